"""Compiled kernels that continue strands behind what hides them."""

import math

import numpy as np

from spreadlets.compiled import helper, kernel
from spreadlets.runtime.label._gap_kernels import on_line

N_ANGLES = 64
"""Directions in which a strand may go on."""
FARTHEST = 20
"""Px: what hides more of a strand is too wide to tell that both ends are of the same one."""
SUPPORT = 5
"""Px of a strand, on either side, that must lie along the direction."""
WIDEST = 4
"""Px: what is wider is no strand."""
LEAST_SHARE = 0.4
"""Mean share of those pixels that must be of the strand."""
ALIKE = 0.5
"""Largest difference of the two ends' places, as a share of that which parts two surfaces."""


@helper
def _leaves(place, row, col, down, across, gap):
    """Return 1 if something farther ends a surface within `WIDEST` steps along a direction, 0 if nearer, -1 if none."""
    height, width = place.shape
    for step in range(1, WIDEST + 1):
        i, j = row + step * down, col + step * across
        if not (0 <= i < height and 0 <= j < width):
            return -1
        if abs(place[i, j] - place[row, col]) >= gap:
            return 1 if place[i, j] > place[row, col] else 0
    return -1


@helper
def _is_narrow(place, row, col, gap):
    """Return whether a surface ends on both sides in a row or a column, before something farther on one at least."""
    left, right = _leaves(place, row, col, 0, -1, gap), _leaves(place, row, col, 0, 1, gap)
    if left >= 0 and right >= 0 and left + right > 0:
        return True
    above, below = _leaves(place, row, col, -1, 0, gap), _leaves(place, row, col, 1, 0, gap)
    return above >= 0 and below >= 0 and above + below > 0


@helper
def _is_hidden_beside(place, row, col, gap):
    """Return whether something nearer lies right beside a pixel."""
    height, width = place.shape
    for i in range(max(row - 1, 0), min(row + 2, height)):
        for j in range(max(col - 1, 0), min(col + 2, width)):
            if place[row, col] - place[i, j] >= gap:
                return True
    return False


@helper
def _support(place, row, col, down, across, here, most):
    """Return the mean share of a strand along `SUPPORT` steps of a direction from a pixel on, by interpolation."""
    height, width = place.shape
    total = 0.0
    for step in range(SUPPORT):
        y, x = row + step * down, col + step * across
        if not (0.0 <= y < height - 1 and 0.0 <= x < width - 1):
            continue
        i, j = int(y), int(x)
        low, right = y - i, x - j
        upper = (1.0 - right) * (abs(place[i, j] - here) < most) + right * (abs(place[i, j + 1] - here) < most)
        lower = (1.0 - right) * (abs(place[i + 1, j] - here) < most) + right * (abs(place[i + 1, j + 1] - here) < most)
        total += upper + low * (lower - upper)
    return total / SUPPORT


@helper
def _steps_behind(place, row, col, down, across, gap):
    """Return the steps along a direction to the first pixel that nothing nearer hides; 0 if the next, or none, is."""
    height, width = place.shape
    for step in range(1, FARTHEST + 1):
        i, j = int(math.floor(row + step * down + 0.5)), int(math.floor(col + step * across + 0.5))
        if not (0 <= i < height and 0 <= j < width):
            return 0
        if place[row, col] - place[i, j] < gap:
            return step if step > 1 else 0
    return 0


@helper
def _blur(place, length, row, col):
    """Return how far a pixel blurs, px."""
    return abs(place[row, col]) + np.float32(0.5) * length[row, col]


@kernel
def find_strands(begin, end, place, length, gap, ends, shares):
    """Find where strands that end beside something nearer go on behind it, along a line.

    Parameters
    ----------
    place : ndarray of shape (H, W), float32
        Where surfaces lie in depth, as CoC radii, px.
    length : ndarray of shape (H, W), float32
        Of each pixel's path, px: only what blurs more than the strand shows it.
    gap : float
        Difference of places that parts two surfaces.
    ends : ndarray of shape (H, W), int32
        Filled with the number, row by row, of the pixel that a strand goes on from; -1 for all other pixels.
    shares : ndarray of shape (H, W), float32
        Filled with the share of its pixels that the strand covers.
    """
    height, width = place.shape
    most = ALIKE * gap
    for row in range(begin, end):
        for col in range(width):
            ends[row, col], shares[row, col] = -1, LEAST_SHARE
            if not _is_hidden_beside(place, row, col, gap) or not _is_narrow(place, row, col, gap):
                continue
            here = place[row, col]
            for turn in range(N_ANGLES):
                # Does the strand come along this direction, and does something nearer that blurs more end it?
                angle = 2.0 * math.pi * turn / N_ANGLES
                down, across = math.sin(angle), math.cos(angle)
                own = _support(place, row, col, -down, -across, here, most)
                if own <= shares[row, col]:
                    continue
                steps = _steps_behind(place, row, col, down, across, gap)
                i, j = int(math.floor(row + down + 0.5)), int(math.floor(col + across + 0.5))
                if not steps or _blur(place, length, i, j) <= _blur(place, length, row, col):
                    continue
                # Is it there again behind?
                i, j = int(math.floor(row + steps * down + 0.5)), int(math.floor(col + steps * across + 0.5))
                if abs(place[i, j] - here) >= most or not _is_narrow(place, i, j, gap):
                    continue
                y, x = row + steps * down, col + steps * across
                share = min(own, _support(place, y, x, down, across, here, most))
                if share > shares[row, col]:
                    ends[row, col], shares[row, col] = i * width + j, share


@kernel
def lay_strands(begin, end, place, gap, ends, shares, found):
    """Lay strands behind what hides them. All rows are done in one call.

    Parameters
    ----------
    place, gap, ends, shares
        See `find_strands`.
    found : tuple of ndarrays of shapes (H, W) and (H, W, 2), float32 and int32
        Share of each pixel that a strand covers, if that is more than before; changed. And the numbers of its pixels
        on either side.
    """
    width = place.shape[1]
    share, sides = found
    for row in range(begin, end):
        for col in range(width):
            if ends[row, col] < 0:
                continue
            down, across = ends[row, col] // width - row, ends[row, col] % width - col
            steps = max(abs(down), abs(across))
            for step in range(1, steps):
                i, j = on_line(row, col, down, across, step, steps)
                if place[row, col] - place[i, j] >= gap and shares[row, col] > share[i, j]:
                    share[i, j] = shares[row, col]
                    sides[i, j, 0], sides[i, j, 1] = row * width + col, ends[row, col]


@kernel
def close_holes(begin, end, share, sides):
    """Give single pixels within a strand, which no line met, to the strand. All rows are done in one call.

    Parameters
    ----------
    share, sides
        What `lay_strands` found; changed.
    """
    height, width = share.shape
    for row in range(max(begin, 1), min(end, height - 1)):
        for col in range(1, width - 1):
            if share[row, col] > 0.0:
                continue
            across = min(share[row, col - 1], share[row, col + 1])
            down = min(share[row - 1, col], share[row + 1, col])
            if across > 0.0 or down > 0.0:
                i, j = (row, col - 1) if across >= down else (row - 1, col)
                share[row, col] = max(across, down)
                sides[row, col, 0], sides[row, col, 1] = sides[i, j, 0], sides[i, j, 1]
