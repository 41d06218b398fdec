"""Compiled kernels of LRDM: statistics of the partitions of tiles, merging, set-up of 5D filters, reprojection.

The derivation of the set-up is in docs/lrdm.md; the numbers of its equations are given as (1), (2), ...
"""

import math

import numpy as np

from spreadlets.compiled import helper, kernel
from spreadlets.runtime.sheared._tile_kernels import MET, N_SUMS, SEEN

COUNT, COC, COC_2, MX, MY, MXX, MXY, MYY = range(8)
"""Columns of the moments of a partition: sums over its samples of 1, CoC, its square, motion and its products."""
N_MOMENTS = 8

ETA, BX, BY, LENS_RATE, TIME_RATE, SXX, SXY, SYY = range(8)
"""Columns of a filter: slopes of the reprojection, px per lens radius and px per frame; half the inverse variance of
the weights over lens and time, 0 if all weigh the same; covariance of the screen filter, px^2."""
N_FILTER = 8

LENS_VARIANCE, TIME_VARIANCE, LENS_REACH, TIME_REACH = range(4)
"""Of all samples: variance along one axis of the lens, of time (frames^2), and the largest of either."""

RANGE_FACTOR = 3.0
"""The square of half the range over the variance, of uniformly spread slopes: turns SLR's ranges into variances."""
LEAST_RATE = 0.02
"""Rates times the variance of the samples below this are taken as 0: no weight would differ by more than 4 %."""
TINY = 1e-12
MISSES, PASSES, SEES = range(3)
"""What a sample is to a layer: it ended in front of it, was seen through it, or was stopped by it."""


