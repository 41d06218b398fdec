"""Compiled kernels of edges in focus: what samples say of the pixels that they were seen in, averaged along edges."""

import math

import numpy as np

from spreadlets.compiled import helper, kernel

UNSTEERED = np.float32(-1.0)
"""The variance where the layer is even, and no mean was made."""


@kernel
def add_sharp(begin, end, radiance, place, coc, length, number, reach, total, count, every):
    """Add one sample of each pixel, as far as it is of a layer and sharp, to the layer's.

    Parameters
    ----------
    radiance : ndarray of shape (H, W, 4), float32
    place : ndarray of shape (H, W), float32
        See `runtime.finish._calibration_kernels.add_samples`.
    coc, length : ndarray of shape (H, W), float32
        CoC radius and length of the path, px.
    number : int
        The layer.
    reach : float
        What the PSF of a sharp sample reaches at most, px; up to one pixel more, it is so in part.
    total : ndarray of shape (H, W, 3), float32
        Colours of the sharp samples; added to.
    count, every : ndarray of shape (H, W), float32
        Shares of the sharp samples, and of all; added to.
    """
    zero, one = np.float32(0.0), np.float32(1.0)
    for row in range(begin, end):
        for col in range(place.shape[1]):
            share = one - abs(place[row, col] - np.float32(number))
            if share <= zero:
                continue
            every[row, col] += share
            beyond = abs(coc[row, col]) + np.float32(0.5) * length[row, col] - np.float32(reach)
            share *= min(max(one - beyond, zero), one)
            if share > zero:
                count[row, col] += share
                for c in range(3):
                    total[row, col, c] += share * radiance[row, col, c]


@helper
def _brightness(layer, row, col, floor):
    """Return the mean of a pixel's colours, without alpha, plus ``floor``."""
    alpha = layer[row, col, 3]
    if alpha <= np.float32(0.0):
        return np.float32(floor)
    bright = (layer[row, col, 0] + layer[row, col, 1] + layer[row, col, 2]) / (np.float32(3.0) * alpha)
    return max(bright, np.float32(0.0)) + np.float32(floor)


@kernel
def find_lacking(begin, end, layer, total, count, floor, least_share, logarithm, lacking):
    """Find what a layer's colours lack of those of its sharp samples, relative to its brightness.

    Parameters
    ----------
    layer : ndarray of shape (H, W, 4), float32
        Premultiplied.
    total, count : ndarray of shapes (H, W, 3) and (H, W), float32
        See `add_sharp`; ``count`` becomes 0 where the layer's alpha is below ``least_share``.
    floor : float
        Brightness that is added to all.
    least_share : float
    logarithm : ndarray of shape (H, W), float32
        Filled with the logarithm of the brightness.
    lacking : ndarray of shape (H, W, 3), float32
        Filled; 0 where there is no sample.
    """
    for row in range(begin, end):
        for col in range(count.shape[1]):
            bright, alpha = _brightness(layer, row, col, floor), layer[row, col, 3]
            logarithm[row, col] = math.log(bright)
            if alpha < np.float32(least_share):
                count[row, col] = np.float32(0.0)
            samples = count[row, col]
            for c in range(3):
                lacking[row, col, c] = np.float32(0.0)
                if samples > np.float32(0.0):
                    lacking[row, col, c] = (total[row, col, c] / samples - layer[row, col, c] / alpha) / bright


@kernel
def multiply_slopes(begin, end, logarithm, products):
    """Fill ``products`` (3, H, W), float32, with the squares of the slopes across and down, and their product between.

    Slopes are of ``logarithm`` (H, W), per px.
    """
    height, width = logarithm.shape
    for row in range(begin, end):
        above, below = max(row - 1, 0), min(row + 1, height - 1)
        for col in range(width):
            left, right = max(col - 1, 0), min(col + 1, width - 1)
            across = (logarithm[row, right] - logarithm[row, left]) / np.float32(max(right - left, 1))
            down = (logarithm[below, col] - logarithm[above, col]) / np.float32(max(below - above, 1))
            products[0, row, col], products[1, row, col] = across * across, across * down
            products[2, row, col] = down * down


