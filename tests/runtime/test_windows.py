"""Frames whose data window is not what is displayed, and whose pixels are no squares."""

from dataclasses import replace

import numpy as np
import pytest

import spreadlets as sp
from spreadlets.precompute.models.registry import exact_psf
from spreadlets.runtime.options import Options
from spreadlets.runtime.render import reconstruct, synthesize
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.frame import Frame
from spreadlets.scene.raster import Raster, Window
from spreadlets.scene.samples import SampleBuffer

CAMERA = ThinLens(focal_length_mm=50, sensor_width_mm=36, f_number=1.4, focus_distance_m=2, shutter=(-0.25, 0.25))


def scene(height, width, seed=0):
    """A near square that moves before a far wall with lamps."""
    rng = np.random.default_rng(seed)
    radiance = rng.random((height, width, 3)).astype(np.float32)
    radiance[rng.random((height, width)) < 0.01] = 20
    depth, motion = np.full((height, width), 12.0), np.zeros((height, width, 2))
    near = slice(height // 3, height // 2), slice(width // 4, width // 2)
    depth[near], motion[near] = 1.6, (8, 3)
    return radiance, depth, motion


def test_overscan_gives_the_result_of_the_wide_frame(small_combined):
    arrays = scene(88, 112)
    wide, _ = synthesize(Frame(*arrays), replace(CAMERA, sensor_width_mm=36 * 112 / 64), small_combined)
    raster = Raster(Window(-24, -20, 112, 88), Window(0, 0, 64, 48))
    over, _ = synthesize(Frame(*arrays, raster=raster), CAMERA, small_combined)
    np.testing.assert_allclose(over, wide, atol=1e-5)


@pytest.mark.parametrize("cut", [(48, 64), (47, 61), (41, 50), (38, 35)])
@pytest.mark.parametrize("method", ["spreadlets", "dense"])
def test_a_frame_cut_from_a_wider_one_with_overscan_gives_the_wide_result(small_combined, method, cut):
    height, width, (top, left) = 208, 256, cut
    radiance, depth, motion = scene(height, width)
    radiance[40:] = 0.5 + 0.4 * np.sin(np.mgrid[40:height, :width, :3].sum(axis=0) / 40)
    depth[...], motion[...] = 12.0, 0.0  # and blocks of the wall are drawn as one
    near = slice(80, 110), slice(115, 135)
    depth[near], motion[near] = 1.6, (8, 3)
    arrays, display = (radiance, depth, motion), Window(112, 96, 32, 16)
    options, camera = Options(method=method), replace(CAMERA, f_number=0.15)
    wide_raster = Raster(Window(0, 0, width, height), display)
    wide, _ = synthesize(Frame(*arrays, raster=wide_raster), camera, small_combined, options)
    inner = slice(top, height - top), slice(left, width - left)
    raster = Raster(Window(left, top, width - 2 * left, height - 2 * top), display)
    over, _ = synthesize(Frame(*(each[inner] for each in arrays), raster=raster), camera, small_combined, options)
    rows, columns = slice(96 - top, 112 - top), slice(112 - left, 144 - left)
    difference = np.abs(over[rows, columns] - wide[inner][rows, columns]).max()
    assert difference < 1e-5


def extent(image, aspect):
    """Width and height of what a lamp became, px."""
    rows, columns = np.nonzero(image[..., 0] > 0.3 * image[..., 0].max())
    return np.ptp(columns) + 1, np.ptp(rows) + 1


@pytest.mark.parametrize("aspect", [2.0, 0.5, 1.5])
def test_bokeh_is_round_on_the_sensor(small_combined, aspect):
    radiance = np.zeros((61, 61, 3))
    radiance[30, 30] = 500
    window = Window(0, 0, 61, 61)
    frame = Frame(radiance, np.full((61, 61), 12.0), raster=Raster(window, window, aspect))
    camera = replace(CAMERA, f_number=0.25)
    exact = exact_psf(small_combined.grid.model)
    image, _ = synthesize(frame, camera, small_combined, exact_psf=exact)
    width, height = extent(image, aspect)
    radius = camera.coc_radius(12.0, 61)
    assert width == pytest.approx(2 * radius, abs=1.6) and height == pytest.approx(2 * radius * aspect, abs=1.6)
    assert image[..., 0].sum() == pytest.approx(500, rel=0.02)


@pytest.mark.parametrize("aspect", [2.0, 1.25, 0.9118, 4 / 3])
def test_the_light_of_every_pixel_counts_alike_whatever_its_shape(small_combined, aspect):
    window = Window(0, 0, 61, 61)
    camera = replace(CAMERA, f_number=0.5)
    sums = []
    for column in range(28, 34):
        radiance = np.zeros((61, 61, 3))
        radiance[30, column] = 500
        frame = Frame(radiance, np.full((61, 61), 12.0), raster=Raster(window, window, aspect))
        image, _ = synthesize(frame, camera, small_combined, exact_psf=exact_psf(small_combined.grid.model))
        sums.append(image[..., 0].sum())
    np.testing.assert_allclose(sums, 500, rtol=1e-3)
    np.testing.assert_allclose(sums, sums[0], rtol=1e-4)


@pytest.mark.parametrize("aspect", [1.25, 0.9118])
def test_a_surface_of_one_colour_stays_one_whatever_the_shape_of_its_pixels(small_combined, aspect):
    window = Window(0, 0, 61, 40)
    depth = np.full((40, 61), 12.0)
    depth[:, :30] = 3.0
    frame = Frame(np.full((40, 61, 3), 0.7), depth, raster=Raster(window, window, aspect))
    image, _ = synthesize(frame, replace(CAMERA, f_number=0.5), small_combined)
    np.testing.assert_allclose(image[..., :3], 0.7, atol=1e-4)


def samples_of(radiance, depth, motion, seed=1, raster=None):
    """Four samples of each pixel of a scene, over lens and shutter."""
    rng = np.random.default_rng(seed)
    arrays = [np.repeat(each[:, :, None], 4, axis=2) for each in (radiance, depth, motion)]
    shape = arrays[0].shape[:3]
    radius, angle = np.sqrt(rng.random(shape)), rng.uniform(0, 2 * np.pi, shape)
    lens_uv = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=3)
    return SampleBuffer(*arrays, lens_uv, rng.uniform(-0.25, 0.25, shape), raster=raster)


