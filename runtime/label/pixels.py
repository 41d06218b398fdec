"""Labelled pixels: what a frame gives to draw, as sets of one label for each pixel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from spreadlets.arrays import NOTHING, Image
from spreadlets.parallel import for_bands
from spreadlets.runtime.controls import Controls
from spreadlets.runtime.label import _label_kernels
from spreadlets.runtime.label.labels import Labels, Places, camera_view
from spreadlets.runtime.label.lists import Pixels, joined
from spreadlets.runtime.label.moving import AS_IT_IS, Effects, coc_radii, in_time, rolled
from spreadlets.runtime.label.stretch import stretch
from spreadlets.runtime.label.surfaces import Split, Surface, split_surfaces, undivided
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.frame import Layer

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
    is_blurred = effects.defocus or (effects.motion and layer.has_motion)
    surfaces = list((split if is_blurred else undivided)(layer, strengthened(camera, effects)))
    found = [labelled(each, layer.shape, camera, effects) for each in surfaces]
    area = stretch(layer, camera) if effects.stretches and effects.motion and layer.has_motion else None
    if area is None:
        return found
    return [
        (own, pixels._replace(radiance=pixels.radiance * each.taken(area)[..., None]))
        for each, (own, pixels) in zip(surfaces, found, strict=True)
    ]


def strengthened(camera: ThinLens, effects: Effects) -> ThinLens:
    """Return the lens amid the shutter, as wide as strengths make it, by whose blur surfaces are told apart."""
    middle = camera.at(camera.shutter_centre)
    return replace(middle, f_number=middle.f_number / effects.controls.strength)


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
    view = camera_view(layer.depth, layer.raster, camera)._replace(places=places)
    shown = layer.raster.display.width
    coc = coc_radii(layer.depth, camera, controls, shown) if defocus else np.zeros_like(length)
    if not motion or not layer.has_motion:
        return Labels(coc, np.zeros((*layer.shape, 2), np.float32), length, None, view)
    shift = layer.motion * np.float32(camera.shutter_centre) if camera.shutter_centre else None
    path = layer.motion * np.float32(camera.shutter_duration)
    for_bands(_label_kernels.path_lengths, len(length), path, length)
    labels = Labels(coc, path, length, shift, view)
    return rolled(layer, labels, camera)
