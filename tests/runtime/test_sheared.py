"""The layered reconstructions: filters against the paper's integrals, kernels against naive twins, known images."""

import json
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner
from naive.sheared import filtered, gaussian, irradiance, reconstruct_naive
from threads import for_thread_counts

import spreadlets.runtime.finish.denoise
from spreadlets.api import reconstruct
from spreadlets.cli.main import main
from spreadlets.errors import InvalidParameterError
from spreadlets.files.exr_samples import write_samples
from spreadlets.files.images import write_image
from spreadlets.runtime.sheared import _tile_kernels
from spreadlets.runtime.sheared import layers as layering
from spreadlets.runtime.sheared.filters import (
    LARGEST_SIGMA,
    REACH,
    SIGMA_LENS,
    SIGMA_PIXEL,
    Filters,
    axis_aligned_filters,
    sheared_filters,
    with_uniform_lens,
)
from spreadlets.runtime.sheared.layers import NONE, find_layers
from spreadlets.runtime.sheared.partitions import BIN, PER_SIDE, Partitioning, edges_behind_focus
from spreadlets.runtime.sheared.samples import Samples
from spreadlets.runtime.sheared.slr import Slr
from spreadlets.runtime.sheared.tiles import Tiling
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.samples import SampleBuffer

CAMERA = ThinLens(focal_length_mm=50.0, sensor_width_mm=36.0, f_number=2.0, focus_distance_m=4.0, shutter=(-0.25, 0.25))
UNCLAMPED = 1e6


def on_disc(rng, shape):
    """Places spread evenly over the unit disc, shape (*shape, 2)."""
    radius, angle = np.sqrt(rng.random(shape)), 2 * np.pi * rng.random(shape)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)


def buffer(rng, height, width, n_samples, see, time=0.0):
    """Samples of a scene: ``see(x, y, u, v)`` returns colour (..., 3 or 4) and CoC of what a ray meets."""
    shape = height, width, n_samples
    lens, offset = on_disc(rng, shape), rng.random((*shape, 2)) - 0.5
    y = np.arange(height)[:, None, None] + offset[..., 1]
    x = np.arange(width)[None, :, None] + offset[..., 0]
    colour, coc = see(x, y, lens[..., 0], lens[..., 1])
    depth = np.broadcast_to(10.0 + np.asarray(coc, np.float64) / 100, shape)
    colour = np.broadcast_to(colour, (*shape, np.shape(colour)[-1]))
    times = np.full(shape, time)
    return SampleBuffer(
        colour, depth, np.zeros((*shape, 2)), lens, times, offset, coc_radius=np.broadcast_to(coc, shape)
    )


def random_buffer(rng, height=20, width=27, n_samples=2):
    """Colours and CoC of several partitions at random, some samples missing, some that met nothing."""
    shape = height, width, n_samples
    colour = rng.random((*shape, 4))
    colour[..., 3] = rng.random(shape) < 0.9
    colour[..., :3] *= colour[..., 3:]
    coc = rng.choice([-6.2, -1.1, 0.2, 2.3, 11.0], shape)
    return SampleBuffer(
        colour,
        np.full(shape, 10.0),
        rng.normal(size=(*shape, 2)),
        on_disc(rng, shape),
        rng.uniform(-0.25, 0.25, shape),
        rng.random((*shape, 2)) - 0.5,
        valid=rng.random(shape) < 0.95,
        coc_radius=coc,
    )


def card(x, y, side):
    """A square around the origin."""
    return (np.abs(x) < side / 2) & (np.abs(y) < side / 2)


# Filters


@pytest.mark.parametrize(("near", "far"), [(3.0, 4.5), (-9.0, -4.0), (15.0, np.inf), (2.0, 30.0)])
def test_the_axis_transform_keeps_the_filter(near, far):
    sigma_lens = 0.4
    made = sheared_filters([near], [far], sigma_lens, largest=UNCLAMPED)
    width = abs(1 / near - 1 / far) / (2 * np.pi * sigma_lens)
    slope, sigma_x = 2 / (1 / near + 1 / far), 1 / (np.pi * width)
    x, u = np.meshgrid(np.linspace(-20, 20, 81), np.linspace(-1, 1, 41))
    by_eq_15 = gaussian(x, sigma_x) * gaussian(u - x / slope, sigma_lens)
    by_eq_23 = gaussian(x - made.shear * u, made.screen) * gaussian(u, made.lens)
    np.testing.assert_allclose(by_eq_23, by_eq_15, rtol=1e-4, atol=1e-7)


