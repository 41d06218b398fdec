"""What neighbouring frames show of what is hidden: a disc that moves before a plane that pans, drawn for any time."""

from dataclasses import replace

import numpy as np
import pytest

from spreadlets.runtime.controls import Controls
from spreadlets.runtime.label.moving import Effects
from spreadlets.runtime.label.reprojection import reproject
from spreadlets.runtime.plan.divide import divide_frames
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.frame import Frame

CAMERA = ThinLens(focal_length_mm=50, sensor_width_mm=36, f_number=0.1, focus_distance_m=6.0)
SIZE, NEAR, FAR = 40, 2.0, 6.0
DISC_SPEED, PAN = 14, -3


def plane(time):
    """Return the plane's colours, texture that pans."""
    texture = np.random.default_rng(0).random((SIZE, 3 * SIZE, 3))
    start = SIZE - PAN * time
    return texture[:, start : start + SIZE]


def drawn(time, advance=0.0, curved=False):
    """Return the layer of a time, and where the disc is; the camera has come nearer by so many metres a frame."""
    rows, cols = np.indices((SIZE, SIZE))
    inside = np.hypot(cols - 20 - DISC_SPEED * time, rows - 20) < 6
    radiance = np.where(inside[..., None], (0.9, 0.1, 0.1), plane(time))
    depth = np.where(inside, NEAR, FAR) - advance * time
    motion = np.zeros((SIZE, SIZE, 2))
    motion[..., 0] = np.where(inside, DISC_SPEED, PAN)
    both = {"motion_prev": motion, "motion_next": motion} if curved else {}
    return Frame(radiance, depth, motion, **both).layers[0], inside


@pytest.mark.interpreted
@pytest.mark.parametrize("time", [-1, 1])
def test_what_a_neighbour_saw_behind_the_disc_is_where_it_lies_now(time):
    layer, inside = drawn(0)
    found, seen = reproject(layer, [drawn(time)[0]], CAMERA)
    middle = np.zeros_like(inside)
    middle[17:24, 17:24] = True
    assert seen[middle].all() and not seen[~inside].any(), "all that is hidden, and nothing else"
    assert np.allclose(found.radiance[middle, :3], plane(0)[middle], atol=1e-6)
    assert np.allclose(found.depth[middle], FAR) and np.allclose(found.motion[middle], (PAN, 0))


def test_two_neighbours_show_more_than_one():
    layer, inside = drawn(0)
    one, both = (reproject(layer, [drawn(t)[0] for t in times], CAMERA)[1].sum() for times in ((1,), (-1, 1)))
    assert one <= both <= inside.sum() and both > 0


def test_what_was_hidden_in_the_neighbour_too_is_not_made_up():
    layer, inside = drawn(0)
    _, seen = reproject(layer, [drawn(0)[0]], CAMERA)
    assert not seen[inside].any() or seen[inside].mean() < 0.35, "only what the texture's pan uncovers"


def test_depths_follow_a_camera_that_comes_nearer():
    layer, _ = drawn(0)
    found, seen = reproject(layer, [drawn(1, advance=0.3)[0]], CAMERA)
    assert seen.any() and np.allclose(found.depth[seen > 0], FAR, atol=1e-4)


def test_curved_paths_are_taken_along():
    layer, _ = drawn(0, curved=True)
    found, seen = reproject(layer, [drawn(1, curved=True)[0]], CAMERA)
    assert np.allclose(found.motion_prev[seen > 0], (PAN, 0)) and np.allclose(found.motion_next[seen > 0], (PAN, 0))


def test_what_a_neighbour_saw_is_used_where_strengths_make_a_small_blur_large():
    layer, other = drawn(0)[0], drawn(1)[0]
    still = replace(CAMERA, shutter=(-1e-3, 1e-3))
    narrow, strong = replace(still, f_number=64 * still.f_number), Controls(near_strength=64.0)
    wide, same = (
        divide_frames([layer], lens, Effects(True, True, True, controls), neighbours=[other]).known
        for lens, controls in ((still, Controls()), (narrow, strong))
    )
    assert wide.any() and np.array_equal(same, wide)
