"""Continuing a frame beyond its border, so that what lies outside is blurred into it as what lies inside is."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import Image
from spreadlets.parallel import for_bands
from spreadlets.remembered import Remembered
from spreadlets.runtime.buffers import buffer
from spreadlets.runtime.plan import _border_kernels
from spreadlets.runtime.plan._border_kernels import Weighted
from spreadlets.runtime.splat.passes import STRIDES, SplatPass


def extended_pass(
    frame: SplatPass,
    share: Image,
    reach: npt.NDArray[np.int64],
    limit: Image,
    corner: tuple[int, int] = (0, 0),
) -> SplatPass:
    """Return a frame with its pixels weighted, and with what lies beyond its border.

    There, the nearest pixel on the border is repeated, as far as its PSF reaches back into the frame; lamps are dimmed.

    Parameters
    ----------
    frame : SplatPass
        The labelled pixels of the frame, unshifted, with stride 1 and origin (0, 0).
    share : ndarray of shape (H, W) or (0, 0), float32
        Weight of each pixel; empty if all are 1.
    reach : ndarray of shape (n_variants,), int64
        How far each variant's splat reaches from its pixel, px.
    limit : ndarray of shape (h, w), float32
        How bright what lies beyond the border may be, see `border_limit`; empty if nothing lies there.
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
    if len(limit) and len(reach):
        edges = frame.label[0], frame.label[-1], frame.label[:, 0], frame.label[:, -1]
        top, bottom, left, right = (int(reach[edge[edge >= 0] % len(reach)].max(initial=0)) for edge in edges)
        top, left = (side + (at - side) % STRIDES[-1] for side, at in zip((top, left), corner, strict=True))
    elif not len(share):
        return frame
    # Repeat pixels outwards.
    shape = top + height + bottom, left + width + right
    extended = SplatPass((-top, -left), buffer((*shape, 4)), buffer(shape, np.int32))
    for_bands(
        _border_kernels.extend_frame,
        shape[0],
        Weighted(frame.radiance, share, frame.label),
        limit,
        reach,
        extended.origin,
        extended.radiance,
        extended.label,
    )
    return extended


@Remembered
def border_limit(radiance: Image) -> Image:
    """Return how bright what goes on beyond the border of colours (H, W, 4) may be, in blocks, shape (h, w).

    What it says of blocks that are not on the border means nothing.

    A plain repetition would turn a lamp at the border into a row of lamps, and its bokeh would grow brighter towards
    the border.
    """
    shape = tuple(-(-side // _border_kernels.BLOCK) for side in radiance.shape[:2])
    light, limit = np.empty((*shape, 2)), np.empty(shape, np.float32)
    for_bands(_border_kernels.sum_light, len(light), radiance, light)
    for_bands(_border_kernels.limit_light, len(light), light, limit)
    return limit
