"""LRDM: the set-up against brute force, screen filters and kernels against naive twins, images of known scenes."""

import json

import numpy as np
import pytest
from click.testing import CliRunner
from naive.lrdm import gaussian_image, reprojected_sums, set_up
from scipy.ndimage import map_coordinates
from threads import for_thread_counts

from spreadlets.api import reconstruct
from spreadlets.cli.main import cli
from spreadlets.errors import InvalidParameterError
from spreadlets.metrics import psnr
from spreadlets.runtime.sheared import _gauss_kernels as gauss
from spreadlets.runtime.sheared import _lrdm_kernels as kernels
from spreadlets.runtime.sheared.lrdm import Lrdm, LrdmFilter, PracticalLrdm, morton_order, spread_of
from spreadlets.runtime.sheared.samples import Samples
from spreadlets.runtime.sheared.tune import trial_samples, tune
from spreadlets.runtime.sheared.work import FILE_VARIABLE, WorkSizes
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.samples import SampleBuffer

CAMERA = ThinLens(focal_length_mm=50.0, sensor_width_mm=36.0, f_number=2.0, focus_distance_m=4.0, shutter=(-0.25, 0.25))
LENS, TIME = 0.25, 0.5**2 / 12
"""Variances of the unit disc along an axis, and of that shutter."""
SPREAD = np.array([LENS, TIME, 1.0, 0.25])
S_PIX = 0.5
METHODS = ("lrdm", "lrdm-sheared", "lrdm-ewa")


@pytest.fixture
def rng():
    return np.random.default_rng(5)


def on_disc(rng, shape):
    radius, angle = np.sqrt(rng.random(shape)), 2 * np.pi * rng.random(shape)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)


def moments_of(coc, motion):
    x, y = motion.T
    rows = [np.ones_like(coc), coc, coc**2, x, y, x**2, x * y, y**2]
    return np.sum(rows, axis=1).astype(np.float64)


def made_filter(coc, motion, largest=np.inf, moving=True):
    filters = np.zeros(kernels.N_FILTER)
    kernels.set_up(moments_of(coc, motion), SPREAD, S_PIX**2, largest**2, moving, filters)
    return filters


def covariance_of(filters):
    sxx, sxy, syy = filters[kernels.SXX : kernels.SYY + 1]
    return np.array([[sxx, sxy], [sxy, syy]])


def scene(rng, height=64, width=96, n_samples=4, *, moving=True, behind=9.0):
    """A striped floor behind a moving, out-of-focus card; and the image that lens and shutter make of it."""
    shape = height, width, n_samples
    lens, offset = on_disc(rng, shape), rng.random((*shape, 2)) - 0.5
    time = rng.uniform(-0.25, 0.25, shape)
    y = np.arange(height)[:, None, None] + offset[..., 1]
    x = np.arange(width)[None, :, None] + offset[..., 0]
    speed = np.array([24.0, 10.0]) if moving else np.zeros(2)
    at_x, at_y = x + 6 * lens[..., 0] - speed[0] * time, y + 6 * lens[..., 1] - speed[1] * time
    card = (np.abs(at_x - width / 2) < width / 5) & (np.abs(at_y - height / 2) < height / 5)
    floor = 0.5 + 0.4 * np.cos((x - behind * lens[..., 0]) / 8)
    colour = np.where(card[..., None], [0.9, 0.4, 0.1], floor[..., None] * [0.3, 0.5, 1.0])
    coc = np.where(card, -6.0, behind)
    motion = np.where(card[..., None], speed, 0.0)
    return SampleBuffer(colour, np.full(shape, 4.0), motion, lens, time, offset, coc_radius=coc)


# Set-up


@pytest.mark.parametrize(("c", "v"), [(3.0, (0.0, 0.0)), (-7.0, (20.0, -8.0)), (0.0, (0.0, 30.0))])
def test_a_narrow_partition_is_reprojected_along_its_slopes_and_blurred_as_lens_and_shutter_do(c, v):
    filters = made_filter(np.full(50, c), np.tile(v, (50, 1)))
    np.testing.assert_allclose(filters[:3], [c, *v], atol=1e-6)
    assert filters[kernels.LENS_RATE] == filters[kernels.TIME_RATE] == 0
    expected = (S_PIX**2 + c**2 * LENS) * np.eye(2) + TIME * np.outer(v, v)
    np.testing.assert_allclose(covariance_of(filters), expected, rtol=1e-6)


def test_near_focus_the_window_is_that_of_slr_eq_29():
    half_range = 0.8
    coc = np.linspace(-half_range, half_range, 2001)
    filters = made_filter(coc, np.zeros((2001, 2)))
    sigma_squared = (2 * S_PIX / (2 * half_range)) ** 2
    assert 0.5 / filters[kernels.LENS_RATE] == pytest.approx(sigma_squared + LENS, rel=2e-3)


