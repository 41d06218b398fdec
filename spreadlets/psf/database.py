"""The spreadlet database: opened and validated, read cell by cell; `spreadlets.psf.database_file` knows its schema."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from threading import Lock
from types import TracebackType
from typing import Any, Self

import h5py
import numpy as np
import numpy.typing as npt

from spreadlets.arrays import FloatArray
from spreadlets.errors import InvalidDatabaseError, InvalidParameterError, LeftOutError
from spreadlets.psf.database_file import (
    MAX_CELLS,
    MAX_OFFSET,
    MAX_POINTS,
    MAX_POINTS_OF_ONE,
    MAX_RANGE,
    MAX_SPREADLETS,
    MAX_VALUE,
    STATISTICS,
    CellRecord,
    absent_record,
    open_checked,
    read_rows,
    read_starts,
    read_table,
    read_text,
    refusing,
    require,
    text_attribute,
    write_database,
)
from spreadlets.psf.grid import NestedGrid
from spreadlets.psf.model import PsfGrid, get_model
from spreadlets.psf.spreadlet import Spreadlet

__all__ = [
    "STATISTICS",
    "CellRecord",
    "Database",
    "absent_record",
    "open_database",
    "shared_database",
    "write_database",
]

MAX_GAP_POINTS = 4096
"""Spreadlets with at most so many points between them are read together: less than a chunk's worth of decompression."""

MAX_POSES = 1 << 20
"""Most poses that a cell may have, far more than the sharpest line needs: a file says it by its ranges."""

ANGLE_TOLERANCE = 1e-9
"""rad by which a stored angle may differ from the grid's."""


