"""Files that appear whole or not at all."""

import contextlib
import glob
import hashlib
import os
import secrets
import socket
from collections.abc import Iterator
from pathlib import Path

from spreadlets.arrays import PathLike
from spreadlets.errors import InvalidFileError

LIBRARY_ERRORS = (RuntimeError, ValueError, TypeError, ZeroDivisionError)
"""What the OpenEXR binding raises on files and headers that it cannot handle, such as a frame rate of 24/0."""


@contextlib.contextmanager
def atomic_path(path: PathLike, suffix: str) -> Iterator[Path]:
    """Give a temporary path in the target's folder; it becomes the target on success, and is removed on failure."""
    target = Path(os.path.realpath(path))
    if os.path.exists(target) and not os.path.isfile(target):  # unlike Path's, these never raise
        raise InvalidFileError(f"{path}: cannot be written: it exists and is not a regular file")
    if not os.path.isdir(target.parent):
        raise InvalidFileError(f"{path}: cannot be written: there is no folder {target.parent}")
    temporary = target.with_name(f"{_prefix()}{os.getpid()}-{secrets.token_hex(8)}{suffix}")
    try:
        yield temporary
        os.replace(temporary, target)
    except (OSError, *LIBRARY_ERRORS) as error:
        raise InvalidFileError(f"{path}: cannot be written: {error}") from error
    finally:
        temporary.unlink(missing_ok=True)


def remove_leftovers(folder: PathLike) -> None:
    """Remove the half-written files that killed processes of this machine have left in a folder."""
    if os.name == "nt":  # where asking whether a process lives ends it
        return
    for path in Path(folder).glob(f"{glob.escape(_prefix())}*"):
        process = path.name.removeprefix(_prefix()).partition("-")[0]
        try:
            os.kill(int(process), 0)
        except ProcessLookupError:
            path.unlink(missing_ok=True)
        except (OSError, ValueError, OverflowError):
            # It lives, or is none of ours.
            continue


def _prefix() -> str:
    """Return how the names of temporary files of this machine begin."""
    return f".spreadlets-{hashlib.sha256(socket.gethostname().encode()).hexdigest()[:8]}-"
