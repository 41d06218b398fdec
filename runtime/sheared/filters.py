"""Filters for defocus, one per layer: sheared (SLR section 3) and axis-aligned (Mehta et al. 2012, as in SLR 7)."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import FloatArray

SIGMA_PIXEL = 0.5
"""Standard deviation of the pixel filter, px. SLR gives none; LRDM's 0.33 leaves more noise than it saves sharpness."""
REACH = 16
"""Radius of the largest screen filter, px: a width of 32 px (SLR section 6.3)."""
LARGEST_SIGMA = REACH / 2
"""Largest standard deviation along x, px: a quarter of the largest filter's width (SLR section 6.3)."""
AXIS_ALIGNED_SHARE = 0.5
"""1 / k of Mehta et al., with SLR's k = 2: preserves the tail of the lens's spectrum."""

ENOUGH = 300.0
"""Samples that a screen filter is to hold: ``4 pi screen^2`` px hold what a Gaussian's mean amounts to. Between 100 and
no limit at all, the three frames of `benchmarks/sheared.py` differ by less than a decibel."""

Aperture = Literal["disc", "gaussian"]
APERTURES: tuple[Aperture, ...] = ("disc", "gaussian")
SIGMA_LENS = {"disc": 0.5, "gaussian": 1.0 / 3.0}
"""Standard deviation of the aperture along u, in radii: of a uniform disc; of SLR's Gaussian, cut at three of them."""

Array = npt.NDArray[np.float64]


class Filters(NamedTuple):
    """The filters of L layers: ``w(x - shear * u; screen) * w(u; lens)``, and the same in (y, v).

    Attributes
    ----------
    shear : ndarray of shape (L,), float32
        eta of SLR Eq. 23, px per lens radius: a sample is reprojected to ``place - shear * lens``.
    screen : ndarray of shape (L,), float32
        Standard deviation of the screen filter, px.
    lens : ndarray of shape (L,), float32
        Standard deviation of the weight of a sample over the lens, in radii; infinite if all weigh the same.
    """

    shear: FloatArray
    screen: FloatArray
    lens: FloatArray


def sheared_filters(
    near: npt.ArrayLike,
    far: npt.ArrayLike,
    sigma_lens: float,
    sigma_pixel: float = SIGMA_PIXEL,
    largest: float = LARGEST_SIGMA,
) -> Filters:
    """Set up the filter of each layer for a Gaussian aperture.

    Parameters
    ----------
    near, far : array_like of shape (L,)
        Range of the signed CoC radius, px; not empty.
    sigma_lens : float
        Standard deviation of the aperture, in lens radii.
    sigma_pixel : float
        Standard deviation of the pixel filter, px.
    largest : float
        Clamp of the standard deviation along x, px.

    Returns
    -------
    Filters

    Notes
    -----
    SLR sections 3.3 to 3.6. The three cases are the standard filter, whose axes are transformed (Eqs. 12 to 23); small
    shears (Eqs. 26 to 29); and the simple filter for wide wedges (Eq. 11). The wedge also counts as wide where it does
    not cross focus but the parallelogram around it is wider than the pixel filter's band: at ``c_min = 0`` it would be
    infinitely wide. The clamp is that of sigma_x before the transform: whatever sigma_x, the filter has the blur of the
    aperture, so a smaller one loses samples, but nothing else.
    """
    c_near, c_far = np.asarray(near, np.float64), np.asarray(far, np.float64)
    largest_coc = np.maximum(np.abs(c_near), np.abs(c_far))
    small = largest_coc < sigma_pixel / sigma_lens
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = 2.0 / (1.0 / c_near + 1.0 / c_far)  # Eq. 13, also where c_far is infinite
        width = np.abs(1.0 / c_near - 1.0 / c_far) / (2.0 * np.pi * sigma_lens)  # Eq. 12
        sigma_x = np.minimum(1.0 / (np.pi * width), largest)  # Eq. 16
    wide = ~small & ((c_near * c_far <= 0.0) | (sigma_x < sigma_pixel))
    slope = np.where(small | wide, 1.0, slope)
    gamma = np.hypot(sigma_lens, sigma_x / slope)
    shear = sigma_x**2 / (slope * gamma**2)  # Eq. 22
    screen = np.where(small | wide, sigma_pixel, sigma_x * sigma_lens / gamma)
    shear = np.select([small, wide], [0.5 * (c_near + c_far), 0.0], shear)  # Eq. 27
    lens = np.select([small, wide], [2.0 * sigma_pixel / (c_far - c_near), sigma_lens], gamma)  # Eq. 29
    return _filters(shear, screen, lens)


