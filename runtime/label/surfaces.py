"""Mixed pixels: where surfaces of several depths show in one pixel, each gets its share, its colour and its labels."""

from __future__ import annotations

import math
import operator
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import partial
from threading import Lock
from typing import Any, NamedTuple
from weakref import WeakSet

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import BoolArray, Image, IntArray
from spreadlets.parallel import for_bands
from spreadlets.runtime.buffers import copied
from spreadlets.runtime.label import _blend_kernels, _gap_kernels, _label_kernels, _surface_kernels, _width_kernels
from spreadlets.runtime.label.lists import rows_of
from spreadlets.runtime.label.scale import LEAST_GAP, places, separating_scale
from spreadlets.runtime.label.tiles import largest_around, tiling
from spreadlets.scans import count_alphas
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.frame import Layer

GUESSING_LINES = 256
"""About so many rows, and columns, tell whether the depth is filtered."""
FILTER_PIXELS = 1 << 12
"""About so many mixed pixels tell how wide the filter is."""
USUAL_WIDENING, WIDENINGS = 0.03, (-0.05, 0.2)
"""Half of what a filter's variance is larger by than that of a tent, px^2: usually, and at least and most."""
SURE = 200.0
"""What mixed pixels must tell of the filter to be believed as much as that."""
EDGES_SHARE = 0.85
"""Of how much the coverage of strands varies across them, beyond their width; the rest is doubt about it."""
STRAND_VARIANCES = (1.0 / 16.0, 0.5)
"""Least and largest variance of the edges of strands, px^2: that of the filter is between them."""
WIDEST_STRAND = 2
"""Px that a strand may be wide in the depth: what is a pixel and a half wide is now one, now two."""
DOUBT = 0.03
"""The same of the doubt about the place of an edge, of which point samples tell the pixel."""
EMPTY_PIXELS = 1 << 16
"""About so many pixels are looked at to find the depth of nothing."""
NOISE_SHARE = 0.1
"""Share of the pixels without any of their surface beside them, from which depth is noise: a frame full of leaves has
.01, one full of hair .02 to .08, depths drawn at random between radii of 8 and 16 px .13."""
WHITE = 1.0
"""Radiance above which a display shows no more."""
MOST_KEPT_PIXELS = 1 << 24
"""Labelled pixels that are kept for the next camera, some 50 bytes each."""
DEPTHS, MOTIONS = ("depth", "depth_prev", "depth_next"), ("motion", "motion_prev", "motion_next")
"""What may be known of a layer, and is averaged: one of each, or all three."""

Indices = npt.NDArray[np.int32]


