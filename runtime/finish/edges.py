"""Edges in focus: where a layer is sharp, its samples say what the pixels show that they were seen in.

Of a sharp layer few samples fall in each pixel, and behind something out of focus often none. It is filled from around,
which blurs its edges. There, the mean of what the samples differ from the layer is the edge that was lost. A mean along
the edge takes in many samples, and blurs nothing (steering kernel regression; Takeda, Farsiu and Milanfar 2007).

How much is lost grows with the slope of the edge, and nothing is lost where the layer is even. So one number for each
layer, the mean square of what is lost by the square of the slope, tells with the noise of each mean how far it is to be
believed (Wiener). Samples of what is out of focus, or moves, say nothing of where an edge lies, and take no part.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from spreadlets.arrays import Image
from spreadlets.parallel import for_bands
from spreadlets.runtime.box_blur import box_blurred
from spreadlets.runtime.finish import _edge_kernels
from spreadlets.runtime.finish._edge_kernels import UNSTEERED

SHARP_REACH = 1.5
"""CoC radius and half a path, px, up to which a sample is sharp."""
LEAST_SHARE = 1e-3
"""Alpha of a layer from which it counts."""
LEAST_SLOPE = 0.04
"""Share of its brightness by which a layer changes from pixel to pixel, at least, where it has an edge."""
WINDOW_REACH = 4
WINDOW_AXES = 6.0, 1.5, 2.8
"""Half lengths, px, of windows along an edge, across it, and where slopes have no direction."""
SLOPE_HALF, SHARE_HALF = 1, 2
"""Half widths, px, of the boxes, applied twice, over which slopes and the share of sharp samples are averaged."""
TINY = np.float32(1e-6)
MARGIN = 2 * WINDOW_REACH
"""Rows beyond those of sharp samples that take part: boxes and windows reach no farther together."""


class PlacedSamples(NamedTuple):
    """One sample of each pixel, and where it lies among the layers.

    Attributes
    ----------
    radiance : ndarray of shape (H, W, 4), float32
    place : ndarray of shape (H, W), float32
        The number of the nearer of its layers plus the share of the next one; below -1 where there is no sample.
    coc, length : ndarray of shape (H, W), float32
        CoC radius and length of the path, px.
    """

    radiance: Image
    place: Image
    coc: Image
    length: Image


class SharpSamples(NamedTuple):
    """The sharp samples of a layer: sums of their colours (H, W, 3) and shares (H, W), and the shares of all of it."""

    total: Image
    share: Image
    every: Image


def sharp_samples(samples: Sequence[PlacedSamples], number: int) -> SharpSamples | None:
    """Return the sharp samples of a layer; None if there are none.

    Parameters
    ----------
    samples : sequence of PlacedSamples
        One for each sample of a pixel.
    number : int
        The layer.
    """
    shape = samples[0].place.shape
    found = SharpSamples(np.zeros((*shape, 3), np.float32), *np.zeros((2, *shape), np.float32))
    for each in samples:
        for_bands(_edge_kernels.add_sharp, shape[0], *each, number, SHARP_REACH, *found)
    return found if found.share.any() else None


def keep_edges(layer: Image, sharp: SharpSamples, floor: float) -> None:
    """Bring the edges of a layer to its sharp samples, in place.

    Parameters
    ----------
    layer : ndarray of shape (H, W, 4), float32
        What the layer adds to an image, premultiplied; its alpha stays.
    sharp : SharpSamples
    floor : float
        Brightness below which noise does not get less.
    """
    # Take the rows around sharp samples.
    rows = np.flatnonzero(sharp.share.any(axis=1))
    band = slice(max(int(rows[0]) - MARGIN, 0), int(rows[-1]) + 1 + MARGIN)
    layer, (total, count, every) = layer[band], (each[band] for each in sharp)
    # Find what the layer lacks there, and which way its edges run.
    height, shape = len(layer), layer.shape[:2]
    logarithm, lacking = np.empty(shape, np.float32), np.empty((*shape, 3), np.float32)
    given = layer, total, count, floor, LEAST_SHARE
    for_bands(_edge_kernels.find_lacking, height, *given, logarithm, lacking)
    products = np.empty((3, *shape), np.float32)
    for_bands(_edge_kernels.multiply_slopes, height, logarithm, products)
    products = np.stack([box_blurred(each, SLOPE_HALF, times=2) for each in products])
    # Average along edges, and see how much is lost of a slope, less what is noise.
    mean, variance = np.zeros_like(lacking), np.empty(shape, np.float32)
    windows = lacking, count, products, LEAST_SLOPE, WINDOW_REACH, WINDOW_AXES
    for_bands(_edge_kernels.steered_means, height, *windows, mean, variance)
    edge = (variance != UNSTEERED) & (count > 0.0)
    slope = (products[0] + products[2])[edge].astype(np.float64)
    lost = np.square(mean[edge], dtype=np.float64).sum(axis=-1) - variance[edge]
    power = float(slope @ lost) / max(float(slope @ slope), 1e-30)
    if power <= 0.0:
        return
    # Add as much of it as is believed, where the layer is sharp.
    near = box_blurred(count, SHARE_HALF, times=2) / np.maximum(box_blurred(every, SHARE_HALF, times=2), TINY)
    for_bands(_edge_kernels.add_edges, height, layer, mean, variance, products, np.minimum(near, 1.0), power, floor)
