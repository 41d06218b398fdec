"""Planning: from a layer's labels alone, which PSF variants the frame needs, and nothing else."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from runtime import _plan_kernels
from runtime.border import border_passes
from runtime.merge import merge_passes
from runtime.splat import PointTable, SplatPass
from runtime.variant import SHARP, DensePsf, Variant, variant_points
from spreadlets.camera import ThinLens
from spreadlets.database import Database
from spreadlets.frame import Frame, Layer
from spreadlets.labels import DIRECTIONS, Labels, View, coordinates, ignored_effects
from spreadlets.psf_model import PsfGrid

SCALE_STEPS_PER_OCTAVE = 16
"""Sizes at which a PSF beyond the database's range is drawn: steps of 4.4 %, about a cell's own width."""
N_SCALES = 3 * SCALE_STEPS_PER_OCTAVE + 1
"""PSFs are scaled by up to 8; a wider one covers the frame evenly whatever its exact size."""
SHARP_EXTENT = 0.5
"""A PSF that reaches no farther than half a pixel from the pixel's centre is the pixel itself, px."""
SHIFT_STEPS_PER_PIXEL = 16
"""A splat's centre is placed to 1/16 px; what lies between pixels is split bilinearly."""


@dataclass
class Plan:
    """What one layer needs.

    Attributes
    ----------
    passes : list of SplatPass
        The labelled pixels to draw, and those that continue the frame beyond its border.
    table : PointTable
        The points of the variants in use.
    padding : int
        Pixels that the splats need around the frame on each side.
    cells_used : set of int
    pixels_skipped : int
        Pixels of the frame that contribute nothing.
    error_bound : float
        Bound on the change of the displayed image by drawing blocks of pixels as one.
    left_out : list of str
        What this layer does not need.
    """

    passes: list[SplatPass]
    table: PointTable
    padding: int
    cells_used: set[int]
    pixels_skipped: int
    error_bound: float = 0.0
    left_out: list[str] = field(default_factory=list)

    def counts(self) -> dict[str, int]:
        """Return the numbers of pixels drawn sparse and dense, of those merged, and of the points that they draw."""
        drawn, splats, merged = np.zeros((3, len(self.table.direct)), np.int64)
        for source in self.passes:
            count = np.bincount(source.variant.ravel() + 1, minlength=len(drawn) + 1)[1:]
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
    still = np.zeros((height, width), np.float32)
    view = View(layer.depth, camera.focal_length_mm / camera.sensor_width_mm * width, camera.sensor_width_mm / width)
    coc = np.asarray(camera.coc_radius(layer.depth, width), np.float32) if defocus else still
    if not motion or not layer.has_motion:
        return Labels(coc, np.broadcast_to(still[..., None], (height, width, 2)), None, view)
    shift = layer.motion * np.float32(camera.shutter_centre) if camera.shutter_centre else None
    return Labels(coc, layer.motion * np.float32(camera.shutter_duration), shift, view)


def needed_spreadlets(frame: Frame, camera: ThinLens, grid: PsfGrid) -> set[tuple[int, int]]:
    """Return the (cell, direction) pairs that a frame needs of a database with the given grid."""
    cell_start = np.concatenate([[0], np.cumsum(grid.pose_counts)])
    needed: set[tuple[int, int]] = set()
    for layer in frame.layers:
        key, _ = _variant_keys(layer, label_pixels(layer, camera, defocus=True, motion=True), grid, cell_start)
        variants = [_decode(int(each), cell_start) for each in np.unique(key[key >= 0])]
        needed |= {(variant.cell, variant.direction) for variant in variants if variant != SHARP}
    return needed