@pytest.mark.parametrize("largest", [LARGEST_SIGMA, 2.0, UNCLAMPED])
@pytest.mark.parametrize(("near", "far"), [(3.0, 4.5), (-9.0, -4.0), (20.0, 33.0)])
def test_at_the_slope_of_its_layer_the_filter_blurs_as_the_lens_does_whatever_the_clamp(near, far, largest):
    sigma_lens = 1 / 3
    slope = 2 / (1 / near + 1 / far)
    made = sheared_filters([near], [far], sigma_lens, largest=largest)
    for texture in (np.cos, lambda x: np.exp(-0.5 * (x / 3) ** 2), lambda x: np.cos(0.2 * x)):
        for x in (0.0, 1.3):
            found = filtered(texture, slope, x, *(float(each[0]) for each in made))
            assert found == pytest.approx(irradiance(texture, slope, x, sigma_lens), abs=2e-3)


@pytest.mark.parametrize(("near", "far"), [(3.0, 4.5), (-9.0, -4.0), (5.0, 7.0)])
def test_at_the_sides_of_its_wedge_the_filter_has_fallen_by_as_much_as_the_lens_s_own_response(near, far):
    """The parallelogram of SLR Eq. 12 ends there: of what the lens passes, the filter passes the same share again."""
    sigma_lens = 1 / 3
    made = sheared_filters([near], [far], sigma_lens, largest=UNCLAMPED)
    for coc in (near, far):
        for frequency in np.array([0.2, 0.7, 1.2]) / abs(coc) / (2 * np.pi * sigma_lens):

            def wave(x, frequency=frequency):
                return np.cos(2 * np.pi * frequency * x)

            found = filtered(wave, coc, 0.0, *(float(each[0]) for each in made))
            assert found == pytest.approx(irradiance(wave, coc, 0.0, sigma_lens) ** 2, abs=1e-4)


def test_small_shears_keep_the_pixel_filter_and_widen_over_the_lens():
    sigma_pixel, sigma_lens = 0.5, 0.5
    made = sheared_filters([-0.5, 0.0, -0.9], [0.0, 0.5, 0.8], sigma_lens, sigma_pixel)
    np.testing.assert_allclose(made.shear, [-0.25, 0.25, -0.05], rtol=1e-6)
    np.testing.assert_allclose(made.screen, sigma_pixel)
    np.testing.assert_allclose(made.lens, [2.0, 2.0, 1.0 / 1.7], rtol=1e-6)


def test_wide_wedges_take_the_simple_filter():
    made = sheared_filters([-3.0, 0.0, 0.4], [2.0, 4.0, 60.0], 0.5, 0.5)
    np.testing.assert_array_equal(made.shear, 0)
    np.testing.assert_array_equal(made.screen, np.float32(0.5))
    np.testing.assert_array_equal(made.lens, np.float32(0.5))


def test_filters_in_front_of_focus_mirror_those_behind():
    near, far = np.array([0.0, 1.0, 2.5, 7.0, 38.0]), np.array([0.5, 1.5, 3.0, 9.5, 60.0])
    for make in (sheared_filters, axis_aligned_filters):
        behind, front = make(near, far, 0.5), make(-far, -near, 0.5)
        np.testing.assert_array_equal(front.shear, -behind.shear)
        np.testing.assert_array_equal(front.screen, behind.screen)
        np.testing.assert_array_equal(front.lens, behind.lens)


def test_axis_aligned_filters_end_at_the_least_coc_or_the_pixel():
    made = axis_aligned_filters([-12.0, -1.0, 0.4, 4.0, 50.0], [-8.0, 1.0, 0.9, 6.0, 90.0], 0.5, 0.5)
    np.testing.assert_allclose(made.screen, [0.25 * 8.0, 0.5, 0.5, 0.25 * 4.0, LARGEST_SIGMA])
    np.testing.assert_array_equal(made.shear, 0)
    np.testing.assert_array_equal(made.lens, np.float32(0.5))


