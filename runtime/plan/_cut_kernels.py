"""Compiled kernels that count what meets in a frame, and tell which pixels are drawn."""

import math

import numpy as np

from spreadlets.compiled import helper, kernel

DISTANCES = (1, 2, 4, 8)
"""Pixels so far apart, px, are taken to meet: at edges, across thin things, and where wide blurs overlap."""
COUNTING_BLOCKS = 4
"""Parts of a frame that are counted by themselves: always so many, so that sums do not depend on the threads."""
STEEPER = 2.0
"""So many times as much as on the slope before it, a place changes where a surface ends."""
NOWHERE = -2.0
"""Step of a pixel that is not drawn: more than a step from all others."""


@helper
def _meet(first, position, row, col, meetings):
    """Count a meeting of two places, step and path, if both are drawn; add how their paths differ."""
    second = position[row, col, 0]
    if first[0] >= 0.0 and second >= 0.0:
        nearer, farther = int(min(first[0], second)), int(max(first[0], second))
        across, down = first[1] - position[row, col, 1], first[2] - position[row, col, 2]
        meetings[0, nearer, farther] += 1.0
        meetings[1, nearer, farther] += math.sqrt(across * across + down * down)


@kernel
def count_steps(begin, end, labels, at, stride, steps, position, sums, meetings, seams):
    """Find the steps of depth that pixels lie in, and count which of them meet.

    Parameters
    ----------
    labels : tuple of ndarrays
        ``depth``, ``coc`` (H, W), float32, ``path`` (H, W, 2), float32, and ``variant`` (H, W), int32.
    at : ndarray of shape (H, W, 2) or (0, 0, 2), int32
        Where the pixels of a list lie, which meet those of a frame; empty for the frame.
    stride : int
        Of the frame's rows, every so many-eth one is looked at. These are shared out among `COUNTING_BLOCKS`, which
        ``begin`` and ``end`` count. A list is one block.
    steps : tuple of two floats
        Where the first step begins in ``-1 / depth``, and steps for each of its unit.
    position : ndarray of shape (h, W, 3), float64
        Where the frame's pixels lie, in steps, `NOWHERE` if they are not drawn; and their paths, px. Filled from the
        frame, read for a list.
    sums : ndarray of shape (n_blocks, 2, n), float64
        Raised in each block: of each step, the number of pixels, and their CoC radii.
    meetings : ndarray of shape (n_blocks, 2, n, n), float64
        The same: numbers of pairs of pixels, (nearer, farther), and by how much their paths differ, px.
    seams : ndarray of shape (n_blocks, n + 1), float64
        The same: numbers of pairs of neighbours less than a step apart that each border of steps parts.
    """
    depth, coc, path, variant = labels
    listed, last, n_lines = at.shape[0] > 0, sums.shape[2] - 0.5, position.shape[0]
    for block in range(begin, end):
        first_row, end_row = 0, depth.shape[0]
        if not listed:
            first_row = stride * (block * n_lines // COUNTING_BLOCKS)
            end_row = stride * ((block + 1) * n_lines // COUNTING_BLOCKS)
        counted, met, parted = sums[block], meetings[block], seams[block]
        for row in range(first_row, min(end_row, depth.shape[0]), 1 if listed else stride):
            begins, slope = 0, 0.0
            for col in range(depth.shape[1]):
                if listed and at[row, col, 0] % stride:
                    continue
                # Find the pixel's step.
                place = NOWHERE
                if variant[row, col] >= 0:
                    place = min(max((-1.0 / np.float64(depth[row, col]) - steps[0]) * steps[1], 0.0), last)
                    counted[0, int(place)] += 1.0
                    counted[1, int(place)] += coc[row, col]
                here = place, np.float64(path[row, col, 0]), np.float64(path[row, col, 1])
                # Count what it meets: the frame's pixel at its place, or those of other surfaces before it in the row.
                if listed:
                    _meet(here, position, at[row, col, 0] // stride, at[row, col, 1], met)
                    continue
                line = row // stride
                position[line, col, 0], position[line, col, 1], position[line, col, 2] = here
                # Count the border that parts it from its neighbour; where the place jumps, a surface ends.
                if col > 0:
                    before = position[line, col - 1, 0]
                    change = place - before
                    if abs(change) < 1.0 and math.floor(place) != math.floor(before):
                        parted[int(max(place, before))] += 1.0
                    if abs(change) >= 1.0 and not 0.0 < change * slope <= STEEPER * slope * slope and col > 1:
                        begins = col
                    slope = change
                for distance in DISTANCES:
                    if 0 <= col - distance < begins:
                        _meet(here, position, line, col - distance, met)


@kernel
def mark_drawn(begin, end, radiance, weight, drawn):
    """Fill ``drawn`` (H, W), int32: 0 where colour (H, W, 4) and weight (H, W) or (0, 0) are not all 0, else -1."""
    for row in range(begin, end):
        for col in range(drawn.shape[1]):
            pixel = radiance[row, col]
            is_there = pixel[0] != 0.0 or pixel[1] != 0.0 or pixel[2] != 0.0 or pixel[3] != 0.0
            drawn[row, col] = 0 if is_there and (not weight.shape[0] or weight[row, col] > 0.0) else -1
