"""LRDM's reconstruction of defocus and motion blur, with the practical improvements of 2015; see docs/lrdm.md."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import FloatArray, Image
from spreadlets.errors import InvalidParameterError
from spreadlets.parallel import for_each, thread_count
from spreadlets.runtime.sheared import _gauss_kernels, _lrdm_kernels
from spreadlets.runtime.sheared._tile_kernels import N_SUMS
from spreadlets.runtime.sheared.filters import LARGEST_SIGMA
from spreadlets.runtime.sheared.method import Counter, Progress
from spreadlets.runtime.sheared.samples import Samples
from spreadlets.runtime.sheared.tiles import DEFAULT_TILE, Tiling
from spreadlets.runtime.sheared.work import WorkSizes

SCREEN_FILTERS = {
    "rotated": (_gauss_kernels.ROTATED, _gauss_kernels.ROUND_ROTATED),
    "sheared": (_gauss_kernels.SHEARED, _gauss_kernels.ROUND_SHEARED),
    "ewa": (_gauss_kernels.EWA, _gauss_kernels.ROUND_EWA),
}
"""Numbers of the screen filters with motion, and of those for defocus alone."""

DEFAULT_SIGMA_PIXEL = 0.5
"""px; LRDM's figure 9 trades streaks for sharpness with it: .33 there."""
DEFAULT_SPARSITY = 3
"""Pixels in each of which one sample is taken for the statistics: LRDM's n = 3 spp (section 4)."""
DEFAULT_SHRINK = 0.1
"""Share by which a screen filter may shrink when partitions are merged (section 4)."""
DEFAULT_STEP = 4.0
"""px of CoC: width of a partition."""
DEFAULT_LAYERS = 32
"""Partitions over both sides of focus; the outermost have no end."""
MOST_LAYERS = 254
"""As many as a byte numbers, with that of the samples that met nothing."""
DEFAULT_BLOCK = 256
"""px: side of the large tiles that are worked on one after the other."""
TILE_UNIT = 32
"""px: tiles are multiples of the largest texel of a pyramid."""
SAMPLES_AT_A_TIME = 1 << 16
"""For what is done sample by sample."""
SUMMED_AT_A_TIME = 1 << 13
"""Of numbers that are summed in single precision; more would cost digits."""
SEED = 0x9E3779B9
"""Of the sparse statistics."""

Work = Callable[[int, int], None]
Step = tuple[Work, int]
Jobs = tuple[
    npt.NDArray[np.int64],
    npt.NDArray[np.int64],
    npt.NDArray[np.int64],
    npt.NDArray[np.int32],
    npt.NDArray[np.int32],
    npt.NDArray[np.int64],
]
"""See `runtime.sheared._lrdm_kernels.reproject_layers`."""


