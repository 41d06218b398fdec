"""Continuing a frame beyond its border, so that what lies outside is blurred into it as what lies inside is."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import Image, IntArray
from spreadlets.parallel import for_bands
from spreadlets.runtime.buffers import buffer
from spreadlets.runtime.plan import _border_kernels
from spreadlets.runtime.plan._border_kernels import Weighted
from spreadlets.runtime.splat.passes import STRIDES, SplatPass


def extended_pass(
    frame: SplatPass,
    share: Image,
    reach: npt.NDArray[np.int64],
    corner: tuple[int, int] = (0, 0),
    *,
    border: bool = True,
) -> SplatPass:
    """Return a frame with its pixels weighted, and with what lies beyond its border: the frame in a mirror.

    Colours, labels and weights are those of the mirrored pixels, as far as their PSFs reach back into the frame. So it
    is as bright outside as inside, and what touches the border goes on.

    Parameters
    ----------
    frame : SplatPass
        The labelled pixels of the frame, unshifted, with stride 1 and origin (0, 0).
    share : ndarray of shape (H, W) or (0, 0), float32
        Weight of each pixel; empty if all are 1.
    reach : ndarray of shape (n_variants,), int64
        How far each variant's splat reaches from its pixel, px.
    corner : tuple of int
        Row and column of the frame's first pixel, counted from the picture's centre.
    border : bool
        Whether anything lies beyond it.

    Returns
    -------
    SplatPass
        Colours and labels are new arrays, or the frame's own where they are the same. Its first row and column are
        multiples of the largest stride, counted so, as those of every pass: so blocks fit one canvas, and are the same
        whatever part of the picture the frame is.
    """
    # Find how far the PSFs along each side reach back, in whole blocks of the grid.
    height, width = frame.label.shape
    top = bottom = left = right = 0
    if border and len(reach):
        flipped = frame.label[::-1, ::-1]
        sides = frame.label, flipped, frame.label.T, flipped.T
        top, bottom, left, right = (_reaching_back(side, reach) for side in sides)
        top, left = (side + (at - side) % STRIDES[-1] for side, at in zip((top, left), corner, strict=True))
    elif not len(share):
        return frame
    # Mirror the frame.
    shape = top + height + bottom, left + width + right
    extended = SplatPass((-top, -left), buffer((*shape, 4)), buffer(shape, np.int32))
    given = Weighted(frame.radiance, share, frame.label), reach, extended.origin, extended.radiance, extended.label
    for_bands(_border_kernels.extend_frame, shape[0], *given)
    return extended


def _reaching_back(label: npt.NDArray[np.int32], reach: IntArray) -> int:
    """Return how many rows, mirrored at the first row of a frame, have PSFs that reach back into it."""
    farthest = int(reach.max())
    found = np.empty(min(len(label), farthest), np.int64)
    rows = np.ascontiguousarray(label[: len(found)])
    for_bands(_border_kernels.row_reaches, len(found), rows, reach, found)
    # The mirror image of the whole frame is seen again and again.
    away = np.arange(farthest)
    seen = away % (2 * len(label))
    row = np.where(seen < len(label), seen, 2 * len(label) - 1 - seen)
    back = np.flatnonzero(found[row] > away)
    return int(back[-1]) + 1 if len(back) else 0
