import numpy as np
import pytest

from spreadlets.runtime.label._label_kernels import path_places
from spreadlets.runtime.label.depth_edges import split_depth_edges
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.frame import Frame

CAMERA = ThinLens(focal_length_mm=50, sensor_width_mm=36, f_number=0.005, focus_distance_m=2.0)
NEAR, FAR = 2.0, 6.0


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


def edge_frame(share, slope=0.0):
    """A near surface to the left of a far one; the pixels of one column are blends of both."""
    depth = np.where(np.arange(12) < 6, NEAR, FAR) * np.ones((9, 12)) + slope * np.arange(9)[:, None]
    depth[:, 5] = share * NEAR + (1 - share) * FAR + slope * np.arange(9)
    motion = np.where(np.arange(12) < 5, 3.0, -1.0)[:, None] * np.ones((9, 12, 2))
    return Frame(np.ones((9, 12, 4)), depth, motion).layers[0]


@pytest.mark.interpreted
@pytest.mark.parametrize("share", [0.25, 0.8])
@pytest.mark.parametrize("slope", [0.0, 0.01])
def test_blended_depths_are_divided_between_both_surfaces(share, slope):
    layer = edge_frame(share, slope)
    (far, far_share), (near, near_share) = split_depth_edges(layer, CAMERA)
    inner = slice(2, -2)
    np.testing.assert_allclose(near_share[inner, 5], share, atol=2e-3)
    np.testing.assert_allclose(near_share + far_share, 1.0, atol=1e-6)
    np.testing.assert_allclose(near.depth[inner, 5], layer.depth[inner, 4], atol=0.011)
    np.testing.assert_allclose(far.depth[inner, 5], layer.depth[inner, 6], atol=0.011)
    assert (near.motion[inner, 5] == 3.0).all() and (far.motion[inner, 5] == -1.0).all()
    # A pixel beside the blend may be taken for one of its own surface and the blend; hardly any of it is given away.
    others = np.arange(12) != 5
    given = np.minimum(near_share, far_share)[inner, others]
    assert given.max() < 0.01
    np.testing.assert_array_equal(far.depth[near_share == 0], layer.depth[near_share == 0])
    assert near.radiance is layer.radiance and far.radiance is layer.radiance


def ramp(depth):
    return Frame(np.ones((9, 12, 4)), depth).layers[0]


@pytest.mark.parametrize(
    "depth",
    [
        np.full((9, 12), NEAR),
        np.where(np.arange(12) < 6, NEAR, FAR) * np.ones((9, 12)),
        np.linspace(NEAR, FAR, 12) * np.ones((9, 12)),
        np.where(np.arange(12) == 5, 3.0, FAR) * np.ones((9, 12)),
        np.where(np.arange(12) < 6, NEAR, np.where(np.arange(12) == 6, 3.0, np.inf)) * np.ones((9, 12)),
    ],
    ids=["flat", "aliased edge", "slant", "thin object", "before the background"],
)
def test_depths_of_real_surfaces_are_kept(depth):
    ((kept, share),) = split_depth_edges(ramp(depth), CAMERA)
    assert share is None and kept.depth.shape == (9, 12)
