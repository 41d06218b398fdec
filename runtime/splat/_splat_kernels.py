"""Compiled kernels of the splat step: runs of like pixels, drawn as contiguous multiply-adds.

Indices into images are unsigned: a signed index would be checked for wrap-around at each access, which keeps the
compiler from vectorising.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import Image
from spreadlets.compiled import helper, kernel
from spreadlets.runtime._vector_kernels import TWO_PIXELS, add, load, load_two, multiply, store
from spreadlets.runtime.splat._resample_kernels import shrink_row

RUN_SOURCE, RUN_ROW, RUN_COL, RUN_LENGTH, RUN_VARIANT = range(5)
"""Columns of the table of runs: first pixel in the flattened source; row and column in the frame; length; variant."""

LONG_RUN = 16
"""Pixels from which a run is drawn along itself rather than along the rows of a direct PSF."""

_U = np.uint64


class Level(NamedTuple):
    """What is drawn of one stride.

    Attributes
    ----------
    radiance : ndarray of shape (n_pixels * 4,), float32
        Flattened colours.
    runs : ndarray of shape (n_runs, 5), int32
        See `RUN_SOURCE`; sorted by row (`test_runs_of_a_group_are_sorted_by_row`).
    row_start : ndarray of shape (rows + 1,), int64
        Where the runs of each row of the canvas begin.
    """

    radiance: Image
    runs: npt.NDArray[np.int32]
    row_start: npt.NDArray[np.int64]


class Window(NamedTuple):
    """Row and column, in the frame, of a canvas's first pixel; its columns; and how far a splat may reach, px."""

    top: int
    left: int
    cols: int
    reach: int


class PointRows(NamedTuple):
    """Where the points of each row of each variant begin, see `rows_of_points`."""

    first: npt.NDArray[np.int64]
    base: npt.NDArray[np.int64]
    reach: npt.NDArray[np.int64]


class SpanPlaces(NamedTuple):
    """Row and column (n_spans,) of the first point of each span; where its points begin (n_spans + 1,); all int64."""

    row: npt.NDArray[np.int64]
    col: npt.NDArray[np.int64]
    start: npt.NDArray[np.int64]


@helper
def _run_end(label, shift, row, col):
    """Return the column behind the run that starts at (row, col): same label and, if there are shifts, same shift."""
    width = label.shape[1]
    end = col + 1
    while end < width and label[row, end] == label[row, col]:
        if shift.shape[0] and (shift[row, end, 0] != shift[row, col, 0] or shift[row, end, 1] != shift[row, col, 1]):
            break
        end += 1
    return end


@kernel
def count_runs(begin, end, label, shift, group, count):
    """Count the runs of neighbouring pixels in a row that share a label and a shift.

    Parameters
    ----------
    label : ndarray of shape (H, W), int32
        Label of each pixel; negative where nothing is drawn.
    shift : ndarray of shape (H, W, 2), int32, or (0, 0, 2)
        Displacement (row, col) of each pixel's splat centre, px; empty if there is none.
    group : ndarray of shape (n_labels,), int64
        The group that runs of each label go to.
    count : ndarray of shape (n_groups, H), int64
        Filled with the runs of each group in each row.
    """
    height, width = label.shape
    for row in range(begin, end):
        count[:, row] = 0
        col = 0
        while col < width:
            end = _run_end(label, shift, row, col)
            if label[row, col] >= 0:
                count[group[label[row, col]], row] += 1
            col = end


