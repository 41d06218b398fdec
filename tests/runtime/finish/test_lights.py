"""Lights: the highlights of samples, drawn past what hides them."""

import numpy as np
import pytest
from naive.lights import clear_shares, points_through

from spreadlets.api import reconstruct
from spreadlets.parallel import limit_threads
from spreadlets.runtime.finish import _light_kernels
from spreadlets.runtime.finish._light_kernels import ACROSS, Cells, Points
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.samples import SampleBuffer

SIZE = 80
CAMERA = ThinLens(
    focal_length_mm=50.0, sensor_width_mm=36.0, f_number=0.02, focus_distance_m=4.0, shutter=(-0.25, 0.25)
)
LAMP, LAMP_RADIUS, LIGHT = np.array([38.3, 41.6]), 2.2, 300.0
"""Place without lens at mid-shutter, (x, y), and radius, px; its radiance."""
LAMP_COC, POST_COC, WALL_COC = 9.5, -7.0, 10.5
EDGE = 39.0
"""What lies before this column is the post, px."""
WALL, POST = 0.02, 0.05


def depth_of(coc):
    return 1.0 / (1.0 / CAMERA.focus_distance_m - np.asarray(coc) / CAMERA.coc_scale(SIZE))


def seen(place, lens, time, post_path, lamp_path):
    """What rays meet: 0 the post, 1 the lamp, 2 the wall; places in px, times in shutters from mid-shutter."""
    at_post = place[..., 0] - POST_COC * lens[..., 0] - post_path * time
    at_lamp = place - LAMP_COC * lens - np.stack([lamp_path * time, 0.0 * time], axis=-1) - LAMP
    lit = (at_lamp**2).sum(axis=-1) < LAMP_RADIUS**2
    return np.where(at_post < EDGE, 0, np.where(lit, 1, 2))


def on_lens(first, second):
    radius, angle = np.sqrt(first), 2 * np.pi * second
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)


def drawn_samples(count, post_path=0.0, lamp_path=0.0, seed=0, light=LIGHT, valid=None):
    """A lamp before a wall, and before both a post, as rays through random places on lens and shutter see them."""
    rng, shape = np.random.default_rng(seed), (SIZE, SIZE, count)
    offset, lens = rng.uniform(-0.5, 0.5, (*shape, 2)), on_lens(rng.random(shape), rng.random(shape))
    time = rng.uniform(-0.5, 0.5, shape)
    centre = np.stack(np.meshgrid(np.arange(SIZE), np.arange(SIZE)), axis=-1)[:, :, None]
    met = seen(centre + offset, lens, time, post_path, lamp_path)
    motion = np.zeros((*shape, 2))
    motion[..., 0] = np.choose(met, [post_path, lamp_path, 0.0]) / CAMERA.shutter_duration
    radiance = np.repeat(np.choose(met, [POST, light, WALL])[..., None], 3, axis=-1)
    depth = depth_of(np.choose(met, [POST_COC, LAMP_COC, WALL_COC]))
    where = {"lens_uv": lens, "time": time * CAMERA.shutter_duration, "offset": offset}
    return SampleBuffer(radiance, depth, motion, **where, valid=valid)


def truth(post_path=0.0, lamp_path=0.0):
    """The same from 4096 rays in each pixel, spread evenly over lens, shutter and pixel."""
    number = np.arange(4096)
    golden = 1.0 / 1.2207440846057596 ** np.arange(1, 6)
    first, second, third, across, down = np.mod(0.5 + number[:, None] * golden, 1.0).T
    lens, offset, time = on_lens(first, second), np.stack([across, down], axis=-1) - 0.5, third - 0.5
    image = np.empty((SIZE, SIZE))
    for row in range(SIZE):
        place = np.stack([np.arange(SIZE), np.full(SIZE, row)], axis=-1)[:, None] + offset
        met = seen(place, lens[None], np.broadcast_to(time, place.shape[:2]), post_path, lamp_path)
        image[row] = np.choose(met, [POST, LIGHT, WALL]).mean(axis=1)
    return image


def shares(image):
    """How the light of an image is shared out among its pixels."""
    excess = np.asarray(image, np.float64) - min(WALL, POST)
    return excess / excess.sum()


# Their lights as splats of layers: .44, .32, .35.
@pytest.mark.parametrize(("post_path", "lamp_path", "most"), [(0.0, 0.0, 0.25), (14.0, 0.0, 0.17), (0.0, 9.0, 0.25)])
def test_a_post_cuts_the_bokeh_of_a_lamp_as_the_lens_sees_it(small_combined, post_path, lamp_path, most):
    image = reconstruct(drawn_samples(4, post_path, lamp_path), CAMERA, small_combined)[..., 0]
    # How much light there is depends on how many samples have met the lamp: what counts is where it goes.
    assert np.abs(shares(image) - shares(truth(post_path, lamp_path))).sum() < most


