"""Compiled kernels that continue thin things behind what hides them."""

import math

import numpy as np

from spreadlets.compiled import helper, kernel

N_ANGLES = 32
"""Directions, over half a turn, in which a hidden pixel looks both ways."""
FARTHEST = 20
"""Pixels, along a direction, up to which it looks past what hides it."""
SUPPORT = 4
"""Pixels of a thing, on either side, that must lie along the direction."""
WIDEST = 4
"""Pixels across: what is wider is no thin thing."""
LEAST_SHARE = 0.4
"""Mean share of those pixels that must be of the thing."""
ALIKE = 0.5
"""Largest difference of places of one thing's two ends, as a share of the gap between two surfaces."""


@helper
def _first_behind(place, row, col, step_row, step_col, limit):
    """Return how many steps along a direction a pixel lies that is behind a limit; -1 if there is none."""
    height, width = place.shape
    for step in range(1, FARTHEST + 1):
        i, j = int(math.floor(row + step * step_row + 0.5)), int(math.floor(col + step * step_col + 0.5))
        if not (0 <= i < height and 0 <= j < width):
            return -1
        if place[i, j] >= limit:
            return step
    return -1


@helper
def _membership(place, y, x, here, most):
    """Return the share of a thing's places at a point, by bilinear interpolation; 0 beyond the frame."""
    height, width = place.shape
    if not (0.0 <= y < height - 1 and 0.0 <= x < width - 1):
        return 0.0
    i, j = int(y), int(x)
    down, across = y - i, x - j
    upper = (1.0 - across) * (abs(place[i, j] - here) < most) + across * (abs(place[i, j + 1] - here) < most)
    lower = (1.0 - across) * (abs(place[i + 1, j] - here) < most) + across * (abs(place[i + 1, j + 1] - here) < most)
    return upper + down * (lower - upper)


@helper
def _support(place, row, col, step_row, step_col, start, here, most):
    """Return the mean share of a thing along `SUPPORT` steps of a direction, from a first one on."""
    total = 0.0
    for step in range(start, start + SUPPORT):
        total += _membership(place, row + step * step_row, col + step * step_col, here, most)
    return total / SUPPORT


@helper
def _is_thin(place, row, col, step_row, step_col, at, here, gap):
    """Return whether a thing ends on both sides across a direction, before something farther on one at least."""
    height, width = place.shape
    farther = 0
    y, x = row + at * step_row, col + at * step_col
    for side in (-1, 1):
        left = False
        for step in range(1, WIDEST + 1):
            i = int(math.floor(y + side * step * step_col + 0.5))
            j = int(math.floor(x - side * step * step_row + 0.5))
            if not (0 <= i < height and 0 <= j < width):
                return False
            if abs(place[i, j] - here) >= gap:
                left = True
                farther += 1 if place[i, j] > here else 0
                break
        if not left:
            return False
    return farther > 0


@kernel
def find_threads(begin, end, place, blur, gap, share, ends):
    """Find the thin things that go on behind pixels: seen on both sides of what hides them, along a line.

    Parameters
    ----------
    place : ndarray of shape (H, W), float32
        Where surfaces lie in depth, as CoC radii, px.
    blur : ndarray of shape (H, W), float32
        How far each pixel blurs, px.
    gap : float
        Difference of places that parts two surfaces.
    share : ndarray of shape (H, W), float32
        Filled with the share of the pixel that the thing covers.
    ends : ndarray of shape (H, W, 2), int32
        Filled with the numbers, row by row, of a pixel of it on either side.
    """
    height, width = place.shape
    most = np.float32(ALIKE * gap)
    for row in range(begin, end):
        for col in range(width):
            share[row, col] = 0.0
            limit = place[row, col] + gap
            best = LEAST_SHARE
            if blur[row, col] < 1.5:
                continue
            for turn in range(N_ANGLES):
                angle = math.pi * turn / N_ANGLES
                down, across = math.sin(angle), math.cos(angle)
                first = _first_behind(place, row, col, down, across, limit)
                if first < 0:
                    continue
                i, j = int(math.floor(row + first * down + 0.5)), int(math.floor(col + first * across + 0.5))
                here = place[i, j]
                if blur[i, j] >= blur[row, col]:
                    continue
                other = _first_behind(place, row, col, -down, -across, limit)
                if other < 0:
                    continue
                k, m = int(math.floor(row - other * down + 0.5)), int(math.floor(col - other * across + 0.5))
                if abs(place[k, m] - here) >= most:
                    continue
                own = min(
                    _support(place, row, col, down, across, first, here, most),
                    _support(place, row, col, -down, -across, other, here, most),
                )
                if own <= best:
                    continue
                if not _is_thin(place, row, col, down, across, first + 2, here, gap) or not _is_thin(
                    place, row, col, -down, -across, other + 2, here, gap
                ):
                    continue
                best = own
                share[row, col] = own
                ends[row, col, 0], ends[row, col, 1] = i * width + j, k * width + m
