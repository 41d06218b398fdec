"""Highlights: pixels so bright that the rim of their PSF shows are drawn with a PSF of their own, and not of a cell.

The PSF of a cell is blurred over the cell: at the rim it is off by up to half of its level, which is invisible in a dim
pixel among its like, and all that is seen of a lamp. A pixel's error is its light times that of its PSF: where it
exceeds the bound that also rules merging (`runtime.plan.merge`), the PSF is made at the pixel's own coordinate. Labels
are rounded so that the pixels of a lamp, and their neighbours along a row, share one.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import DoubleArray, FloatArray, Image, IntArray
from spreadlets.parallel import for_bands
from spreadlets.psf.exact import ExactPsf
from spreadlets.psf.model import PsfModel
from spreadlets.psf.spreadlet import Spreadlet
from spreadlets.runtime.label.labels import DIRECTIONS
from spreadlets.runtime.label.pixels import Pixels
from spreadlets.runtime.plan import _highlight_kernels
from spreadlets.runtime.plan._highlight_kernels import HEADING_BITS, HEADING_ZERO, NOT_ALONE
from spreadlets.runtime.plan._plan_kernels import INVISIBLE

HALF_WIDTHS = 3, 15
"""Of the group of pixels that a highlight may be, and of its surroundings, px."""
STANDS_OUT = 5.0
"""How many times brighter than its surroundings a pixel of a highlight is; along a straight edge it is twice."""
RIM_SHARE = 0.125
"""Share of a PSF's level by which that of a cell errs where it errs, in the mean: a rim of 1 becomes a ramp, off by
half at most, and a ramp's mean error is a quarter of that."""
LEAST_TOLERANCE = 1e-3
"""Bound on the error that is worth a PSF, where a smaller one is asked for: a quarter of an 8-bit step."""
RADIUS_STEPS = 48.0
"""CoC radii are rounded to steps of ``2 sqrt(r) / 48``, with which cells grow, too: by 1 % at 4 px, 1/6 px at 64 px."""
PATH_STEP_PX = 1.0
"""Paths are rounded to whole pixels; their ends are off by a quarter of one in the mean."""
PLACES_ACROSS = 128
"""Places across the image that tell one PSF of a lens from the next."""
LARGEST_AREA = 1 << 18
"""Largest PSF that is drawn in full, px; a lamp that is spread over more has no rim to see."""


class Highlights(NamedTuple):
    """The pixels that have a PSF of their own.

    Attributes
    ----------
    number : list of ndarrays of shape (H, W), int32
        For each pass, which of the PSFs is each pixel's; -1 for the others.
    psfs : list of Spreadlet
        Direct points, their rows ascending.
    """

    number: list[npt.NDArray[np.int32]]
    psfs: list[Spreadlet]

    def others(self, keys: Sequence[IntArray]) -> list[IntArray]:
        """Return the keys of all other pixels; highlights become invisible."""
        if not self.psfs:
            return list(keys)
        return [np.where(number < 0, key, INVISIBLE) for number, key in zip(self.number, keys, strict=True)]

    def add_to(self, variants: Sequence[npt.NDArray[np.int32]], n_variants: int) -> None:
        """Give the highlights the variants from ``n_variants`` on, in place."""
        # Without highlights there are no numbers.
        for number, variant in zip(self.number, variants, strict=bool(self.psfs)):
            np.copyto(variant, number + np.int32(n_variants), where=number >= 0)


NO_HIGHLIGHTS = Highlights([], [])


def find_highlights(
    passes: Sequence[Pixels], keys: Sequence[IntArray], model: PsfModel, exact_psf: ExactPsf | None, tolerance: float
) -> Highlights:
    """Find the pixels whose light shows the rim of a PSF, and make their PSFs.

    Parameters
    ----------
    passes : sequence of Pixels
    keys : sequence of ndarrays of shape (H, W), int64
        The variant of each pixel of a pass, see `runtime.plan._plan_kernels.variant_keys`.
    model : PsfModel
    exact_psf : ExactPsf or None
        What makes the PSFs; None if there are none but those of cells.
    tolerance : float
        Largest error of the displayed image, as a share of its range.
    """
    if exact_psf is None:
        return NO_HIGHLIGHTS
    limit = max(tolerance, LEAST_TOLERANCE) / RIM_SHARE
    found = zip(passes, keys, _excesses(passes), strict=True)
    codes = [_codes(pixels, key, excess, model, limit) for pixels, key, excess in found]
    used, number = _numbered(codes)
    if not len(used):
        return NO_HIGHLIGHTS
    view = passes[0].labels.view
    psfs = exact_psf(*_coordinates(used, model, view.depth.shape[1], view.sensor_mm_per_px))
    return Highlights(number, list(psfs))


