"""PSFs of single coordinates, which lie between the cells of a grid: what the runtime asks a model for."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol

import numpy as np

from spreadlets.arrays import DoubleArray, IntArray
from spreadlets.psf.spreadlet import Spreadlet

MIN_DIRECT_VALUE = 1e-7
"""Pixels of a dense PSF below this share of its peak are not drawn: under float32's own resolution."""


class ExactPsf(Protocol):
    """Makes the PSFs of a model at single coordinates, without a pre-filter."""

    def __call__(self, coordinate: DoubleArray, direction: DoubleArray, side: IntArray) -> Iterator[Spreadlet]:
        """Yield PSFs as direct points, their rows ascending.

        Parameters
        ----------
        coordinate : ndarray of shape (n, n_axes), float64
            In the units of the model's axes; it may lie beyond their ends.
        direction : ndarray of shape (n,), float64
            Radians, y down; ignored by models without direction.
        side : ndarray of shape (n,), int64
            1 behind the focus, -1 in front of it.
        """


def direct_points(psf: DoubleArray) -> Spreadlet:
    """Turn a centred dense PSF of shape (h, w, C) into direct points, of the same energy, their rows ascending."""
    rows, cols = np.nonzero(psf.max(axis=2) > MIN_DIRECT_VALUE * psf.max())
    value = psf[rows, cols]
    value *= psf.sum(axis=(0, 1)) / value.sum(axis=0)
    centre = np.array([psf.shape[0] // 2, psf.shape[1] // 2])
    return Spreadlet((np.stack([rows, cols], axis=1) - centre).astype(np.int16), value.astype(np.float32), True)
