"""The spreadlet database: one HDF5 file, written atomically, validated on opening, read cell by cell."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, Self

import h5py
import numpy as np
import numpy.typing as npt

from spreadlets.errors import InvalidDatabaseError, InvalidParameterError
from spreadlets.psf_model import PsfGrid, get_model
from spreadlets.spreadlet import Spreadlet

FORMAT_NAME = "spreadlets"
SCHEMA_VERSION = 1
STATISTICS = ("n_support", "sparsity", "ssim", "l1", "energy_error", "max_value_ratio", "total_variation")
"""Names of the figures that every stored spreadlet carries, in the file's column order."""

MAX_CELLS = 1_000_000
MAX_SPREADLETS = 20_000_000
MAX_POINTS = 2_000_000_000
MAX_OFFSET = 16_384
MAX_SETTINGS_BYTES = 1 << 22
"""Limits that a file is held to before memory is taken for what it claims to hold; an offset is in pixels."""

MAX_GAP_POINTS = 4096
"""Spreadlets with at most so many points between them are read together: less than a chunk's worth of decompression."""
CHUNK_POINTS = 8192
"""Points that are compressed together: small enough to read a few cells, large enough to compress well."""


class CellRecord(NamedTuple):
    """One direction of one cell, as the build hands it over: where, what, and how good."""

    direction: float
    spreadlet: Spreadlet
    statistics: Mapping[str, float]


def absent_record(grid: PsfGrid, cell: int, direction: int) -> CellRecord:
    """Return the record of a direction that is left out: it has no points, and reading it is an error."""
    empty = Spreadlet(np.zeros((0, 2), np.int16), np.zeros((0, grid.model.n_channels), np.float32))
    return CellRecord(float(grid.directions(cell)[direction]), empty, dict.fromkeys(STATISTICS, 0.0))


def write_database(
    path: str | os.PathLike[str],
    grid: PsfGrid,
    cells: Iterable[list[CellRecord]],
    provenance: Mapping[str, Any],
) -> None:
    """Write a database beside its final name, then rename it, so that no half-written file is ever seen.

    Parameters
    ----------
    path : path-like
        The final file name; an existing file is replaced.
    grid : PsfGrid
        The model and its cells.
    cells : iterable of list of CellRecord
        For each cell in index order its records, one for each of ``grid.directions(cell)``.
    provenance : mapping
        JSON-serialisable facts on how the file was made (seed, versions, settings, build time).
    """
    target = Path(path)
    temporary = target.with_name(f".{target.name}.{os.getpid()}.tmp")
    try:
        with h5py.File(temporary, "w") as file:
            _write_header(file, grid, provenance)
            _write_cells(file, list(cells))
        os.replace(temporary, target)
    except OSError as error:
        raise InvalidParameterError(f"cannot write the database {str(target)!r}: {error}") from error
    finally:
        temporary.unlink(missing_ok=True)


def _write_header(file: h5py.File, grid: PsfGrid, provenance: Mapping[str, Any]) -> None:
    file.attrs["format"] = FORMAT_NAME
    file.attrs["version"] = SCHEMA_VERSION
    file.attrs["model"] = grid.model.name
    file.attrs["shape"] = np.asarray(grid.shape, dtype=np.int64)
    file.attrs["maximum"] = np.asarray([axis.maximum for axis in grid.model.axes], dtype=np.float64)
    file.attrs["power"] = np.asarray([axis.power for axis in grid.model.axes], dtype=np.float64)
    file.attrs["floor"] = np.asarray([axis.floor for axis in grid.model.axes], dtype=np.float64)
    file.attrs["direction_step_px"] = grid.direction_step_px
    file.attrs["provenance"] = json.dumps(dict(provenance), sort_keys=True)
    if grid.model.settings:
        text = json.dumps(dict(grid.model.settings), sort_keys=True).encode()
        file.create_dataset("settings", data=np.frombuffer(text, np.uint8), compression="gzip", compression_opts=9)


