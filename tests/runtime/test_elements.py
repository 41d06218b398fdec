"""Elements that samples meet before nothing: they keep their size, and let through what they do."""

from dataclasses import replace

import numpy as np
import pytest

import spreadlets as sp

SIZE, FOCUS = 96, 4.0
CAMERA = sp.ThinLens(
    focal_length_mm=50.0, sensor_width_mm=36.0, f_number=0.05, focus_distance_m=FOCUS, shutter=(-0.25, 0.25)
)


@pytest.fixture(scope="module")
def combined():
    with sp.open_database("combined") as database:
        yield database


def disc(radius, coc, motion, alpha, n_samples, seed):
    """Samples of a disc before nothing, taken through a lens while it moves."""
    rng = np.random.default_rng(seed)
    shape = SIZE, SIZE, n_samples
    offset, time = rng.uniform(-0.5, 0.5, (*shape, 2)), rng.uniform(-0.25, 0.25, shape)
    angle = rng.uniform(0.0, 2 * np.pi, shape)
    lens_uv = np.sqrt(rng.random(shape))[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    centre = np.indices((SIZE, SIZE))[::-1].transpose(1, 2, 0)[:, :, None] + 0.5 - SIZE / 2
    place = centre + offset - coc * lens_uv - np.array(motion) * time[..., None]
    met = np.hypot(place[..., 0], place[..., 1]) < radius
    depth = np.where(met, 1.0 / (1.0 / FOCUS - coc / CAMERA.coc_scale(SIZE)), np.inf)
    colour = np.where(met[..., None], alpha * np.array([0.5, 0.4, 0.3, 1.0]), 0.0)
    return sp.SampleBuffer(colour, depth, np.where(met[..., None], motion, 0.0), lens_uv, time, offset)


def covers(combined, *given, n_samples):
    """Sums of alpha of images, of several buffers of the same, and of what was met; the largest alpha."""
    buffers = [disc(*given, n_samples, seed) for seed in range(8 // n_samples)]
    images = [sp.reconstruct(each, CAMERA, combined)[..., 3] for each in buffers]
    return np.sum(images), sum(each.radiance[..., 3].mean(axis=2).sum() for each in buffers), np.max(images)


@pytest.mark.parametrize("n_samples", [1, 4])
@pytest.mark.parametrize(("coc", "motion"), [(8.0, (0.0, 0.0)), (-5.0, (16.0, 6.0))])
def test_an_element_before_nothing_keeps_its_size(combined, coc, motion, n_samples):
    found, met, _ = covers(combined, 24.0, coc, motion, 1.0, n_samples=n_samples)
    assert found == pytest.approx(met, rel=0.006)


def test_an_element_keeps_its_size_where_the_shutter_opens_and_closes_at_once(combined):
    given = disc(24.0, 8.0, (0.0, 0.0), 1.0, 4, 0)
    given.time[:] = 0.0
    image = sp.reconstruct(given, replace(CAMERA, shutter=(0.0, 0.0)), combined)
    assert image[..., 3].sum() == pytest.approx(given.radiance[..., 3].mean(axis=2).sum(), rel=0.006)


@pytest.mark.parametrize("n_samples", [1, 4])
def test_an_element_that_can_be_seen_through_keeps_its_alpha(combined, n_samples):
    found, met, most = covers(combined, 24.0, 8.0, (0.0, 0.0), 0.5, n_samples=n_samples)
    assert found == pytest.approx(met, rel=0.006) and most == pytest.approx(0.5, abs=0.02)
