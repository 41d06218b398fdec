"""Image files in and out: frames and images as OpenEXR, previews as PNG.

The names and meanings of the channels are tables (`MOTION_CONVENTIONS`, `DEPTH_NAMES`, `COLOUR_NAMES`): another
renderer is another row.
"""

from __future__ import annotations

import contextlib
import io
import os
import secrets
import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import OpenEXR

from spreadlets.errors import InvalidFileError, InvalidFrameError, InvalidParameterError
from spreadlets.frame import FloatArray, Frame, Layer, image_array
from spreadlets.metrics import display_encode

PathLike = str | os.PathLike[str]
Matrix = tuple[tuple[float, ...], tuple[float, ...]]

MAX_VALUES = 1 << 30
"""Most values (pixels times channels, over all parts) that are read: 4 GiB as float32, an 8K frame of 32 channels."""

LIBRARY_ERRORS = (RuntimeError, ValueError, TypeError)
"""What the OpenEXR binding raises on files and headers that it cannot handle."""

HALF_MAX = float(np.finfo(np.float16).max)

RESERVED_METADATA = frozenset(
    {
        "channels",
        "chunkCount",
        "compression",
        "dataWindow",
        "displayWindow",
        "lineOrder",
        "name",
        "pixelAspectRatio",
        "screenWindowCenter",
        "screenWindowWidth",
        "tiles",
        "type",
        "version",
    }
)
"""Header attributes that describe the file itself; other values there would break it."""

_STDERR_DESCRIPTOR = 2
_STDERR_LOCK = threading.Lock()


@dataclass(frozen=True)
class MotionConvention:
    """How a renderer's motion channels become px per frame, y down, forward in time.

    Attributes
    ----------
    channels : tuple of str
        Names to look for, behind any layer prefix; empty if the channels must be given.
    motion, motion_prev, motion_next : 2 x n matrix or None
        Rows of dx and dy as weights of the n channels; `motion` is None where it is the mean of the other two.
    """

    channels: tuple[str, ...]
    motion: Matrix | None = None
    motion_prev: Matrix | None = None
    motion_next: Matrix | None = None

    @property
    def n_channels(self) -> int:
        """How many channels the convention takes."""
        return max(len(m[0]) for m in (self.motion, self.motion_prev, self.motion_next) if m is not None)


MOTION_CONVENTIONS: Mapping[str, MotionConvention] = {
    # XY = P(prev) - P(cur), ZW = P(cur) - P(next), px per frame, y up.
    "blender": MotionConvention(
        ("Vector.X", "Vector.Y", "Vector.Z", "Vector.W"),
        motion_prev=((-1, 0, 0, 0), (0, 1, 0, 0)),
        motion_next=((0, 0, -1, 0), (0, 0, 0, 1)),
    ),
    # Our own: px per frame, y down, forward in time.
    "forward-px": MotionConvention(("motion.x", "motion.y"), motion=((1, 0), (0, 1))),
    # Our own with a curved path, as `write_frame` stores it.
    "curved-px": MotionConvention(
        ("motion.x", "motion.y", "motion_prev.x", "motion_prev.y", "motion_next.x", "motion_next.y"),
        motion=((1, 0, 0, 0, 0, 0), (0, 1, 0, 0, 0, 0)),
        motion_prev=((0, 0, 1, 0, 0, 0), (0, 0, 0, 1, 0, 0)),
        motion_next=((0, 0, 0, 0, 1, 0), (0, 0, 0, 0, 0, 1)),
    ),
    # P(prev) - P(cur), px per frame, y down. Nobody's default name, so the channels must be given.
    "backward-px": MotionConvention((), motion=((-1, 0), (0, -1))),
    # Nuke's forward layer: P(next) - P(cur), px per frame, y up.
    "nuke-forward": MotionConvention(("forward.u", "forward.v"), motion=((1, 0), (0, -1))),
}
"""Motion conventions by the name that the `motion_convention` option takes."""

DEPTH_CONVENTIONS: Mapping[str, Callable[[FloatArray], FloatArray]] = {
    "planar": lambda depth: depth,
    "inverse": lambda depth: np.divide(np.float32(1), depth),
}
"""Planar depth in metres from a depth channel, by the name that the `depth_convention` option takes."""

