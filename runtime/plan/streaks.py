"""Streaks and thin capsules: PSFs that are drawn in closed form, not by cells.

A cell's PSF is a mean over radii, lengths and directions. That is right for what is blurred. A texture that moves in
focus would be blurred across its path, and beyond its ends; so it is drawn along its own. Near the focus, where cells
are wide against the blur, it would jump from one to the next as the focus is pulled; and a cell would be stored as its
pixels, of which its own mean has more than a PSF has. So discs and capsules of a round lens, up to
`spreadlets.psf._capsule_kernels.CLOSED_RADIUS_PX`, have nearly their own radius, length and direction, and no cells.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import Image, IntArray
from spreadlets.parallel import for_bands
from spreadlets.psf.model import PsfModel
from spreadlets.runtime.plan import _streak_kernels

LONGEST_PX = 128.0
"""Extent along an axis of the longest path that is a streak: the numbers of codes grow with its square."""
BOX_SHUTTER = (1.0, 1.0)
"""How far a shutter without a curve is open, from opening to closing."""


def longest_streak(model: PsfModel) -> float:
    """Return the largest extent of a streak along an axis, px; 0 if the model's PSFs do not move."""
    return LONGEST_PX if model.has_motion else 0.0


class Streaks(NamedTuple):
    """The pixels that some streaks cover.

    Attributes
    ----------
    offset_rc : ndarray of shape (n_points, 2), int32
        Rows and columns from the pixel, those of a streak sorted by row.
    value : ndarray of shape (n_points, 1), float32
        Shares of the light, for each streak of sum 1.
    counts : ndarray of shape (n,), int64
        Numbers of points of each streak.
    """

    offset_rc: npt.NDArray[np.int32]
    value: Image
    counts: IntArray


def draw_streaks(codes: IntArray, model: PsfModel) -> Streaks:
    """Return the pixels that streaks cover.

    Parameters
    ----------
    codes : ndarray of shape (n,), int64
        See `runtime.plan._streak_kernels.streak_code`.
    model : PsfModel
        Of a thin lens with motion, if there are any.
    """
    curve = model.settings.get("shutter_curve")
    given = codes, np.asarray(BOX_SHUTTER if curve is None else curve, np.float64)
    counts = np.zeros(len(codes), np.int64)
    drawn = for_bands(_streak_kernels.draw_own, len(codes), *given, counts)
    offset_rc, value = (np.concatenate(each) for each in zip(*drawn, strict=True))
    return Streaks(offset_rc, value, counts)
