"""Compiled kernels of visibility: the means of each layer, and how much of a layer was seen."""

import math

import numpy as np

from spreadlets.compiled import helper, kernel
from spreadlets.runtime.plan._layer_kernels import share_in

MOMENTS = ("weight", "coc", "coc squared", "length squared", "motion x", "motion y")
"""Columns of `layer_moments`, all sums; the largest blur, px, comes behind them."""

LEAST_UNCOVERED = np.float32(0.05)
"""Share of a pixel that a layer leaves uncovered, and not just because its share is not known better."""
SLIVER = np.float32(0.05)
"""Where a blur meets less than that of what a layer leaves, this does not tell what the rest is."""
MIXED = np.float32(1e-3)
"""The same of a pixel that shows some of what lies beyond itself."""
STEP_PX, MOST_STEPS = 3.0, 64.0
"""Between the places along a path that are looked at, px; and how many of them there are at most to either side."""
ROWS_LOOKED_AT = 8
"""About so many rows, to either side of a pixel, tell whether something uncovered lies as near as the pixel blurs."""


@helper
def _add_moments(total, weight, coc, path, motion):
    """Add a pixel to the sums of its layer."""
    total[0] += weight
    total[1] += weight * coc
    total[2] += weight * coc * coc
    length_squared = np.float64(path[0]) ** 2 + np.float64(path[1]) ** 2
    total[3] += weight * length_squared
    total[4] += weight * motion[0]
    total[5] += weight * motion[1]
    total[6] = max(total[6], abs(coc) + 0.5 * math.sqrt(length_squared))


@kernel
def layer_moments(begin, end, variant, layer, farther, weight, coc, path, motion, total):
    """Add to ``total`` (H, n_layers, 7), float64, what `MOMENTS` names of the pixels of each layer in each row.

    ``weight`` is (H, W), or (0, 0) if all are 1; ``path`` and ``motion`` are (H, W, 2).
    """
    for row in range(begin, end):
        for col in range(variant.shape[1]):
            if variant[row, col] < 0:
                continue
            for part in range(2):
                share = np.float64(farther[row, col]) if part else 1.0 - np.float64(farther[row, col])
                if weight.shape[0]:
                    share *= np.float64(weight[row, col])
                if share > 0.0:
                    each = total[row, layer[row, col] + part]
                    _add_moments(each, share, np.float64(coc[row, col]), path[row, col], motion[row, col])


@helper
def _share_before(place, number):
    """Return the share of a pixel that belongs to layers before a number, of what `cover_planes` has for a place."""
    return min(max(np.float32(number) - place, np.float32(0.0)), np.float32(1.0))


@kernel
def cover_planes(begin, end, variant, layer, farther, radiance, weight, cover, place):
    """Find what pixels cover, and in which layers.

    Parameters
    ----------
    variant, layer, farther : ndarray of shape (H, W)
        See `runtime.plan.layering.Membership`.
    radiance : ndarray of shape (H, W, 4), float32
        Its alpha, times ``weight`` (H, W), or (0, 0) for 1, is what a pixel covers.
    cover : ndarray of shape (H, W), float32
        Filled; 0 where nothing is drawn.
    place : ndarray of shape (H, W), float32
        Filled with the number of the layer and the share of the next one.
    """
    for row in range(begin, end):
        for col in range(variant.shape[1]):
            share = radiance[row, col, 3] * (weight[row, col] if weight.shape[0] else np.float32(1.0))
            cover[row, col] = share if variant[row, col] >= 0 else np.float32(0.0)
            place[row, col] = np.float32(layer[row, col]) + farther[row, col]


@kernel
def add_listed_cover(cover, place, at, number, nearer, beyond):
    """Add what the pixels of a list cover before a layer, and take off what they cover up to and with it.

    Parameters
    ----------
    cover, place : ndarray of shape (h, w), float32
        See `cover_planes`.
    at : ndarray of shape (h, w, 2), int32
        Their rows and columns in the frame.
    number : int
        The layer.
    nearer, beyond : ndarray of shape (H, W), float32
        Changed in place.
    """
    for i in range(cover.shape[0]):
        for j in range(cover.shape[1]):
            # Farther layers take part in neither.
            if place[i, j] >= number + 1:
                continue
            row, col = at[i, j, 0], at[i, j, 1]
            nearer[row, col] += cover[i, j] * _share_before(place[i, j], number)
            beyond[row, col] -= cover[i, j] * _share_before(place[i, j], number + 1)


@kernel
def take_hidden(cover, place, at, number, beyond):
    """Take off ``beyond`` what a list of hidden pixels would cover in a layer; arguments as for `add_listed_cover`."""
    for i in range(cover.shape[0]):
        for j in range(cover.shape[1]):
            own = _share_before(place[i, j], number + 1) - _share_before(place[i, j], number)
            if own > np.float32(0.0):
                beyond[at[i, j, 0], at[i, j, 1]] -= cover[i, j] * own


