"""The benchmark: error against run time of every method and knob, in turns and resumable, as CSV, plots and a page."""

from __future__ import annotations

import csv
import hashlib
import json
import math
import os
import platform
import shutil
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numba

from spreadlets import metrics
from spreadlets.arrays import Image
from spreadlets.errors import InvalidParameterError
from spreadlets.packages import optional_package
from spreadlets.parallel import thread_count
from spreadlets.psf.database import open_database
from spreadlets.reports.bench.contenders import Contender, contenders, recorded
from spreadlets.reports.bench.page import save_page, save_pictures
from spreadlets.reports.bench.plot import save_plots
from spreadlets.reports.bench.rows import METRICS, Row, front, panels
from spreadlets.reports.bench.subjects import Subject
from spreadlets.reports.demo import DATABASE

ROUNDS, QUICK_ROUNDS = 5, 3
MOST_SECONDS, QUICK_MOST_SECONDS = 30.0, 4.0
"""A contender that has taken so long is not timed again: three dense images, say, where others are timed five times."""
FEWEST_RUNS = 2
PACKAGES = (".", "runtime", "precompute")
DATABASES = "databases"
"""Folder of the databases that are built for the frames."""

Progress = Callable[[int, int], None]


class Notebook:
    """The rows measured so far, kept in ``progress.json`` so that an interrupted run goes on; others' are dropped."""

    def __init__(self, folder: Path, conditions: dict[str, Any], *, fresh: bool) -> None:
        self.path, self.conditions = folder / "progress.json", conditions
        self.rows: dict[str, Row] = {}
        if not fresh and self.path.exists():
            kept = json.loads(self.path.read_text())
            if kept["conditions"] == conditions:
                self.rows = {row["key"]: Row(**{k: v for k, v in row.items() if k != "key"}) for row in kept["rows"]}

    def row(self, frame: str, contender: Contender) -> Row:
        """Return the row of a contender, a new one if it has none."""
        made = Row(frame, contender.task, contender.source, contender.method, contender.knob)
        return self.rows.setdefault(made.key, made)

    def save(self) -> None:
        """Write what is known."""
        rows = [{"key": key} | asdict(row) for key, row in self.rows.items()]
        temporary = self.path.with_suffix(".tmp")
        temporary.write_text(json.dumps({"conditions": self.conditions, "rows": rows}))
        os.replace(temporary, self.path)


def conditions(quick: bool) -> dict[str, Any]:
    """Return what figures depend on: the machine, the versions, the source and the database."""
    # Hash the source, except for the reports.
    root = Path(__file__).resolve().parents[2]
    digest = hashlib.sha256()
    for package in PACKAGES:
        for path in sorted((root / package).rglob("*.py")):
            if "reports" not in path.parts:
                digest.update(path.read_bytes())
    with open_database(DATABASE) as database:
        size = database.path.stat().st_size
    return {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "threads": thread_count(),
        "python": platform.python_version(),
        "numba": numba.__version__,
        "source": digest.hexdigest()[:12],
        "database_bytes": size,
        "quick": quick,
    }


