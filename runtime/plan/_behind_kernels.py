"""Compiled kernels that guess what lies behind the nearer surfaces of a frame."""

import math

import numpy as np

from spreadlets.compiled import helper, kernel

BLOCK = 8
"""Side, px, of the blocks of pixels that are looked up together."""
AROUND = 12
"""So far around a block, px, it is compared with other places."""
FARTHEST = 96
"""Farthest that another place may lie along each axis, px."""
TRIALS = 48
"""Places that each block tries by itself; then it tries those of its neighbours, and what lies beside the best."""
ROUNDS = 4
BLOCKS_ACROSS = 1 << 12
"""More than there are in a row: what blocks try first differs."""
MOSTLY_SEEN = 0.9
"""Share of a pixel from which it tells what lies there."""
NEGLIGIBLE = 0.004
"""Share of a pixel, and of what lies hidden in it, that no display shows."""
LEAST_LIGHT = 0.05
"""Added to what differences of colours are relative to."""
LEAST_COVER = 0.25
"""Share of what was seen around a block that is of the layer: what is less is small, and stands amid others."""
FAR_PRICE = 0.02 / FARTHEST**2
"""What a squared distance, px, counts beside squared relative differences."""
HIDDEN_PRICE = 1.0
"""The same of a place where nothing was seen of what is looked for."""
SPARSE, SHEAR = 9, 4
"""Every ninth pixel is compared: of each row others, so that neither rows nor columns are left out."""
TOO_FEW = 8
"""Pixels that must be comparable."""
LIKE = 0.05
"""Mean squared relative difference, summed over features, up to which two places show the same texture."""
LEAST_UNLIKE = 0.001
"""Added to what weights are in inverse proportion to."""
COLOUR, ALPHA, BLUR = 4, 3, -1
"""Colour comes first among the features, with alpha; how far a pixel blurs, px, comes last."""


@helper
def _part(layer, farther, weight, row, col, number):
    """Return the share of a pixel that lies in a layer."""
    part = np.float32(0.0)
    if layer[row, col] == number:
        part = np.float32(1.0) - farther[row, col]
    elif layer[row, col] == number - 1:
        part = farther[row, col]
    return part * weight[row, col] if weight.shape[0] else part


@kernel
def add_cover(begin, end, layer, farther, radiance, weight, blur, number, cover, reach, sums):
    """Add what a pass of pixels covers of a layer to ``cover`` (H, W), and see how far it blurs.

    Parameters
    ----------
    layer, farther, radiance, weight, blur, number
        As for `add_features`.
    reach : ndarray of shape (H, W), float32
        The largest blur of each pixel, px; raised.
    sums : ndarray of shape (H, 3), float64
        Of each row, the sums of the cover and of the cover times the blur, and the largest blur; changed.
    """
    for row in range(begin, end):
        for col in range(layer.shape[1]):
            if not number - 1 <= layer[row, col] <= number:
                continue
            each = _part(layer, farther, weight, row, col, number) * radiance[row, col, 3]
            if each > 0.0:
                cover[row, col] += each
                reach[row, col] = max(reach[row, col], blur[row, col])
                sums[row, 0] += each
                sums[row, 1] += np.float64(each) * blur[row, col]
                sums[row, 2] = max(sums[row, 2], np.float64(blur[row, col]))


@kernel
def add_features(begin, end, layer, farther, radiance, weight, blur, depths, motions, number, features):
    """Add to ``features`` (H, W, n), float32, what a pass of pixels shows of a layer.

    Parameters
    ----------
    layer : ndarray of shape (H, W), int32
    farther : ndarray of shape (H, W), float32
        Layers of the pixels, and their shares in the next one, see `runtime.plan.layering.Membership`.
    radiance : ndarray of shape (H, W, 4), float32
    weight : ndarray of shape (H, W) or (0, 0), float32
    blur : ndarray of shape (H, W), float32
        How far each pixel blurs, px.
    depths : tuple of ndarrays of shape (H, W), float32
        Metres.
    motions : tuple of ndarrays of shape (H, W, 2), float32
    number : int
        The layer.
    """
    for row in range(begin, end):
        for col in range(layer.shape[1]):
            if not number - 1 <= layer[row, col] <= number:
                continue
            part = _part(layer, farther, weight, row, col, number)
            out = features[row, col]
            # Colour and alpha by the pixel's share in the layer; all else by what it covers.
            for c in range(COLOUR):
                out[c] += part * radiance[row, col, c]
            cover = part * radiance[row, col, 3]
            c = COLOUR
            for depth in depths:
                out[c] -= cover / depth[row, col]
                c += 1
            for motion in motions:
                out[c] += cover * motion[row, col, 0]
                out[c + 1] += cover * motion[row, col, 1]
                c += 2
            # How far it blurs comes last.
            out[BLUR] += cover * blur[row, col]


