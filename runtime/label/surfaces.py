"""Mixed pixels: where surfaces of several depths show in one pixel, each gets its share, its colour and its labels."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import partial
from threading import Lock
from typing import Any

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import Image
from spreadlets.parallel import for_bands
from spreadlets.runtime.label import _blend_kernels, _label_kernels, _surface_kernels
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.frame import Layer

LEAST_GAP = 1.0
"""Difference of CoC radii, px, from which two surfaces are worth telling apart."""
SCALES_PER_OCTAVE = 2
"""Steps of the f-number at which surfaces are told apart: between two of them the same surfaces serve."""
MOST_KEPT_PIXELS = 1 << 24
"""Labelled pixels that are kept for the next camera, some 50 bytes each."""

Surface = tuple[Layer, Image | None]
"""A layer that holds one surface of every pixel, and its share of the pixels."""
Split = Callable[[Layer, ThinLens], Iterable[Surface]]
"""Divides the mixed pixels of a layer between their surfaces."""


def split_surfaces(layer: Layer, camera: ThinLens) -> Iterator[Surface]:
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
    # Undo a filter of the depth.
    height, width = layer.shape
    layer = without_nothing(layer)
    place, known = places(layer, camera), np.full(layer.shape, -1.0, np.float32)
    if depth_is_filtered(place):
        layer, known = without_filter(layer, place)
        place = places(layer, camera)
    place[layer.radiance[..., 3] == 0.0] = np.inf
    # Divide each pixel among the surfaces around it.
    purity = np.empty_like(place)
    for_bands(_surface_kernels.find_purity, height, place, LEAST_GAP, purity)
    source = np.empty((height, width, _surface_kernels.MOST, 2), np.int32)
    share = np.empty((height, width, _surface_kernels.MOST), np.float32)
    colours = np.empty((height, width, _surface_kernels.MOST, 4), np.float32)
    weights = purity, np.empty_like(place), np.empty_like(place)
    for_bands(_surface_kernels.weigh_colours, height, layer.radiance, *weights)
    given = place, layer.radiance, weights, known, LEAST_GAP
    if not sum(for_bands(_surface_kernels.divide_pixels, height, *given, source, share, colours)):
        yield layer, None
        return
    # Gather the first surfaces of all pixels in a layer, then the second and the third.
    for number in range(_surface_kernels.MOST):
        weight = np.ascontiguousarray(share[:, :, number])
        if weight.any():
            shown = np.ascontiguousarray(colours[:, :, number])
            # The first surface is the pixel's own.
            yield _surface(layer, shown, source[:, :, number]) if number else replace(layer, radiance=shown), weight


def undivided(layer: Layer, camera: ThinLens) -> list[Surface]:
    """Return a layer as it is, its mixed pixels with the labels that they have: a `Split` that divides none."""
    return [(layer, None)]


def places(layer: Layer, camera: ThinLens) -> Image:
    """Return where a layer's surfaces lie in depth, as CoC radii, px, shape (H, W), float32."""
    place = np.empty(layer.shape, np.float32)
    for_bands(_label_kernels.coc_radii, len(place), layer.depth, _scale(layer, camera), 0.0, place)
    return place


def _scale(layer: Layer, camera: ThinLens) -> float:
    """Return the CoC of an inverse depth, px metres, rounded up to one of `SCALES_PER_OCTAVE`."""
    scale = camera.coc_scale(layer.raster.display.width)
    return float(np.exp2(np.ceil(SCALES_PER_OCTAVE * np.log2(scale)) / SCALES_PER_OCTAVE))


class KeptSurfaces:
    """Splits layers as `split_surfaces` does, and keeps what it found: focus and shutter do not change it.

    It may be used from several threads.
    """

    def __init__(self) -> None:
        self._kept: OrderedDict[tuple[int, float], tuple[Layer, list[Surface]]] = OrderedDict()
        self._lock = Lock()

    def __call__(self, layer: Layer, camera: ThinLens) -> Iterable[Surface]:
        """Return the surfaces of a layer, see `split_surfaces`; those of a very large one are not kept."""
        if _surface_kernels.MOST * layer.depth.size > MOST_KEPT_PIXELS:
            return split_surfaces(layer, camera)
        key = id(layer), _scale(layer, camera)
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key][1]
        found = list(split_surfaces(layer, camera))
        with self._lock:
            # The layer is kept as long as its number stands for it.
            self._kept[key] = layer, found
            n_pixels = [len(surfaces) * each.depth.size for each, surfaces in self._kept.values()]
            while len(self._kept) > 1 and sum(n_pixels) > MOST_KEPT_PIXELS:
                self._kept.popitem(last=False)
                n_pixels.pop(0)
        return found


class SharedSurfaces:
    """Splits the first layer that it is given, and others that differ in their colours only among the same surfaces.

    Parameters
    ----------
    split : callable
        Splits the first.
    """

    def __init__(self, split: Split) -> None:
        self._split, self._surfaces = split, list[Surface]()

    def __call__(self, layer: Layer, camera: ThinLens) -> list[Surface]:
        """Return the surfaces of a layer."""
        if not self._surfaces:
            self._surfaces = list(self._split(layer, camera))
            return self._surfaces
        shares = [share for _, share in self._surfaces if share is not None]
        if not shares:
            return [(replace(surface, radiance=layer.radiance), None) for surface, _ in self._surfaces]
        place = np.stack([places(surface, camera) for surface, _ in self._surfaces])
        colours = np.empty((*place.shape, 4), np.float32)
        given = layer.radiance, place, np.stack(shares)
        for_bands(_surface_kernels.recolour_surfaces, place.shape[1], *given, colours)
        return [
            (replace(surface, radiance=shown), share)
            for (surface, share), shown in zip(self._surfaces, colours, strict=True)
        ]


