"""What a file is by its first bytes, whatever its name."""

from __future__ import annotations

import os
from typing import BinaryIO

from spreadlets.arrays import PathLike
from spreadlets.errors import InvalidFileError

OPENEXR = "an OpenEXR file"
TLFR = "a TLFR sample buffer"
HDF5 = "an HDF5 file, such as a database"

KINDS = (
    (b"\x76\x2f\x31\x01", OPENEXR),
    (b"Version ", TLFR),
    (b"\x89HDF\r\n\x1a\n", HDF5),
    (b"\xff\xd8\xff", "a JPEG"),
    (b"\x89PNG", "a PNG"),
    (b"II*\x00", "a TIFF"),
    (b"MM\x00*", "a TIFF"),
    (b"#?RADIANCE", "a Radiance HDR"),
    (b"PXR-USDC", "a USD file"),
    (b"#usda", "a USD file"),
    (b"{", "text, such as a camera's JSON"),
)
"""First bytes of the files that are read, and of others that are named by mistake."""

LONGEST = max(len(start) for start, _ in KINDS)


def open_file(path: PathLike) -> BinaryIO:
    """Open a regular file for reading.

    Raises
    ------
    InvalidFileError
        If there is no such file, or it cannot be read.
    """
    if not os.path.isfile(path):
        there = os.path.exists(path)
        raise InvalidFileError(f"{path}: {'is not a regular file' if there else 'there is no such file'}")
    try:
        return open(path, "rb")
    except OSError as error:
        raise InvalidFileError(f"{path}: cannot be read: {error.strerror}") from None


def file_kind(source: PathLike | BinaryIO) -> str:
    """Return what a file is by its first bytes.

    Parameters
    ----------
    source : path or binary file
        A file that is open is left at its beginning.

    Returns
    -------
    str
        Such as ``"a PNG"``; empty if it is none of `KINDS`, or cannot be read.

    Examples
    --------
    >>> from pathlib import Path
    >>> from spreadlets.files.kinds import file_kind
    >>> _ = Path("frame.exr").write_bytes(b"#usda 1.0")
    >>> file_kind("frame.exr"), file_kind("absent.exr")
    ('a USD file', '')
    """
    try:
        if not isinstance(source, str | os.PathLike):
            source.seek(0)
            first = source.read(LONGEST)
            source.seek(0)
        else:
            with open(source, "rb") as file:
                first = file.read(LONGEST)
    except OSError:
        return ""
    return next((kind for start, kind in KINDS if first.startswith(start)), "")
