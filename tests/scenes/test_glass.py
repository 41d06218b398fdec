"""The lens that the renderer sees through: forwards, backwards, and beside the product's own."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest

import spreadlets as sp
from spreadlets.precompute.models import physicallens

SCENES = Path(__file__).resolve().parents[2] / "scenes"
sys.path.insert(0, str(SCENES))
from glass import Lens  # noqa: E402  (scripts, not a package)
from glass_camera import colour_matrix, gain, matching, part_of_pupil, source  # noqa: E402
from shot import LENSES  # noqa: E402

FOCAL_MM, F_NUMBER, FOCUS_M = 85.0, 2.1, 2.0


@pytest.fixture(scope="module")
def lens():
    return Lens.focused(LENSES / "double_gauss.txt", FOCAL_MM, F_NUMBER, FOCUS_M)


def rays(lens, slope, distance_mm, count=400):
    """Return places on the entrance pupil and slopes of rays from a point of the scene."""
    pupil = np.random.default_rng(0).uniform(-1, 1, (count, 2)) * 0.7 * lens.entrance_radius_mm
    return pupil, np.array(slope) + pupil / distance_mm


def test_paraxial_figures_are_those_of_the_product(lens):
    camera = sp.ThinLens(FOCAL_MM, 36.0, F_NUMBER, FOCUS_M)
    product = physicallens.focused_lens(physicallens.read_settings(lens="double_gauss", camera=camera, width=256))
    assert lens.entrance_mm == pytest.approx(product.pupil_distance, rel=1e-9)
    assert lens.entrance_radius_mm == pytest.approx(product.pupil_radius, rel=1e-9)
    assert lens.sensor_mm == pytest.approx(product.sensor_distance, rel=1e-6)
    # In light of another wavelength.
    assert lens.image_scale_mm == pytest.approx(product.chief_scale, rel=2e-5)


def test_a_point_in_focus_is_a_point_on_the_sensor(lens):
    places, _, passed = lens.to_sensor(*rays(lens, (0.0, 0.0), 1000 * FOCUS_M), 550.0)
    pixel_mm = 36 / 1024
    assert passed.mean() > 0.9
    assert np.sqrt((places[passed] ** 2).sum(axis=1).mean()) < pixel_mm


@pytest.mark.parametrize("distance_mm", [700.0, 2000.0, 30000.0])
def test_rays_from_the_sensor_go_back_the_same_way(lens, distance_mm):
    pupil, slope = rays(lens, (0.12, -0.07), distance_mm)
    places, through, passed = lens.to_sensor(pupil, slope, 523.0)
    origins, directions, back = lens.from_sensor(places, through, 523.0)
    both = passed & back
    assert both.sum() > 100 and (passed == back).mean() > 0.99
    met = origins + directions * ((distance_mm / 1000 - origins[:, 2]) / directions[:, 2])[:, None]
    expected = np.array([0.12, -0.07]) * distance_mm / 1000
    assert np.abs(met[both, :2] - expected).max() < 1e-9 * distance_mm


def test_rays_that_meet_a_rim_do_not_pass(lens):
    through = np.array([[0.0, 0.0], [1.5, 0.0]])
    assert lens.from_sensor(np.zeros((2, 2)), through, 550.0)[2].tolist() == [True, False]


def test_an_even_spectrum_is_white():
    nm = np.arange(400, 700, 1.0) + 0.5
    assert colour_matrix() @ matching(nm).mean(axis=1) == pytest.approx(1, rel=1e-3)


@pytest.mark.parametrize("slope", [(0.0, 0.0), (0.1, 0.05), (-0.18, 0.1)])
def test_a_lamp_shines_through_the_part_of_the_pupil_that_is_foretold(lens, slope):
    place = (10 * slope[0], 10 * slope[1], 10.0)
    x, y, scale, radius = part_of_pupil(lens, place, 0.01, focus_m=None)
    places, through, passed = lens.to_sensor(*rays(lens, slope, 10_000.0), 550.0)
    assert passed.sum() > 100 and radius < 0.3
    assert np.hypot(*((places - [x, y]) * scale - through)[passed].T).max() < radius


def test_a_thin_lens_sees_a_lamp_as_its_circle_of_confusion_says(lens):
    x, y, scale, _ = part_of_pupil(lens, (1.0, 0.5, 10.0), 0.01, focus_m=FOCUS_M)
    coc_mm = lens.entrance_radius_mm * lens.image_scale_mm * (1 / FOCUS_M - 1 / 10.0) / 1000
    assert (x, y) == pytest.approx((0.1 * lens.image_scale_mm, 0.05 * lens.image_scale_mm))
    assert 1 / scale == pytest.approx(-coc_mm)


def test_the_source_knows_every_constant_it_names(lens):
    part = part_of_pupil(lens, (1.0, 0.5, 10.0), 0.01, focus_m=None)
    text = source(lens, 0.625, [part, part], focus_m=None)
    head, body = text.split("//", 1)
    defined = {line.split()[1] for line in head.splitlines()}
    named = {word for word in re.findall(r"\b[A-Z][A-Z_]{2,}\b", body)} - {"THIN"}
    assert named - defined <= {"NAME", "M_2PI"}, named - defined
    assert gain(lens) > 1