@kernel
def assign_partitions(coc, colour, step, n_partitions, begin, end, partition):
    """Find the partitions of samples begin to end - 1: equal steps of CoC around focus.

    Parameters
    ----------
    coc : ndarray of shape (N,), float32
    colour : ndarray of shape (N, 4), float32
    step : float
        px of CoC.
    n_partitions : int
        The last one is for samples that met nothing.
    partition : ndarray of shape (N,), uint8
        Filled.
    """
    scale, half = np.float32(1.0 / step), np.float32((n_partitions - 1) // 2)
    lowest, highest = np.float32(0.0), np.float32(n_partitions - 2)
    for i in range(begin, end):
        place = min(max(coc[i] * scale + half, lowest), highest)
        partition[i] = np.uint8(place) if colour[i, 3] != np.float32(0.0) else np.uint8(n_partitions - 1)


@helper
def add_moments(moments, p, weight, coc, motion, moving):
    """Add a sample, or one that stands for several, to the moments (P, N_MOMENTS) of a partition."""
    c = np.float64(coc)
    moments[p, COUNT] += weight
    moments[p, COC] += weight * c
    moments[p, COC_2] += weight * c * c
    if not moving:
        return
    x, y = np.float64(motion[0]), np.float64(motion[1])
    moments[p, MX] += weight * x
    moments[p, MY] += weight * y
    moments[p, MXX] += weight * x * x
    moments[p, MXY] += weight * x * y
    moments[p, MYY] += weight * y * y


@kernel
def next_random(state):
    """Return the next number of Marsaglia's 32-bit xor-shift generator."""
    state ^= np.uint32(state << np.uint32(13))
    state ^= np.uint32(state >> np.uint32(17))
    state ^= np.uint32(state << np.uint32(5))
    return state


@kernel
def below(random, limit):
    """Return a number from 0 to ``limit - 1`` for a random one of 32 bits."""
    return np.int64((np.uint64(random) * np.uint64(limit)) >> np.uint64(32))


@helper
def bits_of(partition, begin, end):
    """Return a word with a bit for each partition that some samples are in; those 64 apart share theirs."""
    found, one, last = np.uint64(0), np.uint64(1), np.uint64(63)
    for i in range(begin, end):
        found |= one << (np.uint64(partition[i]) & last)
    return found


@helper
def listed(which):
    """Return the numbers of the elements that are true, int64."""
    numbers, count = np.empty(len(which), np.int64), 0
    for number in range(len(which)):
        numbers[count] = number
        count += which[number]
    return numbers[:count]


@kernel
def full_moments(samples, box, moving, only, moments):
    """Sum the moments of a tile's partitions over all samples, or those of some partitions.

    Parameters
    ----------
    samples : tuple
        partition (N,), motion (N, 2), coc (N,), first (H * W + 1,), and the image's width.
    box : ndarray of shape (4,), int32
        Top, left, bottom, right of the tile, px.
    moving : bool
        Whether motion is summed.
    only : ndarray of shape (P,), bool
        Which partitions count; rows of pixels without any are passed over.
    moments : ndarray of shape (P, N_MOMENTS), float64
        Added to.
    """
    partition, motion, coc, first, width = samples
    top, left, bottom, right = box
    numbers = listed(only)
    wanted = bits_of(numbers, 0, numbers.size)
    for row in range(top, bottom):
        begin, end = first[row * width + left], first[row * width + right]
        if numbers.size < only.size and bits_of(partition, begin, end) & wanted == np.uint64(0):
            continue
        for i in range(begin, end):
            if only[partition[i]]:
                add_moments(moments, partition[i], 1.0, coc[i], motion[i], moving)


@kernel
def sparse_moments(samples, box, order, sparsity, seed, moving, moments):
    """Sum the moments of a tile's partitions over one sample of every so many pixels.

    Parameters
    ----------
    samples, box, moving, moments
        As for `full_moments`.
    order : ndarray of shape (T * T, 2), int16
        Rows and columns of a tile's pixels in Morton order.
    sparsity : int
        Pixels in a bucket, from which one sample is taken at random; it stands for all of them.
    seed : uint32
        Not 0.
    """
    partition, motion, coc, first, width = samples
    top, left, bottom, right = box
    state = np.uint32(seed)
    taken = np.empty((order.shape[0] // sparsity + 1, 2), np.int64)  # samples, and how many there are in the pixel
    n = 0
    for bucket in range(0, order.shape[0], sparsity):
        state = next_random(state)
        k = bucket + below(state, min(sparsity, order.shape[0] - bucket))
        row, col = top + order[k, 0], left + order[k, 1]
        if row >= bottom or col >= right:
            continue
        begin = first[row * width + col]
        here = first[row * width + col + 1] - begin
        if here > 0:
            state = next_random(state)
            taken[n, 0], taken[n, 1] = begin + below(state, here), here
            n += 1
    # What is scattered over memory is fetched side by side, as no fetch waits for a random number any more.
    for number in range(n):
        i, weight = taken[number, 0], np.float64(taken[number, 1] * sparsity)
        add_moments(moments, partition[i], weight, coc[i], motion[i], moving)


@helper
def disc_variance(variance, rate):
    """Return the variance along an axis of a uniform disc whose samples weigh ``exp(-rate * r^2)``."""
    a = 4.0 * variance * rate
    if a < 1e-6:
        return variance
    return 0.5 / rate * (1.0 - math.exp(-a) * (1.0 + a)) / -math.expm1(-a)


@helper
def box_variance(variance, rate):
    """Return the variance of a uniform interval whose samples weigh ``exp(-rate * t^2)``."""
    squared = 3.0 * variance * rate
    if squared < 1e-6:
        return variance
    z = math.sqrt(squared)
    return 0.5 / rate * (1.0 - 2.0 * z * math.exp(-squared) / (math.sqrt(math.pi) * math.erf(z)))


@helper
def weight_rate(excess, variance):
    """Return half the inverse variance of a weight whose variance exceeds the samples' by some; 0 if negligible."""
    rate = 0.5 / (excess + variance) if excess + variance > 0.0 else 0.0
    return rate if rate * variance > LEAST_RATE else 0.0


@kernel
def set_up(m, spread, pixel, largest, moving, filters):
    """Set up the filter of a partition from the mean and variance of its CoC and motion.

    Parameters
    ----------
    m : ndarray of shape (N_MOMENTS,), float64
        Moments.
    spread : ndarray of shape (4,), float64
        See `LENS_VARIANCE`.
    pixel, largest : float
        Variance of the pixel filter, and the largest of a screen filter along its longer axis, px^2.
    moving : bool
        Whether there is motion at all.
    filters : ndarray of shape (N_FILTER,), float64
        Filled.
    """
    lens, time = spread[LENS_VARIANCE], spread[TIME_VARIANCE]
    c = m[COC] / m[COUNT]
    c_var = max(m[COC_2] / m[COUNT] - c * c, 0.0)
    x, y, xx, xy, yy = 0.0, 0.0, 0.0, 0.0, 0.0
    if moving:
        x, y = m[MX] / m[COUNT], m[MY] / m[COUNT]
        xx, yy = max(m[MXX] / m[COUNT] - x * x, 0.0), max(m[MYY] / m[COUNT] - y * y, 0.0)
        xy = m[MXY] / m[COUNT] - x * y
    # The inverse of the narrow partition's screen covariance (2): what it lets pass of the spectrum.
    around = pixel + c * c * lens
    along = around + time * (x * x + y * y)
    inverse = 1.0 / (around * along)
    ixx, iyy = (around + time * y * y) * inverse, (around + time * x * x) * inverse
    ixy = -time * x * y * inverse
    # Excess variances (4) of the weights over lens and time, and the shares of the slopes (5).
    lens_excess = 1.0 / max(RANGE_FACTOR * c_var * 0.5 * (ixx + iyy), TINY)
    time_excess = 1.0 / max(RANGE_FACTOR * (ixx * xx + 2.0 * ixy * xy + iyy * yy), TINY)
    f = lens_excess / (lens_excess + lens)
    g = time_excess / (time_excess + time)
    lens_rate, time_rate = weight_rate(lens_excess, lens), weight_rate(time_excess, time)
    seen_lens, seen_time = disc_variance(lens, lens_rate), box_variance(time, time_rate)
    budget = largest - pixel
    speed = x * x + y * y
    # (6): what the reprojected samples do not spread by themselves. Beyond the clamp, samples weigh the same and the
    # slopes are taken back, so that samples spread more by themselves (7).
    lens_part = c * c * (lens - (1.0 - f) ** 2 * seen_lens) + c_var * (lens - seen_lens)
    time_part = speed * (time - (1.0 - g) ** 2 * seen_time) + (xx + yy) * (time - seen_time)
    if lens_part + time_part > budget:
        lens_rate, time_rate, seen_lens, seen_time = 0.0, 0.0, lens, time
        lens_part, time_part = c * c * lens * f * (2.0 - f), speed * time * g * (2.0 - g)
        share = min(budget / max(lens_part + time_part, TINY), 1.0)
        f = 1.0 - math.sqrt(1.0 - share * f * (2.0 - f))
        g = 1.0 - math.sqrt(1.0 - share * g * (2.0 - g))
        lens_part = c * c * lens * f * (2.0 - f)
    of_mean = time - (1.0 - g) ** 2 * seen_time
    of_spread = time - seen_time
    filters[ETA], filters[BX], filters[BY] = f * c, g * x, g * y
    filters[LENS_RATE], filters[TIME_RATE] = lens_rate, time_rate
    filters[SXX] = pixel + lens_part + of_mean * x * x + of_spread * xx
    filters[SXY] = of_mean * x * y + of_spread * xy
    filters[SYY] = pixel + lens_part + of_mean * y * y + of_spread * yy


@helper
def filter_extents(m, spread, pixel, moving, scratch):
    """Return the standard deviations of a partition's screen filter along its axes, the longer first, unclamped, px."""
    set_up(m, spread, pixel, np.inf, moving, scratch)
    mean = 0.5 * (scratch[SXX] + scratch[SYY])
    half = math.hypot(0.5 * (scratch[SXX] - scratch[SYY]), scratch[SXY])
    return math.sqrt(mean + half), math.sqrt(max(mean - half, 0.0))


@kernel
def together(nearer, farther):
    """Return the moments of two partitions that count alike, however many samples they have.

    If they counted by their samples, the few of one would be lost among the many of the other.
    """
    return 0.5 * (nearer / nearer[COUNT] + farther / farther[COUNT])


@kernel
def tile_layers(moments, spread, pixel, largest, moving, shrink, own, holes, filters):
    """Find the layers of a tile, front to back, merge them and set their filters up.

    Parameters
    ----------
    moments : ndarray of shape (P, N_MOMENTS), float64
        Overwritten by those of the layers.
    spread, pixel, largest, moving
        As for `set_up`.
    shrink : float
        Share by which the screen filter may shrink for two partitions to be merged; negative to merge none.
    own, holes : ndarray of shape (P,), int16
        Filled: the layer that holds a partition's samples, or -1; and the number of layers in front of them.
    filters : ndarray of shape (P, N_FILTER), float64
        Filled, one for each layer.

    Returns
    -------
    n_used, n_layers : int
        Partitions with samples, and layers.
    """
    scratch = np.empty(N_FILTER)
    n_used, n_layers = 0, 0
    keep, last_longer, last_shorter = 1.0 - shrink, 0.0, 0.0
    for p in range(moments.shape[0]):
        own[p], holes[p] = -1, n_layers
        if moments[p, COUNT] == 0.0:
            continue
        n_used += 1
        last = n_layers - 1
        merge = False
        if shrink >= 0.0 and p < moments.shape[0] - 1:
            # Both axes are compared: a moving and a still surface together may have a filter of the same area.
            longer, shorter = filter_extents(moments[p], spread, pixel, moving, scratch)
            if last >= 0:
                both = together(moments[last], moments[p])
                longer_both, shorter_both = filter_extents(both, spread, pixel, moving, scratch)
                merge = longer_both >= keep * max(longer, last_longer) and shorter_both >= keep * max(
                    shorter, last_shorter
                )
            last_longer, last_shorter = longer, shorter
        if merge:
            for number in range(moments.shape[1]):
                moments[last, number] += moments[p, number]
            last_longer, last_shorter = filter_extents(moments[last], spread, pixel, moving, scratch)
        else:
            for number in range(moments.shape[1]):
                moments[n_layers, number] = moments[p, number]
            n_layers += 1
        own[p] = holes[p] = n_layers - 1
    for layer in range(n_layers):
        set_up(moments[layer], spread, pixel, largest, moving, filters[layer])
    return n_used, n_layers


@kernel
def set_up_tiles(samples, boxes, order, sampling, spread, settings, begin, end, tables):
    """Find layers and filters of tiles begin to end - 1.

    Parameters
    ----------
    samples, order
        As for `sparse_moments`.
    boxes : ndarray of shape (T, 4), int32
    sampling : tuple
        Pixels of a bucket, 0 for full statistics; and seed.
    spread
        As for `set_up`.
    settings : tuple
        Variance of the pixel filter, largest variance, whether there is motion, and by how much filters may shrink.
    tables : tuple
        ``own`` and ``holes`` (T, P) int16, ``filters`` (T, P, N_FILTER) float32, ``counts`` (T, 2) int32: of used
        partitions and of layers. Filled.
    """
    pixel, largest, moving, shrink = settings
    own, holes, filters, counts = tables
    sparsity, seed = sampling
    moments = np.empty((own.shape[1], N_MOMENTS))
    for tile in range(begin, end):
        moments[:] = 0.0
        state = next_random(np.uint32(seed + tile * 2654435761 | 1))
        if sparsity > 0:
            sparse_moments(samples, boxes[tile], order, sparsity, state, moving, moments)
        # What sparse statistics have missed is rare: all of it counts, else it would be lost.
        full_moments(samples, boxes[tile], moving, moments[:, COUNT] == 0.0, moments)
        counts[tile, 0], counts[tile, 1] = tile_layers(
            moments, spread, pixel, largest, moving, shrink, own[tile], holes[tile], filters[tile]
        )


@helper
def land(place, lens, time, slopes, grid, moving, landing):
    """Find the texel of a grid that each sample of a row is reprojected to (LRDM Eq. 1).

    Parameters
    ----------
    place, lens : ndarray of shape (n, 2), float32
    time : ndarray of shape (n,), float32
    slopes : ndarray of shape (N_FILTER,), float32
    grid : tuple of int
        Top, left, bottom, right in the image, px, and side of a texel, px, a power of two that divides the grid's.
    moving : bool
        Whether there is motion at all.
    landing : ndarray of shape (n,) or more, int32
        Filled with ``row * width + col`` in the grid, or -1 outside.
    """
    top, left, bottom, right, texel = grid
    eta, bx, by = slopes[ETA], slopes[BX], slopes[BY]
    dx, dy = np.float32(0.5 - left), np.float32(0.5 - top)  # half a pixel, as centres are at whole numbers
    scale, zero, outside = np.float32(1.0 / texel), np.float32(0.0), np.float32(-1.0)
    width, height = np.float32((right - left) // texel), np.float32((bottom - top) // texel)
    # All in floats, which hold these numbers exactly, and in one dimension: else the loops would not be vectorised.
    xy, uv = place.reshape(place.size), lens.reshape(lens.size)
    if moving:
        for i in range(time.size):
            col = np.floor((xy[2 * i] - eta * uv[2 * i] - bx * time[i] + dx) * scale)
            row = np.floor((xy[2 * i + 1] - eta * uv[2 * i + 1] - by * time[i] + dy) * scale)
            within = (col >= zero) & (col < width) & (row >= zero) & (row < height)
            landing[i] = np.int32(row * width + col if within else outside)
    else:
        for i in range(time.size):
            col = np.floor((xy[2 * i] - eta * uv[2 * i] + dx) * scale)
            row = np.floor((xy[2 * i + 1] - eta * uv[2 * i + 1] + dy) * scale)
            within = (col >= zero) & (col < width) & (row >= zero) & (row < height)
            landing[i] = np.int32(row * width + col if within else outside)


@kernel
def choose(landing, partition, counts, chosen):
    """List the samples (n,) that landed in the grid and count for the layer; return how many they are.

    Without branches: chance decides, which no processor predicts.
    """
    n = 0
    for i in range(partition.size):
        chosen[n] = i
        n += np.int64((landing[i] >= 0) & (counts[partition[i]] != MISSES))
    return n


@helper
def add_alike(colour, landing, partition, counts, chosen, sums):
    """Add chosen samples of weight 1 to sums (texels, N_SUMS); those that passed the layer with a colour of 0."""
    one, zero = np.float32(1.0), np.float32(0.0)
    for number in chosen:
        i = np.uint32(number)
        target = sums[np.uint32(landing[i])]
        seen = one if counts[partition[i]] == SEES else zero
        red, green = target[0] + seen * colour[i, 0], target[1] + seen * colour[i, 1]
        blue, alpha = target[2] + seen * colour[i, 2], target[3] + seen * colour[i, 3]
        of_seen, of_met = target[SEEN] + seen, target[MET] + one
        # All reads before all writes, so that they become reads and writes of several at once.
        target[0], target[1], target[2], target[3], target[SEEN], target[MET] = (
            red, green, blue, alpha, of_seen, of_met,
        )  # fmt: skip


@helper
def add_weighted(samples, landing, partition, counts, chosen, slopes, sums):
    """Add chosen samples with their weights over lens and time; samples are colour (n, 4), lens (n, 2), time (n,)."""
    colour, lens, time = samples
    lens_rate, time_rate = slopes[LENS_RATE], slopes[TIME_RATE]
    for number in chosen:
        i = np.uint32(number)
        target = sums[np.uint32(landing[i])]
        squared = lens[i, 0] * lens[i, 0] + lens[i, 1] * lens[i, 1]
        weight = np.float32(math.exp(-(lens_rate * squared + time_rate * time[i] * time[i])))
        target[MET] += weight
        if counts[partition[i]] == SEES:
            target[SEEN] += weight
            for channel in range(4):
                target[channel] += weight * colour[i, channel]


@kernel
def reproject(samples, partition, own, holes, layer, slopes, grid, reach, moving, sums):
    """Add the samples around a tile to the sums of one of its layers, at (u, v, t) = (0, 0, 1/2) (LRDM Eq. 1).

    Parameters
    ----------
    samples : tuple
        colour (N, 4), place (N, 2), lens (N, 2), time (N,), first (H * W + 1,), and the image's shape.
    partition : ndarray of shape (N,), uint8
    own, holes : ndarray of shape (P,), int16
        Of the tile, see `tile_layers`.
    layer : int
    slopes : ndarray of shape (N_FILTER,), float32
        The layer's filter.
    grid : tuple of int
        Top, left, bottom, right of the sums in the image, px; they may leave it. And side of a texel, px, see `land`.
    reach : tuple of float
        Largest lens coordinate and largest time of a sample.
    moving : bool
        Whether there is motion at all.
    sums : ndarray of shape (h * w, N_SUMS), float32
        Of the grid's texels. Zero; filled.
    """
    colour, place, lens, time, first, shape = samples
    top, left, bottom, right, _ = grid
    weighted = slopes[LENS_RATE] > np.float32(0.0) or slopes[TIME_RATE] > np.float32(0.0)
    # Find how far samples that land in the tile may lie.
    dx = int(math.ceil(abs(slopes[ETA]) * reach[0] + abs(slopes[BX]) * reach[1] + 1.0))
    dy = int(math.ceil(abs(slopes[ETA]) * reach[0] + abs(slopes[BY]) * reach[1] + 1.0))
    counts = np.empty(own.size, np.int8)  # what a sample of each partition is to the layer
    for p in range(own.size):
        counts[p] = SEES if own[p] == layer else PASSES if layer < holes[p] else MISSES
    # Go through their rows: where each lands, which of them count, and what they add.
    left_end, right_end = max(left - dx, 0), min(right + dx, shape[1])
    landing, chosen = np.empty(0, np.int32), np.empty(0, np.int32)
    for row in range(max(top - dy, 0), min(bottom + dy, shape[0])):
        begin, end = first[row * shape[1] + left_end], first[row * shape[1] + right_end]
        if end - begin > landing.size:
            landing, chosen = np.empty(2 * (end - begin), np.int32), np.empty(2 * (end - begin), np.int32)
        those, of = colour[begin:end], partition[begin:end]
        land(place[begin:end], lens[begin:end], time[begin:end], slopes, grid, moving, landing)
        n = choose(landing, of, counts, chosen)
        if weighted:
            given = (those, lens[begin:end], time[begin:end])
            add_weighted(given, landing, of, counts, chosen[:n], slopes, sums)
        else:
            add_alike(those, landing, of, counts, chosen[:n], sums)


@kernel
def reproject_layers(samples, partition, tables, jobs, spread, moving, begin, end, sums):
    """Fill the sums of layers: jobs begin to end - 1.

    Parameters
    ----------
    samples, partition, moving
        As for `reproject`.
    tables : tuple
        ``own`` and ``holes`` (T, P) int16, and ``filters`` (L, N_FILTER) float32.
    jobs : tuple
        Of each job the layer's number among all, its tile, its number in the tile, all (J,) int64; the boxes of the
        sums (J, 4) int32, px; the side of their texels (J,) int32, px; and where the sums begin (J + 1,) int64.
    spread : ndarray of shape (4,), float64
    sums : ndarray of one dimension, float32
        The sums of all jobs, one after the other.
    """
    own, holes, filters = tables
    layers, tiles, numbers, boxes, texels, starts = jobs
    reach = (spread[LENS_REACH], spread[TIME_REACH])
    for job in range(begin, end):
        tile = tiles[job]
        top, left, bottom, right = boxes[job]
        flat = sums[starts[job] : starts[job + 1]]
        flat[:] = np.float32(0.0)
        target = flat.reshape((flat.size // N_SUMS, N_SUMS))
        grid = (top, left, bottom, right, texels[job])
        slopes = filters[layers[job]]
        reproject(samples, partition, own[tile], holes[tile], numbers[job], slopes, grid, reach, moving, target)
