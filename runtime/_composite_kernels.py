"""Compiled kernels of the composite step."""

import numba
import numpy as np


@numba.njit(cache=True, fastmath=False, parallel=True)
def all_opaque(radiance):
    """Return whether the alpha of every pixel (H, W, 4) is 1."""
    transparent = 0
    for row in numba.prange(radiance.shape[0]):
        for col in range(radiance.shape[1]):
            transparent += radiance[row, col, 3] != np.float32(1.0)
    return transparent == 0


@numba.njit(cache=True, fastmath=False, parallel=True)
def reweight(padded, top, left, opaque, least, layer):
    """Cut a layer out of its canvas and normalise it by its alpha: see `runtime.composite.reweight`.

    Parameters
    ----------
    padded : ndarray of shape (rows, cols, 4), float32
        Accumulated premultiplied colour and alpha.
    top, left : int
        Row and column, in the layer, of the canvas's first pixel.
    opaque : bool
    least : float32
        Smallest alpha to divide by.
    layer : ndarray of shape (H, W, 4), float32
        Filled; zero where the canvas does not reach.
    """
    rows, cols = padded.shape[:2]
    one = np.float32(1.0)
    for row in numba.prange(layer.shape[0]):
        for col in range(layer.shape[1]):
            i, j = row - top, col - left
            if not (0 <= i < rows and 0 <= j < cols):
                for c in range(4):
                    layer[row, col, c] = np.float32(0.0)
                continue
            weight = one / max(padded[i, j, 3], least)
            for c in range(3):
                layer[row, col, c] = padded[i, j, c] * weight
            layer[row, col, 3] = one if opaque else min(max(padded[i, j, 3] * weight, np.float32(0.0)), one)
