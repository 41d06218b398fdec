"""What a build computes: cells, divided into work units of even size, the longest first.

A unit is some poses of one cell. Its result depends on nothing else, so that cells come out the same on any number
of workers, in any order, in one run or in several.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from threadpoolctl import threadpool_limits

from spreadlets.parallel import limit_threads
from spreadlets.precompute.models.grids import ALGORITHM_VERSION
from spreadlets.precompute.models.registry import psf_footprint, trace_psf
from spreadlets.precompute.sparsify.sparsify import sparsify
from spreadlets.psf.database_file import CellRecord
from spreadlets.psf.model import PsfGrid, PsfModel

UNITS_PER_WORKER = 32
"""Least number of units for each worker, unless poses are longer than that: no worker then waits for the last one
longer than a 32nd of the whole time."""

COST_EXPONENT = 0.7
"""Time grows with this power of a PSF's pixels: measured from 50 to 35 000 pixels, two models, within a factor of 2."""

LEAST_COST = 10.0
"""Cost of the smallest PSF: even that takes some milliseconds."""


class CellTask(NamedTuple):
    """All that the spreadlets of one cell depend on; the others of its poses are left out."""

    grid: PsfGrid
    cell: int
    poses: tuple[int, ...]
    density: float
    rays: int | None
    seed: int
    seed_cell: int
    sparsifier: str


class WorkUnit(NamedTuple):
    """Some poses of one cell, and what they are made from: small enough to be sent to another machine.

    Attributes
    ----------
    model : PsfModel
    box : ndarray of shape (n_axes, 2), float64
        The cell's ranges.
    cell : int
    poses : tuple of (int, float, int)
        Number, direction (radians) and side of the focus of each spreadlet.
    half_width : float
        Of the pre-filter over the direction, radians.
    density, rays, seed
        As for the build.
    seed_cell : int
        The cell's number in the build that first had it: a part of the seed.
    sparsifier : str
        As for the build.
    cost : float
        Expected time, in a unit of its own.
    """

    model: PsfModel
    box: npt.NDArray[np.float64]
    cell: int
    poses: tuple[tuple[int, float, int], ...]
    half_width: float
    density: float
    rays: int | None
    seed: int
    seed_cell: int
    sparsifier: str
    cost: float


class UnitResult(NamedTuple):
    """What a worker sends back: the records by their number, how long it took, s, and with which algorithm."""

    cell: int
    records: dict[int, CellRecord]
    seconds: float
    cost: float
    algorithm_version: int


def build_unit(unit: WorkUnit) -> UnitResult:
    """Trace and sparsify the poses of a unit; the result depends on the unit alone."""
    with single_threaded():
        begin = time.process_time()
        records = {number: _build_record(unit, number, angle, side) for number, angle, side in unit.poses}
        return UnitResult(unit.cell, records, time.process_time() - begin, unit.cost, ALGORITHM_VERSION)


@contextmanager
def single_threaded() -> Iterator[None]:
    """Keep kernels and linear algebra on one thread: units run side by side, and no sum depends on a thread count."""
    with limit_threads(1), threadpool_limits(1):
        yield


def pose_seed(seed: int, cell: int, number: int) -> int:
    """Return the seed of one spreadlet of a build."""
    return int(np.random.SeedSequence((seed, cell, number)).generate_state(1)[0])


def _build_record(unit: WorkUnit, number: int, angle: float, side: int) -> CellRecord:
    """Trace and sparsify one pose of a cell."""
    seed = pose_seed(unit.seed, unit.seed_cell, number)
    psf = trace_psf(
        unit.model,
        unit.box,
        angle=angle,
        angle_half_width=unit.half_width,
        side=side,
        rays=unit.rays,
        seed=seed,
    )
    spreadlet, statistics = sparsify(psf, density=unit.density, seed=seed, sparsifier=unit.sparsifier)
    return CellRecord(angle, spreadlet, {**statistics, "total_variation": total_variation(psf)})


def total_variation(psf: npt.NDArray[np.float64]) -> float:
    """Return the sum of absolute differences of neighbouring pixels of a PSF (H, W, C), largest over the channels."""
    padded = np.pad(psf, ((1, 1), (1, 1), (0, 0)))
    along = (np.abs(np.diff(padded, axis=axis)).sum(axis=(0, 1)) for axis in (0, 1))
    return float(np.max(sum(along)))


def plan_units(tasks: Sequence[CellTask], workers: int) -> list[WorkUnit]:
    """Divide cells into units, longest first.

    Parameters
    ----------
    tasks : sequence of CellTask
    workers : int
        How many will share the work.

    Returns
    -------
    list of WorkUnit
        A unit has as many poses of its cell as stay below the `UNITS_PER_WORKER`-th part of a worker's share, and
        at least one.

    Notes
    -----
    Graham 1969: with list scheduling, m workers need at most ``T / m + (1 - 1 / m) p`` for units of T in all, of which
    the last to finish takes p; longest first, p is one of the smallest.
    """
    costs = [_pose_cost(task) for task in tasks]
    total = sum(cost * len(task.poses) for cost, task in zip(costs, tasks, strict=True))
    share = total / (workers * UNITS_PER_WORKER)
    units = [unit for cost, task in zip(costs, tasks, strict=True) for unit in _units(task, cost, share)]
    return sorted(units, key=lambda unit: (-unit.cost, unit.cell, unit.poses))


def _pose_cost(task: CellTask) -> float:
    """Return the expected time of one pose of a cell, in a unit of its own."""
    number = task.poses[0]
    pixels = psf_footprint(
        task.grid.model,
        task.grid.box(task.cell),
        angle=float(task.grid.angles(task.cell)[number]),
        angle_half_width=task.grid.angle_half_width(task.cell),
        side=task.grid.side(task.cell, number),
    )
    return float(LEAST_COST + pixels**COST_EXPONENT)


def _units(task: CellTask, cost: float, share: float) -> Iterator[WorkUnit]:
    """Yield the units of a cell, of nearly equal numbers of poses."""
    grid, cell = task.grid, task.cell
    angles = grid.angles(cell)
    poses = [(number, float(angles[number]), grid.side(cell, number)) for number in task.poses]
    n_units = min(len(poses), int(np.ceil(len(poses) / max(share / cost, 1.0))))
    half_width, box = grid.angle_half_width(cell), grid.box(cell)
    for some in np.array_split(np.arange(len(poses)), n_units):
        chosen = tuple(poses[index] for index in some)
        options = task.density, task.rays, task.seed, task.seed_cell, task.sparsifier
        yield WorkUnit(grid.model, box, cell, chosen, half_width, *options, cost * len(chosen))
