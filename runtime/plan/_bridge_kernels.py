"""Compiled kernels that continue what is seen on both sides of a narrow gap across it, along its own lines."""

import math

import numpy as np

from spreadlets.compiled import helper
from spreadlets.runtime.plan._alike_kernels import ALPHA, BLOCK, LEAST_LIGHT, LIKE, MOSTLY_SEEN

N_DIRECTIONS = 32
"""Directions in which a gap may be crossed."""
LONGEST = 16
"""Cells from a hidden one to either side, at most."""
BESIDE = 3
"""Cells to either side of a line across the gap whose ends are compared, too."""
LEAST_COMPARED = 6
"""Of these, how many must be comparable."""
LENGTH_PRICE = 1e-4
"""What a cell of a line's length counts beside mean squared relative differences: of alike lines, the shortest."""
LEAST_COVERED = 0.9
"""Share of a cell that the layer must cover to be compared: what ends there, as leaves do, goes on nowhere."""


@helper
def _is_seen(cells, row, col):
    """Return whether most of a cell was seen, and its block is filled; for ``cells`` see `bridge`."""
    hides, _, wanted, corner = cells
    if not (0 <= row < hides.shape[0] and 0 <= col < hides.shape[1]):
        return False
    above, before = corner[0] % BLOCK, corner[1] % BLOCK
    return 1.0 - hides[row, col] >= MOSTLY_SEEN and wanted[(row + above) // BLOCK, (col + before) // BLOCK]


@helper
def _steps_to_seen(cells, row, col, down, across):
    """Return the steps from a hidden cell along a direction to the first one that was seen; 0 if none is near."""
    for step in range(1, LONGEST + 1):
        if _is_seen(cells, *_away(row, col, down, across, step)):
            return step
    return 0


@helper
def _away(row, col, down, across, steps):
    """Return the cell some steps away along a direction."""
    return int(math.floor(row + steps * down + 0.5)), int(math.floor(col + steps * across + 0.5))


@helper
def _difference(cells, one, other):
    """Return the squared relative difference of two cells' colours and alphas; negative if they are not comparable."""
    if not (_is_seen(cells, *one) and _is_seen(cells, *other)):
        return -1.0
    hides, features = cells[0], cells[1]
    scale, other_scale = 1.0 / (1.0 - hides[one]), 1.0 / (1.0 - hides[other])
    if min(scale * features[one][ALPHA], other_scale * features[other][ALPHA]) < LEAST_COVERED:
        return -1.0
    total = 0.0
    for c in range(ALPHA + 1):
        first, second = scale * features[one][c], other_scale * features[other][c]
        each = (first - second) / (LEAST_LIGHT + 0.5 * (abs(first) + abs(second)))
        total += each * each
    return total


@helper
def bridge(cells, row, col, value):
    """Fill ``value`` (n) with what lies in a hidden cell, if lines go on across it; return whether they do.

    In each direction, what is seen where the gap begins and ends is compared, and beside it, too. Along the direction
    in which it differs least, it is interpolated.

    Parameters
    ----------
    cells : tuple of ndarrays of shapes (h, w), (h, w, n), float32, and (h / BLOCK, w / BLOCK), bool, and of two ints
        What hides the cells, their features, in which blocks these are filled, and row and column of the first cell.
    row, col : int
        The cell.
    value : ndarray of shape (n,)
        Filled with features.
    """
    least, best, ahead, back = LIKE, -1, 0, 0
    for turn in range(N_DIRECTIONS):
        # Find the ends of the line across the gap.
        angle = math.pi * turn / N_DIRECTIONS
        down, across = math.sin(angle), math.cos(angle)
        forth = _steps_to_seen(cells, row, col, down, across)
        if forth == 0:
            continue
        behind = _steps_to_seen(cells, row, col, -down, -across)
        if behind == 0 or LENGTH_PRICE * (forth + behind) >= least:
            continue
        # Compare them, and those of the lines beside it.
        total, compared = 0.0, 0
        for side in range(-BESIDE, BESIDE + 1):
            y, x = row + side * across, col - side * down
            each = _difference(cells, _away(y, x, down, across, forth), _away(y, x, down, across, -behind))
            if each >= 0.0:
                total += each
                compared += 1
        if compared < LEAST_COMPARED:
            continue
        cost = total / compared + LENGTH_PRICE * (forth + behind)
        if cost < least:
            least, best, ahead, back = cost, turn, forth, behind
    if best < 0:
        return False
    # Interpolate along the best one.
    hides, features = cells[0], cells[1]
    angle = math.pi * best / N_DIRECTIONS
    one = _away(row, col, math.sin(angle), math.cos(angle), ahead)
    other = _away(row, col, math.sin(angle), math.cos(angle), -back)
    share = np.float64(back) / (ahead + back)
    for c in range(len(value)):
        value[c] = share * features[one][c] / (1.0 - hides[one])
        value[c] += (1.0 - share) * features[other][c] / (1.0 - hides[other])
    return True
