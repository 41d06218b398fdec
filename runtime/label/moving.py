"""What changes while the shutter is open: pixels drawn at several times, each with its place, its blur and its share.

A cell of a model with motion covers a straight path at constant blur: such a pixel is drawn once. What bends is drawn
along chords; what changes its blur, since it moves in depth or the lens is pulled, is drawn in steps of time, and so is
what moves under a shutter that is not open evenly. PSFs that do not move are drawn at places along the path, close
enough to make one streak.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import FloatArray, Image
from spreadlets.parallel import for_bands
from spreadlets.runtime.controls import Controls
from spreadlets.runtime.label import _label_kernels
from spreadlets.runtime.label.labels import Labels
from spreadlets.runtime.label.lists import Pixels, listed, rows_of
from spreadlets.runtime.label.trail import Trail
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.frame import Layer
from spreadlets.scene.shutter import shutter_shares

CHORD_TOLERANCE = 0.2
CHORD_SHARE = 0.15
"""Largest distance of a curved path from the straight lines that it is drawn by: px, or so much of the CoC radius."""
MOST_CHORDS = 16
"""Straight lines of a path at most; their distance falls with the square of their number."""
MOST_STEPS = 128
"""Steps of time at most."""
COC_STEP_PX = 0.5
COC_STEP_SHARE = 0.06
"""Change of a CoC radius within a step: so many px, or so much of itself. Steps between are what cells are wide."""
PLACE_STEP_SHARE = 0.1
"""Distance, in CoC radii and at least a pixel, of the places at which a PSF that does not move is drawn on its way."""
CURVE_STEP_PX = 2.0
CURVE_STEP_SHARE = 0.25
"""Length of a step, px or in CoC radii, within which a shutter that opens and closes slowly is taken to be even."""

AS_IT_IS = Controls()
"""The lens without any change."""


class Effects(NamedTuple):
    """What is drawn: the defocus, the motion; whether PSFs are swept along paths; how the lens is changed.

    And whether what motion stretches covers more, see `runtime.label.stretch`: not what is divided by its cover anyway.
    """

    defocus: bool
    motion: bool
    swept: bool
    controls: Controls = AS_IT_IS
    stretches: bool = False


def in_time(layer: Layer, pixels: Pixels, camera: ThinLens, effects: Effects) -> Iterator[Pixels]:
    """Yield the pixels that are drawn once, and lists of the others at steps of the shutter's time.

    Parameters
    ----------
    layer : Layer
        What the labels were made of.
    pixels : Pixels
        Of a frame or of a list, with the labels of mid-shutter and straight paths.
    camera : ThinLens
    effects : Effects
    """
    if not effects.swept and pixels.labels.length.any():
        # What is not swept has no path; it gets places instead.
        labels = pixels.labels
        labels = labels._replace(
            path=np.zeros_like(labels.path), length=np.zeros_like(labels.length), sweep=labels.path
        )
        pixels = pixels._replace(labels=labels)
    steps = _count_steps(layer, pixels, camera, effects)
    largest = 1 if steps is None else int(steps.max())
    if steps is None or largest == 1:
        yield pixels
        return
    weight = pixels.weight if len(pixels.weight) else np.ones(steps.shape, np.float32)
    moving = steps > 1
    once = pixels._replace(weight=np.where(moving, np.float32(0.0), weight))
    yield once if pixels.is_list else once._replace(curved=moving)
    if not effects.swept and not _refocuses(layer, camera, effects):
        chosen = np.flatnonzero(moving & (weight > 0))
        if len(chosen):
            part, some = listed(layer, pixels._replace(weight=weight), chosen)
            yield _on_the_way(part, some, steps.ravel()[rows_of(chosen)], camera)
        return
    for count in (2**power for power in range(1, largest.bit_length())):
        chosen = np.flatnonzero((steps == count) & (weight > 0))
        if len(chosen):
            part, some = listed(layer, pixels._replace(weight=weight), chosen)
            shares = shutter_shares(camera.shutter_curve, count).astype(np.float32)
            for share, labels in zip(shares, _labels_in_time(part, some.labels, camera, effects, count), strict=True):
                if share:
                    yield some._replace(labels=labels, weight=some.weight * share)


def _on_the_way(layer: Layer, pixels: Pixels, count: npt.NDArray[np.int32], camera: ThinLens) -> Pixels:
    """Return a list whose pixels are drawn at so many places, (H, W), of their ways."""
    motion = layer.motion, layer.motion
    if layer.motion_prev is not None and layer.motion_next is not None:
        motion = layer.motion_prev, layer.motion_next
    trail = Trail.of(count, motion, camera.shutter, camera.shutter_curve)
    labels = pixels.labels._replace(shift=np.zeros_like(layer.motion), sweep=pixels.labels.whole_path, trail=trail)
    return pixels._replace(labels=rolled(layer, labels, camera))


def _refocuses(layer: Layer, camera: ThinLens, effects: Effects) -> bool:
    """Tell whether the blur of what is in the frame may change while the shutter is open."""
    return effects.defocus and (layer.depth_prev is not None or bool(camera.keys))


def _count_steps(layer: Layer, pixels: Pixels, camera: ThinLens, effects: Effects) -> npt.NDArray[np.int32] | None:
    """Return the number of steps of each pixel, a power of 2, or None if nothing asks for any."""
    if not camera.shutter_duration:
        return None
    # Find what changes at all.
    moves = effects.motion and layer.has_motion
    bends = moves and layer.motion_prev is not None and layer.motion_next is not None
    refocuses = _refocuses(layer, camera, effects)
    unevenly = moves and camera.shutter_curve is not None
    if not (bends or refocuses or unevenly or (moves and not effects.swept)):
        return None
    count, radius = np.ones(pixels.labels.coc.shape, np.int32), np.abs(pixels.labels.coc)
    # Follow bends by chords, changes of blur by steps, and the ways of what is not swept by places.
    if bends:
        limits = camera.shutter_duration, (CHORD_TOLERANCE, CHORD_SHARE), MOST_CHORDS
        given = layer.motion_prev, layer.motion_next, radius
        for_bands(_label_kernels.count_segments, len(count), *given, *limits, count)
    if refocuses:
        count = np.maximum(count, _power_of_two(_coc_range(layer, camera, effects.controls) / _coc_step(radius)))
    if unevenly or (moves and not effects.swept):
        opens, closes = (_places(layer, time) for time in camera.shutter)
        way = np.hypot(*np.moveaxis(closes - opens, 2, 0))
        share, least = (CURVE_STEP_SHARE, CURVE_STEP_PX) if effects.swept else (PLACE_STEP_SHARE, 1.0)
        count = np.maximum(count, _power_of_two(way / np.maximum(np.float32(share) * radius, np.float32(least))))
    return count


def _coc_step(radius: FloatArray) -> FloatArray:
    return np.asarray(np.maximum(np.float32(COC_STEP_SHARE) * radius, np.float32(COC_STEP_PX)), np.float32)


def _coc_range(layer: Layer, camera: ThinLens, controls: Controls) -> FloatArray:
    """Return by how much each pixel's CoC radius changes while the shutter is open, px."""
    keyed = [key.time for key in camera.keys if camera.shutter[0] < key.time < camera.shutter[1]]
    found = [_coc(layer, camera, controls, time) for time in (*camera.shutter, camera.shutter_centre, *keyed)]
    return np.asarray(np.max(found, axis=0) - np.min(found, axis=0), np.float32)


