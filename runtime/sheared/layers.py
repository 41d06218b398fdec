"""The layers of each tile: which partitions its samples are in, and their actual range of CoC (SLR section 6.2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import FloatArray
from spreadlets.runtime.sheared import _tile_kernels
from spreadlets.runtime.sheared.partitions import BIN, Partitioning
from spreadlets.runtime.sheared.samples import Samples
from spreadlets.runtime.sheared.tiles import CELL, Tiling

NONE = -1
"""In place of a layer's number: the partition has no sample in the tile."""
MOST_BINS = 1 << 12
"""Bins of CoC on each side of focus; a larger CoC counts for the last one."""


@dataclass(frozen=True)
class Layers:
    """The layers of all tiles, tile by tile, front to back.

    Attributes
    ----------
    slot : ndarray of shape (T, P), int16
        Number of the layer, from 0 in each tile, that holds a partition's samples; `NONE` if there are none.
    first : ndarray of shape (T + 1,), int64
        The layers of a tile are ``first[tile]`` to ``first[tile + 1] - 1``.
    near, far : ndarray of shape (L,), float32
        Range of CoC of each layer, px; never empty.
    """

    slot: npt.NDArray[np.int16]
    first: npt.NDArray[np.int64]
    near: FloatArray
    far: FloatArray

    @property
    def per_tile(self) -> float:
        """Mean number of layers of a tile."""
        return len(self.near) / len(self.slot)


def find_layers(
    samples: Samples,
    partition: npt.NDArray[np.uint8],
    partitioning: Partitioning,
    tiling: Tiling,
    *,
    actual_range: bool = True,
) -> Layers:
    """Find the partitions in use in each tile, and how far their samples spread.

    Parameters
    ----------
    samples : Samples
    partition : ndarray of shape (N,), uint8
        Of each sample, see `Partitioning.of`.
    partitioning : Partitioning
    tiling : Tiling
        A tile's border counts for it.
    actual_range : bool
        Ranges of CoC are those of the samples in the tile, in whole bins; else those of the partitions, which makes
        filters the same in all tiles.

    Returns
    -------
    Layers
    """
    near, far = cell_ranges(samples, partition, partitioning.n_partitions)
    near, far = tile_ranges(near, far, tiling)
    used = near <= far
    slot = np.where(used, np.cumsum(used, axis=1) - 1, NONE).astype(np.int16)
    first = np.concatenate([[0], np.cumsum(used.sum(axis=1))]).astype(np.int64)
    if actual_range:
        return Layers(slot, first, (BIN * near[used]).astype(np.float32), (BIN * (far[used] + 1)).astype(np.float32))
    lowest, highest = (np.broadcast_to(each, used.shape)[used] for each in partitioning.bounds())
    return Layers(slot, first, lowest, highest)


def cell_ranges(
    samples: Samples, partition: npt.NDArray[np.uint8], n_partitions: int
) -> tuple[npt.NDArray[np.int16], npt.NDArray[np.int16]]:
    """Return the first and the last bin of CoC in use, by cell and partition, each of shape (rows, cols, P).

    Where a partition has no sample, the first bin is larger than the last.
    """
    height, width = samples.shape
    shape = (-(-height // CELL), -(-width // CELL), n_partitions)
    near, far = np.full(shape, MOST_BINS, np.int16), np.full(shape, -MOST_BINS - 1, np.int16)
    _tile_kernels.mark_bins(samples.coc, partition, samples.first, width, CELL, BIN, MOST_BINS, near, far)
    return near, far


def tile_ranges(
    near: npt.NDArray[np.int16], far: npt.NDArray[np.int16], tiling: Tiling
) -> tuple[npt.NDArray[np.int16], npt.NDArray[np.int16]]:
    """Return the first and the last bin of each partition in each tile with its border, each of shape (T, P)."""
    boxes = tiling.outer()
    lowest, highest = (np.empty((len(boxes), near.shape[2]), np.int16) for _ in range(2))
    for tile, (top, left, bottom, right) in enumerate(boxes):
        cells = slice(top // CELL, -(-bottom // CELL)), slice(left // CELL, -(-right // CELL))
        lowest[tile], highest[tile] = near[cells].min(axis=(0, 1)), far[cells].max(axis=(0, 1))
    return lowest, highest
