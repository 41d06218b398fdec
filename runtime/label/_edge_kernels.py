"""Compiled kernel that finds pixels whose depth is a blend of two surfaces."""

import math

import numpy as np

from spreadlets.compiled import helper, kernel

STEPS = ((0, 1), (1, 0), (1, 1), (1, -1))


@helper(inline="always")
def _blend_at(depth, radiance, scale, least_gap, flatness, row, col, near, far):
    """Find the surfaces on either side of a pixel, and return the share of the nearer one: 0 if there are none."""
    share = 0.0
    best = 0.0
    for down, right in STEPS:
        i, j = row - down, col - right
        k, m = row + down, col + right
        if depth[i, j] > depth[k, m]:
            i, j, k, m = k, m, i, j
        here, front, back = float(depth[row, col]), float(depth[i, j]), float(depth[k, m])
        if not (front < here < back < math.inf) or radiance[i, j, 3] == 0 or radiance[k, m, 3] == 0:
            continue
        gap = scale * (1.0 / front - 1.0 / back)
        if gap < least_gap or gap <= best:
            continue
        off_front = scale * abs(1.0 / front - 1.0 / float(depth[2 * i - row, 2 * j - col]))
        off_back = scale * abs(1.0 / back - 1.0 / float(depth[2 * k - row, 2 * m - col]))
        if off_front > flatness * gap or off_back > flatness * gap:
            continue
        best = gap
        near[0], near[1] = i, j
        far[0], far[1] = k, m
        share = (back - here) / (back - front)
    return share


@helper(inline="always")
def _find_gaps(above, here, below, step, found):
    """Tell for each pixel of a row whether the surfaces on two opposite sides of it may lie a gap apart.

    Parameters
    ----------
    above, here, below : ndarray of shape (W,), float32
        Depths.
    step : float32
        Difference of inverse depths that is a gap. Depths p and q are, if ``|p - q| >= step p q``.
    found : ndarray of shape (W,), bool
        Filled but for the first and the last pixel.
    """
    n = np.uint64(here.shape[0] - 1)
    for left in range(np.uint64(0), n - np.uint64(1)):
        col, right = left + np.uint64(1), left + np.uint64(2)
        along = abs(here[left] - here[right]) >= step * here[left] * here[right]
        across = abs(above[col] - below[col]) >= step * above[col] * below[col]
        falling = abs(above[left] - below[right]) >= step * above[left] * below[right]
        rising = abs(above[right] - below[left]) >= step * above[right] * below[left]
        found[col] = along | across | falling | rising


@kernel
def find_blends(begin, end, depth, radiance, scale, least_gap, flatness, near, far, share):
    """Find the pixels between two surfaces whose depth lies between them, as antialiasing leaves it.

    Along one of four lines through the pixel, the neighbours on either side lie on different surfaces, and each is as
    deep as its own next neighbour: a slanted surface or a thin object is not taken for an edge.

    Parameters
    ----------
    depth : ndarray of shape (H, W), float32
    radiance : ndarray of shape (H, W, 4), float32
        Pixels without alpha are no surface.
    scale : float
        CoC radius is ``scale * (1 / focus - 1 / depth)``, px.
    least_gap : float
        Smallest difference of the surfaces' CoC radii, px.
    flatness : float
        Largest difference of a neighbour's CoC radius from that of its next, as a share of the gap.
    near, far : ndarray of shape (H, W, 2), int32
        Filled, for blends only, with row and column of the neighbours.
    share : ndarray of shape (H, W), float32
        Filled with the share of the nearer surface; 0 where the pixel is no blend.

    Returns
    -------
    int
        Number of blends.
    """
    height, width = depth.shape
    found = np.empty(width, np.bool_)
    count = 0
    # A little less than the gap, so that rounding hides none.
    step = np.float32(0.999 * least_gap / scale) if scale > 0 else np.float32(np.inf)
    for row in range(begin, end):
        share[row] = 0.0
        if not 2 <= row < height - 2:
            continue
        _find_gaps(depth[row - 1], depth[row], depth[row + 1], step, found)
        for col in range(2, width - 2):
            if not found[col]:
                continue
            share[row, col] = _blend_at(
                depth, radiance, scale, least_gap, flatness, row, col, near[row, col], far[row, col]
            )
            count += share[row, col] > 0
    return count
