"""Building a database: trace and sparsify every cell and direction, in parallel processes, resumable."""

from __future__ import annotations

import hashlib
import inspect
import json
import os
import shutil
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import joblib
import numba
import numpy as np
import numpy.typing as npt
from threadpoolctl import threadpool_limits

from precompute import combined, physicallens, simplelens, stylized, volume
from precompute.aperture import Aperture
from precompute.light_tracing import trace_psf
from precompute.sparsify import sparsify
from spreadlets.database import CellRecord, absent_record, write_database
from spreadlets.errors import InvalidParameterError
from spreadlets.psf_model import PsfGrid, get_model
from spreadlets.spreadlet import Spreadlet

ALGORITHM_VERSION = 3
"""Raise it when a change of tracing or sparsification makes finished cells of an interrupted build outdated."""
MAX_SAMPLES = 100_000

Progress = Callable[[int, int], None]
"""Called with the numbers of finished and of all cells."""


SETTINGS: dict[str, Callable[..., dict[str, Any]]] = {
    "simplelens": simplelens.read_settings,
    "combined": combined.read_settings,
    "physicallens": physicallens.read_settings,
    "stylized": stylized.read_settings,
    "volume": volume.read_settings,
}
"""What turns the options of a model into its settings; its keywords are the options that the model has, and if it
takes any, those of an aperture."""


class CellTask(NamedTuple):
    """All that the spreadlets of one cell depend on; the others of its directions are left out."""

    grid: PsfGrid
    cell: int
    directions: tuple[int, ...]
    density: float
    rays: int | None
    seed: int


def build_cell(task: CellTask) -> list[CellRecord]:
    """Trace and sparsify one cell in each of the task's directions; the result depends on the task alone."""
    with _single_threaded():
        return [
            _build_record(task, number) if number in task.directions else absent_record(task.grid, task.cell, number)
            for number in range(len(task.grid.directions(task.cell)))
        ]


@contextmanager
def _single_threaded() -> Iterator[None]:
    """Keep kernels and linear algebra on one thread: cells run side by side, and no sum depends on a thread count."""
    threads = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        with threadpool_limits(1):
            yield
    finally:
        numba.set_num_threads(threads)


def _build_record(task: CellTask, number: int) -> CellRecord:
    """Trace and sparsify one direction of a cell."""
    direction = float(task.grid.directions(task.cell)[number])
    seed = int(np.random.SeedSequence((task.seed, task.cell, number)).generate_state(1)[0])
    psf = trace_psf(
        task.grid.model,
        task.grid.box(task.cell),
        direction=direction,
        direction_half_width=task.grid.direction_half_width(task.cell),
        side=task.grid.side(task.cell, number),
        rays=task.rays,
        seed=seed,
    )
    spreadlet, statistics = sparsify(psf, density=task.density, seed=seed)
    return CellRecord(direction, spreadlet, {**statistics, "total_variation": _total_variation(psf)})


def _total_variation(psf: npt.NDArray[np.float64]) -> float:
    """Return the sum of absolute differences of neighbouring pixels of a PSF (H, W, C), largest over the channels."""
    padded = np.pad(psf, ((1, 1), (1, 1), (0, 0)))
    along = (np.abs(np.diff(padded, axis=axis)).sum(axis=(0, 1)) for axis in (0, 1))
    return float(np.max(sum(along)))


