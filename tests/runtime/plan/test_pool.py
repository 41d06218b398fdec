import numpy as np
import pytest
from threads import for_thread_counts

from spreadlets.arrays import NOTHING
from spreadlets.runtime.label.moving import curved_places
from spreadlets.runtime.label.trail import Trail
from spreadlets.runtime.plan import pool as pooling
from spreadlets.runtime.plan.pool import place_pixels, pool
from spreadlets.scene.shutter import shutter_shares

H, W, N_VARIANTS, N_LAYERS = 6, 9, 3, 2
REACHES = np.array([0, 3, 7])
WIDE = np.array([False, False, True])


def make_samples(rng, *, border, spread=5.0):
    radiance = rng.random((H, W, 4)).astype(np.float32)
    weight = rng.random((H, W)).astype(np.float32)
    label = rng.integers(-1, N_VARIANTS * N_LAYERS, (H, W)).astype(np.int32)
    shift = rng.normal(0, spread, (H, W, 2)).astype(np.float32)
    radiance[0, 3] = 0.0  # nothing to draw
    limit = np.full((1, 1), 0.6, np.float32) if border else NOTHING
    return radiance, weight, label, shift, limit


def naive(samples):
    """Sum the bilinear parts of every splat that reaches the frame, of pixels within and far beyond it."""
    total = {}
    for radiance, weight, label, shift, limit in samples:
        far = 40 if len(limit) else 0
        for down in range(-far, H + far):
            for right in range(-far, W + far):
                row, col = min(max(down, 0), H - 1), min(max(right, 0), W - 1)
                if label[row, col] < 0:
                    continue
                colour = radiance[row, col].copy()
                if down != row or right != col:
                    colour[:3] *= min(1.0, limit[0, 0] / max(colour[:3].max(), 1e-9))
                variant = label[row, col] % N_VARIANTS
                place = shift[row, col, ::-1].astype(np.float64)
                place = np.rint(place) if WIDE[variant] else np.rint(place * 16) / 16
                first = np.floor(place).astype(int)
                for dy, dx in np.ndindex(2, 2):
                    share = np.prod(1 - np.abs(place - first - (dy, dx)))
                    y, x = down + first[0] + dy, right + first[1] + dx
                    far_y, far_x = max(-y, y - H + 1), max(-x, x - W + 1)
                    if share > 0 and max(far_y, far_x) <= REACHES[variant] and colour.any():
                        key = int(label[row, col]), y, x
                        total[key] = total.get(key, 0) + share * weight[row, col] * colour.astype(np.float64)
    return total


def pooled(samples):
    placed = [place_pixels(*each[:4], None, WIDE, each[4]) for each in samples]
    return list(pool(placed, (H, W), REACHES, N_LAYERS))


def as_dict(splats):
    found = {}
    for each in splats:
        index = np.arange(each.label.shape[1])
        places = each.shift[0] + np.stack([0 * index, index], axis=1)
        for label, place, radiance in zip(each.label[0], places, each.radiance[0], strict=True):
            key = int(label), *place.tolist()
            found[key] = found.get(key, 0) + radiance.astype(np.float64)
    return found


@pytest.mark.parametrize("border", [False, True])
@pytest.mark.parametrize("n", [pytest.param(1, marks=pytest.mark.interpreted), 3])
def test_splats_are_those_of_every_sample(border, n):
    rng = np.random.default_rng(n)
    samples = [make_samples(rng, border=border) for _ in range(n)]
    splats, expected = pooled(samples), naive(samples)
    assert len(splats) == 1 and splats[0].label.size == len(expected)
    found = as_dict(splats)
    assert found.keys() == expected.keys()
    assert all(found[key] == pytest.approx(expected[key], rel=1e-5, abs=1e-7) for key in found)


def test_what_is_moved_farther_than_any_frame_is_drawn_from_the_border_alone():
    radiance, weight, label, _, limit = make_samples(np.random.default_rng(0), border=True)
    label[:], limit[:] = 0, np.inf
    shift = np.full((H, W, 2), 1e12, np.float32)  # to the right and down: what is seen repeats the first pixel
    splats = pooled([(radiance, weight, label, shift, limit)])
    found, far = as_dict(splats), REACHES[0]
    assert found.keys() == {(0, y, x) for y in range(-far, H + far) for x in range(-far, W + far)}
    assert all(value == pytest.approx(radiance[0, 0] * weight[0, 0], rel=1e-6) for value in found.values())


def test_each_place_and_label_comes_once_by_rows_then_labels_then_columns():
    rng = np.random.default_rng(4)
    splat = pooled([make_samples(rng, border=True, spread=1.0) for _ in range(4)])[0]
    index = np.arange(splat.label.shape[1])
    keys = np.stack([splat.shift[0, :, 0], splat.label[0], splat.shift[0, :, 1] + index], axis=1)
    assert (np.unique(keys, axis=0) == keys).all()


