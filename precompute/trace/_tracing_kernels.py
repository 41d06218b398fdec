"""Numba kernels of the light tracer: the point sequence and the exact deposit of line segments."""

import math

import numpy as np

from spreadlets.arrays import DoubleArray, IntArray
from spreadlets.compiled import helper, kernel


@kernel
def kronecker(first: int, total: int, most: int, shift: DoubleArray, alpha: DoubleArray) -> DoubleArray:
    """Fill rows with points ``first, first + 1, ...`` of a shifted Hammersley-Kronecker set of ``total`` points.

    Parameters
    ----------
    first, total, most : int
        The rows are points ``first`` up to, but excluding, ``first + n``, n being ``most`` or as many as are left.
    shift : float64 array of shape (d,)
        Cranley-Patterson rotation in [0, 1).
    alpha : float64 array of shape (d - 1,)
        Generators of the irrational rotation.

    Returns
    -------
    float64 array of shape (n, d)
        Column 0 is ``(i + shift) / total``; column j is ``frac(shift_j + i alpha_j)``.
    """
    n = min(total - first, most)
    points = np.empty((n, len(shift)), dtype=np.float64)
    for row in range(n):
        i = first + row
        points[row, 0] = (i + shift[0]) / total
        for j in range(1, len(shift)):
            value = shift[j] + i * alpha[j - 1]
            points[row, j] = value - math.floor(value)
    return points


@kernel
def cut_lines(
    nodes: DoubleArray,
    density: DoubleArray,
    clearance: DoubleArray,
    ends: DoubleArray,
    start: DoubleArray,
    stop: DoubleArray,
) -> int:
    """Join the nodes of lines by segments, cut where the clearance, linear between the nodes, falls below zero.

    Parameters
    ----------
    nodes : float64 array of shape (n, K, 2)
        Places x, y on the image.
    density : float64 array of shape (n, K, C)
        Energy density per step from node to node.
    clearance : float64 array of shape (n, K)
        At least 0 where light passes.
    ends : float64 array of shape (n * (K - 1), 4)
        Its first rows are filled with x0, y0, x1, y1 of the segments that light passes along.
    start, stop : float64 arrays of shape (n * (K - 1), C)
        Filled with the energy density at the ends, per unit of the cut segment's own parameter.

    Returns
    -------
    int
        Number of rows that are filled.
    """
    count = 0
    for line in range(nodes.shape[0]):
        for k in range(nodes.shape[1] - 1):
            # Skip segments in the dark.
            here, there = clearance[line, k], clearance[line, k + 1]
            if not (here > 0.0 or there > 0.0):
                continue
            # Find the parameters between which the clearance is positive.
            first = here / (here - there) if here < 0.0 else 0.0
            last = here / (here - there) if there < 0.0 else 1.0
            # Cut the ends, and the energy density, to them.
            for axis in range(2):
                begin, step = nodes[line, k, axis], nodes[line, k + 1, axis] - nodes[line, k, axis]
                ends[count, axis], ends[count, 2 + axis] = begin + first * step, begin + last * step
            for channel in range(density.shape[2]):
                low = density[line, k, channel]
                slope = density[line, k + 1, channel] - low
                start[count, channel] = (last - first) * (low + first * slope)
                stop[count, channel] = (last - first) * (low + last * slope)
            count += 1
    return count


@kernel
def lit_runs(clearance: DoubleArray, line: IntArray, first: DoubleArray, last: DoubleArray) -> int:
    """Find the parts of lines along which the clearance, linear between equally spaced nodes, is above zero.

    Parameters
    ----------
    clearance : float64 array of shape (n, K)
    line : int64 array of shape (n * K,)
        Its first entries are filled with the line of each part.
    first, last : float64 arrays of shape (n * K,)
        Filled with where it begins and ends, from 0 to K - 1.

    Returns
    -------
    int
        Number of parts.
    """
    count = 0
    n_nodes = clearance.shape[1]
    for row in range(clearance.shape[0]):
        for k in range(n_nodes):
            if not clearance[row, k] > 0.0:
                continue
            # A part begins between a dark node and a lit one, or at the line's end.
            if k == 0 or not clearance[row, k - 1] > 0.0:
                before = clearance[row, k - 1] if k > 0 else 0.0
                line[count] = row
                first[count] = k - clearance[row, k] / (clearance[row, k] - before) if k > 0 else 0.0
            # It ends between a lit node and a dark one.
            if k == n_nodes - 1 or not clearance[row, k + 1] > 0.0:
                after = clearance[row, k + 1] if k < n_nodes - 1 else 0.0
                last[count] = k + clearance[row, k] / (clearance[row, k] - after) if k < n_nodes - 1 else float(k)
                count += 1
    return count


