"""Compiled kernels of LRDM's screen filters: anisotropic Gaussians of sums (h, w, C), float32.

Three ways, each in two passes over the box of a layer, which is a tile and a ring around it:

- rotated: along the longer axis, then along the shorter one, with bilinear interpolation (LRDM 2014);
- sheared: a recursive filter along x, then a Gaussian along a sheared axis (LRDM 2015 section 6.2);
- ewa: a MIP pyramid, then lookups as texture hardware does them (section 6.1).

Without motion all Gaussians are round, and each way has a shorter one: no interpolation between pixels, no shear, and
four lookups that are two along x of two along y.

`ring_of` says how wide the ring must be, and how coarse the sums may be; `first_pass` and `second_pass` filter.
"""

import math

import numpy as np

from spreadlets.compiled import helper, kernel
from spreadlets.runtime.sheared._tile_kernels import N_SUMS, composite, gaussian, share_out

ROTATED, SHEARED, EWA, ROUND_ROTATED, ROUND_SHEARED, ROUND_EWA = range(6)

REACH = 24
"""Radius of the largest 1D filter, px: three standard deviations of 8 px, SLR's clamp."""
ALPHA = 2.2365
"""alpha of LRDM Eq. 3: a footprint of so many standard deviations holds 95 % of a Gaussian."""
GAIN = 1.2
"""Ours: lookups spread evenly over the footprint vary less than the Gaussian does; wider by this, they vary as much."""
TAP_OFFSET = 0.33
"""d of LRDM section 6.1: offset of the four taps from the centre, in footprints."""
MOST_PROBES = 16
"""Lookups along the longer axis, as texture hardware limits them."""
NEARLY_ISOTROPIC = 2
"""Up to so many lookups along the longer axis, four taps are taken."""
LEVELS = 6
"""Levels of the largest MIP pyramid; the last one has texels of 32 px."""
ROWS_AT_A_TIME = 16
"""Of the recursive filter."""
ROUND = 1e-3
"""Relative difference of the axes below which a Gaussian is taken as round."""


@kernel
def rotated_axes(sxx, sxy, syy):
    """Return the standard deviations along the longer and the shorter axis, and cosine and sine of the longer one."""
    mean, half = 0.5 * (sxx + syy), math.hypot(0.5 * (sxx - syy), sxy)
    longer, shorter = math.sqrt(mean + half), math.sqrt(max(mean - half, 0.0))
    if longer - shorter <= ROUND * longer:
        return longer, shorter, 1.0, 0.0
    angle = 0.5 * math.atan2(2.0 * sxy, sxx - syy)
    return longer, shorter, math.cos(angle), math.sin(angle)


@kernel
def sheared_axes(sxx, sxy, syy):
    """Return the standard deviations along x and along the sheared axis (beta, 1), and beta (LRDM Eqs. 5 to 9)."""
    return math.sqrt(max(sxx - sxy * sxy / syy, 0.0)), math.sqrt(syy), sxy / syy


@helper
def shear_margin(sigma_y, beta):
    """Return how far a filter along the sheared axis reaches along x, px."""
    return int(math.ceil(abs(beta) * radius_of(sigma_y))) + 1


@kernel
def recursion(sigma):
    """Return gamma of the recursive filter (LRDM Eq. 10)."""
    return math.exp(-math.sqrt(2.0) / sigma) if sigma > 0.0 else 0.0


@helper
def radius_of(sigma):
    """Return the radius of a 1D filter, px: that of `gaussian`."""
    return min(REACH, int(math.ceil(3.0 * sigma)))


@kernel
def footprint_of(sxx, sxy, syy):
    """Return number and spacing of the lookups, both levels' weights and the taps of a footprint (LRDM Eqs. 2 to 4).

    Returns
    -------
    longer, shorter : float
        Length of the footprint's axes, px.
    cosine, sine : float
        Direction of the longer one.
    probes : int
        Lookups along it.
    n_taps : int
        4 for footprints that are nearly round, else 1.
    level : float
        Of the lookups, between two levels of the pyramid.
    """
    sigma_u, sigma_v, cosine, sine = rotated_axes(sxx, sxy, syy)
    longer, shorter = GAIN * ALPHA * sigma_u, GAIN * ALPHA * sigma_v
    probes = min(int(math.ceil(longer / shorter - 1e-6)), MOST_PROBES)
    n_taps = 4 if probes <= NEARLY_ISOTROPIC else 1
    width = longer / probes
    if n_taps == 4:
        width *= 1.0 - TAP_OFFSET  # a tap touches the edge of the footprint
    level = min(max(math.log2(max(width, 1.0)), 0.0), LEVELS - 1.0)
    return longer, shorter, cosine, sine, probes, n_taps, level


