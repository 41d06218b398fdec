"""Splatting: draw the points of each labelled pixel's PSF into an image, runs of like pixels at a time (LKS 6.2)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import Image
from spreadlets.parallel import for_bands
from spreadlets.runtime.buffers import buffer
from spreadlets.runtime.splat import _resample_kernels, _splat_kernels
from spreadlets.runtime.splat._splat_kernels import Level, Window
from spreadlets.runtime.splat.passes import STRIDES, Canvas, PointTable, Runs

BAND_ROWS = 32
"""Rows that one thread owns at a time: a band of a 1024 px wide float4 image stays within a core's L2 cache."""


def splat_laplacian(
    canvas: Canvas, passes: Sequence[Sequence[Runs]], group: int, table: PointTable, step: int = 1
) -> Image:
    """Draw one group of sparse variants.

    Parameters
    ----------
    canvas : Canvas
        Every splat must lie within it.
    passes : sequence of sequences of Runs
        For each pass single pixels and blocks, of different strides.
    group : int
        The group to draw.
    table : PointTable
        Points of the variants.
    step : int
        Side, px, of the pixels that the Laplacians are summed in.

    Returns
    -------
    ndarray of shape (canvas.rows / step, canvas.cols / step, 4), float32
        The Laplacian image.
    """
    flat = [each for levels in passes for each in levels if len(each.of(group))]
    drawn = tuple(_joined([each for each in flat if each.source.stride == stride], group, canvas) for stride in STRIDES)
    pitch = 4 * canvas.cols
    variants = _variants(flat, group, table)
    offsets = buffer((len(STRIDES), len(table.offset_rc)), np.int32)
    points = table.point_start, table.offset_rc, canvas.cols, offsets
    for_bands(_splat_kernels.point_offsets, len(variants), variants, *points)
    window = Window(canvas.top, canvas.left, canvas.cols, int(table.reaches[variants].max(initial=0)))
    image = buffer((canvas.rows // step, pitch // step))

    def draw(begin: int, end: int) -> None:
        scratch = buffer((3, BAND_ROWS + step + 3, pitch))
        points = offsets, table.rows, table.lanes
        _splat_kernels.splat_levels(begin, end, image, drawn, *points, window, step, BAND_ROWS, scratch)

    for_bands(draw, -(-canvas.rows // BAND_ROWS))
    return image.reshape(len(image), -1, 4)


def add_to_canvas(image: Image, canvas: Canvas, placed: Image, own: Canvas, step: int) -> None:
    """Add an image of pixels of side ``step`` on a canvas of its own, as far as it lies within the other, in place."""
    rows, top, left = placed.reshape(len(placed), -1), own.top - canvas.top, own.left - canvas.left
    if step == 1:
        for_bands(_resample_kernels.add_placed, len(image), rows, top, left, image.reshape(len(image), -1))
    else:
        for_bands(_resample_kernels.add_enlarged, len(image), rows, top, left, step, image.reshape(len(image), -1))


def splat_direct(image: Image, canvas: Canvas, source: Runs, group: int, table: PointTable) -> None:
    """Add one group of direct variants to an image in place; arguments as for `splat_laplacian`, of stride 1."""
    if not len(source.of(group)):
        return
    spans = table.spans
    reach, longest = spans.extent
    window = Window(canvas.top, canvas.left, canvas.cols, reach)
    drawn = image.reshape(-1), _level(source, group, canvas), *spans, window, longest, BAND_ROWS
    for_bands(_splat_kernels.splat_spans, -(-canvas.rows // BAND_ROWS), *drawn)


def sum_rows(image: Image, sums: Image) -> Image:
    """Fill ``sums`` with an image's running sums along rows, and return it: differences along rows integrated."""
    for_bands(_splat_kernels.sum_rows, len(image), image, sums)
    return sums


def _variants(sources: Sequence[Runs], group: int, table: PointTable) -> npt.NDArray[np.int64]:
    """Return the variants that runs of a group have."""
    is_used = np.zeros(table.n_variants, np.bool_)
    for each in sources:
        is_used[each.of(group)[:, _splat_kernels.RUN_VARIANT]] = True
    return np.flatnonzero(is_used)


def _level(source: Runs, group: int, canvas: Canvas) -> Level:
    """Return the flattened colours, the runs, and where the runs of each row of the canvas begin."""
    runs = source.of(group)
    return Level(source.source.radiance.reshape(-1), runs, _row_start(runs, canvas))


def _row_start(runs: npt.NDArray[np.int32], canvas: Canvas) -> npt.NDArray[np.int64]:
    rows = canvas.top + np.arange(canvas.rows + 1)
    return np.searchsorted(runs[:, _splat_kernels.RUN_ROW], rows).astype(np.int64)


def _joined(sources: Sequence[Runs], group: int, canvas: Canvas) -> Level:
    """Do as `_level` for the runs of several passes of one stride."""
    if len(sources) == 1:
        return _level(sources[0], group, canvas)
    # Order the runs of all passes by row.
    parts = [each.of(group) for each in sources]
    runs = np.concatenate([np.zeros((0, 5), np.int32), *parts])
    order = np.argsort(runs[:, _splat_kernels.RUN_ROW], kind="stable")
    # Place their colours one behind another in that order.
    ends = np.cumsum(runs[order, _splat_kernels.RUN_LENGTH], dtype=np.int64)
    place = np.empty(len(runs), np.int64)
    place[order] = ends - runs[order, _splat_kernels.RUN_LENGTH]
    colours = np.empty(4 * int(ends[-1]) if len(ends) else 0, np.float32)
    # Collect the colours pass by pass.
    begin = 0
    for each, part in zip(sources, parts, strict=True):
        end = begin + len(part)
        source = each.source.radiance.reshape(-1)
        for_bands(_splat_kernels.collect_runs, len(part), source, part, place[begin:end], colours)
        begin = end
    # Point the runs to them.
    runs[:, _splat_kernels.RUN_SOURCE] = place
    runs = runs[order]
    return Level(colours, runs, _row_start(runs, canvas))
