"""Poses of cameras."""

import numpy as np
import pytest

from spreadlets.errors import InvalidCameraError
from spreadlets.scene.camera import LensKey, ThinLens
from spreadlets.scene.pose import checked_pose, pose_between, rigid

STILL = np.eye(4)


def turned(angle, axis=2):
    first, second = [k for k in range(3) if k != axis]
    matrix = np.eye(4)
    matrix[first, first] = matrix[second, second] = np.cos(angle)
    matrix[first, second], matrix[second, first] = -np.sin(angle), np.sin(angle)
    return matrix


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("angle", [1e-7, 0.3, 3.0])
def test_a_share_of_a_turn_is_the_turn_by_a_share_of_the_angle(axis, angle):
    between = pose_between(checked_pose("a", STILL), checked_pose("b", turned(angle, axis)), 0.25)
    assert np.asarray(between) == pytest.approx(turned(0.25 * angle, axis), abs=1e-12)


def test_a_camera_between_keys_turns_and_moves_evenly():
    end = turned(0.4)
    end[:3, 3] = 1.0, 2.0, -3.0
    camera = ThinLens(50, 36, 2, 3, keys=(LensKey(-1, camera_to_world=STILL), LensKey(1, camera_to_world=end)))
    middle = np.asarray(camera.pose_at(0.0))
    assert middle[:3, :3] == pytest.approx(turned(0.2)[:3, :3])
    assert middle[:3, 3] == pytest.approx([0.5, 1.0, -1.5])
    assert camera.pose_at(-5.0) == camera.keys[0].camera_to_world and camera.pose_at(1.0) == camera.pose_at(7.0)
    assert camera.at(0.0).camera_to_world == camera.pose_at(0.0) and camera.at(0.0).keys == ()


def test_a_scaled_group_does_not_scale_its_camera():
    assert rigid(np.diag([2.0, 2.0, 2.0, 1.0])) == pytest.approx(np.eye(4))


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("here", "must be 4 rows of 4"),
        (np.eye(3), "must be 4 rows of 4"),
        (np.full((4, 4), np.nan), "finite"),
        (np.diag([1.0, 1.0, 1.0, 2.0]), "must be 0, 0, 0, 1"),
        (np.diag([2.0, 2.0, 2.0, 1.0]), "no rigid motion"),
        (np.diag([1.0, 1.0, -1.0, 1.0]), "no rigid motion"),
    ],
)
def test_what_is_no_pose_is_refused(given, said):
    with pytest.raises(InvalidCameraError, match=said):
        ThinLens(50, 36, 2, 3, camera_to_world=given)
    with pytest.raises(InvalidCameraError, match="camera_to_world at 0.5 frames"):
        LensKey(0.5, camera_to_world=given)