@helper
def taps_of(longer, shorter, n_taps):
    """Return how far the taps of a footprint are from its lookups, along and across it, px."""
    if n_taps == 1:
        return 0.0, 0.0
    share = TAP_OFFSET * math.sqrt(0.5)  # on the diagonals of the footprint
    return share * longer, share * shorter


@kernel
def ring_of(way, sxx, sxy, syy):
    """Return the width of the ring that a screen filter reaches, (x, y) px, and the side of the sums' texels, px."""
    if way == ROUND_ROTATED:
        radius = radius_of(math.sqrt(sxx))
        return radius, radius, 1
    if way == ROTATED:
        sigma_u, sigma_v, cosine, sine = rotated_axes(sxx, sxy, syy)
        u, v = radius_of(sigma_u), radius_of(sigma_v)
        cosine, sine = abs(cosine), abs(sine)
        return int(math.ceil(u * cosine + v * sine)) + 3, int(math.ceil(u * sine + v * cosine)) + 3, 1
    if way == SHEARED or way == ROUND_SHEARED:
        sigma_x, sigma_y, beta = sheared_axes(sxx, sxy, syy)
        along = radius_of(sigma_y)
        return radius_of(sigma_x) + shear_margin(sigma_y, beta) + 1, along, 1
    longer, shorter, cosine, sine, probes, n_taps, level = footprint_of(sxx, sxy, syy)
    fine, coarse = 1 << int(math.floor(level)), 1 << int(math.ceil(level))
    along, across = taps_of(longer, shorter, n_taps)
    along += (0.5 - 0.5 / probes) * longer
    # A lookup reaches half a texel beyond its place. Whole texels of both levels.
    x = (along * abs(cosine) + across * abs(sine)) / coarse + 0.5
    y = (along * abs(sine) + across * abs(cosine)) / coarse + 0.5
    return coarse * int(math.ceil(x)), coarse * int(math.ceil(y)), fine


@kernel
def ring_of_layers(way, filters, column, rings):
    """Fill ``rings`` (L, 3), int32, with rings and texels of filters whose covariance is in three columns."""
    for layer in range(filters.shape[0]):
        covariance = covariance_in(filters[layer], column)
        rings[layer, 0], rings[layer, 1], rings[layer, 2] = ring_of(way, covariance[0], covariance[1], covariance[2])


@helper
def covariance_in(numbers, column):
    """Return xx, xy and yy of a filter (F,), from a column on."""
    return np.float64(numbers[column]), np.float64(numbers[column + 1]), np.float64(numbers[column + 2])


@kernel
def along_direction(source, weights, step_x, step_y, top, left, target):
    """Filter along a direction, with bilinear interpolation at every tap.

    Parameters
    ----------
    source : ndarray of shape (H, W, C), float32
    weights : ndarray of shape (2 * radius + 1,), float32
    step_x, step_y : float
        From one tap to the next, px.
    top, left : int
        Where the target begins in the source, px.
    target : ndarray of shape (h, w * C), float32
        Filled. Every tap lies in the source.
    """
    channels = source.shape[2]
    across = target.shape[1]
    radius = weights.size // 2
    one = np.float32(1.0)
    for row in range(target.shape[0]):
        out = target[row]
        out[:] = np.float32(0.0)
        for k in range(-radius, radius + 1):
            # Split the tap's place into a pixel and bilinear shares.
            x, y = k * step_x, k * step_y
            col, line = int(math.floor(x)), int(math.floor(y))
            fx, fy = np.float32(x - col), np.float32(y - line)
            weight = weights[k + radius]
            begin = (left + col) * channels
            upper = source[top + row + line].reshape(source.shape[1] * channels)
            p00 = upper[begin : begin + across]
            # On a pixel, add the shifted row.
            if fx == 0.0 and fy == 0.0:
                for i in range(across):
                    out[i] += weight * p00[i]
                continue
            # Between pixels, add four shifted rows.
            lower = source[top + row + line + 1].reshape(source.shape[1] * channels)
            p01 = upper[begin + channels : begin + channels + across]
            p10 = lower[begin : begin + across]
            p11 = lower[begin + channels : begin + channels + across]
            w00, w01 = weight * (one - fy) * (one - fx), weight * (one - fy) * fx
            w10, w11 = weight * fy * (one - fx), weight * fy * fx
            for i in range(across):
                out[i] += w00 * p00[i] + w01 * p01[i] + w10 * p10[i] + w11 * p11[i]


