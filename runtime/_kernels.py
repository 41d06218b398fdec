"""Compiled kernels of the splat step: finding runs of like pixels, and drawing them as contiguous multiply-adds."""

import numba
import numpy as np

RUN_SOURCE_ROW, RUN_SOURCE_COL, RUN_TARGET_ROW, RUN_TARGET_COL, RUN_LENGTH, RUN_VARIANT = range(6)
"""Columns of the table of runs."""


@numba.njit(cache=True, fastmath=False)
def _run_end(variant, shift, row, col):
    """Return the column behind the run that starts at (row, col): same variant, same shift."""
    width = variant.shape[1]
    end = col + 1
    while (
        end < width
        and variant[row, end] == variant[row, col]
        and shift[row, end, 0] == shift[row, col, 0]
        and shift[row, end, 1] == shift[row, col, 1]
    ):
        end += 1
    return end


@numba.njit(cache=True, fastmath=False)
def find_runs(variant, shift, wanted):
    """List the runs of neighbouring pixels in a row that share a variant and a shift.

    Parameters
    ----------
    variant : ndarray of shape (H, W), int32
        Index of the PSF variant of each pixel; negative where the pixel is not drawn.
    shift : ndarray of shape (H, W, 2), int32
        Displacement (row, col) of each pixel's splat centre, px.
    wanted : ndarray of shape (n_variants,), bool
        The variants to list; runs of others are passed over.

    Returns
    -------
    ndarray of shape (n_runs, 6), int32
        Source row and column, target row and column, length and variant of each run, in raster order.
    """
    height, width = variant.shape
    count = 0
    for row in range(height):
        col = 0
        while col < width:
            end = _run_end(variant, shift, row, col)
            if variant[row, col] >= 0 and wanted[variant[row, col]]:
                count += 1
            col = end
    runs = np.empty((count, 6), np.int32)
    count = 0
    for row in range(height):
        col = 0
        while col < width:
            end = _run_end(variant, shift, row, col)
            if variant[row, col] >= 0 and wanted[variant[row, col]]:
                runs[count, 0] = row
                runs[count, 1] = col
                runs[count, 2] = row + shift[row, col, 0]
                runs[count, 3] = col + shift[row, col, 1]
                runs[count, 4] = end - col
                runs[count, 5] = variant[row, col]
                count += 1
            col = end
    return runs


@numba.njit(cache=True, fastmath=False)
def _first_point(offset_rc, begin, end, row):
    """Return the first point of [begin, end) whose row offset is at least ``row``; points are sorted by row."""
    while begin < end:
        middle = (begin + end) // 2
        if offset_rc[middle, 0] < row:
            begin = middle + 1
        else:
            end = middle
    return begin


# fastmath stays off: a product and a sum for each element leave nothing to reorder, and results stay exact.
@numba.njit(cache=True, fastmath=False, parallel=True)
def splat_runs(image, radiance, runs, row_start, offset_rc, value, point_start, band_rows):
    """Draw every run with the points of its variant: each point adds the run, scaled, as one contiguous stretch.

    Bands of rows are independent (each is written by one thread only, in the order of the runs), so the result
    is the same for any number of threads.

    Parameters
    ----------
    image : ndarray of shape (rows, cols, 4), float32
        Accumulated in place.
    radiance : ndarray of shape (H, W, 4), float32
        Colour of the source pixels.
    runs : ndarray of shape (n_runs, 6), int32
        The runs, sorted by target row; targets are in the coordinates of ``image``.
    row_start : ndarray of shape (rows + 1,), int64
        The runs that target row i are ``row_start[i]`` to ``row_start[i + 1]``.
    offset_rc : ndarray of shape (n_points, 2), int32
        Points of all variants, each variant sorted by row.
    value : ndarray of shape (n_points, C), float32
        C is 1, or 3 (then alpha takes the mean of the three).
    point_start : ndarray of shape (n_variants + 1,), int64
        The points of each variant.
    band_rows : int
        Height of a band.
    """
    rows, cols = image.shape[0], image.shape[1]
    n_bands = (rows + band_rows - 1) // band_rows
    reach = 0
    for p in range(offset_rc.shape[0]):
        reach = max(reach, abs(offset_rc[p, 0]))
    image_flat = image.reshape(rows, cols * 4)
    radiance_flat = radiance.reshape(radiance.shape[0], radiance.shape[1] * 4)
    for band in numba.prange(n_bands):
        begin_row = band * band_rows
        end_row = min(begin_row + band_rows, rows)
        first_run = row_start[max(begin_row - reach, 0)]
        last_run = row_start[min(end_row + reach, rows)]
        for i in range(first_run, last_run):
            target_row = runs[i, 2]
            variant = runs[i, 5]
            p = _first_point(offset_rc, point_start[variant], point_start[variant + 1], begin_row - target_row)
            n = 4 * runs[i, 4]
            source = radiance_flat[runs[i, 0], 4 * runs[i, 1] : 4 * runs[i, 1] + n]
            while p < point_start[variant + 1] and target_row + offset_rc[p, 0] < end_row:
                start = 4 * (runs[i, 3] + offset_rc[p, 1])
                target = image_flat[target_row + offset_rc[p, 0], start : start + n]
                if value.shape[1] == 1:
                    weight = value[p, 0]
                    for k in range(n):
                        target[k] += weight * source[k]
                else:
                    red, green, blue = value[p, 0], value[p, 1], value[p, 2]
                    alpha = (red + green + blue) * np.float32(1.0 / 3.0)
                    for k in range(0, n, 4):
                        target[k] += red * source[k]
                        target[k + 1] += green * source[k + 1]
                        target[k + 2] += blue * source[k + 2]
                        target[k + 3] += alpha * source[k + 3]
                p += 1