@kernel
def list_runs(begin, end, label, shift, group, start, origin, stride, n_variants, runs):
    """List the runs of `count_runs`, those of a group together, in raster order.

    Parameters
    ----------
    label, shift, group
        As for `count_runs`.
    start : ndarray of shape (n_groups, H), int64
        Where the runs of each group in each row begin in the list.
    origin : tuple of two ints
        Row and column, in the frame, of the first pixel.
    stride : int
        Distance of neighbouring pixels in the frame, px.
    n_variants : int
        A label is ``layer * n_variants + variant``.
    runs : ndarray of shape (n_runs, 5), int32
        Filled; see `RUN_SOURCE`.
    """
    height, width = label.shape
    for row in range(begin, end):
        at = start[:, row].copy()
        col = 0
        while col < width:
            # A run is neighbours of one label and, if there are any, one displacement.
            end = _run_end(label, shift, row, col)
            if label[row, col] >= 0:
                # Append it to the runs of its group.
                i = at[group[label[row, col]]]
                at[group[label[row, col]]] += 1
                runs[i, RUN_SOURCE] = row * width + col
                runs[i, RUN_ROW] = origin[0] + stride * row
                runs[i, RUN_COL] = origin[1] + stride * col
                # Displace it.
                if shift.shape[0]:
                    runs[i, RUN_ROW] += shift[row, col, 0]
                    runs[i, RUN_COL] += shift[row, col, 1]
                runs[i, RUN_LENGTH] = end - col
                runs[i, RUN_VARIANT] = label[row, col] % n_variants
            col = end


@kernel
def collect_runs(begin, end, radiance, runs, place, colours):
    """Copy the colours of runs together.

    Parameters
    ----------
    radiance : ndarray of shape (H * W * 4,), float32
        Flattened source.
    runs : ndarray of shape (n_runs, 5), int32
    place : ndarray of shape (n_runs,), int64
        The first pixel of each run in the collection.
    colours : ndarray of shape (n_pixels * 4,), float32
        Filled at these places.
    """
    for i in range(begin, end):
        source, target = _U(4) * _U(runs[i, RUN_SOURCE]), _U(4) * _U(place[i])
        for k in range(_U(4) * _U(runs[i, RUN_LENGTH])):
            colours[target + k] = radiance[source + k]


@kernel
def run_bounds(runs, reach, stride):
    """Return the first row and column that the splats of runs may touch, and those behind the last."""
    top, left, bottom, right = 1 << 30, 1 << 30, -(1 << 30), -(1 << 30)
    for i in range(runs.shape[0]):
        far = reach[runs[i, RUN_VARIANT]]
        top = min(top, runs[i, RUN_ROW] - far)
        bottom = max(bottom, runs[i, RUN_ROW] + stride + far)
        left = min(left, runs[i, RUN_COL] - far)
        right = max(right, runs[i, RUN_COL] + stride * runs[i, RUN_LENGTH] + far)
    return top, left, bottom, right


@kernel
def rows_of_points(offset_rc, point_start, reach, base, first):
    """List, for each variant, where the points of each row begin.

    Parameters
    ----------
    offset_rc : ndarray of shape (n_points, 2), int32
        Rows ascending within a variant (`test_points_of_a_variant_are_sorted_by_row`).
    point_start : ndarray of shape (n_variants + 1,), int64
    reach : ndarray of shape (n_variants,), int64
        No row of the variant lies farther from 0 than this.
    base : ndarray of shape (n_variants + 1,), int64
        Cumulative sum of ``2 reach + 2``.
    first : ndarray of shape (base[-1],), int64
        Filled: the points of variant v from row r on begin at ``first[base[v] + r + reach[v]]``.
    """
    for variant in range(len(reach)):
        p = point_start[variant]
        for k in range(2 * reach[variant] + 2):
            while p < point_start[variant + 1] and offset_rc[p, 0] < k - reach[variant]:
                p += 1
            first[base[variant] + k] = p


