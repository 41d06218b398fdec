"""Extending a database: a wider range, a higher density, more of a database for certain frames.

The nested grid's cells depend on the size of its unit, not on where the space ends. So a range is widened by whole
units: all cells stay where they are, except those that the old border cut, which grow to their full size and are built
anew; so are those beyond.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import IntArray
from spreadlets.errors import InvalidParameterError, option
from spreadlets.precompute.models.grids import ALGORITHM_VERSION, check_ranges
from spreadlets.psf.database import Database, open_database
from spreadlets.psf.database_file import CellRecord
from spreadlets.psf.model import Axis, PsfGrid

RANGES = {"coc": "max_coc", "depth": "max_coc", "motion": "max_motion", "distance": "max_distance"}
"""The option that widens an axis, by the axis's name."""

UNIT_TOLERANCE = 1e-9
"""Share of a unit that rounding may add to a range."""

ANGLE_TOLERANCE = 1e-9
"""rad by which an angle may differ from one that is kept: rounding."""


def extended_grid(path: str | os.PathLike[str], model: str, options: Mapping[str, Any]) -> PsfGrid:
    """Return the grid of a database with wider ranges, in the same units.

    Parameters
    ----------
    path : path-like
        The database.
    model : str
        Its model.
    options : mapping
        New ends of its axes, by the names in `RANGES`; one that lies within the old range changes nothing. An end is
        moved up to the next whole unit.

    Raises
    ------
    InvalidParameterError
        If the model is another, or an option is none of the ranges of its axes.
    InvalidDatabaseError
        If the database cannot be read.
    """
    # Read the old grid.
    if not Path(path).is_file():
        raise InvalidParameterError(f"{str(path)!r} cannot be extended: there is no such file; build it first")
    with open_database(path) as database:
        grid = database.grid
    # Check that only ranges of its own axes change.
    if grid.model.name != model:
        raise InvalidParameterError(f"{str(path)!r} is a database of {grid.model.name!r}, not of {model!r}")
    known = {RANGES[axis.name] for axis in grid.model.axes if axis.name in RANGES}
    for name in options:
        if name not in known:
            raise InvalidParameterError(
                f"{option(name)} cannot be extended: cells and settings stay what they are; of {model!r} these can be "
                f"widened: {', '.join(map(option, sorted(known)))}"
            )
    check_ranges(options)
    # Lengthen the axes by whole units, so that the old cells stay what they are.
    pairs = [
        _extended_axis(axis, side, options.get(RANGES.get(axis.name, "")))
        for axis, side in zip(grid.model.axes, grid.shape, strict=True)
    ]
    axes, shape = tuple(axis for axis, _ in pairs), tuple(side for _, side in pairs)
    return PsfGrid(replace(grid.model, axes=axes), shape, grid.direction_step_px)


def _extended_axis(axis: Axis, side: int, wanted: float | None) -> tuple[Axis, int]:
    """Return an axis that reaches as far as wanted, at least, and its side in units."""
    if wanted is None or wanted <= axis.maximum:
        return axis, side
    power = 1.0 / axis.power
    first = axis.floor**power
    unit = (axis.maximum**power - first) / side
    wider = math.ceil((wanted**power - first) / unit - UNIT_TOLERANCE)
    return replace(axis, maximum=float((first + wider * unit) ** axis.power)), wider


