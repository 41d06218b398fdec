"""Evening: stochastic samples, moved to where they would lie without lens, lie in clusters and leave gaps.

A sample in a gap stands for more of its surface than one in a cluster. Weighed by the area that it stands for, samples
make a mean that is less noisy by much: as of places spread evenly, not at random.

Samples also lie closely where a small surface hides only part of another: through the lens both are seen at one place.
That is no cluster. So no surface gives weight to another: means of weights are 1 over samples side by side at like
depths.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from spreadlets.arrays import Image
from spreadlets.parallel import for_bands
from spreadlets.runtime.box_blur import box_blurred
from spreadlets.runtime.buffers import buffer, cleared
from spreadlets.runtime.label.lists import Pixels
from spreadlets.runtime.plan import _evening_kernels
from spreadlets.runtime.plan.layering import Layering

CELL_PX, N_STEPS = 5, 128
"""Weights are 1 in the mean over cells of so many pixels and so many steps of parallax, and between them: how much of a
surface was seen is left as it is. By layers alone, lamps before a wall lost 14 % of their light, with 64 steps 4 %, and
with 128 or 256 less than 1 %."""
USUAL_PX = 3
"""How far to all sides the box reaches that, applied twice, tells how many samples are usual around."""
TIMES = 2
"""Weights by the number around are uneven still: they are evened once more, as the density of samples is compensated in
gridding (Pipe and Menon 1999). A third time gains nothing, and then large weights carry more noise than is evened."""
MARGIN_PX = 64
"""How far beyond the frame samples are counted; what lies farther keeps the weight 1."""


def evened(pixel_sets: Sequence[Pixels], layering: Layering) -> list[Pixels]:
    """Return samples with weights: the area that a sample stands for, over the mean of those around at like depths.

    Parameters
    ----------
    pixel_sets : sequence of Pixels
        One set for each sample of a pixel, with shifts.
    layering : Layering
        Depth layers, among whose samples each has its area.
    """
    # Find the layer of each sample that met something, and, layer by layer, the area that each stands for.
    met = [np.where(each.radiance[..., 3] > 0.0, np.int32(0), np.int32(-1)) for each in pixel_sets]
    labelled = [(each.labels, there) for each, there in zip(pixel_sets, met, strict=True)]
    hard = layering.hard
    layer = [np.where(there < 0, there, hard.members(labels, there).layer) for labels, there in labelled]
    shifts = [np.ascontiguousarray(each.labels.shift) for each in pixel_sets]
    areas = [np.zeros(there.shape, np.float32) for there in met]
    for number in range(layering.n_layers):
        _find_areas(layer, number, shifts, areas)
    # Weigh each by its area over the mean of those around, of its own surface.
    steps = Layering.equal(labelled, N_STEPS, 1.0)
    members = [steps.members(*each) for each in labelled]
    cells = [1 + math.ceil((size + 2 * MARGIN_PX) / CELL_PX) for size in met[0].shape]
    sums = np.zeros((*cells, steps.n_layers + 1, 2), np.float32)
    placed = [
        (member.layer, member.farther, shift, area, CELL_PX, MARGIN_PX, sums)
        for member, shift, area in zip(members, shifts, areas, strict=True)
    ]
    for each in placed:
        _evening_kernels.add_areas(*each)
    weights = [np.empty(there.shape, np.float32) for there in met]
    for each, weight in zip(placed, weights, strict=True):
        for_bands(_evening_kernels.weigh_samples, len(weight), *each, weight)
    return [each._replace(weight=weight) for each, weight in zip(pixel_sets, weights, strict=True)]


def _find_areas(layer: Sequence[Image], number: int, shifts: Sequence[Image], areas: Sequence[Image]) -> None:
    """Fill the areas of the samples of a layer."""
    bins = max(1, round(len(layer) ** 0.5))  # about one sample in each
    given = bins, MARGIN_PX
    shape = tuple(size + 2 * MARGIN_PX for size in layer[0].shape)
    count = cleared((shape[0] * bins, shape[1] * bins))
    for there, shift in zip(layer, shifts, strict=True):
        _evening_kernels.count_samples(there, number, shift, *given, count)
    # A share against what is usual around does not shift weight to where fewer and fewer are seen, or to a rim.
    usual, weight = box_blurred(_in_pixels(count, bins), USUAL_PX, times=2), count
    for _ in range(TIMES):
        uneven, weight = weight, buffer(count.shape)
        for_bands(_evening_kernels.even_out, len(count), uneven, usual, bins, weight)
    for there, shift, found in zip(layer, shifts, areas, strict=True):
        for_bands(_evening_kernels.find_areas, len(there), there, number, shift, *given, count, weight, found)


def _in_pixels(values: Image, bins: int) -> Image:
    """Return the sums over the bins of each pixel."""
    total = np.zeros([size // bins for size in values.shape], np.float32)
    for row, col in np.ndindex(bins, bins):
        total += values[row::bins, col::bins]
    return total
