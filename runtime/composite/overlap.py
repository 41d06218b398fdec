"""Overlap: how much more, or less, is seen of a layer than if it and those before it blurred apart.

What a point of the lens sees through gaps of one layer is what it sees of the next: both move together from point to
point, the more alike the closer they lie. The product of their mean visibilities knows nothing of that. So the layers
are looked at through points of lens and shutter, coarsely, by what they cover alone; the difference to that product is
smooth, and corrects the layers that are drawn.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from spreadlets.arrays import NOTHING, DoubleArray, Image, IntArray
from spreadlets.parallel import for_bands
from spreadlets.runtime.box_blur import box_blurred
from spreadlets.runtime.buffers import buffer, cleared
from spreadlets.runtime.composite import _overlap_kernels
from spreadlets.runtime.composite._overlap_kernels import CELL, LEAST_CHANGE, MOMENTS, TILE
from spreadlets.runtime.composite.layers import CoverPart, Moments
from spreadlets.runtime.label.labels import Labels
from spreadlets.runtime.label.tiles import largest_around, tiling

POINTS = 256
"""Points of lens and shutter that layers are looked at through: with 64, leaves and coins lose .001 of SSIM."""
GOLDEN_ANGLE = math.pi * (3.0 - math.sqrt(5.0))
STEP_IN_TIME = 7
"""From point to point, the time goes on by so many of the equal steps that half of the shutter's is divided into."""
TILES_AROUND = 1
"""So many tiles around, what was seen of a layer tells how it blurs in one."""
LEAST_SHARE = 1e-3
"""Share of a cell, or of a tile, that counts as nothing."""
LEAST_BLUR = 0.5
"""Blur, cells, up to which a layer stands still."""


class Overlap(NamedTuple):
    """What is seen of each layer beyond the product of mean visibilities.

    Attributes
    ----------
    covariance : ndarray of shape (n_layers, h, w), float32
        In cells.
    corner : tuple of two ints
        Row and column of the frame's first pixel in the first cell.
    shape : tuple of two ints
        Of the frame.
    """

    covariance: Image
    corner: tuple[int, int]
    shape: tuple[int, int]

    def of(self, number: int) -> Image:
        """Return that of a layer, (H, W); nothing if it is 0."""
        cells = self.covariance[number]
        if not cells.any():
            return NOTHING
        image = buffer(self.shape)
        for_bands(_overlap_kernels.enlarge_cells, len(image), cells, self.corner, image)
        return image


def find_overlap(
    frames: Sequence[tuple[CoverPart, Labels]],
    lists: Sequence[CoverPart],
    moments: Sequence[Moments | None],
    *,
    closed: bool,
    hiding: bool,
) -> Overlap | None:
    """Find how the layers of a frame overlap.

    Parameters
    ----------
    frames : sequence of (CoverPart, Labels)
        What is seen, of all pixels.
    lists : sequence of CoverPart
        What else is seen of some.
    moments : sequence of Moments or None
        Of each layer.
    closed : bool
        Whether the last layer is opaque: then it shows all that is left.
    hiding : bool
        Whether what nearer layers cover hid farther ones: there these are taken to be as they are around.

    Returns
    -------
    Overlap or None
        None if no two layers overlap.
    """
    n_layers, shape, side = len(moments), frames[0][0].cover.shape, CELL * TILE
    if n_layers < 2 + closed:
        return None
    row, column = frames[0][1].view.corner
    inner = row % side, column % side
    cells, tiles = tiling(shape, CELL, inner), tiling(shape, side, inner)
    # See what each layer covers in each cell, and how it blurs in each tile.
    covers = cleared((n_layers, *cells))
    sums = np.zeros((*tiles, n_layers, MOMENTS), np.float32)
    for part, labels in frames:
        planes = part.cover, part.place, labels.coc, labels.whole_path
        for_bands(_overlap_kernels.enter_frame, tiles[0], *planes, inner, covers, sums)
    for each in lists:
        _overlap_kernels.enter_list(*each, inner, covers)
    for_bands(_overlap_kernels.make_shares, cells[0], inner, shape, covers)
    # Choose the tiles in which layers overlap that blur, and look at these.
    blurs = _blurs(sums, moments, max(cells))
    reaches = np.abs(blurs[..., 0]) + np.hypot(blurs[..., 1], blurs[..., 2]) / 2.0
    if (reaches > LEAST_BLUR).any(axis=(0, 1)).sum() < 2:
        return None
    padding = TILE + 2 + math.ceil(reaches.max())
    filled = _filled(covers, moments, padding, hiding=hiding)
    wanted = _wanted(filled, reaches, inner, padding, closed=closed)
    if not wanted.any():
        return None
    # Its room is not needed for covers any more.
    covariance = covers
    for_bands(_overlap_kernels.look_through, tiles[0], _points(), blurs, wanted, inner, padding, filled, covariance)
    return Overlap(covariance, inner, shape)