@dataclass(frozen=True)
class Kept:
    """What an extended database has from the one before; empty if there was none.

    Parameters
    ----------
    database : Database, optional
        The one before.
    sources : mapping of int to int
        The cell of the old database that each cell of the new one was.
    direct_only : bool
        Whether only PSFs that are stored as pixels are kept: those are the same at any density.
    """

    database: Database | None = None
    sources: Mapping[int, int] = field(default_factory=dict)
    direct_only: bool = False

    @classmethod
    @contextmanager
    def of(cls, path: str | os.PathLike[str], grid: PsfGrid, density: float | None) -> Iterator[Kept]:
        """Give what a grid of the same units takes over from a database, which stays open for the block."""
        with open_database(path) as database:
            stored = database.provenance["parameters"]["density"]
            yield cls(database, _same_cells(database, grid), density not in (None, stored))

    def seed_cells(self, grid: PsfGrid) -> IntArray:
        """Return the number of each cell of a grid that goes into its seed: that of the old database, if it had it."""
        numbers = np.arange(grid.n_cells)
        if self.database is not None:
            for cell, source in self.sources.items():
                numbers[cell] = self.database.seed_cell[source]
        return numbers

    @property
    def build_s(self) -> float:
        """Seconds that building took so far."""
        return 0.0 if self.database is None else float(self.database.provenance.get("build_s", 0.0))

    def __contains__(self, place: tuple[int, int]) -> bool:
        """Return whether a pose of a cell of the new grid is kept."""
        cell, number = place
        if self.database is None or cell not in self.sources:
            return False
        index = int(self.database.cell_start[self.sources[cell]]) + number
        stored = self.database.point_start[index] < self.database.point_start[index + 1]
        return bool(stored and (self.database.direct[index] or not self.direct_only))

    def places(self) -> set[tuple[int, int]]:
        """Return all (cell, pose) of the new grid that the old database holds, to be kept or built anew."""
        if self.database is None:
            return set()
        n_stored = np.diff(self.database.point_start)
        start = self.database.cell_start
        return {
            (cell, number)
            for cell, source in self.sources.items()
            for number in range(int(start[source + 1] - start[source]))
            if n_stored[start[source] + number]
        }

    def records(self, cell: int) -> dict[int, CellRecord]:
        """Return what is kept of a cell, by the number of the pose."""
        if self.database is None or cell not in self.sources:
            return {}
        source = self.sources[cell]
        angles = self.database.angles(source)
        numbers = [number for number in range(len(angles)) if (cell, number) in self]
        spreadlets = self.database.spreadlets([(source, number) for number in numbers])
        rows = [int(self.database.cell_start[source]) + number for number in numbers]
        statistics = self.database.statistics()
        return {
            number: CellRecord(
                float(angles[number]), spreadlet, {name: float(column[row]) for name, column in statistics.items()}
            )
            for number, spreadlet, row in zip(numbers, spreadlets, rows, strict=True)
        }


def _same_cells(database: Database, grid: PsfGrid) -> dict[int, int]:
    """Return the old cell of each new one that has the same place and the same angles."""
    old = {box.tobytes(): cell for cell, box in enumerate(database.grid.nested.boxes())}
    same: dict[int, int] = {}
    for cell, box in enumerate(grid.nested.boxes()):
        source = old.get(box.tobytes())
        if source is not None and _same_angles(database.angles(source), grid.angles(cell)):
            same[cell] = source
    return same


def _same_angles(old: npt.NDArray[np.float64], new: npt.NDArray[np.float64]) -> bool:
    return len(old) == len(new) and bool(np.abs(old - new).max() <= ANGLE_TOLERANCE)


def check_extension(
    kept: Kept, density: float | None, sparsifier: str | None, rays: int | None, seed: int
) -> tuple[float, str, int | None, int]:
    """Return density, sparsifier, rays and seed of an extended database: what is not given is that of the old one.

    Raises
    ------
    InvalidParameterError
        If the old one was built otherwise: by another version of the algorithm, with another sparsifier, other rays or
        another seed, or with more points.
    """
    assert kept.database is not None  # only called for one that is extended
    provenance, path = kept.database.provenance, kept.database.path
    stored = provenance["parameters"]
    if provenance.get("algorithm_version") != ALGORITHM_VERSION:
        raise InvalidParameterError(
            f"{path} was built by version {provenance.get('algorithm_version')} of the algorithm, this is version "
            f"{ALGORITHM_VERSION}: build it anew"
        )
    # Refuse what would make new cells differ in kind from the old ones; only the density may grow.
    if sparsifier not in (None, stored["sparsifier"]):
        raise InvalidParameterError(
            f"{path} was built with the sparsifier {stored['sparsifier']!r}: an extension keeps it, it cannot be "
            f"{sparsifier!r}"
        )
    if rays not in (None, stored["rays"]) or seed not in (0, provenance["seed"]):
        raise InvalidParameterError(
            f"{path} was built with rays {stored['rays']} and seed {provenance['seed']}: an extension keeps them"
        )
    if density is not None and density < stored["density"]:
        raise InvalidParameterError(f"{path} has density {stored['density']:g}: an extension cannot thin it out")
    return density or stored["density"], stored["sparsifier"], stored["rays"], provenance["seed"]
