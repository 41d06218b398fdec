"""Depth maps as networks and stereo give them: of another size, with holes, with edges beside those of the image."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

from spreadlets.arrays import BoolArray, FloatArray
from spreadlets.errors import InvalidFrameError, InvalidParameterError, option
from spreadlets.parallel import for_bands
from spreadlets.photograph import _refine_kernels

DepthKind = Literal["inverse", "metric", "disparity"]

STRAY_SHARE = 0.002
"""Share of the pixels at either end of the range of depths that may be stray."""
ASPECT_TOLERANCE = 0.03
"""How far the shape of a map may be from that of the image."""
REFINE_SHARE = 1 / 250
"""Half-width of what is looked at for a pixel's depth, as a share of the longer side; networks are that imprecise."""
LEAST_HALF = 5
MOST_SAMPLES = 11
"""Pixels that are looked at along a side of it, at most."""
LEAST_EDGE = 0.03
"""Difference of inverse depth, as a share of its range, from which there is an edge."""
LIKE_COLOUR = 0.06
"""Difference of colour, as displayed, at which a pixel's depth counts a quarter."""
ROUNDS = 2


def inverse_depth(values: FloatArray, kind: DepthKind, shape: tuple[int, int]) -> tuple[FloatArray, float, float]:
    """Return a depth map as inverse depth without holes, from 0 (farthest) to 1 (nearest), and what these stand for.

    Parameters
    ----------
    values : ndarray of shape (h, w), float32
        Inverse depth or disparity, whose scale and offset are unknown, larger is nearer; or metres. What is not finite,
        and depths and disparities that are not above 0, are holes.
    kind : {"inverse", "metric", "disparity"}
    shape : tuple of int
        Of the image; a map of another size is stretched.

    Returns
    -------
    ndarray of shape (H, W), float32
    least, most : float
        Inverse depths that are 0 and 1: in 1/m if the kind is metric.

    Raises
    ------
    InvalidParameterError
        If there is no such kind.
    InvalidFrameError
        If the map's proportions are not the image's, or it has not two depths.
    """
    if kind not in get_args(DepthKind):
        raise InvalidParameterError(f"{option('depth_kind')} is {kind!r}: allowed are {', '.join(get_args(DepthKind))}")
    ratio = (values.shape[0] / values.shape[1]) / (shape[0] / shape[1])
    if abs(ratio - 1.0) > ASPECT_TOLERANCE:
        raise InvalidFrameError(
            f"the depth map has {values.shape[1]} x {values.shape[0]} px, the image {shape[1]} x {shape[0]}: their "
            "proportions differ; was one of them turned?"
        )
    with np.errstate(divide="ignore"):
        inverse = 1.0 / values if kind == "metric" else values
    known = np.isfinite(values) & (np.isfinite(inverse)) & ((values > 0.0) | (kind == "inverse"))
    if kind == "metric":
        # The sky is infinitely far.
        known |= values == np.inf
    if not known.any():
        raise InvalidFrameError("the depth map holds no valid value")
    least, most = (float(each) for each in np.quantile(inverse[known], [STRAY_SHARE, 1.0 - STRAY_SHARE]))
    if not most > least:
        raise InvalidFrameError(f"the depth map is {least:g} everywhere: nothing lies before anything else")
    share = np.clip((filled(inverse, known) - least) / (most - least), 0.0, 1.0).astype(np.float32)
    return stretched(share, shape), least, most


def filled(values: FloatArray, known: BoolArray) -> FloatArray:
    """Return values with those of the nearest known pixel in the holes."""
    if known.all():
        return values
    from scipy.ndimage import distance_transform_edt

    rows, cols = distance_transform_edt(~known, return_distances=False, return_indices=True)
    return np.asarray(values[rows, cols], np.float32)


def stretched(values: FloatArray, shape: tuple[int, int]) -> FloatArray:
    """Return a map at another size, linear between its pixels."""
    if values.shape == shape:
        return np.ascontiguousarray(values, np.float32)
    from PIL import Image

    image = Image.fromarray(np.ascontiguousarray(values, np.float32))
    return np.asarray(image.resize(shape[::-1], Image.Resampling.BILINEAR), np.float32)


def refined(inverse: FloatArray, image: FloatArray) -> FloatArray:
    """Return a depth map whose edges lie where the image's do.

    Parameters
    ----------
    inverse : ndarray of shape (H, W), float32
        From 0 to 1.
    image : ndarray of shape (H, W, 3), float32
        As displayed, from 0 to 1.

    Returns
    -------
    ndarray of shape (H, W), float32

    Notes
    -----
    A weighted median (Ma et al. 2013, "Constant time weighted median filtering for stereo matching and beyond"), near
    the edges only: it makes no depths between two surfaces, as a mean would.
    """
    from scipy.ndimage import maximum_filter, minimum_filter

    half = max(LEAST_HALF, round(REFINE_SHARE * max(inverse.shape)))
    window = half, max(1, -(-(2 * half + 1) // MOST_SAMPLES))
    for _ in range(ROUNDS):
        low, high = (each(inverse, 2 * half + 1) for each in (minimum_filter, maximum_filter))
        high = np.where(high - low < LEAST_EDGE, low, high)
        found = np.empty_like(inverse)
        for_bands(_refine_kernels.weighted_medians, len(found), inverse, image, low, high, window, LIKE_COLOUR, found)
        inverse = found
    return inverse
