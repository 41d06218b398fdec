"""Compiled kernels that add up the splats of pixels that agree in place and PSF."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import Image
from spreadlets.compiled import helper, kernel
from spreadlets.runtime._vector_kernels import add, load, multiply, store
from spreadlets.runtime.label._label_kernels import on_parabola, power, turns_evenly
from spreadlets.runtime.plan._border_kernels import dimming

_U = np.uint64
STEP_BITS = 4
STEPS_PER_PIXEL = 1 << STEP_BITS
"""A splat's centre is placed to 1/16 px; what lies between pixels is split bilinearly."""
FARTHEST_STEP = 1 << 30
"""Farthest that a centre is placed from its pixel, in these: beyond any frame, and held by an int32."""
SPREAD_BITS = 30
SPREAD = (663608943, 444758425)
"""Multiples of line and column, in units of 2 to the power of -`SPREAD_BITS`, whose fraction says where in a table a
sum is looked for: the golden ratio and the root of 2, by which neighbours lie apart evenly (multiplicative hashing)."""


class Way(NamedTuple):
    """The way of each pixel: motion (H, W, 2) before and after, and when the shutter opens and closes, frames."""

    before: Image
    after: Image
    shutter: tuple[float, float]


class Stepped(NamedTuple):
    """Pixels, and where their splats lie.

    Attributes
    ----------
    radiance : ndarray of shape (H, W, 4), float32
    weight : ndarray of shape (H, W), float32
    label : ndarray of shape (H, W), int32
    steps : ndarray of shape (n, 2), int32
        Displacements of `place_steps`.
    first : ndarray of shape (H * W + 1,) or (0,), int64
        Where those of each pixel begin; empty if each has one.
    share : ndarray of shape (m,), float32
        Shares of the light of a pixel with several; they begin at ``n * (n - 1) / 2`` for n.
    at : ndarray of shape (H, W, 2) or (0, 0, 2), int32
        Rows and columns in the frame of the pixels of a list; empty for a frame.
    """

    radiance: Image
    weight: Image
    label: npt.NDArray[np.int32]
    steps: npt.NDArray[np.int32]
    first: npt.NDArray[np.int64]
    share: Image
    at: npt.NDArray[np.int32]


class Sums(NamedTuple):
    """Sums of splats by label and place, in the order in which these came up.

    Attributes
    ----------
    slot : ndarray of shape (n_slots,), int32
        Numbers of sums; -1 where there is none.
    key : ndarray of shape (most,), int64
        What each is of: ``(row * n_labels + label) * n_cols + col``.
    radiance : ndarray of shape (4 * most,), float32
    n_sums : int
        How many there are.
    """

    slot: npt.NDArray[np.int32]
    key: npt.NDArray[np.int64]
    radiance: Image
    n_sums: int


class Sides(NamedTuple):
    """By how many pixels a frame is continued on each side."""

    above: int
    below: int
    left: int
    right: int


@helper
def _step(place, whole):
    """Return a displacement, px, in 1/16 px."""
    step = np.rint(place) * STEPS_PER_PIXEL if whole else np.rint(place * STEPS_PER_PIXEL)
    return np.int32(min(max(step, -FARTHEST_STEP), FARTHEST_STEP))


@helper
def _own_steps(first, number):
    """Return the first of a pixel's displacements, and the one behind the last."""
    return (first[number], first[number + 1]) if len(first) else (number, number + 1)


@kernel
def place_steps(begin, end, shift, label, wide, way, first, steps):
    """Fill ``steps`` (n, 2), int32, with the displacement (row, col) of each splat's centre, in 1/16 px.

    Parameters
    ----------
    shift : ndarray of shape (H, W, 2), float32
        Displacement (x, y), px.
    label : ndarray of shape (H, W), int32
        ``layer * n_variants + variant``, negative where nothing is drawn.
    wide : ndarray of shape (n_variants,), bool
        Variants whose centres are moved to the next pixel.
    way : Way
        Along which there are several for each pixel, counted from ``shift``; not read if there are not. They lie amid
        equal steps of the shutter's time, see `runtime.label.trail.Trail`.
    first : ndarray of shape (H * W + 1,) or (0,), int64
        See `Stepped`.
    """
    before, after, (opens, closes) = way
    for row in range(begin, end):
        for col in range(label.shape[1]):
            if label[row, col] < 0:
                continue
            whole, x, y = wide[label[row, col] % len(wide)], shift[row, col, 0], shift[row, col, 1]
            start, stop = _own_steps(first, row * label.shape[1] + col)
            if not len(first):
                steps[start, 0], steps[start, 1] = _step(np.float64(y), whole), _step(np.float64(x), whole)
                continue
            p = complex(before[row, col, 0], before[row, col, 1])
            n = complex(after[row, col, 0], after[row, col, 1])
            # Of an even turn, one place is a constant turn and growth away from the next.
            even, each = turns_evenly(p, n), (closes - opens) / (stop - start)
            q = n / p if even else complex(1.0, 0.0)
            scale = n / (q - 1.0) if even else complex(0.0, 0.0)
            turned, turn = power(q, opens + 0.5 * each), power(q, each)
            for k in range(start, stop):
                z = scale * (turned - 1.0) if even else on_parabola(p, n, opens + (k - start + 0.5) * each)
                turned *= turn
                steps[k, 0] = _step(np.float64(y + np.float32(z.imag)), whole)
                steps[k, 1] = _step(np.float64(x + np.float32(z.real)), whole)


