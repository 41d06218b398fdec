"""TLFR: kernels against a naive twin, images of known scenes against their integrals, threads, tiles, settings."""

import numpy as np
import pytest
from naive.tlfr import crosses, has_triangle, seen_by_views
from scipy.ndimage import gaussian_filter
from scipy.special import j1
from threads import for_thread_counts

from spreadlets.api import reconstruct
from spreadlets.compiled import kernel
from spreadlets.errors import InvalidParameterError
from spreadlets.runtime.sheared import _tlfr_kernels as kernels
from spreadlets.runtime.sheared import tlfr
from spreadlets.runtime.sheared.samples import Samples
from spreadlets.runtime.sheared.tlfr import REACH, Tlfr
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.samples import SampleBuffer

CAMERA = ThinLens(focal_length_mm=50.0, sensor_width_mm=36.0, f_number=2.0, focus_distance_m=4.0, shutter=(-0.25, 0.25))
SHUTTER = 0.5


@kernel
def cross(one, other, half_shutter, tolerance):
    return kernels.cross(one, other, half_shutter, tolerance)


@kernel
def covers(offset, radius):
    return kernels.covers(offset, 0, len(offset), radius)


def buffer(rng, height, width, n_samples, see):
    """Samples of a scene: ``see(x, y, u, v, t)`` returns colour (..., 3), CoC and motion along x of what it meets."""
    shape = height, width, n_samples
    radius, angle = np.sqrt(rng.random(shape)), 2 * np.pi * rng.random(shape)
    lens = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)
    offset, time = rng.random((*shape, 2)) - 0.5, SHUTTER * (rng.random(shape) - 0.5)
    x, y = np.arange(width)[:, None] + offset[..., 0], np.arange(height)[:, None, None] + offset[..., 1]
    colour, coc, motion = see(x, y, lens[..., 0], lens[..., 1], time)
    coc, motion = np.broadcast_to(coc, shape), np.broadcast_to(motion, shape)
    colour = np.broadcast_to(colour, (*shape, np.shape(colour)[-1]))
    motion = np.stack([motion, np.zeros(shape)], axis=-1)
    return SampleBuffer(colour, 10.0 + coc / 100, motion, lens, time, offset, coc_radius=coc)


def grey(values):
    return np.repeat(np.asarray(values)[..., None], 3, axis=-1)


def mixed(rng, height=14, width=17, n_samples=2):
    """Two surfaces of random colours, CoC and motions about two values each."""

    def see(x, y, u, v, t):
        front = (x + 3 * u - 4 * t) % 9 < 5
        coc = np.where(front, -3.0, 4.0) + 0.3 * rng.normal(size=x.shape)
        return rng.random((*x.shape, 3)), coc, np.where(front, 4.0, -6.0)

    return buffer(rng, height, width, n_samples, see)


def prepared(given, **settings):
    samples, method = Samples.from_buffer(given, CAMERA), Tlfr(**settings)
    return method.prepare(samples, method.tiling(samples.shape))


# The twin


@pytest.mark.interpreted
def test_views_see_what_the_naive_twin_sees():
    given = mixed(np.random.default_rng(1), 9, 10)
    tiles = prepared(given, views=2, tile=8)
    expected = seen_by_views(tiles.trajectories, tiles.views)
    sums = np.zeros(expected.shape, np.float32)
    for box in tiles.tiling.inner():
        kernels.gather_tile(tiles.trajectories, tiles.views, box, sums, 0)
    assert (expected[..., 4].sum(axis=-1) == 2).all()
    assert len(np.unique(expected[..., 4].argmax(axis=-1))) > 1
    np.testing.assert_allclose(sums, expected, atol=2e-5)


@pytest.mark.interpreted
def test_trajectories_cross_as_in_the_naive_twin():
    views = prepared(mixed(np.random.default_rng(2)), views=1).views
    rng = np.random.default_rng(2)
    paths = (rng.normal(size=(200, 2, 5)) * [1, 1, 1, 6, 6]).astype(np.float32)
    found = [cross(one, other, views.half_shutter, views.tolerance) for one, other in paths]
    assert found == [crosses(one, other, views) for one, other in paths]
    assert 0.2 < np.mean(found) < 0.8


@pytest.mark.interpreted
def test_surfaces_cover_what_a_triangle_of_their_samples_holds():
    rng = np.random.default_rng(3)
    for _ in range(200):
        # To one side of the place, so that about half do not cover it.
        offset = (rng.uniform(-2, 2, (rng.integers(3, 9), 2)) + rng.uniform(-1, 1, 2)).astype(np.float32)
        offset = offset[np.hypot(*offset.T) < 2]
        assert covers(offset, np.float32(1)) == has_triangle(offset.astype(float), 1.0)


