"""Tiles of an image, each with a border of samples that its filters reach (SLR section 6.3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from spreadlets.errors import InvalidParameterError

CELL = 8
"""px: tiles and borders are whole cells, so that what is known of cells adds up to tiles."""
DEFAULT_TILE = 32
LARGEST_TILE = 1024


@dataclass(frozen=True)
class Tiling:
    """Square tiles that cover an image; those at its right and lower border may be smaller.

    Attributes
    ----------
    shape : tuple of int
        Height and width of the image, px.
    border : int
        px around a tile whose samples count for it, a multiple of `CELL`.
    tile : int
        Side of a tile, px, a positive multiple of `CELL` up to `LARGEST_TILE`.

    Raises
    ------
    InvalidParameterError
        If tile or border are not such multiples.
    """

    shape: tuple[int, int]
    border: int
    tile: int = DEFAULT_TILE

    def __post_init__(self) -> None:
        if not CELL <= self.tile <= LARGEST_TILE or self.tile % CELL:
            raise InvalidParameterError(
                f"tile is {self.tile}: allowed are multiples of {CELL} px from {CELL} to {LARGEST_TILE}"
            )
        if self.border < 0 or self.border % CELL:
            raise InvalidParameterError(f"border is {self.border}: allowed are multiples of {CELL} px from 0 on")

    def inner(self) -> npt.NDArray[np.int32]:
        """Return the boxes (top, left, bottom, right) of the tiles, px, shape (T, 4), row by row."""
        height, width = self.shape
        top, left = np.meshgrid(np.arange(0, height, self.tile), np.arange(0, width, self.tile), indexing="ij")
        bottom, right = np.minimum(top + self.tile, height), np.minimum(left + self.tile, width)
        return np.stack([each.ravel() for each in (top, left, bottom, right)], axis=1).astype(np.int32)

    def outer(self) -> npt.NDArray[np.int32]:
        """Return the boxes of the samples that count for each tile, within the image, shape (T, 4)."""
        grown = self.inner() + np.array([-self.border, -self.border, self.border, self.border], np.int32)
        height, width = self.shape
        return np.clip(grown, 0, np.array([height, width, height, width], np.int32))
