"""What neighbouring frames of a sequence show of what is hidden in a frame, moved to where it lies there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from spreadlets.arrays import Image
from spreadlets.runtime.label import _reprojection_kernels
from spreadlets.runtime.label.scale import LEAST_GAP, places, separating_scale
from spreadlets.runtime.label.surfaces import take_features, weigh_pixels, with_features
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.frame import Layer

SAME_DEPTH = 0.1
"""Relative difference up to which two depths may be one surface's, which the camera has come nearer to."""


class _Neighbour(NamedTuple):
    """A neighbouring frame: its pixels, how they move to the other frame, and in which direction of time."""

    layer: Layer
    motion: Image
    sign: float


def reproject(layer: Layer, neighbours: Sequence[Layer], camera: ThinLens) -> tuple[Layer, Image]:
    """Return what neighbouring frames show behind each pixel of a frame, the nearest of it.

    Parameters
    ----------
    layer : Layer
        The frame.
    neighbours : sequence of Layer
        The frames right before or after it, with the motion of their pixels. Which it is follows from where their
        colours fit better.
    camera : ThinLens
        Depths are compared by their CoC.

    Returns
    -------
    layer : Layer
    seen : ndarray of shape (H, W), float32
        1 where there is something, else 0.

    Notes
    -----
    Only pixels of one surface are moved. Each is divided bilinearly among four.
    """
    scale = separating_scale(layer, camera)
    hides = places(layer, scale)
    nearest = np.full(layer.shape, np.inf, np.float32)
    sums = np.zeros((*layer.shape, 5 + len(layer.depths) + 2 * len(layer.motions)), np.float32)
    moved = []
    for each in neighbours:
        neighbour = _directed(layer, each)
        place = places(neighbour.layer, scale)
        place[neighbour.layer.radiance[..., 3] == 0.0] = np.inf
        purity = weigh_pixels(place, place, neighbour.layer.radiance)[0]
        moved.append((purity, place, neighbour.motion, neighbour.sign, take_features(neighbour.layer, layer)))
    # Pixels may move anywhere: one band.
    for purity, place, motion, sign, _ in moved:
        _reprojection_kernels.find_farther(0, len(place), purity, place, motion, sign, hides, LEAST_GAP, nearest)
    for purity, place, motion, sign, values in moved:
        _reprojection_kernels.add_farther(0, len(place), purity, place, motion, sign, nearest, LEAST_GAP, values, sums)
    seen = sums[..., -1] >= _reprojection_kernels.LEAST_WEIGHT
    weight = np.maximum(sums[..., -1:], np.float32(_reprojection_kernels.LEAST_WEIGHT))
    features = np.asarray(sums[..., :-1] / weight, np.float32)
    return with_features(layer, features), seen.astype(np.float32)


def _directed(layer: Layer, neighbour: Layer) -> _Neighbour:
    """Find out whether a neighbour comes before or after a frame, and how much nearer the camera has come."""
    before = neighbour.motion if neighbour.motion_next is None else neighbour.motion_next
    after = neighbour.motion if neighbour.motion_prev is None else neighbour.motion_prev
    found = [(_misfit(layer, neighbour, motion, sign), motion, sign) for motion, sign in ((before, 1.0), (after, -1.0))]
    (_, advance), motion, sign = min(found, key=lambda each: each[0][0])
    return _Neighbour(replace(neighbour, depth=neighbour.depth + advance), motion, sign)


def _misfit(layer: Layer, neighbour: Layer, motion: Image, sign: float) -> tuple[float, np.float32]:
    """Return the mean difference of colours where a neighbour's pixels come to lie, and the median one of depths."""
    height, width = layer.shape
    rows, cols = np.indices(layer.shape)
    rows, cols = (np.rint(base + sign * motion[..., c]).astype(np.int64) for base, c in ((rows, 1), (cols, 0)))
    inside = (rows >= 0) & (rows < height) & (cols >= 0) & (cols < width)
    there = rows[inside], cols[inside]
    difference = np.abs(np.minimum(layer.radiance[there], 1.0) - np.minimum(neighbour.radiance[inside], 1.0)).mean()
    depth, other = layer.depth[there], neighbour.depth[inside]
    same = np.isfinite(depth) & np.isfinite(other)
    same[same] &= np.abs(depth[same] - other[same]) <= SAME_DEPTH * other[same]
    return float(difference), np.float32(np.median(depth[same] - other[same]) if same.any() else 0.0)