def test_many_samples_are_pooled_in_several_batches_of_the_same_sum(monkeypatch):
    rng = np.random.default_rng(5)
    samples = [make_samples(rng, border=True) for _ in range(5)]
    whole = as_dict(pooled(samples))
    monkeypatch.setattr(pooling, "MOST_SPLATS", 700)
    parts = pooled(samples)
    assert 1 < len(parts) <= 5
    found = as_dict(parts)
    assert found.keys() == whole.keys()
    assert all(found[key] == pytest.approx(whole[key], rel=1e-5) for key in found)


@pytest.mark.interpreted
def test_room_for_sums_grows_as_it_is_needed(monkeypatch):
    rng = np.random.default_rng(10)
    samples = [make_samples(rng, border=False) for _ in range(2)]
    whole = pooled(samples)[0]
    monkeypatch.setattr(pooling, "LEAST_SUMS", 1)
    grown = pooled(samples)[0]
    assert all(np.array_equal(a, b) for a, b in zip(whole[1:4], grown[1:4], strict=True))


def test_sums_are_the_same_for_any_number_of_threads():
    rng = np.random.default_rng(6)
    samples = [make_samples(rng, border=True) for _ in range(3)]
    first, *others = for_thread_counts(lambda: pooled(samples)[0][1:4])
    assert all(np.array_equal(a, b) for other in others for a, b in zip(first, other, strict=True))


def test_nothing_to_draw_gives_nothing():
    radiance, weight, label, shift, limit = make_samples(np.random.default_rng(7), border=True)
    assert pooled([(radiance, weight, np.full_like(label, -1), shift, limit)]) == []
    assert pooled([(np.zeros_like(radiance), weight, label, shift, NOTHING)]) == []
    assert pooled([]) == []


def test_no_weights_are_weights_of_one():
    radiance, weight, label, shift, limit = make_samples(np.random.default_rng(8), border=True)
    plain = pooled([(radiance, np.ones_like(weight), label, shift, limit)])[0]
    assert np.array_equal(
        pooled([(radiance, np.zeros((0, 0), np.float32), label, shift, limit)])[0].radiance, plain.radiance
    )


@pytest.mark.parametrize("border", [False, True])
def test_a_list_of_pixels_is_drawn_as_the_frame_s_pixels_are(border):
    """In whatever order, and whatever shape the list has."""
    rng = np.random.default_rng(9)
    radiance, weight, label, shift, limit = make_samples(rng, border=border)
    order = rng.permutation(H * W)
    at = np.stack(np.divmod(order, W), axis=-1).astype(np.int32).reshape(2, -1, 2)
    radiance, weight, label, shift = (
        each.reshape(H * W, *each.shape[2:])[order].reshape(2, -1, *each.shape[2:])
        for each in (radiance, weight, label, shift)
    )
    listed = place_pixels(radiance, weight, label, shift, at, WIDE, limit)
    found = as_dict(pool([listed], (H, W), REACHES, N_LAYERS))
    wanted = naive([make_samples(np.random.default_rng(9), border=border)])
    assert found.keys() == wanted.keys()
    for key, colour in wanted.items():
        np.testing.assert_allclose(found[key], colour, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("border", [pytest.param(False, marks=pytest.mark.interpreted), True])
def test_a_pixel_with_several_places_is_drawn_as_so_many_pixels(border, monkeypatch):
    """On straight ways, on arcs and on parabolas; also where there is no more room after some of a pixel's places."""
    monkeypatch.setattr(pooling, "LEAST_SUMS", 1)
    rng = np.random.default_rng(11)
    radiance, weight, label, shift, limit = make_samples(rng, border=border, spread=1.0)
    n_places = rng.integers(1, 6, (H, W)).astype(np.int32)
    before = rng.normal(0, 4, (H, W, 2)).astype(np.float32)
    after = (before @ np.array([[0.8, 0.4], [-0.4, 0.8]])).astype(np.float32)
    after[:2], after[2:4] = before[:2], -before[2:4]
    trail = Trail.of(n_places, (before, after), (-0.25, 0.5), (0.0, 1.0))
    placed = [place_pixels(radiance, weight, label, shift, None, WIDE, limit, trail)]
    found = as_dict(pool(placed, (H, W), REACHES, N_LAYERS))
    samples = []
    for n in range(1, 6):
        for k, share in enumerate(shutter_shares((0.0, 1.0), n)):
            time = np.full((H, W), -0.25 + 0.75 * (k + 0.5) / n, np.float32)
            own = np.where(n_places == n, label, -1).astype(np.int32)
            places = shift + curved_places(before, after, time)
            samples.append((radiance, (weight * share).astype(np.float32), own, places, limit))
    expected = naive(samples)
    assert found.keys() == expected.keys()
    assert all(found[key] == pytest.approx(expected[key], rel=1e-4, abs=1e-6) for key in found)
