"""Compiled kernels that guess what lies behind the nearer surfaces of a frame."""

import math

import numpy as np

from spreadlets.compiled import helper, kernel
from spreadlets.runtime._lamp_kernels import BRIGHTEST, dimmed, evened
from spreadlets.runtime._vector_kernels import add, load, multiply, store
from spreadlets.runtime.plan._alike_kernels import ALPHA, BLOCK, COLOUR, LIKE, MOSTLY_SEEN
from spreadlets.runtime.plan._bridge_kernels import bridge, continue_around
from spreadlets.runtime.plan._layer_kernels import share_in

EXACT = 16.0
"""Distances, cells, up to which they are exact, others by blocks: there what a blur reveals ends softly."""
LEAST_GAP = 0.1
"""Width of gaps, in the blur of what lies around, from which its texture shows in them; narrower ones that fills."""
FAR_BLUR = 2.0
"""How far a layer's blur may reach, in its mean one: a few pixels far out of focus do not widen what is looked up."""
NEGLIGIBLE = 0.004
"""Share of a pixel, and of what lies hidden in it, that no display shows."""
LEAST_COVER = 0.25
"""Share of what was seen around a block that is of the layer: what is less is small, and stands amid others."""
LEAST_UNLIKE = 0.001
"""Added to what weights are in inverse proportion to."""
_U = np.uint64


@kernel
def sum_layers(begin, end, surface, at, corner, cover, sums, reach):
    """See what a surface covers in each layer, and how far that blurs.

    Parameters
    ----------
    surface : tuple of ndarrays
        ``layer`` (H, W), int32, and ``farther`` (H, W), float32: see `runtime.plan.layering.Membership`; ``radiance``
        (H, W, 4), ``weight`` (H, W) or (0, 0), ``coc`` and ``length`` (H, W), float32.
    at : ndarray of shape (H, W, 2) or (0, 0, 2), int32
        Where the pixels of a list lie, rows and columns; empty for those of a frame. A list is done in one call.
    corner : tuple of two ints
        Row and column of the frame's first pixel, counted from the picture's centre, which tiles are aligned with.
    cover : ndarray of shape (H, W), float32
        Filled with the share of its pixel that the surface covers.
    sums : ndarray of shape (h, w, n_layers, 2), float32
        Of each layer in each tile: the cover, and the cover times the blur, px; changed.
    reach : ndarray of shape (h, w, n_layers), float32
        The largest blur of each layer in each tile; raised.
    """
    layer, farther, radiance, weight, coc, length = surface
    listed, down, left = at.shape[0] > 0, corner[0] % BLOCK, corner[1] % BLOCK
    above = 0 if listed else down
    for tile in range(begin, end):
        for row in range(max(tile * BLOCK - above, 0), min((tile + 1) * BLOCK - above, layer.shape[0])):
            for col in range(layer.shape[1]):
                # What is drawn of the surface covers its pixel.
                own = radiance[row, col, 3] * (weight[row, col] if weight.shape[0] else np.float32(1.0))
                cover[row, col] = own
                if own <= 0.0:
                    continue
                blur = abs(coc[row, col]) + np.float32(0.5) * length[row, col]
                y, x = (at[row, col, 0], at[row, col, 1]) if listed else (row, col)
                # Sum it up in the one or two layers that it lies in.
                for number in range(layer[row, col], layer[row, col] + 2):
                    each = own * share_in(layer[row, col], farther[row, col], number)
                    if each > 0.0:
                        i, j = (y + down) // BLOCK, (x + left) // BLOCK
                        sums[i, j, number, 0] += each
                        sums[i, j, number, 1] += each * abs(coc[row, col])
                        reach[i, j, number] = max(reach[i, j, number], blur)


@helper
def _pixels_in(number, level, corner, size):
    """Return the first row of a frame in a row of cells, and the first behind; for columns alike."""
    cell = 1 << level
    begin = number * cell - corner % cell
    return max(begin, 0), min(begin + cell, size)


