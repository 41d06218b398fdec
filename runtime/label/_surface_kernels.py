"""Compiled kernels that explain mixed pixels by the surfaces around them."""

import math

import numpy as np

from spreadlets.compiled import helper, kernel

REACH = 2
"""Surfaces whose pixels lie no farther than this, px, may be seen in a pixel: filters are up to 3 px wide."""
COLOUR_REACH = 3
"""A surface's colour is taken from its pixels within this, px."""
MOST = 3
"""Surfaces of a pixel."""
PURITY_POWER = 8
"""How much the purer of a surface's pixels count: one that is a fifth of another surface counts a sixth."""
LONGEST = 5
"""Steps, px, to either side along an edge."""
ALONG = 2.0
"""Deviation, px, along a straight edge of the mean that tells how a surface covers a pixel."""
ACROSS = 0.6
"""The same where there is no direction: at corners and dots."""
TRUST_NEAR, TRUST_FAR = 0.15, 0.05
"""Deviations of the coverage that is found by that mean: within a pixel of the surface, and farther from it."""
TRUST_DEPTH = 0.02
"""Deviation of a coverage that filtered depth tells."""
LEAST_NOISE, COLOUR_NOISE = 0.02, 0.1
"""Deviation of a surface's colour: at least so much, and so much of itself."""
LAMP_RATIO = 4.0
"""How many times as bright as usual a surface's pixel may be before it is taken to show something else."""
SAME_SURFACE = 1.0
"""Difference of places, px, below which a pixel is taken to show the surface of another: that of a gap."""
NEGLIGIBLE = 0.002
"""A coverage, and a brightness, that no display shows."""

WINDOW_WEIGHT = np.exp(-0.5 * np.add.outer(np.arange(-REACH, REACH + 1) ** 2, np.arange(-REACH, REACH + 1) ** 2))
"""How much a pixel's surroundings tell of the surfaces in it, by their place around it."""
GRADIENT_WEIGHT = np.sqrt(WINDOW_WEIGHT)
"""The same for the direction of an edge."""
COLOUR_WEIGHT = 1.0 / (
    1.0 + 0.25 * np.add.outer(*2 * [np.arange(-COLOUR_REACH, COLOUR_REACH + 1, dtype=np.float64) ** 2])
)
"""The same for the colours of surfaces."""


@kernel
def find_purity(begin, end, place, gap, purity):
    """Fill ``purity`` (H, W), float32, with the share of each pixel's filter that its own surface fills, about.

    Pixels whose ``place`` (H, W), float32, differs by less than ``gap`` are of one surface.
    """
    height, width = place.shape
    for row in range(begin, end):
        for col in range(width):
            here, total, own = place[row, col], 0.0, 0.0
            for i in range(max(row - 1, 0), min(row + 2, height)):
                for j in range(max(col - 1, 0), min(col + 2, width)):
                    # The weights of a filter 3 px wide, as most renderers have it: 0.8 and 0.1 along each axis.
                    weight = (0.8 if i == row else 0.1) * (0.8 if j == col else 0.1)
                    total += weight
                    own += weight if abs(place[i, j] - here) < gap else 0.0
            purity[row, col] = own / total


@helper
def _surfaces_around(place, row, col, gap, spare, bounds):
    """Fill ``bounds`` (MOST, 2) with the least and largest places of the surfaces around a pixel; return their number.

    Places in the window with no gap between them are of one surface. The first is the pixel's own, the others are
    those that have most of the window, nearer pixels counting more.
    """
    height, width = place.shape
    low, high, weight, best = spare
    n = 0
    for i in range(max(row - REACH, 0), min(row + REACH + 1, height)):
        for j in range(max(col - REACH, 0), min(col + REACH + 1, width)):
            each = place[i, j]
            if each == math.inf:
                continue
            # Join what the place is less than a gap from.
            first = n
            for k in range(n - 1, -1, -1):
                if not (each - high[k] < gap and low[k] - each < gap):
                    continue
                if first == n:
                    low[k], high[k] = min(low[k], each), max(high[k], each)
                    first = k
                    continue
                low[k], high[k] = min(low[k], low[first]), max(high[k], high[first])
                weight[k] += weight[first]
                n -= 1
                low[first], high[first], weight[first] = low[n], high[n], weight[n]
                first = k
            if first == n:
                low[n], high[n], weight[n] = each, each, 0.0
                n += 1
            weight[first] += WINDOW_WEIGHT[i - row + REACH, j - col + REACH]
    for s in range(MOST):
        bounds[s, 0], bounds[s, 1], best[s] = math.inf, -math.inf, 0.0
    for k in range(n):
        score = math.inf if low[k] <= place[row, col] <= high[k] else weight[k]
        for s in range(MOST):
            if score > best[s]:
                score, best[s] = best[s], score
                low[k], bounds[s, 0] = bounds[s, 0], low[k]
                high[k], bounds[s, 1] = bounds[s, 1], high[k]
    return min(n, MOST)


