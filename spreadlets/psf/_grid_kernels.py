"""Numba twins of the forward maps, callable from other kernels: coordinate to cell, motion angle to stored direction.

Imports numpy, numba and math only. Nothing here validates: the wrappers in ``grid`` and ``psf_model`` do.
"""

import math

import numpy as np

from spreadlets.arrays import BoolArray, DoubleArray, IntArray
from spreadlets.compiled import helper, kernel

_OCTANT = math.pi / 4.0

SIGN_IGNORED, SIGN_TURNED, SIGN_STORED, SIGN_TURNED_WHOLE = 0, 1, 2, 3
"""What the side of the focus does to a PSF: nothing; half a turn, but not to its direction, which is that of a motion;
it has spreadlets of its own; half a turn to all of it."""


@kernel
def triangular_root(value: float) -> int:
    """Return the largest l with l (l + 1) / 2 <= value, for value >= 0.

    The square root may round across an integer, so one comparison on either side corrects it.
    """
    level = int((math.sqrt(8.0 * value + 1.0) - 1.0) * 0.5)
    if (level + 1) * (level + 2) // 2 <= value:
        return level + 1
    if level * (level + 1) // 2 > value:
        return level - 1
    return level


@helper
def cell_index(coordinate: DoubleArray, shape: IntArray, level_offset: IntArray) -> int:
    """Map a coordinate in grid units to its cell in O(1); coordinates outside the space are clamped into it.

    Parameters
    ----------
    coordinate : float64 array of shape (n_axes,), or a tuple of floats
        Grid units, axis i in [0, shape[i]].
    shape : int64 array of shape (n_axes,)
    level_offset : int64 array of shape (n_levels,)
        Number of cells before each level.

    Notes
    -----
    LKS section 5.2. Cells of a level in row-major order are the multi-indices k with at least one k_i = 0, so the
    place of k is its rank among all multi-indices less the number of those before it whose every entry is >= 1.
    """
    smallest = math.inf
    for axis in range(len(shape)):
        smallest = min(smallest, coordinate[axis])
    # Written so that NaN, too, lands in a valid level.
    level = triangular_root(smallest) if smallest > 0.0 else 0
    level = min(level, len(level_offset) - 1)
    start = level * (level + 1) // 2
    edge = level + 1
    rank = 0
    inner_before = 0
    all_inner = True
    for axis in range(len(shape)):
        count = (shape[axis] - start + edge - 1) // edge
        k = 0
        if coordinate[axis] > start:
            # Clamp as a float: an infinite coordinate has no integer value.
            k = int(min((coordinate[axis] - start) / edge, count - 1.0))
        rank = rank * count + k
        inner_before = inner_before * (count - 1)
        if all_inner:
            inner_before += max(k - 1, 0)
            all_inner = k >= 1
    return int(level_offset[level] + rank - inner_before)


@helper
def grid_coordinate(value: float, remap: tuple[float, float, float], n_units: int) -> float:
    """Map a physical coordinate to grid units, clamped to [0, n_units] (LKS 5.2).

    ``remap`` holds the axis's maximum, its power, and its floor on the remapped axis: `psf_model.PsfGrid.remap`.
    """
    fraction = min(value / remap[0], 1.0)
    if not fraction > 0.0:
        return 0.0
    # The usual powers, 1 and 2, need no general power function, which would be most of a frame's look-up time.
    if remap[1] == 2.0:
        fraction = math.sqrt(fraction)
    elif remap[1] != 1.0:
        fraction = fraction ** (1.0 / remap[1])
    return max(n_units * (fraction - remap[2]) / (1.0 - remap[2]), 0.0)


@kernel
def cell_indices(coordinates: DoubleArray, shape: IntArray, level_offset: IntArray) -> IntArray:
    """Apply `cell_index` to each row of ``coordinates`` (n, n_axes)."""
    out = np.empty(coordinates.shape[0], dtype=np.int64)
    for row in range(coordinates.shape[0]):
        out[row] = cell_index(coordinates[row], shape, level_offset)
    return out


@kernel
def grid_coordinates(coordinates: DoubleArray, remap: DoubleArray, shape: IntArray) -> DoubleArray:
    """Apply `grid_coordinate` to each entry of ``coordinates`` (n, n_axes), physical units."""
    out = np.empty(coordinates.shape, dtype=np.float64)
    for row in range(coordinates.shape[0]):
        for axis in range(coordinates.shape[1]):
            out[row, axis] = grid_coordinate(
                coordinates[row, axis], (remap[axis, 0], remap[axis, 1], remap[axis, 2]), shape[axis]
            )
    return out


