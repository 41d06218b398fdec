"""The PSF of a round thin lens at a single coordinate, still or in straight motion, in closed form."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from spreadlets.arrays import DoubleArray, IntArray
from spreadlets.parallel import for_bands
from spreadlets.precompute.models._capsule_kernels import draw_capsules, half_sizes
from spreadlets.psf.spreadlet import Spreadlet


def exact_capsules(coordinate: DoubleArray, angle: DoubleArray, side: IntArray) -> Iterator[Spreadlet]:
    """Yield discs swept along their paths: the PSFs of ``simplelens`` and ``combined`` with a round aperture.

    Parameters
    ----------
    coordinate : ndarray of shape (n, 1) or (n, 2), float64
        CoC radius and, if anything moves, the length of the path, px.
    direction, side
        See `spreadlets.psf.exact.ExactPsf`; both sides of the focus are alike.

    Notes
    -----
    LKS section 5.3: "a closed-form solution might exist for special models".
    """
    shape = np.zeros((len(coordinate), 3))
    shape[:, : coordinate.shape[1]] = coordinate
    shape[:, 2] = np.where(shape[:, 1] > 0.0, angle, 0.0)
    halves = np.array([half_sizes(*each) for each in shape], np.int64).reshape(-1, 2)
    first = np.concatenate([[0], np.cumsum((2 * halves + 1).prod(axis=1))])
    offset_rc, value = np.empty((first[-1], 2), np.int16), np.empty((first[-1], 1), np.float32)
    count = np.empty(len(shape), np.int64)
    for_bands(draw_capsules, len(shape), shape, first, offset_rc, value, count)
    for begin, n in zip(first, count, strict=False):
        yield Spreadlet(offset_rc[begin : begin + n], value[begin : begin + n], True)
