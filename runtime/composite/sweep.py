"""A disc swept along a path as a blur: exact in its outline, at the cost of one sum for each of its rows."""

from __future__ import annotations

import math

import numpy as np

from spreadlets.arrays import DoubleArray, Image, IntArray
from spreadlets.parallel import for_bands
from spreadlets.runtime.buffers import buffer
from spreadlets.runtime.composite import _sweep_kernels

FINEST_RADIUS = 8.0
"""Discs of up to twice this radius, px, are summed pixel by pixel; wider ones at half the size, and so on."""
COARSEST = 1 << 24
"""Largest side of the blocks, px: more than that of any image, which is one block then."""


def sweep_blur(image: Image, radius: float, path: tuple[float, float]) -> Image:
    """Blur an image by a disc swept along a path.

    Parameters
    ----------
    image : ndarray of shape (H, W), float32
        Values from 0 to 1, which are blurred to 1e-6; the border pixels repeat outside.
    radius : float
        Of the disc, px.
    path : tuple of two floats
        (dx, dy), px.

    Returns
    -------
    ndarray of shape (H, W), float32
    """
    factor = reduction(radius, path)
    return enlarged(reduced_blur(image, radius, path, factor), image.shape, factor)


def reduction(radius: float, path: tuple[float, float]) -> int:
    """Return the side, px, of the blocks whose means are blurred in place of pixels: a power of 2."""
    wide = max(radius, math.hypot(*path) / 2.0, 1.0)
    return min(COARSEST, 1 << max(0, math.floor(math.log2(wide / FINEST_RADIUS))))


def reduced_blur(image: Image, radius: float, path: tuple[float, float], factor: int) -> Image:
    """Return the blurred means of an image's blocks; arguments as for `sweep_blur` and from `reduction`."""
    if factor == 1:
        return _blurred(image, radius, path)
    small = np.empty([-(-size // factor) for size in image.shape], np.float32)
    for_bands(_sweep_kernels.shrink, len(small), image, factor, small)
    return _blurred(small, radius / factor, (path[0] / factor, path[1] / factor))


def enlarged(small: Image, shape: tuple[int, ...], factor: int) -> Image:
    """Return the image of a shape whose blocks have these means, interpolated linearly."""
    if factor == 1:
        return small
    image = buffer(shape)
    for_bands(_sweep_kernels.enlarge, len(image), small, factor, image)
    return image


def _blurred(image: Image, radius: float, path: tuple[float, float]) -> Image:
    """Blur an image pixel by pixel."""
    if image.size == 1:
        return image
    first, last = sweep_spans(radius, path)
    if len(first) == 1 and first[0] == last[0]:
        return image
    sums = buffer((image.shape[0], image.shape[1] + 1), np.int32)
    blurred = np.empty_like(image)
    for_bands(_sweep_kernels.sum_rows, len(sums), image, sums)
    for_bands(_sweep_kernels.sum_spans, len(image), sums, first, last, blurred)
    return blurred


def sweep_spans(radius: float, path: tuple[float, float]) -> tuple[IntArray, IntArray]:
    """Return the first and the last pixel of each row of a disc swept along a path, relative to its middle.

    Parameters
    ----------
    radius : float
        Px.
    path : tuple of two floats
        (dx, dy), px.

    Returns
    -------
    first, last : ndarray of shape (2 n + 1,), int64
        Of the rows -n to n; no row is empty.
    """
    radius = max(radius, 0.5)
    n = math.floor(radius + abs(path[1]) / 2.0)
    rows = np.arange(-n, n + 1)
    # The outline is that of the discs along the path; a step of a quarter of the radius leaves less than 1 % of it.
    steps = np.linspace(-0.5, 0.5, 2 + math.ceil(4.0 * math.hypot(*path) / radius))
    half = _half_chords(rows[:, None] - steps * path[1], radius)
    left, right = (steps * path[0] - half).min(axis=1), (steps * path[0] + half).max(axis=1)
    middle = np.rint((left + right) / 2.0)
    return np.minimum(np.ceil(left), middle).astype(np.int64), np.maximum(np.floor(right), middle).astype(np.int64)


def _half_chords(height: DoubleArray, radius: float) -> DoubleArray:
    """Return half the chord of a disc at heights from its middle; such that it leaves any span alone beyond it."""
    inside = np.abs(height) <= radius
    return np.where(inside, np.sqrt(np.maximum(radius**2 - height**2, 0.0)), -np.inf)
