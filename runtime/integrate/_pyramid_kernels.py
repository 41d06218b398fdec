"""Compiled kernels of the Poisson integrators.

All images are C-contiguous float32 arrays of shape (H, W * C): a row holds its channels interleaved, so that one flat
loop serves any number of channels and a neighbouring pixel lies `C` floats away. Every output row is computed by the
same instructions from the same inputs whichever thread owns it, so results do not depend on the number of threads.
"""

from typing import NamedTuple

import numpy as np

from spreadlets.compiled import helper, kernel
from spreadlets.runtime._vector_kernels import load, store

FILTER_RADIUS = 3
"""Separable filters are symmetric and given by their centre tap and `FILTER_RADIUS` side taps."""

BLOCK_PIXELS = 1536
"""Width of the column strips of `relax`: the rows that its steps keep then fit the second-level cache."""

INTERPOLATION_REACH = 4
"""Pixels that an interpolated pixel can depend on to either side, rounded up to whole coarse pixels."""

FOUR = np.uint64(4)
"""Channels that move as one vector."""

MAGNITUDE_BITS = np.int32(0x7FFFFFFF)
"""All bits of a float32 but its sign."""

# Multiply-add contraction only: sums keep their written order, and NaN and infinity keep their meaning.
FASTMATH = {"contract"}


@helper(fastmath=FASTMATH)
def _row(image, index, zeros):
    """Return a row, or zeros outside the image."""
    if 0 <= index < image.shape[0]:
        return image[index]
    return zeros


@helper(fastmath=FASTMATH)
def _filter_rows(out, image, index, taps, zeros):
    """Filter along the columns: write the weighted sum of the seven rows around `index`."""
    centre = _row(image, index, zeros)
    up_1, down_1 = _row(image, index - 1, zeros), _row(image, index + 1, zeros)
    up_2, down_2 = _row(image, index - 2, zeros), _row(image, index + 2, zeros)
    up_3, down_3 = _row(image, index - 3, zeros), _row(image, index + 3, zeros)
    tap_0, tap_1, tap_2, tap_3 = taps[0], taps[1], taps[2], taps[3]
    for j in range(out.shape[0]):
        out[j] = (
            tap_0 * centre[j]
            + tap_1 * (up_1[j] + down_1[j])
            + tap_2 * (up_2[j] + down_2[j])
            + tap_3 * (up_3[j] + down_3[j])
        )


@helper(fastmath=FASTMATH)
def _filter_cols(out, row, step, taps):
    """Filter along a row: `out[j]` is centred on `row[j + 3 * step]`."""
    left_3, left_2, left_1 = row, row[step:], row[2 * step :]
    centre, right_1, right_2, right_3 = row[3 * step :], row[4 * step :], row[5 * step :], row[6 * step :]
    tap_0, tap_1, tap_2, tap_3 = taps[0], taps[1], taps[2], taps[3]
    for j in range(out.shape[0]):
        out[j] = (
            tap_0 * centre[j]
            + tap_1 * (left_1[j] + right_1[j])
            + tap_2 * (left_2[j] + right_2[j])
            + tap_3 * (left_3[j] + right_3[j])
        )


@helper(fastmath=FASTMATH)
def _add(out, row):
    for j in range(out.shape[0]):
        out[j] += row[j]


