"""Parts of OpenEXR files as named channels, and these as arrays; no meaning is attached here.

What the channels mean is told by `spreadlets.files.conventions` and `spreadlets.files.recognise`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import OpenEXR

from spreadlets.arrays import BoolArray, FloatArray, PathLike
from spreadlets.errors import InvalidFileError, option
from spreadlets.scene.raster import Attribute, Raster, Window, overlap


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

    @classmethod
    def of(cls, header: Mapping[str, Any], planes: Mapping[str, Plane], attributes: Mapping[str, Attribute]) -> Part:
        """Return a part by its header, its channels, and the attributes that do not describe its own pixels."""
        return cls(str(header.get("name", "")), header, planes, attributes)

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


# --- Names ---------------------------------------------------------------------------------------------------------


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


def raster_header(raster: Raster, data: Window) -> dict[str, Any]:
    """Return the header attributes that say where the pixels of a data window lie."""
    header: dict[str, Any] = {"dataWindow": _box(data), "displayWindow": _box(raster.display)}
    return header | {"pixelAspectRatio": float(raster.pixel_aspect)}


def _box(window: Window) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int32]]:
    """Return a window as the OpenEXR binding takes it: with an inclusive maximum."""
    left, top, width, height = window
    return np.array([left, top], np.int32), np.array([left + width - 1, top + height - 1], np.int32)
