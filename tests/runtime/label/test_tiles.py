"""Squares of an image, and the largest values around them."""

import numpy as np
from scipy import ndimage

from spreadlets.runtime.label.tiles import largest_around, tiling


def test_the_largest_around_is_that_of_a_window():
    values = np.random.default_rng(0).random((9, 14))
    for reach in (1, 3, 20):
        assert np.array_equal(largest_around(values, reach), ndimage.maximum_filter(values, 2 * reach + 1))


def test_squares_that_begin_before_the_image_cover_all_of_it():
    for corner in range(-9, 9):
        rows = (np.arange(21) + corner) // 8
        assert tiling((21, 8), 8, (corner, 0)) == (len(np.unique(rows)), 1)
