"""Compiled kernels that continue what is seen beside a gap into it: along its own lines, or from all sides."""

import math

import numpy as np

from spreadlets.compiled import helper, kernel
from spreadlets.runtime.plan._alike_kernels import ALPHA, BLOCK, LEAST_LIGHT, LIKE, MOSTLY_SEEN

N_DIRECTIONS, COARSE = 32, 4
"""Directions in which a gap may be crossed, and every so many-eth is tried first."""
LONGEST = 16
"""Cells from a hidden one to either side, at most."""
BESIDE = 3
"""Cells to either side of a line across the gap whose ends are compared, too."""
LEAST_COMPARED = 6
"""Of these and itself, how many must be comparable."""
LENGTH_PRICE = 1e-4
"""What a cell of a line's length counts beside mean squared relative differences: of alike lines, the shortest."""
LEAST_COVERED = 0.9
"""Share of a cell that the layer must cover to be compared: what ends there, as leaves do, goes on nowhere."""
EVEN = 0.02
"""Squared relative difference below which all that lies around a cell is of one colour, which fills the gap anyway."""
NEIGHBOURS = ((-1, 0), (0, -1), (0, 1), (1, 0))
"""Rows and columns to the cells beside one."""
EVERY = 8
"""Every so many-eth direction is looked in for what lies around a hidden cell: what is nearest counts most."""


def _steps_away():
    """Return rows and columns to each cell of each line, see `AWAY`."""
    turn = np.pi * np.arange(N_DIRECTIONS)[:, None, None] / N_DIRECTIONS
    side, steps = np.arange(-BESIDE, BESIDE + 1)[:, None], np.arange(-LONGEST, LONGEST + 1)
    down = steps * np.sin(turn) + side * np.cos(turn)
    across = steps * np.cos(turn) - side * np.sin(turn)
    return np.floor(np.stack([down, across], axis=-1) + 0.5).astype(np.int8)


AWAY = _steps_away()
"""Rows and columns from a cell, by direction, line beside it (from -`BESIDE` on), and steps along it (from -`LONGEST`).
"""