@kernel
def row_distances(begin, end, nearer, distance):
    """Fill ``distance`` (H, W), int32, with the columns from each pixel to the next one mostly seen in its row."""
    width = nearer.shape[1]
    for row in range(begin, end):
        for ahead in range(2):
            last = 1 << 14
            for n in range(width):
                col = width - 1 - n if ahead else n
                last = 0 if 1.0 - nearer[row, col] >= MOSTLY_SEEN else last + 1
                distance[row, col] = min(distance[row, col], last) if ahead else last


@kernel
def find_gaps(begin, end, nearer, across, extent, own, gap):
    """Fill ``gap`` (H, W), float32, with the distance, px, to what was seen; negative where what is hidden stays so.

    Parameters
    ----------
    nearer : ndarray of shape (H, W), float32
        Share of each pixel that nearer layers hide.
    across : ndarray of shape (H, W), int32
        See `row_distances`.
    extent : ndarray of shape (H, W), float32
        How far from the pixel, px, the blur of what hides it may reveal what lies behind.
    own : float
        How far, px, the layer's own blur spreads what lies hidden.
    """
    height = len(nearer)
    for row in range(begin, end):
        for col in range(nearer.shape[1]):
            gap[row, col] = -1.0
            if nearer[row, col] < NEGLIGIBLE:
                continue
            limit = np.float64(extent[row, col]) + own + 1.0
            best, step = limit * limit, 0
            while step * step < best:
                for i in (row - step, row + step):
                    if 0 <= i < height:
                        best = min(best, step * step + np.float64(across[i, col]) ** 2)
                step += 1
            if best < limit * limit:
                gap[row, col] = math.sqrt(best)


@kernel
def choose_blocks(begin, end, nearer, cover, gap, least, corner, unlike):
    """Fill ``unlike`` (h, w), float64, with -1 for blocks that are left as they are, else infinity.

    Those are looked up that have a gap wider than ``least``, px, in a layer that covers, or nearly so, what was seen.
    Blocks lie as the picture's centre does, from which ``corner``, row and column of the frame's first pixel, count.
    """
    height, width = nearer.shape
    for number in range(begin, end):
        for across in range(unlike.shape[1]):
            wide, own, seen = False, 0.0, 0.0
            top, left = number * BLOCK - corner[0] % BLOCK, across * BLOCK - corner[1] % BLOCK
            for i in range(max(top - BLOCK, 0), min(top + 2 * BLOCK, height)):
                for j in range(max(left - BLOCK, 0), min(left + 2 * BLOCK, width)):
                    inside = 0 <= i - top < BLOCK and 0 <= j - left < BLOCK
                    wide = wide or (inside and gap[i, j] > least)
                    own += cover[i, j]
                    seen += 1.0 - nearer[i, j]
            unlike[number, across] = math.inf if wide and own >= LEAST_COVER * seen else -1.0


