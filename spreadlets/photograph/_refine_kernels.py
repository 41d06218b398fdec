"""Kernels that move the edges of a depth map to those of its image."""

import numpy as np

from spreadlets.compiled import kernel

BINS = 32
"""Into which the depths around a pixel are sorted to find their median."""


PLATEAU = 0.25
"""Share of the range of depths around a pixel, at either end of it, that is not on the ramp between two surfaces."""


@kernel
def end_ramps(begin, end, depth, low, high, side, window, sharpened):
    """Give pixels on a ramp between two surfaces the depth of the one that they are nearer to.

    Parameters
    ----------
    depth : ndarray of shape (H, W), float32
    low, high : ndarray of shape (H / side, W / side), float32
        Range of the depths around each block of pixels; where they are equal there is no ramp, and the depth stays.
    side : int
        Of these blocks, px.
    window : tuple of int
        Half-width of what is looked at, px, and the step between the pixels that are.
    sharpened : ndarray of shape (H, W), float32
        Filled.
    """
    height, width = depth.shape
    half, step = window
    for row in range(begin, end):
        for col in range(width):
            least, most = low[row // side, col // side], high[row // side, col // side]
            sharpened[row, col] = depth[row, col]
            if not most > least:
                continue
            # Average what lies at its end of the range.
            reach = np.float32(PLATEAU) * (most - least)
            is_near = depth[row, col] - least > most - depth[row, col]
            count, total = 0, 0.0
            for i in range(max(row - half, 0), min(row + half + 1, height), step):
                for j in range(max(col - half, 0), min(col + half + 1, width), step):
                    if (most - depth[i, j] if is_near else depth[i, j] - least) <= reach:
                        count += 1
                        total += depth[i, j]
            if count:
                sharpened[row, col] = total / count


@kernel
def weighted_medians(begin, end, depth, image, low, high, side, window, tolerance, refined):
    """Replace depths near edges by the median of those around, weighted by how like their colours are.

    Parameters
    ----------
    depth : ndarray of shape (H, W), float32
    image : ndarray of shape (H, W, 3), float32
        Colours as displayed.
    low, high : ndarray of shape (H / side, W / side), float32
        Range of the depths around each block of pixels; where they are equal there is no edge, and the depth stays.
    side : int
        Of these blocks, px.
    window : tuple of int
        Half-width of what is looked at, px, and the step between the pixels that are.
    tolerance : float
        Difference of colour at which a pixel's weight is a quarter.
    refined : ndarray of shape (H, W), float32
        Filled.
    """
    height, width = depth.shape
    half, step = window
    weights, sums = np.empty(BINS), np.empty(BINS)
    for row in range(begin, end):
        for col in range(width):
            least, most = low[row // side, col // side], high[row // side, col // side]
            refined[row, col] = depth[row, col]
            if not most > least:
                continue
            # Sort the depths around into bins, by the likeness of their pixels.
            weights[:], sums[:] = 0.0, 0.0
            red, green, blue = image[row, col, 0], image[row, col, 1], image[row, col, 2]
            for i in range(max(row - half, 0), min(row + half + 1, height), step):
                for j in range(max(col - half, 0), min(col + half + 1, width), step):
                    apart = (image[i, j, 0] - red) ** 2 + (image[i, j, 1] - green) ** 2 + (image[i, j, 2] - blue) ** 2
                    like = 1.0 / (1.0 + apart / tolerance**2)
                    bin_ = min(max(int(BINS * (depth[i, j] - least) / (most - least)), 0), BINS - 1)
                    weights[bin_] += like * like
                    sums[bin_] += like * like * depth[i, j]
            # Half of the weight lies on either side of the median.
            rest, bin_ = 0.5 * weights.sum(), 0
            while rest > weights[bin_]:
                rest -= weights[bin_]
                bin_ += 1
            refined[row, col] = sums[bin_] / weights[bin_]
