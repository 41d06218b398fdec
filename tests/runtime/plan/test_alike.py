"""Places that look alike: found where a copy was planted, and given up where nothing tells one from another."""

import numpy as np
import pytest

from spreadlets.runtime.label.tiles import tiling
from spreadlets.runtime.plan._alike_kernels import BLOCK
from spreadlets.runtime.plan.alike import Cells, Found, coarser_blocks, find_alike, halved, judged, refine

CORNERS = ((0, 0), (-37, -50))
SIDE, HOLE = 96, slice(36, 48)


def textured(seed=0, contrast=1.0):
    """Return cells (SIDE, SIDE) of a random texture that repeats every 40 columns, with a hole."""
    rng = np.random.default_rng(seed)
    tile = 0.5 + contrast * (rng.random((SIDE, 40, 3)) - 0.5)
    features = np.ones((SIDE, SIDE, 5), np.float32)
    features[..., :3] = np.tile(tile, (1, 3, 1))[:, :SIDE]
    hides = np.zeros((SIDE, SIDE), np.float32)
    hides[HOLE, HOLE] = 1.0
    features[HOLE, HOLE] = 0.0
    return hides, features


def blocks_over_hole(hides, corner):
    chosen = np.zeros(tiling(hides.shape, BLOCK, corner), np.bool_)
    rows, cols = (np.unique((np.arange(HOLE.start, HOLE.stop) + each % BLOCK) // BLOCK) for each in corner)
    chosen[np.ix_(rows, cols)] = True
    return chosen


@pytest.mark.interpreted
@pytest.mark.parametrize("corner", CORNERS)
def test_a_texture_that_repeats_is_found_where_it_repeats(corner):
    fine_hides, fine = textured()
    hides, half = halved(fine_hides, corner)
    features, _ = halved(fine, corner)
    chosen = blocks_over_hole(fine_hides, corner)
    holding = coarser_blocks(chosen, hides.shape, corner)
    found = find_alike(Cells(hides, features, half), holding).handed_down(chosen, corner)
    cells = Cells(fine_hides, fine, corner)
    refine(cells, found)
    assert {tuple(place) for place in np.abs(found.places[chosen])} == {(0, 40)}
    brightest = judged(cells, found)
    assert (found.unlike[chosen] < 0.05).all() and np.allclose(brightest[chosen], 1.0, atol=0.02)


@pytest.mark.interpreted
@pytest.mark.parametrize("corner", CORNERS)
def test_halved_cells_are_means_of_those_that_there_are(corner):
    fine = np.random.default_rng(1).random((7, 10, 2)).astype(np.float32)
    coarse, half = halved(fine, corner)
    rows, cols = ((np.arange(n) + each) // 2 - each // 2 for n, each in zip(fine.shape, corner, strict=False))
    for i, j in np.ndindex(coarse.shape[:2]):
        assert np.allclose(coarse[i, j], fine[np.ix_(rows == i, cols == j)].mean(axis=(0, 1)))
    assert half == (corner[0] // 2, corner[1] // 2)


def test_a_place_that_is_no_more_alike_than_any_other_is_given_up():
    """Random textures of little contrast differ by little wherever they are."""
    hides, features = textured(contrast=0.3)
    chosen = blocks_over_hole(hides, (0, 0))
    alike = np.where(chosen, 0.04, -1.0)
    found = Found(np.zeros((*chosen.shape, 2), np.int64), alike)
    judged(Cells(hides, features, (0, 0)), found)
    assert np.isinf(found.unlike[chosen]).all() and (found.unlike[~chosen] == -1.0).all()
