"""Rays of the ``combined`` model: a thin lens and straight motion of constant speed (LKS section 5.1)."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from spreadlets.errors import InvalidParameterError, option
from spreadlets.precompute.models import aperture
from spreadlets.precompute.trace.line_sample import Segments, Tracer, lens_chords, point_symmetric, tent

N_DIMENSIONS = 4
"""Place of the chord, circle of confusion, length of the motion, its direction."""


def read_settings(*, shutter_curve: Sequence[float] | str | None = None, **shape: Any) -> dict[str, Any]:
    """Return the settings of an aperture, see `precompute.models.aperture.read_settings`."""
    if shape.get("cats_eye_radial"):
        raise InvalidParameterError(
            f"{option('cats_eye_radial')}: the directions of 'combined' are those of motion; build 'simplelens', with "
            "which motion is drawn in steps"
        )
    return aperture.read_settings(shutter_curve, shape)


def trace(
    points: npt.NDArray[np.float64], box: npt.NDArray[np.float64], angle: float, angle_half_width: float
) -> Segments:
    """Turn points of the unit cube into chords of the lens, each moving over the shutter.

    Parameters
    ----------
    points : ndarray of shape (n, N_DIMENSIONS), float64
    box : ndarray of shape (2, 2), float64
        Ranges of the circle of confusion's radius and of the path's length, px.
    angle, angle_half_width : float
        Middle and half-width of the tent over the motion's direction, radians, y down.
    """
    radius = tent(points[:, 1], *box[0])
    half_path = 0.5 * tent(points[:, 2], *box[1])
    heading = tent(points[:, 3], angle - angle_half_width, angle + angle_half_width)
    return lens_chords(points[:, 0], radius, half_path, heading)


def reach(box: npt.NDArray[np.float64]) -> float:
    """Return the largest distance from the centre that a ray can have, px: the path's centre is at mid-shutter."""
    return float(box[0, 1] + 0.5 * box[1, 1])


ROUND = Tracer(N_DIMENSIONS, trace, reach, point_symmetric)
"""Tracer of the model without settings: a round, even aperture and a box shutter."""
