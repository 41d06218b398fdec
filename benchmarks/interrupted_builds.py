"""Builds cut short: killed at random moments, on a full disk, in a read-only folder, by a dead worker, in pairs.

After every one of them the same command must go on, and give a database that equals an uninterrupted one, dataset by
dataset. A child process builds; this one kills it (SIGKILL), 200 times by default, and now and then lets it end.

    python benchmarks/interrupted_builds.py [--kills 200] [--seed 0]

Full disk and read-only folder need the right to mount a small file system, and are left out without it. The results go
to benchmarks/results/interrupted_builds.txt.
"""

import argparse
import json
import multiprocessing
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import h5py
import numpy as np

from spreadlets.precompute.build.build import build_database

RESULTS = Path(__file__).parent / "results"

CASE = {"samples": 40, "max_coc": 6.0, "max_motion": 6.0, "rays": 30_000, "seed": 5}
"""A model of some cells that are built in moments."""

ROOM_FOR_ONE = 5
"""Pages of 4 KiB that the last cell and the log take, at most."""

CHILD = """
import json, sys, time
from spreadlets.precompute.build.build import build_database
from spreadlets.errors import SpreadletsError
case = json.loads(sys.argv[2])
delay = case.pop("delay", 0.0)
print("go", flush=True)
def report(done, total, left):
    print(done, flush=True)
    time.sleep(delay)
try:
    build_database("combined", sys.argv[1], progress=report, **case)
except SpreadletsError as error:
    sys.exit(f"{type(error).__name__}: {error}")
"""


def start(path: Path, **changes: object) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", CHILD, str(path), json.dumps(CASE | changes)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def finish(path: Path, **changes: object) -> tuple[int, str]:
    """Build to the end; return the exit status and what it said."""
    process = start(path, **changes)
    _, said = process.communicate()
    return process.returncode, said.strip()


def same(one: Path, other: Path) -> bool:
    """Compare two databases, dataset by dataset and attribute by attribute; the time that building took may differ."""
    with h5py.File(one) as a, h5py.File(other) as b:
        if set(a) != set(b) or set(a.attrs) != set(b.attrs):
            return False
        provenance = [json.loads(file["provenance"][...].tobytes()) | {"build_s": 0} for file in (a, b)]
        tables = all(np.array_equal(a[name], b[name]) for name in a if name != "provenance")
        return (
            tables and provenance[0] == provenance[1] and all(np.array_equal(a.attrs[n], b.attrs[n]) for n in a.attrs)
        )


def n_parts(path: Path) -> int:
    return len(list(path.with_name(path.name + ".parts").glob("*.part")))


def kills(folder: Path, reference: Path, count: int, seed: int) -> list[str]:
    """Kill builds of one file at random moments after 0 to 11 more cells; when one ends by itself, compare, begin anew.

    The builds are forks of this process, which has loaded all that they need and computed nothing.
    """
    rng = np.random.default_rng(seed)
    fork = multiprocessing.get_context("fork")
    path, killed, ended, lost, wrong, parts, finished = folder / "killed.h5", 0, 0, 0, 0, 0, 0
    while killed < count:
        process = fork.Process(target=build_database, args=("combined", path), kwargs=CASE | {"jobs": 1})
        process.start()
        more = parts + int(rng.integers(0, 12))
        while process.is_alive() and n_parts(path) < more:
            time.sleep(0.001)
        process.join(float(rng.exponential(0.05)))
        process.kill()
        process.join()
        if process.exitcode == -signal.SIGKILL:
            killed += 1
            now = n_parts(path)
            lost += now < parts and not path.exists()
            finished += max(now - parts, 0)
            parts = now
            if killed % 20 == 0:
                print(f"{killed} killed, {ended} came to their end, {wrong} differ", flush=True)
            continue
        if process.exitcode:
            return [f"kills: a build failed after {killed} kills"]
        ended += 1
        wrong += not same(path, reference)
        path.unlink()
        parts = 0
    status, _ = finish(path, jobs=1)
    wrong += bool(status) or not same(path, reference)
    left = sorted(each.name for each in folder.iterdir() if each.name.startswith((".killed", "killed.h5.")))
    return [
        f"killed {killed} builds, which had finished {finished} cells; {ended + 1} came to their end between kills: "
        f"{wrong} of them differ from the uninterrupted one",
        f"finished cells lost by a kill: {lost}; files left over: {', '.join(left) or 'none'}",
    ]


@contextmanager
def small_disk(folder: Path, options: str) -> Iterator[Path | None]:
    """Mount a small file system in memory; None if that is not allowed."""
    place = folder / "disk"
    place.mkdir()
    mount = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(place)], capture_output=True, check=False
    )
    try:
        yield place if mount.returncode == 0 else None
    finally:
        if mount.returncode == 0:
            subprocess.run(["umount", str(place)], check=True)
        place.rmdir()


def stop_at(path: Path, cells: int) -> None:
    """Kill a build as soon as so many cells are finished."""
    process = start(path, jobs=1, delay=0.05)
    assert process.stdout is not None
    while process.stdout.readline().strip() != str(cells):
        pass
    process.send_signal(signal.SIGKILL)
    process.communicate()


