"""Continuing a frame beyond its border, so that what lies outside is blurred into it as what lies inside is."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import Image
from spreadlets.parallel import for_bands
from spreadlets.runtime.buffers import buffer
from spreadlets.runtime.plan import _border_kernels
from spreadlets.runtime.plan._border_kernels import Colours, Weighted
from spreadlets.runtime.splat.passes import STRIDES, SplatPass

BORDER_STRIP = 8
"""Depth, px, of the strip along a border whose median colour continues the frame."""
BORDER_MEDIAN = 15
"""Length, px, of the median along the border: a highlight shorter than half of it is not continued."""


def extended_pass(
    frame: SplatPass,
    share: Image,
    reach: npt.NDArray[np.int64],
    colours: Colours | None,
    corner: tuple[int, int] = (0, 0),
) -> SplatPass:
    """Return a frame with its pixels weighted, and with what lies beyond its border.

    Labels and weights repeat those of the nearest border pixel, as far as its PSF reaches back into the frame.

    Parameters
    ----------
    frame : SplatPass
        The labelled pixels of the frame, unshifted, with stride 1 and origin (0, 0).
    share : ndarray of shape (H, W) or (0, 0), float32
        Weight of each pixel; empty if all are 1.
    reach : ndarray of shape (n_variants,), int64
        How far each variant's splat reaches from its pixel, px.
    colours : Colours or None
        What lies beyond the border, see `border_colours`; None to end there.
    corner : tuple of two ints
        Row and column of the frame's first pixel, counted from the picture's centre.

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
    if colours is not None and len(reach):
        edges = frame.label[0], frame.label[-1], frame.label[:, 0], frame.label[:, -1]
        top, bottom, left, right = (int(reach[edge[edge >= 0] % len(reach)].max(initial=0)) for edge in edges)
        top, left = (side + (at - side) % STRIDES[-1] for side, at in zip((top, left), corner, strict=True))
    elif not len(share):
        return frame
    # Repeat labels and weights outwards.
    shape = top + height + bottom, left + width + right
    extended = SplatPass((-top, -left), buffer((*shape, 4)), buffer(shape, np.int32))
    nothing = np.zeros((0, 4), np.float32)
    for_bands(
        _border_kernels.extend_frame,
        shape[0],
        Weighted(frame.radiance, share, frame.label),
        colours or Colours(nothing, nothing, nothing, nothing),
        reach,
        extended.origin,
        extended.radiance,
        extended.label,
    )
    return extended


def border_colours(radiance: Image) -> Colours:
    """Return the robust colours along each side of the border.

    A plain repetition would turn a highlight at the border into a streak of highlights outside, and its bokeh would
    grow brighter towards the border; the median leaves it out.
    """
    turned = radiance.transpose(1, 0, 2)
    colours: list[Image] = []
    for side in (radiance[:BORDER_STRIP], radiance[-BORDER_STRIP:], turned[:BORDER_STRIP], turned[-BORDER_STRIP:]):
        colours.append(np.empty((side.shape[1], 4), np.float32))
        _border_kernels.border_colours(np.ascontiguousarray(side), BORDER_MEDIAN // 2, colours[-1])
    return Colours(*colours)
