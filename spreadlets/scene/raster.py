"""Where a frame's pixels lie: its data and display windows, the shape of a pixel, and what its file says besides."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from spreadlets.arrays import FloatArray
from spreadlets.errors import InvalidFrameError

MOST_ASPECT = 8.0
"""Of a pixel, or of its reciprocal: anamorphic lenses and video formats stay below 2."""


class Window(NamedTuple):
    """A pixel rectangle: left column, top row, width, height."""

    left: int
    top: int
    width: int
    height: int

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width, px."""
        return self.height, self.width

    def union(self, other: Window) -> Window:
        """Return the smallest rectangle that holds both."""
        left, top = min(self.left, other.left), min(self.top, other.top)
        right = max(self.left + self.width, other.left + other.width)
        bottom = max(self.top + self.height, other.top + other.height)
        return Window(left, top, right - left, bottom - top)


def overlap(first: Window, second: Window) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Return the rows and columns that two windows share, counted in the one and in the other."""
    left, right = max(first.left, second.left), min(first.left + first.width, second.left + second.width)
    top, bottom = max(first.top, second.top), min(first.top + first.height, second.top + second.height)
    right, bottom = max(left, right), max(top, bottom)
    shared = [(slice(top - w.top, bottom - w.top), slice(left - w.left, right - w.left)) for w in (first, second)]
    return shared[0], shared[1]


def placed(values: FloatArray, window: Window, target: Window, fill: float = 0.0) -> FloatArray:
    """Return an array (H, W, ...) of one window as it lies in another, filled where it does not reach."""
    if window == target:
        return values
    result = np.full((*target.shape, *values.shape[2:]), fill, values.dtype)
    there, here = overlap(target, window)
    result[there] = values[here]
    return result


class Attribute(NamedTuple):
    """An attribute of an OpenEXR header: the name of its type, and its value as it is stored."""

    kind: str
    value: bytes


@dataclass(frozen=True)
class Raster:
    """Where the pixels of a frame lie.

    Attributes
    ----------
    data : Window
        Of the pixels that there are. It may reach beyond the display window (overscan), or fill a part of it.
    display : Window
        The picture that the camera sees: the sensor's width spans its width.
    pixel_aspect : float
        Width of a pixel over its height, as displayed.
    stored : Window or None
        The data window of the file, if `data` holds empty pixels around it that the blur may reach.
    attributes : mapping of str to Attribute
        What the header says besides, such as chromaticities and time code.

    Raises
    ------
    InvalidFrameError
        If a window is empty or the pixel aspect is beyond `MOST_ASPECT`.

    Examples
    --------
    >>> raster = Raster(Window(-8, -8, 116, 76), Window(0, 0, 100, 60))
    >>> raster.centre
    (57.5, 37.5)
    """

    data: Window
    display: Window
    pixel_aspect: float = 1.0
    stored: Window | None = None
    attributes: Mapping[str, Attribute] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if min(*self.data.shape, *self.display.shape) < 1:
            raise InvalidFrameError("a window is empty; data and display windows need at least one pixel")
        if not 1 / MOST_ASPECT <= self.pixel_aspect <= MOST_ASPECT:
            raise InvalidFrameError(
                f"the pixel aspect ratio is {self.pixel_aspect:g}; "
                f"it must be from {1 / MOST_ASPECT:g} to {MOST_ASPECT:g}"
            )

    @classmethod
    def of_shape(cls, shape: tuple[int, int]) -> Raster:
        """Return that of a plain image (H, W): square pixels, all of them displayed."""
        window = Window(0, 0, shape[1], shape[0])
        return cls(window, window)

    @property
    def centre(self) -> tuple[float, float]:
        """Column and row, counted in the data window, of the display window's centre."""
        x = self.display.left - self.data.left + 0.5 * (self.display.width - 1)
        y = self.display.top - self.data.top + 0.5 * (self.display.height - 1)
        return x, y

    @property
    def off_middle(self) -> tuple[float, float]:
        """From the data window's middle to the display window's centre, columns and rows."""
        x, y = self.centre
        return x - 0.5 * (self.data.width - 1), y - 0.5 * (self.data.height - 1)

    def reaching(self, window: Window) -> Raster:
        """Return the raster of the same frame in a data window that holds its own."""
        return replace(self, data=window, stored=self.stored or self.data)

    def written(self, image: FloatArray) -> Window:
        """Return the part of the data window that an image (H, W, C) fills: the file's, and where it is not zero."""
        if self.stored is None:
            return self.data
        rows, cols = (np.flatnonzero(np.any(image, axis=axes)) for axes in ((1, 2), (0, 2)))
        if not len(rows):
            return self.stored
        first, last = (int(cols[0]), int(rows[0])), (int(cols[-1]), int(rows[-1]))
        left, top = self.data.left + first[0], self.data.top + first[1]
        return self.stored.union(Window(left, top, last[0] - first[0] + 1, last[1] - first[1] + 1))
