"""Tiles of pixels: what is known of whole squares of an image, so that kernels can leave most of them alone."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
import numpy.typing as npt

Value = TypeVar("Value", bound=np.generic)


def tiling(shape: tuple[int, int], size: int, corner: tuple[int, int] = (0, 0)) -> tuple[int, int]:
    """Return how many squares of a size cover an image, rows and columns.

    Parameters
    ----------
    shape : tuple of two ints
        Height and width, px.
    size : int
        Side of a square, px.
    corner : tuple of two ints
        Row and column of the image's first pixel, counted from a pixel that squares begin at.

    Examples
    --------
    >>> tiling((16, 17), 8)
    (2, 3)
    >>> tiling((16, 17), 8, (-1, 0))
    (3, 3)
    """
    height, width = (-(-(side + at % size) // size) for side, at in zip(shape, corner, strict=True))
    return height, width


def largest_around(values: npt.NDArray[Value], reach: int) -> npt.NDArray[Value]:
    """Return the largest of the values around each one, up to ``reach`` rows and columns away, of an array (h, w).

    Examples
    --------
    >>> largest_around(np.array([[0, 0, 5, 0, 0, 1]]), 1)
    array([[0, 5, 5, 5, 1, 1]])
    """
    for axis in range(2):
        lines = np.moveaxis(values, axis, 0)
        around = lines.copy()
        for step in range(1, min(reach, len(lines) - 1) + 1):
            np.maximum(around[step:], lines[:-step], out=around[step:])
            np.maximum(around[:-step], lines[step:], out=around[:-step])
        values = np.moveaxis(around, 0, axis)
    # In the order that kernels are compiled for.
    return np.ascontiguousarray(values)
