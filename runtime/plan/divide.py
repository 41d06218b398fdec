"""A frame of one layer, divided by depth, with what its nearer layers hide."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from spreadlets.runtime.label.lists import Pixels
from spreadlets.runtime.label.moving import Effects
from spreadlets.runtime.label.pixels import Split, frame_surfaces, hidden_pixels, labelled, surface_pixels
from spreadlets.runtime.label.reprojection import reproject
from spreadlets.runtime.label.surfaces import split_surfaces
from spreadlets.runtime.options import FRAME_SOFTNESS, MOST_LAYERS
from spreadlets.runtime.plan.behind import find_behind
from spreadlets.runtime.plan.layering import Layering
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.frame import Layer


class Divided(NamedTuple):
    """What a frame of one layer gives to draw.

    Attributes
    ----------
    pixel_sets : list of Pixels
        What is seen, then a list of what is hidden, if there is anything.
    n_hidden : int
        1 if there is such a list, else 0.
    layering : Layering
        The depth layers.
    known : ndarray of shape (H, W), uint64
        Bits of the layers in which each pixel is known, see `runtime.plan.behind.Behind`.
    """

    pixel_sets: list[Pixels]
    n_hidden: int
    layering: Layering
    known: npt.NDArray[np.uint64]


def divide_frame(
    layer: Layer,
    camera: ThinLens,
    effects: Effects,
    *,
    most: int = MOST_LAYERS,
    softness: float = FRAME_SOFTNESS,
    split: Split = split_surfaces,
    neighbours: Sequence[Layer] = (),
) -> Divided:
    """Divide a frame of one layer by depth, and find what is hidden in it.

    Parameters
    ----------
    layer : Layer
    camera : ThinLens
    effects : Effects
    most : int
        Depth layers at most.
    softness : float
        Width of the transition between them, in layers.
    split : callable
        Divides mixed pixels between their surfaces.
    neighbours : sequence of Layer
        The frames right before or after, see `runtime.label.reprojection.reproject`.
    """
    # Divide what is seen into depth layers.
    surfaces = frame_surfaces(layer, camera, effects, split)
    seen = surface_pixels(surfaces, camera, effects)
    drawn = [(each.labels, _drawn(each)) for each in seen]
    layering = Layering.fitted(drawn[:1], most, softness, drawn[1:])
    if layering.n_layers == 1:
        return Divided(seen, 0, layering, np.ones(layer.shape, np.uint64))
    # Find what nearer ones hide of each.
    elsewhere = None
    if neighbours:
        farther, there = reproject(layer, neighbours, camera)
        elsewhere = labelled(farther, there, camera, effects)
    behind = find_behind(surfaces, layering, elsewhere)
    if not behind.share.any():
        return Divided(seen, 0, layering, behind.known)
    hidden = hidden_pixels(labelled(behind.layer, behind.share, camera, effects), camera, effects, seen[0].radiance)
    return Divided([*seen, hidden], 1, layering, behind.known)


def _drawn(pixels: Pixels) -> npt.NDArray[np.int32]:
    """Return 0 for the pixels that there are, -1 for all others."""
    is_there = pixels.radiance.any(axis=2)
    if len(pixels.weight):
        is_there &= pixels.weight > 0.0
    if pixels.curved is not None:
        is_there |= pixels.curved
    return np.where(is_there, np.int32(0), np.int32(-1))
