"""Continuing a frame beyond its border, so that what lies outside is blurred into it as what lies inside is."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy import ndimage

Image = npt.NDArray[np.float32]

BORDER_STRIP = 8
"""Depth, px, of the strip along a border whose median colour continues the frame."""
BORDER_MEDIAN = 15
"""Length, px, of the median along the border: a highlight shorter than half of it is not continued."""


def extended_radiance(radiance: Image, width: int) -> Image:
    """Continue a layer's colour beyond its borders by the robust colour of the nearest piece of border.

    A plain repetition would turn a highlight at the border into a streak of highlights outside, and its bokeh would
    grow brighter towards the border; the median leaves it out.

    Parameters
    ----------
    radiance : ndarray of shape (H, W, 4), float32
        Premultiplied colour.
    width : int
        Pixels to add on each side.

    Returns
    -------
    ndarray of shape (H + 2 width, W + 2 width, 4), float32
    """
    if width == 0:
        return radiance
    height, breadth = radiance.shape[:2]
    extended = np.empty((height + 2 * width, breadth + 2 * width, 4), np.float32)
    inside = slice(width, width + height), slice(width, width + breadth)
    extended[inside] = radiance
    extended[inside[0], :width] = _border_colour(radiance)[:, None]
    extended[inside[0], width + breadth :] = _border_colour(radiance[:, ::-1])[:, None]
    turned = radiance.transpose(1, 0, 2)
    for rows, colour in (
        (slice(None, width), _border_colour(turned)),
        (slice(width + height, None), _border_colour(turned[:, ::-1])),
    ):
        extended[rows] = np.pad(colour, ((width, width), (0, 0)), mode="edge")[None]
    return extended


def outside_distance(shape: tuple[int, int], width: int) -> npt.NDArray[np.int32]:
    """Return how many rows or columns, whichever is more, each pixel of an extended frame lies outside; 0 inside."""
    rows, cols = (np.pad(np.zeros(size, np.int32), width, mode="linear_ramp", end_values=width) for size in shape)
    return np.maximum(rows[:, None], cols[None, :])


def _border_colour(radiance: Image) -> Image:
    """Return the robust colour along the left border, shape (H, 4)."""
    strip = np.median(radiance[:, :BORDER_STRIP], axis=1)
    colour: Image = ndimage.median_filter(strip, size=(BORDER_MEDIAN, 1), mode="nearest")
    return colour
