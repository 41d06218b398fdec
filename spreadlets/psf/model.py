"""The parameter spaces of the PSF models (LKS section 5.1, table 1) and their cells in physical units.

A model is declared here once, in the table below; nothing else asks for a model by its name, save the table that
joins a name to its tracer.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt

from spreadlets.errors import InvalidParameterError
from spreadlets.psf._capsule_kernels import CLOSED_RADIUS_PX
from spreadlets.psf._grid_kernels import (
    SIGN_IGNORED,
    SIGN_STORED,
    SIGN_TURNED,
    SIGN_TURNED_WHOLE,
    cell_indices,
    fold_poses,
    grid_coordinates,
)
from spreadlets.psf.grid import NestedGrid, as_coordinates, nested_shape

DIRECTION_STEP_PX = 1.0 / 3.0
"""Travel of the tip of a line without width between two neighbouring directions, px: no direction is off by more than
half of it."""

DIRECTION_STEP_COC_PX = 2.4
"""CoC radius, px, that allows one more such step at once, the smallest of a cell counting: width hides a turn."""

MAX_DIRECTION_STEPS = 16.0
"""Steps at once that no CoC exceeds. With these three, a PSF midway between two directions, measured in 24 cells of all
sizes, loses 0.016 of similarity at its worst angle as a rule, and up to 0.03 at a few angles of the sharpest lines."""

LENS_DIRECTION_STEPS = 4.5
"""Steps at once for what a lens makes of a point off its axis, which is never as sharp as a line; or half the width of
the pre-filter, where that is more."""

EYE_DIRECTION_STEPS = 9.0
"""The same for a cat's eye: half as many directions are as near to the exact PSFs, at random coordinates, as more."""

STILL_MOTION_PX = 1.0
"""A path no longer than a pixel, px, looks the same in every direction."""

COC_FLOOR_PX = 1.0
"""PSFs with smaller circles of confusion share a unit of the grid. On frames, 400 cells with this floor are as good as
800 without: half of them would go to radii that no pixel shows."""

FINEST_MOTION_PX = 1.6
"""Length of the path, px, over which what is still is averaged in a grid of many cells. More cells then divide the CoC:
the radius of a rim shows more than the ends of a path. At random coordinates the PSFs of 400 cells have a similarity of
.935 to the exact ones, those of 1000 with equal units .955, and with these .967, for a fifth less time to build."""

FINEST_ECCENTRICITY_MM = 0.19
"""The same for the distance from a lens's axis. At random coordinates, PSFs of 128 cells of a double Gauss have a
similarity of .74, those of 754 with equal units .85, those of 800 with these .90."""

FINEST_FIELD = 0.2
"""The same for the way from the picture's middle to a corner. With 200 cells, PSFs at random coordinates are as near to
the exact ones as with .1 and 400."""

UNIT_TOLERANCE = 1e-9
"""Share of a unit that is rounding."""

OCTANT = math.pi / 4.0
"""The lattice's symmetry maps every direction into [0, pi/4], radians."""

DEFAULT_MAX_COC = 64.0
DEFAULT_MAX_MOTION = 128.0

DEFAULT_MAX_DISTANCE_M = 4.0
"""Range of the model `volume`: at its density, 3.6 mean free paths."""

DEFAULT_MAX_ECCENTRICITY_MM = 25.5
"""Corner of a square image on a sensor 36 mm wide."""

Heading = Literal["motion", "azimuth"]
Sign = Literal["ignored", "turned", "stored"]

