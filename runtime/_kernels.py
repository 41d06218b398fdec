"""Compiled kernels of the splat step: runs of like pixels, drawn as contiguous multiply-adds.

Indices into images are unsigned: a signed index would be checked for wrap-around at each access, which keeps the
compiler from vectorising.
"""

import numba
import numpy as np

RUN_SOURCE, RUN_ROW, RUN_COL, RUN_LENGTH, RUN_VARIANT = range(5)
"""Columns of the table of runs: first pixel in the flattened source; target row, column; length; variant."""

_U = np.uint64


@numba.njit(cache=True, fastmath=False)
def _run_end(variant, shift, row, col):
    """Return the column behind the run that starts at (row, col): same variant and, if there are shifts, same shift."""
    width = variant.shape[1]
    end = col + 1
    while end < width and variant[row, end] == variant[row, col]:
        if shift.shape[0] and (shift[row, end, 0] != shift[row, col, 0] or shift[row, end, 1] != shift[row, col, 1]):
            break
        end += 1
    return end


@numba.njit(cache=True, fastmath=False, parallel=True)
def count_runs(variant, shift, wanted, counts):
    """Count, for each row, the runs of wanted variants; see `fill_runs`."""
    for row in numba.prange(variant.shape[0]):
        count = 0
        col = 0
        while col < variant.shape[1]:
            end = _run_end(variant, shift, row, col)
            if variant[row, col] >= 0 and wanted[variant[row, col]]:
                count += 1
            col = end
        counts[row] = count


@numba.njit(cache=True, fastmath=False, parallel=True)
def fill_runs(variant, shift, wanted, first, runs):
    """List the runs of neighbouring pixels in a row that share a variant and a shift.

    Parameters
    ----------
    variant : ndarray of shape (H, W), int32
        Index of the PSF variant of each pixel; negative where the pixel is not drawn.
    shift : ndarray of shape (H, W, 2), int32, or (0, 0, 2)
        Displacement (row, col) of each pixel's splat centre, px; empty if there is none.
    wanted : ndarray of shape (n_variants,), bool
        The variants to list; runs of others are passed over.
    first : ndarray of shape (H,), int64
        Where each row's runs begin in the table.
    runs : ndarray of shape (n_runs, 5), int32
        Filled in raster order, see `RUN_SOURCE`.
    """
    width = variant.shape[1]
    for row in numba.prange(variant.shape[0]):
        place = first[row]
        col = 0
        while col < width:
            end = _run_end(variant, shift, row, col)
            if variant[row, col] >= 0 and wanted[variant[row, col]]:
                runs[place, 0] = row * width + col
                runs[place, 1] = row
                runs[place, 2] = col
                if shift.shape[0]:
                    runs[place, 1] += shift[row, col, 0]
                    runs[place, 2] += shift[row, col, 1]
                runs[place, 3] = end - col
                runs[place, 4] = variant[row, col]
                place += 1
            col = end


@numba.njit(cache=True, fastmath=False)
def _first_point(row, begin, end, wanted):
    """Return the first point of [begin, end) whose row is at least ``wanted``; the rows are sorted."""
    while begin < end:
        middle = (begin + end) // 2
        if row[middle] < wanted:
            begin = middle + 1
        else:
            end = middle
    return begin


@numba.njit(cache=True, fastmath=False)
def _draw_pixel(image, radiance, source, target, point_offset, value, begin, end):
    """Add one pixel, times the value of each point, at the places of the points."""
    r, g, b, a = radiance[source], radiance[source + _U(1)], radiance[source + _U(2)], radiance[source + _U(3)]
    for p in range(begin, end):
        o = _U(target + point_offset[p])
        weight = value[p, 0]
        # Load all four before the first store, so that they become one vector.
        r0, g0, b0, a0 = image[o], image[o + _U(1)], image[o + _U(2)], image[o + _U(3)]
        image[o] = r0 + weight * r
        image[o + _U(1)] = g0 + weight * g
        image[o + _U(2)] = b0 + weight * b
        image[o + _U(3)] = a0 + weight * a


