"""Compiled kernels of LRDM's screen filters: anisotropic Gaussians of sums (h, w, C), float32.

Three ways, each in two passes over the box of a layer, which is a tile and a ring around it:

- rotated: along the longer axis, then along the shorter one, with bilinear interpolation (LRDM 2014);
- sheared: a recursive filter along x, then a Gaussian along a sheared axis (LRDM 2015 section 6.2);
- ewa: a MIP pyramid, then lookups as texture hardware does them (section 6.1).

`ring_of` says how wide the ring must be, `first_pass` and `second_pass` filter.
"""

import math

import numba
import numpy as np

from runtime.sheared._tile_kernels import N_SUMS, composite, gaussian, share_out

ROTATED, SHEARED, EWA = range(3)

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
ROUND = 1e-3
"""Relative difference of the axes below which a Gaussian is taken as round."""

Kernel = numba.njit(cache=True, fastmath=False, nogil=True)


@Kernel
def rotated_axes(sxx, sxy, syy):
    """Return the standard deviations along the longer and the shorter axis, and cosine and sine of the longer one."""
    mean, half = 0.5 * (sxx + syy), math.hypot(0.5 * (sxx - syy), sxy)
    longer, shorter = math.sqrt(mean + half), math.sqrt(max(mean - half, 0.0))
    if longer - shorter <= ROUND * longer:
        return longer, shorter, 1.0, 0.0
    angle = 0.5 * math.atan2(2.0 * sxy, sxx - syy)
    return longer, shorter, math.cos(angle), math.sin(angle)


@Kernel
def sheared_axes(sxx, sxy, syy):
    """Return the standard deviations along x and along the sheared axis (beta, 1), and beta (LRDM Eqs. 5 to 9)."""
    return math.sqrt(max(sxx - sxy * sxy / syy, 0.0)), math.sqrt(syy), sxy / syy


@Kernel
def recursion(sigma):
    """Return gamma of the recursive filter (LRDM Eq. 10)."""
    return math.exp(-math.sqrt(2.0) / sigma) if sigma > 0.0 else 0.0


@Kernel
def radius_of(sigma):
    """Return the radius of a 1D filter, px: that of `gaussian`."""
    return min(REACH, int(math.ceil(3.0 * sigma)))


@Kernel
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


@Kernel
def ring_of(way, sxx, sxy, syy):
    """Return the width of the ring that a screen filter reaches, (x, y) px."""
    if way == ROTATED:
        sigma_u, sigma_v, cosine, sine = rotated_axes(sxx, sxy, syy)
        u, v = radius_of(sigma_u), radius_of(sigma_v)
        cosine, sine = abs(cosine), abs(sine)
        return int(math.ceil(u * cosine + v * sine)) + 3, int(math.ceil(u * sine + v * cosine)) + 3
    if way == SHEARED:
        sigma_x, sigma_y, beta = sheared_axes(sxx, sxy, syy)
        along = radius_of(sigma_y)
        return radius_of(sigma_x) + int(math.ceil(abs(beta) * along)) + 2, along
    longer, shorter, cosine, sine, _, n_taps, level = footprint_of(sxx, sxy, syy)
    texel = 1 << int(math.ceil(level))
    share = 0.5 + (TAP_OFFSET if n_taps == 4 else 0.0)
    x = share * (longer * abs(cosine) + shorter * abs(sine)) + 0.5 * texel
    y = share * (longer * abs(sine) + shorter * abs(cosine)) + 0.5 * texel
    # Whole texels of every level; a lookup reaches half a texel beyond the centres of the outermost.
    return texel * int(math.ceil(x / texel)), texel * int(math.ceil(y / texel))


@Kernel
def ring_of_layers(way, filters, columns, rings):
    """Fill ``rings`` (L, 2), int32, with the rings of filters whose covariance is in three columns."""
    for layer in range(filters.shape[0]):
        sxx, sxy, syy = filters[layer, columns], filters[layer, columns + 1], filters[layer, columns + 2]
        rings[layer, 0], rings[layer, 1] = ring_of(way, sxx, sxy, syy)