SIGN_CODES: dict[Sign, int] = {"ignored": SIGN_IGNORED, "turned": SIGN_TURNED, "stored": SIGN_STORED}


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
        Coordinates below it make no visible difference, or their PSFs are drawn in closed form: they all belong to the
        first unit, and the others start here.
    scales : bool
        Whether the PSF beyond the maximum is the one at the maximum, magnified; if not, it is that one as it is.
    finest : float
        Width of the first unit of a grid below which a finer one would bring little; 0 for no such width. Where there
        are cells to spend, they divide the other axes.
    """

    name: str
    unit: str
    maximum: float
    power: float
    floor: float = 0.0
    scales: bool = True
    finest: float = 0.0

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

    @property
    def most_units(self) -> int | None:
        """Units of a grid at which the first is as narrow as makes sense; None if there is no such number."""
        if not self.finest:
            return None
        end = float(min((self.floor + self.finest) / self.maximum, 1.0) ** (1.0 / self.power))
        return math.ceil((1.0 - self.first) / (end - self.first) - UNIT_TOLERANCE)


@dataclass(frozen=True)
class PoseSymmetry:
    """What the direction of a pixel and the sign of its circle of confusion do to its PSF.

    Each cell stores a spreadlet for every *pose* (a side of the focus and a direction) that no symmetry gives from
    another.

    Parameters
    ----------
    heading : {"motion", "azimuth"}
        The label that the direction is read from: that of the motion, or the pixel's, seen from the image's centre.
    arrow : bool
        Whether the opposite direction gives another PSF: an arrow rather than a line.
    lattice : bool
        Whether the PSF is its own mirror image about its direction. Then the lattice's symmetries map directions onto
        each other, and those in [0, pi/4] suffice; else all are stored.
    sign : {"ignored", "turned", "stored"}
        In front of focus the PSF is the one behind it; or that, turned by half a turn, save for a motion; or one of its
        own.

    Raises
    ------
    InvalidParameterError
        If a name is unknown.
    """

    heading: Heading = "motion"
    arrow: bool = False
    lattice: bool = True
    sign: Sign = "ignored"

    def __post_init__(self) -> None:
        if self.heading not in get_args(Heading) or self.sign not in get_args(Sign):
            raise InvalidParameterError(
                f"heading is {self.heading!r} and sign {self.sign!r}: "
                f"allowed are {get_args(Heading)} and {get_args(Sign)}"
            )

    @property
    def n_sides(self) -> int:
        """Sides of the focus for which spreadlets are stored."""
        return 2 if self.sign == "stored" else 1

    @property
    def n_spans(self) -> int:
        """How often the octant fits into the directions that are stored."""
        if self.lattice:
            return 1
        return 8 if self.arrow else 4

    @property
    def codes(self) -> tuple[bool, bool, int]:
        """The symmetry as the kernels take it: arrow, lattice, and one of `SIGN_CODES`."""
        whole = self.sign == "turned" and self.heading == "azimuth"
        return self.arrow, self.lattice, SIGN_TURNED_WHOLE if whole else SIGN_CODES[self.sign]


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
        Whether the PSF depends on a direction: then each cell holds several, and the first axis is the CoC radius in
        px. The direction of a motion goes with a last axis that is the motion's length in px.
    default_cells : int
        Number of cells of the model's grid.
    symmetry : PoseSymmetry
        What direction and sign do.
    settings : mapping
        What else the PSFs depend on, as the model's tracer takes it; JSON values only. It is stored in the database.
    """

    name: str
    axes: tuple[Axis, ...]
    n_channels: int
    has_direction: bool
    default_cells: int
    symmetry: PoseSymmetry = PoseSymmetry()
    settings: Mapping[str, Any] = field(default_factory=dict)

    @property
    def n_axes(self) -> int:
        """Number of parameters."""
        return len(self.axes)

    @property
    def has_defocus(self) -> bool:
        """Whether the PSFs are those of a lens, whose focus and f-number change them."""
        return any(axis.name in ("coc", "depth") for axis in self.axes)

    @property
    def has_motion(self) -> bool:
        """Whether the PSFs are those of things that move."""
        return any(axis.name == "motion" for axis in self.axes)

    @property
    def parts_colours(self) -> bool:
        """Whether PSFs shift each colour by another way from place to place, as glass does, and none loses light."""
        return self.n_channels > 1 and self.symmetry.heading == "azimuth"

    @property
    def closed_radius(self) -> float:
        """CoC radius up to which PSFs are drawn in closed form, px; -1 if they are not those of a round thin lens."""
        is_round = self.axes[0].name == "coc" and self.n_channels == 1 and not self.settings
        return CLOSED_RADIUS_PX if is_round else -1.0


def _coc_floor(max_coc: float, *, is_round: bool = False) -> float:
    return min(CLOSED_RADIUS_PX if is_round else COC_FLOOR_PX, 0.5 * max_coc)


def _simplelens(max_coc: float, max_motion: float, settings: Mapping[str, Any]) -> PsfModel:
    """Thin lens; the motion is ignored. Its aperture may change from the picture's middle to the corners."""
    coc = Axis("coc", "px", max_coc, 2.0, _coc_floor(max_coc, is_round=not settings))
    if settings.get("aperture", {}).get("cats_eye_radial"):
        axes = coc, Axis("field", "of the way to a corner", 1.0, 1.0, scales=False, finest=FINEST_FIELD)
        return PsfModel("simplelens", axes, 1, True, 200, _stored_symmetry(settings), settings)
    return PsfModel("simplelens", (coc,), 1, False, 100, _stored_symmetry(settings), settings)


