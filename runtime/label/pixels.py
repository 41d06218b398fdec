"""Labelled pixels: what a frame or a buffer of samples gives to draw, as sets of one label for each pixel.

What few pixels of a frame need, such as a second surface, is a list: arrays of as many rows as it takes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import NOTHING, BoolArray, Image, IntArray
from spreadlets.parallel import for_bands
from spreadlets.runtime.controls import Controls
from spreadlets.runtime.label import _label_kernels
from spreadlets.runtime.label.labels import Labels, Places, View
from spreadlets.runtime.label.surfaces import Surface, split_surfaces
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.frame import Layer
from spreadlets.scene.raster import Raster
from spreadlets.scene.samples import SampleBuffer

LIST_WIDTH = 1024
"""Pixels in a row of a list: rows are what threads divide."""
CHORD_TOLERANCE = 0.5
"""Largest distance, px, of a curved path from the straight lines that it is drawn by."""
MOST_SEGMENTS = 4
"""Straight lines of a path at most; their distance falls with the square of their number."""

Split = Callable[[Layer, ThinLens], Iterable[Surface]]
"""Divides the mixed pixels of a layer between their surfaces."""
AS_IT_IS = Controls()
"""The lens without any change."""


_Number = TypeVar("_Number", bound=np.generic)


class Pixels(NamedTuple):
    """One label for each pixel of a frame, or of a list of its pixels.

    Attributes
    ----------
    radiance : ndarray of shape (H, W, 4), float32
        Premultiplied colour, C-contiguous.
    labels : Labels
        With the places of the pixels, if they are a list.
    weight : ndarray of shape (H, W) or (0, 0), float32
        Share of the pixel that is drawn by this label; empty if it is the whole.
    frame : ndarray of shape (frame's H, W, 4), float32, or None
        The colours of the frame that the pixels of a list are from.
    curved : ndarray of shape (H, W), bool, or None
        The pixels of a frame whose weight is 0 because a list draws them along the chords of their paths.
    """

    radiance: Image
    labels: Labels
    weight: Image = NOTHING
    frame: Image | None = None
    curved: BoolArray | None = None

    @property
    def is_list(self) -> bool:
        """Whether the pixels are a list."""
        return self.labels.view.places is not None


def frame_pixels(
    layer: Layer,
    camera: ThinLens,
    *,
    defocus: bool,
    motion: bool,
    curved: bool = True,
    controls: Controls = AS_IT_IS,
    split: Split = split_surfaces,
) -> list[Pixels]:
    """Turn a frame's depth and motion vectors into labels; an effect that is off has parameter 0.

    First come all pixels of the frame, then a list of what some of them need beside: further surfaces of those that
    show several, see `runtime.label.surfaces`; and, where paths are curved (the motion before the frame's time differs
    from that after it), chords of the curve through the three positions, each with its share of the shutter. With
    ``curved`` off, as it is for PSFs that do not move, there are no chords: they would be ghosts. ``controls``
    change the lens; ``split`` divides mixed pixels.
    """
    blurred = defocus or (motion and layer.has_motion)
    found: list[Pixels] = []
    for surface, share in split(layer, camera) if blurred else ((layer, None),):
        labels = _straight_labels(surface, camera, controls, defocus=defocus, motion=motion)
        pixels = Pixels(controls.light(surface.radiance, labels.coc), labels)
        if share is not None:
            pixels = pixels._replace(weight=share)
        if found:
            surface, pixels = listed(surface, pixels, np.flatnonzero(pixels.weight))
        found += _along_paths(surface, pixels, camera) if motion and curved else [pixels]
    lists = [each._replace(frame=found[0].radiance) for each in found[1:]]
    return [found[0], joined(lists)] if lists else found


def _along_paths(layer: Layer, pixels: Pixels, camera: ThinLens) -> Iterator[Pixels]:
    """Yield pixels without those whose paths are curved, and lists of these along the chords of their paths."""
    segments = np.ones(pixels.radiance.shape[:2], np.int32)
    if layer.motion_prev is not None and layer.motion_next is not None and camera.shutter_duration:
        limits = camera.shutter_duration, CHORD_TOLERANCE, MOST_SEGMENTS
        for_bands(_label_kernels.count_segments, len(segments), layer.motion_prev, layer.motion_next, *limits, segments)
    largest = int(segments.max())
    if largest == 1:
        yield pixels
        return
    weight = pixels.weight if len(pixels.weight) else np.ones(segments.shape, np.float32)
    curved = segments > 1
    straight = pixels._replace(weight=np.where(curved, np.float32(0.0), weight))
    yield straight if pixels.is_list else straight._replace(curved=curved)
    for count in (2**power for power in range(1, largest.bit_length())):
        chosen = np.flatnonzero((segments == count) & (weight > 0))
        if len(chosen):
            part, bent = listed(layer, pixels._replace(weight=weight), chosen)
            for chord in _chords(part, camera, bent.labels, count):
                yield bent._replace(labels=chord, weight=bent.weight / np.float32(count))


def _straight_labels(layer: Layer, camera: ThinLens, controls: Controls, *, defocus: bool, motion: bool) -> Labels:
    height, width = layer.shape
    coc, length = np.zeros((2, height, width), np.float32)
    shown = layer.raster.display.width
    view = _view(layer.depth, layer.raster, camera)
    if defocus:
        optics = camera.coc_scale(shown), 1.0 / camera.focus_distance_m
        for_bands(_label_kernels.coc_radii, height, layer.depth, *optics, coc)
        coc = controls.coc(coc, layer.depth, optics[0]) if controls.change_coc else coc
    if not motion or not layer.has_motion:
        return Labels(coc, np.zeros((height, width, 2), np.float32), length, None, view)
    shift = layer.motion * np.float32(camera.shutter_centre) if camera.shutter_centre else None
    path = layer.motion * np.float32(camera.shutter_duration)
    for_bands(_label_kernels.path_lengths, len(length), path, length)
    return Labels(coc, path, length, shift, view)


def _view(depth: Image, raster: Raster, camera: ThinLens) -> View:
    """Return how the camera sees pixels, whose display window's width is the sensor's."""
    mm_per_px = camera.sensor_width_mm / raster.display.width
    return View(depth, camera.focal_length_mm / mm_per_px, mm_per_px, raster.off_middle)


def _chords(layer: Layer, camera: ThinLens, straight: Labels, count: int) -> Iterator[Labels]:
    """Yield the labels of the chords between equal steps of the shutter's time."""
    places = np.empty((count + 1, *layer.motion.shape), np.float32)
    for time, place in zip(np.linspace(*camera.shutter, count + 1), places, strict=True):
        for_bands(_label_kernels.path_places, len(place), layer.motion_prev, layer.motion_next, time, place)
    for begin, end in zip(places[:-1], places[1:], strict=True):
        path = end - begin
        length = np.empty(layer.shape, np.float32)
        for_bands(_label_kernels.path_lengths, len(length), path, length)
        yield straight._replace(path=path, length=length, shift=np.float32(0.5) * (begin + end))


def listed(layer: Layer, pixels: Pixels, chosen: IntArray) -> tuple[Layer, Pixels]:
    """Return some pixels as a list, with as many rows as it takes.

    Parameters
    ----------
    layer : Layer
        What the labels were made of.
    pixels : Pixels
        Of a frame or of a list, weighted.
    chosen : ndarray of shape (n,), int64
        Their numbers in raster order.

    Returns
    -------
    layer : Layer
    pixels : Pixels
        The last row is filled up with the first pixel, of weight 0.
    """
    n_rows = -(-len(chosen) // LIST_WIDTH)
    index = np.zeros((n_rows, LIST_WIDTH), np.int64)
    index.ravel()[: len(chosen)] = chosen
    labels, view = pixels.labels, pixels.labels.view
    in_frame = np.stack(np.divmod(index, pixels.radiance.shape[1]), axis=-1).astype(np.int32)
    at = in_frame if view.places is None else _taken(view.places.at, index)
    weight = _taken(pixels.weight, index)
    weight.ravel()[len(chosen) :] = 0.0
    before, after, depth = layer.motion_prev, layer.motion_next, _taken(layer.depth, index)
    part = replace(
        layer,
        radiance=_taken(pixels.radiance, index),
        depth=depth,
        motion=_taken(layer.motion, index),
        motion_prev=None if before is None else _taken(before, index),
        motion_next=None if after is None else _taken(after, index),
    )
    labels = Labels(
        _taken(labels.coc, index),
        _taken(labels.path, index),
        _taken(labels.length, index),
        None if labels.shift is None else _taken(labels.shift, index),
        view._replace(depth=depth, places=Places(at, view.frame_shape)),
    )
    return part, Pixels(part.radiance, labels, weight, pixels.frame)


def _taken(values: npt.NDArray[_Number], index: IntArray) -> npt.NDArray[_Number]:
    """Return the values (H, W, ...) of pixels, by their numbers in raster order."""
    return values.reshape(-1, *values.shape[2:])[index]


def joined(lists: Sequence[Pixels]) -> Pixels:
    """Return several lists as one."""
    labels = [each.labels for each in lists]
    at = [each.view.places.at for each in labels if each.view.places is not None]
    places = Places(np.concatenate(at), labels[0].view.frame_shape)
    return Pixels(
        np.concatenate([each.radiance for each in lists]),
        Labels(
            np.concatenate([each.coc for each in labels]),
            np.concatenate([each.path for each in labels]),
            np.concatenate([each.length for each in labels]),
            np.concatenate([np.zeros_like(each.path) if each.shift is None else each.shift for each in labels]),
            labels[0].view._replace(depth=np.concatenate([each.view.depth for each in labels]), places=places),
        ),
        np.concatenate([each.weight for each in lists]),
        lists[0].frame,
    )


def sample_pixels(samples: SampleBuffer, camera: ThinLens, *, defocus: bool, motion: bool) -> list[Pixels]:
    """Turn samples into labels, one pass for each sample of a pixel.

    Splats are centred where the sample would lie without lens, at mid-shutter (LKS section 6.2, "Stochastic
    frame-buffers"); an effect that is off has parameter 0 and is so undone.
    """
    pixel_sets = []
    for number in range(samples.n_samples):
        labels = _sample_labels(samples, camera, number)
        if not defocus:
            labels = labels._replace(coc=np.zeros_like(labels.coc))
        if not motion:
            labels = labels._replace(path=np.zeros_like(labels.path), length=np.zeros_like(labels.length))
        pixel_sets.append(Pixels(np.ascontiguousarray(samples.radiance[:, :, number]), labels))
    return pixel_sets


def _sample_labels(samples: SampleBuffer, camera: ThinLens, number: int) -> Labels:
    height, width = samples.shape
    shown = samples.raster.display.width
    depth = np.ascontiguousarray(samples.depth[:, :, number])
    length = np.empty((height, width), np.float32)
    if samples.coc_radius is None:
        coc = np.empty((height, width), np.float32)
        for_bands(_label_kernels.coc_radii, height, depth, camera.coc_scale(shown), 1.0 / camera.focus_distance_m, coc)
    else:
        coc = np.ascontiguousarray(samples.coc_radius[:, :, number])
    path = samples.motion[:, :, number] * np.float32(camera.shutter_duration)
    for_bands(_label_kernels.path_lengths, len(length), path, length)
    since_centre = samples.time[:, :, number] - np.float32(camera.shutter_centre)
    shift = samples.offset[:, :, number] - coc[..., None] * samples.lens_uv[:, :, number]
    shift -= samples.motion[:, :, number] * since_centre[..., None]
    view = _view(depth, samples.raster, camera)
    return Labels(coc, path, length, shift, view)
