"""Continuing a frame beyond its border, so that what lies outside is blurred into it as what lies inside is."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import NOTHING, DoubleArray, Image
from spreadlets.parallel import for_bands
from spreadlets.remembered import Remembered
from spreadlets.runtime.buffers import buffer
from spreadlets.runtime.plan import _border_kernels
from spreadlets.runtime.plan._border_kernels import Border, Slopes, Weighted
from spreadlets.runtime.splat.passes import STRIDES, SplatPass

STRIP_PX = 16
"""Depth of the strip along the border that tells in which direction outlines reach it."""
AROUND_PX, NEAR_PX = 64, 10.0
"""How far to both sides along the border it is looked at; and how near that counts for the most: where nothing lies so
near, an outline farther off tells the direction."""
STEEPEST = 2.0
"""Most that an edge goes on along the border, px for each px outwards."""

NO_BORDER = Border(NOTHING, 4 * (np.zeros(0),))
"""Of a frame beyond which there is nothing."""


def extended_pass(
    frame: SplatPass,
    share: Image,
    reach: npt.NDArray[np.int64],
    border: Border,
    corner: tuple[int, int] = (0, 0),
) -> SplatPass:
    """Return a frame with its pixels weighted, and with what lies beyond its border.

    There, pixels on the border are repeated in the direction in which outlines reach it, as far as their PSFs reach
    back into the frame; lamps are dimmed.

    Parameters
    ----------
    frame : SplatPass
        The labelled pixels of the frame, unshifted, with stride 1 and origin (0, 0).
    share : ndarray of shape (H, W) or (0, 0), float32
        Weight of each pixel; empty if all are 1.
    reach : ndarray of shape (n_variants,), int64
        How far each variant's splat reaches from its pixel, px.
    border : Border
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
    if len(border.limit) and len(reach):
        edges = frame.label[0], frame.label[-1], frame.label[:, 0], frame.label[:, -1]
        top, bottom, left, right = (int(reach[edge[edge >= 0] % len(reach)].max(initial=0)) for edge in edges)
        top, left = (side + (at - side) % STRIDES[-1] for side, at in zip((top, left), corner, strict=True))
    elif not len(share):
        return frame
    # Repeat pixels outwards, along the outlines that reach the border.
    shape = top + height + bottom, left + width + right
    extended = SplatPass((-top, -left), buffer((*shape, 4)), buffer(shape, np.int32))
    for_bands(
        _border_kernels.extend_frame,
        shape[0],
        Weighted(frame.radiance, share, frame.label),
        border,
        reach,
        extended.origin,
        extended.radiance,
        extended.label,
    )
    return extended


@Remembered
def border_limit(radiance: Image) -> Image:
    """Return how bright what goes on beyond the border of colours (H, W, 4) may be, see `Border`.

    A plain repetition would turn a lamp at the border into a row of lamps, and its bokeh would grow brighter towards
    the border.
    """
    shape = tuple(-(-side // _border_kernels.BLOCK) for side in radiance.shape[:2])
    light, limit = np.empty((*shape, 2)), np.empty(shape, np.float32)
    for_bands(_border_kernels.sum_light, len(light), radiance, light)
    for_bands(_border_kernels.limit_light, len(light), light, limit)
    return limit


@Remembered
def edge_slopes(coc: Image) -> Slopes:
    """Return in which direction outlines reach the border of a frame, by its CoC radii (H, W); see `Border`.

    Straight outwards, every outline that reaches the border aslant would be bent there. Colours do not count: so what
    lies beyond the border stays linear in them.
    """
    above, below, left, right = (_slopes(each[: STRIP_PX + 1]) for each in (coc, coc[::-1], coc.T, coc.T[::-1]))
    return above, below, left, right


def _slopes(strip: Image) -> DoubleArray:
    """Return the slopes of outlines along the depths of a strip, of which the first row is the border; 0 without any.

    Along an outline, depths change the least: outwards they change by as much as they do along the border, times the
    slope, the other way round. It is found by least squares.
    """
    if min(strip.shape) < 3:
        return np.zeros(strip.shape[1])
    # Take gradients (Sobel).
    depth = strip.astype(np.float64)
    down, across = depth[2:] - depth[:-2], depth[:, 2:] - depth[:, :-2]
    inwards = down[:, :-2] + 2.0 * down[:, 1:-1] + down[:, 2:]
    along = across[:-2] + 2.0 * across[1:-1] + across[2:]
    # Sum up over the depth of the strip, and what lies around along it.
    counts = (1.0 + (np.arange(-AROUND_PX, AROUND_PX + 1) / NEAR_PX) ** 2) ** -2
    squares, products = (
        np.convolve((along * each).sum(axis=0), counts)[AROUND_PX - 1 :][: strip.shape[1]] for each in (along, inwards)
    )
    squares[squares == 0.0] = 1.0
    return np.clip(products / squares, -STEEPEST, STEEPEST)