@numba.njit(cache=True, fastmath=False)
def _draw_run(image, radiance, source, target, n, point_offset, value, begin, end):
    """Add n floats of contiguous pixels, times the value of each point, at the places of the points."""
    for p in range(begin, end):
        o = _U(target + point_offset[p])
        weight = value[p, 0]
        for k in range(n):
            image[o + _U(k)] += weight * radiance[source + _U(k)]


@numba.njit(cache=True, fastmath=False)
def _draw_coloured_run(image, radiance, source, target, n, point_offset, value, begin, end):
    """Do as `_draw_run` with a value for each of R, G and B; alpha takes their mean."""
    for p in range(begin, end):
        o = _U(target + point_offset[p])
        r, g, b = value[p, 0], value[p, 1], value[p, 2]
        a = (r + g + b) * np.float32(1.0 / 3.0)
        for k in range(_U(0), n, _U(4)):
            image[o + k] += r * radiance[source + k]
            image[o + k + _U(1)] += g * radiance[source + k + _U(1)]
            image[o + k + _U(2)] += b * radiance[source + k + _U(2)]
            image[o + k + _U(3)] += a * radiance[source + k + _U(3)]


# fastmath stays off: a product and a sum for each element leave nothing to reorder, and results stay exact.
@numba.njit(cache=True, fastmath=False, parallel=True)
def splat_runs(image, radiance, runs, row_start, points, value, point_start, cols, band_rows):
    """Draw every run with the points of its variant: each point adds the run, scaled, as one contiguous stretch.

    Bands of rows are independent (each is written by one thread only, in the order of the runs), so the result
    is the same for any number of threads.

    Parameters
    ----------
    image : ndarray of shape (rows * cols * 4,), float32
        Accumulated in place.
    radiance : ndarray of shape (H * W * 4,), float32
        Colour of the source pixels.
    runs : ndarray of shape (n_runs, 5), int32
        The runs, sorted by target row; targets are in the coordinates of ``image``.
    row_start : ndarray of shape (rows + 1,), int64
        The runs that target row i are ``row_start[i]`` to ``row_start[i + 1]``.
    points : tuple of two ndarrays of shape (n_points,), int32 and int64
        Row offset of each point, ascending within a variant, and its offset in floats of the flattened image.
    value : ndarray of shape (n_points, C), float32
        C is 1, or 3 (then alpha takes the mean of the three).
    point_start : ndarray of shape (n_variants + 1,), int64
        The points of each variant.
    cols, band_rows : int
        Width of the image, and height of a band.
    """
    point_row, point_offset = points
    rows = row_start.shape[0] - 1
    reach = 0
    for p in range(point_row.shape[0]):
        reach = max(reach, abs(point_row[p]))
    for band in numba.prange((rows + band_rows - 1) // band_rows):
        begin_row = band * band_rows
        end_row = min(begin_row + band_rows, rows)
        for i in range(row_start[max(begin_row - reach, 0)], row_start[min(end_row + reach, rows)]):
            row, variant = runs[i, 1], runs[i, 4]
            begin = _first_point(point_row, point_start[variant], point_start[variant + 1], begin_row - row)
            end = _first_point(point_row, begin, point_start[variant + 1], end_row - row)
            source = _U(4) * _U(runs[i, 0])
            target = 4 * (np.int64(row) * cols + runs[i, 2])
            n = _U(4) * _U(runs[i, 3])
            if value.shape[1] == 3:
                _draw_coloured_run(image, radiance, source, target, n, point_offset, value, begin, end)
            elif n == _U(4):
                _draw_pixel(image, radiance, source, target, point_offset, value, begin, end)
            else:
                _draw_run(image, radiance, source, target, n, point_offset, value, begin, end)
