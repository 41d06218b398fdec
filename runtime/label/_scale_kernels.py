"""A compiled kernel that tells by how much surfaces that move apart differ in depth."""

import math

import numpy as np

from spreadlets.compiled import kernel

STEEP = 4.0
"""How many times as much depth changes between two pixels as before or behind them, where a surface ends."""
BESIDE = 3
"""Over so many pixels: depths that were enlarged, or rounded, change on a slope but now and then."""
BINS_PER_OCTAVE, FIRST_OCTAVE, N_BINS = 4, -20, 128
"""Differences of inverse depth are counted in such steps of their logarithm."""


@kernel
def count_differences(begin, end, depth, motion, parting, counts):
    """Count neighbours along each line by how much their inverse depths differ.

    Parameters
    ----------
    depth : ndarray of shape (H, W), float32
    motion : ndarray of shape (H, W, 2), float32
    parting : float
        Difference of motions that parts two surfaces.
    counts : ndarray of shape (H, 2, N_BINS), int64
        Filled: neighbours on one surface, which move alike, and those of which one ends while they move apart.
    """
    width = depth.shape[1]
    for row in range(begin, end):
        line, moves = depth[row], motion[row]
        counts[row] = 0
        for col in range(BESIDE, width - 1 - BESIDE):
            here, next_one = 1.0 / np.float64(line[col]), 1.0 / np.float64(line[col + 1])
            difference = next_one - here
            if difference == 0.0:
                continue
            before = here - 1.0 / np.float64(line[col - BESIDE])
            behind = 1.0 / np.float64(line[col + 1 + BESIDE]) - next_one
            # Where a surface ends, depth changes far less on it, or behind it, than here: also of what is a pixel wide.
            ends = abs(difference) > STEEP * min(abs(before), abs(behind))
            across, down = moves[col + 1, 0] - moves[col, 0], moves[col + 1, 1] - moves[col, 1]
            if ends != (math.sqrt(across * across + down * down) >= parting):
                continue
            # On a slope it changes all along.
            if not ends and (before * difference < 0.0 or behind * difference < 0.0):
                continue
            place = int((math.log2(abs(difference)) - FIRST_OCTAVE) * BINS_PER_OCTAVE)
            counts[row, int(ends), min(max(place, 0), N_BINS - 1)] += 1
