import numpy as np
import pytest

from spreadlets.runtime.label._label_kernels import path_places


def place(before, after, time):
    found = np.empty((1, 1, 2), np.float32)
    path_places(0, 1, *(np.array(each, np.float32).reshape(1, 1, 2) for each in (before, after)), time, found)
    return found[0, 0]


def on_circle(turn, time, radius=40.0):
    return radius * np.array([np.cos(turn * time) - 1.0, np.sin(turn * time)])


@pytest.mark.interpreted
@pytest.mark.parametrize("degrees", [0.01, 1.0, 20.0, 60.0, 90.0, -130.0])
@pytest.mark.parametrize("time", [-1.0, -0.4, 0.25, 1.0])
def test_what_turns_at_constant_speed_moves_along_an_arc(degrees, time):
    turn = np.radians(degrees)
    found = place(-on_circle(turn, -1.0), on_circle(turn, 1.0), time)
    np.testing.assert_allclose(found, on_circle(turn, time), atol=2e-4)


@pytest.mark.parametrize(
    "before, after",
    [
        ((3.0, 1.0), (3.0, 1.0)),
        ((2.0, 1.0), (3.0, 1.5)),
        ((0.0, 0.0), (5.0, 1.0)),
        ((4.0, 0.0), (-4.0, 0.1)),
        ((4, 4), (0, 0)),
    ],
)
def test_paths_lead_through_the_places_before_and_after(before, after):
    np.testing.assert_allclose(place(before, after, -1.0), -np.array(before), atol=1e-5)
    np.testing.assert_allclose(place(before, after, 1.0), after, atol=1e-5)
    np.testing.assert_allclose(place(before, after, 0.0), [0, 0], atol=1e-6)


def test_a_stop_is_a_parabola():
    np.testing.assert_allclose(place((4.0, 0.0), (0.0, 0.0), -0.5), [-0.5 * 2 - 0.5 * 0.25 * 4, 0.0], atol=1e-6)
