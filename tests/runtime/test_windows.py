"""Frames whose data window is not what is displayed, and whose pixels are no squares."""

from dataclasses import replace

import numpy as np
import pytest

from spreadlets.precompute.models.registry import exact_psf
from spreadlets.runtime.options import Options
from spreadlets.runtime.render import synthesize
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.frame import Frame
from spreadlets.scene.raster import Raster, Window

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


@pytest.mark.parametrize("method", ["spreadlets", "dense"])
def test_a_frame_cut_from_a_wider_one_with_overscan_gives_the_wide_result(small_combined, method):
    height, width, cut = 208, 256, 64  # what is hidden is filled on a grid of powers of two
    arrays = scene(height, width)
    display = Window(112, 96, 32, 16)
    options = Options(method=method)
    wide_raster = Raster(Window(0, 0, width, height), display)
    wide, _ = synthesize(Frame(*arrays, raster=wide_raster), CAMERA, small_combined, options)
    inner = slice(cut, height - cut), slice(cut, width - cut)
    raster = Raster(Window(cut, cut, width - 2 * cut, height - 2 * cut), display)
    over, _ = synthesize(Frame(*(each[inner] for each in arrays), raster=raster), CAMERA, small_combined, options)
    rows, columns = slice(96 - cut, 112 - cut), slice(112 - cut, 144 - cut)
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
