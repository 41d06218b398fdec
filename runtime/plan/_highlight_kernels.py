"""Compiled kernels of highlights: which pixels stand out, and the steps to which their labels are rounded."""

import math
from typing import NamedTuple

import numpy as np

from spreadlets.arrays import FloatArray
from spreadlets.compiled import helper, kernel
from spreadlets.runtime.plan._display_kernels import display_slope
from spreadlets.runtime.plan._plan_kernels import INVISIBLE

NOT_ALONE = -1
"""Code of a pixel that is drawn with the PSF of its cell."""
HEADING_BITS = 17
HEADING_ZERO = 1 << (HEADING_BITS - 1)
"""Bits of a code for each of a heading's two steps; where 0 lies."""
EDGE_WIDTH = 3
"""How wide the edge of a lamp may be, px: filters of renderers reach about so far."""
COLUMNS = 64
"""Columns that are summed down together: they share their lines of the cache."""


class CodedLabels(NamedTuple):
    """Signed CoC radius (H, W) and length of the path (H, W), px; headings (H, W, 2), px, for directions."""

    coc: FloatArray
    length: FloatArray
    heading: FloatArray


class CodeSteps(NamedTuple):
    """How labels are rounded.

    Attributes
    ----------
    radius : float
        Steps of the CoC radius up to 1 px, as many up to 4 px, and so on with its square root.
    longest : float
        Longest step of the heading, px.
    thin_radius : float
        CoC radius, px, below which it is half as long.
    sided : bool
        Whether the sides of the focus differ.
    """

    radius: float
    longest: float
    thin_radius: float
    sided: bool


@kernel
def brightest(begin, end, radiance, light):
    """Fill ``light`` (H, W), float32, with the largest of R, G and B of each pixel of (H, W, 4)."""
    for row in range(begin, end):
        for col in range(light.shape[1]):
            light[row, col] = max(radiance[row, col, 0], radiance[row, col, 1], radiance[row, col, 2])


@kernel
def sums_along_rows(begin, end, plane, half, sums):
    """Sum a plane (H, W), float32, along its rows.

    Parameters
    ----------
    half : tuple of two ints
        Sums are over those of the ``2 half + 1`` pixels about each that are in the frame.
    sums : ndarray of shape (2, H, W), float32
        Filled, for each half.
    """
    width = plane.shape[1]
    for row in range(begin, end):
        for k in range(2):
            reach = half[k]
            total = np.float64(0.0)
            for col in range(min(reach, width)):
                total += plane[row, col]
            for col in range(width):
                if col + reach < width:
                    total += plane[row, col + reach]
                if col > reach:
                    total -= plane[row, col - reach - 1]
                sums[k, row, col] = total


@helper
def _pixels_about(place, size, half):
    """Return how many pixels of a row, or a column, of a size are no farther than ``half`` from one of them."""
    return min(place + half, size - 1) - max(place - half, 0) + 1


@helper
def _add_row(total, k, sums, row, begin, end, sign):
    """Add a row of sums, the columns from begin to end, times a sign, to ``total[k]``."""
    for col in range(begin, end):
        total[k, col - begin] += sign * sums[k, row, col]


@helper
def _move_down(total, sums, row, half, begin, end):
    """Move sums over rows (2, n) from the pixels of a row to those of the next, the columns from begin to end."""
    height = sums.shape[1]
    for k in range(2):
        if row + half[k] < height:
            _add_row(total, k, sums, row + half[k], begin, end, 1.0)
        if row > half[k]:
            _add_row(total, k, sums, row - half[k] - 1, begin, end, -1.0)


@kernel
def standing_out(first, last, light, sums, counts, half, limits, excess, level):
    """Find the pixels that stand out, and how much light their group adds to the display.

    Parameters
    ----------
    light, half
        See `brightest` and `sums_along_rows`.
    sums : ndarray of shape (2, H, W), float32
        Of the light, over the width of a group of pixels, and over that of its surroundings.
    counts : ndarray of shape (2, H, W) or (0, 0, 0), float32
        The same of the share of each pixel that is known; empty if all are.
    limits : tuple of two floats
        How many times brighter than its surroundings a pixel must be; how much of them must be known.
    excess : ndarray of shape (H, W), float32
        Filled with what the group about the pixel, or the pixel by itself, has above the mean of the surroundings,
        times the display's slope at that mean; 0 where the pixel does not stand out. Divided by the area of a PSF, it
        is how much the display changes under it.
    level : ndarray of shape (H, W), float32
        Filled with the mean of the surroundings; infinite where too little of them is known.
    """
    height, width = light.shape
    ratio, least_known = limits
    for part in range(first, last):
        begin, end = part * COLUMNS, min(part * COLUMNS + COLUMNS, width)
        # Begin the sliding sums of the group and its surroundings above the first row.
        total, known, n_cols = np.zeros((2, end - begin)), np.zeros((2, end - begin)), np.empty((2, end - begin))
        for k in range(2):
            for col in range(begin, end):
                n_cols[k, col - begin] = _pixels_about(col, width, half[k])
            for row in range(min(half[k], height)):
                _add_row(total, k, sums, row, begin, end, 1.0)
                if counts.shape[0]:
                    _add_row(known, k, counts, row, begin, end, 1.0)
        for row in range(height):
            # Slide both down to this row.
            _move_down(total, sums, row, half, begin, end)
            if counts.shape[0]:
                _move_down(known, counts, row, half, begin, end)
            else:
                for k in range(2):
                    n_rows = _pixels_about(row, height, half[k])
                    # One by one: the message about arrays of unlike lengths would take longer to compile than the rest.
                    for i in range(end - begin):
                        known[k, i] = n_rows * n_cols[k, i]
            least = least_known * _pixels_about(row, height, half[1])
            for col in range(begin, end):
                i = col - begin
                # Compare the pixel with the mean of the surroundings outside the group.
                own, n_around, around = (
                    np.float64(light[row, col]),
                    known[1, i] - known[0, i],
                    total[1, i] - total[0, i],
                )
                excess[row, col], level[row, col] = 0.0, math.inf
                if n_around > least * n_cols[1, i]:
                    mean = max(around, 0.0) / n_around
                    level[row, col] = mean
                    if own > ratio * mean:
                        more = max(total[0, i] - known[0, i] * mean, own - mean)
                        excess[row, col] = more * np.float64(display_slope(np.float32(mean)))


