import math

import numpy as np
import pytest
from skimage.metrics import structural_similarity

from spreadlets import metrics
from spreadlets.errors import InvalidFrameError
from spreadlets.scene.display import display_encode

OPTIONS = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False, "data_range": 1}


@pytest.fixture
def pair():
    rng = np.random.default_rng(3)
    reference = rng.gamma(1.0, 0.4, (24, 30, 3)).astype(np.float32)
    return reference + rng.normal(0, 0.05, reference.shape).astype(np.float32), reference


def disc(radius, size):
    y, x = np.mgrid[:size, :size] - size // 2
    return (x**2 + y**2 <= radius**2).astype(float)


def test_display_encoding_has_the_published_values():
    linear = np.array([-1, 0, 0.0031308, 0.214041, 1, 7])
    np.testing.assert_allclose(display_encode(linear), [0, 0, 0.04045, 0.5, 1, 1], atol=1e-5)
    assert display_encode(linear.astype(np.float32)).dtype == np.float32


def test_ssim_is_that_of_scikit_image_and_psnr_as_it_is_defined(pair):
    encoded = [display_encode(image) for image in pair]
    assert metrics.ssim(*pair) == pytest.approx(structural_similarity(*encoded, channel_axis=2, **OPTIONS), abs=1e-6)
    assert metrics.psnr(*pair) == pytest.approx(-10 * np.log10(np.mean((encoded[0] - encoded[1]) ** 2)), rel=1e-6)


def test_linear_errors_of_constant_images():
    image, reference = np.full((12, 12, 3), 0.7), np.full((12, 12, 3), 0.5)
    assert metrics.mae(image, reference) == pytest.approx(0.2)
    assert metrics.relmse(image, reference) == pytest.approx(0.04 / 0.26)


def test_flip_grows_with_the_error_and_takes_the_reference_second(pair):
    from flip_evaluator import evaluate

    image, reference = pair
    encoded = [display_encode(array) for array in (reference, image)]
    assert metrics.flip(image, reference) == pytest.approx(evaluate(*encoded, "LDR", applyMagma=False)[1])
    assert 0 < metrics.flip(image, reference) < metrics.flip(reference[::-1], reference)


def test_equal_images(pair):
    assert metrics.compare(pair[1], pair[1]) == {"ssim": 1, "psnr": math.inf, "flip": 0, "relmse": 0, "mae": 0}


def test_compare_holds_every_metric_and_ignores_alpha(pair):
    image, reference = pair
    alpha = np.random.default_rng(0).random((24, 30, 1))
    result = metrics.compare(np.concatenate([image, alpha], axis=2), reference)
    assert result == {name: getattr(metrics, name)(image, reference) for name in result}
    assert list(result) == ["ssim", "psnr", "flip", "relmse", "mae"]
    assert all(type(value) is float for value in result.values())


@pytest.mark.parametrize("metric", ["ssim", "psnr", "flip", "relmse", "mae", "compare"])
def test_unusable_images_are_refused(pair, metric):
    measure = getattr(metrics, metric)
    image, reference = pair
    with pytest.raises(InvalidFrameError, match=r"image is 20 x 30 px, but reference is 24 x 30 px"):
        measure(image[:20], reference)
    with pytest.raises(InvalidFrameError, match=r"reference has shape \(24, 30\)"):
        measure(image, reference[..., 0])
    image[3, 4] = np.nan
    with pytest.raises(InvalidFrameError, match=r"image is not finite at 1 of 720 pixels, first at \(row 3, col 4\)"):
        measure(image, reference)


def test_ssim_refuses_images_smaller_than_its_window():
    with pytest.raises(InvalidFrameError, match="10 x 30 px; SSIM needs 11 px"):
        metrics.ssim(np.ones((10, 30, 3)), np.ones((10, 30, 3)))


