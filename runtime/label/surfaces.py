"""Mixed pixels: where surfaces of several depths show in one pixel, each gets its share, its colour and its labels."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import Image
from spreadlets.parallel import for_bands
from spreadlets.runtime.label import _label_kernels, _surface_kernels
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.frame import Layer

LEAST_GAP = 1.0
"""Difference of CoC radii, px, from which two surfaces are worth telling apart."""


def split_surfaces(layer: Layer, camera: ThinLens) -> Iterator[tuple[Layer, Image | None]]:
    """Yield layers that each hold one surface of every pixel, with its share of the pixel.

    Colours are filtered: a pixel at an edge, or with a thin thing in it, shows several surfaces, while it has one depth
    and one motion. Shares and colours of the surfaces are those most likely, given the colours of purer pixels around,
    and how point samples of the depth are spread along the edge. They add up to the pixel's colour.

    Parameters
    ----------
    layer : Layer
    camera : ThinLens
        Depths are compared by their CoC.

    Yields
    ------
    layer : Layer
        The layer itself, if no pixel is mixed; else first each pixel's own surface, then others.
    share : ndarray of shape (H, W), float32, or None
        Weight of each pixel; None if all are 1.

    Notes
    -----
    Bayesian matting (Chuang et al. 2001) in closed form, for up to three surfaces, whose depths are known.
    """
    height, width = layer.shape
    place, purity = np.empty((2, height, width), np.float32)
    optics = camera.coc_scale(width), 1.0 / camera.focus_distance_m
    for_bands(_label_kernels.coc_radii, height, layer.depth, *optics, place)
    place[layer.radiance[..., 3] == 0.0] = np.inf
    for_bands(_surface_kernels.find_purity, height, place, LEAST_GAP, purity)
    source = np.empty((height, width, _surface_kernels.MOST, 2), np.int32)
    share = np.empty((height, width, _surface_kernels.MOST), np.float32)
    colours = np.empty((height, width, _surface_kernels.MOST, 4), np.float32)
    found = source, share, colours
    if not sum(for_bands(_surface_kernels.divide_pixels, height, place, layer.radiance, purity, LEAST_GAP, *found)):
        yield layer, None
        return
    for number in range(_surface_kernels.MOST):
        weight = np.ascontiguousarray(share[:, :, number])
        if weight.any():
            yield _surface(layer, np.ascontiguousarray(colours[:, :, number]), source[:, :, number]), weight


def _surface(layer: Layer, colours: Image, source: npt.NDArray[np.int32]) -> Layer:
    """Return a layer of the given colours whose labels are those of the pixels at (row, col)."""
    place = source[..., 0], source[..., 1]
    before, after = layer.motion_prev, layer.motion_next
    return replace(
        layer,
        radiance=colours,
        depth=layer.depth[place],
        motion=layer.motion[place],
        motion_prev=None if before is None else before[place],
        motion_next=None if after is None else after[place],
    )
