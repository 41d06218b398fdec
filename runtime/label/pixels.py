"""Labelled pixels: what a frame or a buffer of samples gives to draw, as sets of one label for each pixel."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

import numpy as np

from spreadlets.arrays import NOTHING, Image
from spreadlets.parallel import for_bands
from spreadlets.runtime.controls import Controls
from spreadlets.runtime.label import _label_kernels
from spreadlets.runtime.label.labels import Labels, View
from spreadlets.runtime.label.surfaces import Surface, split_surfaces
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.frame import Layer
from spreadlets.scene.samples import SampleBuffer

CHORD_TOLERANCE = 0.5
"""Largest distance, px, of a curved path from the straight lines that it is drawn by."""
MOST_SEGMENTS = 4
"""Straight lines of a path at most; their distance falls with the square of their number."""

Split = Callable[[Layer, ThinLens], Iterable[Surface]]
"""Divides the mixed pixels of a layer between their surfaces."""
AS_IT_IS = Controls()
"""The lens without any change."""


class Pixels(NamedTuple):
    """One label for each pixel.

    Attributes
    ----------
    radiance : ndarray of shape (H, W, 4), float32
        Premultiplied colour, C-contiguous.
    labels : Labels
    weight : ndarray of shape (H, W) or (0, 0), float32
        Share of the pixel that is drawn by this label; empty if it is the whole.
    """

    radiance: Image
    labels: Labels
    weight: Image = NOTHING


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

    Pixels that show several surfaces are divided between them, see `runtime.label.surfaces`. Paths that are curved (the
    motion before the frame's time differs from that after it) become chords of the curve through the three positions,
    each with its share of the shutter; unless ``curved`` is off, as it is for PSFs that do not move: drawn once for
    each chord they would be ghosts. ``controls`` change the lens; ``split`` divides mixed pixels.
    """
    blurred = defocus or (motion and layer.has_motion)
    pixel_sets = []
    for surface, share in split(layer, camera) if blurred else ((layer, None),):
        straight = _straight_labels(surface, camera, controls, defocus=defocus, motion=motion)
        radiance = controls.light(surface.radiance, straight.coc)
        for labels, weight in _along_paths(surface, camera, straight, motion and curved):
            weights = [each for each in (share, weight) if each is not None]
            pixel_sets.append(Pixels(radiance, labels, np.prod(weights, axis=0) if weights else NOTHING))
    return pixel_sets


def _along_paths(
    layer: Layer, camera: ThinLens, straight: Labels, motion: bool
) -> Iterator[tuple[Labels, Image | None]]:
    """Yield the labels of straight paths and of the chords of curved ones, with the share of each pixel."""
    if not motion or layer.motion_prev is None or layer.motion_next is None or not camera.shutter_duration:
        yield straight, None
        return
    segments = np.empty(layer.shape, np.int32)
    limits = camera.shutter_duration, CHORD_TOLERANCE, MOST_SEGMENTS
    for_bands(_label_kernels.count_segments, len(segments), layer.motion_prev, layer.motion_next, *limits, segments)
    largest = int(segments.max())
    if largest == 1:
        yield straight, None
        return
    yield straight, (segments == 1).astype(np.float32)
    for count in (2**power for power in range(1, largest.bit_length())):
        weight = np.where(segments == count, np.float32(1 / count), np.float32(0))
        if weight.any():
            for chord in _chords(layer, camera, straight, count):
                yield chord, weight


def _straight_labels(layer: Layer, camera: ThinLens, controls: Controls, *, defocus: bool, motion: bool) -> Labels:
    height, width = layer.shape
    coc, length = np.zeros((2, height, width), np.float32)
    shown = layer.raster.display.width
    mm_per_px = camera.sensor_width_mm / shown
    view = View(
        layer.depth, camera.focal_length_mm / camera.sensor_width_mm * shown, mm_per_px, layer.raster.off_middle
    )
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
    depth = np.ascontiguousarray(samples.depth[:, :, number])
    length = np.empty((height, width), np.float32)
    if samples.coc_radius is None:
        coc = np.empty((height, width), np.float32)
        for_bands(_label_kernels.coc_radii, height, depth, camera.coc_scale(width), 1.0 / camera.focus_distance_m, coc)
    else:
        coc = np.ascontiguousarray(samples.coc_radius[:, :, number])
    path = samples.motion[:, :, number] * np.float32(camera.shutter_duration)
    for_bands(_label_kernels.path_lengths, len(length), path, length)
    since_centre = samples.time[:, :, number] - np.float32(camera.shutter_centre)
    shift = samples.offset[:, :, number] - coc[..., None] * samples.lens_uv[:, :, number]
    shift -= samples.motion[:, :, number] * since_centre[..., None]
    view = View(depth, camera.focal_length_mm / camera.sensor_width_mm * width, camera.sensor_width_mm / width)
    return Labels(coc, path, length, shift, view)