DEPTH_NAMES = ("depth.Z", "Depth.Z")
"""Depth channels, behind any layer prefix; a plain ``Z`` counts only beside the colour (normals have a Z, too)."""

COLOUR_NAMES = ("Combined.", "rgba.", "RGBA.", "beauty.", "Beauty.", "")
"""What stands before R, G, B in the main image, behind any layer prefix, if there are no plain R, G, B; first wins."""


class _Window(NamedTuple):
    """A pixel rectangle: left column, top row, width, height."""

    left: int
    top: int
    width: int
    height: int


@dataclass(frozen=True, eq=False)
class _Plane:
    """One channel's pixels where the file stores them."""

    pixels: npt.NDArray[Any]
    window: _Window
    sampling: tuple[int, int]


@dataclass(frozen=True, eq=False)
class _Part:
    """One part of a file: its channels by the names that they have in the file."""

    name: str
    planes: Mapping[str, _Plane]
    display: _Window
    view: str


@dataclass(frozen=True, eq=False)
class _Image:
    """The channels of a file, or of one layer part, by their full names."""

    path: PathLike
    planes: Mapping[str, _Plane]
    display: _Window

    def problem(self, what: str, option: str) -> InvalidFileError:
        """Return an error that lists the channels and names the option that settles the matter."""
        found = ", ".join(sorted(self.planes)) or "none"
        return InvalidFileError(f"{self.path}: {what}; name it with {option}. Channels found: {found}")


def read_frame(
    paths: PathLike | Sequence[PathLike],
    *,
    colour_layer: str | None = None,
    depth_channel: str | None = None,
    motion_channels: Sequence[str] | None = None,
    depth_convention: str = "planar",
    motion_convention: str | None = None,
    repair: bool = False,
) -> Frame:
    """Read a frame of labelled pixels from OpenEXR files.

    Parameters
    ----------
    paths : path or sequence of paths
        One file is a whole frame, or depth layers if each of its parts holds R, G, B, A and Z. Several files are depth
        layers, nearest first, premultiplied by alpha.
    colour_layer : str, optional
        Prefix of the colour channels, e.g. ``"ViewLayer.Combined"``; by default the main image is looked for.
    depth_channel : str, optional
        Name of the depth channel; by default a known name is looked for.
    motion_channels : sequence of str, optional
        Names of the motion channels in the order of the convention; by default known names are looked for.
    depth_convention : {'planar', 'inverse'}
        Whether the depth channel holds planar metres or their inverse.
    motion_convention : str, optional
        A key of `MOTION_CONVENTIONS`; by default it follows from the channels' names.
    repair : bool
        Drop pixels with invalid values instead of raising, see `Frame`.

    Returns
    -------
    Frame
        In the file's display window; where the data window does not reach, pixels are empty. Without motion channels
        the frame is still.

    Raises
    ------
    InvalidFileError
        If a file cannot be read, or a channel is missing, ambiguous, or does not cover the image.
    InvalidFrameError
        If the values are invalid, or the layers' shapes differ.
    InvalidParameterError
        If a convention's name is unknown, or takes another number of channels than are named.
    """
    _check_choice("depth_convention", depth_convention, DEPTH_CONVENTIONS)
    if motion_convention is not None:
        _check_choice("motion_convention", motion_convention, MOTION_CONVENTIONS)
    files = [paths] if isinstance(paths, str | os.PathLike) else list(paths)
    layers = []
    for image in (image for path in files for image in _layer_images(path)):
        colour = _find_colour(image, colour_layer)
        depth = _find_depth(image, depth_channel)
        motion = _find_motion(image, motion_channels, motion_convention)
        _check_same_window(image, [*colour, depth, *(motion[1] if motion else ())])
        labels = {} if motion is None else _motion_labels(*motion, image)
        with np.errstate(divide="ignore"):  # an inverse depth of zero is infinitely far
            planar = DEPTH_CONVENTIONS[depth_convention](_gather(image, (depth,))[..., 0])
        layers.append(_named_frame(image, _radiance(image, colour), planar, labels, repair))
    return layers[0] if len(layers) == 1 else Frame.from_layers(layers)


