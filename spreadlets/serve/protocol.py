"""What a host and the warm process say to each other: a command line one way, its report the other, as JSON.

``POST /run`` takes ``{"arguments": ["synth", "frame.exr", "-o", "out.exr"], "folder": "/shots/7"}``: a command line as
it would be typed in that folder. The answer has its exit ``status``, the ``report`` that it prints with ``--json``, and
the ``messages`` of standard error, the last of which says what was wrong. ``GET /`` tells the version.
"""

from __future__ import annotations

import json
import os
from collections.abc import Collection
from typing import Any, NamedTuple

from spreadlets.errors import SpreadletsError

MOST_BYTES = 1 << 18
"""Largest request, 256 KB: a command line of the longest paths; files are named, and not sent."""
MOST_ARGUMENTS = 1000


class RefusedError(SpreadletsError):
    """A request that is not answered; `status` is that of HTTP."""

    def __init__(self, status: int, message: str) -> None:
        super().__init__(message)
        self.status = status


class Request(NamedTuple):
    """A command line, and the folder where it is typed."""

    arguments: list[str]
    folder: str


class Answer(NamedTuple):
    """What came of a command."""

    status: int
    report: Any
    messages: list[str]


def parse_request(body: bytes, commands: Collection[str]) -> Request:
    """Return what a request asks for.

    Parameters
    ----------
    body : bytes
    commands : collection of str
        The commands that may be run.

    Raises
    ------
    RefusedError
        If it is damaged, or asks for something else.

    Examples
    --------
    >>> from spreadlets.serve.protocol import parse_request
    >>> parse_request(b'{"arguments": ["compare", "a.exr", "b.exr"], "folder": "/"}', ["compare"]).folder
    '/'
    """
    try:
        content = json.loads(body)
    except (ValueError, RecursionError):
        raise RefusedError(400, "the request is not JSON") from None
    if not isinstance(content, dict) or set(content) != {"arguments", "folder"}:
        raise RefusedError(400, 'the request must be {"arguments": [...], "folder": "..."}')
    arguments, folder = content["arguments"], content["folder"]
    if not isinstance(arguments, list) or not all(_is_text(each) for each in arguments):
        raise RefusedError(400, "arguments must be a list of texts")
    if not 0 < len(arguments) <= MOST_ARGUMENTS or arguments[0] not in commands:
        raise RefusedError(400, f"the first of at most {MOST_ARGUMENTS} arguments must be one of {', '.join(commands)}")
    if not _is_text(folder) or not os.path.isabs(folder) or not os.path.isdir(folder):
        raise RefusedError(400, "folder must be the whole path of one that exists")
    return Request(arguments, folder)


def _is_text(value: Any) -> bool:
    """Tell whether a value is a text that can be an argument of a program."""
    if not isinstance(value, str) or "\0" in value:
        return False
    try:
        os.fsencode(value)
    except UnicodeError:
        return False
    return True
