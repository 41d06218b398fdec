"""What may be written where: never over a file that is read, and known before anything is computed."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable

from spreadlets.arrays import PathLike
from spreadlets.errors import InvalidFileError, InvalidParameterError


def check_outputs(outputs: Iterable[PathLike], inputs: Iterable[PathLike] = ()) -> None:
    """Check that files can be written, and are none of those that are read.

    Parameters
    ----------
    outputs : iterable of path
        Files to write.
    inputs : iterable of path
        Files that are read; those that do not exist do not matter.

    Raises
    ------
    InvalidParameterError
        If an output is a file that is read, by whatever name or link, or the same as another output.
    InvalidFileError
        If an output cannot be written.

    Examples
    --------
    >>> import pathlib
    >>> from spreadlets.files.outputs import check_outputs
    >>> pathlib.Path("frame.exr").touch()
    >>> check_outputs(["out.exr"], ["frame.exr"])
    >>> check_outputs(["./frame.exr"], ["frame.exr"])
    Traceback (most recent call last):
    spreadlets.errors.InvalidParameterError: the output ./frame.exr would replace frame.exr, which is read
    """
    read = {identity: path for path in inputs for identity in _identities(path)}
    written: dict[object, PathLike] = {}
    folders: set[str] = set()
    for path in outputs:
        for identity in _identities(path):
            if identity in read:
                raise InvalidParameterError(f"the output {path} would replace {read[identity]}, which is read")
            if written.setdefault(identity, path) is not path:
                raise InvalidParameterError(f"the output {path} is the same file as the output {written[identity]}")
        _check_writable(path, folders)


def _identities(path: PathLike) -> list[object]:
    """Return what tells a file from others: where it lies, and which one it is if it exists."""
    identities: list[object] = [os.path.normcase(os.path.realpath(path))]
    if os.path.exists(path):
        status = os.stat(path)
        identities.append((status.st_dev, status.st_ino))
    return identities


def _check_writable(path: PathLike, known: set[str]) -> None:
    """Raise InvalidFileError if a file cannot be written; folders that can are added to those that are known."""
    target = os.path.realpath(path)
    folder = os.path.dirname(target)
    if os.path.exists(target):
        if not os.path.isfile(target):
            raise InvalidFileError(f"{path}: cannot be written: it exists and is not a regular file")
        if not os.access(target, os.W_OK):
            raise InvalidFileError(f"{path}: cannot be written: it is protected")
    if folder in known:
        return
    if not os.path.isdir(folder):
        raise InvalidFileError(f"{path}: cannot be written: there is no folder {folder}")
    try:
        with tempfile.TemporaryFile(dir=folder):
            known.add(folder)
    except OSError as error:
        raise InvalidFileError(f"{path}: cannot be written: {error}") from None
