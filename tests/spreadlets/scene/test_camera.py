import json
import math

import numpy as np
import pytest

from spreadlets.errors import InvalidCameraError, InvalidParameterError
from spreadlets.scene.camera import ThinLens

VALUES = {
    "focal_length_mm": 85.0,
    "sensor_width_mm": 36.0,
    "f_number": 0.2125,
    "focus_distance_m": 6.0,
    "shutter_open_close_frames": [-0.25, 0.25],
}

# Aperture diameter times focal length in px of the sample cameras, as the renderer states them: twice the coc scale.
RENDERER_SCALES_PX_M = [
    ((85.0, 36.0, 0.2125, 6.0), 483.55554199218795),
    ((85.0, 36.0, 0.28, 8.0), 366.98412542170144),
    ((60.0, 36.0, 0.075, 5.6), 682.6666395399317),
]


def lens(**changes):
    arguments = {"focal_length_mm": 85.0, "sensor_width_mm": 36.0, "f_number": 0.2125, "focus_distance_m": 6.0}
    return ThinLens(**{**arguments, **changes})


def write_json(path, **changes):
    content = {key: value for key, value in {**VALUES, **changes}.items() if value is not ...}
    path.write_text(json.dumps(content))
    return path


@pytest.mark.parametrize(("numbers", "scale"), RENDERER_SCALES_PX_M)
def test_coc_matches_the_renderers_scale(numbers, scale):
    camera = ThinLens(*numbers)
    depth = np.array([1.0, 3.7, 26.0])
    expected = 0.5 * scale * (1 / numbers[3] - 1 / depth)
    np.testing.assert_allclose(camera.coc_radius(depth, 512), expected, rtol=1e-6)


def test_coc_is_negative_in_front_zero_in_focus_and_bounded_behind():
    camera = lens()
    front, focus, behind, background = camera.coc_radius(np.array([2.0, 6.0, 50.0, np.inf]), 512)
    assert front < 0 == focus < behind < background
    assert background == pytest.approx(camera.coc_scale(512) / 6.0)


def test_coc_is_proportional_to_the_image_width():
    assert lens().coc_radius(2.0, 1024) == pytest.approx(2 * lens().coc_radius(2.0, 512))


def test_textbook_model_scales_by_zf_over_zf_minus_f():
    textbook = lens(lens_model="textbook")
    np.testing.assert_allclose(textbook.coc_radius(2.0, 512), lens().coc_radius(2.0, 512) * 6.0 / (6.0 - 0.085))


@pytest.mark.parametrize("model", ["renderer", "textbook"])
def test_focus_at_infinity_blurs_only_what_is_near(model):
    camera = lens(focus_distance_m=math.inf, lens_model=model)
    near, background = camera.coc_radius(np.array([2.0, np.inf]), 512)
    assert near == pytest.approx(-0.5 * 0.4 * 85 / 36 * 512 / 2.0)
    assert background == 0


@pytest.mark.parametrize(
    ("dtype", "expected"), [(np.float16, np.float32), (np.float32, np.float32), (np.float64, np.float64)]
)
def test_coc_keeps_shape_and_precision(dtype, expected):
    radius = lens().coc_radius(np.full((2, 3), 4, dtype), 512)
    assert radius.shape == (2, 3)
    assert radius.dtype == expected


@pytest.mark.parametrize("width", [0, -5])
def test_image_width_must_be_positive(width):
    with pytest.raises(InvalidParameterError, match="image_width"):
        lens().coc_radius(1.0, width)


def test_shutter_duration_and_centre():
    camera = lens(shutter=(-0.1, 0.5))
    assert camera.shutter_duration == pytest.approx(0.6)
    assert camera.shutter_centre == pytest.approx(0.2)
    assert lens(shutter=(0.5, 0.5)).shutter_duration == 0


@pytest.mark.parametrize("key", ["focal_length_mm", "sensor_width_mm", "f_number"])
@pytest.mark.parametrize("value", [0, -1.0, math.nan, math.inf, "85", True, None, 10**400])
def test_impossible_optics_are_refused(key, value):
    with pytest.raises(InvalidCameraError, match=key):
        lens(**{key: value})


@pytest.mark.parametrize("focus", [0.085, 0.01, 0, -3, -math.inf])
def test_focus_inside_the_focal_length_is_refused(focus):
    with pytest.raises(InvalidCameraError, match="inside the focal length"):
        lens(focus_distance_m=focus)


@pytest.mark.parametrize("shutter", [(0.25, -0.25), (0, math.inf), (math.nan, 0), ("0", 1), (0,), 0.5])
def test_impossible_shutters_are_refused(shutter):
    with pytest.raises(InvalidCameraError, match="shutter"):
        lens(shutter=shutter)


def test_unknown_lens_models_are_refused_with_the_allowed_ones():
    with pytest.raises(InvalidCameraError, match=r"pinhole.*renderer, textbook"):
        lens(lens_model="pinhole")


@pytest.mark.parametrize(
    ("fit", "shape", "width"),
    [
        ("horizontal", (160, 90), 36),
        ("auto", (160, 90), 20.25),
        ("auto", (90, 160), 36),
        ("vertical", (90, 160), 24 * 160 / 90),
        ("vertical", (160, 90), 24 * 90 / 160),
    ],
)
def test_the_sensor_spans_the_side_that_its_fit_says(fit, shape, width):
    camera = lens(sensor_width_mm=36.0, sensor_height_mm=24.0, sensor_fit=fit).fitted(shape)
    assert camera.sensor_width_mm == pytest.approx(width) and camera.sensor_fit == "horizontal"


def test_pixels_that_are_not_square_count_in_the_fit():
    assert lens(sensor_width_mm=36.0, sensor_fit="auto").fitted((100, 60), 2.0).sensor_width_mm == 36


def test_a_camera_that_was_not_fitted_makes_no_circles():
    with pytest.raises(InvalidParameterError, match="take camera.fitted"):
        lens(sensor_fit="auto").coc_radius(2.0, 100)


def test_unknown_fits_and_impossible_heights_are_refused():
    with pytest.raises(InvalidCameraError, match="sensor_fit is 'wide'; allowed are horizontal, vertical, auto"):
        lens(sensor_fit="wide")
    with pytest.raises(InvalidCameraError, match="sensor_height_mm is 0"):
        lens(sensor_height_mm=0.0)
