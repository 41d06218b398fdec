"""What moves apart covers more: elements before nothing stay opaque."""

import numpy as np
import pytest

import spreadlets as sp
from spreadlets.runtime.label.stretch import stretch
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.frame import Frame

SIZE = 64


def camera(shutter, **changes):
    return ThinLens(
        focal_length_mm=50, sensor_width_mm=36, f_number=8, focus_distance_m=4.0, shutter=shutter, **changes
    )


def from_middle():
    y, x = np.indices((SIZE, SIZE)) - 0.5 * (SIZE - 1)
    return np.stack([x, y], axis=-1).astype(np.float32)


def element(motion, alpha=1.0, **labels):
    """Return a disc over nothing."""
    colour = np.array([0.5, 0.3, 0.2, 1.0], np.float32) * np.float32(alpha)
    inside = np.hypot(*np.moveaxis(from_middle(), 2, 0)) < 20
    return Frame(inside[..., None] * colour, np.full((SIZE, SIZE), 4.0), motion, **labels)


def core(image):
    return image[26:38, 26:38]


@pytest.mark.parametrize("rate", [0.3, -0.3])
@pytest.mark.parametrize("alpha", [1.0, 0.5])
def test_areas_are_those_of_the_magnified_surface(rate, alpha):
    (layer,) = element(rate * from_middle(), alpha).layers
    area = stretch(layer, camera((0.0, 0.5)))
    if rate < 0 and alpha == 1.0:
        # It stays opaque as it is.
        assert area is None
        return
    times = np.linspace(0.0, 0.5, 101)
    assert core(area) == pytest.approx(((1.0 + rate * times) ** 2).mean(), abs=2e-3)
    assert area[0, 0] == 1.0


def test_what_turns_or_moves_as_a_whole_covers_what_it_did():
    offset = from_middle()
    turn = np.deg2rad(20.0)
    after, before = (
        offset @ np.array([[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]], np.float32) - offset for a in (turn, -turn)
    )
    labels = {"motion_prev": -before, "motion_next": after}
    turning = element(0.5 * (after - before), **labels).layers[0]
    # Along straight paths it would grow.
    straight = element(0.5 * (after - before), 0.5).layers[0]
    assert stretch(turning, camera((0.0, 0.5))) is None
    assert core(stretch(straight, camera((0.0, 0.5)))).min() > 1.005
    assert stretch(element(np.ones_like(offset)).layers[0], camera((0.0, 0.5))) is None


def test_a_rolling_shutter_stretches_what_moves_along_its_way():
    down = np.zeros((SIZE, SIZE, 2), np.float32) + np.array([0.0, 12.0], np.float32)
    (layer,) = element(down).layers
    area = stretch(layer, camera((-0.25, 0.25), readout_frames=1.0))
    assert core(area) == pytest.approx(1.0 + 12.0 / (SIZE - 1), abs=1e-3)


@pytest.mark.parametrize("is_layer", [False, True])
def test_an_element_that_comes_nearer_stays_opaque(is_layer):
    frame = element(0.3 * from_middle())
    if is_layer:
        white = Frame(np.ones((SIZE, SIZE, 4)), np.full((SIZE, SIZE), 8.0), np.zeros((SIZE, SIZE, 2)))
        frame = Frame.from_layers([frame, white])
    image = sp.synthesize(frame, camera((0.0, 1.0)))
    # Unstretched it would be .77, and the white would shine through.
    expected = [0.5, 0.3, 0.2, 1.0]
    np.testing.assert_allclose(core(image).mean(axis=(0, 1)), expected, atol=0.06)