@helper
def deposit_segment(i: int, ends: DoubleArray, start: DoubleArray, stop: DoubleArray, image: DoubleArray) -> None:
    """Add segment i to ``image``: each pixel gets the energy of the part of the segment that lies in it.

    Parameters
    ----------
    i : int
        Row of the next three arrays. Views of a row would cost more, in reference counts, than the deposit.
    ends : float64 array of shape (n, 4)
        x0, y0, x1, y1 in px from the centre of the image's central pixel; a pixel owns the half-open square of side
        1 about its centre.
    start, stop : float64 arrays of shape (n, C)
        Energy density per unit of the segment's parameter t in [0, 1] at its two ends, linear between them; the
        segment's energy is their mean.
    image : float64 array of shape (H, W, C)
        H and W odd; the segment must lie inside (`test_no_segment_leaves_the_square_that_its_tracer_names`).

    Notes
    -----
    Amanatides and Woo 1987, "A fast voxel traversal algorithm for ray tracing". The number of steps is known from
    the end pixels, so rounding cannot lead the traversal out of the image. A segment of no length is a point.
    ``fastmath`` would break the infinite step of an axis-parallel segment.
    """
    x0, y0 = ends[i, 0] + 0.5 + image.shape[1] // 2, ends[i, 1] + 0.5 + image.shape[0] // 2
    x1, y1 = ends[i, 2] + 0.5 + image.shape[1] // 2, ends[i, 3] + 0.5 + image.shape[0] // 2
    dx, dy = x1 - x0, y1 - y0
    col, row = math.floor(x0), math.floor(y0)
    left_x, left_y = abs(math.floor(x1) - col), abs(math.floor(y1) - row)
    step_col, step_row = (1 if dx > 0.0 else -1), (1 if dy > 0.0 else -1)
    # The parameter at which the segment crosses its next column and row border, and the distance between borders.
    next_x, next_y = math.inf, math.inf
    delta_x, delta_y = math.inf, math.inf
    if left_x > 0:
        delta_x = abs(1.0 / dx)
        next_x = (col + (step_col > 0) - x0) / dx
    if left_y > 0:
        delta_y = abs(1.0 / dy)
        next_y = (row + (step_row > 0) - y0) / dy
    t = 0.0
    for _ in range(left_x + left_y):
        # An axis whose crossings are used up must not step again, however its last crossing rounds.
        along_row = left_y == 0 or (left_x > 0 and next_x < next_y)
        until = min(max(next_x if along_row else next_y, t), 1.0)
        middle = 0.5 * (t + until)
        for channel in range(image.shape[2]):
            density = start[i, channel] + (stop[i, channel] - start[i, channel]) * middle
            image[row, col, channel] += (until - t) * density
        t = until
        if along_row:
            col += step_col
            next_x += delta_x
            left_x -= 1
        else:
            row += step_row
            next_y += delta_y
            left_y -= 1
    middle = 0.5 * (t + 1.0)
    for channel in range(image.shape[2]):
        density = start[i, channel] + (stop[i, channel] - start[i, channel]) * middle
        image[row, col, channel] += (1.0 - t) * density


@kernel
def deposit_segments(
    begin: int, end: int, ends: DoubleArray, start: DoubleArray, stop: DoubleArray, images: DoubleArray
) -> None:
    """Add segments to a stack of images, a contiguous share to each, so that no two threads meet in one image.

    Parameters
    ----------
    ends : float64 array of shape (n, 4)
    start, stop : float64 arrays of shape (n, C)
    images : float64 array of shape (n_blocks, H, W, C)
        H and W odd. The shares depend on n_blocks alone, so the result is the same for any number of threads.
    """
    n_blocks = images.shape[0]
    n = ends.shape[0]
    for block in range(begin, end):
        for i in range(n * block // n_blocks, n * (block + 1) // n_blocks):
            deposit_segment(i, ends, start, stop, images[block])
