"""What the camera's own move does to a picture: the motion and the depths of a world that stands still.

A frame without motion vectors is moved as the camera, or its zoom, moves it. Where a frame has vectors, those of
renderers hold the camera's move already; what they lack, the change of depth, is given to what moves as the camera
alone would move it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from spreadlets.arrays import BoolArray, DoubleArray
from spreadlets.runtime.label.labels import View
from spreadlets.scans import holds_anything
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.frame import Layer

STRAIGHT_PX = 0.02
"""What a path or a CoC radius departs from a constant one by at most, px, if it is taken for that."""
STILL_PX = 0.25
STILL_SHARE = 0.02
"""How far a motion vector, px per frame, or as a share of itself, may be from the camera's own motion in what stands
still: renderers average vectors over a pixel."""
NEAREST_SHARE = 0.1
"""What comes nearer than this share of its depth is held there: it would pass the camera."""


class Course(NamedTuple):
    """How all pixels go, by parabolas: ``first * t + second * t**2`` at time t, frames.

    Attributes
    ----------
    place : pair of ndarrays of shape (H, W, 2), float64
        Of the place in the image, px.
    nearness : pair of ndarrays of shape (H, W), float64
        Of 1 / depth.
    """

    place: tuple[DoubleArray, DoubleArray]
    nearness: tuple[DoubleArray, DoubleArray]


def moves_itself(layers: Sequence[Layer]) -> bool:
    """Tell whether a frame has motion vectors of its own."""
    return any(holds_anything(layer.motion) for layer in layers)


def carried(layers: Sequence[Layer], camera: ThinLens) -> list[Layer]:
    """Return the layers of a frame as the camera's move makes them move.

    Parameters
    ----------
    layers : sequence of Layer
    camera : ThinLens
        Fitted to the frame, with keys of its poses or focal lengths.
    """
    known = moves_itself(layers)
    return [(_deepened if known else _moved)(layer, _course(layer, camera), camera) for layer in layers]


def _moved(layer: Layer, course: Course, camera: ThinLens) -> Layer:
    """Return a layer with the motion and the depths of a course."""
    first, second = course.place
    moved = replace(layer, motion=np.ascontiguousarray(first, np.float32), has_motion=True)
    if _largest(layer, second) * _latest(camera) ** 2 > STRAIGHT_PX:
        before, after = (np.ascontiguousarray(first + sign * second, np.float32) for sign in (-1.0, 1.0))
        moved = replace(moved, motion_prev=before, motion_next=after)
    return _with_depths(moved, course, camera, np.ones(layer.shape, np.bool_))


def _deepened(layer: Layer, course: Course, camera: ThinLens) -> Layer:
    """Return a layer whose depth changes as in a course, where its motion is that of the course."""
    way = course.place[0]
    apart, length = np.hypot(*np.moveaxis(layer.motion - way, 2, 0)), np.hypot(*np.moveaxis(way, 2, 0))
    return _with_depths(layer, course, camera, apart <= np.maximum(STILL_PX, STILL_SHARE * length))


def _with_depths(layer: Layer, course: Course, camera: ThinLens, still: BoolArray) -> Layer:
    """Return a layer with the depths of the frames before and after, of what stands still, unless none changes."""
    first, second = (np.where(still, each, 0.0) for each in course.nearness)
    change = _latest(camera) * _largest(layer, np.abs(first) + _latest(camera) * np.abs(second))
    if layer.depth_prev is not None or change * camera.coc_scale(layer.raster.display.width) <= STRAIGHT_PX:
        return layer
    now = 1.0 / layer.depth.astype(np.float64)
    with np.errstate(divide="ignore"):  # what was beyond all distances stays there
        before, after = (
            (1.0 / np.maximum(now + sign * first + second, 0.0)).astype(np.float32) for sign in (-1.0, 1.0)
        )
    return replace(layer, depth_prev=before, depth_next=after)


def _latest(camera: ThinLens) -> float:
    """Return how far from the frame's time the shutter is open, frames."""
    return max(map(abs, camera.shutter))


def _largest(layer: Layer, values: DoubleArray) -> float:
    """Return the largest magnitude among what can be seen."""
    seen = np.abs(values[layer.radiance[..., 3] > 0.0])
    return float(seen.max()) if seen.size else 0.0


def _course(layer: Layer, camera: ThinLens) -> Course:
    """Return how the pixels of a layer go, fitted to where they are at the camera's keys."""
    begin = View(layer.depth, 1.0, 1.0, centre=layer.raster.off_middle).position().astype(np.float64)
    nearness = 1.0 / layer.depth.astype(np.float64)
    places, depths = [np.zeros_like(begin), np.zeros_like(begin)], [np.zeros_like(nearness), np.zeros_like(nearness)]
    times = _times(camera)
    for time, weights in zip(times, np.linalg.pinv(np.stack([times, times**2], axis=1)).T, strict=True):
        place, near = seen_at(begin, nearness, camera, layer.raster.display.width, float(time))
        for k in range(2):
            places[k] += weights[k] * (place - begin)
            depths[k] += weights[k] * (near - nearness)
    return Course((places[0], places[1]), (depths[0], depths[1]))


def _times(camera: ThinLens) -> DoubleArray:
    """Return the times of the keys around the shutter, without the frame's own, at least two, ascending."""
    opens, closes = camera.shutter
    keyed = sorted({k.time for k in camera.keys if k.camera_to_world is not None or k.focal_length_mm is not None})
    # From the last key before the shutter opens to the first after it closes, but no farther than the frames around.
    begin = max([time for time in keyed if time <= opens][-1:] or keyed[:1])
    end = min([time for time in keyed if time >= closes][:1] or keyed[-1:])
    begin, end = max(begin, min(opens, -1.0)), min(end, max(closes, 1.0))
    times = {time for time in (begin, *keyed, end) if begin <= time <= end} - {0.0}
    return np.array(sorted(times if len(times) > 1 else {*times, *(0.5 * time for time in times)}))


def seen_at(
    place: DoubleArray, nearness: DoubleArray, camera: ThinLens, width: int, time: float
) -> tuple[DoubleArray, DoubleArray]:
    """Return where points that stand still are seen at a time.

    Parameters
    ----------
    place : ndarray of shape (H, W, 2), float64
        Where they are seen at time 0: (x, y) from the picture's centre, px, y down.
    nearness : ndarray of shape (H, W), float64
        1 / depth at time 0.
    camera : ThinLens
    width : int
        Of the picture, px.
    time : float
        Frames.

    Returns
    -------
    place : ndarray of shape (H, W, 2), float64
    nearness : ndarray of shape (H, W), float64
    """
    # Take the points from the space of the camera then, where it looks along -z and y is up, to that of the camera now.
    poses = camera.pose_at(0.0), camera.pose_at(time)
    move = np.eye(4) if poses[0] is None or poses[1] is None else np.linalg.inv(poses[1]) @ np.asarray(poses[0])
    before, after = (camera.value_at("focal_length_mm", t) / camera.sensor_width_mm * width for t in (0.0, time))
    x, y = place[..., 0] / before, -place[..., 1] / before
    turned = [move[k, 0] * x + move[k, 1] * y - move[k, 2] + nearness * move[k, 3] for k in range(3)]
    # Project them.
    ahead = np.maximum(-turned[2], NEAREST_SHARE)
    return after * np.stack([turned[0] / ahead, -turned[1] / ahead], axis=-1), nearness / ahead
