"""Compiled kernels that learn, from point samples of something fine, how colours tell its share of a pixel."""

import numpy as np

from spreadlets.compiled import helper

REACH, WIDTH = 5, 2.5
"""Px around a pixel from which it is learnt, and deviation of their weights."""
LEAST_NOISE, NOISE = 0.01, 0.02
"""Deviation of the colours there: at least so much, and so much of their mean."""
UNCERTAIN = 0.1
"""Share of the samples' variance that chance explains about as well as colours do."""
BRIGHTEST = 2.0
"""Radiance above which nothing is learnt: where there is a lamp, all other colours are alike."""
LEAST_LOOSE = 2
"""Such samples that lie around a pixel: a single one may be the end of something."""
TINY = 1e-9

WEIGHT = np.exp(-0.5 * np.add.outer(*2 * [np.arange(-REACH, REACH + 1, dtype=np.float64) ** 2]) / WIDTH**2)


@helper
def is_loose(loose, row, col, reach):
    """Return whether point samples that hit a fine thing here and there lie around a pixel, within a reach, px."""
    height, width = loose.shape
    count = 0
    for i in range(max(row - reach, 0), min(row + reach + 1, height)):
        for j in range(max(col - reach, 0), min(col + reach + 1, width)):
            count += loose[i, j]
    return count >= LEAST_LOOSE


@helper
def _clipped(colour, c):
    """Return a channel of a pixel as it tells of shares."""
    return min(np.float64(colour[c]), BRIGHTEST)


@helper
def _sum_samples(point, radiance, row, col, bounds, moments, samples):
    """Sum moments of colours around a pixel, and of the point samples of each surface; return the brightest channel.

    Parameters
    ----------
    bounds : ndarray of shape (3, 2)
        The least and largest places of each surface. A pixel that shows none of them counts for nothing.
    moments : ndarray of shape (6,)
        Filled with the products rr, gg, bb, rg, rb and gb.
    samples : ndarray of shape (n + 1, 4)
        Filled for each surface, and for no surface first, with the weight and the colours of its samples.
    """
    height, width = point.shape
    moments[:] = 0.0
    samples[:] = 0.0
    brightest = 0.0
    for i in range(max(row - REACH, 0), min(row + REACH + 1, height)):
        for j in range(max(col - REACH, 0), min(col + REACH + 1, width)):
            # At an edge, branches would be guessed wrong.
            at = point[i, j]
            first = int((bounds[0, 0] <= at) & (at <= bounds[0, 1]))
            second = int((bounds[1, 0] <= at) & (at <= bounds[1, 1]))
            which = first + 2 * second + 3 * int((bounds[2, 0] <= at) & (at <= bounds[2, 1]))
            weight = WEIGHT[i - row + REACH, j - col + REACH] if which else 0.0
            r, g, b = _clipped(radiance[i, j], 0), _clipped(radiance[i, j], 1), _clipped(radiance[i, j], 2)
            brightest = max(brightest, r, g, b)
            wr, wg, wb = weight * r, weight * g, weight * b
            moments[0] += wr * r
            moments[1] += wg * g
            moments[2] += wb * b
            moments[3] += wr * g
            moments[4] += wr * b
            moments[5] += wg * b
            samples[which, 0] += weight
            samples[which, 1] += wr
            samples[which, 2] += wg
            samples[which, 3] += wb
    return brightest


@helper
def learn_from_colours(point, radiance, row, col, bounds, count, guide):
    """Learn from the point samples around a pixel how colours tell its surfaces' shares; return how well they do.

    Around a pixel, the share of a surface is about linear in the colour, as long as both sides have a colour each.
    Point samples are ones and zeros whose mean is the share: their least squares fit is an estimate of it (the guided
    filter of He et al. 2013, of samples by colours). The same line tells which colour a share of 1 would have.

    Parameters
    ----------
    guide : tuple
        The arrays of `_sum_samples`, and those that are filled: shares (n,) and colours (n, 3).

    Returns
    -------
    float
        0 if colours tell nothing of the first surface, 1 if they tell all.
    """
    moments, samples, shares, colours = guide
    brightest = _sum_samples(point, radiance, row, col, bounds, moments, samples)
    # Set up the covariance of the colours, with some noise, and invert it.
    total = mr = mg = mb = 0.0
    for s in range(1, count + 1):
        total, mr = total + samples[s, 0], mr + samples[s, 1]
        mg, mb = mg + samples[s, 2], mb + samples[s, 3]
    if total == 0.0:
        return 0.0
    mr, mg, mb = mr / total, mg / total, mb / total
    rr = moments[0] / total - mr * mr + (LEAST_NOISE + NOISE * max(mr, 0.0)) ** 2
    gg = moments[1] / total - mg * mg + (LEAST_NOISE + NOISE * max(mg, 0.0)) ** 2
    bb = moments[2] / total - mb * mb + (LEAST_NOISE + NOISE * max(mb, 0.0)) ** 2
    rg, rb, gb = moments[3] / total - mr * mg, moments[4] / total - mr * mb, moments[5] / total - mg * mb
    xx, xy, xz = gg * bb - gb * gb, rb * gb - rg * bb, rg * gb - rb * gg
    yy, yz, zz = rr * bb - rb * rb, rb * rg - rr * gb, rr * gg - rg * rg
    determinant = rr * xx + rg * xy + rb * xz
    own = radiance[row, col]
    r, g, b = _clipped(own, 0) - mr, _clipped(own, 1) - mg, _clipped(own, 2) - mb
    # Read each surface's share and colour off the line.
    certain = whole = 0.0
    for s in range(count):
        mean = samples[s + 1, 0] / total
        vr, vg = samples[s + 1, 1] / total - mean * mr, samples[s + 1, 2] / total - mean * mg
        vb = samples[s + 1, 3] / total - mean * mb
        x, y, z = xx * vr + xy * vg + xz * vb, xy * vr + yy * vg + yz * vb, xz * vr + yz * vg + zz * vb
        shares[s] = min(max(mean + (x * r + y * g + z * b) / determinant, 0.0), 1.0)
        whole += shares[s]
        explained = (x * vr + y * vg + z * vb) / determinant
        away = (1.0 - mean) / max(explained, TINY)
        colours[s, 0], colours[s, 1] = max(mr + away * vr, 0.0), max(mg + away * vg, 0.0)
        colours[s, 2] = max(mb + away * vb, 0.0)
        if s == 0 and brightest < BRIGHTEST:
            certain = explained / (explained + UNCERTAIN * max(mean * (1.0 - mean), TINY))
    for s in range(count):
        shares[s] /= whole
    return certain
