"""Means along edges, pixel by pixel, by eigenvectors of the structure tensor."""

import numpy as np

from spreadlets.runtime.finish.edges import FOLLOWED, STRAIGHT


def direction(products, row, col):
    """Return the vector (x, y) along the edge at a pixel, and how much the slopes around agree."""
    xx, xy, yy = products[:, row, col].astype(np.float64)
    value, vector = np.linalg.eigh([[xx, xy], [xy, yy]])
    return vector[:, 0], ((value[1] - value[0]) / (value[1] + value[0])) ** 2


def followed(products, is_edge, row, col):
    """Yield the places (x, y) along the edge through a pixel, whether it is level there, and how much they count."""
    height, width = is_edge.shape
    first, agree = direction(products, row, col)
    length = FOLLOWED[1] + agree * (FOLLOWED[0] - FOLLOWED[1])
    for side in (1.0, -1.0):
        along, place, gone = side * first, np.array((col, row), float), 0.0
        while gone < length:
            if gone > 0.0 or side == 1.0:
                yield place, abs(along[0]) >= abs(along[1]), (1.0 - (gone / length) ** 2) ** 2
            stride = 1.0 / np.abs(along).max()
            place, gone = place + stride * along, gone + stride
            x, y = np.rint(place).astype(int)
            if not (0 <= x < width and 0 <= y < height and is_edge[y, x]):
                break
            onward, _ = direction(products, y, x)
            if abs(onward @ along) < STRAIGHT:
                break
            along = onward * np.sign(onward @ along)


def steered_mean(lacking, count, products, is_edge, row, col):
    """Return the mean along the edge through one pixel, and its variance."""
    total, mean, squares = 0.0, np.zeros(lacking.shape[2]), 0.0
    for place, is_level, taper in followed(products, is_edge, row, col):
        across = int(is_level)
        before = int(np.floor(place[across]))
        for near, part in ((before, before + 1 - place[across]), (before + 1, place[across] - before)):
            at = np.rint(place).astype(int)
            at[across] = near
            x, y = at
            if 0 <= y < len(count) and 0 <= x < count.shape[1]:
                weight = taper * part * count[y, x]
                total += weight
                mean += weight * lacking[y, x]
                squares += weight**2 * (lacking[y, x].astype(np.float64) ** 2).sum()
    return mean / total, squares / total**2