def _write_cells(file: h5py.File, cells: list[list[CellRecord]]) -> None:
    records = [record for cell in cells for record in cell]
    counts = [record.spreadlet.n_points for record in records]
    compressed: dict[str, Any] = {"compression": "gzip", "compression_opts": 9, "shuffle": True, "fletcher32": True}
    file["cell_start"] = _starts([len(cell) for cell in cells])
    file["point_start"] = _starts(counts)
    file["direction"] = np.asarray([record.direction for record in records], dtype=np.float64)
    file["direct"] = np.asarray([record.spreadlet.direct for record in records], dtype=np.uint8)
    table = np.asarray([[record.statistics[name] for name in STATISTICS] for record in records], dtype=np.float32)
    file.create_dataset("statistics", data=table, **compressed)
    offsets = np.concatenate([record.spreadlet.offset_rc for record in records])
    values = np.concatenate([record.spreadlet.value for record in records])
    rows = min(CHUNK_POINTS, len(offsets))
    file.create_dataset("offset_rc", data=offsets.astype(np.int16), chunks=(rows, 2), **compressed)
    file.create_dataset("value", data=values.astype(np.float32), chunks=(rows, values.shape[1]), **compressed)


def _starts(counts: list[int]) -> npt.NDArray[np.int64]:
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)