@helper
def _steered(xx, xy, yy, along, across, even):
    """Return the quadratic form (xx, xy, yy) of a window that is long along an edge, and round where there is none."""
    trace, difference = xx + yy, math.sqrt((xx - yy) ** 2 + np.float32(4.0) * xy * xy)
    if difference == np.float32(0.0):
        round_window = np.float32(1.0) / (even * even)
        return round_window, np.float32(0.0), round_window
    # How much the slopes around agree tells how long and thin it is.
    agree = (difference / trace) ** 2
    down_slope, level = even + agree * (across - even), even + agree * (along - even)
    steep, flat = np.float32(1.0) / (down_slope * down_slope), np.float32(1.0) / (level * level)
    turned, half = (xx - yy) / difference, np.float32(0.5)
    mean, spread = half * (steep + flat), half * (steep - flat)
    return mean + spread * turned, spread * np.float32(2.0) * xy / difference, mean - spread * turned


@kernel
def steered_means(begin, end, lacking, count, products, least_slope, reach, axes, mean, variance):
    """Average what a layer lacks along its edges.

    Parameters
    ----------
    lacking, count : ndarray of shapes (H, W, 3) and (H, W), float32
        See `find_lacking`.
    products : ndarray of shape (3, H, W), float32
        See `multiply_slopes`, blurred.
    least_slope : float
        Where slopes are smaller, nothing is done.
    reach : int
        Of windows, px, to all sides.
    axes : tuple of three floats
        Half lengths of the windows along an edge, across, and of the round ones, px.
    mean : ndarray of shape (H, W, 3), float32
        Filled where slopes are as large.
    variance : ndarray of shape (H, W), float32
        Filled with that of the mean, summed over the channels, as the spread of what is averaged tells; `UNSTEERED`
        where there is no mean.
    """
    height, width = count.shape
    zero, one = np.float32(0.0), np.float32(1.0)
    along, across, even = np.float32(axes[0]), np.float32(axes[1]), np.float32(axes[2])
    for row in range(begin, end):
        for col in range(width):
            variance[row, col] = UNSTEERED
            xx, xy, yy = products[0, row, col], products[1, row, col], products[2, row, col]
            if xx + yy < np.float32(least_slope) ** 2:
                continue
            # Turn the window along the edge, and sum up what lies in it.
            xx, xy, yy = _steered(xx, xy, yy, along, across, even)
            samples, red, green, blue, squares = zero, zero, zero, zero, zero
            for y in range(max(row - reach, 0), min(row + reach + 1, height)):
                for x in range(max(col - reach, 0), min(col + reach + 1, width)):
                    if count[y, x] == zero:
                        continue
                    dx, dy = np.float32(x - col), np.float32(y - row)
                    inside = one - (xx * dx * dx + np.float32(2.0) * xy * dx * dy + yy * dy * dy)
                    if inside <= zero:
                        continue
                    weight = inside * inside * count[y, x]
                    r, g, b = lacking[y, x, 0], lacking[y, x, 1], lacking[y, x, 2]
                    samples += weight
                    red, green, blue = red + weight * r, green + weight * g, blue + weight * b
                    squares += weight * weight * (r * r + g * g + b * b)
            # Divide by the weight; without a sample nothing is known.
            if samples > zero:
                mean[row, col, 0], mean[row, col, 1] = red / samples, green / samples
                mean[row, col, 2] = blue / samples
                variance[row, col] = squares / (samples * samples)


@kernel
def add_edges(begin, end, layer, mean, variance, products, sharp, power, floor):
    """Add to a layer what it lacks, as far as that is believed.

    Parameters
    ----------
    layer : ndarray of shape (H, W, 4), float32
        Premultiplied; changed in place.
    mean, variance : ndarray of shapes (H, W, 3) and (H, W), float32
        See `steered_means`.
    products : ndarray of shape (3, H, W), float32
    sharp : ndarray of shape (H, W), float32
        Share of the layer's samples around that are sharp.
    power : float
        Expected square of what is lacking, for a square of the slopes of 1.
    floor : float
        See `find_lacking`.
    """
    zero = np.float32(0.0)
    for row in range(begin, end):
        for col in range(sharp.shape[1]):
            if variance[row, col] == UNSTEERED:
                continue
            expected = np.float32(power) * (products[0, row, col] + products[2, row, col])
            if expected <= zero:
                continue
            believed = sharp[row, col] * expected / (expected + variance[row, col])
            scale = believed * _brightness(layer, row, col, floor) * layer[row, col, 3]
            for c in range(3):
                changed = layer[row, col, c] + scale * mean[row, col, c]
                layer[row, col, c] = max(changed, min(layer[row, col, c], zero))
