"""The parameter spaces of the PSF models (LKS section 5.1, table 1) and their cells in physical units.

A model is declared here once, in the table below; nothing else asks for a model by its name, save the table that
joins a name to its tracer.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from spreadlets._kernels import cell_indices, fold_directions, grid_coordinates
from spreadlets.errors import InvalidParameterError
from spreadlets.grid import NestedGrid, as_coordinates, nested_shape

DIRECTION_STEP_PX = 1.0 / 3.0
"""Travel of the tip of a line without width between two neighbouring directions, px: no direction is off by more than
half of it."""

DIRECTION_STEP_COC_PX = 2.4
"""CoC radius, px, that allows one more such step at once, the smallest of a cell counting: width hides a turn."""

MAX_DIRECTION_STEPS = 16.0
"""Steps at once that no CoC exceeds. With these three, a PSF midway between two directions, measured in 24 cells of all
sizes, loses 0.016 of similarity at its worst angle as a rule, and up to 0.03 at a few angles of the sharpest lines."""

STILL_MOTION_PX = 1.0
"""A path no longer than a pixel, px, looks the same in every direction."""

COC_FLOOR_PX = 1.0
"""PSFs with smaller circles of confusion share a unit of the grid. On frames, 400 cells with this floor are as good as
800 without: half of them would go to radii that no pixel shows."""

OCTANT = math.pi / 4.0
"""The lattice's symmetry maps every direction into [0, pi/4], radians."""

DEFAULT_MAX_COC = 64.0
DEFAULT_MAX_MOTION = 128.0


@dataclass(frozen=True)
class Axis:
    """One axis of a PSF model's parameter space.

    Parameters
    ----------
    name, unit : str
    maximum : float
        The coordinate runs from 0 to this value.
    power : float
        Grid units grow as ``(s / maximum) ** (1 / power)``: above 1, cells are finer near zero (LKS section 5.2).
    floor : float
        Coordinates below it make no visible difference: they all belong to the first unit, and the others start here.
    """

    name: str
    unit: str
    maximum: float
    power: float
    floor: float = 0.0

    def __post_init__(self) -> None:
        if not (0.0 < self.maximum < math.inf and 0.0 < self.power < math.inf and 0.0 <= self.floor < self.maximum):
            raise InvalidParameterError(
                f"axis {self.name!r} needs a finite maximum and power above 0 and a floor from 0 to below the maximum, "
                f"not {self.maximum}, {self.power} and {self.floor}"
            )

    @property
    def first(self) -> float:
        """The floor on the power-remapped axis, in [0, 1)."""
        return float((self.floor / self.maximum) ** (1.0 / self.power))


@dataclass(frozen=True)
class PsfModel:
    """A family of PSFs over a few physical parameters.

    Parameters
    ----------
    name : str
    axes : tuple of Axis
    n_channels : int
        1 for monochromatic PSFs, 3 for coloured ones.
    has_direction : bool
        Whether the PSF is stretched along a motion. Then the first axis is the CoC radius in px, the last one the
        length of that motion in px, and each cell holds several directions.
    default_cells : int
        Number of cells of the model's grid.
    """

    name: str
    axes: tuple[Axis, ...]
    n_channels: int
    has_direction: bool
    default_cells: int

    @property
    def n_axes(self) -> int:
        """Number of parameters."""
        return len(self.axes)


def _coc_floor(max_coc: float) -> float:
    return min(COC_FLOOR_PX, 0.5 * max_coc)


def _simplelens(max_coc: float, max_motion: float) -> PsfModel:
    """Thin lens; the motion is ignored."""
    return PsfModel("simplelens", (Axis("coc", "px", max_coc, 2.0, _coc_floor(max_coc)),), 1, False, 100)


def _combined(max_coc: float, max_motion: float) -> PsfModel:
    """Thin lens with straight, constant motion; its length is that of the path over the shutter."""
    axes = (Axis("coc", "px", max_coc, 2.0, _coc_floor(max_coc)), Axis("motion", "px", max_motion, 1.0))
    return PsfModel("combined", axes, 1, True, 400)


