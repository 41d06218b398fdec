"""Splatting: draw the points of each labelled pixel's PSF into an image, runs of like pixels at a time (LKS 6.2)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from runtime import _kernels

BAND_ROWS = 32
"""Rows that one thread owns at a time: a band of a 1024 px wide float4 image stays within a core's L2 cache."""

NO_SHIFT = np.zeros((0, 0, 2), np.int32)
"""The shift of a pass whose splats are centred on their pixels."""


class PointTable(NamedTuple):
    """The points of all variants of a plan, concatenated; each variant's points are sorted by row.

    Attributes
    ----------
    offset_rc : ndarray of shape (n_points, 2), int32
        Offsets from the splat's centre, px.
    value : ndarray of shape (n_points, C), float32
        Values; C is 1 or 3.
    point_start : ndarray of shape (n_variants + 1,), int64
        The points of variant i are ``point_start[i]`` to ``point_start[i + 1]``.
    direct : ndarray of shape (n_variants,), bool
        Whether a variant's points are the PSF itself rather than its Laplacian.
    """

    offset_rc: npt.NDArray[np.int32]
    value: npt.NDArray[np.float32]
    point_start: npt.NDArray[np.int64]
    direct: npt.NDArray[np.bool_]

    @property
    def n_points(self) -> npt.NDArray[np.int64]:
        """Number of points of each variant, shape (n_variants,)."""
        return np.diff(self.point_start)

    def reaches(self) -> npt.NDArray[np.int64]:
        """Return the largest distance, in rows or columns, from a splat's centre to a point of each variant, px."""
        if not len(self.direct):
            return np.zeros(0, np.int64)
        return np.maximum.reduceat(np.abs(self.offset_rc).max(axis=1), self.point_start[:-1]).astype(np.int64)

    def reach(self) -> int:
        """Return the largest of the `reaches`."""
        return int(self.reaches().max(initial=0))


class SplatPass(NamedTuple):
    """One rectangle of labelled pixels to be drawn: where, what, with which variant, and shifted by how much.

    Attributes
    ----------
    origin : tuple of two ints
        Row and column of the rectangle's first pixel in the frame; negative beyond its border.
    radiance : ndarray of shape (H, W, 4), float32
        Premultiplied colour.
    variant : ndarray of shape (H, W), int32
        Variant of each pixel, negative where nothing is drawn.
    shift : ndarray of shape (H, W, 2), int32, or `NO_SHIFT`
        Displacement (row, col) of the splat's centre from the pixel, px.
    stride : int
        Distance of neighbouring pixels in the frame, px: above 1 they stand for the first pixels of blocks.
    """

    origin: tuple[int, int]
    radiance: npt.NDArray[np.float32]
    variant: npt.NDArray[np.int32]
    shift: npt.NDArray[np.int32] = NO_SHIFT
    stride: int = 1


def splat(
    image: npt.NDArray[np.float32], source: SplatPass, table: PointTable, padding: int, wanted: npt.NDArray[np.bool_]
) -> None:
    """Draw the pixels of a pass whose variant is wanted into a padded image, in place.

    Parameters
    ----------
    image : ndarray of shape (rows, cols, 4), float32, contiguous
        Laplacian or direct image; the frame's first pixel lies at (padding, padding). Every splat must lie within it.
    source : SplatPass
        The pixels.
    table : PointTable
        Points of the variants.
    padding : int
        Border around the frame, px.
    wanted : ndarray of shape (n_variants,), bool
        The variants to draw.
    """
    runs = _kernels.find_runs(source.variant, source.shift, wanted)
    if not len(runs):
        return
    rows, cols = image.shape[:2]
    for column, first in ((_kernels.RUN_ROW, source.origin[0]), (_kernels.RUN_COL, source.origin[1])):
        runs[:, column] *= source.stride
        runs[:, column] += padding + first
    if source.shift is not NO_SHIFT:
        runs = np.ascontiguousarray(runs[np.argsort(runs[:, _kernels.RUN_ROW], kind="stable")])
    row_start = np.searchsorted(runs[:, _kernels.RUN_ROW], np.arange(rows + 1)).astype(np.int64)
    flat = image.reshape(-1), np.ascontiguousarray(source.radiance).reshape(-1), runs, row_start
    if table.direct[wanted].all():
        spans, value, span_of_variant = _spans(table, cols)
        _kernels.splat_spans(*flat, spans, value, span_of_variant, cols, BAND_ROWS)
    else:
        row, col = table.offset_rc.T
        points = np.ascontiguousarray(row), 4 * (row.astype(np.int64) * cols + col)
        _kernels.splat_runs(*flat, points, table.value, table.point_start, (cols, source.stride), BAND_ROWS)


def _spans(
    table: PointTable, cols: int
) -> tuple[tuple[npt.NDArray[np.int64], ...], npt.NDArray[np.float32], npt.NDArray[np.int64]]:
    """Group points that are neighbours in a row; see `runtime._kernels.splat_spans` for what is returned."""
    row, col = table.offset_rc.T.astype(np.int64)
    breaks = np.ones(len(row), np.bool_)
    breaks[1:] = (np.diff(row) != 0) | (np.diff(col) != 1)
    breaks[table.point_start[:-1]] = True
    first = np.flatnonzero(breaks)
    spans = row[first], 4 * (row[first] * cols + col[first]), np.append(first, len(row))
    lanes = [0, 0, 0, 0] if table.value.shape[1] == 1 else [0, 1, 2, 3]
    coloured = np.concatenate([table.value, table.value.mean(axis=1, keepdims=True)], axis=1)
    return spans, coloured[:, lanes].reshape(-1), np.searchsorted(first, table.point_start)


def gather(source: SplatPass, table: PointTable) -> npt.NDArray[np.float32]:
    """Filter a layer: each pixel becomes the mean of its surroundings under its own PSF (LKS section 7, FILTERING).

    Parameters
    ----------
    source : SplatPass
        The pixels of the frame; shifts are ignored, as a filter has no place to move light to.
    table : PointTable
        Direct points of the variants.

    Returns
    -------
    ndarray of shape (H, W, 4), float32
        Zero where the variant is negative. Beyond the border the frame's edge is repeated.
    """
    padding = table.reach()
    padded = np.pad(source.radiance, ((padding, padding), (padding, padding), (0, 0)), mode="edge")
    runs = _kernels.find_runs(source.variant, NO_SHIFT, np.ones(len(table.direct), np.bool_))
    runs[:, [_kernels.RUN_ROW, _kernels.RUN_COL]] += padding
    # A filter mirrors its kernel: the light under offset d is light that a splat would have moved by -d.
    row, col = -table.offset_rc.T.astype(np.int64)
    cols = padded.shape[1]
    image = np.zeros_like(source.radiance)
    _kernels.gather_runs(
        image.reshape(-1), padded.reshape(-1), runs, 4 * (row * cols + col), table.value, table.point_start, cols
    )
    return image
