import numpy as np
import pytest
from naive.edges import steered_mean
from scipy import ndimage
from threads import for_thread_counts

from spreadlets.runtime.finish import _edge_kernels
from spreadlets.runtime.finish.edges import (
    LEAST_SLOPE,
    SHARP_REACH,
    WINDOW_AXES,
    WINDOW_REACH,
    PlacedSamples,
    keep_edges,
    sharp_samples,
)

SIZE = 64
FLOOR = 0.1


def stripes(angle=0.4, period=16.0):
    """An opaque layer (H, W, 4) of stripes with hard edges."""
    rows, cols = np.indices((SIZE, SIZE))
    dark = np.mod(cols * np.cos(angle) + rows * np.sin(angle), period) < period / 2
    layer = np.ones((SIZE, SIZE, 4), np.float32)
    layer[..., :3] = np.where(dark, 0.2, 0.8)[..., None] * np.array((1.0, 0.9, 0.7))
    return layer


def blurred(layer, sigma=1.0):
    """The layer, smoothed as one is that was filled from around."""
    soft = layer.copy()
    for c in range(3):
        soft[..., c] = ndimage.gaussian_filter(layer[..., c], sigma)
    return soft


def sampled(layer, rng, *, missing=0.5, noise=0.05, coc=0.0, length=0.0):
    """One sample of each pixel, some of which met another layer."""
    colours = layer.copy()
    colours[..., :3] *= 1.0 + noise * rng.standard_normal((SIZE, SIZE, 1))
    place = np.where(rng.random((SIZE, SIZE)) < missing, np.float32(3.0), np.float32(1.0))
    wide = (np.full((SIZE, SIZE), value, np.float32) for value in (coc, length))
    return [PlacedSamples(colours.astype(np.float32), place.astype(np.float32), *wide)]


def error(layer, truth):
    return float(np.abs(layer - truth)[..., :3].mean())


def test_edges_that_were_blurred_are_brought_back_and_alpha_stays():
    truth = stripes()
    layer = blurred(truth)
    before = error(layer, truth)
    keep_edges(layer, sharp_samples(sampled(truth, np.random.default_rng(0)), 1), FLOOR)
    assert error(layer, truth) < 0.75 * before
    assert (layer[..., 3] == 1.0).all()


def test_noise_does_not_enter_where_the_layer_is_right():
    truth = stripes(period=200.0)
    rows, cols = np.indices((SIZE, SIZE))
    truth[..., :3] *= (1.0 + 0.5 * np.sin(cols / 4.0))[..., None]  # slopes, but none that were lost
    layer = truth.copy()
    keep_edges(layer, sharp_samples(sampled(truth, np.random.default_rng(1), noise=0.3), 1), FLOOR)
    assert error(layer, truth) < 0.01 * 0.3


def test_an_even_layer_stays_as_it_is_to_the_bit():
    layer = np.full((SIZE, SIZE, 4), 0.5, np.float32)
    rng = np.random.default_rng(2)
    same = layer.copy()
    keep_edges(same, sharp_samples(sampled(layer, rng, noise=0.0), 1), FLOOR)
    keep_edges(same, sharp_samples(sampled(layer, rng, noise=0.2), 1), FLOOR)
    assert np.array_equal(same, layer)


@pytest.mark.parametrize(("coc", "length"), [(SHARP_REACH + 1.0, 0.0), (0.0, 2.0 * SHARP_REACH + 2.0)])
def test_what_is_out_of_focus_or_moves_is_not_sharp(coc, length):
    rng = np.random.default_rng(3)
    assert sharp_samples(sampled(stripes(), rng, coc=coc, length=length), 1) is None
    assert sharp_samples(sampled(stripes(), rng, coc=0.8 * coc, length=0.8 * length), 1) is not None
    assert sharp_samples(sampled(stripes(), rng, missing=0.0), 3) is None


def test_a_layer_that_is_sharp_in_part_is_changed_in_part():
    truth = stripes()
    changed = []
    for coc in (0.0, SHARP_REACH + 0.5):
        layer = blurred(truth)
        before = layer.copy()
        keep_edges(layer, sharp_samples(sampled(truth, np.random.default_rng(4), noise=0.0, coc=coc), 1), FLOOR)
        changed.append(np.abs(layer - before).sum())
    assert 0.4 * changed[0] < changed[1] < 0.6 * changed[0]


@pytest.mark.interpreted
def test_means_are_taken_along_edges():
    rng = np.random.default_rng(5)
    shape = 12, 11
    lacking = rng.standard_normal((*shape, 3)).astype(np.float32)
    count = rng.integers(0, 3, shape).astype(np.float32)
    slope = rng.standard_normal((2, *shape))
    other = 0.3 * rng.standard_normal((2, *shape))
    products = np.stack(
        [
            a * b + c * d
            for (a, b), (c, d) in (
                ((slope[0], slope[0]), (other[0], other[0])),
                ((slope[0], slope[1]), (other[0], other[1])),
                ((slope[1], slope[1]), (other[1], other[1])),
            )
        ]
    ).astype(np.float32)
    products[:, 3, 4] = 0.0
    mean, variance = np.zeros_like(lacking), np.zeros(shape, np.float32)
    windows = lacking, count, products, LEAST_SLOPE, WINDOW_REACH, WINDOW_AXES
    _edge_kernels.steered_means(0, shape[0], *windows, mean, variance)
    assert variance[3, 4] == _edge_kernels.UNSTEERED
    for row, col in ((0, 0), (5, 6), (11, 10), (7, 2)):
        expected = steered_mean(lacking, count, products, row, col)
        assert mean[row, col] == pytest.approx(expected[0], abs=1e-4)
        assert variance[row, col] == pytest.approx(expected[1], rel=1e-3)


def test_rows_far_from_sharp_samples_play_no_part():
    truth = stripes()
    samples = sampled(truth, np.random.default_rng(6))
    samples[0].place[: SIZE // 2] = 3.0
    layer = blurred(truth)
    before = layer.copy()
    keep_edges(layer, sharp_samples(samples, 1), FLOOR)
    changed = np.abs(layer - before).any(axis=(1, 2))
    assert not changed[: SIZE // 2 - WINDOW_REACH].any() and changed[SIZE // 2 - 2 :].all()


def test_edges_are_the_same_for_any_number_of_threads():
    truth = stripes()
    samples = sampled(truth, np.random.default_rng(7))

    def made():
        layer = blurred(truth)
        keep_edges(layer, sharp_samples(samples, 1), FLOOR)
        return layer

    first, *others = for_thread_counts(made)
    assert all(np.array_equal(first, other) for other in others)
