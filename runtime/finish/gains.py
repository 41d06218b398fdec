"""Gains by scales: what brings an image to noisy means, coarse to fine, as far as the noise lets it be believed.

At each scale the gain is that of least squares under a window; where gains are no larger than their own standard
errors they are drawn towards one (James and Stein 1961), so that noise does not enter. All is done on sums over blocks
of pixels, which are added up for the coarser scales.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from spreadlets.arrays import FloatArray

SCALES = (16, 8, 4, 2)
"""Standard deviations of the windows, px, and the sides of the blocks that stand for their pixels; halves each."""
BLOCK = SCALES[-1]
WINDOW = np.array((1.0, 4.0, 6.0, 4.0, 1.0), np.float32) / np.float32(16.0)
"""Weights of blocks along an axis: nearly a Gaussian window of standard deviation 1."""
FEW = 16.0
"""The square of a gain, less one, must exceed its variance to be believed at all; and twice that where no more pixels
than so many carry the noise around."""
SURROUNDINGS, LEAST_SURROUNDINGS = 4, 16
"""Gains and their variances are compared over windows so many times wider, and at least so many px: where few samples
carry the light, as under the bokeh of a small lamp, a window may hold none of them, and would look certain of being too
bright."""
WHOLE = SURROUNDINGS * SCALES[0] // BLOCK
"""Rows and columns of blocks are multiples of so many, so that all windows are of whole blocks."""
WIDEST = 6.0 * BLOCK
"""CoC radius, px, up to which gains of the finest scale are believed in full; beyond, in inverse proportion. What is
out of focus varies slowly: more is seen there of noise that few bright samples make than of any bias."""
LARGEST_GAIN = 4.0
TINY = np.float32(1e-37)


def block_counts(shape: tuple[int, ...]) -> tuple[int, int]:
    """Return the rows and columns of blocks that cover an image (H, W), see `WHOLE`."""
    rows, cols = (WHOLE * -(-size // (WHOLE * BLOCK)) for size in shape[:2])
    return rows, cols


def believed_gains(
    sums: FloatArray, scales: Sequence[int], radius: FloatArray | None = None, *, shared: bool = False
) -> FloatArray:
    """Return the gain of each block in each of some planes, (n, rows, cols).

    Parameters
    ----------
    sums : ndarray of shape (5, n, rows, cols), float32
        Over the pixels of a block: ``w y m``, ``w y y``, the square of their difference and its fourth power, and
        ``y``, with the value y of a pixel, the mean m that it should have, and its weight w.
    scales : sequence of int
        Of `SCALES`, those that are used.
    radius : ndarray of shape (rows, cols), float32, optional
        Mean CoC radius of the samples of each block, px, see `WIDEST`.
    shared : bool
        Whether the planes share out each pixel between them, so that the sum of their values stays what it is.
    """
    levels = [sums]
    for _ in SCALES[1:]:
        levels.append(_reduced(levels[-1], 2))
    gain = np.ones_like(levels[-1][0])
    for scale, (product, square, noise, fourth, value) in zip(SCALES, reversed(levels), strict=True):
        gain = gain if scale == SCALES[0] else _enlarged(gain, 2)
        if scale in scales:
            left = gain * (product - gain * square)
            change = _believed_change(left, gain * gain * square, noise, fourth, scale)
            if radius is not None and scale == BLOCK:
                change *= np.float32(WIDEST) / np.maximum(radius, np.float32(WIDEST))
            gain *= np.float32(1.0) + change
            np.clip(gain, 1.0 / LARGEST_GAIN, LARGEST_GAIN, out=gain)
            if shared:
                gain *= np.maximum(value.sum(axis=0), TINY) / np.maximum((gain * value).sum(axis=0), TINY)
    return np.asarray(gain, np.float32)


def _believed_change(
    part: FloatArray, square: FloatArray, noise: FloatArray, fourth: FloatArray, scale: int
) -> FloatArray:
    """Return by how much the gain of each block differs from one, as far as it is believed."""
    # Find the change of least squares under the window, and what its variance is by the spread of the parts.
    below = _windowed(square, WINDOW)
    below += max(np.float32(1e-12) * below.max(), TINY)
    change = _windowed(part, WINDOW) / below
    variance = _windowed(noise, WINDOW * WINDOW) / below
    # Compare both around, each window by how much it knows.
    factor = max(SURROUNDINGS * scale, LEAST_SURROUNDINGS) // scale
    power, error, noise, fourth = (_around(each, factor) for each in (below * change * change, variance, noise, fourth))
    # A mean of squares is as uncertain as its few largest make it.
    carrying = np.float32(2.0 * np.pi * factor**2) * noise * noise / np.maximum(fourth, TINY)
    doubt = np.float32(1.0) + np.minimum(np.sqrt(FEW / np.maximum(carrying, np.float32(FEW))), np.float32(1.0))
    believed = np.clip(1.0 - doubt * error / np.maximum(power, TINY), 0.0, 1.0).astype(np.float32)
    return np.asarray(change * _enlarged(believed, factor), np.float32)


def _around(planes: FloatArray, factor: int) -> FloatArray:
    """Return the means of planes over a window that is wider by a factor, one for so many blocks."""
    return _windowed(_reduced(planes, factor), WINDOW) / np.float32(factor**2)


def _reduced(planes: FloatArray, factor: int) -> FloatArray:
    """Return the sums of planes (..., rows, cols) over blocks of as many rows and columns, a power of 2."""
    while factor > 1:
        rows = planes[..., ::2, :] + planes[..., 1::2, :]
        planes, factor = rows[..., ::2] + rows[..., 1::2], factor // 2
    return planes


def _windowed(planes: FloatArray, weights: FloatArray) -> FloatArray:
    """Return the sums of planes (n, rows, cols) under a window; nothing lies beyond the border."""
    for _ in range(2):
        result = weights[2] * planes
        for k in (1, 2):
            part = weights[2 + k] * planes
            result[:, k:] += part[:, :-k]
            result[:, :-k] += part[:, k:]
        planes = result.swapaxes(1, 2)
    return planes


def _enlarged(planes: FloatArray, factor: int) -> FloatArray:
    """Return planes (n, rows, cols) with as many times the rows and columns, interpolated linearly."""
    for _ in range(2):
        size = planes.shape[1]
        padded = np.concatenate([planes[:, :1], planes, planes[:, -1:]], axis=1)
        result = np.empty((len(planes), factor * size, planes.shape[2]), np.float32)
        for k in range(factor):
            place = 1.0 + (k + 0.5) / factor - 0.5
            before, share = int(place), np.float32(place % 1.0)
            first, second = padded[:, before : before + size], padded[:, before + 1 : before + 1 + size]
            result[:, k::factor] = first + share * (second - first)
        planes = result.swapaxes(1, 2)
    return planes
