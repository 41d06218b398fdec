"""Splatting: draw the points of each labelled pixel's PSF into an image, runs of like pixels at a time (LKS 6.2)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from runtime import _kernels

BAND_ROWS = 32
"""Rows that one thread owns at a time: a band of a 1024 px wide float4 image stays within a core's L2 cache."""


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
    """One image of labelled pixels to be drawn: what, with which variant, and shifted by how much.

    Attributes
    ----------
    radiance : ndarray of shape (H, W, 4), float32
        Premultiplied colour.
    variant : ndarray of shape (H, W), int32
        Variant of each pixel, negative where nothing is drawn.
    shift : ndarray of shape (H, W, 2), int32
        Displacement (row, col) of the splat's centre from the pixel, px.
    """

    radiance: npt.NDArray[np.float32]
    variant: npt.NDArray[np.int32]
    shift: npt.NDArray[np.int32]


def splat(
    image: npt.NDArray[np.float32], source: SplatPass, table: PointTable, padding: int, wanted: npt.NDArray[np.bool_]
) -> None:
    """Draw the pixels of a pass whose variant is wanted into a padded image, in place.

    Parameters
    ----------
    image : ndarray of shape (H + 2 padding, W + 2 padding, 4), float32
        Laplacian or direct image; pixel (0, 0) of the pass, of shape (H, W), lies at (padding, padding).
    source : SplatPass
        The pixels; every splat must lie within the padded image.
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
    runs[:, _kernels.RUN_TARGET_ROW] += padding
    runs[:, _kernels.RUN_TARGET_COL] += padding
    target_row = runs[:, _kernels.RUN_TARGET_ROW]
    if (np.diff(target_row) < 0).any():
        runs = np.ascontiguousarray(runs[np.argsort(target_row, kind="stable")])
        target_row = runs[:, _kernels.RUN_TARGET_ROW]
    row_start = np.searchsorted(target_row, np.arange(image.shape[0] + 1)).astype(np.int64)
    _kernels.splat_runs(
        image, source.radiance, runs, row_start, table.offset_rc, table.value, table.point_start, BAND_ROWS
    )
