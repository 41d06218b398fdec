"""Compiled kernels that count the samples around each, and weigh them."""

import numpy as np

from spreadlets.compiled import helper, kernel


@helper
def _bin(place, shift, bins, margin):
    """Return the bin of a place along an axis: row or column of the pixel, moved by some px."""
    return int(np.floor((place + 0.5 + np.float64(shift)) * bins)) + margin * bins


@kernel
def count_samples(layer, number, shift, bins, margin, count):
    """Add to ``count`` (rows, cols), float32, the samples of a layer in each bin.

    Parameters
    ----------
    layer : ndarray of shape (H, W), int32
        Negative where there is no sample.
    number : int
        The layer.
    shift : ndarray of shape (H, W, 2), float32
        From each pixel to where its sample is drawn, (dx, dy), px.
    bins : int
        In a pixel, along each axis.
    margin : int
        Pixels around the frame that have bins, too.
    """
    for row in range(layer.shape[0]):
        for col in range(layer.shape[1]):
            if layer[row, col] == number:
                y = _bin(row, shift[row, col, 1], bins, margin)
                x = _bin(col, shift[row, col, 0], bins, margin)
                if 0 <= y < count.shape[0] and 0 <= x < count.shape[1]:
                    count[y, x] += np.float32(1.0)


@kernel
def sum_blurs(begin, end, layer, number, coc, path, side, sums):
    """Sum up, in rows of tiles, how the samples of a layer blur.

    Parameters
    ----------
    layer, number
        See `count_samples`.
    coc, path : ndarrays of shapes (H, W) and (H, W, 2), float32
        CoC radius of each, and how far it moves while the shutter is open, (dx, dy), px.
    side : int
        Of a tile, px.
    sums : ndarray of shape (4, h, w), float32
        Of samples, of their CoC radii, and of their paths; changed.
    """
    for tile in range(begin, end):
        for row in range(tile * side, min((tile + 1) * side, layer.shape[0])):
            for col in range(layer.shape[1]):
                if layer[row, col] == number:
                    j = col // side
                    sums[0, tile, j] += np.float32(1.0)
                    sums[1, tile, j] += coc[row, col]
                    sums[2, tile, j] += path[row, col, 0]
                    sums[3, tile, j] += path[row, col, 1]


@kernel
def move_passing(begin, end, layer, number, seen, blurs, side, shift, passing):
    """Find where samples passed a layer: as far from where they were seen as the layer blurs there.

    Parameters
    ----------
    layer, number
        See `count_samples`; what lies behind the layer has passed it.
    seen : tuple of ndarrays of shapes (H, W, 2), (H, W, 2) and (H, W), float32
        Where in its pixel each was seen, (dx, dy), px; its place on the lens; and its time from the middle of the
        shutter's, in its length.
    blurs : ndarray of shape (4, h, w), float32
        See `sum_blurs`: means around each tile. Where there are no samples, nothing passed that is of interest.
    side : int
        Of a tile, px.
    shift : ndarray of shape (H, W, 2), float32
        Filled with (dx, dy), px, where one passed.
    passing : ndarray of shape (H, W), int32
        Filled with ``number``, and -1 where none passed.
    """
    offset, lens_uv, time = seen
    for row in range(begin, end):
        for col in range(layer.shape[1]):
            i, j = row // side, col // side
            passing[row, col] = -1
            if layer[row, col] <= number or blurs[0, i, j] == np.float32(0.0):
                continue
            passing[row, col] = number
            for c in range(2):
                moved = blurs[1, i, j] * lens_uv[row, col, c] + blurs[2 + c, i, j] * time[row, col]
                shift[row, col, c] = offset[row, col, c] - moved


