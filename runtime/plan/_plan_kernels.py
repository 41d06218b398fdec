"""Compiled kernels of the plan step: labels to variants, and points of variants."""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import FloatArray
from spreadlets.compiled import helper, kernel
from spreadlets.psf._capsule_kernels import thin_code
from spreadlets.psf._grid_kernels import fold_pose, grid_coordinate
from spreadlets.runtime.plan._streak_kernels import streak_code

INVISIBLE = -1
SHARP = 0
"""Keys of pixels that contribute nothing, and of those whose PSF stays within the pixel."""
FIRST_STREAK = -2
"""Keys of streaks and thin capsules, see `runtime.plan.streaks`, go down from here with their codes."""
STILL = 0.25
"""What moves so little adds to the extent of a PSF, px, that it is drawn as if it stood still."""
WIDE_EXTENT = 8.0
"""Extent of a PSF, px, above which a cell's is off by a pixel, and blocks of pixels are hidden under it."""
BLOCK_BITS = 2
"""Binary logarithm of the side of those blocks, px: as large as those that can be drawn as one."""
PHASES = ((3679390609, 3152041523), (2700274806, 2313257605))
"""Multiples of a block's row and column, in units of 2 to the power of -32, whose fraction is its threshold on each
axis: powers of 1 / 1.1673. Blocks beside one another have thresholds spread evenly over [0, 1) on both axes together
(Roberts 2018, "The unreasonable effectiveness of quasirandom sequences")."""
PHASE_MASK = (1 << 32) - 1


class GridTables(NamedTuple):
    """The grid of a database.

    ``remap``, ``shape`` and ``unit_cell`` are the model's, ``bounds`` (n_cells, n_axes, 2) its cells' boxes in units;
    ``cell_start`` is the file's.
    """

    remap: npt.NDArray[np.float64]
    shape: npt.NDArray[np.int64]
    unit_cell: npt.NDArray[np.int64]
    bounds: npt.NDArray[np.float64]
    cell_start: npt.NDArray[np.int64]


class PixelPlaces(NamedTuple):
    """Where pixels lie: row and column of the frame's first, counted from the picture's centre; those of a list.

    The latter, of shape (H, W, 2), int32, are counted from the frame's first pixel, and empty for all of a frame.
    """

    corner: tuple[int, int]
    at: npt.NDArray[np.int32]


class Sizes(NamedTuple):
    """How PSFs beyond the grid's range are scaled, and which stay within a pixel.

    Attributes
    ----------
    steps_per_octave, n_steps : int
        Scale steps.
    scaling : ndarray of shape (n_axes,), bool
        Which axes scale the PSF.
    share : ndarray of shape (n_axes,), float64
        How much of each coordinate adds to the PSF's extent.
    sharp_extent : float
        The extent, px, up to which the key is `SHARP`; and the radius up to which what moves leaves a streak.
    longest_streak : float
        Largest extent of a streak along an axis, px; 0 if there are none.
    closed_radius : float
        Radius, px, up to which PSFs are drawn in closed form; below 0 if there are none, see `psf.model.PsfModel`.
    """

    steps_per_octave: int
    n_steps: int
    scaling: npt.NDArray[np.bool_]
    share: npt.NDArray[np.float64]
    sharp_extent: float
    longest_streak: float
    closed_radius: float


class PoseLabels(NamedTuple):
    """Vectors (dx, dy) for directions, (H, W, 2); signed CoC radii, (H, W); shifts (H, W, 2) or (0, 0, 2).

    And the model's `PoseSymmetry.codes`.
    """

    heading: FloatArray
    coc: FloatArray
    shift: FloatArray
    codes: tuple[bool, bool, int]


@helper
def _scale_step(excess, steps_per_octave, n_steps):
    """Return by how many steps a PSF must shrink to come into range; ``excess`` is how many times it exceeds it."""
    if not excess > 1.0:
        return 0
    if excess > 2.0 ** ((n_steps - 1) / steps_per_octave):
        return n_steps - 1
    return int(math.ceil(steps_per_octave * math.log2(excess)))


# Kernels take arrays out of tuples, and numbers out of arrays, once: for each pixel it costs as much as its arithmetic.


@helper
def _axis(number, grid, sizes):
    """Return an axis's remapping, units, whether it scales the PSF and its share in the extent; of none, one unit."""
    if number >= len(grid.shape):
        return (1.0, 1.0, 0.0), 1, False, 0.0
    remap = grid.remap[number, 0], grid.remap[number, 1], grid.remap[number, 2]
    return remap, grid.shape[number], sizes.scaling[number], sizes.share[number]


@helper
def _extent(one, other, first, second):
    """Return the extent of a PSF of two coordinates, px, and how many times it exceeds the range of their axes."""
    factor = one / first[0][0] if first[2] else 0.0
    if second[2]:
        factor = max(factor, other / second[0][0])
    return first[3] * one + second[3] * other, factor


@helper
def _place(size, shrink, axis):
    """Return the place of a coordinate on its axis, the PSF made smaller by a factor."""
    return grid_coordinate(size * (shrink if axis[2] else 1.0), axis[0], axis[1])


