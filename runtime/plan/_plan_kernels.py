"""Compiled kernels of the plan step: labels to variants, and points of variants."""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import FloatArray
from spreadlets.compiled import helper, kernel
from spreadlets.psf._grid_kernels import fold_pose, grid_coordinate
from spreadlets.runtime.plan._streak_kernels import disc_code, streak_code

INVISIBLE = -1
SHARP = 0
"""Keys of pixels that contribute nothing, and of those whose PSF stays within the pixel."""
FIRST_STREAK = -2
"""Keys of streaks and small discs, see `runtime.plan.streaks`, go down from here with their codes."""
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
    largest_disc : float
        Radius, px, up to which discs are drawn as they are; below 0 if the lens is not round, or there are no discs.
    """

    steps_per_octave: int
    n_steps: int
    scaling: npt.NDArray[np.bool_]
    share: npt.NDArray[np.float64]
    sharp_extent: float
    longest_streak: float
    largest_disc: float


class PoseLabels(NamedTuple):
    """Vectors (dx, dy) for directions, (H, W, 2); signed CoC radii, (H, W); shifts (H, W, 2) or (0, 0, 2).

    And the model's `PoseSymmetry.codes`.
    """

    heading: FloatArray
    coc: FloatArray
    shift: FloatArray
    codes: tuple[bool, bool, int]


@helper(inline="always")
def _scale_step(excess, steps_per_octave, n_steps):
    """Return by how many steps a PSF must shrink to come into range; ``excess`` is how many times it exceeds it."""
    if not excess > 1.0:
        return 0
    if excess > 2.0 ** ((n_steps - 1) / steps_per_octave):
        return n_steps - 1
    return int(math.ceil(steps_per_octave * math.log2(excess)))


@helper(inline="always")
def _same(coordinate, heading, coc, row, col):
    """Tell whether a pixel has the labels of the one to its left."""
    same = coc[row, col] == coc[row, col - 1]
    for axis in range(len(coordinate)):
        same &= coordinate[axis][row, col] == coordinate[axis][row, col - 1]
    return (
        same and heading[row, col, 0] == heading[row, col - 1, 0] and heading[row, col, 1] == heading[row, col - 1, 1]
    )


@helper(inline="always")
def _extent(coordinate, row, col, grid, sizes):
    """Return the extent of a pixel's PSF, px, and how many times it exceeds the range."""
    extent, factor = 0.0, 0.0
    for axis in range(len(coordinate)):
        size = abs(np.float64(coordinate[axis][row, col]))
        extent += sizes.share[axis] * size
        if sizes.scaling[axis]:
            factor = max(factor, size / grid.remap[axis, 0])
    return extent, factor


@helper(inline="always")
def _place(coordinate, row, col, shrink, grid, sizes, unit):
    """Fill ``unit`` (n_axes,), float64, with a pixel's place in the grid, its PSF made smaller by a factor."""
    for axis in range(len(coordinate)):
        size = abs(np.float64(coordinate[axis][row, col])) * (shrink if sizes.scaling[axis] else 1.0)
        unit[axis] = grid_coordinate(size, grid.remap[axis], grid.shape[axis])


@helper(inline="always")
def _cell(unit, grid):
    """Return the cell of a place in the grid."""
    index = 0
    for axis in range(len(unit)):
        index = index * grid.shape[axis] + min(int(unit[axis]), grid.shape[axis] - 1)
    return grid.unit_cell[index]


@helper(inline="always")
def _key(cell, step, pose, row, col, grid):
    """Return the key of a cell's PSF in the pixel's direction, larger by some steps."""
    n_poses = grid.cell_start[cell + 1] - grid.cell_start[cell]
    angle = math.atan2(pose.heading[row, col, 1], pose.heading[row, col, 0]) if n_poses > 1 else 0.0
    number, transpose, flip_row, flip_col = fold_pose(angle, pose.coc[row, col] < 0.0, n_poses, pose.codes)
    orientation = int(transpose) + 2 * int(flip_row) + 4 * int(flip_col)
    return 1 + 8 * (step * grid.cell_start[-1] + grid.cell_start[cell] + number) + orientation


@helper
def _shared_cell(unit, row, col, grid):
    """Return the cell that a block takes of those about a place in the grid, which is overwritten.

    Axis by axis, the place lies between the middles of its cell and of the next. The block takes the next if its
    threshold is below the share of the way: so the mean of many blocks lies at the place.
    """
    for axis in range(len(unit)):
        low, high = grid.bounds[_cell(unit, grid), axis]
        place, middle = unit[axis], 0.5 * (low + high)
        unit[axis] = middle
        if high < grid.shape[axis] if place > middle else low > 0.0:
            unit[axis] = high + 0.5 if place > middle else low - 0.5
            low, high = grid.bounds[_cell(unit, grid), axis]
            other = 0.5 * (low + high)
            down, across = PHASES[axis]
            threshold = ((row * down + col * across) & PHASE_MASK) / (PHASE_MASK + 1.0)
            unit[axis] = other if threshold < (place - middle) / (other - middle) else middle
    return _cell(unit, grid)


