"""Compiled kernels that make strands as wide, and as bright, as they are on average along their line.

In a pixel alone, how much of it a strand covers can hardly be told from what colour it has. Along a strand neither
changes much, while what is behind it does.
"""

import math

import numpy as np

from spreadlets.compiled import helper, kernel
from spreadlets.runtime.label._gap_kernels import ALIKE, UPRIGHT

BESIDE = 2
"""Px to either side of a strand in which it is seen: filters are up to 3 px wide."""
LONGEST, ALONG = 14, 7.0
"""Px along a strand, to either side, over which it is averaged, and deviation of the weights."""
LONGEST_SKIP = 3
"""Px to the next pixel of a strand that is followed: another may cross it."""
LEAST_FOLLOWED = 5
"""Pixels of a strand, besides the one it is followed from: what is shorter is none."""
CROOKED = 0.06
"""Variance of a strand's middles about a straight line, px^2, at which its own coverages count half."""
LEAST_SHOWN = 0.5
"""Share of a strip's coverage that its own pixels must hold to be given all of it."""
HARDLY_SEEN = 0.1
"""Px of a strand in a row across it, of which little is to be learnt about where it lies there."""
MOST_COVERED = 0.98
"""Share of a pixel that a strand may be given: others keep some, to hold what the strand's colour does not explain."""


@helper
def _surface_at(found, number, place, here, most):
    """Return which of a mixed pixel's surfaces lies at a place, -1 if none does."""
    _, shares, sources, _, _ = found
    for s in range(shares.shape[1]):
        seen = s == 0 or shares[number, s] > 0.0
        if seen and abs(place[sources[number, s, 0], sources[number, s, 1]] - here) < most:
            return s
    return -1


@helper
def _across(thin, row, col, step):
    """Return the pixel some steps across a strand."""
    return (row, col + step) if thin[row, col] == UPRIGHT else (row + step, col)


@helper
def _is_nearest(place, thin, strand, row, col, step, most):
    """Return whether no other strand of the same surface lies nearer to the pixel some steps across a strand."""
    height, width = place.shape
    side = 1 if step > 0 else -1
    # Half-way between two strands, a pixel is that of the first.
    for away in range(1, 2 * abs(step) + (side < 0)):
        i, j = _across(thin, row, col, side * away)
        if not (0 <= i < height and 0 <= j < width):
            return True
        is_strand = strand[i, j] >= 0 and thin[i, j] == thin[row, col]
        if is_strand and abs(place[i, j] - place[row, col]) < most:
            return False
    return True


@helper
def _seen_across(place, thin, strand, mixed, found, row, col, step, most):
    """Return the pixel some steps across a strand, and which of its surfaces is the strand; -1 if none is."""
    height, width = place.shape
    i, j = _across(thin, row, col, step)
    if not (0 <= i < height and 0 <= j < width) or mixed[i, j] < 0:
        return i, j, -1
    if not _is_nearest(place, thin, strand, row, col, step, most):
        return i, j, -1
    return i, j, _surface_at(found, mixed[i, j], place, place[row, col], most)


@kernel
def measure_strands(begin, end, place, thin, strand, mixed, found, gap, measured):
    """Sum what strands cover, and their light, across them.

    Parameters
    ----------
    place : ndarray of shape (H, W), float32
        Where surfaces lie in depth, as CoC radii, px.
    thin : ndarray of shape (H, W), int8
        See `find_thin`.
    strand, mixed : ndarray of shape (H, W), int32
        Number of each pixel among those of strands, and among the mixed ones; -1 where it is none. A pixel counts for
        the strand that is nearest to it.
    found : tuple
        See `divide_pixels`.
    gap : float
        Difference of places that parts two surfaces.
    measured : ndarray of shape (n, 7), float32
        Filled for each pixel of a strand: coverage, px, and light; and the mean of the steps across to it, and of their
        squares.
    """
    _, shares, _, colours, _ = found
    for row in range(begin, end):
        for col in range(place.shape[1]):
            if strand[row, col] < 0:
                continue
            sums = measured[strand[row, col]]
            for c in range(7):
                sums[c] = 0.0
            # Look at the pixels across it that show its surface.
            for step in range(-BESIDE, BESIDE + 1):
                i, j, s = _seen_across(place, thin, strand, mixed, found, row, col, step, ALIKE * gap)
                if s >= 0:
                    number = mixed[i, j]
                    sums[0] += shares[number, s]
                    for c in range(4):
                        sums[1 + c] += shares[number, s] * colours[number, s, c]
                    sums[5] += step * shares[number, s]
                    sums[6] += step * step * shares[number, s]
            if sums[0] > 0.0:
                sums[5] /= sums[0]
                sums[6] /= sums[0]