@pytest.mark.parametrize(("near", "far"), [(3.0, 4.5), (-9.0, -4.0), (20.0, 33.0), (70.0, 80.0)])
@pytest.mark.parametrize("samples_per_pixel", [0.5, 4.0, 64.0])
def test_with_a_uniform_lens_the_blur_has_the_variance_of_the_disc_s_and_the_pixel_s(near, far, samples_per_pixel):
    made = sheared_filters([near], [far], SIGMA_LENS["disc"])
    made = with_uniform_lens(made, [near], [far], samples_per_pixel, sigma_pixel=0.4)
    slope = 2 / (1 / near + 1 / far)
    rng = np.random.default_rng(1)
    lens = on_disc(rng, 400_000)[:, 0]
    weights = _tile_kernels.gaussian(made.screen[0], REACH)  # cut by the clamp, as it is drawn
    offsets = np.arange(weights.size) - weights.size // 2
    blur = (slope - made.shear[0]) * lens + rng.choice(offsets, lens.size, p=weights / weights.sum(dtype=np.float64))
    assert np.std(blur) == pytest.approx(np.hypot(np.std(slope * lens), 0.4), rel=5e-3)
    axis_aligned = axis_aligned_filters([near], [far], SIGMA_LENS["disc"], sigma_pixel=0.4)
    assert made.screen[0] > 0.9 * min(axis_aligned.screen[0], 4.0)
    few = with_uniform_lens(sheared_filters([near], [far], SIGMA_LENS["disc"]), [near], [far], 0.1, sigma_pixel=0.4)
    assert made.screen[0] <= few.screen[0]
    assert np.isinf(made.lens[0])


@pytest.mark.parametrize(("near", "far"), [(-0.5, 0.0), (0.0, 0.5), (-0.5, 0.5), (-3.0, 2.0)])
def test_with_a_uniform_lens_what_may_be_in_focus_stays_where_it_is(near, far):
    made = with_uniform_lens(sheared_filters([near], [far], SIGMA_LENS["disc"]), [near], [far], 4.0)
    assert made.shear[0] == 0 and made.screen[0] == SIGMA_PIXEL
    beside = with_uniform_lens(sheared_filters([0.5], [1.0], SIGMA_LENS["disc"]), [0.5], [1.0], 4.0)
    assert beside.shear[0] > 0.3


# Partitions and layers


def test_there_are_thirty_partitions_of_constant_energy():
    edges = Partitioning.of_constant_energy().edges
    assert len(edges) == 2 * PER_SIDE + 1
    assert np.all(np.diff(edges) > 0)
    np.testing.assert_array_equal(edges, -np.array(edges[::-1]))
    behind = np.array(edges_behind_focus())
    np.testing.assert_array_equal(behind[:-1] % BIN, 0)
    inverse = np.append(1 / behind[1:-1], 0.0)
    steps = -np.diff(inverse)
    coarse = np.flatnonzero(np.diff(behind[1:]) > BIN)
    assert len(coarse) >= 3
    # An edge lies up to a bin nearer than the equal step would have it.
    step = steps[coarse].max()
    for k in coarse[:-1]:
        exact = 1 / (inverse[k] - step)
        assert exact - BIN <= behind[k + 2] <= exact + 1e-9 or steps[k] <= step


@pytest.mark.parametrize("per_side", [2, 3, 8, 40, 120])
def test_as_many_partitions_as_are_asked_for(per_side):
    assert len(edges_behind_focus(per_side)) == per_side + 1


def test_samples_are_in_the_partition_that_holds_their_coc():
    partitioning = Partitioning.of_constant_energy()
    coc = np.array([[[-1e4, -0.5, -0.1, 0.0, 0.5, 3.2, 39.0, 1e5]]], np.float32)
    shape = coc.shape
    colour = np.ones((*shape, 4))
    colour[0, 0, 5] = 0
    given = SampleBuffer(
        colour, np.full(shape, 5.0), *(np.zeros((*shape, 2)) for _ in range(2)), np.zeros(shape), coc_radius=coc
    )
    samples = Samples.from_buffer(given, CAMERA)
    found = partitioning.of(samples)
    edges = np.array(partitioning.edges)
    for i in (0, 1, 2, 3, 4, 6, 7):
        assert edges[found[i]] <= samples.coc[i] < edges[found[i] + 1]
    assert found[5] == partitioning.n_partitions - 1


@pytest.mark.interpreted
@pytest.mark.parametrize(("tile", "border"), [(8, 8), (16, 0), (32, 24)])
def test_layers_are_what_a_scan_of_each_tile_finds(tile, border):
    samples = Samples.from_buffer(random_buffer(np.random.default_rng(3)), CAMERA)
    partitioning = Partitioning.of_constant_energy()
    partition = partitioning.of(samples)
    tiling = Tiling(samples.shape, border, tile)
    found = find_layers(samples, partition, partitioning, tiling)
    pixel = np.repeat(np.arange(len(samples.first) - 1), np.diff(samples.first))
    row, col = pixel // samples.shape[1], pixel % samples.shape[1]
    for number, (top, left, bottom, right) in enumerate(tiling.outer()):
        within = (row >= top) & (row < bottom) & (col >= left) & (col < right)
        # Borders are whole cells: what is in a cell that the border touches counts.
        present = sorted(set(partition[within].tolist()))
        slots = found.slot[number]
        assert [p for p in range(partitioning.n_partitions) if slots[p] != NONE] == present
        assert slots[present].tolist() == list(range(len(present)))
        for k, p in enumerate(present):
            coc = samples.coc[within & (partition == p)]
            assert found.near[found.first[number] + k] == np.floor(coc.min() / BIN) * BIN
            assert found.far[found.first[number] + k] == (np.floor(coc.max() / BIN) + 1) * BIN
    assert found.per_tile == len(found.near) / len(tiling.inner())


