"""A reference of two noisy halves: nearer to the truth than their mean, and honest about what denoising did."""

import sys
from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "scenes"))
from references import MOST_LEFT, reference  # noqa: E402  (scripts, no package)


def smoothed(image):
    return ndimage.gaussian_filter(image, (1.5, 1.5, 0))


@pytest.fixture
def truth():
    """A smooth picture, which smoothing leaves as it is."""
    rows, cols = np.indices((64, 64)) / 64
    return np.stack([0.3 + 0.2 * np.sin(6 * rows), 0.4 + 0.2 * cols, 0.5 + 0.1 * rows * cols], axis=-1)


def halves(truth):
    rng = np.random.default_rng(3)
    return [truth * rng.gamma(25.0, 1 / 25.0, truth.shape) for _ in range(2)]


def test_what_is_left_of_the_error_is_found_without_the_truth(truth):
    first, second = halves(truth)
    image, figures = reference(first, second, smoothed)
    scale = 1 / (truth**2 + 0.01)
    left = np.mean((smoothed(first) - truth) ** 2 * scale) / np.mean((first - truth) ** 2 * scale)
    assert figures["error_left"] == pytest.approx(left, abs=0.02) and left < 0.1
    assert figures["denoised_halves_ssim"] > figures["halves_ssim"] + 0.2
    assert np.array_equal(image, smoothed(0.5 * (first + second)))


def test_a_denoiser_that_takes_away_what_is_there_is_not_used(truth):
    """Its halves agree all the better, the more it takes away."""
    stripes = truth + 0.2 * np.sin(2.5 * np.arange(64))[:, None]
    first, second = halves(stripes)
    image, figures = reference(first, second, smoothed)
    assert figures["denoised_halves_ssim"] > figures["halves_ssim"] + 0.1 and figures["error_left"] > MOST_LEFT
    assert np.array_equal(image, 0.5 * (first + second))


def test_a_denoiser_that_loses_light_is_not_used(truth):
    first, second = halves(truth)
    image, figures = reference(first, second, lambda image: 0.99 * smoothed(image))
    assert figures["error_left"] < MOST_LEFT and figures["light_kept"] == pytest.approx(0.99, abs=2e-3)
    assert np.array_equal(image, 0.5 * (first + second))


def test_without_noise_nothing_is_denoised(truth):
    image, figures = reference(truth, truth, smoothed)
    assert np.array_equal(image, truth) and figures["error_left"] == 1.0 and figures["halves_ssim"] == 1.0


def test_with_open_image_denoise_it_is_nearer_to_the_truth(truth):
    pytest.importorskip("pyoidn", reason="pyoidn is not installed")
    first, second = halves(truth)
    image, figures = reference(first, second)
    assert np.mean((image - truth) ** 2) < 0.3 * np.mean((0.5 * (first + second) - truth) ** 2)
    assert figures["error_left"] < MOST_LEFT