@pytest.mark.parametrize("count", [1, 3])
def test_a_lamp_has_the_light_that_its_samples_have(small_combined, count):
    valid = np.ones((SIZE, SIZE, count), bool)
    valid[::2, :, 1:] = False
    samples = drawn_samples(count, valid=valid)
    image, dark = (
        reconstruct(each, CAMERA, small_combined, calibrate=False)
        for each in (samples, drawn_samples(count, light=0.0, valid=valid))
    )
    # Each pixel is the mean of its samples.
    mean = (samples.radiance[..., 0] == LIGHT).sum(axis=2) / valid.sum(axis=2)
    light = (image - dark)[..., 0].sum(dtype=np.float64)
    assert light == pytest.approx(LIGHT * mean.sum(), rel=1e-3)


def test_the_image_is_the_same_for_any_number_of_threads(small_combined):
    samples = drawn_samples(1, post_path=6.0)
    with limit_threads(1):
        alone = reconstruct(samples, CAMERA, small_combined)
    np.testing.assert_array_equal(reconstruct(samples, CAMERA, small_combined), alone)


def random_case(seed, moves):
    """A light, and samples about it in cells of 8 px, as kernels take them."""
    rng = np.random.default_rng(seed)
    light = np.array([[30.2, 25.7, 9.0, 8.0 * moves, -4.0 * moves]], np.float32)
    samples = np.concatenate(
        [
            rng.uniform(16, 40, (300, 2)),
            rng.uniform(-9, 9, (300, 1)),
            moves * rng.uniform(-12, 12, (300, 2)),
            rng.random((300, 1)),
        ],
        axis=1,
    ).astype(np.float32)
    number = samples[:, 1].astype(int) // 8 * 8 + samples[:, 0].astype(int) // 8
    samples = samples[np.argsort(number, kind="stable")]
    start = np.concatenate([[0], np.cumsum(np.bincount(number, minlength=64))])
    return light, samples, Cells(samples, start, 8, 8, 0)


@pytest.mark.interpreted
@pytest.mark.parametrize("moves", [0.0, 1.0])
def test_what_is_hidden_and_what_is_drawn_are_those_of_plain_numpy(moves):
    light, samples, cells = random_case(0, moves)
    clear, hides = np.empty((1, ACROSS, ACROSS), np.float32), np.zeros(1, np.bool_)
    _light_kernels.clear_shares(0, 1, light, np.array([60]), cells, 0.8, 1000, clear, hides)
    expected = clear_shares(light[0], samples, 0.8)
    assert hides[0]
    assert 0.1 < expected.mean() < 0.9
    np.testing.assert_allclose(clear[0], expected, atol=1e-5)
    # Draw some points of a PSF past that.
    offset_rc = np.argwhere(np.hypot(*np.indices((15, 15)) - 7) < 7).astype(np.int32) - 7
    points = Points(
        offset_rc, np.full((len(offset_rc), 1), 1 / len(offset_rc), np.float32), np.array([0, len(offset_rc)])
    )
    group, scale, place = np.zeros(1, np.int64), np.empty(1, np.float32), np.array([[20.0, 18.0]], np.float32)
    _light_kernels.light_scales(0, 1, group, light, clear, hides, group, points, scale)
    image, colour = np.zeros((40, 40, 4), np.float32), np.array([[1.0, 2.0, 3.0]], np.float32)
    for begin, end in ((0, 19), (19, 40)):
        _light_kernels.add_lights(begin, end, place, colour, group, light, clear, group, points, scale, image)
    drawn = np.zeros((40, 40))
    drawn[tuple((offset_rc + (18, 20)).T)] = points_through(light[0], expected, offset_rc, points.value[:, 0])
    np.testing.assert_allclose(image, drawn[..., None] * np.array([1.0, 2.0, 3.0, 0.0]), atol=1e-5)


@pytest.mark.interpreted
def test_of_many_samples_every_so_many_th_stands_for_those_between():
    light, samples, cells = random_case(1, 0.0)
    clear, hides = np.empty((1, ACROSS, ACROSS), np.float32), np.zeros(1, np.bool_)
    _light_kernels.clear_shares(0, 1, light, np.array([60]), cells, 0.8, 150, clear, hides)
    np.testing.assert_allclose(clear[0], clear_shares(light[0], samples[::3], 0.8 / 3), atol=1e-5)
