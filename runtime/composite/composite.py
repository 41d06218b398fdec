"""Compositing: each layer is normalised, filled where it was hidden, and put behind the nearer ones."""

from __future__ import annotations

import math

import numpy as np

from spreadlets.arrays import NOTHING, Image
from spreadlets.parallel import for_bands
from spreadlets.remembered import Remembered
from spreadlets.runtime._lamp_kernels import BRIGHTEST
from spreadlets.runtime.box_blur import box_blurred
from spreadlets.runtime.buffers import buffer
from spreadlets.runtime.composite import _fill_kernels
from spreadlets.runtime.composite._fill_kernels import COUNT, COVERAGE, LAST, REST
from spreadlets.runtime.composite.lanes import Lanes
from spreadlets.runtime.label.tiles import largest_around, tiling
from spreadlets.scans import count_alphas

LEAST_SEEN = 0.98, 4.0
"""Share of a pixel that must have been seen for it to stand for itself, all but rounding; and how much of one of a
coarser level, in pixels. What is missing to this is filled: the little that was seen of a pixel is no more likely all
over it than what was seen around."""
MIN_SUM = 1e-9
"""Where not even the coarsest level has seen more than this, a layer is empty."""
LEAST_BITS = 3
"""Blocks around which the brightness of a layer is taken have sides of at least 2^3 px; of wide blurs, of their discs.
"""
LEAST_WEIGHT, UNLIMITED = 1e-3, 1e30
"""Weight of a layer around a block, px, that tells how bright it is; and how bright it may be where there is less."""
NO_WEIGHT = np.float32(1e-3)
"""Weight of a colour that is as good as none: ten times the error of the solver."""
FAR_OFF = 0x155555
"""Rows and columns that the pyramid's first pair lies before the picture's centre. Pairs of pairs end at multiples of
2, 4, 8 ... from there: with every other bit set, the centre is not where many end."""
NOTHING_TOLD = np.zeros((0, 0, 5), np.float32)
"""Where there are no lanes."""

__all__ = ["COUNT", "COVERAGE", "LAST", "LEAST_SEEN", "REST", "add_layer", "even_colours", "is_opaque"]


def add_layer(
    image: Image,
    padded: Image,
    origin: tuple[int, int],
    kind: int,
    *,
    seen: Image = NOTHING,
    beyond: Image = NOTHING,
    least: tuple[float, float] = LEAST_SEEN,
    corner: tuple[int, int] = (0, 0),
    blur: float | None = None,
    lanes: Lanes | None = None,
) -> None:
    """Normalise a layer and put it behind an image, in place.

    The sums of a layer's splats are divided by what they would be if the layer were everywhere. That measure is, by
    ``kind``:

    - `COVERAGE`: 1; nothing was hidden.
    - `REST`: the layer's own weight, and of what that leaves of 1 the share ``seen`` that lies beyond the layer; the
      other share was hidden by nearer ones. So what was seen stands for what was hidden beside it.
    - `COUNT`: for stochastic samples, the layer's own weight and the number ``seen`` that passed it: a sample that
      passes a layer is a hole in it (SLR section 5).
    - `LAST`: the layer's own weight; behind an opaque last layer there is nothing.

    Where the measure is small, little is known; it is filled from the surroundings, level by level of a pyramid.

    Parameters
    ----------
    image : ndarray of shape (H, W, 4), float32
        Premultiplied colour and alpha of the nearer layers.
    padded : ndarray of shape (rows, cols, 4), float32
        Sums of the layer's splats.
    origin : tuple of two ints
        Row and column, in the image, of the canvas's first pixel.
    kind : int
    seen : ndarray of shape (H, W), float32
    beyond : ndarray of shape (H, W), float32
        How much more is seen of the layer than the image leaves in the mean, see `runtime.composite.overlap`.
    least : tuple of two floats
        Measures from which a pixel, and one of a coarser level, stand for themselves.
    corner : tuple of two ints
        Row and column of the image's first pixel, counted from the picture's centre: the pyramid divides the picture,
        whatever part of it the image holds.
    blur : float, optional
        How far the layer's pixels blur, px, if it is not to be filled with the light of lamps.
    lanes : Lanes, optional
        What moves far in focus: what they tell is not filled.
    """
    bound, bound_of_levels = map(np.float32, least)
    sums, shape = (padded, *origin, seen, kind), image.shape[:2]
    if not any(for_bands(_fill_kernels.is_unseen, len(image), *sums, bound, shape)):
        for_bands(_fill_kernels.add_layer, len(image), image, beyond, *sums)
        return
    # Sum it up in the levels of a pyramid.
    odds = [_odd(corner, 0)]
    levels = [_half_size(image, odds[0])]
    lamps = (NOTHING, NOTHING, 0, (0, 0)) if blur is None else _lamps(padded, origin, corner, blur)
    for_bands(_fill_kernels.pull_sums, len(levels[0]), *sums, lamps, shape, odds[0], levels[0])
    while max(levels[-1].shape[:2]) > 1:
        odds.append(_odd(corner, len(levels)))
        levels.append(_half_size(levels[-1], odds[-1]))
        for_bands(_fill_kernels.pull, len(levels[-1]), levels[-2], odds[-1], levels[-1])
    # Fill each level from the coarser one, and put the layer behind the image.
    top = levels[-1]
    top /= np.maximum(top[..., 4:], MIN_SUM)
    for fine, coarse, odd in zip(levels[-2::-1], levels[:0:-1], odds[:0:-1], strict=True):
        for_bands(_fill_kernels.push, len(fine), fine, coarse, odd, bound_of_levels)
    told = NOTHING_TOLD if lanes is None else lanes.told(padded, origin, seen, kind)
    for_bands(_fill_kernels.add_filled, len(image), image, beyond, *sums, levels[0], odds[0], bound, told)