@pytest.mark.parametrize("widths", [(0.5, 1.0), (3.0, 15.0), (12.0, 40.0)])
def test_the_set_up_agrees_with_its_equations_in_matrices(rng, widths):
    coc, motion = (
        6 + widths[0] * rng.normal(size=400),
        [18.0, -7.0]
        + widths[1]
        * rng.normal(size=(400, 2))
        @ [
            [1, 0.4],
            [0, 0.3],
        ],
    )
    eta, b, (k_u, k_t), covariance = set_up(coc, motion, LENS, TIME, S_PIX)
    filters = made_filter(coc, motion)
    np.testing.assert_allclose(filters[:3], [eta, *b], rtol=1e-6)
    # Rates that hardly change a weight are left out, which the covariance takes into account.
    for column, k, variance in ((kernels.LENS_RATE, k_u, LENS), (kernels.TIME_RATE, k_t, TIME)):
        rate = 0.5 / (k + variance)
        assert filters[column] == pytest.approx(rate if rate * variance > kernels.LEAST_RATE else 0.0, rel=1e-6)
    if filters[kernels.LENS_RATE] and filters[kernels.TIME_RATE]:
        np.testing.assert_allclose(covariance_of(filters), covariance, rtol=1e-4)


@pytest.mark.parametrize("largest", [np.inf, 3.0])
@pytest.mark.parametrize("widths", [(0.0, 0.0), (2.0, 0.0), (0.0, 25.0), (5.0, 60.0)])
def test_by_brute_force_samples_and_filter_together_spread_as_lens_and_shutter_do(rng, widths, largest):
    n = 400_000
    coc = 6 + widths[0] * rng.uniform(-1, 1, n)
    motion = np.array([14.0, 6.0]) + widths[1] * rng.uniform(-1, 1, (n, 2)) * [1.0, 0.3]
    lens, time = on_disc(rng, n), rng.uniform(-0.25, 0.25, n)
    filters = made_filter(coc, motion, largest)
    eta, b = filters[kernels.ETA], filters[kernels.BX : kernels.BY + 1]
    landing = (coc - eta)[:, None] * lens + (motion - b) * time[:, None]
    rates = filters[kernels.LENS_RATE], filters[kernels.TIME_RATE]
    weight = np.exp(-rates[0] * (lens**2).sum(axis=1) - rates[1] * time**2)
    found = (landing * weight[:, None]).T @ landing / weight.sum() + covariance_of(filters)
    true = coc[:, None] * lens + motion * time[:, None]
    np.testing.assert_allclose(found, true.T @ true / n + S_PIX**2 * np.eye(2), atol=0.01 * np.trace(found))
    assert np.linalg.eigvalsh(covariance_of(filters)).max() <= largest**2 * (1 + 1e-9)


@pytest.mark.parametrize(
    ("c_range", "v_range"), [((5.0, 5.0), (0.0, 0.0)), ((4.0, 6.0), (20.0, 24.0)), ((-4, 6), (-30, 30))]
)
def test_in_flatland_the_filtered_samples_are_the_image_of_the_surfaces(rng, c_range, v_range):
    """Surfaces of cosine texture, one screen axis: what the filter makes of all samples, against the integral."""
    n = 400_000
    coc, speed = rng.uniform(*c_range, n), rng.uniform(*v_range, n)
    lens, time = on_disc(rng, n)[:, 0], rng.uniform(-0.25, 0.25, n)
    filters = made_filter(coc, np.stack([speed, np.zeros(n)], axis=1))
    landing = (coc - filters[kernels.ETA]) * lens + (speed - filters[kernels.BX]) * time
    # The disc's other axis is integrated: its weight depends on u alone through the rest of the disc.
    weight = np.exp(-filters[kernels.LENS_RATE] * lens**2 - filters[kernels.TIME_RATE] * time**2)
    spread = np.sqrt(np.mean((coc * lens + speed * time) ** 2) + S_PIX**2)
    for frequency in np.array([0.3, 0.6, 0.9]) / spread:
        texture = np.exp(1j * frequency * landing)
        found = (weight * texture).sum() / weight.sum() * np.exp(-0.5 * frequency**2 * filters[kernels.SXX])
        true = np.exp(1j * frequency * (coc * lens + speed * time)).mean() * np.exp(-0.5 * (frequency * S_PIX) ** 2)
        assert abs(found - true) < 0.02


def test_a_clamped_filter_is_as_wide_as_the_clamp_and_reprojects_less():
    free, clamped = (made_filter(np.full(9, 40.0), np.tile([60.0, 0.0], (9, 1)), largest) for largest in (np.inf, 8.0))
    assert np.linalg.eigvalsh(covariance_of(clamped)).max() == pytest.approx(64.0)
    assert 0 < clamped[kernels.ETA] < 0.1 * free[kernels.ETA]


def test_without_motion_the_short_way_is_the_long_one(rng):
    coc = rng.normal(3, 1, 60)
    np.testing.assert_allclose(
        made_filter(coc, np.zeros((60, 2)), moving=False), made_filter(coc, np.zeros((60, 2))), rtol=1e-12
    )


# Statistics and layers


def tile_samples(rng, side=32, n_samples=4):
    shape = side, side, n_samples
    coc = rng.choice([-20.0, 1.0, 2.5, 14.0], shape, p=[0.02, 0.4, 0.38, 0.2])
    buffer = SampleBuffer(
        rng.random((*shape, 3)), np.full(shape, 4.0), 20 * rng.normal(size=(*shape, 2)), on_disc(rng, shape),
        rng.uniform(-0.25, 0.25, shape), coc_radius=coc, valid=rng.random(shape) < 0.9,
    )  # fmt: skip
    return Samples.from_buffer(buffer, CAMERA)


