import numpy as np
import pytest
from naive.edges import steered_mean
from scipy import ndimage
from threads import for_thread_counts

from spreadlets.runtime.finish import _edge_kernels
from spreadlets.runtime.finish.edges import (
    FOLLOWED,
    LEAST_SLOPE,
    SHARP_REACH,
    STRAIGHT,
    PlacedSamples,
    keep_edges,
    keep_outlines,
)

SIZE = 64
FLOOR = 0.1


def stripes(angle=0.4, period=16.0, offset=(0.0, 0.0)):
    """An opaque layer (H, W, 4) of stripes with hard edges, at places (dx, dy) from the pixels' centres."""
    rows, cols = np.indices((SIZE, SIZE))
    rows, cols = rows + offset[1], cols + offset[0]
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


def sampled(layer, rng, *, missing=0.5, noise=0.05, coc=0.0, path=(0.0, 0.0)):
    """One sample of each pixel, seen at its centre, some of which met another layer."""
    colours = layer.copy()
    colours[..., :3] *= 1.0 + noise * rng.standard_normal((SIZE, SIZE, 1))
    place = np.where(rng.random((SIZE, SIZE)) < missing, np.float32(3.0), np.float32(1.0))
    return [placed(colours, place, coc=coc, path=path)]


def placed(colours, place, *, coc=0.0, path=(0.0, 0.0), offset=(0.0, 0.0)):
    """One sample of each pixel."""
    vectors = (np.broadcast_to(np.float32(each), (SIZE, SIZE, 2)).copy() for each in (path, offset))
    return PlacedSamples(
        colours.astype(np.float32), place.astype(np.float32), np.full((SIZE, SIZE), coc, np.float32), *vectors
    )


def error(layer, truth):
    return float(np.abs(layer - truth)[..., :3].mean())


def test_edges_that_were_blurred_are_brought_back_and_alpha_stays():
    truth = stripes()
    layer = blurred(truth)
    before = error(layer, truth)
    keep_edges(layer, sampled(truth, np.random.default_rng(0)), 1, FLOOR)
    assert error(layer, truth) < 0.75 * before
    assert (layer[..., 3] == 1.0).all()


def test_noise_does_not_enter_where_the_layer_is_right():
    truth = stripes(period=200.0)
    rows, cols = np.indices((SIZE, SIZE))
    truth[..., :3] *= (1.0 + 0.5 * np.sin(cols / 4.0))[..., None]  # slopes, but none that were lost
    layer = truth.copy()
    keep_edges(layer, sampled(truth, np.random.default_rng(1), noise=0.3), 1, FLOOR)
    assert error(layer, truth) < 0.01 * 0.3


def test_an_even_layer_stays_as_it_is_to_the_bit():
    layer = np.full((SIZE, SIZE, 4), 0.5, np.float32)
    rng = np.random.default_rng(2)
    same = layer.copy()
    keep_edges(same, sampled(layer, rng, noise=0.0), 1, FLOOR)
    keep_edges(same, sampled(layer, rng, noise=0.2), 1, FLOOR)
    assert np.array_equal(same, layer)


def changed_by(angle=0.0, **seen):
    """How much of what was lost of stripes samples bring back."""
    truth = stripes(angle)
    layer = blurred(truth)
    before = layer.copy()
    keep_edges(layer, sampled(truth, np.random.default_rng(3), **seen), 1, FLOOR)
    return np.abs(layer - before).sum() / np.abs(truth - before).sum()


def test_what_is_out_of_focus_or_moves_across_an_edge_is_not_sharp():
    assert changed_by() > 0.5
    for seen in ({"coc": SHARP_REACH + 1.0}, {"path": (2.0 * SHARP_REACH + 2.0, 0.0)}, {"missing": 1.0}):
        assert changed_by(**seen) == 0.0
    for seen in ({"coc": 0.8 * SHARP_REACH}, {"path": (1.6 * SHARP_REACH, 0.0)}):
        assert changed_by(**seen) > 0.5


def test_what_moves_along_an_edge_is_sharp_whatever_its_path():
    still = changed_by(angle=0.6)
    along, across = (-8.0 * np.sin(0.6), 8.0 * np.cos(0.6)), (8.0 * np.cos(0.6), 8.0 * np.sin(0.6))
    assert changed_by(angle=0.6, path=along) == pytest.approx(still, rel=0.01)
    assert changed_by(angle=0.6, path=across) < 0.1 * still


def test_where_in_its_pixel_a_sample_was_seen_makes_it_less_noisy():
    rng = np.random.default_rng(8)
    offset = rng.uniform(-0.5, 0.5, (SIZE, SIZE, 2))
    fine = [stripes(offset=(dx, dy)) for dx in np.arange(-3.5, 4) / 8 for dy in np.arange(-3.5, 4) / 8]
    truth = np.mean(fine, axis=0, dtype=np.float32)
    seen, errors = stripes(offset=np.moveaxis(offset, 2, 0)), []
    for known in (offset, 0.0 * offset):
        layer = blurred(truth, 0.8)
        keep_edges(layer, [placed(seen, np.ones((SIZE, SIZE)), offset=known)], 1, FLOOR)
        errors.append(np.square(layer - truth).mean())
    assert errors[0] < 0.88 * errors[1]


def disc(x, y):
    return np.hypot(x - 30.3, y - 33.1) < 17.0