def read_image(path: PathLike, *, colour_layer: str | None = None) -> FloatArray:
    """Read the colours of an OpenEXR file.

    Parameters
    ----------
    path : path
        The file.
    colour_layer : str, optional
        Prefix of the colour channels, e.g. ``"ViewLayer.Combined"``; by default the main image is looked for.

    Returns
    -------
    ndarray of shape (H, W, 3) or (H, W, 4), float32
        Linear values in the display window; with alpha if the file has it, or does not fill the window.

    Raises
    ------
    InvalidFileError
        If the file cannot be read, or its colour channels are missing, ambiguous, or do not cover the image.
    """
    image = _merged(path, _read_parts(path))
    colour = _find_colour(image, colour_layer)
    _check_same_window(image, colour)
    return _radiance(image, colour)


def write_image(
    path: PathLike,
    radiance: npt.ArrayLike,
    *,
    half: bool = False,
    metadata: Mapping[str, str | int | float] | None = None,
) -> None:
    """Write an image as OpenEXR; the file appears whole or not at all.

    Parameters
    ----------
    path : path
        Where to write; an existing file is replaced.
    radiance : array_like of shape (H, W, 3) or (H, W, 4)
        Linear values, stored as R, G, B and A.
    half : bool
        Store 16-bit floats (values beyond 65504 are clipped) instead of 32-bit ones.
    metadata : mapping, optional
        Header attributes: names to strings, integers or floats.

    Raises
    ------
    InvalidFrameError
        If `radiance` is no such array.
    InvalidParameterError
        If the metadata has a reserved name or a value of another type.
    InvalidFileError
        If the file cannot be written.
    """
    image = image_array("radiance", radiance)
    channels = {name: image[..., index] for index, name in enumerate("RGBA"[: image.shape[2]])}
    if half:
        channels = {name: np.clip(plane, -HALF_MAX, HALF_MAX) for name, plane in channels.items()}
    stored = {name: np.ascontiguousarray(plane, np.float16 if half else np.float32) for name, plane in channels.items()}
    header = {**_checked_metadata(metadata or {}), **_part_header()}
    with atomic_path(path, ".exr") as temporary, _library_messages():
        OpenEXR.File(header, stored).write(str(temporary))


def write_frame(path: PathLike, frame: Frame) -> None:
    """Write a frame as OpenEXR so that `read_frame` gives it back; the file appears whole or not at all.

    Parameters
    ----------
    path : path
        Where to write; an existing file is replaced.
    frame : Frame
        Stored as 32-bit floats R, G, B, A, Z, and motion.x, motion.y (px per frame, y down, forward) where the frame
        has motion, with motion_prev and motion_next for a curved path; several layers as parts layer0, layer1, ...

    Raises
    ------
    InvalidFileError
        If the file cannot be written.
    """
    parts = [
        OpenEXR.Part({**_part_header(), "name": f"layer{index}"}, _frame_channels(layer))
        for index, layer in enumerate(frame.layers)
    ]
    with atomic_path(path, ".exr") as temporary, _library_messages():
        OpenEXR.File(parts).write(str(temporary))


def write_png(path: PathLike, radiance: npt.ArrayLike) -> None:
    """Write an image as an 8-bit sRGB PNG for viewing; the file appears whole or not at all.

    Parameters
    ----------
    path : path
        Where to write; an existing file is replaced.
    radiance : array_like of shape (H, W, 3) or (H, W, 4)
        Linear values; premultiplied colours are shown over black, NaN as black.

    Raises
    ------
    InvalidFrameError
        If `radiance` is no such array.
    InvalidFileError
        If the file cannot be written.
    """
    from skimage.io import imsave

    encoded = display_encode(image_array("radiance", radiance)[..., :3])
    pixels = np.rint(255 * np.nan_to_num(encoded)).astype(np.uint8)
    with atomic_path(path, ".png") as temporary:
        imsave(str(temporary), pixels, check_contrast=False)


# --- Reading -------------------------------------------------------------------------------------------------------


def _layer_images(path: PathLike) -> list[_Image]:
    """Return a file's depth layers: one per part if each part holds R, G, B, A and Z, else one from all parts."""
    parts = _read_parts(path)
    one_view = len({part.view for part in parts}) == 1  # the parts of a stereo image are no layers
    if one_view and all({"R", "G", "B", "A", "Z"} <= part.planes.keys() for part in parts):
        return [_Image(path, part.planes, part.display) for part in parts]
    return [_merged(path, parts)]