def test_coc_beyond_all_bins_counts_for_the_last_one():
    rng = np.random.default_rng(3)
    given = buffer(rng, 8, 8, 1, lambda x, y, u, v: (np.ones(3), 1e6))
    samples = Samples.from_buffer(given, CAMERA)
    partitioning = Partitioning.of_constant_energy()
    found = find_layers(samples, partitioning.of(samples), partitioning, Tiling(samples.shape, 8))
    assert found.far[0] == layering.MOST_BINS * BIN
    image = reconstruct(given, CAMERA, method="sheared")
    np.testing.assert_allclose(image, 1.0, rtol=1e-5)


# Samples


def test_samples_keep_their_pixels_and_places():
    given = random_buffer(np.random.default_rng(4))
    samples = Samples.from_buffer(given, CAMERA)
    height, width = given.shape
    assert samples.first[-1] == given.valid.sum()
    for row, col in ((0, 0), (7, 11), (height - 1, width - 1)):
        own = slice(*samples.first[row * width + col : row * width + col + 2])
        there = given.valid[row, col]
        np.testing.assert_array_equal(samples.colour[own], given.radiance[row, col][there])
        np.testing.assert_allclose(samples.place[own], given.offset[row, col][there] + (col, row), atol=1e-5)


@pytest.mark.parametrize("off", ["defocus", "motion"])
def test_without_an_effect_samples_lie_where_they_would_be_seen(off):
    given = random_buffer(np.random.default_rng(4))
    whole = Samples.from_buffer(given, CAMERA)
    moved = Samples.from_buffer(given, CAMERA, **{off: False})
    shift = whole.coc[:, None] * whole.lens if off == "defocus" else whole.motion * whole.time[:, None]
    expected = {tuple(np.round(v, 3)) for v in np.column_stack([whole.place - shift, whole.colour]).tolist()}
    found = {tuple(np.round(v, 3)) for v in np.column_stack([moved.place, moved.colour]).tolist()}
    assert len(expected ^ found) <= 0.02 * len(expected)  # rounding may differ in the last digit
    assert not (moved.coc if off == "defocus" else moved.motion).any()
    height, width = given.shape
    pixel = np.repeat(np.arange(height * width), np.diff(moved.first))
    inside = np.clip(np.rint(moved.place), 0, (width - 1, height - 1))
    np.testing.assert_array_equal(pixel, inside[:, 1] * width + inside[:, 0])


# Algorithms 1 and 2


@pytest.mark.parametrize("aperture", ["disc", pytest.param("gaussian", marks=pytest.mark.interpreted)])
def test_tiles_are_what_every_pixel_gathers_from_every_sample(aperture):
    given = random_buffer(np.random.default_rng(5), height=9, width=12)
    method = Slr(aperture=aperture, tile=8, actual_range=False)
    samples = Samples.from_buffer(given, CAMERA)
    partitioning = Partitioning.of_constant_energy()
    near, far = partitioning.bounds()
    made = sheared_filters(near, far, SIGMA_LENS[aperture])
    filters = with_uniform_lens(made, near, far, samples.per_pixel) if aperture == "disc" else made
    expected = reconstruct_naive(samples, partitioning.of(samples), filters, REACH)
    image = np.zeros((*given.shape, 4), np.float32)
    tiling = method.tiling(given.shape)
    method.prepare(samples, tiling).fill(image)
    np.testing.assert_allclose(image, expected, atol=2e-5)