@kernel
def list_spans(offset_rc, lanes, point_start, direct, spans, value, span_of_variant):
    """List the points of direct variants, those together that are neighbours in a row; return the number of spans.

    Parameters
    ----------
    offset_rc : ndarray of shape (n_points, 2), int32
    lanes : ndarray of shape (n_points, 1 or 4), float32
    point_start : ndarray of shape (n_variants + 1,), int64
    direct : ndarray of shape (n_variants,), bool
    spans : SpanPlaces
        Filled as far as there are spans; there is room for one of each point.
    value : ndarray of shape (4 * n_direct_points,), float32
        Filled with the values of the points.
    span_of_variant : ndarray of shape (n_variants + 1,), int64
        Filled with where the spans of each variant begin.
    """
    last, n_spans, n_points = lanes.shape[1] - 1, 0, 0
    for variant in range(len(direct)):
        span_of_variant[variant] = n_spans
        if not direct[variant]:
            continue
        for p in range(point_start[variant], point_start[variant + 1]):
            row, col = offset_rc[p, 0], offset_rc[p, 1]
            # A span ends where a variant, a row or a stretch of neighbours does.
            if p == point_start[variant] or row != offset_rc[p - 1, 0] or col != offset_rc[p - 1, 1] + 1:
                spans.row[n_spans], spans.col[n_spans], spans.start[n_spans] = row, col, n_points
                n_spans += 1
            for c in range(4):
                value[4 * n_points + c] = lanes[p, min(c, last)]
            n_points += 1
    span_of_variant[len(direct)], spans.start[n_spans] = n_spans, n_points
    return n_spans


@kernel
def point_offsets(begin, end, variants, point_start, offset_rc, cols, offsets):
    """Turn the offsets of some variants into places in flattened images of strides 1, 2 and 4, see `_spread`.

    Parameters
    ----------
    variants : ndarray of shape (n,), int64
    point_start : ndarray of shape (n_variants + 1,), int64
    offset_rc : ndarray of shape (n_points, 2), int32
    cols : int
        Columns of the images, a multiple of 4 (`test_canvases_begin_and_end_at_blocks_of_every_stride`).
    offsets : ndarray of shape (3, n_points), int32
        Filled, in floats.
    """
    for i in range(begin, end):
        for p in range(point_start[variants[i]], point_start[variants[i] + 1]):
            row, col = np.int64(offset_rc[p, 0]) * 4 * cols, np.int64(offset_rc[p, 1])
            offsets[0, p] = row + 4 * col
            # Shifts and masks take the floor of negative columns, too.
            offsets[1, p] = row + 4 * ((col & 1) * (cols >> 1) + (col >> 1))
            offsets[2, p] = row + 4 * ((col & 3) * (cols >> 2) + (col >> 2))


@helper
def _runs_near(level, first_row, n_rows, farthest):
    """Return the runs of a level that may reach ``n_rows`` rows of the canvas from ``first_row`` on: first, end."""
    rows = level.row_start.shape[0] - 1
    first = level.row_start[min(max(first_row - farthest, 0), rows)]
    return first, level.row_start[min(max(first_row + n_rows + farthest, 0), rows)]


@helper
def _draw_pixel(image, radiance, source, target, point_offset, value, begin, end):
    """Add one pixel, times the value of each point, at the places of the points."""
    colour = load(radiance, source)
    for p in range(_U(begin), _U(end)):
        o = _U(target + point_offset[p])
        weight = value[p, 0]
        store(image, o, add(load(image, o), multiply((weight, weight, weight, weight), colour)))


@helper
def _add_scaled(image, to, radiance, source, n, weight):
    """Add n floats of contiguous pixels, times a weight for each channel, to others; two pixels at once."""
    twice, pairs = weight + weight, n - n % _U(TWO_PIXELS)
    for k in range(_U(0), pairs, _U(TWO_PIXELS)):
        store(image, to + k, add(load_two(image, to + k), multiply(twice, load_two(radiance, source + k))))
    if pairs < n:
        to += pairs
        store(image, to, add(load(image, to), multiply(weight, load(radiance, source + pairs))))


@helper
def _draw_run(image, radiance, source, target, n, point_offset, value, begin, end):
    """Add n floats of contiguous pixels, times the value of each point, at the places of the points."""
    for p in range(_U(begin), _U(end)):
        weight = value[p, 0], value[p, 0], value[p, 0], value[p, 0]
        _add_scaled(image, _U(target + point_offset[p]), radiance, source, n, weight)