@dataclass(frozen=True)
class Lrdm:
    """Layered reconstruction for defocus and motion blur.

    Attributes
    ----------
    screen_filter : {"rotated", "sheared", "ewa"}
        How the Gaussian is drawn: in two passes along its axes (LRDM 2014), recursively along x and along a sheared
        axis, or by lookups into a MIP pyramid (both LRDM 2015).
    sparsity : int
        Statistics of a tile are taken from one sample in so many pixels; 0 takes all samples.
    shrink : float
        Share by which a screen filter may shrink when two partitions are merged, from 0 to below 1; negative never
        merges.
    layers : int
        Partitions over both sides of focus, an even number.
    step : float
        Width of a partition, px of CoC.
    sigma_pixel : float
        Standard deviation of the pixel filter, px.
    largest_sigma : float
        Clamp of the standard deviation of a screen filter, px; beyond it samples are reprojected less.
    skip_motion : bool
        Leave all that concerns motion out where nothing moves.
    tile : int
        Side of a tile, px, a multiple of 32.
    block : int
        Side of the large tiles that all steps are done for before the next one, px, a multiple of `tile`; 0 takes the
        whole image, as LRDM does. Memory is in proportion.
    """

    screen_filter: str = "rotated"
    sparsity: int = 0
    shrink: float = -1.0
    layers: int = DEFAULT_LAYERS
    step: float = DEFAULT_STEP
    sigma_pixel: float = DEFAULT_SIGMA_PIXEL
    largest_sigma: float = LARGEST_SIGMA
    skip_motion: bool = True
    tile: int = DEFAULT_TILE
    block: int = DEFAULT_BLOCK

    def __post_init__(self) -> None:
        # Check the filter, and that layers, tiles and blocks divide evenly.
        if self.screen_filter not in SCREEN_FILTERS:
            raise InvalidParameterError(
                f"screen_filter {self.screen_filter!r} is unknown: allowed are {', '.join(SCREEN_FILTERS)}"
            )
        if self.layers % 2 or not 2 <= self.layers <= MOST_LAYERS:
            raise InvalidParameterError(f"layers is {self.layers}: allowed are even numbers from 2 to {MOST_LAYERS}")
        if self.tile < TILE_UNIT or self.tile % TILE_UNIT:
            raise InvalidParameterError(f"tile is {self.tile}: allowed are multiples of {TILE_UNIT} px")
        if self.block < 0 or self.block % self.tile:
            raise InvalidParameterError(
                f"block is {self.block}: allowed are 0 (the whole image) and multiples of the tile, {self.tile} px"
            )
        # Check the ranges of the other numbers.
        for name, value, low, high in (
            ("sparsity", self.sparsity, 0, 64),
            ("step", self.step, 0.25, 1000.0),
            ("sigma_pixel", self.sigma_pixel, 0.1, 4.0),
            ("largest_sigma", self.largest_sigma, 0.5, LARGEST_SIGMA),
        ):
            if not low <= value <= high:
                raise InvalidParameterError(f"{name} is {value}: allowed are {low:g} to {high:g}")
        if not self.shrink < 1.0:
            raise InvalidParameterError(f"shrink is {self.shrink}: allowed are values below 1")
        # A tiling has limits of its own.
        self.tiling((self.tile, self.tile))

    def tiling(self, shape: tuple[int, int]) -> Tiling:
        """Divide an image into tiles; how far a filter reaches beyond is known for each layer."""
        return Tiling(shape, 0, self.tile)

    def prepare(self, samples: Samples, tiling: Tiling) -> LrdmFilter:
        """Find the layers of each tile and set their filters up."""
        moving = not self.skip_motion or _largest(samples.motion) > 0.0
        spread = spread_of(samples, moving)
        partition = self.partitions(samples)
        begin = time.perf_counter()
        tables = self.set_up(samples, partition, tiling, spread, moving)
        seconds = time.perf_counter() - begin
        return LrdmFilter(self, samples, partition, tiling, spread, moving, tables, seconds)

    def partitions(self, samples: Samples) -> npt.NDArray[np.uint8]:
        """Return the partition of each sample, from near to far; the last is for those that met nothing."""
        partition = np.empty(len(samples.coc), np.uint8)

        def work(begin: int, end: int) -> None:
            given = samples.coc, samples.colour, self.step, self.layers + 1
            _lrdm_kernels.assign_partitions(*given, begin, end, partition)

        in_parts(work, len(partition), SAMPLES_AT_A_TIME)
        return partition

    def set_up(
        self,
        samples: Samples,
        partition: npt.NDArray[np.uint8],
        tiling: Tiling,
        spread: npt.NDArray[np.float64],
        moving: bool,
        size: int | None = None,
    ) -> Tables:
        """Take the statistics of all tiles, merge partitions and set their filters up, so many tiles at a time."""
        boxes, n_partitions = tiling.inner(), self.layers + 1
        shape = len(boxes), n_partitions
        own, holes = np.empty(shape, np.int16), np.empty(shape, np.int16)
        filters, counts = np.empty((*shape, _lrdm_kernels.N_FILTER), np.float32), np.empty((len(boxes), 2), np.int32)
        sampling = self.sparsity, SEED
        given = (partition, samples.motion, samples.coc, samples.first, samples.shape[1])
        settings = (self.sigma_pixel**2, self.largest_sigma**2, moving, self.shrink)

        def work(begin: int, end: int) -> None:
            order, tables = morton_order(self.tile), (own, holes, filters, counts)
            _lrdm_kernels.set_up_tiles(given, boxes, order, sampling, spread, settings, begin, end, tables)

        in_parts(work, len(boxes), size or WorkSizes.current().set_up)
        used = np.arange(n_partitions) < counts[:, 1:]
        first = np.concatenate([[0], np.cumsum(counts[:, 1])]).astype(np.int64)
        return Tables(own, holes, filters[used], first, int(counts[:, 0].sum()))