@kernel
def complete_cover(begin, end, cover, place, known, number, nearer, beyond):
    """Add what the pixels of a frame cover to what lists do, and make shares of both, within 0 and 1, in place.

    Parameters
    ----------
    known : ndarray of shape (H, W), uint64
        Bits of the layers in which each pixel is known: what nearer ones hide of it there counts to what lies beyond.
    cover, place, number, nearer, beyond
        See `add_listed_cover`; of all pixels of the frame.
    """
    zero, one, shift = np.float32(0.0), np.float32(1.0), np.uint64(number)
    for row in range(begin, end):
        covers, places, bits, hidden, left = cover[row], place[row], known[row], nearer[row], beyond[row]
        for col in range(len(covers)):
            before = hidden[col] + covers[col] * _share_before(places[col], number)
            rest = one + left[col] - covers[col] * _share_before(places[col], number + 1)
            counted = np.float32((bits[col] >> shift) & np.uint64(1))
            hidden[col] = min(max((one - counted) * before, zero), one)
            left[col] = min(max(rest + counted * before, zero), one)


@kernel
def divide_shares(begin, end, nearer, beyond, around, least):
    """Divide ``beyond`` by the sum of both, in place; where that is little, by far, what lies ``around`` tells.

    Parameters
    ----------
    nearer, beyond : ndarray of shape (H, W), float32
    around : tuple of two ndarrays of shape (H, W), float32
        The same of all that the farthest pixels of the layer blur over: counts for what the sum is less than `SLIVER`.
    least : float32
        Sum below which there is neither.
    """
    for row in range(begin, end):
        for col in range(beyond.shape[1]):
            hidden, left = nearer[row, col], beyond[row, col]
            share = max(SLIVER - hidden - left, np.float32(0.0))
            hidden += share * around[0][row, col]
            left += share * around[1][row, col]
            beyond[row, col] = left / max(hidden + left, least)


@kernel
def uncovered_distances(begin, end, nearer, beyond, distance):
    """Fill ``distance`` (H, W), int32, with the pixels from each one along its row to one that a layer does not cover.

    Parameters
    ----------
    nearer, beyond : ndarray of shape (H, W), float32
        What is not the layer's of each pixel.
    distance : ndarray of shape (H, W), int32
        Filled.
    """
    width = distance.shape[1]
    for row in range(begin, end):
        for ahead in range(2):
            last = width
            for n in range(width):
                col = width - 1 - n if ahead else n
                last = 0 if nearer[row, col] + beyond[row, col] > LEAST_UNCOVERED else last + 1
                distance[row, col] = min(distance[row, col], last) if ahead else last


