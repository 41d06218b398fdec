"""The exception hierarchy: every refusal of bad input is one of these; and how messages spell the names of options."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar


class SpreadletsError(ValueError):
    """Base of all errors that the caller can mend; the message says what was given and what is allowed."""


class InvalidFrameError(SpreadletsError):
    """A frame's or a sample buffer's arrays are unusable: wrong shape, non-finite values, negative depth."""


class InvalidCameraError(SpreadletsError):
    """A camera is impossible (zero focal length, focus inside the focal length) or its file is malformed."""


class InvalidFileError(SpreadletsError):
    """An image file cannot be read as what it should be, or lacks a channel."""


class InvalidDatabaseError(SpreadletsError):
    """A spreadlet database is truncated, malformed, or of another version."""


class LeftOutError(InvalidDatabaseError):
    """Spreadlets are needed that were left out of a database, which was built for certain frames only.

    Attributes
    ----------
    places : list of (int, int)
        Their cells and poses.
    """

    def __init__(self, message: str, places: list[tuple[int, int]]) -> None:
        super().__init__(message)
        self.places = places


class InvalidParameterError(SpreadletsError):
    """An option or argument is out of its allowed range, or names something unknown."""


class MissingPackageError(InvalidParameterError):
    """Something was asked for that needs an optional package; the message says how to install it."""


class StoppedError(SpreadletsError):
    """Work stopped before its end, since the cluster is lost; what is finished is kept, and the same call goes on."""


class BuildStoppedError(StoppedError):
    """A build stopped before its end: no room, a worker or the cluster lost, or another build at work.

    Its finished cells are kept, and the same build goes on from them.
    """


class WorkerLostError(SpreadletsError):
    """One worker after the other died on a piece of work: killed, or out of memory."""


class MissingServerError(SpreadletsError):
    """No warm process answers where one was said to be."""


class AmbiguousInputWarning(UserWarning):
    """An image file's depth or motion can be read in several ways; the message says which was taken, and the remedy."""


_SPELLING: ContextVar[Callable[[str], str]] = ContextVar("spelling", default=str)


def option(name: str) -> str:
    """Return the name of an option as the caller would type it: ``depth_channel`` in Python, unless told otherwise.

    Examples
    --------
    >>> option("depth_channel")
    'depth_channel'
    """
    return _SPELLING.get()(name)


def spelling() -> Callable[[str], str]:
    """Return how options are spelled now, for `options_spelled` in another process."""
    return _SPELLING.get()


@contextmanager
def options_spelled(spelling: Callable[[str], str]) -> Iterator[None]:
    """Let messages spell options in another way within the block, such as ``--depth-channel``.

    Examples
    --------
    >>> with options_spelled(lambda name: "--" + name.replace("_", "-")):
    ...     option("depth_channel")
    '--depth-channel'
    """
    token = _SPELLING.set(spelling)
    try:
        yield
    finally:
        _SPELLING.reset(token)
