"""Compiled kernels that close the gaps that point samples of the depth leave in threads thinner than a pixel."""

import math

import numpy as np

from spreadlets.compiled import helper, kernel

REACH = 10
"""Longest gap, px, that is closed."""
ALIKE = 0.5
"""Largest difference of places on one thread from end to end of a gap, as a share of the gap between two surfaces."""
LOOK = 2
"""A thread is looked for beyond the ends of a gap over so many times the gap's length."""
LEAST_LOOK = 6
"""At least so many pixels."""
LEAST_HITS = 2
"""Pixels of the thread that must lie beyond each end."""


@kernel
def find_thin(begin, end, place, gap, thin):
    """Mark the pixels that both neighbours in a row, or in a column, lie behind.

    Parameters
    ----------
    place : ndarray of shape (H, W), float32
        Where surfaces lie in depth, as CoC radii, px.
    gap : float
        Difference of places that parts two surfaces.
    thin : ndarray of shape (H, W), bool
        Filled.
    """
    height, width = place.shape
    for row in range(begin, end):
        for col in range(width):
            least = place[row, col] + gap
            beside = place[row, max(col - 1, 0)] >= least and place[row, min(col + 1, width - 1)] >= least
            above = place[max(row - 1, 0), col] >= least and place[min(row + 1, height - 1), col] >= least
            thin[row, col] = beside or above


@helper
def _ends(place, row, col, down, across, most):
    """Return whether a thread ends in a pixel towards a direction: all of its pixels around lie the other way."""
    height, width = place.shape
    for i in range(max(row - 1, 0), min(row + 2, height)):
        for j in range(max(col - 1, 0), min(col + 2, width)):
            if abs(place[i, j] - place[row, col]) < most and (i != row or j != col):
                if (i - row) * down + (j - col) * across >= 0:
                    return False
    return True


@helper
def _is_free(place, row, col, down, across, most):
    """Return whether no pixel between one and another, so many rows and columns away, is of the thread."""
    steps = max(down, abs(across))
    for step in range(1, steps):
        i = int(math.floor(row + down * step / steps + 0.5))
        j = int(math.floor(col + across * step / steps + 0.5))
        if abs(place[i, j] - place[row, col]) < most:
            return False
    return True


@helper
def _count_hits(place, thin, row, col, down, across, here, most):
    """Return how many of the next steps along a direction, from a pixel, lie on the thread, or one pixel beside it."""
    height, width = place.shape
    steps = max(abs(down), abs(across))
    upright = abs(down) >= abs(across)
    hits = 0
    for step in range(1, max(LOOK * steps, LEAST_LOOK) + 1):
        i = int(math.floor(row + down * step / steps + 0.5))
        j = int(math.floor(col + across * step / steps + 0.5))
        for side in (0, -1, 1):
            y, x = (i, j + side) if upright else (i + side, j)
            if 0 <= y < height and 0 <= x < width and thin[y, x] and abs(place[y, x] - here) < most:
                hits += 1
                break
    return hits


@kernel
def find_gaps(begin, end, place, thin, gap, ends):
    """Find where a thread goes on after a gap below, or right of, each of its pixels.

    Parameters
    ----------
    place : ndarray of shape (H, W), float32
    thin : ndarray of shape (H, W), bool
        See `find_thin`.
    gap : float
    ends : ndarray of shape (H, W, 2), int8
        Filled with how many rows and columns away that is; (0, 0) where there is no gap.
    """
    height, width = place.shape
    most = np.float32(ALIKE * gap)
    for row in range(begin, end):
        for col in range(width):
            ends[row, col] = 0
            if not thin[row, col]:
                continue
            here, best = place[row, col], 0.0
            for down in range(min(REACH, height - 1 - row) + 1):
                for across in range(max(-REACH, -col) if down else 2, min(REACH, width - 1 - col) + 1):
                    if not thin[row + down, col + across] or abs(place[row + down, col + across] - here) >= most:
                        continue
                    if max(down, abs(across)) < 2 or not _ends(place, row, col, down, across, most):
                        continue
                    if not _ends(place, row + down, col + across, -down, -across, most):
                        continue
                    if not _is_free(place, row, col, down, across, most):
                        continue
                    before = _count_hits(place, thin, row, col, -down, -across, here, most)
                    after = _count_hits(place, thin, row + down, col + across, down, across, here, most)
                    if min(before, after) < LEAST_HITS:
                        continue
                    score = (before + after) / (down * down + across * across)
                    if score > best:
                        best = score
                        ends[row, col, 0], ends[row, col, 1] = down, across


@kernel
def close_gaps(begin, end, place, ends, gap, closed, source):
    """Put threads into their gaps, where nothing nearer hides them.

    Parameters
    ----------
    place : ndarray of shape (H, W), float32
    ends : ndarray of shape (H, W, 2), int8
        See `find_gaps`.
    gap : float
    closed : ndarray of shape (H, W), float32
        As ``place``; changed where a thread lies.
    source : ndarray of shape (H, W, 2), int32
        Row and column of the pixel that has each pixel's labels; changed there, too.
    """
    for row in range(begin, end):
        for col in range(place.shape[1]):
            down, across = np.int64(ends[row, col, 0]), np.int64(ends[row, col, 1])
            steps = max(down, abs(across))
            for step in range(1, steps):
                i = int(math.floor(row + down * step / steps + 0.5))
                j = int(math.floor(col + across * step / steps + 0.5))
                first = 2 * step < steps
                y, x = (row, col) if first else (row + down, col + across)
                if closed[i, j] - place[y, x] >= gap:
                    closed[i, j] = place[y, x]
                    source[i, j, 0], source[i, j, 1] = y, x


@kernel
def find_hidden(begin, end, place, ends, gap, source):
    """Find the pixels in which threads are hidden: gaps where something nearer lies.

    Parameters
    ----------
    place : ndarray of shape (H, W), float32
    ends : ndarray of shape (H, W, 2), int8
        See `find_gaps`.
    gap : float
    source : ndarray of shape (H, W), int64
        Number of the pixel that the nearest such thread goes on from, row by row; -1 where there is none. Lowered.
    """
    width = place.shape[1]
    for row in range(begin, end):
        for col in range(width):
            down, across = np.int64(ends[row, col, 0]), np.int64(ends[row, col, 1])
            steps = max(down, abs(across))
            for step in range(1, steps):
                i = int(math.floor(row + down * step / steps + 0.5))
                j = int(math.floor(col + across * step / steps + 0.5))
                y, x = (row, col) if 2 * step < steps else (row + down, col + across)
                if place[y, x] - place[i, j] < gap:
                    continue
                before = source[i, j]
                if before < 0 or place[y, x] < place[before // width, before % width]:
                    source[i, j] = y * width + x
