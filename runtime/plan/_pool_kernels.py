"""Compiled kernels that sort the splats of stochastic samples by place and PSF, and add up those that agree."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import Image
from spreadlets.compiled import helper, kernel
from spreadlets.runtime.plan._border_kernels import dimming

STEP_BITS = 4
STEPS_PER_PIXEL = 1 << STEP_BITS
"""A splat's centre is placed to 1/16 px; what lies between pixels is split bilinearly."""
FARTHEST_STEP = 1 << 30
"""Farthest that a centre is placed from its pixel, in these: beyond any frame, and held by an int32."""


class Splats(NamedTuple):
    """A list of splats: labels (n,) and columns (n,), int32; weighted colours (n, 4), float32."""

    label: npt.NDArray[np.int32]
    col: npt.NDArray[np.int32]
    radiance: Image


class Stepped(NamedTuple):
    """Pixels: colours (H, W, 4), float32; weights and labels (H, W); steps (H, W, 2) of `place_steps`; places.

    Places (H, W, 2), int32, are rows and columns in the frame of the pixels of a list, and empty for a frame.
    """

    radiance: Image
    weight: Image
    label: npt.NDArray[np.int32]
    steps: npt.NDArray[np.int32]
    at: npt.NDArray[np.int32]


class Pooled(NamedTuple):
    """Sums of splats as if all were one row of pixels: colours (m, 4); labels (m,), int32; shifts (m, 2), int32.

    A shift holds the row, and the column less the place in the list.
    """

    radiance: Image
    label: npt.NDArray[np.int32]
    shift: npt.NDArray[np.int32]


class Sides(NamedTuple):
    """By how many pixels a frame is continued on each side."""

    above: int
    below: int
    left: int
    right: int


@kernel
def place_steps(begin, end, shift, label, wide, steps):
    """Fill ``steps`` (H, W, 2), int32, with the displacement (row, col) of each splat's centre, in 1/16 px.

    Parameters
    ----------
    shift : ndarray of shape (H, W, 2), float32
        Displacement (x, y), px.
    label : ndarray of shape (H, W), int32
        ``layer * n_variants + variant``, negative where nothing is drawn.
    wide : ndarray of shape (n_variants,), bool
        Variants whose centres are moved to the next pixel.
    """
    for row in range(begin, end):
        for col in range(label.shape[1]):
            index = label[row, col]
            whole = index >= 0 and wide[index % len(wide)]
            for axis in range(2):
                place = np.float64(shift[row, col, 1 - axis]) if index >= 0 else 0.0
                step = np.rint(place) * STEPS_PER_PIXEL if whole else np.rint(place * STEPS_PER_PIXEL)
                steps[row, col, axis] = np.int32(min(max(step, -FARTHEST_STEP), FARTHEST_STEP))