def even_colours(padded: Image, white: Image, lights: Image) -> None:
    """Give the colours of a layer's sums the weight that its alpha has, in place.

    Where one cell of a database ends and the next begins, glass shifts each colour by a little more or less: a line is
    left in which there is too much of one and too little of another.

    Parameters
    ----------
    padded : ndarray of shape (rows, cols, 4), float32
        Sums of the layer's splats.
    white : ndarray of shape (rows, cols, 4), float32
        What they would be if all of the layer were white.
    lights : ndarray of shape (rows, cols, 4), float32
        The part of them that comes from highlights, which have PSFs of their own place, and stays.
    """
    weight = np.maximum(white, np.float32(0.0)) + NO_WEIGHT
    padded[..., :3] += (padded - lights)[..., :3] * (weight[..., 3:] / weight[..., :3] - np.float32(1.0))


def _lamps(
    padded: Image, origin: tuple[int, int], corner: tuple[int, int], blur: float
) -> tuple[Image, Image, int, tuple[int, int]]:
    """Return how bright what lies hidden may be in blocks of a layer's sums, see `_fill_kernels.pull_sums`.

    Blocks lie as the picture's centre does.
    """
    bits = max(LEAST_BITS, math.ceil(math.log2(max(2.0 * blur, 1.0))))
    side, own = 1 << bits, (corner[0] + origin[0], corner[1] + origin[1])
    first = own[0] % side, own[1] % side
    light = np.empty((2, *tiling(padded.shape[:2], side, own)), np.float32)
    for_bands(_fill_kernels.sum_light, light.shape[1], padded, bits, first, light)
    total, weight = (box_blurred(each, 1) for each in light)
    # The light is the fourth power of its evened mean; where hardly anything of the layer is, nothing tells it.
    known = weight > LEAST_WEIGHT
    mean = np.where(known, total, 0.0) / np.where(known, weight, 1.0)
    limits = np.where(known, BRIGHTEST * mean**4, UNLIMITED).astype(np.float32)
    # A pixel's limit is between those of its block and the ones beside.
    return limits, -largest_around(-limits, 1), bits, first


def _odd(corner: tuple[int, int], level: int) -> tuple[int, int]:
    """Return whether the first row and column of a level are the second of their pairs, 0 or 1."""
    row, column = (((place + FAR_OFF) >> level) & 1 for place in corner)
    return row, column


def _half_size(image: Image, odd: tuple[int, int]) -> Image:
    """Return room, for a level of the pyramid, for sums and their measure over 2 x 2 pixels of an image."""
    height, width = (size + first for size, first in zip(image.shape[:2], odd, strict=True))
    return buffer(((height + 1) // 2, (width + 1) // 2, 5))


@Remembered
def is_opaque(radiance: Image) -> bool:
    """Return whether every pixel (..., 4) is opaque."""
    return count_alphas(radiance).whole == radiance[..., 3].size
