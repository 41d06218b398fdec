"""Compiled kernels that explain mixed pixels by the surfaces around them."""

import math

import numpy as np

from spreadlets.compiled import helper, kernel
from spreadlets.runtime.label._guide_kernels import is_loose, learn_from_colours

REACH = 2
"""Surfaces whose pixels lie no farther than this, px, may be seen in a pixel: filters are up to 3 px wide."""
COLOUR_REACH = 3
"""A surface's colour is taken from its pixels within this, px."""
MOST = 3
"""Surfaces of a pixel."""
PURITY_POWER = 8
"""How much the purer of a surface's pixels count: one that is a fifth of another surface counts a sixth."""
LEAST_PURITY = 0.3
"""That of a pixel whose surface lies beside its centre."""
LONGEST = 5
"""Steps, px, to either side along an edge."""
ALONG = 2.0
"""Deviation, px, along a straight edge of the mean that tells how a surface covers a pixel."""
STRAND_LONGEST, STRAND_ALONG = 8, 4.0
"""The same along a strand with gaps: it covers a pixel as much as its point samples lie close along it."""
ACROSS = 0.6
"""The same where there is no direction: at corners and dots."""
TRUST_NEAR, TRUST_FAR = 0.15, 0.1
"""Deviations of the coverage that is found by that mean: within a pixel of the surface, and farther from it."""
TRUST_DEPTH = 0.02
"""Deviation of a coverage that filtered depth tells."""
LEAST_NOISE, COLOUR_NOISE = 0.01, 0.04
"""Deviation of a surface's colour, beside that of its pixels: at least so much, and so much of itself."""
LOG_LAMP_RATIO = math.log(2.0)
"""Logarithm of how many times as bright as usual a surface's pixel may be before it is taken to show something else:
with 4 in place of 2, thin bars take the sky's light for their own."""
LAMP_FALLOFF = 4.0
"""One that is brighter than that by a quarter counts half."""
OWN_WEIGHT = 0.1
"""How much a pixel at which surfaces meet counts itself among those that tell their colours: it would explain itself
where little lies around it."""
GUIDE_TRUST = 0.05
"""Deviation of a share that colours have told."""
STRAIGHT = 0.9
"""How straight an edge is, from 0 to 1, along which point samples tell enough."""
SAME_SURFACE = 1.0
"""Difference of places, px, below which a pixel is taken to show the surface of another: that of a gap."""
MOST_TRIED = 6
"""Surfaces around a pixel that are tried for its last, those that show most first."""
EXPLAINED = 4.0
"""Square of the deviations by which a pixel's colour may differ from what its surfaces show."""
NEGLIGIBLE = 0.002
"""A coverage, and a brightness, that no display shows."""
OUTSHINING = 0.5
"""Brightness, above a pixel's own, of which the few percent that the rim of a filter shows are seen."""
TILE = 8
"""Side, px, of the tiles of pixels that are looked at only if a surface ends in them or beside: more than any reach."""

WINDOW_WEIGHT = np.exp(-0.5 * np.add.outer(np.arange(-REACH, REACH + 1) ** 2, np.arange(-REACH, REACH + 1) ** 2))
"""How much a pixel's surroundings tell of the surfaces in it, by their place around it."""
GRADIENT_WEIGHT = np.sqrt(WINDOW_WEIGHT)
"""The same for the direction of an edge."""
COLOUR_WEIGHT = 1.0 / (
    1.0 + 0.25 * np.add.outer(*2 * [np.arange(-COLOUR_REACH, COLOUR_REACH + 1, dtype=np.float64) ** 2])
)
"""The same for the colours of surfaces."""


@helper
def _brightness(colour):
    """Return the brightest channel of a colour."""
    return np.float64(max(colour[0], colour[1], colour[2]))


@kernel
def place_range(begin, end, place, low, high):
    """Fill ``low`` and ``high`` (h, w), float32, with the least and the largest place in each tile of pixels.

    What is infinitely far is left out; a tile of nothing else has an infinite ``low``.
    """
    height, width = place.shape
    for number in range(begin, end):
        low[number], high[number] = np.float32(np.inf), np.float32(-np.inf)
        for row in range(number * TILE, min((number + 1) * TILE, height)):
            for col in range(width):
                each, across = place[row, col], col // TILE
                if each != np.inf:
                    low[number, across] = min(low[number, across], each)
                    high[number, across] = max(high[number, across], each)