def full_buffer(rng):
    shape = 32, 32, 4
    return SampleBuffer(
        rng.random((*shape, 3)), np.full(shape, 4.0), rng.normal(size=(*shape, 2)), on_disc(rng, shape),
        rng.uniform(-0.25, 0.25, shape), coc_radius=rng.uniform(-9, 9, shape),
    )  # fmt: skip


def given_to_statistics(samples, partition):
    given = (partition, samples.motion, samples.coc, samples.first, samples.shape[1])
    return given, np.array([0, 0, *samples.shape], np.int32)


def sparse_by_kernel(samples, partition, sparsity, seed=7, n_partitions=33):
    given, box = given_to_statistics(samples, partition)
    moments = np.zeros((n_partitions, kernels.N_MOMENTS))
    kernels.sparse_moments(given, box, morton_order(32), sparsity, np.uint32(seed), True, moments)
    return moments


def test_full_statistics_are_the_sums_over_every_partition(rng):
    samples = tile_samples(rng)
    partition = Lrdm().partitions(samples)
    moments = np.zeros((33, kernels.N_MOMENTS))
    kernels.full_moments(*given_to_statistics(samples, partition), True, np.ones(33, np.bool_), moments)
    for p in np.unique(partition):
        here = partition == p
        expected = moments_of(samples.coc[here].astype(np.float64), samples.motion[here].astype(np.float64))
        np.testing.assert_allclose(moments[p], expected, rtol=1e-9)
    assert moments[:, kernels.COUNT].sum() == len(samples.coc)


def test_sparse_statistics_take_one_sample_of_every_bucket_in_morton_order(rng):
    samples = Samples.from_buffer(full_buffer(rng), CAMERA)
    buckets = np.zeros(len(samples.coc), np.uint8)
    for number, (row, col) in enumerate(morton_order(32)[:600]):  # 200 buckets of 3 pixels; the rest is one partition
        buckets[samples.first[row * 32 + col] : samples.first[row * 32 + col + 1]] = 1 + number // 3
    taken = [sparse_by_kernel(samples, buckets, 3, seed, n_partitions=201) for seed in (1, 2)]
    for moments in taken:
        np.testing.assert_array_equal(moments[1:, kernels.COUNT], 12)  # one sample stands for 3 pixels of 4
        ours = moments[1:, kernels.COC] / 12
        assert all(coc in samples.coc[buckets == 1 + k].astype(np.float64) for k, coc in enumerate(ours))
    assert (taken[0][:, kernels.MX] != taken[1][:, kernels.MX]).any()


def test_sparse_statistics_are_not_biased_by_how_many_samples_pixels_have(rng):
    samples = tile_samples(rng)
    partition = np.zeros(len(samples.coc), np.uint8)
    found = sum(sparse_by_kernel(samples, partition, 3, seed, 2)[0] for seed in range(1, 400))
    np.testing.assert_allclose(
        found[: kernels.MX] / found[0], [1, samples.coc.mean(), (samples.coc**2).mean()], rtol=0.03
    )
    assert found[0] / 399 == pytest.approx(len(samples.coc), rel=0.01)


def test_partitions_that_sparse_statistics_miss_count_with_all_their_samples(rng):
    samples = tile_samples(rng)
    partition = Lrdm().partitions(samples)
    partition[[1234, 1235]] = 3
    before = sparse_by_kernel(samples, partition, 64)
    assert before[3, kernels.COUNT] == 0
    moments = before.copy()
    missed = before[:, kernels.COUNT] == 0
    kernels.full_moments(*given_to_statistics(samples, partition), True, missed, moments)
    np.testing.assert_allclose(moments[3, :2], [2, samples.coc[[1234, 1235]].sum()])
    np.testing.assert_array_equal(moments[~missed], before[~missed])


def test_the_random_numbers_are_marsaglia_s():
    assert kernels.next_random(np.uint32(2463534242)) == 723471715


def test_morton_order_visits_quads_of_quads():
    assert morton_order(32)[:8].tolist() == [[0, 0], [0, 1], [1, 0], [1, 1], [0, 2], [0, 3], [1, 2], [1, 3]]
    assert len(np.unique(morton_order(96), axis=0)) == 96**2


def layers_of(*partitions, shrink=0.1):
    moments = np.zeros((9, kernels.N_MOMENTS))
    for p, (n, coc, motion) in partitions:
        moments[p] = n * moments_of(np.array([coc]), np.array([motion], np.float64))
    own, holes = np.empty(9, np.int16), np.empty(9, np.int16)
    filters = np.zeros((9, kernels.N_FILTER))
    counts = kernels.tile_layers(moments, SPREAD, S_PIX**2, 64.0, True, shrink, own, holes, filters)
    return counts, own.tolist(), holes.tolist(), filters


