"""Numbered sequences of files: patterns such as ``frame.####.exr`` or ``frame.%04d.exr``."""

from __future__ import annotations

import glob
import os
import re
from collections.abc import Iterable, Sequence

from spreadlets.errors import InvalidFileError, InvalidParameterError, option

COUNTER = re.compile(r"#+|@+|%(?:0\d+)?d|\$F\d*")
"""What stands for the frame's number: one ``#`` or ``@`` for each digit, or as in C or in Houdini."""

NAME = re.compile(f"[^{re.escape(os.sep + (os.altsep or ''))}]+")
"""A folder's or a file's name in a path."""

MAX_FRAMES = 1_000_000
"""Longest sequence, eleven hours at 24 frames a second: a slip of the keyboard should not fill memory."""

NAMED_FRAMES = 20
"""How many missing numbers an error lists."""


def is_pattern(path: str) -> bool:
    """Tell whether a path stands for a sequence: it has a counter, and is not the name of a file.

    Examples
    --------
    >>> is_pattern("shot.####.exr"), is_pattern("####_beauty.exr"), is_pattern("shot.exr")
    (True, True, False)
    """
    return bool(_counters(path))


def numbered(pattern: str, number: int) -> str:
    """Return the path of one frame; a path without a counter is the same for all.

    Examples
    --------
    >>> numbered("shot.####.exr", 7), numbered("shot.%d.exr", -3), numbered("shot.$F3.exr", 7)
    ('shot.0007.exr', 'shot.-3.exr', 'shot.007.exr')
    """
    counters = _counters(pattern)
    if not counters:
        return pattern
    # It takes a tenth of a second to import, which a single file need not wait for.
    from fileseq.constants import PAD_STYLE_HASH1
    from fileseq.filesequence import FileSequence
    from fileseq.utils import pad

    text, end = "", 0
    for counter in counters:
        digits = FileSequence.getPaddingNum(counter[0], pad_style=PAD_STYLE_HASH1)
        text += pattern[end : counter.start()] + pad(number, digits)
        end = counter.end()
    return text + pattern[end:]


def _counters(path: str) -> list[re.Match[str]]:
    """Return the counters of a path: the last in the file's name, and in the names of folders that do not exist.

    What looks like another is a part of the name, and what is the name of a file or folder has none.
    """
    if os.path.exists(path):
        return []
    folder = os.path.dirname(path)
    while folder and not os.path.isdir(folder):
        folder = os.path.dirname(folder)
    names = NAME.finditer(path, len(folder))
    return [each for name in names for each in list(COUNTER.finditer(path, *name.span()))[-1:]]


def parse_frames(text: str) -> list[int]:
    """Return the frame numbers that a list of numbers and ranges names.

    Parameters
    ----------
    text : str
        Such as ``1-24``, ``1-24x2`` (every second), ``-5-10``, or ``1,5,9-12``.

    Returns
    -------
    list of int
        Ascending, each once.

    Raises
    ------
    InvalidParameterError
        If the text is no such list, or names too many frames.

    Examples
    --------
    >>> parse_frames("1-9x4,-2")
    [-2, 1, 5, 9]
    """
    from fileseq.exceptions import MaxSizeException, ParseException
    from fileseq.frameset import FrameSet

    try:
        frames = FrameSet(text)
    except MaxSizeException:
        raise InvalidParameterError(f"frames names more than {MAX_FRAMES} frames") from None
    except ParseException:
        frames = FrameSet("")
    if not len(frames) or any(number != int(number) for number in frames):
        raise InvalidParameterError(f"{option('frames')} is {text!r}; it must be like 1-24, 1-24x2 or 1,5,9-12")
    if len(frames) > MAX_FRAMES:
        raise InvalidParameterError(f"frames names more than {MAX_FRAMES} frames")
    return sorted(int(number) for number in frames)


def existing_frames(pattern: str) -> list[int]:
    """Return the numbers of a pattern's files that exist, ascending."""
    ends = [(counter.start(), counter.end()) for counter in _counters(pattern)]
    begins = [0, *(end for _, end in ends)]
    texts = [
        pattern[begin:end] for begin, end in zip(begins, [*(start for start, _ in ends), len(pattern)], strict=True)
    ]
    found = re.compile(r"(-?\d+)".join(map(re.escape, texts)))
    matches = map(found.fullmatch, glob.glob("*".join(map(glob.escape, texts))))
    numbers = {int(match[1]) for match in matches if match and len(match.groups())}
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
        If no frame has all its files; the message names one that lacks and its numbers.
    InvalidParameterError
        If the output has no counter or would replace an input, or the frames cannot be parsed.
    """
    # Find the numbers that are asked for, or that exist.
    patterns = [path for path in inputs if is_pattern(path)]
    if not is_pattern(output):
        raise InvalidParameterError(f"the output {output} needs a counter, such as ####, as the frames have one")
    if frames is not None:
        numbers = parse_frames(frames)
    else:
        numbers = sorted(set().union(*(existing_frames(pattern) for pattern in patterns)))
        if not numbers:
            raise InvalidFileError(f"{patterns[0]}: no such frames exist")
    # Leave out frames that lack a file, unless all do.
    lacking: set[int] = set()
    for path in [*inputs, *others]:
        missing = [number for number in numbers if not os.path.isfile(numbered(path, number))]
        lacking.update(missing)
        if len(lacking) == len(numbers):
            raise InvalidFileError(f"{path}: {len(missing)} frames are missing: {listed(missing)}")
    # Refuse to replace an input.
    if os.path.realpath(numbered(output, numbers[0])) in {os.path.realpath(numbered(p, numbers[0])) for p in inputs}:
        raise InvalidParameterError(f"the output {output} would replace the frames that are read")
    gaps = sorted(set(range(numbers[0], numbers[-1])) - set(numbers)) if frames is None else []
    return numbers, gaps


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