def _merged(path: PathLike, parts: Sequence[_Part]) -> _Image:
    """Return all parts' channels in one; in a file of several parts the part's name leads, if it does not already."""
    planes: dict[str, _Plane] = {}
    for part in parts:
        for name, plane in part.planes.items():
            bare = len(parts) == 1 or not part.name or name.startswith(part.name + ".")
            planes[name if bare else f"{part.name}.{name}"] = plane
    return _Image(path, planes, parts[0].display)


def _read_parts(path: PathLike) -> list[_Part]:
    """Return every channel of a file as stored, after checking what the header promises."""
    if not os.path.isfile(path):
        raise InvalidFileError(f"{path}: there is no such file")
    header, _ = _open(path, header_only=True)
    _check_headers(path, [part.header for part in header.parts])
    file, messages = _open(path, header_only=False)
    parts = [
        _Part(
            part.name(),
            {
                name: _Plane(channel.pixels, _window(part.header["dataWindow"]), (channel.xSampling, channel.ySampling))
                for name, channel in part.channels.items()
            },
            _window(part.header["displayWindow"]),
            str(part.header.get("view", "")),
        )
        for part in file.parts
    ]
    # The binding skips parts that it fails to decode.
    if len(parts) < len(header.parts) or not all(part.planes for part in parts):
        raise InvalidFileError(f"{path}: the pixels are truncated or corrupt{_detail(path, messages)}")
    return parts


def _open(path: PathLike, *, header_only: bool) -> tuple[Any, list[str]]:
    """Return the binding's file object and what the library printed."""
    messages: list[str] = []
    try:
        with _library_messages() as messages:
            return OpenEXR.File(os.fspath(path), separate_channels=True, header_only=header_only), messages
    except LIBRARY_ERRORS as error:
        raise InvalidFileError(
            f"{path}: is not a readable OpenEXR file{_detail(path, messages or [str(error)])}"
        ) from None


def _detail(path: PathLike, messages: Sequence[str]) -> str:
    """Return the library's first message, in brackets, without the path that it starts with."""
    return f" ({messages[0].removeprefix(f'{path}: ')})" if messages else ""


@contextlib.contextmanager
def _library_messages() -> Iterator[list[str]]:
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


def _check_headers(path: PathLike, headers: Sequence[Mapping[str, Any]]) -> None:
    """Raise InvalidFileError before any pixel is read if a file is deep, or larger than `MAX_VALUES`."""
    total = 0
    for header in headers:
        if header.get("type") in (OpenEXR.deepscanline, OpenEXR.deeptile):
            raise InvalidFileError(f"{path}: holds a deep image; only flat images can be read")
        data, display = _window(header["dataWindow"]), _window(header["displayWindow"])
        if min(*data[2:], *display[2:]) < 1:
            raise InvalidFileError(f"{path}: has an empty window")
        if display != _window(headers[0]["displayWindow"]):
            raise InvalidFileError(f"{path}: its parts have different display windows")
        total += max(data.width * data.height, display.width * display.height) * len(header["channels"])
    if total > MAX_VALUES:
        raise InvalidFileError(f"{path}: holds {total} values (pixels times channels); at most {MAX_VALUES} are read")


def _window(box: tuple[npt.NDArray[np.int32], npt.NDArray[np.int32]]) -> _Window:
    """Return an OpenEXR box, whose maximum is inclusive, as left, top, width, height."""
    (left, top), (right, bottom) = ((int(x), int(y)) for x, y in box)
    return _Window(left, top, right - left + 1, bottom - top + 1)


# --- Finding channels ----------------------------------------------------------------------------------------------


def _groups(image: _Image, names: Sequence[str]) -> list[tuple[str, ...]]:
    """Return every set of channels that carries these names behind one prefix."""
    heads = [name for name in image.planes if name == names[0] or name.endswith("." + names[0])]
    prefixes = [head.removesuffix(names[0]) for head in heads]
    groups = [tuple(prefix + name for name in names) for prefix in prefixes]
    return [group for group in groups if all(name in image.planes for name in group)]


