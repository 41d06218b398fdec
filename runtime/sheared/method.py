"""What a layered reconstruction is made of, and the run over all tiles."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Protocol

from spreadlets.arrays import Image
from spreadlets.parallel import for_each
from spreadlets.runtime.sheared.samples import Samples
from spreadlets.runtime.sheared.tiles import Tiling

Progress = Callable[[int, int], None]
"""Told how many parts of the work are done, and of how many."""


class TileFilter(Protocol):
    """Filters set up for certain samples and tiles."""

    def fill(self, image: Image, progress: Progress | None = None) -> None:
        """Fill an image (H, W, 4) of zeros, and tell how far it is."""

    def figures(self) -> dict[str, float]:
        """Return figures of the set-up for the report, such as ``layers_per_tile``."""


class Method(Protocol):
    """A layered reconstruction with its parameters."""

    def tiling(self, shape: tuple[int, int]) -> Tiling:
        """Divide an image of a shape (H, W) into tiles, with the border that the method needs."""

    def prepare(self, samples: Samples, tiling: Tiling) -> TileFilter:
        """Find partitions and layers, and set the filters up."""


class Counter:
    """Counts parts of the work that are done, by any thread, and tells of each."""

    def __init__(self, total: int, progress: Progress | None) -> None:
        self._done, self._total, self._progress = 0, total, progress
        self._lock = threading.Lock()

    def add(self) -> None:
        """Count one more."""
        with self._lock:
            self._done += 1
            if self._progress is not None:
                self._progress(self._done, self._total)


def run(fill_tile: Callable[[int, Image], None], n_tiles: int, image: Image, progress: Progress | None = None) -> None:
    """Fill an image (H, W, 4) tile by tile, several at a time.

    Tiles write different pixels and share nothing else, so the image does not depend on the number of threads. The
    kernels of a tile release the interpreter's lock.
    """
    counter = Counter(n_tiles, progress)

    def fill(tile: int) -> None:
        fill_tile(tile, image)
        counter.add()

    for_each(fill, range(n_tiles))
