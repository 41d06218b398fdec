"""Image and PSF errors, each defined once: SSIM, PSNR, FLIP, relMSE, mean absolute error, and the PSF similarity."""

from __future__ import annotations

import math
import warnings
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter

from spreadlets.arrays import FloatArray
from spreadlets.errors import InvalidFrameError, MissingPackageError
from spreadlets.packages import optional_package
from spreadlets.scene.display import display_encode
from spreadlets.scene.frame import check_finite, shown_array

SSIM_SIGMA_PX = 1.5
SSIM_WINDOW_PX = 11
"""The SSIM of Wang et al. 2004: a Gaussian window of this deviation and side; a smaller image has no SSIM."""

SSIM_C1, SSIM_C2 = 0.01**2, 0.03**2
"""Its constants for values in [0, 1], which keep dark and flat windows from dividing by zero."""

RELMSE_EPSILON = 0.01
"""Added to the squared reference in relMSE, so that black pixels do not decide the figure."""

PSF_SUPPORT_THRESHOLD = 1e-4
"""Pixels above this fraction of the peak are a PSF's support."""

PSF_MARGIN_PX = 8
PSF_MARGIN_FRACTION = 0.25
"""A PSF's box grows on each side by the greater of the two, so that errors outside the support count."""


def ssim(image: npt.ArrayLike, reference: npt.ArrayLike) -> float:
    """Return the mean structural similarity of the display-encoded colours; 1 for equal images.

    Parameters
    ----------
    image, reference : array_like of shape (H, W, 3) or (H, W, 4)
        Linear radiance, or sRGB of 8- or 16-bit integers, at least 11 px on each side; alpha is ignored.

    Raises
    ------
    InvalidFrameError
        If a shape is wrong, the sizes differ, an image is too small for the window, or a value is not finite.

    Notes
    -----
    Wang et al. 2004, with population covariance, mean over the three channels; the value of scikit-image's
    ``structural_similarity`` with ``gaussian_weights=True, use_sample_covariance=False, data_range=1``.

    Examples
    --------
    >>> import numpy as np
    >>> image, reference = np.full((12, 12, 3), 0.7), np.full((12, 12, 3), 0.5)
    >>> round(sp.metrics.ssim(image, reference), 4)
    0.9889
    """
    return _ssim(*_colours(image, reference))


def psnr(image: npt.ArrayLike, reference: npt.ArrayLike) -> float:
    """Return the peak signal-to-noise ratio of the display-encoded colours in dB; ``inf`` for equal images.

    Parameters
    ----------
    image, reference : array_like of shape (H, W, 3) or (H, W, 4)
        Linear radiance, or sRGB of 8- or 16-bit integers; alpha is ignored.

    Raises
    ------
    InvalidFrameError
        If a shape is wrong, the sizes differ, or a value is not finite.

    Examples
    --------
    >>> import numpy as np
    >>> image, reference = np.full((12, 12, 3), 0.7), np.full((12, 12, 3), 0.5)
    >>> round(sp.metrics.psnr(image, reference), 2)
    18.49
    """
    return _psnr(*_colours(image, reference))


def flip(image: npt.ArrayLike, reference: npt.ArrayLike) -> float:
    """Return the mean LDR-FLIP error of the display-encoded colours, 0 to 1; 0 for equal images.

    Parameters
    ----------
    image, reference : array_like of shape (H, W, 3) or (H, W, 4)
        Linear radiance, or sRGB of 8- or 16-bit integers; alpha is ignored.

    Raises
    ------
    InvalidFrameError
        If a shape is wrong, the sizes differ, or a value is not finite.
    MissingPackageError
        If the package flip-evaluator is not installed (extra ``metrics``).

    Notes
    -----
    The flip-evaluator's default viewing distance, 67 px per degree.

    Examples
    --------
    >>> import numpy as np
    >>> image, reference = np.full((12, 12, 3), 0.7), np.full((12, 12, 3), 0.5)
    >>> 0 < sp.metrics.flip(image, reference) < 1
    True
    """
    return _flip(*_colours(image, reference))