def full_disk(folder: Path, reference: Path) -> list[str]:
    """Build where there is room for some parts only, then for all parts but not the database, then for all."""
    filler = bytes(1 << 12)
    lines = []
    with small_disk(folder, "size=64k") as disk:
        if disk is None:
            return ["full disk: left out, mounting is not allowed here"]
        path = disk / "full.h5"
        for size in ("64k", "180k", "4m with a filler", "4m"):
            subprocess.run(["mount", "-o", f"remount,size={size.split()[0]}", str(disk)], check=True)
            if "filler" in size:
                stop_at(path, CASE["samples"] - 1)
                room = os.statvfs(disk).f_bavail * os.statvfs(disk).f_frsize
                (disk / "filler").write_bytes(filler * (room // len(filler) - ROOM_FOR_ONE))
            else:
                (disk / "filler").unlink(missing_ok=True)
            before = n_parts(path) if path.with_name("full.h5.parts").exists() else 0
            status, said = finish(path, jobs=1)
            after = n_parts(path) if status else CASE["samples"]
            outcome = said if status else f"complete, equal: {same(path, reference)}"
            lines.append(f"disk of {size}: {before} cells stored before, {after} after; {outcome}")
            left = [each.name for each in disk.iterdir() if each.name not in ("full.h5", "full.h5.parts", "filler")]
            lines += [f"left over: {left}"] if left else []
    return lines


def read_only(folder: Path, reference: Path) -> list[str]:
    """Build into a folder that cannot be written, half way too, and then can."""
    with small_disk(folder, "size=4m") as disk:
        if disk is None:
            return ["read-only folder: left out, mounting is not allowed here"]
        path = disk / "a.h5"
        stop_at(path, 8)
        before = n_parts(path)
        subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True)
        said = finish(path, jobs=1)[1], finish(disk / "b.h5", jobs=1)[1]
        subprocess.run(["mount", "-o", "remount,rw", str(disk)], check=True)
        kept = n_parts(path)
        status, _ = finish(path, jobs=1)
        return [
            f"read-only folder with {before} cells: {said[0]}",
            f"read-only folder, new file: {said[1]}",
            f"writable again: {kept} cells are there; complete, equal: {not status and same(path, reference)}",
        ]


def children(pid: int) -> list[int]:
    found = subprocess.run(["ps", "--ppid", str(pid), "-o", "pid=,args="], capture_output=True, text=True, check=False)
    return [
        int(line.split()[0]) for line in found.stdout.splitlines() if "spreadlets.processes" in line or "loky" in line
    ]


def dead_worker(folder: Path, reference: Path) -> list[str]:
    """Kill a worker process in the middle of a build."""
    path = folder / "worker.h5"
    process = start(path, jobs=2, delay=0.1)
    assert process.stdout is not None
    while process.stdout.readline().strip() != "5":
        pass
    workers = [
        pid for pid in children(process.pid) if "resource_tracker" not in Path(f"/proc/{pid}/cmdline").read_text()
    ]
    os.kill(workers[0], signal.SIGKILL)
    said = process.communicate()[1].strip() or "another took its place"
    kept = n_parts(path)
    status, _ = finish(path, jobs=1)
    return [f"worker killed: {said}", f"{kept} cells kept; complete, equal: {not status and same(path, reference)}"]


def two_at_once(folder: Path, reference: Path) -> list[str]:
    """Start two builds of one file at the same time, several times."""
    lines = set()
    wins = []
    for _ in range(5):
        path = folder / "both.h5"
        pair = [start(path, jobs=1, delay=0.1) for _ in range(2)]
        said = [each.communicate()[1].strip() for each in pair]
        wins.append(sum(each.returncode == 0 for each in pair))
        lines |= {text.replace(str(folder), "...").split(" (")[0] for text in said if text}
        if not same(path, reference):
            lines.add("the database differs")
        path.unlink()
    return [f"two builds into one file, 5 times: {wins} of them won; the others: {'; '.join(sorted(lines))}"]


def orphans(folder: Path) -> list[str]:
    """Kill a building process only, and see its workers leave."""
    process = start(folder / "orphan.h5", jobs=2, delay=0.1)
    assert process.stdout is not None
    while process.stdout.readline().strip() != "3":
        pass
    workers = children(process.pid)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    begin = time.monotonic()
    while any(Path(f"/proc/{pid}").exists() for pid in workers) and time.monotonic() - begin < 60:
        time.sleep(0.1)
    gone = not any(Path(f"/proc/{pid}").exists() for pid in workers)
    return [f"workers of a killed build: {len(workers)}, all gone after {time.monotonic() - begin:.1f} s: {gone}"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    lines = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        reference = folder / "reference.h5"
        status, said = finish(reference, jobs=1)
        if status:
            raise SystemExit(said)
        lines += kills(folder, reference, arguments.kills, arguments.seed)
        for study in (full_disk, read_only, dead_worker, two_at_once):
            print("\n".join(lines), flush=True)
            lines += study(folder, reference)
        lines += orphans(folder)
    print("\n".join(lines))
    text = "\n".join(lines).replace(name, "...")
    (RESULTS / "interrupted_builds.txt").write_text(text + "\n")


if __name__ == "__main__":
    main()