def build_database(
    model: str,
    path: str | os.PathLike[str],
    *,
    samples: int | None = None,
    max_coc: float | None = None,
    max_motion: float | None = None,
    density: float = 1.0,
    rays: int | None = None,
    only: Iterable[tuple[int, int]] | None = None,
    jobs: int | None = None,
    seed: int = 0,
    progress: Progress | None = None,
    **options: Any,
) -> None:
    """Build a database of spreadlets; an interrupted build goes on where it stopped when called again.

    Parameters
    ----------
    model : str
        Name of a PSF model, see `spreadlets.psf_model.MODELS`.
    path : path-like
        The database to write. Finished cells wait in the folder ``PATH.parts`` until all are there.
    samples : int, optional
        Number of cells to aim at; the default is the model's own.
    max_coc, max_motion : float, optional
        Range of the CoC radius and of the motion over the shutter, px; the defaults are the model's own.
    density : float
        Operating point: 0.5, 1 or 2 times the usual number of points (LKS Fig. 10 d).
    rays : int, optional
        Ray budget for each PSF; the default is the tracer's own.
    only : iterable of (int, int), optional
        The (cell, direction) pairs to build; the others are left out, and reading one of them is an error.
    jobs : int, optional
        Number of processes; the default is the number of cores.
    seed : int
        Seed of tracing and sparsification. Equal seeds give equal databases for any number of processes.
    progress : callable, optional
        Told of each finished cell.
    options
        Those of the model, see `SETTINGS`; None stands for the model's own value.

    Raises
    ------
    InvalidParameterError
        If an argument is out of its range, or the file cannot be written.
    """
    begin = time.perf_counter()
    _check_arguments(samples, density, rays, jobs, seed)
    grid = model_grid(model, samples=samples, max_coc=max_coc, max_motion=max_motion, **options)
    target = Path(path)
    parts = target.with_name(target.name + ".parts")
    directions = _wanted_directions(grid, only)
    tasks = [CellTask(grid, cell, directions[cell], density, rays, seed) for cell in range(grid.n_cells)]
    _make_folder(parts)
    _compute_missing(tasks, parts, jobs or os.cpu_count() or 1, progress)
    cells = [_read_part(_part_path(parts, task)) if task.directions else build_cell(task) for task in tasks]
    provenance = {"seed": seed, "parameters": _parameters(grid, density, rays)} | _versions()
    provenance["build_s"] = time.perf_counter() - begin
    write_database(target, grid, cells, provenance)
    shutil.rmtree(parts)


def _check_arguments(samples: int | None, density: float, rays: int | None, jobs: int | None, seed: int) -> None:
    if samples is not None and not 1 <= samples <= MAX_SAMPLES:
        raise InvalidParameterError(f"samples is {samples}: allowed are 1 to {MAX_SAMPLES} cells")
    if density not in (0.5, 1.0, 2.0):
        raise InvalidParameterError(f"density is {density}: allowed are 0.5, 1 and 2")
    if rays is not None and rays < 1:
        raise InvalidParameterError(f"rays is {rays}: at least one is needed")
    if jobs is not None and jobs < 1:
        raise InvalidParameterError(f"jobs is {jobs}: at least one process is needed")
    if seed < 0:
        raise InvalidParameterError(f"seed is {seed}: it must not be negative")


def model_grid(
    model: str,
    *,
    samples: int | None = None,
    max_coc: float | None = None,
    max_motion: float | None = None,
    **options: Any,
) -> PsfGrid:
    """Return the grid that a build with these arguments has; None stands for the model's own value."""
    given = {"max_coc": max_coc, "max_motion": max_motion}
    ranges = {key: value for key, value in given.items() if value is not None}
    return PsfGrid.of(get_model(model, **ranges, settings=model_settings(model, options)), samples)


def model_settings(model: str, options: Mapping[str, Any]) -> dict[str, Any]:
    """Turn the options of a model into its settings; None stands for the model's own value.

    Raises
    ------
    InvalidParameterError
        If the model has no such option, or refuses its value.
    """
    if model not in SETTINGS:
        # The table of models gives the error.
        return {}
    given = {name: value for name, value in options.items() if value is not None}
    known = _option_names(model)
    for name in given:
        if name not in known:
            raise InvalidParameterError(f"the model {model!r} has no option {name!r}; its own are: {', '.join(known)}")
    return SETTINGS[model](**given)


def _option_names(model: str) -> list[str]:
    """Return the names of a model's own options."""
    parameters = inspect.signature(SETTINGS[model]).parameters.values()
    names = [each.name for each in parameters if each.kind is not inspect.Parameter.VAR_KEYWORD]
    takes_shape = len(names) < len(parameters)
    return names + [field.name for field in fields(Aperture)] * takes_shape


