"""The HDF5 file of a database: its schema, writing it, and reading it without trusting it.

A file may come from anyone. Before anything is taken from it, it is held to the schema below: plain datasets of known
names, in this one file, behind no filter but those that HDF5 has built in, of no more bytes than their stored size can
unpack to. What a file says is data: nothing in it is executed, and no other file is opened for it.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
import numpy.typing as npt

from spreadlets.errors import InvalidDatabaseError, InvalidParameterError
from spreadlets.psf.model import PsfGrid
from spreadlets.psf.spreadlet import Spreadlet

FORMAT_NAME = "spreadlets"
SCHEMA_VERSION = 2
"""Of what is written and read: every dataset carries checksums, and so does HDF5's own bookkeeping."""
LIBRARY_VERSION = ("v110", "v110")
"""The oldest format of HDF5's bookkeeping that has checksums throughout."""
SIGNATURE = b"\x89HDF\r\n\x1a\n"
"""What an HDF5 file begins with; a byte with the version of its bookkeeping follows."""
FIRST_CHECKED = 2
"""Version from which it has checksums. HDF5 can be led in circles by a damaged file of an older one."""

STATISTICS = ("n_support", "sparsity", "ssim", "l1", "energy_error", "max_value_ratio", "total_variation")
"""Names of the figures that every stored spreadlet carries, in the file's column order."""

TABLES = ("cell_start", "point_start", "direction", "direct", "statistics", "offset_rc", "value")
OPTIONAL = ("settings", "provenance", "seed_cell")
"""What a model depends on beside its axes; how the file was made; and of an extended database the number that each cell
had in the build that first had it, which is a part of its seed."""

MAX_CELLS = 1_000_000
MAX_SPREADLETS = 20_000_000
MAX_POINTS = 1 << 28
MAX_POINTS_OF_ONE = 1 << 20
MAX_OFFSET = 4096
MAX_VALUE = 1000.0
MAX_TEXT_BYTES = 1 << 22
MAX_ATTRIBUTE_BYTES = 1 << 20
MAX_ATTRIBUTES = 32
MAX_CHUNK_BYTES = 1 << 19
MAX_RANGE = 1e6
"""Limits that a file is held to before memory is taken for what it claims to hold: cells, spreadlets, points of all and
of one spreadlet, an offset in px, the size of a value (those of a PSF's Laplacian are at most 4, and a fit's some times
that), bytes of a text, an attribute and an unpacked chunk, and the end of an axis in its unit."""

MAX_EXPANSION = 1032
"""No byte of a deflated stream stands for more bytes than this (zlib's manual): so much can stored bytes unpack to."""
FILTER_SLACK = 1024
"""Bytes by which a stored chunk may exceed its unpacked size: headers and checksums."""

GZIP, SHUFFLE, FLETCHER32 = 1, 2, 3
"""HDF5's identifiers of filters that it has built in; others would be plug-ins, libraries that it loads from a path."""

GZIP_LEVEL = 9
"""How hard zlib tries: a file is written once, and shipped and read often."""
CHUNK_POINTS = 16384
"""Points that are compressed together: small enough to read a few cells, large enough to compress well."""
WRITE_POINTS = 64 * CHUNK_POINTS
"""Points that are written at a time: bounds the memory of writing, whatever the size of the database."""


class CellRecord(NamedTuple):
    """One pose of one cell, as the build hands it over: where, what, and how good."""

    angle: float
    spreadlet: Spreadlet
    statistics: Mapping[str, float]


@lru_cache(maxsize=1 << 12)
def absent_record(angle: float, n_channels: int) -> CellRecord:
    """Return the record of a pose that is left out: it has no points, and reading it is an error."""
    empty = Spreadlet(np.zeros((0, 2), np.int16), np.zeros((0, n_channels), np.float32))
    return CellRecord(angle, empty, dict.fromkeys(STATISTICS, 0.0))


