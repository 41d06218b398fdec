"""Planning: from a layer's labels alone, which PSF variants the frame needs, and nothing else."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from runtime import _plan_kernels
from runtime.border import extended_pass
from runtime.merge import merge_blocks
from runtime.splat import PointTable, SplatPass
from runtime.variant import SHARP, DensePsf, Variant, variant_points
from spreadlets.camera import ThinLens
from spreadlets.database import Database
from spreadlets.frame import Frame, Layer
from spreadlets.psf_model import PsfGrid

SCALE_STEPS_PER_OCTAVE = 16
"""Sizes at which a PSF beyond the database's range is drawn: steps of 4.4 %, about a cell's own width."""
N_SCALES = 3 * SCALE_STEPS_PER_OCTAVE + 1
"""PSFs are scaled by up to 8; a wider one covers the frame evenly whatever its exact size."""
SHARP_EXTENT = 0.5
"""A PSF that reaches no farther than half a pixel from the pixel's centre is the pixel itself, px."""
EXTENT_SHARES = {"coc": 1.0, "motion": 0.5}
"""How much of each coordinate adds to the extent of a PSF."""
SHIFT_STEPS_PER_PIXEL = 16
"""A splat's centre is placed to 1/16 px; what lies between pixels is split bilinearly."""


class Labels(NamedTuple):
    """What the PSF of each pixel depends on, in pixels.

    Attributes
    ----------
    coc : ndarray of shape (H, W), float32
        Signed radius of the circle of confusion.
    path : ndarray of shape (H, W, 2), float32
        Motion (dx, dy) over the shutter.
    length : ndarray of shape (H, W), float32
        Length of the path.
    shift : ndarray of shape (H, W, 2), float32, or None
        From the pixel to its position at mid-shutter, (dx, dy); None if the shutter is centred or nothing moves.
    """

    coc: npt.NDArray[np.float32]
    path: npt.NDArray[np.float32]
    length: npt.NDArray[np.float32]
    shift: npt.NDArray[np.float32] | None


@dataclass
class Plan:
    """What one layer needs.

    Attributes
    ----------
    sources : list of list of SplatPass
        The labelled pixels to draw, continued beyond the frame's border: for each pass single pixels and blocks.
    table : PointTable
        The points of the variants in use.
    cells_used : set of int
    pixels_skipped : int
        Pixels of the frame that contribute nothing.
    error_bound : float
        Bound on the change of the displayed image by drawing blocks of pixels as one.
    left_out : list of str
        What this layer does not need.
    """

    sources: list[list[SplatPass]]
    table: PointTable
    cells_used: set[int]
    pixels_skipped: int
    error_bound: float = 0.0
    left_out: list[str] = field(default_factory=list)

    def counts(self) -> dict[str, int]:
        """Return the numbers of pixels drawn sparse and dense, of those merged, and of the points that they draw."""
        drawn, splats, merged = np.zeros((3, self.table.n_variants), np.int64)
        for source in (each for levels in self.sources for each in levels):
            count = _plan_kernels.count_labels(source.label, self.table.n_variants)
            splats += count
            drawn += count * source.stride**2
            merged += count * source.stride**2 if source.stride > 1 else 0
        return {
            "pixels_sparse": int(drawn[~self.table.direct].sum()),
            "pixels_dense": int(drawn[self.table.direct].sum()),
            "pixels_merged": int(merged.sum()),
            "points_splatted": int((splats * self.table.n_points).sum()),
        }


def label_pixels(layer: Layer, camera: ThinLens, *, defocus: bool, motion: bool) -> Labels:
    """Turn depth and motion vectors into the PSF's parameters; an effect that is off has parameter 0."""
    height, width = layer.depth.shape
    coc, length = np.zeros((2, height, width), np.float32)
    if defocus:
        _plan_kernels.coc_radii(layer.depth, camera.coc_scale(width), 1.0 / camera.focus_distance_m, coc)
    if not motion or not layer.has_motion:
        return Labels(coc, np.broadcast_to(length[..., None], (height, width, 2)), length, None)
    shift = layer.motion * np.float32(camera.shutter_centre) if camera.shutter_centre else None
    path = layer.motion * np.float32(camera.shutter_duration)
    _plan_kernels.path_lengths(path, length)
    return Labels(coc, path, length, shift)


