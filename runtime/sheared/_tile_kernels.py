"""Compiled kernels that every layered reconstruction shares: statistics of cells, the screen filter, compositing.

The sums of a tile are arrays (L, h, w, `N_SUMS`), float32: of each layer, over the tile and `reach` px around.
"""

import math

import numpy as np

from spreadlets.compiled import helper, kernel

N_SUMS = 6
"""Of each pixel: weighted premultiplied R, G, B, A; weight of the samples in the layer; of those and of its holes."""
SEEN = 4
"""Column of the weight of the samples that a layer stopped."""
MET = 5
"""Column of the weight of the samples that met a layer: it stopped them, or they passed it."""

LEAST_MET = np.float32(1e-12)
"""Weight of samples below which a layer is taken as unknown: the tails of recursive filters underflow."""


@kernel
def mark_bins(coc, partition, first, width, cell, bin_width, most, near, far):
    """Widen the ranges of bins of CoC, by cell and partition, to what the samples need.

    Parameters
    ----------
    coc : ndarray of shape (N,), float32
    partition : ndarray of shape (N,), uint8
    first : ndarray of shape (H * W + 1,), int64
    width, cell : int
        Of the image and of a cell, px.
    bin_width : float
        px of CoC.
    most : int
        Bins on each side of focus.
    near, far : ndarray of shape (rows, cols, P), int16
        First and last bin in use; widened in place.
    """
    for pixel in range(first.size - 1):
        row, col = pixel // width // cell, pixel % width // cell
        for i in range(first[pixel], first[pixel + 1]):
            place = np.int16(min(max(math.floor(coc[i] / bin_width), -most), most - 1))
            p = partition[i]
            near[row, col, p] = min(near[row, col, p], place)
            far[row, col, p] = max(far[row, col, p], place)


@kernel
def gaussian(sigma, reach):
    """Return weights of sum 1 at -r ... r px, cut at three standard deviations or at `reach` px, float32."""
    radius = min(reach, int(math.ceil(3.0 * sigma)))
    weights = np.empty(2 * radius + 1, np.float32)
    total = 0.0
    for k in range(-radius, radius + 1):
        weights[k + radius] = math.exp(-0.5 * (k / sigma) ** 2)
        total += weights[k + radius]
    for k in range(weights.size):
        weights[k] /= total
    return weights


@kernel
def blur(sums, reach, weights, between, blurred):
    """Apply a screen filter that is the same along x and y to a layer's sums.

    Parameters
    ----------
    sums : ndarray of shape (h + 2 * reach, w + 2 * reach, C), float32
    reach : int
        Ring around the tile, px, at least the radius of the filter.
    weights : ndarray of shape (2 * radius + 1,), float32
        Symmetric.
    between : ndarray of shape (h + 2 * reach, w * C), float32
        Scratch.
    blurred : ndarray of shape (h, w * C), float32
        Filled.
    """
    radius = weights.size // 2
    channels = sums.shape[2]
    across = blurred.shape[1]
    height = blurred.shape[0]
    # Along the rows, including those of the ring that the columns need.
    for row in range(reach - radius, reach + height + radius):
        line = sums[row].reshape(sums.shape[1] * channels)
        target = between[row]
        target[:] = np.float32(0.0)
        for k in range(weights.size):
            weight = weights[k]
            begin = (reach - radius + k) * channels
            part = line[begin : begin + across]
            for i in range(across):
                target[i] += weight * part[i]
    # Along the columns.
    for row in range(height):
        target = blurred[row]
        target[:] = np.float32(0.0)
        for k in range(weights.size):
            weight = weights[k]
            part = between[row + reach - radius + k]
            for i in range(across):
                target[i] += weight * part[i]


@kernel
def composite(blurred, top, left, image, left_over):
    """Put a filtered layer behind what is there already (SLR Eq. 35, Algorithms 1 and 2).

    Parameters
    ----------
    blurred : ndarray of shape (h, w * N_SUMS), float32
        The layer's sums after the screen filter.
    top, left : int
        Place of the tile in the image, px.
    image : ndarray of shape (H, W, 4), float32
        Added to.
    left_over : ndarray of shape (h, w), float32
        Share of the light that passes all layers so far; multiplied by what passes this one.
    """
    for row in range(left_over.shape[0]):
        for col in range(left_over.shape[1]):
            base = col * N_SUMS
            met = blurred[row, base + MET]
            if met > LEAST_MET:
                share = left_over[row, col] / met
                for channel in range(4):
                    image[top + row, left + col, channel] += share * blurred[row, base + channel]
                opacity = min(blurred[row, base + SEEN] / met, np.float32(1.0))
                left_over[row, col] *= np.float32(1.0) - opacity


@helper
def share_out(top, left, image, left_over):
    """Divide a tile's pixels by the light that layers stopped: what passed them all met no sample of a farther one."""
    for row in range(left_over.shape[0]):
        for col in range(left_over.shape[1]):
            stopped = np.float32(1.0) - left_over[row, col]
            if stopped > np.float32(0.0):
                for channel in range(4):
                    image[top + row, left + col, channel] /= stopped
