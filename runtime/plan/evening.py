"""Evening: stochastic samples, moved to where they would lie without lens, lie in clusters and leave gaps.

A sample in a gap stands for more of its surface than one in a cluster. Weighed by the area that it stands for, samples
make a mean that is less noisy by much: as of places spread evenly, not at random.

Where a surface ends, no more samples lie beside the last ones, yet they stand for no more of it. Samples that passed it
there say so: moved to where they passed, they claim their own areas, and are weighed by them, too.

Samples also lie closely where a small surface hides only part of another: through the lens both are seen at one place.
That is no cluster. So no surface gives weight to another: means of weights are 1 over samples side by side at like
depths.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import BoolArray, Image
from spreadlets.parallel import for_bands
from spreadlets.runtime.box_blur import box_blurred
from spreadlets.runtime.buffers import buffer, cleared
from spreadlets.runtime.label.labels import Labels
from spreadlets.runtime.label.lists import Pixels
from spreadlets.runtime.label.tiles import tiling
from spreadlets.runtime.plan import _evening_kernels
from spreadlets.runtime.plan.layering import BEHIND_ALL, Layering

CELL_PX, N_STEPS = 5, 128
"""Weights are 1 in the mean over cells of so many pixels and so many steps of parallax, and between them: how much of a
surface was seen is left as it is. By layers alone, lamps before a wall lost 14 % of their light, with 64 steps 4 %, and
with 128 or 256 less than 1 %."""
TILE = 8
"""Side, px, of the tiles in which it is known how a layer blurs."""
LEAST = 1e-3
"""Samples around a tile that are none: what rounding leaves."""
USUAL_PX = 3
"""How far to all sides the box reaches that, applied twice, tells how many samples are usual around."""
TIMES = 2
"""Weights by the number around are uneven still: they are evened once more, as the density of samples is compensated in
gridding (Pipe and Menon 1999). A third time gains nothing, and then large weights carry more noise than is evened."""
MARGIN_PX = 64
"""How far beyond the frame samples are counted; what lies farther keeps the weight 1."""


class Seen(NamedTuple):
    """How one sample of each pixel was taken.

    Attributes
    ----------
    there : ndarray of shape (H, W), bool
        False where one is missing.
    labels : Labels
        As the lens and the shutter that took it blur it.
    offset, lens_uv : ndarray of shape (H, W, 2), float32
        Where in its pixel it was seen, (dx, dy), px, and its place on the lens.
    time : ndarray of shape (H, W), float32
        From the middle of the shutter's time, in its length.
    """

    there: BoolArray
    labels: Labels
    offset: Image
    lens_uv: Image
    time: Image


class _Placed(NamedTuple):
    """One sample of each pixel: its layer, (H, W), int32; where it lies there, (H, W, 2), px; and its area, (H, W)."""

    layer: npt.NDArray[np.int32]
    shift: Image
    area: Image


def evened(
    pixel_sets: Sequence[Pixels], seen: Sequence[Seen], layering: Layering
) -> tuple[list[Pixels], list[list[Image]]]:
    """Weigh samples: by the area that each stands for, over the mean of those around at like depths.

    Parameters
    ----------
    pixel_sets : sequence of Pixels
        One set for each sample of a pixel, with shifts.
    seen : sequence of Seen
        Of each set.
    layering : Layering
        Depth layers, among whose samples each has its area.

    Returns
    -------
    pixel_sets : list of Pixels
        With weights.
    passing_weights : list of lists of ndarray of shape (H, W), float32
        Of each sample where it passed a layer, for each layer and set.
    """
    # Find the layer of each sample that met something; one that met nothing passed all.
    met = [np.where(each.radiance[..., 3] > 0.0, np.int32(0), np.int32(-1)) for each in pixel_sets]
    labelled = [(each.labels, there) for each, there in zip(pixel_sets, met, strict=True)]
    layer = []
    for (labels, there), taken in zip(labelled, seen, strict=True):
        met_in = np.where(there < 0, np.int32(BEHIND_ALL), layering.hard.members(labels, there).layer)
        layer.append(np.where(taken.there, met_in, np.int32(-1)))
    # Layer by layer, find the area that each stands for, and each of those that passed.
    shifts = [np.ascontiguousarray(each.labels.shift) for each in pixel_sets]
    areas, passing_weights, nothing = [cleared(there.shape) for there in met], [], cleared(met[0].shape)
    grid = [1 + math.ceil((size + 2 * MARGIN_PX) / CELL_PX) for size in met[0].shape]
    own, passed = np.zeros((2, *grid, layering.n_layers + 1, 2), np.float32)
    for number in range(layering.n_layers):
        of_layer = [_Placed(*each, cleared(nothing.shape)) for each in zip(layer, shifts, strict=True)]
        passing = _passing(layer, number, seen)
        _find_areas([*of_layer, *passing], number, len(layer))
        for sums, sets in ((own, of_layer), (passed, passing)):
            for each in sets:
                _evening_kernels.add_areas(each.layer, nothing, each.shift, each.area, CELL_PX, MARGIN_PX, sums)
        for area, each in zip(areas, of_layer, strict=True):
            area += each.area
        # What passed counts by its area over the mean around, of the whole layer.
        weighed = [(there, nothing, shift, area, CELL_PX, MARGIN_PX, own) for there, shift, area in passing]
        passing_weights.append(_weights(weighed, [each.layer for each in passing], passed))
    # Weigh each by its area over the mean of those around: of its own surface, and of those that passed.
    steps = Layering.equal(labelled, N_STEPS, 1.0)
    members = [steps.members(*each) for each in labelled]
    sums = np.zeros((*grid, steps.n_layers + 1, 2), np.float32)
    placed = [
        (member.layer, member.farther, shift, area, CELL_PX, MARGIN_PX, sums)
        for member, shift, area in zip(members, shifts, areas, strict=True)
    ]
    for given in placed:
        _evening_kernels.add_areas(*given)
    weights = _weights(placed, layer, passed)
    return [each._replace(weight=weight) for each, weight in zip(pixel_sets, weights, strict=True)], passing_weights


def _weights(placed: Sequence[tuple[Any, ...]], layer: Sequence[npt.NDArray[np.int32]], passed: Image) -> list[Image]:
    """Return the weights of samples, see `_evening_kernels.weigh_samples`."""
    weights = [np.empty(there.shape, np.float32) for there in layer]
    for each, there, weight in zip(placed, layer, weights, strict=True):
        for_bands(_evening_kernels.weigh_samples, len(weight), *each, there, passed, weight)
    return weights


def _passing(layer: Sequence[npt.NDArray[np.int32]], number: int, seen: Sequence[Seen]) -> list[_Placed]:
    """Return the samples that passed a layer near what it holds, where they did."""
    blurs, found = _blurs(layer, number, seen), []
    for there, taken in zip(layer, seen, strict=True):
        passing, shift = np.empty(there.shape, np.int32), buffer((*there.shape, 2))
        given = there, number, (taken.offset, taken.lens_uv, taken.time), blurs, TILE
        for_bands(_evening_kernels.move_passing, len(there), *given, shift, passing)
        found.append(_Placed(passing, shift, cleared(there.shape)))
    return found


def _find_areas(placed: Sequence[_Placed], number: int, n_samples: int) -> None:
    """Fill the areas of the samples of a layer, of so many in each pixel."""
    bins = max(1, round(n_samples**0.5))  # about one sample in each
    given = bins, MARGIN_PX
    shape = tuple(size + 2 * MARGIN_PX for size in placed[0].layer.shape)
    count = cleared((shape[0] * bins, shape[1] * bins))
    for each in placed:
        _evening_kernels.count_samples(each.layer, number, each.shift, *given, count)
    # A share against what is usual around does not shift weight to where fewer and fewer are seen.
    usual, weight = box_blurred(_in_pixels(count, bins), USUAL_PX, times=2), count
    for _ in range(TIMES):
        uneven, weight = weight, buffer(count.shape)
        for_bands(_evening_kernels.even_out, len(count), uneven, usual, bins, weight)
    for each in placed:
        own = each.layer, number, each.shift, *given, count, weight, each.area
        for_bands(_evening_kernels.find_areas, len(each.layer), *own)


def _blurs(layer: Sequence[npt.NDArray[np.int32]], number: int, seen: Sequence[Seen]) -> Image:
    """Return how a layer blurs around each tile, see `_evening_kernels.move_passing`."""
    sums = np.zeros((4, *tiling(layer[0].shape, TILE)), np.float32)
    for there, taken in zip(layer, seen, strict=True):
        blur = taken.labels.coc, taken.labels.whole_path
        for_bands(_evening_kernels.sum_blurs, sums.shape[1], there, number, *blur, TILE, sums)
    # What passed was seen as far from the layer's samples as these blur; what turns blurs there as those beside do.
    share, coc, *path = np.abs(sums)
    reach = np.max((coc + 0.5 * np.hypot(*path)) / np.maximum(share, 1.0))
    beside, around = (np.stack([box_blurred(each, half) for each in sums]) for half in (1, 1 + math.ceil(reach / TILE)))
    around = np.where(beside[:1] > LEAST, beside, around)
    return np.asarray(around / np.where(around[:1] > LEAST, around[:1], np.float32(np.inf)), np.float32)


def _in_pixels(values: Image, bins: int) -> Image:
    """Return the sums over the bins of each pixel."""
    total = np.zeros([size // bins for size in values.shape], np.float32)
    for row, col in np.ndindex(bins, bins):
        total += values[row::bins, col::bins]
    return total