@helper
def _unlikeness(nearer, features, top, left, down, right, most):
    """Return how unlike, mean squared, what was seen around a block is to what was seen (down, right) of it."""
    height, width = nearer.shape
    price = FAR_PRICE * (down * down + right * right)
    if price >= most:
        return math.inf
    # Enough of the block's own pixels must have been seen there.
    unseen = 0
    for i in range(top + 1 + down, top + BLOCK + down, 2):
        for j in range(left + 1 + right, left + BLOCK + right, 2):
            if not (0 <= i < height and 0 <= j < width) or 1.0 - nearer[i, j] < MOSTLY_SEEN:
                unseen += 1
    price += HIDDEN_PRICE * unseen / (BLOCK // 2) ** 2
    if price >= most:
        return math.inf
    total, weights = 0.0, 0.0
    side = BLOCK + 2 * AROUND
    bound = (most - price) * side * (side // SPARSE + 1)
    for i in range(max(top - AROUND, 0), min(top + BLOCK + AROUND, height)):
        if not 0 <= i + down < height:
            continue
        if total > bound:
            return math.inf
        for j in range(left - AROUND + SHEAR * (i - top) % SPARSE, min(left + BLOCK + AROUND, width), SPARSE):
            if j < 0 or not 0 <= j + right < width:
                continue
            first, second = 1.0 - nearer[i, j], 1.0 - nearer[i + down, j + right]
            if first < MOSTLY_SEEN or second < MOSTLY_SEEN:
                continue
            weights += 1.0
            one, other = features[i, j], features[i + down, j + right]
            for c in range(COLOUR):
                total += ((one[c] - other[c]) / (abs(one[c]) + abs(other[c]) + LEAST_LIGHT)) ** 2
            total += ((one[BLUR] - other[BLUR]) / (1.0 + one[BLUR] + other[BLUR])) ** 2
    if weights < TOO_FEW:
        return math.inf
    return total / weights + price


@helper
def _refine(nearer, features, top, left, size, best, place):
    """Move ``place`` by steps of some sizes, halved each time, while its surroundings get more alike."""
    while size:
        middle_row, middle_col = place[0], place[1]
        for i in range(-1, 2):
            for j in range(-1, 2):
                down, right = middle_row + i * size, middle_col + j * size
                each = _unlikeness(nearer, features, top, left, down, right, best)
                if each < best:
                    best, place[0], place[1] = each, down, right
        size //= 2
    return best


@kernel
def try_places(begin, end, nearer, features, corner, places, unlike):
    """Find for each block, among some places, where what was seen around it is most alike.

    Parameters
    ----------
    nearer, features
        As for `find_behind`.
    corner : tuple of two ints
        As for `choose_blocks`.
    places : ndarray of shape (h, w, 2), int64
        Filled with the rows and columns from the block to the place.
    unlike : ndarray of shape (h, w), float64
        See `choose_blocks`; filled, infinite where no place is found.
    """
    for number in range(begin, end):
        for across in range(unlike.shape[1]):
            place = places[number, across]
            place[:] = 0
            if unlike[number, across] < 0.0:
                continue
            best = math.inf
            top, left = number * BLOCK - corner[0] % BLOCK, across * BLOCK - corner[1] % BLOCK
            part = BLOCKS_ACROSS * (number + corner[0] // BLOCK) + across + corner[1] // BLOCK
            for n in range(TRIALS):
                # A sequence that fills the square evenly (Roberts 2018), another part of it for each block.
                index = n + TRIALS * part
                x, y = 0.7548776662466927 * index % 1.0, 0.5698402909980532 * index % 1.0
                # Denser in the middle.
                x, y = 2.0 * x - 1.0, 2.0 * y - 1.0
                down, right = int(FARTHEST * y * abs(y)), int(FARTHEST * x * abs(x))
                each = _unlikeness(nearer, features, top, left, down, right, best)
                if each < best:
                    best, place[0], place[1] = each, down, right
            if best < math.inf:
                best = _refine(nearer, features, top, left, 4, best, place)
            unlike[number, across] = best


@kernel
def spread_places(begin, end, nearer, features, corner, places, unlike, new_places, new_unlike):
    """Let each block try its neighbours' places: fill the new arrays, like those of `try_places`."""
    rows, cols = unlike.shape
    for number in range(begin, end):
        for across in range(cols):
            best, place = unlike[number, across], new_places[number, across]
            place[0], place[1] = places[number, across, 0], places[number, across, 1]
            # Try the neighbours' places.
            if best >= 0.0:
                start = best
                top, left = number * BLOCK - corner[0] % BLOCK, across * BLOCK - corner[1] % BLOCK
                for i in range(max(number - 1, 0), min(number + 2, rows)):
                    for j in range(max(across - 1, 0), min(across + 2, cols)):
                        if not 0.0 <= unlike[i, j] < math.inf:
                            continue
                        down, right = places[i, j, 0], places[i, j, 1]
                        if down == place[0] and right == place[1]:
                            continue
                        each = _unlikeness(nearer, features, top, left, down, right, best)
                        if each < best:
                            best, place[0], place[1] = each, down, right
                # Refine what was better.
                if best < start:
                    best = _refine(nearer, features, top, left, 2, best, place)
            new_unlike[number, across] = best


@helper
def _keep(row, col, number, share, value, found, known):
    """Keep a hidden surface of a pixel, the features ``value`` premultiplied, if it is larger than what is kept."""
    layer, shares, features = found
    if shares[row, col] >= share:
        return
    if shares[row, col] > 0.0:
        known[row, col] ^= np.uint64(1) << np.uint64(layer[row, col])
    known[row, col] |= np.uint64(1) << np.uint64(number)
    layer[row, col], shares[row, col] = number, share
    for c in range(features.shape[2]):
        features[row, col, c] = value[c] / value[ALPHA]


@kernel
def take_elsewhere(begin, end, nearer, layer, seen, features, number, found, known):
    """Take from neighbouring frames what of a layer lies hidden in each pixel.

    Parameters
    ----------
    nearer : ndarray of shape (H, W), float32
        Share of each pixel that nearer layers hide.
    layer : ndarray of shape (H, W), int32
        Layer of what was seen elsewhere.
    seen : ndarray of shape (H, W), float32
        0 where nothing was.
    features : ndarray of shape (H, W, n), float32
        Of what was seen.
    number, found, known
        As for `find_behind`.
    """
    for row in range(begin, end):
        for col in range(nearer.shape[1]):
            if nearer[row, col] < NEGLIGIBLE or seen[row, col] == 0.0 or layer[row, col] < number:
                continue
            if layer[row, col] == number and features[row, col, ALPHA] > 0.0:
                share = nearer[row, col] * features[row, col, ALPHA]
                _keep(row, col, number, share, features[row, col], found, known)
            else:
                known[row, col] |= np.uint64(1) << np.uint64(number)


@helper
def _copy(nearer, features, corner, places, unlike, row, col, value):
    """Fill ``value`` (n) with what the places of the four blocks around a pixel show; return the sum of its weights.

    They give way to each other linearly, the more alike counting more.
    """
    height, width = nearer.shape
    y = (row + corner[0] % BLOCK + 0.5) / BLOCK - 0.5
    x = (col + corner[1] % BLOCK + 0.5) / BLOCK - 0.5
    # Find the four blocks around the pixel.
    above, before = math.floor(y), math.floor(x)
    value[:] = 0.0
    total = 0.0
    for k in range(4):
        i, j = above + k // 2, before + k % 2
        if not (0 <= i < unlike.shape[0] and 0 <= j < unlike.shape[1]) or not 0.0 <= unlike[i, j] <= LIKE:
            continue
        # Look up its place in what the block was found to be like.
        there_row, there_col = row + places[i, j, 0], col + places[i, j, 1]
        if not (0 <= there_row < height and 0 <= there_col < width):
            continue
        seen = 1.0 - nearer[there_row, there_col]
        if seen < MOSTLY_SEEN:
            continue
        # Blend, the more alike counting more.
        weight = (y - above if k // 2 else 1.0 - (y - above)) * (x - before if k % 2 else 1.0 - (x - before))
        weight /= LEAST_UNLIKE + unlike[i, j]
        total += weight
        for c in range(len(value)):
            value[c] += weight / seen * features[there_row, there_col, c]
    return total


@kernel
def find_behind(begin, end, nearer, features, gap, corner, places, unlike, number, found, known):
    """Guess what of a layer lies hidden in each pixel.

    Parameters
    ----------
    nearer : ndarray of shape (H, W), float32
        Share of each pixel that nearer layers hide.
    features : ndarray of shape (H, W, n), float32
        See `add_features`.
    gap, corner, places, unlike
        See `find_gaps` and `try_places`.
    number : int
        The layer.
    found : tuple of ndarrays of shapes (H, W), (H, W) and (H, W, n - 1), int32 and float32
        Layer, share of the pixel, and features of the largest hidden surface; changed. All others are unknown.
    known : ndarray of shape (H, W), uint64
        Bits of the layers in which each pixel is known; set.
    """
    value = np.empty(features.shape[2])
    bit = np.uint64(1) << np.uint64(number)
    for row in range(begin, end):
        for col in range(nearer.shape[1]):
            hidden = np.float64(nearer[row, col])
            if hidden < NEGLIGIBLE:
                known[row, col] |= bit
            elif gap[row, col] >= 0.0 and not known[row, col] & bit:
                total = _copy(nearer, features, corner, places, unlike, row, col, value)
                if total == 0.0:
                    continue
                if value[ALPHA] < NEGLIGIBLE * total:
                    known[row, col] |= bit
                else:
                    _keep(row, col, number, hidden * value[ALPHA] / total, value, found, known)