@kernel
def count_alone(begin, end, place, gap, step, counts):
    """Count the pixels of which no neighbour shows the same surface.

    Parameters
    ----------
    place : ndarray of shape (H, W), float32
        Where surfaces lie in depth, as CoC radii, px.
    gap : float
        Difference of places that parts two surfaces.
    step : int
        Rows and columns from one pixel that is looked at to the next.
    counts : ndarray of shape (n, 2), int64
        Filled for each such row: pixels, and those of them that are alone. What is infinitely far counts for neither.
    """
    height, width = place.shape
    for number in range(begin, end):
        counts[number] = 0
        row = number * step
        for col in range(0, width, step):
            here, nearest = place[row, col], np.float32(np.inf)
            if here == np.inf:
                continue
            for i in range(max(row - 1, 0), min(row + 2, height)):
                for j in range(max(col - 1, 0), min(col + 2, width)):
                    if i != row or j != col:
                        nearest = min(nearest, abs(place[i, j] - here))
            counts[number, 0] += 1
            counts[number, 1] += nearest >= gap


@kernel
def weigh_pixels(begin, end, place, point, gap, radiance, wanted, weights):
    """Find how pure the pixels of some tiles are, how much each counts for its surface's colour, and how bright it is.

    Parameters
    ----------
    place, point : ndarray of shape (H, W), float32
        Where surfaces lie in depth, with and without what strands were given in their gaps: there little is pure.
    gap : float
        Pixels whose places differ by less are of one surface.
    radiance : ndarray of shape (H, W, 4), float32
    wanted : ndarray of shape (h, w), bool
        The tiles.
    weights : tuple of three ndarrays of shape (H, W), float32
        Filled with purity, the share of each pixel's filter that its own surface fills, about; with its power
        `PURITY_POWER`; and with the logarithm of the brightest channel.
    """
    height, width = place.shape
    purity, power, log_light = weights
    for number in range(begin, end):
        for row in range(number * TILE, min((number + 1) * TILE, height)):
            for across in range(wanted.shape[1]):
                if not wanted[number, across]:
                    continue
                for col in range(across * TILE, min((across + 1) * TILE, width)):
                    here, total, own = place[row, col], 0.0, 0.0
                    for i in range(max(row - 1, 0), min(row + 2, height)):
                        for j in range(max(col - 1, 0), min(col + 2, width)):
                            # The weights of a filter 3 px wide, as most renderers have it: 0.8 and 0.1 along each axis.
                            weight = (0.8 if i == row else 0.1) * (0.8 if j == col else 0.1)
                            total += weight
                            own += weight if abs(point[i, j] - here) < gap else 0.0
                    share = max(own / total, LEAST_PURITY)
                    purity[row, col], power[row, col] = share, share**PURITY_POWER
                    log_light[row, col] = math.log(_brightness(radiance[row, col]) + NEGLIGIBLE)


@helper
def _find_sampled(place, point, row, col, gap):
    """Return the place nearest by of the surface that a pixel samples, if its place is a strand's; else infinity.

    In the gap of a strand the pixel's own sample is of what lies behind, and may be the only one near that is.
    """
    height, width = place.shape
    found, least = np.float32(np.inf), 1000
    if place[row, col] == point[row, col]:
        return found
    for i in range(max(row - COLOUR_REACH, 0), min(row + COLOUR_REACH + 1, height)):
        for j in range(max(col - COLOUR_REACH, 0), min(col + COLOUR_REACH + 1, width)):
            distance = (i - row) ** 2 + (j - col) ** 2
            if distance < least and abs(place[i, j] - point[row, col]) < gap:
                found, least = place[i, j], distance
    return found


@helper
def _surfaces_around(place, point, row, col, gap, last, spare, bounds):
    """Fill ``bounds`` (MOST, 2) with the least and largest places of surfaces around a pixel; return their number.

    Places in the window with no gap between them are of one surface. The first is the pixel's own, the others are
    those that have most of the window, nearer pixels counting more; the last is the one of the given rank.
    """
    height, width = place.shape
    low, high, weight = spare
    n = 0
    sampled = _find_sampled(place, point, row, col, gap)
    if sampled != np.inf:
        low[0], high[0] = min(sampled, point[row, col]), max(sampled, point[row, col])
        weight[0] = WINDOW_WEIGHT[REACH, REACH]
        n = 1
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
    # Sort them.
    for s in range(MOST):
        bounds[s, 0], bounds[s, 1] = math.inf, -math.inf
    for rank in range(min(n, last + 1)):
        most, chosen = -1.0, 0
        for k in range(n):
            score = math.inf if low[k] <= place[row, col] <= high[k] else weight[k]
            if score > most:
                most, chosen = score, k
        s = min(rank, MOST - 1)
        bounds[s, 0], bounds[s, 1] = low[chosen], high[chosen]
        low[chosen], high[chosen], weight[chosen] = math.inf, -math.inf, -2.0
    return n


