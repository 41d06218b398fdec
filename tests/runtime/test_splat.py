import numba
import numpy as np
import pytest
from reference_splat import splat_naive

from runtime.splat import NO_SHIFT, PointTable, SplatPass, splat


def random_table(rng, n_channels, n_variants=5, reach=6):
    offsets, values, counts = [], [], []
    for _ in range(n_variants):
        n_points = int(rng.integers(1, 12))
        offset = rng.integers(-reach, reach + 1, (n_points, 2)).astype(np.int32)
        offsets.append(offset[np.lexsort((offset[:, 1], offset[:, 0]))])
        values.append(rng.normal(size=(n_points, n_channels)).astype(np.float32))
        counts.append(n_points)
    start = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    return PointTable(np.concatenate(offsets), np.concatenate(values), start, rng.random(n_variants) < 0.4)


def random_pass(rng, n_variants=5, shape=(70, 23), shift=3):
    radiance = rng.random((*shape, 4)).astype(np.float32)
    variant = np.repeat(rng.integers(-1, n_variants, (shape[0], 8)), 3, axis=1)[:, : shape[1]].astype(np.int32)
    moved = rng.integers(-shift, shift + 1, (shape[0], 1, 2)).repeat(shape[1], axis=1).astype(np.int32)
    moved[:, shape[1] // 2 :] = 0
    return SplatPass((-2, 1), radiance, variant, moved)


@pytest.mark.interpreted
@pytest.mark.parametrize("n_channels", [1, 3])
def test_runs_draw_what_single_pixels_would(n_channels):
    rng = np.random.default_rng(n_channels)
    table, source = random_table(rng, n_channels), random_pass(rng)
    for wanted in (table.direct, ~table.direct):
        image = np.zeros((90, 43, 4), np.float32)
        splat(image, source, table, 10, wanted)
        assert np.allclose(image, splat_naive(image.shape, source, table, 10, wanted), atol=2e-5)


def test_the_result_does_not_depend_on_the_number_of_threads():
    rng = np.random.default_rng(5)
    table, source = random_table(rng, 1), random_pass(rng)
    images = []
    for threads in (1, 2):
        before = numba.get_num_threads()
        numba.set_num_threads(min(threads, numba.config.NUMBA_NUM_THREADS))
        images.append(np.zeros((90, 43, 4), np.float32))
        splat(images[-1], source, table, 10, np.ones(5, bool))
        numba.set_num_threads(before)
    assert np.array_equal(*images)


@pytest.mark.interpreted
@pytest.mark.parametrize("n_channels", [1, 3])
def test_direct_points_that_are_neighbours_are_drawn_like_single_ones(n_channels):
    rng = np.random.default_rng(8)
    _, source = random_table(rng, n_channels), random_pass(rng, n_variants=2)
    grid = np.argwhere(rng.random((7, 9)) < 0.8).astype(np.int32) - [3, 4]
    offset = np.concatenate([grid, grid[::2]]).astype(np.int32)
    value = rng.random((len(offset), n_channels)).astype(np.float32)
    table = PointTable(offset, value, np.array([0, len(grid), len(offset)]), np.ones(2, bool))
    image = np.zeros((90, 43, 4), np.float32)
    splat(image, source, table, 10, table.direct)
    assert np.allclose(image, splat_naive(image.shape, source, table, 10, table.direct), atol=2e-5)


@pytest.mark.interpreted
def test_a_pass_without_shift_is_one_with_zero_shift():
    rng = np.random.default_rng(7)
    table, source = random_table(rng, 1), random_pass(rng, shift=0)
    images = np.zeros((2, 90, 43, 4), np.float32)
    splat(images[0], source, table, 10, ~table.direct)
    splat(images[1], source._replace(shift=NO_SHIFT), table, 10, ~table.direct)
    assert images[0].any() and np.array_equal(*images)


def test_nothing_wanted_draws_nothing():
    rng = np.random.default_rng(6)
    table, source = random_table(rng, 1), random_pass(rng)
    image = np.zeros((90, 43, 4), np.float32)
    splat(image, source, table, 10, np.zeros(5, bool))
    assert not image.any()
