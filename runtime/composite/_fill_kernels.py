"""Compiled kernels of the composite step: normalise a layer, fill what was not seen of it, and put it behind others."""

import numpy as np

from spreadlets.compiled import helper, kernel
from spreadlets.runtime._lamp_kernels import dimmed, evened
from spreadlets.runtime._vector_kernels import add, load, multiply

COVERAGE, COUNT, REST, LAST = range(4)
"""What a layer's sums are measured by: 1; their own weight plus a count, plus a share of what they leave; their weight
alone."""

NONE = np.float32(0.0), np.float32(0.0), np.float32(0.0), np.float32(0.0)
"""The sums of a pixel outside the canvas."""
_U = np.uint64
LEAST_ALPHA = np.float32(1e-3)
"""Alpha of a layer up to which nothing is seen of it."""

SOLVER_ERROR = np.float32(0.005)
"""Measure, of a pixel's 1, up to which sums may be errors of the Poisson solver and the spreadlets' far fields."""


@helper
def sureness(measure):
    """Return how far sums of this measure are to be believed, from 0 to 1."""
    if measure >= np.float32(2.0) * SOLVER_ERROR:
        return np.float32(1.0)
    return min(max(measure / SOLVER_ERROR - np.float32(1.0), np.float32(0.0)), np.float32(1.0))


@helper
def measured(weight, seen, kind):
    """Return by what the sums of a pixel are divided."""
    own = max(weight, np.float32(0.0))
    if kind == LAST:
        return own
    if kind == COUNT:
        return own + seen
    if kind == REST:
        return own + max(np.float32(1.0) - own, np.float32(0.0)) * seen
    return max(own, np.float32(1.0))


@kernel
def is_unseen(begin, end, padded, top, left, seen, kind, least, shape):
    """Tell whether there are pixels of which less than ``least`` was seen; arguments as for `add_layer`."""
    rows, cols = padded.shape[:2]
    for row in range(begin, end):
        for col in range(shape[1]):
            i, j = row - top, col - left
            weight = padded[i, j, 3] if 0 <= i < rows and 0 <= j < cols else np.float32(0.0)
            share = seen[row, col] if seen.shape[0] else np.float32(1.0)
            if measured(weight, share, kind) < least:
                return True
    return False


@kernel
def sum_light(begin, end, padded, bits, first, light):
    """Sum up the evened light of a layer, and its weight, in rows of blocks; every second row and column tells enough.

    Parameters
    ----------
    padded : ndarray of shape (rows, cols, 4), float32
        Sums of the layer's splats.
    bits : int
        Blocks have sides of 2^bits px.
    first : tuple of two ints
        Row and column, in its block, of the first pixel.
    light : ndarray of shape (2, h, w), float32
        Filled.
    """
    side = 1 << bits
    for block in range(begin, end):
        light[0, block], light[1, block] = np.float32(0.0), np.float32(0.0)
        top = block * side - first[0]
        for i in range(top if top >= 0 else first[0] % 2, min(top + side, padded.shape[0]), 2):
            for j in range(first[1] % 2, padded.shape[1], 2):
                own = padded[i, j, 3]
                if own > SOLVER_ERROR:
                    across = (j + first[1]) >> bits
                    brightest = max(padded[i, j, 0], padded[i, j, 1], padded[i, j, 2], np.float32(0.0))
                    light[0, block, across] += own * np.float32(evened(brightest / own))
                    light[1, block, across] += own


@helper
def _limit(limits, bits, row, col):
    """Interpolate the limits of blocks linearly at a pixel, counted from the first block's."""
    (height, width), side = limits.shape, 1 << bits
    y, x = (row + 0.5) / side - 0.5, (col + 0.5) / side - 0.5
    y, x = min(max(y, 0.0), height - 1.0), min(max(x, 0.0), width - 1.0)
    top, left = int(y), int(x)
    below, beside = min(top + 1, height - 1), min(left + 1, width - 1)
    down, right = np.float32(y - top), np.float32(x - left)
    upper = limits[top, left] + right * (limits[top, beside] - limits[top, left])
    lower = limits[below, left] + right * (limits[below, beside] - limits[below, left])
    return upper + down * (lower - upper)


@helper
def _without_lamps(limits, least, bits, row, col, sums, measure):
    """Return by what the colours of a pixel's sums are multiplied where they stand for others; see `pull_sums`."""
    light = max(sums[0], sums[1], sums[2])
    if light <= measure * least[row >> bits, col >> bits]:
        return np.float32(1.0)
    limit = measure * _limit(limits, bits, row, col)
    return np.float32(dimmed(light, limit) / light)


