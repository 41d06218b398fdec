"""Labelled pixels: what a frame or a buffer of samples gives to draw, as sets of one label for each pixel."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from spreadlets.arrays import NOTHING, Image
from spreadlets.parallel import for_bands
from spreadlets.runtime.controls import Controls
from spreadlets.runtime.label import _label_kernels
from spreadlets.runtime.label.labels import Labels, Places, View
from spreadlets.runtime.label.lists import Pixels, joined
from spreadlets.runtime.label.moving import AS_IT_IS, Effects, coc_radii, curved_places, in_time, rolled, zoomed
from spreadlets.runtime.label.surfaces import Split, Surface, split_surfaces, undivided
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.frame import Layer
from spreadlets.scene.raster import Raster
from spreadlets.scene.samples import SampleBuffer

Labelled = tuple[Layer, Pixels]
"""A surface of all pixels of a frame, with their labels and weights."""


def frame_pixels(
    layer: Layer,
    camera: ThinLens,
    *,
    defocus: bool,
    motion: bool,
    swept: bool = True,
    controls: Controls = AS_IT_IS,
    split: Split = split_surfaces,
) -> list[Pixels]:
    """Turn a frame's depth and motion vectors into labels; an effect that is off has parameter 0.

    First come all pixels of the frame, then a list of what some of them need beside: further surfaces of those that
    show several, see `runtime.label.surfaces`; and steps of time of those that change while the shutter is open, see
    `runtime.label.moving`.

    Parameters
    ----------
    layer : Layer
    camera : ThinLens
    defocus, motion : bool
        Which effects are drawn.
    swept : bool
        Whether PSFs are swept along straight paths; if not, what moves is drawn at places along its way.
    controls : Controls
        How the lens is changed.
    split : callable
        Divides mixed pixels between their surfaces.
    """
    effects = Effects(defocus, motion, swept, controls)
    return surface_pixels(frame_surfaces(layer, camera, effects, split), camera, effects)


def frame_surfaces(layer: Layer, camera: ThinLens, effects: Effects, split: Split) -> list[Labelled]:
    """Return the surfaces of a frame's pixels, with the labels of mid-shutter and straight paths.

    Parameters
    ----------
    layer, camera, split
        As for `frame_pixels`.
    effects : Effects
    """
    middle = camera.at(camera.shutter_centre)
    layer = zoomed(layer, camera) if effects.motion and camera.keys else layer
    is_blurred = effects.defocus or (effects.motion and layer.has_motion)
    surfaces = (split if is_blurred else undivided)(layer, middle)
    return [labelled(each, layer.shape, camera, effects) for each in surfaces]


def labelled(surface: Surface, shape: tuple[int, int], camera: ThinLens, effects: Effects) -> Labelled:
    """Return a surface of a frame's pixels, (H, W), with the labels of mid-shutter and straight paths."""
    middle, controls, layer = camera.at(camera.shutter_centre), effects.controls, surface.layer
    places = None if surface.at is None else Places(surface.at, shape)
    labels = _straight_labels(layer, places, middle, controls, defocus=effects.defocus, motion=effects.motion)
    light = controls.light(layer.radiance, labels.coc)
    return layer, Pixels(light, labels, NOTHING if surface.share is None else surface.share)


def surface_pixels(surfaces: Sequence[Labelled], camera: ThinLens, effects: Effects) -> list[Pixels]:
    """Return the pixels to draw of some surfaces: all those of the first, then a list of what is needed beside."""
    found = [pixels for each in surfaces for pixels in in_time(*each, camera, effects)]
    return [found[0], joined(found[1:], found[0].radiance)] if len(found) > 1 else found


def hidden_pixels(surface: Labelled, camera: ThinLens, effects: Effects, frame: Image) -> Pixels:
    """Return the list of pixels to draw of a list hidden behind others; ``frame`` are the colours of the frame."""
    return joined(list(in_time(*surface, camera, effects)), frame)


def _straight_labels(
    layer: Layer, places: Places | None, camera: ThinLens, controls: Controls, *, defocus: bool, motion: bool
) -> Labels:
    length = np.zeros(layer.shape, np.float32)
    view = _view(layer.depth, layer.raster, camera)._replace(places=places)
    shown = layer.raster.display.width
    coc = coc_radii(layer.depth, camera, controls, shown) if defocus else np.zeros_like(length)
    if not motion or not layer.has_motion:
        return Labels(coc, np.zeros((*layer.shape, 2), np.float32), length, None, view)
    shift = layer.motion * np.float32(camera.shutter_centre) if camera.shutter_centre else None
    path = layer.motion * np.float32(camera.shutter_duration)
    for_bands(_label_kernels.path_lengths, len(length), path, length)
    labels = Labels(coc, path, length, shift, view)
    return rolled(layer, labels, camera)


def _view(depth: Image, raster: Raster, camera: ThinLens) -> View:
    """Return how the camera sees pixels, whose display window's width is the sensor's."""
    mm_per_px = camera.sensor_width_mm / raster.display.width
    return View(depth, camera.focal_length_mm / mm_per_px, mm_per_px, raster.off_middle)


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
    depth = np.ascontiguousarray(samples.depth[:, :, number])
    length = np.empty_like(depth)
    if samples.coc_radius is None:
        coc = coc_radii(depth, camera, AS_IT_IS, samples.raster.display.width)
    else:
        coc = np.ascontiguousarray(samples.coc_radius[:, :, number])
    path, middle, now = _sample_places(samples, camera, number)
    for_bands(_label_kernels.path_lengths, len(length), path, length)
    shift = samples.offset[:, :, number] - coc[..., None] * samples.lens_uv[:, :, number] + middle - now
    view = _view(depth, samples.raster, camera)
    return Labels(coc, path, length, shift, view)


def _sample_places(samples: SampleBuffer, camera: ThinLens, number: int) -> tuple[Image, Image, Image]:
    """Return the paths of samples over the shutter, their middles, and where each was seen, all from the frame's time.

    A curved path is drawn as its chord; its middle and the place at the sample's own time are on the curve.
    """
    time = np.ascontiguousarray(samples.time[:, :, number])
    if samples.motion_prev is None or samples.motion_next is None:
        motion = np.ascontiguousarray(samples.motion[:, :, number])
        centre = motion * np.float32(camera.shutter_centre)
        return motion * np.float32(camera.shutter_duration), centre, motion * time[..., None]
    before, after = (np.ascontiguousarray(each[:, :, number]) for each in (samples.motion_prev, samples.motion_next))
    begin, end = (curved_places(before, after, np.full_like(time, each)) for each in camera.shutter)
    return end - begin, np.float32(0.5) * (begin + end), curved_places(before, after, time)