def relmse(image: npt.ArrayLike, reference: npt.ArrayLike) -> float:
    """Return the relative mean square error of the linear colours, ``mean((x - r)^2 / (r^2 + 0.01))``.

    Parameters
    ----------
    image, reference : array_like of shape (H, W, 3) or (H, W, 4)
        Linear radiance, or sRGB of 8- or 16-bit integers; alpha is ignored.

    Raises
    ------
    InvalidFrameError
        If a shape is wrong, the sizes differ, or a value is not finite.

    Examples
    --------
    >>> import numpy as np
    >>> image, reference = np.full((12, 12, 3), 0.7), np.full((12, 12, 3), 0.5)
    >>> round(sp.metrics.relmse(image, reference), 4)
    0.1538
    """
    return _relmse(*_colours(image, reference))


def mae(image: npt.ArrayLike, reference: npt.ArrayLike) -> float:
    """Return the mean absolute error of the linear colours.

    Parameters
    ----------
    image, reference : array_like of shape (H, W, 3) or (H, W, 4)
        Linear radiance, or sRGB of 8- or 16-bit integers; alpha is ignored.

    Raises
    ------
    InvalidFrameError
        If a shape is wrong, the sizes differ, or a value is not finite.

    Examples
    --------
    >>> import numpy as np
    >>> image, reference = np.full((12, 12, 3), 0.7), np.full((12, 12, 3), 0.5)
    >>> round(sp.metrics.mae(image, reference), 4)
    0.2
    """
    return _mae(*_colours(image, reference))


def compare(image: npt.ArrayLike, reference: npt.ArrayLike) -> dict[str, float]:
    """Return every image metric of an image against its reference.

    Parameters
    ----------
    image, reference : array_like of shape (H, W, 3) or (H, W, 4)
        Linear radiance, or sRGB of 8- or 16-bit integers, at least 11 px on each side; alpha is ignored.

    Returns
    -------
    dict
        ``ssim``, ``psnr`` (dB; ``inf`` for equal images, which JSON cannot hold), ``flip``, ``relmse`` and ``mae``.
        Without the package flip-evaluator (extra ``metrics``) ``flip`` is NaN, and a warning says so.

    Raises
    ------
    InvalidFrameError
        If a shape is wrong, the sizes differ, an image is too small, or a value is not finite.

    Examples
    --------
    >>> import numpy as np
    >>> image, reference = np.full((12, 12, 3), 0.7), np.full((12, 12, 3), 0.5)
    >>> list(sp.metrics.compare(image, reference))
    ['ssim', 'psnr', 'flip', 'relmse', 'mae']
    """
    pair = _colours(image, reference)
    return {
        "ssim": _ssim(*pair),
        "psnr": _psnr(*pair),
        "flip": _flip_if_installed(*pair),
        "relmse": _relmse(*pair),
        "mae": _mae(*pair),
    }


def psf_similarity(psf: npt.ArrayLike, reconstruction: npt.ArrayLike) -> float:
    """Return the structural similarity of a reconstructed PSF over the PSF's bounding box and a margin.

    Parameters
    ----------
    psf : array_like of shape (h, w) or (h, w, C)
        The true PSF, non-negative, not all zero, on a window that holds its support.
    reconstruction : array_like of the same shape
        Its reconstruction on the same window, which may reach beyond the PSF's box.

    Returns
    -------
    float
        1 for equal arrays; the mean over channels.

    Raises
    ------
    InvalidFrameError
        If the shapes differ, a value is not finite, or the PSF has no positive value.

    Notes
    -----
    Both arrays are divided by the true PSF's peak (over all channels). The box of the pixels above 1e-4 of the peak
    grows on each side by the greater of 8 px and a quarter of that axis' length; the arrays count as zero outside.

    Examples
    --------
    >>> import numpy as np
    >>> y, x = np.mgrid[-8:9, -8:9]
    >>> disc, wider = ((x**2 + y**2 <= radius**2) * 1.0 for radius in (5.0, 5.5))
    >>> sp.metrics.psf_similarity(disc, disc), 0.5 < sp.metrics.psf_similarity(disc, wider) < 1
    (1.0, True)
    """
    true, approximate = _psf_pair(psf, reconstruction)
    peak = true.max()
    if not peak > 0:
        raise InvalidFrameError("psf has no positive value; its peak must be > 0")
    box = _grown_support(true / peak)
    return _structural_similarity(*(_crop_zero_padded(array / peak, box) for array in (true, approximate)))


