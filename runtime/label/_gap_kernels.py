"""Compiled kernels that close the gaps which point samples of the depth leave in strands thinner than a pixel."""

import math

import numpy as np

from spreadlets.compiled import helper, kernel

UPRIGHT, LEVEL = 1, 2
"""What is thin in a row, and what is only so in a column."""
LONGEST_GAP = 10
"""Px: so far apart two pixels' centres may lie in a strand a few tenths of a pixel wide."""
LONGEST_STEEP_GAP = 40
"""The same along a row or a column from which a strand turns away by so little that it is a pixel beside at the end."""
LEAST_RUN = 0.25
"""Pixels in a row, as a share of such a gap, that a strand must have at either end: it is a fifth of a pixel wide."""
ALIKE = 0.5
"""Largest difference of places from end to end of a gap, as a share of that which parts two surfaces."""
LOOK, LEAST_LOOK = 2, 6
"""A strand is looked for beyond the ends of a gap over so many times the gap's length, and at least so many pixels."""
LEAST_HITS = 2
"""Its pixels that must lie there, beyond each end."""
SEEN_REACH = 3
"""How far, px, from a pixel in a gap its surface must show once more: so far `_surface_kernels` looks for it."""


@kernel
def find_thin(begin, end, place, gap, widest, thin):
    """Mark the pixels in which something is one pixel wide in a row, or in a column, or a little more.

    Its surface ends on both sides, before something farther on one at least.

    Parameters
    ----------
    place : ndarray of shape (H, W), float32
        Where surfaces lie in depth, as CoC radii, px; infinity where there is none.
    gap : float
        Difference of places that parts two surfaces.
    widest : int
        So many pixels it may have.
    thin : ndarray of shape (H, W), int8
        Filled with `UPRIGHT`, `LEVEL` or 0.
    """
    height, width = place.shape
    for row in range(begin, end):
        for col in range(width):
            thin[row, col], here = 0, place[row, col]
            if here == np.inf:
                continue
            # Of what is wider than a pixel, the first one in the row or the column is marked.
            after, below = col + 1, row + 1
            while after < min(col + widest, width) and abs(place[row, after] - here) < ALIKE * gap:
                after += 1
            while below < min(row + widest, height) and abs(place[below, col] - here) < ALIKE * gap:
                below += 1
            left, right = place[row, max(col - 1, 0)] - here, place[row, min(after, width - 1)] - here
            over, under = place[max(row - 1, 0), col] - here, place[min(below, height - 1), col] - here
            if min(abs(over), abs(under)) >= gap and max(over, under) >= gap:
                thin[row, col] = LEVEL
            if min(abs(left), abs(right)) >= gap and max(left, right) >= gap:
                thin[row, col] = UPRIGHT


@kernel
def find_loose(begin, end, place, thin, gap, loose):
    """Mark the thin pixels of which at most one neighbour shows the same surface: where samples have missed the rest.

    Parameters
    ----------
    place, thin, gap
        See `find_thin`.
    loose : ndarray of shape (H, W), bool
        Filled.
    """
    height, width = place.shape
    for row in range(begin, end):
        for col in range(width):
            loose[row, col] = False
            if not thin[row, col]:
                continue
            alike = -1
            for i in range(max(row - 1, 0), min(row + 2, height)):
                for j in range(max(col - 1, 0), min(col + 2, width)):
                    alike += abs(place[i, j] - place[row, col]) < gap
            loose[row, col] = alike <= 1


@helper
def on_line(row, col, down, across, step, steps):
    """Return the pixel after some of the steps from a pixel to the one so many rows and columns away."""
    return int(math.floor(row + down * step / steps + 0.5)), int(math.floor(col + across * step / steps + 0.5))


@helper
def _ends_towards(place, row, col, down, across, most):
    """Return whether a strand ends in a pixel towards a direction: those of its pixels beside it lie the other way."""
    height, width = place.shape
    for i in range(max(row - 1, 0), min(row + 2, height)):
        for j in range(max(col - 1, 0), min(col + 2, width)):
            ahead = (i - row) * down + (j - col) * across >= 0 and (i != row or j != col)
            if ahead and abs(place[i, j] - place[row, col]) < most:
                return False
    return True


@helper
def _is_gap(place, row, col, down, across, most):
    """Return whether a strand ends in a pixel, goes on so many rows and columns away, and is not seen between."""
    steps = max(down, abs(across))
    if steps < 2 or not _ends_towards(place, row, col, down, across, most):
        return False
    if not _ends_towards(place, row + down, col + across, -down, -across, most):
        return False
    for step in range(1, steps):
        if abs(place[on_line(row, col, down, across, step, steps)] - place[row, col]) < most:
            return False
    return True


@helper
def _count_hits(place, thin, row, col, down, across, here, most):
    """Return how many of the steps that follow from a pixel meet thin pixels of a strand, or have one beside them."""
    height, width = place.shape
    steps, upright = max(abs(down), abs(across)), abs(down) >= abs(across)
    hits = 0
    for step in range(1, max(LOOK * steps, LEAST_LOOK) + 1):
        i, j = on_line(row, col, down, across, step, steps)
        for side in range(-1, 2):
            y, x = (i, j + side) if upright else (i + side, j)
            if 0 <= y < height and 0 <= x < width and thin[y, x] and abs(place[y, x] - here) < most:
                hits += 1
                break
    return hits


