"""Numbered sequences of files: patterns such as ``frame.####.exr`` or ``frame.%04d.exr``, and frame by frame runs."""

from __future__ import annotations

import glob
import os
import re
import time
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from spreadlets.errors import InvalidFileError, InvalidFrameError, InvalidParameterError, SpreadletsError

COUNTER = re.compile(r"#+|@+|%0(\d+)d|%d|\$F(\d*)")
"""What stands for the frame's number: one ``#`` or ``@`` per digit, or as in C or Houdini."""

MAX_FRAMES = 1_000_000
"""Longest sequence, eleven hours at 24 frames a second: a slip of the keyboard should not fill memory."""

NAMED_FRAMES = 20
"""How many missing numbers an error lists."""


def is_pattern(path: str) -> bool:
    """Tell whether a path stands for a sequence: it has a counter, and is not the name of a file."""
    return bool(_counters(path))


def numbered(pattern: str, number: int) -> str:
    """Return the path of one frame: its number in place of each counter; a path without is the same for all."""
    parts, end = [], 0
    for counter in _counters(pattern):
        parts += [pattern[end : counter.start()], f"{number:0{_digits(counter)}d}"]
        end = counter.end()
    return "".join(parts) + pattern[end:]


def parse_frames(text: str) -> list[int]:
    """Return the frame numbers that a list of numbers and ranges names.

    Parameters
    ----------
    text : str
        Such as ``1-24``, ``1-24x2`` (every second), ``1,5,9-12``, or ``-10--1``.

    Returns
    -------
    list of int
        Ascending, each once.

    Raises
    ------
    InvalidParameterError
        If the text is no such list, or names too many frames.
    """
    numbers: set[int] = set()
    for item in text.split(","):
        found = re.fullmatch(r"\s*(-?\d{1,9})(?:-(-?\d{1,9})(?:x(\d{1,9}))?)?\s*", item)
        if found is None or found[3] is not None and int(found[3]) == 0:
            raise InvalidParameterError(f"frames is {text!r}; it must be like 1-24, 1-24x2 or 1,5,9-12")
        first, last = int(found[1]), int(found[2] or found[1])
        if last < first:
            raise InvalidParameterError(f"frames names the range {item.strip()}, which ends before it begins")
        chosen = range(first, last + 1, int(found[3] or 1))
        if len(numbers) + len(chosen) > MAX_FRAMES:
            raise InvalidParameterError(f"frames names more than {MAX_FRAMES} frames")
        numbers.update(chosen)
    return sorted(numbers)


def existing_frames(pattern: str) -> list[int]:
    """Return the numbers of a pattern's files that exist, ascending."""
    first, *_ = counters = _counters(pattern)
    ends = [counter.end() for counter in counters]
    begins = [*(counter.start() for counter in counters[1:]), len(pattern)]
    between = [pattern[end:begin] for end, begin in zip(ends, begins, strict=True)]
    before = pattern[: first.start()]
    found = re.compile(re.escape(before) + r"(-?\d+)" + r"-?\d+".join(map(re.escape, between)))
    names = glob.glob(glob.escape(before) + "*" + "*".join(map(glob.escape, between)))
    numbers = {int(match[1]) for match in map(found.fullmatch, names) if match}
    return sorted(number for number in numbers if os.path.exists(numbered(pattern, number)))