@helper
def _next_pixel(place, thin, strand, row, col, side, here, most):
    """Return the next pixel of a strand on one side along it, and how far that is, px; 0 where it ends."""
    height, width = place.shape
    for reach in range(1, LONGEST_SKIP + 1):
        for turn in range(2 * reach + 1):
            # Straight on first, then ever more to the left and to the right.
            shift = (turn + 1) // 2 * (1 if turn % 2 else -1)
            upright = thin[row, col] == UPRIGHT
            i, j = (row + side * reach, col + shift) if upright else (row + shift, col + side * reach)
            if not (0 <= i < height and 0 <= j < width) or strand[i, j] < 0 or thin[i, j] != thin[row, col]:
                continue
            if abs(place[i, j] - here) < most:
                return i, j, reach
    return row, col, 0


@helper
def _average_along(place, thin, strand, row, col, gap, measured, mean):
    """Average along a strand what was measured across it, to both sides of a pixel; return whether that is enough.

    ``mean`` (8,) is filled with coverage and light; with the steps across to the strand's middle, and how many it moves
    across for each along: a straight line through the middles around, those of more coverage counting more; and with
    their variance about it.
    """
    number = strand[row, col]
    weights, followed = 1.0, 0
    for c in range(5):
        mean[c] = measured[number, c]
    # Sums for the line through the middles: weights, places across and along, their squares and their product.
    seen, across, along = mean[0], mean[0] * measured[number, 5], 0.0
    across_square, along_square, product = across * measured[number, 5], 0.0, 0.0
    # Follow the strand from pixel to pixel.
    for side in (-1, 1):
        i, j, away = row, col, 0
        while away < LONGEST:
            i, j, reach = _next_pixel(place, thin, strand, i, j, side, place[row, col], ALIKE * gap)
            if reach == 0:
                break
            away += reach
            followed += 1
            weight = math.exp(-0.5 * (away / ALONG) ** 2)
            weights += weight
            each = measured[strand[i, j]]
            for c in range(5):
                mean[c] += weight * each[c]
            # Where its middle lies.
            aside = (j - col if thin[row, col] == UPRIGHT else i - row) + each[5]
            weight *= each[0]
            seen += weight
            across += weight * aside
            along += weight * side * away
            across_square += weight * aside * aside
            along_square += weight * away * away
            product += weight * aside * side * away
    for c in range(5):
        mean[c] /= weights
    if seen > 0.0:
        spread = along_square - along * along / seen
        mean[6] = (product - across * along / seen) / spread if spread > 0.0 else 0.0
        mean[5] = (across - mean[6] * along) / seen
        mean[7] = max(across_square - mean[5] * across - mean[6] * product, 0.0) / seen
    return followed >= LEAST_FOLLOWED and seen > 0.0


@helper
def _covered(middle, width, deviation):
    """Return what a strip covers of a pixel, through a Gaussian filter, its middle so many px from the pixel's."""
    scale = math.sqrt(0.5) / deviation
    return 0.5 * (math.erf(scale * (middle + 0.5 * width)) - math.erf(scale * (middle - 0.5 * width)))


@kernel
def average_strands(begin, end, place, thin, strand, gap, measured, line, softness):
    """Average strands along their lines, and see how soft their edges are.

    Parameters
    ----------
    place, thin, strand, gap, measured
        See `measure_strands`.
    line : ndarray of shape (n, 8), float32
        Filled for each pixel of a strand, see `_average_along`; the coverage is 0 where the strand is too short.
    softness : ndarray of shape (H, 2), float64
        Filled for each row: sum of the variances, px^2, that the edges have across strands, and their weights.
    """
    for row in range(begin, end):
        softness[row] = 0.0
        for col in range(place.shape[1]):
            number = strand[row, col]
            if number < 0:
                continue
            mean = line[number]
            if not _average_along(place, thin, strand, row, col, gap, measured, mean):
                mean[0] = 0.0
            own, width = measured[number], np.float64(mean[0])
            if width <= 0.0 or own[0] <= 0.0:
                continue
            # The variance across, without that of a strip; a slanted strand's edges are softer across a row.
            varied = own[6] - own[5] * own[5] - width * width / 12.0
            weight = own[0] / (1.0 + mean[7] / CROOKED)
            softness[row, 0] += weight * varied / (1.0 + mean[6] * mean[6])
            softness[row, 1] += weight