@helper
def _reaches_uncovered(distance, row, col, reach):
    """Return whether a pixel that a layer does not cover lies within a square around a pixel."""
    height = len(distance)
    for step in range(0, reach + 1, 1 + reach // ROWS_LOOKED_AT):
        if distance[max(row - step, 0), col] <= reach or distance[min(row + step, height - 1), col] <= reach:
            return True
    return False


@kernel
def hide_unreached(begin, end, nearer, beyond, distance, place, blur, number, seen):
    """Let nothing be seen beyond a layer at its pixels whose blur does not reach what it leaves uncovered.

    If their splats fall short of 1 there, neighbours blur less than they do.

    Parameters
    ----------
    nearer, beyond : ndarray of shape (H, W), float32
        What is not the layer's of each pixel.
    distance : ndarray of shape (H, W), int32
        See `uncovered_distances`.
    place, blur : ndarray of shape (H, W), float32
        Of the pixels of a frame: see `cover_planes`; and how far they blur, px.
    number : int
        The layer.
    seen : ndarray of shape (H, W), float32
        Changed to 0 there.
    """
    for row in range(begin, end):
        for col in range(seen.shape[1]):
            own = _share_before(place[row, col], number + 1) - _share_before(place[row, col], number)
            if own == np.float32(0.0) or nearer[row, col] + beyond[row, col] > MIXED:
                continue
            if not _reaches_uncovered(distance, row, col, int(math.ceil(blur[row, col])) + 1):
                seen[row, col] = np.float32(0.0)


@kernel
def scatter_passing(members, number, sample, moments, ways, bits, padding, passing):
    """Add what passed a layer of samples, each where it passed through it, split bilinearly.

    Those that lie behind the layer have passed it, and of those in it what it leaves of them.

    Parameters
    ----------
    members : tuple of ndarrays of shape (H, W)
        Variant, layer and share of the next one, as for `layer_labels`.
    number : int
        The layer.
    sample : tuple of ndarrays of shapes (H, W, 2), (H, W, 2), (H, W), (H, W) and (H, W), float32
        Where in its pixel each sample was seen, (dx, dy); its place on the lens, and in time from the shutter's centre;
        its alpha; and its weight.
    moments : tuple of three floats
        CoC radius of the layer, px, and its motion (dx, dy).
    ways : ndarray of shape (h, w, 4), float32
        Motion of the layer where each tile of 2^bits px saw it, and its change, (dx, dy) each, which are followed in
        place of the layer's; (0, 0, 4) if there are none.
    bits : int
    padding : int
        The nearest samples repeat so far beyond the border.
    passing : ndarray of shape (H + 2 padding, W + 2 padding), float32
        Accumulated in place; what lies outside is dropped.
    """
    variant, layer, farther = members
    offset, lens_uv, time, alpha, weights = sample
    coc, motion_x, motion_y = moments
    height, width = passing.shape
    for padded_row in range(height):
        row = min(max(padded_row - padding, 0), variant.shape[0] - 1)
        for padded_col in range(width):
            col = min(max(padded_col - padding, 0), variant.shape[1] - 1)
            # Find the share of the sample that passed the layer.
            place = np.float32(layer[row, col]) + farther[row, col]
            met = _share_before(place, number + 1) - _share_before(place, number)
            weight = np.float32(1.0) - _share_before(place, number + 1) + met * (np.float32(1.0) - alpha[row, col])
            if weight == 0 or (variant[row, col] < 0 and layer[row, col] <= number):
                continue
            weight *= weights[row, col]
            # Shear the sample to where its ray passed through the layer.
            x = padded_col + offset[row, col, 0] - coc * lens_uv[row, col, 0]
            y = padded_row + offset[row, col, 1] - coc * lens_uv[row, col, 1]
            if ways.shape[0]:
                way, half = ways[row >> bits, col >> bits], np.float32(0.5) * time[row, col]
                x -= time[row, col] * (way[0] - half * way[2])
                y -= time[row, col] * (way[1] - half * way[3])
            else:
                x -= motion_x * time[row, col]
                y -= motion_y * time[row, col]
            left, top = math.floor(x), math.floor(y)
            if left < -1 or top < -1 or left >= width or top >= height:
                continue
            # Split it bilinearly.
            right_share, below_share = np.float32(x - left), np.float32(y - top)
            for down in range(2):
                for right in range(2):
                    i, j = int(top) + down, int(left) + right
                    if 0 <= i < height and 0 <= j < width:
                        across = right_share if right else np.float32(1.0) - right_share
                        along = below_share if down else np.float32(1.0) - below_share
                        passing[i, j] += weight * across * along


@kernel
def sum_paths(begin, end, members, path, number, side, sums):
    """Sum up, in rows of tiles, how the samples of a layer move.

    Parameters
    ----------
    members : tuple of ndarrays of shape (H, W)
        Variant, layer and share of the next one, as for `layer_labels`.
    path : ndarray of shape (H, W, 2), float32
        How far each moves while the shutter is open, px (dx, dy).
    number : int
        The layer.
    side : int
        Of a tile, px.
    sums : ndarray of shape (4, h, w), float32
        Of shares, of shares times dx, dy and squared lengths; changed.
    """
    variant, layer, farther = members
    for tile in range(begin, end):
        for row in range(tile * side, min((tile + 1) * side, variant.shape[0])):
            for col in range(variant.shape[1]):
                share = share_in(layer[row, col], farther[row, col], number)
                if variant[row, col] >= 0 and share > np.float32(0.0):
                    j, x, y = col // side, path[row, col, 0], path[row, col, 1]
                    sums[0, tile, j] += share
                    sums[1, tile, j] += share * x
                    sums[2, tile, j] += share * y
                    sums[3, tile, j] += share * (x * x + y * y)


@helper
def _sum_along(passing, path, side, row, col, way, steps):
    """Return the sum of what passed at some steps along one half of a path that follows those around; the last half."""
    height, width = passing.shape
    scale = np.float32(0.5 * way / steps)
    y, x, total = np.float32(row + 0.5), np.float32(col + 0.5), np.float32(0.0)
    i, j = row // side, col // side
    for step in range(1, steps + 1):
        x += scale * path[i, j, 0]
        y += scale * path[i, j, 1]
        top, left = min(max(int(y), 0), height - 1), min(max(int(x), 0), width - 1)
        total += passing[top, left] * np.float32(0.5 if step == steps else 1.0)
        i, j = top // side, left // side
    return total


@kernel
def blur_along(begin, end, passing, path, side, blurred):
    """Blur what passed a layer along the layer's own paths.

    Parameters
    ----------
    passing : ndarray of shape (H, W), float32
        Beyond its border the nearest pixels repeat.
    path : ndarray of shape (h, w, 3), float32
        Mean path of the layer around each tile of ``side`` px, (dx, dy), and whether there is any of it.
    blurred : ndarray of shape (H, W), float32
        Filled.
    """
    for row in range(begin, end):
        i = row // side
        for col in range(blurred.shape[1]):
            j = col // side
            own = passing[row, col]
            half = 0.5 * math.hypot(path[i, j, 0], path[i, j, 1])
            steps = int(math.ceil(min(half / STEP_PX, MOST_STEPS)))
            if path[i, j, 2] == np.float32(0.0) or steps == 0:
                blurred[row, col] = own
                continue
            total = own + _sum_along(passing, path, side, row, col, 1.0, steps)
            total += _sum_along(passing, path, side, row, col, -1.0, steps)
            blurred[row, col] = total / np.float32(2 * steps)
