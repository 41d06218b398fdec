"""An OpenEXR file that is opened once: its kind, headers, chunks and pixels all come from one handle.

Each promise of a header is checked before anything is made by it.
"""

from __future__ import annotations

import contextlib
import functools
import io
import os
import tempfile
import threading
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, BinaryIO, Self

import OpenEXR

from spreadlets.arrays import PathLike
from spreadlets.errors import InvalidFileError
from spreadlets.files.atomic import LIBRARY_ERRORS
from spreadlets.files.attributes import carried_attributes
from spreadlets.files.exr_chunks import (
    DeepPart,
    check_chunks,
    check_structure,
    deep_sample_bytes,
    read_attributes,
    read_deep_part,
)
from spreadlets.files.exr_parts import Image, Part, Plane, merged, window
from spreadlets.files.kinds import OPENEXR, file_kind, open_file
from spreadlets.scene.raster import Window

MAX_VALUES = 1 << 30
"""Most values (pixels times channels, over all parts) that are read: 4 GiB as float32, an 8K frame of 32 channels."""

FLOAT_BYTES = 4

LEAST_BYTES = 2
"""Of a stored value: a half."""

EXPANSION: Mapping[Any, int] = {
    OpenEXR.NO_COMPRESSION: 1,
    OpenEXR.RLE_COMPRESSION: 64,
    OpenEXR.ZIPS_COMPRESSION: 1032,
    OpenEXR.ZIP_COMPRESSION: 1032,
    OpenEXR.PXR24_COMPRESSION: 2064,
}
"""Most values of a byte that one stored byte can stand for: runs of 128 in 2 bytes; deflate's 1032, twice that where
the library drops a byte first. The other compressions have no useful bound."""

STREAM = "<python_buffer>"
"""What the library calls a file that is handed to it open."""

_STDERR_DESCRIPTOR = 2
_STDERR_LOCK = threading.Lock()


class ExrFile:
    """An OpenEXR file, open for reading until it is closed; a context manager.

    Parameters
    ----------
    source : path or binary file
        The file. Its headers are read and checked at once, its pixels when they are asked for.

    Attributes
    ----------
    path : path
    headers : list of mapping
        The header of each part, as the library decodes it.
    attributes : list of mapping of str to Attribute
        Of each part, as stored, what does not describe its own pixels.

    Raises
    ------
    InvalidFileError
        If the file is missing, no OpenEXR file, or malformed.

    Examples
    --------
    >>> import numpy as np
    >>> from spreadlets.files.exr_file import ExrFile
    >>> sp.write_image("image.exr", np.ones((4, 6, 3)))
    >>> with ExrFile("image.exr") as file:
    ...     sorted(file.parts[0].planes)
    ['B', 'G', 'R']
    """

    def __init__(self, source: PathLike | BinaryIO) -> None:
        self._handle = open_file(source) if isinstance(source, str | os.PathLike) else source
        self.path: PathLike = self._handle.name
        try:
            self.headers = self._checked_headers()
            self.attributes = [carried_attributes(stored) for stored in read_attributes(self._handle)]
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the file; what was read stays."""
        self._handle.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def is_deep(self) -> bool:
        """Whether some part is a deep image."""
        return any(map(is_deep, self.headers))

    @functools.cached_property
    def parts(self) -> list[Part]:
        """Every channel of a flat file as stored, after checking what the headers promise."""
        self.check_size()
        check_chunks(self._handle)
        file, messages = self._decoded(header_only=False)
        parts = []
        for part, attributes in zip(file.parts, self.attributes, strict=False):  # their number is checked below
            data = window(part.header["dataWindow"])
            planes = {
                name: Plane(channel.pixels, data, (channel.xSampling, channel.ySampling))
                for name, channel in part.channels.items()
            }
            parts.append(Part.of(part.header, planes, attributes))
        # The binding skips parts that it fails to decode.
        if len(parts) < len(self.headers) or not all(part.planes for part in parts):
            raise InvalidFileError(f"{self.path}: the pixels are truncated or corrupt{_detail(messages)}")
        return parts

    @property
    def image(self) -> Image:
        """All channels of all parts of a flat file, by their full names."""
        return merged(self.path, self.parts)

    def deep_part(self, index: int) -> DeepPart:
        """Return the samples of a deep part of a file whose size was checked."""
        return read_deep_part(self._handle, index)

    def check_size(self, *, deep: bool = False) -> None:
        """Raise InvalidFileError if the file is larger than `MAX_VALUES`, or deep if that is not allowed."""
        display = window(self.headers[0]["displayWindow"])
        # Refuse kinds of parts and windows that are not read.
        for header in self.headers:
            if is_deep(header) and not deep:
                raise InvalidFileError(f"{self.path}: holds a deep image; only flat images can be read here")
            if header.get("type") == OpenEXR.deeptile:
                raise InvalidFileError(f"{self.path}: holds deep tiles; only deep scanlines can be read")
            if min(*window(header["dataWindow"])[2:], *window(header["displayWindow"])[2:]) < 1:
                raise InvalidFileError(f"{self.path}: has an empty window")
            if window(header["displayWindow"]) != display:
                raise InvalidFileError(f"{self.path}: its parts have different display windows")
        # Count the values that the parts promise, and the bytes that they must hold.
        total = sum(_promised(header) for header in self.headers)
        if self.is_deep:
            total += deep_sample_bytes(self._handle) // FLOAT_BYTES
        if total > MAX_VALUES:
            raise InvalidFileError(
                f"{self.path}: holds {total} values (pixels times channels); at most {MAX_VALUES} are read"
            )
        if sum(map(_least_stored, self.headers)) > os.fstat(self._handle.fileno()).st_size:
            raise InvalidFileError(
                f"{self.path}: is too short for the {total} values that it promises: truncated or corrupt"
            )

    def _checked_headers(self) -> list[Mapping[str, Any]]:
        """Return the headers as the library decodes them, if they are well-formed."""
        if (kind := file_kind(self._handle)) and kind != OPENEXR:
            raise InvalidFileError(f"{self.path}: is {kind}; frames and images are read from OpenEXR")
        file, _ = self._decoded(header_only=True)
        check_structure(self._handle)
        headers = [part.header for part in file.parts]
        try:
            for header in headers:
                [channel.name for channel in header["channels"]]  # the binding decodes them when they are asked for
        except UnicodeDecodeError:
            raise InvalidFileError(f"{self.path}: a channel's name is not text") from None
        return headers

    def _decoded(self, *, header_only: bool) -> tuple[Any, list[str]]:
        """Return the binding's file object and what the library printed."""
        messages: list[str] = []
        self._handle.seek(0)
        try:
            with library_messages() as messages:
                return OpenEXR.File(self._handle, separate_channels=True, header_only=header_only), messages
        except LIBRARY_ERRORS as error:
            said = messages if isinstance(error, RuntimeError) else [str(error)]
            raise InvalidFileError(f"{self.path}: is not a readable OpenEXR file{_detail(said)}") from None