@kernel
def even_out(begin, end, weight, usual, bins, evened):
    """Fill ``evened`` (rows, cols), float32, with the weight of the samples of each bin, more where little lies around.

    It is divided by what lies under a tent of two bins, in place of what is ``usual`` in each pixel; the outermost bins
    become 0.
    """
    two, four, whole = np.float32(2.0), np.float32(4.0), np.float32(16.0)
    height, width = weight.shape
    for row in range(begin, end):
        evened[row] = np.float32(0.0)
        if row == 0 or row == height - 1:
            continue
        above, own, below, result = weight[row - 1], weight[row], weight[row + 1], evened[row]
        for col in range(1, width - 1):
            if own[col] == np.float32(0.0):
                continue
            corners = above[col - 1] + above[col + 1] + below[col - 1] + below[col + 1]
            beside = above[col] + below[col] + own[col - 1] + own[col + 1]
            around = corners + two * beside + four * own[col]
            result[col] = own[col] * whole * usual[row // bins, col // bins] / around


@kernel
def find_areas(begin, end, layer, number, shift, bins, margin, count, weight, found):
    """Fill ``found`` (H, W), float32, of the samples of a layer with their areas: parts of the ``weight`` of a bin.

    Those that have no bin are left out; other arguments as for `count_samples`.
    """
    for row in range(begin, end):
        for col in range(layer.shape[1]):
            if layer[row, col] == number:
                y = _bin(row, shift[row, col, 1], bins, margin)
                x = _bin(col, shift[row, col, 0], bins, margin)
                if 0 <= y < count.shape[0] and 0 <= x < count.shape[1]:
                    found[row, col] = weight[y, x] / (count[y, x] * np.float32(bins * bins))


@helper
def _between_cells(place, shift, cell, margin, size):
    """Return the cell before a place along an axis, one of a grid's but the last, and the share of the next."""
    at = min(max((place + 0.5 + np.float64(shift) + margin) / cell - 0.5, 0.0), size - 1.0)
    first = min(int(at), size - 2)
    return first, np.float32(at - first)


@kernel
def add_areas(step, farther, shift, area, cell, margin, sums):
    """Add samples and their areas to a grid over the frame and its depths, each shared between the cells around.

    Parameters
    ----------
    step : ndarray of shape (H, W), int32
        Of depth, and so the cell.
    farther : ndarray of shape (H, W), float32
        Share of the sample that belongs to the next one.
    shift : ndarray of shape (H, W, 2), float32
        From each pixel to where its sample is drawn, (dx, dy), px.
    area : ndarray of shape (H, W), float32
        0 for what does not count.
    cell : int
        Side, px.
    margin : int
        Pixels around the frame that have cells, too.
    sums : ndarray of shape (rows, cols, n_steps + 1, 2), float32
        Samples and areas; added to.
    """
    for row in range(area.shape[0]):
        for col in range(area.shape[1]):
            if area[row, col] == 0.0:
                continue
            y, down = _between_cells(row, shift[row, col, 1], cell, margin, sums.shape[0])
            x, right = _between_cells(col, shift[row, col, 0], cell, margin, sums.shape[1])
            for k in range(8):
                share = (down if k & 1 else np.float32(1.0) - down) * (right if k & 2 else np.float32(1.0) - right)
                share *= farther[row, col] if k & 4 else np.float32(1.0) - farther[row, col]
                total = sums[y + (k & 1), x + (k >> 1 & 1), step[row, col] + (k >> 2)]
                total[0] += share
                total[1] += share * area[row, col]


@kernel
def weigh_samples(begin, end, step, farther, shift, area, cell, margin, sums, layer, passed, weight):
    """Fill ``weight`` (H, W), float32, with areas over the mean of those around, 1 for what does not count.

    The mean is between the cells of a grid; arguments as for `add_areas`, and:

    Parameters
    ----------
    layer : ndarray of shape (H, W), int32
        Of each sample.
    passed : ndarray of shape (rows, cols, n_layers + 1, 2), float32
        As ``sums``, of the samples that passed each layer: they count, too.
    """
    for row in range(begin, end):
        for col in range(area.shape[1]):
            weight[row, col] = 1.0
            if area[row, col] == 0.0:
                continue
            y, down = _between_cells(row, shift[row, col, 1], cell, margin, sums.shape[0])
            x, right = _between_cells(col, shift[row, col, 0], cell, margin, sums.shape[1])
            count, around = np.float32(0.0), np.float32(0.0)
            for k in range(8):
                share = (down if k & 1 else np.float32(1.0) - down) * (right if k & 2 else np.float32(1.0) - right)
                share *= farther[row, col] if k & 4 else np.float32(1.0) - farther[row, col]
                i, j = y + (k & 1), x + (k >> 1 & 1)
                total, other = sums[i, j, step[row, col] + (k >> 2)], passed[i, j, layer[row, col]]
                count += share * (total[0] + other[0])
                around += share * (total[1] + other[1])
            weight[row, col] = area[row, col] * count / around
