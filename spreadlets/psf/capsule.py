"""The PSF of a round thin lens at a single coordinate, still or in straight motion, in closed form."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from spreadlets.arrays import DoubleArray, IntArray
from spreadlets.kept import Kept
from spreadlets.parallel import for_bands
from spreadlets.psf._capsule_kernels import FAINT, draw_capsules, half_sizes, round_thin
from spreadlets.psf.spreadlet import Spreadlet

MOST_KEPT_POINTS = 1 << 21
"""Points of exact capsules that are kept for the next camera, 17 MB."""


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
    shapes = [tuple(each) for each in _shapes(coordinate, angle).tolist()]
    yield from _kept.of(shapes, lambda missing: _drawn(np.array(missing).reshape(-1, 3), 0.0))


_kept: Kept[tuple[float, ...], Spreadlet] = Kept(MOST_KEPT_POINTS, lambda psf: psf.n_points)


def thin_capsules(coordinate: DoubleArray, angle: DoubleArray) -> Iterator[Spreadlet]:
    """Yield the PSFs that pixels get whose CoC radius is at most `spreadlets.psf._capsule_kernels.CLOSED_RADIUS_PX`.

    They are those of `exact_capsules` at coordinates that are rounded, so that neighbours share them.
    """
    shape = _shapes(coordinate, angle)
    for_bands(round_thin, len(shape), shape)
    yield from _drawn(shape, FAINT)


def _shapes(coordinate: DoubleArray, angle: DoubleArray) -> DoubleArray:
    """Return radius, length of the path and its direction, (n, 3)."""
    shape = np.zeros((len(coordinate), 3))
    shape[:, : coordinate.shape[1]] = coordinate
    shape[:, 2] = np.where(shape[:, 1] > 0.0, angle, 0.0)
    return shape


def _drawn(shape: DoubleArray, faint: float) -> Iterator[Spreadlet]:
    """Yield capsules, without pixels below a share of their peak."""
    halves = np.array([half_sizes(*each) for each in shape], np.int64).reshape(-1, 2)
    first = np.concatenate([[0], np.cumsum((2 * halves + 1).prod(axis=1))])
    offset_rc, value = np.empty((first[-1], 2), np.int16), np.empty((first[-1], 1), np.float32)
    count = np.empty(len(shape), np.int64)
    for_bands(draw_capsules, len(shape), shape, faint, first, offset_rc, value, count)
    for begin, n in zip(first, count, strict=False):
        # Copies of their own: all would live as long as any of them.
        yield Spreadlet(offset_rc[begin : begin + n].copy(), value[begin : begin + n].copy(), True)