@helper
def _number_surfaces(place, row, col, bounds, count, which):
    """Fill ``which`` (n, n), int8, with the number of the surface that each pixel around one is of, -1 for others."""
    height, width = place.shape
    half = len(which) // 2
    for i in range(len(which)):
        y = min(max(row + i - half, 0), height - 1)
        for j in range(len(which)):
            each, found = place[y, min(max(col + j - half, 0), width - 1)], -1
            for s in range(count):
                if bounds[s, 0] <= each <= bounds[s, 1]:
                    found = s
            which[i, j] = found


@helper
def _share_between(place, y, x, low, high):
    """Return the share of places from ``low`` to ``high`` at a point, by bilinear interpolation."""
    height, width = place.shape
    i, j = math.floor(y), math.floor(x)
    down, across = y - i, x - j
    above, below = min(max(i, 0), height - 1), min(max(i + 1, 0), height - 1)
    left, right = min(max(j, 0), width - 1), min(max(j + 1, 0), width - 1)
    upper = (1.0 - across) * (low <= place[above, left] <= high) + across * (low <= place[above, right] <= high)
    lower = (1.0 - across) * (low <= place[below, left] <= high) + across * (low <= place[below, right] <= high)
    return upper + down * (lower - upper)


@helper
def _edge_share(place, row, col, low, high, which, number):
    """Return how much of a pixel a surface covers, with places from ``low`` to ``high``, by its mean along the edge.

    Point samples of a straight edge are a staircase. Its mean along the edge, interpolated linearly, is the edge as a
    filter about 2 px wide shows it. The direction is that of the least change around the pixel (structure tensor).
    """
    # Sum up the structure tensor of the marks (Sobel gradients).
    xx = yy = xy = 0.0
    for i in range(1, 6):
        for j in range(1, 6):
            falling = int(which[i + 1, j + 1] == number) - int(which[i - 1, j - 1] == number)
            rising = int(which[i - 1, j + 1] == number) - int(which[i + 1, j - 1] == number)
            across = falling + rising + 2 * (int(which[i, j + 1] == number) - int(which[i, j - 1] == number))
            down = falling - rising + 2 * (int(which[i + 1, j] == number) - int(which[i - 1, j] == number))
            weight = GRADIENT_WEIGHT[i - 1, j - 1]
            xx += weight * (across * across)
            yy += weight * (down * down)
            xy += weight * (across * down)
    if xx + yy == 0.0:
        return np.float64(low <= place[row, col] <= high)
    # Turn into the direction of least change, and filter the longer, the straighter the edge is.
    size = math.sqrt((xx - yy) ** 2 + 4.0 * xy * xy)
    double_cosine = (xx - yy) / size if size > 0.0 else 1.0
    step_row = math.sqrt(0.5 * (1.0 + double_cosine))
    step_col = math.sqrt(max(0.5 * (1.0 - double_cosine), 0.0)) * (-1.0 if xy > 0.0 else 1.0)
    falloff = math.exp(-0.5 / (ALONG * (size / (xx + yy)) ** 2 + ACROSS) ** 2)
    # Filter along it, with bilinear interpolation; each Gaussian weight follows from the one before.
    weight, ratio = 1.0, falloff
    total, share = 1.0, np.float64(low <= place[row, col] <= high)
    for step in range(1, LONGEST + 1):
        weight, ratio = weight * ratio, ratio * falloff * falloff
        total += 2.0 * weight
        for side in (-step, step):
            share += weight * _share_between(place, row + side * step_row, col + side * step_col, low, high)
    return share / total


@helper
def _brightness(colour):
    """Return the brightest channel of a colour."""
    return np.float64(max(colour[0], colour[1], colour[2]))


