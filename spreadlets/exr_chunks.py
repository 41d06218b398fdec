"""How much memory the samples of a deep OpenEXR file take, told by its chunks' headers before any of it is unpacked.

A deep file's header says how many pixels there are, but not how many samples; the library would unpack them all.
"""

from __future__ import annotations

import os
import struct
from typing import BinaryIO

from spreadlets.errors import InvalidFileError

MAGIC = 20000630
MULTI_PART = 0x1000
"""Bit of the version field."""

MAX_HEADER_BYTES = 1 << 24
"""Previews are the largest attributes of real headers; 16 MiB is far above any."""


def deep_sample_bytes(path: str | os.PathLike[str]) -> int:
    """Return how many bytes the unpacked samples of all deep scanlines take.

    Parameters
    ----------
    path : path
        An OpenEXR file that the library has opened.

    Returns
    -------
    int

    Raises
    ------
    InvalidFileError
        If the file ends early or its tables point outside it.

    Notes
    -----
    OpenEXR file layout: a deep scanline chunk is [part number,] y, packed size of the table of counts, packed size of
    the samples, unpacked size of the samples, and then the data.
    """
    try:
        with open(path, "rb") as file:
            magic, version = struct.unpack("<iI", _exactly(file, 8))
            if magic != MAGIC:
                raise InvalidFileError(f"{path}: is not a readable OpenEXR file")
            multi_part = bool(version & MULTI_PART)
            chunks = _chunk_counts(file, multi_part)
            if 8 * sum(n for n, _ in chunks) > os.path.getsize(path):
                raise EOFError("the file ends early")
            offsets = [struct.unpack(f"<{n}Q", _exactly(file, 8 * n)) if deep else _skip(file, n) for n, deep in chunks]
            return sum(_unpacked_size(file, offset, multi_part) for table in offsets for offset in table)
    except (EOFError, struct.error, OSError, KeyError, OverflowError) as error:
        raise InvalidFileError(f"{path}: the pixels are truncated or corrupt ({error})") from None


def _chunk_counts(file: BinaryIO, multi_part: bool) -> list[tuple[int, bool]]:
    """Read all headers; return the number of chunks of each part, and whether it holds deep scanlines."""
    counts: list[tuple[int, bool]] = []
    while True:
        attributes = _attributes(file)
        if not attributes:  # an empty header ends those of several parts
            return counts
        if "chunkCount" in attributes:
            (count,) = struct.unpack("<i", attributes["chunkCount"])
        else:
            _, top, _, bottom = struct.unpack("<4i", attributes["dataWindow"])
            count = bottom - top + 1
        if count < 0:
            raise EOFError("a part has a negative number of chunks")
        counts.append((count, attributes.get("type") == b"deepscanline"))
        if not multi_part:
            return counts


def _attributes(file: BinaryIO) -> dict[str, bytes]:
    """Read one header: names and values up to an empty name."""
    attributes: dict[str, bytes] = {}
    while name := _text(file):
        _text(file)  # the type
        (size,) = struct.unpack("<i", _exactly(file, 4))
        if not 0 <= size <= MAX_HEADER_BYTES:
            raise EOFError(f"the attribute {name!r} has {size} bytes")
        attributes[name] = _exactly(file, size)
    return attributes


def _text(file: BinaryIO) -> str:
    """Read characters up to a zero."""
    result = bytearray()
    while (character := _exactly(file, 1)) != b"\0":
        result += character
        if len(result) > 255:
            raise EOFError("a name has more than 255 characters")
    return result.decode("latin-1")


def _skip(file: BinaryIO, n_chunks: int) -> tuple[int, ...]:
    """Pass over the offsets of a flat part."""
    file.seek(8 * n_chunks, os.SEEK_CUR)
    return ()


def _unpacked_size(file: BinaryIO, offset: int, multi_part: bool) -> int:
    """Return what one chunk's header says about its samples."""
    file.seek(offset + (8 if multi_part else 4) + 16)
    size: int = struct.unpack("<Q", _exactly(file, 8))[0]
    return size


def _exactly(file: BinaryIO, size: int) -> bytes:
    content = file.read(size)
    if len(content) < size:
        raise EOFError("the file ends early")
    return content
