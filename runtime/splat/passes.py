"""What is drawn: points of PSF variants, passes of labelled pixels, and their runs of like pixels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import Image
from spreadlets.parallel import for_bands
from spreadlets.runtime.label.labels import NO_SHIFT
from spreadlets.runtime.splat import _splat_kernels
from spreadlets.runtime.splat._splat_kernels import PointRows, SpanPlaces

STRIDES = (1, 2, 4)
"""Sides of the blocks, px, that can be drawn as one; and of the pixels of the images that Laplacians are drawn into."""
DIRECT = len(STRIDES)
GROUPS = DIRECT + 1
"""What is drawn of a layer, in groups: sparse variants by the side of their pixels, as `STRIDES`; then direct ones."""


class Spans(NamedTuple):
    """Direct points that are neighbours in rows: see `runtime.splat._splat_kernels.splat_spans`.

    Attributes
    ----------
    places : SpanPlaces
    value : ndarray of shape (n_points * 4,), float32
        Values of the points for R, G, B and alpha.
    span_of_variant : ndarray of shape (n_variants + 1,), int64
        Where the spans of each variant begin.
    """

    places: SpanPlaces
    value: Image
    span_of_variant: npt.NDArray[np.int64]

    @property
    def extent(self) -> tuple[int, int]:
        """The largest row of a span, up or down, and the most points of a span."""
        return int(np.abs(self.places.row).max(initial=0)), int(np.diff(self.places.start).max(initial=0))


@dataclass(frozen=True, eq=False)
class PointTable:
    """The points of all variants of a plan, concatenated; each variant's points are sorted by row.

    Attributes
    ----------
    offset_rc : ndarray of shape (n_points, 2), int32
        Offsets from the splat's centre, px.
    value : ndarray of shape (n_points, C), float32
        Values; C is 1 or 3.
    point_start : ndarray of shape (n_variants + 1,), int64
        The points of variant i are ``point_start[i]`` to ``point_start[i + 1]``.
    group : ndarray of shape (n_variants,), int64
        `DIRECT` if a variant's points are the PSF itself; else they are its Laplacian, drawn into an image of pixels
        whose side is that of `STRIDES`.
    """

    offset_rc: npt.NDArray[np.int32]
    value: Image
    point_start: npt.NDArray[np.int64]
    group: npt.NDArray[np.int64]

    @property
    def n_variants(self) -> int:
        """Number of variants."""
        return len(self.group)

    @cached_property
    def direct(self) -> npt.NDArray[np.bool_]:
        """Whether each variant's points are the PSF itself."""
        return np.asarray(self.group == DIRECT)

    @property
    def n_points(self) -> npt.NDArray[np.int64]:
        """Number of points of each variant, shape (n_variants,)."""
        return np.diff(self.point_start)

    @cached_property
    def reaches(self) -> npt.NDArray[np.int64]:
        """The largest distance, in rows or columns, from a splat's centre to a point of each variant, px."""
        if not len(self.direct):
            return np.zeros(0, np.int64)
        farthest = np.maximum(*np.abs(self.offset_rc).T)
        return np.maximum.reduceat(farthest, self.point_start[:-1]).astype(np.int64)

    @cached_property
    def lanes(self) -> Image:
        """The values as kernels take them: of shape (n_points, 1), or (n_points, 4) with the mean for alpha."""
        if self.value.shape[1] == 1:
            return self.value
        return np.concatenate([self.value, self.value.mean(axis=1, keepdims=True)], axis=1)

    @cached_property
    def spans(self) -> Spans:
        """The points of direct variants, those grouped that are neighbours in a row."""
        n_points = int(self.n_points[self.direct].sum())
        row, col, start = np.empty((3, n_points + 1), np.int64)
        value, span_of_variant = np.empty(4 * n_points, np.float32), np.empty(self.n_variants + 1, np.int64)
        points = self.offset_rc, self.lanes, self.point_start, self.direct
        n = _splat_kernels.list_spans(*points, SpanPlaces(row, col, start), value, span_of_variant)
        return Spans(SpanPlaces(row[:n], col[:n], start[: n + 1]), value, span_of_variant)

    @cached_property
    def rows(self) -> PointRows:
        """Where the points of each row of each variant begin."""
        base = np.concatenate([[0], np.cumsum(2 * self.reaches + 2)]).astype(np.int64)
        first = np.empty(base[-1], np.int64)
        _splat_kernels.rows_of_points(self.offset_rc, self.point_start, self.reaches, base, first)
        return PointRows(first, base, self.reaches)


