"""Poisson integrators: from a Laplacian image to the image."""

import math
import os
import warnings
from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from runtime import _pyramid_kernels as kernels
from spreadlets.errors import InvalidParameterError
from spreadlets.laplacian import solve_dirichlet

Image = NDArray[np.float32]

METHODS = ("exact", "pyramid-f5", "pyramid-f7")
"""Names of the integrators."""

NET_SOURCE_TOLERANCE = 1e-4
"""Largest net source, relative to the sum of magnitudes, that passes for rounding."""


class UnbalancedSourceWarning(UserWarning):
    """The Laplacian has a net source, for which no answer is zero at infinity."""


@dataclass(frozen=True)
class FilterSet:
    """The separable filters of a convolution pyramid: centre tap, then the taps on either side.

    Attributes
    ----------
    down, up, source : tuple of 4 floats
        Filters before decimation, after expansion, and of each level's own source (`h1`, `h2` and `g` in the source).
    pad : int
        Zero pixels added around every level.

    Notes
    -----
    Farbman et al. 2011, "Convolution Pyramids", sets F5 and F7.
    """

    down: tuple[float, float, float, float]
    up: tuple[float, float, float, float]
    source: tuple[float, float, float, float]
    pad: int


_F7_DOWN = (0.65934, 0.53034, 0.26177, 0.06110)
_F7_GAIN = math.sqrt(0.51106)
FILTER_SETS = {
    "pyramid-f5": FilterSet(
        down=(0.7, 0.5, 0.15, 0.0), up=(0.7, 0.5, 0.15, 0.0), source=(0.547, 0.175, 0.0, 0.0), pad=5
    ),
    "pyramid-f7": FilterSet(
        down=_F7_DOWN,
        up=(_F7_GAIN * _F7_DOWN[0], _F7_GAIN * _F7_DOWN[1], _F7_GAIN * _F7_DOWN[2], _F7_GAIN * _F7_DOWN[3]),
        source=(0.57410, 0.24453, 0.05407, 0.0),
        pad=7,
    ),
}
"""The published sets by the name of their integrator."""


def integrate(laplacian_image: NDArray[Any], method: str = "exact", *, threads: int | None = None) -> Image:
    """Integrate a Laplacian image."""
    source = _checked_source(laplacian_image)
    if method not in METHODS:
        raise InvalidParameterError(f"method is {method!r}; the integrators are {', '.join(METHODS)}")
    n_threads = numba.get_num_threads() if threads is None else threads
    before = numba.get_num_threads()
    numba.set_num_threads(n_threads)
    try:
        image = solve_dirichlet(source, workers=n_threads) if method == "exact" else _run_pyramid(source, method)
    finally:
        numba.set_num_threads(before)
    return image


def _checked_source(laplacian_image: NDArray[Any]) -> Image:
    source = np.asarray(laplacian_image)
    if source.ndim != 3 or source.size == 0 or not np.issubdtype(source.dtype, np.floating):
        raise InvalidParameterError(
            f"the Laplacian image has shape {source.shape} and dtype {source.dtype}; "
            "give a non-empty floating-point array of shape (H, W, C)"
        )
    return np.ascontiguousarray(source, np.float32)


def _run_pyramid(source: Image, method: str) -> Image:
    filters = FILTER_SETS[method]
    height, width, n_channels = source.shape
    pad = filters.pad
    n_levels = max(1, math.ceil(math.log2(max(height, width))))
    down, up, own = (np.array([taps, taps], np.float32) for taps in (filters.down, filters.up, filters.source))
    levels = [source.reshape(height, width * n_channels)]
    scratch = np.zeros((numba.get_num_threads(), 5, (width + 4 * pad + 16) * n_channels), np.float32)
    for _ in range(1, n_levels):
        height, width = (height + 2 * pad + 1) // 2, (width + 2 * pad + 1) // 2
        coarse = np.empty((height, width * n_channels), np.float32)
        kernels.filter_down(levels[-1], coarse, down, pad, n_channels, scratch)
        levels.append(coarse)
    # The published filters invert minus the Laplacian.
    negate = np.array([[-1], [1]], np.float32)
    answer = np.empty_like(levels[-1])
    kernels.filter_level(levels[-1], answer, own if n_levels > 1 else own * negate, n_channels, scratch)
    for level in range(n_levels - 2, -1, -1):
        fine = np.empty_like(levels[level])
        taps = (up, own) if level else (up * negate, own * negate)
        kernels.filter_up(answer, levels[level], fine, *taps, pad, n_channels, scratch)
        answer = fine
    return answer.reshape(source.shape)
