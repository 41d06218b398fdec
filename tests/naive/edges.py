"""Means along edges, pixel by pixel, by eigenvectors of the structure tensor."""

import numpy as np

from spreadlets.runtime.finish.edges import WINDOW_AXES, WINDOW_REACH


def steered_mean(lacking, count, products, row, col):
    """Return the mean about one pixel, and its variance."""
    xx, xy, yy = products[:, row, col].astype(np.float64)
    value, vector = np.linalg.eigh([[xx, xy], [xy, yy]])
    agree = ((value[1] - value[0]) / (value[1] + value[0])) ** 2
    along, across, even = WINDOW_AXES
    lengths = even + agree * (along - even), even + agree * (across - even)
    total, mean, squares = 0.0, np.zeros(3), 0.0
    for y in range(max(row - WINDOW_REACH, 0), min(row + WINDOW_REACH + 1, len(count))):
        for x in range(max(col - WINDOW_REACH, 0), min(col + WINDOW_REACH + 1, count.shape[1])):
            # The smaller eigenvalue's vector runs along the edge.
            places = vector.T @ (x - col, y - row) / lengths
            weight = max(1.0 - places @ places, 0.0) ** 2 * count[y, x]
            total += weight
            mean += weight * lacking[y, x]
            squares += weight**2 * (lacking[y, x].astype(np.float64) ** 2).sum()
    return mean / total, squares / total**2