@helper
def along_line(source, begin, stride, weights, target):
    """Filter along an axis of the image, with symmetric weights.

    Parameters
    ----------
    source : ndarray of one dimension, float32
    begin : int
        Where the middle taps of the target are in the source.
    stride : int
        From one tap to the next.
    weights : ndarray of shape (2 * radius + 1,), float32
    target : ndarray of one dimension, float32
        Filled. Every tap lies in the source.
    """
    n, radius = target.size, weights.size // 2
    half, middle = weights[radius:], source[begin : begin + n]
    for i in range(n):
        target[i] = half[0] * middle[i]
    k = 1
    if radius % 2:
        before, after = source[begin - stride :][:n], source[begin + stride :][:n]
        for i in range(n):
            target[i] += half[1] * (before[i] + after[i])
        k = 2
    while k < radius:  # four taps at a time, so that the target is read and written less often
        here, next_to_it = begin - k * stride, begin + k * stride
        p0, p1 = source[here:][:n], source[here - stride :][:n]
        q0, q1 = source[next_to_it:][:n], source[next_to_it + stride :][:n]
        for i in range(n):
            target[i] += half[k] * (p0[i] + q0[i]) + half[k + 1] * (p1[i] + q1[i])
        k += 2


@kernel
def recursive_rows(source, gamma, begin, end, target):
    """Filter rows (h, w, N_SUMS) forth and back with ``out[i] = (1 - gamma) in[i] + gamma out[i -+ 1]`` (LRDM Eq. 10).

    Parameters
    ----------
    source : ndarray of shape (h, w, N_SUMS), float32
    gamma : float
    begin, end : int
        Columns that are wanted.
    target : ndarray of shape (h, end - begin, N_SUMS), float32
        Filled.
    """
    height, width = source.shape[:2]
    gain, keep = np.float32((1.0 - gamma) ** 2), np.float32(gamma)
    # Each step waits for the one before it: those of several rows, side by side, do so together.
    columns = np.zeros((width, ROWS_AT_A_TIME * N_SUMS), np.float32)
    for top in range(0, height, ROWS_AT_A_TIME):
        rows = min(ROWS_AT_A_TIME, height - top)
        for row in range(rows):
            for col in range(width):
                for channel in range(N_SUMS):
                    columns[col, row * N_SUMS + channel] = gain * source[top + row, col, channel]
        for col in range(1, width):
            add_scaled(columns[col - 1], keep, columns[col])
        for col in range(width - 2, begin - 1, -1):
            add_scaled(columns[col + 1], keep, columns[col])
        for row in range(rows):
            for col in range(begin, end):
                for channel in range(N_SUMS):
                    target[top + row, col - begin, channel] = columns[col, row * N_SUMS + channel]


@helper
def add_scaled(values, factor, target):
    """Add values (n,) times a factor."""
    for i in range(target.size):
        target[i] += factor * values[i]


@kernel
def along_shear(source, weights, beta, left, blurred):
    """Filter along the axis (beta, 1), with linear interpolation along x.

    Parameters
    ----------
    source : ndarray of shape (h + 2 * radius, W, C), float32
    weights : ndarray of shape (2 * radius + 1,), float32
    beta : float
    left : int
        Where the target begins in the source, px.
    blurred : ndarray of shape (h, w * C), float32
        Filled.
    """
    channels = source.shape[2]
    across = blurred.shape[1]
    radius = weights.size // 2
    for row in range(blurred.shape[0]):
        out = blurred[row]
        out[:] = np.float32(0.0)
        for k in range(-radius, radius + 1):
            # Split the tap's place on its row into a pixel and a share.
            x = beta * k
            col = int(math.floor(x))
            share = np.float32(x - col)
            line = source[row + radius + k].reshape(source.shape[1] * channels)
            begin = (left + col) * channels
            here = line[begin : begin + across]
            weight = weights[k + radius]
            # On a pixel, add the shifted row.
            if share == 0.0:
                for i in range(across):
                    out[i] += weight * here[i]
                continue
            # Between pixels, add two shifted rows.
            beside = line[begin + channels : begin + channels + across]
            near, far = weight * (np.float32(1.0) - share), weight * share
            for i in range(across):
                out[i] += near * here[i] + far * beside[i]