@helper
def _number_surfaces(place, row, col, bounds, which):
    """Fill ``which`` (n, n), int8, with the number of the surface that each pixel around one is of, -1 for others."""
    height, width = place.shape
    half = len(which) // 2
    for i in range(len(which)):
        line = place[min(max(row + i - half, 0), height - 1)]
        for j in range(len(which)):
            each = line[min(max(col + j - half, 0), width - 1)]
            # At an edge, branches would be guessed wrong.
            first = int((bounds[0, 0] <= each) & (each <= bounds[0, 1]))
            second = int((bounds[1, 0] <= each) & (each <= bounds[1, 1]))
            third = int((bounds[2, 0] <= each) & (each <= bounds[2, 1]))
            which[i, j] = first + 2 * second + 3 * third - 1


@helper
def _share_between(place, y, x, low, high):
    """Return the share of places from ``low`` to ``high`` at a point, by bilinear interpolation."""
    height, width = place.shape
    y, x = min(max(y, 0.0), height - 1.0), min(max(x, 0.0), width - 1.0)
    above, left = int(y), int(x)
    below, right = min(above + 1, height - 1), min(left + 1, width - 1)
    down, across = y - above, x - left
    one, other = place[above, left], place[above, right]
    upper = (1.0 - across) * ((low <= one) & (one <= high)) + across * ((low <= other) & (other <= high))
    one, other = place[below, left], place[below, right]
    lower = (1.0 - across) * ((low <= one) & (one <= high)) + across * ((low <= other) & (other <= high))
    return upper + down * (lower - upper)


@helper
def _is_strand(place, point, row, col):
    """Return whether gaps of a strand were closed around a pixel."""
    height, width = place.shape
    for i in range(max(row - REACH, 0), min(row + REACH + 1, height)):
        for j in range(max(col - REACH, 0), min(col + REACH + 1, width)):
            if place[i, j] != point[i, j]:
                return True
    return False