@helper
def _blend(image, row, col, red, green, blue, alpha, opaque, beyond):
    """Put a premultiplied colour behind a pixel, ``beyond`` more of it than the pixel leaves to be seen in the mean.

    Of what the pixel leaves, no more can be seen past the colour than the colour leaves.
    """
    left = np.float32(1.0) - image[row, col, 3]
    if beyond != np.float32(0.0) and not opaque and alpha > LEAST_ALPHA:
        least = max((left + alpha - np.float32(1.0)) / alpha, np.float32(0.0))
        left = min(max(left + beyond / alpha, least), min(left / alpha, np.float32(1.0)))
    image[row, col, 0] += left * red
    image[row, col, 1] += left * green
    image[row, col, 2] += left * blue
    image[row, col, 3] = np.float32(1.0) if opaque else min(image[row, col, 3] + left * alpha, np.float32(1.0))


@kernel
def add_layer(begin, end, image, beyond, padded, top, left, seen, kind):
    """Divide a layer by its measure and put it behind an image.

    Parameters
    ----------
    image : ndarray of shape (H, W, 4), float32
        Premultiplied colour and alpha of nearer layers; changed in place.
    beyond : ndarray of shape (H, W) or (0, 0), float32
        How much more is seen of the layer than these leave in the mean, see `runtime.composite.overlap`.
    padded : ndarray of shape (rows, cols, 4), float32
        Sums of the layer's splats.
    top, left : int
        Row and column, in the image, of the canvas's first pixel.
    seen : ndarray of shape (H, W) or (0, 0), float32
        Number of samples that passed the layer, or share of what it leaves that lies beyond; empty if all does.
    kind : int
        `COVERAGE`, `COUNT`, `REST` or `LAST`; the last layer is opaque.
    """
    rows, cols = padded.shape[:2]
    one = np.float32(1.0)
    for row in range(begin, end):
        for col in range(image.shape[1]):
            i, j = row - top, col - left
            if not (0 <= i < rows and 0 <= j < cols):
                continue
            weight = padded[i, j, 3]
            scale = one / measured(weight, seen[row, col] if seen.shape[0] else one, kind)
            alpha = max(weight * scale, np.float32(0.0))
            r, g, b = padded[i, j, 0] * scale, padded[i, j, 1] * scale, padded[i, j, 2] * scale
            more = beyond[row, col] if beyond.shape[0] else np.float32(0.0)
            _blend(image, row, col, r, g, b, alpha, kind == LAST, more)


@kernel
def pull_sums(begin, end, padded, top, left, seen, kind, lamps, shape, odd, coarse):
    """Fill ``coarse`` (H / 2, W / 2, 5), float32, with a layer's sums and their measure over 2 x 2 pixels.

    ``lamps`` tells how bright what lies hidden may be: limits (h, w), float32, of blocks of 2^bits px, (0, 0) for none;
    the least of each block and those beside it; bits; and row and column, in its block, of the canvas's first pixel.
    Other arguments are those of `add_layer`; ``shape`` is that of its image, and ``odd`` (2 integers) is 1 where the
    image's first row or column is the second of its pair.
    """
    limits, least, bits, (down, across) = lamps
    rows, cols = padded.shape[:2]
    sums = padded.reshape(padded.size)
    for row in range(begin, end):
        first, last = max(2 * row - odd[0], 0), min(2 * row + 2 - odd[0], shape[0])
        for col in range(coarse.shape[1]):
            # Sum colour, weight and measure over the block, each pixel as far as it is sure.
            total, measure = NONE, np.float32(0.0)
            for y in range(first, last):
                for x in range(max(2 * col - odd[1], 0), min(2 * col + 2 - odd[1], shape[1])):
                    each, i, j = NONE, y - top, x - left
                    if 0 <= i < rows and 0 <= j < cols:
                        each = load(sums, _U(4 * (i * cols + j)))
                    own = measured(each[3], seen[y, x] if seen.shape[0] else np.float32(1.0), kind)
                    sure = sureness(own)
                    total = add(total, multiply((sure, sure, sure, sure), each))
                    measure += sure * own
            # What stands for what lies hidden holds no lamps.
            i, j = 2 * row - odd[0] - top, 2 * col - odd[1] - left
            if limits.shape[0] and 0 <= i < rows and 0 <= j < cols:
                kept = _without_lamps(limits, least, bits, i + down, j + across, total, measure)
                total = multiply((kept, kept, kept, np.float32(1.0)), total)
            for c in range(4):
                coarse[row, col, c] = total[c]
            coarse[row, col, 4] = measure


@kernel
def pull(begin, end, fine, odd, coarse):
    """Fill ``coarse`` with the sums of 2 x 2 pixels of ``fine``, both (H, W, 5), float32; ``odd`` as in `pull_sums`."""
    height, width = fine.shape[:2]
    for row in range(begin, end):
        for col in range(coarse.shape[1]):
            for c in range(5):
                coarse[row, col, c] = np.float32(0.0)
            for y in range(max(2 * row - odd[0], 0), min(2 * row + 2 - odd[0], height)):
                for x in range(max(2 * col - odd[1], 0), min(2 * col + 2 - odd[1], width)):
                    for c in range(5):
                        coarse[row, col, c] += fine[y, x, c]