# --- Writing -------------------------------------------------------------------------------------------------------


def temporary_path(target: Path, mark: str) -> Path:
    """Return where a database is written before it gets its name; ``"*"`` as the mark gives a pattern of all."""
    return target.with_name(f".{target.name}.{mark}.tmp")


def write_database(
    path: str | os.PathLike[str],
    grid: PsfGrid,
    cells: Iterable[list[CellRecord]],
    provenance: Mapping[str, Any],
    seed_cell: npt.NDArray[np.int64] | None = None,
) -> None:
    """Write a database beside its final name, then rename it, so that no half-written file is ever seen.

    Parameters
    ----------
    path : path-like
        The final file name; an existing file is replaced.
    grid : PsfGrid
        The model and its cells.
    cells : iterable of list of CellRecord
        For each cell in index order its records, one for each of ``grid.angles(cell)``. They are taken one by one:
        no more than a few cells are in memory at once, beside the file itself.
    provenance : mapping
        JSON-serialisable facts on how the file was made (seed, versions, settings, build time).
    seed_cell : ndarray of shape (n_cells,), int64, optional
        The number of each cell that went into its seed, if it is not its own.

    Raises
    ------
    InvalidParameterError
        If the file cannot be written; whatever was there before is still there.
    """
    target = Path(path)
    temporary = temporary_path(target, str(os.getpid()))
    try:
        # HDF5 cannot close a file that has no room: it makes the file in memory, packed.
        with h5py.File(temporary, "w", libver=LIBRARY_VERSION, driver="core", backing_store=False) as file:
            _write_header(file, grid, provenance)
            _write_cells(file, grid.model.n_channels, cells)
            if seed_cell is not None:
                _write_table(file, "seed_cell", seed_cell)
            file.flush()
            content = file.id.get_file_image()
        with open(temporary, "wb") as written:
            written.write(content)
            written.flush()
            os.fsync(written.fileno())
        os.replace(temporary, target)
    except OSError as error:
        raise InvalidParameterError(f"cannot write the database {str(target)!r}: {error.strerror or error}") from error
    finally:
        temporary.unlink(missing_ok=True)


def _write_header(file: h5py.File, grid: PsfGrid, provenance: Mapping[str, Any]) -> None:
    file.attrs["format"] = np.bytes_(FORMAT_NAME)
    file.attrs["version"] = SCHEMA_VERSION
    file.attrs["model"] = np.bytes_(grid.model.name)
    file.attrs["shape"] = np.asarray(grid.shape, dtype=np.int64)
    for name in ("maximum", "power", "floor"):
        file.attrs[name] = np.asarray([getattr(axis, name) for axis in grid.model.axes], dtype=np.float64)
    file.attrs["direction_step_px"] = grid.direction_step_px
    _write_text(file, "provenance", provenance)
    if grid.model.settings:
        _write_text(file, "settings", grid.model.settings)


def _write_text(file: h5py.File, name: str, content: Mapping[str, Any]) -> None:
    _write_table(file, name, np.frombuffer(json.dumps(dict(content), sort_keys=True).encode(), np.uint8))


def _write_table(file: h5py.File, name: str, table: npt.NDArray[Any]) -> None:
    chunks = (min(CHUNK_POINTS, len(table)), *table.shape[1:])
    file.create_dataset(name, data=table, chunks=chunks, **_filters())


def _filters() -> dict[str, Any]:
    return {"compression": "gzip", "compression_opts": GZIP_LEVEL, "shuffle": True, "fletcher32": True}


