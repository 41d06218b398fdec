"""Building a database: every cell and pose traced and sparsified by workers, resumable, extendable.

Workers compute (`spreadlets.workers`), this process alone writes: finished cells into a folder
(`precompute.build.parts`), and in the end all of them into the database, which appears whole.
"""

from __future__ import annotations

import os
import time
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

from spreadlets.errors import BuildStoppedError, InvalidParameterError, WorkerLostError, option
from spreadlets.precompute.build.between_cells import FindSpreadlet, between_cells
from spreadlets.precompute.build.extension import Kept, check_extension, extended_grid
from spreadlets.precompute.build.parts import LOG_NAME, Parts, open_parts
from spreadlets.precompute.build.progress import BuildProgress, Progress
from spreadlets.precompute.build.work import CellTask, UnitResult, WorkUnit, build_unit, plan_units
from spreadlets.precompute.models.grids import ALGORITHM_VERSION, model_grid
from spreadlets.precompute.sparsify.sparsify import DEFAULT_SPARSIFIER, check_sparsifier
from spreadlets.psf.database_file import SIGNATURE, CellRecord, absent_record, write_database
from spreadlets.psf.model import PsfGrid
from spreadlets.psf.spreadlet import Spreadlet
from spreadlets.version import __version__
from spreadlets.workers import AGAIN, Compute, open_workers

MAX_SAMPLES = 100_000


def build_database(
    model: str,
    path: str | os.PathLike[str],
    *,
    samples: int | None = None,
    max_coc: float | None = None,
    max_motion: float | None = None,
    density: float | None = None,
    sparsifier: str | None = None,
    rays: int | None = None,
    only: Iterable[tuple[int, int]] | None = None,
    jobs: int | None = None,
    scheduler: str | None = None,
    seed: int = 0,
    extend: bool = False,
    progress: Progress | None = None,
    log: str | os.PathLike[str] | None = None,
    judge: bool = True,
    **options: Any,
) -> None:
    """Build a database of spreadlets; an interrupted build goes on where it stopped when called again.

    Parameters
    ----------
    model : str
        Name of a PSF model, see `spreadlets.psf.model.MODELS`.
    path : path-like
        The database to write. Finished cells wait in the folder ``PATH.parts`` until all are there. Only one process
        at a time may build a file.
    samples : int, optional
        Number of cells to aim at; the default is the model's own.
    max_coc, max_motion : float, optional
        Range of the CoC radius and of the motion over the shutter, px; the defaults are the model's own.
    density : float, optional
        Operating point: 0.5, 1 (the default) or 2 times the usual number of points (LKS Fig. 10 d).
    sparsifier : str, optional
        ``"fit"`` (the default), or ``"lks"``: dart throwing, Lloyd relaxation, Voronoi collapse and annealing as
        published (LKS section 5.5), see `precompute.sparsify.sparsify.SPARSIFIERS`.
    rays : int, optional
        Ray budget for each PSF; the default is the tracer's own.
    only : iterable of (int, int), optional
        The (cell, pose) pairs to build; the others are left out, and reading one of them is an error.
    jobs : int, optional
        Number of processes, each of one thread; the default is the number of cores.
    scheduler : str, optional
        Address of a Dask scheduler whose workers compute in place of processes of this machine.
    seed : int
        Seed of tracing and sparsification. Equal seeds give equal databases for any number of workers.
    extend : bool
        Widen the database that is there: what it holds is kept where it is the same in the wider one, see
        `precompute.build.extension`. What is not given stays as it is.
    progress : callable, optional
        Told of each finished cell.
    log : path, optional
        A line for each finished cell, with an estimate of what is left, is added to this file; by default to one in
        the folder of parts, which goes with it.
    judge : bool
        Record how well PSFs between the cells are drawn, see `precompute.build.between_cells`; takes some seconds.
    options
        Those of the model, see `spreadlets.models`; None stands for the model's own value.

    Raises
    ------
    InvalidParameterError
        If an argument is out of its range, the file cannot be written, or it is there already and is no HDF5.
    BuildStoppedError
        If the build cannot go on: the disk is full, a worker or the cluster is lost, or another process builds the
        same file. Calling again goes on from the cells that were finished.
    InvalidDatabaseError
        If the database to extend cannot be read.
    """
    begin = time.perf_counter()
    target = Path(path)
    _check_target(target)
    _check_arguments(samples, density, rays, jobs, seed)
    if sparsifier is not None:
        check_sparsifier(sparsifier)
    ranges = {"samples": samples, "max_coc": max_coc, "max_motion": max_motion}
    # Divide the model's parameter space into cells.
    grid = build_grid(model, target, extend, **ranges, **options)
    with ExitStack() as stack:
        parts = stack.enter_context(open_parts(target, grid))
        # Take over what a database that is extended already holds.
        kept = Kept()
        if extend:
            kept = stack.enter_context(Kept.of(target, grid, density))
            density, sparsifier, rays, seed = check_extension(kept, density, sparsifier, rays, seed)
        density, sparsifier = density or 1.0, sparsifier or DEFAULT_SPARSIFIER
        # List the cells and poses that are missing.
        wanted = _wanted_poses(grid, None if only is None else {*only, *kept.places()})
        missing = [
            tuple(number for number in numbers if (cell, number) not in kept) for cell, numbers in enumerate(wanted)
        ]
        seed_cell = kept.seed_cells(grid)
        tasks = [
            CellTask(grid, cell, numbers, density, rays, seed, int(seed_cell[cell]), sparsifier)
            for cell, numbers in enumerate(missing)
        ]
        # Trace and sparsify them; finished cells wait as parts.
        shown = _compute_missing(tasks, parts, jobs, scheduler, log or parts.folder / LOG_NAME, progress)
        # Record the provenance, and what is drawn between the cells.
        provenance = {"seed": seed, "parameters": _parameters(grid, density, sparsifier, rays)} | _versions()
        if judge:
            provenance["between_cells"] = between_cells(grid, _finder(tasks, parts, kept), rays)
        provenance["build_s"] = time.perf_counter() - begin + kept.build_s
        # Assemble the database from the parts.
        cells = (_cell(task, parts, kept) for task in tasks)
        try:
            write_database(target, grid, cells, provenance, seed_cell if extend else None)
        except InvalidParameterError as error:
            raise BuildStoppedError(f"{error}; {AGAIN}") from error
        shown.ended(target)
        parts.remove()