class Database:
    """An open database; only the small index tables are read on opening, points cell by cell.

    Use `open_database`; close it, or use it as a context manager. A pickled one is opened anew from its path.

    Attributes
    ----------
    path : Path
        The file.
    grid : PsfGrid
        The PSF model with its cells.
    provenance : dict
        How the file was made.
    cell_start : ndarray of shape (n_cells + 1,), int64
        The spreadlets of cell i are ``cell_start[i]`` to ``cell_start[i + 1]``, one for each pose.
    angle : ndarray of shape (n_spreadlets,), float64
        Direction of motion of each spreadlet, radians in [0, pi/4].
    direct : ndarray of shape (n_spreadlets,), bool
        Whether the points are the PSF's own pixels rather than its Laplacian's.
    point_start : ndarray of shape (n_spreadlets + 1,), int64
        The points of each spreadlet in the file's point tables.
    seed_cell : ndarray of shape (n_cells,), int64
        The number of each cell that went into its seed: its own, unless the database was extended.

    Examples
    --------
    >>> with sp.open_database("simplelens") as database:
    ...     database.n_cells, database.n_channels, database.grid.model.name
    (400, 1, 'simplelens')
    """

    def __init__(self, file: h5py.File, path: Path) -> None:
        self._file = file
        self.path = path
        self.grid = _read_grid(file)
        self.provenance: dict[str, Any] = read_text(file, "provenance")
        # Read where the spreadlets of each cell begin, one for each pose.
        self.cell_start = read_starts(file, "cell_start", self.grid.n_cells, MAX_SPREADLETS, 1, MAX_POSES)
        if not np.array_equal(np.diff(self.cell_start), self.grid.pose_counts):
            raise InvalidDatabaseError(f"{path}: the angles stored for the cells are not those of the model's grid")
        # Read where the points of each spreadlet begin, and its angle.
        n_spreadlets = int(self.cell_start[-1])
        self.point_start = read_starts(file, "point_start", n_spreadlets, MAX_POINTS, 0, MAX_POINTS_OF_ONE)
        self.angle = read_table(file, "direction", (n_spreadlets,), np.float64)
        nodes = {count: self.grid.angles_of(count) for count in set(self.grid.pose_counts.tolist())}
        expected = np.concatenate([nodes[count] for count in self.grid.pose_counts.tolist()])
        if np.abs(self.angle - expected).max() > ANGLE_TOLERANCE:
            raise InvalidDatabaseError(f"{path}: the angles stored for the cells are not those of the model's grid")
        # Read which are stored as pixels.
        direct = read_table(file, "direct", (n_spreadlets,), np.uint8)
        if direct.max() > 1:
            raise InvalidDatabaseError(f"{path}: dataset 'direct' holds {direct.max()}; allowed are 0 and 1")
        self.direct = direct.astype(bool)
        # Check the points' tables; they are read when they are needed.
        n_points = int(self.point_start[-1])
        require(file, "offset_rc", (n_points, 2), np.int16)
        require(file, "value", (n_points, self.n_channels), np.float32)
        # Read the numbers from which the cells are seeded, if the database was extended.
        self.seed_cell = np.arange(self.grid.n_cells)
        if "seed_cell" in file:
            self.seed_cell = read_table(file, "seed_cell", (self.grid.n_cells,), np.int64)
            if self.seed_cell.min() < 0:
                raise InvalidDatabaseError(f"{path}: dataset 'seed_cell' holds a negative number")

    @property
    def n_cells(self) -> int:
        """Number of cells of the grid."""
        return self.grid.n_cells

    @property
    def n_channels(self) -> int:
        """Colour channels of a point's value: 1 (achromatic) or 3."""
        return self.grid.model.n_channels

    @property
    def n_spreadlets(self) -> int:
        """Number of stored spreadlets: cells times their poses."""
        return int(self.cell_start[-1])

    def coordinate(self, cell: int) -> npt.NDArray[np.float64]:
        """Physical coordinate at the middle of a cell, shape (n_axes,), in the units of the model's axes."""
        return self.grid.coordinate(self._checked(cell))

    def find(self, coordinate: npt.ArrayLike) -> npt.NDArray[np.int64]:
        """Return the index of the cell that holds each coordinate; input shape (..., n_axes), clamped to the range."""
        return self.grid.find(coordinate)

    def angles(self, cell: int) -> npt.NDArray[np.float64]:
        """Return the angle of each pose stored for a cell, radians, shape (n_poses,), float64."""
        cell = self._checked(cell)
        return self.angle[self.cell_start[cell] : self.cell_start[cell + 1]]

    def cell(self, cell: int, pose: int = 0) -> Spreadlet:
        """Read one spreadlet of a cell; ``pose`` counts the cell's `angles`."""
        cell = self._checked(cell)
        n_poses = int(self.cell_start[cell + 1] - self.cell_start[cell])
        if not 0 <= pose < n_poses:
            raise InvalidParameterError(f"pose {pose} of cell {cell}: allowed are 0 to {n_poses - 1}")
        return self.spreadlets([(cell, pose)])[0]

    def spreadlets(self, cells: Sequence[tuple[int, int]]) -> list[Spreadlet]:
        """Read the spreadlets of several (cell, pose) pairs, and validate their points.

        Spreadlets that lie close together in the file are read in one go.

        Raises
        ------
        InvalidDatabaseError
            If points cannot be read, or are not finite, or lie too far out.
        """
        # Refuse what was left out of the build.
        index = np.array([self.cell_start[cell] + pose for cell, pose in cells], np.int64)
        absent = np.flatnonzero(self.point_start[index] == self.point_start[index + 1])
        if len(absent):
            cell, pose = cells[int(absent[0])]
            raise LeftOutError(
                f"{self.path}: pose {pose} of cell {cell} and {len(absent) - 1} more that are needed were "
                "left out of this database, which was built for certain frames only",
                [cells[int(each)] for each in absent],
            )
        found: dict[int, Spreadlet] = {}
        for first, last in self._stretches(np.unique(index)):
            points = self._read_points(int(self.point_start[first]), int(self.point_start[last + 1]))
            for each in index[(index >= first) & (index <= last)]:
                begin, end = self.point_start[each : each + 2] - self.point_start[first]
                found[int(each)] = Spreadlet(points[0][begin:end], points[1][begin:end], bool(self.direct[each]))
        return [found[int(each)] for each in index]

    def _stretches(self, index: npt.NDArray[np.int64]) -> Iterator[tuple[int, int]]:
        """Yield (first, last) spreadlets of stretches of the file to be read in one go."""
        if not len(index):
            return
        gap = self.point_start[index[1:]] - self.point_start[index[:-1] + 1]
        breaks = np.flatnonzero(gap > MAX_GAP_POINTS)
        for begin, end in zip(np.append(0, breaks + 1), np.append(breaks, len(index) - 1), strict=True):
            yield int(index[begin]), int(index[end])

    def _read_points(self, begin: int, end: int) -> tuple[npt.NDArray[np.int16], npt.NDArray[np.float32]]:
        """Read a range of the point tables and validate it."""
        with refusing(self.path):
            offset_rc = read_rows(self._file, "offset_rc", begin, end)
            value = read_rows(self._file, "value", begin, end)
        bad = ~np.isfinite(value).all(axis=1)
        if bad.any():
            raise InvalidDatabaseError(f"{self.path}: point {begin + int(bad.argmax())} has a value that is not finite")
        if np.abs(value).max(initial=0.0) > MAX_VALUE:
            raise InvalidDatabaseError(f"{self.path}: points {begin} to {end} have a value above {MAX_VALUE:g}")
        if np.abs(offset_rc.astype(np.int32)).max(initial=0) > MAX_OFFSET:
            raise InvalidDatabaseError(f"{self.path}: points {begin} to {end} have an offset above {MAX_OFFSET} px")
        return offset_rc, value

    def statistics(self) -> dict[str, npt.NDArray[np.float32]]:
        """Read the recorded figures of every spreadlet: name to array of shape (n_spreadlets,).

        Raises
        ------
        InvalidDatabaseError
            If they cannot be read, or are not finite.
        """
        return {name: self._statistics[:, column] for column, name in enumerate(STATISTICS)}

    @cached_property
    def _statistics(self) -> FloatArray:
        with refusing(self.path):
            return read_table(self._file, "statistics", (self.n_spreadlets, len(STATISTICS)), np.float32)

    def summary(self) -> dict[str, Any]:
        """Return what ``spreadlets info`` prints: model, counts, size, quality figures and provenance.

        Means are over all spreadlets that are stored, direct ones included. What is drawn between the cells is under
        ``between_cells``, see `precompute.build.between_cells`. A database for frames that need no PSF has no figures.
        """
        present = np.diff(self.point_start) > 0
        statistics = {name: column[present] for name, column in self.statistics().items()}

        def figure(name: str, of: Callable[[FloatArray], Any]) -> float | None:
            return float(of(statistics[name])) if present.any() else None

        return {
            "model": self.grid.model.name,
            "n_cells": self.n_cells,
            "n_channels": self.n_channels,
            "n_spreadlets": int(present.sum()),
            "n_points": int(self.point_start[-1]),
            "size_bytes": self.path.stat().st_size,
            "mean_sparsity": figure("sparsity", np.mean),
            "mean_ssim": figure("ssim", np.mean),
            "min_ssim": figure("ssim", np.min),
            "mean_l1": figure("l1", np.mean),
            "max_energy_error": figure("energy_error", np.max),
            "between_cells": self.provenance.get("between_cells"),
            "build_s": self.provenance.get("build_s"),
            "seed": self.provenance.get("seed"),
            "parameters": self.provenance.get("parameters"),
            "axes": [vars(axis) for axis in self.grid.model.axes],
        }

    def __reduce__(self) -> tuple[Callable[[Path], Database], tuple[Path]]:
        """Let other processes open the same file."""
        return open_database, (self.path.absolute(),)

    def close(self) -> None:
        """Close the file; spreadlets already read stay valid."""
        self._file.close()

    def __enter__(self) -> Self:
        """Return the open database."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the file."""
        self.close()

    def _checked(self, cell: int) -> int:
        if not 0 <= cell < self.n_cells:
            raise InvalidParameterError(f"cell {cell}: the database has cells 0 to {self.n_cells - 1}")
        return int(cell)