def _combined(max_coc: float, max_motion: float, settings: Mapping[str, Any]) -> PsfModel:
    """Thin lens with straight motion; its length is that of the path over the shutter."""
    axes = (
        Axis("coc", "px", max_coc, 2.0, _coc_floor(max_coc, is_round=not settings)),
        Axis("motion", "px", max_motion, 1.0, finest=FINEST_MOTION_PX),
    )
    return PsfModel("combined", axes, 1, True, 400, _stored_symmetry(settings), settings)


def _stylized(max_coc: float, max_motion: float, settings: Mapping[str, Any]) -> PsfModel:
    """Any image, as large as the circle of confusion, upright on both sides of the focus."""
    axes = (Axis("coc", "px", max_coc, 1.5, _coc_floor(max_coc)),)
    return PsfModel("stylized", axes, 3, False, 200, settings=settings)


def _volume(max_coc: float, max_motion: float, settings: Mapping[str, Any]) -> PsfModel:
    """Homogeneous scattering medium between the scene and the camera."""
    axes = (Axis("distance", "m", settings.get("max_distance_m", DEFAULT_MAX_DISTANCE_M), 1.0, scales=False),)
    return PsfModel("volume", axes, 3, False, 200, settings=settings)


def _physicallens(max_coc: float, max_motion: float, settings: Mapping[str, Any]) -> PsfModel:
    """Real glass; depth is told by the circle of confusion that a thin lens would have."""
    eccentricity = settings.get("max_eccentricity_mm", DEFAULT_MAX_ECCENTRICITY_MM)
    axes = (
        Axis("depth", "px of CoC", max_coc, 2.5, _coc_floor(max_coc)),
        Axis("eccentricity", "mm", eccentricity, 1.2, scales=False, finest=FINEST_ECCENTRICITY_MM),
    )
    symmetry = PoseSymmetry("azimuth", arrow=True, sign="stored")
    return PsfModel("physicallens", axes, 3, True, 4000, symmetry, settings)


def _stored_symmetry(settings: Mapping[str, Any]) -> PoseSymmetry:
    """Return the symmetry that the settings name, by default that of a round aperture and an even shutter."""
    return PoseSymmetry(**settings.get("symmetry", {}))


MODELS: dict[str, Callable[[float, float, Mapping[str, Any]], PsfModel]] = {
    "simplelens": _simplelens,
    "combined": _combined,
    "physicallens": _physicallens,
    "stylized": _stylized,
    "volume": _volume,
}