class SplatPass(NamedTuple):
    """One rectangle of labelled pixels to be drawn: where, what, with which variant, and shifted by how much.

    Attributes
    ----------
    origin : tuple of two ints
        Row and column of the rectangle's first pixel in the frame; negative beyond its border. Where there are blocks,
        the columns of passes differ by multiples of 4, see `canvas_of`.
    radiance : ndarray of shape (H, W, 4), float32
        Premultiplied colour, C-contiguous.
    label : ndarray of shape (H, W), int32
        ``layer * n_variants + variant`` of each pixel, negative where nothing is drawn.
    shift : ndarray of shape (H, W, 2), int32, or `NO_SHIFT`
        Displacement (row, col) of the splat's centre from the pixel, px.
    stride : int
        Distance of neighbouring pixels in the frame, px: above 1 they stand for the first pixels of blocks.
    """

    origin: tuple[int, int]
    radiance: Image
    label: npt.NDArray[np.int32]
    shift: npt.NDArray[np.int32] = NO_SHIFT
    stride: int = 1


class Runs(NamedTuple):
    """The runs of like pixels of a pass, by group: ``GROUPS * layer`` plus that of the variant, see `PointTable`.

    Attributes
    ----------
    source : SplatPass
    runs : ndarray of shape (n_runs, 5), int32
        See `runtime.splat._splat_kernels.RUN_SOURCE`; sorted by group, then by row.
    start : ndarray of shape (n_groups + 1,), int64
        Where the runs of each group begin.
    """

    source: SplatPass
    runs: npt.NDArray[np.int32]
    start: npt.NDArray[np.int64]

    def of(self, group: int) -> npt.NDArray[np.int32]:
        """Return the runs of a group."""
        return self.runs[self.start[group] : self.start[group + 1]]


class Canvas(NamedTuple):
    """A rectangle of the frame, px; it may reach beyond the frame's border."""

    top: int
    left: int
    rows: int
    cols: int


def find_runs(source: SplatPass, table: PointTable, n_layers: int) -> Runs:
    """List the runs of neighbouring pixels of a pass that share a label and a shift."""
    group = (GROUPS * np.arange(n_layers)[:, None] + table.group).astype(np.int64).ravel()
    count = np.empty((GROUPS * n_layers, source.label.shape[0]), np.int64)
    for_bands(_splat_kernels.count_runs, count.shape[1], source.label, source.shift, group, count)
    ends = np.cumsum(count.ravel())
    start = np.concatenate([[0], ends[count.shape[1] - 1 :: count.shape[1]]])
    runs = np.empty((int(start[-1]), 5), np.int32)
    first = (ends - count.ravel()).reshape(count.shape)
    pixels, place = (source.label, source.shift, group), (source.origin, source.stride)
    for_bands(_splat_kernels.list_runs, count.shape[1], *pixels, first, *place, table.n_variants, runs)
    if source.shift is not NO_SHIFT:
        for begin, end in zip(start[:-1], start[1:], strict=True):
            runs[begin:end] = runs[begin:end][np.argsort(runs[begin:end, _splat_kernels.RUN_ROW], kind="stable")]
    return Runs(source, runs, start)


def canvas_of(
    sources: Sequence[Runs], group: int, table: PointTable, margin: int, corner: tuple[int, int]
) -> Canvas | None:
    """Return the rectangle that holds all splats of a group and a margin, or None if there are no splats.

    Its sides lie at multiples of the largest stride, counted from the picture's centre, of which ``corner`` is the row
    and column of the frame's first pixel: so blocks of any stride fit it.
    """
    bounds = [
        _splat_kernels.run_bounds(each.of(group), table.reaches, each.source.stride)
        for each in sources
        if len(each.of(group))
    ]
    if not bounds:
        return None
    sides = zip((min, min, max, max), zip(*bounds, strict=True), strict=True)
    top, left, bottom, right = (int(pick(side)) for pick, side in sides)
    (top, rows), (left, cols) = (
        _whole_blocks(begin - margin, end + margin, at)
        for begin, end, at in zip((top, left), (bottom, right), corner, strict=True)
    )
    return Canvas(top, left, rows, cols)


def _whole_blocks(begin: int, end: int, at: int) -> tuple[int, int]:
    """Widen a stretch until both ends, counted from ``-at``, are multiples of the largest stride; return its size."""
    begin -= (begin + at) % STRIDES[-1]
    return begin, end - begin + (begin - end) % STRIDES[-1]


def union(canvases: Sequence[Canvas]) -> Canvas:
    """Return the smallest rectangle that holds some others."""
    top, left = min(each.top for each in canvases), min(each.left for each in canvases)
    bottom, right = max(each.top + each.rows for each in canvases), max(each.left + each.cols for each in canvases)
    return Canvas(top, left, bottom - top, right - left)


def within(canvas: Canvas, shape: tuple[int, ...]) -> Canvas:
    """Return the part of a canvas that lies within a frame of a shape; without rows or columns, if none does."""
    (top, rows), (left, cols) = (
        (max(begin, 0), max(min(begin + size, side) - max(begin, 0), 0))
        for begin, size, side in zip((canvas.top, canvas.left), (canvas.rows, canvas.cols), shape, strict=False)
    )
    return Canvas(top, left, rows, cols)
