"""OpenEXR files as named channels: every part read whole and checked, or written whole; no meaning is attached here.

What the channels mean is told by `spreadlets.files.conventions` and `spreadlets.files.recognise`.
"""

from __future__ import annotations

import contextlib
import io
import os
import tempfile
import threading
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import OpenEXR

from spreadlets.arrays import BoolArray, FloatArray, PathLike
from spreadlets.errors import InvalidFileError, option
from spreadlets.files.atomic import LIBRARY_ERRORS
from spreadlets.files.attributes import carried_attributes
from spreadlets.files.exr_chunks import check_chunks, check_structure, deep_sample_bytes
from spreadlets.scene.raster import Attribute, Raster, Window, overlap

EXR_MAGIC = b"\x76\x2f\x31\x01"
"""What every OpenEXR file starts with."""

OTHER_KINDS = (
    (b"\xff\xd8\xff", "a JPEG"),
    (b"\x89PNG", "a PNG"),
    (b"II*\x00", "a TIFF"),
    (b"MM\x00*", "a TIFF"),
    (b"#?RADIANCE", "a Radiance HDR"),
    (b"\x89HDF", "an HDF5 file, such as a database"),
    (b"PXR-USDC", "a USD file"),
    (b"#usda", "a USD file"),
    (b"Version ", "a TLFR sample buffer"),
    (b"{", "text, such as a camera's JSON"),
)
"""First bytes of other files that are named by mistake, and what they are."""

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

_STDERR_DESCRIPTOR = 2
_STDERR_LOCK = threading.Lock()


@dataclass(frozen=True, eq=False)
class Plane:
    """One channel's pixels where the file stores them, and where it belongs.

    Attributes
    ----------
    pixels : ndarray
        As stored; empty where only headers were read.
    window : Window
        The pixels that are stored.
    sampling : tuple of int
        Columns and rows per stored value.
    part : int
        Index of the part that holds it.
    view : str
        The view of a stereo image that it belongs to, empty if none or all.
    bare, place : str
        The name without the view: as in its part, and with the part's name in front unless it begins with that.
    """

    pixels: npt.NDArray[Any]
    window: Window
    sampling: tuple[int, int]
    part: int = 0
    view: str = ""
    bare: str = ""
    place: str = ""


@dataclass(frozen=True, eq=False)
class Part:
    """One part of a file: its header, and its channels by the names that they have there."""

    name: str
    header: Mapping[str, Any]
    planes: Mapping[str, Plane]
    attributes: Mapping[str, Attribute] = field(default_factory=dict)

    @property
    def display(self) -> Window:
        """The display window."""
        return window(self.header["displayWindow"])

    @property
    def view(self) -> str:
        """The view of a stereo image that the whole part belongs to, or empty."""
        return str(self.header.get("view", ""))

    @property
    def pixel_aspect(self) -> float:
        """Width of a pixel over its height, as displayed."""
        return float(self.header.get("pixelAspectRatio", 1.0))


@dataclass(frozen=True, eq=False)
class Image:
    """The channels of a file, or of one layer part, by their full names.

    Attributes
    ----------
    path : path
        The file.
    planes : mapping of str to Plane
        Every channel.
    display : Window
        The display window.
    names : tuple of str
        The channels among which names are looked for: those of one view.
    views : tuple of str
        The views of a stereo image, the hero view first.
    """

    path: PathLike
    planes: Mapping[str, Plane]
    display: Window
    parts: Sequence[Part] = ()
    names: tuple[str, ...] = ()
    views: tuple[str, ...] = ()

    def raster(self, name: str) -> Raster:
        """Return where a channel's pixels lie, and what the header of its part says besides."""
        plane = self.planes[name]
        if not self.parts:
            return Raster(plane.window, self.display)
        part = self.parts[plane.part]
        return Raster(plane.window, self.display, part.pixel_aspect, attributes=part.attributes)

    @property
    def n_parts(self) -> int:
        """How many parts of the file the channels are from."""
        return len({plane.part for plane in self.planes.values()})

    def place(self, name: str) -> str:
        """Return a channel's name without its view, behind its part's name."""
        return self.planes[name].place or name

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of what `gather` returns."""
        return self.display.height, self.display.width

    def of_view(self, view: str | None) -> Image:
        """Return the image with the names of one view, by default the hero view's; what has no view belongs to all.

        Raises
        ------
        InvalidFileError
            If there is no such view.
        """
        if view is not None and view not in self.views:
            there = f"its views are {', '.join(self.views)}" if self.views else "it has no views"
            raise InvalidFileError(f"{self.path}: lacks the {option('view')} {view!r}; {there}")
        if not self.views:
            return replace(self, names=tuple(self.planes))
        chosen = self.views[0] if view is None else view
        own = {plane.place for plane in self.planes.values() if plane.view == chosen}
        shared = [name for name, plane in self.planes.items() if not plane.view and plane.place not in own]
        names = [name for name, plane in self.planes.items() if plane.view == chosen]
        return replace(self, names=(*names, *shared))

    def problem(self, what: str, *options: str) -> InvalidFileError:
        """Return an error that lists the channels and names the options that settle the matter."""
        found = ", ".join(sorted(self.planes)) or "none"
        remedy = " or ".join(map(option, options))
        return InvalidFileError(f"{self.path}: {what}; name it with {remedy}. Channels found: {found}")


# --- Reading -------------------------------------------------------------------------------------------------------


def merged(path: PathLike, parts: Sequence[Part]) -> Image:
    """Return all parts' channels in one; in a file of several parts the part's name leads, if it does not already."""
    planes: dict[str, Plane] = {}
    views = list(dict.fromkeys(part.view for part in parts if part.view))
    for index, part in enumerate(parts):
        named = [str(view) for view in part.header.get("multiView", ())]
        views += [view for view in named if view not in views]
        for name, plane in part.planes.items():
            full, placed = _placed(name, plane, part, index, named, alone=len(parts) == 1)
            planes[full if full not in planes else f"part{index}.{name}"] = placed
    return Image(path, planes, parts[0].display, parts, tuple(planes), tuple(views))


def _placed(name: str, plane: Plane, part: Part, index: int, views: Sequence[str], *, alone: bool) -> tuple[str, Plane]:
    """Return a channel's full name, and the channel with its view and its names without it."""
    bare, view = (name, part.view) if part.view else _without_view(name, views)
    layer = _without_ending(part.name, view)
    if alone or not part.name:
        return name, replace(plane, part=index, view=view, bare=bare, place=bare)
    if bare.startswith(layer + "."):
        head, _, last = bare.rpartition(".")
        full = f"{head}.{view}.{last}" if part.view else name
        return full, replace(plane, part=index, view=view, bare=bare, place=bare)
    return f"{part.name}.{name}", replace(plane, part=index, view=view, bare=bare, place=f"{layer}.{bare}")