@kernel
def enter_layer(begin, end, members, cover, at, number, level, corner, nearer, cells):
    """Let a surface's pixels in the layer before a layer hide what lies in it, and sum up in cells what they cover.

    Parameters
    ----------
    members : tuple of ndarrays of shape (H, W), int32 and float32
        The surface's ``layer`` and ``farther``.
    cover, at, corner
        As for `sum_layers`.
    number : int
        The layer.
    level : int
        Cells have sides of 2^level px; they are aligned as tiles are.
    nearer : ndarray of shape (H, W), float32
        Share of each pixel that nearer layers hide; raised.
    cells : tuple of two ndarrays of shape (h, w), float32
        ``hides``, the mean of ``nearer`` in each cell, and ``covers``, that of what the layer covers: added to by
        lists, and made means by the surface of a frame, which comes last.
    """
    layer, farther = members
    hides, covers = cells
    listed, down, left = at.shape[0] > 0, corner[0] % (1 << level), corner[1] % (1 << level)
    for i in range(begin, end):
        first, last = (i, i + 1) if listed else _pixels_in(i, level, corner[0], len(nearer))
        for row in range(first, last):
            for col in range(layer.shape[1]):
                y, x = (at[row, col, 0], at[row, col, 1]) if listed else (row, col)
                own = layer[row, col]
                # Hide by the layer before, and cover by the layer itself.
                if number - 2 <= own <= number and cover[row, col] > 0.0:
                    nearer[y, x] += cover[row, col] * share_in(own, farther[row, col], number - 1)
                    here = cover[row, col] * share_in(own, farther[row, col], number)
                    covers[(y + down) >> level, (x + left) >> level] += here
                if not listed:
                    hides[i, (x + left) >> level] += nearer[y, x]
        # Turn the sums into means.
        if level and not listed:
            for j in range(hides.shape[1]):
                start, stop = _pixels_in(j, level, corner[1], nearer.shape[1])
                scale = np.float32(1.0) / ((last - first) * (stop - start))
                hides[i, j] *= scale
                covers[i, j] *= scale


@kernel
def clear_features(begin, end, corner, wanted, features):
    """Fill the features of wanted blocks of cells with 0; for the arguments see `sum_light`."""
    above, before = corner[0] % BLOCK, corner[1] % BLOCK
    for block in range(begin, end):
        first, last = max(block * BLOCK - above, 0), min((block + 1) * BLOCK - above, features.shape[0])
        for across in range(wanted.shape[1]):
            if wanted[block, across]:
                start, stop = max(across * BLOCK - before, 0), min((across + 1) * BLOCK - before, features.shape[1])
                features[first:last, start:stop] = np.float32(0.0)


@helper
def _add_nearness(flat, place, covers, depth):
    """Add the nearness of pixels of a row, times what they cover, to features of their cells, and go to the next."""
    for k in range(len(place)):
        flat[place[k, 1]] -= covers[k] / depth[place[k, 0]]
        place[k, 1] += _U(1)


@helper
def _add_motion(flat, place, covers, motion):
    """Do as `_add_nearness` for both axes of their motion."""
    for k in range(len(place)):
        col, at = place[k, 0], place[k, 1]
        flat[at] += covers[k] * motion[col, 0]
        flat[at + _U(1)] += covers[k] * motion[col, 1]
        place[k, 1] += _U(2)