def _excesses(passes: Sequence[Pixels]) -> list[FloatArray]:
    """Return how far each pixel stands out, see the kernel; passes often share their colours."""
    colours = {id(pixels.radiance): pixels.radiance for pixels in passes}
    found = {key: _excess(radiance) for key, radiance in colours.items()}
    return [found[id(pixels.radiance)] for pixels in passes]


def _excess(radiance: Image) -> FloatArray:
    shape = radiance.shape[:2]
    light, excess, sums = np.empty(shape, np.float32), np.empty(shape, np.float32), np.empty((2, *shape), np.float32)
    for_bands(_highlight_kernels.light_and_sums, shape[0], radiance, HALF_WIDTHS, light, sums)
    n_stripes = -(-shape[1] // _highlight_kernels.COLUMNS)
    for_bands(_highlight_kernels.standing_out, n_stripes, light, sums, HALF_WIDTHS, STANDS_OUT, excess)
    return excess


def _codes(pixels: Pixels, key: IntArray, excess: FloatArray, model: PsfModel, limit: float) -> IntArray:
    """Return the codes of a pass's highlights."""
    labels, code = pixels.labels, np.empty(key.shape, np.int64)
    nothing = np.zeros((), np.float32)
    length = labels.length if model.has_motion else np.broadcast_to(nothing, key.shape)
    heading = DIRECTIONS[model.symmetry.angle](labels) if model.has_direction else nothing
    heading = np.broadcast_to(heading, (*key.shape, 2))
    steps = RADIUS_STEPS, _heading_step(model, key.shape[1]), model.symmetry.sign != "ignored"
    shape = labels.coc, length, heading
    limits = limit, float(LARGEST_AREA)
    for_bands(_highlight_kernels.highlight_codes, len(key), key, excess, shape, steps, limits, code)
    return code


def _heading_step(model: PsfModel, width: int) -> float:
    """Return the step of the heading, px: of a path, or of the place on an image of a width."""
    return PATH_STEP_PX if model.symmetry.angle == "motion" else max(1.0, width / PLACES_ACROSS)


def _numbered(codes: Sequence[IntArray]) -> tuple[IntArray, list[npt.NDArray[np.int32]]]:
    """Return the codes in use, ascending, and the number of each pixel's code among them, -1 if it has none."""
    starts = [np.flatnonzero(np.diff(code.ravel(), prepend=NOT_ALONE - 1)) for code in codes]
    firsts = [code.ravel()[start] for code, start in zip(codes, starts, strict=True)]
    used = np.unique(np.concatenate(firsts))
    used = used[used != NOT_ALONE]
    numbers = []
    for code, start, first in zip(codes, starts, firsts, strict=True):
        # Neighbours along a row share their code: look up each run once.
        number = np.where(first == NOT_ALONE, -1, np.searchsorted(used, first)).astype(np.int32)
        numbers.append(np.repeat(number, np.diff(start, append=code.size)).reshape(code.shape))
    return used, numbers


def _coordinates(
    codes: IntArray, model: PsfModel, width: int, mm_per_px: float
) -> tuple[DoubleArray, DoubleArray, IntArray]:
    """Return the coordinates (n, n_axes), directions (n,) and sides (n,) that codes stand for."""
    step, mask = _heading_step(model, width), (1 << HEADING_BITS) - 1
    x, y = (((codes >> bits & mask) - HEADING_ZERO) * step for bits in (HEADING_BITS, 0))
    rest = codes >> 2 * HEADING_BITS
    radius, heading = ((rest >> 1) / RADIUS_STEPS) ** 2, np.hypot(x, y)
    known = {"coc": radius, "depth": radius, "motion": heading, "eccentricity": heading * mm_per_px}
    coordinate = np.stack([known[axis.name] for axis in model.axes], axis=-1)
    return coordinate, np.arctan2(y, x), np.where(rest & 1, -1, 1).astype(np.int64)