def _find_colour(image: _Image, layer: str | None) -> tuple[str, ...]:
    """Return the names of R, G, B and, if there is one, A."""
    if layer is not None:
        groups = [tuple(f"{layer}.{name}" for name in "RGB")]
        if not set(groups[0]) <= image.planes.keys():
            raise image.problem(f"lacks {', '.join(groups[0])}", "colour_layer")
    elif {"R", "G", "B"} <= image.planes.keys():
        groups = [("R", "G", "B")]
    else:
        known = (_groups(image, [prefix + name for name in "RGB"]) for prefix in COLOUR_NAMES)
        groups = next((groups for groups in known if groups), [])
    if len(groups) != 1:
        raise image.problem("the colour channels are ambiguous" if groups else "lacks colour channels", "colour_layer")
    alpha = groups[0][0].removesuffix("R") + "A"
    return (*groups[0], alpha) if alpha in image.planes else groups[0]


def _find_depth(image: _Image, channel: str | None) -> str:
    """Return the name of the depth channel."""
    if channel is not None:
        if channel not in image.planes:
            raise image.problem(f"lacks the depth channel {channel}", "depth_channel")
        return channel
    beside_colour = [z for z, _ in _groups(image, ("Z", "R"))]
    plain = ["Z"] if "Z" in image.planes else []
    named = [group[0] for name in DEPTH_NAMES for group in _groups(image, (name,))]
    found = list(dict.fromkeys(plain + beside_colour + named))
    if len(found) != 1:
        what = f"has several depth channels ({', '.join(found)})" if found else "lacks a depth channel"
        raise image.problem(what, "depth_channel")
    return found[0]


def _find_motion(
    image: _Image, channels: Sequence[str] | None, convention: str | None
) -> tuple[MotionConvention, tuple[str, ...]] | None:
    """Return the motion convention and its channels, or None if the file has no motion."""
    rows = MOTION_CONVENTIONS if convention is None else {convention: MOTION_CONVENTIONS[convention]}
    if channels is not None:
        return _given_motion(image, tuple(channels), rows)
    found = [(row, group) for row in rows.values() if row.channels for group in _groups(image, row.channels)]
    # A convention that extends another one is the one that was meant.
    found = [(row, group) for row, group in found if not any(set(group) < set(other) for _, other in found)]
    if len(found) > 1:
        names = " or ".join(", ".join(group) for _, group in found)
        raise image.problem(f"has several sets of motion channels ({names})", "motion_channels or motion_convention")
    if not found and convention is not None:
        raise image.problem(f"lacks the motion channels of the convention {convention}", "motion_channels")
    return found[0] if found else None


def _given_motion(
    image: _Image, channels: tuple[str, ...], rows: Mapping[str, MotionConvention]
) -> tuple[MotionConvention, tuple[str, ...]]:
    """Return the convention of explicitly named channels: the only row allowed, or the one with these names."""
    missing = [name for name in channels if name not in image.planes]
    if missing:
        raise image.problem(f"lacks the motion channel {', '.join(missing)}", "motion_channels")
    if len(rows) == 1:
        ((name, row),) = rows.items()
        if len(channels) != row.n_channels:
            raise InvalidParameterError(
                f"motion_channels names {len(channels)} channels; the motion_convention {name} takes {row.n_channels}"
            )
        return row, channels
    for row in rows.values():
        if row.channels and channels in _groups(image, row.channels):
            return row, channels
    raise image.problem(f"the meaning of {', '.join(channels)} is not known", "motion_convention")


def _check_choice(option: str, value: str, allowed: Mapping[str, object]) -> None:
    """Raise InvalidParameterError unless an option has one of its values."""
    if value not in allowed:
        raise InvalidParameterError(f"{option} is {value!r}; allowed are {', '.join(allowed)}")


# --- Channels to arrays --------------------------------------------------------------------------------------------


def _check_same_window(image: _Image, names: Sequence[str]) -> None:
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


def _gather(image: _Image, names: Sequence[str]) -> FloatArray:
    """Return channels as (H, W, n) float32 in the display window, zero where the data window does not reach."""
    display = image.display
    result = np.zeros((display.height, display.width, len(names)), np.float32)
    for index, name in enumerate(names):
        plane = image.planes[name]
        target, source = _overlap(display, plane.window)
        result[(*target, index)] = plane.pixels[source]
    return result


