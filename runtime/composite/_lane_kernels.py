"""Compiled kernels of lanes: the strips, a pixel wide, along which a layer moves through its pixels."""

import math

import numpy as np

from spreadlets.compiled import helper, kernel
from spreadlets.runtime._vector_kernels import add, load, multiply
from spreadlets.runtime.composite._fill_kernels import measured, sureness
from spreadlets.runtime.plan._layer_kernels import share_in

COUNT, SQUARE, EVERY = 0, 4, 5
"""Columns of samples: shares of a layer; behind its colours, the sum of their squares; shares of all that met it, or
passed it."""
_U = np.uint64
LEAST_MEASURE, LEAST_COVER = np.float32(0.5), np.float32(0.1)
"""What must be known of a pixel, and seen of the layer there, for a lane to tell it; samples."""
TINY = np.float32(1e-6)


@kernel
def sum_samples(begin, end, members, sample, number, reach, side, planes, sums):
    """Add one sample of each pixel, in rows of tiles, to what a layer's lanes are made of.

    Parameters
    ----------
    members : tuple of ndarrays of shape (H, W)
        Variant, layer and share of the next one.
    sample : tuple of ndarrays of shapes (H, W, 4), (H, W) and (H, W, 2), float32
        Radiance; CoC radius, px; and how far it moves while the shutter is open, px (dx, dy).
    number : int
        The layer.
    reach : float
        CoC radius, px, up to which a sample is sharp.
    side : int
        Of a tile, px.
    planes : ndarray of shape (H, W, 6), float32
        Of each pixel: share of the layer, that times each colour and times their squares, and share of the layer and of
        what lies behind it; added to.
    sums : ndarray of shape (4, h, w), float32
        Of each tile: shares of the layer; those of sharp samples, and times dx and dy; added to.
    """
    variant, layer, farther = members
    radiance, coc, path = sample
    for tile in range(begin, end):
        for row in range(tile * side, min((tile + 1) * side, variant.shape[0])):
            for col in range(variant.shape[1]):
                # Share the sample between the layer and what lies behind it.
                place = np.float32(layer[row, col]) + farther[row, col] - np.float32(number)
                each, drawn = planes[row, col], variant[row, col] >= 0
                share = share_in(layer[row, col], farther[row, col], number) if drawn else np.float32(0.0)
                each[EVERY] += share + min(max(place, np.float32(0.0)), np.float32(1.0))
                if share == np.float32(0.0):
                    continue
                each[COUNT] += share
                for c in range(3):
                    each[1 + c] += share * radiance[row, col, c]
                    each[SQUARE] += share * radiance[row, col, c] ** 2
                # Of paths, those of sharp samples count.
                total = sums[:, tile, col // side]
                total[0] += share
                if abs(coc[row, col]) <= reach:
                    total[1] += share
                    total[2] += share * path[row, col, 0]
                    total[3] += share * path[row, col, 1]


@kernel
def spread_paths(begin, end, sums, side, least, path):
    """Fill ``path`` (H, W, 2), float32, with the mean paths of sharp samples between tiles, px.

    It is 0 where most samples are not sharp, or the path is no longer than ``least``. ``sums`` are those of
    `sum_samples`, blurred.
    """
    _, height, width = sums.shape
    zero, one, half = np.float32(0.0), np.float32(1.0), np.float32(0.5)
    for row in range(begin, end):
        y = min(max((row + 0.5) / side - 0.5, 0.0), height - 1.0)
        top = int(y)
        below, down = min(top + 1, height - 1), np.float32(y - top)
        for col in range(path.shape[1]):
            # Interpolate between the four tiles around.
            x = min(max((col + 0.5) / side - 0.5, 0.0), width - 1.0)
            left = int(x)
            beside, right = min(left + 1, width - 1), np.float32(x - left)
            every, sharp, dx, dy = zero, zero, zero, zero
            for k in range(4):
                i, j = below if k & 1 else top, beside if k & 2 else left
                part = (down if k & 1 else one - down) * (right if k & 2 else one - right)
                every += part * sums[0, i, j]
                sharp += part * sums[1, i, j]
                dx += part * sums[2, i, j]
                dy += part * sums[3, i, j]
            known = sharp > max(half * every, TINY) and math.hypot(dx, dy) > np.float32(least) * sharp
            path[row, col, 0] = dx / sharp if known else zero
            path[row, col, 1] = dy / sharp if known else zero


@helper
def _add_splats(padded, top, left, seen, kind, place, is_level, taper, sums):
    """Add what was seen of a layer at a place (y, x) of a lane, between the two pixels across, and its measure."""
    y, x = place
    half, one = np.float32(0.5), np.float32(1.0)
    rows, cols = padded.shape[:2]
    height, width = seen.shape if seen.shape[0] else (rows + top, cols + left)
    flat, total = padded.reshape(padded.size), (sums[0], sums[1], sums[2], sums[3])
    # Of the two pixels that the lane runs between there, each counts as far as it is near.
    between = y if is_level else x
    before = int(math.floor(between))
    part = between - np.float32(before)
    for k in range(2):
        row = before + k if is_level else int(math.floor(y + half))
        col = int(math.floor(x + half)) if is_level else before + k
        weight, i, j = taper * (part if k else one - part), row - top, col - left
        inside = 0 <= row < height and 0 <= col < width and 0 <= i < rows and 0 <= j < cols
        if inside and weight > np.float32(0.0):
            each = load(flat, _U(4 * (i * cols + j)))
            own = measured(each[3], seen[row, col] if seen.shape[0] else one, kind)
            weight *= sureness(own)
            total = add(total, multiply((weight, weight, weight, weight), each))
            sums[4] += weight * own
    for c in range(4):
        sums[c] = total[c]


@kernel
def sum_along(begin, end, padded, top, left, seen, kind, planes, path, reach, along, lane):
    """Sum up what was seen of a layer along its paths: splats right around a pixel, samples over the whole of a path.

    Parameters
    ----------
    padded, top, left, seen, kind
        The layer's sums, see `runtime.composite._fill_kernels.add_layer`.
    planes : ndarray of shape (H, W, 6), float32
        See `sum_samples`.
    path : ndarray of shape (H, W, 2), float32
        See `spread_paths`.
    reach : tuple of two floats
        Half length of the tent under which splats are summed, in paths, and px at most.
    along : ndarray of shape (H, W, 5), float32
        Filled with the splats' sums and their measure; 0 where the path is.
    lane : ndarray of shape (H, W, 6), float32
        Filled with the sums of the samples there.
    """
    height, width = path.shape[:2]
    zero, one, half = np.float32(0.0), np.float32(1.0), np.float32(0.5)
    for row in range(begin, end):
        for col in range(width):
            along[row, col], lane[row, col] = zero, zero
            first_x, first_y = path[row, col, 0], path[row, col, 1]
            whole = math.sqrt(first_x * first_x + first_y * first_y)
            near = max(min(np.float32(reach[0]) * whole, np.float32(reach[1])), one)
            for side in range(2):
                # Follow the path to this side, by a row or a column each time.
                turn = one if side == 0 else -one
                y, x, gone, to_x, to_y = np.float32(row), np.float32(col), zero, turn * first_x, turn * first_y
                while gone < half * whole:
                    i, j, longest = int(math.floor(y + half)), int(math.floor(x + half)), max(abs(to_x), abs(to_y))
                    if longest == zero or i < 0 or j < 0 or i >= height or j >= width:
                        break
                    # Beyond the splats, every second pixel tells enough.
                    stride = (one if gone < near else np.float32(2.0)) / longest
                    step = stride * math.sqrt(to_x * to_x + to_y * to_y)
                    if gone > zero or side == 0:
                        for c in range(6):
                            lane[row, col, c] += step * planes[i, j, c]
                        if gone < near:
                            taper, level = step * (one - gone / near), abs(to_x) >= abs(to_y)
                            _add_splats(padded, top, left, seen, kind, (y, x), level, taper, along[row, col])
                    y, x, gone = y + stride * to_y, x + stride * to_x, gone + step
                    i, j = int(math.floor(y + half)), int(math.floor(x + half))
                    if 0 <= i < height and 0 <= j < width:
                        to_x, to_y = turn * path[i, j, 0], turn * path[i, j, 1]


@helper
def _parts(sums, c):
    """Return a colour of sums and their measure, or for channel 3 how much the layer covers."""
    below = sums[3] if c < 3 else sums[4]
    return sums[c] / max(below, TINY)


@helper
def _tells(sums):
    """Return whether enough was seen of a layer."""
    return sums[4] > LEAST_MEASURE and sums[3] > LEAST_COVER


@kernel
def compare(begin, end, along, around, lane, found):
    """Find by how much lanes differ from what lies around, and by how much they would by chance.

    Parameters
    ----------
    along, around : ndarray of shape (H, W, 5), float32
        Sums of splats along a lane, see `sum_along`, and the same blurred to all sides.
    lane : ndarray of shape (H, W, 6), float32
    found : ndarray of shape (4, H, W), float32
        Filled with the squared difference of the colours, the variance of their mean over the lane's samples, and both
        of the cover; weighed with what was seen of the layer.
    """
    for row in range(begin, end):
        for col in range(along.shape[1]):
            for k in range(4):
                found[k, row, col] = np.float32(0.0)
            own, other, samples = along[row, col], around[row, col], lane[row, col]
            if not _tells(own):
                continue
            # The variance of a mean of colours that differ so, and of one of zeros and ones.
            count, variance = max(samples[COUNT], TINY), samples[SQUARE]
            for c in range(3):
                found[0, row, col] += own[3] * (_parts(own, c) - _parts(other, c)) ** 2
                variance -= samples[1 + c] ** 2 / count
            found[1, row, col] = own[3] * max(variance, np.float32(0.0)) / (count * count)
            cover = _parts(other, 3)
            found[2, row, col] = own[3] * (_parts(own, 3) - cover) ** 2
            spread = max(cover * (np.float32(1.0) - cover), np.float32(0.0))
            found[3, row, col] = own[3] * spread / max(samples[EVERY], TINY)


@helper
def _believed(square, variance):
    """Return how far a difference is believed whose square is so in the mean around, and by chance."""
    return max(np.float32(1.0) - variance / max(square, np.float32(1e-12)), np.float32(0.0))


@kernel
def believe(begin, end, along, around, found, chance):
    """Put what is believed of a layer, premultiplied, in place of the sums ``along``, with 1 where it is known, else 0.

    Parameters
    ----------
    along, around, found
        See `compare`; ``found`` blurred.
    chance : float
        Variance of sums of splats, in that of as many samples.
    """
    for row in range(begin, end):
        for col in range(along.shape[1]):
            own, other = along[row, col], around[row, col]
            if not _tells(own):
                own[4] = np.float32(0.0)
                continue
            colour = _believed(found[0, row, col], np.float32(chance) * found[1, row, col])
            cover = _believed(found[2, row, col], np.float32(chance) * found[3, row, col])
            alpha = _parts(other, 3) + cover * (_parts(own, 3) - _parts(other, 3))
            red = _parts(other, 0) + colour * (_parts(own, 0) - _parts(other, 0))
            green = _parts(other, 1) + colour * (_parts(own, 1) - _parts(other, 1))
            blue = _parts(other, 2) + colour * (_parts(own, 2) - _parts(other, 2))
            own[0], own[1], own[2], own[3], own[4] = alpha * red, alpha * green, alpha * blue, alpha, np.float32(1.0)