def depth_is_filtered(place: Image) -> bool:
    """Guess whether depths are filtered as colours are: then most edges pass through depths between two surfaces'.

    Parameters
    ----------
    place : ndarray of shape (H, W), float32
        Where surfaces lie in depth, as CoC radii, px.
    """
    total = np.zeros(2, np.int64)
    for each in (place, np.ascontiguousarray(place.T)):
        counts = np.zeros((len(each), 2), np.int64)
        for_bands(_blend_kernels.count_edges, len(each), each, LEAST_GAP, counts)
        total += counts.sum(axis=0)
    return bool(total[1] > total[0])


def without_nothing(layer: Layer) -> Layer:
    """Return a layer in which what covers a part of a pixel, with nothing behind, has the depth of its own.

    Where depth is filtered, and a surface ends before nothing, its depth is mixed with whatever stands for nothing. As
    alpha is filtered alike, it tells how.
    """
    alpha = np.ascontiguousarray(layer.radiance[..., 3])
    if not ((alpha > 0.0) & (alpha < 1.0)).any() or alpha.all():
        return layer
    height, surface = len(alpha), np.empty_like(alpha)
    for_bands(_blend_kernels.take_nothing_out, height, layer.depth, alpha, surface)
    counts = np.empty((height, 2), np.int64)
    for_bands(_blend_kernels.count_element_depths, height, layer.depth, surface, counts)
    if counts[:, 1].sum() <= counts[:, 0].sum():
        return layer
    source, depth = np.empty((*layer.shape, 2), np.int32), np.empty_like(alpha)
    for_bands(_blend_kernels.mend_element, height, layer.depth, alpha, surface, source, depth)
    return replace(_surface(layer, layer.radiance, source), depth=depth)


def without_filter(layer: Layer, place: Image) -> tuple[Layer, Image]:
    """Return a layer whose labels are those of one surface each, not blends, and what the blends tell of the shares.

    Parameters
    ----------
    layer : Layer
        Its depth is filtered.
    place : ndarray of shape (H, W), float32
        Its depths as CoC radii, px.

    Returns
    -------
    layer : Layer
    share : ndarray of shape (H, W), float32
        Of the nearer of a pixel's two surfaces, -1 where the pixel is no blend.
    """
    source, share = np.empty((*layer.shape, 2), np.int32), np.empty(layer.shape, np.float32)
    alpha = np.ascontiguousarray(layer.radiance[..., 3])
    for_bands(_blend_kernels.undo_filter, len(place), layer.depth, place, alpha, LEAST_GAP, source, share)
    return _surface(layer, layer.radiance, source), share


def _surface(layer: Layer, colours: Image, source: npt.NDArray[np.int32]) -> Layer:
    """Return a layer of the given colours whose labels are those of the pixels at (row, col)."""
    at_sources = partial(_at_sources, source=source)
    return layer.mapped(at_sources, at_sources, colours)


def _at_sources(values: Image, source: npt.NDArray[np.int32]) -> Image:
    taken = np.empty_like(values)
    shape = (*values.shape[:2], values[0, 0].size)
    for_bands(_label_kernels.take, len(values), values.reshape(shape), source, taken.reshape(shape))
    return taken


def take_features(layer: Layer, like: Layer) -> Image:
    """Return all that is known of a layer's pixels and may be averaged, shape (H, W, n), float32.

    Colour and alpha, nearness ``-1 / depth`` and motions (dx, dy): one of each, or three if those one frame before and
    after are known of another layer ``like`` this.
    """
    depths = [layer.depth if each is None else each for each in (layer.depth_prev, layer.depth_next)]
    motions = [layer.motion if each is None else each for each in (layer.motion_prev, layer.motion_next)]
    nearness = [-1.0 / each[..., None] for each in (layer.depth, *depths)[: len(like.depths)]]
    return np.concatenate(
        [layer.radiance, *nearness, *(layer.motion, *motions)[: len(like.motions)]], axis=2, dtype=np.float32
    )


def with_features(layer: Layer, features: Image) -> Layer:
    """Return a layer like another with features (H, W, n), see `take_features`; beyond all depths where they are 0."""
    begin, names = 4, ("depth", "depth_prev", "depth_next")[: len(layer.depths)]
    planes: dict[str, Any] = {"radiance": np.ascontiguousarray(features[..., :begin])}
    for name in names:
        nearness, planes[name] = features[..., begin], np.full(layer.shape, np.inf, np.float32)
        np.divide(-1.0, nearness, out=planes[name], where=nearness < 0.0)
        begin += 1
    for name in ("motion", "motion_prev", "motion_next")[: len(layer.motions)]:
        planes[name] = np.ascontiguousarray(features[..., begin : begin + 2])
        begin += 2
    return replace(layer, **planes)
