"""Where a camera is and how it looks, as a matrix; and what lies between two such poses."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import DoubleArray
from spreadlets.errors import InvalidCameraError

Pose = tuple[tuple[float, ...], ...]
"""Four rows: a point of the camera's space, as a column, times it is the point in the world, both in metres.

The camera looks along -z, x points to the right and y up, as in OpenGL, USD and Blender.
"""

RIGID_TOLERANCE = 1e-3
"""How far the axes of a camera may be from right angles and from unit length, files having seven digits or fewer."""


def checked_pose(name: str, given: npt.ArrayLike) -> Pose:
    """Return a pose as tuples of floats.

    Parameters
    ----------
    name : str
        What the pose is called in the error's message.
    given : array_like of shape (4, 4)
        Rows of the matrix.

    Raises
    ------
    InvalidCameraError
        If it is no rigid motion: the axes are not at right angles, scaled, or mirrored, or a number is not finite.
    """
    try:
        matrix = np.asarray(given, np.float64)
    except (TypeError, ValueError):
        raise InvalidCameraError(f"{name} is {given!r}; it must be 4 rows of 4 numbers") from None
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        raise InvalidCameraError(f"{name} is {given!r}; it must be 4 rows of 4 finite numbers")
    axes = matrix[:3, :3]
    if np.abs(matrix[3] - (0, 0, 0, 1)).max() > RIGID_TOLERANCE:
        raise InvalidCameraError(f"{name} ends with the row {matrix[3].tolist()}; it must be 0, 0, 0, 1")
    if np.abs(axes.T @ axes - np.eye(3)).max() > RIGID_TOLERANCE or np.linalg.det(axes) < 0:
        raise InvalidCameraError(
            f"{name} is no rigid motion: its axes must have unit length, right angles and no mirror"
        )
    return tuple(tuple(map(float, row)) for row in matrix.tolist())


def rigid(matrix: npt.ArrayLike) -> DoubleArray:
    """Return a matrix (4, 4) whose axes have unit length: a camera in a scaled group is not scaled itself."""
    pose = np.array(matrix, np.float64)
    pose[:3, :3] /= np.maximum(np.linalg.norm(pose[:3, :3], axis=0), np.finfo(np.float64).tiny)
    return pose


def pose_between(first: Pose, second: Pose, share: float) -> Pose:
    """Return the pose at a share of the way between two: it moves straight, and turns about one axis, both evenly.

    Examples
    --------
    >>> still = ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1))
    >>> aside = ((1, 0, 0, 2), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1))
    >>> pose_between(still, aside, 0.25)[0]
    (1.0, 0.0, 0.0, 0.5)
    """
    begin, end = np.asarray(first, np.float64), np.asarray(second, np.float64)
    pose = np.eye(4)
    pose[:3, :3] = begin[:3, :3] @ _turned(begin[:3, :3].T @ end[:3, :3], share)
    pose[:3, 3] = (1.0 - share) * begin[:3, 3] + share * end[:3, 3]
    return tuple(tuple(map(float, row)) for row in pose.tolist())


def _turned(rotation: DoubleArray, share: float) -> DoubleArray:
    """Return a share of a rotation (3, 3) by Rodrigues' formula; exactly half a turn has no axis, and is a jump."""
    twice_sine = np.array(
        [rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]]
    )
    length = float(np.linalg.norm(twice_sine))
    if not length:
        return rotation if share >= 0.5 else np.eye(3)
    angle = share * float(np.arctan2(0.5 * length, 0.5 * (np.trace(rotation) - 1.0)))
    x, y, z = twice_sine / length
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross)