def _finder(tasks: list[CellTask], parts: Parts, kept: Kept) -> FindSpreadlet:
    """Return what finds the spreadlet of a cell and pose among what was built."""
    cells = cache(lambda cell: _cell(tasks[cell], parts, kept))

    def find(cell: int, pose: int) -> Spreadlet | None:
        spreadlet: Spreadlet = cells(cell)[pose].spreadlet
        return spreadlet if spreadlet.n_points else None

    return find


def _check_target(target: Path) -> None:
    """Refuse to replace what is no database, such as the frame whose name was typed in its place."""
    if not target.is_file():
        return
    try:
        with target.open("rb") as file:
            begin = file.read(len(SIGNATURE))
    except OSError as error:
        raise InvalidParameterError(f"{target} cannot be replaced: {error.strerror}") from error
    if begin not in (b"", SIGNATURE):
        raise InvalidParameterError(f"{target} is there already, and no database (HDF5): it is not replaced")


def _check_arguments(samples: int | None, density: float | None, rays: int | None, jobs: int | None, seed: int) -> None:
    if samples is not None and not 1 <= samples <= MAX_SAMPLES:
        raise InvalidParameterError(f"{option('samples')} is {samples}: allowed are 1 to {MAX_SAMPLES} cells")
    if density not in (None, 0.5, 1.0, 2.0):
        raise InvalidParameterError(f"{option('density')} is {density}: allowed are 0.5, 1 and 2")
    if rays is not None and rays < 1:
        raise InvalidParameterError(f"{option('rays')} is {rays}: at least one is needed")
    if jobs is not None and jobs < 1:
        raise InvalidParameterError(f"{option('jobs')} is {jobs}: at least one process is needed")
    if seed < 0:
        raise InvalidParameterError(f"{option('seed')} is {seed}: it must not be negative")


def build_grid(model: str, path: str | os.PathLike[str], extend: bool, **options: Any) -> PsfGrid:
    """Return the grid that a build with these arguments has; None stands for the model's own, or the database's, value.

    Raises
    ------
    InvalidParameterError
        If the model has no such option, refuses its value, or cannot be extended so.
    InvalidDatabaseError
        If there is no database to extend.
    """
    if extend:
        return extended_grid(path, model, {name: value for name, value in options.items() if value is not None})
    return model_grid(model, **options)


