"""Streaks and thin capsules: PSFs that are drawn in closed form, not by cells.

A cell's PSF is a mean over radii, lengths and directions. That is right for what is blurred. A texture that moves in
focus would be blurred across its path, and beyond its ends; so it is drawn along its own. Near the focus, where cells
are wide against the blur, it would jump from one to the next as the focus is pulled; and a cell would be stored as its
pixels, of which its own mean has more than a PSF has. So discs and capsules of a round lens, up to
`spreadlets.psf._capsule_kernels.CLOSED_RADIUS_PX`, have nearly their own radius, length and direction, and no cells.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator

import numpy as np

from spreadlets.arrays import IntArray
from spreadlets.kept import Kept
from spreadlets.parallel import for_bands
from spreadlets.psf.model import PsfModel
from spreadlets.runtime.plan import _streak_kernels
from spreadlets.runtime.plan.variant import Points

LONGEST_PX = 128.0
"""Extent along an axis of the longest path that is a streak: the numbers of codes grow with its square."""
BOX_SHUTTER = (1.0, 1.0)
"""How far a shutter without a curve is open, from opening to closing."""
MOST_KEPT_POINTS, MOST_CURVES = 1 << 21, 4
"""Points that are kept for the next camera, 25 MB, for each of so many shutters."""


def longest_streak(model: PsfModel) -> float:
    """Return the largest extent of a streak along an axis, px; 0 if the model's PSFs do not move."""
    return LONGEST_PX if model.has_motion else 0.0


def draw_streaks(codes: IntArray, model: PsfModel) -> list[Points]:
    """Return the pixels that each streak covers, direct points, with their shares of its light.

    Parameters
    ----------
    codes : ndarray of shape (n,), int64
        See `runtime.plan._streak_kernels.streak_code`; no two alike.
    model : PsfModel
        Of a thin lens with motion, if there are any.
    """
    curve = model.settings.get("shutter_curve")
    openness = BOX_SHUTTER if curve is None else tuple(curve)
    return _kept(openness).of(codes.tolist(), lambda missing: _drawn(np.array(missing, np.int64), openness))


@functools.lru_cache(maxsize=MOST_CURVES)
def _kept(openness: tuple[float, ...]) -> Kept[int, Points]:
    return Kept(MOST_KEPT_POINTS, lambda points: len(points[1]))


def _drawn(codes: IntArray, openness: tuple[float, ...]) -> Iterator[Points]:
    """Yield the points of each streak."""
    counts = np.zeros(len(codes), np.int64)
    drawn = for_bands(_streak_kernels.draw_own, len(codes), codes, np.asarray(openness, np.float64), counts)
    offset_rc, value = (np.concatenate(each) for each in zip(*drawn, strict=True))
    ends = np.cumsum(counts).tolist()
    # Copies of their own: all would live as long as any of them.
    return (
        (offset_rc[begin:end].copy(), value[begin:end].copy(), True)
        for begin, end in zip([0, *ends], ends, strict=False)
    )