@kernel
def halve(source, target):
    """Fill ``target`` (h, w, C) with the means of 2 x 2 pixels of ``source`` (2 h, 2 w, C)."""
    quarter = np.float32(0.25)
    for row in range(target.shape[0]):
        for col in range(target.shape[1]):
            for c in range(target.shape[2]):
                upper = source[2 * row, 2 * col, c] + source[2 * row, 2 * col + 1, c]
                lower = source[2 * row + 1, 2 * col, c] + source[2 * row + 1, 2 * col + 1, c]
                target[row, col, c] = quarter * (upper + lower)


@helper
def spread_texels(source, texel, x, left, share, lines):
    """Interpolate rows of texels to pixels, linearly along x, and add them.

    Parameters
    ----------
    source : ndarray of shape (h, w, N_SUMS), float32
    texel : int
        Side of a texel, px.
    x : float
        Offset from a pixel to where it looks, px.
    left : int
        Where the pixels begin in the source, px.
    share : float32
        Weight.
    lines : ndarray of shape (h, cols * N_SUMS), float32
        Added to.
    """
    for col in range(lines.shape[1] // N_SUMS):
        u = (left + col + 0.5 + x) / texel - 0.5
        place = np.uint32(math.floor(u))
        far = np.float32(u - place) * share
        near = share - far
        begin = col * N_SUMS
        for row in range(lines.shape[0]):
            here, beside = source[row, place], source[row, place + np.uint32(1)]
            for channel in range(N_SUMS):
                lines[row, begin + channel] += near * here[channel] + far * beside[channel]


@helper
def spread_lines(lines, texel, y, top, blurred):
    """Interpolate lines of a texel's height to rows of pixels, linearly along y, and add them.

    Parameters
    ----------
    lines : ndarray of shape (h, cols * N_SUMS), float32
    texel, y, top
        As for `spread_texels`.
    blurred : ndarray of shape (rows, cols * N_SUMS), float32
        Added to.
    """
    for row in range(blurred.shape[0]):
        v = (top + row + 0.5 + y) / texel - 0.5
        number = int(math.floor(v))
        below = np.float32(v - number)
        above = np.float32(1.0) - below
        upper, lower, out = lines[number], lines[number + 1], blurred[row]
        for i in range(out.size):
            out[i] += above * upper[i] + below * lower[i]


@kernel
def add_lookup(source, texel, share, x, y, left, top, lines, blurred):
    """Add a bilinear lookup at every pixel of a tile.

    Parameters
    ----------
    source : ndarray of shape (h, w, N_SUMS), float32
        A level of the pyramid.
    texel : int
        Its texels' side, px.
    share : float32
        Weight.
    x, y : float
        Offset of the lookup from the pixel, px.
    left, top : int
        Where the tile begins in the sums, px.
    lines : ndarray of shape (h or more, cols * N_SUMS), float32
        Scratch.
    blurred : ndarray of shape (rows, cols * N_SUMS), float32
        Added to.
    """
    rows = blurred.shape[0]
    first = int(math.floor((top + 0.5 + y) / texel - 0.5))
    last = int(math.floor((top + rows - 0.5 + y) / texel - 0.5)) + 1
    used = lines[: last + 1 - first]
    for row in range(used.shape[0]):
        used[row] = np.float32(0.0)
    spread_texels(source[first : last + 1], texel, x, left, share, used)
    spread_lines(used, texel, y, top - first * texel, blurred)


@helper
def add_round_lookups(source, texel, share, offset, left, top, lines, blurred):
    """Add bilinear lookups at ``(-+offset, -+offset)`` px, two along x of two along y; parameters as for `add_lookup`.

    `share` is the weight of one of the four.
    """
    used = lines[: source.shape[0]]
    for row in range(used.shape[0]):
        used[row] = np.float32(0.0)
    spread_texels(source, texel, -offset, left, share, used)
    spread_texels(source, texel, offset, left, share, used)
    spread_lines(used, texel, -offset, top, blurred)
    spread_lines(used, texel, offset, top, blurred)


@helper
def look_up(way, sums, coarser, covariance, left, top, blurred):
    """Filter a tile with anisotropic lookups into two levels of a pyramid (LRDM section 6.1).

    Parameters
    ----------
    way : int
        `EWA`, or `ROUND_EWA` for a round Gaussian.
    sums : ndarray of shape (h, w, N_SUMS), float32
        The finer level: sums over its texels.
    coarser : ndarray of shape (h / 2, w / 2, N_SUMS), float32
        Means over 2 x 2 texels of it; not read if the filter needs one level only.
    covariance : tuple of float
        xx, xy and yy, px^2.
    left, top : int
        Where the tile begins in the sums, px.
    blurred : ndarray of shape (rows, cols * N_SUMS), float32
        Filled.
    """
    longer, shorter, cosine, sine, probes, n_taps, level = footprint_of(covariance[0], covariance[1], covariance[2])
    lower = int(math.floor(level))
    blurred[:] = np.float32(0.0)
    lines = np.empty((sums.shape[0], blurred.shape[1]), np.float32)
    du, dv = taps_of(longer, shorter, n_taps)
    for number in range(lower, int(math.ceil(level)) + 1):
        source = sums if number == lower else coarser
        # Of the mean over a texel, whose area the sums have still to be divided by.
        share = np.float32((1.0 - abs(level - number)) / (probes * n_taps * 4.0**lower))
        if way == ROUND_EWA:
            add_round_lookups(source, 1 << number, share, du, left, top, lines, blurred)
            continue
        for tap in range(n_taps):
            u, v = du if tap & 1 else -du, dv if tap & 2 else -dv
            for probe in range(probes):
                along = u + ((probe + 0.5) / probes - 0.5) * longer
                x, y = along * cosine - v * sine, along * sine + v * cosine
                add_lookup(source, 1 << number, share, x, y, left, top, lines, blurred)


@kernel
def first_pass(way, sums, covariance, ring, tile, between):
    """Filter the box of a layer along its first axis, or halve it to the next level of a pyramid.

    Parameters
    ----------
    way : int
        `ROTATED`, `SHEARED`, `EWA`, or one of them for round Gaussians, such as `ROUND_EWA`.
    sums : ndarray of shape (h, w, N_SUMS), float32
        Of texels, see `ring_of`.
    covariance : tuple of float
        xx, xy and yy, px^2.
    ring : tuple of int
        Ring around the tile, (x, y) px, see `ring_of`.
    tile : tuple of int
        Rows and columns of the tile.
    between : ndarray of one dimension, float32
        Filled as `second_pass` wants it; as large as the sums.
    """
    height, width = sums.shape[:2]
    across = tile[1] * N_SUMS
    if way == ROTATED:
        # Along the longer axis, for the tile and the ring of the second pass.
        sigma_u, sigma_v, cosine, sine = rotated_axes(covariance[0], covariance[1], covariance[2])
        right, down = second_ring(sigma_v, cosine, sine)
        rows, cols = tile[0] + 2 * down, tile[1] + 2 * right
        target = between[: rows * cols * N_SUMS].reshape((rows, cols * N_SUMS))
        weights = gaussian(sigma_u, REACH)
        along_direction(sums, weights, cosine, sine, ring[1] - down, ring[0] - right, target)
    elif way == ROUND_ROTATED:
        # Along the rows, by a round Gaussian's weights.
        weights = gaussian(math.sqrt(covariance[0]), REACH)
        target = between[: height * across].reshape((height, across))
        for row in range(height):
            along_line(sums[row].reshape(width * N_SUMS), ring[0] * N_SUMS, N_SUMS, weights, target[row])
    elif way == SHEARED or way == ROUND_SHEARED:
        # Along the rows, recursively, for the tile and the margin of the sheared axis.
        sigma_x, sigma_y, beta = sheared_axes(covariance[0], covariance[1], covariance[2])
        margin = shear_margin(sigma_y, beta) if way == SHEARED else 0
        cols = tile[1] + 2 * margin
        target = between[: height * cols * N_SUMS].reshape((height, cols, N_SUMS))
        begin = ring[0] - margin
        recursive_rows(sums, recursion(sigma_x), begin, begin + cols, target)
    else:
        # Elliptical weighted average: between two levels of the pyramid, make the coarser one.
        level = footprint_of(covariance[0], covariance[1], covariance[2])[6]
        if level > math.floor(level):
            halve(sums, next_level(between, sums.shape))


@kernel
def next_level(between, shape):
    """Return the part of an array of one dimension that is the next level of a pyramid, for the shape of a level."""
    height, width = shape[0] // 2, shape[1] // 2
    return between[: height * width * N_SUMS].reshape((height, width, N_SUMS))


@helper
def second_ring(sigma_v, cosine, sine):
    """Return how far the second, shorter pass of a rotated filter reaches, (x, y) px."""
    radius = radius_of(sigma_v)
    return int(math.ceil(radius * abs(sine))) + 1, int(math.ceil(radius * abs(cosine))) + 1


@kernel
def second_pass(way, sums, covariance, ring, between, blurred):
    """Filter a tile along the second axis of its layer's filter; parameters as for `first_pass`.

    Parameters
    ----------
    blurred : ndarray of shape (rows, cols * N_SUMS), float32
        The tile; filled.
    """
    rows, cols = blurred.shape[0], blurred.shape[1] // N_SUMS
    if way == ROTATED:
        # Along the shorter axis.
        _, sigma_v, cosine, sine = rotated_axes(covariance[0], covariance[1], covariance[2])
        right, down = second_ring(sigma_v, cosine, sine)
        height, width = rows + 2 * down, cols + 2 * right
        source = between[: height * width * N_SUMS].reshape((height, width, N_SUMS))
        along_direction(source, gaussian(sigma_v, REACH), -sine, cosine, down, right, blurred)
    elif way == SHEARED:
        # Along the sheared axis.
        _, sigma_y, beta = sheared_axes(covariance[0], covariance[1], covariance[2])
        margin = shear_margin(sigma_y, beta)
        height, width = sums.shape[0], cols + 2 * margin
        source = between[: height * width * N_SUMS].reshape((height, width, N_SUMS))
        along_shear(source, gaussian(sigma_y, REACH), beta, margin, blurred)
    elif way == ROUND_ROTATED or way == ROUND_SHEARED:
        # Down the columns, by a round Gaussian's weights.
        weights, stride = gaussian(math.sqrt(covariance[2]), REACH), blurred.shape[1]
        for row in range(rows):
            along_line(between, (ring[1] + row) * stride, stride, weights, blurred[row])
    else:
        # Elliptical weighted average: lookups spread over the footprint.
        look_up(way, sums, next_level(between, sums.shape), covariance, ring[0], ring[1], blurred)


@kernel
def blur_layers(way, filters, column, jobs, tile, begin, end, sums, between):
    """Do the first pass of layers: jobs begin to end - 1.

    Parameters
    ----------
    way : int
    filters : ndarray of shape (L, F), float32
        Holds xx, xy and yy of the covariances from a column on.
    column : int
    jobs : tuple
        See `runtime.sheared._lrdm_kernels.reproject_layers`.
    tile : int
        Side of a tile, px.
    sums, between : ndarray of one dimension, float32
    """
    for job in range(begin, end):
        here, covariance, ring, part = job_of(filters, column, jobs, tile, job, sums, between)
        first_pass(way, here, covariance, ring, (tile, tile), part)


@helper
def job_of(filters, column, jobs, tile, job, sums, between):
    """Return the sums of a job (h, w, N_SUMS), its covariance, ring and part between the passes."""
    layers, _, _, boxes, texels, starts = jobs
    top, left, bottom, right = boxes[job]
    shape = ((bottom - top) // texels[job], (right - left) // texels[job], N_SUMS)
    here = sums[starts[job] : starts[job + 1]].reshape(shape)
    ring = ((right - left - tile) // 2, (bottom - top - tile) // 2)
    return here, covariance_in(filters[layers[job]], column), ring, between[starts[job] : starts[job + 1]]


@kernel
def composite_tiles(way, filters, column, jobs, tile, inner, first_job, begin, end, sums, between, image):
    """Do the second pass of all layers of tiles, and put them together: tiles begin to end - 1 of a block.

    Parameters
    ----------
    way, filters, column, jobs, tile, sums, between
        As for `blur_layers`.
    inner : ndarray of shape (t, 4), int32
        Boxes of the block's tiles, px.
    first_job : ndarray of shape (t + 1,), int64
        The layers of a tile are jobs ``first_job[tile]`` to ``first_job[tile + 1] - 1``, front to back.
    image : ndarray of shape (H, W, 4), float32
        Zero in the tiles; filled there.
    """
    blurred = np.empty((tile, tile * N_SUMS), np.float32)
    for number in range(begin, end):
        tile_top, tile_left, tile_bottom, tile_right = inner[number]
        left_over = np.ones((tile_bottom - tile_top, tile_right - tile_left), np.float32)
        for job in range(first_job[number], first_job[number + 1]):
            here, covariance, ring, part = job_of(filters, column, jobs, tile, job, sums, between)
            second_pass(way, here, covariance, ring, part, blurred)
            composite(blurred, tile_top, tile_left, image, left_over)
        share_out(tile_top, tile_left, image, left_over)