def _processor() -> str:
    """Return the processor's name."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


def run_bench(
    subjects: Sequence[Subject],
    folder: str | os.PathLike[str],
    *,
    quick: bool = False,
    fresh: bool = False,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Run every contender on every frame, in turns, and write ``bench.csv``, the plots and ``bench.html``.

    They are written after each frame, of what there is by then.

    Parameters
    ----------
    subjects : sequence of Subject
    folder : path-like
        Made if need be. What is measured is kept there at once: the same command goes on where it was interrupted.
    quick : bool
        Fewer contenders and rounds: within two minutes.
    fresh : bool
        Forget what was measured before.
    progress : callable, optional
        Called with the number of steps done and of all.

    Returns
    -------
    dict
        ``rows`` (list of dict), ``summary`` (list of str), ``conditions``, ``written_to``.

    Raises
    ------
    InvalidParameterError
        If there is no frame, or the folder cannot be written to.
    MissingPackageError
        If the packages for FLIP or plots are missing (extras ``metrics`` and ``plot``).
    """
    optional_package("flip_evaluator", "bench", "a benchmark")
    optional_package("matplotlib", "bench", "a benchmark")
    if not subjects:
        raise InvalidParameterError("there is no frame to run on: give --frame, --camera and --reference, or a folder")
    output = Path(folder)
    try:
        (output / "pictures").mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InvalidParameterError(f"cannot write to {str(output)!r}: {error}") from error
    notebook = Notebook(output, conditions(quick), fresh=fresh)
    if not notebook.rows:
        # They hold what frames needed when they were built.
        shutil.rmtree(output / DATABASES, ignore_errors=True)
    rounds = QUICK_ROUNDS if quick else ROUNDS
    done, names, report = 0, [], {}
    for subject in subjects:
        listed = list(contenders(subject, output / DATABASES, quick=quick))
        total = len(subjects) * len(listed) * (rounds + 1)

        def step(total: int = total) -> None:
            nonlocal done
            done += 1
            if progress:
                progress(done, max(total, done))

        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            _first_runs(subject, listed, notebook, output / "pictures", step)
            _timed_runs(subject, listed, notebook, rounds, QUICK_MOST_SECONDS if quick else MOST_SECONDS, step)
        subject.close()
        names.append(subject.name)
        # What this run was not asked for is no part of its report.
        report = _report([row for row in notebook.rows.values() if row.frame in names], output, notebook.conditions)
    return report


def _first_runs(
    subject: Subject, listed: Sequence[Contender], notebook: Notebook, pictures: Path, step: Callable[[], None]
) -> None:
    """Run every contender once, which compiles and traces what it needs, and take its errors."""
    for contender in listed:
        row = notebook.row(subject.name, contender)
        if math.isnan(row.ssim) and not row.note:
            try:
                image = _image(subject, contender, row)
                figures = {} if image is None else metrics.compare(image, subject.reference)
            except (ValueError, RuntimeError, OSError, MemoryError) as error:
                row.note, image = f"{type(error).__name__}: {' '.join(str(error).split())}"[:300], None
            if image is not None:
                row.ssim, row.flip, row.psnr, row.relmse = (figures[name] for name in METRICS)
                save_pictures(pictures, row.key, image, subject.reference)
            notebook.save()
        step()


def _image(subject: Subject, contender: Contender, row: Row) -> Image | None:
    """Return the image of a contender; note what is missing, and times that are recorded."""
    row.note = contender.missing
    if contender.make is not None:
        return contender.make()
    if contender.source == "render":
        image, seconds = recorded(subject, contender)
        row.runs_s = [] if seconds is None else [seconds]
        return image
    return None


def _timed_runs(
    subject: Subject,
    listed: Sequence[Contender],
    notebook: Notebook,
    rounds: int,
    most: float,
    step: Callable[[], None],
) -> None:
    """Time every contender, one after the other, round by round."""
    for number in range(rounds):
        for contender in listed:
            row = notebook.row(subject.name, contender)
            enough = len(row.runs_s) >= FEWEST_RUNS and sum(row.runs_s) > most
            if contender.make is not None and not math.isnan(row.ssim) and len(row.runs_s) <= number and not enough:
                begin = time.perf_counter()
                image = contender.make()
                elapsed = time.perf_counter() - begin
                # A process of its own says how long its work took, without its start.
                row.runs_s.append(float(getattr(image, "seconds", elapsed)))
                notebook.save()
            step()


