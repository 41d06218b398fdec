"""Compiled kernels of the Poisson integrators.

All images are C-contiguous float32 arrays of shape (H, W * C): a row holds its channels interleaved, so that one flat
loop serves any number of channels and a neighbouring pixel lies `C` floats away. Every output row is computed by the
same instructions from the same inputs whichever thread owns it, so results do not depend on the number of threads.
"""

import numba
import numpy as np

FILTER_RADIUS = 3
"""Separable filters are symmetric and given by their centre tap and `FILTER_RADIUS` side taps."""

ROWS_PER_SUM = 64
"""Rows that share one partial sum in `channel_sums`; fixed, so that sums do not depend on the number of threads."""

# Multiply-add contraction only: sums keep their written order, and NaN and infinity keep their meaning.
FASTMATH = {"contract"}


@numba.njit(cache=True, fastmath=FASTMATH)
def _row(image, index, zeros):
    """Return a row, or zeros outside the image."""
    if 0 <= index < image.shape[0]:
        return image[index]
    return zeros


@numba.njit(cache=True, fastmath=FASTMATH)
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


@numba.njit(cache=True, fastmath=FASTMATH)
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


@numba.njit(cache=True, fastmath=FASTMATH)
def _add(out, row):
    for j in range(out.shape[0]):
        out[j] += row[j]


@numba.njit(cache=True, fastmath=FASTMATH)
def _take_even_pixels(out, row, n_channels):
    for pixel in range(out.shape[0] // n_channels):
        for channel in range(n_channels):
            out[pixel * n_channels + channel] = row[2 * pixel * n_channels + channel]


@numba.njit(cache=True, fastmath=FASTMATH)
def _put_even_pixels(out, row, n_channels):
    for pixel in range(row.shape[0] // n_channels):
        for channel in range(n_channels):
            out[2 * pixel * n_channels + channel] = row[pixel * n_channels + channel]


@numba.njit(cache=True, parallel=True, fastmath=FASTMATH)
def filter_down(fine, coarse, taps, pad, n_channels, scratch):
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
    for band in numba.prange(n_bands):
        zeros, row, filtered = scratch[band, 0, :n_fine], scratch[band, 1], scratch[band, 2]
        row[:] = 0
        for k in range(band * coarse.shape[0] // n_bands, (band + 1) * coarse.shape[0] // n_bands):
            _filter_rows(row[lead : lead + n_fine], fine, 2 * k - pad, taps[0], zeros)
            _filter_cols(filtered[: 2 * coarse.shape[1]], row, n_channels, taps[1])
            _take_even_pixels(coarse[k], filtered, n_channels)


@numba.njit(cache=True, fastmath=FASTMATH)
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


@numba.njit(cache=True, parallel=True, fastmath=FASTMATH)
def filter_up(coarse, source, fine, taps, source_taps, pad, n_channels, scratch):
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
    for band in numba.prange(n_bands):
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


@numba.njit(cache=True, parallel=True, fastmath=FASTMATH)
def filter_level(source, out, taps, n_channels, scratch):
    """Filter the coarsest level's source: with no level below it, that is its answer. Arguments as in `filter_up`."""
    n_bands = scratch.shape[0]
    height, width = source.shape
    lead = FILTER_RADIUS * n_channels
    for band in numba.prange(n_bands):
        zeros, row = scratch[band, 0], scratch[band, 1]
        row[:] = 0
        for i in range(band * height // n_bands, (band + 1) * height // n_bands):
            _filter_rows(row[lead : lead + width], source, i, taps[0], zeros)
            _filter_cols(out[i], row, n_channels, taps[1])


@numba.njit(cache=True, parallel=True, fastmath=FASTMATH)
def channel_sums(image, sums, magnitudes):
    """Sum the values and their magnitudes over groups of `ROWS_PER_SUM` rows, separately for each column.

    Parameters
    ----------
    image : ndarray of shape (h, w * C), float32
        Any values; NaN and infinity show in the sums.
    sums, magnitudes : ndarray of shape (ceil(h / ROWS_PER_SUM), w * C), float64
        Output.
    """
    for group in numba.prange(sums.shape[0]):
        total, magnitude = sums[group], magnitudes[group]
        total[:] = 0
        magnitude[:] = 0
        for i in range(group * ROWS_PER_SUM, min((group + 1) * ROWS_PER_SUM, image.shape[0])):
            row = image[i]
            for j in range(row.shape[0]):
                value = np.float64(row[j])
                total[j] += value
                magnitude[j] += abs(value)