def _write_cells(file: h5py.File, n_channels: int, cells: Iterable[list[CellRecord]]) -> None:
    """Append the cells' points batch by batch; the small tables follow once all are known."""
    # Make the tables of points, which grow.
    file.create_dataset("offset_rc", (0, 2), np.int16, maxshape=(None, 2), chunks=(CHUNK_POINTS, 2), **_filters())
    chunks = (CHUNK_POINTS, n_channels)
    file.create_dataset("value", (0, n_channels), np.float32, maxshape=(None, n_channels), chunks=chunks, **_filters())
    # Append them, and collect what the small tables say of them.
    sizes: list[int] = []
    counts: list[int] = []
    figures: list[tuple[float, ...]] = []
    for batch in _batches(cells):
        for cell in batch:
            sizes.append(len(cell))
            counts += [record.spreadlet.n_points for record in cell]
            for record in cell:
                statistics = (record.statistics[name] for name in STATISTICS)
                figures.append((record.angle, float(record.spreadlet.direct), *statistics))
        records = [record for cell in batch for record in cell]
        _append(file["offset_rc"], np.concatenate([record.spreadlet.offset_rc for record in records]))
        _append(file["value"], np.concatenate([record.spreadlet.value for record in records]))
    # Write the small tables.
    table = np.array(figures, dtype=np.float64)
    _write_table(file, "cell_start", _starts(sizes))
    _write_table(file, "point_start", _starts(counts))
    _write_table(file, "direction", table[:, 0])
    _write_table(file, "direct", table[:, 1].astype(np.uint8))
    _write_table(file, "statistics", table[:, 2:].astype(np.float32))


def _batches(cells: Iterable[list[CellRecord]]) -> Iterator[list[list[CellRecord]]]:
    """Yield cells in groups of about `WRITE_POINTS` points."""
    batch: list[list[CellRecord]] = []
    n_points = 0
    for cell in cells:
        batch.append(cell)
        n_points += sum(record.spreadlet.n_points for record in cell)
        if n_points >= WRITE_POINTS:
            yield batch
            batch, n_points = [], 0
    if batch:
        yield batch


def _append(dataset: h5py.Dataset, rows: npt.NDArray[Any]) -> None:
    begin = dataset.shape[0]
    dataset.resize(begin + len(rows), axis=0)
    dataset[begin:] = rows


def _starts(counts: list[int]) -> npt.NDArray[np.int64]:
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)


# --- Reading -------------------------------------------------------------------------------------------------------


@contextmanager
def refusing(path: str | os.PathLike[str]) -> Iterator[None]:
    """Turn whatever a malformed file makes HDF5 or NumPy raise into one InvalidDatabaseError."""
    try:
        yield
    except InvalidDatabaseError:
        raise
    except (KeyError, TypeError, OSError, RuntimeError, ValueError, OverflowError, MemoryError, IndexError) as error:
        raise InvalidDatabaseError(f"{path}: malformed database: {error}") from error


def open_checked(path: Path) -> h5py.File:
    """Open a file for reading after checking all that it is made of; no table is read yet.

    Raises
    ------
    InvalidDatabaseError
        If it is no HDF5 file, or holds what a database does not.
    """
    # Check the bytes before HDF5 interprets them.
    try:
        _check_bookkeeping(path)
        file = h5py.File(path, "r")
    except InvalidDatabaseError:
        raise
    except (OSError, RuntimeError, ValueError) as error:
        raise InvalidDatabaseError(f"{path}: not a readable HDF5 file (truncated or another format)") from error
    try:
        # Check version, attributes, links and datasets.
        with refusing(path):
            _check_attributes(file)
            _check_version(file)
            for name in file:
                _check_link(file, name)
                _check_dataset(file, name)
        return file
    except InvalidDatabaseError:
        file.close()
        raise


def _check_bookkeeping(path: Path) -> None:
    """Refuse what is no HDF5, or HDF5 without checksums of its own, before HDF5 sees it."""
    with open(path, "rb") as file:
        start = file.read(len(SIGNATURE) + 1)
    if len(start) <= len(SIGNATURE) or not start.startswith(SIGNATURE):
        raise ValueError("no HDF5 signature")
    if start[-1] < FIRST_CHECKED:
        raise InvalidDatabaseError(
            f"{path}: HDF5 of an old format, without checksums of where things are; build it anew"
        )