Source = PathLike | ExrFile
"""A file by its path, or already open."""


@contextlib.contextmanager
def opened(sources: Source | Sequence[Source]) -> Iterator[list[ExrFile]]:
    """Give files open for reading; those that are opened for it are closed at the end.

    Raises
    ------
    InvalidFileError
        As for `ExrFile`.
    """
    listed = [sources] if isinstance(sources, str | os.PathLike | ExrFile) else sources
    with contextlib.ExitStack() as stack:
        yield [each if isinstance(each, ExrFile) else stack.enter_context(ExrFile(each)) for each in listed]


def is_deep(header: Mapping[str, Any]) -> bool:
    """Tell whether a part's header is that of a deep image."""
    return header.get("type") in (OpenEXR.deepscanline, OpenEXR.deeptile)


@contextlib.contextmanager
def library_messages() -> Iterator[list[str]]:
    """Collect what the OpenEXR library prints on failure, so that it goes into the error instead of the terminal.

    The C library writes to the process's standard error and the binding to Python's standard output; neither can be
    switched off. The list is filled when the block ends.
    """
    messages: list[str] = []
    with _STDERR_LOCK, tempfile.TemporaryFile() as log, contextlib.redirect_stdout(io.StringIO()):
        saved = os.dup(_STDERR_DESCRIPTOR)
        os.dup2(log.fileno(), _STDERR_DESCRIPTOR)
        try:
            yield messages
        finally:
            os.dup2(saved, _STDERR_DESCRIPTOR)
            os.close(saved)
            log.seek(0)
            messages += log.read().decode(errors="replace").splitlines()


def _detail(messages: Sequence[str]) -> str:
    """Return the library's first message, in brackets, without the file's name that it starts with."""
    return f" ({messages[0].removeprefix(f'{STREAM}: ')})" if messages else ""


def _promised(header: Mapping[str, Any]) -> int:
    """Return how many values of a part are held: in its data window or, if that is larger, in the display window."""
    windows = window(header["dataWindow"]), window(header["displayWindow"])
    return max(each.width * each.height for each in windows) * len(header["channels"])


def _least_stored(header: Mapping[str, Any]) -> int:
    """Return the fewest bytes that a part can take in a file, as far as its compression tells; 0 of a deep one."""
    data: Window = window(header["dataWindow"])
    expansion = EXPANSION.get(header.get("compression"))
    if expansion is None or is_deep(header):
        return 0
    values = sum(data.width * data.height // (each.xSampling * each.ySampling) for each in header["channels"])
    return int(values) * LEAST_BYTES // expansion
