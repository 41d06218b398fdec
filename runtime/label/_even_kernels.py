"""Compiled kernels that make strands as wide, and as bright, as they are along their line."""

import math

import numpy as np

from spreadlets.compiled import helper, kernel

BESIDE = 2
"""Px to either side of a strand in which it is seen: filters are up to 3 px wide."""
LONGEST = 14
"""Px along a strand, to either side, over which it is averaged."""
ALONG = 7.0
"""Deviation, px, of the average's weights."""
LEAST_LENGTH = 5
SKIP = 3
ALIKE = 0.5
"""Largest difference of places of a strand's pixels, as a share of that which parts two surfaces."""


@helper
def _surface_of(found, number, place, here, most):
    """Return which of a mixed pixel's surfaces lies at a place, or -1."""
    _, shares, sources, _ = found
    for s in range(shares.shape[1]):
        if shares[number, s] > 0.0 or s == 0:
            if abs(place[sources[number, s, 0], sources[number, s, 1]] - here) < most:
                return s
    return -1


@kernel
def measure_strands(begin, end, place, thin, index, found, gap, total, light):
    """Sum what strands cover, and their light, across them.

    Parameters
    ----------
    place : ndarray of shape (H, W), float32
    thin : ndarray of shape (H, W), int8
        1 where a strand goes down, 2 where it goes across, else 0.
    index : ndarray of shape (H, W), int32
        Number of each mixed pixel, else -1.
    found : tuple
        See `divide_pixels`.
    gap : float
    total : ndarray of shape (H, W), float32
        Filled, in the strand's pixels; -1 in others.
    light : ndarray of shape (H, W, 4), float32
        Filled there.
    """
    height, width = place.shape
    _, shares, _, colours = found
    for row in range(begin, end):
        for col in range(width):
            total[row, col] = -1.0
            if not thin[row, col] or index[row, col] < 0:
                continue
            covered = np.float32(0.0)
            for c in range(4):
                light[row, col, c] = 0.0
            for step in range(-BESIDE, BESIDE + (thin[row, col] + 1) // 2):
                i, j = (row, col + step) if thin[row, col] % 2 == 1 else (row + step, col)
                if not (0 <= i < height and 0 <= j < width) or index[i, j] < 0:
                    continue
                number = index[i, j]
                s = _surface_of(found, number, place, place[row, col], ALIKE * gap)
                if s < 0:
                    continue
                covered += shares[number, s]
                for c in range(4):
                    light[row, col, c] += shares[number, s] * colours[number, s, c]
            total[row, col] = covered


@kernel
def average_strands(begin, end, place, thin, total, light, gap, mean, mean_light):
    """Average what `measure_strands` found along strands."""
    height, width = place.shape
    for row in range(begin, end):
        for col in range(width):
            mean[row, col] = -1.0
            if total[row, col] < 0.0:
                continue
            weights, covered = 1.0, np.float64(total[row, col])
            red, green = np.float64(light[row, col, 0]), np.float64(light[row, col, 1])
            blue, alpha = np.float64(light[row, col, 2]), np.float64(light[row, col, 3])
            n_followed = 0
            for side in (-1, 1):
                # Follow the strand pixel by pixel.
                i, j = row, col
                step = 0
                while step < LONGEST:
                    ahead = False
                    for reach in range(1, SKIP + 1):
                        for k in range(2 * reach + 1):
                            shift = (k + 1) // 2 * (1 if k % 2 else -1)
                            y, x = (i + side * reach, j + shift) if thin[row, col] % 2 == 1 else (i + shift, j + side * reach)
                            if 0 <= y < height and 0 <= x < width and total[y, x] >= 0.0 and (thin[y, x] - thin[row, col]) % 2 == 0:
                                if abs(place[y, x] - place[row, col]) < ALIKE * gap:
                                    ahead = True
                                    break
                        if ahead:
                            step += reach
                            break
                    if not ahead:
                        break
                    i, j = y, x
                    n_followed += 1
                    weight = math.exp(-0.5 * (step / ALONG) ** 2)
                    weights += weight
                    covered += weight * total[i, j]
                    red += weight * light[i, j, 0]
                    green += weight * light[i, j, 1]
                    blue += weight * light[i, j, 2]
                    alpha += weight * light[i, j, 3]
            if n_followed < LEAST_LENGTH:
                continue
            mean[row, col] = covered / weights
            mean_light[row, col, 0], mean_light[row, col, 1] = red / weights, green / weights
            mean_light[row, col, 2], mean_light[row, col, 3] = blue / weights, alpha / weights


@helper
def _give(radiance, shares, colours, own, share, light, share_light):
    """Give a surface of a pixel a share, with a colour, and the others what is left."""
    before = shares[own]
    if share >= 1.0 or before >= 1.0:
        return
    for c in range(4):
        left = was = 0.0
        part = min(light[c] * share_light, radiance[c])
        left = radiance[c] - part
        for s in range(len(shares)):
            if s != own:
                was += shares[s] * colours[s, c]
        colours[own, c] = part / share if share > 0.0 else 0.0
        for s in range(len(shares)):
            if s != own and shares[s] > 0.0:
                bright = shares[s] * colours[s, c] / was if was > 0.0 else shares[s] / (1.0 - before)
                colours[s, c] = left * bright / (shares[s] * (1.0 - share) / (1.0 - before))
    for s in range(len(shares)):
        shares[s] = share if s == own else shares[s] * (1.0 - share) / (1.0 - before)


@kernel
def even_strands(begin, end, place, radiance, thin, index, gap, total, mean, mean_light, first, found):
    """Give strands what they cover on average along them. All rows are done in one call."""
    height, width = place.shape
    _, shares, _, colours = found
    for row in range(begin, end):
        for col in range(width):
            if mean[row, col] <= 0.0:
                continue
            for step in range(-BESIDE, BESIDE + (thin[row, col] + 1) // 2):
                i, j = (row, col + step) if thin[row, col] % 2 == 1 else (row + step, col)
                if not (0 <= i < height and 0 <= j < width) or index[i, j] < 0:
                    continue
                number = index[i, j]
                s = _surface_of(found, number, place, place[row, col], ALIKE * gap)
                if s < 0:
                    continue
                if total[row, col] > 0.0:
                    share = shares[number, s] * mean[row, col] / total[row, col]
                else:
                    share = mean[row, col] if step == 0 else 0.0
                share = min(share, 0.98)
                _give(radiance[i, j], shares[number], colours[number], s, share, mean_light[row, col], share / mean[row, col])
                first[0][i, j] = shares[number, 0]
                for c in range(4):
                    first[1][i, j, c] = colours[number, 0, c]