def test_samples_with_overscan_give_the_result_of_the_wide_buffer(small_combined):
    arrays = scene(60, 80)
    wide, _ = reconstruct(samples_of(*arrays), replace(CAMERA, sensor_width_mm=36 * 80 / 64), small_combined)
    raster = Raster(Window(-8, -6, 80, 60), Window(0, 0, 64, 48))
    over, _ = reconstruct(samples_of(*arrays, raster=raster), CAMERA, small_combined)
    np.testing.assert_allclose(over, wide, atol=1e-5)


@pytest.mark.parametrize("method", ["mean", "spreadlets", "lrdm", "axis-aligned"])
def test_samples_of_pixels_that_are_no_squares_give_the_picture_of_the_squares(small_combined, method):
    """Each pixel of aspect 2 stands for two squares that show the same."""
    radiance, depth, motion = scene(40, 30)
    window = Window(0, 0, 30, 40)
    samples = samples_of(radiance, depth, motion, raster=Raster(window, window, 2.0))
    image = sp.reconstruct(samples, CAMERA, str(small_combined.path), method=method)
    double = [np.repeat(each, 2, axis=1) for each in (samples.radiance, samples.depth, samples.lens_uv, samples.time)]
    moved = np.repeat(samples.motion, 2, axis=1) * (2, 1)
    squares = SampleBuffer(double[0], double[1], moved, double[2], double[3])
    expected = sp.reconstruct(squares, CAMERA, str(small_combined.path), method=method)
    np.testing.assert_allclose(image, 0.5 * (expected[:, ::2] + expected[:, 1::2]), atol=1e-5)
