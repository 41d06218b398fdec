"""What the OpenEXR library does not do: check where a file's chunks lie, and unpack deep scanlines.

The library searches for chunks that its table does not find, and may find others. Its binding would give an array
object for every deep pixel and channel, gigabytes for a high-definition frame, and the header does not tell how many
samples there are.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import PathLike
from spreadlets.errors import InvalidFileError
from spreadlets.scene.raster import Attribute

MAGIC = 20000630
TILED = 0x200
MULTI_PART = 0x1000
LONG_NAMES = 0x400
"""Bits of the version field."""
SHORT_NAME = 31
"""Characters of a name that needs no bit."""

MAX_HEADER_BYTES = 1 << 24
"""Previews are the largest attributes of real headers; 16 MiB is far above any."""

CHANNEL_TYPES: Mapping[int, np.dtype[Any]] = {0: np.dtype("<u4"), 1: np.dtype("<f2"), 2: np.dtype("<f4")}
NO_COMPRESSION, RLE, ZIPS = 0, 1, 2
"""What OpenEXR allows for deep scanlines: one line per chunk, each."""

LINES_PER_CHUNK: Mapping[int, int] = {NO_COMPRESSION: 1, RLE: 1, ZIPS: 1} | dict(
    zip(range(3, 10), (16, 32, 16, 32, 32, 32, 256), strict=True)
)
"""Of the compressions by their numbers, from 3 on: ZIP, PIZ, PXR24, B44, B44A, DWAA, DWAB."""

PIXELS = "the pixels are truncated or corrupt"
"""What is wrong with a file whose chunks are not what its headers and tables say."""
_MALFORMED = (EOFError, struct.error, OSError, KeyError, ValueError, OverflowError, zlib.error)


@dataclass(frozen=True, eq=False)
class DeepPart:
    """The samples of a deep part.

    Attributes
    ----------
    counts : ndarray of shape (h, w), int64
        Samples in each pixel of the data window.
    channels : mapping of str to ndarray of shape (N,), float32
        Samples of each channel, pixel after pixel in row-major order.
    """

    counts: npt.NDArray[np.int64]
    channels: Mapping[str, npt.NDArray[np.float32]]


@dataclass(frozen=True)
class _PartHeader:
    """What a part's header says about its chunks; `tile` is the width and height of tiles, px, or None."""

    deep: bool
    tile: tuple[int, int] | None
    n_chunks: int
    window: tuple[int, int, int, int]
    compression: int
    types: Mapping[str, np.dtype[Any]]


def check_structure(file: BinaryIO) -> None:
    """Check that the headers of a file are well-formed: the library passes over much that is not, and guesses.

    Parameters
    ----------
    file : binary file
        An OpenEXR file that the library has read.

    Raises
    ------
    InvalidFileError
        If a header is malformed.
    """
    with _refusing(file, "its header is malformed"):
        if not _file_headers(file)[1]:
            raise ValueError("it has no parts")


def check_chunks(file: BinaryIO) -> None:
    """Check that the chunks of all flat parts, lines or tiles, lie where the file's tables say.

    Parameters
    ----------
    file : binary file
        An OpenEXR file that the library has read, of a size that was checked.

    Raises
    ------
    InvalidFileError
        If the file ends early, or a table points to something else than its chunk.
    """
    with _refusing(file, PIXELS):
        multi_part, headers, offsets = _tables(file)
        begin, end = file.tell(), os.fstat(file.fileno()).st_size
        for part, (header, table) in enumerate(zip(headers, offsets, strict=True)):
            if header.deep or (header.tile is None and header.compression not in LINES_PER_CHUNK):
                continue
            places = _chunk_places(header)
            listed = table[: len(places)] if header.tile else table  # smaller levels follow, which are not read
            for place, offset in zip(places, listed, strict=True):
                file.seek(offset)
                of_part = struct.unpack("<i", _exactly(file, 4))[0] if multi_part else part
                *found, packed = struct.unpack(f"<{len(place) + 1}i", _exactly(file, 4 * len(place) + 4))
                if (of_part, *found) != (part, *place) or offset < begin or not 0 < packed <= end - file.tell():
                    what = f"lines from {place[0]} on are" if len(place) == 1 else f"tile {place} is"
                    raise ValueError(f"the {what} not where the table says")


