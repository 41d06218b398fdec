"""Pixels of every shape as squares, and back."""

import numpy as np
import pytest

from spreadlets.errors import InvalidFrameError
from spreadlets.scene.frame import Frame
from spreadlets.scene.raster import Raster, Window
from spreadlets.scene.squares import squared, squares_per_pixel, unsquared


@pytest.mark.parametrize(
    ("aspect", "squares"), [(2, (2, 1)), (0.5, (1, 2)), (1.5, (3, 2)), (2 / 3, (2, 3)), (1.01, (1, 1)), (1.1, (2.2, 2))]
)
def test_squares_of_a_pixel(aspect, squares):
    assert squares_per_pixel(aspect) == pytest.approx(squares)


@pytest.mark.parametrize("aspect", [2.0, 0.5, 1.5, 0.667, 1.0940, 0.9091])
def test_the_picture_comes_back_and_has_the_shape_that_is_displayed(aspect):
    rng = np.random.default_rng(0)
    raster = Raster(Window(-2, 1, 23, 17), Window(0, 0, 20, 18), aspect)
    frame = Frame(rng.random((17, 23, 3)), rng.random((17, 23)) + 1, rng.random((17, 23, 2)), raster=raster)
    squares = squared(frame)
    height, width = squares.shape
    assert width / height == pytest.approx(aspect * 23 / 17, rel=0.03) and squares.raster.data.shape == (height, width)
    np.testing.assert_allclose(unsquared(squares.radiance, raster), frame.radiance, atol=1e-6)
    across, down = squares_per_pixel(aspect)
    np.testing.assert_allclose(squares.motion[0, 0], frame.motion[0, 0] * (across, down), rtol=1e-5)
    centre = frame.raster.off_middle
    np.testing.assert_allclose(squares.raster.off_middle, (centre[0] * across, centre[1] * down), atol=1.5)


def test_square_pixels_are_left_alone():
    frame = Frame(np.ones((3, 4, 3)), np.ones((3, 4)))
    assert squared(frame) is frame


@pytest.mark.parametrize("aspect", [0.0, -1.0, np.nan, np.inf, 100.0, 1e-5])
def test_a_pixel_of_an_impossible_shape_is_refused(aspect):
    with pytest.raises(InvalidFrameError, match="pixel aspect ratio"):
        Raster(Window(0, 0, 2, 2), Window(0, 0, 2, 2), aspect)