class Database:
    """An open database; only the small index tables are read on opening, points cell by cell.

    Use `open_database`; close it, or use it as a context manager.

    Attributes
    ----------
    path : Path
        The file.
    grid : PsfGrid
        The PSF model with its cells.
    provenance : dict
        How the file was made.
    cell_start : ndarray of shape (n_cells + 1,), int64
        The spreadlets of cell i are ``cell_start[i]`` to ``cell_start[i + 1]``, one for each direction.
    direction : ndarray of shape (n_spreadlets,), float64
        Direction of motion of each spreadlet, radians in [0, pi/4].
    direct : ndarray of shape (n_spreadlets,), bool
        Whether the points are the PSF's own pixels rather than its Laplacian's.
    point_start : ndarray of shape (n_spreadlets + 1,), int64
        The points of each spreadlet in the file's point tables.
    """

    def __init__(self, file: h5py.File, path: Path) -> None:
        self._file = file
        self.path = path
        self.grid = _read_grid(file)
        self.provenance: dict[str, Any] = _read_provenance(file)
        self.cell_start = _read_starts(file, "cell_start", self.grid.n_cells, MAX_SPREADLETS, 1)
        if not np.array_equal(np.diff(self.cell_start), self.grid.pose_counts):
            raise InvalidDatabaseError(f"{path}: the directions stored for the cells are not those of the model's grid")
        n_spreadlets = int(self.cell_start[-1])
        self.point_start = _read_starts(file, "point_start", n_spreadlets, MAX_POINTS, 0)
        self.direction = _read_table(file, "direction", (n_spreadlets,), np.float64)
        self.direct = _read_table(file, "direct", (n_spreadlets,), np.uint8).astype(bool)
        n_points = int(self.point_start[-1])
        _require(file, "offset_rc", (n_points, 2), np.int16)
        _require(file, "value", (n_points, self.n_channels), np.float32)

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
        """Number of stored spreadlets: cells times their directions."""
        return int(self.cell_start[-1])

    def coordinate(self, cell: int) -> npt.NDArray[np.float64]:
        """Physical coordinate at the middle of a cell, shape (n_axes,), in the units of the model's axes."""
        return self.grid.coordinate(self._checked(cell))

    def find(self, coordinate: npt.ArrayLike) -> npt.NDArray[np.int64]:
        """Return the index of the cell that holds each coordinate; input shape (..., n_axes), clamped to the range."""
        return self.grid.find(coordinate)

    def directions(self, cell: int) -> npt.NDArray[np.float64]:
        """Directions stored for a cell, radians in [0, pi/4]."""
        cell = self._checked(cell)
        return self.direction[self.cell_start[cell] : self.cell_start[cell + 1]]

    def cell(self, cell: int, direction: int = 0) -> Spreadlet:
        """Read one spreadlet of a cell; ``direction`` counts the cell's `directions`."""
        cell = self._checked(cell)
        n_directions = int(self.cell_start[cell + 1] - self.cell_start[cell])
        if not 0 <= direction < n_directions:
            raise InvalidParameterError(f"direction {direction} of cell {cell}: allowed are 0 to {n_directions - 1}")
        return self.spreadlets([(cell, direction)])[0]

    def spreadlets(self, cells: Sequence[tuple[int, int]]) -> list[Spreadlet]:
        """Read the spreadlets of several (cell, direction) pairs, and validate their points.

        Spreadlets that lie close together in the file are read in one go.

        Raises
        ------
        InvalidDatabaseError
            If points cannot be read, or are not finite, or lie too far out.
        """
        index = np.array([self.cell_start[cell] + direction for cell, direction in cells], np.int64)
        absent = np.flatnonzero(self.point_start[index] == self.point_start[index + 1])
        if len(absent):
            cell, direction = cells[int(absent[0])]
            raise InvalidDatabaseError(
                f"{self.path}: direction {direction} of cell {cell} and {len(absent) - 1} more that are needed were "
                "left out of this database, which was built for certain frames only"
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
        try:
            offset_rc = self._file["offset_rc"][begin:end]
            value = self._file["value"][begin:end]
        except OSError as error:
            raise InvalidDatabaseError(f"{self.path}: points {begin} to {end} cannot be read: {error}") from error
        bad = ~np.isfinite(value).all(axis=1)
        if bad.any():
            raise InvalidDatabaseError(f"{self.path}: point {begin + int(bad.argmax())} has a value that is not finite")
        if np.abs(offset_rc.astype(np.int32)).max(initial=0) > MAX_OFFSET:
            raise InvalidDatabaseError(f"{self.path}: points {begin} to {end} have an offset above {MAX_OFFSET} px")
        return offset_rc, value

    def statistics(self) -> dict[str, npt.NDArray[np.float32]]:
        """Read the recorded figures of every spreadlet: name to array of shape (n_spreadlets,)."""
        table = _read_table(self._file, "statistics", (self.n_spreadlets, len(STATISTICS)), np.float32)
        return {name: table[:, column] for column, name in enumerate(STATISTICS)}

    def summary(self) -> dict[str, Any]:
        """Return what ``spreadlets info`` prints: model, counts, size, quality figures and provenance.

        Means are over all spreadlets that are stored, direct ones included.
        """
        present = np.diff(self.point_start) > 0
        statistics = {name: column[present] for name, column in self.statistics().items()}
        return {
            "model": self.grid.model.name,
            "n_cells": self.n_cells,
            "n_channels": self.n_channels,
            "n_spreadlets": int(present.sum()),
            "n_points": int(self.point_start[-1]),
            "size_bytes": self.path.stat().st_size,
            "mean_sparsity": float(statistics["sparsity"].mean()),
            "mean_ssim": float(statistics["ssim"].mean()),
            "min_ssim": float(statistics["ssim"].min()),
            "mean_l1": float(statistics["l1"].mean()),
            "max_energy_error": float(statistics["energy_error"].max()),
            "build_s": self.provenance.get("build_s"),
            "seed": self.provenance.get("seed"),
            "parameters": self.provenance.get("parameters"),
            "axes": [vars(axis) for axis in self.grid.model.axes],
        }

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
    """
    path = _resolve(name_or_path)
    try:
        file = h5py.File(path, "r")
    except OSError as error:
        raise InvalidDatabaseError(f"{path}: not a readable HDF5 file (truncated or another format)") from error
    try:
        return Database(file, path)
    except (KeyError, TypeError, OSError, RuntimeError, ValueError) as error:
        file.close()
        if isinstance(error, InvalidDatabaseError):
            raise
        raise InvalidDatabaseError(f"{path}: malformed database: {error}") from error


def shipped_folders() -> list[Path]:
    """Folders that hold the shipped databases: inside an installed wheel, or in a source checkout."""
    package = Path(__file__).resolve().parent
    return [package / "data" / "psf_db", package.parent / "psf_db"]


def _resolve(name_or_path: str | os.PathLike[str]) -> Path:
    path = Path(name_or_path)
    if path.is_file():
        return path
    shipped = sorted(file for folder in shipped_folders() if folder.is_dir() for file in folder.glob("*.h5"))
    for file in shipped:
        if file.stem == str(name_or_path):
            return file
    names = ", ".join(sorted({file.stem for file in shipped})) or "none"
    raise InvalidDatabaseError(f"no database {str(name_or_path)!r}: give a file, or a shipped name ({names})")


def _read_grid(file: h5py.File) -> PsfGrid:
    if file.attrs.get("format") != FORMAT_NAME:
        raise InvalidDatabaseError(f"{file.filename}: not a spreadlet database (no format mark)")
    version = int(file.attrs.get("version", -1))
    if version != SCHEMA_VERSION:
        raise InvalidDatabaseError(
            f"{file.filename}: database version {version}, this program reads version {SCHEMA_VERSION}; rebuild it"
        )
    shape = tuple(int(size) for size in np.asarray(file.attrs["shape"]))
    model = get_model(str(file.attrs["model"]), settings=_read_settings(file))
    ranges = np.stack([file.attrs[name] for name in ("maximum", "power", "floor")], axis=-1)
    if not len(shape) == len(ranges) == model.n_axes or not all(0 < size <= MAX_CELLS for size in shape):
        raise InvalidDatabaseError(f"{file.filename}: grid shape {shape} does not fit model {model.name!r}")
    axes = [
        replace(axis, maximum=float(maximum), power=float(power), floor=float(floor))
        for axis, (maximum, power, floor) in zip(model.axes, ranges, strict=True)
    ]
    return PsfGrid(replace(model, axes=tuple(axes)), shape, float(file.attrs["direction_step_px"]))


def _read_settings(file: h5py.File) -> dict[str, Any]:
    """Read what the model depends on beside its axes; the models of the first databases have none."""
    if "settings" not in file:
        return {}
    stored = file["settings"]
    if not isinstance(stored, h5py.Dataset) or stored.dtype != np.uint8 or stored.size > MAX_SETTINGS_BYTES:
        raise InvalidDatabaseError(f"{file.filename}: the model's settings are not up to {MAX_SETTINGS_BYTES} bytes")
    settings = json.loads(stored[...].tobytes())
    if not isinstance(settings, dict):
        raise InvalidDatabaseError(f"{file.filename}: the model's settings are not a JSON object")
    return settings


def _read_provenance(file: h5py.File) -> dict[str, Any]:
    provenance = json.loads(str(file.attrs["provenance"]))
    if not isinstance(provenance, dict):
        raise InvalidDatabaseError(f"{file.filename}: provenance is not a JSON object")
    return provenance


def _require(file: h5py.File, name: str, shape: tuple[int, ...], dtype: npt.DTypeLike) -> h5py.Dataset:
    dataset = file.get(name)
    if not isinstance(dataset, h5py.Dataset):
        raise InvalidDatabaseError(f"{file.filename}: dataset {name!r} is missing")
    if dataset.shape != shape or dataset.dtype != np.dtype(dtype):
        raise InvalidDatabaseError(
            f"{file.filename}: dataset {name!r} is {dataset.shape} {dataset.dtype}, expected {shape} {np.dtype(dtype)}"
        )
    return dataset


def _read_table(file: h5py.File, name: str, shape: tuple[int, ...], dtype: npt.DTypeLike) -> npt.NDArray[Any]:
    table: npt.NDArray[Any] = _require(file, name, shape, dtype)[...]
    if table.dtype.kind == "f" and not np.isfinite(table).all():
        raise InvalidDatabaseError(f"{file.filename}: dataset {name!r} holds a value that is not finite")
    return table


def _read_starts(file: h5py.File, name: str, count: int, limit: int, least: int) -> npt.NDArray[np.int64]:
    if count > limit:
        raise InvalidDatabaseError(f"{file.filename}: {count} entries in {name!r} exceed the limit of {limit}")
    starts = _read_table(file, name, (count + 1,), np.int64)
    if starts[0] != 0 or (np.diff(starts) < least).any() or starts[-1] > limit:
        raise InvalidDatabaseError(f"{file.filename}: {name!r} is not a list of rising starts from 0 up to {limit}")
    return starts
