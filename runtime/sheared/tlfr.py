"""TLFR's reconstruction of defocus and motion blur: samples of neighbours, moved to many places on lens and shutter."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import FloatArray, Image
from spreadlets.errors import InvalidParameterError
from spreadlets.parallel import for_each
from spreadlets.runtime.sheared import _tlfr_kernels
from spreadlets.runtime.sheared._tile_kernels import N_SUMS
from spreadlets.runtime.sheared._tlfr_kernels import Trajectories, Views
from spreadlets.runtime.sheared.method import Counter, Progress
from spreadlets.runtime.sheared.samples import Samples
from spreadlets.runtime.sheared.tiles import Tiling

DEFAULT_VIEWS = 64
"""Of each pixel; TLFR takes 128, and so does SLR in its comparison (section 7)."""
MOST_VIEWS = 1024
DEFAULT_DISPERSION = 2.0
"""px, at one sample in each pixel: the radius of the largest disc without a sample of a surface. If samples are spread
by chance, as those of a blurred surface are once they are moved, one disc of 290,000 has none."""
LARGEST_RADIUS = 9.0
"""px; where samples are sparser than one in 20 pixels, there are holes."""
WINDOW = 9
"""px: side of the square that the spacing of samples is taken from."""
DEFAULT_TOLERANCE = 0.5
"""px by which trajectories must cross: what hides what by less is not seen."""
DEFAULT_SOFTNESS = 1 / 6
"""Standard deviation of a layer's screen filter, of the least CoC radius in it: a disc's own is half the radius, so its
rim stays crisp to a third of it."""
FIRST_LAYER = 2.0
"""px of CoC radius: what is sharper is not filtered on the screen."""
LAYER_STEP = 2**0.5
"""From the least CoC radius of a layer to that of the next."""
REACH = 24
"""px: largest radius of a screen filter."""
STRIP = 64
"""Rows of the image that are filtered at a time."""
LEAST_SIGMA = 1e-3
"""px: a filter of one pixel."""
DEFAULT_TILE_OF_VIEWS = 64
"""px: all samples around a tile are moved for each view, so larger tiles move fewer."""
SIDE_OF_PATTERNS = 4
"""px: each square of this side has every pattern of views once."""
GROUP = 32
"""Samples of a group, at most."""
GROUP_CELL = 8
"""px: side of the squares that groups are made of."""
SEED = 0x51F7
"""Of the order of patterns."""


@dataclass(frozen=True)
class Tlfr:
    """Temporal light field reconstruction.

    Attributes
    ----------
    views : int
        Places on lens and shutter that a pixel is reconstructed at.
    dispersion : float
        Radius, px, of the largest disc without a sample of a surface, at one sample in each pixel; it shrinks with the
        root of their number.
    tolerance : float
        px by which trajectories must cross to be of two surfaces.
    softness : float
        Standard deviation of the filter that each layer of CoC gets on the screen, of the least CoC radius in it; 0
        leaves the noise of the views, as TLFR does.
    tile : int
        Side of a tile, px. The image depends on it by rounding alone.
    """

    views: int = DEFAULT_VIEWS
    dispersion: float = DEFAULT_DISPERSION
    tolerance: float = DEFAULT_TOLERANCE
    softness: float = DEFAULT_SOFTNESS
    tile: int = DEFAULT_TILE_OF_VIEWS

    def __post_init__(self) -> None:
        for name, value, low, high in (
            ("views", self.views, 1, MOST_VIEWS),
            ("dispersion", self.dispersion, 0.25, 8.0),
            ("tolerance", self.tolerance, 0.0, 8.0),
            ("softness", self.softness, 0.0, 1.0),
        ):
            if not low <= value <= high:
                raise InvalidParameterError(f"{name} is {value}: allowed are {low:g} to {high:g}")
        self.tiling((self.tile, self.tile))

    def tiling(self, shape: tuple[int, int]) -> Tiling:
        """Divide an image into tiles; which samples come near one is known for each."""
        return Tiling(shape, 0, self.tile)

    def prepare(self, samples: Samples, tiling: Tiling) -> _TlfrTiles:
        """Group the samples, and choose places on lens and shutter for each pixel."""
        near = layers(samples.coc if self.softness else samples.coc[:0])
        views = Views(
            places(self.views, samples.half_shutter),
            patterns(samples.shape),
            radius_of_largest_gap(samples.first, samples.shape, self.dispersion),
            np.float32(samples.half_shutter),
            np.float32(self.tolerance),
            near,
        )
        return _TlfrTiles(trajectories(samples), views, screen_sigma(near, self.softness), tiling)


@dataclass(frozen=True)
class _TlfrTiles:
    """What `Tlfr.prepare` found."""

    trajectories: Trajectories
    views: Views
    sigma: FloatArray
    tiling: Tiling

    def fill(self, image: Image, progress: Progress | None = None) -> None:
        """Fill an image, strip by strip: gather all views as far as filters reach beyond it, then filter."""
        height, width = self.tiling.shape
        strips = [(top, min(top + STRIP, height)) for top in range(0, height, STRIP)]
        gathered = [0, *(min(bottom + REACH, height) for _, bottom in strips)]
        todo = [self._boxes(*rows) for rows in pairwise(gathered)]
        counter = Counter(sum(map(len, todo)), progress)
        sums = np.zeros((STRIP + 2 * REACH, width, len(self.sigma), N_SUMS), np.float32)
        for (top, bottom), boxes in zip(strips, todo, strict=True):
            # Go on with what is gathered already.
            if top:
                sums[: 2 * REACH] = sums[STRIP:]
                sums[2 * REACH :] = 0
            for_each(partial(self._gather, sums, top - REACH, counter), boxes)
            for_each(partial(self._filter, sums, top - REACH, image), self._boxes(top, bottom))

    def _gather(self, sums: FloatArray, first_row: int, counter: Counter, box: npt.NDArray[np.int32]) -> None:
        _tlfr_kernels.gather_tile(self.trajectories, self.views, box, sums, first_row)
        counter.add()

    def _filter(self, sums: FloatArray, first_row: int, image: Image, box: npt.NDArray[np.int32]) -> None:
        _tlfr_kernels.filter_tile(sums, first_row, self.sigma, REACH, box, image)

    def _boxes(self, top: int, bottom: int) -> npt.NDArray[np.int32]:
        """Return the boxes of tiles that cover some rows of the image."""
        boxes = Tiling((bottom - top, self.tiling.shape[1]), 0, self.tiling.tile).inner()
        return boxes + np.array([top, 0, top, 0], np.int32)

    def figures(self) -> dict[str, float]:
        """Return the number of groups that the samples are in."""
        return {"groups": float(len(self.trajectories.first) - 1)}


def layers(coc: FloatArray) -> FloatArray:
    """Return the CoC radius that each layer begins at, px, from near to far: -infinity, then up to the largest one."""
    most = float(np.abs(coc).max(initial=0.0))
    n_steps = math.ceil(math.log(max(most / FIRST_LAYER, 1.0), LAYER_STEP))
    steps = FIRST_LAYER * LAYER_STEP ** np.arange(n_steps)
    return np.concatenate([[-np.inf], -steps[::-1], steps]).astype(np.float32)


def screen_sigma(near: FloatArray, softness: float) -> FloatArray:
    """Return the standard deviation of each layer's screen filter, px."""
    far = np.append(near[1:], np.inf)
    least = np.where(near >= 0, near, np.where(far <= 0, -far, 0.0))
    return np.clip(softness * least, LEAST_SIGMA, REACH / 3).astype(np.float32)