def test_psf_similarity_equals_a_direct_call_over_the_grown_box():
    psf, size = disc(20, 101) * 0.01, 101
    reconstruction = psf + np.random.default_rng(0).normal(0, 5e-4, psf.shape)
    # The disc spans 41 px, a quarter of which is 11 px after rounding up.
    box = slice(size // 2 - 20 - 11, size // 2 + 20 + 11 + 1)
    expected = structural_similarity(psf[box, box] / 0.01, reconstruction[box, box] / 0.01, **OPTIONS)
    assert metrics.psf_similarity(psf, reconstruction) == pytest.approx(expected, abs=1e-9)


def test_psf_box_grows_by_at_least_eight_pixels_and_is_padded_with_zeros():
    psf = disc(3, 101)
    inside, outside = psf.copy(), psf.copy()
    inside[50, 50 + 3 + 8] = outside[50, 50 + 3 + 9] = 1
    assert metrics.psf_similarity(psf, outside) == pytest.approx(1)
    assert metrics.psf_similarity(psf, inside) < 1
    tight = slice(50 - 3, 50 + 4)
    blurred = psf * 0.9
    assert metrics.psf_similarity(psf[tight, tight], blurred[tight, tight]) == pytest.approx(
        metrics.psf_similarity(psf, blurred)
    )


def test_psf_support_is_what_exceeds_a_ten_thousandth_of_the_peak():
    psf = disc(3, 101)
    psf[50, 80] = 0.9e-4
    far = psf.copy()
    far[50, 80] = 1
    assert metrics.psf_similarity(psf, far) == pytest.approx(1)
    psf[50, 80] = 1.1e-4
    assert metrics.psf_similarity(psf, far) < 0.99


def test_psf_channels_share_the_peak_and_are_averaged():
    psf = np.stack([disc(5, 41), 0.25 * disc(5, 41)], axis=2)
    reconstruction = psf + np.random.default_rng(0).normal(0, 0.1, psf.shape)
    grown = slice(20 - 5 - 8, 20 + 5 + 8 + 1)
    channels = [structural_similarity(psf[grown, grown, c], reconstruction[grown, grown, c], **OPTIONS) for c in (0, 1)]
    assert metrics.psf_similarity(psf, reconstruction) == pytest.approx(np.mean(channels))


def test_psf_l1_is_relative_to_the_energy():
    psf = disc(5, 41) * 3
    assert metrics.psf_l1(psf, psf) == 0
    assert metrics.psf_l1(psf, 0.9 * psf) == pytest.approx(0.1)


@pytest.mark.parametrize("metric", [metrics.psf_similarity, metrics.psf_l1])
def test_unusable_psfs_are_refused(metric):
    psf = disc(5, 41)
    with pytest.raises(InvalidFrameError, match=r"\(41, 41\) and reconstruction \(40, 41\)"):
        metric(psf, psf[1:])
    with pytest.raises(InvalidFrameError, match="psf .* must be > 0"):
        metric(0 * psf, psf)
    with pytest.raises(InvalidFrameError, match="reconstruction has values that are not finite"):
        metric(psf, np.full_like(psf, np.nan))


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_pictures_of_integers_are_compared_as_what_they_show(pair, kind):
    codes = [np.rint(display_encode(each) * np.iinfo(kind).max).astype(kind) for each in pair]
    shown, expected = metrics.compare(*codes), metrics.compare(*(np.clip(each, 0, 1) for each in pair))
    assert shown["psnr"] == pytest.approx(expected["psnr"], abs=0.05)
    assert shown["mae"] == pytest.approx(expected["mae"], rel=0.02)


def test_a_picture_of_integers_has_three_channels(pair):
    with pytest.raises(InvalidFrameError, match=r"image has shape \(24, 30, 4\); a picture of uint8 must be"):
        metrics.mae(np.zeros((24, 30, 4), np.uint8), pair[1])


def test_what_is_no_image_is_refused_as_such_also_as_a_picture():
    codes = np.zeros((24, 30, 3), np.uint8)
    hidden, ragged = np.ma.masked_array(codes, codes == 0), [[1], [1, 2]]
    for image, said in (
        (hidden, "image is masked in places"),
        (ragged, "image is not an array"),
        (codes[..., 0], "shape"),
    ):
        with pytest.raises(InvalidFrameError, match=said):
            metrics.mae(image, codes)
