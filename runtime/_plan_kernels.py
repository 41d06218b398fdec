"""Compiled kernels of the plan step: labels to variants, and points of variants."""

import math

import numba
import numpy as np

from spreadlets._kernels import fold_direction, grid_coordinate

INVISIBLE = -1
SHARP = 0
"""Keys of pixels that contribute nothing, and of those whose PSF stays within the pixel."""


@numba.njit(cache=True, fastmath=False, parallel=True)
def coc_radii(depth, scale, inverse_focus, coc):
    """Fill ``coc`` (H, W), float32, with ``scale * (inverse_focus - 1 / depth)``: signed CoC radii, px."""
    for row in numba.prange(depth.shape[0]):
        for col in range(depth.shape[1]):
            coc[row, col] = scale * (inverse_focus - 1.0 / np.float64(depth[row, col]))


@numba.njit(cache=True, fastmath=False, parallel=True)
def path_lengths(path, length):
    """Fill ``length`` (H, W), float32, with the lengths of the paths (H, W, 2), px."""
    for row in numba.prange(path.shape[0]):
        for col in range(path.shape[1]):
            x, y = np.float64(path[row, col, 0]), np.float64(path[row, col, 1])
            length[row, col] = math.sqrt(x * x + y * y)


@numba.njit(cache=True, fastmath=False)
def _scale_step(excess, steps_per_octave, n_scales):
    """Return by how many steps a PSF must shrink to come into range; ``excess`` is how many times it exceeds it."""
    if not excess > 1.0:
        return 0
    if excess > 2.0 ** ((n_scales - 1) / steps_per_octave):
        return n_scales - 1
    return int(math.ceil(steps_per_octave * math.log2(excess)))


@numba.njit(cache=True, fastmath=False, parallel=True)
def variant_keys(radiance, coordinate, path, sharp_extent, grid, scales, key, excess):
    """Map the labels of each pixel to the key of its variant.

    Parameters
    ----------
    radiance : ndarray of shape (H, W, 4), float32
        Pixels of zero colour and alpha get the key `INVISIBLE`.
    coordinate : tuple of n_axes ndarrays of shape (H, W), float32
        Physical coordinates; their signs are ignored.
    path : ndarray of shape (H, W, 2), float32
        Motion (dx, dy), whose direction is used.
    sharp_extent : float
        Pixels whose coordinates sum to no more, the last counted half if it is the length of a path, get the key
        `SHARP`.
    grid : tuple of ndarrays
        ``remap`` and ``shape`` of the model's grid, its ``unit_cell`` flattened, ``cell_start`` of the database; and
        the share of each coordinate in the PSF's extent.
    scales : tuple of two ints
        Scale steps per octave, and number of scale steps.
    key : ndarray of shape (H, W), int64
        Filled with ``1 + (scale step * n_spreadlets + spreadlet) * 8 + orientation``.
    excess : ndarray of shape (H, 3), float64
        Filled with each row's largest factor by which a PSF exceeds the range, the number of such pixels, and the
        largest scale step.
    """
    remap, shape, unit_cell, cell_start, share = grid
    steps_per_octave, n_scales = scales
    n_axes = len(remap)
    n_spreadlets = cell_start[-1]
    for row in numba.prange(radiance.shape[0]):
        excess[row] = 0.0
        for col in range(radiance.shape[1]):
            if not (radiance[row, col, 0] or radiance[row, col, 1] or radiance[row, col, 2] or radiance[row, col, 3]):
                key[row, col] = INVISIBLE
                continue
            extent = 0.0
            factor = 0.0
            for axis in range(n_axes):
                size = abs(np.float64(coordinate[axis][row, col]))
                extent += share[axis] * size
                factor = max(factor, size / remap[axis, 0])
            if extent <= sharp_extent:
                key[row, col] = SHARP
                continue
            step = 0
            shrink = 1.0
            if factor > 1.0:
                step = _scale_step(factor, steps_per_octave, n_scales)
                shrink = 2.0 ** (-step / steps_per_octave)
                excess[row, 0] = max(excess[row, 0], factor)
                excess[row, 1] += 1
                excess[row, 2] = max(excess[row, 2], step)
            unit = 0
            for axis in range(n_axes):
                size = abs(np.float64(coordinate[axis][row, col])) * shrink
                place = int(grid_coordinate(size, remap[axis], shape[axis]))
                unit = unit * shape[axis] + min(place, shape[axis] - 1)
            cell = unit_cell[unit]
            n_directions = cell_start[cell + 1] - cell_start[cell]
            direction, transpose, flip_row, flip_col = 0, False, False, False
            if n_directions > 1:
                angle = math.atan2(path[row, col, 1], path[row, col, 0])
                direction, transpose, flip_row, flip_col = fold_direction(angle, n_directions)
            orientation = int(transpose) + 2 * int(flip_row) + 4 * int(flip_col)
            key[row, col] = 1 + 8 * (step * n_spreadlets + cell_start[cell] + direction) + orientation


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
def replace_keys(key, place, label):
    """Fill ``label`` (H, W), int32, with the place of each pixel's key, -1 where invisible; count the latter."""
    invisible = 0
    for row in numba.prange(key.shape[0]):
        for col in range(key.shape[1]):
            label[row, col] = place[key[row, col]] if key[row, col] >= 0 else -1
            invisible += key[row, col] < 0
    return invisible