@kernel
def listed_excess(begin, end, light, at, frame_excess, level, ratio, excess):
    """Fill the excess of pixels of a list: that of the frame's pixel, or of their own light if it is brighter.

    Parameters
    ----------
    light : ndarray of shape (h, w), float32
    at : ndarray of shape (h, w, 2), int32
        Row and column in the frame.
    frame_excess, level : ndarray of shape (H, W), float32
        See `standing_out`, for the frame.
    ratio : float
        As there.
    excess : ndarray of shape (h, w), float32
        Filled.
    """
    for row in range(begin, end):
        for col in range(light.shape[1]):
            y, x = at[row, col, 0], at[row, col, 1]
            own, mean = np.float64(light[row, col]), np.float64(level[y, x])
            excess[row, col] = 0.0
            if own > ratio * mean:
                alone = (own - mean) * np.float64(display_slope(np.float32(mean)))
                excess[row, col] = max(np.float64(frame_excess[y, x]), alone)


@kernel
def sources_of_light(begin, end, at, light, ratio, source):
    """Find the pixels that the light of those that stand out is from: of a much brighter neighbour, or their own.

    Along the edge of a lamp pixels are blends: their light is the lamp's, their depth may be of what is behind.

    Parameters
    ----------
    at : ndarray of shape (n,), int64
        Places of pixels in the flattened frame.
    light : ndarray of shape (H, W), float32
        See `brightest`.
    ratio : float
        How many times as bright a neighbour must be.
    source : ndarray of shape (n,), int64
        Filled with the places that their light is from.
    """
    height, width = light.shape
    for number in range(begin, end):
        # Climb to the brightest neighbour while that is much brighter.
        here = at[number]
        for _ in range(EDGE_WIDTH):
            y, x = here // width, here % width
            there = here
            for i in range(max(y - 1, 0), min(y + 2, height)):
                for j in range(max(x - 1, 0), min(x + 2, width)):
                    if light[i, j] > light[there // width, there % width]:
                        there = i * width + j
            if light[there // width, there % width] <= ratio * light[y, x]:
                break
            here = there
        source[number] = here


@helper
def _code(key, excess, labels, steps, limits, row, col):
    """Return the labels of a pixel that stands out, rounded and packed; `NOT_ALONE` if it is no highlight."""
    if key[row, col] == INVISIBLE:
        return NOT_ALONE
    radius = abs(np.float64(labels.coc[row, col]))
    area = max(math.pi * radius * radius + 2.0 * radius * np.float64(labels.length[row, col]), 1.0)
    if excess[row, col] <= limits[0] * area or area > limits[1]:
        return NOT_ALONE
    n_steps = np.int64(steps.radius * math.sqrt(radius) + 0.5)
    is_thin = (n_steps / steps.radius) ** 2 < steps.thin_radius
    step_px = 0.5 * steps.longest if is_thin else steps.longest
    packed = 2 * n_steps
    if steps.sided and labels.coc[row, col] < 0.0:
        packed += 1
    for axis in range(2):
        place = np.float64(labels.heading[row, col, axis]) / step_px
        # Halves away from 0: mirror images are rounded to mirror images.
        step = np.int64(math.copysign(math.floor(abs(place) + 0.5), place))
        packed = (packed << HEADING_BITS) + min(max(step + HEADING_ZERO, 0), 2 * HEADING_ZERO - 1)
    return packed


@kernel
def count_highlights(begin, end, key, excess, labels, steps, limits, counts):
    """Fill ``counts`` (H,), int64, with the number of highlights in each row; see `list_highlights`."""
    for row in range(begin, end):
        counts[row] = 0
        for col in range(key.shape[1]):
            if excess[row, col] > 0.0:
                counts[row] += _code(key, excess, labels, steps, limits, row, col) != NOT_ALONE


@kernel
def list_highlights(begin, end, key, excess, labels, steps, limits, first, at, code):
    """List the highlights, with their labels, rounded, packed into codes.

    Parameters
    ----------
    key : ndarray of shape (H, W), int64
        See `runtime.plan._plan_kernels.variant_keys`: pixels that are invisible are none.
    excess : ndarray of shape (H, W), float32
        See `standing_out`.
    labels : CodedLabels
    steps : CodeSteps
    limits : tuple of two floats
        Change of the display under a PSF from which a pixel is a highlight; largest area of a PSF, px.
    first : ndarray of shape (H,), int64
        Where each row's begin in the list.
    at, code : ndarray of shape (n,), int64
        Filled with their places in the flattened frame, ascending, and their codes.
    """
    width = key.shape[1]
    for row in range(begin, end):
        number = first[row]
        for col in range(width):
            if excess[row, col] == 0.0:
                continue
            packed = _code(key, excess, labels, steps, limits, row, col)
            if packed != NOT_ALONE:
                at[number], code[number] = row * width + col, packed
                number += 1
