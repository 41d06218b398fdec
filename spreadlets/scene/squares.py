"""Pixels that are no squares: the frame as squares, for what is round on the sensor, and the image back as pixels.

A pixel that is f times as wide as high becomes n squares of 1/d of its height, n nearest to f d^2: d rows of n/d each.
That need not be a whole number. Then rows begin at different places, row r of pixel i at ``floor((i n + r) / d)``, so
that by Hermite's identity every pixel has the same number of squares. So what is sharp comes back as it was, the light
of every pixel counts alike, and a surface of one colour stays one. Of a pixel that is higher than wide columns do so.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import FloatArray
from spreadlets.scene.frame import Frame, Layer
from spreadlets.scene.raster import Raster, Window
from spreadlets.scene.samples import SampleBuffer

NEARLY = 0.02
"""How far, relatively, a pixel's shape may lie from that of its squares; of a bokeh 50 px wide it is a pixel."""
MOST_DIVISIONS = 4
"""Squares along a pixel's shorter side, at most: there are the square of it, times the aspect, for each pixel."""

Indices = npt.NDArray[np.intp]
Value = TypeVar("Value", np.float32, np.bool_)


@dataclass(frozen=True)
class Grid:
    """How pixels are divided into squares.

    Attributes
    ----------
    count : int
        Squares of a pixel.
    divisions : int
        Squares along its shorter side.
    upright : bool
        Whether that is the width.
    """

    count: int
    divisions: int
    upright: bool

    @classmethod
    def of(cls, pixel_aspect: float) -> Grid:
        """Return the coarsest that fits a pixel's shape, or else the one that fits best."""
        longer = max(pixel_aspect, 1 / pixel_aspect)
        found = [(round(longer * d * d), d) for d in range(1, MOST_DIVISIONS + 1)]
        errors = [abs(n / (d * d * longer) - 1) for n, d in found]
        fitting = [pair for pair, error in zip(found, errors, strict=True) if error <= NEARLY]
        return cls(*(fitting[0] if fitting else found[int(np.argmin(errors))]), pixel_aspect < 1)

    @property
    def per_pixel(self) -> tuple[float, float]:
        """How many squares a pixel is wide and high."""
        longer, shorter = self.count / self.divisions, float(self.divisions)
        return (shorter, longer) if self.upright else (longer, shorter)

    def window(self, pixels: Window) -> Window:
        """Return the squares of a window of pixels."""
        left, top, width, height = pixels if not self.upright else (pixels[1], pixels[0], pixels[3], pixels[2])
        first, end = self.begin(left, 0), self.begin(left + width, self.divisions - 1)
        across, down = (first, end - first), (top * self.divisions, height * self.divisions)
        (left, width), (top, height) = (down, across) if self.upright else (across, down)
        return Window(left, top, width, height)

    def begin(self, pixel: int, row: int) -> int:
        """Return at which square a pixel begins in one of its rows, counted from (0, 0) along its longer side."""
        return (pixel * self.count + row) // self.divisions

    def rows(self, pixels: Window) -> Iterator[Indices]:
        """Yield, for each row of squares of a pixel, where each pixel's squares begin among those of the window."""
        first, n = (pixels.top, pixels.height) if self.upright else (pixels.left, pixels.width)
        for row in range(self.divisions):
            begins = ((first + np.arange(n)) * self.count + row) // self.divisions - self.begin(first, 0)
            begins[0] = 0  # squares at the ends that are no pixel's are the next one's
            yield begins.astype(np.intp)


def squared(frame: Frame) -> Frame:
    """Return a frame with every pixel repeated, so that its picture consists of squares.

    Parameters
    ----------
    frame : Frame
        Its raster tells the shape of a pixel.

    Returns
    -------
    Frame
        The same picture; the motion is in squares. The frame itself, if its pixels are squares.
    """
    if frame.raster.pixel_aspect == 1:
        return frame
    grid, pixels = Grid.of(frame.raster.pixel_aspect), frame.raster.data
    raster = Raster(grid.window(pixels), grid.window(frame.raster.display))
    return Frame.of([_repeated(layer, grid, pixels, raster) for layer in frame.layers])


def squared_samples(samples: SampleBuffer) -> SampleBuffer:
    """Return a buffer with every pixel and its samples repeated, as `squared` does with those of a frame.

    A sample lies in each square as it did in the pixel; a given CoC radius, px along a row, is in squares.
    """
    if samples.raster.pixel_aspect == 1:
        return samples
    grid, pixels = Grid.of(samples.raster.pixel_aspect), samples.raster.data
    per_pixel = np.array(grid.per_pixel, np.float32)
    factors = {name: per_pixel for name in ("motion", "motion_prev", "motion_next")} | {"coc_radius": per_pixel[0]}
    labels = {name: values * factors[name] if name in factors else values for name, values in samples.labels.items()}
    return SampleBuffer.of(
        repeated(samples.radiance, grid, pixels),
        {name: repeated(values, grid, pixels) for name, values in labels.items()},
        repeated(samples.valid, grid, pixels),
        Raster(grid.window(pixels), grid.window(samples.raster.display)),
        samples.dropped_samples,
    )


def unsquared(image: FloatArray, raster: Raster) -> FloatArray:
    """Return an image (H, W, C) of the squares of a frame as the pixels of its raster: the means of their squares."""
    if raster.pixel_aspect == 1:
        return image
    grid = Grid.of(raster.pixel_aspect)
    turned = image.swapaxes(0, 1) if grid.upright else image
    rows = list(grid.rows(raster.data))
    sums = [np.add.reduceat(turned[row :: grid.divisions], begins, axis=1) for row, begins in enumerate(rows)]
    counts = np.asarray(np.sum([np.diff(begins, append=turned.shape[1]) for begins in rows], axis=0), np.float32)
    means = np.asarray(sum(sums) / counts[:, None], np.float32)
    return np.ascontiguousarray(means.swapaxes(0, 1) if grid.upright else means)


def repeated(values: npt.NDArray[Value], grid: Grid, pixels: Window) -> npt.NDArray[Value]:
    """Return an array (H, W, ...) of a window's pixels with each value at each of the pixel's squares."""
    turned = values.swapaxes(0, 1) if grid.upright else values
    height, width = grid.window(pixels).shape
    width = height if grid.upright else width
    result = np.empty((len(turned) * grid.divisions, width, *values.shape[2:]), values.dtype)
    for row, begins in enumerate(grid.rows(pixels)):
        owner = np.repeat(np.arange(len(begins)), np.diff(begins, append=width))
        result[row :: grid.divisions] = turned[:, owner]
    return np.ascontiguousarray(result.swapaxes(0, 1) if grid.upright else result)


def _repeated(layer: Layer, grid: Grid, pixels: Window, raster: Raster) -> Layer:
    def repeat(values: FloatArray) -> FloatArray:
        return repeated(values, grid, pixels)

    def scale(motion: FloatArray) -> FloatArray:
        return repeat(motion) * np.array(grid.per_pixel, np.float32)

    return replace(layer.mapped(repeat, scale, repeat(layer.radiance)), raster=raster)
