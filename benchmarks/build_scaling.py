"""How builds scale: efficiency with 1, 2 and 4 processes, a simulation up to 256 workers, times of two large databases.

    python benchmarks/build_scaling.py processes      a small build with 1, 2 and 4 processes in turn, several times
    python benchmarks/build_scaling.py measure        times of the units of 40 cells of `combined` and of `physicallens`
    python benchmarks/build_scaling.py simulate       from those times: list scheduling on up to 256 workers

Times of units are processor times, so that other programs on the machine do not count. `measure` takes five minutes
(`--every 1` times all of `combined`, in six more); what it found is kept in benchmarks/results/build_times.npz. Tables
are written to benchmarks/results/build_scaling_*.txt.
"""

import argparse
import heapq
import os
import tempfile
import time
from pathlib import Path

import numpy as np

from spreadlets.files.cameras import read_camera
from spreadlets.precompute.build.build import build_database
from spreadlets.precompute.build.work import CellTask, build_unit, plan_units
from spreadlets.precompute.models.grids import model_grid
from spreadlets.precompute.sparsify.sparsify import DEFAULT_SPARSIFIER
from spreadlets.psf.model import PsfGrid

ROOT = Path(__file__).resolve().parent.parent
RESULTS = Path(__file__).parent / "results"
TIMES = RESULTS / "build_times.npz"

SMALL = {"model": "combined", "samples": 100, "max_coc": 24.0, "max_motion": 24.0}
"""A build of half a minute or less: starting a process takes the better part of a second, once."""
PROCESSES = (1, 2, 4)
WORKERS = (1, 2, 4, 8, 16, 32, 64, 128, 256)
LENS = {"camera": "psf_db/physicallens.json", "width": 1024, "max_coc": 32.0, "samples": 4000}
N_LENS_CELLS = 40


def tasks_of(grid: PsfGrid, cells: np.ndarray | None = None) -> list[CellTask]:
    chosen = range(grid.n_cells) if cells is None else cells.tolist()
    poses = [tuple(range(n)) for n in grid.pose_counts]
    return [CellTask(grid, cell, poses[cell], 1.0, None, 0, cell, DEFAULT_SPARSIFIER) for cell in chosen]


def lens_grid() -> PsfGrid:
    return model_grid("physicallens", **(LENS | {"camera": read_camera(ROOT / LENS["camera"])}))


def timed(tasks: list[CellTask], label: str, share: float = 1.0) -> np.ndarray:
    """Return cell, expected cost and processor time of every unit of a division for 256 workers, (n, 3).

    The tasks may be a share of all: then the units are as small as if all were there.
    """
    units = plan_units(tasks, max(1, round(share * max(WORKERS))))
    build_unit(units[-1])  # compiles
    rows = []
    for count, unit in enumerate(units, 1):
        rows.append((unit.cell, unit.cost, build_unit(unit).seconds))
        if count % 100 == 0:
            print(f"{label}: {count} of {len(units)} units", flush=True)
    print(f"{label}: all {len(units)} units", flush=True)
    return np.array(rows)