@helper
def _draw_coloured_run(image, radiance, source, target, n, point_offset, value, begin, end):
    """Do as `_draw_run` with a value for each of R, G, B and alpha."""
    for p in range(_U(begin), _U(end)):
        weight = value[p, 0], value[p, 1], value[p, 2], value[p, 3]
        _add_scaled(image, _U(target + point_offset[p]), radiance, source, n, weight)


@helper
def _draw_rows(target, first_row, n_rows, level, stride, point_offset, points, value, window):
    """Draw what the runs of a level add to ``n_rows`` rows of the canvas, from ``first_row`` on, into ``target``."""
    radiance, runs, reach = level.radiance, level.runs, points.reach
    first_run, end_run = _runs_near(level, first_row, n_rows, window.reach)
    for i in range(first_run, end_run):
        variant = runs[i, RUN_VARIANT]
        row = runs[i, RUN_ROW] - window.top - first_row
        last = 2 * reach[variant] + 1
        begin = points.first[points.base[variant] + min(max(reach[variant] - row, 0), last)]
        end = points.first[points.base[variant] + min(max(reach[variant] + n_rows - row, 0), last)]
        if begin == end:
            continue
        source = _U(4) * _U(runs[i, RUN_SOURCE])
        # The column of a canvas's first pixel fits the stride, see `splat_levels`.
        at = np.int64(row) * 4 * window.cols + 4 * ((runs[i, RUN_COL] - window.left) // stride)
        n = _U(4) * _U(runs[i, RUN_LENGTH])
        if value.shape[1] == 4:
            _draw_coloured_run(target, radiance, source, at, n, point_offset, value, begin, end)
        elif n == _U(4):
            _draw_pixel(target, radiance, source, at, point_offset, value, begin, end)
        else:
            _draw_run(target, radiance, source, at, n, point_offset, value, begin, end)


@helper
def _spread(target, source, n_rows, stride, pitch):
    """Add to each pixel of the target those of the source that lie 0 and ``stride / 2`` above and to the left.

    The source's first row lies ``stride / 2`` above the target's. An image of stride s keeps the columns c of equal
    ``c % s`` together: such a row is s stretches, in each of which the pixels of blocks are neighbours.
    """
    half = stride // 2
    n = _U(4 * (pitch // (4 * stride)))
    for row in range(n_rows):
        above = _U(row * pitch)
        here = _U((row + half) * pitch)
        out = _U(row * pitch)
        for phase in range(stride):
            # Column s i + phase lies at i of its stretch; in the target at 2 i + phase // half of stretch phase % half.
            own = _U(phase) * n
            beside = _U((phase + half) % stride) * n
            back = _U(0) if phase >= half else _U(4)
            o = out + _U(phase % half) * (n + n) + _U(4 * (phase // half))
            if back:
                store(target, o, add(load(target, o), add(load(source, here + own), load(source, above + own))))
            for k in range(back, n, _U(4)):
                i, j = own + k, beside + k - back
                left = add(load(source, here + i), load(source, above + i))
                right = add(load(source, here + j), load(source, above + j))
                store(target, o + k + k, add(load(target, o + k + k), add(left, right)))


# fastmath stays off: a product and a sum for each element leave nothing to reorder, and results stay exact.
@kernel
def splat_levels(begin, end, image, levels, offsets, points, value, window, step, band_rows, scratch):
    """Draw every run with the points of its variant: each point adds the run, scaled, as one contiguous stretch.

    Blocks of 4 x 4 pixels are drawn by their first pixels, and spread by half their side; with blocks of 2 x 2 added
    the same is done again, and single pixels are added last. What is smooth is then summed over coarser pixels. All of
    it happens in bands of rows that stay in a core's cache. Bands are independent (each row is summed in the order of
    the runs), so the result is the same for any number of threads.

    Parameters
    ----------
    image : ndarray of shape (rows / step, cols / step * 4), float32
        Overwritten; rows and cols are multiples of 4 (`test_canvases_begin_and_end_at_blocks_of_every_stride`).
    levels : tuple of three Levels
        Of strides 1, 2 and 4.
    offsets : ndarray of shape (3, n_points), int32
        See `point_offsets`.
    points : PointRows
    value : ndarray of shape (n_points, 1) or (n_points, 4), float32
        For all channels, or for each of R, G, B and alpha.
    window : Window
        The image's place. It fits all strides: it differs from those of blocks by multiples of 4.
    step : int
        Side of the image's pixels: 1, 2 or 4 px.
    band_rows : int
        Height of a band, px; a multiple of 4.
    scratch : ndarray of shape (3, band_rows + step + 3, cols * 4), float32
        Of this call alone.
    """
    pitch = 4 * window.cols
    rows = step * image.shape[0]
    level_1, level_2, level_4 = levels
    twos, fours = scratch[1].reshape(scratch[1].size), scratch[0].reshape(scratch[0].size)
    around = step // 2
    for band in range(begin, end):
        # Clear the band, and what coarser pixels reach beyond it.
        first_row = band * band_rows - around
        n_rows = min(band_rows, rows - band * band_rows) + 2 * around
        if step == 1:
            target = image[first_row : first_row + n_rows].reshape(n_rows * pitch)
        else:
            target = scratch[2, :n_rows].reshape(n_rows * pitch)
        target[:] = np.float32(0.0)
        # Find the blocks that reach the band, or the rows above it that spreading needs.
        first_2, end_2 = _runs_near(level_2, first_row - 1, n_rows + 1, window.reach)
        first_4, end_4 = _runs_near(level_4, first_row - 3, n_rows + 3, window.reach)
        if first_2 < end_2 or first_4 < end_4:
            twos[: (n_rows + 1) * pitch] = np.float32(0.0)
            if first_4 < end_4:
                fours[: (n_rows + 3) * pitch] = np.float32(0.0)
                # Draw blocks of 4 x 4, and spread them to 2 x 2.
                _draw_rows(fours, first_row - 3, n_rows + 3, level_4, np.int64(4), offsets[2], points, value, window)
                _spread(twos, fours, n_rows + 1, np.int64(4), pitch)
            # Draw blocks of 2 x 2, and spread both to pixels.
            _draw_rows(twos, first_row - 1, n_rows + 1, level_2, np.int64(2), offsets[1], points, value, window)
            _spread(target, twos, n_rows, np.int64(2), pitch)
        # Draw single pixels.
        _draw_rows(target, first_row, n_rows, level_1, np.int64(1), offsets[0], points, value, window)
        # Sum all over coarser pixels.
        if step > 1:
            first = band * band_rows // step
            for row in range(n_rows // step - 1):
                shrink_row(image[first + row], target, row, step, pitch, twos)


@helper
def _first_point(row, begin, end, wanted):
    """Return the first point of [begin, end) whose row is at least ``wanted``; the rows are sorted."""
    while begin < end:
        middle = (begin + end) // 2
        if row[middle] < wanted:
            begin = middle + 1
        else:
            end = middle
    return begin


@helper
def _draw_direct_run(image, radiance, source, target, n, cols, spans, value, bounds, tiled):
    """Add n pixels to each span from ``bounds[0]`` to ``bounds[1]``, along whichever of the two is longer."""
    begin, end = bounds
    if n >= LONG_RUN:
        # Long runs: add the run, scaled by each value of a span.
        for span in range(begin, end):
            o = _U(target + 4 * (spans.row[span] * cols + spans.col[span]))
            for p in range(_U(4 * spans.start[span]), _U(4 * spans.start[span + 1]), _U(4)):
                _add_scaled(image, o, radiance, source, _U(4 * n), load(value, p))
                o += _U(4)
        return
    # Short runs: add the span, scaled by the colour of each pixel.
    for pixel in range(n):
        for k in range(len(tiled)):
            tiled[k] = radiance[source + _U(4 * pixel + (k & 3))]
        for span in range(begin, end):
            o = _U(target + 4 * (pixel + spans.row[span] * cols + spans.col[span]))
            first = _U(4 * spans.start[span])
            for k in range(_U(4 * (spans.start[span + 1] - spans.start[span]))):
                image[o + _U(k)] += value[first + _U(k)] * tiled[_U(k)]


@kernel
def splat_spans(begin, end, image, level, spans, value, span_of_variant, window, longest, band_rows):
    """Draw every run with a direct PSF, whose points are neighbours in rows: the counterpart of `splat_levels`.

    Short runs are drawn pixel by pixel, each span of the PSF as one contiguous stretch; long ones point by point, each
    point adding the run as one contiguous stretch.

    Parameters
    ----------
    image : ndarray of shape (rows * cols * 4,), float32
        Accumulated in place.
    level : Level
        Of stride 1.
    spans : SpanPlaces
        Rows ascend within a variant.
    value : ndarray of shape (n_points * 4,), float32
        Values of the points for R, G, B and alpha.
    span_of_variant : ndarray of shape (n_variants + 1,), int64
        The spans of each variant.
    window : Window
        The image's place; its reach is the largest row of a span, up or down.
    longest : int
        The most points of a span.
    band_rows : int
        Height of a band.
    """
    radiance, runs, row_start = level.radiance, level.runs, level.row_start
    cols, reach = window.cols, window.reach
    rows = row_start.shape[0] - 1
    tiled = np.empty(4 * longest, np.float32)
    for band in range(begin, end):
        begin_row = band * band_rows
        end_row = min(begin_row + band_rows, rows)
        for i in range(row_start[max(begin_row - reach, 0)], row_start[min(end_row + reach, rows)]):
            row, length, variant = runs[i, RUN_ROW] - window.top, runs[i, RUN_LENGTH], runs[i, RUN_VARIANT]
            first = _first_point(spans.row, span_of_variant[variant], span_of_variant[variant + 1], begin_row - row)
            last = _first_point(spans.row, first, span_of_variant[variant + 1], end_row - row)
            if first == last:
                continue
            source = _U(4) * _U(runs[i, RUN_SOURCE])
            target = 4 * (np.int64(row) * cols + runs[i, RUN_COL] - window.left)
            _draw_direct_run(image, radiance, source, target, length, cols, spans, value, (first, last), tiled)


@kernel
def gather_runs(begin, end, image, radiance, runs, point_offset, value, point_start, cols):
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
    value : ndarray of shape (n_points, 1) or (n_points, 4), float32
        The PSF's pixels, for all channels or for each.
    point_start : ndarray of shape (n_variants + 1,), int64
    cols : int
        Width of the padded input, px.
    """
    for i in range(begin, end):
        variant = runs[i, RUN_VARIANT]
        target = _U(4) * _U(runs[i, RUN_SOURCE])
        centre = 4 * (np.int64(runs[i, RUN_ROW]) * cols + runs[i, RUN_COL])
        n = _U(4) * _U(runs[i, RUN_LENGTH])
        for p in range(point_start[variant], point_start[variant + 1]):
            source = _U(centre + point_offset[p])
            if value.shape[1] == 1:
                weight = value[p, 0]
                for k in range(n):
                    image[target + _U(k)] += weight * radiance[source + _U(k)]
            else:
                weight = value[p, 0], value[p, 1], value[p, 2], value[p, 3]
                _add_scaled(image, target, radiance, source, n, weight)


@kernel
def sum_rows(begin, end, image, sums):
    """Fill ``sums`` with the running sums along rows of an image, both (rows, cols, 4), float32."""
    total = np.empty(4, np.float64)
    for row in range(begin, end):
        total[:] = 0.0
        for col in range(image.shape[1]):
            for c in range(4):
                total[c] += image[row, col, c]
                sums[row, col, c] = total[c]