def _check_attributes(file: h5py.File) -> None:
    """Refuse attributes that are large or not plain, before any is read."""
    if h5py.h5a.get_num_attrs(file.id) > MAX_ATTRIBUTES:
        raise InvalidDatabaseError(f"{file.filename}: more than {MAX_ATTRIBUTES} attributes")
    for name in file.attrs:
        attribute = file.attrs.get_id(name)
        if attribute.dtype.kind not in "OSUiuf" or attribute.get_storage_size() > MAX_ATTRIBUTE_BYTES:
            raise InvalidDatabaseError(
                f"{file.filename}: the attribute {name!r} is not a number or text of up to {MAX_ATTRIBUTE_BYTES} bytes"
            )
        if attribute.dtype.kind == "O" and (h5py.check_string_dtype(attribute.dtype) is None or attribute.shape != ()):
            raise InvalidDatabaseError(f"{file.filename}: the attribute {name!r} refers to something else")


def _check_version(file: h5py.File) -> None:
    if text_attribute(file, "format") != FORMAT_NAME:
        raise InvalidDatabaseError(f"{file.filename}: not a spreadlet database (no format mark)")
    version = int(file.attrs.get("version", -1))
    if version != SCHEMA_VERSION:
        raise InvalidDatabaseError(
            f"{file.filename}: database version {version}, this program reads version {SCHEMA_VERSION}; rebuild it"
        )


def text_attribute(file: h5py.File, name: str) -> str:
    """Return an attribute that is text; an empty one if there is none."""
    value = file.attrs.get(name, "")
    return value.decode() if isinstance(value, bytes) else str(value)


def _check_link(file: h5py.File, name: str) -> None:
    link = file.get(name, getlink=True)
    if not isinstance(link, h5py.HardLink):
        raise InvalidDatabaseError(f"{file.filename}: {name!r} is a link to another place or file; that is refused")
    if name not in (*TABLES, *OPTIONAL):
        raise InvalidDatabaseError(f"{file.filename}: holds {name!r}, which no database has")
    if file.get(name, getclass=True) is not h5py.Dataset:
        raise InvalidDatabaseError(f"{file.filename}: {name!r} is not a dataset")


def _check_dataset(file: h5py.File, name: str) -> None:
    """Refuse a dataset whose values lie elsewhere, need a plug-in, or are more than its bytes can hold."""
    dataset = file[name]
    place = f"{file.filename}: dataset {name!r}"
    plist = dataset.id.get_create_plist()
    if dataset.is_virtual or plist.get_external_count():
        raise InvalidDatabaseError(f"{place} keeps its values in another file; that is refused")
    if dataset.dtype.kind not in "iuf" or dataset.dtype.itemsize > 8:
        raise InvalidDatabaseError(f"{place} holds {dataset.dtype}; a database holds numbers only")
    filters = [plist.get_filter(index)[0] for index in range(plist.get_nfilters())]
    if not set(filters) <= {GZIP, SHUFFLE, FLETCHER32} or len(set(filters)) < len(filters):
        raise InvalidDatabaseError(f"{place} needs the filters {filters}; allowed are gzip, shuffle and fletcher32")
    if FLETCHER32 not in filters:
        raise InvalidDatabaseError(f"{place} has no checksums")
    nominal, stored = dataset.size * dataset.dtype.itemsize, dataset.id.get_storage_size()
    if dataset.chunks and int(np.prod(dataset.chunks, dtype=object)) * dataset.dtype.itemsize > MAX_CHUNK_BYTES:
        raise InvalidDatabaseError(f"{place} has chunks of more than {MAX_CHUNK_BYTES} bytes")
    if nominal > stored * (MAX_EXPANSION if GZIP in filters else 1):
        raise InvalidDatabaseError(f"{place} claims {nominal} bytes, but stores only {stored}")