@pytest.mark.parametrize("method", ["sheared", "axis-aligned"])
def test_the_reconstruction_of_a_defocused_plane_is_the_irradiance_of_the_paper(method):
    """A striped plane at CoC 6 px through a Gaussian aperture, against SLR Eq. 3."""
    coc, wavelength = 6.0, 24.0

    def stripes(x):
        return 0.5 + 0.4 * np.cos(2 * np.pi * x / wavelength)

    def see(x, y, u, v):
        return np.repeat(stripes(x - coc * u)[..., None], 3, axis=-1), coc

    given = buffer(np.random.default_rng(6), 64, 96, 24, see)
    settings = {"aperture": "gaussian", "bilinear": True}
    image = reconstruct(given, CAMERA, method=method, settings=settings)[24:40, 24:72, 0].mean(axis=0)
    expected = np.array([irradiance(stripes, coc, x, SIGMA_LENS["gaussian"]) for x in range(24, 72)])
    sigma = 0.5 * coc * SIGMA_LENS["gaussian"] if method == "axis-aligned" else 0.0  # its own filter blurs, too
    expected = 0.5 + (expected - 0.5) * np.exp(-0.5 * (2 * np.pi * sigma / wavelength) ** 2)
    assert np.abs(image - expected).max() < 0.02


@pytest.mark.parametrize("settings", [{}, {"bilinear": True}, {"aperture": "gaussian"}, {"actual_range": False}])
def test_a_plain_image_stays_what_it_is_in_any_layers(settings):
    rng = np.random.default_rng(7)
    given = buffer(rng, 40, 40, 2, lambda x, y, u, v: (np.array([0.25, 0.5, 2.0]), rng.normal(0, 9, x.shape)))
    for method in ("sheared", "axis-aligned"):
        image = reconstruct(given, CAMERA, method=method, settings=settings)
        np.testing.assert_allclose(image, np.broadcast_to([0.25, 0.5, 2.0, 1.0], image.shape), rtol=1e-5)


@pytest.mark.interpreted
def test_samples_that_met_nothing_are_holes():
    def see(x, y, u, v):
        met = x < 12
        return np.where(met[..., None], [0.5, 0.5, 0.5, 1.0], 0.0), 0.2

    image = reconstruct(buffer(np.random.default_rng(8), 16, 24, 4, see), CAMERA, method="sheared")
    np.testing.assert_allclose(image[:, :9], np.broadcast_to([0.5, 0.5, 0.5, 1.0], (16, 9, 4)), rtol=1e-5)
    np.testing.assert_array_equal(image[:, 15:], 0)


def test_a_pixel_without_any_sample_near_is_empty():
    given = buffer(np.random.default_rng(8), 8, 24, 1, lambda x, y, u, v: (np.ones(3), 0.2))
    valid = np.ones((8, 24, 1), bool)
    valid[:, 10:20] = False
    parts = given.depth, given.motion, given.lens_uv, given.time, given.offset
    partly = SampleBuffer(given.radiance, *parts, valid=valid, coc_radius=given.coc_radius)
    image = reconstruct(partly, CAMERA, method="sheared")
    np.testing.assert_array_equal(image[:, 13:17], 0)
    np.testing.assert_allclose(image[:, :9], 1, rtol=1e-6)


def test_a_buffer_without_samples_is_an_empty_image():
    given = random_buffer(np.random.default_rng(8))
    parts = given.depth, given.motion, given.lens_uv, given.time, given.offset
    empty = SampleBuffer(given.radiance, *parts, valid=np.zeros(given.depth.shape, bool))
    np.testing.assert_array_equal(reconstruct(empty, CAMERA, method="sheared"), 0)


# Tiles


def planes(rng, n_samples=3, size=100):
    """A defocused card before a striped background of another CoC."""

    def see(x, y, u, v):
        front = card(x + 9 * u - 45, y + 9 * v - 50, 40)
        stripes = 0.5 + 0.4 * np.sign(np.sin(0.5 * (x - 4 * u)))
        colour = np.where(front[..., None], [0.9, 0.3, 0.1], stripes[..., None] * [0.3, 0.6, 0.9])
        return colour, np.where(front, -9.0, 4.0)

    return buffer(rng, size, size, n_samples, see)


@pytest.mark.parametrize("method", ["sheared", "axis-aligned"])
def test_tiles_of_another_size_give_the_same_image(method):
    given = planes(np.random.default_rng(9))
    images = [
        reconstruct(given, CAMERA, method=method, settings={"tile": tile, "actual_range": False})
        for tile in (8, 32, 64, 128)
    ]
    for image in images[1:]:
        np.testing.assert_array_equal(image, images[0])
    for tile in (32, 64):  # here the actual range of a layer is a single bin wherever the layer is in use
        image = reconstruct(given, CAMERA, method=method, settings={"tile": tile})
        other = reconstruct(given, CAMERA, method=method, settings={"tile": 128})
        np.testing.assert_allclose(image, other, atol=2e-6)