def _blurs(sums: Image, moments: Sequence[Moments | None], most: int) -> DoubleArray:
    """Return CoC radius and path of each layer in each tile, cells, at most so many, (h, w, n_layers, 3)."""
    blurs = np.zeros((*sums.shape[:3], 3))
    for number, mean in enumerate(moments):
        if mean is None:
            continue
        share, *parts = (
            box_blurred(np.ascontiguousarray(each), TILES_AROUND) for each in np.moveaxis(sums[:, :, number], 2, 0)
        )
        # Where little was seen of it, it blurs as in the mean.
        for k, (part, whole) in enumerate(zip(parts, (mean.coc, *mean.motion), strict=True)):
            blurs[:, :, number, k] = (part + LEAST_SHARE * whole) / (share + LEAST_SHARE) / CELL
    return np.clip(blurs, -most, most)


def _filled(covers: Image, moments: Sequence[Moments | None], padding: int, *, hiding: bool) -> Image:
    """Return what each layer covers, also where nearer ones hide it, with its border repeated."""
    n_layers, height, width = covers.shape
    filled = buffer((n_layers, height + 2 * padding, width + 2 * padding))
    known = np.ones((height, width), np.float32)
    for number, mean in enumerate(moments):
        if hiding and number:
            for_bands(_overlap_kernels.hide, height, covers, number, known)
        # What was seen is looked for as far around as the layer blurs.
        half = 1 if mean is None else max(1, sum(mean.box_half_widths()) // (2 * CELL))
        around = [box_blurred(each, half, times=2) for each in (covers[number], known)]
        prior = np.float32(LEAST_SHARE * covers[number].mean()), np.float32(LEAST_SHARE * known.mean())
        given = covers[number], known, *around, prior, padding, filled[number]
        for_bands(_overlap_kernels.fill_unknown, height, *given)
    return filled


def _wanted(covers: Image, reaches: DoubleArray, corner: tuple[int, int], padding: int, *, closed: bool) -> IntArray:
    """Return how many layers are to be looked at in each tile, counted from the nearest, (h, w); 0 if none overlap."""
    low, high = np.empty((2, *reaches.shape), np.float32)
    for_bands(_overlap_kernels.cover_range, len(low), corner, padding, covers, low, high)
    shown = np.flatnonzero(high.any(axis=(0, 1)))
    if closed:
        shown = shown[:-1]
    count, wanted = np.zeros(low.shape[:2], np.int64), np.zeros(low.shape[:2], np.int64)
    for number in shown:
        # A layer that is even around a tile, or stands still, hides all that lies beyond it alike.
        around = math.ceil((reaches[..., number].max() + 1.0) / TILE)
        change = largest_around(high[..., number], around) + largest_around(-low[..., number], around)
        overlaps = (change > LEAST_CHANGE) & (reaches[..., number] > LEAST_BLUR)
        count += overlaps
        wanted[overlaps & (count > 1)] = number + 1
    return wanted


def _points() -> DoubleArray:
    """Return points of the lens, in its radius, and times from the middle of the shutter's, in its length, (n, 3).

    With each there is its reflection in the lens, in time, and in both: reversed in space or time, all stays as it is.
    """
    number = np.arange(POINTS // 4)
    radius, angle = np.sqrt((number + 0.5) / len(number)), GOLDEN_ANGLE / 2.0 * number
    time = (0.5 + STEP_IN_TIME * number % len(number)) / len(number) / 2.0
    quarter = np.stack([radius * np.cos(angle), radius * np.sin(angle), time], axis=1)
    return np.concatenate([quarter * (side, side, way) for side in (1.0, -1.0) for way in (1.0, -1.0)])
