"""What lies behind: surfaces that nearer ones hide, found before anything is blurred.

A blur shows what a sharp image hides: beside a near thing out of focus, and through it. Layer by layer, what nearer
ones hide of it is taken from neighbouring frames of the sequence, if there are any, and else guessed: where what was
seen around looks like some other place, what lies there is copied. What is not found so is left to compositing.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import DoubleArray, Image, IntArray
from spreadlets.parallel import for_bands
from spreadlets.runtime.label.pixels import Labelled
from spreadlets.runtime.label.surfaces import take_features, with_features
from spreadlets.runtime.plan import _behind_kernels
from spreadlets.runtime.plan.layering import Layering
from spreadlets.scene.frame import Layer

LEAST_GAP = 1.5
"""Width of gaps, in a layer's own blur, from which its texture shows in them; narrower ones its blur fills."""
FAR_BLUR = 2.0
"""How far a layer's blur may reach, in its mean one: a few pixels far out of focus do not widen what is looked up."""


class Behind(NamedTuple):
    """The hidden surfaces of a frame.

    Attributes
    ----------
    layer : Layer
        The hidden surface of each pixel, of several the largest.
    share : ndarray of shape (H, W), float32
        Share of the pixel that it would have if nothing nearer were there; 0 where there is none.
    known : ndarray of shape (H, W), uint64
        Bit k says that all of depth layer k in the pixel is known: seen, or the hidden surface.
    """

    layer: Layer
    share: Image
    known: npt.NDArray[np.uint64]


class _Pass(NamedTuple):
    """A surface of each pixel: its depth layers and their shares, its colours, weights and how far it blurs, px."""

    layer: npt.NDArray[np.int32]
    farther: Image
    radiance: Image
    weight: Image
    blur: Image


def find_behind(
    surfaces: Sequence[Labelled],
    layering: Layering,
    elsewhere: Labelled | None = None,
    further: Sequence[Sequence[Labelled]] = (),
) -> list[Behind]:
    """Find the hidden surfaces of a frame, and of further ones whose surfaces differ in their colours only.

    Parameters
    ----------
    surfaces : sequence of (layer, pixels)
        What is seen.
    layering : Layering
        Its depth layers.
    elsewhere : (layer, pixels), optional
        What neighbouring frames show behind each pixel, with weight 0 where they show nothing; only of a frame alone.
    further : sequence of sequences of (layer, pixels)
        What is hidden in them is copied from the same places.
    """
    # What is hidden: layer, share of the pixel, and features of each frame; and the layers in which pixels are known.
    first, passes = surfaces[0][0], [_pass_of(each, layering) for each in surfaces]
    shape, n_features = first.shape, 4 + len(first.depths) + 2 * len(first.motions)
    frames = [surfaces, *further]
    hidden = [
        (np.zeros(shape, np.int32), np.zeros(shape, np.float32), np.zeros((*shape, n_features), np.float32))
        for _ in frames
    ]
    corner = surfaces[0][1].labels.view.corner
    nearer, reach = np.zeros((2, *shape), np.float32)
    known = [np.ones(shape, np.uint64) for _ in frames]
    for number in range(layering.n_layers):
        cover, sums, hidden_reach = np.zeros(shape, np.float32), np.zeros((shape[0], 3)), reach.copy()
        for each in passes:
            for_bands(_behind_kernels.add_cover, shape[0], *each, number, cover, reach, sums)
        if number and sums[:, 0].any():
            if elsewhere is not None:
                there = _pass_of(elsewhere, layering)
                given = nearer, there.layer, there.weight, take_features(elsewhere[0], first)
                for_bands(_behind_kernels.take_elsewhere, shape[0], *given, number, hidden[0], known[0])
            gap, unlike = _choose(nearer, cover, hidden_reach, sums, corner)
            if (unlike >= 0.0).any():
                shown = _features(passes, surfaces, number, n_features)
                places = _places(nearer, shown, corner, unlike)
                for index, frame in enumerate(frames):
                    # The same places, in the frame's own colours.
                    own = _features(passes, frame, number, n_features) if index else shown
                    found = number, hidden[index], known[index]
                    for_bands(_behind_kernels.find_behind, shape[0], nearer, own, gap, corner, *places, *found)
        nearer += cover
    return [
        Behind(with_features(first, features), share, own)
        for (_, share, features), own in zip(hidden, known, strict=True)
    ]


def _features(passes: Sequence[_Pass], surfaces: Sequence[Labelled], number: int, n_features: int) -> Image:
    """Return what the surfaces of a frame show of a layer, see the kernel."""
    shape = surfaces[0][0].shape
    shown = np.zeros((*shape, n_features + 1), np.float32)
    for each, (layer, _) in zip(passes, surfaces, strict=True):
        given = each._replace(radiance=layer.radiance)
        for_bands(_behind_kernels.add_features, shape[0], *given, layer.depths, layer.motions, number, shown)
    return shown


def _pass_of(surface: Labelled, layering: Layering) -> _Pass:
    layer, pixels = surface
    members = layering.members(pixels.labels, np.zeros(layer.shape, np.int32))
    blur = np.abs(pixels.labels.coc) + np.float32(0.5) * pixels.labels.length
    return _Pass(members.layer, members.farther, layer.radiance, pixels.weight, blur)


def _choose(
    nearer: Image, cover: Image, reach: Image, sums: DoubleArray, corner: tuple[int, int]
) -> tuple[Image, DoubleArray]:
    """Return the widths of a layer's gaps, and which blocks of pixels are to be looked up, see the kernels."""
    own, height = float(sums[:, 1].sum() / sums[:, 0].sum()), len(nearer)
    across, gap = np.empty(nearer.shape, np.int32), np.empty_like(nearer)
    for_bands(_behind_kernels.row_distances, height, nearer, across)
    farthest = min(float(sums[:, 2].max()), FAR_BLUR * own)
    for_bands(_behind_kernels.find_gaps, height, nearer, across, reach, farthest, gap)
    size = _behind_kernels.BLOCK
    unlike = np.empty([-(-(side + at % size) // size) for side, at in zip(nearer.shape, corner, strict=True)])
    for_bands(_behind_kernels.choose_blocks, len(unlike), nearer, cover, gap, LEAST_GAP * own, corner, unlike)
    return gap, unlike


def _places(
    nearer: Image, features: Image, corner: tuple[int, int], unlike: DoubleArray
) -> tuple[IntArray, DoubleArray]:
    """Return for each block where what was seen around it is most alike, and how unlike.

    Notes
    -----
    PatchMatch (Barnes et al. 2009), for blocks and with trials that are the same each time.
    """
    places = np.empty((*unlike.shape, 2), np.int64)
    for_bands(_behind_kernels.try_places, len(unlike), nearer, features, corner, places, unlike)
    for _ in range(_behind_kernels.ROUNDS):
        before = places, unlike
        places, unlike = np.empty_like(places), np.empty_like(unlike)
        for_bands(_behind_kernels.spread_places, len(unlike), nearer, features, corner, *before, places, unlike)
    return places, unlike