@helper
def _add_colours(radiance, weights, row, col, which, count, sums):
    """Sum over the pixels of each surface near a pixel; see `_colour_models` for the columns.

    Next to a lamp, the lamp's light in a surface's pixels may be far more than their own. So those that are many times
    brighter than the geometric mean of the surface's pixels count little.
    """
    purity, power, log_light = weights
    height, width = purity.shape
    middle = len(which) // 2
    sums[:] = 0.0
    for part in range(2):
        for i in range(max(row - COLOUR_REACH, 0), min(row + COLOUR_REACH + 1, height)):
            for j in range(max(col - COLOUR_REACH, 0), min(col + COLOUR_REACH + 1, width)):
                s = which[i - row + middle, j - col + middle]
                if s < 0:
                    continue
                # Weight a pixel of the surface by nearness and purity.
                near = COLOUR_WEIGHT[i - row + COLOUR_REACH, j - col + COLOUR_REACH]
                weight = near * power[i, j]
                # First sum: the geometric mean of brightness.
                if part == 0:
                    sums[s, 11] += weight
                    sums[s, 12] += weight * log_light[i, j]
                    continue
                # Second sum: moments of colour, in which pixels much brighter than usual, by now the last column,
                # count little.
                excess = _brightness(radiance[i, j]) / sums[s, 12] - 1.0
                if excess > 0.0:
                    weight /= 1.0 + excess**2
                sums[s, 0] += weight
                sums[s, 1] += near
                sums[s, 2] += weight * purity[i, j]
                for c in range(4):
                    value = np.float64(radiance[i, j, c])
                    sums[s, 3 + c] += weight * value
                    sums[s, 7 + c] += weight * value * value
        if part == 0:
            for s in range(count):
                sums[s, 12] = LAMP_RATIO * math.exp(sums[s, 12] / sums[s, 11])


@helper
def _colour_models(count, sums, mean, variance):
    """Fill mean and variance (MOST, 4) of each surface's colour from sums over its pixels.

    Columns of ``sums``: weight, weight by distance alone, purity, colours, their squares; two are of the first sum.
    What is impure of the pixels shows the other surfaces; their mean is taken out.
    """
    for s in range(count):
        share = sums[s, 2] / sums[s, 0]
        for c in range(4):
            # Find the moments of the surface's pixels, and those of all others.
            own = sums[s, 3 + c] / sums[s, 0]
            spread = max(sums[s, 7 + c] / sums[s, 0] - own * own, 0.0)
            weight = other = square = 0.0
            for t in range(count):
                if t != s:
                    value = sums[t, 3 + c] / sums[t, 0]
                    weight += sums[t, 1]
                    other += sums[t, 1] * value
                    square += sums[t, 1] * sums[t, 7 + c] / sums[t, 0]
            other /= weight
            square = max(square / weight - other * other, 0.0)
            # Take out the others' share.
            mean[s, c] = max((own - (1.0 - share) * other) / share, 0.0)
            noise = LEAST_NOISE + COLOUR_NOISE * mean[s, c]
            variance[s, c] = max(spread - (1.0 - share) ** 2 * square, 0.0) / share**2 + noise**2
        mean[s, 3] = min(mean[s, 3], 1.0)


@helper
def _fit_shares(colour, mean, variance, trust, count, share):
    """Change the surfaces' shares of a pixel, from a first guess, to those that its colour makes most likely.

    Colours are Gaussian with the given mean and variance, shares with the guess and deviations ``trust``, and sum to 1.
    """
    # Set up the normal equations of the shares' changes: the guess, and what the colour lacks.
    xx = 1.0 / trust[1] ** 2
    yy, xy, x, y = 1.0 / trust[2] ** 2, 0.0, 0.0, 0.0
    for c in range(4):
        missing, noise = np.float64(colour[c]), 1e-8
        for s in range(count):
            missing -= share[s] * mean[s, c]
            noise += share[s] ** 2 * variance[s, c]
        first = mean[1, c] - mean[0, c]
        xx, x = xx + first * first / noise, x + first * missing / noise
        if count == 3:
            second = mean[2, c] - mean[0, c]
            yy, y = yy + second * second / noise, y + second * missing / noise
            xy += first * second / noise
    # Solve them.
    determinant = xx * yy - xy * xy
    more, most = (x * yy - y * xy) / determinant, (y * xx - x * xy) / determinant
    share[0] -= more + most
    share[1] += more
    share[2] += most
    # Clip the shares, leave out what cannot be seen, and normalise.
    total = 0.0
    for s in range(count):
        bright = max(mean[s, 0], mean[s, 1], mean[s, 2], 1.0)
        share[s] = min(max(share[s], 0.0), 1.0) if share[s] * bright >= NEGLIGIBLE else 0.0
        total += share[s]
    for s in range(count):
        share[s] /= total


