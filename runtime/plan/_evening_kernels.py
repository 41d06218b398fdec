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
def share_area(begin, end, count, usual, bins, area):
    """Fill ``area`` (rows, cols), float32, with the area that each sample of a bin stands for; 0 where there is none.

    It is the inverse of their number, under a tent of two bins, times the number that is ``usual`` in each pixel.
    """
    for row in range(begin, end):
        for col in range(count.shape[1]):
            area[row, col] = 0.0
            if count[row, col] == 0.0:
                continue
            around = np.float32(0.0)
            for down in range(-1, 2):
                for across in range(-1, 2):
                    y, x = row + down, col + across
                    if 0 <= y < count.shape[0] and 0 <= x < count.shape[1]:
                        around += count[y, x] * np.float32((2 - abs(down)) * (2 - abs(across)) / 16.0)
            area[row, col] = usual[row // bins, col // bins] / around


@kernel
def weigh_samples(begin, end, layer, number, shift, bins, margin, area, sums, weight):
    """Fill ``weight`` (H, W), float32, of the samples of a layer with their areas over the mean of those around.

    See `count_samples`; ``area`` is of `share_area`, ``sums`` (2, rows, cols) are the samples and their areas around
    each pixel.
    """
    for row in range(begin, end):
        for col in range(layer.shape[1]):
            if layer[row, col] == number:
                y = _bin(row, shift[row, col, 1], bins, margin)
                x = _bin(col, shift[row, col, 0], bins, margin)
                if 0 <= y < area.shape[0] and 0 <= x < area.shape[1]:
                    i, j = y // bins, x // bins
                    weight[row, col] = area[y, x] * sums[0, i, j] / sums[1, i, j]