def axis_aligned_filters(
    near: npt.ArrayLike,
    far: npt.ArrayLike,
    sigma_lens: float,
    sigma_pixel: float = SIGMA_PIXEL,
    largest: float = LARGEST_SIGMA,
) -> Filters:
    """Set up the filter of each layer without a shear; parameters as for `sheared_filters`.

    Notes
    -----
    Mehta et al. 2012: the band along x ends at that of the pixel filter or of the aperture over the least CoC,
    whichever is less (SLR section 3.7), scaled by 1 / k (SLR section 7). Samples are integrated over the lens as it is.
    """
    c_near, c_far = np.asarray(near, np.float64), np.asarray(far, np.float64)
    least_coc = np.where(c_near * c_far <= 0.0, 0.0, np.minimum(np.abs(c_near), np.abs(c_far)))
    screen = np.clip(AXIS_ALIGNED_SHARE * sigma_lens * least_coc, sigma_pixel, largest)
    return _filters(np.zeros_like(screen), screen, np.full_like(screen, sigma_lens))


def with_uniform_lens(
    filters: Filters,
    near: npt.ArrayLike,
    far: npt.ArrayLike,
    samples_per_pixel: float,
    sigma_pixel: float = SIGMA_PIXEL,
) -> Filters:
    """Return filters for samples spread evenly over a round aperture, which all weigh the same.

    Parameters
    ----------
    filters : Filters
        Set up for a Gaussian of the disc's variance, ``SIGMA_LENS["disc"]``.
    near, far : array_like of shape (L,)
        Range of CoC that they were set up for.
    samples_per_pixel : float
        > 0.
    sigma_pixel : float
        Standard deviation of the pixel filter, px.

    Returns
    -------
    Filters

    Notes
    -----
    This is ours. The weights that the sheared filter asks for are wider than the aperture, and samples end at its rim:
    with them, and more so with weights of the aperture's own width, the blur would be narrower than the disc's. All
    samples weigh the same instead, and the shear is what gives the blur of the layer's slope its variance,
    ``screen^2 + (slope - shear)^2 / 4 = slope^2 / 4``, with the variance of the screen filter as it is cut. What the
    shear leaves of the disc keeps its shape, so the screen filter is no wider than it takes to hold `ENOUGH` samples,
    or than the axis-aligned one. The pixel filter is added, as LRDM does: SLR has none where the lens blurs by more
    than a pixel, and leaves the grain of single samples there. A layer that touches focus is not reprojected: its
    range is known to half a pixel, and what is sharp in it would be moved by up to a quarter.
    """
    c_near, c_far = np.asarray(near, np.float64), np.asarray(far, np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = np.where(c_near * c_far > 0.0, 2.0 / (1.0 / c_near + 1.0 / c_far), 0.0)
    shear = np.where(slope != 0.0, filters.shear, 0.0)
    own = np.abs(slope) * SIGMA_LENS["disc"]
    transformed = (filters.shear != 0.0) & (filters.screen < own)
    enough = np.sqrt(ENOUGH / (4.0 * np.pi * samples_per_pixel))
    screen = np.minimum(filters.screen.astype(np.float64), np.maximum(AXIS_ALIGNED_SHARE * own, enough))
    with_pixel = np.hypot(screen, sigma_pixel)
    by_screen = cut_variance(with_pixel) - sigma_pixel**2
    rest = np.sqrt(np.maximum(own**2 - by_screen, 0.0)) / SIGMA_LENS["disc"]
    shear = np.where(transformed, np.sign(slope) * (np.abs(slope) - rest), shear)
    return _filters(shear, np.where(transformed, with_pixel, filters.screen), np.full(shear.shape, np.inf))


def cut_variance(sigma: Array) -> Array:
    """Return the variance of Gaussians (L,) as they are drawn: at whole pixels, up to three sigma or `REACH`, px^2."""
    offset = np.arange(-REACH, REACH + 1.0)[:, None]
    weight = np.exp(-0.5 * (offset / sigma) ** 2) * (np.abs(offset) <= np.ceil(3.0 * sigma))
    return np.asarray((weight * offset**2).sum(axis=0) / weight.sum(axis=0))


def _filters(shear: Array, screen: npt.NDArray[np.floating], lens: Array) -> Filters:
    return Filters(shear.astype(np.float32), screen.astype(np.float32), lens.astype(np.float32))
