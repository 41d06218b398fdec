"""Sequences: one job for each frame, made here, by processes of this machine, or by a cluster.

A frame is a task: it depends on its files alone, is written whole or not at all, and is the same whoever makes it.
"""

from __future__ import annotations

import os
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, NamedTuple

from spreadlets.errors import (
    AmbiguousInputWarning,
    InvalidDatabaseError,
    InvalidParameterError,
    SpreadletsError,
    options_spelled,
    spelling,
)
from spreadlets.files.atomic import remove_leftovers
from spreadlets.files.images import check_bit_depth
from spreadlets.files.outputs import check_outputs
from spreadlets.files.sequence import listed, numbered, sequence_frames
from spreadlets.jobs.job import Job
from spreadlets.workers import open_workers

SAME_FOR_ALL_FRAMES = (InvalidParameterError, InvalidDatabaseError)
"""Errors that every other frame would have, too."""


class Frame(NamedTuple):
    """One frame to make."""

    number: int
    job: Job


class FrameResult(NamedTuple):
    """What came of a frame: its report, and what was warned of."""

    report: dict[str, Any]
    doubts: list[str]
    warnings: list[str]


def chosen_frames(job: Job, frames: str | None) -> list[int]:
    """Return which frames of a sequence to make, after checking that no result replaces a file that is read.

    Parameters
    ----------
    job : Job
        Its paths have counters.
    frames : str or None
        Such as ``1-24x2``; by default every number that an input has.

    Raises
    ------
    InvalidFileError, InvalidParameterError
        As `sequence_frames` and `check_outputs` do.

    Warns
    -----
    UserWarning
        If numbers are missing between the first and the last.
    """
    chosen, gaps = sequence_frames(job.inputs, job.others, job.output, frames)
    if gaps:
        warnings.warn(f"the sequence has no frames {listed(gaps)}", stacklevel=2)
    check_bit_depth(job.output, job.bit_depth)
    check_outputs(
        [numbered(path, number) for path in job.writes for number in chosen],
        {numbered(path, number) for path in job.reads for number in chosen},
    )
    return chosen


def run_sequence(
    job: Job,
    numbers: Sequence[int],
    *,
    overwrite: bool = False,
    jobs: int = 1,
    scheduler: str | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> dict[str, Any]:
    """Make a sequence, leaving out what is there already.

    Parameters
    ----------
    job : Job
        Its paths have counters. Results are written whole or not at all, so one that exists is complete.
    numbers : sequence of int
        The frames.
    overwrite : bool
        Make results that exist again.
    jobs : int
        Processes of this machine, which share its threads.
    scheduler : str, optional
        Address of a Dask scheduler, whose workers see the files by the same paths.
    progress : callable
        Called with how many frames are done, and how many there are.

    Returns
    -------
    dict
        ``frames`` (a list of reports, in order, with ``frame``, ``output``, ``skipped``, and ``error`` if it could not
        be made), ``written``, ``skipped``, ``failed`` (the numbers of those that could not), ``total_s``, and
        ``peak_rss_mb``, the most memory that one process took.

    Raises
    ------
    InvalidParameterError, InvalidDatabaseError
        As a frame's job raises them, since every frame would have the same; earlier results stay. Other errors are the
        frame's own, and the others are made. A frame on which one worker after the other dies has failed, too.
    StoppedError
        If the cluster is lost. The same call goes on.
    """
    # Leave out what is there.
    begin = time.perf_counter()
    frames = [Frame(number, job.numbered(number).absolute()) for number in numbers]
    entries: dict[int, dict[str, Any]] = {
        frame.number: {"frame": frame.number, "output": numbered(job.output, frame.number), "skipped": True}
        for frame in frames
        if os.path.isfile(frame.job.output) and not overwrite
    }
    # Make the others, in whatever order workers are done.
    missing = [frame for frame in frames if frame.number not in entries]
    progress(len(entries), len(frames))
    for number, entry in _made(missing, jobs, scheduler):
        entries[number] = {"frame": number, "output": numbered(job.output, number), "skipped": False} | entry
        progress(len(entries), len(frames))
    for folder in {os.path.dirname(path) for frame in missing for path in frame.job.writes}:
        remove_leftovers(folder)
    # Report in the order of the frames.
    reports = [entries[number] for number in numbers]
    skipped = sum(entry["skipped"] for entry in reports)
    failed = [entry["frame"] for entry in reports if "error" in entry]
    counts = {"written": len(reports) - skipped - len(failed), "skipped": skipped, "failed": failed}
    peak = max((entry.get("peak_rss_mb", 0.0) for entry in reports), default=0.0)
    return {"frames": reports} | counts | {"total_s": time.perf_counter() - begin, "peak_rss_mb": peak}


def _made(frames: Sequence[Frame], jobs: int, scheduler: str | None) -> Iterator[tuple[int, dict[str, Any]]]:
    """Yield the number and the report of each frame, or what was wrong with it, in any order; tell of warnings."""
    if not frames:
        return
    doubted = False
    with open_workers(jobs, scheduler) as (_, compute):
        for frame, result in compute(partial(_make, spelling()), frames):
            if isinstance(result, SAME_FOR_ALL_FRAMES):
                raise type(result)(f"frame {frame.number}: {result}") from result
            if isinstance(result, Exception):
                named = "" if isinstance(result, SpreadletsError) else f"{type(result).__name__}: "
                yield frame.number, {"error": f"{named}{result}"}
                continue
            for text in [] if doubted else result.doubts:
                warnings.warn(text, AmbiguousInputWarning, stacklevel=3)
            doubted = doubted or bool(result.doubts)
            for text in result.warnings:
                warnings.warn(f"frame {frame.number}: {text}", stacklevel=3)
            yield frame.number, result.report


def _make(spelled: Callable[[str], str], frame: Frame) -> FrameResult:
    """Make a frame; runs in any process."""
    with options_spelled(spelled), warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        report = frame.job.make()
    doubts = [str(each.message) for each in told if issubclass(each.category, AmbiguousInputWarning)]
    others = [str(each.message) for each in told if not issubclass(each.category, AmbiguousInputWarning)]
    return FrameResult(report, doubts, others)