def test_partitions_alike_are_merged_and_others_are_not():
    still, swift = (0.0, 0.0), (40.0, 0.0)
    near, next_to_it, far = (1, (90, -20.0, still)), (2, (10, -19.0, still)), (5, (50, 3.0, still))
    counts, own, holes, filters = layers_of(near, next_to_it, far)
    assert counts == (3, 2) and own == [-1, 0, 0, -1, -1, 1, -1, -1, -1] and holes == [0, 0, 0, 1, 1, 1, 2, 2, 2]
    assert layers_of(near, next_to_it, far, shrink=-1.0)[0] == (3, 3)
    # Few samples are not lost among many, and a moving surface is not merged with a still one.
    assert layers_of((1, (5000, -20.0, still)), (2, (1, -4.0, still)))[0] == (2, 2)
    assert layers_of((3, (50, -1.0, still)), (4, (50, 1.0, swift)))[0] == (2, 2)
    # Samples that met nothing are never merged.
    assert layers_of((7, (50, 3.0, still)), (8, (50, 3.0, still)))[0] == (2, 2)


# Reprojection


def test_reprojection_agrees_with_its_naive_twin(rng):
    samples = tile_samples(rng)
    layer_of = rng.integers(0, 3, len(samples.coc))
    partition = layer_of.astype(np.uint8)
    own, holes = np.array([0, 1, -1], np.int16), np.array([0, 1, 2], np.int16)
    slopes = np.array([5.0, 9.0, -4.0, 0.8, 6.0, 0, 0, 0], np.float32)
    box = (-4, 3, 41, 30)
    given = (samples.colour, samples.place, samples.lens, samples.time, samples.first, samples.shape)
    found = np.zeros(((box[2] - box[0]) * (box[3] - box[1]), 6), np.float32)
    kernels.reproject(given, partition, own, holes, 1, slopes, (*box, 1), (1.0, 0.25), True, found)
    expected = reprojected_sums(samples, layer_of, 1, slopes[0], slopes[1:3], slopes[3:5], box)
    found = found.reshape(expected.shape)
    assert np.isclose(found, expected, atol=1e-5).all(axis=2).mean() > 0.999  # float32 rounds some across a border
    np.testing.assert_allclose(found.sum(axis=(0, 1)), expected.sum(axis=(0, 1)), rtol=2e-3)


@pytest.mark.parametrize(("rates", "moving"), [((0.0, 0.0), True), ((0.0, 0.0), False), ((0.8, 6.0), True)])
def test_sums_of_texels_are_those_of_their_pixels(rng, rates, moving):
    samples = tile_samples(rng)
    partition = rng.integers(0, 3, len(samples.coc)).astype(np.uint8)
    own, holes = np.array([0, 1, -1], np.int16), np.array([0, 1, 2], np.int16)
    slopes = np.array([5.0, 9.0 * moving, -4.0 * moving, *rates, 0, 0, 0], np.float32)
    given = (samples.colour, samples.place, samples.lens, samples.time, samples.first, samples.shape)
    of_pixels, of_texels = np.zeros((48 * 32, 6), np.float32), np.zeros((12 * 8, 6), np.float32)
    for texel, sums in ((1, of_pixels), (4, of_texels)):
        box = (-8, 0, 40, 32, texel)
        kernels.reproject(given, partition, own, holes, 1, slopes, box, (1.0, 0.25), moving, sums)
    expected = of_pixels.reshape(12, 4, 8, 4, 6).sum(axis=(1, 3))
    assert (expected[1:-1, :, 5] > 0).all()
    np.testing.assert_allclose(of_texels.reshape(expected.shape), expected, rtol=1e-4)


# Screen filters

COVARIANCES = [
    (0.25, 0.0, 0.25), (4.0, 0.0, 4.0), (64.0, 0.0, 64.0), (40.0, 30.0, 24.0), (9.0, -8.6, 9.0), (60.0, 3.0, 0.6),
    (0.6, -3.0, 60.0),
]  # fmt: skip