@helper
def fold_direction(angle: float, n_directions: int) -> tuple[int, bool, bool, bool]:
    """Fold a motion angle into the octant [0, pi/4] and round it to the nearest of ``n_directions`` nodes.

    Parameters
    ----------
    angle : float
        Radians, ``atan2(dy, dx)``, y down.
    n_directions : int
        Equally spaced nodes, first 0, last pi/4; or the single node 0.

    Returns
    -------
    index, transpose, flip_row, flip_col
        Transpose first, then negate. Every direction modulo 180 degrees has exactly one answer, so that neighbouring
        pixels of nearly equal motion share it: node 0 is never flipped, node pi/4 never transposed.
    """
    folded = angle - math.pi * math.floor(angle / math.pi)
    mirrored = folded > 2.0 * _OCTANT
    if mirrored:
        folded = math.pi - folded
    transpose = folded > _OCTANT
    if transpose:
        folded = 2.0 * _OCTANT - folded
    last = n_directions - 1
    index = min(max(int(folded / _OCTANT * last + 0.5), 0), last)
    if index == 0:
        mirrored = False
    elif index == last:
        transpose = False
    return index, transpose, mirrored and not transpose, mirrored and transpose


@helper
def fold_arrow(angle: float, n_directions: int) -> tuple[int, bool, bool, bool]:
    """Fold a direction as `fold_direction` does, but tell it from its opposite: all eight symmetries are in use."""
    across, along = math.sin(angle), math.cos(angle)
    flip_row, flip_col = across < 0.0, along < 0.0
    transpose = abs(across) > abs(along)
    folded = math.atan2(min(abs(across), abs(along)), max(abs(across), abs(along)))
    last = n_directions - 1
    index = min(max(int(folded / _OCTANT * last + 0.5), 0), last)
    if index == 0:
        # The PSF is its own mirror image about an axis.
        flip_row, flip_col = flip_row and transpose, flip_col and not transpose
    elif index == last:
        transpose = False
    return index, transpose, flip_row, flip_col


@helper
def fold_pose(
    angle: float, in_front: bool, n_poses: int, codes: tuple[bool, bool, int]
) -> tuple[int, bool, bool, bool]:
    """Find the stored pose nearest to a direction on a side of the focus, and the symmetry that brings it there.

    Parameters
    ----------
    angle : float
        Radians, ``atan2(dy, dx)``, y down.
    in_front : bool
        Whether the pixel lies in front of the focus.
    n_poses : int
        Poses of the cell.
    codes : tuple
        `spreadlets.psf.model.PoseSymmetry.codes`.

    Returns
    -------
    number, transpose, flip_row, flip_col
        The pose; transpose first, then negate.
    """
    arrow, lattice, sign = codes
    turned = in_front and (sign == SIGN_TURNED or sign == SIGN_TURNED_WHOLE)
    n_directions = n_poses // 2 if sign == SIGN_STORED else n_poses
    index, transpose, flip_row, flip_col = 0, False, False, False
    if n_directions > 1:
        # Half a turn of the PSF turns its direction, too: where that stays, it must be turned before.
        wanted = angle + math.pi if turned and sign == SIGN_TURNED else angle
        if not lattice:
            turns = wanted / (8.0 * _OCTANT if arrow else 4.0 * _OCTANT)
            index = int((turns - math.floor(turns)) * n_directions + 0.5) % n_directions
        elif arrow:
            index, transpose, flip_row, flip_col = fold_arrow(wanted, n_directions)
        else:
            index, transpose, flip_row, flip_col = fold_direction(wanted, n_directions)
    if in_front and sign == SIGN_STORED:
        index += n_directions
    return index, transpose, flip_row != turned, flip_col != turned


@kernel
def fold_poses(
    angles: DoubleArray, in_front: BoolArray, n_poses: IntArray, codes: tuple[bool, bool, int]
) -> tuple[IntArray, BoolArray]:
    """Apply `fold_pose` elementwise; return the numbers (n,) and the three flags as columns (n, 3)."""
    index = np.empty(angles.shape[0], dtype=np.int64)
    flags = np.empty((angles.shape[0], 3), dtype=np.bool_)
    for row in range(angles.shape[0]):
        node, transpose, flip_row, flip_col = fold_pose(angles[row], in_front[row], n_poses[row], codes)
        index[row] = node
        flags[row, 0] = transpose
        flags[row, 1] = flip_row
        flags[row, 2] = flip_col
    return index, flags