@helper
def _continued(row, col, shape, padding, down, across, far):
    """Return the first and the last row, and column, that a pixel is drawn in: of one on the border, also beyond it.

    Of these, what is drawn so many rows down and columns across lies in reach of the frame.
    """
    top, left = row - (padding.above if row == 0 else 0), col - (padding.left if col == 0 else 0)
    bottom = row + (padding.below if row == shape[0] - 1 else 0)
    right = col + (padding.right if col == shape[1] - 1 else 0)
    top, bottom = max(top, -far - 1 - down), min(bottom, shape[0] + far - 1 - down)
    left, right = max(left, -far - 1 - across), min(right, shape[1] + far - 1 - across)
    return top, bottom, left, right


@helper
def _place(places, i, j):
    """Return row and column in the frame of a pixel."""
    if len(places):
        return np.int64(places[i, j, 0]), np.int64(places[i, j, 1])
    return i, j


@kernel
def list_pixels(begin, end, pixels, frame, reach, rows, at, n_splats, listed):
    """Count the labelled pixels whose splats reach each block of rows of the image, or list them.

    A splat whose centre lies between pixels becomes up to four. Beyond the frame's border, the nearest pixel in it is
    drawn again. What cannot reach the frame is left out.

    Parameters
    ----------
    pixels : Stepped
    frame : tuple
        Height and width of the frame, and its padding, `Sides`.
    reach : ndarray of shape (n_variants,), int64
        How far each variant reaches from its centre, px.
    rows : tuple of two ints
        The first row in which there may be a splat, and the rows of a block.
    at : ndarray of shape (n_chunks, n_blocks), int64
        For each chunk of the pixels' rows and each block, where the next pixel goes in the list; increased. From zeros
        on, it counts.
    n_splats : ndarray of shape (n_chunks,), int64
        Filled with how many splats each chunk has at most.
    listed : ndarray of shape (n,), int32
        Filled with numbers of pixels in raster order, or empty just to count.
    """
    radiance, weight, label, steps, own, _, places = pixels
    shape, padding = frame
    (n_rows, n_cols), n_chunks, (first_row, block_rows) = label.shape, len(at), rows
    for chunk in range(begin, end):
        n_splats[chunk] = 0
        for i in range(chunk * n_rows // n_chunks, (chunk + 1) * n_rows // n_chunks):
            for j in range(n_cols):
                index = label[i, j]
                if index < 0 or weight[i, j] == 0:
                    continue
                r, g, b, alpha = radiance[i, j, 0], radiance[i, j, 1], radiance[i, j, 2], radiance[i, j, 3]
                if r == 0 and g == 0 and b == 0 and alpha == 0:
                    continue
                row, col = _place(places, i, j)
                far, first, last = reach[index % len(reach)], at.shape[1], -1
                start, stop = _own_steps(own, i * n_cols + j)
                for k in range(start, stop):
                    # Shifts and masks take the floor of negative steps, too.
                    step_y, step_x = np.int64(steps[k, 0]), np.int64(steps[k, 1])
                    moved = step_y >> STEP_BITS, step_x >> STEP_BITS
                    top, bottom, left, right = _continued(row, col, shape, padding, *moved, far)
                    if top > bottom or left > right:
                        continue
                    down, across = step_y & (STEPS_PER_PIXEL - 1), step_x & (STEPS_PER_PIXEL - 1)
                    parts = (1 + (down > 0)) * (1 + (across > 0))
                    n_splats[chunk] += parts * (bottom - top + 1) * (right - left + 1)
                    highest = max(top + (step_y >> STEP_BITS), -far)
                    lowest = min(bottom + (step_y >> STEP_BITS) + (down > 0), shape[0] + far - 1)
                    first = min(first, (highest - first_row) // block_rows)
                    last = max(last, (lowest - first_row) // block_rows)
                for block in range(first, last + 1):
                    place = at[chunk, block]
                    at[chunk, block] = place + 1
                    if len(listed):
                        listed[place] = i * n_cols + j


@helper
def _slot_of(slot, key, line, col, n_cols):
    """Return the slot of a sum, or the free one where it belongs."""
    wanted, spread = line * n_cols + col, (line * SPREAD[0] + (col >> 2) * SPREAD[1]) & ((1 << SPREAD_BITS) - 1)
    place = _U((((spread * len(slot)) >> SPREAD_BITS) & -4) + (col & 3))
    while slot[place] >= 0 and key[_U(slot[place])] != wanted:
        place = place + _U(4) if place + _U(4) < _U(len(slot)) else place + _U(4) - _U(len(slot))
    return place


@kernel
def enter(begin, end, key, n_cols, slot):
    """Enter the sums with numbers from ``begin`` to ``end`` into a table ``slot``, see `Sums`."""
    for number in range(begin, end):
        slot[_slot_of(slot, key, key[number] // n_cols, key[number] % n_cols, n_cols)] = number


@kernel
def add_splats(begin, end, listed, resume, pixels, frame, limit, reach, sizes, sums):
    """Add the splats of listed pixels in some rows of the image to the sums of their labels and places.

    Parameters
    ----------
    begin, end : int
        The rows.
    listed : ndarray of shape (n,), int32
        Numbers of pixels in raster order.
    resume : tuple of two ints
        Where in this list, and with which of the splats of that pixel, to begin.
    pixels : Stepped
    frame, reach
        See `list_pixels`.
    limit : ndarray of shape (h, w), float32
        How bright they may be beyond the border, see `runtime.plan.border.border_limit`; not read without padding.
    sizes : tuple of three ints
        Number of labels; the first column in which there may be a splat, and the number of columns.
    sums : Sums
        Changed.

    Returns
    -------
    resume : tuple of two ints
        Where there is no more room.
    n_sums : int
        How many there are.
    """
    radiance, weight, label, steps, own, shares, places = pixels
    ((height, width), padding), (n_labels, first_col, n_cols) = frame, sizes
    slot, key, total, n = sums
    colours = radiance.reshape(radiance.size)
    for number_of in range(resume[0], len(listed)):
        number = np.int64(listed[number_of])
        i, j = number // label.shape[1], number % label.shape[1]
        index, pixel = np.int64(label[i, j]), load(colours, _U(4 * number))
        (row, col), far = _place(places, i, j), reach[index % len(reach)]
        start, stop = _own_steps(own, number)
        known = (stop - start) * (stop - start - 1) // 2
        for k in range(resume[1] if number_of == resume[0] else 0, stop - start):
            step_y, step_x = np.int64(steps[start + k, 0]), np.int64(steps[start + k, 1])
            whole_y, whole_x = step_y >> STEP_BITS, step_x >> STEP_BITS
            top, bottom, left, right = _continued(row, col, (height, width), padding, whole_y, whole_x, far)
            # Arrays do not grow here: each time that it may be another one takes as long as what is done with it.
            if n + (min(bottom - top, end - begin) + 2) * (right - left + 2) > len(key):
                return (number_of, k), n
            part_y, part_x = step_y & (STEPS_PER_PIXEL - 1), step_x & (STEPS_PER_PIXEL - 1)
            share = weight[i, j] * shares[known + k] if len(shares) else weight[i, j]
            # What lies on the border is drawn again beyond it, as far as it was found to reach back.
            for down in range(max(top, begin - 1 - whole_y), min(bottom + 1, end - whole_y)):
                for across in range(left, right + 1):
                    light = np.float32(1.0)
                    if down != row or across != col:
                        light = dimming(radiance, i, j, limit, row, col)
                    # Share it between the pixels around its centre.
                    y0, x0 = down + whole_y, across + whole_x
                    for y in range(max(y0, -far, begin), min(y0 + 1 + (part_y > 0), height + far, end)):
                        line, of_row = (y - begin) * n_labels + index, STEPS_PER_PIXEL - part_y if y == y0 else part_y
                        for x in range(max(x0, -far), min(x0 + 1 + (part_x > 0), width + far)):
                            of_pixel = of_row * (STEPS_PER_PIXEL - part_x if x == x0 else part_x)
                            part = share * np.float32(of_pixel / STEPS_PER_PIXEL**2)
                            # Find the sum that it goes into, or begin one.
                            place = _slot_of(slot, key, line, x - first_col, n_cols)
                            if slot[place] < 0:
                                slot[place], key[n] = n, line * n_cols + x - first_col
                                for c in range(4):
                                    total[4 * n + c] = np.float32(0.0)
                                n += 1
                            summed, lit = _U(4) * _U(slot[place]), part * light
                            store(total, summed, add(load(total, summed), multiply((lit, lit, lit, part), pixel)))
    return (len(listed), 0), n
