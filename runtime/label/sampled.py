"""Labelled samples: what a buffer of stochastic samples gives to draw, one set for each sample of a pixel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from spreadlets.arrays import FloatArray, Image
from spreadlets.parallel import for_bands
from spreadlets.runtime.label import _label_kernels
from spreadlets.runtime.label.labels import Labels, camera_view
from spreadlets.runtime.label.lists import Pixels, joined
from spreadlets.runtime.label.moving import AS_IT_IS, Effects, coc_radii, curved_places, in_time, rolled
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.frame import Layer
from spreadlets.scene.samples import SampleBuffer

LENS_MOMENTS = 65
"""Times in the shutter between which a lens with keys is taken to change evenly."""


def sample_pixels(samples: SampleBuffer, camera: ThinLens, *, defocus: bool, motion: bool) -> list[Pixels]:
    """Turn samples into labels of mid-shutter and straight paths, one set for each sample of a pixel.

    Splats are centred where the sample would lie without lens, at mid-shutter (LKS section 6.2, "Stochastic
    frame-buffers"); an effect that is off has parameter 0 and is so undone.
    """
    pixel_sets = []
    for number in range(samples.n_samples):
        layer = _sample_layer(samples, number)
        labels = _sample_labels(samples, layer, camera, number)
        if not defocus:
            labels = labels._replace(coc=np.zeros_like(labels.coc))
        if not motion:
            labels = labels._replace(path=np.zeros_like(labels.path), length=np.zeros_like(labels.length))
        pixel_sets.append(Pixels(layer.radiance, labels))
    return pixel_sets


def sample_steps(
    samples: SampleBuffer, pixel_sets: Sequence[Pixels], camera: ThinLens, effects: Effects
) -> list[Pixels]:
    """Return the sets to draw: all samples, then lists of those that are drawn at steps of the shutter's time.

    Parameters
    ----------
    samples : SampleBuffer
    pixel_sets : sequence of Pixels
        Of `sample_pixels`, one for each sample of a pixel.
    camera : ThinLens
    effects : Effects
    """
    if samples.coc_radius is not None:
        # What the file says of the lens holds for all times.
        camera = replace(camera, keys=())
    sets, lists = [], []
    for number, pixels in enumerate(pixel_sets):
        layer = _sample_layer(samples, number)
        first, *steps = in_time(layer, pixels, camera, effects)
        sets.append(first)
        if steps:
            start = _start(samples, layer, camera, number) if effects.motion else None
            lists.append(joined([_moved(each, start) for each in steps], pixels.radiance))
    return [*sets, *lists]


def sample_paths(samples: SampleBuffer, pixel_sets: Sequence[Pixels], camera: ThinLens) -> list[Image]:
    """Return how far each sample moves where it was seen, as long as the shutter is open, px (dx, dy).

    What bends moves another way then than amid the shutter.

    Parameters
    ----------
    samples : SampleBuffer
    pixel_sets : sequence of Pixels
        Of `sample_pixels`, one for each sample of a pixel.
    camera : ThinLens
    """
    if samples.motion_prev is None or samples.motion_next is None:
        return [each.labels.whole_path for each in pixel_sets]
    paths, half = [], np.float32(0.5 * camera.shutter_duration)
    for number in range(len(pixel_sets)):
        layer, time = _sample_layer(samples, number), np.ascontiguousarray(samples.time[:, :, number])
        paths.append(_places(layer, time + half) - _places(layer, time - half))
    return paths


def _moved(pixels: Pixels, start: Image | None) -> Pixels:
    """Return a list whose places are counted from where each sample lay at the frame's time."""
    labels, places = pixels.labels, pixels.labels.view.places
    if start is None or places is None:
        return pixels
    there = start[places.at[..., 0], places.at[..., 1]]
    return pixels._replace(labels=labels._replace(shift=there if labels.shift is None else labels.shift + there))


def _sample_layer(samples: SampleBuffer, number: int) -> Layer:
    """Return one sample of each pixel as a frame."""

    def of_sample(values: FloatArray | None) -> FloatArray | None:
        return None if values is None else np.ascontiguousarray(values[:, :, number])

    colour, depth, motion = (
        np.ascontiguousarray(each[:, :, number]) for each in (samples.radiance, samples.depth, samples.motion)
    )
    curve = of_sample(samples.motion_prev), of_sample(samples.motion_next)
    return Layer(colour, depth, motion, *curve, raster=samples.raster)


def _sample_labels(samples: SampleBuffer, layer: Layer, camera: ThinLens, number: int) -> Labels:
    middle = camera.at(camera.shutter_centre)
    length = np.empty_like(layer.depth)
    if samples.coc_radius is None:
        coc = coc_radii(layer.depth, middle, AS_IT_IS, samples.raster.display.width)
    else:
        coc = np.ascontiguousarray(samples.coc_radius[:, :, number])
    begin, end = (_places(layer, np.full_like(layer.depth, time)) for time in camera.shutter)
    path = end - begin
    for_bands(_label_kernels.path_lengths, len(length), path, length)
    shift = _start(samples, layer, camera, number) + np.float32(0.5) * (begin + end)
    labels = Labels(coc, path, length, shift, camera_view(layer.depth, samples.raster, middle))
    return rolled(layer, labels, camera)


def _start(samples: SampleBuffer, layer: Layer, camera: ThinLens, number: int) -> Image:
    """Return where samples would lie at the frame's time without lens, px (dx, dy) from their pixels' centres."""
    time = np.ascontiguousarray(samples.time[:, :, number])
    if samples.coc_radius is None:
        coc = _own_coc(layer, camera, time)
    else:
        coc = samples.coc_radius[:, :, number]
    through_lens = coc[..., None] * samples.lens_uv[:, :, number]
    return np.asarray(samples.offset[:, :, number] - through_lens - _places(layer, time), np.float32)


def _own_coc(layer: Layer, camera: ThinLens, time: FloatArray) -> FloatArray:
    """Return the CoC radius of each sample at its own time, px: the lens may change while the shutter is open."""
    width = layer.raster.display.width
    if not camera.keys:
        return coc_radii(layer.depth, camera, AS_IT_IS, width)
    times = np.linspace(time.min(), time.max(), LENS_MOMENTS)
    lenses = [camera.at(each) for each in times]
    scale = np.interp(time, times, [each.coc_scale(width) for each in lenses])
    inverse_focus = np.interp(time, times, [1.0 / each.focus_distance_m for each in lenses])
    return np.asarray(scale * (inverse_focus - 1.0 / layer.depth.astype(np.float64)), np.float32)


def _places(layer: Layer, time: FloatArray) -> Image:
    """Return where samples lie at times (H, W), px (dx, dy) from where they lie at the frame's time."""
    if layer.motion_prev is None or layer.motion_next is None:
        return layer.motion * time[..., None]
    return curved_places(layer.motion_prev, layer.motion_next, time)
