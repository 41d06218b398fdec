"""Compiled kernels of SLR Algorithm 1: pre-integration by reprojection, and a tile with all its layers."""

import math

import numpy as np

from spreadlets.compiled import helper, kernel
from spreadlets.runtime.sheared._tile_kernels import MET, N_SUMS, SEEN, blur, composite, gaussian, share_out

WEIGHT_LEVELS = 255.0
"""Largest sum of weights in fixed point: 8 bits after pre-integration (SLR Table I)."""
COLOUR_LEVELS = 255.0
"""Of a sample's colour in fixed point: 8 bits, so that sums have 16."""
FILTERED_LEVELS = np.array([2047.0, 1023.0, 1023.0, 65535.0], np.float32)
"""Of a layer's filtered colour in fixed point: 11, 10 and 10 bits (SLR Table I), and 16 of alpha, which SLR has not."""
FILTERED_WEIGHT_LEVELS = 65535.0
"""Of filtered weights in fixed point: 16 bits (SLR Table I)."""


@helper
def pre_integrate(samples, partition, slot, filters, outer, origin, options, sums):
    """Add the samples around a tile to the sums of its layers (SLR Algorithm 1, first loop).

    Parameters
    ----------
    samples : tuple
        colour (N, 4), place (N, 2), lens (N, 2), first (H * W + 1,), and the image's width.
    partition : ndarray of shape (N,), uint8
    slot : ndarray of shape (P,), int16
        Layer of each partition, negative if it is none of this tile's.
    filters : tuple of three ndarrays of shape (L,), float32
        Shear, standard deviation on the screen and over the lens, see `runtime.sheared.filters.Filters`.
    outer : ndarray of shape (4,), int32
        Top, left, bottom, right of the samples to take, px.
    origin : tuple of int
        Row and column of the sums' first pixel in the image, px.
    options : tuple
        bilinear (bool): spread a sample over the four nearest pixels instead of adding it to the nearest; steps
        (float32): 0, or round weights to multiples of 1 / steps and sum them as integers.
    sums : ndarray of shape (L, h, w, N_SUMS), float32
        Added to.
    """
    colour, place, lens, first, width = samples
    shear, _, sigma_lens = filters
    bilinear, steps = options
    top, left, bottom, right = outer
    for row in range(top, bottom):
        for i in range(first[row * width + left], first[row * width + right]):
            own = slot[partition[i]]
            squared = lens[i, 0] ** 2 + lens[i, 1] ** 2
            # A sample meets its own layer, and passes all that are nearer.
            for layer in range(own + 1):
                # Shear it by the layer's slope, and weight it over the lens.
                x = place[i, 0] - shear[layer] * lens[i, 0] - origin[1]
                y = place[i, 1] - shear[layer] * lens[i, 1] - origin[0]
                weight = np.float32(1.0)
                if sigma_lens[layer] < np.float32(np.inf):
                    weight = np.float32(math.exp(np.float32(-0.5) * squared / sigma_lens[layer] ** 2))
                # Spread it over the four nearest pixels, or add it to the nearest.
                if bilinear:
                    col, line = int(math.floor(x)), int(math.floor(y))
                    fx, fy = np.float32(x - col), np.float32(y - line)
                    for below in range(2):
                        share_y = fy if below else np.float32(1.0) - fy
                        for right_of in range(2):
                            share = share_y * (fx if right_of else np.float32(1.0) - fx)
                            part = in_steps(weight * share, steps)
                            add(sums[layer], line + below, col + right_of, part, colour[i], layer == own)
                else:
                    line, col = int(math.floor(y + 0.5)), int(math.floor(x + 0.5))
                    add(sums[layer], line, col, in_steps(weight, steps), colour[i], layer == own)


@helper
def in_steps(weight, steps):
    """Return a weight as a whole number of steps in fixed point, where there are any, or else as it is."""
    return np.float32(math.floor(weight * steps + np.float32(0.5))) if steps > np.float32(0.0) else weight


@helper
def add(sums, row, col, weight, colour, seen):
    """Add a sample that a layer stopped, or that passed it, to a pixel of its sums (h, w, N_SUMS), if within."""
    if 0 <= row < sums.shape[0] and 0 <= col < sums.shape[1]:
        sums[row, col, MET] += weight
        if seen:
            sums[row, col, SEEN] += weight
            for channel in range(4):
                sums[row, col, channel] += weight * colour[channel]


@helper
def saturate(sums):
    """Limit the sums (h, w, N_SUMS) of a layer to what fixed point holds."""
    for row in range(sums.shape[0]):
        for col in range(sums.shape[1]):
            for channel in range(4):
                sums[row, col, channel] = min(sums[row, col, channel], np.float32(WEIGHT_LEVELS * COLOUR_LEVELS))
            for column in (SEEN, MET):
                sums[row, col, column] = min(sums[row, col, column], np.float32(WEIGHT_LEVELS))


@helper
def round_filtered(blurred):
    """Round the filtered sums (h, w * N_SUMS) of a layer: its mean colour, and its weights; take colours back to 1."""
    fine = np.float32(FILTERED_WEIGHT_LEVELS / WEIGHT_LEVELS)
    for row in range(blurred.shape[0]):
        for base in range(0, blurred.shape[1], N_SUMS):
            met = blurred[row, base + MET]
            for column in (SEEN, MET):
                blurred[row, base + column] = np.rint(blurred[row, base + column] * fine) / fine
            for channel in range(4):
                if met > np.float32(0.0):
                    levels = FILTERED_LEVELS[channel]
                    mean = min(blurred[row, base + channel] / (met * np.float32(COLOUR_LEVELS)), np.float32(1.0))
                    blurred[row, base + channel] = np.rint(mean * levels) / levels * blurred[row, base + MET]


@kernel
def filter_tile(samples, partition, slot, filters, inner, outer, reach, options, image):
    """Reconstruct the pixels of a tile (SLR Algorithm 2).

    Parameters
    ----------
    samples, partition, slot, filters, outer, options
        As for `pre_integrate`.
    inner : ndarray of shape (4,), int32
        Top, left, bottom, right of the tile, px.
    reach : int
        Largest radius of a screen filter, px.
    image : ndarray of shape (H, W, 4), float32
        Zero in the tile; filled there.
    """
    top, left, bottom, right = inner
    height, width = bottom - top, right - left
    fixed_point = options[1] > np.float32(0.0)
    n_layers = filters[0].size
    sums = np.zeros((n_layers, height + 2 * reach, width + 2 * reach, N_SUMS), np.float32)
    pre_integrate(samples, partition, slot, filters, outer, (top - reach, left - reach), options, sums)
    between = np.empty((height + 2 * reach, width * N_SUMS), np.float32)
    blurred = np.empty((height, width * N_SUMS), np.float32)
    left_over = np.ones((height, width), np.float32)
    for layer in range(n_layers):
        if fixed_point:
            saturate(sums[layer])
        blur(sums[layer], reach, gaussian(filters[1][layer], reach), between, blurred)
        if fixed_point:
            round_filtered(blurred)
        composite(blurred, top, left, image, left_over)
    share_out(top, left, image, left_over)
