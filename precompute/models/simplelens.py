"""Rays of the ``simplelens`` model: a thin lens and no motion (LKS section 5.1)."""

from typing import Any

import numpy as np
import numpy.typing as npt

from spreadlets.precompute.models import aperture
from spreadlets.precompute.trace.line_sample import Segments, Tracer, lattice_symmetric, lens_chords, tent

N_DIMENSIONS = 2
"""Place of the chord, circle of confusion."""

CHORD_ANGLE = 0.3
"""Direction of all chords, radians: far from the lattice's axes and diagonals, to which parallel chords would beat."""


def read_settings(**shape: Any) -> dict[str, Any]:
    """Return the settings of an aperture, see `precompute.models.aperture.read_settings`."""
    return aperture.read_settings(None, shape)


def trace(
    points: npt.NDArray[np.float64], box: npt.NDArray[np.float64], angle: float, angle_half_width: float
) -> Segments:
    """Turn points of the unit cube into chords of the lens.

    Parameters
    ----------
    points : ndarray of shape (n, N_DIMENSIONS), float64
    box : ndarray of shape (1, 2), float64
        Range of the circle of confusion's radius, px.
    angle, angle_half_width : float
        Ignored: the PSF is round.
    """
    radius = tent(points[:, 1], *box[0])
    return lens_chords(points[:, 0], radius, np.zeros_like(radius), np.full_like(radius, CHORD_ANGLE))


def reach(box: npt.NDArray[np.float64]) -> float:
    """Return the largest distance from the centre that a ray can have, px."""
    return float(box[0, 1])


ROUND = Tracer(N_DIMENSIONS, trace, reach, lattice_symmetric)
"""Tracer of the model without settings: a round, even aperture."""
