"""Compiled kernels that list what lies hidden in the pixels of a frame."""

import numpy as np

from spreadlets.compiled import helper, kernel

RADIANCE = 4
"""Features of a pixel's colour and alpha; those of depths and motions follow."""


@helper
def _put(feature, number, planes):
    """Write the features (n,) of a pixel to a place in the list."""
    radiance, depths, motions = planes
    for c in range(RADIANCE):
        radiance[number, c] = feature[c]
    for c in range(len(depths)):
        nearness = feature[RADIANCE + c]
        depths[c, number] = np.float32(-1.0) / nearness if nearness < 0.0 else np.float32(np.inf)
    for c in range(len(motions)):
        motions[c, number, 0] = feature[RADIANCE + len(depths) + 2 * c]
        motions[c, number, 1] = feature[RADIANCE + len(depths) + 2 * c + 1]


@kernel
def count_hidden(begin, end, share, counts):
    """Fill ``counts`` (H,), int64, with the pixels of each row in which something lies hidden."""
    for row in range(begin, end):
        counts[row] = 0
        for col in range(share.shape[1]):
            counts[row] += share[row, col] != 0.0


@kernel
def list_hidden(begin, end, share, features, strands, first, places, planes):
    """List the hidden surfaces of each row's pixels, each before the strands that lie behind it.

    Parameters
    ----------
    share : ndarray of shape (H, W), float32
        Of a pixel that the surface covers, 0 where there is none.
    features : ndarray of shape (H, W, n), float32
        See `runtime.label.surfaces.take_features`.
    strands : tuple of ndarrays of shapes (m,), (m,), (m, n) and (H + 1,), int64, float32, float32 and int64
        Places of their pixels in the flattened frame, ascending; shares; features; and where each row's begin.
    first : ndarray of shape (H,), int64
        Where each row's begin in the list.
    places : tuple of ndarrays of shapes (k, 2) and (k,), int32 and float32
        Filled with rows and columns, and with the shares.
    planes : tuple of ndarrays of shapes (k, 4), (n_depths, k) and (n_motions, k, 2), float32
        Filled with colours, depths and motions; beyond all depths where the nearness is 0.
    """
    at, part = places
    line, thread, begins = strands[0], strands[2], strands[3]
    width = share.shape[1]
    for row in range(begin, end):
        number, k = first[row], begins[row]
        for col in range(width):
            if share[row, col] != 0.0:
                at[number, 0], at[number, 1], part[number] = row, col, share[row, col]
                _put(features[row, col], number, planes)
                number += 1
            if k < begins[row + 1] and line[k] == row * width + col:
                at[number, 0], at[number, 1], part[number] = row, col, strands[1][k]
                _put(thread[k], number, planes)
                number, k = number + 1, k + 1
