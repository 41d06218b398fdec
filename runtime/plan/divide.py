"""A frame of one layer, divided by depth, with what its nearer layers hide."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from spreadlets.parallel import for_bands
from spreadlets.runtime.label.lists import Pixels
from spreadlets.runtime.label.moving import Effects
from spreadlets.runtime.label.pixels import frame_surfaces, hidden_pixels, labelled, strengthened, surface_pixels
from spreadlets.runtime.label.reprojection import reproject
from spreadlets.runtime.label.surfaces import SharedSurfaces, Split, Surface, split_surfaces
from spreadlets.runtime.options import FRAME_SOFTNESS, MOST_LAYERS
from spreadlets.runtime.plan import _cut_kernels
from spreadlets.runtime.plan.behind import find_behind
from spreadlets.runtime.plan.layering import Layering
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.frame import Layer


class Divided(NamedTuple):
    """What a frame of one layer gives to draw.

    Attributes
    ----------
    pixel_sets : list of lists of Pixels
        Of each frame what is seen, then a list of what is hidden, if there is anything.
    n_hidden : int
        1 if there is such a list, else 0.
    layering : Layering
        The depth layers.
    known : ndarray of shape (H, W), uint64
        Bits of the layers in which each pixel is known, see `runtime.plan.behind.Behind`.
    """

    pixel_sets: list[list[Pixels]]
    n_hidden: int
    layering: Layering
    known: npt.NDArray[np.uint64]


def divide_frames(
    layers: Sequence[Layer],
    camera: ThinLens,
    effects: Effects,
    *,
    most: int = MOST_LAYERS,
    softness: float = FRAME_SOFTNESS,
    split: Split = split_surfaces,
    neighbours: Sequence[Layer] = (),
    hidden: bool = True,
) -> Divided:
    """Divide frames of one layer by depth, all as the first, and find what is hidden in them.

    Parameters
    ----------
    layers : sequence of Layer
        They differ in their colours only.
    camera : ThinLens
    effects : Effects
    most : int
        Depth layers at most.
    softness : float
        Width of the transition between them, in layers.
    split : callable
        Divides mixed pixels between their surfaces.
    neighbours : sequence of Layer
        The frames right before or after that of a single layer, see `runtime.label.reprojection.reproject`.
    hidden : bool
        Whether what is hidden is looked for.
    """
    # Divide what is seen into depth layers.
    shared = SharedSurfaces(split)
    surfaces, *further = (frame_surfaces(each, camera, effects, shared) for each in layers)
    seen = [surface_pixels(each, camera, effects) for each in (surfaces, *further)]
    drawn = [(each.labels, _drawn(each)) for each in seen[0]]
    layering = Layering.fitted(drawn[:1], most, softness, drawn[1:])
    del drawn
    if layering.n_layers == 1 or not hidden:
        return Divided(seen, 0, layering, np.zeros(layers[0].shape, np.uint64))
    # Find what nearer ones hide of each.
    elsewhere = None
    if neighbours:
        farther, there = reproject(layers[0], neighbours, strengthened(camera, effects))
        elsewhere = labelled(Surface(farther, there), farther.shape, camera, effects)
    behind = find_behind(surfaces, layering, elsewhere, further)
    if behind[0].surface is None:
        return Divided(seen, 0, layering, behind[0].known)
    for sets, each in zip(seen, behind, strict=True):
        assert each.surface is not None, "all frames hide the same"
        listed = labelled(each.surface, layers[0].shape, camera, effects)
        sets.append(hidden_pixels(listed, camera, effects, sets[0].radiance))
    return Divided(seen, 1, layering, behind[0].known)


def _drawn(pixels: Pixels) -> npt.NDArray[np.int32]:
    """Return 0 for the pixels that there are, -1 for all others."""
    drawn = np.empty(pixels.radiance.shape[:2], np.int32)
    for_bands(_cut_kernels.mark_drawn, len(drawn), pixels.radiance, pixels.weight, drawn)
    if pixels.curved is not None:
        drawn[pixels.curved] = 0
    return drawn
