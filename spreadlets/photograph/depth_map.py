"""Depth maps as networks and stereo give them: of another size, with holes, with edges beside those of the image."""

from __future__ import annotations

from functools import reduce
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
EXACT_HALF = 8
"""Up to this half-width, px, what lies around a pixel is found to the pixel; farther around, by blocks."""
MOST_SAMPLES = 11
"""Pixels that are looked at along a side of it, at most."""
LEAST_EDGE = 0.03
"""Difference of inverse depth, as a share of its range, from which there is an edge."""
LIKE_COLOUR = 0.06
"""Difference of colour, as displayed, at which a pixel's depth counts a quarter."""
ROUNDS = 2
SHARP = 0.5
"""Share of the range of depths around a pixel that one step between neighbours has where edges are sharp already."""
STEEP = 1.4
"""Where depths around a pixel differ at most so many times as much in twice the width, there is a step between two
surfaces; a slope goes on, and differs twice as much, or half as much again where it ends."""


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
        If the map is no plane, its proportions are not the image's, or it has not two depths.
    """
    if kind not in get_args(DepthKind):
        raise InvalidParameterError(f"{option('depth_kind')} is {kind!r}: allowed are {', '.join(get_args(DepthKind))}")
    if values.ndim != 2 or not values.size:
        raise InvalidFrameError(f"depth has shape {values.shape}; it must be (h, w)")
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


def sharpened(inverse: FloatArray, half: int) -> FloatArray:
    """Return a depth map whose soft edges are steps: networks predict few pixels, and smooth ones.

    Parameters
    ----------
    inverse : ndarray of shape (H, W), float32
        From 0 to 1.
    half : int
        Px from the middle of an edge to where its ramp ends, at most.

    Returns
    -------
    ndarray of shape (H, W), float32
        Slopes, and edges that are sharp, stay as they are.
    """
    side = _block_side(half)
    (low, high), (farther_low, farther_high) = _range(inverse, half, side), _range(inverse, 2 * half, side)
    is_step = (high - low >= LEAST_EDGE) & (farther_high - farther_low <= STEEP * (high - low))
    is_soft = _largest_step(inverse, half, side) < SHARP * (high - low)
    high, found = np.where(is_step & is_soft, high, low), np.empty_like(inverse)
    for_bands(_refine_kernels.end_ramps, len(found), inverse, low, high, side, _window(half), found)
    return found


def _block_side(half: int) -> int:
    """Return the side, px, of the blocks of pixels that share what lies around them, so many px to each side."""
    return max(1, half // EXACT_HALF)


def _range(values: FloatArray, half: int, side: int) -> tuple[FloatArray, FloatArray]:
    """Return the least and the largest values around each block of pixels, see `_extreme`."""
    return _extreme(values, half, side, np.minimum), _extreme(values, half, side, np.maximum)


def _extreme(values: FloatArray, half: int, side: int, choose: np.ufunc) -> FloatArray:
    """Return the least or the largest values around each block of pixels: of it, and at least so many px to each side.

    What is chosen of two values is ``choose``, `numpy.minimum` or `numpy.maximum`.
    """
    from scipy.ndimage import maximum_filter, minimum_filter

    rest = -values.shape[0] % side, -values.shape[1] % side
    blocks = np.pad(values, ((0, rest[0]), (0, rest[1])), mode="edge") if any(rest) else values
    # Row by row, then column by column: many at a time.
    blocks = reduce(choose, [blocks[k::side] for k in range(side)])
    blocks = reduce(choose, [blocks[:, k::side] for k in range(side)])
    return np.asarray((minimum_filter if choose is np.minimum else maximum_filter)(blocks, 2 * -(-half // side) + 1))


def _largest_step(values: FloatArray, half: int, side: int) -> FloatArray:
    """Return the largest difference of neighbours around each block of pixels."""
    step = np.zeros_like(values)
    np.abs(np.diff(values, axis=0), out=step[1:])
    np.maximum(step[:, 1:], np.abs(np.diff(values, axis=1)), out=step[:, 1:])
    return _extreme(step, half, side, np.maximum)


def _window(half: int) -> tuple[int, int]:
    """Return the half-width of what is looked at, and the step between the pixels that are."""
    return half, max(1, -(-(2 * half + 1) // MOST_SAMPLES))


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
    Soft edges are made steps first. Then a weighted median (Ma et al. 2013, "Constant time weighted median filtering
    for stereo matching and beyond"), near the edges only: it makes no depths between two surfaces, as a mean would.
    """
    half = max(LEAST_HALF, round(REFINE_SHARE * max(inverse.shape)))
    inverse, side = sharpened(inverse, 2 * half), _block_side(half)
    for _ in range(ROUNDS):
        low, high = _range(inverse, half, side)
        high, found = np.where(high - low < LEAST_EDGE, low, high), np.empty_like(inverse)
        given = inverse, image, low, high, side, _window(half), LIKE_COLOUR, found
        for_bands(_refine_kernels.weighted_medians, len(found), *given)
        inverse = found
    return inverse