def test_no_seam_runs_where_the_range_of_a_layer_changes_from_tile_to_tile():
    """A slanted striped plane, whose tiles have different ranges, for tiles of 32 and 64 px."""
    rng = np.random.default_rng(10)
    size, n_samples = 128, 16
    shape = size, size, n_samples
    lens, offset = on_disc(rng, shape), rng.random((*shape, 2)) - 0.5
    y = np.arange(size)[:, None, None] + offset[..., 1]
    x = np.arange(size)[None, :, None] + offset[..., 0]
    # c = a + b y0 with y0 = y - c v: solved for c.
    coc = (2.0 + 0.1 * y) / (1 + 0.1 * lens[..., 1])
    stripes = 0.5 + 0.4 * np.sin(0.2 * (x - coc * lens[..., 0]))
    zero = np.zeros((*shape, 2))
    given = SampleBuffer(
        np.repeat(stripes[..., None], 3, axis=-1), np.full(shape, 9.0), zero, lens, zero[..., 0], offset, coc_radius=coc
    )
    small, large = (reconstruct(given, CAMERA, method="sheared", settings={"tile": tile}) for tile in (32, 64))
    assert np.abs(small - large).max() < 0.03
    steps = np.abs(np.diff(small[..., 0].mean(axis=1)))
    at_borders = np.isin(np.arange(size - 1), (31, 63, 95))
    assert steps[at_borders].max() <= steps[~at_borders].max()


def test_the_image_is_the_same_for_any_number_of_threads():
    given = planes(np.random.default_rng(11), n_samples=1)
    images = for_thread_counts(lambda: reconstruct(given, CAMERA, method="sheared"))
    samples, method = Samples.from_buffer(given, CAMERA), Slr()
    tiling = method.tiling(given.shape)
    tiles = method.prepare(samples, tiling)
    backwards = np.zeros((*given.shape, 4), np.float32)
    for tile in reversed(range(len(tiling.inner()))):
        tiles._fill_tile(tile, backwards)
    for image in images:
        np.testing.assert_array_equal(image, backwards)


@pytest.mark.parametrize("wrong", [{"tile": 12}, {"tile": 0}, {"tile": 4096}, {"border": 3}])
def test_tiles_and_borders_are_whole_cells(wrong):
    with pytest.raises(InvalidParameterError, match="multiples of 8"):
        Tiling((64, 64), **({"border": 8, "tile": 16} | wrong))


# Fixed point and settings


def test_fixed_point_changes_no_8_bit_image_by_more_than_steps():
    given = planes(np.random.default_rng(12), n_samples=8, size=48)
    for aperture in ("disc", "gaussian"):
        exact, rounded = (
            reconstruct(given, CAMERA, method="sheared", settings={"fixed_point": on, "aperture": aperture})
            for on in (False, True)
        )
        difference = np.abs(exact - rounded)
        assert 0 < difference.max() < 6 / 255
        assert difference.mean() < 1 / 255
        np.testing.assert_allclose(rounded[..., 3], 1, atol=2e-4)


def test_fixed_point_clips_bright_colours():
    given = buffer(np.random.default_rng(12), 16, 16, 4, lambda x, y, u, v: (np.array([3.0, 0.5, 0.0]), 5.0))
    image = reconstruct(given, CAMERA, method="sheared", settings={"fixed_point": True, "bilinear": True})
    np.testing.assert_allclose(image[..., 0], 1, atol=1e-6)
    np.testing.assert_allclose(image[..., 1], 0.5, atol=2 / 255)


@pytest.mark.parametrize("settings", [{"bilinear": True}, {"aperture": "gaussian"}, {"layers": 4}, {"sigma_pixel": 1}])
def test_every_setting_shows(settings):
    given = random_buffer(np.random.default_rng(13))
    usual = reconstruct(given, CAMERA, method="sheared")
    assert np.abs(reconstruct(given, CAMERA, method="sheared", settings=settings) - usual).max() > 0.01


def test_the_number_of_layers_is_that_of_partitions_over_both_sides():
    given = planes(np.random.default_rng(13), size=40)
    settings = {"layers": 4}
    np.testing.assert_array_equal(
        reconstruct(given, CAMERA, method="sheared", layers=4),
        reconstruct(given, CAMERA, method="sheared", settings=settings),
    )


