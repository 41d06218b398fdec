import numpy as np
import pytest
from threads import for_thread_counts

import spreadlets as sp
from spreadlets.errors import InvalidParameterError
from spreadlets.runtime.finish.calibration import NOWHERE, calibrated, takes_whole_lens
from spreadlets.runtime.finish.edges import PlacedSamples
from spreadlets.runtime.finish.gains import BLOCK, SCALES, WIDEST, believed_gains
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


def placed(colours, place, coc=8.0):
    """Samples of one blur that are still."""
    shape = colours.shape[:2]
    still = np.zeros((*shape, 2), np.float32)
    return PlacedSamples(colours, place, np.full(shape, coc, np.float32), still, still)


def of_one_layer(image, samples, valid=None, coc=8.0):
    """Calibrate an image of a single layer."""
    valid = np.ones((*image.shape[:2], len(samples)), bool) if valid is None else valid
    places = [np.where(valid[:, :, k], np.float32(0.0), NOWHERE) for k in range(len(samples))]
    return calibrated([(0, image)], [placed(*each, coc) for each in zip(samples, places, strict=True)])


def test_a_smooth_bias_is_taken_out_and_a_right_image_stays():
    rng = np.random.default_rng(0)
    truth = texture(rng)
    x = np.linspace(-1, 1, SIZE)
    bias = np.float32(1.0 + 0.3 * np.outer(np.cos(2 * x), np.sin(2 * x)))[..., None]
    for start, least in ((bias, 4.0), (np.float32(1.0), None)):
        image = truth.copy()
        image[..., :3] *= start
        before = np.abs(image - truth)[..., :3].mean()
        image = of_one_layer(image, noisy(truth, rng, n=8))
        after = np.abs(image - truth)[..., :3].mean()
        assert after < before / least if least else after < 0.005
        assert (image[..., 3] == 1).all()


@pytest.mark.interpreted
def test_gains_are_those_of_least_squares_under_a_window_about_each_block():
    rng = np.random.default_rng(1)
    rows, cols = 64, 32
    product, square = rng.uniform(2.0, 2.4, (1, rows, cols)), rng.uniform(1.0, 1.4, (1, rows, cols))
    nothing = np.zeros_like(product)  # no noise: all of it is believed
    gain = believed_gains(np.stack([product, square, nothing, nothing, nothing]).astype(np.float32), [BLOCK])
    taps = np.array([1, 4, 6, 4, 1]) / 16
    for row, col in ((20, 16), (0, 3), (63, 31)):
        weight = np.zeros((rows, cols))
        for i in range(max(row - 2, 0), min(row + 3, rows)):
            for j in range(max(col - 2, 0), min(col + 3, cols)):
                weight[i, j] = taps[i - row + 2] * taps[j - col + 2]
        assert gain[0, row, col] == pytest.approx((weight * product[0]).sum() / (weight * square[0]).sum(), rel=1e-5)