@helper
def _divide(colour, mean, variance, share, count, colours):
    """Fill the likeliest colours (MOST, 4) of a pixel's surfaces that add up to the pixel's; none is below 0."""
    for c in range(4):
        missing, noise = np.float64(colour[c]), 1e-12
        for s in range(count):
            missing -= share[s] * mean[s, c]
            noise += share[s] ** 2 * variance[s, c]
        short = whole = 0.0
        for s in range(count):
            value = mean[s, c] + missing * share[s] * variance[s, c] / noise
            short -= share[s] * min(value, 0.0)
            whole += share[s] * max(value, 0.0)
            colours[s, c] = max(value, 0.0)
        for s in range(count):
            colours[s, c] *= max(1.0 - short / whole, 0.0) if whole > 0.0 else 1.0


@helper
def _find_sources(purity, row, col, which, count, source, trust):
    """Fill row and column of the nearest pixel of each surface, of two the purer; and how far to trust its share."""
    height, width = purity.shape
    for s in range(count):
        trust[s] = math.inf
    # Find the nearest pixels, and keep their distances for now.
    for i in range(max(row - REACH, 0), min(row + REACH + 1, height)):
        for j in range(max(col - REACH, 0), min(col + REACH + 1, width)):
            s = which[i - row + COLOUR_REACH, j - col + COLOUR_REACH]
            distance = (i - row) ** 2 + (j - col) ** 2 - 0.5 * purity[i, j]
            if s >= 0 and distance < trust[s]:
                trust[s] = distance
                source[s, 0], source[s, 1] = i, j
    for s in range(count):
        trust[s] = TRUST_NEAR if trust[s] < 2.0 else TRUST_FAR


@helper
def _is_mixed(place, row, col, gap):
    """Return whether the places around a pixel differ by the gap."""
    height, width = place.shape
    low = high = place[row, col]
    for i in range(max(row - REACH, 0), min(row + REACH + 1, height)):
        for j in range(max(col - REACH, 0), min(col + REACH + 1, width)):
            each = place[i, j]
            if each < low:
                low = each
            elif each > high and each != math.inf:
                high = each
    return high - low >= gap


@kernel
def weigh_colours(begin, end, radiance, purity, power, log_light):
    """Fill ``power`` and ``log_light`` (H, W), float32, with how much each pixel counts and how bright it is."""
    for row in range(begin, end):
        for col in range(purity.shape[1]):
            power[row, col] = np.float64(purity[row, col]) ** PURITY_POWER
            log_light[row, col] = math.log(_brightness(radiance[row, col]) + NEGLIGIBLE)