def sequence_frames(
    inputs: Sequence[str], others: Sequence[str], output: str, frames: str | None
) -> tuple[list[int], list[int]]:
    """Return which frames to make, after checking that their files are there.

    Parameters
    ----------
    inputs : sequence of str
        Patterns, at least one; paths without a counter are the same for every frame.
    others : sequence of str
        Further files or patterns that every frame needs, which do not decide what frames there are.
    output : str
        Pattern of the results.
    frames : str or None
        As for `parse_frames`; by default every number that an input has.

    Returns
    -------
    numbers : list of int
        Ascending.
    gaps : list of int
        Numbers between the first and the last that no input has, if no frames were named.

    Raises
    ------
    InvalidFileError
        If an input lacks a frame; the message names the numbers.
    InvalidParameterError
        If the output has no counter, or the frames cannot be parsed.
    """
    patterns = [path for path in inputs if is_pattern(path)]
    if not is_pattern(output):
        raise InvalidParameterError(f"the output {output} needs a counter, such as ####, as the frames have one")
    if frames is not None:
        numbers = parse_frames(frames)
    else:
        numbers = sorted(set().union(*(existing_frames(pattern) for pattern in patterns)))
        if not numbers:
            raise InvalidFileError(f"{patterns[0]}: no such frames exist")
    for path in [*inputs, *others]:
        missing = [number for number in numbers if not os.path.isfile(numbered(path, number))]
        if missing:
            raise InvalidFileError(f"{path}: {len(missing)} frames are missing: {listed(missing)}")
    gaps = sorted(set(range(numbers[0], numbers[-1])) - set(numbers)) if frames is None else []
    return numbers, gaps


def run_sequence(
    numbers: Sequence[int],
    output: str,
    make: Callable[[int, str], dict[str, Any]],
    *,
    overwrite: bool = False,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> dict[str, Any]:
    """Make a sequence frame by frame, leaving out what is there already.

    Parameters
    ----------
    numbers : sequence of int
        The frames.
    output : str
        Pattern of the results. Results are written whole or not at all, so one that exists is complete.
    make : callable
        Called with a number and the path to write; returns a report.
    overwrite : bool
        Make results that exist again.
    progress : callable
        Called with how many frames are done, and how many there are.

    Returns
    -------
    dict
        ``frames`` (a list of reports with ``frame``, ``output`` and ``skipped``, and ``error`` if it failed),
        ``written``, ``skipped``, ``failed`` (the numbers of frames whose files or pixels are bad) and ``total_s``.

    Raises
    ------
    SpreadletsError
        Of another kind than bad files and pixels, as `make` raises it; the message says which frame. Earlier results
        stay.
    """
    begin = time.perf_counter()
    reports = []
    progress(0, len(numbers))
    for index, number in enumerate(numbers):
        path = numbered(output, number)
        done = os.path.isfile(path) and not overwrite
        entry: dict[str, Any] = {"frame": number, "output": path, "skipped": done}
        if not done:
            try:
                entry |= make(number, path)
            except (InvalidFileError, InvalidFrameError) as error:
                entry["error"] = str(error)
            except SpreadletsError as error:
                raise type(error)(f"frame {number}: {error}") from error
        reports.append(entry)
        progress(index + 1, len(numbers))
    skipped = sum(entry["skipped"] for entry in reports)
    failed = [entry["frame"] for entry in reports if "error" in entry]
    written = len(reports) - skipped - len(failed)
    figures = {"written": written, "skipped": skipped, "failed": failed, "total_s": time.perf_counter() - begin}
    return {"frames": reports, **figures}


def listed(numbers: Iterable[int]) -> str:
    """Return numbers as runs, such as ``3, 7-9``."""
    runs: list[list[int]] = []
    for number in numbers:
        if runs and number == runs[-1][1] + 1:
            runs[-1][1] = number
        else:
            runs.append([number, number])
    shown = [f"{first}-{last}" if last > first else str(first) for first, last in runs[:NAMED_FRAMES]]
    return ", ".join(shown) + (", ..." if len(runs) > NAMED_FRAMES else "")


def _counters(path: str) -> list[re.Match[str]]:
    """Return the counters of a path; what is the name of a folder or file that exists has none."""
    if os.path.exists(path):
        return []
    folder = os.path.dirname(path)
    while folder and not os.path.isdir(folder):
        folder = os.path.dirname(folder)
    return list(COUNTER.finditer(path, len(folder)))


def _digits(counter: re.Match[str]) -> int:
    if counter[0][0] in "#@":
        return len(counter[0])
    return int(counter[1] or counter[2] or 1)