def plan_layer(layer: Layer, labels: Labels, database: Database, tolerance: float, dense_psf: DensePsf | None) -> Plan:
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
        See `runtime.merge.merge_passes`.
    dense_psf : callable or None
        If given, every PSF is drawn in full from it (method ``dense``), none as a spreadlet.

    Notes
    -----
    LKS sections 6.2 (nearest sample, symmetries) and 6.4 (fast track).
    """
    key, excess = _variant_keys(layer, labels, database.grid, database.cell_start)
    n_keys = 1 + 8 * database.n_spreadlets * N_SCALES
    used, place = _plan_kernels.used_keys(key, n_keys)
    index = np.empty(key.shape, np.int32)
    _plan_kernels.replace_keys(key, place, index)
    visible = index >= 0
    _warn_beyond_range(database.grid, excess, int(visible.sum()))
    variants = [_decode(int(each), database.cell_start) for each in used]
    table = _point_table(list(variant_points(variants, database, dense_psf)), database.n_channels)
    passes = [each for frame in _passes(layer.radiance, index, labels.shift) for each in _with_border(frame, table)]
    error_bound = 0.0
    if dense_psf is None:
        passes, error_bound = _merged(passes, variants, table, database, tolerance)
    plan = Plan(
        passes=passes,
        table=table,
        padding=_padding(passes, table, index.shape),
        cells_used={variant.cell for variant in variants if variant != SHARP},
        pixels_skipped=int(visible.size - visible.sum()),
        error_bound=error_bound,
    )
    plan.left_out = _left_out(plan, labels, variants)
    return plan


def _variant_keys(
    layer: Layer, labels: Labels, grid: PsfGrid, cell_start: npt.NDArray[np.int64]
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float64]]:
    """Return the key of each pixel's variant, and each row's excess over the range: see the kernel."""
    coordinate = _coordinates(labels, grid)
    key = np.empty(labels.coc.shape, np.int64)
    excess = np.empty((len(key), 2), np.float64)
    tables = grid.remap, np.array(grid.shape, np.int64), grid.nested.level_offset, cell_start
    scaling = np.array([axis.scales for axis in grid.model.axes])
    scales = SCALE_STEPS_PER_OCTAVE, N_SCALES, scaling
    pose = np.ascontiguousarray(DIRECTIONS[grid.model.symmetry.angle](labels)), labels.coc, grid.model.symmetry.codes
    _plan_kernels.variant_keys(layer.radiance, coordinate, pose, _sharp(labels, grid), tables, scales, key, excess)
    return key, excess


def _sharp(labels: Labels, grid: PsfGrid) -> npt.NDArray[np.bool_]:
    """Find the pixels whose PSF stays within the pixel; where more than lens and motion blurs, there are none."""
    if not all(axis.scales for axis in grid.model.axes):
        return np.zeros(labels.coc.shape, np.bool_)
    length = np.hypot(labels.path[..., 0], labels.path[..., 1])
    return np.asarray(np.abs(labels.coc) + np.float32(0.5) * length <= SHARP_EXTENT)


def _coordinates(labels: Labels, grid: PsfGrid) -> npt.NDArray[np.float32]:
    """Return the coordinates (n_axes, H, W) of each pixel; say what the model cannot show."""
    for name, share in ignored_effects(labels, grid.model):
        warnings.warn(
            f"the database's model {grid.model.name!r} has no axis {name!r}: it is ignored on {100 * share:.1f} % of "
            "the pixels",
            stacklevel=2,
        )
    found = coordinates(labels, grid.model)
    for axis, values in zip(grid.model.axes, found, strict=True):
        share = float((values > axis.maximum).mean())
        if share > 0 and not axis.scales:
            warnings.warn(
                f"{100 * share:.2f} % of the pixels lie beyond the database's largest {axis.name}, "
                f"{axis.maximum:g} {axis.unit}: its last cells are used there",
                stacklevel=2,
            )
    return found


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
    turned, step = divmod(key - 1, N_SCALES)
    spreadlet, orientation = divmod(turned, 8)
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
    radiance: npt.NDArray[np.float32], variant: npt.NDArray[np.int32], shift: npt.NDArray[np.float32] | None
) -> Iterator[SplatPass]:
    """Split a layer by the fractional part of its shifts: one pass if there is none, up to four corners else."""
    if shift is None:
        yield SplatPass((0, 0), radiance, variant)
        return
    steps = np.rint(shift[..., ::-1].astype(np.float64) * SHIFT_STEPS_PER_PIXEL).astype(np.int64)
    steps[variant < 0] = 0
    whole, fraction = np.divmod(steps, SHIFT_STEPS_PER_PIXEL)
    share = fraction / SHIFT_STEPS_PER_PIXEL
    for corner_row in (0, 1):
        for corner_col in (0, 1):
            weight_row = share[..., 0] if corner_row else 1.0 - share[..., 0]
            weight_col = share[..., 1] if corner_col else 1.0 - share[..., 1]
            weight = (weight_row * weight_col).astype(np.float32)
            drawn = np.where(weight > 0, variant, -1).astype(np.int32)
            if (drawn >= 0).any():
                moved = (whole + (corner_row, corner_col)).astype(np.int32)
                yield SplatPass((0, 0), radiance * weight[..., None], drawn, moved)


def _with_border(frame: SplatPass, table: PointTable) -> list[SplatPass]:
    """Return the pass of a frame and those that continue it beyond its border."""
    moved = int(np.abs(frame.shift).max(initial=0))
    return [frame, *border_passes(frame, table.reaches() + moved)]


def _merged(
    passes: list[SplatPass], variants: list[Variant], table: PointTable, database: Database, tolerance: float
) -> tuple[list[SplatPass], float]:
    """Merge blocks of like pixels in every pass; return all passes and the bound on the change."""
    stored = database.statistics()["total_variation"]
    variation = np.full(len(variants), np.inf, np.float32)
    for number, variant in enumerate(variants):
        if not table.direct[number]:
            # A PSF stretched by s is lower by s^2 and its outline longer by s.
            variation[number] = stored[database.cell_start[variant.cell] + variant.direction] / variant.scale
    merged = [merge_passes(each, variation, tolerance) for each in passes]
    return [each for group, _ in merged for each in group], max((bound for _, bound in merged), default=0.0)


def _padding(passes: list[SplatPass], table: PointTable, shape: tuple[int, ...]) -> int:
    """Return how far the splats of all passes can reach beyond the frame, px."""
    padding = 0
    for each in passes:
        drawn = np.zeros(len(table.direct), np.bool_)
        drawn[each.variant[each.variant >= 0]] = True
        last = [first + size * each.stride for first, size in zip(each.origin, each.variant.shape, strict=True)]
        beyond = max(0, -min(each.origin), last[0] - shape[0], last[1] - shape[1])
        moved = int(np.abs(each.shift).max(initial=0))
        padding = max(padding, beyond + moved + int(table.reaches()[drawn].max(initial=0)))
    return padding


def _left_out(plan: Plan, labels: Labels, variants: list[Variant]) -> list[str]:
    """Name what this layer does not need."""
    skipped: dict[str, bool] = {
        "empty pixels": plan.pixels_skipped > 0,
        "motion": not labels.path.any(),
        "defocus": not labels.coc.any(),
        "sparse image": bool(plan.table.direct.all()),
        "direct image": not plan.table.direct.any(),
        "scaled PSFs": all(variant.scale == 1.0 for variant in variants),
        "sub-pixel placement": labels.shift is None,
    }
    return [name for name, is_skipped in skipped.items() if is_skipped]