@kernel
def divide_pixels(begin, end, place, radiance, weights, known, gap, source, share, colours):
    """Explain each pixel by up to `MOST` surfaces around it, its own first.

    Parameters
    ----------
    place : ndarray of shape (H, W), float32
        Where surfaces lie in depth, as CoC radii, px; infinite where there is nothing.
    radiance : ndarray of shape (H, W, 4), float32
    weights : tuple of three ndarrays of shape (H, W), float32
        See `find_purity` and `weigh_colours`.
    known : ndarray of shape (H, W), float32
        Share of the nearer of two surfaces where the depth tells it, else -1.
    gap : float
        Difference of places that parts two surfaces.
    source : ndarray of shape (H, W, MOST, 2), int32
        Filled with row and column of a pixel that has the surface's label; those of the pixel itself where it has none.
    share : ndarray of shape (H, W, MOST), float32
        Filled with the coverages, which sum to 1.
    colours : ndarray of shape (H, W, MOST, 4), float32
        Filled with the surfaces' colours; those of the pixel where it has no such surface.

    Returns
    -------
    int
        Number of pixels with more than one surface.
    """
    window = (2 * REACH + 1) ** 2
    spare, bounds = (np.empty(window), np.empty(window), np.empty(window), np.empty(MOST)), np.empty((MOST, 2))
    which = np.empty((2 * COLOUR_REACH + 1, 2 * COLOUR_REACH + 1), np.int8)
    sums, mean, variance = np.empty((MOST, 13)), np.empty((MOST, 4)), np.empty((MOST, 4))
    each, trust = np.empty(MOST), np.ones(MOST)
    mixed = 0
    for row in range(begin, end):
        for col in range(place.shape[1]):
            # Begin with a pixel that is all its own.
            for s in range(MOST):
                source[row, col, s, 0], source[row, col, s, 1] = row, col
                share[row, col, s] = 1.0 if s == 0 else 0.0
                for c in range(4):
                    colours[row, col, s, c] = radiance[row, col, c]
            if place[row, col] == math.inf or not _is_mixed(place, row, col, gap):
                continue
            # Find the surfaces around a pixel of an edge.
            count = _surfaces_around(place, row, col, gap, spare, bounds)
            if count < 2:
                continue
            # Guess their shares by the edge, or take those that a filtered depth told.
            each[:] = 0.0
            total = 0.0
            _number_surfaces(place, row, col, bounds, count, which)
            for s in range(count):
                each[s] = _edge_share(place, row, col, bounds[s, 0], bounds[s, 1], which, s)
                total += each[s]
            each /= total
            _find_sources(weights[0], row, col, which, count, source[row, col], trust)
            if count == 2 and known[row, col] >= 0.0:
                nearer = 0 if bounds[0, 0] < bounds[1, 0] else 1
                each[nearer], each[1 - nearer] = known[row, col], 1.0 - known[row, col]
                trust[1] = TRUST_DEPTH
            # Fit the shares to the pixel's colour.
            _add_colours(radiance, weights, row, col, which, count, sums)
            _colour_models(count, sums, mean, variance)
            _fit_shares(radiance[row, col], mean, variance, trust, count, each)
            if each[0] == 1.0:
                continue
            # Divide the colour among the surfaces.
            mixed += 1
            for s in range(count):
                share[row, col, s] = each[s]
            _divide(radiance[row, col], mean, variance, each, count, colours[row, col])
            source[row, col, 0, 0], source[row, col, 0, 1] = row, col
    return mixed


@kernel
def recolour_surfaces(begin, end, radiance, place, share, colours):
    """Divide other colours of mixed pixels among surfaces that are known, their shares too.

    A surface's colour is the mean over the pixels around that show little else; what is then missing of the pixel's is
    given to its surfaces by their shares. None gets less than 0.

    Parameters
    ----------
    radiance : ndarray of shape (H, W, 4), float32
        The other colours.
    place : ndarray of shape (n, H, W), float32
        Where the pixel's surfaces lie in depth, as CoC radii, px.
    share : ndarray of shape (n, H, W), float32
        Their coverages.
    colours : ndarray of shape (n, H, W, 4), float32
        Filled; with the pixel's colours where it is not mixed.
    """
    n, height, width = share.shape
    own, mean, variance = np.empty(n), np.zeros((MOST, 4)), np.ones((MOST, 4))
    for row in range(begin, end):
        for col in range(width):
            for s in range(n):
                colours[s, row, col] = radiance[row, col]
                own[s] = share[s, row, col]
            if own[0] == 1.0:
                continue
            # Average each surface over the pixels around that it fills.
            for s in range(n):
                total = 1e-9
                for c in range(4):
                    mean[s, c] = total * radiance[row, col, c]
                for i in range(max(row - COLOUR_REACH, 0), min(row + COLOUR_REACH + 1, height)):
                    for j in range(max(col - COLOUR_REACH, 0), min(col + COLOUR_REACH + 1, width)):
                        if abs(place[0, i, j] - place[s, row, col]) >= SAME_SURFACE or own[s] == 0.0:
                            continue
                        near = 1.0 / (1.0 + 0.25 * ((i - row) ** 2 + (j - col) ** 2))
                        weight = near * np.float64(share[0, i, j]) ** PURITY_POWER
                        total += weight
                        for c in range(4):
                            mean[s, c] += weight * radiance[i, j, c]
                mean[s] /= total
            # Divide what is missing.
            _divide(radiance[row, col], mean, variance, own, n, colours[:, row, col])
