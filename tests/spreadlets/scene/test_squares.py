"""Pixels of every shape as squares, and back."""

import numpy as np
import pytest

from spreadlets.errors import InvalidFrameError
from spreadlets.scene.frame import Frame
from spreadlets.scene.raster import Raster, Window
from spreadlets.scene.squares import Grid, repeated, squared, unsquared


@pytest.mark.parametrize(
    ("aspect", "squares"),
    [(2, (2, 1)), (0.5, (1, 2)), (1.5, (3, 2)), (2 / 3, (2, 3)), (1.01, (1, 1)), (1.25, (2.5, 2)), (4 / 3, (4, 3))],
)
def test_squares_of_a_pixel(aspect, squares):
    assert Grid.of(aspect).per_pixel == squares


ASPECTS = [2.0, 0.5, 1.5, 0.667, 1.0940, 0.9118, 1.4587, 1.2121, 1.25, 0.8, 1.0667]


@pytest.mark.parametrize("aspect", ASPECTS)
def test_the_picture_comes_back_and_has_the_shape_that_is_displayed(aspect):
    rng = np.random.default_rng(0)
    raster = Raster(Window(-2, 1, 23, 17), Window(0, 0, 20, 18), aspect)
    frame = Frame(rng.random((17, 23, 3)), rng.random((17, 23)) + 1, rng.random((17, 23, 2)), raster=raster)
    squares = squared(frame)
    height, width = squares.shape
    assert width / height == pytest.approx(aspect * 23 / 17, rel=0.05) and squares.raster.data.shape == (height, width)
    np.testing.assert_allclose(unsquared(squares.radiance, raster), frame.radiance, atol=1e-6)
    across, down = Grid.of(aspect).per_pixel
    np.testing.assert_allclose(squares.motion[0, 0], frame.motion[0, 0] * (across, down), rtol=1e-5)
    centre = frame.raster.off_middle
    np.testing.assert_allclose(squares.raster.off_middle, (centre[0] * across, centre[1] * down), atol=1)


@pytest.mark.parametrize("aspect", ASPECTS)
def test_every_pixel_has_the_same_number_of_squares_of_nearly_its_shape(aspect):
    raster = Raster(Window(-7, 3, 30, 20), Window(0, 0, 30, 20), aspect)
    number = np.arange(600.0).reshape(20, 30) + 1
    squares = squared(Frame(np.ones((20, 30, 3)), number, raster=raster)).depth
    _, counts = np.unique(squares, return_counts=True)
    inner = counts.reshape(20, 30)[1:-1, 1:-1]  # the last of a row has those that are left
    grid = Grid.of(aspect)
    assert (inner == grid.count).all()
    assert grid.count / grid.divisions**2 == pytest.approx(max(aspect, 1 / aspect), rel=0.02)


def test_squares_lie_where_they_do_in_a_wider_window():
    values = np.random.default_rng(0).random((20, 40)).astype(np.float32)
    grid = Grid.of(1.094)
    whole, part = Window(-11, 0, 40, 20), Window(-4, 2, 20, 10)
    inner = repeated(values[2:12, 7:27], grid, part)
    offset = grid.window(part).left - grid.window(whole).left, grid.window(part).top - grid.window(whole).top
    same = repeated(values, grid, whole)[offset[1] : offset[1] + inner.shape[0], offset[0] : offset[0] + inner.shape[1]]
    np.testing.assert_array_equal(inner[:, 1:-1], same[:, 1:-1])


def test_square_pixels_are_left_alone():
    frame = Frame(np.ones((3, 4, 3)), np.ones((3, 4)))
    assert squared(frame) is frame


@pytest.mark.parametrize("aspect", [0.0, -1.0, np.nan, np.inf, 100.0, 1e-5])
def test_a_pixel_of_an_impossible_shape_is_refused(aspect):
    with pytest.raises(InvalidFrameError, match="pixel aspect ratio"):
        Raster(Window(0, 0, 2, 2), Window(0, 0, 2, 2), aspect)