def test_coarse_gains_are_those_of_sums_over_larger_blocks_interpolated():
    """A bias that rises evenly is met by windows of any size."""
    rows, cols = np.indices((64, 64)).astype(np.float32)
    bias = (1.0 + 0.004 * rows + 0.002 * cols)[None]
    nothing, one = np.zeros_like(bias), np.ones_like(bias)
    for scale in SCALES:
        gain = believed_gains(np.stack([bias, one, nothing, nothing, nothing]), [scale])
        inside = slice(3 * scale // BLOCK, -3 * scale // BLOCK or None)
        assert np.abs(gain - bias)[0, inside, inside].max() < 1e-4


def two_layers(rng, cover, n=4):
    """Samples, with their places, of a red layer that covers part of each pixel, and of a green one behind."""
    near = rng.random((n, SIZE, SIZE)) < cover
    colours = np.where(near[..., None], (1.0, 0.1, 0.1, 1.0), (0.1, 1.0, 0.1, 1.0)).astype(np.float32)
    places = np.where(near, np.float32(0.0), np.float32(1.0))
    return [placed(*each) for each in zip(colours, places, strict=True)]


def seen(cover, red=1.0):
    """What both layers add to an image."""
    near, far = np.empty((2, SIZE, SIZE, 4), np.float32)
    near[:] = cover[..., None] * np.array((1.0, 0.1, 0.1, 1.0))
    near[..., 0] *= red
    far[:] = (1 - cover)[..., None] * np.array((0.1, 1.0, 0.1, 1.0))
    return [(0, near), (1, far)]


def test_each_layer_is_brought_to_its_own_samples_whatever_hides_it():
    """Whether a sample meets the one or the other is noise, and says nothing of the colour of either."""
    rows = np.linspace(0, 6, SIZE)[:, None]
    cover, bias = np.full((SIZE, SIZE), 0.5), 1.0 + 0.2 * np.sin(4 * rows) * np.ones((1, SIZE))
    samples = two_layers(np.random.default_rng(0), cover)
    truth = sum(layer for _, layer in seen(cover))
    before = sum(layer for _, layer in seen(cover, bias))
    apart, together = calibrated(seen(cover, bias), samples), of_one_layer(before, [each.radiance for each in samples])
    left, of_whole, at_first = (np.abs(each - truth)[..., 0].mean() for each in (apart, together, before))
    assert left < 0.25 * at_first and left < 0.5 * of_whole


def test_how_much_is_seen_of_each_layer_is_brought_to_the_share_of_its_samples():
    right, wrong = np.full((SIZE, SIZE), 0.5), np.full((SIZE, SIZE), 0.35)
    image = calibrated(seen(wrong), two_layers(np.random.default_rng(1), right))
    truth = sum(layer for _, layer in seen(right))
    assert np.abs(image - truth)[..., :3].mean() < 0.02 and np.allclose(image[..., 3], 1.0, atol=1e-6)


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
        image = of_one_layer(image, samples)
        left[few] = np.abs(image - truth).mean() / before
    assert left[False] < 0.7 and left[True] < 1.0


def test_a_fine_bias_is_doubted_where_the_layer_is_far_out_of_focus():
    """By the ratio of the CoC radius to that up to which it is believed; coarser gains are not doubted."""
    rows, cols = np.indices((64, 64))
    fine = 1.0 + 0.2 * ((rows // 2 + cols // 2) % 2)
    nothing, one = np.zeros((1, 64, 64), np.float32), np.ones((1, 64, 64), np.float32)
    sums = np.stack([fine[None].astype(np.float32), one, nothing, nothing, nothing])
    for scale in (BLOCK, SCALES[0]):
        sharp = believed_gains(sums, [scale], np.full((64, 64), 0.5 * WIDEST, np.float32))
        wide = believed_gains(sums, [scale], np.full((64, 64), 4.0 * WIDEST, np.float32))
        assert np.allclose(sharp, believed_gains(sums, [scale]))
        assert np.allclose(wide - 1.0, (sharp - 1.0) / (4.0 if scale == BLOCK else 1.0), atol=1e-6)


def test_samples_are_told_to_be_out_of_focus_by_their_own_layer():
    """A fine bias is left more where the CoC is wide."""
    rng = np.random.default_rng(0)
    rows, cols = np.indices((SIZE, SIZE))
    truth, bias = texture(rng), np.float32(1.0 + 0.15 * np.sin(rows / 2.0) * np.sin(cols / 2.0))[..., None]
    samples, image = noisy(truth, rng, n=8, sigma=0.2), truth.copy()
    image[..., :3] *= bias
    near, far = (np.abs(of_one_layer(image, samples, coc=coc) - truth).mean() for coc in (8.0, 4 * WIDEST))
    assert near < 0.93 * far


def test_missing_samples_and_dark_images_count_for_nothing():
    rng = np.random.default_rng(2)
    truth = texture(rng)
    samples, valid = noisy(truth, rng), np.ones((SIZE, SIZE, 2), bool)
    valid[:, : SIZE // 2, 1] = False
    samples[1, :, : SIZE // 2] = 1e6
    assert np.abs(of_one_layer(truth, samples, valid) - truth).mean() < 0.01
    assert not of_one_layer(np.zeros_like(truth), samples, valid).any()


def test_a_small_image_is_left_as_it_is():
    image = np.full((7, 7, 4), 0.5, np.float32)
    assert (of_one_layer(image, np.ones((1, 7, 7, 4), np.float32)) == 0.5).all()


def test_the_image_is_the_same_for_any_number_of_threads():
    rng = np.random.default_rng(3)
    truth = texture(rng)
    samples = noisy(truth, rng)

    def made():
        return of_one_layer(truth * np.float32(0.8), samples)

    first, *others = for_thread_counts(made)
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


def test_samples_of_a_pinhole_come_through_the_centre_of_the_lens():
    rng = np.random.default_rng(4)
    assert takes_whole_lens(buffer(rng, lens=0.0), CAMERA, pinhole=True)
    assert not takes_whole_lens(buffer(rng), CAMERA, pinhole=True)
    assert not takes_whole_lens(buffer(rng, lens=0.0, time=0.0), CAMERA, pinhole=True)


@pytest.mark.parametrize(
    ("options", "changes", "left_out"),
    [
        ({}, {}, False),
        ({"calibrate": False}, {}, True),
        ({"defocus": False}, {}, True),
        ({"motion": False}, {}, True),
        ({}, {"lens": 0.0}, True),
        ({"defocus": False}, {"lens": 0.0}, False),
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
    assert np.abs(of_one_layer(image, [sample]) / image - 1)[disc].max() < 0.1