@kernel
def list_splats(begin, end, pixels, shape, limit, padding, reach, first_row, at, splats):
    """Count the splats of labelled pixels in each row of the image, or list them.

    A splat whose centre lies between pixels becomes up to four. Beyond the frame's border, the nearest pixel in it is
    drawn again. What cannot reach the frame is left out.

    Parameters
    ----------
    pixels : Stepped
    shape : tuple of two ints
        Height and width of the frame.
    limit : ndarray of shape (h, w), float32
        How bright they may be beyond the border, see `runtime.plan.border.border_limit`; not read without padding.
    padding : Sides
    reach : ndarray of shape (n_variants,), int64
        How far each variant reaches from its centre, px.
    first_row : int
        The first row in which there may be a splat.
    at : ndarray of shape (n_chunks, n_rows), int64
        For each chunk of the frame's rows and each row of splats, where the next splat goes in the list; increased.
        From zeros on, it counts.
    splats : Splats
        Filled, or empty just to count.
    """
    radiance, weight, label, steps, places = pixels
    listed_label, listed_col, listed_radiance = splats
    (n_rows, n_cols), (height, width), n_chunks = label.shape, shape, len(at)
    for chunk in range(begin, end):
        for i in range(chunk * n_rows // n_chunks, (chunk + 1) * n_rows // n_chunks):
            for j in range(n_cols):
                index = label[i, j]
                if index < 0 or weight[i, j] == 0:
                    continue
                row, col = i, j
                if len(places):
                    row, col = np.int64(places[i, j, 0]), np.int64(places[i, j, 1])
                red, green = radiance[i, j, 0], radiance[i, j, 1]
                blue, alpha = radiance[i, j, 2], radiance[i, j, 3]
                if red == 0 and green == 0 and blue == 0 and alpha == 0:
                    continue
                # Shifts and masks take the floor of negative steps, too.
                step_y, step_x, far = np.int64(steps[i, j, 0]), np.int64(steps[i, j, 1]), reach[index % len(reach)]
                part_y, part_x = step_y & (STEPS_PER_PIXEL - 1), step_x & (STEPS_PER_PIXEL - 1)
                # What lies on the border is drawn again beyond it, as far as it was found to reach back.
                top, left = row - (padding.above if row == 0 else 0), col - (padding.left if col == 0 else 0)
                bottom = row + (padding.below if row == height - 1 else 0)
                right = col + (padding.right if col == width - 1 else 0)
                # Of these, what is drawn lies in reach of the frame.
                moved_y, moved_x = step_y >> STEP_BITS, step_x >> STEP_BITS
                top, bottom = max(top, -far - 1 - moved_y), min(bottom, height + far - 1 - moved_y)
                left, right = max(left, -far - 1 - moved_x), min(right, width + far - 1 - moved_x)
                for down in range(top, bottom + 1):
                    for across in range(left, right + 1):
                        light = np.float32(1.0)
                        if down != row or across != col:
                            light = dimming(radiance, i, j, limit, row, col)
                        # Share it between the pixels around its centre.
                        first_y, first_x = down + moved_y, across + moved_x
                        for y in range(max(first_y, -far), min(first_y + 1 + (part_y > 0), height + far)):
                            for x in range(max(first_x, -far), min(first_x + 1 + (part_x > 0), width + far)):
                                place = at[chunk, y - first_row]
                                at[chunk, y - first_row] = place + 1
                                if not len(listed_label):
                                    continue
                                share = (STEPS_PER_PIXEL - part_y if y == first_y else part_y) * (
                                    STEPS_PER_PIXEL - part_x if x == first_x else part_x
                                )
                                part = weight[i, j] * np.float32(share / STEPS_PER_PIXEL**2)
                                listed_label[place], listed_col[place] = index, x
                                lit = part * light
                                listed_radiance[place, 0], listed_radiance[place, 1] = lit * red, lit * green
                                listed_radiance[place, 2], listed_radiance[place, 3] = lit * blue, part * alpha


@helper
def _counting_sort(values, order, count, result):
    """Sort ``order`` by ``values[order]``, equal ones as they were, into ``result``; ``count`` has room for all values.

    ``count`` has one place more than there are values, and is zero before and after.
    """
    for k in order:
        count[values[k] + 1] += 1
    for value in range(1, len(count)):
        count[value] += count[value - 1]
    for k in order:
        place = count[values[k]]
        count[values[k]] = place + 1
        result[place] = k
    count[:] = 0


@kernel
def sort_rows(begin, end, label, col, row_start, n_labels, n_cols, order, n_places):
    """Sort the splats of each row by label, then by column; count the different ones.

    Parameters
    ----------
    label, col : ndarray of shape (n,), int32
        Columns may not be negative.
    row_start : ndarray of shape (n_rows + 1,), int64
        The splats of each row.
    n_labels, n_cols : int
        One more than the largest of each.
    order : ndarray of shape (n,), int64
        Filled.
    n_places : ndarray of shape (n_rows,), int64
        Filled with the number of different (label, column) in each row.
    """
    of_label, of_col = np.zeros(n_labels + 1, np.int64), np.zeros(n_cols + 1, np.int64)
    for row in range(begin, end):
        first, last = row_start[row], row_start[row + 1]
        by_col = np.empty(last - first, np.int64)
        _counting_sort(col, np.arange(first, last), of_col, by_col)
        _counting_sort(label, by_col, of_label, order[first:last])
        n_places[row] = 0
        for k in range(first, last):
            i, j = order[k], order[k - 1]
            n_places[row] += k == first or label[i] != label[j] or col[i] != col[j]


@kernel
def add_up(begin, end, splats, order, row_start, place_start, first, pooled):
    """Add up the splats of each row that have label and column in common.

    Parameters
    ----------
    splats : Splats
    order, row_start : ndarray
        See `sort_rows`.
    place_start : ndarray of shape (n_rows + 1,), int64
        Where the sums of each row go.
    first : tuple of two ints
        Row and column in the frame of row 0 and column 0.
    pooled : Pooled
        Filled.
    """
    label, col, radiance = splats
    sums, sum_label, shift = pooled
    for row in range(begin, end):
        place = place_start[row] - 1
        for k in range(row_start[row], row_start[row + 1]):
            i, j = order[k], order[k - 1]
            if k == row_start[row] or label[i] != label[j] or col[i] != col[j]:
                place += 1
                sum_label[place] = label[i]
                shift[place, 0] = first[0] + row
                shift[place, 1] = first[1] + col[i] - place
                for c in range(4):
                    sums[place, c] = np.float32(0.0)
            for c in range(4):
                sums[place, c] += radiance[i, c]
