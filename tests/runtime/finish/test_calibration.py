import numpy as np
import pytest
from threads import for_thread_counts

import spreadlets as sp
from spreadlets.errors import InvalidParameterError
from spreadlets.runtime.finish.calibration import BLOCK, calibrate, takes_whole_lens
from spreadlets.runtime.finish.calibration import _gain as gain_of
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.samples import SampleBuffer

SIZE = 96
CAMERA = ThinLens(50.0, 36.0, 0.5, 4.0, shutter=(-0.25, 0.25))


def noisy(truth, rng, n=2, sigma=0.5):
    """Samples (n, H, W, 4) of an image whose noise grows with its brightness."""
    factor = rng.gamma(1 / sigma**2, sigma**2, (n, *truth.shape[:2], 1))
    samples = np.repeat(truth[None], n, axis=0)
    samples[..., :3] *= factor
    return samples.astype(np.float32)


def texture(rng):
    image = np.ones((SIZE, SIZE, 4), np.float32)
    image[..., :3] = rng.uniform(0.2, 1.0, (SIZE, SIZE, 3))
    return image


def everything(n=2):
    return np.ones((SIZE, SIZE, n), bool)


def test_a_smooth_bias_is_taken_out_and_a_right_image_stays():
    rng = np.random.default_rng(0)
    truth = texture(rng)
    x = np.linspace(-1, 1, SIZE)
    bias = np.float32(1.0 + 0.3 * np.outer(np.cos(2 * x), np.sin(2 * x)))[..., None]
    for start, least in ((bias, 4.0), (np.float32(1.0), None)):
        image = truth.copy()
        image[..., :3] *= start
        before = np.abs(image - truth)[..., :3].mean()
        calibrate(image, list(noisy(truth, rng, n=8)), everything(8))
        after = np.abs(image - truth)[..., :3].mean()
        assert after < before / least if least else after < 0.005
        assert (image[..., 3] == 1).all()


@pytest.mark.interpreted
def test_gains_are_those_of_least_squares_under_a_gaussian_window():
    rng = np.random.default_rng(1)
    parts = rng.normal(0, 1, (12, 14, 3)) + 3  # far above their noise: all of it is believed
    squares = rng.uniform(5, 9, (12, 14, 3))
    nothing = np.zeros_like(parts)
    gain = gain_of(np.stack([parts, squares, nothing, nothing]), 2.0 * BLOCK, BLOCK)
    rows, cols = np.indices((12, 14))

    def reflected(size, at):  # where the window reaches beyond the border, the image is mirrored
        return np.where(at < 0, -1 - at, np.where(at >= size, 2 * size - 1 - at, at))

    for row, col in ((5, 6), (0, 3), (11, 13)):
        window = np.zeros((12, 14))
        for dr in range(-6, 7):
            for dc in range(-6, 7):
                at = int(reflected(12, np.array(row + dr))), int(reflected(14, np.array(col + dc)))
                window[at] += np.exp(-(dr * dr + dc * dc) / 8.0)
        expected = 1 + (window[..., None] * parts).sum((0, 1)) / (window[..., None] * squares).sum((0, 1))
        assert gain[row, col] == pytest.approx(expected, rel=1e-6)


def test_a_fine_bias_is_taken_out_where_many_samples_carry_the_noise_and_not_where_few_do():
    rows, cols = np.indices((SIZE, SIZE))
    bias = np.float32(1.0 + 0.15 * np.sin(rows / 4.0) * np.sin(cols / 4.0))[..., None]
    left = {}
    for few in (False, True):
        rng = np.random.default_rng(0)
        truth = texture(rng)
        samples = noisy(truth, rng, n=4, sigma=0.4)
        if few:  # as noisy, but by one sample in two hundred
            rare = rng.random(samples.shape[:3]) < 1 / 200
            samples[..., :3] = truth[..., :3] * (1.0 + (rare - 1 / 200) * 0.4 / np.sqrt(1 / 200))[..., None]
        image = truth.copy()
        image[..., :3] *= bias
        before = np.abs(image - truth).mean()
        calibrate(image, list(samples), everything(4))
        left[few] = np.abs(image - truth).mean() / before
    assert left[False] < 0.7 and left[True] < 1.0


