"""Naive float64 twins of the pyramids: one plane, whole arrays, nothing fused."""

import math

import numpy as np
from scipy.ndimage import correlate1d

from spreadlets.psf.laplacian import laplacian, solve_dirichlet


def published_naive(source, filters):
    """Evaluate a published convolution pyramid as the paper writes it, on zero-padded arrays."""
    down, up, own = ([*taps[:0:-1], *taps] for taps in (filters.down, filters.up, filters.source))
    pad = filters.pad
    levels = [np.pad(-source, pad)]
    for _ in range(1, math.ceil(math.log2(max(source.shape)))):
        levels.append(np.pad(filter_both_axes(levels[-1], down)[::2, ::2], pad))
    answer = filter_both_axes(levels[-1], own)
    for level in reversed(levels[:-1]):
        spread = np.zeros_like(level)
        spread[::2, ::2] = answer[pad:-pad, pad:-pad]
        answer = filter_both_axes(spread, up) + filter_both_axes(level, own)
    return answer[pad:-pad, pad:-pad]


def filter_both_axes(plane, taps):
    """Correlate with a separable filter; zero outside."""
    return correlate1d(correlate1d(plane, taps, axis=0, mode="constant"), taps, axis=1, mode="constant")


def reflect(values):
    """Continue an array's first axis by three pixels of odd reflection about the zeros just outside."""
    zero = np.zeros_like(values[:1])
    return np.concatenate([-values[1::-1], zero, values, zero, -values[:-3:-1]])


def coarsen_naive(plane, taps):
    """Filter along the first axis and keep the odd pixels."""
    extended = reflect(plane)
    count = (len(plane) - 1) // 2
    return sum(taps[abs(tap)] * extended[4 + tap :][: 2 * count : 2] for tap in range(-3, 4))


def stretch_naive(plane, taps):
    """Interpolate along the first axis from n to 2 n + 1 pixels."""
    spread = np.zeros((2 * len(plane) + 13, *plane.shape[1:]))
    spread[1::2] = reflect(plane)
    middle = len(spread) // 2
    width = 2 * len(plane) + 1
    begin = middle - width // 2
    return sum(taps[abs(tap)] * spread[begin + tap :][:width] for tap in range(-3, 4))


def pyramid_naive(source, filters, coarsest_side, level=0):
    """Run the optimised pyramid on a plane whose sides are odd at every level.

    `filters` holds (down taps, up taps, weights) of the finest level and of the others.
    """
    if min(source.shape) < 2 * coarsest_side - 1:
        return solve_dirichlet(source)
    down, up, weights = filters[min(level, 1)]
    coarse = coarsen_naive(coarsen_naive(source, down).T, down).T
    answer = pyramid_naive(coarse, filters, coarsest_side, level + 1)
    image = stretch_naive(stretch_naive(answer, up).T, up).T
    for weight in weights:
        image = image + weight * (laplacian(image)[1:-1, 1:-1] - source)
    return image
