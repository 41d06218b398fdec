"""A dense PSF made ready: checked, moved to the middle of its light, cropped to a box, its spike set apart."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import BoolArray, DoubleArray, IntArray
from spreadlets.errors import InvalidParameterError
from spreadlets.metrics import PSF_MARGIN_FRACTION, PSF_MARGIN_PX, PSF_SUPPORT_THRESHOLD

ROUNDING = 1e-9
"""Negative values up to this fraction of the peak count as zero."""

SPIKE = 3.0
"""A central pixel that is so many times brighter than any around it, and more, is set apart as a spike."""

THIN_RADIUS = 3.5
"""PSFs no wider than a disc of this radius, px, are drawn directly: their few rows of pixels are cheaper, and exact."""


def checked(psf: npt.ArrayLike) -> DoubleArray:
    """Return a PSF as an array (H, W, C) without negative values, or say why it is none."""
    dense = np.asarray(psf, dtype=np.float64)
    dense = dense[..., None] if dense.ndim == 2 else dense
    if dense.ndim != 3 or dense.shape[0] % 2 == 0 or dense.shape[1] % 2 == 0:
        raise InvalidParameterError(f"psf must have shape (H, W, C) with H and W odd, not {np.shape(psf)}")
    if not np.isfinite(dense).all() or not dense.max() > 0 or dense.min() < -ROUNDING * dense.max():
        raise InvalidParameterError("psf must be finite, non-negative and not zero everywhere")
    return np.maximum(dense, 0.0)


def offset_of_support(psf: DoubleArray) -> IntArray:
    """Return how far, in whole px, the middle of the light lies from the centre: an aberrated PSF is off its pixel."""
    place = np.argwhere((psf > 0).any(axis=2))
    middle = (place.min(axis=0) + place.max(axis=0)) // 2
    return np.asarray(middle - np.asarray(psf.shape[:2]) // 2, np.int64)


def moved(psf: DoubleArray, shift: IntArray) -> DoubleArray:
    """Move a PSF by whole pixels, on a window that grows with the shift."""
    if not shift.any():
        return psf
    padded = np.pad(psf, [(abs(int(n)), abs(int(n))) for n in shift] + [(0, 0)])
    return np.asarray(np.roll(padded, (int(shift[0]), int(shift[1])), axis=(0, 1)))


def on_box(psf: DoubleArray) -> DoubleArray:
    """Crop or pad a PSF, about its centre, to a box that holds all of it and where its similarity is measured."""
    centre = np.asarray(psf.shape[:2]) // 2
    reach = np.abs(np.argwhere((psf > 0).any(axis=2)) - centre).max(axis=0)
    rows, columns = (slice(c - r, c + r + 1) for c, r in zip(centre, reach, strict=True))
    cropped = psf[rows, columns]
    offset = np.argwhere(support(cropped)) - reach
    margin = np.maximum(PSF_MARGIN_PX, np.ceil(PSF_MARGIN_FRACTION * (np.ptp(offset, axis=0) + 1))).astype(np.int64)
    pad = np.maximum(np.abs(offset).max(axis=0) + margin - reach, 0)
    return np.pad(cropped, [(pad[0], pad[0]), (pad[1], pad[1]), (0, 0)])


def support(psf: DoubleArray) -> BoolArray:
    """Return the pixels (H, W) of a PSF (H, W, C) that count as its support."""
    return np.asarray((psf > PSF_SUPPORT_THRESHOLD * psf.max()).any(axis=2))


def width_radius(psf: DoubleArray) -> float:
    """Return the radius, px, of the disc that is as wide as the PSF where that is narrowest.

    It does not change when the PSF turns on the lattice or grows along its motion, so that all directions agree.
    """
    weight = psf.sum(axis=2) / psf.sum()
    offset = np.indices(weight.shape).reshape(2, -1)
    return 2.0 * float(np.sqrt(np.linalg.eigvalsh(np.cov(offset, aweights=weight.ravel(), ddof=0))[0]))


def split_spike(psf: DoubleArray) -> tuple[DoubleArray, DoubleArray]:
    """Take what a central pixel has above its neighbours off a PSF.

    Light that passes a medium unscattered stays in one pixel, a thousand times brighter than the rest. The similarity
    is relative to the peak, and would see nothing else, however much light there is around it.

    Parameters
    ----------
    psf : ndarray of shape (H, W, C), float64
        PSF, centred, odd sizes.

    Returns
    -------
    rest : ndarray of shape (H, W, C), float64
    spike : ndarray of shape (C,), float64
        What was taken off the central pixel: zero, unless that is more than `SPIKE` times as bright as any around it.
    """
    row, column = np.asarray(psf.shape[:2]) // 2
    if min(row, column) < 1:
        return psf, np.zeros(psf.shape[2])
    around = psf[row - 1 : row + 2, column - 1 : column + 2].copy()
    around[1, 1] = 0.0
    highest = around.max(axis=(0, 1))
    spike = psf[row, column] - highest
    if not (spike > SPIKE * highest).all() or not highest.max() > 0.0:
        return psf, np.zeros_like(spike)
    rest = psf.copy()
    rest[row, column] = highest
    # In a PSF of few pixels, a bright one is no spike but the PSF.
    if width_radius(rest) <= THIN_RADIUS:
        return psf, np.zeros_like(spike)
    return rest, spike
