"""Compiled kernels that find places that look alike."""

import math

import numpy as np

from spreadlets.compiled import helper, kernel

BLOCK = 8
"""Side, cells, of the blocks that are looked up together."""
AROUND = 12
"""So far around a block, cells, it is compared with other places."""
NEAREST = 4
"""Nearest that another place may lie: a nearer one shows hardly more than what was seen."""
FARTHEST = 64
"""Farthest that a block tries another place by itself along each axis, cells."""
TRIALS = 48
"""Places that each block tries by itself; then it tries those of its neighbours, and what lies beside the best."""
BLOCKS_ACROSS = 1 << 12
"""More than there are in a row: what blocks try first differs."""
MOSTLY_SEEN = 0.9
"""Share of a cell from which it tells what lies there."""
LEAST_LIGHT = 0.05
"""Added to what differences of colours are relative to."""
MOST_PRICE = 0.02
FAR_PRICE = MOST_PRICE / FARTHEST**2
"""What a squared distance, cells, counts beside squared relative differences, and what it counts at most."""
HIDDEN_PRICE = 1.0
"""The same of a place where nothing was seen of what is looked for."""
SPARSE, SHEAR = 9, 4
"""Every ninth cell is compared: of each row others, so that neither rows nor columns are left out."""
MOST_COMPARED = (BLOCK + 2 * AROUND - 1) // SPARSE + 1
"""Cells of a row that are compared, at most."""
TOO_FEW = 20
"""Cells that must be comparable."""
LIKE = 0.05
"""Mean squared relative difference, summed over features, up to which two places show the same texture."""
RANDOM = 0.25
"""How unlike places may be, in the variance around them."""
EVEN = 0.005
"""How unlike they may be anyway: where nothing varies, one place is as good as another."""
COLOUR, ALPHA, BLUR = 4, 3, -1
"""Colour comes first among the features, with alpha; how far a pixel blurs, px, comes last."""
COARSE_STEP, STEP, FINE_STEP = 4, 2, 1
"""Steps, cells, by which places are moved first: of a block that has just found one, that had one, or a handed down."""