@pytest.mark.parametrize(
    ("method", "options", "message"),
    [
        ("sheared", {"settings": {"bilinear": 3}}, "bilinear is 3: method 'sheared' wants bool"),
        ("sheared", {"settings": {"tiles": 3}}, "'tiles' is no setting of method 'sheared': allowed are aperture"),
        ("sheared", {"settings": {"tile": 33}}, "tile is 33: allowed are multiples of 8 px from 8 to 1024"),
        ("sheared", {"settings": {"aperture": "square"}}, "aperture 'square' is unknown: allowed are disc, gaussian"),
        ("sheared", {"settings": {"sigma_pixel": 0.0}}, "sigma_pixel is 0.0: it must be > 0 px"),
        ("axis-aligned", {"layers": 7}, "layers is 7: allowed are even numbers from 4 to 240"),
        ("axis-aligned", {"integrator": "exact"}, "integrator is no option of method 'axis-aligned'"),
        ("mean", {"motion": False}, "motion is no option of method 'mean'"),
        ("mean", {"layers": 1}, "layers is no option of method 'mean'"),
        ("mean", {"settings": {"tile": 32}}, "method 'mean' has no settings; those with are sheared, axis-aligned"),
        ("dense", {"settings": {"tile": 32}}, "method 'dense' has no settings"),
    ],
)
def test_wrong_settings_are_named(method, options, message):
    given = buffer(np.random.default_rng(14), 8, 8, 1, lambda x, y, u, v: (np.ones(3), 1.0))
    with pytest.raises(InvalidParameterError, match=message):
        reconstruct(given, CAMERA, method=method, **options)


def test_the_command_line_reconstructs_with_settings(tmp_path):
    given = planes(np.random.default_rng(15), size=48)
    write_samples(tmp_path / "samples.exr", given)
    write_image(tmp_path / "reference.exr", reconstruct(given, CAMERA, method="mean"))
    camera = {"focal_length_mm": 50, "sensor_width_mm": 36, "f_number": 2, "focus_distance_m": 4}
    (tmp_path / "camera.json").write_text(json.dumps(camera | {"shutter_open_close_frames": [-0.25, 0.25]}))
    paths = [str(tmp_path / name) for name in ("samples.exr", "out.exr", "camera.json", "reference.exr")]
    arguments = ["reconstruct", paths[0], "-o", paths[1], "--camera", paths[2], "--reference", paths[3], "--json"]
    from spreadlets.cli.main import cli

    settings = ["--method", "sheared", "--set", "tile=64", "--set", "aperture=gaussian", "--set", "bilinear=true"]
    result = CliRunner().invoke(cli, [*arguments, *settings])
    assert result.exit_code == 0, result.output
    report = json.loads(result.stdout)
    assert report["plan"]["tiles"] == 1
    assert report["plan"]["layers_per_tile"] >= 2
    assert {"psnr", "ssim", "time_s", "compile_s", "peak_rss_mb"} <= set(report)
    assert CliRunner().invoke(cli, [*arguments, "--set", "tile"]).exit_code == 2


def test_a_wrong_setting_on_the_command_line_is_one_line(tmp_path, monkeypatch, capsys):
    given = planes(np.random.default_rng(15), size=24)
    write_samples(tmp_path / "samples.exr", given)
    camera = {"focal_length_mm": 50, "sensor_width_mm": 36, "f_number": 2, "focus_distance_m": 4}
    (tmp_path / "camera.json").write_text(json.dumps(camera | {"shutter_open_close_frames": [-0.25, 0.25]}))
    arguments = ["reconstruct", str(tmp_path / "samples.exr"), "-o", str(tmp_path / "out.exr")]
    arguments += ["--camera", str(tmp_path / "camera.json"), "--method", "sheared", "--set", "tile=5"]
    monkeypatch.setattr(sys, "argv", ["spreadlets", *arguments])
    with pytest.raises(SystemExit) as stop:
        main()
    assert stop.value.code == 2
    assert capsys.readouterr().err.startswith("error: tile is 5: allowed are multiples of 8 px")
    assert not (tmp_path / "out.exr").exists()


# Visibility


RADIUS, BLUR = 14.0, 7.0


def two_discs(x, y, u, v):
    """SLR Fig. 6: a red disc in front of focus and a green one behind it, over the same area of rays; else black."""
    red = np.hypot(x + BLUR * u, y + BLUR * v) < RADIUS
    green = np.hypot(x - BLUR * u, y - BLUR * v) < RADIUS
    colour = np.select([red[..., None], green[..., None]], [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], [0.0, 0.0, 0.0])
    return colour, np.select([red, green], [-BLUR, BLUR], 30.0)


