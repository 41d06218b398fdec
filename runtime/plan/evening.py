"""Evening: stochastic samples, moved to where they would lie without lens, lie in clusters and leave gaps.

A sample in a gap stands for more of its surface than one in a cluster. Weighed by the area that it stands for, samples
make a mean that is less noisy by much: as of places spread evenly, not at random.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from spreadlets.arrays import Image
from spreadlets.parallel import for_bands
from spreadlets.runtime.box_blur import box_blurred
from spreadlets.runtime.label.lists import Pixels
from spreadlets.runtime.plan import _evening_kernels
from spreadlets.runtime.plan.layering import Layering

SURROUNDINGS_PX = 4
"""Weights are 1 in the mean over the pixels this far to all sides: how much of a surface was seen is left as it is."""
USUAL_PX = 3
"""How far to all sides the box reaches that, applied twice, tells how many samples are usual around."""
MARGIN_PX = 64
"""How far beyond the frame samples are counted; what lies farther keeps the weight 1."""


def evened(pixel_sets: Sequence[Pixels], n_layers: int) -> list[Pixels]:
    """Return samples with weights: of each layer, the area that a sample stands for, over the mean of those around.

    Parameters
    ----------
    pixel_sets : sequence of Pixels
        One set for each sample of a pixel, with shifts.
    n_layers : int
        Depth layers: samples on different surfaces do not stand for one another.
    """
    # Find the layer of each sample that met something.
    met = [np.where(each.radiance[..., 3] > 0.0, np.int32(0), np.int32(-1)) for each in pixel_sets]
    layering = Layering.equal(
        [(each.labels, there) for each, there in zip(pixel_sets, met, strict=True)], n_layers, 0.0
    )
    layer = [
        np.where(there < 0, there, layering.members(each.labels, there).layer)
        for each, there in zip(pixel_sets, met, strict=True)
    ]
    # Weigh them, layer by layer.
    weights = [np.ones(there.shape, np.float32) for there in met]
    shifts = [np.ascontiguousarray(each.labels.shift) for each in pixel_sets]
    for number in range(layering.n_layers):
        _weigh_layer(layer, number, shifts, weights)
    return [each._replace(weight=weight) for each, weight in zip(pixel_sets, weights, strict=True)]


def _weigh_layer(layer: Sequence[Image], number: int, shifts: Sequence[Image], weights: Sequence[Image]) -> None:
    """Fill the weights of the samples of a layer."""
    bins = max(1, round(len(layer) ** 0.5))  # about one sample in each
    given = bins, MARGIN_PX
    shape = tuple(size + 2 * MARGIN_PX for size in layer[0].shape)
    count = np.zeros((shape[0] * bins, shape[1] * bins), np.float32)
    for there, shift in zip(layer, shifts, strict=True):
        _evening_kernels.count_samples(there, number, shift, *given, count)
    # A share against what is usual around does not shift weight to where fewer and fewer are seen, or to a rim.
    per_pixel = _in_pixels(count, bins)
    usual, area = box_blurred(per_pixel, USUAL_PX, times=2), np.empty_like(count)
    for_bands(_evening_kernels.share_area, len(count), count, usual, bins, area)
    sums = np.stack([box_blurred(each, SURROUNDINGS_PX) for each in (per_pixel, _in_pixels(count * area, bins))])
    for there, shift, weight in zip(layer, shifts, weights, strict=True):
        for_bands(_evening_kernels.weigh_samples, len(there), there, number, shift, *given, area, sums, weight)


def _in_pixels(values: Image, bins: int) -> Image:
    """Return the sums over the bins of each pixel."""
    total = np.zeros([size // bins for size in values.shape], np.float32)
    for row, col in np.ndindex(bins, bins):
        total += values[row::bins, col::bins]
    return total
