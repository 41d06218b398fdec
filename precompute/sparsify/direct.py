"""Direct spreadlets: a PSF's own pixels, where its Laplacian is not sparse (LKS section 6.4)."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import BoolArray, DoubleArray, IntArray
from spreadlets.psf.spreadlet import Spreadlet

DIRECT_THRESHOLDS = (1e-4, 1e-3, 2e-3, 3e-3, 5e-3, 1e-2, 2e-2)
"""Fractions of the peak below which a direct spreadlet may leave out pixels; the best by price is taken. If it left out
more of the faint pixels along its rim, a small disc would keep its size from one cell to the next, and then jump."""

MAX_LEFT_OUT = 0.1
"""Share of a channel's light that those pixels may hold, save at the least fraction: an aberrated PSF has a bright
core, and around it a veil of half its light that the similarity, relative to the peak, hardly sees."""

DIRECT_BITS = 13
"""Direct values are rounded to the peak's power of two divided by 2 to this power: a third of the file is saved, and
no display shows more than 12 bits."""


def direct_choices(psf: DoubleArray) -> Iterator[BoolArray]:
    """Yield which pixels (H, W) of a PSF (H, W, C) a direct spreadlet may keep: all of its support, then fewer."""
    for least in DIRECT_THRESHOLDS:
        kept = (psf > least * psf.max()).any(axis=2)
        if least > DIRECT_THRESHOLDS[0] and (psf[~kept].sum(axis=0) > MAX_LEFT_OUT * psf.sum(axis=(0, 1))).any():
            return
        yield kept


def direct_spreadlet(psf: DoubleArray, kept: BoolArray) -> Spreadlet:
    """Keep some of the pixels of a PSF (H, W, C), scaled to keep each channel's energy."""
    pixel = np.argwhere(kept)
    value = psf[pixel[:, 0], pixel[:, 1]]
    sums = value.sum(axis=0)
    value = value * np.divide(psf.sum(axis=(0, 1)), sums, out=np.zeros_like(sums), where=sums > 0)
    offset = pixel - np.asarray(psf.shape[:2]) // 2
    return Spreadlet(offset.astype(np.int16), round_direct(offset, value), direct=True)


def round_direct(offset_rc: IntArray, value: DoubleArray) -> npt.NDArray[np.float32]:
    """Round pixels to few bits, which compress well, keeping each channel's sum.

    Parameters
    ----------
    offset_rc : ndarray of shape (n, 2), int64
        Offsets from the centre, in the order in which each pixel's rounding error passes on to the next: a plateau
        keeps its mean.
    value : ndarray of shape (n, C), float64
        Non-negative values.

    Returns
    -------
    ndarray of shape (n, C), float32
        Multiples of a power of two per channel, less than one of them from ``value``; the pixel nearest to the centre
        takes up the rest of the sum, less than half of one.
    """
    step = np.exp2(np.ceil(np.log2(np.maximum(value.max(axis=0), np.finfo(np.float32).tiny))) - DIRECT_BITS)
    total = np.cumsum(value, axis=0)
    rounded = np.diff(np.rint(total / step), axis=0, prepend=0.0) * step
    rounded[np.argmin((offset_rc**2).sum(axis=1))] += total[-1] - rounded.sum(axis=0)
    return np.asarray(rounded, dtype=np.float32)
