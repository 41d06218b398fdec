"""Continuing a frame beyond its border, so that what lies outside is blurred into it as what lies inside is."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from runtime import _plan_kernels
from runtime.splat import NO_SHIFT, SplatPass

Image = npt.NDArray[np.float32]

BORDER_STRIP = 8
"""Depth, px, of the strip along a border whose median colour continues the frame."""
BORDER_MEDIAN = 15
"""Length, px, of the median along the border: a highlight shorter than half of it is not continued."""


def border_passes(frame: SplatPass, reach: npt.NDArray[np.int64]) -> Iterator[SplatPass]:
    """Yield four strips around a frame: above, below, left and right.

    Labels repeat those of the nearest border pixel, as far as its PSF reaches back into the frame. Colours are the
    robust colour of the nearest piece of border: a plain repetition would turn a highlight at the border into a streak
    of highlights outside, and its bokeh would grow brighter towards the border; the median leaves it out.

    Parameters
    ----------
    frame : SplatPass
        The labelled pixels of the frame.
    reach : ndarray of shape (n_variants,), int64
        How far each variant's splat reaches from its pixel, px.
    """
    height, width = frame.variant.shape
    edges = frame.variant[0], frame.variant[-1], frame.variant[:, 0], frame.variant[:, -1]
    top, bottom, left, right = (int(reach[edge[edge >= 0]].max(initial=0)) for edge in edges)
    above, below, before, behind = (_border_colour(side) for side in _sides(frame.radiance))
    sideways = ((left, right), (0, 0))
    for rows, first, colour in ((top, -top, above), (bottom, height, below)):
        if rows:
            row = np.pad(colour, sideways, mode="edge")
            yield _strip(frame, reach, (first, -left), np.broadcast_to(row, (rows, *row.shape)))
    for cols, first, colour in ((left, -left, before), (right, width, behind)):
        if cols:
            yield _strip(frame, reach, (0, first), np.broadcast_to(colour[:, None], (height, cols, 4)))


def _strip(frame: SplatPass, reach: npt.NDArray[np.int64], origin: tuple[int, int], colour: Image) -> SplatPass:
    """Return the pass of one strip, its labels those of the nearest pixels of the frame."""
    variant: npt.NDArray[np.int32] = np.empty(colour.shape[:2], np.int32)
    _plan_kernels.fill_border(frame.variant, reach, origin, variant)
    variant[~colour.any(axis=2)] = -1
    shift = NO_SHIFT
    if frame.shift is not NO_SHIFT:
        height, width = frame.variant.shape
        rows = np.clip(origin[0] + np.arange(len(variant)), 0, height - 1)
        cols = np.clip(origin[1] + np.arange(len(variant[0])), 0, width - 1)
        shift = np.ascontiguousarray(frame.shift[rows[:, None], cols])
    return SplatPass(origin, np.ascontiguousarray(colour), variant, shift)


def _sides(radiance: Image) -> Iterator[Image]:
    """Yield the image turned so that its top, bottom, left and right border comes first along the first axis."""
    yield radiance
    yield radiance[::-1]
    yield radiance.transpose(1, 0, 2)
    yield radiance.transpose(1, 0, 2)[::-1]


def _border_colour(radiance: Image) -> Image:
    """Return the robust colour along the first row, shape (W, 4)."""
    strip = np.median(radiance[:BORDER_STRIP], axis=0)
    colour: Image = ndimage.median_filter(strip, size=(BORDER_MEDIAN, 1), mode="nearest")
    return colour