def open_database(name_or_path: str | os.PathLike[str]) -> Database:
    """Open a database by path, or by the name of one that ships (``"combined"``, ``"simplelens"``).

    Raises
    ------
    InvalidDatabaseError
        If there is no such file, or it is truncated, malformed, or of another version.

    Examples
    --------
    >>> with sp.open_database("combined") as database:
    ...     cell = int(database.find([10.0, 20.0]))
    ...     psf = database.cell(cell).to_dense()
    >>> round(float(psf.sum()), 3)
    1.0
    """
    path = resolve(name_or_path)
    file = open_checked(path)
    try:
        with refusing(path):
            return Database(file, path)
    except InvalidDatabaseError:
        file.close()
        raise


def shared_database(name_or_path: str | os.PathLike[str]) -> Database | None:
    """Return a database that ships, which stays open with the points that were read of it; None for any other file.

    Opening it and reading what a frame needs of it takes as long as a tenth of the frame.
    """
    path = resolve(name_or_path)
    if path.resolve().parent != shipped_folder().resolve():
        return None
    status = path.stat()
    version = (status.st_ino, status.st_size, status.st_mtime_ns)
    with _SHARING:
        known = _SHARED.get(path)
        if known is None or known[0] != version:
            # Who still uses the one before keeps it open.
            _SHARED[path] = known = version, open_database(path)
        return known[1]


