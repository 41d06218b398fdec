"""Pooling: pixels that lie elsewhere than where they were seen are drawn together with those that lie there, too.

Stochastic samples, moved to where they would lie without lens and at mid-shutter, fall onto the pixels that see them
through a pinhole, wherever on the lens they were taken; and a pixel that is moved by part of a pixel is split over up
to four. Splats with one PSF, in one layer and on one pixel add up before they are drawn, which is exact, since
splatting is linear; and neighbours with one PSF become runs.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import Image
from spreadlets.parallel import for_bands, for_blocks, for_each
from spreadlets.runtime.label.labels import NO_SHIFT
from spreadlets.runtime.label.trail import Trail
from spreadlets.runtime.plan import _pool_kernels
from spreadlets.runtime.plan._pool_kernels import Sides, Stepped, Sums, Way
from spreadlets.runtime.splat.passes import SplatPass

CHUNKS = 16
"""Parts of the rows of pixels that are listed independently; fixed, so that sums are the same for any thread count."""
BLOCK_ROWS = 16
"""Rows of the image that are added up at a time: few enough for a processor's own memory."""
LEAST_SUMS = 1024
"""Sums that there is room for at first."""
SLOTS_PER_SUM = 4
"""Slots of the table in which sums are looked for: at least half of it stays empty."""
MOST_SPLATS = 1 << 25
"""Splats that are pooled at a time: some 2 GiB, if no two agree."""

NO_WAY = Way(np.zeros((0, 0, 2), np.float32), np.zeros((0, 0, 2), np.float32), (0.0, 0.0))
"""The way of pixels that are drawn once."""


class PlacedPixels(NamedTuple):
    """Pixels, or one sample of each, in one of their layers, and where their splats lie.

    Beyond the border they are repeated straight outwards: along edges, see `runtime.plan.border`, nothing is gained for
    what moves.

    Attributes
    ----------
    pixels : Stepped
        Their labels are ``layer * n_variants + variant``, negative where nothing is drawn.
    limit : ndarray of shape (h, w), float32
        How bright they may be where they are repeated beyond the border, see `runtime.plan.border.border_limit`; empty
        if they are not.
    """

    pixels: Stepped
    limit: Image


def place_pixels(
    radiance: Image,
    weight: Image,
    label: npt.NDArray[np.int32],
    shift: Image,
    at: npt.NDArray[np.int32] | None,
    wide: npt.NDArray[np.bool_],
    limit: Image,
    trail: Trail | None = None,
) -> PlacedPixels:
    """Return pixels with their places.

    Parameters
    ----------
    radiance, label, limit
        See `PlacedPixels`.
    weight : ndarray of shape (H, W) or (0, 0), float32
        Empty if all weights are 1.
    shift : ndarray of shape (H, W, 2), float32
        Displacement (x, y) of the splat's centre from the pixel, px.
    at : ndarray of shape (H, W, 2), int32, or None
        Row and column in the frame of the pixels of a list.
    wide : ndarray of shape (n_variants,), bool
        Variants whose centres are moved to the next pixel.
    trail : Trail, optional
        The places of pixels that are drawn at several, counted from ``shift``.
    """
    first, share, way, n_steps = np.zeros(0, np.int64), np.zeros(0, np.float32), NO_WAY, label.size
    if trail is not None:
        first = np.concatenate([[0], np.cumsum(np.where(label >= 0, trail.n_places, 0))])
        share, way, n_steps = trail.share, Way(trail.before, trail.after, trail.shutter), int(first[-1])
    steps = np.empty((n_steps, 2), np.int32)
    for_bands(_pool_kernels.place_steps, len(label), shift, label, wide, way, first, steps)
    weight = weight if len(weight) else np.ones(label.shape, np.float32)
    return PlacedPixels(Stepped(radiance, weight, label, steps, first, share, NO_SHIFT if at is None else at), limit)


def pool(
    pixels: Sequence[PlacedPixels], shape: tuple[int, int], reaches: npt.NDArray[np.int64], n_layers: int
) -> Iterator[SplatPass]:
    """Yield the splats of pixels, those of one label and place added up, as passes of one row.

    Parameters
    ----------
    pixels : sequence of PlacedPixels
    shape : tuple of two ints
        Height and width of the frame.
    reaches : ndarray of shape (n_variants,), int64
        How far each variant reaches from its centre, px.
    n_layers : int
        Depth layers.
    """
    if not pixels or not len(reaches):
        return
    image = _Image(shape, reaches, n_layers * len(reaches), int(reaches.max()))
    sets = [_Set.of(each, image) for each in pixels]
    sizes = [each.n_splats for each in sets]
    begin = 0
    while begin < len(sets):
        end = begin + max(1, int(np.searchsorted(np.cumsum(sizes[begin:]), MOST_SPLATS, side="right")))
        if any(each.counts.any() for each in sets[begin:end]):
            yield _pooled(sets[begin:end], image)
        begin = end


