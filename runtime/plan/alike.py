"""What looks alike: for blocks of cells, other places around which the same was seen."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from spreadlets.arrays import BoolArray, DoubleArray, Image, IntArray
from spreadlets.parallel import for_bands
from spreadlets.runtime.label.tiles import largest_around, tiling
from spreadlets.runtime.plan import _alike_kernels
from spreadlets.runtime.plan._alike_kernels import AROUND, BLOCK, FARTHEST, LIKE

ROUNDS = 3
"""So often blocks try their neighbours' places."""
BLOCKS_NEAR = -(-(FARTHEST + AROUND) // BLOCK) + 3
"""So many blocks around those that look for a place may be compared: places move on by up to 13 cells in all."""
BLOCKS_AROUND = 2 * BLOCKS_NEAR
"""The same, from places in cells twice as large."""
BLOCKS_BESIDE = -(-AROUND // BLOCK) + 2
"""So many around a block, or its place, are looked at when places are refined, and when they are copied."""


class Cells(NamedTuple):
    """What was seen in cells.

    Attributes
    ----------
    hides : ndarray of shape (h, w), float32
        Share of each cell that hides what is looked for.
    features : ndarray of shape (h, w, n), float32
        What was seen, see the kernels.
    corner : tuple of two ints
        Row and column of the first cell, counted from the picture's centre.
    """

    hides: Image
    features: Image
    corner: tuple[int, int]


class Found(NamedTuple):
    """What blocks have found.

    Attributes
    ----------
    places : ndarray of shape (h / BLOCK, w / BLOCK, 2), int64
        Rows and columns, cells, from each block to where what was seen around it is most alike.
    unlike : ndarray of shape (h / BLOCK, w / BLOCK), float64
        How unlike that is, infinite where nothing is alike, and negative where no place was looked for.
    """

    places: IntArray
    unlike: DoubleArray

    def handed_down(self, chosen: BoolArray, corner: tuple[int, int]) -> Found:
        """Return the same for chosen blocks of cells half as large, ``corner`` being the first of these."""
        places, unlike = np.zeros((*chosen.shape, 2), np.int64), np.full(chosen.shape, -1.0)
        above = _block_above(chosen, corner)
        places[chosen], unlike[chosen] = 2 * self.places[above], self.unlike[above]
        return Found(places, unlike)

    def looked_at(self) -> BoolArray:
        """Return which blocks tell what is seen around those that look for a place, and around what they have found."""
        block = np.stack(np.nonzero(self.unlike >= 0.0))
        there = np.clip(block + self.places[*block].T // BLOCK, 0, np.array(self.unlike.shape)[:, None] - 1)
        own, found = np.zeros((2, *self.unlike.shape), np.bool_)
        own[*block] = found[*there] = True
        return np.asarray(largest_around(own, BLOCKS_NEAR) | largest_around(found, BLOCKS_BESIDE))


def halved(hides: Image, corner: tuple[int, int]) -> tuple[Image, tuple[int, int]]:
    """Return means over twice as large cells, of shares (h, w) or features (h, w, n), and the first one's place."""
    shape = tiling(hides.shape[:2], 2, corner)
    planes = hides.reshape(*hides.shape[:2], -1)
    coarse = np.empty((*shape, planes.shape[2]), np.float32)
    for_bands(_alike_kernels.halve_cells, len(coarse), planes, corner, coarse)
    return coarse.reshape(*shape, *hides.shape[2:]), (corner[0] >> 1, corner[1] >> 1)


def coarser_blocks(chosen: BoolArray, shape: tuple[int, int], corner: tuple[int, int]) -> BoolArray:
    """Return which blocks of twice as large cells, of which there are (h, w), hold a chosen block."""
    holding = np.zeros(tiling(shape, BLOCK, (corner[0] >> 1, corner[1] >> 1)), np.bool_)
    holding[_block_above(chosen, corner)] = True
    return holding


def find_alike(cells: Cells, chosen: BoolArray) -> Found:
    """Find places for chosen blocks, from those found for cells twice as large.

    Notes
    -----
    PatchMatch (Barnes et al. 2009), for blocks and with trials that are the same each time.
    """
    (hides, corner), (features, _) = halved(cells.hides, cells.corner), halved(cells.features, cells.corner)
    holding = coarser_blocks(chosen, hides.shape, cells.corner)
    coarse = _searched(Cells(hides, features, corner), holding, np.zeros((*holding.shape, 2), np.int64))
    return _searched(cells, chosen, coarse.handed_down(chosen, cells.corner).places)


def refine(cells: Cells, found: Found) -> None:
    """Move places by a cell or so, in place, where that is more alike; blocks that found none look for one here."""
    for_bands(_alike_kernels.refine_places, len(found.unlike), *cells, *found)
    alone = found.unlike > LIKE
    if alone.any():
        own = _searched(cells, alone, np.zeros_like(found.places), LIKE)
        found.places[alone], found.unlike[alone] = own.places[alone], own.unlike[alone]


def judged(cells: Cells, found: Found) -> DoubleArray:
    """Return how bright what was seen around each block is; places that are alike by chance are given up."""
    brightest = np.zeros(found.unlike.shape)
    for_bands(_alike_kernels.judge_places, len(brightest), *cells, found.unlike, brightest)
    return brightest


def _searched(cells: Cells, chosen: BoolArray, places: IntArray, most: float = math.inf) -> Found:
    """Return what chosen blocks find, each from a place to begin with."""
    found = Found(places, np.where(chosen, np.inf, -1.0))
    for number in range(ROUNDS):
        before, found = found, Found(np.empty_like(found.places), np.empty_like(found.unlike))
        for_bands(_alike_kernels.look_up, len(chosen), *cells, not number, most, tuple(before), *found)
    return found


def _block_above(chosen: BoolArray, corner: tuple[int, int]) -> tuple[IntArray, IntArray]:
    """Return rows and columns of the blocks of twice as large cells that hold the chosen ones."""
    first = [each // BLOCK for each in corner]
    row, col = (
        (numbers + own >> 1) - (each >> 1) // BLOCK
        for numbers, own, each in zip(np.nonzero(chosen), first, corner, strict=True)
    )
    return row, col