_SHARED: dict[Path, tuple[tuple[int, ...], Database]] = {}
_SHARING = Lock()


def shipped_folder() -> Path:
    """Return the folder of the databases that ship with the package."""
    return Path(__file__).resolve().parents[1] / "data" / "psf_db"


def resolve(name_or_path: str | os.PathLike[str]) -> Path:
    """Return the file of a database: a path, or the name of one that ships; InvalidDatabaseError if there is none."""
    path = Path(name_or_path)
    if path.is_file():
        return path
    shipped = sorted(shipped_folder().glob("*.h5"))
    for file in shipped:
        if file.stem == str(name_or_path):
            return file
    names = ", ".join(file.stem for file in shipped) or "none"
    raise InvalidDatabaseError(f"no database {str(name_or_path)!r}: give a file, or a shipped name ({names})")


def _read_grid(file: h5py.File) -> PsfGrid:
    """Read the model and its cells; ranges are checked before anything is made as large as they say."""
    # Read the model, and the sides and ends of its axes.
    shape = tuple(int(size) for size in np.atleast_1d(file.attrs["shape"]))
    model = get_model(text_attribute(file, "model"), settings=read_text(file, "settings"))
    ranges = np.stack([np.atleast_1d(file.attrs[name]) for name in ("maximum", "power", "floor")], axis=-1)
    # Check them before anything is made as large as they say.
    if not len(shape) == len(ranges) == model.n_axes or not all(0 < size <= MAX_CELLS for size in shape):
        raise InvalidDatabaseError(f"{file.filename}: grid shape {shape} does not fit model {model.name!r}")
    if not (np.abs(ranges) <= MAX_RANGE).all():
        raise InvalidDatabaseError(f"{file.filename}: the axes end at {ranges[:, 0].tolist()}, beyond {MAX_RANGE:g}")
    if NestedGrid(shape).n_cells > MAX_CELLS:
        raise InvalidDatabaseError(f"{file.filename}: more than {MAX_CELLS} cells")
    # Divide the axes into cells, and check the number of poses.
    axes = [
        replace(axis, maximum=float(maximum), power=float(power), floor=float(floor))
        for axis, (maximum, power, floor) in zip(model.axes, ranges, strict=True)
    ]
    grid = PsfGrid(replace(model, axes=tuple(axes)), shape, float(file.attrs["direction_step_px"]))
    if not 0 < grid.pose_counts.min() <= grid.pose_counts.max() <= MAX_POSES:
        raise InvalidDatabaseError(f"{file.filename}: its ranges ask for more than {MAX_POSES} poses of a cell")
    if grid.pose_counts.sum() > MAX_SPREADLETS:
        raise InvalidDatabaseError(f"{file.filename}: its ranges ask for more than {MAX_SPREADLETS} poses")
    return grid