def _wanted_poses(grid: PsfGrid, only: Iterable[tuple[int, int]] | None) -> list[tuple[int, ...]]:
    """Return the poses to build for each cell."""
    if only is None:
        return [tuple(range(int(count))) for count in grid.pose_counts]
    wanted: list[set[int]] = [set() for _ in range(grid.n_cells)]
    for cell, pose in only:
        wanted[cell].add(pose)
    return [tuple(sorted(each)) for each in wanted]


def _compute_missing(
    tasks: list[CellTask],
    parts: Parts,
    jobs: int | None,
    scheduler: str | None,
    log: str | os.PathLike[str],
    progress: Progress | None,
) -> BuildProgress:
    """Compute the cells that have no part yet, storing each as soon as all its poses are there."""
    tasks = [task for task in tasks if task.poses]
    missing = {task.cell: task for task in tasks if not parts.has(task)}
    with open_workers(jobs or os.cpu_count() or 1, scheduler, BuildStoppedError) as (n_workers, compute):
        units = plan_units(list(missing.values()), n_workers)
        cost = sum(unit.cost for unit in units)
        shown = BuildProgress(len(tasks), len(tasks) - len(missing), cost, log, progress)
        for cell, finished in _cells(_results(compute, units), missing, shown):
            parts.store(missing[cell], [record for each in finished for _, record in sorted(each.records.items())])
            shown.finished(cell, sum(each.seconds for each in finished))
    return shown


def _results(compute: Compute, units: list[WorkUnit]) -> Iterator[UnitResult]:
    """Yield the results of units; what went wrong with one stops the build."""
    for unit, result in compute(build_unit, units):
        if isinstance(result, WorkerLostError):
            raise BuildStoppedError(f"cell {unit.cell}: {result}; {AGAIN}") from result
        if isinstance(result, Exception):
            raise result
        if result.algorithm_version != ALGORITHM_VERSION:
            raise BuildStoppedError(
                f"a worker of the cluster has version {result.algorithm_version} of the algorithm, this program "
                f"{ALGORITHM_VERSION}: install the same spreadlets everywhere; {AGAIN}"
            )
        yield result


def _cells(
    results: Iterable[UnitResult], missing: Mapping[int, CellTask], shown: BuildProgress
) -> Iterator[tuple[int, list[UnitResult]]]:
    """Yield each cell as soon as all its units are there, its units in the order of their poses."""
    waiting: dict[int, list[UnitResult]] = defaultdict(list)
    for result in results:
        shown.worked(result.cost)
        units = waiting[result.cell]
        units.append(result)
        if sum(len(unit.records) for unit in units) == len(missing[result.cell].poses):
            yield result.cell, sorted(waiting.pop(result.cell), key=lambda unit: min(unit.records))
    if waiting:
        raise BuildStoppedError(f"no results came back for {len(waiting)} cells; run the same command again")


def _cell(task: CellTask, parts: Parts, kept: Kept) -> list[CellRecord]:
    """Return all records of a cell: built, kept, and those that are left out."""
    built = dict(zip(task.poses, parts.load(task), strict=True)) if task.poses else {}
    built |= kept.records(task.cell)
    n_channels = task.grid.model.n_channels
    return [
        built.get(number) or absent_record(angle, n_channels)
        for number, angle in enumerate(task.grid.angles(task.cell).tolist())
    ]


def _parameters(grid: PsfGrid, density: float, sparsifier: str, rays: int | None) -> dict[str, Any]:
    return {
        "samples": grid.n_cells,
        "shape": list(grid.shape),
        "density": density,
        "sparsifier": sparsifier,
        "rays": rays,
        "maximum": {axis.name: axis.maximum for axis in grid.model.axes},
        "power": {axis.name: axis.power for axis in grid.model.axes},
    }


def _versions() -> dict[str, Any]:
    packages = {name: version(name) for name in ("numpy", "scipy", "numba")}
    return {"algorithm_version": ALGORITHM_VERSION, "versions": {"spreadlets": __version__} | packages}