@kernel
def add_features(begin, end, surface, at, planes, number, level, corner, wanted, features):
    """Add up in cells what a surface shows of a layer.

    Parameters
    ----------
    surface, at, corner
        As for `sum_layers`.
    planes : tuple of two tuples of ndarrays of shapes (H, W) and (H, W, 2), float32
        The surface's depths, metres, and motions.
    number, level
        As for `enter_layer`.
    wanted : ndarray of shape (h / BLOCK, w / BLOCK), bool
        The blocks of cells that are to be filled.
    features : ndarray of shape (h, w, n), float32
        Changed: means of colour, of nearness and motions times alpha, and last how far it blurs, px; as for `cells`.
        Where it has room for colour and blur only, all else is left out.
    """
    layer, farther, radiance, weight, coc, length = surface
    listed, down, left = at.shape[0] > 0, corner[0] % (1 << level), corner[1] % (1 << level)
    above, before = (corner[0] >> level) % BLOCK, (corner[1] >> level) % BLOCK
    flat, (_, across, size) = features.reshape(features.size), features.shape
    # The pixels of a row that show the layer: their columns, where the features of their cells begin, and their cover.
    place, covers = np.empty((layer.shape[1], 2), np.uint64), np.empty(layer.shape[1], np.float32)
    for i in range(begin, end):
        if not listed and not wanted[(i + above) // BLOCK].any():
            continue
        first, last = (i, i + 1) if listed else _pixels_in(i, level, corner[0], layer.shape[0])
        for row in range(first, last):
            n, colours = 0, radiance[row].reshape(4 * layer.shape[1])
            for col in range(layer.shape[1]):
                if not number - 1 <= layer[row, col] <= number:
                    continue
                y, x = (at[row, col, 0], at[row, col, 1]) if listed else (row, col)
                y, x = (y + down) >> level, (x + left) >> level
                part = share_in(layer[row, col], farther[row, col], number)
                part *= weight[row, col] if weight.shape[0] else np.float32(1.0)
                if part == 0.0 or not wanted[(y + above) // BLOCK, (x + before) // BLOCK]:
                    continue
                # Colour and alpha by the pixel's share in the layer; all else by what it covers.
                out, cover = _U((y * across + x) * size), part * radiance[row, col, ALPHA]
                store(flat, out, add(load(flat, out), multiply((part, part, part, part), load(colours, _U(4 * col)))))
                place[n, 0], place[n, 1], covers[n] = col, out + _U(COLOUR), cover
                n += 1
                # How far it blurs comes last.
                flat[out + _U(size - 1)] += cover * (abs(coc[row, col]) + np.float32(0.5) * length[row, col])
            # Plane by plane: to take one out of a tuple costs as much as to add a pixel.
            if size > COLOUR + 1:
                for depth in planes[0]:
                    _add_nearness(flat, place[:n], covers, depth[row])
                for motion in planes[1]:
                    _add_motion(flat, place[:n], covers, motion[row])
        if level and not listed:
            for j in range(across):
                if wanted[(i + above) // BLOCK, (j + before) // BLOCK]:
                    start, stop = _pixels_in(j, level, corner[1], layer.shape[1])
                    for c in range(size):
                        features[i, j, c] /= np.float32((last - first) * (stop - start))


@kernel
def sum_light(begin, end, features, corner, wanted, light):
    """Fill ``light`` (h / BLOCK, w / BLOCK, 2), float64, with the evened light and the alpha of blocks of cells.

    Parameters
    ----------
    features : ndarray of shape (h, w, n), float32
        See `add_features`.
    corner : tuple of two ints
        Row and column of the first cell, counted from the picture's centre.
    wanted : ndarray of shape (h / BLOCK, w / BLOCK), bool
        The blocks that are filled.
    """
    above, before = corner[0] % BLOCK, corner[1] % BLOCK
    for block in range(begin, end):
        light[block] = 0.0
        for across in range(light.shape[1]):
            if not wanted[block, across]:
                continue
            sums = light[block, across]
            for i in range(max(block * BLOCK - above, 0), min((block + 1) * BLOCK - above, features.shape[0])):
                for j in range(max(across * BLOCK - before, 0), min((across + 1) * BLOCK - before, features.shape[1])):
                    cover = np.float64(features[i, j, ALPHA])
                    if cover > 0.0:
                        brightest = max(features[i, j, 0], features[i, j, 1], features[i, j, 2], np.float32(0.0))
                        sums[0] += cover * evened(brightest / cover)
                        sums[1] += cover


@kernel
def dim_highlights(begin, end, light, corner, features):
    """Dim cells that are more than `BRIGHTEST` times as bright as the blocks around them.

    Parameters
    ----------
    light, corner
        See `sum_light`.
    features : ndarray of shape (h, w, n), float32
        Changed.
    """
    above, before = corner[0] % BLOCK, corner[1] % BLOCK
    for block in range(begin, end):
        for across in range(light.shape[1]):
            if light[block, across, 1] == 0.0:
                continue
            # The mean of the block and those beside it.
            total, cover = 0.0, 0.0
            for k in range(max(block - 1, 0), min(block + 2, light.shape[0])):
                for m in range(max(across - 1, 0), min(across + 2, light.shape[1])):
                    total += light[k, m, 0]
                    cover += light[k, m, 1]
            limit = BRIGHTEST * (total / max(cover, NEGLIGIBLE)) ** 4
            for i in range(max(block * BLOCK - above, 0), min((block + 1) * BLOCK - above, features.shape[0])):
                for j in range(max(across * BLOCK - before, 0), min((across + 1) * BLOCK - before, features.shape[1])):
                    each = features[i, j]
                    brightest, most = max(each[0], each[1], each[2]), limit * each[ALPHA]
                    if brightest > most:
                        scale = np.float32(dimmed(brightest, most) / brightest)
                        for c in range(ALPHA):
                            each[c] *= scale


@kernel
def row_distances(begin, end, hides, corner, distance, seen):
    """Find the cells from each one to the next mostly seen one in its row, and the blocks that have such.

    Parameters
    ----------
    hides : ndarray of shape (h, w), float32
        Share of each cell that nearer layers hide.
    corner : tuple of two ints
        Row and column of the first cell, counted from the picture's centre: blocks lie as that does.
    distance : ndarray of shape (h, w), int32
        Filled.
    seen : ndarray of shape (h / BLOCK, w / BLOCK), bool
        Set.
    """
    width = hides.shape[1]
    above, before = corner[0] % BLOCK, corner[1] % BLOCK
    for row in range(begin, end):
        for ahead in range(2):
            last = 1 << 14
            for n in range(width):
                col = width - 1 - n if ahead else n
                last = last + 1
                if 1.0 - hides[row, col] >= MOSTLY_SEEN:
                    last = 0
                    # Threads may write the same place, but nothing else than this.
                    seen[(row + above) // BLOCK, (col + before) // BLOCK] = True
                distance[row, col] = min(distance[row, col], last) if ahead else last


@helper
def _nearest(across, row, col, most):
    """Return the distance from a cell to the next seen one, at most some, by those along the rows above and below."""
    best, step = most * most, 0
    while step * step < best:
        for i in (row - step, row + step):
            if 0 <= i < len(across):
                best = min(best, step * step + np.float64(across[i, col]) ** 2)
        step += 1
    return math.sqrt(best)


@kernel
def nearest(begin, end, across, distance):
    """Fill ``distance`` (h, w), float64, from distances along rows, see `row_distances`."""
    for row in range(begin, end):
        for col in range(across.shape[1]):
            distance[row, col] = _nearest(across, row, col, 1.0 + max(across.shape))


@kernel
def find_gaps(begin, end, hides, across, away, blur, level, corner, gap):
    """Fill ``gap`` (h, w), float32, with the cells to what was seen; negative where what is hidden stays so.

    Parameters
    ----------
    hides, across
        See `row_distances`.
    away : ndarray of shape (h / BLOCK, w / BLOCK), float64
        From each block to the next one of which something was seen, blocks.
    blur : tuple of two ndarrays of shape (H / BLOCK, W / BLOCK), float32, and a float
        How far, px, the blur of what hides each tile of pixels may reveal what lies behind; the layer's own mean blur
        around it, px; and the layer's largest one.
    level : int
    corner : tuple of two ints
        As for `enter_layer`.
    """
    reach, own, farthest = blur
    cell = 1 << level
    above, before = (corner[0] >> level) % BLOCK, (corner[1] >> level) % BLOCK
    down, left = corner[0] % BLOCK - corner[0] % cell, corner[1] % BLOCK - corner[1] % cell
    for row in range(begin, end):
        for col in range(hides.shape[1]):
            gap[row, col] = -1.0
            # What hides nothing has no gap.
            if hides[row, col] < NEGLIGIBLE:
                continue
            # Find how far the blurs reach, and whether by blocks that is too far.
            tile_row, tile_col = (row * cell + down) // BLOCK, (col * cell + left) // BLOCK
            mean = np.float64(own[tile_row, tile_col])
            limit = (np.float64(reach[tile_row, tile_col]) + min(FAR_BLUR * mean, farthest) + 1.0) / cell
            most = min(max(EXACT, LEAST_GAP * mean / cell), limit)
            rough = BLOCK * away[(row + above) // BLOCK, (col + before) // BLOCK]
            if rough - 1.5 * BLOCK < most:
                exactly = _nearest(across, row, col, most)
                if exactly < most:
                    gap[row, col] = exactly
                    continue
            if most <= rough < limit:
                gap[row, col] = rough


@kernel
def choose_blocks(begin, end, hides, covers, gap, own, level, corner, chosen):
    """Fill ``chosen`` (h / BLOCK, w / BLOCK), bool, with which blocks are to be looked up.

    Those are looked up that have a gap wider than `LEAST_GAP` times the blur around, in a layer that covers, or nearly
    so, what was seen. For ``hides`` and ``covers`` see `enter_layer`, for ``gap``, ``own`` and ``corner`` `find_gaps`.
    """
    height, width = hides.shape
    cell, above, before = 1 << level, (corner[0] >> level) % BLOCK, (corner[1] >> level) % BLOCK
    down, aside = corner[0] % BLOCK - corner[0] % cell, corner[1] % BLOCK - corner[1] % cell
    for number in range(begin, end):
        for across in range(chosen.shape[1]):
            top, left = number * BLOCK - above, across * BLOCK - before
            chosen[number, across] = False
            # Is there a wide gap?
            wide = False
            for i in range(max(top, 0), min(top + BLOCK, height)):
                for j in range(max(left, 0), min(left + BLOCK, width)):
                    mean = own[(i * cell + down) // BLOCK, (j * cell + aside) // BLOCK]
                    wide = wide or gap[i, j] > max(LEAST_GAP * mean / cell, 0.0)
            if not wide:
                continue
            # Is most of what was seen around of the layer?
            covered, seen = 0.0, 0.0
            for i in range(max(top - BLOCK, 0), min(top + 2 * BLOCK, height)):
                for j in range(max(left - BLOCK, 0), min(left + 2 * BLOCK, width)):
                    covered += covers[i, j]
                    seen += 1.0 - hides[i, j]
            chosen[number, across] = covered >= LEAST_COVER * seen


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
def _copy(hides, features, corner, places, unlike, brightest, row, col, value):
    """Fill ``value`` (n) with what the places of the four blocks around a cell show; return the sum of its weights.

    They give way to each other linearly, the more alike counting more.
    """
    height, width = hides.shape
    y = (row + corner[0] % BLOCK + 0.5) / BLOCK - 0.5
    x = (col + corner[1] % BLOCK + 0.5) / BLOCK - 0.5
    # Find the four blocks around the cell.
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
        seen = 1.0 - hides[there_row, there_col]
        if seen < MOSTLY_SEEN:
            continue
        # Blend, the more alike counting more.
        weight = (y - above if k // 2 else 1.0 - (y - above)) * (x - before if k % 2 else 1.0 - (x - before))
        weight /= LEAST_UNLIKE + unlike[i, j]
        total += weight
        there, scale = features[there_row, there_col], weight / seen
        # What is brighter than all that was seen around would catch the eye.
        light = max(there[0], there[1], there[2])
        dimmed = scale * min(1.0, brightest[i, j] / light) if light > 0.0 else scale
        for c in range(ALPHA):
            value[c] += dimmed * there[c]
        for c in range(ALPHA, len(value)):
            value[c] += scale * there[c]
    return total


@kernel
def find_behind(begin, end, nearer, cells, looked_up, level, corner, number, found, known):
    """Guess what of a layer lies hidden in each pixel.

    Parameters
    ----------
    nearer : ndarray of shape (H, W), float32
        Share of each pixel that nearer layers hide.
    cells : tuple of ndarrays of shapes (h, w), (h, w, n) and (h, w), float32, and (h, w), uint8
        What hides them, see `enter_layer`; `add_features`; `find_gaps`; and
        `runtime.plan._bridge_kernels.mark_comparable`.
    looked_up : tuple of two ints and four ndarrays
        Row and column of the first cell, as for `row_distances`; and the blocks' places, how unlike these are, how
        bright what was seen around is, and up to which width of a gap, cells, what is seen beside it goes on.
    level, corner
        As for `enter_layer`.
    number : int
        The layer.
    found : tuple of ndarrays of shapes (H, W), (H, W) and (H, W, n - 1), int32 and float32
        Layer, share of the pixel, and features of the largest hidden surface; changed. All others are unknown.
    known : ndarray of shape (H, W), uint64
        Bits of the layers of which all that is hidden in a pixel is known; set.
    """
    hides, features, gap, comparable = cells
    first, places, unlike, brightest, widest = looked_up
    above, before = first[0] % BLOCK, first[1] % BLOCK
    shown = hides, features, comparable
    value, bit = np.empty(features.shape[2]), np.uint64(1) << np.uint64(number)
    for i in range(begin, end):
        top, bottom = _pixels_in(i, level, corner[0], nearer.shape[0])
        for j in range(gap.shape[1]):
            if gap[i, j] < 0.0:
                continue
            # Copy from what the blocks around were found to be like.
            total = _copy(hides, features, first, places, unlike, brightest, i, j, value)
            # Where nothing is alike, continue what is seen beside a narrow gap across it, or what lies around into it.
            if total == 0.0:
                goes_on = bridge(shown, i, j, gap[i, j], value)
                if not goes_on and 0.0 < gap[i, j] <= widest[(i + above) // BLOCK, (j + before) // BLOCK]:
                    goes_on = continue_around(shown, i, j, gap[i, j], value)
                total = 1.0 if goes_on else 0.0
            if total == 0.0:
                continue
            # Give it to the pixels of the cell of which something is hidden.
            left, right = _pixels_in(j, level, corner[1], nearer.shape[1])
            for row in range(top, bottom):
                for col in range(left, right):
                    hidden = np.float64(nearer[row, col])
                    if hidden < NEGLIGIBLE or known[row, col] & bit:
                        continue
                    if value[ALPHA] < NEGLIGIBLE * total:
                        known[row, col] |= bit
                    else:
                        _keep(row, col, number, hidden * value[ALPHA] / total, value, found, known)