def _overlap(display: _Window, data: _Window) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Return the rows and columns that two windows share, counted in the one and in the other."""
    left, right = max(display.left, data.left), min(display.left + display.width, data.left + data.width)
    top, bottom = max(display.top, data.top), min(display.top + display.height, data.top + data.height)
    right, bottom = max(left, right), max(top, bottom)
    shared = [(slice(top - w.top, bottom - w.top), slice(left - w.left, right - w.left)) for w in (display, data)]
    return shared[0], shared[1]


def _radiance(image: _Image, names: Sequence[str]) -> FloatArray:
    """Return the colours; opaque ones get an alpha where their data window does not fill the display window."""
    colours = _gather(image, names)
    window = image.planes[names[0]].window
    if len(names) == 4 or window == image.display:
        return colours
    coverage = np.zeros((*colours.shape[:2], 1), np.float32)
    coverage[_overlap(image.display, window)[0]] = 1
    return np.concatenate([colours, coverage], axis=2)


def _motion_labels(convention: MotionConvention, names: Sequence[str], image: _Image) -> dict[str, FloatArray]:
    """Return the motion arrays that a convention defines, by the names of `Frame`'s parameters."""
    matrices = {
        "motion": convention.motion,
        "motion_prev": convention.motion_prev,
        "motion_next": convention.motion_next,
    }
    channels = _gather(image, names)
    return {name: _combined(channels, matrix) for name, matrix in matrices.items() if matrix is not None}


def _combined(channels: FloatArray, matrix: Matrix) -> FloatArray:
    """Return weighted sums of channels, (H, W, 2); a channel of weight zero is not touched, so its NaN stays out."""
    result = np.zeros((*channels.shape[:2], 2), np.float32)
    for axis, weights in enumerate(matrix):
        for index, weight in enumerate(weights):
            if weight:
                result[..., axis] += np.float32(weight) * channels[..., index]
    return result


def _named_frame(
    image: _Image, radiance: FloatArray, depth: FloatArray, labels: Mapping[str, FloatArray], repair: bool
) -> Frame:
    """Return a frame; its errors start with the file's path."""
    try:
        return Frame(radiance, depth, **labels, repair=repair)
    except InvalidFrameError as error:
        raise InvalidFrameError(f"{image.path}: {error}") from None


# --- Writing -------------------------------------------------------------------------------------------------------


@contextlib.contextmanager
def atomic_path(path: PathLike, suffix: str) -> Iterator[Path]:
    """Give a temporary path in the target's folder; it becomes the target on success, and is removed on failure."""
    target = Path(os.path.realpath(path))
    if os.path.exists(target) and not os.path.isfile(target):  # unlike Path's, these never raise
        raise InvalidFileError(f"{path}: cannot be written: it exists and is not a regular file")
    if not os.path.isdir(target.parent):
        raise InvalidFileError(f"{path}: cannot be written: there is no folder {target.parent}")
    temporary = target.with_name(f".spreadlets-{secrets.token_hex(8)}{suffix}")
    try:
        yield temporary
        os.replace(temporary, target)
    except (OSError, *LIBRARY_ERRORS) as error:
        raise InvalidFileError(f"{path}: cannot be written: {error}") from error
    finally:
        temporary.unlink(missing_ok=True)


def _part_header() -> dict[str, Any]:
    return {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}


def _checked_metadata(metadata: Mapping[str, str | int | float]) -> dict[str, str | int | float]:
    """Return the metadata, or raise InvalidParameterError if the header cannot hold it."""
    for name, value in metadata.items():
        if name in RESERVED_METADATA:
            raise InvalidParameterError(f"metadata {name!r} is reserved: it describes the file itself")
        if isinstance(value, bool) or not isinstance(value, str | int | float):
            raise InvalidParameterError(f"metadata {name!r} is {value!r}; it must be a string, an integer or a float")
    return dict(metadata)


def _frame_channels(layer: Layer) -> dict[str, FloatArray]:
    """Return a layer's channels by name, as contiguous planes."""
    channels = {name: layer.radiance[..., index] for index, name in enumerate("RGBA")}
    channels["Z"] = layer.depth
    paths = {"motion": layer.motion if layer.has_motion else None}
    paths |= {"motion_prev": layer.motion_prev, "motion_next": layer.motion_next}
    for name, path in paths.items():
        if path is not None:
            channels |= {f"{name}.x": path[..., 0], f"{name}.y": path[..., 1]}
    return {name: np.ascontiguousarray(plane) for name, plane in channels.items()}