def takes_option(model: str, name: str) -> bool:
    """Return whether a model has an option of its own of this name."""
    return model in SETTINGS and name in _option_names(model)


def _wanted_directions(grid: PsfGrid, only: Iterable[tuple[int, int]] | None) -> list[tuple[int, ...]]:
    """Return the directions to build for each cell."""
    if only is None:
        return [tuple(range(int(count))) for count in grid.pose_counts]
    wanted: list[set[int]] = [set() for _ in range(grid.n_cells)]
    for cell, direction in only:
        wanted[cell].add(direction)
    return [tuple(sorted(each)) for each in wanted]


def _make_folder(parts: Path) -> None:
    try:
        parts.mkdir(exist_ok=True)
    except OSError as error:
        raise InvalidParameterError(f"cannot write beside the database: {error}") from error


def _compute_missing(tasks: list[CellTask], parts: Path, jobs: int, progress: Progress | None) -> None:
    """Compute the cells that have no part yet, longest first, storing each as it is finished."""
    tasks = [task for task in tasks if task.directions]
    missing = [task for task in tasks if not _part_path(parts, task).exists()]
    missing.sort(key=lambda task: -len(task.directions) * float(task.grid.box(task.cell)[:, 1].prod()))
    done = len(tasks) - len(missing)
    if progress is not None:
        progress(done, len(tasks))
    workers = joblib.Parallel(n_jobs=min(jobs, max(len(missing), 1)), return_as="generator_unordered")
    for _ in workers(joblib.delayed(_store_cell)(task, parts) for task in missing):
        done += 1
        if progress is not None:
            progress(done, len(tasks))


def _store_cell(task: CellTask, parts: Path) -> None:
    path = _part_path(parts, task)
    temporary = path.with_suffix(f".{os.getpid()}.tmp")
    records = [(record.direction, record.spreadlet, dict(record.statistics)) for record in build_cell(task)]
    arrays = {
        "direction": np.array([direction for direction, _, _ in records]),
        "count": np.array([spreadlet.n_points for _, spreadlet, _ in records]),
        "direct": np.array([spreadlet.direct for _, spreadlet, _ in records]),
        "offset_rc": np.concatenate([spreadlet.offset_rc for _, spreadlet, _ in records]),
        "value": np.concatenate([spreadlet.value for _, spreadlet, _ in records]),
        "statistics": np.array(json.dumps([statistics for _, _, statistics in records])),
    }
    with open(temporary, "wb") as file:
        np.savez(file, allow_pickle=False, **arrays)
    os.replace(temporary, path)


def _read_part(path: Path) -> list[CellRecord]:
    with np.load(path, allow_pickle=False) as part:
        start = np.concatenate([[0], np.cumsum(part["count"])])
        offset_rc, value, direct = part["offset_rc"], part["value"], part["direct"]
        statistics = json.loads(str(part["statistics"]))
        return [
            CellRecord(
                float(direction),
                Spreadlet(offset_rc[start[i] : start[i + 1]], value[start[i] : start[i + 1]], bool(direct[i])),
                statistics[i],
            )
            for i, direction in enumerate(part["direction"])
        ]


def _part_path(parts: Path, task: CellTask) -> Path:
    """Return where a cell's part lies: its name is a hash of all that the result depends on."""
    facts = (ALGORITHM_VERSION, repr(task.grid), *task[1:])
    return parts / f"{hashlib.sha256(repr(facts).encode()).hexdigest()[:32]}.npz"


def _parameters(grid: PsfGrid, density: float, rays: int | None) -> dict[str, Any]:
    return {
        "samples": grid.n_cells,
        "shape": list(grid.shape),
        "density": density,
        "rays": rays,
        "maximum": {axis.name: axis.maximum for axis in grid.model.axes},
        "power": {axis.name: axis.power for axis in grid.model.axes},
    }


def _versions() -> dict[str, Any]:
    packages = ("spreadlets", "numpy", "scipy", "numba")
    return {"algorithm_version": ALGORITHM_VERSION, "versions": {name: version(name) for name in packages}}
