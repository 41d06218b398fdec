"""Compiled kernels that continue a frame beyond its border."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import Image
from spreadlets.compiled import helper, kernel
from spreadlets.runtime._vector_kernels import load, multiply, store

_U = np.uint64


class Colours(NamedTuple):
    """What lies beyond each side of a frame, shapes (W, 4), (W, 4), (H, 4) and (H, 4), float32."""

    above: Image
    below: Image
    left: Image
    right: Image


class Weighted(NamedTuple):
    """Pixels: colours (H, W, 4), float32; weights (H, W), or (0, 0) if all are 1, float32; labels (H, W), int32."""

    radiance: Image
    weight: Image
    label: npt.NDArray[np.int32]


@helper
def _median(values, n):
    """Return the median of the first n values, sorting them in place."""
    for i in range(1, n):
        each = values[i]
        k = i
        while k > 0 and values[k - 1] > each:
            values[k] = values[k - 1]
            k -= 1
        values[k] = each
    return np.float32(0.5) * (values[(n - 1) // 2] + values[n // 2])


@kernel
def border_colours(strip, half, colour):
    """Take the median of a strip across the border, then along it.

    Parameters
    ----------
    strip : ndarray of shape (n, W, 4), float32
        Pixels along a border.
    half : int
        The second median is over ``2 half + 1`` pixels, repeating the last at the ends.
    colour : ndarray of shape (W, 4), float32
        Filled.
    """
    n, width = strip.shape[:2]
    across = np.empty((width, 4), np.float32)
    values = np.empty(max(n, 2 * half + 1), np.float32)
    for col in range(width):
        for c in range(4):
            for i in range(n):
                values[i] = strip[i, col, c]
            across[col, c] = _median(values, n)
    for col in range(width):
        for c in range(4):
            for i in range(2 * half + 1):
                values[i] = across[min(max(col + i - half, 0), width - 1), c]
            colour[col, c] = _median(values, 2 * half + 1)


@helper
def colour_beyond(colours, down, right, row, col):
    """Return the colour of a pixel beyond the frame's border, whose nearest pixel in the frame is (row, col)."""
    if down != row:
        side, place = colours.above if down < row else colours.below, col
    else:
        side, place = colours.left if right < col else colours.right, row
    return side[place, 0], side[place, 1], side[place, 2], side[place, 3]


@kernel
def extend_frame(begin, end, frame, colours, reach, origin, radiance, label):
    """Weight the pixels of a frame, and continue its border outwards, as far as the PSFs of its pixels reach back.

    Parameters
    ----------
    frame : Weighted
    colours : Colours
    reach : ndarray of shape (n_variants,), int64
        How far each variant's splat reaches, px. A label is ``layer * n_variants + variant``.
    origin : tuple of two ints
        Row and column, in the frame, of the first extended pixel.
    radiance, label : ndarray of shapes (h, w, 4), float32, and (h, w), int32
        Colours and labels of the extended frame; filled, labels with -1 where nothing is drawn. There, colours mean
        nothing.
    """
    own, weight, labels = frame.radiance.reshape(frame.radiance.size), frame.weight, frame.label
    target, pitch, (height, width) = radiance.reshape(radiance.size), label.shape[1], labels.shape
    above, below, left, right = colours
    for i in range(begin, end):
        down = origin[0] + i
        row = min(max(down, 0), height - 1)
        first = -origin[1] if down == row else pitch
        # Continue colours beyond the border; draw nothing that is black, or too far outside for its PSF to reach back.
        for j in range(pitch - (width if down == row else 0)):
            j += width if j >= first else 0
            col = min(max(origin[1] + j, 0), width - 1)
            index = labels[row, col]
            label[i, j] = -1
            if index < 0 or max(abs(down - row), abs(origin[1] + j - col)) > reach[index % len(reach)]:
                continue
            share = weight[row, col] if weight.shape[0] else np.float32(1.0)
            for c in range(4):
                if down != row:
                    colour = above[col, c] if down < row else below[col, c]
                else:
                    colour = left[row, c] if j < first else right[row, c]
                radiance[i, j, c] = share * colour
                if colour != 0:
                    label[i, j] = index
        if down != row:
            continue
        # Weight the frame's own pixels.
        for col in range(width):
            index = labels[row, col]
            label[i, first + col] = max(index, np.int32(-1))
            if index >= 0:
                share = weight[row, col] if weight.shape[0] else np.float32(1.0)
                pixel = load(own, _U(4 * (row * width + col)))
                store(target, _U(4 * (i * pitch + first + col)), multiply((share, share, share, share), pixel))