def _chunk_places(header: _PartHeader) -> list[tuple[int, ...]]:
    """Return what the chunks of a flat part begin with, as its table lists them: lines, or tiles of the first level."""
    left, top, right, bottom = header.window
    if header.tile is None:
        return [(y,) for y in range(top, bottom + 1, LINES_PER_CHUNK[header.compression])]
    across, down = -((left - right - 1) // header.tile[0]), -((top - bottom - 1) // header.tile[1])
    return [(column, row, 0, 0) for row in range(down) for column in range(across)]


def deep_sample_bytes(file: BinaryIO) -> int:
    """Return how many bytes the unpacked samples of all deep scanlines take.

    Parameters
    ----------
    file : binary file
        An OpenEXR file that the library has read.

    Returns
    -------
    int

    Raises
    ------
    InvalidFileError
        If the file ends early or its tables point outside it.
    """
    with _refusing(file, PIXELS):
        multi_part, headers, offsets = _tables(file)
        deep = [table for header, table in zip(headers, offsets, strict=True) if header.deep]
        return sum(_chunk_header(file, offset, multi_part)[3] for table in deep for offset in table)


def read_deep_part(file: BinaryIO, part: int) -> DeepPart:
    """Return the samples of a deep part.

    Parameters
    ----------
    file : binary file
        An OpenEXR file that the library has read, of a size that was checked.
    part : int
        Which part, from 0.

    Returns
    -------
    DeepPart

    Raises
    ------
    InvalidFileError
        If the file is truncated or corrupt, a channel is subsampled, or the compression is none that deep scanlines may
        have.
    """
    with _refusing(file, PIXELS):
        multi_part, headers, offsets = _tables(file)
        return _deep_part(file, headers[part], offsets[part], multi_part)


def read_attributes(file: BinaryIO) -> list[dict[str, Attribute]]:
    """Return all attributes of each part's header as they are stored.

    Raises
    ------
    InvalidFileError
        If a header is malformed.
    """
    with _refusing(file, "its header is malformed"):
        _, version = struct.unpack("<iI", _exactly(file, 8))
        parts = [_attributes(file)]
        while version & MULTI_PART and (attributes := _attributes(file)):
            parts.append(attributes)
        return parts


def add_attributes(
    path: PathLike, parts: Sequence[Mapping[str, Attribute]], *, replacing: Collection[str] = ()
) -> None:
    """Put attributes into the headers of a file of scanlines, in place.

    Parameters
    ----------
    path : path
        A file as the library has written it.
    parts : sequence of mapping
        Attributes to add to the header of each part. One that is there already stays.
    replacing : collection of str
        Names of attributes that give way.
    """
    with open(path, "rb") as file:
        # Read headers, offsets and chunks.
        found = read_attributes(file)
        file.seek(0)
        multi_part, _, tables = _tables(file)
        chunks = file.read()
        begin = file.tell() - len(chunks)
        file.seek(0)
        magic, version = struct.unpack("<iI", _exactly(file, 8))
    # Add the attributes to the headers.
    headers = []
    for own, added in zip(found, parts, strict=True):
        kept = {name: each for name, each in own.items() if name not in replacing or name not in added}
        headers.append(dict(sorted({**added, **kept}.items())))
    if any(len(name) > SHORT_NAME for header in headers for name in header):
        version |= LONG_NAMES
    stored = [b"".join(_stored_attribute(*item) for item in header.items()) + b"\0" for header in headers]
    head = struct.pack("<iI", magic, version) + b"".join(stored) + (b"\0" if multi_part else b"")
    # Shift the offsets by what the headers have grown.
    offsets = [offset for table in tables for offset in table]
    shift = len(head) + 8 * len(offsets) - begin
    with open(path, "wb") as file:
        file.write(head + struct.pack(f"<{len(offsets)}Q", *(offset + shift for offset in offsets)))
        file.write(chunks)


@contextmanager
def _refusing(file: BinaryIO, problem: str) -> Iterator[None]:
    """Go to the beginning of a file, and say what is wrong with it where it cannot be read as it should."""
    try:
        file.seek(0)
        yield
    except _MALFORMED as error:
        raise InvalidFileError(f"{file.name}: {problem} ({error})") from None


def _deep_part(file: BinaryIO, header: _PartHeader, offsets: Sequence[int], multi_part: bool) -> DeepPart:
    """Unpack the lines of a part, in any order.

    Notes
    -----
    OpenEXR file layout: a chunk is its header, the running count of samples over the line's pixels, and the samples of
    one channel after the other; counts and samples are packed each by itself.
    """
    left, top, right, bottom = header.window
    width, height = right - left + 1, bottom - top + 1
    if len(offsets) != height:
        raise ValueError(f"there are {len(offsets)} chunks for {height} lines")
    counts = np.zeros((height, width), np.int64)
    lines: dict[int, dict[str, npt.NDArray[np.float32]]] = {}
    bytes_per_sample = sum(dtype.itemsize for dtype in header.types.values())
    for offset in offsets:
        # Read a chunk's header, and the counts of its line.
        y, packed_counts, packed_samples, unpacked = _chunk_header(file, offset, multi_part)
        if not top <= y <= bottom or y in lines:
            raise ValueError(f"there is a line {y}")
        running = np.frombuffer(_unpacked(file, packed_counts, 4 * width, header.compression), "<i4").astype(np.int64)
        counts[y - top] = np.diff(running, prepend=0)
        n = int(running[-1])
        if (counts[y - top] < 0).any() or n * bytes_per_sample != unpacked:
            raise ValueError(f"the counts of line {y} are wrong")
        # Unpack its samples, one channel after the other.
        samples = _unpacked(file, packed_samples, unpacked, header.compression)
        lines[y] = {}
        begin = 0
        for name, dtype in header.types.items():
            values = np.frombuffer(samples, dtype, n, begin)
            lines[y][name] = values.astype(np.float32)
            begin += values.nbytes
    # Put the lines in order.
    ordered = [lines[y] for y in range(top, bottom + 1)]
    return DeepPart(counts, {name: np.concatenate([line[name] for line in ordered]) for name in header.types})


def _unpacked(file: BinaryIO, packed: int, size: int, compression: int) -> bytes:
    """Read and unpack a block of known size; one that would not shrink is stored as it is."""
    if packed > os.fstat(file.fileno()).st_size:
        raise EOFError("the file ends early")
    block = _exactly(file, packed)
    if packed == size or compression == NO_COMPRESSION:
        result = block
    elif compression == ZIPS:
        stream = zlib.decompressobj()
        result = _reordered(stream.decompress(block, size + 1))
        if not stream.eof:  # its checksum follows the last byte
            raise ValueError("a block goes on, or has no end")
    elif compression == RLE:
        result = _reordered(_runs(block, size))
    else:
        raise ValueError(f"deep scanlines cannot have the compression {compression}")
    if len(result) != size:
        raise ValueError(f"a block has {len(result)} bytes in place of {size}")
    return result


def _reordered(block: bytes) -> bytes:
    """Undo OpenEXR's predictor (bytes are differences plus 128) and put the halves' bytes in turn."""
    differences = np.frombuffer(block, np.uint8)
    values = np.cumsum(differences, dtype=np.uint8)
    values[1::2] ^= 128  # 128 less for each step, modulo 256
    result = np.empty_like(values)
    half = (values.size + 1) // 2
    result[0::2], result[1::2] = values[:half], values[half:]
    return result.tobytes()


def _runs(block: bytes, size: int) -> bytes:
    """Undo run lengths: -n is followed by n bytes, n by one that stands n + 1 times."""
    result = bytearray()
    at = 0
    while at < len(block) and len(result) <= size:
        length = block[at] - 256 if block[at] > 127 else block[at]
        if length < 0:
            result += block[at + 1 : at + 1 - length]
            at += 1 - length
        else:
            result += block[at + 1 : at + 2] * (length + 1)
            at += 2
    return bytes(result)


# --- Headers -------------------------------------------------------------------------------------------------------


def _tables(file: BinaryIO) -> tuple[bool, list[_PartHeader], list[Sequence[int]]]:
    """Return whether there are several parts, their headers, and where the chunks of each begin."""
    multi_part, headers = _file_headers(file)
    if 8 * sum(header.n_chunks for header in headers) > os.fstat(file.fileno()).st_size:
        raise EOFError("the file ends early")
    tables = [struct.unpack(f"<{header.n_chunks}Q", _exactly(file, 8 * header.n_chunks)) for header in headers]
    return multi_part, headers, list(tables)


def _file_headers(file: BinaryIO) -> tuple[bool, list[_PartHeader]]:
    """Return whether there are several parts, and their headers."""
    magic, version = struct.unpack("<iI", _exactly(file, 8))
    if magic != MAGIC:
        raise ValueError("not an OpenEXR file")
    return bool(version & MULTI_PART), _headers(file, version)


def _headers(file: BinaryIO, version: int) -> list[_PartHeader]:
    headers: list[_PartHeader] = []
    while attributes := _attributes(file):  # an empty header ends those of several parts
        values = {name: attribute.value for name, attribute in attributes.items()}
        headers.append(_part_header(values, bool(version & TILED)))
        if not version & MULTI_PART:
            break
    return headers


def _part_header(attributes: Mapping[str, bytes], tiled: bool) -> _PartHeader:
    """Return what a header says; `tiled` if the file says that its only part is."""
    # Count the chunks.
    window: tuple[int, int, int, int] = struct.unpack("<4i", attributes["dataWindow"])
    compression, tile = attributes["compression"][0], None
    n_chunks = -((window[1] - window[3] - 1) // LINES_PER_CHUNK.get(compression, 1))
    if attributes.get("type", b"tiledimage" if tiled else b"") == b"tiledimage":
        tile = struct.unpack_from("<II", attributes["tiles"])
        if 0 in tile:
            raise ValueError("its tiles have no size")
        n_chunks = ((window[0] - window[2] - 1) // tile[0]) * ((window[1] - window[3] - 1) // tile[1])
    if "chunkCount" in attributes:
        (n_chunks,) = struct.unpack("<i", attributes["chunkCount"])
    if n_chunks < 0:
        raise ValueError("a part has a negative number of chunks")
    # List the channels with their types.
    types: dict[str, np.dtype[Any]] = {}
    names = attributes["channels"]
    while names and names[0]:
        name, _, rest = names.partition(b"\0")
        kind, _, *sampling = struct.unpack_from("<iIii", rest)
        if sampling != [1, 1] and attributes.get("type") == b"deepscanline":
            raise ValueError(f"the channel {name.decode('latin-1')} is subsampled")
        types[name.decode("latin-1")] = CHANNEL_TYPES[kind]
        names = rest[16:]
    if list(types) != sorted(types):  # pixels lie in this order, and readers sort the names
        raise ValueError("its channels are not in alphabetical order")
    deep = attributes.get("type") == b"deepscanline"
    return _PartHeader(deep, tile, n_chunks, window, compression, types)


def _attributes(file: BinaryIO) -> dict[str, Attribute]:
    """Read one header: names, types and values up to an empty name."""
    attributes: dict[str, Attribute] = {}
    while name := _text(file):
        kind = _text(file)
        (size,) = struct.unpack("<i", _exactly(file, 4))
        if not 0 <= size <= MAX_HEADER_BYTES:
            raise EOFError(f"the attribute {name!r} has {size} bytes")
        attributes[name] = Attribute(kind, _exactly(file, size))
    return attributes


def _stored_attribute(name: str, attribute: Attribute) -> bytes:
    """Return an attribute as a header holds it: undoes `_attributes`."""
    size = struct.pack("<i", len(attribute.value))
    return name.encode("latin-1") + b"\0" + attribute.kind.encode("latin-1") + b"\0" + size + attribute.value


def _text(file: BinaryIO) -> str:
    """Read characters up to a zero."""
    result = bytearray()
    while (character := _exactly(file, 1)) != b"\0":
        result += character
        if len(result) > 255:
            raise EOFError("a name has more than 255 characters")
    return result.decode("latin-1")


def _chunk_header(file: BinaryIO, offset: int, multi_part: bool) -> tuple[int, int, int, int]:
    """Return a chunk's y, its packed sizes of counts and samples, and the unpacked size of the samples, bytes."""
    file.seek(offset + (4 if multi_part else 0))
    y, packed_counts, packed_samples, unpacked = struct.unpack("<iQQQ", _exactly(file, 28))
    return y, packed_counts, packed_samples, unpacked


def _exactly(file: BinaryIO, size: int) -> bytes:
    content = file.read(size)
    if len(content) < size:
        raise EOFError("the file ends early")
    return content
