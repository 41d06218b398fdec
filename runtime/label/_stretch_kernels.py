"""Compiled kernels that tell how much a moving surface is stretched."""

import numpy as np

from spreadlets.compiled import helper, kernel

REACH = 4
"""Px to either side over which motion is compared: that of files is rounded."""
SAME_SURFACE = 0.05
"""Difference of depths, as a share, from which neighbours are of two surfaces."""
LEAST_AREA, LARGEST_AREA = 0.25, 4.0


@helper
def _last_along(depth, radiance, row, col, down, across):
    """Return how many pixels one may go from a pixel in a direction, and stay on its surface."""
    height, width = depth.shape
    here = depth[row, col]
    for step in range(1, REACH + 1):
        i, j = row + step * down, col + step * across
        if not (0 <= i < height and 0 <= j < width) or radiance[i, j, 3] == 0.0:
            return step - 1
        if not abs(depth[i, j] - here) <= SAME_SURFACE * here:
            return step - 1
    return REACH


@helper
def _slope(depth, radiance, place, row, col, down, across):
    """Return by how much places change for each pixel in a direction, (x, y)."""
    before = _last_along(depth, radiance, row, col, -down, -across)
    after = _last_along(depth, radiance, row, col, down, across)
    if before + after == 0:
        return 0.0, 0.0
    first, last = place[row - before * down, col - before * across], place[row + after * down, col + after * across]
    x, y = np.float64(last[0]) - np.float64(first[0]), np.float64(last[1]) - np.float64(first[1])
    return x / (before + after), y / (before + after)


@kernel
def add_areas(begin, end, depth, radiance, place, share, area):
    """Add a share of the areas that pixels have where they are at a time.

    Parameters
    ----------
    depth : ndarray of shape (H, W), float32
    radiance : ndarray of shape (H, W, 4), float32
        Where alpha is 0 there is no surface.
    place : ndarray of shape (H, W, 2), float32
        Where each pixel is then, px (dx, dy) from its own place.
    share : float32
    area : ndarray of shape (H, W), float32
        Changed.
    """
    for row in range(begin, end):
        for col in range(depth.shape[1]):
            found = 1.0
            if radiance[row, col, 3] > 0.0:
                xx, xy = _slope(depth, radiance, place, row, col, 0, 1)
                yx, yy = _slope(depth, radiance, place, row, col, 1, 0)
                # What is opaque and shrinks hides itself; it stays opaque as it is.
                least = 1.0 if radiance[row, col, 3] == 1.0 else LEAST_AREA
                found = min(max((1.0 + xx) * (1.0 + yy) - xy * yx, least), LARGEST_AREA)
            area[row, col] += share * np.float32(found)