def psf_l1(psf: npt.ArrayLike, reconstruction: npt.ArrayLike) -> float:
    """Return the relative L1 error of a reconstructed PSF, ``sum |u - f| / sum f`` over window and channels.

    Parameters
    ----------
    psf, reconstruction : array_like of the same shape (h, w) or (h, w, C)
        The true PSF ``f``, of positive sum, and its reconstruction ``u``.

    Raises
    ------
    InvalidFrameError
        If the shapes differ, a value is not finite, or the PSF's sum is not positive.

    Examples
    --------
    >>> import numpy as np
    >>> y, x = np.mgrid[-8:9, -8:9]
    >>> disc, wider = ((x**2 + y**2 <= radius**2) * 1.0 for radius in (5.0, 5.5))
    >>> round(sp.metrics.psf_l1(disc, wider), 3)
    0.198
    """
    true, approximate = _psf_pair(psf, reconstruction)
    total = float(true.sum())
    if not total > 0:
        raise InvalidFrameError(f"psf sums to {total:g}; it must be > 0")
    return float(np.abs(approximate - true).sum()) / total


def _colours(image: npt.ArrayLike, reference: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return the checked RGB of both images, (H, W, 3) float32."""
    pair = shown_array("image", image), shown_array("reference", reference)
    if pair[0].shape[:2] != pair[1].shape[:2]:
        raise InvalidFrameError(
            f"image is {pair[0].shape[0]} x {pair[0].shape[1]} px, but reference is "
            f"{pair[1].shape[0]} x {pair[1].shape[1]} px; they must agree"
        )
    for name, array in zip(("image", "reference"), pair, strict=True):
        check_finite(name, array[..., :3])
    return np.ascontiguousarray(pair[0][..., :3]), np.ascontiguousarray(pair[1][..., :3])


def _ssim(image: FloatArray, reference: FloatArray) -> float:
    if min(image.shape[:2]) < SSIM_WINDOW_PX:
        raise InvalidFrameError(
            f"the images are {image.shape[0]} x {image.shape[1]} px; SSIM needs {SSIM_WINDOW_PX} px on each side"
        )
    return _structural_similarity(display_encode(image), display_encode(reference))


def _structural_similarity(image: npt.NDArray[np.floating[Any]], reference: npt.NDArray[np.floating[Any]]) -> float:
    """Return the mean SSIM of two (H, W, C) arrays of values in [0, 1]."""
    x, y = np.asarray(image), np.asarray(reference)
    # Gaussian means, variances and covariance of every pixel's window, channel by channel
    mean_x, mean_y, mean_xx, mean_yy, mean_xy = (_window_mean(array) for array in (x, y, x * x, y * y, x * y))
    variances = (mean_xx - mean_x * mean_x) + (mean_yy - mean_y * mean_y)
    covariance = mean_xy - mean_x * mean_y
    # Wang et al. 2004, Eq. 13
    luminance = (2 * mean_x * mean_y + SSIM_C1) / (mean_x**2 + mean_y**2 + SSIM_C1)
    similarity = luminance * (2 * covariance + SSIM_C2) / (variances + SSIM_C2)
    # Windows that reach over the border do not count
    margin = SSIM_WINDOW_PX // 2
    return float(similarity[margin:-margin, margin:-margin].mean(dtype=np.float64))


def _window_mean(values: npt.NDArray[np.floating[Any]]) -> npt.NDArray[np.floating[Any]]:
    """Return the weighted means of an (H, W, C) array over every pixel's window."""
    means: npt.NDArray[np.floating[Any]] = gaussian_filter(
        values, SSIM_SIGMA_PX, radius=SSIM_WINDOW_PX // 2, axes=(0, 1)
    )
    return means


def _psnr(image: FloatArray, reference: FloatArray) -> float:
    difference = display_encode(image).astype(np.float64) - display_encode(reference)
    mean_square = float(np.mean(difference**2))
    return -10 * math.log10(mean_square) if mean_square > 0 else math.inf


def _flip(image: FloatArray, reference: FloatArray) -> float:
    evaluator = optional_package("flip_evaluator", "metrics", "FLIP")
    _, mean, _ = evaluator.evaluate(display_encode(reference), display_encode(image), "LDR", applyMagma=False)
    return float(mean)


def _flip_if_installed(image: FloatArray, reference: FloatArray) -> float:
    """Return FLIP, or NaN with a warning that says how to have it."""
    try:
        return _flip(image, reference)
    except MissingPackageError as error:
        warnings.warn(str(error), stacklevel=3)
        return math.nan


def _relmse(image: FloatArray, reference: FloatArray) -> float:
    x, r = image.astype(np.float64), reference.astype(np.float64)
    return float(np.mean((x - r) ** 2 / (r**2 + RELMSE_EPSILON)))


def _mae(image: FloatArray, reference: FloatArray) -> float:
    return float(np.mean(np.abs(image.astype(np.float64) - reference)))


def _psf_pair(psf: npt.ArrayLike, reconstruction: npt.ArrayLike) -> tuple[npt.NDArray[np.float64], ...]:
    """Return both arrays as (h, w, C) float64 of one shape with finite values."""
    pair = np.asarray(psf, dtype=np.float64), np.asarray(reconstruction, dtype=np.float64)
    if pair[0].shape != pair[1].shape or pair[0].ndim not in (2, 3) or pair[0].size == 0:
        raise InvalidFrameError(
            f"psf has shape {pair[0].shape} and reconstruction {pair[1].shape}; "
            "both must be (h, w) or (h, w, C), equal and not empty"
        )
    for name, array in zip(("psf", "reconstruction"), pair, strict=True):
        if not np.isfinite(array).all():
            raise InvalidFrameError(f"{name} has values that are not finite")
    return tuple(array.reshape(array.shape[0], array.shape[1], -1) for array in pair)


def _grown_support(psf: npt.NDArray[np.float64]) -> tuple[tuple[int, int], tuple[int, int]]:
    """Return ((first row, end row), (first column, end column)) of the grown box; it may leave the array."""
    support = (psf > PSF_SUPPORT_THRESHOLD).any(axis=2)
    ranges = []
    for axis in (0, 1):
        occupied = np.nonzero(support)[axis]
        first, end = int(occupied.min()), int(occupied.max()) + 1
        margin = max(PSF_MARGIN_PX, math.ceil(PSF_MARGIN_FRACTION * (end - first)))
        ranges.append((first - margin, end + margin))
    return ranges[0], ranges[1]


def _crop_zero_padded(
    array: npt.NDArray[np.float64], box: tuple[tuple[int, int], tuple[int, int]]
) -> npt.NDArray[np.float64]:
    """Return the part of an (h, w, C) array in a box that may leave it, with zeros outside the array."""
    (top, bottom), (left, right) = box
    window = np.zeros((bottom - top, right - left, array.shape[2]))
    inside = array[max(top, 0) : max(bottom, 0), max(left, 0) : max(right, 0)]
    row, col = max(-top, 0), max(-left, 0)
    window[row : row + inside.shape[0], col : col + inside.shape[1]] = inside
    return window