@helper
def _run(place, row, col, down, across, most):
    """Return how many pixels of a strand follow each other along a row or a column, with the first."""
    height, width = place.shape
    here, steps = place[row, col], 0
    while 0 <= row < height and 0 <= col < width and abs(place[row, col] - here) < most:
        row, col, steps = row + down, col + across, steps + 1
    return steps


@helper
def _steep_gap(place, thin, row, col, most):
    """Return how many rows and columns away a strand goes on that hardly leaves its row or column; (0, 0) if none."""
    height, width = place.shape
    upright, here = thin[row, col] == UPRIGHT, place[row, col]
    for side in (-1, 1):
        if not _ends_towards(place, row, col, 1 if upright else side, side if upright else 1, most):
            continue
        for reach in range(LONGEST_GAP + 1, LONGEST_STEEP_GAP + 1):
            down, across = (reach, side) if upright else (side, reach)
            i, j = row + down, col + across
            if not (0 <= i < height and 0 <= j < width):
                break
            if thin[i, j] != thin[row, col] or abs(place[i, j] - here) >= most:
                continue
            # A strand that turns away so slowly has many pixels in a row at both ends.
            along = (1, 0) if upright else (0, 1)
            shortest = min(_run(place, row, col, -along[0], -along[1], most), _run(place, i, j, *along, most))
            if shortest >= LEAST_RUN * reach and _is_gap(place, row, col, down, across, most):
                return down, across
            break
    return 0, 0


@kernel
def find_gaps(begin, end, place, thin, gap, ends):
    """Find where strands go on after a gap below, or to the right, of each of their pixels.

    Parameters
    ----------
    place : ndarray of shape (H, W), float32
    thin : ndarray of shape (H, W), int8
        See `find_thin`.
    gap : float
    ends : ndarray of shape (H, W, 2), int8
        Filled with how many rows and columns away that is; (0, 0) where there is no gap.
    """
    height, width = place.shape
    most = ALIKE * gap
    for row in range(begin, end):
        for col in range(width):
            ends[row, col, 0] = ends[row, col, 1] = 0
            if not thin[row, col]:
                continue
            here, best = place[row, col], 0.0
            for down in range(min(LONGEST_GAP, height - 1 - row) + 1):
                first = max(-LONGEST_GAP, -col) if down else 2
                for across in range(first, min(LONGEST_GAP, width - 1 - col) + 1):
                    # Look for an end of the same strand.
                    if not thin[row + down, col + across] or abs(place[row + down, col + across] - here) >= most:
                        continue
                    if not _is_gap(place, row, col, down, across, most):
                        continue
                    # Beyond both, it must lie along the same line. Of several, take the near one with most of it.
                    before = _count_hits(place, thin, row, col, -down, -across, here, most)
                    after = _count_hits(place, thin, row + down, col + across, down, across, here, most)
                    score = (before + after) / (down * down + across * across)
                    if min(before, after) >= LEAST_HITS and score > best:
                        best = score
                        ends[row, col, 0], ends[row, col, 1] = down, across
            if best == 0.0:
                ends[row, col, 0], ends[row, col, 1] = _steep_gap(place, thin, row, col, most)


@helper
def _is_seen_beside(place, row, col, gap):
    """Return whether a pixel's surface shows in another pixel near it, too, which can tell its colour and labels."""
    height, width = place.shape
    for i in range(max(row - SEEN_REACH, 0), min(row + SEEN_REACH + 1, height)):
        for j in range(max(col - SEEN_REACH, 0), min(col + SEEN_REACH + 1, width)):
            if (i != row or j != col) and abs(place[i, j] - place[row, col]) < gap:
                return True
    return False


@kernel
def close_gaps(begin, end, place, ends, gap, closed, source):
    """Put strands into their gaps, where nothing nearer hides them. All rows are done in one call.

    Not over the only pixel of what shows between them, say of the sky: its light would be taken for the strand's.

    Parameters
    ----------
    place : ndarray of shape (H, W), float32
    ends : ndarray of shape (H, W, 2), int8
        See `find_gaps`.
    gap : float
    closed : ndarray of shape (H, W), float32
        As ``place``; changed where a strand lies.
    source : ndarray of shape (H, W, 2), int32
        Row and column of the pixel that has each pixel's labels; changed there, too.
    """
    for row in range(begin, end):
        for col in range(place.shape[1]):
            down, across = int(ends[row, col, 0]), int(ends[row, col, 1])
            steps = max(down, abs(across))
            for step in range(1, steps):
                at = on_line(row, col, down, across, step, steps)
                y, x = (row, col) if 2 * step < steps else (row + down, col + across)
                if closed[at] - place[y, x] >= gap and _is_seen_beside(closed, at[0], at[1], gap):
                    closed[at] = place[y, x]
                    source[at[0], at[1], 0], source[at[0], at[1], 1] = y, x
