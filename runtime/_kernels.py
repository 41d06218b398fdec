"""Compiled kernels of the splat step: runs of like pixels, drawn as contiguous multiply-adds.

Indices into images are unsigned: a signed index would be checked for wrap-around at each access, which keeps the
compiler from vectorising.
"""

import numba
import numpy as np

RUN_SOURCE, RUN_ROW, RUN_COL, RUN_LENGTH, RUN_VARIANT = range(5)
"""Columns of the table of runs: first pixel in the flattened source; target row, column; length; variant."""

LONG_RUN = 16
"""Pixels from which a run is drawn along itself rather than along the rows of a direct PSF."""

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


@numba.njit(cache=True, fastmath=False)
def find_runs(variant, shift, wanted):
    """List the runs of neighbouring pixels in a row that share a variant and a shift.

    Serial, as it takes a few milliseconds for a million pixels, and most passes are narrow strips.

    Parameters
    ----------
    variant : ndarray of shape (H, W), int32
        Index of the PSF variant of each pixel; negative where the pixel is not drawn.
    shift : ndarray of shape (H, W, 2), int32, or (0, 0, 2)
        Displacement (row, col) of each pixel's splat centre, px; empty if there is none.
    wanted : ndarray of shape (n_variants,), bool
        The variants to list; runs of others are passed over.

    Returns
    -------
    ndarray of shape (n_runs, 5), int32
        In raster order, see `RUN_SOURCE`.
    """
    height, width = variant.shape
    runs = np.empty((1024, 5), np.int32)
    count = 0
    for row in range(height):
        col = 0
        while col < width:
            end = _run_end(variant, shift, row, col)
            if variant[row, col] >= 0 and wanted[variant[row, col]]:
                if count == len(runs):
                    longer = np.empty((2 * count, 5), np.int32)
                    longer[:count] = runs
                    runs = longer
                runs[count, 0] = row * width + col
                runs[count, 1] = row
                runs[count, 2] = col
                if shift.shape[0]:
                    runs[count, 1] += shift[row, col, 0]
                    runs[count, 2] += shift[row, col, 1]
                runs[count, 3] = end - col
                runs[count, 4] = variant[row, col]
                count += 1
            col = end
    return runs[:count].copy()


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
def _draw_coloured_run(image, radiance, source, target, n, spacing, point_offset, value, begin, end):
    """Do as `_draw_spaced_run` with a value for each of R, G and B; alpha takes their mean."""
    for p in range(begin, end):
        o = _U(target + point_offset[p])
        r, g, b = value[p, 0], value[p, 1], value[p, 2]
        a = (r + g + b) * np.float32(1.0 / 3.0)
        for k in range(source, source + n, _U(4)):
            image[o] += r * radiance[k]
            image[o + _U(1)] += g * radiance[k + _U(1)]
            image[o + _U(2)] += b * radiance[k + _U(2)]
            image[o + _U(3)] += a * radiance[k + _U(3)]
            o += spacing


@numba.njit(cache=True, fastmath=False)
def _draw_spaced_run(image, radiance, source, target, n, spacing, point_offset, value, begin, end):
    """Do as `_draw_run` with pixels ``spacing`` floats apart in the image."""
    for p in range(begin, end):
        o = _U(target + point_offset[p])
        weight = value[p, 0]
        for k in range(source, source + n, _U(4)):
            r, g, b, a = image[o], image[o + _U(1)], image[o + _U(2)], image[o + _U(3)]
            image[o] = r + weight * radiance[k]
            image[o + _U(1)] = g + weight * radiance[k + _U(1)]
            image[o + _U(2)] = b + weight * radiance[k + _U(2)]
            image[o + _U(3)] = a + weight * radiance[k + _U(3)]
            o += spacing


