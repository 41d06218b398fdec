"""Sequences on many processes: efficiency, kills of workers and of schedulers, and a simulation up to 256 workers.

Draws a shot of small frames. After kills of processes, of workers and of schedulers, --kills of each, results must be
those of a serial run, byte by byte.

    python benchmarks/farm.py [--frames 100] [--width 512] [--rounds 7] [--kills 20] [--seed 0]

The results go to benchmarks/results/farm.txt.
"""

import argparse
import filecmp
import heapq
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np
import psutil

import spreadlets as sp
from spreadlets.workers import open_workers

RESULTS = Path(__file__).parent / "results"
COMMAND = [sys.executable, "-m", "spreadlets.cli.main"]
WORKERS = (1, 2, 4, 16, 64, 128, 256)
SHOT, SHOT_PIXELS = 1000, 1920 * 1080
"""Frames of the simulated shot, and their size: times are taken to grow with the pixels."""
MOST_TAKEN, MOST_DISTURBED = 0.1, 20
"""Part of the processors that other programs may take for a turn to count, and how many turns are done anew for it."""
LEAST_FRAMES = 5
"""Two frames must be there before a kill, and two left after it."""
START_S = 3.0
"""Start of a worker in the simulation, s."""


def draw_shot(folder: Path, count: int, width: int) -> None:
    """Write frames of discs at many depths that move past each other, some of them bright."""
    height = width * 9 // 16
    rng = np.random.default_rng(3)
    discs = np.stack(
        [rng.uniform(0, width, 40), rng.uniform(0, height, 40), rng.uniform(4, 0.1 * width, 40), rng.uniform(1, 12, 40)]
    )
    speed, colour = rng.uniform(-6, 6, (2, 40)), rng.random((40, 3))
    colour[::8] *= 30.0
    rows, columns = np.indices((height, width))
    for number in range(1, count + 1):
        radiance, depth, motion = (
            np.full((height, width, 3), 0.2),
            np.full((height, width), 20.0),
            np.zeros((height, width, 2)),
        )
        for index in np.argsort(-discs[3]):
            x, y = (discs[:2, index] + speed[:, index] * number) % (width, height)
            inside = (columns - x) ** 2 + (rows - y) ** 2 < discs[2, index] ** 2
            radiance[inside], depth[inside], motion[inside] = colour[index], discs[3, index], speed[:, index]
        sp.write_frame(folder / f"shot.{number:04d}.exr", sp.Frame(radiance, depth, motion))
    camera = {"focal_length_mm": 50, "sensor_width_mm": 36, "f_number": 1.4, "focus_distance_m": 3}
    (folder / "camera.json").write_text(json.dumps(camera | {"shutter_open_close_frames": [-0.25, 0.25]}))


class Run(NamedTuple):
    """A run of the command, and the files that take what it prints."""

    process: subprocess.Popen[bytes]
    out: Path
    err: Path


def start(folder: Path, name: str, *options: str, threads: int | None = None) -> Run:
    """Start a run whose results are called so."""
    files = [str(folder / "shot.####.exr"), "-o", str(folder / f"{name}.####.exr")]
    command = [*COMMAND, "synth", *files, "--camera", str(folder / "camera.json"), "--json", *options]
    environment = os.environ | ({"NUMBA_NUM_THREADS": str(threads)} if threads else {})
    out, err = folder / f"{name}.out", folder / f"{name}.err"
    with out.open("wb") as report, err.open("wb") as said:
        return Run(subprocess.Popen(command, stdout=report, stderr=said, env=environment), out, err)


def finish(run: Run) -> tuple[dict, str]:
    """Wait for a run; return its report and what it said."""
    run.process.wait()
    out = run.out.read_text()
    return (json.loads(out) if out else {}), run.err.read_text().strip()


def made(folder: Path, name: str) -> int:
    return len(list(folder.glob(f"{name}.????.exr")))


def differing(folder: Path, name: str, count: int) -> int:
    """Count frames that are not there or differ from the serial run's in any byte; and remove them all."""
    wrong = 0
    for number in range(1, count + 1):
        path = folder / f"{name}.{number:04d}.exr"
        wrong += not (path.exists() and filecmp.cmp(path, folder / f"serial.{number:04d}.exr", shallow=False))
        path.unlink(missing_ok=True)
    return wrong