def test_the_layers_of_views_are_filtered_and_composited_front_to_back():
    tiles = prepared(mixed(np.random.default_rng(4), 100, 24), views=4, softness=0.4)
    sums = np.zeros((100, 24, len(tiles.sigma), 6), np.float32)
    for box in tiles.tiling.inner():
        kernels.gather_tile(tiles.trajectories, tiles.views, box, sums, 0)
    image = np.zeros((100, 24, 4), np.float32)
    tiles.fill(image)
    expected, left_over = np.zeros(image.shape), np.ones(image.shape[:2])
    for layer, sigma in enumerate(tiles.sigma):
        reach = min(int(np.ceil(3 * sigma)), REACH)
        blurred = gaussian_filter(
            sums[:, :, layer].astype(float), (sigma, sigma, 0), mode="constant", radius=(reach, reach, 0)
        )
        with np.errstate(invalid="ignore"):
            share = np.nan_to_num(blurred[..., :5] / blurred[..., 5:])
        expected += left_over[..., None] * share[..., :4]
        left_over = left_over * (1 - share[..., 4])
    np.testing.assert_allclose(image, expected / (1 - left_over)[..., None], atol=2e-5)
    assert tiles.sigma.max() > 1


# Set-up


def test_groups_hold_all_samples_and_their_bounds():
    given = mixed(np.random.default_rng(5), 30, 50)
    samples = Samples.from_buffer(given, CAMERA)
    made = tlfr.trajectories(samples)
    sizes = np.diff(made.first)
    assert sizes.min() > 0
    assert sizes.max() == tlfr.GROUP
    for group, (begin, end) in enumerate(zip(made.first[:-1], made.first[1:], strict=True)):
        np.testing.assert_array_equal(made.path[begin:end].min(axis=0), made.low[group])
        np.testing.assert_array_equal(made.path[begin:end].max(axis=0), made.high[group])
        assert np.ptp(made.path[begin:end, :2] // tlfr.GROUP_CELL, axis=0).max() == 0
    np.testing.assert_allclose(np.sort(made.colour[:, 0]), np.sort(samples.colour[:, 0]))


def test_the_radius_follows_the_spacing_of_the_samples():
    rows = np.full((20, 30), 4)
    rows[:, 15:] = 1
    first = np.concatenate([[0], np.cumsum(rows.ravel())])
    radius = tlfr.radius_of_largest_gap(first, rows.shape)
    np.testing.assert_allclose(radius[:, :10], 1.0)
    np.testing.assert_allclose(radius[:, 20:], 2.0)
    assert (np.diff(radius[3, 10:20]) > 0).sum() >= 8
    np.testing.assert_array_equal(tlfr.radius_of_largest_gap(0 * first, rows.shape), tlfr.LARGEST_RADIUS)


def test_places_fill_lens_shutter_and_pixel_evenly():
    place = tlfr.places(64, 0.25)
    assert place.shape == (16, 64, 5)
    assert np.hypot(place[..., 0], place[..., 1]).max() <= 1
    assert np.abs(place[..., 2]).max() <= 0.25
    assert np.abs(place[..., 3:]).max() <= 0.5
    variance = [0.25, 0.25, 0.5**2 / 12, 1 / 12, 1 / 12]
    np.testing.assert_allclose(place.var(axis=1), np.broadcast_to(variance, (16, 5)), rtol=0.15)
    np.testing.assert_allclose(place.mean(axis=1), 0, atol=0.05)
    assert len(np.unique(place.reshape(-1, 5), axis=0)) == 16 * 64


def test_each_square_of_pixels_has_every_pattern():
    pattern = tlfr.patterns((10, 19))
    assert pattern.shape == (10, 19)
    assert sorted(pattern[4:8, 8:12].ravel()) == list(range(16))
    assert (pattern[:4, :4] != pattern[4:8, :4]).any()


def test_layers_begin_at_even_steps_of_blur_to_both_sides_of_focus():
    near = tlfr.layers(np.array([0.1, -7.0], np.float32))
    np.testing.assert_allclose(near, [-np.inf, -5.657, -4, -2.828, -2, 2, 2.828, 4, 5.657], rtol=1e-3)
    sigma = tlfr.screen_sigma(near, 0.25)
    np.testing.assert_allclose(sigma, [1.414, 1, 0.707, 0.5, 0.001, 0.5, 0.707, 1, 1.414], rtol=1e-3)
    assert len(tlfr.layers(np.zeros(3, np.float32))) == 1


# Images of known scenes


@pytest.mark.interpreted
def test_a_plain_image_stays_what_it_is():
    rng = np.random.default_rng(7)
    see = lambda x, y, u, v, t: (np.array([0.25, 0.5, 2.0]), rng.normal(0, 9, x.shape), rng.normal(0, 9, x.shape))  # noqa: E731
    image = reconstruct(buffer(rng, 12, 14, 2, see), CAMERA, method="tlfr", settings={"views": 4})
    np.testing.assert_allclose(image, np.broadcast_to([0.25, 0.5, 2.0, 1.0], image.shape), rtol=1e-5)


@pytest.mark.parametrize(("coc", "motion"), [(0.0, 0.0), (6.0, 0.0), (-6.0, 0.0), (0.0, 24.0), (4.0, 16.0)])
def test_a_plane_is_the_integral_over_lens_and_shutter(coc, motion):
    """A striped plane: a disc damps its wave by 2 J1(k)/k, a path by a sinc."""
    wave = 2 * np.pi / 24.0

    def see(x, y, u, v, t):
        return grey(0.5 + 0.4 * np.cos(wave * (x - coc * u - motion * t))), coc, motion

    given = buffer(np.random.default_rng(6), 40, 96, 8, see)
    image = reconstruct(given, CAMERA, method="tlfr", settings={"softness": 0.0})[8:32, 24:72, 0].mean(axis=0)
    k = wave * abs(coc)
    damped = (2 * j1(k) / k if k else 1.0) * np.sinc(wave * motion * SHUTTER / (2 * np.pi))
    expected = 0.5 + 0.4 * damped * np.cos(wave * np.arange(24, 72))
    assert np.abs(image - expected).max() < 0.02


def half_plane(x, coc, motion):
    """Share of lens, shutter and pixel from which a half-plane ``x0 < 0`` is seen at x."""
    u, t, dx = np.meshgrid(np.linspace(-1, 1, 101), SHUTTER * (np.linspace(0, 1, 41) - 0.5), (np.arange(10) - 4.5) / 10)
    inside = x[:, None, None, None] + dx - coc * u - motion * t < 0
    return (inside * np.sqrt(1 - u**2)).sum(axis=(1, 2, 3)) / np.sqrt(1 - u**2).sum()


@pytest.mark.parametrize(
    ("coc", "motion", "behind"), [(-8.0, 0.0, 3.0), (0.0, 30.0, 0.0), (0.0, 0.0, 8.0), (-6.0, 24.0, 4.0)]
)
def test_a_plane_hides_another_by_its_exact_coverage(coc, motion, behind):
    """A light half-plane before a dark plane: out of focus, moving, sharp before a blurred one, and both."""

    def see(x, y, u, v, t):
        front = x - 32 - coc * u - motion * t < 0
        return grey(np.where(front, 1.0, 0.0)), np.where(front, coc, behind), np.where(front, motion, 0.0)

    given = buffer(np.random.default_rng(8), 40, 64, 4, see)
    given.depth[...] = np.where(given.radiance[..., 0] > 0, 1.0, 9.0)
    line = reconstruct(given, CAMERA, method="tlfr", settings={"softness": 0.0})[8:32, :, 0].mean(axis=0)
    error = line - half_plane(np.arange(64) - 32.0, coc, motion)
    assert np.abs(error).max() < (0.06 if coc or motion else 0.2)  # a sharp edge is as wide as the tent
    assert -0.4 < error.sum() < 0.2  # px that the light plane is narrower by: samples' triangles end within it


def two_discs(x, y, u, v):
    """SLR Fig. 6: a red disc in front of focus, a green one behind it, seen through opposite halves of the lens."""
    red = np.hypot(x + 12 * u, y + 12 * v) < 20
    green = np.hypot(x - 12 * u, y - 12 * v) < 20
    colour = np.select([red[..., None], green[..., None]], [[1.0, 0, 0], [0, 1.0, 0]], [0.0, 0, 0])
    return colour, np.select([red, green], [-12.0, 12.0], 36.0)


def test_what_hides_what_is_known_at_each_place_of_the_lens():
    """Where layers are composited by their mean opacity, what is seen beside the red disc comes out dark."""

    def see(x, y, u, v, t):
        return *two_discs(x - 32, y - 32, u, v), 0.0

    rng = np.random.default_rng(9)
    exact = np.mean([buffer(rng, 64, 64, 64, see).radiance.mean(axis=2) for _ in range(8)], axis=0)
    given = buffer(rng, 64, 64, 8, see)
    error = {
        method: (reconstruct(given, CAMERA, method=method)[..., 1] - exact[..., 1])[16:48, 16:48]
        for method in ("tlfr", "sheared")
    }
    assert abs(error["tlfr"].mean()) < 0.5 * abs(error["sheared"].mean())
    assert np.abs(error["tlfr"]).mean() < 0.03


# Edges, threads, tiles, settings


def test_a_pixel_without_any_sample_near_is_empty():
    given = buffer(np.random.default_rng(8), 12, 60, 1, lambda x, y, u, v, t: (np.ones(3), 0.2, 0.0))
    given.valid[:, 10:55] = False
    image = reconstruct(given, CAMERA, method="tlfr", settings={"views": 4})
    np.testing.assert_array_equal(image[:, 30:35], 0)
    np.testing.assert_allclose(image[:, :9], 1, rtol=1e-6)


def test_a_buffer_without_samples_is_an_empty_image():
    given = mixed(np.random.default_rng(8))
    given.valid[...] = False
    np.testing.assert_array_equal(reconstruct(given, CAMERA, method="tlfr", settings={"views": 2}), 0)


def test_the_image_is_the_same_for_any_number_of_threads_and_tiles_in_any_order():
    given = mixed(np.random.default_rng(11), 90, 70)
    settings = {"views": 4, "tile": 16}
    images = for_thread_counts(lambda: reconstruct(given, CAMERA, method="tlfr", settings=settings))
    for image in images[1:]:
        np.testing.assert_array_equal(image, images[0])
    for tile in (8, 32, 128):
        other = reconstruct(given, CAMERA, method="tlfr", settings=settings | {"tile": tile})
        np.testing.assert_allclose(other, images[0], atol=1e-5)


def test_without_an_effect_it_is_not_there():
    def see(x, y, u, v, t):
        return grey((x - 5 * u - 20 * t) // 8 % 2), 5.0, 20.0

    given = buffer(np.random.default_rng(12), 24, 64, 4, see)
    sharp = reconstruct(given, CAMERA, method="tlfr", settings={"views": 16}, defocus=False, motion=False)
    assert np.abs(sharp[12, 2:62, 0] - np.arange(2, 62) // 8 % 2).mean() < 0.12
    for options in ({"defocus": False}, {"motion": False}):
        image = reconstruct(given, CAMERA, method="tlfr", settings={"views": 16}, **options)
        assert np.abs(image - sharp).mean() > 0.1


@pytest.mark.parametrize("settings", [{"views": 8}, {"dispersion": 1.5}, {"tolerance": 3.0}, {"softness": 0.5}])
def test_every_setting_shows(settings):
    given = mixed(np.random.default_rng(13), 24, 24)
    usual = reconstruct(given, CAMERA, method="tlfr", settings={"views": 4})
    assert np.abs(reconstruct(given, CAMERA, method="tlfr", settings={"views": 4} | settings) - usual).max() > 0.01


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"settings": {"views": 0}}, "views is 0: allowed are 1 to 1024"),
        ({"settings": {"views": 2.5}}, "views is 2.5: method 'tlfr' wants int"),
        ({"settings": {"dispersion": 0}}, "dispersion is 0: allowed are 0.25 to 8"),
        ({"settings": {"softness": 2.0}}, "softness is 2.0: allowed are 0 to 1"),
        ({"settings": {"tile": 33}}, "tile is 33: allowed are multiples of 8 px from 8 to 1024"),
        ({"layers": 4}, "'layers' is no setting of method 'tlfr': allowed are views"),
        ({"integrator": "exact"}, "integrator is no option of method 'tlfr'"),
    ],
)
def test_wrong_settings_are_named(options, message):
    with pytest.raises(InvalidParameterError, match=message):
        reconstruct(mixed(np.random.default_rng(14)), CAMERA, method="tlfr", **options)


@pytest.mark.parametrize("method", ["tlfr", "sheared", "lrdm"])
def test_progress_counts_to_the_end_and_an_interrupt_stops_the_run(method):
    given = mixed(np.random.default_rng(15), 70, 40)
    told = []
    settings = {"views": 1, "tile": 8} if method == "tlfr" else {}
    reconstruct(given, CAMERA, method=method, settings=settings, progress=lambda *done: told.append(done))
    assert told == [(k + 1, told[-1][1]) for k in range(told[-1][1])]
    assert method == "lrdm" or len(told) > 4

    def interrupt(done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        reconstruct(given, CAMERA, method=method, settings=settings, progress=interrupt)