@dataclass(frozen=True)
class PracticalLrdm(Lrdm):
    """LRDM with the set-up of 2015: sparse statistics and merged partitions."""

    sparsity: int = DEFAULT_SPARSITY
    shrink: float = DEFAULT_SHRINK


class Tables(NamedTuple):
    """Layers and filters of all tiles.

    Attributes
    ----------
    own, holes : ndarray of shape (T, P), int16
        Layer that holds a partition's samples, -1 if none; number of layers that they are holes in.
    filters : ndarray of shape (L, 8), float32
        See `runtime.sheared._lrdm_kernels.ETA`, tile by tile, front to back.
    first : ndarray of shape (T + 1,), int64
        The layers of a tile are ``first[tile]`` to ``first[tile + 1] - 1``.
    n_used : int
        Partitions with samples before merging.
    """

    own: npt.NDArray[np.int16]
    holes: npt.NDArray[np.int16]
    filters: FloatArray
    first: npt.NDArray[np.int64]
    n_used: int


class Block(NamedTuple):
    """A block of t tiles with J layers, and its buffers.

    Attributes
    ----------
    inner : ndarray of shape (t, 4), int32
        Boxes of the tiles, px.
    first_job : ndarray of shape (t + 1,), int64
        The layers of a tile are jobs ``first_job[tile]`` to ``first_job[tile + 1] - 1``.
    jobs : tuple of arrays
        See `runtime.sheared._lrdm_kernels.reproject_layers`.
    sums, between : ndarray of one dimension, float32
        Of all layers, one after the other: before and after the first pass of the screen filter.
    """

    inner: npt.NDArray[np.int32]
    first_job: npt.NDArray[np.int64]
    jobs: Jobs
    sums: FloatArray
    between: FloatArray


