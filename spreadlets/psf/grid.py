"""The nested grid of LKS section 5.2: cells whose edges grow linearly with the level, found in constant time.

Level l starts at the triangular number T_l = l (l + 1) / 2 and has cells of edge l + 1. It holds the cells that touch
its lower faces; what lies beyond them is the next level. A 9 x 9 grid has 28 cells instead of 81:

    level 0: 9 + 9 - 1 = 17 cells of edge 1, level 1: 4 + 4 - 1 = 7 of edge 2, level 2: 2 + 2 - 1 = 3 of edge 3,
    level 3: 1 cell, edge 4, of which 3 fit.

Everything here is in grid units; `spreadlets.psf.model.PsfGrid` adds the physical units.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from spreadlets.errors import InvalidParameterError
from spreadlets.psf._grid_kernels import cell_indices

MAX_SIDE_DIFFERENCE = 3
"""How far the sides of a shape may differ in `nested_shape`: enough to reach most counts, still nearly cubic."""


MAX_UNITS = 1 << 22
"""Most unit boxes of a grid: each takes a few bytes where a frame is planned. In one dimension they allow 2896 cells,
in two some 20 000."""


def _level_counts(shape: tuple[int, ...], level: int) -> tuple[int, ...]:
    """Return the number of cells per axis at ``level``, counting also those that belong to later levels."""
    start = level * (level + 1) // 2
    return tuple(-((start - side) // (level + 1)) for side in shape)


def _level_sizes(shape: tuple[int, ...]) -> list[int]:
    """Return the number of cells of each level."""
    sizes: list[int] = []
    while level_start(len(sizes)) < min(shape):
        counts = _level_counts(shape, len(sizes))
        sizes.append(math.prod(counts) - math.prod(count - 1 for count in counts))
    return sizes


def level_start(level: int) -> int:
    """Return the grid coordinate at which ``level`` starts, the triangular number level (level + 1) / 2."""
    return level * (level + 1) // 2


@dataclass(frozen=True)
class NestedGrid:
    """A nested grid over the box [0, N_1] x ... x [0, N_n].

    Parameters
    ----------
    shape : tuple of int
        The sides N_i in grid units, each at least 1.

    Raises
    ------
    InvalidParameterError
        If the shape is empty or a side is not a positive integer.
    """

    shape: tuple[int, ...]

    def __post_init__(self) -> None:
        if not self.shape or any(int(side) != side or side < 1 for side in self.shape):
            raise InvalidParameterError(f"a grid needs one or more sides, each an integer of at least 1: {self.shape}")
        object.__setattr__(self, "shape", tuple(int(side) for side in self.shape))
        if math.prod(self.shape) > MAX_UNITS:
            raise InvalidParameterError(
                f"a grid of {self.shape} units is too large: at most {MAX_UNITS}; ask for fewer cells"
            )

    @property
    def n_axes(self) -> int:
        """Number of axes."""
        return len(self.shape)

    @property
    def n_cells(self) -> int:
        """Number of cells."""
        return len(self.bounds)

    @cached_property
    def level_offset(self) -> npt.NDArray[np.int64]:
        """Number of cells before each level, shape (n_levels,): the table of LKS section 5.2, for the kernels."""
        return np.cumsum([0, *_level_sizes(self.shape)[:-1]], dtype=np.int64)

    @cached_property
    def unit_cell(self) -> npt.NDArray[np.int64]:
        """The cell of each unit box, row-major, shape (prod(shape),): every border of a cell is an integer."""
        return self.index(np.moveaxis(np.indices(self.shape), 0, -1) + 0.5).ravel()

    @cached_property
    def bounds(self) -> npt.NDArray[np.float64]:
        """Every cell's box, as of `boxes`, for the kernels; not to be changed."""
        # Place the boxes level by level, row-major, until the space is full.
        boxes = []
        for level in range(len(self.level_offset)):
            start = level_start(level)
            counts = _level_counts(self.shape, level)
            k = np.indices(counts).reshape(len(counts), -1).T
            low = start + (level + 1) * k[k.min(axis=1) == 0]
            boxes.append(np.stack([low, np.minimum(low + level + 1, self.shape)], axis=-1))
        return np.concatenate(boxes).astype(np.float64)

    def boxes(self) -> npt.NDArray[np.float64]:
        """Return every cell's box, the inverse map.

        Returns
        -------
        ndarray of shape (n_cells, n_axes, 2), float64
            Lower and upper border per axis, grid units. A box owns its lower borders; its upper ones only where
            they are the border of the space.
        """
        return self.bounds.copy()

    def index(self, coordinate: npt.ArrayLike) -> npt.NDArray[np.int64]:
        """Find the cells that hold the given coordinates, in O(1) each.

        Parameters
        ----------
        coordinate : array_like of shape (..., n_axes)
            Grid units; values outside the space are clamped into it.

        Returns
        -------
        ndarray of shape (...), int64

        Raises
        ------
        InvalidParameterError
            If the last axis is not n_axes long.

        Notes
        -----
        LKS section 5.2, "forward mapping".
        """
        points = as_coordinates(coordinate, self.n_axes)
        shape = np.array(self.shape, dtype=np.int64)
        flat = cell_indices(points.reshape(-1, self.n_axes), shape, self.level_offset)
        return np.asarray(flat.reshape(points.shape[:-1]), dtype=np.int64)