@kernel
def mark_comparable(begin, end, hides, features, corner, wanted, comparable):
    """Mark the cells of a layer that are seen, and that it covers.

    Parameters
    ----------
    hides : ndarray of shape (h, w), float32
        Share of each cell that nearer layers hide.
    features : ndarray of shape (h, w, n), float32
        What was seen of the layer, see `runtime.plan._behind_kernels.add_features`.
    corner : tuple of two ints
        Row and column of the first cell, counted from the picture's centre: blocks lie as that does.
    wanted : ndarray of shape (h / BLOCK, w / BLOCK), bool
        The blocks of cells whose features are filled.
    comparable : ndarray of shape (h, w), uint8
        Filled: 0 where a cell is not seen, or not known; 1 where it is, and 2 where the layer covers it.
    """
    above, before = corner[0] % BLOCK, corner[1] % BLOCK
    for row in range(begin, end):
        for col in range(hides.shape[1]):
            seen = np.float32(1.0) - hides[row, col]
            known = seen >= MOSTLY_SEEN and wanted[(row + above) // BLOCK, (col + before) // BLOCK]
            covers = known and features[row, col, ALPHA] >= LEAST_COVERED * seen
            comparable[row, col] = 2 if covers else (1 if known else 0)


@kernel
def count_changes(begin, end, comparable, corner, counts):
    """Count in blocks of cells what tells how large the pieces are that a layer covers.

    Parameters
    ----------
    comparable, corner
        See `mark_comparable`.
    counts : ndarray of shape (4, h / BLOCK, w / BLOCK), float32
        Filled: the known cells; those that the layer covers; pairs of known cells that lie beside each other, each
        counted from both of its cells; and those pairs of which it covers one.
    """
    height, width = comparable.shape
    for block in range(begin, end):
        counts[:, block] = np.float32(0.0)
        top = block * BLOCK - corner[0] % BLOCK
        for row in range(max(top, 0), min(top + BLOCK, height)):
            for col in range(width):
                own = comparable[row, col]
                if not own:
                    continue
                across = (col + corner[1] % BLOCK) // BLOCK
                counts[0, block, across] += np.float32(1.0)
                counts[1, block, across] += np.float32(own == 2)
                for down, right in NEIGHBOURS:
                    i, j = row + down, col + right
                    if 0 <= i < height and 0 <= j < width and comparable[i, j]:
                        counts[2, block, across] += np.float32(1.0)
                        counts[3, block, across] += np.float32(comparable[i, j] != own)


@helper
def _away(row, col, turn, steps, side=0):
    """Return the cell some steps away in a direction, on a line so many cells to one side."""
    place = AWAY[turn, BESIDE + side, LONGEST + steps]
    return row + np.int64(place[0]), col + np.int64(place[1])


@helper
def _steps_to_seen(comparable, row, col, turn, side, first):
    """Return the steps from a hidden cell to one side of a direction to the first one that was seen; 0 if none is."""
    height, width = comparable.shape
    for step in range(first, LONGEST + 1):
        i, j = _away(row, col, turn, side * step)
        if not (0 <= i < height and 0 <= j < width):
            return 0
        if comparable[i, j]:
            return step
    return 0


@helper
def _difference(hides, features, i, j, k, m):
    """Return the squared relative difference of two cells' colours and alphas."""
    scale, other_scale = (
        np.float32(1.0) / (np.float32(1.0) - hides[i, j]),
        np.float32(1.0) / (np.float32(1.0) - hides[k, m]),
    )
    total = np.float32(0.0)
    for c in range(ALPHA + 1):
        first, second = scale * features[i, j, c], other_scale * features[k, m, c]
        each = (first - second) / (np.float32(LEAST_LIGHT) + np.float32(0.5) * (abs(first) + abs(second)))
        total += each * each
    return np.float64(total)


@helper
def _cost(hides, features, comparable, row, col, turn, forth, back, least):
    """Return how unlike the ends of a line across a gap are, and of those beside it; infinite if not the least."""
    height, width = comparable.shape
    length_price = LENGTH_PRICE * (forth + back)
    total, compared = 0.0, 0
    for number in range(2 * BESIDE + 1):
        # The line itself first, then those to both sides of it.
        side = (number + 1) // 2 * (1 if number % 2 else -1)
        i, j = _away(row, col, turn, forth, side)
        k, m = _away(row, col, turn, -back, side)
        inside = 0 <= i < height and 0 <= j < width and 0 <= k < height and 0 <= m < width
        if inside and comparable[i, j] == 2 and comparable[k, m] == 2:
            total += _difference(hides, features, i, j, k, m)
            compared += 1
        elif number - compared >= 2 * BESIDE + 1 - LEAST_COMPARED:
            return math.inf
        if total >= (least - length_price) * (2 * BESIDE + 1):
            return math.inf
    return total / compared + length_price


@helper
def _is_even(hides, features, comparable, row, col, first):
    """Return whether what lies around a hidden cell is of one colour."""
    one_row = one_col = -1
    for turn in range(0, N_DIRECTIONS, N_DIRECTIONS // 4):
        for side in (-1, 1):
            steps = _steps_to_seen(comparable, row, col, turn, side, first)
            if steps == 0:
                continue
            i, j = _away(row, col, turn, side * steps)
            if one_row < 0:
                one_row, one_col = i, j
            elif _difference(hides, features, one_row, one_col, i, j) > EVEN:
                return False
    return True


@helper
def _ends_covered(comparable, row, col, turn, steps):
    """Return whether enough of the ends of a line, and of those right beside it, may be compared for `_cost`."""
    height, width = comparable.shape
    missing = 0
    for side in range(-1, 2):
        i, j = _away(row, col, turn, steps, side)
        if not (0 <= i < height and 0 <= j < width) or comparable[i, j] != 2:
            missing += 1
    return missing <= 2 * BESIDE + 1 - LEAST_COMPARED


@helper
def _try(cells, row, col, turn, first, least):
    """Return the cost of the line through a hidden cell in a direction, and its steps forth and back."""
    hides, features, comparable = cells
    forth = _steps_to_seen(comparable, row, col, turn, 1, first)
    if forth == 0 or not _ends_covered(comparable, row, col, turn, forth):
        return math.inf, 0, 0
    back = _steps_to_seen(comparable, row, col, turn, -1, first)
    if back == 0:
        return math.inf, 0, 0
    return _cost(hides, features, comparable, row, col, turn, forth, back, least), forth, back


@helper
def bridge(cells, row, col, gap, value):
    """Fill ``value`` (n) with what lies in a hidden cell, if lines go on across it; return whether they do.

    In each direction, what is seen where the gap begins and ends is compared, and beside it, too. Along the direction
    in which it differs least, it is interpolated.

    Parameters
    ----------
    cells : tuple of ndarrays of shapes (h, w), (h, w, n), float32, and (h, w), uint8
        What hides the cells, their features, and which are comparable, see `mark_comparable`.
    row, col : int
        The cell.
    gap : float
        Distance to the next cell that was seen.
    value : ndarray of shape (n,)
        Filled with features.
    """
    hides, features, comparable = cells
    first = max(int(gap - 0.7), 1)
    if first > LONGEST or _is_even(hides, features, comparable, row, col, first):
        return False
    # Try some directions, and those beside the best one.
    least, best, ahead, back = LIKE, -1, 0, 0
    for turn in range(0, N_DIRECTIONS, COARSE):
        cost, forth, behind = _try(cells, row, col, turn, first, least)
        if cost < least:
            least, best, ahead, back = cost, turn, forth, behind
    middle = best
    for turn in range(N_DIRECTIONS):
        apart = abs(turn - middle)
        if turn % COARSE == 0 or (middle >= 0 and min(apart, N_DIRECTIONS - apart) >= COARSE):
            continue
        cost, forth, behind = _try(cells, row, col, turn, first, least)
        if cost < least:
            least, best, ahead, back = cost, turn, forth, behind
    if best < 0:
        return False
    # Interpolate along the best one.
    i, j = _away(row, col, best, ahead)
    k, m = _away(row, col, best, -back)
    share = np.float64(back) / (ahead + back)
    one, other = share / (1.0 - hides[i, j]), (1.0 - share) / (1.0 - hides[k, m])
    for c in range(len(value)):
        value[c] = one * features[i, j, c] + other * features[k, m, c]
    return True


@helper
def continue_around(cells, row, col, gap, value):
    """Fill ``value`` (n) with the mean of what is seen around a hidden cell; return whether anything is.

    Of each direction the first cell counts that was seen, by the inverse square of its distance. For the arguments see
    `bridge`.
    """
    hides, features, comparable = cells
    first = max(int(gap - 0.7), 1)
    # Sum up what was seen first in each direction.
    value[:] = 0.0
    total = 0.0
    for turn in range(0, N_DIRECTIONS, EVERY):
        for side in (-1, 1):
            steps = _steps_to_seen(comparable, row, col, turn, side, first)
            if steps == 0:
                continue
            i, j = _away(row, col, turn, side * steps)
            weight = 1.0 / steps**2
            total += weight
            for c in range(len(value)):
                value[c] += weight / (1.0 - hides[i, j]) * features[i, j, c]
    if total == 0.0:
        return False
    for c in range(len(value)):
        value[c] /= total
    return True
