"""The scale at which depths are compared, to tell surfaces apart that blur or move differently."""

from __future__ import annotations

import numpy as np

from spreadlets.arrays import Image, IntArray
from spreadlets.parallel import for_bands
from spreadlets.runtime.label import _label_kernels, _scale_kernels
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.frame import Layer

LEAST_GAP = 0.7
"""Difference of places, px of CoC radius or of a path's length, from which two surfaces are worth telling apart."""
SCALES_PER_OCTAVE = 2
"""Steps of the f-number at which surfaces are told apart: between two of them the same surfaces serve."""
COUNTED_LINES = 128
"""About so many rows, and columns, are looked at."""
LEAST_MISSED = 0.02
"""Share of the places where surfaces move apart from which the scale of the lens, which misses them, does not do."""
MISSED = 0.03
"""Of these, so many may still be missed: those that differ least in depth."""
EVEN, FLATNESS = 0.95, 0.25
"""So many neighbours on one surface differ by less than this share of a gap: it must not fall apart."""


def separating_scale(layer: Layer, camera: ThinLens) -> float:
    """Return how many px lie between places of inverse depth 0 and 1 / m: the scale of the lens's CoC, or a larger one.

    A lens that blurs all alike does not tell surfaces apart that move apart. So places are drawn out until most of
    these lie `LEAST_GAP` from each other, as far as no surface falls apart. It is rounded up, to one of
    `SCALES_PER_OCTAVE`.

    Parameters
    ----------
    layer : Layer
    camera : ThinLens
        Depths are compared by their CoC, and by what moves while its shutter is open.

    Returns
    -------
    float
        px metres
    """
    scale = camera.coc_scale(layer.raster.display.width)
    if layer.has_motion and camera.shutter_duration > 0.0:
        even, apart = _differences(layer, LEAST_GAP / camera.shutter_duration)
        missed = apart[: np.searchsorted(scale * _BORDERS, LEAST_GAP)]
        if missed.sum() > LEAST_MISSED * apart.sum():
            wanted = LEAST_GAP / _quantile(apart, MISSED * missed.sum() / apart.sum())
            scale = max(scale, min(wanted, FLATNESS * LEAST_GAP / _quantile(even, EVEN)))
    return float(np.exp2(np.ceil(SCALES_PER_OCTAVE * np.log2(scale)) / SCALES_PER_OCTAVE))


def places(layer: Layer, scale: float) -> Image:
    """Return where a layer's surfaces lie in depth, px, shape (H, W), float32, at a scale, px metres."""
    place = np.empty(layer.shape, np.float32)
    for_bands(_label_kernels.coc_radii, len(place), layer.depth, scale, 0.0, place)
    return place


_BORDERS = np.exp2(
    np.arange(1, _scale_kernels.N_BINS + 1) / _scale_kernels.BINS_PER_OCTAVE + _scale_kernels.FIRST_OCTAVE
)
"""Upper borders of the steps of inverse depth in which differences are counted, 1 / m."""


def _differences(layer: Layer, parting: float) -> tuple[IntArray, IntArray]:
    """Return the numbers of neighbours whose inverse depths differ so much: on one surface, and on two that move apart.

    Motions that differ by ``parting``, px per frame, part two surfaces.
    """
    total = np.zeros((2, _scale_kernels.N_BINS), np.int64)
    rows, columns = (slice(None, None, max(1, side // COUNTED_LINES)) for side in layer.shape)
    across = layer.depth[rows], layer.motion[rows]
    along = layer.depth[:, columns].T, layer.motion[:, columns].swapaxes(0, 1)
    for lines in (across, along):
        depth, motion = map(np.ascontiguousarray, lines)
        counts = np.empty((len(depth), *total.shape), np.int64)
        for_bands(_scale_kernels.count_differences, len(depth), depth, motion, parting, counts)
        total += counts.sum(axis=0)
    return total[0], total[1]


def _quantile(counts: IntArray, share: float) -> float:
    """Return the difference of inverse depth, 1 / m, below which a share of those counted lies."""
    return float(_BORDERS[np.searchsorted(np.cumsum(counts), share * counts.sum())])