def _report(rows: list[Row], output: Path, found: dict[str, Any]) -> dict[str, Any]:
    lines = summary(rows, found)
    write_csv(output / "bench.csv", rows)
    (output / "bench.txt").write_text("\n".join(lines) + "\n")
    plots = save_plots(output, rows)
    save_page(output, rows, lines, plots)
    figures = [
        {name: value for name, value in asdict(row).items() if name != "runs_s"}
        | {"seconds": row.seconds, "seconds_low": row.spread[0], "seconds_high": row.spread[1], "runs": len(row.runs_s)}
        for row in rows
    ]
    return {"rows": figures, "summary": lines, "conditions": found, "written_to": str(output)}


COLUMNS = (
    *("frame", "task", "input", "method", "knob", *METRICS),
    *("seconds", "seconds_low", "seconds_high", "runs", "on_front_of", "note"),
)


def write_csv(path: Path, rows: Sequence[Row]) -> None:
    """Write all rows, with the metrics by which each is on the front of what it can be compared with."""
    on: dict[str, list[str]] = {}
    for group in panels(rows).values():
        for metric in METRICS:
            for row in front(group, metric):
                on.setdefault(row.key, []).append(metric)
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(COLUMNS)
        for row in rows:
            errors = [f"{getattr(row, metric):.6g}" for metric in METRICS]
            times = [f"{value:.4g}" for value in (row.seconds, *row.spread)]
            named = row.frame, row.task, row.source, row.method, row.knob
            writer.writerow([*named, *errors, *times, len(row.runs_s), " ".join(on.get(row.key, [])), row.note])


def summary(rows: Sequence[Row], found: dict[str, Any]) -> list[str]:
    """Return what the figures say, for people."""
    machine = f"{found['processor']}, {found['threads']} threads"
    lines = [f"Error against run time, {machine}; seconds are medians (fastest to slowest run)."]
    for (frame, task, source), group in panels(rows).items():
        lines += ["", f"{frame}, {task} from {source}: the front by SSIM, fastest first"]
        lines += [f"  {text_of(row)}" for row in front(group, "ssim")]
        lines += [f"  {verdict}" for verdict in verdicts(group)]
    renders = [row for row in rows if row.source == "render"]
    if renders:
        lines += ["", "Plain Monte Carlo renders"]
        lines += [f"  {row.frame}, {text_of(row)}" for row in renders]
    missing = dict.fromkeys(f"{row.task}, {row.name}: {row.note}" for row in rows if row.note)
    if missing:
        lines += ["", "Left out, or without a time", *(f"  {each}" for each in missing)]
    return lines


def text_of(row: Row) -> str:
    """Return a row as a line of text."""
    errors = f"SSIM {row.ssim:.4f}  FLIP {row.flip:.4f}  PSNR {row.psnr:5.2f}  relMSE {row.relmse:.2e}"
    low, high = row.spread
    times = f"{row.seconds:8.3f} s ({low:.3f} to {high:.3f})" if row.runs_s else "     no time"
    return f"{row.name:<34} {times:<30} {errors}"


def verdicts(group: Sequence[Row]) -> list[str]:
    """Say for each metric whether spreadlets are on the front, and if not, what is faster and better."""
    lines = []
    for metric, sign in METRICS.items():
        ours = [row for row in front(group, metric) if row.method == "spreadlets"]
        mine = [row for row in group if row.method == "spreadlets" and row.measured]
        if ours:
            lines.append(f"{metric}: spreadlets is on the front ({', '.join(row.knob for row in ours)})")
        elif mine:
            best = max(mine, key=lambda row: sign * getattr(row, metric))
            better = [row for row in group if row.measured and row.method != "spreadlets" and beats(row, best, metric)]
            names = ", ".join(row.name for row in better)
            lines.append(f"{metric}: spreadlets is NOT on the front; faster and no worse than its best: {names}")
    return lines


def beats(row: Row, other: Row, metric: str) -> bool:
    """Say whether a row is no slower and no worse than another."""
    sign = METRICS[metric]
    return row.seconds <= other.seconds and sign * getattr(row, metric) >= sign * getattr(other, metric)
