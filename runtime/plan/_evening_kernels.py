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
                    found[row, col] = weight[y, x] / count[y, x]


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
def weigh_samples(begin, end, step, farther, shift, area, cell, margin, sums, weight):
    """Fill ``weight`` (H, W), float32, with areas over the mean of those around, 1 for what does not count.

    The mean is between the cells of a grid; arguments as for `add_areas`.
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
                total = sums[y + (k & 1), x + (k >> 1 & 1), step[row, col] + (k >> 2)]
                count += share * total[0]
                around += share * total[1]
            weight[row, col] = area[row, col] * count / around
