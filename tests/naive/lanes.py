"""Sums along the paths of a layer, place by place, in double precision."""

import numpy as np


def places(path, row, col, near):
    """Yield the places (x, y) along the path through a pixel, whether it is level there, its step, and its distance."""
    height, width = path.shape[:2]
    first = path[row, col].astype(np.float64)
    for side in (1.0, -1.0):
        way, place, gone = side * first, np.array((col, row), float), 0.0
        while gone < 0.5 * np.hypot(*first) and way.any():
            stride = (1.0 if gone < near else 2.0) / np.abs(way).max()
            step = stride * np.hypot(*way)
            if gone > 0.0 or side == 1.0:
                yield place, abs(way[0]) >= abs(way[1]), step, gone
            place, gone = place + stride * way, gone + step
            x, y = np.floor(place + 0.5).astype(int)
            if not (0 <= x < width and 0 <= y < height):
                break
            way = side * path[y, x].astype(np.float64)


def sums_along(padded, measure, planes, path, reach, row, col):
    """Return the sums of splats (5,) under a tent along the path through a pixel, and of samples (6,) along all of it.

    ``measure`` (H, W) is by what ``padded`` (H, W, 4) is divided.
    """
    height, width = path.shape[:2]
    along, lane = np.zeros(5), np.zeros(6)
    near = max(min(reach[0] * np.hypot(*path[row, col]), reach[1]), 1.0)
    for place, level, step, gone in places(path, row, col, near):
        x, y = np.floor(place + 0.5).astype(int)
        lane += step * planes[y, x]
        before = int(np.floor(place[int(level)]))
        for k in range(2 if gone < near else 0):
            i, j = (before + k, x) if level else (y, before + k)
            weight = max(0.0, 1.0 - abs(place[int(level)] - before - k)) * step * (1.0 - gone / near)
            if 0 <= i < height and 0 <= j < width:
                along += weight * np.append(padded[i, j], measure[i, j])
    return along, lane
