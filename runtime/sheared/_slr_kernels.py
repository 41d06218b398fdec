"""Compiled kernels of SLR Algorithm 1: pre-integration by reprojection, and a tile with all its layers."""

import math

import numba
import numpy as np

from runtime.sheared._tile_kernels import MET, N_SUMS, SEEN, blur, composite, gaussian, share_out


@numba.njit(cache=True, fastmath=False, nogil=True)
def pre_integrate(samples, partition, slot, filters, outer, origin, bilinear, sums):
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
    bilinear : bool
        Spread a sample over the four nearest pixels instead of adding it to the nearest.
    sums : ndarray of shape (L, h, w, N_SUMS), float32
        Added to.
    """
    colour, place, lens, first, width = samples
    shear, _, sigma_lens = filters
    top, left, bottom, right = outer
    for row in range(top, bottom):
        for i in range(first[row * width + left], first[row * width + right]):
            own = slot[partition[i]]
            squared = lens[i, 0] ** 2 + lens[i, 1] ** 2
            for layer in range(own + 1):
                x = place[i, 0] - shear[layer] * lens[i, 0] - origin[1]
                y = place[i, 1] - shear[layer] * lens[i, 1] - origin[0]
                weight = np.float32(1.0)
                if sigma_lens[layer] < np.float32(np.inf):
                    weight = np.float32(math.exp(np.float32(-0.5) * squared / sigma_lens[layer] ** 2))
                if bilinear:
                    col, line = int(math.floor(x)), int(math.floor(y))
                    fx, fy = np.float32(x - col), np.float32(y - line)
                    one = np.float32(1.0)
                    add(sums[layer], line, col, weight * (one - fy) * (one - fx), colour[i], layer == own)
                    add(sums[layer], line, col + 1, weight * (one - fy) * fx, colour[i], layer == own)
                    add(sums[layer], line + 1, col, weight * fy * (one - fx), colour[i], layer == own)
                    add(sums[layer], line + 1, col + 1, weight * fy * fx, colour[i], layer == own)
                else:
                    add(
                        sums[layer], int(math.floor(y + 0.5)), int(math.floor(x + 0.5)), weight, colour[i], layer == own
                    )


@numba.njit(cache=True, fastmath=False, nogil=True, inline="always")
def add(sums, row, col, weight, colour, seen):
    """Add a sample that a layer stopped, or that passed it, to a pixel of its sums (h, w, N_SUMS), if within."""
    if 0 <= row < sums.shape[0] and 0 <= col < sums.shape[1]:
        sums[row, col, MET] += weight
        if seen:
            sums[row, col, SEEN] += weight
            for channel in range(4):
                sums[row, col, channel] += weight * colour[channel]


@numba.njit(cache=True, fastmath=False, nogil=True)
def filter_tile(samples, partition, slot, filters, inner, outer, reach, bilinear, image):
    """Reconstruct the pixels of a tile (SLR Algorithm 2).

    Parameters
    ----------
    samples, partition, slot, filters, outer, bilinear
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
    n_layers = filters[0].size
    sums = np.zeros((n_layers, height + 2 * reach, width + 2 * reach, N_SUMS), np.float32)
    pre_integrate(samples, partition, slot, filters, outer, (top - reach, left - reach), bilinear, sums)
    between = np.empty((height + 2 * reach, width * N_SUMS), np.float32)
    blurred = np.empty((height, width * N_SUMS), np.float32)
    left_over = np.ones((height, width), np.float32)
    for layer in range(n_layers):
        blur(sums[layer], reach, gaussian(filters[1][layer], reach), between, blurred)
        composite(blurred, top, left, image, left_over)
    share_out(top, left, image, left_over)