def _without_view(name: str, views: Sequence[str]) -> tuple[str, str]:
    """Return a channel's name without its view, and the view.

    OpenEXR puts the view before the last word; some programs put it first. A name of one word is the hero view's.
    """
    words = name.split(".")
    if views and len(words) == 1:
        return name, views[0]
    for place in (len(words) - 2, 0):
        if len(words) > 1 and words[place] in views:
            return ".".join(words[:place] + words[place + 1 :]), words[place]
    return name, ""


def _without_ending(part_name: str, view: str) -> str:
    """Return a part's name without its view, which some programs add after a dot, dash, or underscore."""
    if view and part_name.endswith(view) and part_name[: -len(view)].endswith((".", "-", "_")):
        return part_name[: -len(view) - 1]
    return part_name


def read_parts(path: PathLike) -> list[Part]:
    """Return every channel of a flat file as stored, after checking what the header promises."""
    headers = read_headers(path)
    check_headers(path, headers)
    check_chunks(path)
    carried = carried_attributes(path)
    file, messages = _open(path, header_only=False)
    parts = []
    for part, attributes in zip(file.parts, carried, strict=False):  # their number is checked below
        data = window(part.header["dataWindow"])
        planes = {
            name: Plane(channel.pixels, data, (channel.xSampling, channel.ySampling))
            for name, channel in part.channels.items()
        }
        parts.append(part_of(part.header, planes, attributes))
    # The binding skips parts that it fails to decode.
    if len(parts) < len(headers) or not all(part.planes for part in parts):
        raise InvalidFileError(f"{path}: the pixels are truncated or corrupt{_detail(path, messages)}")
    return parts


def part_of(header: Mapping[str, Any], planes: Mapping[str, Plane], attributes: Mapping[str, Attribute]) -> Part:
    """Return a part of a file by its header, its channels, and the attributes that do not describe its own pixels."""
    return Part(str(header.get("name", "")), header, planes, attributes)


def read_headers(path: PathLike) -> list[Mapping[str, Any]]:
    """Return the header of each part; no pixel is read. Raises InvalidFileError if the file is missing or malformed."""
    if not os.path.isfile(path):
        raise InvalidFileError(f"{path}: there is no such file")
    file, _ = _open(path, header_only=True)
    check_structure(path)
    headers = [part.header for part in file.parts]
    try:
        for header in headers:
            [channel.name for channel in header["channels"]]  # the binding decodes them when they are asked for
    except UnicodeDecodeError:
        raise InvalidFileError(f"{path}: a channel's name is not text") from None
    return headers


def is_deep(header: Mapping[str, Any]) -> bool:
    """Tell whether a part's header is that of a deep image."""
    return header.get("type") in (OpenEXR.deepscanline, OpenEXR.deeptile)


