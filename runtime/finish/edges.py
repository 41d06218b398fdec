"""Edges in focus, and outlines: there, samples say what the pixels show that they were seen in.

Of a sharp layer few samples fall in each pixel, and behind something out of focus often none. It is filled from around,
which blurs its edges. There, the mean of what the samples differ from the layer is the edge that was lost. A mean along
the edge takes in many samples, and blurs nothing (steering kernel regression; Takeda, Farsiu and Milanfar 2007). So it
is with a layer's outlines: there, its cover differs from the share of the samples that met it.

A sample is compared with the layer right where it was seen, not at its pixel's centre: what differs is less noisy by as
much as the layer varies within a pixel. Its mean is not quite 0 where the layer is right: edges become sharper by what
the mean over a pixel would blur them. That makes up for part of what is believed too little: a comparison that is right
in the mean was worse on three of five scenes and better on none, with 1 to 16 samples in each pixel.

How much is lost grows with the slope of the edge, and nothing is lost where the layer is even. So one number for each
layer, the mean square of what is lost by the square of the slope, tells with the noise of each mean how far it is to be
believed (Wiener). Samples of what is out of focus, or moves across an edge, say nothing of where it lies, and take no
part; what moves along its edge, as the rings of a wheel do, does.
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
LEAST_SLOPE = 0.08
"""Share of its brightness, or cover, by which a layer changes from pixel to pixel, at least, where it has an edge."""
FOLLOWED = 12.0, 4.0
"""How far edges are followed to either side, px, where slopes around agree which way they run, and where not."""
STRAIGHT = 0.8
"""Cosine of the largest turn from a pixel to the next: an edge that turns sharper is a corner, and ends there."""
SLOPE_HALF, SHARE_HALF = 1, 2
"""Half widths, px, of the boxes, applied twice, over which slopes and the share of sharp samples are averaged."""
TINY = np.float32(1e-6)
MARGIN = 16
"""Rows beyond those of sharp samples that take part: boxes, and edges that are followed, reach no farther together."""


class PlacedSamples(NamedTuple):
    """One sample of each pixel, and where it lies among the layers.

    Attributes
    ----------
    radiance : ndarray of shape (H, W, 4), float32
    place : ndarray of shape (H, W), float32
        The number of the nearer of its layers plus the share of the next one; below -1 where there is no sample.
    coc : ndarray of shape (H, W), float32
        CoC radius, px.
    path : ndarray of shape (H, W, 2), float32
        How far it moves where it was seen, while the shutter is open, px (dx, dy).
    offset : ndarray of shape (H, W, 2), float32
        Where in its pixel it was seen, px (dx, dy) from the centre.
    """

    radiance: Image
    place: Image
    coc: Image
    path: Image
    offset: Image


def keep_edges(layer: Image, samples: Sequence[PlacedSamples], number: int, floor: float) -> None:
    """Bring the edges of a layer to its sharp samples, in place.

    Parameters
    ----------
    layer : ndarray of shape (H, W, 4), float32
        What the layer adds to an image, premultiplied; its alpha stays.
    samples : sequence of PlacedSamples
        One for each sample of a pixel.
    number : int
        The layer's.
    floor : float
        Brightness below which noise does not get less.
    """
    # Take the rows around samples in focus.
    in_focus = np.zeros(len(layer), np.bool_)
    for each in samples:
        for_bands(_edge_kernels.find_in_focus, len(layer), each.place, each.coc, number, SHARP_REACH, in_focus)
    if not in_focus.any():
        return
    rows = np.flatnonzero(in_focus)
    band = slice(max(int(rows[0]) - MARGIN, 0), int(rows[-1]) + 1 + MARGIN)
    layer, height = layer[band], len(layer[band])
    # Find which way its edges run, and what it lacks of samples that are sharp across them.
    shape = layer.shape[:2]
    logarithm, products = np.empty(shape, np.float32), np.empty((3, *shape), np.float32)
    for_bands(_edge_kernels.take_logarithms, height, layer, floor, logarithm)
    for_bands(_edge_kernels.multiply_slopes, height, logarithm, products)
    products = np.stack([box_blurred(each, SLOPE_HALF, times=2) for each in products])
    lacking, count, every = np.zeros((*shape, 3), np.float32), *np.zeros((2, *shape), np.float32)
    for each in samples:
        given = PlacedSamples(*(plane[band] for plane in each)), layer, products, number, SHARP_REACH, LEAST_SHARE
        for_bands(_edge_kernels.add_sharp, height, *given, lacking, count, every)
    for_bands(_edge_kernels.find_lacking, height, layer, count, floor, lacking)
    # Add as much of it as is believed, where the layer is sharp.
    sharp, whole = (box_blurred(each, SHARE_HALF, times=2) for each in (count, every))
    near = np.minimum(sharp / np.maximum(whole, TINY), np.float32(1.0), dtype=np.float32)
    mean, variance, power = _steered_means(lacking, count, products, near)
    if power > 0.0:
        believed = mean, variance, products, near, power, floor
        for_bands(_edge_kernels.add_edges, height, layer, *believed)


def keep_outlines(layer: Image, samples: Sequence[PlacedSamples], number: int) -> None:
    """Bring the outlines of a layer to what share of the samples met it, in place.

    Parameters
    ----------
    layer : ndarray of shape (H, W, 4), float32
        What the layer adds to an image, premultiplied; its colours stay.
    samples : sequence of PlacedSamples
        One for each sample of a pixel.
    number : int
        The layer's.
    """
    # Find which way its outlines run, if it has any.
    height, shape = len(layer), layer.shape[:2]
    cover = np.ascontiguousarray(layer[..., 3:])
    products = np.empty((3, *shape), np.float32)
    for_bands(_edge_kernels.multiply_slopes, height, cover[..., 0], products)
    if (products[0] + products[2]).max() < LEAST_SLOPE**2:
        return
    products = np.stack([box_blurred(each, SLOPE_HALF, times=2) for each in products])
    # Find what share of the samples it lacks there, and add as much of it as is believed.
    lacking, count = np.zeros((*shape, 1), np.float32), np.zeros(shape, np.float32)
    for each in samples:
        for_bands(_edge_kernels.add_seen, height, each.place, each.offset, cover, number, lacking, count)
    lacking /= np.maximum(count, 1.0)[..., None]
    mean, variance, power = _steered_means(lacking, count, products, cover[..., 0])
    if power > 0.0:
        for_bands(_edge_kernels.add_outlines, height, layer, mean, variance, products, power, LEAST_SHARE)


def _steered_means(lacking: Image, count: Image, products: Image, wanted: Image) -> tuple[Image, Image, float]:
    """Average along edges; return means, their variances, and how much is lost of a slope, less what is noise."""
    directions, mean, variance = np.empty((*count.shape, 3), np.float32), np.empty_like(lacking), np.empty_like(count)
    for_bands(_edge_kernels.find_directions, len(count), products, LEAST_SLOPE, wanted, directions)
    followed = lacking, count, directions, FOLLOWED, STRAIGHT
    for_bands(_edge_kernels.steered_means, len(count), *followed, mean, variance)
    edge = (variance != UNSTEERED) & (count > 0.0)
    slope = (products[0] + products[2])[edge].astype(np.float64)
    lost = np.square(mean[edge], dtype=np.float64).sum(axis=-1) - variance[edge]
    return mean, variance, float(slope @ lost) / max(float(slope @ slope), 1e-30)
