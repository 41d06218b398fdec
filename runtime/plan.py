"""Planning: from a layer's labels alone, which PSF variants the frame needs, and nothing else."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from runtime.border import extended_radiance, outside_distance
from runtime.splat import PointTable, SplatPass
from runtime.variant import SHARP, Variant, variant_points
from spreadlets.camera import ThinLens
from spreadlets.database import Database
from spreadlets.frame import Layer
from spreadlets.psf_model import PsfGrid

DensePsf = Callable[[int, int, float], npt.NDArray[np.float64]]
"""Gives the full PSF of (cell, direction, scale) as an array of odd size, centred."""

SCALE_STEPS_PER_OCTAVE = 16
"""Sizes at which a PSF beyond the database's range is drawn: steps of 4.4 %, about a cell's own width."""
SHARP_EXTENT = 0.5
"""A PSF that reaches no farther than half a pixel from the pixel's centre is the pixel itself, px."""
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
    shift : ndarray of shape (H, W, 2), float32
        From the pixel to its position at mid-shutter, (dx, dy).
    """

    coc: npt.NDArray[np.float32]
    path: npt.NDArray[np.float32]
    shift: npt.NDArray[np.float32]


@dataclass
class Plan:
    """What one layer needs.

    Attributes
    ----------
    passes : list of SplatPass
        The labelled pixels to draw, those that continue the frame beyond its border included.
    table : PointTable
        The points of the variants in use.
    border : int
        Pixels by which the passes exceed the frame on each side.
    padding : int
        Pixels that the splats need around the frame on each side.
    cells_used : set of int
    pixels_skipped : int
        Pixels of the frame that contribute nothing.
    left_out : list of str
        What this layer does not need.
    """

    passes: list[SplatPass]
    table: PointTable
    border: int
    padding: int
    cells_used: set[int]
    pixels_skipped: int
    left_out: list[str] = field(default_factory=list)

    def counts(self) -> dict[str, int]:
        """Return the numbers of pixels drawn sparse and dense, and of the points that they draw."""
        drawn = np.zeros(len(self.table.direct), np.int64)
        for source in self.passes:
            drawn += np.bincount(source.variant[source.variant >= 0], minlength=len(drawn))
        return {
            "pixels_sparse": int(drawn[~self.table.direct].sum()),
            "pixels_dense": int(drawn[self.table.direct].sum()),
            "points_splatted": int((drawn * self.table.n_points).sum()),
        }


def label_pixels(layer: Layer, camera: ThinLens, *, defocus: bool, motion: bool) -> Labels:
    """Turn depth and motion vectors into the PSF's parameters; an effect that is off has parameter 0."""
    height, width = layer.depth.shape
    coc = camera.coc_radius(layer.depth, width) if defocus else np.zeros((height, width), np.float32)
    vector = layer.motion if motion else np.zeros((height, width, 2), np.float32)
    return Labels(
        np.asarray(coc, np.float32),
        vector * np.float32(camera.shutter_duration),
        vector * np.float32(camera.shutter_centre),
    )


def plan_layer(layer: Layer, labels: Labels, database: Database, dense_psf: DensePsf | None) -> Plan:
    """Decide the variant of each pixel, read just the cells in use, and lay out the passes to draw.

    Parameters
    ----------
    layer : Layer
        The labelled pixels.
    labels : Labels
        Their PSF parameters.
    database : Database
        The spreadlets.
    dense_psf : callable or None
        If given, every PSF is drawn in full from it (method ``dense``), none as a spreadlet.

    Notes
    -----
    LKS sections 6.2 (nearest sample, symmetries) and 6.4 (fast track).
    """
    visible = np.asarray(layer.radiance.any(axis=2))
    coordinate, scale_step = _in_range(_coordinates(labels, database.grid), database.grid, visible)
    key = _variant_key(coordinate, scale_step, labels, database.grid)
    used, inverse = np.unique(key[visible], return_inverse=True)
    variants = [_decode(int(value)) for value in used]
    table = _point_table([variant_points(variant, database, dense_psf) for variant in variants], database.n_channels)
    index = np.full(visible.shape, -1, np.int32)
    index[visible] = inverse
    source, border = _extended(layer.radiance, index, labels.shift, table)
    passes = list(_passes(*source))
    moved = max((int(np.abs(each.shift[each.variant >= 0]).max(initial=0)) for each in passes), default=0)
    plan = Plan(
        passes=passes,
        table=table,
        border=border,
        padding=border + table.reach() + moved,
        cells_used={variant.cell for variant in variants if variant != SHARP},
        pixels_skipped=int(visible.size - visible.sum()),
    )
    plan.left_out = _left_out(plan, labels, visible)
    return plan


def _coordinates(labels: Labels, grid: PsfGrid) -> npt.NDArray[np.float64]:
    """Return the coordinate of each pixel in the model's parameter space, shape (H, W, n_axes)."""
    given = {"coc": np.abs(labels.coc), "motion": np.hypot(labels.path[..., 0], labels.path[..., 1])}
    names = [axis.name for axis in grid.model.axes]
    for name in sorted(set(given) - set(names)):
        moving = float((given[name] > 0).mean())
        if moving > 0:
            warnings.warn(
                f"the database's model {grid.model.name!r} has no axis {name!r}: it is ignored on "
                f"{100 * moving:.1f} % of the pixels",
                stacklevel=2,
            )
    return np.stack([given[name] for name in names], axis=-1).astype(np.float64)