def _open(path: PathLike, *, header_only: bool) -> tuple[Any, list[str]]:
    """Return the binding's file object and what the library printed."""
    messages: list[str] = []
    try:
        with library_messages() as messages:
            return OpenEXR.File(os.fspath(path), separate_channels=True, header_only=header_only), messages
    except LIBRARY_ERRORS as error:
        if other := other_kind(path):
            raise InvalidFileError(f"{path}: is {other}; frames and images are read from OpenEXR") from None
        raise InvalidFileError(
            f"{path}: is not a readable OpenEXR file{_detail(path, messages or [str(error)])}"
        ) from None


def other_kind(path: PathLike) -> str:
    """Return what a file is by its first bytes, such as ``"a PNG"``, or an empty string."""
    try:
        with open(path, "rb") as file:
            start = file.read(16)
    except OSError:
        return ""
    return next((kind for magic, kind in OTHER_KINDS if start.startswith(magic)), "")


def _detail(path: PathLike, messages: Sequence[str]) -> str:
    """Return the library's first message, in brackets, without the path that it starts with."""
    return f" ({messages[0].removeprefix(f'{path}: ')})" if messages else ""


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


def check_headers(path: PathLike, headers: Sequence[Mapping[str, Any]], *, deep: bool = False) -> None:
    """Raise InvalidFileError before any pixel is read if a file is larger than `MAX_VALUES`, or deep if not allowed."""
    total = stored = 0
    for header in headers:
        if is_deep(header) and not deep:
            raise InvalidFileError(f"{path}: holds a deep image; only flat images can be read here")
        if header.get("type") == OpenEXR.deeptile:
            raise InvalidFileError(f"{path}: holds deep tiles; only deep scanlines can be read")
        data, display = window(header["dataWindow"]), window(header["displayWindow"])
        if min(*data[2:], *display[2:]) < 1:
            raise InvalidFileError(f"{path}: has an empty window")
        if display != window(headers[0]["displayWindow"]):
            raise InvalidFileError(f"{path}: its parts have different display windows")
        total += max(data.width * data.height, display.width * display.height) * len(header["channels"])
        if not is_deep(header):
            stored += _least_stored(header, data)
    if any(is_deep(header) for header in headers):
        total += deep_sample_bytes(path) // FLOAT_BYTES
    if total > MAX_VALUES:
        raise InvalidFileError(f"{path}: holds {total} values (pixels times channels); at most {MAX_VALUES} are read")
    if stored > os.path.getsize(path):
        raise InvalidFileError(f"{path}: is too short for the {total} values that it promises: truncated or corrupt")


def _least_stored(header: Mapping[str, Any], data: Window) -> int:
    """Return the fewest bytes that a flat part can take in a file."""
    expansion = EXPANSION.get(header.get("compression"))
    if expansion is None:
        return 0
    values = sum(data.width * data.height // (each.xSampling * each.ySampling) for each in header["channels"])
    return int(values) * LEAST_BYTES // expansion


def window(box: tuple[npt.NDArray[np.int32], npt.NDArray[np.int32]]) -> Window:
    """Return an OpenEXR box, whose maximum is inclusive, as left, top, width, height."""
    (left, top), (right, bottom) = ((int(x), int(y)) for x, y in box)
    return Window(left, top, right - left + 1, bottom - top + 1)


# --- Channels to arrays --------------------------------------------------------------------------------------------


def check_same_window(image: Image, names: Sequence[str]) -> None:
    """Raise InvalidFileError unless the channels have every pixel of one common window."""
    first = image.planes[names[0]]
    for name in names:
        plane = image.planes[name]
        if plane.sampling != (1, 1):
            raise InvalidFileError(f"{image.path}: channel {name} is subsampled; every pixel needs a value")
        if plane.window != first.window or plane.pixels.shape != (plane.window.height, plane.window.width):
            raise InvalidFileError(
                f"{image.path}: channel {name} covers {plane.window.width} x {plane.window.height} px at "
                f"({plane.window.left}, {plane.window.top}), channel {names[0]} {first.window.width} x "
                f"{first.window.height} px at ({first.window.left}, {first.window.top}); they must agree"
            )


def gather(image: Image, names: Sequence[str], target: Window | None = None, fill: float = 0.0) -> FloatArray:
    """Return channels as (H, W, n) float32 in a window, filled where their data windows do not reach.

    Parameters
    ----------
    image : Image
    names : sequence of str
        Channels, each with every pixel of its own data window.
    target : Window, optional
        By default the display window.
    fill : float
        What stands where a channel has no pixel.
    """
    target = image.display if target is None else target
    result = np.full((*target.shape, len(names)), fill, np.float32)
    for index, name in enumerate(names):
        plane = image.planes[name]
        there, here = overlap(target, plane.window)
        result[(*there, index)] = plane.pixels[here]
    return result


def covered(image: Image, name: str, target: Window) -> BoolArray:
    """Return which pixels (H, W) of a window a channel has."""
    inside = np.zeros(target.shape, np.bool_)
    inside[overlap(target, image.planes[name].window)[0]] = True
    return inside


# --- Writing -------------------------------------------------------------------------------------------------------


def part_header() -> dict[str, Any]:
    """Return the header attributes that every flat part is written with."""
    return {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
