"""The lattice Green's function, tabulated once for many PSFs, and the solution of a few point sources on a window."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import DoubleArray
from spreadlets.precompute.sparsify import _sparsify_kernels as _kernels
from spreadlets.psf.laplacian import lattice_green

RADIUS_STEP = 64
"""Tables are made for multiples of this radius, px, so that PSFs of similar size share them."""


def green_table(radius: int) -> DoubleArray:
    """Return the quarter of the lattice Green's function to at least a radius, px; shared, so not to be written to."""
    return _table(-(-radius // RADIUS_STEP) * RADIUS_STEP)


@lru_cache(maxsize=4)
def _table(radius: int) -> DoubleArray:
    table = lattice_green(radius)
    table.flags.writeable = False
    return table


def reconstruct(offset_rc: npt.NDArray[np.int64], value: DoubleArray, shape: tuple[int, int]) -> DoubleArray:
    """Solve the free-space Poisson problem of point sources on a centred window.

    Parameters
    ----------
    offset_rc : ndarray of shape (n, 2), int64
        Offsets of the sources from the window's centre, px; inside the window.
    value : ndarray of shape (n, C), float64
        Their Laplacian.
    shape : tuple of int
        Height and width of the window, odd.

    Returns
    -------
    ndarray of shape (H, W, C), float64
    """
    planes = np.zeros((value.shape[1], *shape))
    add_sources(planes, offset_rc + np.asarray(shape) // 2, value)
    return np.ascontiguousarray(np.moveaxis(planes, 0, 2))


def add_sources(planes: DoubleArray, point_rc: npt.NDArray[np.int64], value: DoubleArray) -> None:
    """Add the solution of point sources at pixels (n, 2) to planes of shape (C, H, W), in place."""
    table = green_table(max(planes.shape[1:]))
    _kernels.add_green(planes, table, point_rc, np.ascontiguousarray(value, dtype=np.float64))