def test_missing_samples_and_dark_images_count_for_nothing():
    rng = np.random.default_rng(2)
    truth = texture(rng)
    samples, valid = noisy(truth, rng), everything()
    valid[:, : SIZE // 2, 1] = False
    samples[1, :, : SIZE // 2] = 1e6
    image = truth.copy()
    calibrate(image, list(samples), valid)
    assert np.abs(image - truth).mean() < 0.01
    black = np.zeros_like(truth)
    calibrate(black, list(samples), valid)
    assert not black.any()


def test_a_small_image_is_left_as_it_is():
    image = np.full((7, 7, 4), 0.5, np.float32)
    calibrate(image, [np.ones((7, 7, 4), np.float32)], np.ones((7, 7, 1), bool))
    assert (image == 0.5).all()


def test_the_image_is_the_same_for_any_number_of_threads():
    rng = np.random.default_rng(3)
    truth = texture(rng)
    samples = list(noisy(truth, rng))

    def calibrated():
        image = truth * np.float32(0.8)
        calibrate(image, samples, everything())
        return image

    first, *others = for_thread_counts(calibrated)
    assert all(np.array_equal(first, other) for other in others)


def buffer(rng, *, lens=1.0, time=0.25, motion=4.0, shift=0.0):
    shape = SIZE, SIZE, 2
    radius, angle = np.sqrt(rng.random(shape)), rng.uniform(0, 2 * np.pi, shape)
    places = lens * np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)
    return SampleBuffer(
        rng.uniform(0.2, 1.0, (*shape, 3)),
        np.full(shape, 3.0),
        np.full((*shape, 2), motion),
        lens_uv=np.clip(places + shift, -1, 1),
        time=rng.uniform(-time, time, shape),
    )


@pytest.mark.parametrize(
    ("changes", "whole"),
    [
        ({}, True),
        ({"lens": 0.0}, False),
        ({"lens": 0.5}, False),
        ({"shift": 0.3}, False),
        ({"time": 0.0}, False),
        ({"time": 0.0, "motion": 0.0}, True),
    ],
)
def test_samples_must_be_spread_over_lens_and_shutter(changes, whole):
    assert takes_whole_lens(buffer(np.random.default_rng(4), **changes), CAMERA) == whole


@pytest.mark.parametrize(
    ("options", "changes", "left_out"),
    [
        ({}, {}, False),
        ({"calibrate": False}, {}, True),
        ({"defocus": False}, {}, True),
        ({"motion": False}, {}, True),
        ({}, {"lens": 0.0}, True),
    ],
)
def test_the_report_says_where_it_is_left_out(small_combined, options, changes, left_out):
    samples = buffer(np.random.default_rng(5), **changes)
    _, report = sp.reconstruct(samples, CAMERA, small_combined, report=True, **options)
    assert ("calibration" in report["plan"]["left_out"]) == left_out


def test_it_is_no_option_of_other_methods():
    with pytest.raises(InvalidParameterError, match="calibrate is no option of method 'mean'"):
        sp.reconstruct(buffer(np.random.default_rng(6)), CAMERA, method="mean", calibrate=False)


@pytest.mark.parametrize("seed", range(6))
def test_light_that_few_samples_carry_is_not_taken_for_a_bias(seed):
    """Under the bokeh of a small lamp one sample in five hundred meets it; the image is right."""
    rng = np.random.default_rng(seed)
    rows, cols = np.indices((SIZE, SIZE))
    image = np.full((SIZE, SIZE, 4), 0.3, np.float32)
    disc = (rows - 48) ** 2 + (cols - 44) ** 2 < 25**2
    image[disc, :3] = 4.0
    image[..., 3] = 1.0
    sample = np.full((SIZE, SIZE, 4), 0.3, np.float32)
    sample[disc & (rng.random((SIZE, SIZE)) < (4.0 - 0.3) / 2000.0), :3] = 2000.0
    calibrated = image.copy()
    calibrate(calibrated, [sample], everything(1))
    assert np.abs(calibrated / image - 1)[disc].max() < 0.1
