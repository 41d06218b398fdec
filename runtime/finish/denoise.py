"""Denoisers of other projects, which know nothing of lens and shutter: optional packages, for comparison."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import Image
from spreadlets.errors import InvalidParameterError
from spreadlets.packages import optional_package
from spreadlets.runtime.report import Report

if TYPE_CHECKING:
    from spreadlets.runtime.clock import Clock


SHARP_WINDOW = 5
"""Side of the window, px, in which the share of sharp samples is taken."""

OUTLIERS = 5.0
"""How many deviations of the noise BM3D is told: what lens and shutter leave is mostly outliers, which it keeps
otherwise. On a part of a rendered frame with 4 samples in each pixel, 1 gave 22 dB and 5 gave 28 dB."""
LEAST_SIGMA = 1e-3
"""Least standard deviation of the noise that BM3D is told, on log(1 + radiance): it divides by it."""
LEAST_SIDE = 8
"""Side, px, of the blocks of BM3D: it takes no smaller image."""
OPPONENTS = np.array([[1, 1, 1], [1, 0, -1], [1, -2, 1]], np.float32).T
"""From RGB to the colours in which BM3D compares blocks, but for their scale."""


def noise_deviation(image: npt.NDArray[np.floating]) -> float:
    """Return the standard deviation of white noise in an image (H, W, C), from the diagonal differences of its pixels.

    A difference ``(a - b - c + d) / 2`` of four neighbours has the deviation of the noise, and hardly anything of a
    smooth image. The noise of a stochastic frame is strong in places and absent in others, so the mean square counts,
    not the median that is usual.
    """
    diagonal = 0.5 * (image[1:, 1:] - image[1:, :-1] - image[:-1, 1:] + image[:-1, :-1])
    return float(np.sqrt(np.mean(np.square(diagonal, dtype=np.float64)))) if diagonal.size else 0.0


def _bm3d(colour: Image) -> npt.NDArray[np.floating]:
    """Denoise linear colours (H, W, 3) with package bm3d, on log(1 + radiance)."""
    package = optional_package("bm3d", "bench", "method 'bm3d'")
    if min(colour.shape[:2]) < LEAST_SIDE:
        raise InvalidParameterError(
            f"method 'bm3d' is for {LEAST_SIDE} x {LEAST_SIDE} px and more: the image has {colour.shape[1]} x "
            f"{colour.shape[0]}"
        )
    shown = np.log1p(np.maximum(colour, 0))
    sigma = max(OUTLIERS * noise_deviation(shown), LEAST_SIGMA)
    if np.ptp(shown @ OPPONENTS, axis=(0, 1)).min() > 0.0:
        found = package.bm3d_rgb(shown, sigma)
    else:
        # It divides by the range of each opponent colour; grey has one.
        channels = [package.bm3d(each, sigma) if np.ptp(each) > 0.0 else each for each in np.moveaxis(shown, 2, 0)]
        found = np.stack(channels, axis=2)
    return np.asarray(np.maximum(np.expm1(found), 0.0))


def _oidn(colour: Image) -> npt.NDArray[np.floating]:
    """Denoise linear colours (H, W, 3) with Open Image Denoise, package pyoidn, colour only."""
    package = optional_package("pyoidn", "bench", "method 'oidn'")
    return np.asarray(package.denoise(np.ascontiguousarray(colour), hdr=True))


DENOISING: dict[str, Callable[[Image], npt.NDArray[np.floating]]] = {"bm3d": _bm3d, "oidn": _oidn}


def denoise_sharp(image: Image, sharp: Image, method: str) -> Image:
    """Denoise an image where it is sharp, which no splatting can clean: there, a sample stays in its pixel.

    Parameters
    ----------
    image : ndarray of shape (H, W, 4), float32
        Linear, premultiplied; alpha stays as it is.
    sharp : ndarray of shape (H, W), float32
        Share of each pixel's samples that are neither out of focus nor moving. From one half on, in the mean of a
        window, the denoised image comes in, up to the whole of it at 1.
    method : {"bm3d", "oidn"}
        See `denoise`.

    Returns
    -------
    ndarray of shape (H, W, 4), float32
    """
    from scipy import ndimage

    weight = np.clip(2.0 * ndimage.uniform_filter(sharp, SHARP_WINDOW, mode="nearest") - 1.0, 0.0, 1.0)[..., None]
    colour = image[..., :3]
    mixed = colour + weight * (DENOISING[method](colour) - colour)
    return np.concatenate([mixed.astype(np.float32), image[..., 3:]], axis=2)


def denoise(image: Image, method: str, clock: Clock) -> tuple[Image, Report]:
    """Denoise an image.

    Parameters
    ----------
    image : ndarray of shape (H, W, 4), float32
        Linear, premultiplied; alpha stays as it is.
    method : {"bm3d", "oidn"}
        BM3D (free for non-commercial use only), told `OUTLIERS` times the deviation of the image's noise; or Open
        Image Denoise.
    clock : Clock
        Where the time is added.

    Returns
    -------
    image : ndarray of shape (H, W, 4), float32
    report : Report

    Raises
    ------
    MissingPackageError
        If the package is not installed.
    """
    with clock.step("composite"):
        colour = DENOISING[method](image[..., :3])
        denoised = np.concatenate([colour.astype(np.float32), image[..., 3:]], axis=2)
    return denoised, Report.of(clock, {})
