"""Verifying a database: every spreadlet is read and held to its figures, and of every cell one is traced anew."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import joblib
import numpy as np

from spreadlets.arrays import DoubleArray
from spreadlets.errors import InvalidDatabaseError
from spreadlets.precompute.build.progress import Progress
from spreadlets.precompute.build.work import pose_seed, single_threaded, total_variation
from spreadlets.precompute.models.grids import ALGORITHM_VERSION
from spreadlets.precompute.models.registry import trace_psf
from spreadlets.precompute.sparsify.measurement import measure_spreadlet
from spreadlets.psf.database import Database
from spreadlets.psf.database_file import refusing
from spreadlets.psf.model import PsfModel
from spreadlets.psf.spreadlet import Spreadlet

TOLERANCES: Mapping[str, tuple[float, float]] = {
    "n_support": (0.02, 2.0),
    "sparsity": (0.02, 1e-4),
    "ssim": (0.0, 2e-3),
    "l1": (0.03, 3e-4),
    "energy_error": (0.0, 1e-3),
    "total_variation": (0.02, 1e-3),
}
"""How far a figure that is measured anew may be from the recorded one, relative and absolute: the tracing's noise,
should another version of a library draw other samples. Nothing is asked of the largest value, a quotient of two small
numbers."""

COUNT_TOLERANCE = 1e-4
"""Relative: sparsity and support are stored as float32."""

ENERGY_TOLERANCE = 1e-3
"""By which a spreadlet's energy may differ from 1, beside its recorded error."""


class _Check(NamedTuple):
    """What tracing one pose of a cell anew takes."""

    cell: int
    number: int
    model: PsfModel
    box: DoubleArray
    angle: float
    half_width: float
    side: int
    rays: int | None
    seed: int
    spreadlet: Spreadlet
    recorded: dict[str, float]


def verify_database(database: Database, *, jobs: int | None = None, progress: Progress | None = None) -> dict[str, Any]:
    """Check all of a database.

    Parameters
    ----------
    database : Database
    jobs : int, optional
        Processes that trace; the default is the number of cores.
    progress : callable, optional
        Told of each cell.

    Returns
    -------
    dict
        ``spreadlets`` that were read, ``cells`` of which one pose was traced, and ``differences``, the largest
        absolute one of each figure of `TOLERANCES`.

    Raises
    ------
    InvalidDatabaseError
        If something cannot be read, or a figure is not what is recorded; the message names the first, and how many.
    """
    statistics = database.statistics()
    bad: list[str] = []
    n_spreadlets = 0
    checks: list[_Check] = []
    # Check the points of every spreadlet; choose one pose of each cell to trace again.
    for cell in range(database.n_cells):
        stored = _stored(database, cell)
        n_spreadlets += len(stored)
        spreadlets = database.spreadlets([(cell, number) for number in stored])
        for number, spreadlet in zip(stored, spreadlets, strict=True):
            recorded = {name: float(c[database.cell_start[cell] + number]) for name, c in statistics.items()}
            bad += [f"cell {cell}, pose {number}: {what}" for what in _point_problems(spreadlet, recorded)]
            if number == stored[cell % len(stored)]:
                checks.append(_check(database, cell, number, spreadlet, recorded))
    # Trace them, and compare with the recorded figures.
    differences = dict.fromkeys(TOLERANCES, 0.0)
    done = 0
    for check, measured in _measured(database, checks, jobs or os.cpu_count() or 1):
        done += 1
        bad += [f"cell {check.cell}, pose {check.number}: {what}" for what in _figures(check, measured)]
        for name, largest in differences.items():
            differences[name] = max(largest, abs(measured[name] - check.recorded[name]))
        if progress is not None:
            progress(done, len(checks), None)
    # Report the first problem, and how many follow.
    if bad:
        more = f"; and {len(bad) - 1} more" * (len(bad) > 1)
        raise InvalidDatabaseError(f"{database.path}: {bad[0]}{more}{_other_version(database)}")
    return {"spreadlets": n_spreadlets, "cells": len(checks), "differences": differences}


def _other_version(database: Database) -> str:
    """Return what may explain differences, if it does."""
    version = database.provenance.get("algorithm_version")
    if version == ALGORITHM_VERSION:
        return ""
    return f" (it was built by version {version} of the algorithm, this is version {ALGORITHM_VERSION})"


def _stored(database: Database, cell: int) -> list[int]:
    """Return the poses of a cell that are not left out."""
    first, last = database.cell_start[cell : cell + 2]
    return np.flatnonzero(np.diff(database.point_start[first : last + 1])).tolist()


def _check(database: Database, cell: int, number: int, spreadlet: Spreadlet, recorded: dict[str, float]) -> _Check:
    grid, provenance = database.grid, database.provenance
    return _Check(
        cell,
        number,
        grid.model,
        grid.box(cell),
        float(database.angles(cell)[number]),
        grid.angle_half_width(cell),
        grid.side(cell, number),
        provenance.get("parameters", {}).get("rays"),
        pose_seed(int(provenance.get("seed", 0)), int(database.seed_cell[cell]), number),
        spreadlet,
        recorded,
    )


def _point_problems(spreadlet: Spreadlet, recorded: Mapping[str, float]) -> Iterator[str]:
    """Yield what of a spreadlet's points contradicts its figures, or cannot be."""
    expected = recorded["sparsity"] * recorded["n_support"]
    if abs(spreadlet.n_points - expected) > COUNT_TOLERANCE * spreadlet.n_points:
        yield f"it has {spreadlet.n_points} points, and {expected:g} are recorded"
    if len(np.unique(spreadlet.offset_rc, axis=0)) < spreadlet.n_points:
        yield "some of its points coincide"
    moments = spreadlet.moments()
    energy = float((moments[0] if spreadlet.direct else 0.25 * (moments[4] + moments[5])).mean())
    if abs(energy - 1.0) > recorded["energy_error"] + ENERGY_TOLERANCE:
        yield f"its energy is {energy:g}, and an error of {recorded['energy_error']:g} is recorded"


def _measured(database: Database, checks: list[_Check], jobs: int) -> Iterator[tuple[_Check, dict[str, float]]]:
    parallel = joblib.Parallel(n_jobs=min(jobs, max(len(checks), 1)), return_as="generator")
    with joblib.parallel_config(backend="loky", inner_max_num_threads=1), refusing(database.path):
        yield from zip(checks, parallel(joblib.delayed(_measure)(check) for check in checks), strict=True)


def _measure(check: _Check) -> dict[str, float]:
    """Trace the PSF anew and measure the spreadlet against it."""
    with single_threaded():
        psf = trace_psf(
            check.model,
            check.box,
            angle=check.angle,
            angle_half_width=check.half_width,
            side=check.side,
            rays=check.rays,
            seed=check.seed,
        )
        return {**measure_spreadlet(psf, check.spreadlet), "total_variation": total_variation(psf)}


def _figures(check: _Check, measured: Mapping[str, float]) -> Iterator[str]:
    """Yield what was measured anew and is not what is recorded."""
    for name, (relative, absolute) in TOLERANCES.items():
        recorded = check.recorded[name]
        if not abs(measured[name] - recorded) <= relative * abs(recorded) + absolute:
            yield f"its {name} is {measured[name]:.5g}, and {recorded:.5g} is recorded"