@helper
def _edge_share(place, row, col, low, high, which, number, along, longest):
    """Return how much of a pixel a surface covers, with places from ``low`` to ``high``, by its mean along the edge.

    Point samples of a straight edge are a staircase. Its mean along the edge, interpolated linearly, is the edge as a
    filter about 2 px wide shows it. The direction is that of the least change around the pixel (structure tensor).
    The second number is by how much more there is a pixel to either side of the edge, as a mean: times a half of what
    a filter's variance is larger by, px^2, it is what a wider filter changes.
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
        return np.float64(low <= place[row, col] <= high), 0.0, 0.0
    # Turn into the direction of least change, and filter the longer, the straighter the edge is.
    size = math.sqrt((xx - yy) ** 2 + 4.0 * xy * xy)
    double_cosine = (xx - yy) / size if size > 0.0 else 1.0
    step_row = math.sqrt(0.5 * (1.0 + double_cosine))
    step_col = math.sqrt(max(0.5 * (1.0 - double_cosine), 0.0)) * (-1.0 if xy > 0.0 else 1.0)
    falloff = math.exp(-0.5 / (along * (size / (xx + yy)) ** 2 + ACROSS) ** 2)
    # Filter along it, with bilinear interpolation; each Gaussian weight follows from the one before.
    weight, ratio = 1.0, falloff
    total, share = 1.0, np.float64(low <= place[row, col] <= high)
    beside = _share_beside(place, row, col, step_row, step_col, low, high)
    for step in range(1, longest + 1):
        weight, ratio = weight * ratio, ratio * falloff * falloff
        if weight < NEGLIGIBLE:
            break
        total += 2.0 * weight
        for side in (-step, step):
            y, x = row + side * step_row, col + side * step_col
            share += weight * _share_between(place, y, x, low, high)
            beside += weight * _share_beside(place, y, x, step_row, step_col, low, high)
    return share / total, (beside - 2.0 * share) / total, size / (xx + yy)


@helper
def _share_beside(place, y, x, step_row, step_col, low, high):
    """Return the sum of the shares a pixel to either side of a point of an edge."""
    one = _share_between(place, y + step_col, x - step_row, low, high)
    return one + _share_between(place, y - step_col, x + step_row, low, high)


@helper
def _add_colours(radiance, weights, row, col, which, count, counts, sums):
    """Sum over the pixels of each surface near a pixel; see `_colour_models` for the columns. Overwrites ``counts``.

    Next to a lamp, the lamp's light in a surface's pixels may be far more than their own. So those that are many times
    brighter than the geometric mean of the surface's pixels count little.
    """
    purity, power, log_light = weights
    height, width = purity.shape
    top, left = row - COLOUR_REACH, col - COLOUR_REACH
    for s in range(count):
        for c in range(sums.shape[1]):
            sums[s, c] = 0.0
    # Weight the pixels of the surfaces by nearness and purity, and find the geometric means of brightness.
    for i in range(max(-top, 0), min(height - top, len(which))):
        for j in range(max(-left, 0), min(width - left, len(which))):
            s = which[i, j]
            if s >= 0:
                weight = COLOUR_WEIGHT[i, j] * power[top + i, left + j]
                if i == COLOUR_REACH and j == COLOUR_REACH and purity[row, col] < 1.0:
                    weight *= OWN_WEIGHT
                counts[i, j] = weight
                sums[s, 14] += weight
                sums[s, 15] += weight * log_light[top + i, left + j]
    for s in range(count):
        sums[s, 15] = LOG_LAMP_RATIO + sums[s, 15] / sums[s, 14]
    # Sum up moments of colour, in which pixels much brighter than that count little.
    for i in range(max(-top, 0), min(height - top, len(which))):
        for j in range(max(-left, 0), min(width - left, len(which))):
            s = which[i, j]
            if s < 0:
                continue
            total, weight = sums[s], counts[i, j]
            if log_light[top + i, left + j] > total[15]:
                excess = _brightness(radiance[top + i, left + j]) / math.exp(total[15]) - 1.0
                weight /= 1.0 + (LAMP_FALLOFF * max(excess, 0.0)) ** 2
            total[0] += weight
            total[1] += COLOUR_WEIGHT[i, j]
            total[2] += weight * purity[top + i, left + j]
            for c in range(4):
                value = np.float64(radiance[top + i, left + j, c])
                total[3 + c] += weight * value
                total[7 + c] += weight * value * value
            r, g = np.float64(radiance[top + i, left + j, 0]), np.float64(radiance[top + i, left + j, 1])
            b = np.float64(radiance[top + i, left + j, 2])
            total[11] += weight * r * g
            total[12] += weight * r * b
            total[13] += weight * g * b


@helper
def _colour_models(count, sums, mean, spread):
    """Fill mean (MOST, 4) and spread (MOST, 7) of each surface's colour from sums over its pixels.

    Columns of ``sums``: weight, weight by distance alone, purity, colours, their squares, and their products rg, rb and
    gb; two are of the first sum. Those of ``spread``: variances, and covariances rg, rb and gb. What is impure of the
    pixels shows the other surfaces; their mean is taken out.
    """
    for s in range(count):
        share = sums[s, 2] / sums[s, 0]
        for c in range(4):
            # Find the moments of the surface's pixels, and those of all others.
            own = sums[s, 3 + c] / sums[s, 0]
            raw = max(sums[s, 7 + c] / sums[s, 0] - own * own, 0.0)
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
            spread[s, c] = max(raw - (1.0 - share) ** 2 * square, 0.0) / share**2
            # Keep by how much the deviation has changed.
            sums[s, 7 + c] = math.sqrt(spread[s, c] / raw) if raw > 0.0 else 0.0
        mean[s, 3] = min(mean[s, 3], 1.0)
    for s in range(count):
        share = sums[s, 2] / sums[s, 0]
        # Channels vary together as much as those of the pixels do: of impure ones that tells little.
        for k in range(3):
            one, two = k // 2, 1 + (k + 1) // 2
            product = sums[s, 11 + k] / sums[s, 0] - sums[s, 3 + one] * sums[s, 3 + two] / sums[s, 0] ** 2
            spread[s, 4 + k] = share**2 * product * sums[s, 7 + one] * sums[s, 7 + two]
        for c in range(4):
            spread[s, c] += ((LEAST_NOISE + COLOUR_NOISE * mean[s, c]) / share**2) ** 2


@helper
def _set_precision(spread, share, count, least, precision):
    """Fill ``precision`` (7,) with the inverse of the covariance of a pixel's colour, as `_colour_models` orders it.

    Parameters
    ----------
    spread, share
        Of the pixel's surfaces.
    least : float
        Added to the variances.
    """
    for c in range(7):
        precision[c] = least if c < 4 else 0.0
        for s in range(count):
            precision[c] += share[s] ** 2 * spread[s, c]
    rr, gg, bb, rg, rb, gb = precision[0], precision[1], precision[2], precision[4], precision[5], precision[6]
    xx, xy, xz = gg * bb - gb * gb, rb * gb - rg * bb, rg * gb - rb * gg
    scale = 1.0 / (rr * xx + rg * xy + rb * xz)
    precision[0], precision[1], precision[2] = xx * scale, (rr * bb - rb * rb) * scale, (rr * gg - rg * rg) * scale
    precision[3] = 1.0 / precision[3]
    precision[4], precision[5], precision[6] = xy * scale, xz * scale, (rb * rg - rr * gb) * scale


@helper
def _times(matrix, vector, product):
    """Fill ``product`` (4,) with a symmetric matrix, ordered as `_colour_models` has it, times a vector of channels."""
    r, g, b = vector[0], vector[1], vector[2]
    product[0] = matrix[0] * r + matrix[4] * g + matrix[5] * b
    product[1] = matrix[4] * r + matrix[1] * g + matrix[6] * b
    product[2] = matrix[5] * r + matrix[6] * g + matrix[2] * b
    product[3] = matrix[3] * vector[3]


@helper
def _dot(one, other):
    return one[0] * other[0] + one[1] * other[1] + one[2] * other[2] + one[3] * other[3]


@helper
def _missing(colour, mean, share, count, missing):
    """Fill ``missing`` (4,) with what a pixel's surfaces lack of its colour."""
    for c in range(4):
        missing[c] = np.float64(colour[c])
        for s in range(count):
            missing[c] -= share[s] * mean[s, c]