def efficiency(folder: Path, count: int, rounds: int) -> tuple[list[str], list[float]]:
    """Let runs of one process and of two take turns; return lines, and the seconds of each frame with one thread.

    A worker of two on two processors has one thread, so what it is held against is one process of one thread. Turns in
    which other programs took more of the processors than `MOST_TAKEN` do not count, but are counted.
    """
    runs = {"serial": (1, ["--jobs", "1"]), "double": (1, ["--jobs", "2"]), "both threads": (2, ["--jobs", "1"])}
    turns: list[dict[str, float]] = []
    reports, wrong, disturbed = {}, 0, 0
    while len(turns) < rounds:
        turn, taken = {}, 0.0
        for name, (threads, options) in runs.items():
            before, begin = others_s(), time.perf_counter()
            reports[name], _ = finish(start(folder, name, "--overwrite", *options, threads=threads))
            turn[name] = time.perf_counter() - begin
            taken = max(taken, (others_s() - before) / (turn[name] * os.cpu_count()))
        wrong += differing(folder, "double", count) + differing(folder, "both threads", count)
        if taken <= MOST_TAKEN:
            turns.append(turn)
        elif disturbed < MOST_DISTURBED:
            disturbed += 1
        else:
            raise SystemExit(f"in each turn others took more than {100 * MOST_TAKEN:.0f} % of the processors")
    columns = {name: [turn[name] for turn in turns] for name in runs}
    parts = [turn["serial"] / (2 * turn["double"]) for turn in turns]
    lines = [
        f"{count} frames, starts included, in turns, median (least to most) of {rounds}: one process of one thread "
        f"{spread(columns['serial'])} s, two of one thread {spread(columns['double'])} s, one of two threads "
        f"{spread(columns['both threads'])} s; {disturbed} turns left out, in which others took more than "
        f"{100 * MOST_TAKEN:.0f} % of the processors",
        f"efficiency of two processes, half of the first by the second: {spread(parts, 3)}; frames that differ {wrong}",
        f"memory: {reports['serial']['peak_rss_mb']:.0f} MB for one process, {reports['double']['peak_rss_mb']:.0f} MB "
        "for each of two",
    ]
    return lines, [entry["time_s"]["total"] for entry in reports["serial"]["frames"]][1:]


def others_s() -> float:
    """Return the seconds that processors have spent on programs which this one has not started."""
    whole, own = psutil.cpu_times(), os.times()
    return whole.user + whole.nice + whole.system + whole.steal - sum(own[:4])


def spread(values: list[float], digits: int = 1) -> str:
    """Return the median, the least and the most as text."""
    return f"{np.median(values):.{digits}f} ({min(values):.{digits}f} to {max(values):.{digits}f})"


def children(pid: int) -> list[int]:
    found = subprocess.run(["ps", "--ppid", str(pid), "-o", "pid=,args="], capture_output=True, text=True, check=False)
    return [int(line.split()[0]) for line in found.stdout.splitlines() if "spreadlets.processes" in line]


def kill_processes(folder: Path, count: int, kills: int, rng: random.Random) -> str:
    """Kill processes of runs of two at random moments, as often as their frames allow."""
    done = runs = wrong = 0
    failed: list[int] = []
    while done < kills:
        run, before, runs = start(folder, "killed", "--jobs", "2"), 0, runs + 1
        while done < kills and run.process.poll() is None:
            time.sleep(rng.uniform(0.0, 1.0))
            workers, now = children(run.process.pid), made(folder, "killed")
            if workers and before + 2 <= now < count - 2:
                os.kill(rng.choice(workers), signal.SIGKILL)
                done, before = done + 1, now
        report, _ = finish(run)
        failed += report.get("failed", [0])
        wrong += differing(folder, "killed", count)
    left = len(list(folder.glob(".*")))
    return (
        f"{done} kills of processes in {runs} runs: failed frames {failed}, frames that differ {wrong}, "
        f"files left over {left}"
    )


