"""Compiled kernels of the depth layers: which pixel belongs where."""

import math

import numpy as np

from spreadlets.compiled import helper, kernel


@kernel
def nearness_range(begin, end, depth, label, bounds):
    """Fill ``bounds`` (H, 2), float64, with the least and the largest ``-1 / depth`` of each row's drawn pixels."""
    for row in range(begin, end):
        low, high = math.inf, -math.inf
        for col in range(depth.shape[1]):
            if label[row, col] >= 0:
                nearness = -1.0 / np.float64(depth[row, col])
                low, high = min(low, nearness), max(high, nearness)
        bounds[row, 0] = low
        bounds[row, 1] = high


@kernel
def assign_layers(begin, end, depth, cuts, widths, layer, farther):
    """Find the layer of each pixel, and which share of it belongs to the next one.

    Parameters
    ----------
    depth : ndarray of shape (H, W), float32
        Metres.
    cuts : ndarray of shape (n,), float64
        Of ``-1 / depth``, ascending.
    widths : ndarray of shape (n,), float64
        Width of the transition around each cut, up to the step to its neighbours; 0 for a hard one.
    layer : ndarray of shape (H, W), int32
        Filled.
    farther : ndarray of shape (H, W), float32
        Filled: the share in ``layer + 1``.
    """
    for row in range(begin, end):
        for col in range(depth.shape[1]):
            # Count the cuts before the place: halve the range in which the first beyond it lies.
            place = -1.0 / np.float64(depth[row, col])
            number, beyond = 0, len(cuts)
            while number < beyond:
                middle = (number + beyond) // 2
                if cuts[middle] <= place:
                    number = middle + 1
                else:
                    beyond = middle
            layer[row, col] = number
            farther[row, col] = 0.0
            for cut in range(max(number - 1, 0), min(number + 1, len(cuts))):
                if abs(place - cuts[cut]) < 0.5 * widths[cut]:
                    layer[row, col] = cut
                    farther[row, col] = (place - cuts[cut]) / widths[cut] + 0.5


@helper
def share_in(layer, farther, number):
    """Return the share of a pixel that lies in a layer; ``layer`` and ``farther`` as for `assign_layers`."""
    if layer == number:
        return np.float32(1.0) - farther
    return farther if layer == number - 1 else np.float32(0.0)


@kernel
def layer_labels(begin, end, variant, layer, farther, weight, n_variants, part, label, share):
    """Combine variants and layers to labels ``layer * n_variants + variant``, and weights with shares.

    Parameters
    ----------
    variant, layer : ndarray of shape (H, W), int32
    farther : ndarray of shape (H, W), float32
    weight : ndarray of shape (H, W) or (0, 0), float32
        Weights of the pixels; empty if all are 1.
    n_variants : int
    part : int
        0 for the nearer layer of each pixel, 1 for the farther one.
    label : ndarray of shape (H, W), int32
        Filled; -1 where the pixel has no such part.
    share : ndarray of shape (H, W), float32
        Filled.

    Returns
    -------
    int
        Number of pixels that have the part.
    """
    count = 0
    for row in range(begin, end):
        for col in range(variant.shape[1]):
            each = farther[row, col] if part else np.float32(1.0) - farther[row, col]
            if weight.shape[0]:
                each *= weight[row, col]
            drawn = variant[row, col] >= 0 and each > 0
            label[row, col] = (layer[row, col] + part) * n_variants + variant[row, col] if drawn else -1
            share[row, col] = each
            count += drawn
    return count