def half_seen(rng, *, missing=0.0):
    """The cover of a disc (H, W), and one sample of each pixel, of layer 1 where it met the disc."""
    rows, cols = np.indices((SIZE, SIZE))
    fine = [(cols + dx, rows + dy) for dx in np.arange(-3.5, 4) / 8 for dy in np.arange(-3.5, 4) / 8]
    cover = np.mean([disc(*each) for each in fine], axis=0)
    offset = rng.uniform(-0.5, 0.5, (SIZE, SIZE, 2))
    place = np.where(disc(cols + offset[..., 0], rows + offset[..., 1]), 1.0, 2.0)
    place[rng.random((SIZE, SIZE)) < missing] = -2.0
    return cover.astype(np.float32), placed(np.ones((SIZE, SIZE, 4)), place, offset=offset)


@pytest.mark.parametrize("missing", [0.0, 0.4])
def test_outlines_that_were_blurred_are_brought_back_in_the_layers_colour(missing):
    cover, samples = half_seen(np.random.default_rng(9), missing=missing)
    colour = np.array((0.8, 0.4, 0.1, 1.0), np.float32)
    layer = ndimage.gaussian_filter(cover, 1.2)[..., None] * colour
    before = np.abs(layer[..., 3] - cover).mean()
    keep_outlines(layer, [samples], 1)
    assert np.abs(layer[..., 3] - cover).mean() < (0.6 if missing else 0.5) * before
    assert layer[..., 3].min() >= 0.0 and layer[..., 3].max() <= 1.0
    np.testing.assert_allclose(layer, layer[..., 3:] * colour, atol=1e-6)


def test_an_outline_that_is_right_gets_little_noise_and_an_even_cover_stays_to_the_bit():
    cover, samples = half_seen(np.random.default_rng(10))
    layer = cover[..., None] * np.ones(4, np.float32)
    keep_outlines(layer, [samples], 1)
    assert np.abs(layer[..., 3] - cover).mean() < 0.002
    even = np.full((SIZE, SIZE, 4), 0.5, np.float32)
    same = even.copy()
    keep_outlines(same, [samples], 1)
    assert np.array_equal(same, even)


def test_a_layer_that_is_sharp_in_part_is_changed_in_part():
    truth = stripes()
    changed = []
    for coc in (0.0, SHARP_REACH + 0.5):
        layer = blurred(truth)
        before = layer.copy()
        keep_edges(layer, sampled(truth, np.random.default_rng(4), noise=0.0, coc=coc), 1, FLOOR)
        changed.append(np.abs(layer - before).sum())
    assert 0.4 * changed[0] < changed[1] < 0.6 * changed[0]


@pytest.mark.interpreted
def test_means_are_taken_along_edges_as_far_as_they_go_on():
    rng, shape = np.random.default_rng(5), (24, 21)
    lacking = rng.standard_normal((*shape, 3)).astype(np.float32)
    count = rng.integers(0, 3, shape).astype(np.float32)
    # Rings, whose slopes agree more or less.
    rows, cols = np.indices(shape)
    y, x = rows - 11.3, cols - 9.6
    noise = 0.02 * rng.random(shape)
    products = np.stack([x * x, x * y, y * y]) / (x * x + y * y) + noise * np.array((1.0, 0.0, 1.0))[:, None, None]
    is_edge = rng.random(shape) < 0.95
    products, wanted = products.astype(np.float32), is_edge.astype(np.float32)
    directions, mean, variance = np.empty((*shape, 3), np.float32), np.empty_like(lacking), np.empty_like(count)
    _edge_kernels.find_directions(0, shape[0], products, LEAST_SLOPE, wanted, directions)
    _edge_kernels.steered_means(0, shape[0], lacking, count, directions, FOLLOWED, STRAIGHT, mean, variance)
    assert (variance[~is_edge] == _edge_kernels.UNSTEERED).all() and not mean[~is_edge].any()
    is_met = np.isfinite(variance)
    assert is_met[is_edge].mean() > 0.95
    for row, col in [(0, 0), (5, 6), (23, 20), (7, 2), (11, 9), *rng.integers(0, shape, (20, 2))]:
        if is_met[row, col]:
            expected = steered_mean(lacking, count, products, is_edge, row, col)
            assert mean[row, col] == pytest.approx(expected[0], abs=1e-4)
            assert variance[row, col] == pytest.approx(expected[1], rel=1e-3)


def test_rows_far_from_sharp_samples_play_no_part():
    truth = stripes()
    samples = sampled(truth, np.random.default_rng(6))
    samples[0].place[: SIZE // 2] = 3.0
    layer = blurred(truth)
    before = layer.copy()
    keep_edges(layer, samples, 1, FLOOR)
    changed = np.abs(layer - before).any(axis=(1, 2))
    assert not changed[: SIZE // 2 - int(FOLLOWED[0])].any() and changed[SIZE // 2 - 2 :].all()


def test_edges_are_the_same_for_any_number_of_threads():
    truth = stripes()
    samples = sampled(truth, np.random.default_rng(7))
    cover, seen = half_seen(np.random.default_rng(11))
    soft = ndimage.gaussian_filter(cover, 1.2)

    def made():
        layer = blurred(truth)
        layer[..., 3] = soft
        keep_edges(layer, [*samples, seen], 1, FLOOR)
        keep_outlines(layer, [*samples, seen], 1)
        return layer

    first, *others = for_thread_counts(made)
    assert all(np.array_equal(first, other) for other in others)