@Kernel
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
            x, y = k * step_x, k * step_y
            col, line = int(math.floor(x)), int(math.floor(y))
            fx, fy = np.float32(x - col), np.float32(y - line)
            weight = weights[k + radius]
            begin = (left + col) * channels
            upper = source[top + row + line].reshape(source.shape[1] * channels)
            p00 = upper[begin : begin + across]
            if fx == 0.0 and fy == 0.0:
                for i in range(across):
                    out[i] += weight * p00[i]
                continue
            lower = source[top + row + line + 1].reshape(source.shape[1] * channels)
            p01 = upper[begin + channels : begin + channels + across]
            p10 = lower[begin : begin + across]
            p11 = lower[begin + channels : begin + channels + across]
            w00, w01 = weight * (one - fy) * (one - fx), weight * (one - fy) * fx
            w10, w11 = weight * fy * (one - fx), weight * fy * fx
            for i in range(across):
                out[i] += w00 * p00[i] + w01 * p01[i] + w10 * p10[i] + w11 * p11[i]


@Kernel
def recursive_rows(source, gamma, target):
    """Filter rows (h, w, C) forth and back with ``out[i] = (1 - gamma) in[i] + gamma out[i -+ 1]`` (LRDM Eq. 10)."""
    height, width, channels = source.shape
    gain, keep = np.float32(1.0 - gamma), np.float32(gamma)
    state = np.empty(channels, np.float32)
    for row in range(height):
        state[:] = np.float32(0.0)
        for col in range(width):
            for channel in range(channels):
                state[channel] = gain * source[row, col, channel] + keep * state[channel]
                target[row, col, channel] = state[channel]
        state[:] = np.float32(0.0)
        for col in range(width - 1, -1, -1):
            for channel in range(channels):
                state[channel] = gain * target[row, col, channel] + keep * state[channel]
                target[row, col, channel] = state[channel]


@Kernel
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
            x = beta * k
            col = int(math.floor(x))
            share = np.float32(x - col)
            line = source[row + radius + k].reshape(source.shape[1] * channels)
            begin = (left + col) * channels
            here = line[begin : begin + across]
            weight = weights[k + radius]
            if share == 0.0:
                for i in range(across):
                    out[i] += weight * here[i]
                continue
            beside = line[begin + channels : begin + channels + across]
            near, far = weight * (np.float32(1.0) - share), weight * share
            for i in range(across):
                out[i] += near * here[i] + far * beside[i]


@Kernel
def halve(source, target):
    """Fill ``target`` (h, w, C) with the means of 2 x 2 pixels of ``source`` (2 h, 2 w, C)."""
    quarter = np.float32(0.25)
    for row in range(target.shape[0]):
        for col in range(target.shape[1]):
            for c in range(target.shape[2]):
                upper = source[2 * row, 2 * col, c] + source[2 * row, 2 * col + 1, c]
                lower = source[2 * row + 1, 2 * col, c] + source[2 * row + 1, 2 * col + 1, c]
                target[row, col, c] = quarter * (upper + lower)


@Kernel
def build_pyramid(sums, level, pyramid):
    """Fill ``pyramid`` (one dimension) with levels 1 to ``level`` of sums (h, w, C), one after the other."""
    height, width, channels = sums.shape
    begin = 0
    last = sums
    for _ in range(level):
        height, width = height // 2, width // 2
        end = begin + height * width * channels
        now = pyramid[begin:end].reshape((height, width, channels))
        halve(last, now)
        last = now
        begin = end


