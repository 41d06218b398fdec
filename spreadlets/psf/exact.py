"""PSFs of single coordinates, which lie between the cells of a grid: what the runtime asks a model for.

Coordinates are rounded, so that neighbours share a PSF, to steps that are too small to see.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol

import numpy as np

from spreadlets.arrays import DoubleArray, IntArray
from spreadlets.psf.model import PsfModel
from spreadlets.psf.spreadlet import Spreadlet

MIN_DIRECT_VALUE = 1e-7
"""Pixels of a dense PSF below this share of its peak are not drawn: under float32's own resolution."""

RADIUS_STEPS = 48.0
"""CoC radii are rounded to steps of ``2 sqrt(r) / 48``, with which cells grow, too: by 1 % at 4 px, 1/6 px at 64 px."""
PATH_STEP_PX = 1.0
"""Paths are rounded to whole pixels; their ends are off by a quarter of one in the mean."""
PLACES_ACROSS = 128
"""Places across the image that tell one PSF of a lens from the next."""
THIN_RADIUS_PX = 4.0
"""CoC radius below which a PSF is so thin that its ends show: steps of the path, or the place, are half as long."""


class ExactPsf(Protocol):
    """Makes the PSFs of a model at single coordinates, without a pre-filter."""

    def __call__(self, coordinate: DoubleArray, angle: DoubleArray, side: IntArray) -> Iterator[Spreadlet]:
        """Yield PSFs as direct points, their rows ascending.

        Parameters
        ----------
        coordinate : ndarray of shape (n, n_axes), float64
            In the units of the model's axes; it may lie beyond their ends.
        angle : ndarray of shape (n,), float64
            Radians, y down; ignored by models without direction.
        side : ndarray of shape (n,), int64
            1 behind the focus, -1 in front of it.
        """


def direct_points(psf: DoubleArray) -> Spreadlet:
    """Turn a centred dense PSF of shape (h, w, C) into direct points, of the same energy, their rows ascending."""
    rows, cols = np.nonzero(psf.max(axis=2) > MIN_DIRECT_VALUE * psf.max())
    value = psf[rows, cols]
    # A channel may hold no light: a picture of one pure colour.
    kept = value.sum(axis=0)
    value *= np.divide(psf.sum(axis=(0, 1)), kept, out=np.zeros_like(kept), where=kept > 0.0)
    centre = np.array([psf.shape[0] // 2, psf.shape[1] // 2])
    return Spreadlet((np.stack([rows, cols], axis=1) - centre).astype(np.int16), value.astype(np.float32), True)


def longest_step(model: PsfModel, width: int) -> float:
    """Return the longest step of a heading, px: of a path, or of the place on an image of a width."""
    return PATH_STEP_PX if model.symmetry.heading == "motion" else max(1.0, width / PLACES_ACROSS)


def heading_steps(radius: DoubleArray, longest: float) -> DoubleArray:
    """Return the steps of headings, px, for (rounded) CoC radii."""
    return np.where(radius < THIN_RADIUS_PX, 0.5 * longest, longest)


def rounded(
    coordinate: DoubleArray, angle: DoubleArray, side: IntArray, model: PsfModel
) -> tuple[DoubleArray, DoubleArray, IntArray]:
    """Return coordinates, directions and sides as they are drawn.

    Parameters
    ----------
    coordinate : ndarray of shape (n, n_axes), float64
        In the units of the model's axes, the first of which is the CoC radius.
    angle : ndarray of shape (n,), float64
        Radians.
    side : ndarray of shape (n,), int64
        1 behind the focus, -1 in front of it.
    model : PsfModel
    """
    made = coordinate.copy()
    made[:, 0] = (np.floor(RADIUS_STEPS * np.sqrt(coordinate[:, 0]) + 0.5) / RADIUS_STEPS) ** 2
    if not model.has_direction:
        return made, np.zeros_like(angle), side
    view = model.settings.get("view", {"width_px": PLACES_ACROSS, "sensor_width_mm": 2.0})
    unit = 1.0 if model.has_motion else view["sensor_width_mm"] / view["width_px"]
    step = heading_steps(made[:, 0], longest_step(model, view["width_px"]))
    heading = coordinate[:, -1] / unit * np.stack([np.cos(angle), np.sin(angle)])
    x, y = np.copysign(np.floor(np.abs(heading) / step + 0.5), heading) * step
    made[:, -1] = np.hypot(x, y) * unit
    return made, np.arctan2(y + 0.0, x + 0.0), side
