"""What a layered reconstruction is made of, and the run over all tiles."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from spreadlets.arrays import Image
from spreadlets.parallel import for_each
from spreadlets.runtime.sheared.samples import Samples
from spreadlets.runtime.sheared.tiles import Tiling


class TileFilter(Protocol):
    """Filters set up for certain samples and tiles."""

    def fill(self, image: Image) -> None:
        """Fill an image (H, W, 4) of zeros."""

    def figures(self) -> dict[str, float]:
        """Return figures of the set-up for the report, such as ``layers_per_tile``."""


class Method(Protocol):
    """A layered reconstruction with its parameters."""

    def tiling(self, shape: tuple[int, int]) -> Tiling:
        """Divide an image of a shape (H, W) into tiles, with the border that the method needs."""

    def prepare(self, samples: Samples, tiling: Tiling) -> TileFilter:
        """Find partitions and layers, and set the filters up."""


def run(fill_tile: Callable[[int, Image], None], n_tiles: int, image: Image) -> None:
    """Fill an image (H, W, 4) tile by tile, several at a time.

    Tiles write different pixels and share nothing else, so the image does not depend on the number of threads. The
    kernels of a tile release the interpreter's lock.
    """
    for_each(lambda tile: fill_tile(tile, image), range(n_tiles))
