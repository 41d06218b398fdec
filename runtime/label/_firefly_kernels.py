"""Compiled kernels that find fireflies: samples far brighter than all others that come from the same place."""

import math

import numpy as np

from spreadlets.compiled import helper, kernel


@helper
def brightness(colour):
    """Return the mean of red, green and blue of a pixel (4,), float32."""
    return (colour[0] + colour[1] + colour[2]) * np.float32(1.0 / 3.0)


@kernel
def _cell(shift, row, col, shape):
    """Return the pixel, clamped to the frame, in which a sample lies once it is moved by its shift (dx, dy)."""
    if not shift.shape[0]:
        return np.int64(row), np.int64(col)
    down, right = row + np.float64(shift[row, col, 1]), col + np.float64(shift[row, col, 0])
    # Clamped before it is rounded, so that no size is beyond an integer's range.
    return (
        np.int64(math.floor(min(max(down, 0.0), shape[0] - 1.0) + 0.5)),
        np.int64(math.floor(min(max(right, 0.0), shape[1] - 1.0) + 0.5)),
    )


@kernel
def gather_brightest(radiance, shift, brightest):
    """Note the two brightest samples of each pixel.

    Parameters
    ----------
    radiance : ndarray of shape (H, W, 4), float32
    shift : ndarray of shape (H, W, 2) or (0, 0, 2), float32
        From each sample to where it comes from, (dx, dy), px; empty if nothing is moved.
    brightest : ndarray of shape (H, W, 2), float32
        Brightness of the brightest and of the second; raised in place.
    """
    shape = brightest.shape[:2]
    for row in range(radiance.shape[0]):
        for col in range(radiance.shape[1]):
            level = brightness(radiance[row, col])
            i, j = _cell(shift, row, col, shape)
            if level > brightest[i, j, 0]:
                brightest[i, j, 1] = brightest[i, j, 0]
                brightest[i, j, 0] = level
            elif level > brightest[i, j, 1]:
                brightest[i, j, 1] = level


@kernel
def clamp(begin, end, radiance, shift, brightest, factor, floor):
    """Dim each sample to ``factor`` times the brightest other one within a pixel of where it comes from, in place.

    Parameters
    ----------
    radiance, shift, brightest
        As for `gather_brightest`.
    factor : float32
    floor : float32
        The others count as no darker than this.

    Returns
    -------
    int
        Number of samples that were dimmed.
    """
    height, width = brightest.shape[:2]
    count = 0
    for row in range(begin, end):
        for col in range(radiance.shape[1]):
            level = brightness(radiance[row, col])
            if level <= factor * floor:
                continue
            i, j = _cell(shift, row, col, (height, width))
            # The sample itself is the brightest of its own pixel, or the second is no darker than it.
            around = brightest[i, j, 1] if brightest[i, j, 0] == level else brightest[i, j, 0]
            for k in range(max(i - 1, 0), min(i + 2, height)):
                for m in range(max(j - 1, 0), min(j + 2, width)):
                    if k != i or m != j:
                        around = max(around, brightest[k, m, 0])
            limit = factor * max(around, floor)
            if level > limit:
                count += 1
                for c in range(3):
                    radiance[row, col, c] *= limit / level
    return count