@helper
def _fit_shares(colour, mean, spread, trust, count, share, lines):
    """Change the surfaces' shares of a pixel, from a first guess, to those that its colour makes most likely.

    Colours are Gaussian with the given mean and spread, shares with the guess and deviations ``trust``, and sum to 1.
    """
    precision, missing, first, second, weighed = lines
    # Set up the normal equations of the shares' changes: the guess, and what the colour lacks.
    _set_precision(spread, share, count, 1e-8, precision)
    _missing(colour, mean, share, count, missing)
    for c in range(4):
        first[c], second[c] = mean[1, c] - mean[0, c], mean[2, c] - mean[0, c]
    _times(precision, first, weighed)
    xx, x = 1.0 / trust[1] ** 2 + _dot(weighed, first), _dot(weighed, missing)
    yy, xy, y = 1.0 / trust[2] ** 2, 0.0, 0.0
    if count == 3:
        xy = _dot(weighed, second)
        _times(precision, second, weighed)
        yy, y = yy + _dot(weighed, second), _dot(weighed, missing)
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
def _divide(colour, mean, spread, share, count, colours, lines):
    """Fill the likeliest colours (MOST, 4) of a pixel's surfaces that add up to the pixel's; none is below 0."""
    precision, missing, change, _, weighed = lines
    _set_precision(spread, share, count, 1e-12, precision)
    _missing(colour, mean, share, count, missing)
    _times(precision, missing, weighed)
    for s in range(count):
        _times(spread[s], weighed, change)
        for c in range(4):
            colours[s, c] = mean[s, c] + share[s] * change[c]
    for c in range(4):
        short = whole = 0.0
        for s in range(count):
            value = np.float64(colours[s, c])
            short -= share[s] * min(value, 0.0)
            whole += share[s] * max(value, 0.0)
            colours[s, c] = max(value, 0.0)
        for s in range(count):
            colours[s, c] *= max(1.0 - short / whole, 0.0) if whole > 0.0 else 1.0


@helper
def _nearest(purity, row, col, which, reach, source, distances):
    """Fill row and column of the nearest pixel of each surface within a reach, of two the purer, if nearer than was."""
    height, width = purity.shape
    for i in range(max(row - reach, 0), min(row + reach + 1, height)):
        for j in range(max(col - reach, 0), min(col + reach + 1, width)):
            s = which[i - row + COLOUR_REACH, j - col + COLOUR_REACH]
            distance = (i - row) ** 2 + (j - col) ** 2 - 0.5 * purity[i, j]
            if s >= 0 and distance < distances[s]:
                distances[s] = distance
                source[s, 0], source[s, 1] = i, j


@helper
def _find_sources(purity, row, col, which, count, source, trust):
    """Fill row and column of the nearest pixel of each surface, of two the purer; and how far to trust its share."""
    for s in range(count):
        trust[s] = math.inf
    # Keep the distances there for now. What only the pixel itself samples lies farther off.
    _nearest(purity, row, col, which, REACH, source, trust)
    for s in range(count):
        if trust[s] == math.inf:
            _nearest(purity, row, col, which, COLOUR_REACH, source, trust)
    for s in range(count):
        trust[s] = TRUST_NEAR if trust[s] < 2.0 else TRUST_FAR