@Kernel
def add_lookup(source, texel, share, x, y, left, top, blurred):
    """Add a bilinear lookup at every pixel of a tile.

    Parameters
    ----------
    source : ndarray of shape (h, w, C), float32
        A level of the pyramid.
    texel : int
        Its texels' side, px.
    share : float
        Weight.
    x, y : float
        Offset of the lookup from the pixel, px.
    left, top : int
        Where the tile begins in the sums, px.
    blurred : ndarray of shape (rows, cols * C), float32
        Added to.
    """
    channels = source.shape[2]
    one = np.float32(1.0)
    cols = blurred.shape[1] // channels
    place, beyond = np.empty(cols, np.int32), np.empty(cols, np.float32)
    for col in range(cols):
        u = (left + col + 0.5 + x) / texel - 0.5
        place[col] = int(math.floor(u))
        beyond[col] = u - place[col]
    begin, end = place[0], place[cols - 1] + 2
    line = np.empty((end - begin) * channels, np.float32)
    for row in range(blurred.shape[0]):
        v = (top + row + 0.5 + y) / texel - 0.5
        number = int(math.floor(v))
        below = np.float32(share * (v - number))
        above = np.float32(share - below)
        upper = source[number, begin:end].reshape(line.size)
        lower = source[number + 1, begin:end].reshape(line.size)
        for i in range(line.size):
            line[i] = above * upper[i] + below * lower[i]
        out = blurred[row]
        for col in range(cols):
            far = beyond[col]
            near = one - far
            here = (place[col] - begin) * channels
            for c in range(channels):
                out[col * channels + c] += near * line[here + c] + far * line[here + channels + c]


@Kernel
def look_up(sums, pyramid, covariance, left, top, blurred):
    """Filter a tile with anisotropic lookups into the pyramid of its sums (LRDM section 6.1).

    Parameters
    ----------
    sums : ndarray of shape (h, w, C), float32
    pyramid : ndarray of one dimension, float32
        See `build_pyramid`.
    covariance : tuple of float
        xx, xy and yy, px^2.
    left, top : int
        Where the tile begins in the sums, px.
    blurred : ndarray of shape (rows, cols * C), float32
        Filled.
    """
    longer, shorter, cosine, sine, probes, n_taps, level = footprint_of(covariance[0], covariance[1], covariance[2])
    lower = int(math.floor(level))
    channels = sums.shape[2]
    for row in range(blurred.shape[0]):
        blurred[row] = np.float32(0.0)
    begin = 0
    for number in range(int(math.ceil(level)) + 1):
        height, width = sums.shape[0] >> number, sums.shape[1] >> number
        source = sums
        if number > 0:
            end = begin + height * width * channels
            source = pyramid[begin:end].reshape((height, width, channels))
            begin = end
        share = 1.0 - abs(level - number)
        if number < lower or share <= 0.0:
            continue
        weight = np.float32(share / (probes * n_taps))
        for tap in range(n_taps):
            u, v = 0.0, 0.0
            if n_taps == 4:  # on the diagonals of the footprint, at d from its centre
                u = TAP_OFFSET * longer * (math.sqrt(0.5) if tap & 1 else -math.sqrt(0.5))
                v = TAP_OFFSET * shorter * (math.sqrt(0.5) if tap & 2 else -math.sqrt(0.5))
            for probe in range(probes):
                along = u + ((probe + 0.5) / probes - 0.5) * longer
                x, y = along * cosine - v * sine, along * sine + v * cosine
                add_lookup(source, 1 << number, weight, x, y, left, top, blurred)


