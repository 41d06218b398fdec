"""Compiled kernels that sort the splats of stochastic samples by place and PSF, and add up those that agree."""

import numpy as np

from spreadlets.compiled import helper, kernel
from spreadlets.runtime.plan._border_kernels import colour_beyond

STEP_BITS = 4
STEPS_PER_PIXEL = 1 << STEP_BITS
"""A splat's centre is placed to 1/16 px; what lies between pixels is split bilinearly."""


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
                steps[row, col, axis] = np.int32(step)


@kernel
def list_splats(begin, end, pixels, colours, padding, reach, first_row, at, splats):
    """Count the splats of labelled pixels in each row of the image, or list them.

    A splat whose centre lies between pixels becomes up to four. Pixels beyond the frame's border are drawn with the
    label and the shift of the nearest one in it. What cannot reach the frame is left out.

    Parameters
    ----------
    pixels : tuple of four ndarrays
        Colours (H, W, 4), float32; weights (H, W), float32; labels (H, W), int32; steps (H, W, 2) of `place_steps`.
    colours : tuple of four ndarrays of shapes (W, 4), (W, 4), (H, 4) and (H, 4), float32
        What lies above, below, left and right of the frame.
    padding : tuple of four ints
        By how many pixels the frame is continued above, below, left and right.
    reach : ndarray of shape (n_variants,), int64
        How far each variant reaches from its centre, px.
    first_row : int
        The first row in which there may be a splat.
    at : ndarray of shape (n_chunks, n_rows), int64
        For each chunk of the frame's rows and each row of splats, where the next splat goes in the list; increased.
        From zeros on, it counts.
    splats : tuple of three ndarrays
        Labels (n,), int32; columns (n,), int32; weighted colours (n, 4), float32; filled, or empty just to count.
    """
    radiance, weight, label, steps = pixels
    top, bottom, left, right = padding
    out_label, out_col, out_radiance = splats
    filling = len(out_label) > 0
    height, width = label.shape
    rows, cols = top + height + bottom, left + width + right
    n_chunks = len(at)
    for chunk in range(begin, end):
        for i in range(chunk * rows // n_chunks, (chunk + 1) * rows // n_chunks):
            down = i - top
            row = min(max(down, 0), height - 1)
            for j in range(cols):
                across = j - left
                col = min(max(across, 0), width - 1)
                index = label[row, col]
                if index < 0:
                    continue
                colour = radiance[row, col]
                if down != row or across != col:
                    colour = colour_beyond(colours, down, across, row, col)
                if colour[0] == 0 and colour[1] == 0 and colour[2] == 0 and colour[3] == 0:
                    continue
                far = reach[index % len(reach)]
                step_y, step_x = np.int64(steps[row, col, 0]), np.int64(steps[row, col, 1])
                # Shifts and masks take the floor of negative steps, too.
                part_y, part_x = step_y & (STEPS_PER_PIXEL - 1), step_x & (STEPS_PER_PIXEL - 1)
                first_y, first_x = down + (step_y >> STEP_BITS), across + (step_x >> STEP_BITS)
                for y in range(max(first_y, -far), min(first_y + 1 + (part_y > 0), height + far)):
                    for x in range(max(first_x, -far), min(first_x + 1 + (part_x > 0), width + far)):
                        place = at[chunk, y - first_row]
                        at[chunk, y - first_row] = place + 1
                        if filling:
                            share = (STEPS_PER_PIXEL - part_y if y == first_y else part_y) * (
                                STEPS_PER_PIXEL - part_x if x == first_x else part_x
                            )
                            part = weight[row, col] * np.float32(share / STEPS_PER_PIXEL**2)
                            out_label[place] = index
                            out_col[place] = x
                            for c in range(4):
                                out_radiance[place, c] = part * colour[c]


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
    splats : tuple of three ndarrays
        As for `list_splats`.
    order, row_start : ndarray
        See `sort_rows`.
    place_start : ndarray of shape (n_rows + 1,), int64
        Where the sums of each row go.
    first : tuple of two ints
        Row and column in the frame of row 0 and column 0.
    pooled : tuple of three ndarrays
        Colours (m, 4), float32; labels (m,), int32; and shifts (m, 2), int32: row, and column less the place in the
        list, as if all were one row of pixels. Filled.
    """
    label, col, radiance = splats
    out_radiance, out_label, out_shift = pooled
    for row in range(begin, end):
        place = place_start[row] - 1
        for k in range(row_start[row], row_start[row + 1]):
            i, j = order[k], order[k - 1]
            if k == row_start[row] or label[i] != label[j] or col[i] != col[j]:
                place += 1
                out_label[place] = label[i]
                out_shift[place, 0] = first[0] + row
                out_shift[place, 1] = first[1] + col[i] - place
                out_radiance[place] = np.float32(0.0)
            for c in range(4):
                out_radiance[place, c] += radiance[i, c]