@dataclass(frozen=True)
class LrdmFilter:
    """What `Lrdm.prepare` found."""

    method: Lrdm
    samples: Samples
    partition: npt.NDArray[np.uint8]
    layout: Tiling
    spread: npt.NDArray[np.float64]
    moving: bool
    tables: Tables
    set_up_s: float

    def fill(self, image: Image, progress: Progress | None = None) -> None:
        """Fill an image (H, W, 4), block by block; the steps of a block are divided between threads."""
        sizes, counter = WorkSizes.current(), Counter(len(self._tiles_of_blocks()), progress)
        for block in self.blocks():
            for name, (work, n) in self.steps(block, image).items():
                in_parts(work, n, getattr(sizes, name))
            counter.add()

    def blocks(self) -> Iterator[Block]:
        """Yield the blocks; they share their buffers."""
        rings = np.empty((len(self.tables.filters), 3), np.int32)
        _gauss_kernels.ring_of_layers(self._way, self.tables.filters, _lrdm_kernels.SXX, rings)
        found = [self._jobs(tiles, rings) for tiles in self._tiles_of_blocks()]
        size = max(int(jobs[-1][-1]) for _, _, jobs in found)
        sums, between = np.empty(size, np.float32), np.empty(size, np.float32)
        for inner, first_job, jobs in found:
            yield Block(inner, first_job, jobs, sums, between)

    def steps(self, block: Block, image: Image) -> dict[str, Step]:
        """Return what is to be done for a block, in order: by the name of a work size, the work and how much."""
        samples, tables, side = self.samples, self.tables, self.method.tile
        # Gather the arrays that the kernels share.
        given = (samples.colour, samples.place, samples.lens, samples.time, samples.first, samples.shape)
        found = (tables.own, tables.holes, tables.filters)
        inner, first_job, jobs, sums, between = block
        of_filter = (self._way, tables.filters, _lrdm_kernels.SXX, jobs, side)

        # Each step works on a range of the block's layers or tiles.
        def reproject(begin: int, end: int) -> None:
            _lrdm_kernels.reproject_layers(
                given, self.partition, found, jobs, self.spread, self.moving, begin, end, sums
            )

        def blur(begin: int, end: int) -> None:
            _gauss_kernels.blur_layers(*of_filter, begin, end, sums, between)

        def composite(begin: int, end: int) -> None:
            _gauss_kernels.composite_tiles(*of_filter, inner, first_job, begin, end, sums, between, image)

        # List the steps with their sizes.
        n_layers = len(jobs[0])
        return {
            "reproject": (reproject, n_layers),
            "blur": (blur, n_layers),
            "composite": (composite, len(inner)),
        }

    @property
    def _way(self) -> int:
        """Number of the screen filter."""
        return SCREEN_FILTERS[self.method.screen_filter][not self.moving]

    def figures(self) -> dict[str, float]:
        """Return the mean numbers of partitions and layers of a tile, and the time of the set-up."""
        n_tiles = len(self.tables.own)
        return {
            "partitions_per_tile": self.tables.n_used / n_tiles,
            "layers_per_tile": len(self.tables.filters) / n_tiles,
            "set_up_s": self.set_up_s,
        }

    def _tiles_of_blocks(self) -> list[npt.NDArray[np.int64]]:
        """Return the tiles of each block, row by row."""
        inner = self.layout.inner()
        side = self.method.block or max(self.layout.shape)
        number = inner[:, 0] // side * (max(self.layout.shape) // side + 1) + inner[:, 1] // side
        return [np.flatnonzero(number == each) for each in np.unique(number)]

    def _jobs(
        self, tiles: npt.NDArray[np.int64], rings: npt.NDArray[np.int32]
    ) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int64], Jobs]:
        """Return the boxes of a block's tiles, where the layers of each begin, and what is to be done."""
        first, inner, side = self.tables.first, self.layout.inner(), self.method.tile
        counts = first[tiles + 1] - first[tiles]
        first_job = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
        of_tile = np.repeat(np.arange(len(tiles)), counts)
        number = np.arange(first_job[-1]) - first_job[of_tile]
        layer = first[tiles[of_tile]] + number
        corner = inner[tiles[of_tile], :2]
        ring, texel = rings[layer, 1::-1], rings[layer, 2]
        boxes = np.concatenate([corner - ring, corner + side + ring], axis=1).astype(np.int32)
        sizes = np.prod(((side + 2 * ring) // texel[:, None]).astype(np.int64), axis=1) * N_SUMS
        starts = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
        return inner[tiles], first_job, (layer, tiles[of_tile], number, boxes, texel, starts)


def spread_of(samples: Samples, moving: bool = True) -> npt.NDArray[np.float64]:
    """Return how far samples spread over lens and shutter.

    Parameters
    ----------
    samples : Samples
    moving : bool
        Whether anything moves; else the shutter does not count.

    Returns
    -------
    ndarray of shape (4,)
        Variance along one axis of the lens, variance of time (frames^2), and the largest of either.
    """
    spread = np.zeros(4)
    spread[_lrdm_kernels.LENS_VARIANCE] = _mean_square(samples.lens)
    spread[_lrdm_kernels.LENS_REACH] = _largest(samples.lens)
    if moving:
        spread[_lrdm_kernels.TIME_VARIANCE] = _mean_square(samples.time)
        spread[_lrdm_kernels.TIME_REACH] = _largest(samples.time)
    return spread


def _mean_square(values: FloatArray) -> float:
    """Return the mean square of values, 0 of none."""
    flat = values.reshape(values.size)
    parts = [flat[begin : begin + SUMMED_AT_A_TIME] for begin in range(0, flat.size, SUMMED_AT_A_TIME)]
    return sum(float(np.einsum("i,i->", part, part)) for part in parts) / max(flat.size, 1)


def _largest(values: FloatArray) -> float:
    """Return the largest absolute value, 0 of none."""
    return max(float(values.max(initial=0.0)), -float(values.min(initial=0.0)))


@lru_cache
def morton_order(tile: int) -> npt.NDArray[np.int16]:
    """Return rows and columns of a tile's pixels along a Morton curve, shape (tile^2, 2)."""
    rows, cols = (each.ravel() for each in np.meshgrid(np.arange(tile), np.arange(tile), indexing="ij"))
    code = sum(((cols >> bit & 1) << 2 * bit) | ((rows >> bit & 1) << 2 * bit + 1) for bit in range(tile.bit_length()))
    order = np.argsort(code, kind="stable")
    return np.stack([rows[order], cols[order]], axis=1).astype(np.int16)


def in_parts(work: Work, n: int, size: int) -> None:
    """Call ``work(begin, end)`` for parts of a range, several at a time; parts share nothing.

    One thread does all at once.
    """
    parts = [(begin, min(begin + size, n)) for begin in range(0, n, size)]
    if min(thread_count(), len(parts)) <= 1:
        return work(0, n)
    for_each(lambda part: work(*part), parts)