def _in_range(
    coordinate: npt.NDArray[np.float64], grid: PsfGrid, visible: npt.NDArray[np.bool_]
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.int64]]:
    """Shrink coordinates beyond the database's range into it; return them and the steps by which they shrank."""
    maximum = np.array([axis.maximum for axis in grid.model.axes])
    excess = (coordinate / maximum).max(axis=-1)
    beyond = visible & (excess > 1.0)
    step = np.zeros(excess.shape, np.int64)
    if beyond.any():
        step[beyond] = np.ceil(SCALE_STEPS_PER_OCTAVE * np.log2(excess[beyond]))
        share = 100.0 * beyond.sum() / max(visible.sum(), 1)
        limits = ", ".join(f"{axis.name} 0 to {axis.maximum:g} {axis.unit}" for axis in grid.model.axes)
        warnings.warn(
            f"{share:.2f} % of the pixels have a PSF beyond the database's range ({limits}; largest needed is "
            f"{excess.max():.2f} times that): scaled from the nearest cell",
            stacklevel=2,
        )
    return coordinate / np.exp2(step / SCALE_STEPS_PER_OCTAVE)[..., None], step


def _variant_key(
    coordinate: npt.NDArray[np.float64], scale_step: npt.NDArray[np.int64], labels: Labels, grid: PsfGrid
) -> npt.NDArray[np.int64]:
    """Pack cell, direction, orientation and scale of each pixel into one integer; -1 is a PSF within one pixel."""
    cell = grid.find(coordinate)
    angle = np.arctan2(labels.path[..., 1], labels.path[..., 0])
    direction, transpose, flip_row, flip_col = grid.nearest_direction(cell, angle)
    orientation = transpose.astype(np.int64) | flip_row.astype(np.int64) << 1 | flip_col.astype(np.int64) << 2
    key = ((cell << 16 | direction) << 3 | orientation) << 12 | scale_step
    extent = np.abs(labels.coc) + 0.5 * np.hypot(labels.path[..., 0], labels.path[..., 1])
    return np.where(extent <= SHARP_EXTENT, -1, key)


def _extended(
    radiance: npt.NDArray[np.float32],
    variant: npt.NDArray[np.int32],
    shift: npt.NDArray[np.float32],
    table: PointTable,
) -> tuple[tuple[npt.NDArray[np.float32], npt.NDArray[np.int32], npt.NDArray[np.float32]], int]:
    """Continue a layer beyond its border: labels repeat, as far as their PSFs reach back into the frame."""
    reach = np.append(table.reaches(), 0)[variant] + np.ceil(np.abs(shift).max(axis=2)).astype(np.int64)
    border = int(max(reach[0].max(), reach[-1].max(), reach[:, 0].max(), reach[:, -1].max()))
    around = ((border, border), (border, border))
    extended = np.pad(variant, around, mode="edge")
    out_of_reach = outside_distance(variant.shape, border) > np.pad(reach, around, mode="edge")
    colour = extended_radiance(radiance, border)
    extended[out_of_reach | ~colour.any(axis=2)] = -1
    return (colour, extended, np.pad(shift, (*around, (0, 0)), mode="edge")), border


def _decode(key: int) -> Variant:
    if key < 0:
        return SHARP
    orientation = key >> 12 & 7
    return Variant(
        cell=key >> 31,
        direction=key >> 15 & 0xFFFF,
        transpose=bool(orientation & 1),
        flip_row=bool(orientation & 2),
        flip_col=bool(orientation & 4),
        scale=float(np.exp2((key & 0xFFF) / SCALE_STEPS_PER_OCTAVE)),
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
    radiance: npt.NDArray[np.float32],
    variant: npt.NDArray[np.int32],
    shift: npt.NDArray[np.float32],
) -> Iterator[SplatPass]:
    """Split a layer by the fractional part of its shifts: one pass if there is none, up to four corners else."""
    steps = np.rint(shift[..., ::-1].astype(np.float64) * SHIFT_STEPS_PER_PIXEL).astype(np.int64)
    steps[variant < 0] = 0
    whole, fraction = np.divmod(steps, SHIFT_STEPS_PER_PIXEL)
    share = fraction / SHIFT_STEPS_PER_PIXEL
    for corner_row in (0, 1):
        for corner_col in (0, 1):
            weight_row = share[..., 0] if corner_row else 1.0 - share[..., 0]
            weight_col = share[..., 1] if corner_col else 1.0 - share[..., 1]
            weight = (weight_row * weight_col).astype(np.float32)
            drawn = (weight > 0) & (variant >= 0)
            if not drawn.any():
                continue
            scaled = radiance if (weight == 1).all() else radiance * weight[..., None]
            moved = (whole + (corner_row, corner_col)).astype(np.int32)
            yield SplatPass(scaled, np.where(drawn, variant, -1).astype(np.int32), moved)


def _left_out(plan: Plan, labels: Labels, visible: npt.NDArray[np.bool_]) -> list[str]:
    """Name what this layer does not need."""
    skipped: dict[str, Any] = {
        "empty pixels": plan.pixels_skipped > 0,
        "motion": not labels.path[visible].any(),
        "defocus": not labels.coc[visible].any(),
        "sparse image": bool(plan.table.direct.all()),
        "direct image": not plan.table.direct.any(),
        "sub-pixel placement": len(plan.passes) <= 1,
    }
    return [name for name, is_skipped in skipped.items() if is_skipped]
