"""SLR's reconstruction of defocus, with sheared or axis-aligned filters."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from spreadlets.arrays import Image
from spreadlets.errors import InvalidParameterError
from spreadlets.runtime.sheared import _slr_kernels
from spreadlets.runtime.sheared.filters import (
    APERTURES,
    LARGEST_SIGMA,
    REACH,
    SIGMA_LENS,
    SIGMA_PIXEL,
    Aperture,
    Filters,
    axis_aligned_filters,
    sheared_filters,
    with_uniform_lens,
)
from spreadlets.runtime.sheared.layers import Layers, find_layers
from spreadlets.runtime.sheared.method import Progress, run
from spreadlets.runtime.sheared.partitions import LEAST_PER_SIDE, MOST_PER_SIDE, PER_SIDE, Partitioning
from spreadlets.runtime.sheared.samples import Samples
from spreadlets.runtime.sheared.tiles import CELL, DEFAULT_TILE, Tiling

LEAST_PER_PIXEL = 1e-3
"""Mean number of samples in a pixel below which a buffer is as good as empty."""
HEADROOM = 4.0
"""How many times the mean number of samples fixed point has room for in a pixel."""


@dataclass(frozen=True)
class Slr:
    """SLR's layered reconstruction; motion is left to the mean over the samples.

    Attributes
    ----------
    sheared : bool
        Sheared filters, or axis-aligned ones.
    aperture : {"disc", "gaussian"}
        How the samples lie on the lens: evenly on the unit disc, as renderers have them, or as SLR has them, to be
        weighted by a Gaussian that the disc cuts at three standard deviations.
    bilinear : bool
        Spread reprojected samples over four pixels instead of adding them to the nearest.
    fixed_point : bool
        Round intermediate sums to the bits of SLR Table I; colours are clipped to [0, 1], which SLR's are, and rounded
        to 8 bits.
    actual_range : bool
        Filters for the CoC that a tile has, or for all that its partitions may have.
    tile : int
        Side of a tile, px.
    layers : int
        Partitions over both sides of focus, an even number.
    sigma_pixel : float
        Standard deviation of the pixel filter, px.
    """

    sheared: bool = True
    aperture: Aperture = "disc"
    bilinear: bool = False
    fixed_point: bool = False
    actual_range: bool = True
    tile: int = DEFAULT_TILE
    layers: int = 2 * PER_SIDE
    sigma_pixel: float = SIGMA_PIXEL

    def __post_init__(self) -> None:
        if self.aperture not in APERTURES:
            raise InvalidParameterError(f"aperture {self.aperture!r} is unknown: allowed are {', '.join(APERTURES)}")
        if self.layers % 2 or not 2 * LEAST_PER_SIDE <= self.layers <= 2 * MOST_PER_SIDE:
            raise InvalidParameterError(
                f"layers is {self.layers}: allowed are even numbers from {2 * LEAST_PER_SIDE} to {2 * MOST_PER_SIDE}"
            )
        if not self.sigma_pixel > 0.0:
            raise InvalidParameterError(f"sigma_pixel is {self.sigma_pixel}: it must be > 0 px")
        self.tiling((self.tile, self.tile))

    def tiling(self, shape: tuple[int, int]) -> Tiling:
        """Divide an image into tiles, with the border that screen filter and reprojection reach."""
        farthest = LARGEST_SIGMA / (2.0 * SIGMA_LENS[self.aperture])  # of Eq. 22: where c = sigma_x / sigma_u
        return Tiling(shape, REACH + CELL * int(np.ceil(farthest / CELL)), self.tile)

    def filters(self, layers: Layers, samples_per_pixel: float) -> Filters:
        """Set up the filter of each layer."""
        make = sheared_filters if self.sheared else axis_aligned_filters
        found = make(layers.near, layers.far, SIGMA_LENS[self.aperture], self.sigma_pixel)
        if self.aperture == "gaussian":
            return found
        return with_uniform_lens(found, layers.near, layers.far, samples_per_pixel, self.sigma_pixel)

    def prepare(self, samples: Samples, tiling: Tiling) -> _SlrTiles:
        """Find the layers of each tile and set their filters up."""
        partitioning = Partitioning.of_constant_energy(self.layers // 2)
        partition = partitioning.of(samples)
        steps = 0.0
        if self.fixed_point:
            samples, steps = _fixed_point(samples)
        layers = find_layers(samples, partition, partitioning, tiling, actual_range=self.actual_range)
        return _SlrTiles(
            samples,
            partition,
            layers,
            self.filters(layers, max(samples.per_pixel, LEAST_PER_PIXEL)),
            tiling,
            (self.bilinear, np.float32(steps)),
        )


def _fixed_point(samples: Samples) -> tuple[Samples, float]:
    """Return samples with integer colours, and the integer that stands for a weight of 1.

    A pixel's weights add up to 8 bits at most; `HEADROOM` times the usual number of samples may be reprojected to it.
    """
    colour = np.rint(np.clip(samples.colour, 0.0, 1.0) * np.float32(_slr_kernels.COLOUR_LEVELS))
    steps = np.floor(_slr_kernels.WEIGHT_LEVELS / (HEADROOM * max(samples.per_pixel, 1.0)))
    return replace(samples, colour=colour), max(steps, 1.0)


@dataclass(frozen=True)
class _SlrTiles:
    """What `Slr.prepare` found."""

    samples: Samples
    partition: np.ndarray[tuple[int], np.dtype[np.uint8]]
    layers: Layers
    set_up: Filters
    tiling: Tiling
    options: tuple[bool, np.float32]
    boxes: tuple[np.ndarray, np.ndarray] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "boxes", (self.tiling.inner(), self.tiling.outer()))

    def fill(self, image: Image, progress: Progress | None = None) -> None:
        """Fill an image, tile by tile."""
        run(self._fill_tile, len(self.boxes[0]), image, progress)

    def _fill_tile(self, tile: int, image: Image) -> None:
        """Fill the pixels of a tile."""
        given, here = self.samples, slice(*self.layers.first[tile : tile + 2])
        _slr_kernels.filter_tile(
            (given.colour, given.place, given.lens, given.first, given.shape[1]),
            self.partition,
            self.layers.slot[tile],
            tuple(each[here] for each in self.set_up),
            self.boxes[0][tile],
            self.boxes[1][tile],
            REACH,
            self.options,
            image,
        )

    def figures(self) -> dict[str, float]:
        """Return the mean number of layers in a tile."""
        return {"layers_per_tile": self.layers.per_tile}