def get_model(
    name: str,
    max_coc: float = DEFAULT_MAX_COC,
    max_motion: float = DEFAULT_MAX_MOTION,
    settings: Mapping[str, Any] | None = None,
) -> PsfModel:
    """Return the model called ``name``, scaled to the given ranges.

    Parameters
    ----------
    name : str
        A key of `MODELS`.
    max_coc : float
        Largest circle-of-confusion radius, px.
    max_motion : float
        Longest motion path over the shutter, px; only models with motion use it.
    settings : mapping, optional
        What else the model depends on.

    Raises
    ------
    InvalidParameterError
        If the name is unknown or a range is not above zero.
    """
    if name not in MODELS:
        raise InvalidParameterError(f"unknown PSF model {name!r}; available: {', '.join(sorted(MODELS))}")
    return MODELS[name](max_coc, max_motion, settings or {})


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
        """Return the nearly cubic grid of ``n_cells`` cells, by default as many as the model asks for.

        Axes whose units would become finer than makes sense have fewer.
        """
        count, most = model.default_cells if n_cells is None else n_cells, [axis.most_units for axis in model.axes]
        return cls(model, nested_shape(count, model.n_axes, most))

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
        # What is below a floor belongs to the first unit, unless it needs no cell.
        closed = np.array([0.0 < self.model.closed_radius <= axis.floor for axis in self.model.axes])
        return np.asarray(np.where(closed[:, None] | (units > 0), boxes, 0.0), dtype=np.float64)

    @cached_property
    def direction_counts(self) -> npt.NDArray[np.int64]:
        """Number of directions stored for each cell, shape (n_cells,).

        A path of length l turning by d moves its tip by d l / 2, so neighbouring nodes are at most ``2 step / l``
        apart, l being the longest path of the cell. The step is `direction_step_px` for a line, and grows with the
        smallest CoC radius of the cell by as much again every `DIRECTION_STEP_COC_PX`, `MAX_DIRECTION_STEPS` at most.
        """
        if not self.model.has_direction:
            return np.ones(self.n_cells, dtype=np.int64)
        longest = self._turning_lengths
        step = self.direction_step_px * self._direction_steps
        steps = np.ceil(OCTANT * longest / (2.0 * step))
        return np.where(longest > STILL_MOTION_PX, steps + 1.0, 1.0).astype(np.int64)

    @property
    def _direction_steps(self) -> npt.NDArray[np.float64]:
        """How many times `direction_step_px` each cell's directions may be apart, shape (n_cells,)."""
        if self.model.symmetry.heading == "motion":
            return np.minimum(1.0 + self.boxes[:, 0, 0] / DIRECTION_STEP_COC_PX, MAX_DIRECTION_STEPS)
        width = np.diff(self.boxes[:, :-1], axis=2).max(axis=(1, 2))
        least = EYE_DIRECTION_STEPS if self.model.axes[-1].name == "field" else LENS_DIRECTION_STEPS
        return np.asarray(np.maximum(least, 0.5 * width / self.direction_step_px))

    @property
    def _turning_lengths(self) -> npt.NDArray[np.float64]:
        """Length, px, of the motion path that a turn moves as much as each cell's PSF, shape (n_cells,).

        A lens is round on its axis: the PSF loses its roundness in proportion to the distance from it.
        """
        if self.model.symmetry.heading == "motion":
            return np.asarray(self.boxes[:, -1, 1], dtype=np.float64)
        share = self.boxes[:, -1, 1] / self.maximum[-1]
        return np.asarray(2.0 * share * (self.boxes[:, 0, 1] + self.model.settings.get("aberration_px", 0.0)))

    @cached_property
    def pose_counts(self) -> npt.NDArray[np.int64]:
        """Number of poses stored for each cell, shape (n_cells,): directions, times the sides of the focus."""
        symmetry = self.model.symmetry
        counts = self.direction_counts
        if symmetry.n_spans > 1:
            counts = np.maximum(symmetry.n_spans * (counts - 1), 1)
        return np.asarray(symmetry.n_sides * counts, dtype=np.int64)

    def side(self, cell: int, number: int) -> int:
        """Return on which side of the focus a pose of a cell lies: 1 behind it, -1 in front of it."""
        behind = int(self.pose_counts[cell]) // self.model.symmetry.n_sides
        return 1 if number < behind else -1

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

    def angles(self, cell: int) -> npt.NDArray[np.float64]:
        """Return the angle of each pose stored for a cell, radians, float64; those behind the focus come first."""
        return self.angles_of(int(self.pose_counts[cell]))

    def angles_of(self, pose_count: int) -> npt.NDArray[np.float64]:
        """Return the angle of each pose of a cell with so many."""
        symmetry = self.model.symmetry
        count = pose_count // symmetry.n_sides
        stop = symmetry.n_spans * OCTANT
        nodes = np.linspace(0.0, stop, count, endpoint=symmetry.lattice, dtype=np.float64)
        return np.tile(nodes, symmetry.n_sides)

    def angle_half_width(self, cell: int) -> float:
        """Return the half-width of the pre-filter over directions, radians: the node spacing, 0 for a single node."""
        count = int(self.direction_counts[cell])
        return OCTANT / (count - 1) if count > 1 else 0.0

    def nearest_pose(
        self, cell: npt.ArrayLike, angle: npt.ArrayLike, in_front: npt.ArrayLike = False
    ) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.bool_], npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
        """Find the stored pose nearest to a direction, and the lattice symmetry that brings it there.

        Parameters
        ----------
        cell : array_like of int
        angle : array_like of float
            Radians, ``atan2(dy, dx)`` with y down; any value. Broadcast against ``cell``.
        in_front : array_like of bool
            Whether the pixel lies in front of the focus.

        Returns
        -------
        index : ndarray of int64
            Into ``angles(cell)``.
        transpose, flip_row, flip_col : ndarray of bool
            Swap rows and columns first, then negate the row, then the column.

        Notes
        -----
        The PSF of constant motion is symmetric under half a turn, so four of the lattice's eight symmetries suffice,
        and `spreadlets.psf._grid_kernels.fold_direction` picks exactly one of them.
        """
        cells, angles, front = np.broadcast_arrays(
            np.asarray(cell, np.int64), np.asarray(angle, np.float64), np.asarray(in_front, np.bool_)
        )
        poses = self.pose_counts[cells].ravel()
        index, flags = fold_poses(angles.ravel(), front.ravel(), poses, self.model.symmetry.codes)
        transpose, flip_row, flip_col = (flags[:, i].reshape(angles.shape) for i in range(3))
        return index.reshape(angles.shape), transpose, flip_row, flip_col