def as_coordinates(coordinate: npt.ArrayLike, n_axes: int) -> npt.NDArray[np.float64]:
    """Return ``coordinate`` as contiguous float64 of shape (..., n_axes), or say why it is not one."""
    points = np.ascontiguousarray(coordinate, dtype=np.float64)
    if np.ndim(coordinate) == 0 or points.shape[-1] != n_axes:
        raise InvalidParameterError(
            f"coordinates need shape (..., {n_axes}), one entry per axis, not {np.shape(coordinate)}"
        )
    return points


def nested_shape(n_cells: int, n_axes: int, most: Sequence[int | None] | None = None) -> tuple[int, ...]:
    """Return the nearly cubic shape whose nested grid has ``n_cells`` cells, or else the most cells below that.

    Parameters
    ----------
    n_cells : int
        At least 1.
    n_axes : int
        At least 1.
    most : sequence of (int or None), optional
        Largest side on each axis, None for no limit; then the other sides are longer than a cube's. One at least must
        have no limit.

    Returns
    -------
    tuple of int
        Sides that differ by at most `MAX_SIDE_DIFFERENCE` before they are limited, in falling order. Among equals the
        most cubic shape, then the one of largest volume, because its last cells are clipped least.

    Raises
    ------
    InvalidParameterError
        If an argument is below 1, or every side is limited.

    Examples
    --------
    >>> nested_shape(400, 2), nested_shape(1000, 2, (None, 80))
    ((77, 75), (260, 80))
    """
    if n_cells < 1 or n_axes < 1:
        raise InvalidParameterError(f"n_cells and n_axes must be at least 1, not {n_cells} and {n_axes}")
    limits = [math.inf if limit is None else limit for limit in most or (None,) * n_axes]
    if math.inf not in limits:
        raise InvalidParameterError(f"one side at least must have no limit, not {most}")

    def limited(sides: Sequence[int]) -> tuple[int, ...]:
        return tuple(int(min(side, limit)) for side, limit in zip(sides, limits, strict=True))

    def count(sides: Sequence[int]) -> int:
        return sum(_level_sizes(limited(sides)))

    side = 1
    while count((2 * side,) * n_axes) <= n_cells:
        side *= 2
    # The count never falls as a side grows: bisect for the largest cube that fits.
    step = side
    while step:
        if count((side + step,) * n_axes) <= n_cells:
            side += step
        step //= 2
    best = ((1, 0, 1), (1,) * n_axes)
    for smallest in range(max(1, side - MAX_SIDE_DIFFERENCE), side + 1):
        longer = range(smallest, smallest + MAX_SIDE_DIFFERENCE + 1)
        for rising in itertools.combinations_with_replacement(longer, n_axes):
            if count(rising[::-1]) <= n_cells:
                best = max(best, ((count(rising[::-1]), rising[0] - rising[-1], math.prod(rising)), rising[::-1]))
    return limited(best[1])