def require(file: h5py.File, name: str, shape: tuple[int, ...], dtype: npt.DTypeLike) -> h5py.Dataset:
    """Return a dataset of the shape and the type that it must have."""
    dataset = file.get(name)
    if not isinstance(dataset, h5py.Dataset):
        raise InvalidDatabaseError(f"{file.filename}: dataset {name!r} is missing")
    if dataset.shape != shape or dataset.dtype != np.dtype(dtype):
        raise InvalidDatabaseError(
            f"{file.filename}: dataset {name!r} is {dataset.shape} {dataset.dtype}, expected {shape} {np.dtype(dtype)}"
        )
    return dataset


def read_rows(file: h5py.File, name: str, begin: int, end: int) -> npt.NDArray[Any]:
    """Read rows of a dataset, none of whose chunks may unpack to more than it should."""
    dataset = file[name]
    if dataset.chunks:
        limit = int(np.prod(dataset.chunks)) * dataset.dtype.itemsize + FILTER_SLACK
        for row in range(begin - begin % dataset.chunks[0], end, dataset.chunks[0]):
            for place in _chunks_of_row(dataset, row):
                if dataset.id.get_chunk_info_by_coord(place).size > limit:
                    raise InvalidDatabaseError(f"{file.filename}: a chunk of {name!r} is larger than it can be")
    try:
        return np.asarray(dataset[begin:end])
    except OSError as error:
        raise InvalidDatabaseError(
            f"{file.filename}: rows {begin} to {end} of {name!r} cannot be read: damaged ({error})"
        ) from error


def _chunks_of_row(dataset: h5py.Dataset, row: int) -> list[tuple[int, ...]]:
    """Return the places of the chunks that hold a row."""
    if dataset.ndim == 1:
        return [(row,)]
    return [(row, column) for column in range(0, dataset.shape[1], dataset.chunks[1])]


def read_table(file: h5py.File, name: str, shape: tuple[int, ...], dtype: npt.DTypeLike) -> npt.NDArray[Any]:
    """Read a whole dataset; numbers must be finite."""
    require(file, name, shape, dtype)
    table = read_rows(file, name, 0, shape[0])
    if table.dtype.kind == "f" and not np.isfinite(table).all():
        raise InvalidDatabaseError(f"{file.filename}: dataset {name!r} holds a value that is not finite")
    return table


def read_starts(file: h5py.File, name: str, count: int, limit: int, least: int, most: int) -> npt.NDArray[np.int64]:
    """Read where each of ``count`` entries starts, each at least ``least`` and at most ``most`` long."""
    if count > MAX_SPREADLETS:
        raise InvalidDatabaseError(f"{file.filename}: {count} entries in {name!r} exceed the limit {MAX_SPREADLETS}")
    starts = read_table(file, name, (count + 1,), np.int64)
    if starts[0] != 0 or not ((starts >= 0) & (starts <= limit)).all():
        raise InvalidDatabaseError(f"{file.filename}: {name!r} is not a list of rising starts from 0 up to {limit}")
    lengths = np.diff(starts)
    if (lengths < least).any() or (lengths > most).any():
        raise InvalidDatabaseError(
            f"{file.filename}: {name!r} is not a list of rising starts whose steps are {least} to {most}"
        )
    return starts


def read_text(file: h5py.File, name: str) -> dict[str, Any]:
    """Read a JSON object that is stored as bytes; an empty one if there is none."""
    if name not in file:
        return {}
    stored = file[name]
    if stored.dtype != np.uint8 or stored.ndim != 1 or stored.size > MAX_TEXT_BYTES:
        raise InvalidDatabaseError(f"{file.filename}: {name!r} is not a text of up to {MAX_TEXT_BYTES} bytes")
    content = json.loads(read_rows(file, name, 0, stored.size).tobytes())
    if not isinstance(content, dict):
        raise InvalidDatabaseError(f"{file.filename}: {name!r} is not a JSON object")
    return content