@helper(fastmath=FASTMATH)
def _take_even_pixels(out, row, n_channels):
    for pixel in range(out.shape[0] // n_channels):
        for channel in range(n_channels):
            out[pixel * n_channels + channel] = row[2 * pixel * n_channels + channel]


@helper(fastmath=FASTMATH)
def _put_even_pixels(out, row, n_channels):
    for pixel in range(row.shape[0] // n_channels):
        for channel in range(n_channels):
            out[2 * pixel * n_channels + channel] = row[pixel * n_channels + channel]


@kernel(fastmath=FASTMATH)
def filter_down(begin, end, fine, coarse, taps, pad, n_channels, scratch):
    """Filter an image with a separable filter and keep every second pixel: coarse pixel k lies on fine pixel 2 k - pad.

    Parameters
    ----------
    fine : ndarray of shape (h, w * C), float32
        Zero outside.
    coarse : ndarray of shape (ceil((h + 2 pad) / 2), ceil((w + 2 pad) / 2) * C), float32
        Output.
    taps : ndarray of shape (2, 4), float32
        Filters along the columns and along the rows: centre tap and the three taps on either side.
    pad : int
        Pixels that are added on each side of the fine image; at least 3.
    n_channels : int
        C.
    scratch : ndarray of shape (n_bands, 3, (w + 2 pad + 7) * C), float32
        Row buffers, zero where not written; each band of rows is one parallel task.
    """
    n_bands = scratch.shape[0]
    n_fine = fine.shape[1]
    lead = (pad + FILTER_RADIUS) * n_channels
    for band in range(begin, end):
        zeros, row, filtered = scratch[band, 0, :n_fine], scratch[band, 1], scratch[band, 2]
        row[:] = 0
        for k in range(band * coarse.shape[0] // n_bands, (band + 1) * coarse.shape[0] // n_bands):
            _filter_rows(row[lead : lead + n_fine], fine, 2 * k - pad, taps[0], zeros)
            _filter_cols(filtered[: 2 * coarse.shape[1]], row, n_channels, taps[1])
            _take_even_pixels(coarse[k], filtered, n_channels)


@helper(fastmath=FASTMATH)
def _stretch_rows(out, coarse, position, taps, zeros):
    """Interpolate along the columns at a fine row: only every second of the seven taps meets a coarse row."""
    first = (position - FILTER_RADIUS + 1) // 2
    row_0, row_1 = _row(coarse, first, zeros), _row(coarse, first + 1, zeros)
    row_2, row_3 = _row(coarse, first + 2, zeros), _row(coarse, first + 3, zeros)
    if position % 2 == 0:
        # The fourth coarse row lies outside the filter.
        tap_0, tap_1, tap_2, tap_3 = taps[2], taps[0], taps[2], np.float32(0)
    else:
        tap_0, tap_1, tap_2, tap_3 = taps[3], taps[1], taps[1], taps[3]
    for j in range(out.shape[0]):
        out[j] = tap_0 * row_0[j] + tap_1 * row_1[j] + tap_2 * row_2[j] + tap_3 * row_3[j]


@kernel(fastmath=FASTMATH)
def filter_up(begin, end, coarse, source, fine, taps, source_taps, pad, n_channels, scratch):
    """Interpolate the coarser level's answer with a separable filter and add this level's filtered source.

    Parameters
    ----------
    coarse : ndarray of shape (ceil((h + 2 pad) / 2), ceil((w + 2 pad) / 2) * C), float32
        The coarser answer, placed as in `filter_down`.
    source : ndarray of shape (h, w * C), float32
        This level's source.
    fine : ndarray of shape (h, w * C), float32
        Output: this level's answer.
    taps, source_taps : ndarray of shape (2, 4), float32
        Filters of the interpolation and of the source, as in `filter_down`.
    pad : int
        As in `filter_down`.
    n_channels : int
        C.
    scratch : ndarray of shape (n_bands, 5, (w + 2 pad + 7) * C), float32
        Row buffers, zero where not written.
    """
    n_bands = scratch.shape[0]
    height, n_fine = fine.shape
    lead = FILTER_RADIUS * n_channels
    for band in range(begin, end):
        zeros, stretched, spread = scratch[band, 0], scratch[band, 1, : coarse.shape[1]], scratch[band, 2]
        row, filtered = scratch[band, 3], scratch[band, 4, :n_fine]
        spread[:] = 0
        row[:] = 0
        for i in range(band * height // n_bands, (band + 1) * height // n_bands):
            _stretch_rows(stretched, coarse, i + pad, taps[0], zeros)
            _put_even_pixels(spread, stretched, n_channels)
            _filter_cols(fine[i], spread[pad * n_channels - lead :], n_channels, taps[1])
            _filter_rows(row[lead : lead + n_fine], source, i, source_taps[0], zeros)
            _filter_cols(filtered, row, n_channels, source_taps[1])
            _add(fine[i], filtered)


@kernel(fastmath=FASTMATH)
def filter_level(begin, end, source, out, taps, n_channels, scratch):
    """Filter the coarsest level's source: with no level below it, that is its answer. Arguments as in `filter_up`."""
    n_bands = scratch.shape[0]
    height, width = source.shape
    lead = FILTER_RADIUS * n_channels
    for band in range(begin, end):
        zeros, row = scratch[band, 0], scratch[band, 1]
        row[:] = 0
        for i in range(band * height // n_bands, (band + 1) * height // n_bands):
            _filter_rows(row[lead : lead + width], source, i, taps[0], zeros)
            _filter_cols(out[i], row, n_channels, taps[1])


@helper(fastmath=FASTMATH)
def _mirrored(index, count):
    """Odd reflection about the zero pixels just outside: an index inside the array, and the sign of its value."""
    if index < 0:
        return max(-2 - index, 0), np.float32(-1 if index < -1 else 0)
    if index >= count:
        return min(2 * count - index, count - 1), np.float32(-1 if index > count else 0)
    return index, np.float32(1)


@helper(fastmath=FASTMATH)
def _largest_magnitude(row):
    """Bits of the largest magnitude in a row: as integers they order like the numbers, with infinity and NaN on top."""
    bits = row.view(np.int32)
    largest = np.int32(0)
    for j in range(bits.shape[0]):
        largest = max(largest, np.int32(bits[j] & MAGNITUDE_BITS))
    return largest


@helper(fastmath=FASTMATH)
def _sum_pixels(sums, row, n_channels, scratch):
    """Sum a row over its pixels, by folding it in half until one pixel is left."""
    remaining = row.shape[0] // n_channels
    for j in range(row.shape[0]):
        scratch[j] = row[j]
    while remaining > 1:
        half = remaining // 2
        upper = scratch[(remaining - half) * n_channels :]
        for j in range(half * n_channels):
            scratch[j] += upper[j]
        remaining -= half
    # One by one: the message about slices of unlike lengths would take longer to compile than all else.
    for channel in range(n_channels):
        sums[channel] = scratch[channel]


@helper(fastmath=FASTMATH)
def _split_pixels(even, odd, row, n_channels):
    """Part a row of 2 n + 1 pixels into its n + 1 even and n odd ones; four channels move as one vector."""
    n_odd = odd.shape[0] // n_channels
    if n_channels == 4:
        for pixel in range(n_odd):
            place = np.uint64(4 * pixel)
            store(even, place, load(row, 2 * place))
            store(odd, place, load(row, 2 * place + FOUR))
    else:
        for pixel in range(n_odd):
            for channel in range(n_channels):
                even[pixel * n_channels + channel] = row[2 * pixel * n_channels + channel]
                odd[pixel * n_channels + channel] = row[(2 * pixel + 1) * n_channels + channel]
    for channel in range(n_channels):
        even[n_odd * n_channels + channel] = row[2 * n_odd * n_channels + channel]


@helper(fastmath=FASTMATH)
def _join_pixels(row, even, odd, n_channels):
    """Inverse of `_split_pixels`."""
    n_odd = odd.shape[0] // n_channels
    if n_channels == 4:
        for pixel in range(n_odd):
            place = np.uint64(4 * pixel)
            store(row, 2 * place, load(even, place))
            store(row, 2 * place + FOUR, load(odd, place))
    else:
        for pixel in range(n_odd):
            for channel in range(n_channels):
                row[2 * pixel * n_channels + channel] = even[pixel * n_channels + channel]
                row[(2 * pixel + 1) * n_channels + channel] = odd[pixel * n_channels + channel]
    for channel in range(n_channels):
        row[2 * n_odd * n_channels + channel] = even[n_odd * n_channels + channel]


@helper(fastmath=FASTMATH)
def _copy_row(out, row):
    """Copy a row that may be shorter than its target; the rest becomes zero."""
    for j in range(row.shape[0]):
        out[j] = row[j]
    for j in range(row.shape[0], out.shape[0]):
        out[j] = 0


@helper(fastmath=FASTMATH)
def _residual_row(out, above, row, below, source, step):
    """Write `source - Lap u` of a row; the source may be shorter than the row.

    Summing differences keeps the rounding error in proportion to the image's slope and not to its level, which the
    coarse levels would amplify.
    """
    count = out.shape[0]
    centre, left, right = row[step:], row, row[2 * step :]
    above_centre, below_centre, inner = above[step:], below[step:], out[step:]
    for j in range(count - 2 * step):
        value = centre[j]
        inner[j] = (value - left[j]) + (value - right[j]) + (value - above_centre[j]) + (value - below_centre[j])
    for j in range(step):
        value = row[j]
        out[j] = value + (value - row[j + step]) + (value - above[j]) + (value - below[j])
        k = count - step + j
        value = row[k]
        out[k] = value + (value - row[k - step]) + (value - above[k]) + (value - below[k])
    for j in range(min(source.shape[0], count)):
        out[j] += source[j]


@helper(fastmath=FASTMATH)
def _coarsen_rows(out, rows, first, height, taps):
    """Filter along the columns: the seven rows from `first` on, out of a ring of eight."""
    w_0, w_1 = taps[3] * _mirrored(first, height)[1], taps[2] * _mirrored(first + 1, height)[1]
    w_2, w_3 = taps[1] * _mirrored(first + 2, height)[1], taps[0]
    w_4, w_5 = taps[1] * _mirrored(first + 4, height)[1], taps[2] * _mirrored(first + 5, height)[1]
    w_6 = taps[3] * _mirrored(first + 6, height)[1]
    r_0, r_1, r_2, r_3 = rows[first % 8], rows[(first + 1) % 8], rows[(first + 2) % 8], rows[(first + 3) % 8]
    r_4, r_5, r_6 = rows[(first + 4) % 8], rows[(first + 5) % 8], rows[(first + 6) % 8]
    for j in range(out.shape[0]):
        out[j] = (
            w_3 * r_3[j] + (w_2 * r_2[j] + w_4 * r_4[j]) + (w_1 * r_1[j] + w_5 * r_5[j]) + (w_0 * r_0[j] + w_6 * r_6[j])
        )


@helper(fastmath=FASTMATH)
def _coarsen_cols(out, row, taps, n_channels, even, odd):
    """Filter along a row and keep its odd pixels."""
    count = out.shape[0]
    _split_pixels(even[n_channels:], odd[n_channels : n_channels + count], row, n_channels)
    for channel in range(n_channels):
        odd[channel] = 0
        odd[n_channels + count + channel] = 0
        even[channel] = -even[n_channels + channel]
        even[2 * n_channels + count + channel] = -even[n_channels + count + channel]
    odd_1, odd_2, even_1 = odd[n_channels:], odd[2 * n_channels :], even[n_channels:]
    even_2, even_3 = even[2 * n_channels :], even[3 * n_channels :]
    tap_0, tap_1, tap_2, tap_3 = taps[0], taps[1], taps[2], taps[3]
    for j in range(count):
        out[j] = (
            tap_0 * odd_1[j]
            + tap_1 * (even_1[j] + even_2[j])
            + tap_2 * (odd[j] + odd_2[j])
            + tap_3 * (even[j] + even_3[j])
        )


@kernel(fastmath=FASTMATH)
def coarsen(begin, end, source, image, coarse, taps, n_channels, sums, largest, scratch):
    """Filter `source - Lap image` and keep its odd pixels: coarse pixel k lies on fine pixel 2 k + 1.

    Parameters
    ----------
    source : ndarray of shape (h, w * C), float32
        The Laplacian; zero on the rest of the level's domain.
    image : ndarray of shape (2 hc + 1, (2 wc + 1) * C), float32, or of shape (0, 0)
        The present image on the level's whole domain; without rows it is zero.
    coarse : ndarray of shape (hc, wc * C), float32
        Output. Its total is that of the fine level, up to what its odd reflection at the sides takes off.
    taps : ndarray of shape (4,), float32
        Centre tap and the three taps on either side.
    n_channels : int
        C.
    sums : ndarray of shape (2 hc + 1, C), float32, or of shape (0, C)
        Output: the sum over the pixels of each row of `source - Lap image`; without rows, it is not wanted.
    largest : ndarray of shape (2 hc + 1,), int32
        Output, if `sums` has rows: bits of the largest magnitude in each row.
    scratch : ndarray of shape (n_bands, 12, (2 wc + 5) * C), float32
        Row buffers; each band of rows is one parallel task.
    """
    n_bands = scratch.shape[0]
    height, count = 2 * coarse.shape[0] + 1, 2 * coarse.shape[1] + n_channels
    for band in range(begin, end):
        even, odd, spare = scratch[band, 0], scratch[band, 1], scratch[band, 2, :count]
        zeros, rows = scratch[band, 3, :count], scratch[band, 4:12]
        zeros[:] = 0
        first, last = band * coarse.shape[0] // n_bands, (band + 1) * coarse.shape[0] // n_bands
        position = 2 * first - 2
        for k in range(first, last):
            while position <= 2 * k + 4:
                i = _mirrored(position, height)[0]
                row = rows[position % 8, :count]
                own = source[i] if i < source.shape[0] else zeros[:0]
                if image.shape[0] == 0:
                    _copy_row(row, own)
                else:
                    above = image[i - 1] if i > 0 else zeros
                    below = image[i + 1] if i + 1 < image.shape[0] else zeros
                    _residual_row(row, above, image[i], below, own, n_channels)
                # Bands share rows at their borders; each row is measured where it is owned.
                if position < sums.shape[0] and first <= min(position // 2, coarse.shape[0] - 1) < last:
                    _sum_pixels(sums[position], row, n_channels, spare)
                    largest[position] = _largest_magnitude(row)
                position += 1
            _coarsen_rows(spare, rows, 2 * k - 2, height, taps)
            _coarsen_cols(coarse[k], spare, taps, n_channels, even, odd)


@helper(fastmath=FASTMATH)
def _stretch_cols(out, coarse, taps, n_channels, scratch):
    """Interpolate a coarse row of n pixels to 2 n + 1 pixels."""
    count = coarse.shape[0]
    extended, even, odd = scratch[0], scratch[1], scratch[2, :count]
    for j in range(count):
        extended[2 * n_channels + j] = coarse[j]
    for channel in range(n_channels):
        extended[channel] = -coarse[channel]
        extended[n_channels + channel] = 0
        extended[2 * n_channels + count + channel] = 0
        extended[3 * n_channels + count + channel] = -coarse[count - n_channels + channel]
    x_1, x_2, x_3 = extended[n_channels:], extended[2 * n_channels :], extended[3 * n_channels :]
    tap_0, tap_1, tap_2, tap_3 = taps[0], taps[1], taps[2], taps[3]
    for j in range(count):
        odd[j] = tap_0 * x_2[j] + tap_2 * (x_1[j] + x_3[j])
    for j in range(count + n_channels):
        even[j] = tap_1 * (x_1[j] + x_2[j]) + tap_3 * (extended[j] + x_3[j])
    _join_pixels(out, even, odd, n_channels)


@helper(fastmath=FASTMATH)
def _blend_rows(out, rows, position, n_coarse, taps):
    """Interpolate along the columns at a fine row, from a ring of four stretched coarse rows."""
    if position % 2 == 0:
        first = position // 2 - 2
        w_0, w_1, w_2, w_3 = taps[3], taps[1], taps[1], taps[3]
    else:
        first = position // 2 - 1
        w_0, w_1, w_2, w_3 = taps[2], taps[0], taps[2], np.float32(0)
    w_0, w_1 = w_0 * _mirrored(first, n_coarse)[1], w_1 * _mirrored(first + 1, n_coarse)[1]
    w_2, w_3 = w_2 * _mirrored(first + 2, n_coarse)[1], w_3 * _mirrored(first + 3, n_coarse)[1]
    r_0, r_1, r_2, r_3 = rows[first % 4], rows[(first + 1) % 4], rows[(first + 2) % 4], rows[(first + 3) % 4]
    for j in range(out.shape[0]):
        out[j] = w_0 * r_0[j] + w_1 * r_1[j] + w_2 * r_2[j] + w_3 * r_3[j]


class Stretch(NamedTuple):
    """A stretch of a row of an array: the row, its first element, their number."""

    row: int
    first: int
    size: int


class ThreeRows(NamedTuple):
    """A row and its neighbours in an array; the element one pixel to the left of the first that is written."""

    above: int
    row: int
    below: int
    first: int


@helper(fastmath=FASTMATH)
def _relax_row(out, out_at, rows, at, source, source_at, weight, step):
    """One Jacobi step on a row: `out = row + weight * (Lap row - source)`.

    Rows are given by array, index and first element, because handing over a slice costs as much as ten pixels.

    Parameters
    ----------
    out, out_at : ndarray of 2 axes, and Stretch
    rows, at : ndarray of 2 axes, and ThreeRows
    source, source_at : ndarray of 2 axes, and Stretch
        The count may be less than that of `out`; the source is zero from there on.
    weight : float
    step : int
        Elements in a pixel.
    """
    above, row, below = rows[at.above][at.first + step :], rows[at.row][at.first :], rows[at.below][at.first + step :]
    centre, right = row[step:], row[2 * step :]
    target, own = out[out_at.row][out_at.first :], source[source_at.row][source_at.first :]
    four = np.float32(4)
    for j in range(source_at.size):
        around = (row[j] + right[j]) + (above[j] + below[j])
        target[j] = centre[j] + weight * (around - four * centre[j] - own[j])
    for j in range(max(source_at.size, 0), out_at.size):
        around = (row[j] + right[j]) + (above[j] + below[j])
        target[j] = centre[j] + weight * (around - four * centre[j])


@helper(fastmath=FASTMATH)
def _relax_block(coarse, image, source, out, taps, weights, n_channels, block, scratch):
    """Do the work of `relax` on the block (first row, end row, first pixel, end pixel) of its output.

    All steps run in one sweep: step s follows one row behind step s - 1, and each keeps its last three rows. Pixels
    near the sides of a block that are not sides of the domain see wrong neighbours; the overlap keeps them out of the
    output.
    """
    first_row, end_row, first_pixel, end_pixel = block
    n_steps = weights.shape[0]
    n_coarse, height = coarse.shape[0], 2 * coarse.shape[0] + 1
    overlap = n_steps + INTERPOLATION_REACH
    first_col = max(0, (first_pixel - overlap) // 2) * n_channels
    end_col = min(coarse.shape[1], ((end_pixel + overlap + 1) // 2) * n_channels)
    begin, count = 2 * first_col, 2 * (end_col - first_col) + n_channels
    stretched = scratch[4:8]
    scratch[0] = 0
    for row in scratch[8 : 8 + 3 * n_steps]:
        row[:n_channels] = 0
        row[n_channels + count : 2 * n_channels + count] = 0
    largest = np.int32(0)
    next_coarse = max(first_row - n_steps, 0) // 2 - 2
    for position in range(max(first_row - n_steps, 0), end_row + n_steps):
        if position < height:
            # Step 0: interpolate.
            while next_coarse <= (position + position % 2) // 2 + 1:
                line = coarse[_mirrored(next_coarse, n_coarse)[0]][first_col:end_col]
                _stretch_cols(stretched[next_coarse % 4, :count], line, taps, n_channels, scratch[1:4])
                next_coarse += 1
            row = scratch[8 + position % 3, n_channels : n_channels + count]
            _blend_rows(row, stretched, position, n_coarse, taps)
            if image.shape[0] > 0:
                _add(row, image[position, begin : begin + count])
        for step in range(1, n_steps + 1):
            i, reach = position - step, n_steps - step
            if i < max(first_row - reach, 0) or i >= min(end_row + reach, height):
                continue
            slot = 5 + 3 * step
            above = slot + (i - 1) % 3 if i > 0 else 0
            below = slot + (i + 1) % 3 if i + 1 < height else 0
            known = source.shape[1] if i < source.shape[0] else 0
            if step < n_steps:
                at, to = (
                    ThreeRows(above, slot + i % 3, below, np.int64(0)),
                    Stretch(slot + 3 + i % 3, n_channels, count),
                )
                known_at = Stretch(min(i, source.shape[0] - 1), begin, min(known - begin, count))
                _relax_row(scratch, to, scratch, at, source, known_at, weights[step - 1], n_channels)
            else:
                first, last = first_pixel * n_channels, end_pixel * n_channels
                at, to = ThreeRows(above, slot + i % 3, below, first - begin), Stretch(i, first, last - first)
                known_at = Stretch(min(i, source.shape[0] - 1), first, min(known, last) - first)
                _relax_row(out, to, scratch, at, source, known_at, weights[step - 1], n_channels)
                largest = max(largest, _largest_magnitude(out[i, first:last]))
    return largest


@kernel(fastmath=FASTMATH)
def relax(begin, end, coarse, image, source, out, taps, weights, n_channels, largest, scratch):
    """Interpolate a coarse correction, add it to an image, and relax with Jacobi steps, in one sweep over memory.

    Parameters
    ----------
    coarse : ndarray of shape (hc, wc * C), float32
        The correction; coarse pixel k lies on fine pixel 2 k + 1.
    image : ndarray of shape (2 hc + 1, (2 wc + 1) * C), float32, or of shape (0, 0)
        The present image; without rows it is zero.
    source : ndarray of shape (h, w * C), float32
        The Laplacian; zero on the rest of the level's domain.
    out : ndarray of shape (at most 2 hc + 1, at most (2 wc + 1) * C), float32
        Output: the new image, or its upper left part. Must not be `image`.
    taps : ndarray of shape (4,), float32
        Centre tap and the three taps on either side of the interpolation.
    weights : ndarray of shape (n_steps,), float32
        Weight of each step.
    n_channels : int
        C.
    largest : ndarray of shape (n_bands,), int32
        Output: bits of the largest magnitude that each band wrote.
    scratch : ndarray of shape (n_bands, 8 + 3 * n_steps, n), float32
        Row buffers; each band of rows is one parallel task.
        `n >= (BLOCK_PIXELS + 2 * (n_steps + INTERPOLATION_REACH) + 8) * C`.
    """
    n_bands, n_pixels = scratch.shape[0], out.shape[1] // n_channels
    for band in range(begin, end):
        first_row, end_row = band * out.shape[0] // n_bands, (band + 1) * out.shape[0] // n_bands
        largest[band] = 0
        for first_pixel in range(0, n_pixels, BLOCK_PIXELS):
            block = (first_row, end_row, first_pixel, min(first_pixel + BLOCK_PIXELS, n_pixels))
            found = _relax_block(coarse, image, source, out, taps, weights, n_channels, block, scratch[band])
            largest[band] = max(largest[band], found)


@kernel(fastmath=FASTMATH)
def measure(begin, end, image, n_channels, sums, largest, scratch):
    """Sum each row over its pixels and find the largest magnitude.

    Parameters
    ----------
    image : ndarray of shape (h, w * C), float32
        Any values.
    n_channels : int
        C.
    sums : ndarray of shape (h, C), float32
        Output.
    largest : ndarray of shape (h,), int32
        Output: bits of the largest magnitude of each row.
    scratch : ndarray of shape (n_bands, at least 1, at least w * C), float32
        Row buffers; each band of rows is one parallel task.
    """
    n_bands = scratch.shape[0]
    for band in range(begin, end):
        for i in range(band * image.shape[0] // n_bands, (band + 1) * image.shape[0] // n_bands):
            largest[i] = _largest_magnitude(image[i])
            _sum_pixels(sums[i], image[i], n_channels, scratch[band, 0])