@helper
def _cell(one, other, first, second, unit_cell):
    """Return the cell of a place in the grid."""
    return unit_cell[min(int(one), first[1] - 1) * second[1] + min(int(other), second[1] - 1)]


@helper
def _key(cell, step, x, y, coc, codes, cell_start):
    """Return the key of a cell's PSF in the direction (x, y) on a side of the focus, larger by some steps."""
    n_poses = cell_start[cell + 1] - cell_start[cell]
    angle = math.atan2(y, x) if n_poses > 1 else np.float32(0.0)
    number, transpose, flip_row, flip_col = fold_pose(angle, coc < 0.0, n_poses, codes)
    orientation = int(transpose) + 2 * int(flip_row) + 4 * int(flip_col)
    return 1 + 8 * (step * cell_start[-1] + cell_start[cell] + number) + orientation


@helper
def _shared_cell(place, axes, row, col, unit_cell, bounds):
    """Return the cell that a block takes of those about a place (2,) in the grid, which is overwritten.

    Axis by axis, the place lies between the middles of its cell and of the next. The block takes the next if its
    threshold is below the share of the way: so the mean of many blocks lies at the place.
    """
    first, second = axes
    for axis in range(bounds.shape[1]):
        cell, n_units = _cell(place[0], place[1], first, second, unit_cell), axes[axis][1]
        low, high, wanted = bounds[cell, axis, 0], bounds[cell, axis, 1], place[axis]
        middle = 0.5 * (low + high)
        place[axis] = middle
        if high < n_units if wanted > middle else low > 0.0:
            place[axis] = high + 0.5 if wanted > middle else low - 0.5
            cell = _cell(place[0], place[1], first, second, unit_cell)
            other = 0.5 * (bounds[cell, axis, 0] + bounds[cell, axis, 1])
            down, across = PHASES[axis]
            threshold = ((row * down + col * across) & PHASE_MASK) / (PHASE_MASK + 1.0)
            place[axis] = other if threshold < (wanted - middle) / (other - middle) else middle
    return _cell(place[0], place[1], first, second, unit_cell)


@kernel
def variant_keys(begin, end, colour, coordinate, pose, grid, sizes, key, excess):
    """Map the labels of each pixel to the key of its variant.

    Parameters
    ----------
    colour : tuple of two ndarrays of shapes (H, W, 4) and (H, W) or (0, 0), float32
        Colours and weights; no weights means 1. Pixels of zero colour and alpha, or weight, get the key `INVISIBLE`.
    coordinate : tuple of n_axes ndarrays of shape (H, W), float32
        Physical coordinates on one or two axes; their signs are ignored.
    pose : PoseLabels
    grid : GridTables
    sizes : Sizes
    key : ndarray of shape (H, W), int64
        Filled with ``1 + (scale step * n_spreadlets + spreadlet) * 8 + orientation``, or `FIRST_STREAK` less a code.
    excess : ndarray of shape (H, 3), float64
        Filled with each row's largest factor by which a PSF exceeds the range, the number of such pixels, and the
        largest scale step.
    """
    radiance, weight = colour
    heading, coc, shift, codes = pose
    unit_cell, cell_start, first, second = grid.unit_cell, grid.cell_start, _axis(0, grid, sizes), _axis(1, grid, sizes)
    steps_per_octave, n_steps, _, _, sharp_extent, longest, closed_radius = sizes
    largest = 2.0 ** ((n_steps - 1) / steps_per_octave)
    ones, others = coordinate[0], coordinate[-1]
    for row in range(begin, end):
        worst, count, largest_step = 0.0, 0, 0
        for col in range(radiance.shape[1]):
            r, g, b, a = radiance[row, col, 0], radiance[row, col, 1], radiance[row, col, 2], radiance[row, col, 3]
            if not (r or g or b or a) or (weight.shape[0] and weight[row, col] == 0):
                key[row, col] = INVISIBLE
                continue
            x, y, radius = heading[row, col, 0], heading[row, col, 1], coc[row, col]
            # Neighbours on one flat, still surface share all their labels; counting an excess needs the long way.
            if col > 0 and count == 0 and key[row, col - 1] >= 0:
                same = x == heading[row, col - 1, 0] and y == heading[row, col - 1, 1] and radius == coc[row, col - 1]
                if same and ones[row, col] == ones[row, col - 1] and others[row, col] == others[row, col - 1]:
                    key[row, col] = key[row, col - 1]
                    continue
            one, other = abs(np.float64(ones[row, col])), abs(np.float64(others[row, col]))
            extent, factor = _extent(one, other, first, second)
            if extent <= sharp_extent:
                key[row, col] = SHARP
                continue
            path_x, path_y = (np.float64(x), np.float64(y)) if longest > 0.0 else (0.0, 0.0)
            is_streak = one <= sharp_extent and extent - one > STILL
            if is_streak and max(abs(path_x), abs(path_y)) <= longest:
                across, down = 0.0, 0.0
                if len(shift):
                    across, down = np.float64(shift[row, col, 0]), np.float64(shift[row, col, 1])
                key[row, col] = FIRST_STREAK - streak_code(path_x, path_y, across, down)
                continue
            # Beyond the range, what would come into the closed form if it were scaled down is in it, too.
            wider = max(factor, 1.0) if factor <= largest else 1.0
            if one <= closed_radius * wider:
                key[row, col] = FIRST_STREAK - 2 * thin_code(one, path_x, path_y, wider) - 1
                continue
            # All others have a cell; what is beyond its range is scaled.
            step, shrink = 0, 1.0
            if factor > 1.0:
                step = _scale_step(factor, steps_per_octave, n_steps)
                shrink = 2.0 ** (-step / steps_per_octave)
                worst, count, largest_step = max(worst, factor), count + 1, max(largest_step, step)
            cell = _cell(_place(one, shrink, first), _place(other, shrink, second), first, second, unit_cell)
            key[row, col] = _key(cell, step, x, y, radius, codes, cell_start)
        excess[row, 0], excess[row, 1], excess[row, 2] = worst, count, largest_step


