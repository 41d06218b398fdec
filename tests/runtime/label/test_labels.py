import numpy as np
import pytest

from spreadlets.psf.model import get_model
from spreadlets.runtime.label.labels import HEADINGS, Labels, View, coordinates, ignored_effects, view_differences
from spreadlets.scene.camera import ThinLens

DEPTH = np.array([[2.0, 3.0, 4.0], [5.0, np.inf, 7.0]], np.float32)


def labels(coc=-3.0, path=(6.0, 8.0)):
    ones = np.ones_like(DEPTH)
    length = np.float32(np.hypot(*path)) * ones
    return Labels(np.float32(coc) * ones, ones[..., None] * np.float32(path), length, None, View(DEPTH, 2.0, 0.5))


@pytest.mark.parametrize(
    "name, expected",
    [
        ("simplelens", [3.0]),
        ("combined", [3.0, 10.0]),
        ("stylized", [3.0]),
        # The first pixel lies at (-1, -0.5) px from the centre, which is seen 2 px away.
        ("volume", [2.0 * np.sqrt(1 + 1.25 / 4)]),
        ("physicallens", [3.0, 0.5 * np.sqrt(1.25)]),
    ],
)
def test_coordinates_of_every_model(name, expected):
    found = coordinates(labels(), get_model(name))
    assert all(each.shape == (2, 3) and each.dtype == np.float32 for each in found)
    np.testing.assert_allclose([abs(each[0, 0]) for each in found], expected, rtol=1e-6)


def test_distance_of_the_background_is_infinite():
    assert np.isinf(coordinates(labels(), get_model("volume"))[0][1, 1])


def test_directions_are_those_of_motion_and_of_the_place():
    np.testing.assert_array_equal(HEADINGS["motion"](labels())[1, 2], [6.0, 8.0])
    place = HEADINGS["azimuth"](labels())
    np.testing.assert_array_equal(place[0], [[-1.0, -0.5], [0.0, -0.5], [1.0, -0.5]])


@pytest.mark.parametrize("size, block", [(100, 1), (200, 2), (500, 4)])
def test_pixels_of_a_block_have_one_place_on_the_lens(size, block):
    view = View(np.ones((8, size), np.float32), 1.0, 0.5)
    coarse, place = view.block_position(), view.position()
    assert np.array_equal(coarse, coarse[::block, ::block].repeat(block, 0).repeat(block, 1)[:8, :size])
    assert len(np.unique(coarse[0, :, 0])) == size // block
    assert np.abs(coarse - place).max() == 0.5 * (block - 1)


@pytest.mark.parametrize(
    "name, ignored",
    [
        ("simplelens", ["motion"]),
        ("combined", []),
        ("physicallens", ["motion"]),
        ("volume", ["coc", "motion"]),
        ("stylized", ["motion"]),
    ],
)
def test_effects_that_a_model_cannot_show_are_named(name, ignored):
    assert ignored_effects(labels(), get_model(name)) == [(effect, 1.0) for effect in ignored]
    assert ignored_effects(labels(coc=0.0, path=(0.0, 0.0)), get_model(name)) == []


def test_another_camera_is_told_by_what_differs():
    view = {"focal_length_mm": 50.0, "f_number": 2.0, "focus_per_m": 0.5, "width_px": 512, "sensor_width_mm": 36.0}
    model = get_model("physicallens", settings={"view": view})
    camera = ThinLens(focal_length_mm=50.0, sensor_width_mm=36.0, f_number=2.01, focus_distance_m=2.0)
    assert view_differences(model, camera, 512) == []
    other = ThinLens(focal_length_mm=50.0, sensor_width_mm=36.0, f_number=4.0, focus_distance_m=np.inf)
    assert view_differences(model, other, 1024) == [
        "f_number is 4, built for 2",
        "focus_per_m is 0, built for 0.5",
        "width_px is 1024, built for 512",
    ]