def needed_spreadlets(frame: Frame, camera: ThinLens, grid: PsfGrid) -> set[tuple[int, int]]:
    """Return the (cell, direction) pairs that a frame needs of a database with the given grid."""
    cell_start = np.concatenate([[0], np.cumsum(grid.direction_counts)])
    needed: set[tuple[int, int]] = set()
    for layer in frame.layers:
        key, _ = _variant_keys(layer, label_pixels(layer, camera, defocus=True, motion=True), grid, cell_start)
        variants = [_decode(int(each), cell_start) for each in np.unique(key[key >= 0])]
        needed |= {(variant.cell, variant.direction) for variant in variants if variant != SHARP}
    return needed


def plan_layer(
    layer: Layer,
    labels: Labels,
    database: Database,
    tolerance: float,
    dense_psf: DensePsf | None,
    *,
    border: bool = True,
) -> Plan:
    """Decide the variant of each pixel, read just the cells in use, and lay out the passes to draw.

    Parameters
    ----------
    layer : Layer
        The labelled pixels.
    labels : Labels
        Their PSF parameters.
    database : Database
        The spreadlets.
    tolerance : float
        See `runtime.merge.merge_blocks`.
    dense_psf : callable or None
        If given, every PSF is drawn in full from it (method ``dense``), none as a spreadlet.
    border : bool
        Whether to continue the frame beyond its border.

    Notes
    -----
    LKS sections 6.2 (nearest sample, symmetries) and 6.4 (fast track).
    """
    key, excess = _variant_keys(layer, labels, database.grid, database.cell_start)
    n_keys = 1 + 8 * database.n_spreadlets * (1 + int(excess[:, 2].max()))
    used, place = _plan_kernels.used_keys(key, n_keys)
    label = np.empty(key.shape, np.int32)
    skipped = int(_plan_kernels.replace_keys(key, place, label))
    _warn_beyond_range(database.grid, excess, label.size - skipped)
    variants = [_decode(int(each), database.cell_start) for each in used]
    table = _point_table(list(variant_points(variants, database, dense_psf)), database.n_channels)
    moved = _passes(layer.radiance, label, labels.shift)
    frames = [extended_pass(each, table.reaches + _farthest(each.shift)) if border else each for each in moved]
    variation = _variation(variants, table, database)
    merged = [merge_blocks(each, variation, 0.0 if dense_psf else tolerance) for each in frames]
    plan = Plan(
        sources=[levels for levels, _ in merged],
        table=table,
        cells_used={variant.cell for variant in variants if variant != SHARP},
        pixels_skipped=skipped,
        error_bound=max((bound for _, bound in merged), default=0.0),
    )
    plan.left_out = _left_out(plan, labels, variants)
    return plan


def _variant_keys(
    layer: Layer, labels: Labels, grid: PsfGrid, cell_start: npt.NDArray[np.int64]
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float64]]:
    """Return the key of each pixel's variant, and each row's excess over the range: see the kernel."""
    given = {"coc": labels.coc, "motion": labels.length}
    _warn_of_missing_axes(given, grid)
    names = [axis.name for axis in grid.model.axes]
    key = np.empty(labels.coc.shape, np.int64)
    excess = np.empty((len(key), 3), np.float64)
    share = np.array([EXTENT_SHARES[name] for name in names], np.float64)
    tables = grid.remap, np.array(grid.shape, np.int64), grid.nested.unit_cell, cell_start, share
    scales = SCALE_STEPS_PER_OCTAVE, N_SCALES
    coordinate = tuple(given[name] for name in names)
    _plan_kernels.variant_keys(layer.radiance, coordinate, labels.path, SHARP_EXTENT, tables, scales, key, excess)
    return key, excess


def _warn_of_missing_axes(given: dict[str, npt.NDArray[np.float32]], grid: PsfGrid) -> None:
    """Say which share of the pixels has an effect that the database's model does not know."""
    for name in sorted(set(given) - {axis.name for axis in grid.model.axes}):
        share = 100.0 * np.count_nonzero(given[name]) / given[name].size
        if share > 0:
            warnings.warn(
                f"the database's model {grid.model.name!r} has no axis {name!r}: it is ignored on {share:.1f} % of "
                "the pixels",
                stacklevel=2,
            )