@kernel
def share_out(begin, end, radiance, limit, coordinate, pose, places, grid, sizes, key):
    """Let blocks of bright pixels under wide PSFs share out the cells about their coordinate.

    Parameters
    ----------
    radiance : ndarray of shape (H, W, 4), float32
    limit : float
        Radiance above which a pixel is bright.
    coordinate, pose, grid, sizes
        See `variant_keys`.
    places : PixelPlaces
    key : ndarray of shape (H, W), int64
        Changed in place; those up to `SHARP` are kept.
    """
    heading, coc, _, codes = pose
    _, _, unit_cell, bounds, cell_start = grid
    steps_per_octave, n_steps, at, corner = sizes.steps_per_octave, sizes.n_steps, places.at, places.corner
    first, second = _axis(0, grid, sizes), _axis(1, grid, sizes)
    ones, others, place = coordinate[0], coordinate[-1], np.empty(2)
    for row in range(begin, end):
        for col in range(radiance.shape[1]):
            r, g, b = radiance[row, col, 0], radiance[row, col, 1], radiance[row, col, 2]
            if key[row, col] <= SHARP or max(r, g, b) <= limit:
                continue
            # Small PSFs show no block.
            one, other = abs(np.float64(ones[row, col])), abs(np.float64(others[row, col]))
            extent, factor = _extent(one, other, first, second)
            if extent < WIDE_EXTENT:
                continue
            # Find the pixel's block, and the cell that it takes of those about the coordinate.
            down, across = row, col
            if len(at):
                down, across = np.int64(at[row, col, 0]), np.int64(at[row, col, 1])
            step = _scale_step(factor, steps_per_octave, n_steps)
            shrink = 2.0 ** (-step / steps_per_octave)
            place[0], place[1] = _place(one, shrink, first), _place(other, shrink, second)
            block = (down + corner[0]) >> BLOCK_BITS, (across + corner[1]) >> BLOCK_BITS
            x, y = heading[row, col, 0], heading[row, col, 1]
            cell = _shared_cell(place, (first, second), block[0], block[1], unit_cell, bounds)
            key[row, col] = _key(cell, step, x, y, coc[row, col], codes, cell_start)


@kernel
def sum_colours(begin, end, radiance, total):
    """Fill ``total`` (H,), float64, with the sums over rows of the colours of pixels (H, W, 4), without alpha."""
    for row in range(begin, end):
        red = green = blue = 0.0
        for col in range(radiance.shape[1]):
            red += radiance[row, col, 0]
            green += radiance[row, col, 1]
            blue += radiance[row, col, 2]
        total[row] = red + green + blue


@kernel
def mark_keys(begin, end, key, lowest, is_used):
    """Mark in ``is_used`` (n_keys,), bool, each key in use, counted from the lowest."""
    # Threads may write the same place, but nothing else than True.
    for row in range(begin, end):
        for col in range(key.shape[1]):
            if key[row, col] != INVISIBLE:
                is_used[key[row, col] - lowest] = True


@kernel
def replace_keys(begin, end, key, lowest, place, label):
    """Fill ``label`` (H, W), int32, with the place of each pixel's key, -1 where invisible."""
    for row in range(begin, end):
        for col in range(key.shape[1]):
            label[row, col] = place[key[row, col] - lowest] if key[row, col] != INVISIBLE else -1


@kernel
def key_range(begin, end, key):
    """Return the least and the largest key (H, W), int64, of some rows, and of 0."""
    low, high = 0, 0
    for row in range(begin, end):
        for col in range(key.shape[1]):
            low, high = min(low, key[row, col]), max(high, key[row, col])
    return low, high


@kernel
def count_labels(begin, end, label, n_variants):
    """Count the pixels of each variant in some rows, shape (n_variants,), int64."""
    count = np.zeros(n_variants, np.int64)
    for row in range(begin, end):
        for col in range(label.shape[1]):
            if label[row, col] >= 0:
                count[label[row, col] % n_variants] += 1
    return count