def trajectories(samples: Samples) -> Trajectories:
    """Sort samples into groups of neighbours at like depths, seen from the lens's centre at mid-shutter."""
    centre = samples.place - samples.coc[:, None] * samples.lens - samples.motion * samples.time[:, None]
    cell = np.floor(centre / GROUP_CELL)
    order = np.lexsort((samples.depth, cell[:, 0], cell[:, 1]))
    path = np.concatenate([centre, samples.coc[:, None], samples.motion], axis=1)[order].astype(np.float32)
    first = group_begins(cell[order])
    return Trajectories(
        path,
        samples.depth[order],
        samples.colour[order],
        np.append(first, len(path)),
        np.minimum.reduceat(path, first) if len(path) else path,
        np.maximum.reduceat(path, first) if len(path) else path,
    )


def group_begins(cell: FloatArray) -> npt.NDArray[np.int64]:
    """Return where groups begin among samples that are sorted by cell (N, 2): with each cell, and every 32 samples."""
    new = np.ones(len(cell), np.bool_)
    new[1:] = (cell[1:] != cell[:-1]).any(axis=1)
    begins = np.flatnonzero(new)
    since = np.arange(len(cell)) - np.repeat(begins, np.diff(np.append(begins, len(cell))))
    return np.flatnonzero(since % GROUP == 0)


