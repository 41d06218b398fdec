"""Compiled kernels of the plan step: labels to variants, and points of variants."""

import math

import numba
import numpy as np

from spreadlets._kernels import cell_index, fold_pose, grid_coordinate

INVISIBLE = -1
SHARP = 0
"""Keys of pixels that contribute nothing, and of those whose PSF stays within the pixel."""


@numba.njit(cache=True, fastmath=False)
def _scale_step(excess, steps_per_octave, n_scales):
    """Return by how many steps a PSF must shrink to come into range; ``excess`` is how many times it exceeds it."""
    if not excess > 1.0:
        return 0
    if excess > 2.0 ** ((n_scales - 1) / steps_per_octave):
        return n_scales - 1
    return int(math.ceil(steps_per_octave * math.log2(excess)))


@numba.njit(cache=True, fastmath=False, parallel=True)
def variant_keys(radiance, coordinate, pose, sharp, grid, scales, key, excess):
    """Map the labels of each pixel to the key of its variant.

    Parameters
    ----------
    radiance : ndarray of shape (H, W, 4), float32
        Pixels of zero colour and alpha get the key `INVISIBLE`.
    coordinate : ndarray of shape (n_axes, H, W), float32
        Physical coordinates.
    pose : tuple
        Vector (dx, dy) whose direction is used, (H, W, 2) float32; signed CoC radius, (H, W) float32; and the model's
        `PoseSymmetry.codes`.
    sharp : ndarray of shape (H, W), bool
        Pixels that get the key `SHARP`.
    grid : tuple of ndarrays
        ``remap``, ``shape``, ``level_offset`` of the model's grid, ``cell_start`` of the database.
    scales : tuple
        Scale steps per octave, number of scale steps, and which axes scale the PSF, (n_axes,) bool.
    key : ndarray of shape (H, W), int64
        Filled with ``1 + (8 * spreadlet + orientation) * n_scales + scale step``.
    excess : ndarray of shape (H, 2), float64
        Filled with each row's largest factor by which a PSF exceeds the range, and the number of such pixels.
    """
    remap, shape, level_offset, cell_start = grid
    steps_per_octave, n_scales, scaling = scales
    heading, coc, codes = pose
    n_axes = len(remap)
    for row in numba.prange(radiance.shape[0]):
        units = np.empty(n_axes, np.float64)
        excess[row] = 0.0
        for col in range(radiance.shape[1]):
            pixel = radiance[row, col]
            if pixel[0] == 0 and pixel[1] == 0 and pixel[2] == 0 and pixel[3] == 0:
                key[row, col] = INVISIBLE
                continue
            if sharp[row, col]:
                key[row, col] = SHARP
                continue
            factor = 0.0
            for axis in range(n_axes):
                if scaling[axis]:
                    factor = max(factor, coordinate[axis, row, col] / remap[axis, 0])
            step = _scale_step(factor, steps_per_octave, n_scales)
            if step:
                excess[row, 0] = max(excess[row, 0], factor)
                excess[row, 1] += 1
            shrink = 2.0 ** (-step / steps_per_octave) if step else 1.0
            for axis in range(n_axes):
                value = coordinate[axis, row, col] * (shrink if scaling[axis] else 1.0)
                units[axis] = grid_coordinate(value, remap[axis], shape[axis])
            cell = cell_index(units, shape, level_offset)
            n_poses = cell_start[cell + 1] - cell_start[cell]
            angle = math.atan2(heading[row, col, 1], heading[row, col, 0]) if n_poses > 1 else 0.0
            direction, transpose, flip_row, flip_col = fold_pose(angle, coc[row, col] < 0.0, n_poses, codes)
            orientation = int(transpose) + 2 * int(flip_row) + 4 * int(flip_col)
            key[row, col] = 1 + (8 * (cell_start[cell] + direction) + orientation) * n_scales + step


@numba.njit(cache=True, fastmath=False)
def used_keys(key, n_keys):
    """Return the keys in use, ascending, int64; and for each key its place among them, int32, -1 if not in use."""
    place = np.full(n_keys, -1, np.int32)
    for row in range(key.shape[0]):
        for col in range(key.shape[1]):
            if key[row, col] >= 0:
                place[key[row, col]] = 0
    count = 0
    for i in range(n_keys):
        count += place[i] == 0
    used = np.empty(count, np.int64)
    count = 0
    for i in range(n_keys):
        if place[i] == 0:
            used[count] = i
            place[i] = count
            count += 1
    return used, place


@numba.njit(cache=True, fastmath=False, parallel=True)
def replace_keys(key, place, index):
    """Fill ``index`` (H, W), int32, with the place of each pixel's key, -1 where invisible."""
    for row in numba.prange(key.shape[0]):
        for col in range(key.shape[1]):
            index[row, col] = place[key[row, col]] if key[row, col] >= 0 else -1


@numba.njit(cache=True, fastmath=False)
def turned_points(offset_rc, transpose, flip_row, flip_col):
    """Apply a lattice symmetry to offsets (n, 2), int16, and sort them by row.

    Returns
    -------
    turned : ndarray of shape (n, 2), int32
        Swapped first, then negated; rows ascending.
    order : ndarray of shape (n,), int64
        The point that each of them was.
    """
    n = offset_rc.shape[0]
    row_axis = 1 if transpose else 0
    row_sign = -1 if flip_row else 1
    col_sign = -1 if flip_col else 1
    lowest = 1 << 30
    highest = -(1 << 30)
    for i in range(n):
        row = row_sign * np.int64(offset_rc[i, row_axis])
        lowest = min(lowest, row)
        highest = max(highest, row)
    # Counting sort: rows are few and dense.
    place = np.zeros(highest - lowest + 2, np.int64)
    for i in range(n):
        place[row_sign * np.int64(offset_rc[i, row_axis]) - lowest + 1] += 1
    place = np.cumsum(place)
    turned = np.empty((n, 2), np.int32)
    order = np.empty(n, np.int64)
    for i in range(n):
        row = row_sign * np.int64(offset_rc[i, row_axis])
        k = place[row - lowest]
        place[row - lowest] += 1
        turned[k, 0] = row
        turned[k, 1] = col_sign * np.int64(offset_rc[i, 1 - row_axis])
        order[k] = i
    return turned, order


@numba.njit(cache=True, fastmath=False)
def fill_border(variant, reach, origin, out):
    """Continue the variants of a frame's border pixels outwards, as far as their PSFs reach back.

    Parameters
    ----------
    variant : ndarray of shape (H, W), int32
        Variants of the frame.
    reach : ndarray of shape (n_variants,), int64
        How far each variant's splat reaches, px.
    origin : tuple of two ints
        Row and column, in the frame, of the first pixel of the strip.
    out : ndarray of shape (h, w), int32
        Filled; -1 where nothing is drawn. Pixels inside the frame are not drawn.
    """
    height, width = variant.shape
    for i in range(out.shape[0]):
        row = min(max(origin[0] + i, 0), height - 1)
        for j in range(out.shape[1]):
            col = min(max(origin[1] + j, 0), width - 1)
            distance = max(abs(origin[0] + i - row), abs(origin[1] + j - col))
            index = variant[row, col]
            out[i, j] = index if index >= 0 and 0 < distance <= reach[index] else -1