@Kernel
def first_pass(way, sums, covariance, ring, tile, between):
    """Filter the box of a layer along its first axis, or build its pyramid.

    Parameters
    ----------
    way : int
        `ROTATED`, `SHEARED` or `EWA`.
    sums : ndarray of shape (h, w, C), float32
    covariance : tuple of float
        xx, xy and yy, px^2.
    ring : tuple of int
        Ring around the tile, (x, y) px, see `ring_of`.
    tile : tuple of int
        Rows and columns of the tile.
    between : ndarray of one dimension, float32
        Filled as `second_pass` wants it; as large as the sums.
    """
    channels = sums.shape[2]
    if way == ROTATED:
        sigma_u, sigma_v, cosine, sine = rotated_axes(covariance[0], covariance[1], covariance[2])
        right, down = second_ring(sigma_v, cosine, sine)
        rows, cols = tile[0] + 2 * down, tile[1] + 2 * right
        target = between[: rows * cols * channels].reshape((rows, cols * channels))
        weights = gaussian(sigma_u, REACH)
        along_direction(sums, weights, cosine, sine, ring[1] - down, ring[0] - right, target)
    elif way == SHEARED:
        sigma_x, _, _ = sheared_axes(covariance[0], covariance[1], covariance[2])
        recursive_rows(sums, recursion(sigma_x), between.reshape(sums.shape))
    else:
        level = footprint_of(covariance[0], covariance[1], covariance[2])[6]
        build_pyramid(sums, int(math.ceil(level)), between)


@Kernel
def second_ring(sigma_v, cosine, sine):
    """Return how far the second, shorter pass of a rotated filter reaches, (x, y) px."""
    radius = radius_of(sigma_v)
    return int(math.ceil(radius * abs(sine))) + 1, int(math.ceil(radius * abs(cosine))) + 1


@Kernel
def second_pass(way, sums, covariance, ring, between, blurred):
    """Filter a tile along the second axis of its layer's filter; parameters as for `first_pass`.

    Parameters
    ----------
    blurred : ndarray of shape (rows, cols * C), float32
        The tile; filled.
    """
    channels = sums.shape[2]
    rows, cols = blurred.shape[0], blurred.shape[1] // channels
    if way == ROTATED:
        _, sigma_v, cosine, sine = rotated_axes(covariance[0], covariance[1], covariance[2])
        right, down = second_ring(sigma_v, cosine, sine)
        height, width = rows + 2 * down, cols + 2 * right
        source = between[: height * width * channels].reshape((height, width, channels))
        along_direction(source, gaussian(sigma_v, REACH), -sine, cosine, down, right, blurred)
    elif way == SHEARED:
        _, sigma_y, beta = sheared_axes(covariance[0], covariance[1], covariance[2])
        along_shear(between.reshape(sums.shape), gaussian(sigma_y, REACH), beta, ring[0], blurred)
    else:
        look_up(sums, between, covariance, ring[0], ring[1], blurred)


@Kernel
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
    layers, _, _, boxes, starts = jobs
    for job in range(begin, end):
        top, left, bottom, right = boxes[job]
        shape = (bottom - top, right - left, N_SUMS)
        here = sums[starts[job] : starts[job + 1]].reshape(shape)
        f = filters[layers[job]]
        covariance = (np.float64(f[column]), np.float64(f[column + 1]), np.float64(f[column + 2]))
        ring = ((shape[1] - tile) // 2, (shape[0] - tile) // 2)
        first_pass(way, here, covariance, ring, (tile, tile), between[starts[job] : starts[job + 1]])


@Kernel
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
    layers, _, _, boxes, starts = jobs
    blurred = np.empty((tile, tile * N_SUMS), np.float32)
    for number in range(begin, end):
        tile_top, tile_left, tile_bottom, tile_right = inner[number]
        left_over = np.ones((tile_bottom - tile_top, tile_right - tile_left), np.float32)
        for job in range(first_job[number], first_job[number + 1]):
            top, left, bottom, right = boxes[job]
            shape = (bottom - top, right - left, N_SUMS)
            here = sums[starts[job] : starts[job + 1]].reshape(shape)
            f = filters[layers[job]]
            covariance = (np.float64(f[column]), np.float64(f[column + 1]), np.float64(f[column + 2]))
            ring = ((shape[1] - tile) // 2, (shape[0] - tile) // 2)
            second_pass(way, here, covariance, ring, between[starts[job] : starts[job + 1]], blurred)
            composite(blurred, tile_top, tile_left, image, left_over)
        share_out(tile_top, tile_left, image, left_over)