def over_the_lens(x, sigma_lens, steps=201):
    """Means over a Gaussian aperture at (x, 0): of the opacity of red, of that of green, and of what is seen of it."""
    u, v = np.meshgrid(*[np.linspace(-1, 1, steps)] * 2)
    weight = gaussian(u, sigma_lens) * gaussian(v, sigma_lens) * (np.hypot(u, v) <= 1)
    red = np.hypot(x + BLUR * u, BLUR * v) < RADIUS
    green = np.hypot(x - BLUR * u, BLUR * v) < RADIUS
    return [float((weight * each).sum() / weight.sum()) for each in (red, green, green & ~red)]


def test_layers_are_composited_by_their_mean_opacity_not_by_what_hides_what():
    """SLR Figs. 6 and 7: where the discs are seen from different halves of the lens, the farther one comes out dark."""
    size = 64
    centre = size // 2
    given = buffer(
        np.random.default_rng(16), size, size, 48, lambda x, y, u, v: two_discs(x - centre, y - centre, u, v)
    )
    settings = {"aperture": "gaussian", "bilinear": True}
    image = reconstruct(given, CAMERA, method="sheared", settings=settings)
    sigma = SIGMA_LENS["gaussian"]
    for distance in (0, 8, 14, 16):
        rows, cols = [0, 0, distance, -distance], [distance, -distance, 0, 0]
        found = image[centre + np.array(rows), centre + np.array(cols)].mean(axis=0)
        red, green, seen = over_the_lens(distance, sigma)
        assert found[0] == pytest.approx(red, abs=0.04)
        assert found[1] == pytest.approx((1 - red) * green, abs=0.04)  # Eq. 37
    red, green, seen = over_the_lens(RADIUS, sigma)
    assert seen == pytest.approx(green, abs=0.05)  # Eq. 36: nothing hides it,
    assert seen - (1 - red) * green > 0.2  # and the approximation takes nearly half of it


# Denoisers


def test_the_deviation_of_noise_is_found_in_a_smooth_image():
    rng = np.random.default_rng(17)
    smooth = np.sin(np.linspace(0, 3, 200))[:, None, None] * np.ones((1, 200, 3))
    noise = rng.normal(0, 0.07, smooth.shape)
    assert spreadlets.runtime.finish.denoise.noise_deviation(smooth) < 1e-4
    assert spreadlets.runtime.finish.denoise.noise_deviation(smooth + noise) == pytest.approx(0.07, rel=0.02)
    assert spreadlets.runtime.finish.denoise.noise_deviation(smooth[:1]) == 0.0


@pytest.mark.parametrize(("method", "package"), [("bm3d", "bm3d"), ("oidn", "pyoidn")])
def test_a_missing_denoiser_is_named(monkeypatch, method, package):
    monkeypatch.setitem(sys.modules, package, None)
    given = buffer(np.random.default_rng(14), 8, 8, 1, lambda x, y, u, v: (np.ones(3), 1.0))
    with pytest.raises(InvalidParameterError, match=f"needs the package {package}, which is not installed"):
        reconstruct(given, CAMERA, method=method)


def test_denoisers_are_given_the_mean_of_the_samples(monkeypatch):
    calls = {}

    def blurred(colour, hdr):
        calls["oidn"] = colour, hdr
        return 0.5 * colour

    def flattened(colour, sigma):
        calls["bm3d"] = colour, sigma
        return np.full(colour.shape, np.log1p(0.25))

    monkeypatch.setitem(sys.modules, "pyoidn", SimpleNamespace(denoise=blurred))
    monkeypatch.setitem(sys.modules, "bm3d", SimpleNamespace(bm3d_rgb=flattened))
    given = planes(np.random.default_rng(18), size=24)
    mean = reconstruct(given, CAMERA, method="mean")
    image, report = reconstruct(given, CAMERA, method="oidn", report=True)
    np.testing.assert_array_equal(calls["oidn"][0], mean[..., :3])
    np.testing.assert_allclose(image, mean * [0.5, 0.5, 0.5, 1.0], rtol=1e-6)
    assert report["time_s"]["total"] > 0
    np.testing.assert_allclose(reconstruct(given, CAMERA, method="bm3d")[..., :3], 0.25, rtol=1e-6)
    np.testing.assert_allclose(calls["bm3d"][0], np.log1p(mean[..., :3]), rtol=1e-6)
    deviation = spreadlets.runtime.finish.denoise.noise_deviation(np.log1p(mean[..., :3]))
    assert calls["bm3d"][1] == pytest.approx(spreadlets.runtime.finish.denoise.OUTLIERS * deviation)


def test_filters_are_named_tuples_of_one_value_for_each_layer():
    assert all(each.shape == (2,) and each.dtype == np.float32 for each in sheared_filters([1, 2], [2, 4], 0.5))
    assert Filters._fields == ("shear", "screen", "lens")