@helper
def _range_columns(place, row, first, ranges):
    """Fill the least and the largest places of columns, over 3 and over 5 rows, without what is infinitely far.

    Parameters
    ----------
    place : ndarray of shape (H, W), float32
    row, first : int
        The middle row and the first column; beyond the border, the nearest pixels repeat.
    ranges : ndarray of shape (4, n), float32
        Filled: low and high of 3 rows, low and high of 5.
    """
    height, width = place.shape
    for j in range(ranges.shape[1]):
        col = min(max(first + j, 0), width - 1)
        low = far_low = np.float32(np.inf)
        high = far_high = np.float32(-np.inf)
        for i in range(row - REACH, row + REACH + 1):
            each = place[min(max(i, 0), height - 1), col]
            finite = each if each != np.inf else np.float32(-np.inf)
            far_low, far_high = min(far_low, each), max(far_high, finite)
            if abs(i - row) <= 1:
                low, high = min(low, each), max(high, finite)
        ranges[0, j], ranges[1, j], ranges[2, j], ranges[3, j] = low, high, far_low, far_high


@helper
def _spread(low, high, first, count):
    """Return by how much places differ within columns of which the least and largest are known."""
    least, largest = low[first], high[first]
    for j in range(first + 1, first + count):
        least, largest = min(least, low[j]), max(largest, high[j])
    return largest - least


@helper
def _is_outshone(radiance, row, col):
    """Return whether something near outshines a pixel."""
    limit = _brightness(radiance[row, col]) + OUTSHINING
    for i in range(max(row - REACH, 0), min(row + REACH + 1, radiance.shape[0])):
        for j in range(max(col - REACH, 0), min(col + REACH + 1, radiance.shape[1])):
            if _brightness(radiance[i, j]) >= limit:
                return True
    return False


@kernel
def list_mixed(begin, end, place, radiance, gap, mixed, columns, counts):
    """List the mixed pixels: their columns, row by row.

    A surface ends right beside them; or near them, and something near outshines them. At an end places differ by the
    gap.

    Parameters
    ----------
    place : ndarray of shape (H, W), float32
    radiance : ndarray of shape (H, W, 4), float32
    gap : float
    mixed : ndarray of shape (h, w), bool
        The tiles in which there may be some; filled with those in which there are. ``begin`` and ``end`` count its
        rows.
    columns : ndarray of shape (H, W), int32
        Filled from the left.
    counts : ndarray of shape (H,), int64
        Filled.
    """
    ranges = np.empty((4, TILE + 2 * REACH), np.float32)
    listed = np.empty(mixed.shape[1], np.bool_)
    for number in range(begin, end):
        listed[:] = False
        for row in range(number * TILE, min((number + 1) * TILE, place.shape[0])):
            count = 0
            for across in range(mixed.shape[1]):
                if not mixed[number, across]:
                    continue
                first = across * TILE
                _range_columns(place, row, first - REACH, ranges)
                # List the row's pixels of the tile by the ranges around them.
                for col in range(first, min(first + TILE, place.shape[1])):
                    wide = _spread(ranges[2], ranges[3], col - first, 2 * REACH + 1)
                    if place[row, col] == np.inf or wide < gap:
                        continue
                    ends = _spread(ranges[0], ranges[1], col - first + REACH - 1, 3) >= gap
                    if ends or _is_outshone(radiance, row, col):
                        columns[row, count] = col
                        count += 1
                        listed[across] = True
            counts[row] = count
        for across in range(mixed.shape[1]):
            mixed[number, across] = listed[across]


@helper
def _work():
    """Return the arrays that `_explain` fills, see there, and those that it needs besides."""
    window, side = (2 * REACH + 1) ** 2, 2 * COLOUR_REACH + 1
    spare = np.empty(window), np.empty(window), np.empty(window)
    found = np.empty((side, side), np.int8), np.empty(MOST), np.empty(MOST), np.zeros((MOST, 4)), np.empty((MOST, 7))
    guide = np.empty(6), np.empty((MOST + 1, 4)), np.empty(MOST), np.empty((MOST, 3))
    lines = np.empty(7), np.empty(4), np.empty(4), np.empty(4), np.empty(4)
    return found, spare, np.empty((MOST, 2)), np.empty((MOST, 16)), np.empty((side, side)), guide, np.zeros(1), lines