@helper
def _unlikeness(hides, features, top, left, down, right, most):
    """Return how unlike, mean squared, what was seen around a block is to what was seen (down, right) of it."""
    height, width = hides.shape
    if max(abs(down), abs(right)) < NEAREST:
        return math.inf
    price = min(FAR_PRICE * (down * down + right * right), MOST_PRICE)
    if price >= most:
        return math.inf
    # Enough of the block's own pixels must have been seen there.
    unseen = 0
    for i in range(top + 1 + down, top + BLOCK + down, 2):
        for j in range(left + 1 + right, left + BLOCK + right, 2):
            if not (0 <= i < height and 0 <= j < width) or 1.0 - hides[i, j] < MOSTLY_SEEN:
                unseen += 1
                if price + HIDDEN_PRICE * unseen / (BLOCK // 2) ** 2 >= most:
                    return math.inf
    price += HIDDEN_PRICE * unseen / (BLOCK // 2) ** 2
    total, weights = 0.0, 0.0
    last = min(top + BLOCK + AROUND, height, height - down)
    for i in range(max(top - AROUND, 0, -down), last):
        # Even if all cells that are left could be compared, and were the same, it would be too unlike.
        if total > (most - price) * (weights + MOST_COMPARED * (last - i)):
            return math.inf
        for j in range(left - AROUND + SHEAR * (i - top) % SPARSE, min(left + BLOCK + AROUND, width), SPARSE):
            if j < 0 or not 0 <= j + right < width:
                continue
            first, second = 1.0 - hides[i, j], 1.0 - hides[i + down, j + right]
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
def _refine(hides, features, top, left, size, best, place):
    """Move ``place`` by steps of some sizes, halved each time, while its surroundings get more alike."""
    while size:
        middle_row, middle_col = place[0], place[1]
        for i in range(-1, 2):
            for j in range(-1, 2):
                down, right = middle_row + i * size, middle_col + j * size
                if down == place[0] and right == place[1]:
                    continue
                each = _unlikeness(hides, features, top, left, down, right, best)
                if each < best:
                    best, place[0], place[1] = each, down, right
        size //= 2
    return best


@helper
def _try_around(hides, features, top, left, part, best, place):
    """Let a block try places of its own, and keep the best."""
    for n in range(TRIALS):
        # A sequence that fills the square evenly (Roberts 2018), another part of it for each block.
        index = n + TRIALS * part
        x, y = 0.7548776662466927 * index % 1.0, 0.5698402909980532 * index % 1.0
        # Denser in the middle.
        x, y = 2.0 * x - 1.0, 2.0 * y - 1.0
        down, right = int(FARTHEST * y * abs(y)), int(FARTHEST * x * abs(x))
        each = _unlikeness(hides, features, top, left, down, right, best)
        if each < best:
            best, place[0], place[1] = each, down, right
    return best


@helper
def _try_neighbours(hides, features, top, left, given, number, across, best, place):
    """Let a block try the places of the blocks around it, and keep the best."""
    places, unlike = given
    for i in range(max(number - 1, 0), min(number + 2, len(unlike))):
        for j in range(max(across - 1, 0), min(across + 2, unlike.shape[1])):
            if not 0.0 <= unlike[i, j] < math.inf:
                continue
            down, right = places[i, j, 0], places[i, j, 1]
            if down == place[0] and right == place[1]:
                continue
            each = _unlikeness(hides, features, top, left, down, right, best)
            if each < best:
                best, place[0], place[1] = each, down, right
    return best


@kernel
def look_up(begin, end, hides, features, corner, first, most, given, places, unlike):
    """Find for each block where what was seen around it is most alike: among some places, then those of its neighbours.

    Parameters
    ----------
    hides : ndarray of shape (h, w), float32
        Share of each cell that hides what is looked for.
    features : ndarray of shape (h, w, n), float32
        What was seen in each cell: colour and alpha first, and last how far it blurs, px.
    corner : tuple of two ints
        Row and column of the first cell, counted from the picture's centre: blocks lie as that does.
    first : bool
        Whether blocks try the places that are given, and others, before they ask each other.
    most : float
        How unlike a place may be to be of use.
    given : tuple of ndarrays of shapes (h / BLOCK, w / BLOCK, 2), int64, and (h / BLOCK, w / BLOCK), float64
        What each block has found: rows and columns from it to the place, and how unlike that is: infinite if nothing
        is alike, negative if it is to find nothing.
    places, unlike : ndarray
        Filled with what it has found then.
    """
    old_places, old_unlike = given
    for number in range(begin, end):
        for across in range(unlike.shape[1]):
            before, place = old_unlike[number, across], places[number, across]
            unlike[number, across], place[0], place[1] = (
                before,
                old_places[number, across, 0],
                old_places[number, across, 1],
            )
            if before < 0.0:
                continue
            start, size = min(before, most), STEP
            best, top, left = start, number * BLOCK - corner[0] % BLOCK, across * BLOCK - corner[1] % BLOCK
            if first:
                part = BLOCKS_ACROSS * (number + corner[0] // BLOCK) + across + corner[1] // BLOCK
                best, size = _unlikeness(hides, features, top, left, place[0], place[1], best), COARSE_STEP
                best = _try_around(hides, features, top, left, part, min(best, start), place)
            best = _try_neighbours(hides, features, top, left, given, number, across, best, place)
            # Refine what is better.
            if best < start:
                unlike[number, across] = _refine(hides, features, top, left, size, best, place)


@kernel
def refine_places(begin, end, hides, features, corner, places, unlike):
    """Move the place of each block while its surroundings get more alike.

    Parameters
    ----------
    hides, features, corner
        As for `look_up`.
    places, unlike : ndarray of shapes (h / BLOCK, w / BLOCK, 2), int64, and (h / BLOCK, w / BLOCK), float64
        Changed. How unlike a place is stays as it was where too little was seen to tell.
    """
    for number in range(begin, end):
        for across in range(unlike.shape[1]):
            place = places[number, across]
            if not 0.0 <= unlike[number, across] < math.inf:
                continue
            top, left = number * BLOCK - corner[0] % BLOCK, across * BLOCK - corner[1] % BLOCK
            best = _unlikeness(hides, features, top, left, place[0], place[1], math.inf)
            best = _refine(hides, features, top, left, FINE_STEP, best, place)
            if best < math.inf:
                unlike[number, across] = best


@helper
def _look_around(hides, features, top, left, sums):
    """Return how bright what was seen around a block is, and how much its colours vary, as `_unlikeness` counts it.

    Where nothing was, it may be as bright as can be.
    """
    height, width = hides.shape
    brightest, count, sums[:] = 0.0, 0, 0.0
    for i in range(max(top - AROUND, 0), min(top + BLOCK + AROUND, height)):
        for j in range(max(left - AROUND, 0), min(left + BLOCK + AROUND, width)):
            if 1.0 - hides[i, j] < MOSTLY_SEEN:
                continue
            count += 1
            for c in range(ALPHA):
                light = np.float64(features[i, j, c])
                brightest = max(brightest, light)
                sums[c, 0] += light
                sums[c, 1] += light * light
    varied = 0.0
    for c in range(ALPHA):
        mean = sums[c, 0] / max(count, 1)
        varied += max(sums[c, 1] / max(count, 1) - mean * mean, 0.0) / (2.0 * mean + LEAST_LIGHT) ** 2
    return brightest if count else math.inf, varied


@kernel
def judge_places(begin, end, hides, features, corner, unlike, brightest):
    """Find how bright what was seen around each block is, and which places are not more alike than any other.

    Parameters
    ----------
    hides, features, corner
        As for `look_up`.
    unlike : ndarray of shape (h / BLOCK, w / BLOCK), float64
        Made infinite where a place is no more alike than two of a random texture, which differ by twice its variance.
    brightest : ndarray of shape (h / BLOCK, w / BLOCK), float64
        Filled where ``unlike`` is at most `LIKE`.
    """
    sums = np.empty((ALPHA, 2))
    for number in range(begin, end):
        for across in range(unlike.shape[1]):
            if not 0.0 <= unlike[number, across] <= LIKE:
                continue
            top, left = number * BLOCK - corner[0] % BLOCK, across * BLOCK - corner[1] % BLOCK
            brightest[number, across], varied = _look_around(hides, features, top, left, sums)
            if unlike[number, across] > max(RANDOM * varied, EVEN):
                unlike[number, across] = math.inf


@kernel
def halve_cells(begin, end, fine, corner, coarse):
    """Fill ``coarse`` (h / 2, w / 2, n) with means over four cells, ``fine`` (h, w, n), both float32.

    For ``corner`` see `look_up`.
    """
    height, width, n = fine.shape
    above, before = corner[0] % 2, corner[1] % 2
    for row in range(begin, end):
        top, bottom = max(2 * row - above, 0), min(2 * row - above + 2, height)
        for col in range(coarse.shape[1]):
            left, right = max(2 * col - before, 0), min(2 * col - before + 2, width)
            scale = np.float32(1.0) / np.float32((bottom - top) * (right - left))
            coarse[row, col] = np.float32(0.0)
            for i in range(top, bottom):
                for j in range(left, right):
                    for c in range(n):
                        coarse[row, col, c] += scale * fine[i, j, c]