@numba.njit(cache=True, fastmath=False)
def count_labels(label, n_variants):
    """Count the pixels of each variant, shape (n_variants,), int64."""
    count = np.zeros(n_variants, np.int64)
    for row in range(label.shape[0]):
        for col in range(label.shape[1]):
            if label[row, col] >= 0:
                count[label[row, col] % n_variants] += 1
    return count


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
def _median(values, n):
    """Return the median of the first n values, sorting them in place."""
    for i in range(1, n):
        each = values[i]
        k = i
        while k > 0 and values[k - 1] > each:
            values[k] = values[k - 1]
            k -= 1
        values[k] = each
    return np.float32(0.5) * (values[(n - 1) // 2] + values[n // 2])


@numba.njit(cache=True, fastmath=False, parallel=True)
def border_colours(strip, half, colour):
    """Take the median of a strip across the border, then along it.

    Parameters
    ----------
    strip : ndarray of shape (n, W, 4), float32
        Pixels along a border.
    half : int
        The second median is over ``2 half + 1`` pixels, repeating the last at the ends.
    colour : ndarray of shape (W, 4), float32
        Filled.
    """
    n, width = strip.shape[:2]
    across = np.empty((width, 4), np.float32)
    for col in numba.prange(width):
        values = np.empty(n, np.float32)
        for c in range(4):
            for i in range(n):
                values[i] = strip[i, col, c]
            across[col, c] = _median(values, n)
    for col in numba.prange(width):
        values = np.empty(2 * half + 1, np.float32)
        for c in range(4):
            for i in range(2 * half + 1):
                values[i] = across[min(max(col + i - half, 0), width - 1), c]
            colour[col, c] = _median(values, 2 * half + 1)


@numba.njit(cache=True, fastmath=False, parallel=True)
def extend_frame(frame, colours, reach, origin, extended):
    """Continue a frame's border outwards, as far as the PSFs of its pixels reach back.

    Parameters
    ----------
    frame : tuple of three ndarrays
        Colours (H, W, 4), float32; labels (H, W), int32; shifts (H, W, 2) or (0, 0, 2), int32.
    colours : tuple of four ndarrays of shapes (W, 4), (W, 4), (H, 4) and (H, 4), float32
        What lies above, below, left and right of the frame.
    reach : ndarray of shape (n_variants,), int64
        How far each variant's splat reaches, px. A label is ``layer * n_variants + variant``.
    origin : tuple of two ints
        Row and column, in the frame, of the first extended pixel.
    extended : tuple of three ndarrays
        Colours, labels and shifts of the extended frame; filled, labels with -1 where nothing is drawn.
    """
    radiance, label, shift = frame
    above, below, before, behind = colours
    out_radiance, out_label, out_shift = extended
    height, width = label.shape
    for i in numba.prange(out_label.shape[0]):
        down = origin[0] + i
        row = min(max(down, 0), height - 1)
        for j in range(out_label.shape[1]):
            right = origin[1] + j
            col = min(max(right, 0), width - 1)
            index = label[row, col]
            if out_shift.shape[0]:
                out_shift[i, j, 0] = shift[row, col, 0]
                out_shift[i, j, 1] = shift[row, col, 1]
            distance = max(abs(down - row), abs(right - col))
            if distance == 0:
                out_label[i, j] = index
                for c in range(4):
                    out_radiance[i, j, c] = radiance[row, col, c]
                continue
            if down < 0:
                colour = above[col]
            elif down >= height:
                colour = below[col]
            else:
                colour = before[row] if right < 0 else behind[row]
            dark = colour[0] == 0 and colour[1] == 0 and colour[2] == 0 and colour[3] == 0
            drawn = index >= 0 and not dark and distance <= reach[index % len(reach)]
            out_label[i, j] = index if drawn else -1
            for c in range(4):
                out_radiance[i, j, c] = colour[c]