def _power_of_two(steps: FloatArray) -> npt.NDArray[np.int32]:
    """Return the next power of 2, up to `MOST_STEPS`."""
    power = np.ceil(np.log2(np.clip(steps, 1.0, MOST_STEPS)))
    return np.exp2(power).astype(np.int32)


def _labels_in_time(layer: Layer, labels: Labels, camera: ThinLens, effects: Effects, count: int) -> Iterator[Labels]:
    """Yield the labels of each of some equal steps of the shutter's time."""
    labels = labels._replace(sweep=labels.whole_path)
    times = np.linspace(*camera.shutter, count + 1)
    for opens, closes in zip(times[:-1], times[1:], strict=True):
        middle = 0.5 * (opens + closes)
        coc = _coc(layer, camera, effects.controls, middle) if effects.defocus else labels.coc
        if not effects.motion:
            yield labels._replace(coc=coc)
            continue
        if not effects.swept:
            yield rolled(layer, labels._replace(coc=coc, shift=_places(layer, middle)), camera)
            continue
        begin, end = _places(layer, opens), _places(layer, closes)
        path, length = end - begin, np.empty_like(labels.length)
        for_bands(_label_kernels.path_lengths, len(length), path, length)
        shift = np.float32(0.5) * (begin + end)
        yield rolled(layer, labels._replace(coc=coc, path=path, length=length, shift=shift), camera)