@helper
def _explain(given, row, col, gap, last, work):
    """Find the surfaces around a pixel, guess their shares, and learn their colours; return how many there are.

    There may be more than `MOST`: ``last`` is the rank of the one that is taken as the last.

    Parameters
    ----------
    given : tuple
        See `divide_pixels`.
    work : tuple
        See `_work`. The first is filled: number of the surface that each pixel around is of, see `_number_surfaces`;
        shares (MOST,), which sum to 1, and what is to be added to them for each px^2 of half the variance that the
        filter has beyond that of a tent 2 px wide; mean and spread of the colours, see `_colour_models`. So is the last
        but one: how much of the shares colours have told (1,).
    """
    place, point, radiance, weights, loose = given
    (which, each, wider, mean, spread), spare, bounds, sums, counts, guide, told, _ = work
    n = _surfaces_around(place, point, row, col, gap, last, spare, bounds)
    if n < 2:
        return 0
    count = min(n, MOST)
    # Guess the shares.
    _number_surfaces(place, row, col, bounds, which)
    along, longest = (STRAND_ALONG, STRAND_LONGEST) if _is_strand(place, point, row, col) else (ALONG, LONGEST)
    each[0], wider[0], straight = _edge_share(point, row, col, bounds[0, 0], bounds[0, 1], which, 0, along, longest)
    # Of two, the other covers the rest.
    each[1], wider[1], each[2], wider[2] = 1.0 - each[0], -wider[0], 0.0, 0.0
    for s in range(1 if count == 3 else count, count):
        each[s], wider[s], _ = _edge_share(point, row, col, bounds[s, 0], bounds[s, 1], which, s, along, longest)
    total = each[0] + each[1] + each[2]
    if total == 0.0:
        return 0
    for s in range(count):
        each[s], wider[s] = each[s] / total, wider[s] / total
    # Where samples hit something fine here and there, colours tell more.
    told[0] = 0.0
    if straight < STRAIGHT and is_loose(loose, row, col, REACH):
        certain = learn_from_colours(point, radiance, row, col, bounds, count, guide)
        told[0] = (1.0 - straight) * certain
        for s in range(count):
            each[s] += told[0] * (guide[2][s] - each[s])
            wider[s] *= 1.0 - told[0]
    # Learn the colours.
    _add_colours(radiance, weights, row, col, which, count, counts, sums)
    _colour_models(count, sums, mean, spread)
    if told[0] > 0.0:
        for s in range(count):
            for c in range(3):
                mean[s, c] += told[0] * (guide[3][s, c] - mean[s, c])
    return n


@kernel
def measure_filter(begin, end, given, listed, gap, stride, sums):
    """Sum up what some mixed pixels tell of the filter that made them.

    With shares for a tent 2 px wide, and a change of them for a wider filter, the pixels' colours tell by least squares
    how much of that change there is.

    Parameters
    ----------
    given, listed, gap
        See `divide_pixels`.
    stride : int
        Every so many-eth of a row's listed pixels is looked at.
    sums : ndarray of shape (H, 2), float64
        Filled for each row: what the change explains of what is missing of the colours, and its own square, both over
        the variance.
    """
    radiance, work = given[2], _work()
    _, each, wider, mean, spread = work[0]
    for row in range(begin, end):
        sums[row] = 0.0
        for number in range(0, listed[1][row + 1] - listed[1][row], stride):
            col = listed[0][row, number]
            count = min(_explain(given, row, col, gap, MOST - 1, work), MOST)
            for c in range(3 if count else 0):
                missing, change, noise = np.float64(radiance[row, col, c]), 0.0, 1e-8
                for s in range(count):
                    missing -= each[s] * mean[s, c]
                    change += wider[s] * mean[s, c]
                    noise += each[s] ** 2 * spread[s, c] + (TRUST_NEAR * (mean[s, c] - mean[0, c])) ** 2
                sums[row, 0] += missing * change / noise
                sums[row, 1] += change * change / noise


