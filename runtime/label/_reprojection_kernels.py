"""Compiled kernels that move pixels of a neighbouring frame to where they are in another, behind what hides them."""

import math

import numpy as np

from spreadlets.compiled import helper, kernel

LEAST_WEIGHT = 0.25
"""Sum of bilinear weights from which a pixel is taken to be covered."""


@helper
def _corners(row, col, motion, sign):
    """Return the row and column above and before where a pixel moves, and the shares of what lies below and behind."""
    y, x = row + sign * np.float64(motion[1]), col + sign * np.float64(motion[0])
    above, before = math.floor(y), math.floor(x)
    return int(above), int(before), y - above, x - before


@kernel
def find_farther(begin, end, purity, place, motion, sign, hides, gap, nearest):
    """Lower ``nearest`` (H, W), float32, to the least place of what comes to lie behind each pixel.

    Parameters
    ----------
    purity, place : ndarray of shape (H, W), float32
        Of the neighbouring frame; pixels that are not pure are left out. Places are CoC radii, px.
    motion : ndarray of shape (H, W, 2), float32
        (dx, dy), px.
    sign : float
        1 if the pixels move by it, -1 if against it.
    hides : ndarray of shape (H, W), float32
        Place of what is seen in each pixel of the other frame.
    gap : float
        What is not behind that by so much, px, is not hidden.
    """
    height, width = place.shape
    for row in range(begin, end):
        for col in range(width):
            if purity[row, col] < 1.0 or place[row, col] == math.inf:
                continue
            above, before, down, right = _corners(row, col, motion[row, col], sign)
            for k in range(4):
                i, j = above + k // 2, before + k % 2
                weight = (down if k // 2 else 1.0 - down) * (right if k % 2 else 1.0 - right)
                if 0 <= i < height and 0 <= j < width and weight >= LEAST_WEIGHT:
                    if place[row, col] - hides[i, j] >= gap:
                        nearest[i, j] = min(nearest[i, j], place[row, col])


@kernel
def add_farther(begin, end, purity, place, motion, sign, nearest, gap, values, sums):
    """Add what comes to lie behind each pixel to ``sums`` (H, W, n + 1), float32: ``values`` (H, W, n), and weights.

    Other arguments are those of `find_farther`, which has filled ``nearest``: what lies farther than that is left out.
    """
    height, width = place.shape
    for row in range(begin, end):
        for col in range(width):
            if purity[row, col] < 1.0 or place[row, col] == math.inf:
                continue
            above, before, down, right = _corners(row, col, motion[row, col], sign)
            for k in range(4):
                i, j = above + k // 2, before + k % 2
                weight = (down if k // 2 else 1.0 - down) * (right if k % 2 else 1.0 - right)
                if not (0 <= i < height and 0 <= j < width) or abs(place[row, col] - nearest[i, j]) >= gap:
                    continue
                for c in range(values.shape[2]):
                    sums[i, j, c] += weight * values[row, col, c]
                sums[i, j, -1] += weight
