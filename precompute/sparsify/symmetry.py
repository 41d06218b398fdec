"""The lattice symmetries of a PSF, and the orbits of points under them.

Points that come in whole orbits share one value, so a spreadlet of a PSF with 2, 4 or 8 symmetries is found by solving
a problem of a half, a quarter or an eighth of the size.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

TOLERANCE = 2e-3
"""Largest difference, in units of the peak, between a PSF and its image under what counts as its symmetry."""


_KEY_BASE = 1 << 20
"""More than any distance between two offsets."""


class Symmetry(NamedTuple):
    """One element of the lattice's point group: swap rows and columns if told so, then negate."""

    transpose: bool
    flip_row: bool
    flip_col: bool


IDENTITY = Symmetry(False, False, False)
HALF_TURN = Symmetry(False, True, True)
GROUPS = (
    tuple(Symmetry(t, r, c) for t in (False, True) for r in (False, True) for c in (False, True)),
    (IDENTITY, HALF_TURN, Symmetry(False, True, False), Symmetry(False, False, True)),
    (IDENTITY, HALF_TURN, Symmetry(True, False, False), Symmetry(True, True, True)),
    (IDENTITY, HALF_TURN),
    (IDENTITY, Symmetry(False, True, False)),
    (IDENTITY, Symmetry(False, False, True)),
    (IDENTITY,),
)
"""The groups that are looked for, largest first: all eight, the mirrors of the axes, of the diagonals, a half turn."""


def transform_image(image: npt.NDArray[np.float64], symmetry: Symmetry) -> npt.NDArray[np.float64]:
    """Apply a symmetry to an image (H, W, C); a transpose swaps H and W."""
    moved = image.swapaxes(0, 1) if symmetry.transpose else image
    return moved[:: -1 if symmetry.flip_row else 1, :: -1 if symmetry.flip_col else 1]


def transform_offsets(offset_rc: npt.NDArray[np.int64], symmetry: Symmetry) -> npt.NDArray[np.int64]:
    """Apply a symmetry to offsets (..., 2) from the centre."""
    moved = offset_rc[..., ::-1] if symmetry.transpose else offset_rc
    return np.asarray(moved * np.asarray([-1 if symmetry.flip_row else 1, -1 if symmetry.flip_col else 1]))


def find_group(psf: npt.NDArray[np.float64], tolerance: float = TOLERANCE) -> tuple[Symmetry, ...]:
    """Find the largest of `GROUPS` under which a PSF is unchanged.

    Parameters
    ----------
    psf : ndarray of shape (H, W, C), float64
        PSF, centred, odd sizes.
    tolerance : float
        Largest accepted difference in units of the peak; light tracing leaves some noise.

    Returns
    -------
    tuple of Symmetry
    """
    limit = tolerance * float(np.abs(psf).max())

    def unchanged(symmetry: Symmetry) -> bool:
        moved = transform_image(psf, symmetry)
        return moved.shape == psf.shape and float(np.abs(moved - psf).max()) <= limit

    return next(group for group in GROUPS if all(unchanged(symmetry) for symmetry in group[1:]))


def symmetrise(psf: npt.NDArray[np.float64], group: tuple[Symmetry, ...]) -> npt.NDArray[np.float64]:
    """Average a PSF (H, W, C) over a group."""
    return np.asarray(sum(transform_image(psf, symmetry) for symmetry in group) / len(group))


def representatives(
    offset_rc: npt.NDArray[np.int64], group: tuple[Symmetry, ...]
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Choose one of each set of offsets that the group maps onto each other.

    Parameters
    ----------
    offset_rc : ndarray of shape (n, 2), int64
        Distinct offsets from the centre.
    group : tuple of Symmetry
        The group.

    Returns
    -------
    index, count : ndarray of shape (m,), int64
        Index of the chosen offsets, and how many of the given ones each stands for, itself included.
    """
    key = _keys(_images(offset_rc, group)).min(axis=1)
    _, index, count = np.unique(key, return_index=True, return_counts=True)
    return index, count


def orbits(
    offset_rc: npt.NDArray[np.int64], group: tuple[Symmetry, ...]
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Complete points to orbits: sets of points that the group maps onto each other.

    Parameters
    ----------
    offset_rc : ndarray of shape (n, 2), int64
        Offsets from the centre; those of the same orbit are merged.
    group : tuple of Symmetry
        A group of order g.

    Returns
    -------
    members : ndarray of shape (m, g, 2), int64
        Images of one representative of each orbit. A point on a mirror occurs more than once in its orbit.
    size : ndarray of shape (m,), int64
        Number of distinct points of each orbit.
    """
    index, _ = representatives(offset_rc, group)
    members = _images(offset_rc[index], group)
    size = 1 + (np.diff(np.sort(_keys(members), axis=1), axis=1) != 0).sum(axis=1)
    return members, size


def expand(
    members: npt.NDArray[np.int64], size: npt.NDArray[np.int64], value: npt.NDArray[np.float64]
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float64]]:
    """Write orbits with one value each as distinct points with one value each.

    Parameters
    ----------
    members, size : ndarray of shape (m, g, 2) and (m,), int64
        The orbits.
    value : ndarray of shape (m, C), float64
        Value of each point of an orbit.

    Returns
    -------
    offset_rc : ndarray of shape (n, 2), int64
        Distinct points in row-major order.
    point_value : ndarray of shape (n, C), float64
    """
    order = members.shape[1]
    offset, first = np.unique(members.reshape(-1, 2), axis=0, return_index=True)
    return offset, value[first // order]


def _images(offset_rc: npt.NDArray[np.int64], group: tuple[Symmetry, ...]) -> npt.NDArray[np.int64]:
    """Return the images (n, g, 2) of offsets (n, 2) under each element of a group."""
    return np.stack([transform_offsets(offset_rc, symmetry) for symmetry in group], axis=1)


def _keys(offset_rc: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Give offsets (..., 2) numbers that differ where they do."""
    return np.asarray(offset_rc[..., 0] * _KEY_BASE + offset_rc[..., 1])
