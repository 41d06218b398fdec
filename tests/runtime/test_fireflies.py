import numpy as np
import pytest

from runtime.fireflies import NO_SHIFT, clamp_fireflies


def clamped_naively(samples, factor):
    """Dim each sample by a search of all others."""
    height, width = samples[0][0].shape[:2]
    places, levels = [], []
    for radiance, shift in samples:
        rows, cols = np.indices((height, width)).astype(np.float64)
        if shift is not NO_SHIFT:
            rows, cols = rows + shift[..., 1], cols + shift[..., 0]
        rows, cols = np.clip(rows, 0, height - 1), np.clip(cols, 0, width - 1)
        places.append(np.stack([np.floor(rows + 0.5), np.floor(cols + 0.5)], axis=-1).reshape(-1, 2))
        levels.append(radiance[..., :3].mean(axis=2).ravel())
    place, level = np.concatenate(places), np.concatenate(levels)
    floor = np.median(level[level > 0])
    limit = np.empty(len(level))
    for k in range(len(level)):
        near = np.abs(place - place[k]).max(axis=1) <= 1
        near[k] = False
        limit[k] = factor * max(level[near].max(initial=0.0), floor)
    scale = np.minimum(1.0, limit / np.maximum(level, 1e-30)).reshape(len(samples), height, width)
    return [np.dstack([c[..., :3] * s[..., None], c[..., 3]]) for (c, _), s in zip(samples, scale, strict=True)]


@pytest.mark.interpreted
@pytest.mark.parametrize("moved", [False, True])
def test_samples_are_dimmed_as_by_a_search_of_all_others(moved):
    rng = np.random.default_rng(5)
    samples = []
    for _ in range(3):
        radiance = np.exp(2.0 * rng.normal(size=(9, 11, 4))).astype(np.float32)
        radiance[..., 3] = 1.0
        shift = rng.uniform(-4, 4, (9, 11, 2)).astype(np.float32) if moved else NO_SHIFT
        samples.append((radiance, shift))
    found, count = clamp_fireflies(samples, 1.5)
    expected = clamped_naively(samples, 1.5)
    assert count == sum(
        (np.abs(a - c) > 1e-5 * c).any(axis=2).sum() for a, (c, _) in zip(expected, samples, strict=True)
    )
    assert count >= 5
    np.testing.assert_allclose(found, expected, rtol=1e-5)


def test_a_highlight_that_many_samples_met_stays():
    radiance = np.full((20, 20, 4), 0.1, np.float32)
    radiance[4:8, 4:8, :3] = 500.0
    radiance[14, 14, :3] = 500.0
    kept = radiance.copy()
    (found,), count = clamp_fireflies([(radiance, NO_SHIFT)], 2.0)
    kept[14, 14, :3] = 0.2
    assert count == 1
    np.testing.assert_allclose(found, kept, rtol=1e-6)
    assert radiance[14, 14, 0] == 500.0


def test_black_samples_stay_black():
    (found,), count = clamp_fireflies([(np.zeros((4, 4, 4), np.float32), NO_SHIFT)], 2.0)
    assert count == 0 and not found.any()