@kernel
def spread_strands(begin, end, place, thin, strand, mixed, found, gap, measured, line, variance, wanted):
    """Find how much of each pixel across a strand it would cover, and with how much light, were it as on average.

    It is a strip, as wide as on average, along a straight line through the middles around: so it is as even as a
    renderer draws it.

    Parameters
    ----------
    place, thin, strand, mixed, found, gap, measured
        See `measure_strands`.
    line
        See `average_strands`.
    variance : float
        Of the strip's edges, px^2.
    wanted : ndarray of shape (n, 2 * BESIDE + 1, 5), float32
        Filled for each pixel of a strand, and the pixels across it: coverage, -1 where it stays as it is, and light.
    """
    _, shares, _, colours, told = found
    for row in range(begin, end):
        for col in range(place.shape[1]):
            number = strand[row, col]
            if number < 0:
                continue
            wanted[number, :, 0] = -1.0
            mean = line[number]
            if mean[0] <= 0.0:
                continue
            deviation = math.sqrt(variance * (1.0 + mean[6] * mean[6]))
            straight = 1.0 / (1.0 + mean[7] / CROOKED)
            whole = measured[number, 0] + HARDLY_SEEN
            # What a strip covers of the pixels across it that are its own: all together as much as on average.
            strip = 0.0
            for step in range(-BESIDE, BESIDE + 1):
                _, _, s = _seen_across(place, thin, strand, mixed, found, row, col, step, ALIKE * gap)
                if s >= 0:
                    wanted[number, step + BESIDE, 0] = _covered(mean[5] - step, mean[0], deviation)
                    strip += wanted[number, step + BESIDE, 0]
            scale = mean[0] / strip if strip > LEAST_SHOWN * mean[0] else 1.0
            for step in range(-BESIDE, BESIDE + 1):
                i, j, s = _seen_across(place, thin, strand, mixed, found, row, col, step, ALIKE * gap)
                if s < 0:
                    continue
                # The less straight it is, the more coverage stays as it was; what is hardly seen is its own pixel's.
                each, own = wanted[number, step + BESIDE], np.float64(shares[mixed[i, j], s])
                spread = mean[0] * (own + (HARDLY_SEEN if step == 0 else 0.0)) / whole
                share = min(spread + straight * (scale * each[0] - spread), MOST_COVERED)
                each[0] = share
                for c in range(4):
                    each[1 + c] = mean[1 + c] * share / mean[0]
                # What colours have told of the pixel stays.
                kept = told[mixed[i, j]]
                each[0] += kept * (own - share)
                for c in range(4):
                    each[1 + c] += kept * (own * colours[mixed[i, j], s, c] - each[1 + c])


@helper
def _give(radiance, shares, colours, own, share, light):
    """Give one surface of a pixel a share and its light, as far as the pixel has it, and the others what is left.

    Surfaces without a share have no colours.
    """
    before = shares[own]
    if before >= 1.0:
        return
    scale = (1.0 - share) / (1.0 - before)
    for c in range(4):
        given, others = min(light[c], radiance[c]), 0.0
        for s in range(len(shares)):
            others += shares[s] * colours[s, c] if s != own and shares[s] > 0.0 else 0.0
        colours[own, c] = given / share if share > 0.0 else 0.0
        # By the light that each of the others has; where none has any, alike.
        brighter = (radiance[c] - given) / (others * scale) if others > 0.0 else 0.0
        for s in range(len(shares)):
            if s != own and shares[s] > 0.0:
                colours[s, c] = colours[s, c] * brighter if others > 0.0 else (radiance[c] - given) / (1.0 - share)
    for s in range(len(shares)):
        shares[s] = share if s == own else shares[s] * scale


@kernel
def even_strands(begin, end, place, radiance, thin, strand, mixed, gap, wanted, first, found):
    """Give strands as much coverage and light across them as they have on average. All rows are done in one call.

    Parameters
    ----------
    place, thin, strand, mixed, gap
        See `measure_strands`.
    radiance : ndarray of shape (H, W, 4), float32
        The pixels' colours, which those of their surfaces go on adding up to.
    wanted : ndarray of shape (n, 2 * BESIDE + 1, 5), float32
        See `average_strands`.
    first, found : tuple
        See `divide_pixels`; changed.
    """
    _, shares, _, colours, _ = found
    for row in range(begin, end):
        for col in range(place.shape[1]):
            if strand[row, col] < 0:
                continue
            # Give the pixels across it what they want, one after the other: some lie beside several strands.
            for step in range(-BESIDE, BESIDE + 1):
                each = wanted[strand[row, col], step + BESIDE]
                if each[0] < 0.0:
                    continue
                i, j = _across(thin, row, col, step)
                number = mixed[i, j]
                s = _surface_at(found, number, place, place[row, col], ALIKE * gap)
                if s < 0:
                    continue
                _give(radiance[i, j], shares[number], colours[number], s, each[0], each[1:])
                first[0][i, j] = shares[number, 0]
                for c in range(4):
                    first[1][i, j, c] = colours[number, 0, c]
