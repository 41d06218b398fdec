"""Shutter curves."""

import numpy as np
import pytest

from spreadlets.errors import InvalidCameraError, InvalidParameterError
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.shutter import read_curve, shutter_shares


@pytest.mark.parametrize("curve", [(0.0, 1.0), (1.0, 0.2, 0.0, 0.0, 1.0), "trapezoid:0.3,0.1"])
@pytest.mark.parametrize("count", [1, 2, 5, 64])
def test_shares_are_the_integral_of_the_curve(curve, count):
    known = read_curve(curve)
    fine = np.interp((np.arange(64000) + 0.5) / 64000, np.linspace(0, 1, len(known)), known)
    expected = fine.reshape(count, -1).sum(axis=1) / fine.sum()
    assert shutter_shares(curve, count) == pytest.approx(expected, abs=1e-6)
    assert shutter_shares(curve, count).sum() == pytest.approx(1.0)


def test_a_camera_keeps_its_curve_as_numbers_and_none_that_says_nothing():
    assert ThinLens(50, 36, 2, 3, shutter_curve="0,1").shutter_curve == (0.0, 1.0)
    assert ThinLens(50, 36, 2, 3, shutter_curve=[3, 3, 3]).shutter_curve is None


@pytest.mark.parametrize(
    "curve", ["a,b", "box:1,2", "trapezoid:0.8,0.5", (0, 0), (1,), (1, -1), (1, np.nan), 7, ("a", 1)]
)
def test_what_is_no_curve_is_refused(curve):
    with pytest.raises(InvalidParameterError):
        read_curve(curve)
    with pytest.raises(InvalidCameraError):
        ThinLens(50, 36, 2, 3, shutter_curve=curve)