def measure(which: str, every: int) -> None:
    found = dict(np.load(TIMES)) if TIMES.exists() else {}
    if which in ("all", "physicallens"):
        grid = lens_grid()
        cells = np.linspace(0, grid.n_cells - 1, N_LENS_CELLS).astype(int)
        found["physicallens"] = timed(tasks_of(grid, cells), "physicallens").astype(np.float32)
    if which in ("all", "combined"):
        grid = model_grid("combined")
        cells = np.arange(every // 2, grid.n_cells, every)
        share = 1.0 / every
        found["combined"] = timed(tasks_of(grid, cells), "combined", share).astype(np.float32)
    np.savez_compressed(TIMES, **found)


def makespan(seconds: np.ndarray, workers: int) -> float:
    """Return when the last worker ends if each takes the next unit as soon as it is free."""
    free = [0.0] * workers
    for each in seconds:
        heapq.heapreplace(free, free[0] + float(each))
    return max(free)


def simulate() -> None:
    """Compare the order and the sizes of units that a build uses with others, for measured times."""
    if not TIMES.exists():
        raise SystemExit("no measured times: run `measure` first")
    found = np.load(TIMES)
    lines = []
    if "combined" in found:
        cell, cost, seconds = found["combined"].astype(float).T
        n_cells = len(np.unique(cell))
        times = round(model_grid("combined").n_cells / n_cells)  # each measured cell stands for so many
        order = np.argsort(-np.tile(cost, times), kind="stable")
        seconds = np.tile(seconds, times)[order]
        cell = (np.tile(cell, times) + 1000 * np.repeat(np.arange(times), len(cell)))[order]
        total, longest = seconds.sum(), seconds.max()
        cells = np.bincount(np.unique(cell, return_inverse=True)[1], seconds)
        shuffled = np.random.default_rng(0).permutation(cells)
        lines += [
            f"combined, {n_cells} of 400 cells measured: {len(seconds)} units, {total:.0f} s of one processor, longest "
            f"unit {longest:.2f} s, longest cell {cells.max():.1f} s",
            f"{'workers':>8}{'time s':>9}{'efficiency':>12}{'bound':>8}{'whole cells':>13}{'any order':>11}",
        ]
        for workers in WORKERS:
            spans = makespan(seconds, workers), makespan(np.sort(cells)[::-1], workers), makespan(shuffled, workers)
            efficiency = [total / (workers * span) for span in spans]
            bound = total / (total + (workers - 1) * longest)
            lines.append(
                f"{workers:>8}{spans[0]:>9.1f}{efficiency[0]:>12.3f}{bound:>8.3f}{efficiency[1]:>13.3f}"
                f"{efficiency[2]:>11.3f}"
            )
        lines += [
            "efficiency: units as a build divides and orders them; bound: the least that any order of them can have;",
            "whole cells: cells undivided, longest first; any order: cells undivided, shuffled.",
            "",
        ]
    if "physicallens" in found:
        grid = lens_grid()
        _, cost, seconds = found["physicallens"].astype(float).T
        all_cost = sum(unit.cost for unit in plan_units(tasks_of(grid), 1))
        projected = all_cost * seconds.sum() / cost.sum()
        lines.append(
            f"physicallens, {grid.n_cells} cells, {int(grid.pose_counts.sum())} directions: {N_LENS_CELLS} cells took "
            f"{seconds.sum():.0f} s; projected {projected / 3600:.1f} h of one processor, "
            f"{projected / 3600 / 2:.1f} h with 2, {projected / 3600 / 256 * 60:.1f} min with 256 at full efficiency"
        )
    write("build_scaling_simulated.txt", lines)


def processes(repetitions: int) -> None:
    """Build the same small database with several numbers of processes, in turn, in one run."""
    times: dict[int, list[float]] = {jobs: [] for jobs in PROCESSES}
    with tempfile.TemporaryDirectory() as folder:
        for jobs in PROCESSES:  # starts the processes, which stay, and compiles
            build(folder, jobs)
        for _ in range(repetitions):
            for jobs in PROCESSES:
                begin = time.perf_counter()
                build(folder, jobs)
                times[jobs].append(time.perf_counter() - begin)
                print(f"{jobs} processes: {times[jobs][-1]:.2f} s", flush=True)
    cores = os.cpu_count() or 1
    one = np.array(times[1])
    lines = [
        f"{SMALL}, {repetitions} times in turn on {cores} cores; load of the machine {os.getloadavg()[0]:.1f}",
        f"{'processes':>10}{'median s':>10}{'efficiency: median':>20}{'least':>8}{'most':>8}",
    ]
    for jobs, taken in times.items():
        ratio = one / (np.array(taken) * min(jobs, cores))
        lines.append(
            f"{jobs:>10}{np.median(taken):>10.2f}{np.median(ratio):>20.3f}{ratio.min():>8.3f}{ratio.max():>8.3f}"
        )
    lines.append("efficiency: time with one process over the time with n, divided by n or the number of cores if less")
    write("build_scaling_processes.txt", lines)


def build(folder: str, jobs: int) -> None:
    build_database(path=Path(folder) / "small.h5", jobs=jobs, **SMALL)


def write(name: str, lines: list[str]) -> None:
    print("\n".join(lines))
    (RESULTS / name).write_text("\n".join(lines) + "\n")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("processes", "measure", "simulate"))
    parser.add_argument("--only", choices=("all", "combined", "physicallens"), default="all", help="of `measure`")
    parser.add_argument("--every", type=int, default=10, help="of `measure`: the cells of `combined` that are timed")
    parser.add_argument("--repetitions", type=int, default=5, help="of `processes`")
    arguments = parser.parse_args()
    if arguments.what == "processes":
        processes(arguments.repetitions)
    elif arguments.what == "measure":
        measure(arguments.only, arguments.every)
    else:
        simulate()


if __name__ == "__main__":
    main()