MODELS: dict[str, Callable[[float, float], PsfModel]] = {"simplelens": _simplelens, "combined": _combined}


def get_model(name: str, max_coc: float = DEFAULT_MAX_COC, max_motion: float = DEFAULT_MAX_MOTION) -> PsfModel:
    """Return the model called ``name``, scaled to the given ranges.

    Parameters
    ----------
    name : str
        A key of `MODELS`.
    max_coc : float
        Largest circle-of-confusion radius, px.
    max_motion : float
        Longest motion path over the shutter, px; only models with motion use it.

    Raises
    ------
    InvalidParameterError
        If the name is unknown or a range is not above zero.
    """
    if name not in MODELS:
        raise InvalidParameterError(f"unknown PSF model {name!r}; available: {', '.join(sorted(MODELS))}")
    return MODELS[name](max_coc, max_motion)


@dataclass(frozen=True)
class PsfGrid:
    """The cells of a model's parameter space, in physical units.

    Parameters
    ----------
    model : PsfModel
    shape : tuple of int
        Sides of the nested grid, one per axis of the model.
    direction_step_px : float
        Travel of the motion path's tip between neighbouring directions, px, where the CoC is 0.

    Raises
    ------
    InvalidParameterError
        If the shape does not fit the model or the step is not above zero.

    Notes
    -----
    LKS section 5.2. A physical coordinate s of an axis lies at ``N (t - t0) / (1 - t0)`` grid units, with
    ``t = (s / maximum) ** (1 / power)`` and t0 that of the axis's floor.
    """

    model: PsfModel
    shape: tuple[int, ...]
    direction_step_px: float = DIRECTION_STEP_PX

    def __post_init__(self) -> None:
        if len(self.shape) != self.model.n_axes:
            raise InvalidParameterError(
                f"model {self.model.name!r} has {self.model.n_axes} axes, but the shape is {self.shape}"
            )
        if not self.direction_step_px > 0.0:
            raise InvalidParameterError(f"direction_step_px must be above 0, not {self.direction_step_px}")

    @classmethod
    def of(cls, model: PsfModel, n_cells: int | None = None) -> "PsfGrid":
        """Return the nearly cubic grid of ``n_cells`` cells, by default as many as the model asks for."""
        return cls(model, nested_shape(model.default_cells if n_cells is None else n_cells, model.n_axes))

    @cached_property
    def nested(self) -> NestedGrid:
        """The grid in grid units."""
        return NestedGrid(self.shape)

    @property
    def n_cells(self) -> int:
        """Number of cells."""
        return self.nested.n_cells

    @cached_property
    def maximum(self) -> npt.NDArray[np.float64]:
        """Upper end of each axis, physical units, shape (n_axes,)."""
        return np.array([axis.maximum for axis in self.model.axes], dtype=np.float64)

    @cached_property
    def power(self) -> npt.NDArray[np.float64]:
        """Power of each axis, shape (n_axes,)."""
        return np.array([axis.power for axis in self.model.axes], dtype=np.float64)

    @cached_property
    def first(self) -> npt.NDArray[np.float64]:
        """Floor of each axis on the power-remapped axis, shape (n_axes,)."""
        return np.array([axis.first for axis in self.model.axes], dtype=np.float64)

    @cached_property
    def remap(self) -> npt.NDArray[np.float64]:
        """Maximum, power and first of each axis, shape (n_axes, 3), as the kernels take them."""
        return np.stack([self.maximum, self.power, self.first], axis=1)

    @cached_property
    def boxes(self) -> npt.NDArray[np.float64]:
        """Every cell's box, physical units, shape (n_cells, n_axes, 2)."""
        units = self.nested.boxes()
        first = self.first[:, None]
        fraction = first + (1.0 - first) * units / np.array(self.shape, dtype=np.float64)[:, None]
        boxes = self.maximum[:, None] * fraction ** self.power[:, None]
        return np.asarray(np.where(units > 0, boxes, 0.0), dtype=np.float64)

    @cached_property
    def direction_counts(self) -> npt.NDArray[np.int64]:
        """Number of directions stored for each cell, shape (n_cells,).

        A path of length l turning by d moves its tip by d l / 2, so neighbouring nodes are at most ``2 step / l``
        apart, l being the longest path of the cell. The step is `direction_step_px` for a line, and grows with the
        smallest CoC radius of the cell by as much again every `DIRECTION_STEP_COC_PX`, `MAX_DIRECTION_STEPS` at most.
        """
        if not self.model.has_direction:
            return np.ones(self.n_cells, dtype=np.int64)
        longest = self.boxes[:, -1, 1]
        n_steps = np.minimum(1.0 + self.boxes[:, 0, 0] / DIRECTION_STEP_COC_PX, MAX_DIRECTION_STEPS)
        step = self.direction_step_px * n_steps
        steps = np.ceil(OCTANT * longest / (2.0 * step))
        return np.where(longest > STILL_MOTION_PX, steps + 1.0, 1.0).astype(np.int64)

    def find(self, coordinates: npt.ArrayLike) -> npt.NDArray[np.int64]:
        """Return the cells of physical coordinates (..., n_axes), clamped to the model's range, as int64 (...)."""
        points = as_coordinates(coordinates, self.model.n_axes)
        flat = points.reshape(-1, self.model.n_axes)
        shape = np.array(self.shape, dtype=np.int64)
        units = grid_coordinates(flat, self.remap, shape)
        cells = cell_indices(units, shape, self.nested.level_offset)
        return np.asarray(cells.reshape(points.shape[:-1]), dtype=np.int64)

    def box(self, cell: int) -> npt.NDArray[np.float64]:
        """Return the box of a cell, float64 of shape (n_axes, 2), physical units."""
        return np.array(self.boxes[cell], dtype=np.float64)

    def coordinate(self, cell: int) -> npt.NDArray[np.float64]:
        """Return the midpoint of a cell's physical box, float64 of shape (n_axes,)."""
        return np.asarray(self.boxes[cell].mean(axis=-1), dtype=np.float64)

    def directions(self, cell: int) -> npt.NDArray[np.float64]:
        """Return the motion directions stored for a cell, radians in [0, pi/4], float64."""
        return np.linspace(0.0, OCTANT, int(self.direction_counts[cell]), dtype=np.float64)

    def direction_half_width(self, cell: int) -> float:
        """Return the half-width of the pre-filter over directions, radians: the node spacing, 0 for a single node."""
        count = int(self.direction_counts[cell])
        return OCTANT / (count - 1) if count > 1 else 0.0

    def nearest_direction(
        self, cell: npt.ArrayLike, angle: npt.ArrayLike
    ) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.bool_], npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
        """Find the stored direction nearest to a motion angle, and the lattice symmetry that brings it there.

        Parameters
        ----------
        cell : array_like of int
        angle : array_like of float
            Radians, ``atan2(dy, dx)`` with y down; any value. Broadcast against ``cell``.

        Returns
        -------
        index : ndarray of int64
            Into ``directions(cell)``.
        transpose, flip_row, flip_col : ndarray of bool
            Swap rows and columns first, then negate the row, then the column.

        Notes
        -----
        The PSF of constant motion is symmetric under half a turn, so four of the lattice's eight symmetries suffice,
        and `spreadlets._kernels.fold_direction` picks exactly one of them.
        """
        cells, angles = np.broadcast_arrays(np.asarray(cell, dtype=np.int64), np.asarray(angle, dtype=np.float64))
        if not self.model.has_direction:
            still = np.zeros(angles.shape, dtype=np.bool_)
            return np.zeros(angles.shape, dtype=np.int64), still, still.copy(), still.copy()
        index, flags = fold_directions(angles.ravel(), self.direction_counts[cells].ravel())
        transpose, flip_row, flip_col = (flags[:, i].reshape(angles.shape) for i in range(3))
        return index.reshape(angles.shape), transpose, flip_row, flip_col
