"""Parts of a frame: smaller ones, and what is seen."""

import numpy as np
import pytest

import spreadlets as sp
from spreadlets.scene.parts import means, seen_depth, smaller, smaller_raster
from spreadlets.scene.raster import Raster, Window


@pytest.mark.parametrize("shape", [(6, 8), (5, 7), (12, 16), (1, 1)])
def test_means_keep_the_light_and_a_constant(shape):
    values = np.random.default_rng(0).random((12, 16, 3)).astype(np.float32)
    found = means(values, shape)
    assert found.shape == (*shape, 3) and found.dtype == np.float32
    np.testing.assert_allclose(found.mean(axis=(0, 1)), values.mean(axis=(0, 1)), rtol=1e-5)
    np.testing.assert_allclose(means(np.full((12, 16), 0.7, np.float32), shape), 0.7, rtol=1e-6)


def test_means_are_those_of_the_area_that_a_pixel_covers():
    values = np.array([[0.0, 3.0, 6.0]], np.float32)
    np.testing.assert_allclose(means(values, (1, 2)), [[1.0, 5.0]])


def test_a_smaller_frame_has_the_same_depths_and_motion_in_its_own_pixels():
    depth = np.where(np.arange(60) < 30, 2.0, 5.0) * np.ones((40, 1))
    motion = np.broadcast_to(np.array([4.0, -2.0]), (40, 60, 2))
    paths = {"motion_prev": motion, "motion_next": 2 * motion, "depth_prev": depth, "depth_next": depth + 1}
    (layer,) = smaller(sp.Frame(np.ones((40, 60, 3)), depth, **paths), 0.5).layers
    np.testing.assert_array_equal(layer.depth_prev, layer.depth)
    np.testing.assert_array_equal(layer.depth_next, layer.depth + 1)
    assert layer.shape == (20, 30) and set(np.unique(layer.depth)) == {2.0, 5.0}
    np.testing.assert_allclose(layer.motion_prev[3, 4], [2.0, -1.0])
    np.testing.assert_allclose(layer.motion_next[3, 4], [4.0, -2.0])


def test_windows_shrink_about_the_origin_and_the_whole_stays_itself():
    raster = Raster(Window(-8, -4, 116, 72), Window(0, 0, 100, 64))
    assert smaller_raster(raster, 0.25) == Raster(Window(-2, -1, 29, 18), Window(0, 0, 25, 16))
    frame = sp.Frame(np.ones((4, 4, 3)), np.ones((4, 4)))
    assert smaller(frame, 1.0) is frame


def test_seen_is_the_first_layer_that_covers_half():
    colours = np.zeros((1, 3, 4))
    colours[0, :, 3] = 0.0, 0.4, 0.6
    layers = [sp.Frame(colours, np.full((1, 3), 1.0)), sp.Frame(np.ones((1, 3, 3)), np.full((1, 3), 2.0))]
    assert seen_depth(sp.Frame.from_layers(layers)).tolist() == [[2.0, 2.0, 1.0]]