def _coc(layer: Layer, camera: ThinLens, controls: Controls, time: float) -> FloatArray:
    """Return the signed CoC radii of pixels at a time, px."""
    depth = layer.depth if layer.depth_prev is None else _depth(layer, time)
    return coc_radii(depth, camera.at(time), controls, layer.raster.display.width)


def coc_radii(depth: FloatArray, camera: ThinLens, controls: Controls, width: int) -> FloatArray:
    """Return the signed CoC radii (H, W), px, of depths (H, W) in an image of a width, px."""
    coc = np.empty_like(depth)
    scale = camera.coc_scale(width)
    for_bands(_label_kernels.coc_radii, len(coc), depth, scale, 1.0 / camera.focus_distance_m, coc)
    return controls.coc(coc, depth, scale) if controls.change_coc else coc


def _depth(layer: Layer, time: float) -> FloatArray:
    """Return the depth at a time, by the parabola of 1/depth through the three that are known."""
    before, now, after = (
        1.0 / np.asarray(each, np.float64) for each in (layer.depth_prev, layer.depth, layer.depth_next)
    )
    inverse = now + 0.5 * time * (after - before) + time * time * (0.5 * (after + before) - now)
    with np.errstate(divide="ignore"):
        return np.asarray(np.where(inverse > 0.0, 1.0 / np.maximum(inverse, 0.0), np.inf), np.float32)


def _places(layer: Layer, time: float) -> Image:
    """Return where pixels are at a time, px (dx, dy) from where they are at the label's time."""
    if layer.motion_prev is None or layer.motion_next is None:
        return layer.motion * np.float32(time)
    return curved_places(layer.motion_prev, layer.motion_next, np.full(layer.shape, time, np.float32))


def places_at(layer: Layer, camera: ThinLens, time: float) -> Image:
    """Return where pixels are at a time of the shutter, (H, W, 2), px (dx, dy) from where the frame shows them."""
    place = _places(layer, time)
    later = _later(camera, np.arange(len(place)), len(place))
    return place if later is None else place + layer.motion * later[:, None, None]


def curved_places(before: Image, after: Image, time: FloatArray) -> Image:
    """Return where pixels are at times (H, W), frames, on the curves through three places, px (dx, dy), (H, W, 2)."""
    place = np.empty_like(before)
    for_bands(_label_kernels.path_places, len(place), before, after, time, place)
    return place


def rolled(layer: Layer, labels: Labels, camera: ThinLens) -> Labels:
    """Return labels whose pixels lie where they are when their row is read out (rolling shutter)."""
    if not layer.has_motion:
        return labels
    rows = np.arange(labels.coc.shape[0])[:, None] if labels.view.places is None else labels.view.places.at[..., 0]
    later = _later(camera, rows, labels.view.frame_shape[0])
    if later is None:
        return labels
    moved = layer.motion * later[..., None]
    return labels._replace(shift=moved if labels.shift is None else labels.shift + moved)


def _later(camera: ThinLens, rows: npt.NDArray[np.integer[Any]], height: int) -> FloatArray | None:
    """Return how much later than the middle one rows are read out, frames; None if all are at once."""
    if not camera.readout_frames or height < 2:
        return None
    return np.float32(camera.readout_frames) * (rows.astype(np.float32) / np.float32(height - 1) - np.float32(0.5))