def response(way, covariance):
    """What a screen filter makes of a single pixel, turned by half a turn to be the filter, with its ring."""
    tile = 96
    *ring, texel = gauss.ring_of(way, *covariance)
    ring = tuple(ring)
    sums = np.zeros(((tile + 2 * ring[1]) // texel, (tile + 2 * ring[0]) // texel, 6), np.float32)
    sums[(ring[1] + tile // 2) // texel, (ring[0] + tile // 2) // texel] = np.arange(1, 7)
    between, blurred = np.empty(sums.size, np.float32), np.empty((tile, tile * 6), np.float32)
    gauss.first_pass(way, sums, covariance, ring, (tile, tile), between)
    gauss.second_pass(way, sums, covariance, ring, between, blurred)
    image = blurred.reshape(tile, tile, 6).astype(np.float64)
    np.testing.assert_allclose(image, image[..., :1] * np.arange(1, 7), rtol=1e-5, atol=1e-12)
    return image[..., 0]


def covariance_of_image(image):
    y, x = np.mgrid[: image.shape[0], : image.shape[1]]
    mean_x, mean_y = (image * x).sum() / image.sum(), (image * y).sum() / image.sum()
    x, y = x - mean_x, y - mean_y
    return np.array([(image * x * x).sum(), (image * x * y).sum(), (image * y * y).sum()]) / image.sum()


@pytest.mark.parametrize("covariance", COVARIANCES)
def test_the_rotated_filter_is_the_gaussian(covariance):
    sxx, sxy, syy = covariance
    image = response(gauss.ROTATED, covariance)
    # Bilinear interpolation adds to narrow filters: at most a quarter of a pixel along either axis in each pass.
    true = gaussian_image(np.array([[sxx, sxy], [sxy, syy]]), 47)
    assert image.sum() == pytest.approx(1, abs=1e-4)
    narrow = np.linalg.eigvalsh([[sxx, sxy], [sxy, syy]])[0] < 1
    assert np.abs(image[1:, 1:] - true).sum() < (0.4 if narrow and sxy else 0.03)
    np.testing.assert_allclose(covariance_of_image(image), covariance, atol=0.04 * (sxx + syy) + 0.25)


@pytest.mark.parametrize("covariance", COVARIANCES)
def test_the_sheared_filter_has_the_gaussian_s_sum_and_spread(covariance):
    sxx, _, syy = covariance
    image = response(gauss.SHEARED, covariance)
    assert image.sum() == pytest.approx(1, abs=0.03)  # the tails of the recursive filter end at the tile
    np.testing.assert_allclose(covariance_of_image(image), covariance, atol=0.25 * (sxx + syy))


@pytest.mark.parametrize("covariance", COVARIANCES)
def test_lookups_have_about_the_gaussian_s_spread_over_all_places_of_the_pixel(covariance):
    sxx, sxy, syy = covariance
    image = response(gauss.EWA, covariance)
    assert image.sum() == pytest.approx(1, rel=0.35)  # a pixel of a coarse texel weighs as its neighbours allow
    found = covariance_of_image(image)
    assert np.abs(found - covariance).max() < 0.45 * (sxx + syy) + 0.2
    assert sxy == 0 or np.sign(found[1]) == np.sign(sxy)


@pytest.mark.parametrize("covariance", COVARIANCES)
def test_the_shear_has_the_covariance_of_the_rotation(covariance):
    sigma_x, sigma_y, beta = gauss.sheared_axes(*covariance)
    matrix = np.array([[1, beta], [0, 1]]) @ np.diag([sigma_x, sigma_y])  # LRDM Eq. 8
    np.testing.assert_allclose((matrix @ matrix.T)[[0, 0, 1], [0, 1, 1]], covariance, rtol=1e-9, atol=1e-12)
    sigma_u, sigma_v, cosine, sine = gauss.rotated_axes(*covariance)
    rho = np.sqrt(sigma_v**2 * cosine**2 + sigma_u**2 * sine**2)  # Eq. 9
    by_eq_9 = sigma_u * sigma_v / rho, rho, cosine * sine * (sigma_u**2 - sigma_v**2) / rho**2
    np.testing.assert_allclose((sigma_x, sigma_y, beta), by_eq_9, rtol=1e-6, atol=1e-9)


def test_the_recursive_filter_is_an_exponential_to_both_sides():
    rows = np.zeros((1, 201, 6), np.float32)
    rows[0, 100] = 1
    out = np.empty_like(rows)
    gamma = gauss.recursion(5.0)
    assert gamma == pytest.approx(np.exp(-np.sqrt(2) / 5))
    gauss.recursive_rows(rows, gamma, 0, 201, out)
    expected = (1 - gamma) / (1 + gamma) * gamma ** np.abs(np.arange(201) - 100)
    np.testing.assert_allclose(out[0, :, 0], expected, rtol=1e-4, atol=1e-9)


def test_passes_along_a_direction_interpolate(rng):
    source = rng.random((40, 44, 6)).astype(np.float32)
    weights = rng.random(7).astype(np.float32)
    y, x = np.mgrid[10:30, 12:32].astype(np.float64)

    def looked_up(step_x, step_y, channel):
        taps = [map_coordinates(source[..., channel], [y + k * step_y, x + k * step_x], order=1) for k in range(-3, 4)]
        return sum(weight * tap for weight, tap in zip(weights, taps, strict=True))

    found = np.empty((20, 120), np.float32)
    gauss.along_direction(source, weights, 0.8, 0.6, 10, 12, found)
    np.testing.assert_allclose(found.reshape(20, 20, 6)[..., 2], looked_up(0.8, 0.6, 2), rtol=1e-4)
    gauss.along_shear(source[7:33], weights, -1.3, 12, found)
    np.testing.assert_allclose(found.reshape(20, 20, 6)[..., 4], looked_up(-1.3, 1.0, 4), rtol=1e-4)


def test_a_level_of_the_pyramid_is_looked_up_bilinearly_between_means_of_blocks(rng):
    sums = rng.random((32, 48, 6)).astype(np.float32)
    level = gauss.next_level(np.empty(sums.size, np.float32), sums.shape)
    gauss.halve(sums, level)
    means = sums.reshape(16, 2, 24, 2, 6).mean(axis=(1, 3))
    np.testing.assert_allclose(level, means, rtol=1e-5)
    found, lines = np.zeros((20, 20 * 6), np.float32), np.empty((32, 20 * 6), np.float32)
    gauss.add_lookup(level, 4, np.float32(0.5), 1.3, -2.2, 30, 20, lines, found)
    y, x = np.mgrid[20:40, 30:50]
    places = [(y + 0.5 - 2.2) / 4 - 0.5, (x + 0.5 + 1.3) / 4 - 0.5]
    expected = 0.5 * map_coordinates(means[..., 3].astype(np.float64), places, order=1)
    np.testing.assert_allclose(found.reshape(20, 20, 6)[..., 3], expected, rtol=1e-4)


@pytest.mark.parametrize("covariance", [(64.0, 0.0, 64.0), (9.0, 0.0, 9.0), (40.0, 30.0, 24.0), (60.0, 3.0, 0.6)])
def test_lookups_into_sums_of_texels_are_those_into_a_pyramid_of_pixels(rng, covariance):
    """Samples land on texels of the level that is looked up; halving an image of pixels leads to the same."""
    *ring, texel = gauss.ring_of(gauss.EWA, *covariance)
    longer, shorter, cosine, sine, probes, n_taps, level = gauss.footprint_of(*covariance)
    assert texel == 2 ** int(level)
    pixels = rng.random((32 + 2 * ring[1], 32 + 2 * ring[0]))
    sums = np.zeros((pixels.shape[0] // texel, pixels.shape[1] // texel, 6), np.float32)
    sums[..., 3] = pixels.reshape(sums.shape[0], texel, sums.shape[1], texel).sum(axis=(1, 3))
    between, found = np.empty(sums.size, np.float32), np.empty((32, 32 * 6), np.float32)
    gauss.first_pass(gauss.EWA, sums, covariance, tuple(ring), (32, 32), between)
    gauss.second_pass(gauss.EWA, sums, covariance, tuple(ring), between, found)
    expected = np.zeros((32, 32))
    y, x = np.mgrid[ring[1] : ring[1] + 32, ring[0] : ring[0] + 32] + 0.5
    taps = 0.33 * np.sqrt(0.5) * np.array([[-1, -1], [1, -1], [-1, 1], [1, 1]]) if n_taps == 4 else np.zeros((1, 2))
    for side in {2 ** int(np.floor(level)), 2 ** int(np.ceil(level))}:
        means = pixels.reshape(pixels.shape[0] // side, side, -1, side).mean(axis=(1, 3))
        for u, v in taps * [longer, shorter]:
            for probe in range(probes):
                along = u + ((probe + 0.5) / probes - 0.5) * longer
                places = y + along * sine + v * cosine, x + along * cosine - v * sine
                looked_up = map_coordinates(means, [each / side - 0.5 for each in places], order=1, mode="nearest")
                expected += (1 - abs(level - np.log2(side))) * looked_up / (probes * n_taps)
    np.testing.assert_allclose(found.reshape(32, 32, 6)[..., 3], expected, rtol=1e-4)


@pytest.mark.parametrize(
    ("way", "short"),
    [(gauss.ROTATED, gauss.ROUND_ROTATED), (gauss.SHEARED, gauss.ROUND_SHEARED), (gauss.EWA, gauss.ROUND_EWA)],
)
@pytest.mark.parametrize("variance", [0.25, 1.9, 9.0, 40.0, 64.0])
def test_the_ways_for_round_gaussians_are_the_general_ones(rng, way, short, variance):
    covariance = variance, 0.0, variance
    wide, ring = gauss.ring_of(way, *covariance), gauss.ring_of(short, *covariance)
    assert ring <= wide and ring[2] == wide[2]
    cut = wide[1] - ring[1], wide[0] - ring[0]
    sums = rng.random(((32 + 2 * wide[1]) // wide[2], (32 + 2 * wide[0]) // wide[2], 6)).astype(np.float32)
    inside = sums[cut[0] : sums.shape[0] - cut[0], cut[1] : sums.shape[1] - cut[1]].copy()
    images = []
    for number, given, size in ((way, sums, wide), (short, inside, ring)):
        between, blurred = np.empty(sums.size, np.float32), np.empty((32, 32 * 6), np.float32)
        gauss.first_pass(number, given, covariance, size[:2], (32, 32), between)
        gauss.second_pass(number, given, covariance, size[:2], between, blurred)
        images.append(blurred)
    np.testing.assert_allclose(images[1], images[0], rtol=2e-5)


def test_the_footprint_holds_95_percent_of_a_gaussian_and_hardware_s_number_of_lookups():
    assert math_erf(gauss.ALPHA / np.sqrt(2)) ** 2 == pytest.approx(0.95, abs=1e-4)
    longer, shorter, cosine, sine, probes, n_taps, level = gauss.footprint_of(64.0, 0.0, 1.0)
    assert (probes, n_taps, cosine, sine) == (8, 1, 1.0, 0.0) and longer == pytest.approx(8 * shorter)
    assert level == pytest.approx(np.log2(shorter))
    *_, probes, n_taps, level = gauss.footprint_of(16.0, 0.0, 16.0)
    assert (probes, n_taps) == (1, 4) and level == pytest.approx(np.log2(0.67 * 4 * gauss.GAIN * gauss.ALPHA))
    assert gauss.footprint_of(64.0, 0.0, 0.04)[4] == gauss.MOST_PROBES


def math_erf(x):
    from math import erf

    return erf(x)


# Images


@pytest.mark.parametrize("method", METHODS)
def test_an_even_image_stays_even(rng, method):
    shape = 50, 70, 2
    buffer = SampleBuffer(
        np.broadcast_to([0.2, 0.5, 0.8], (*shape, 3)), np.full(shape, 4.0), 20 * rng.normal(size=(*shape, 2)),
        on_disc(rng, shape), rng.uniform(-0.25, 0.25, shape), coc_radius=rng.uniform(-30, 30, shape),
    )  # fmt: skip
    image = reconstruct(buffer, CAMERA, method=method)
    np.testing.assert_allclose(image, np.broadcast_to([0.2, 0.5, 0.8, 1.0], image.shape), rtol=1e-4)


@pytest.mark.parametrize("method", METHODS)
def test_noise_of_lens_and_shutter_is_cleaned(rng, method):
    converged = reconstruct(scene(rng, n_samples=400), CAMERA, method="mean")
    noisy = scene(rng)
    mean, clean = reconstruct(noisy, CAMERA, method="mean"), reconstruct(noisy, CAMERA, method=method)
    assert psnr(clean, converged) > psnr(mean, converged) + 6
    assert abs(clean[..., :3].mean() - converged[..., :3].mean()) < 0.01


@pytest.mark.parametrize("method", METHODS)
def test_the_image_does_not_depend_on_threads_blocks_or_work_sizes(rng, method, monkeypatch, tmp_path):
    buffer = scene(rng, 70, 100)
    image = reconstruct(buffer, CAMERA, method=method, settings={"block": 0})
    for block in (32, 64):
        np.testing.assert_array_equal(reconstruct(buffer, CAMERA, method=method, settings={"block": block}), image)
    monkeypatch.setenv(FILE_VARIABLE, str(tmp_path / "sizes.json"))
    WorkSizes(set_up=1, reproject=1, blur=3, composite=2).save()
    for other in for_thread_counts(lambda: reconstruct(buffer, CAMERA, method=method)):
        np.testing.assert_array_equal(other, image)


@pytest.mark.parametrize("method", METHODS)
def test_borders_of_tiles_do_not_show(rng, method):
    """Where statistics are the same in all tiles, so is the image for tiles of any size, up to the filters' cut."""
    shape = 96, 96, 2
    offset, lens = rng.random((*shape, 2)) - 0.5, on_disc(rng, shape)
    x = np.arange(96)[None, :, None] + offset[..., 0]
    colour = (0.5 + 0.4 * np.sin((x - 7.0 * lens[..., 0]) / 5))[..., None] * [1.0, 0.7, 0.4]
    time = rng.uniform(-0.25, 0.25, shape)
    buffer = SampleBuffer(
        colour, np.full(shape, 4.0), np.full((*shape, 2), 12.0), lens, time, offset, coc_radius=np.full(shape, 7.0)
    )
    small, large = (
        reconstruct(buffer, CAMERA, method=method, settings={"tile": tile, "block": 0}) for tile in (32, 96)
    )
    # The recursive filter has no end: a tile's ring cuts it, larger tiles elsewhere.
    np.testing.assert_allclose(small, large, atol=2e-3 if method == "lrdm-sheared" else 1e-5)


@pytest.mark.parametrize("method", METHODS)
def test_without_motion_the_path_for_defocus_makes_the_same_image(rng, method):
    buffer = scene(rng, moving=False)
    image, report = reconstruct(buffer, CAMERA, method=method, report=True)
    full = reconstruct(buffer, CAMERA, method=method, settings={"skip_motion": False})
    np.testing.assert_allclose(image, full, atol=1e-5)
    assert report["plan"]["layers_per_tile"] >= 1
    samples = Samples.from_buffer(buffer, CAMERA)
    prepared = Lrdm().prepare(samples, Lrdm().tiling(samples.shape))
    assert isinstance(prepared, LrdmFilter) and not prepared.moving


def test_merging_and_sparse_statistics_hardly_change_the_image_and_need_fewer_layers(rng):
    buffer = scene(rng, 96, 96, behind=7.5)
    buffer.coc_radius[..., 0] += 1  # the floor is in two partitions
    full, before = reconstruct(buffer, CAMERA, method="lrdm", report=True)
    merged, after = reconstruct(buffer, CAMERA, method="lrdm", report=True, settings={"sparsity": 3, "shrink": 0.1})
    assert after["plan"]["layers_per_tile"] < 0.8 * before["plan"]["layers_per_tile"]
    assert after["plan"]["partitions_per_tile"] == before["plan"]["partitions_per_tile"]
    assert psnr(merged, full) > 35


@pytest.mark.parametrize("method", METHODS[1:])
def test_by_default_the_practical_methods_merge_no_surfaces_that_differ(rng, method):
    _, report = reconstruct(scene(rng), CAMERA, method=method, report=True)
    assert report["plan"]["layers_per_tile"] == 2, "the card and the floor"


def test_by_default_sparse_statistics_stand_for_all_samples():
    """Over partitions whose samples differ in defocus and motion, where fewer would show."""
    found = []
    for seed in (5, 6, 7):
        rng = np.random.default_rng(seed)
        buffer = scene(rng)
        buffer.coc_radius[...] += rng.uniform(-2, 2, buffer.coc_radius.shape)
        buffer.motion[...] += rng.normal(0, 15, buffer.motion.shape)
        exact = reconstruct(buffer, CAMERA, method="lrdm-sheared", settings={"sparsity": 0})
        found.append(psnr(reconstruct(buffer, CAMERA, method="lrdm-sheared"), exact))
    assert np.mean(found) > 51  # measured 54; a quarter of the samples have 47


def test_the_pixel_filter_and_the_clamp_make_the_image_smoother(rng):
    buffer = scene(rng, n_samples=1)

    def roughness(**settings):
        return np.abs(np.diff(reconstruct(buffer, CAMERA, method="lrdm", settings=settings)[..., 0], axis=1)).mean()

    assert roughness(sigma_pixel=2.0) < roughness(sigma_pixel=0.3)
    assert roughness(largest_sigma=8.0) < roughness(largest_sigma=1.5)


def test_partitions_are_as_wide_and_as_many_as_asked_for(rng):
    buffer = scene(rng)
    buffer.coc_radius[:] = rng.uniform(-30, 30, buffer.coc_radius.shape)

    def partitions(**settings):
        _, report = reconstruct(buffer, CAMERA, method="lrdm", report=True, settings=settings)
        return report["plan"]["partitions_per_tile"]

    assert partitions(layers=62, step=1.0) > partitions(layers=62, step=2.0) > partitions(layers=4, step=2.0) == 4


def test_alpha_is_reconstructed_and_samples_that_met_nothing_are_holes(rng):
    buffer = scene(rng)
    there = buffer.coc_radius < 0
    colour = np.where(there[..., None], buffer.radiance, 0)
    card = SampleBuffer(
        colour, buffer.depth, buffer.motion, buffer.lens_uv, buffer.time, buffer.offset, coc_radius=buffer.coc_radius
    )
    image, mean = reconstruct(card, CAMERA, method="lrdm"), reconstruct(card, CAMERA, method="mean")
    assert image[..., 3].max() <= 1 + 1e-5 and image[0, 0, 3] == 0
    assert image[..., 3].mean() == pytest.approx(mean[..., 3].mean(), rel=0.05)


def test_samples_spread_over_lens_and_shutter_as_they_do(rng):
    samples = Samples.from_buffer(scene(rng, n_samples=40), CAMERA)
    found = spread_of(samples)
    np.testing.assert_allclose(found[:2], SPREAD[:2], rtol=0.02)
    assert 0.99 < found[2] <= 1 and 0.24 < found[3] <= 0.25
    np.testing.assert_array_equal(spread_of(samples, moving=False), [found[0], 0, found[2], 0])


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"tile": 48}, "tile is 48: allowed are multiples of 32 px"),
        ({"block": 100}, "block is 100: allowed are 0"),
        ({"block": -32}, "block is -32"),
        ({"sparsity": -1}, "sparsity is -1: allowed are 0 to 64"),
        ({"shrink": 1.0}, "shrink is 1.0: allowed are values below 1"),
        ({"layers": 7}, "layers is 7: allowed are even numbers from 2 to 254"),
        ({"step": 0.0}, "step is 0.0"),
        ({"sigma_pixel": 9.0}, "sigma_pixel is 9.0: allowed are 0.1 to 4"),
        ({"largest_sigma": 9.0}, "largest_sigma is 9.0: allowed are 0.5 to 8"),
        ({"aperture": "disc"}, "'aperture' is no setting of method 'lrdm'"),
        ({"screen_filter": "ewa"}, "'screen_filter' is no setting of method 'lrdm'"),
    ],
)
def test_settings_out_of_range_are_named(rng, settings, said):
    with pytest.raises(InvalidParameterError, match=said.replace("(", r"\(")):
        reconstruct(scene(rng, 16, 16, 1), CAMERA, method="lrdm", settings=settings)


def test_an_unknown_screen_filter_is_named():
    with pytest.raises(InvalidParameterError, match="allowed are rotated, sheared, ewa"):
        PracticalLrdm(screen_filter="box")


# Work sizes


def test_work_sizes_are_read_from_their_file(monkeypatch, tmp_path):
    path = tmp_path / "folder" / "sizes.json"
    monkeypatch.setenv(FILE_VARIABLE, str(path))
    assert WorkSizes.current() == WorkSizes()
    sizes = WorkSizes(set_up=2, reproject=3, blur=5, composite=7)
    assert sizes.save() == path and WorkSizes.current() == sizes
    monkeypatch.delenv(FILE_VARIABLE)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    assert WorkSizes.current() == WorkSizes()
    assert sizes.save() == tmp_path / "config" / "spreadlets" / "work_sizes.json"


@pytest.mark.parametrize("text", ["{", '{"blur": 0}', '{"blurs": 2}', "[1]", '{"blur": 2.5}'])
def test_a_bad_file_of_work_sizes_is_one_clear_error(monkeypatch, tmp_path, text):
    path = tmp_path / "bad.json"
    path.write_text(text)
    monkeypatch.setenv(FILE_VARIABLE, str(path))
    with pytest.raises(InvalidParameterError, match="remove it, or run spreadlets tune"):
        WorkSizes.current()


def test_tuning_measures_every_step():
    sizes, times = tune(repeats=1, side=64)
    assert list(times) == ["set_up", "reproject", "blur", "composite"]
    for name, found in times.items():
        assert found[getattr(sizes, name)] == min(found.values())
    assert len(trial_samples(32).coc) == 2 * 32 * 32


def test_the_command_keeps_what_it_found(monkeypatch, tmp_path):
    path = tmp_path / "sizes.json"
    monkeypatch.setenv(FILE_VARIABLE, str(path))
    result = CliRunner().invoke(cli, ["tune", "--json"])
    assert result.exit_code == 0, result.output
    said = json.loads(result.stdout)
    assert json.loads(path.read_text()) == said["work_sizes"] and said["file"] == str(path)