# fastmath stays off: a product and a sum for each element leave nothing to reorder, and results stay exact.
@numba.njit(cache=True, fastmath=False, parallel=True)
def splat_runs(image, radiance, runs, row_start, points, value, point_start, geometry, band_rows):
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
    geometry : tuple of two ints
        Width of the image, px; distance at which the pixels of a run are drawn, px.
    band_rows : int
        Height of a band.
    """
    point_row, point_offset = points
    cols, stride = geometry
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
                spacing = _U(4 * stride)
                _draw_coloured_run(image, radiance, source, target, n, spacing, point_offset, value, begin, end)
            elif stride > 1:
                spacing = _U(4 * stride)
                _draw_spaced_run(image, radiance, source, target, n, spacing, point_offset, value, begin, end)
            elif n == _U(4):
                _draw_pixel(image, radiance, source, target, point_offset, value, begin, end)
            else:
                _draw_run(image, radiance, source, target, n, point_offset, value, begin, end)


@numba.njit(cache=True, fastmath=False)
def _draw_direct_run(image, radiance, source, target, n, spans, value, bounds, tiled):
    """Add n pixels to each span from ``bounds[0]`` to ``bounds[1]``, along whichever of the two is longer."""
    _, span_offset, span_start = spans
    begin, end = bounds
    if n >= LONG_RUN:
        for span in range(begin, end):
            o = _U(target + span_offset[span])
            for p in range(_U(4 * span_start[span]), _U(4 * span_start[span + 1]), _U(4)):
                r, g, b, a = value[p], value[p + _U(1)], value[p + _U(2)], value[p + _U(3)]
                if r == a and g == a and b == a:
                    for k in range(_U(4 * n)):
                        image[o + _U(k)] += a * radiance[source + _U(k)]
                else:
                    for k in range(_U(0), _U(4 * n), _U(4)):
                        image[o + k] += r * radiance[source + k]
                        image[o + k + _U(1)] += g * radiance[source + k + _U(1)]
                        image[o + k + _U(2)] += b * radiance[source + k + _U(2)]
                        image[o + k + _U(3)] += a * radiance[source + k + _U(3)]
                o += _U(4)
        return
    for pixel in range(n):
        for k in range(len(tiled)):
            tiled[k] = radiance[source + _U(4 * pixel + (k & 3))]
        for span in range(begin, end):
            o = _U(target + 4 * pixel + span_offset[span])
            first = _U(4 * span_start[span])
            for k in range(_U(4 * (span_start[span + 1] - span_start[span]))):
                image[o + _U(k)] += value[first + _U(k)] * tiled[_U(k)]


@numba.njit(cache=True, fastmath=False, parallel=True)
def splat_spans(image, radiance, runs, row_start, spans, value, span_of_variant, cols, band_rows):
    """Draw every run with a direct PSF, whose points are neighbours in rows: the counterpart of `splat_runs`.

    Short runs are drawn pixel by pixel, each span of the PSF as one contiguous stretch; long ones point by point, each
    point adding the run as one contiguous stretch.

    Parameters
    ----------
    image, radiance, runs, row_start, cols, band_rows
        As for `splat_runs`; the stride is 1.
    spans : tuple of three ndarrays of shapes (n_spans,), (n_spans,) and (n_spans + 1,), int64
        Row offset of each span, ascending within a variant; its offset in floats of the flattened image; its points.
    value : ndarray of shape (n_points * 4,), float32
        Values of the points for R, G, B and alpha.
    span_of_variant : ndarray of shape (n_variants + 1,), int64
        The spans of each variant.
    """
    span_row, span_offset, span_start = spans
    rows = row_start.shape[0] - 1
    reach = 0
    longest = 0
    for span in range(span_row.shape[0]):
        reach = max(reach, abs(span_row[span]))
        longest = max(longest, span_start[span + 1] - span_start[span])
    for band in numba.prange((rows + band_rows - 1) // band_rows):
        begin_row = band * band_rows
        end_row = min(begin_row + band_rows, rows)
        tiled = np.empty(4 * longest, np.float32)
        for i in range(row_start[max(begin_row - reach, 0)], row_start[min(end_row + reach, rows)]):
            row, length, variant = runs[i, 1], runs[i, 3], runs[i, 4]
            begin = _first_point(span_row, span_of_variant[variant], span_of_variant[variant + 1], begin_row - row)
            end = _first_point(span_row, begin, span_of_variant[variant + 1], end_row - row)
            if begin == end:
                continue
            source = _U(4) * _U(runs[i, 0])
            target = 4 * (np.int64(row) * cols + runs[i, 2])
            _draw_direct_run(image, radiance, source, target, length, spans, value, (begin, end), tiled)


@numba.njit(cache=True, fastmath=False, parallel=True)
def add_spread(image, spaced, distance):
    """Add an image (rows, cols, 4) and its copies moved down, right, and both, by a distance, px, to another."""
    rows, width = image.shape[0], 4 * image.shape[1]
    target = image.reshape(rows * width)
    source = spaced.reshape(rows * width)
    for row in numba.prange(rows):
        here = _U(row * width)
        above = _U(max(row - distance, 0) * width)
        step = _U(4 * distance)
        weight = np.float32(1.0) if row >= distance else np.float32(0.0)
        for k in range(_U(0), min(step, _U(width))):
            target[here + k] += source[here + k] + weight * source[above + k]
        for k in range(step, _U(width)):
            moved = k - step
            beside = source[here + k] + source[here + moved]
            target[here + k] += beside + weight * (source[above + k] + source[above + moved])


@numba.njit(cache=True, fastmath=False, parallel=True)
def gather_runs(image, radiance, runs, point_offset, value, point_start, cols):
    """Filter: every pixel of a run sums what lies under its own PSF, each point one contiguous multiply-add.

    Parameters
    ----------
    image : ndarray of shape (H * W * 4,), float32
        Accumulated in place; each pixel belongs to one run only.
    radiance : ndarray of shape (rows * cols * 4,), float32
        Padded input.
    runs : ndarray of shape (n_runs, 5), int32
        The receiving pixels; the target row and column are those of the pixel in the padded input.
    point_offset : ndarray of shape (n_points,), int64
        Offset of each point in floats of the padded input.
    value : ndarray of shape (n_points, C), float32
        The PSF's pixels.
    point_start : ndarray of shape (n_variants + 1,), int64
    cols : int
        Width of the padded input, px.
    """
    for i in numba.prange(runs.shape[0]):
        variant = runs[i, 4]
        target = _U(4) * _U(runs[i, 0])
        centre = 4 * (np.int64(runs[i, 1]) * cols + runs[i, 2])
        n = _U(4) * _U(runs[i, 3])
        for p in range(point_start[variant], point_start[variant + 1]):
            source = _U(centre + point_offset[p])
            if value.shape[1] == 1:
                weight = value[p, 0]
                for k in range(n):
                    image[target + _U(k)] += weight * radiance[source + _U(k)]
            else:
                r, g, b = value[p, 0], value[p, 1], value[p, 2]
                a = (r + g + b) * np.float32(1.0 / 3.0)
                for k in range(_U(0), n, _U(4)):
                    image[target + k] += r * radiance[source + k]
                    image[target + k + _U(1)] += g * radiance[source + k + _U(1)]
                    image[target + k + _U(2)] += b * radiance[source + k + _U(2)]
                    image[target + k + _U(3)] += a * radiance[source + k + _U(3)]