@contextmanager
def cluster(folder: Path, workers: int) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """Give the address of a scheduler, its process, and those of its workers."""
    file = folder / "scheduler.json"
    file.unlink(missing_ok=True)
    processes: list[subprocess.Popen[bytes]] = []

    def dask(*arguments: str) -> None:
        command = [sys.executable, "-m", "dask", *arguments, "--scheduler-file", str(file), "--no-dashboard"]
        processes.append(subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL))

    try:
        dask("scheduler", "--host", "127.0.0.1", "--port", "0")
        while not file.exists():
            time.sleep(0.1)
        for _ in range(workers):
            dask("worker", "--nthreads", "1", "--no-nanny")
        yield json.loads(file.read_text())["address"], processes
    finally:
        for process in processes:
            process.kill()
            process.wait()


def kill_cluster(folder: Path, count: int, kills: int, rng: random.Random) -> str:
    """Kill a worker of three and the scheduler in turn; the same command goes on with the next cluster."""
    done, runs, wrong, said = {"worker": 0, "scheduler": 0}, 0, 0, set()
    while min(done.values()) < kills:
        runs += 1
        with cluster(folder, 3) as (address, (scheduler, first, *_)):
            before = made(folder, "there")
            run = start(folder, "there", "--scheduler", address)
            for name, victim in (("worker", first), ("scheduler", scheduler)):
                while run.process.poll() is None and made(folder, "there") <= before:
                    time.sleep(0.02)
                time.sleep(rng.uniform(0.0, 0.5))
                if done[name] < kills and run.process.poll() is None:
                    victim.kill()
                    done[name] += 1
                before = made(folder, "there")
            _, err = finish(run)
            said.add(err)
        if made(folder, "there") == count:
            wrong += differing(folder, "there", count)
    # What is still missing is made without a cluster.
    finish(start(folder, "there"))
    return (
        f"{done['worker']} kills of cluster workers and {done['scheduler']} of the scheduler in {runs} runs of the "
        f"same command: frames that differ {wrong + differing(folder, 'there', count)}; "
        f"said: {' / '.join(sorted(filter(None, said)))}"
    )


def dispatch_s(tasks: int = 500) -> float:
    """Return how long it takes to hand a task out and to take its result, s: those of tasks that do nothing."""
    with open_workers(2, None) as (_, compute):
        list(compute(abs, range(2)))
        begin = time.perf_counter()
        list(compute(abs, range(tasks)))
        return (time.perf_counter() - begin) / tasks


def simulated(seconds: list[float], width: int) -> list[str]:
    """List scheduling of a long shot, from the times of single frames."""
    scale = SHOT_PIXELS / (width * (width * 9 // 16))
    frames, dispatch = scale * np.random.default_rng(0).choice(seconds, SHOT), dispatch_s()
    lines = [
        f"simulated, {SHOT} frames of 1920 x 1080 of {frames.mean():.2f} s each with one thread, {START_S:g} s for a "
        f"worker to start, {1000 * dispatch:.1f} ms to hand a frame out:",
        f"{'workers':>9}{'time s':>9}{'efficiency':>12}",
    ]
    for workers in WORKERS:
        free, asked = [START_S] * workers, 0.0
        for each in frames:
            asked = max(asked, free[0]) + dispatch
            heapq.heapreplace(free, asked + float(each))
        lines.append(f"{workers:>9}{max(free):>9.1f}{frames.sum() / (workers * max(free)):>12.3f}")
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=100)
    parser.add_argument("--width", type=int, default=512)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    if arguments.kills and arguments.frames < LEAST_FRAMES:
        parser.error(f"--frames must be at least {LEAST_FRAMES}: in a shorter shot nothing can be killed in between")
    rng = random.Random(arguments.seed)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        draw_shot(folder, arguments.frames, arguments.width)
        finish(start(folder, "serial"))
        kills = []
        for kill in (kill_processes, kill_cluster):
            kills.append(kill(folder, arguments.frames, arguments.kills, rng))
            print(kills[-1], flush=True)
        lines, seconds = efficiency(folder, arguments.frames, arguments.rounds)
    lines += [*kills, *simulated(seconds, arguments.width)]
    (RESULTS / "farm.txt").write_text("\n".join(lines) + "\n")
    print("\n".join(lines))


if __name__ == "__main__":
    main()
