"""Compiled loops of sparsification: dart throwing, Voronoi assignment, the similarity form's rows, point solutions."""

from __future__ import annotations

import math

import numpy as np

from spreadlets.compiled import kernel


@kernel
def throw_darts(cumulative, radius, uniform, max_failures, accepted):
    """Place pixels drawn by importance, refusing those nearer to a placed one than their own radius.

    Parameters
    ----------
    cumulative : ndarray of shape (H * W,), float64
        Running sum of the pixels' importance, last entry 1.
    radius : ndarray of shape (H, W), float64
        Smallest distance of a pixel to all earlier points, px.
    uniform : ndarray of shape (N,), float64
        Uniform variates in [0, 1), one for each attempt.
    max_failures : int
        Number of refused attempts after which to stop.
    accepted : ndarray of shape (H * W, 2), int64
        Receives the placed (row, column) pairs.

    Returns
    -------
    n_accepted, n_failures : int
        Both counted within this batch of attempts.
    """
    height, width = radius.shape
    taken = np.zeros((height, width), dtype=np.bool_)
    n_accepted = 0
    n_failures = 0
    for attempt in range(uniform.size):
        if n_failures >= max_failures:
            break
        # Sample a pixel by importance.
        pixel = min(np.searchsorted(cumulative, uniform[attempt], side="right"), height * width - 1)
        row = pixel // width
        column = pixel % width
        # Look for an earlier point within its radius.
        reach = radius[row, column]
        whole = int(math.floor(reach))
        free = True
        for r in range(max(0, row - whole), min(height, row + whole + 1)):
            for c in range(max(0, column - whole), min(width, column + whole + 1)):
                if taken[r, c] and (r - row) ** 2 + (c - column) ** 2 <= reach * reach:
                    free = False
                    break
            if not free:
                break
        # Accept it, or count the failure.
        if free:
            taken[row, column] = True
            accepted[n_accepted, 0] = row
            accepted[n_accepted, 1] = column
            n_accepted += 1
        else:
            n_failures += 1
    return n_accepted, n_failures


@kernel
def nearest_points(pixel_rc, point_rc, owner):
    """Find for each pixel its nearest point (the first in order of row among equals).

    The points are sorted by row, so the search walks outwards from the pixel's row and stops when the row distance
    alone exceeds the best distance.

    Parameters
    ----------
    pixel_rc : ndarray of shape (P, 2), float64
        Pixels.
    point_rc : ndarray of shape (n, 2), float64
        Points in ascending order of row (`test_assignment_agrees_with_brute_force`).
    owner : ndarray of shape (P,), int64
        Receives the index of each pixel's point.
    """
    n_points = point_rc.shape[0]
    for i in range(pixel_rc.shape[0]):
        row = pixel_rc[i, 0]
        column = pixel_rc[i, 1]
        # Begin between the points before and behind the pixel's row.
        above = np.searchsorted(point_rc[:, 0], row)
        below = above - 1
        best = np.inf
        chosen = 0
        while True:
            # Stop when the row distance alone exceeds the best distance.
            gap_above = (point_rc[above, 0] - row) ** 2 if above < n_points else np.inf
            gap_below = (point_rc[below, 0] - row) ** 2 if below >= 0 else np.inf
            if min(gap_above, gap_below) > best or (above >= n_points and below < 0):
                break
            # Step to the point of the nearer row.
            if gap_below <= gap_above:
                j = below
                below -= 1
                gap = gap_below
            else:
                j = above
                above += 1
                gap = gap_above
            # Keep the nearest, among equals the first.
            distance = gap + (point_rc[j, 1] - column) ** 2
            if distance < best or (distance == best and j < chosen):
                best = distance
                chosen = j
        owner[i] = chosen


@kernel(fastmath=True)
def add_green(planes, quarter, point_rc, value):
    """Add the free-space solution of some points to an image, in place.

    Parameters
    ----------
    planes : ndarray of shape (C, H, W), float64
        The solution to update.
    quarter : ndarray of shape (R, R), float64
        Lattice Green's function by absolute row and column distance; R at least max(H, W).
    point_rc : ndarray of shape (n, 2), int64
        Points inside the image.
    value : ndarray of shape (n, C), float64
        Values to add at the points.
    """
    n_channels, height, width = planes.shape
    for k in range(n_channels):
        for r in range(height):
            line = planes[k, r]
            for j in range(point_rc.shape[0]):
                green = quarter[abs(r - point_rc[j, 0])]
                column = point_rc[j, 1]
                weight = value[j, k]
                # Two loops without a case distinction, which the compiler turns into vector code.
                for c in range(column):
                    line[c] += weight * green[column - c]
                for c in range(column, width):
                    line[c] += weight * green[c - column]


@kernel(fastmath=True)
def fill_rows(sample_rc, weight, members, share, mean_table, detail_table, rows):
    """Evaluate the similarity form's three rows for each sample and each orbit of points.

    Parameters
    ----------
    sample_rc : ndarray of shape (S, 2), int64
        Offsets of the samples from the centre.
    weight : ndarray of shape (S, 3), float64
        Square roots of the weights of the three rows.
    members : ndarray of shape (m, g, 2), int64
        Offsets of each orbit's points.
    share : ndarray of shape (m,), float64
        Value that each listed member carries for a unit value of the orbit: below 1 where members repeat.
    mean_table, detail_table : ndarray of shape (R, R), float64
        Window mean and detail filter of the lattice Green's function, by absolute row and column distance.
    rows : ndarray of shape (3 * S, m), float64
        Receives for each sample the window mean and the detail's forward differences along columns and rows.
    """
    n_members = members.shape[1]
    for s in range(sample_rc.shape[0]):
        for orbit in range(members.shape[0]):
            # Sum what the orbit's points add to the window mean and the detail's differences.
            mean = 0.0
            along_row = 0.0
            along_column = 0.0
            for k in range(n_members):
                dr = sample_rc[s, 0] - members[orbit, k, 0]
                dc = sample_rc[s, 1] - members[orbit, k, 1]
                r = abs(dr)
                c = abs(dc)
                mean += mean_table[r, c]
                here = detail_table[r, c]
                along_row += detail_table[r, abs(dc + 1)] - here
                along_column += detail_table[abs(dr + 1), c] - here
            # Weight the three rows.
            rows[3 * s, orbit] = weight[s, 0] * share[orbit] * mean
            rows[3 * s + 1, orbit] = weight[s, 1] * share[orbit] * along_row
            rows[3 * s + 2, orbit] = weight[s, 2] * share[orbit] * along_column
