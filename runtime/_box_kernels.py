"""Compiled kernels of the box blur."""

import numpy as np

from spreadlets.compiled import helper, kernel

STRIPE = 64
"""Columns that `box_columns` takes at a time: whole cache lines of each row."""


@kernel
def box_rows(begin, end, image, half, out):
    """Average each row over ``2 half + 1`` pixels; beyond its ends there is nothing.

    Sums run in float64: what has been added cancels exactly for shares and counts.
    """
    width = image.shape[1]
    scale = 1.0 / (2 * half + 1)
    for row in range(begin, end):
        # Sum the box about the pixel before the first, then slide it along.
        total = 0.0
        for col in range(min(half, width)):
            total += image[row, col]
        for col in range(width):
            if col + half < width:
                total += image[row, col + half]
            out[row, col] = total * scale
            if col >= half:
                total -= image[row, col - half]


@helper
def _box_columns(image, left, right, half, total, out):
    """Average the columns from ``left`` up to ``right``; ``total`` has room for their sums."""
    height, scale = len(image), 1.0 / (2 * half + 1)
    # Sum the boxes about the row above the first, then slide them down.
    total[:] = 0.0
    for row in range(min(half, height)):
        line = image[row][left:right]
        for i in range(line.shape[0]):
            total[i] += line[i]
    for row in range(height):
        mean = out[row][left:right]
        if row + half < height:
            line = image[row + half][left:right]
            for i in range(line.shape[0]):
                total[i] += line[i]
        for i in range(mean.shape[0]):
            mean[i] = total[i] * scale
        if row >= half:
            line = image[row - half][left:right]
            for i in range(line.shape[0]):
                total[i] -= line[i]


@kernel
def box_columns(begin, end, image, half, out):
    """Do as `box_rows` for columns, in STRIPEs of neighbouring ones."""
    total = np.empty(STRIPE)
    for number in range(begin, end):
        left, right = number * STRIPE, min((number + 1) * STRIPE, image.shape[1])
        _box_columns(image, left, right, half, total, out)
