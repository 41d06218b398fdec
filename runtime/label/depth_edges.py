"""Antialiased depth: a pixel whose depth is a blend of two surfaces lies at neither; it is given back to both."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import Image
from spreadlets.parallel import for_bands
from spreadlets.runtime.label import _edge_kernels
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.frame import Layer

Place = npt.NDArray[np.int_]

LEAST_GAP = 1.0
"""Difference of CoC radii, px, from which two surfaces are worth telling apart."""
FLATNESS = 0.2
"""A surface's own change of CoC over a pixel, as a share of the gap: on a slanted surface it would be a half."""


def split_depth_edges(layer: Layer, camera: ThinLens) -> Iterator[tuple[Layer, Image | None]]:
    """Yield layers of the same colours whose labels are those of real surfaces, with the share of each pixel.

    Parameters
    ----------
    layer : Layer
        Its depth may be antialiased.
    camera : ThinLens
        Depths are compared by their CoC.

    Yields
    ------
    layer : Layer
        The layer itself, if no pixel is a blend; else one with the farther and one with the nearer surfaces.
    share : ndarray of shape (H, W), float32, or None
        Weight of each pixel; None if all are 1.
    """
    height, width = layer.shape
    near, far = np.empty((2, height, width, 2), np.int32)
    share = np.empty((height, width), np.float32)
    limits = camera.coc_scale(layer.raster.display.width), LEAST_GAP, FLATNESS
    if not sum(for_bands(_edge_kernels.find_blends, height, layer.depth, layer.radiance, *limits, near, far, share)):
        yield layer, None
        return
    blends = np.nonzero(share)
    yield _relabelled(layer, blends, tuple(far[blends].T)), np.float32(1) - share
    yield _relabelled(layer, blends, tuple(near[blends].T)), share


def _relabelled(layer: Layer, blends: tuple[Place, ...], surface: tuple[Place, ...]) -> Layer:
    """Return the layer with the labels of blends, at (rows, cols), taken from a surface beside them."""

    def relabel(labels: Image) -> Image:
        labels = labels.copy()
        labels[blends] = labels[surface]
        return labels

    before, after = layer.motion_prev, layer.motion_next
    return replace(
        layer,
        depth=relabel(layer.depth),
        motion=relabel(layer.motion),
        motion_prev=None if before is None else relabel(before),
        motion_next=None if after is None else relabel(after),
    )