@kernel
def variant_keys(begin, end, colour, coordinate, pose, grid, sizes, key, excess):
    """Map the labels of each pixel to the key of its variant.

    Parameters
    ----------
    colour : tuple of two ndarrays of shapes (H, W, 4) and (H, W) or (0, 0), float32
        Colours and weights; no weights means 1. Pixels of zero colour and alpha, or weight, get the key `INVISIBLE`.
    coordinate : tuple of n_axes ndarrays of shape (H, W), float32
        Physical coordinates; their signs are ignored.
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
    heading, coc = pose.heading, pose.coc
    unit = np.empty(len(grid.remap))
    for row in range(begin, end):
        excess[row] = 0.0
        for col in range(radiance.shape[1]):
            r, g, b, a = radiance[row, col, 0], radiance[row, col, 1], radiance[row, col, 2], radiance[row, col, 3]
            if not (r or g or b or a) or (weight.shape[0] and weight[row, col] == 0):
                key[row, col] = INVISIBLE
                continue
            # Neighbours on one flat, still surface share all their labels; counting an excess needs the long way.
            if col > 0 and key[row, col - 1] >= 0 and excess[row, 1] == 0 and _same(coordinate, heading, coc, row, col):
                key[row, col] = key[row, col - 1]
                continue
            extent, factor = _extent(coordinate, row, col, grid, sizes)
            if extent <= sizes.sharp_extent:
                key[row, col] = SHARP
                continue
            radius = abs(np.float64(coordinate[0][row, col]))
            if radius <= sizes.largest_disc and extent - radius <= STILL:
                key[row, col] = FIRST_STREAK - disc_code(radius)
                continue
            if radius <= sizes.sharp_extent and sizes.longest_streak > 0.0:
                x, y = np.float64(heading[row, col, 0]), np.float64(heading[row, col, 1])
                if max(abs(x), abs(y)) <= sizes.longest_streak:
                    across, down = 0.0, 0.0
                    if len(pose.shift):
                        across, down = np.float64(pose.shift[row, col, 0]), np.float64(pose.shift[row, col, 1])
                    key[row, col] = FIRST_STREAK - streak_code(x, y, across, down)
                    continue
            step = 0
            shrink = 1.0
            if factor > 1.0:
                step = _scale_step(factor, sizes.steps_per_octave, sizes.n_steps)
                shrink = 2.0 ** (-step / sizes.steps_per_octave)
                excess[row, 0] = max(excess[row, 0], factor)
                excess[row, 1] += 1
                excess[row, 2] = max(excess[row, 2], step)
            _place(coordinate, row, col, shrink, grid, sizes, unit)
            key[row, col] = _key(_cell(unit, grid), step, pose, row, col, grid)


@kernel
def share_out(begin, end, radiance, limit, coordinate, pose, places, grid, sizes, apart, key):
    """Let blocks of bright pixels under wide PSFs share out the cells about their coordinate.

    Parameters
    ----------
    radiance : ndarray of shape (H, W, 4), float32
    limit : float
        Radiance above which a pixel is bright.
    coordinate, pose, grid, sizes
        See `variant_keys`.
    places : PixelPlaces
    apart : ndarray of shape (H, W), int32
        Not negative where a pixel keeps its key.
    key : ndarray of shape (H, W), int64
        Changed in place.
    """
    unit = np.empty(len(grid.remap))
    for row in range(begin, end):
        for col in range(radiance.shape[1]):
            r, g, b = radiance[row, col, 0], radiance[row, col, 1], radiance[row, col, 2]
            if key[row, col] <= SHARP or apart[row, col] >= 0 or max(r, g, b) <= limit:
                continue
            extent, factor = _extent(coordinate, row, col, grid, sizes)
            if extent < WIDE_EXTENT:
                continue
            y, x = row, col
            if len(places.at):
                y, x = np.int64(places.at[row, col, 0]), np.int64(places.at[row, col, 1])
            step = _scale_step(factor, sizes.steps_per_octave, sizes.n_steps)
            _place(coordinate, row, col, 2.0 ** (-step / sizes.steps_per_octave), grid, sizes, unit)
            block = (y + places.corner[0]) >> BLOCK_BITS, (x + places.corner[1]) >> BLOCK_BITS
            key[row, col] = _key(_shared_cell(unit, block[0], block[1], grid), step, pose, row, col, grid)


@kernel
def mark_keys(begin, end, key, lowest, place):
    """Set ``place`` (n_keys,), int32, to 0 for each key in use, counted from the lowest."""
    # Threads may write the same place, but nothing else than 0.
    for row in range(begin, end):
        for col in range(key.shape[1]):
            if key[row, col] != INVISIBLE:
                place[key[row, col] - lowest] = 0


@kernel
def replace_keys(begin, end, key, lowest, place, label):
    """Fill ``label`` (H, W), int32, with the place of each pixel's key, -1 where invisible."""
    for row in range(begin, end):
        for col in range(key.shape[1]):
            label[row, col] = place[key[row, col] - lowest] if key[row, col] != INVISIBLE else -1


@kernel
def count_labels(label, n_variants):
    """Count the pixels of each variant, shape (n_variants,), int64."""
    count = np.zeros(n_variants, np.int64)
    for row in range(label.shape[0]):
        for col in range(label.shape[1]):
            if label[row, col] >= 0:
                count[label[row, col] % n_variants] += 1
    return count