class Surface(NamedTuple):
    """A surface of the pixels of a frame.

    Attributes
    ----------
    layer : Layer
        Of all pixels of the frame, or of a list of some.
    share : ndarray of shape (H, W), float32, or None
        Its share of each pixel; None if it is all of the frame.
    at : ndarray of shape (H, W, 2), int32, or None
        Rows and columns of the pixels of a list.
    """

    layer: Layer
    share: Image | None = None
    at: Indices | None = None

    def put(self, values: Image, frame: Image) -> None:
        """Write values of the surface's pixels to where they lie in a frame."""
        if self.at is None or self.share is None:
            frame[...] = values
        else:
            frame[tuple(self.at[self.share > 0].T)] = values[self.share > 0]

    def taken(self, frame: Image) -> Image:
        """Return the values of a frame where the surface's pixels lie."""
        return frame if self.at is None else frame[self.at[..., 0], self.at[..., 1]]


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
    Surface
        The layer itself, if no pixel is mixed, or its depth is noise; else first each pixel's own surface, then lists
        of others.

    Notes
    -----
    Bayesian matting (Chuang et al. 2001) in closed form, for up to three surfaces, whose depths are known.
    """
    height, width = layer.shape
    layer = without_nothing(layer)
    scale, known = separating_scale(layer, camera), np.full(layer.shape, -1.0, np.float32)
    place = places(layer, scale)
    if not _mixed_tiles(place).any() or depth_is_noise(place):
        # There are no surfaces to tell apart.
        yield Surface(layer)
        return
    if depth_is_filtered(place):
        layer, known = without_filter(layer, place)
        place = places(layer, scale)
    place[layer.radiance[..., 3] == 0.0] = np.inf
    # Close the gaps of what is thinner than a pixel.
    point = place
    layer, place = without_gaps(layer, place)
    # List the pixels around which places differ.
    mixed = _mixed_tiles(place)
    columns, starts = np.empty(layer.shape, np.int32), np.zeros(height + 1, np.int64)
    for_bands(_surface_kernels.list_mixed, len(mixed), place, layer.radiance, LEAST_GAP, mixed, columns, starts[1:])
    np.cumsum(starts, out=starts)
    if not starts[-1]:
        yield Surface(layer)
        return
    # Divide them among the surfaces around them, whose colours pixels of their tiles tell, and of those beside.
    weights = weigh_pixels(place, point, layer.radiance, largest_around(mixed, 1))
    n, most = int(starts[-1]), _surface_kernels.MOST
    first = np.ones(layer.shape, np.float32), copied(layer.radiance)
    found = np.empty((n, 2), np.int32), np.empty((n, most), np.float32), np.empty((n, most, 2), np.int32)
    colours, told = np.empty((n, most, 4), np.float32), np.zeros(n, np.float32)
    given, listed = (place, point, layer.radiance, weights, _loose(point)), (columns, starts)
    widening = filter_widening(given, listed)
    divided = known, listed, LEAST_GAP, widening, first, (*found, colours, told)
    if not sum(for_bands(_surface_kernels.divide_pixels, height, given, *divided)):
        yield Surface(layer)
        return
    even_strands(place, layer.radiance, first, (*found, colours, told))
    yield Surface(replace(layer, radiance=first[1]), first[0])
    for number in range(1, most):
        chosen = np.flatnonzero(found[1][:, number])
        if len(chosen):
            index, (at, share, source) = rows_of(chosen), found
            taken = source[index, number]
            listed = share[index, number]
            listed.ravel()[len(chosen) :] = 0.0
            yield Surface(_surface(layer, colours[index, number], taken), listed, at[index])


def filter_widening(
    given: tuple[Image, Image, Image, tuple[Image, Image, Image], BoolArray], listed: tuple[Indices, IntArray]
) -> float:
    """Guess from mixed pixels by how much their filter is wider than a tent 2 px wide, see the kernels.

    Parameters
    ----------
    given, listed : tuple
        See `_surface_kernels.divide_pixels`.

    Returns
    -------
    float
        Half of the difference of their variances, px^2.
    """
    height, n = len(given[0]), int(listed[1][-1])
    sums = np.empty((height, 2))
    stride = max(1, n // FILTER_PIXELS)
    for_bands(_surface_kernels.measure_filter, height, given, listed, LEAST_GAP, stride, sums)
    told, certainty = sums.sum(axis=0)
    return DOUBT + float(np.clip((told + USUAL_WIDENING * SURE) / (certainty + SURE), *WIDENINGS))


def weigh_pixels(
    place: Image, point: Image, radiance: Image, wanted: BoolArray | None = None
) -> tuple[Image, Image, Image]:
    """Return how pure pixels are, how much each counts, and how bright it is; all, or those of some tiles."""
    weights = np.empty_like(place), np.empty_like(place), np.empty_like(place)
    wanted = np.ones(tiling(place.shape, _surface_kernels.TILE), np.bool_) if wanted is None else wanted
    for_bands(_surface_kernels.weigh_pixels, len(wanted), place, point, LEAST_GAP, radiance, wanted, weights)
    return weights


def _mixed_tiles(place: Image) -> BoolArray:
    """Return the tiles of pixels in which there may be mixed ones."""
    low, high = np.empty((2, *tiling(place.shape, _surface_kernels.TILE)), np.float32)
    for_bands(_surface_kernels.place_range, len(low), place, low, high)
    # No pixel of a tile reaches farther than those beside it.
    return largest_around(high, 1) + largest_around(-low, 1) >= LEAST_GAP


def undivided(layer: Layer, camera: ThinLens) -> list[Surface]:
    """Return a layer as it is, its mixed pixels with the labels that they have: a `Split` that divides none."""
    return [Surface(layer)]


def split_lights(layer: Layer, camera: ThinLens) -> list[Surface]:
    """Return the surfaces of a layer, divided only where one of them is brighter than white: else few pixels show it.

    Parameters
    ----------
    layer, camera
        As for `split_surfaces`.
    """
    first, *lists = split_surfaces(layer, camera)
    if first.share is None:
        return [first]
    # Find the pixels with a bright surface, and what others show as a whole.
    bright, whole = _is_bright(first), first.layer.radiance * first.share[..., None]
    for each in lists:
        assert each.share is not None and each.at is not None, "others than the first are lists"
        drawn = each.share > 0.0
        place = tuple(each.at[drawn].T)
        whole[place] += each.layer.radiance[drawn] * each.share[drawn][:, None]
        bright[place] |= _is_bright(each)[drawn]
    bright &= first.share < 1.0
    own = replace(first.layer, radiance=np.where(bright[..., None], first.layer.radiance, whole))
    if not bright.any():
        return [Surface(own)]
    found = [Surface(own, np.where(bright, first.share, np.float32(1.0)))]
    # Keep the others where they are.
    for each in lists:
        assert each.share is not None and each.at is not None
        chosen = np.flatnonzero((each.share > 0.0) & bright[tuple(np.moveaxis(each.at, 2, 0))])
        if len(chosen):
            index = np.unravel_index(rows_of(chosen), each.share.shape)
            share = each.share[index]
            share.ravel()[len(chosen) :] = 0.0
            take = operator.itemgetter(index)
            found.append(Surface(each.layer.mapped(take, take, take(each.layer.radiance)), share, each.at[index]))
    return found


def _is_bright(surface: Surface) -> BoolArray:
    return np.asarray(surface.layer.radiance[..., :3].max(axis=2) > WHITE)


class KeptSurfaces:
    """Splits layers, and keeps what it found: focus does not change it. It may be used from several threads.

    What a layer is split into is kept from the second time on: a single picture needs the memory for other things.

    Parameters
    ----------
    split : callable
        Finds the surfaces.
    """

    def __init__(self, split: Split) -> None:
        self._find = split
        self._asked = WeakSet[Layer]()
        self._kept: OrderedDict[tuple[int, float], tuple[Layer, list[Surface]]] = OrderedDict()
        self._lock = Lock()

    def __call__(self, layer: Layer, camera: ThinLens) -> Iterable[Surface]:
        """Return the surfaces of a layer; those of a very large one are not kept."""
        if _surface_kernels.MOST * layer.depth.size > MOST_KEPT_PIXELS:
            return self._find(layer, camera)
        with self._lock:
            is_first = layer not in self._asked
            self._asked.add(layer)
        if is_first:
            return self._find(layer, camera)
        key = id(layer), separating_scale(layer, camera)
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key][1]
        found = list(self._find(layer, camera))
        with self._lock:
            # The layer is kept as long as its number stands for it.
            self._kept[key] = layer, found
            n_pixels = [sum(each.layer.depth.size for each in found) for _, found in self._kept.values()]
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
        if len(self._surfaces) == 1:
            own = replace(self._surfaces[0].layer, radiance=layer.radiance)
            return [self._surfaces[0]._replace(layer=own)]
        # Divide the colours of all pixels, in planes for each surface.
        scale = separating_scale(layer, camera)
        place, share = np.zeros((2, len(self._surfaces), *layer.shape), np.float32)
        for own, part, each in zip(place, share, self._surfaces, strict=True):
            each.put(places(each.layer, scale), own)
            assert each.share is not None, "only a single surface is all of each pixel"
            each.put(each.share, part)
        colours = np.empty((*place.shape, 4), np.float32)
        for_bands(_surface_kernels.recolour_surfaces, layer.shape[0], layer.radiance, place, share, colours)
        return [
            each._replace(layer=replace(each.layer, radiance=each.taken(own)))
            for each, own in zip(self._surfaces, colours, strict=True)
        ]


def depth_is_filtered(place: Image) -> bool:
    """Guess whether depths are filtered as colours are: then most edges pass through depths between two surfaces'.

    Parameters
    ----------
    place : ndarray of shape (H, W), float32
        Where surfaces lie in depth, as CoC radii, px.
    """
    total = np.zeros(2, np.int64)
    # Some rows and columns tell.
    rows, columns = (slice(None, None, max(1, side // GUESSING_LINES)) for side in place.shape)
    for each in map(np.ascontiguousarray, (place[rows], np.ascontiguousarray(place[:, columns]).T)):
        counts = np.zeros((len(each), 2), np.int64)
        for_bands(_blend_kernels.count_edges, len(each), each, LEAST_GAP, counts)
        total += counts.sum(axis=0)
    return bool(total[1] > total[0])


def depth_is_noise(place: Image) -> bool:
    """Guess whether depths are noise: even what is a pixel wide has a pixel of its own beside it, noise has none.

    Parameters
    ----------
    place : ndarray of shape (H, W), float32
        Where surfaces lie in depth, as CoC radii, px.
    """
    step = max(1, min(place.shape) // GUESSING_LINES)
    counts = np.empty((-(-len(place) // step), 2), np.int64)
    for_bands(_surface_kernels.count_alone, len(counts), place, LEAST_GAP, step, counts)
    looked_at, alone = counts.sum(axis=0)
    return bool(alone > NOISE_SHARE * looked_at)


def without_nothing(layer: Layer) -> Layer:
    """Return a layer in which what covers a part of a pixel, with nothing behind, has the depth of its own.

    Where depth is filtered, and a surface ends before nothing, its depth is mixed with whatever stands for nothing. As
    alpha is filtered alike, it tells how. Where depths are point samples, some have missed the surface; its own are
    those of the nearest pixel that shows it.
    """
    count = count_alphas(layer.radiance)
    if not (count.nothing and count.part):
        return layer
    alpha = np.ascontiguousarray(layer.radiance[..., 3])
    height, surface = len(alpha), np.empty_like(alpha)
    for_bands(_blend_kernels.take_nothing_out, height, layer.depth, alpha, surface)
    counts = np.empty((height, 2), np.int64)
    for_bands(_blend_kernels.count_element_depths, height, layer.depth, surface, counts)
    if counts[:, 1].sum() <= counts[:, 0].sum():
        source = np.empty((*layer.shape, 2), np.int32)
        missed = for_bands(_blend_kernels.find_missed, height, layer.depth, alpha, _depth_of_nothing(layer), source)
        return _surface(layer, layer.radiance, source) if any(missed) else layer
    source, depth = np.empty((*layer.shape, 2), np.int32), np.empty_like(alpha)
    for_bands(_blend_kernels.mend_element, height, layer.depth, alpha, surface, source, depth)
    return replace(_surface(layer, layer.radiance, source), depth=depth)


def _depth_of_nothing(layer: Layer) -> np.float32:
    """Return the depth that most of the empty pixels of a layer have."""
    step = max(1, math.isqrt(layer.depth.size // EMPTY_PIXELS))
    empty = layer.depth[::step, ::step][layer.radiance[::step, ::step, 3] == 0.0]
    return np.float32(np.quantile(empty, 0.5, method="lower")) if len(empty) else np.float32(np.nan)


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


def without_gaps(layer: Layer, place: Image) -> tuple[Layer, Image]:
    """Return a layer whose strands have no gaps, and its places.

    Point samples of the depth miss a strand that is thinner than a pixel where it lies between the pixels' centres.

    Parameters
    ----------
    layer : Layer
    place : ndarray of shape (H, W), float32
        Its depths as CoC radii, px.
    """
    height, thin = len(place), _thin(place)
    ends = np.empty((*layer.shape, 2), np.int8)
    for_bands(_gap_kernels.find_gaps, height, place, thin, LEAST_GAP, ends)
    if not ends.any():
        return layer, place
    closed, source = place.copy(), np.empty((*layer.shape, 2), np.int32)
    source[..., 0], source[..., 1] = np.ogrid[: source.shape[0], : source.shape[1]]
    _gap_kernels.close_gaps(0, height, place, ends, LEAST_GAP, closed, source)
    return _surface(layer, layer.radiance, source), closed


def even_strands(
    place: Image, radiance: Image, first: tuple[Image, Image], found: tuple[Indices, Image, Indices, Image, Image]
) -> None:
    """Make strands as wide and as bright as they are on average along their line.

    Parameters
    ----------
    place : ndarray of shape (H, W), float32
        Where surfaces lie in depth, as CoC radii, px, without gaps.
    radiance : ndarray of shape (H, W, 4), float32
    first, found : tuple
        How the pixels are divided, see `_surface_kernels.divide_pixels`; changed.
    """
    height, thin = len(place), _thin(place, WIDEST_STRAND)
    strand, mixed = np.full((2, *place.shape), -1, np.int32)
    divided = np.flatnonzero(found[1].any(axis=1))
    mixed[tuple(found[0][divided].T)] = divided
    chosen = (thin > 0) & (mixed >= 0)
    n = int(chosen.sum())
    strand[chosen] = np.arange(n)
    measured, line, softness = np.empty((n, 7), np.float32), np.empty((n, 8), np.float32), np.empty((height, 2))
    wanted = np.empty((n, 2 * _width_kernels.BESIDE + 1, 5), np.float32)
    # What they are on average, and how soft their edges are in the whole frame.
    across = place, thin, strand, mixed, found, LEAST_GAP, measured
    for_bands(_width_kernels.measure_strands, height, *across)
    along = place, thin, strand, LEAST_GAP, measured, line, softness
    for_bands(_width_kernels.average_strands, height, *along)
    varied, weight = softness.sum(axis=0)
    variance = float(np.clip(EDGES_SHARE * varied / max(weight, 1.0), *STRAND_VARIANCES))
    for_bands(_width_kernels.spread_strands, height, *across, line, variance, wanted)
    given = place, radiance, thin, strand, mixed, LEAST_GAP, wanted, first, found
    _width_kernels.even_strands(0, height, *given)


def _thin(place: Image, widest: int = 1) -> npt.NDArray[np.int8]:
    """Return in which pixels something is so wide at most, px, see `_gap_kernels.find_thin`."""
    thin = np.empty(place.shape, np.int8)
    for_bands(_gap_kernels.find_thin, len(place), place, LEAST_GAP, widest, thin)
    return thin


def _loose(place: Image) -> BoolArray:
    """Return in which pixels samples of something fine have missed the rest of it, see `_gap_kernels.find_loose`."""
    loose = np.empty(place.shape, np.bool_)
    for_bands(_gap_kernels.find_loose, len(place), place, _thin(place), LEAST_GAP, loose)
    return loose


def _surface(layer: Layer, colours: Image, source: Indices) -> Layer:
    """Return a layer of the given colours whose labels are those of the pixels at (row, col)."""
    at_sources = partial(_at_sources, source=source)
    return layer.mapped(at_sources, at_sources, colours)


def _at_sources(values: Image, source: Indices) -> Image:
    taken = np.empty(source.shape[:2] + values.shape[2:], np.float32)
    n = values[0, 0].size
    given = values.reshape(*values.shape[:2], n), source, taken.reshape(*source.shape[:2], n)
    for_bands(_label_kernels.take, len(source), *given)
    return taken


def take_features(layer: Layer, like: Layer, at: Any = ...) -> Image:
    """Return all that is known of a layer's pixels, or of those at an index, and may be averaged: (H, W, n), float32.

    Colour and alpha, nearness ``-1 / depth`` and motions (dx, dy): one of each, or three if those one frame before and
    after are known of another layer ``like`` this.
    """
    depths = [layer.depth if each is None else each for each in (layer.depth_prev, layer.depth_next)]
    motions = [layer.motion if each is None else each for each in (layer.motion_prev, layer.motion_next)]
    nearness = [-1.0 / each[at][..., None] for each in (layer.depth, *depths)[: len(like.depths)]]
    planes = layer.radiance[at], *nearness, *(each[at] for each in (layer.motion, *motions)[: len(like.motions)])
    return np.concatenate(planes, axis=-1, dtype=np.float32)


def with_features(layer: Layer, features: Image) -> Layer:
    """Return a layer or a list with features (H, W, n) as another has; beyond all depths where they are 0."""
    begin, names = 4, DEPTHS[: len(layer.depths)]
    planes: dict[str, Any] = {"radiance": np.ascontiguousarray(features[..., :begin])}
    for name in names:
        nearness, planes[name] = features[..., begin], np.full(features.shape[:2], np.inf, np.float32)
        np.divide(-1.0, nearness, out=planes[name], where=nearness < 0.0)
        begin += 1
    for name in MOTIONS[: len(layer.motions)]:
        planes[name] = np.ascontiguousarray(features[..., begin : begin + 2])
        begin += 2
    return replace(layer, **planes)