def radius_of_largest_gap(
    first: npt.NDArray[np.int64], shape: tuple[int, int], dispersion: float = DEFAULT_DISPERSION
) -> FloatArray:
    """Return the radius within which there is a sample of every surface, px, for each pixel (H, W).

    Parameters
    ----------
    first : ndarray of shape (H * W + 1,), int64
        See `runtime.sheared.samples.Samples`.
    shape : tuple of int
        H and W.
    dispersion : float
        At one sample in each pixel.
    """
    count = np.diff(first).reshape(shape).astype(np.float64)
    density = _window_sum(count) / _window_sum(np.ones(shape))
    with np.errstate(divide="ignore"):
        return np.minimum(dispersion / np.sqrt(density), LARGEST_RADIUS).astype(np.float32)


def _window_sum(values: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return the sum over the square around each pixel, as far as it is in the image."""
    for axis in (0, 1):
        total = np.cumsum(np.insert(values, 0, 0.0, axis=axis), axis=axis)
        at = np.arange(values.shape[axis])
        end = np.minimum(at + WINDOW // 2 + 1, values.shape[axis])
        values = total.take(end, axis=axis) - total.take(np.maximum(at - WINDOW // 2, 0), axis=axis)
    return values


def places(n_views: int, half_shutter: float) -> FloatArray:
    """Return where on lens, shutter and pixel each pattern gathers light: u, v, t, x, y, shape (P, n_views, 5).

    Patterns are the same low-discrepancy sequence, turned around by another.
    """
    roots = np.array(_generalised_golden_ratio(4)) ** -np.arange(1.0, 5.0)
    numbers, shifts = np.arange(n_views)[None, :, None], np.arange(SIDE_OF_PATTERNS**2)[:, None, None]
    points = (0.5 + (numbers + 0.5) * roots + shifts * _generalised_golden_ratio(5) ** -np.arange(1.0, 5.0)) % 1.0
    jitter = ((shifts + 0.5) * _generalised_golden_ratio(5) ** -5.0) % 1.0
    time = ((numbers + jitter) / n_views * 2.0 - 1.0) * half_shutter
    radius, angle = np.sqrt(points[..., :1]), 2.0 * np.pi * points[..., 1:2]
    parts = radius * np.cos(angle), radius * np.sin(angle), time, points[..., 2:] - 0.5
    return np.concatenate(parts, axis=2).astype(np.float32)


def _generalised_golden_ratio(dimensions: int) -> float:
    """Return the root > 1 of ``x^(d + 1) = x + 1``, whose powers make the sequence of Roberts (2018)."""
    root = 2.0
    for _ in range(64):
        root = (1.0 + root) ** (1.0 / (dimensions + 1))
    return root


def patterns(shape: tuple[int, int]) -> npt.NDArray[np.uint8]:
    """Return the pattern of each pixel: each of all in every square of 4 x 4 px, in random order."""
    height, width = (-(-side // SIDE_OF_PATTERNS) for side in shape)
    numbers = np.broadcast_to(np.arange(SIDE_OF_PATTERNS**2, dtype=np.uint8), (height, width, SIDE_OF_PATTERNS**2))
    mixed = np.random.default_rng(SEED).permuted(numbers, axis=2)
    squares = mixed.reshape(height, width, SIDE_OF_PATTERNS, SIDE_OF_PATTERNS).swapaxes(1, 2)
    whole = squares.reshape(height * SIDE_OF_PATTERNS, width * SIDE_OF_PATTERNS)
    return np.ascontiguousarray(whole[: shape[0], : shape[1]])