class _Image(NamedTuple):
    """Where splats go: height and width of the frame; how far each variant reaches; labels; the farthest reach, px."""

    shape: tuple[int, int]
    reaches: npt.NDArray[np.int64]
    n_labels: int
    far: int

    @property
    def n_blocks(self) -> int:
        """Number of blocks of rows in which there may be splats."""
        return -(-(self.shape[0] + 2 * self.far) // BLOCK_ROWS)


class _Set(NamedTuple):
    """Pixels, how far the frame is continued for them, how many reach each block (chunks, blocks), and their splats."""

    pixels: Stepped
    limit: Image
    padding: Sides
    counts: npt.NDArray[np.int64]
    n_splats: int

    @classmethod
    def of(cls, placed: PlacedPixels, image: _Image) -> _Set:
        """Count the splats of pixels."""
        padding = _padding(placed.pixels, image.shape, image.reaches) if len(placed.limit) else Sides(0, 0, 0, 0)
        counts, nothing = np.zeros((CHUNKS, image.n_blocks), np.int64), np.zeros(0, np.int32)
        unlisted = cls(placed.pixels, placed.limit, padding, counts, 0)
        return unlisted._replace(n_splats=unlisted._list(image, counts, nothing))

    def listed(self, image: _Image) -> list[npt.NDArray[np.int32]]:
        """Return the numbers of the pixels that reach each block."""
        ends = np.cumsum(self.counts.T)
        at = np.ascontiguousarray((ends - self.counts.T.ravel()).reshape(self.counts.T.shape).T)
        listed = np.empty(ends[-1], np.int32)
        if len(listed):
            self._list(image, at, listed)
        return np.split(listed, ends[CHUNKS - 1 : -1 : CHUNKS])

    def _list(self, image: _Image, at: npt.NDArray[np.int64], listed: npt.NDArray[np.int32]) -> int:
        """Count or list the pixels, see the kernel; return how many splats they have at most."""
        n_splats = np.empty(CHUNKS, np.int64)
        given = self.pixels, (image.shape, self.padding), image.reaches, (-image.far, BLOCK_ROWS)
        for_blocks(_pool_kernels.list_pixels, CHUNKS, *given, at, n_splats, listed)
        return int(n_splats.sum())


def _padding(pixels: Stepped, shape: tuple[int, int], reaches: npt.NDArray[np.int64]) -> Sides:
    """Return how far beyond each side a pixel like those on the border reaches back into the frame."""
    found, (height, width) = [], pixels.label.shape
    label, own = pixels.label.ravel(), pixels.first if len(pixels.first) else np.arange(pixels.label.size + 1)
    for axis, sign in ((0, 1), (0, -1), (1, 1), (1, -1)):
        border = 0 if sign > 0 else shape[axis] - 1
        if len(pixels.at):
            edge = np.flatnonzero(pixels.at[..., axis] == border)
        else:
            edge = np.arange(width) + border * width if axis == 0 else np.arange(height) * width + border
        edge = edge[label[edge] >= 0]
        # Take all of their steps.
        count = own[edge + 1] - own[edge]
        steps = np.repeat(own[edge] - np.cumsum(count) + count, count) + np.arange(count.sum())
        towards = sign * (pixels.steps[steps, axis] // _pool_kernels.STEPS_PER_PIXEL) + 1
        found.append(int((np.repeat(reaches[label[edge] % len(reaches)], count) + towards).max(initial=0)))
    return Sides(*found)


def _pooled(sets: Sequence[_Set], image: _Image) -> SplatPass:
    """Return the splats of pixels, added up, by rows, labels and columns."""
    # List the pixels that reach each block of rows.
    listed = [each.listed(image) for each in sets]
    n_cols = image.shape[1] + 2 * image.far

    def add_up(block: int) -> tuple[npt.NDArray[np.int64], Image]:
        """Return keys, ascending, and sums of a block of rows."""
        sums, begin = _room(LEAST_SUMS, n_cols), BLOCK_ROWS * block - image.far
        for each, numbers in zip(sets, listed, strict=True):
            given = each.pixels, (image.shape, each.padding), each.limit, image.reaches
            sizes, place = (image.n_labels, -image.far, n_cols), (0, 0)
            while place[0] < len(numbers[block]):
                place, n_sums = _pool_kernels.add_splats(
                    begin, begin + BLOCK_ROWS, numbers[block], place, *given, sizes, sums
                )
                sums = sums._replace(n_sums=n_sums)
                if place[0] < len(numbers[block]):
                    sums = _room(2 * len(sums.key), n_cols, sums)
        order = np.argsort(sums.key[: sums.n_sums])
        # Rows are counted from the first in which there may be splats.
        return sums.key[order] + BLOCK_ROWS * block * image.n_labels * n_cols, sums.radiance.reshape(-1, 4)[order]

    # Add up the blocks, and read labels and places off their keys.
    keys, radiance = zip(*for_each(add_up, range(image.n_blocks)), strict=True)
    line, col = np.divmod(np.concatenate(keys), n_cols)
    row, label = np.divmod(line, image.n_labels)
    shift = np.stack([row - image.far, col - image.far - np.arange(len(col))], axis=-1)
    return SplatPass((0, 0), np.concatenate(radiance)[None], label.astype(np.int32)[None], shift.astype(np.int32)[None])


def _room(most: int, n_cols: int, sums: Sums | None = None) -> Sums:
    """Return room for sums, of which some may be there."""
    slot = np.full(SLOTS_PER_SUM * most, -1, np.int32)
    key, radiance = np.empty(most, np.int64), np.empty(4 * most, np.float32)
    if sums is None:
        return Sums(slot, key, radiance, 0)
    key[: sums.n_sums], radiance[: 4 * sums.n_sums] = sums.key[: sums.n_sums], sums.radiance[: 4 * sums.n_sums]
    _pool_kernels.enter(0, sums.n_sums, key, n_cols, slot)
    return Sums(slot, key, radiance, sums.n_sums)
