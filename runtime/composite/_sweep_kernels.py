"""Compiled kernels of the blur by a swept disc."""

import numpy as np

from spreadlets.compiled import helper, kernel

ONE = 1 << 20
"""A value of 1 in the sums. They are whole numbers: what comes and goes cancels, even where the sum of a row is beyond
the range of an int32 and wraps. Only that of a disc may not: of 2047 px, more than are summed pixel by pixel."""


@kernel
def sum_rows(begin, end, image, sums):
    """Fill ``sums`` (H, W + 1), int32, with the sums of the pixels before each of a row, of values from 0 to 1."""
    for row in range(begin, end):
        total = 0
        sums[row, 0] = 0
        for col in range(image.shape[1]):
            total += int(image[row, col] * np.float32(ONE) + np.float32(0.5))
            sums[row, col + 1] = np.int32(total)


@helper
def _crossing_span(line, low, high):
    """Return the sum of a row's pixels from ``low`` up to ``high``, by its prefix sums; those at the ends repeat."""
    width = len(line) - 1
    before, behind = line[1], np.int32(line[width] - line[width - 1])
    inside = line[min(max(high, 0), width)] - line[min(max(low, 0), width)]
    outside = before * (max(-low, 0) - max(-high, 0)) + behind * (max(high - width, 0) - max(low - width, 0))
    return inside + outside


@kernel
def sum_spans(begin, end, sums, first, last, mean):
    """Fill ``mean`` (H, W), float32, with the mean of the spans around each pixel, one for each row around it.

    Parameters
    ----------
    sums : ndarray of shape (H, W + 1), int32
        See `sum_rows`. Beyond the border the nearest pixels repeat.
    first, last : ndarray of shape (2 n + 1,), int64
        Columns of the spans' ends, relative to the pixel's.
    mean : ndarray of shape (H, W), float32
    """
    height, width = mean.shape
    n = len(first) // 2
    scale = np.float32(1.0 / (ONE * (last - first + 1).sum()))
    total = np.empty(width, np.int32)
    for row in range(begin, end):
        total[:] = 0
        for each in range(len(first)):
            # Take the prefix sums of the row; beyond the border, the nearest row repeats.
            line = sums[min(max(row + each - n, 0), height - 1)]
            left, right = first[each], last[each] + 1
            # Within the image, a span is a difference of two prefix sums.
            inner_begin = min(max(0, -left), width)
            inner_end = max(inner_begin, width - max(right, 0))
            inner = total[inner_begin:inner_end]
            lows, highs = line[inner_begin + left :], line[inner_begin + right :]
            for col in range(inner.shape[0]):
                inner[col] += highs[col] - lows[col]
            # Across the border, it is its inner part and repetitions of the pixels at the ends.
            for col in range(inner_begin):
                total[col] += _crossing_span(line, col + left, col + right)
            for col in range(inner_end, width):
                total[col] += _crossing_span(line, col + left, col + right)
        for col in range(width):
            mean[row, col] = total[col] * scale


@kernel
def shrink(begin, end, image, factor, small):
    """Fill ``small`` with the means of blocks of ``factor`` x ``factor`` pixels."""
    height, width = image.shape
    column = np.empty(width)
    for row in range(begin, end):
        # Sum along the columns, then along the row.
        first, last = row * factor, min((row + 1) * factor, height)
        column[:] = 0.0
        for i in range(first, last):
            line = image[i]
            for j in range(width):
                column[j] += line[j]
        for col in range(small.shape[1]):
            total, end_col = 0.0, min((col + 1) * factor, width)
            for j in range(col * factor, end_col):
                total += column[j]
            small[row, col] = total / ((last - first) * (end_col - col * factor))


@kernel
def enlarge(begin, end, small, factor, image):
    """Fill ``image`` with ``small``, the means of blocks of ``factor`` x ``factor`` pixels, interpolated linearly."""
    height, width = small.shape
    line = np.empty(width + 2, np.float32)
    for row in range(begin, end):
        # Interpolate along the columns; beyond the ends of the row, its pixels repeat.
        y = min(max((row + 0.5) / factor - 0.5, 0.0), height - 1.0)
        i = min(int(y), height - 1)
        upper, lower, down = small[i], small[min(i + 1, height - 1)], np.float32(y - i)
        for j in range(width):
            line[1 + j] = upper[j] + down * (lower[j] - upper[j])
        line[0], line[width + 1] = line[1], line[width]
        # Interpolate along the row, pixels of like phase together.
        for phase in range(min(factor, image.shape[1])):
            x = (phase + 0.5) / factor + 0.5
            before = line[int(x) :]
            behind, across = before[1:], np.float32(x - int(x))
            target = image[row, phase::factor]
            for j in range(len(target)):
                target[j] = before[j] + across * (behind[j] - before[j])
