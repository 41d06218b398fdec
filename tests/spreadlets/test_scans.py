import numpy as np
import pytest

from spreadlets.runtime.buffers import cleared, copied
from spreadlets.scans import count_alphas, holds_anything, visible_range

SHAPE = (50, 30)


@pytest.mark.interpreted
@pytest.mark.parametrize("place", [(0, 0), (17, 29), (49, 3)])
@pytest.mark.parametrize("value", [1e-30, -1.0, np.nan])
def test_a_single_value_is_found_wherever_it_is(place, value):
    array = np.zeros((*SHAPE, 2), np.float32)
    assert not holds_anything(array) and not holds_anything(array[:0])
    array[(*place, 1)] = value
    assert holds_anything(array) and holds_anything(array[::-1, ::-1])


@pytest.mark.interpreted
def test_alphas_are_counted():
    radiance = np.ones((*SHAPE, 4), np.float32)
    radiance[3, :7, 3], radiance[40:, 0, 3] = 0.0, 0.5
    assert count_alphas(radiance) == (7, 10, 1500 - 17)
    # A frame holds the array that it was given, which may change before the next one is made of it.
    radiance[0, 10, 3] = 0.25
    assert count_alphas(radiance) == (7, 11, 1500 - 18)


@pytest.mark.interpreted
def test_the_visible_range_leaves_out_what_is_transparent_or_too_far():
    rng = np.random.default_rng(0)
    depth = rng.uniform(1.0, 9.0, SHAPE).astype(np.float32)
    radiance = np.ones((*SHAPE, 4), np.float32)
    depth[4, 5], depth[6, 7], depth[8, 9], depth[10, 11] = 0.5, 20.0, 0.1, 1e10
    radiance[8, 9, 3] = 0.0
    assert visible_range(depth, radiance, 1e8) == (0.5, 20.0)
    assert visible_range(depth, np.zeros_like(radiance), 1e8) == (np.inf, 0.0)


def test_lent_memory_is_cleared_and_copies_are_apart():
    for _ in range(2):
        array = cleared((300, 300, 2))
        assert not array.any()
        array[:] = 7.0
        del array
    given = np.random.default_rng(1).random((300, 300, 4)).astype(np.float32)
    copy = copied(given)
    np.testing.assert_array_equal(copy, given)
    copy[:] = 0.0
    assert given.any()