@helper
def _fit_pixel(given, known, row, col, count, widening, work, sources, trust):
    """Fit the shares of the surfaces that explain a pixel; return how badly they do, as a square of deviations."""
    radiance, weights = given[2], given[3]
    (which, each, wider, mean, spread), bounds, lines = work[0], work[2], work[7]
    # Start from those for the frame's filter, or those that a filtered depth told.
    total = 0.0
    for s in range(count):
        each[s] = max(each[s] + widening * wider[s], 0.0)
        total += each[s]
    for s in range(count):
        each[s] /= total
    _find_sources(weights[0], row, col, which, count, sources, trust)
    for s in range(1, count):
        trust[s] += work[6][0] * (GUIDE_TRUST - trust[s])
    if count == 2 and known[row, col] >= 0.0:
        nearer = 0 if bounds[0, 0] < bounds[1, 0] else 1
        each[nearer], each[1 - nearer] = known[row, col], 1.0 - known[row, col]
        trust[1] = TRUST_DEPTH
    _fit_shares(radiance[row, col], mean, spread, trust, count, each, lines)
    # Compare what they show with the pixel.
    precision, missing, _, _, weighed = lines
    _set_precision(spread, each, count, 1e-8, precision)
    _missing(radiance[row, col], mean, each, count, missing)
    _times(precision, missing, weighed)
    return _dot(weighed, missing)


@kernel
def divide_pixels(begin, end, given, known, listed, gap, widening, first, found):
    """Explain mixed pixels by up to `MOST` surfaces around them, their own first.

    Parameters
    ----------
    given : tuple of place, point, radiance, weights and loose
        ``place`` (H, W), float32: where surfaces lie in depth, as CoC radii, px; infinite where there is nothing; and
        ``point`` (H, W), float32: the same before the gaps of strands were closed.
        ``radiance`` (H, W, 4), float32. ``weights``: see `weigh_pixels`. ``loose`` (H, W), bool: see
        `_gap_kernels.find_loose`, of ``point``.
    known : ndarray of shape (H, W), float32
        Share of the nearer of two surfaces where the depth tells it, else -1.
    listed : tuple of ndarrays of shapes (H, W) and (H + 1,), int32 and int64
        The pixels: columns of each row, see `list_mixed`, and number of the first of each row.
    gap : float
        Difference of places that parts two surfaces.
    widening : float
        Half of what the variance of the pixels' filter is larger by than that of a tent 2 px wide, px^2.
    first : tuple of ndarrays of shapes (H, W) and (H, W, 4), float32
        Coverage and colour of the pixel's own surface; changed where it has others.
    found : tuple of ndarrays of shapes (n, 2), (n, MOST), (n, MOST, 2), (n, MOST, 4) and (n,)
        Filled for each listed pixel: its row and column, int32; the coverages, float32, which sum to 1, or all are 0
        where it has one surface; row and column of a pixel that has each surface's label, int32; the colours, float32;
        and how much of all that colours have told, from 0 to 1, float32.

    Returns
    -------
    int
        Number of pixels with more than one surface.
    """
    place, _, radiance, weights, _ = given
    work, trust = _work(), np.ones(MOST)
    _, each, _, mean, spread = work[0]
    mixed = 0
    for row in range(begin, end):
        for number in range(listed[1][row], listed[1][row + 1]):
            col = listed[0][row, number - listed[1][row]]
            at, shares, sources, colours = found[0][number], found[1][number], found[2][number], found[3][number]
            at[0], at[1] = row, col
            for s in range(MOST):
                shares[s] = 0.0
            # Find the surfaces around the pixel, and fit their shares.
            n = _explain(given, row, col, gap, MOST - 1, work)
            if n == 0:
                continue
            count, tried, best = min(n, MOST), MOST - 1, MOST - 1
            least = _fit_pixel(given, known, row, col, count, widening, work, sources, trust)
            # If they do not explain its colour, try others than those that show most.
            for last in range(MOST, min(n, MOST_TRIED)):
                if least < EXPLAINED:
                    break
                tried = last
                if _explain(given, row, col, gap, last, work) == 0:
                    continue
                missing = _fit_pixel(given, known, row, col, count, widening, work, sources, trust)
                if missing < least:
                    least, best = missing, last
            if best != tried:
                _explain(given, row, col, gap, best, work)
                _fit_pixel(given, known, row, col, count, widening, work, sources, trust)
            found[4][number] = work[6][0]
            if each[0] == 1.0:
                continue
            # Divide the colour among the surfaces.
            mixed += 1
            _divide(radiance[row, col], mean, spread, each, count, colours, work[7])
            for s in range(count):
                shares[s] = each[s]
            first[0][row, col] = shares[0]
            for c in range(4):
                first[1][row, col, c] = colours[0, c]
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
    own, mean, spread, lines = np.empty(n), np.zeros((MOST, 4)), np.zeros((MOST, 7)), _work()[7]
    spread[:, :4] = 1.0
    for row in range(begin, end):
        for col in range(width):
            for s in range(n):
                for c in range(radiance.shape[2]):
                    colours[s, row, col, c] = radiance[row, col, c]
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
            _divide(radiance[row, col], mean, spread, own, n, colours[:, row, col], lines)