@helper
def _between(near, far):
    """Return what lies a quarter of the way between two vectors."""
    quarter = np.float32(0.25)
    return (
        near[0] + quarter * (far[0] - near[0]),
        near[1] + quarter * (far[1] - near[1]),
        near[2] + quarter * (far[2] - near[2]),
        near[3] + quarter * (far[3] - near[3]),
    )


@helper
def _interpolate(coarse, shape, row, col):
    """Interpolate a pyramid's coarser level linearly at a pixel of the finer one, counted from a pair.

    The level (H, W, 5) is flat. Return four channels as a vector, and the fifth.
    """
    height, width = shape[:2]
    near_row, near_col = row // 2, col // 2
    next_row = min(max(near_row + (1 if row % 2 else -1), 0), height - 1)
    next_col = min(max(near_col + (1 if col % 2 else -1), 0), width - 1)
    near, near_beside = _U(5 * (near_row * width + near_col)), _U(5 * (near_row * width + next_col))
    far, far_beside = _U(5 * (next_row * width + near_col)), _U(5 * (next_row * width + next_col))
    one = _between(load(coarse, near), load(coarse, near_beside))
    other = _between(load(coarse, far), load(coarse, far_beside))
    quarter, fifth = np.float32(0.25), _U(4)
    upper = coarse[near + fifth] + quarter * (coarse[near_beside + fifth] - coarse[near + fifth])
    lower = coarse[far + fifth] + quarter * (coarse[far_beside + fifth] - coarse[far + fifth])
    return _between(one, other), upper + quarter * (lower - upper)


@kernel
def push(begin, end, fine, coarse, odd, least):
    """Divide ``fine`` by its measure where there is enough of it, and fill the rest from ``coarse``, in place.

    Parameters
    ----------
    fine : ndarray of shape (H, W, 5), float32
        Sums and their measure; becomes what they are divided by it.
    coarse : ndarray of shape (H / 2, W / 2, 5), float32
        The same, already divided; interpolated linearly.
    odd : tuple of two ints
        See `pull_sums`.
    least : float32
        Measure from which a pixel stands for itself; below, the rest to this measure is filled.
    """
    sums = coarse.reshape(coarse.size)
    for row in range(begin, end):
        for col in range(fine.shape[1]):
            measure = fine[row, col, 4]
            if measure >= least:
                for c in range(5):
                    fine[row, col, c] /= measure
                continue
            missing = np.float32(1.0) - measure / least
            around, fifth = _interpolate(sums, coarse.shape, row + odd[0], col + odd[1])
            for c in range(4):
                fine[row, col, c] = fine[row, col, c] / least + missing * around[c]
            fine[row, col, 4] = measure / least + missing * fifth


@kernel
def add_filled(begin, end, image, beyond, padded, top, left, seen, kind, coarse, odd, least, told):
    """Do as `add_layer`, and fill what was not seen from ``coarse``, the finest but one level of a pushed pyramid.

    What lanes have ``told``, (H, W, 5) or (0, 0, 5), float32, see `runtime.composite.lanes`, is taken as it is.
    """
    rows, cols = padded.shape[:2]
    sums, around = padded.reshape(padded.size), coarse.reshape(coarse.size)
    zero, one = np.float32(0.0), np.float32(1.0)
    for row in range(begin, end):
        for col in range(image.shape[1]):
            if image[row, col, 3] >= one:
                continue
            more = beyond[row, col] if beyond.shape[0] else zero
            if told.shape[0] and told[row, col, 4] > zero:
                red, green, blue, alpha = told[row, col, 0], told[row, col, 1], told[row, col, 2], told[row, col, 3]
                _blend(image, row, col, red, green, blue, min(max(alpha, zero), one), kind == LAST, more)
                continue
            # Normalise the layer's sum by how much of it was seen.
            each, i, j = NONE, row - top, col - left
            if 0 <= i < rows and 0 <= j < cols:
                each = load(sums, _U(4 * (i * cols + j)))
            measure = measured(each[3], seen[row, col] if seen.shape[0] else one, kind)
            sure = sureness(measure)
            measure *= sure
            scale = sure / max(measure, least)
            each = multiply((scale, scale, scale, scale), each)
            # Fill the share that is missing from the pyramid.
            if measure < least:
                missing = one - measure / least
                colour, _ = _interpolate(around, coarse.shape, row + odd[0], col + odd[1])
                each = add(each, multiply((missing, missing, missing, missing), colour))
            # Put the layer behind the image.
            _blend(image, row, col, each[0], each[1], each[2], min(max(each[3], zero), one), kind == LAST, more)
