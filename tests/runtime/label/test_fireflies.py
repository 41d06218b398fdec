import numpy as np
import pytest

from spreadlets import SampleBuffer, reconstruct, synthesize
from spreadlets.errors import InvalidParameterError
from spreadlets.runtime.label.fireflies import clamp_fireflies
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.frame import Frame


def clamped_naively(samples, factor):
    """Dim each sample by a search of all others."""
    height, width = samples[0][0].shape[:2]
    places, levels = [], []
    for radiance, shift in samples:
        rows, cols = np.indices((height, width)).astype(np.float64)
        if shift is not None:
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
        shift = rng.uniform(-4, 4, (9, 11, 2)).astype(np.float32) if moved else None
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
    (found,), count = clamp_fireflies([(radiance, None)], 2.0)
    kept[14, 14, :3] = 0.2
    assert count == 1
    np.testing.assert_allclose(found, kept, rtol=1e-6)
    assert radiance[14, 14, 0] == 500.0


def test_black_samples_stay_black():
    (found,), count = clamp_fireflies([(np.zeros((4, 4, 4), np.float32), None)], 2.0)
    assert count == 0 and not found.any()


def buffer_with(firefly):
    rng = np.random.default_rng(3)
    shape = (24, 30, 2)
    radiance = np.full((*shape, 3), 0.5)
    radiance[12, 15, 0] += firefly
    lens = rng.uniform(-0.7, 0.7, (*shape, 2))
    return SampleBuffer(radiance, np.full(shape, 3.0), np.zeros((*shape, 2)), lens, np.zeros(shape))


CAMERA = ThinLens(focal_length_mm=50, sensor_width_mm=36, f_number=0.08, focus_distance_m=2.0)


@pytest.mark.parametrize(
    "options, largest", [({}, 1.0), ({"firefly_clamp": 2.0}, 0.03), ({"firefly_clamp": np.inf}, 1e9)]
)
def test_a_firefly_paints_no_bokeh_in_a_reconstruction(small_combined, options, largest):
    plain = reconstruct(buffer_with(0.0), CAMERA, small_combined, **options)
    image, report = reconstruct(buffer_with(1e4), CAMERA, small_combined, report=True, **options)
    change = np.abs(image - plain).max()
    assert change < largest and report["plan"]["pixels_clamped"] == (not np.isinf(options.get("firefly_clamp", 1.0)))
    if np.isinf(options.get("firefly_clamp", 1.0)):
        assert change > 50


def test_synthesis_clamps_only_if_asked(small_combined):
    radiance = np.full((24, 30, 3), 0.5)
    radiance[12, 15] = 1e4
    frame = Frame(radiance, np.full((24, 30), 3.0))
    kept, report = synthesize(frame, CAMERA, small_combined, report=True)
    clamped, figures = synthesize(frame, CAMERA, small_combined, firefly_clamp=2.0, report=True)
    assert kept.max() > 20 and clamped[..., :3].max() < 0.6
    assert report["plan"]["pixels_clamped"] == 0 and figures["plan"]["pixels_clamped"] == 1


@pytest.mark.parametrize("factor", [0.5, -1.0, np.nan])
def test_an_impossible_clamp_is_refused(small_combined, factor):
    with pytest.raises(InvalidParameterError, match="firefly_clamp is .*1 and more"):
        reconstruct(buffer_with(0.0), CAMERA, small_combined, firefly_clamp=factor)