def _warn_beyond_range(grid: PsfGrid, excess: npt.NDArray[np.float64], n_visible: int) -> None:
    """Say which share of the pixels has a PSF beyond the database's range, if any."""
    beyond = excess[:, 1].sum()
    if not beyond:
        return
    limits = ", ".join(f"{axis.name} 0 to {axis.maximum:g} {axis.unit}" for axis in grid.model.axes)
    warnings.warn(
        f"{100.0 * beyond / n_visible:.2f} % of the pixels have a PSF beyond the database's range ({limits}; largest "
        f"needed is {excess[:, 0].max():.2f} times that): scaled from the nearest cell",
        stacklevel=2,
    )


def _decode(key: int, cell_start: npt.NDArray[np.int64]) -> Variant:
    """Turn a key of the kernel back into what it stands for."""
    if key == _plan_kernels.SHARP:
        return SHARP
    scaled, orientation = divmod(key - 1, 8)
    step, spreadlet = divmod(scaled, int(cell_start[-1]))
    cell = int(np.searchsorted(cell_start, spreadlet, side="right")) - 1
    return Variant(
        cell=cell,
        direction=spreadlet - int(cell_start[cell]),
        transpose=bool(orientation & 1),
        flip_row=bool(orientation & 2),
        flip_col=bool(orientation & 4),
        scale=float(np.exp2(step / SCALE_STEPS_PER_OCTAVE)),
    )


def _point_table(
    points: list[tuple[npt.NDArray[np.int32], npt.NDArray[np.float32], bool]], n_channels: int
) -> PointTable:
    """Concatenate the points of all variants."""
    counts = [len(offset_rc) for offset_rc, _, _ in points]
    return PointTable(
        np.concatenate([np.zeros((0, 2), np.int32), *(offset_rc for offset_rc, _, _ in points)]),
        np.concatenate([np.zeros((0, n_channels), np.float32), *(value for _, value, _ in points)]),
        np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
        np.array([direct for _, _, direct in points], np.bool_),
    )


def _passes(
    radiance: npt.NDArray[np.float32], label: npt.NDArray[np.int32], shift: npt.NDArray[np.float32] | None
) -> Iterator[SplatPass]:
    """Split a layer by the fractional part of its shifts: one pass if there is none, up to four corners else."""
    if not (label >= 0).any():
        return
    if shift is None:
        yield SplatPass((0, 0), radiance, label)
        return
    steps = np.rint(shift[..., ::-1].astype(np.float64) * SHIFT_STEPS_PER_PIXEL).astype(np.int64)
    steps[label < 0] = 0
    whole, fraction = np.divmod(steps, SHIFT_STEPS_PER_PIXEL)
    share = fraction / SHIFT_STEPS_PER_PIXEL
    for corner_row in (0, 1):
        for corner_col in (0, 1):
            weight_row = share[..., 0] if corner_row else 1.0 - share[..., 0]
            weight_col = share[..., 1] if corner_col else 1.0 - share[..., 1]
            weight = (weight_row * weight_col).astype(np.float32)
            drawn = np.where(weight > 0, label, -1).astype(np.int32)
            if (drawn >= 0).any():
                moved = (whole + (corner_row, corner_col)).astype(np.int32)
                yield SplatPass((0, 0), radiance * weight[..., None], drawn, moved)


def _farthest(shift: npt.NDArray[np.int32]) -> int:
    """Return the largest displacement in rows or columns, px."""
    return int(np.abs(shift).max(initial=0))


def _variation(variants: list[Variant], table: PointTable, database: Database) -> npt.NDArray[np.float32]:
    """Return the total variation of each variant's PSF, infinite where it is drawn directly."""
    stored = database.statistics()["total_variation"]
    variation = np.full(len(variants), np.inf, np.float32)
    for number, variant in enumerate(variants):
        if not table.direct[number]:
            # A PSF stretched by s is lower by s^2 and its outline longer by s.
            variation[number] = stored[database.cell_start[variant.cell] + variant.direction] / variant.scale
    return variation


def _left_out(plan: Plan, labels: Labels, variants: list[Variant]) -> list[str]:
    """Name what this layer does not need."""
    skipped: dict[str, bool] = {
        "empty pixels": plan.pixels_skipped > 0,
        "motion": not labels.length.any(),
        "defocus": not labels.coc.any(),
        "sparse image": bool(plan.table.direct.all()),
        "direct image": not plan.table.direct.any(),
        "scaled PSFs": all(variant.scale == 1.0 for variant in variants),
        "sub-pixel placement": labels.shift is None,
    }
    return [name for name, is_skipped in skipped.items() if is_skipped]
