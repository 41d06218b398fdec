"""Planning: from the labels alone, which PSF variants the frame needs, and nothing else."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import Image
from spreadlets.parallel import for_bands
from spreadlets.psf.database import Database
from spreadlets.psf.exact import ExactPsf
from spreadlets.psf.model import PsfGrid
from spreadlets.remembered import Remembered
from spreadlets.runtime.buffers import buffer
from spreadlets.runtime.label.carried import carried
from spreadlets.runtime.label.labels import EXTENT_SHARES, HEADINGS, NO_SHIFT, Labels, coordinates, ignored_effects
from spreadlets.runtime.label.lists import Pixels
from spreadlets.runtime.label.moving import Effects
from spreadlets.runtime.label.pixels import frame_surfaces, surface_pixels
from spreadlets.runtime.label.surfaces import split_surfaces
from spreadlets.runtime.options import DEFAULT_TOLERANCE, FRAME_SOFTNESS, SAMPLE_TOLERANCE, Options
from spreadlets.runtime.plan import _layer_kernels, _plan_kernels
from spreadlets.runtime.plan._border_kernels import Border, Slopes
from spreadlets.runtime.plan._plan_kernels import FIRST_STREAK, GridTables, PixelPlaces, PoseLabels, Sizes
from spreadlets.runtime.plan.border import NO_BORDER, border_limit, edge_slopes, extended_pass
from spreadlets.runtime.plan.divide import divide_frames
from spreadlets.runtime.plan.highlights import Highlights, find_highlights
from spreadlets.runtime.plan.layering import Layering, Membership
from spreadlets.runtime.plan.merge import MERGING_SHARE, coarse_error, merge_blocks
from spreadlets.runtime.plan.pool import place_pixels, pool
from spreadlets.runtime.plan.streaks import draw_streaks, longest_streak
from spreadlets.runtime.plan.variant import SHARP, DensePsf, Points, Variant, own_points, variant_points
from spreadlets.runtime.splat.passes import DIRECT, STRIDES, PointTable, SplatPass
from spreadlets.scans import holds_anything
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.frame import Frame

NOWHERE = np.zeros(0, np.int64)
"""The numbers of no pixels."""
UNMOVED = np.zeros((0, 0, 2), np.float32)
"""The shift of pixels that are drawn where they are."""
SCALE_STEPS_PER_OCTAVE = 16
"""Sizes at which a PSF beyond the database's range is drawn: steps of 4.4 %, about a cell's own width."""
N_SCALES = 3 * SCALE_STEPS_PER_OCTAVE + 1
"""PSFs are scaled by up to 8; a wider one covers the frame evenly whatever its exact size."""
SHARP_EXTENT = 0.5
"""A PSF that reaches no farther than half a pixel from the pixel's centre is the pixel itself, px."""
NEVER_SHARP = -1.0
WHITE = 1.0
"""Radiance above which a display shows no more. What is brighter has a steep rim, where a wrong radius shows."""
BRIGHT = 2.5
"""How many times brighter than the mean of a frame a bright area is: an even texture is at most twice as bright."""
WIDE_REACH = 16
"""Reach of a PSF, px, from which a stochastic sample is placed to the whole pixel: as samples lie anywhere in a pixel,
it is the mean of many such errors that counts."""


@dataclass(frozen=True)
class Drawing:
    """What to draw.

    Attributes
    ----------
    sources : list of list of SplatPass
        The labelled pixels to draw, continued beyond the frame's border: for each pass single pixels and blocks.
    table : PointTable
        The points of the variants in use; behind them the PSFs of highlights, and the spikes that were taken off some.
    n_variants : int
        Variants without those: pixels that have one of them are drawn twice.
    n_layers : int
        Depth layers.
    corner : tuple of int
        Row and column of the first pixel, counted from the picture's centre.
    error_bound : float
        Bound on the change of the displayed image by drawing blocks of pixels as one.
    parts_colours : bool
        That of the model: each colour is then divided by a weight of its own.
    n_lights : int
        How many of the sources, at the end, are of highlights alone, whose PSFs are exact.
    """

    sources: list[list[SplatPass]]
    table: PointTable
    n_variants: int
    n_layers: int
    corner: tuple[int, int]
    error_bound: float
    parts_colours: bool
    n_lights: int

    def counts(self) -> dict[str, int]:
        """Return the numbers of pixels drawn sparse and dense, of those merged, and of the points that they draw.

        Pixels that are pooled (`runtime.plan.pool`) count as one.
        """
        drawn, splats, merged = np.zeros((3, self.table.n_variants), np.int64)
        for source in (each for levels in self.sources for each in levels):
            given = source.label, self.table.n_variants
            count = np.sum(for_bands(_plan_kernels.count_labels, len(source.label), *given), axis=0)
            splats += count
            drawn += count * source.stride**2
            merged += count * source.stride**2 if source.stride > 1 else 0
        drawn[self.n_variants :] = 0
        return {
            "pixels_sparse": int(drawn[~self.table.direct].sum()),
            "pixels_dense": int(drawn[self.table.direct].sum()),
            "pixels_merged": int(merged.sum()),
            "points_splatted": int((splats * self.table.n_points).sum()),
        }


@dataclass(frozen=True)
class Plan:
    """What a set of labelled pixels needs.

    Attributes
    ----------
    table : PointTable
        As in `Drawing`.
    n_layers : int
        Depth layers.
    members : list of Membership
        The layers of the pixels that were given, in their order.
    cells_used : set of int
    pixels_skipped : int
        Pixels that contribute nothing.
    left_out : list of str
        What is not needed.
    lay_out : callable
        Makes the `Drawing` of pixels with these labels and whatever colours.
    highlights : Highlights
        Those of its pixels that are lights are not in the drawing.
    first_highlight : int
        The variant of the first of their PSFs.
    """

    table: PointTable
    n_layers: int
    members: list[Membership]
    cells_used: set[int]
    pixels_skipped: int
    left_out: list[str]
    lay_out: Callable[[Sequence[Pixels]], Drawing]
    highlights: Highlights
    first_highlight: int


class _Choice(NamedTuple):
    """The PSFs of some sets of pixels.

    Attributes
    ----------
    indices : list of ndarray of shape (H, W), int32
        For each set, the number of each pixel's variant; -1 where nothing is drawn.
    variants : list of Variant
        Those behind streaks and capsules.
    is_streak : ndarray of shape (n,), bool
        Which of these are streaks.
    highlights : Highlights
    table : PointTable
        As in `Plan`.
    spike_of : ndarray of shape (table.n_variants,), int32
        Which variant draws the spike of each; -1 if it has none.
    variation : ndarray of shape (table.n_variants,), float32
        Total variation of each PSF, see `_variation`.
    """

    indices: list[npt.NDArray[np.int32]]
    variants: list[Variant]
    is_streak: npt.NDArray[np.bool_]
    highlights: Highlights
    table: PointTable
    spike_of: npt.NDArray[np.int32]
    variation: npt.NDArray[np.float32]

    @property
    def n_streaks(self) -> int:
        """Number of streaks and capsules."""
        return len(self.is_streak)

    @property
    def n_variants(self) -> int:
        """Number of variants without highlights and spikes."""
        return self.n_streaks + len(self.variants)


class _Part(NamedTuple):
    """The part of some pixels that lies in the nearer or in the farther of their layers."""

    pixels: Pixels
    label: npt.NDArray[np.int32]
    weight: npt.NDArray[np.float32]
    border: Border


def needed_spreadlets(frame: Frame, camera: ThinLens, grid: PsfGrid) -> set[tuple[int, int]]:
    """Return the (cell, pose) pairs that a frame needs of a database with the given grid, by default options."""
    cell_start = np.concatenate([[0], np.cumsum(grid.pose_counts)])
    needed: set[tuple[int, int]] = set()
    effects = Effects(defocus=True, motion=True, swept=grid.model.has_motion)
    layers = carried(frame.layers, camera) if camera.moves_picture else frame.layers
    for layer in layers:
        if len(layers) == 1:
            pixel_sets = divide_frames([layer], camera, effects).pixel_sets[0]
        else:
            pixel_sets = surface_pixels(frame_surfaces(layer, camera, effects, split_surfaces), camera, effects)
        for pixels in pixel_sets:
            given = _Given.of(pixels.labels, grid, cell_start)
            key, _ = _variant_keys(pixels, given)
            # Whether a bright pixel is a highlight is not known yet: it may need either.
            shared = _shared_keys(pixels, given, key.copy(), NOWHERE, _bright(pixels))
            found = np.union1d(key, shared)
            variants = _decoded(found[found >= 0], cell_start)
            needed |= {(variant.cell, variant.pose) for variant in variants if variant != SHARP}
    return needed


def plan_pixels(
    pixel_sets: Sequence[Pixels],
    database: Database,
    options: Options,
    n_layers: int,
    *,
    border: bool = True,
    stochastic: bool = False,
    lights: bool = False,
    dense_psf: DensePsf | None = None,
    exact_psf: ExactPsf | None = None,
    layering: Layering | None = None,
    shared: bool = True,
) -> Plan:
    """Decide the variant and the layers of each pixel, and read just the cells in use.

    Parameters
    ----------
    pixel_sets : sequence of Pixels
        Each with one label for each pixel.
    database : Database
    options : Options
        Their tolerance and softness.
    n_layers : int
        Depth layers.
    border : bool
        Whether to continue the frame beyond its border.
    stochastic : bool
        Whether the pixels are stochastic samples.
    lights : bool
        Whether highlights of samples are left out of what is laid out, see `runtime.finish.lights`.
    dense_psf : callable or None
        If given, every PSF is drawn in full from it, none as a spreadlet.
    exact_psf : ExactPsf or None
        What makes the PSFs of highlights; None to draw them as all others.
    layering : Layering, optional
        The depth layers, where they are known; by default they are found in what is drawn.
    shared : bool
        Whether bright pixels share out the cells about their coordinate, see `runtime.plan._plan_kernels.share_out`; a
        filter, which does not add them up, would show it.

    Notes
    -----
    LKS sections 6.2 (nearest sample, symmetries) and 6.4 (fast track).
    """
    # Choose the variants, and read their cells.
    tolerance = SAMPLE_TOLERANCE if stochastic else DEFAULT_TOLERANCE
    tolerance = tolerance if options.tolerance is None else options.tolerance
    tolerance = 0.0 if dense_psf else tolerance
    makers = dense_psf, exact_psf
    chosen = _choose(pixel_sets, database, tolerance, *makers, stochastic=stochastic, lights=lights, shared=shared)
    # Assign the pixels to depth layers.
    if layering is None:
        layering = _divide(pixel_sets, chosen.indices, n_layers, options.softness)
    n_layers, found = layering.n_layers, zip(pixel_sets, chosen.indices, strict=True)
    members = [layering.members(each.labels, index) for each, index in found]
    # Record what is needed, and what is not.
    n_skipped = _count_skipped(pixel_sets, chosen.indices)
    return Plan(
        table=chosen.table,
        n_layers=n_layers,
        members=members,
        cells_used={variant.cell for variant in chosen.variants if variant != SHARP},
        pixels_skipped=n_skipped,
        left_out=_left_out(chosen, n_layers, n_skipped, pixel_sets, stochastic=stochastic),
        lay_out=partial(
            _lay_out,
            chosen=chosen,
            members=members,
            n_layers=n_layers,
            tolerance=tolerance,
            slopes=edge_slopes(pixel_sets[0].labels.coc) if border else None,
            stochastic=stochastic,
            parts_colours=database.grid.model.parts_colours,
        ),
        highlights=chosen.highlights,
        first_highlight=chosen.n_variants,
    )


def _choose(
    pixel_sets: Sequence[Pixels],
    database: Database,
    tolerance: float,
    dense_psf: DensePsf | None,
    exact_psf: ExactPsf | None,
    *,
    stochastic: bool,
    lights: bool,
    shared: bool,
) -> _Choice:
    """Choose the PSF of each pixel, and read just those that are in use."""
    # Find the cell, the pose and the scale of each pixel: its variant.
    given = [_Given.of(each.labels, database.grid, database.cell_start) for each in pixel_sets]
    keys, excess = zip(*map(_variant_keys, pixel_sets, given), strict=True)
    _warn_beyond_range(database.grid, np.concatenate(excess), keys)
    # Give highlights PSFs of their own; of other bright pixels, blocks share out the cells.
    highlights = find_highlights(pixel_sets, keys, database.grid.model, exact_psf, stochastic=stochastic, lights=lights)
    if shared:
        sets = zip(pixel_sets, given, keys, highlights.places, strict=True)
        keys = tuple(_shared_keys(each, known, key, own, _bright(each)) for each, known, key, own in sets)
    # What the kernels are given is as large as what they find.
    del given
    # Number the variants in use.
    used, indices = _numbered(keys)
    streaks = FIRST_STREAK - used[used <= FIRST_STREAK]
    variants = _decoded(used[len(streaks) :], database.cell_start)
    # Collect the points of all.
    parts = [*variant_points(variants, database, dense_psf), *map(own_points, highlights.psfs)]
    points, spikes = (list(each) for each in zip(*parts, strict=True)) if parts else ([], [])
    table, spike_of = _point_table(draw_streaks(streaks, database.grid.model), points, spikes, database.n_channels)
    variation = _variation(len(streaks), variants, spikes, table, database)
    table = replace(table, group=_groups(table.direct, variation, (1.0 - MERGING_SHARE) * tolerance))
    return _Choice(indices, variants, streaks % 2 == 0, highlights, table, spike_of, variation)


def _divide(
    pixel_sets: Sequence[Pixels],
    indices: Sequence[npt.NDArray[np.int32]],
    n_layers: int,
    softness: float | None,
) -> Layering:
    """Divide the range of depths into layers."""
    frames = [
        (each.labels, index if each.curved is None else np.where(each.curved, np.int32(0), index))
        for each, index in zip(pixel_sets, indices, strict=True)
        if not each.is_list
    ]
    lists = [(each.labels, index) for each, index in zip(pixel_sets, indices, strict=True) if each.is_list]
    return Layering.fitted(frames, n_layers, FRAME_SOFTNESS if softness is None else softness, lists)


def _lay_out(
    pixel_sets: Sequence[Pixels],
    *,
    chosen: _Choice,
    members: list[Membership],
    n_layers: int,
    tolerance: float,
    slopes: Slopes | None,
    stochastic: bool,
    parts_colours: bool,
) -> Drawing:
    """Lay out what each layer draws, and bound the error of drawing blocks of pixels as one."""
    table, highlights = chosen.table, chosen.highlights
    wide = table.reaches > (WIDE_REACH if stochastic else math.inf)
    wide[: chosen.n_streaks] |= chosen.is_streak  # the rest of their shift is in them
    # Continue the frame beyond its border, and place or pool its pixels.
    borders = [NO_BORDER if slopes is None else Border(border_limit(_all_colours(each)), slopes) for each in pixel_sets]
    parts = _all_parts(highlights.dimmed(pixel_sets), members, borders, n_layers, table.n_variants)
    shape = pixel_sets[0].labels.view.frame_shape
    splats = list(_splat_passes(parts, shape, table, n_layers, wide))
    # Spikes and highlights are drawn by themselves; of the rest, blocks of like pixels are merged.
    alone = [_spike_pass(each, chosen.spike_of, n_layers) for each in splats] if (chosen.spike_of >= 0).any() else []
    completed = slopes is not None and not stochastic
    placed = list(highlights.placed(pixel_sets, members, chosen.n_variants, wide, completed=completed))
    own = list(pool(placed, shape, table.reaches, n_layers))
    variation = np.tile(chosen.variation, n_layers)
    coarse = float(coarse_error(chosen.variation, np.append(STRIDES, 1)[table.group]).max(initial=0.0))
    merged = [merge_blocks(each, variation, tolerance - coarse) for each in splats]
    sources = [levels for levels, _ in merged] + [[each] for each in (*alone, *own)]
    error_bound = coarse + max((bound for _, bound in merged), default=0.0)
    corner = pixel_sets[0].labels.view.corner
    return Drawing(sources, table, chosen.n_variants, n_layers, corner, error_bound, parts_colours, len(own))


def _variant_keys(pixels: Pixels, given: _Given) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float64]]:
    """Return the key of each pixel's variant, and each row's excess over the range: see the kernel."""
    key = np.empty(pixels.labels.coc.shape, np.int64)
    excess = np.empty((len(key), 3), np.float64)
    colour = pixels.radiance, pixels.weight
    for_bands(_plan_kernels.variant_keys, len(key), colour, *given, key, excess)
    return key, excess


def _shared_keys(
    pixels: Pixels, given: _Given, key: npt.NDArray[np.int64], apart: npt.NDArray[np.int64], limit: float
) -> npt.NDArray[np.int64]:
    """Let blocks of bright pixels share out the cells about their coordinate, see the kernel; return the same keys.

    Those of the pixels ``apart``, by their numbers in raster order, stay.
    """
    view, stay = pixels.labels.view, key.ravel()[apart]
    places = PixelPlaces(view.corner, NO_SHIFT if view.places is None else view.places.at)
    asked = given.coordinate, given.pose, places, given.tables, given.sizes
    key.ravel()[apart] = _plan_kernels.INVISIBLE
    for_bands(_plan_kernels.share_out, len(key), pixels.radiance, limit, *asked, key)
    key.ravel()[apart] = stay
    return key


def _bright(pixels: Pixels) -> float:
    """Return the radiance above which a pixel is bright: beyond white, and far above the mean of the frame."""
    return max(WHITE, BRIGHT * _mean_radiance(_all_colours(pixels)))


def _all_colours(pixels: Pixels) -> Image:
    """Return the colours of the frame that pixels are of."""
    return pixels.radiance if pixels.frame is None else pixels.frame


# Sets often share their colours.
@Remembered
def _mean_radiance(colours: npt.NDArray[np.float32]) -> float:
    total = np.empty(len(colours))
    for_bands(_plan_kernels.sum_colours, len(total), colours, total)
    return float(total.sum() / (3 * total.size * colours.shape[1]))


class _Given(NamedTuple):
    """What the kernels find the variants of pixels from: see there."""

    coordinate: tuple[npt.NDArray[np.float32], ...]
    pose: PoseLabels
    tables: GridTables
    sizes: Sizes

    @classmethod
    def of(cls, labels: Labels, grid: PsfGrid, cell_start: npt.NDArray[np.int64]) -> _Given:
        """Collect it for pixels of some labels."""
        model, nested, coordinate = grid.model, grid.nested, _coordinates(labels, grid)
        scaling = np.array([axis.scales for axis in model.axes])
        share = np.array([EXTENT_SHARES.get(axis.name, 0.0) for axis in model.axes])
        # Where more than lens and motion blurs, no PSF stays within its pixel.
        sharp_extent = SHARP_EXTENT if scaling.all() else NEVER_SHARP
        sizes = Sizes(
            SCALE_STEPS_PER_OCTAVE, N_SCALES, scaling, share, sharp_extent, longest_streak(model), model.closed_radius
        )
        heading = np.ascontiguousarray(HEADINGS[model.symmetry.heading](labels))
        shift = UNMOVED if labels.shift is None else np.ascontiguousarray(labels.shift)
        pose = PoseLabels(heading, labels.coc, shift, model.symmetry.codes)
        shape = np.array(grid.shape, np.int64)
        return cls(coordinate, pose, GridTables(grid.remap, shape, nested.unit_cell, nested.bounds, cell_start), sizes)


def _coordinates(labels: Labels, grid: PsfGrid) -> tuple[npt.NDArray[np.float32], ...]:
    """Return the coordinates (H, W) of each pixel; say what the model cannot show."""
    # What a list is of is among the frame's pixels.
    whole = labels.view.places is None
    for name, share in ignored_effects(labels, grid.model) if whole else ():
        warnings.warn(
            f"the database's model {grid.model.name!r} has no axis {name!r}: it is ignored on {100 * share:.1f} % of "
            "the pixels",
            stacklevel=2,
        )
    found = coordinates(labels, grid.model)
    for axis, values in zip(grid.model.axes, found, strict=True):
        share = 0.0 if axis.scales or not whole else float((np.abs(values) > axis.maximum).mean())
        if share > 0:
            warnings.warn(
                f"{100 * share:.2f} % of the pixels lie beyond the database's largest {axis.name}, "
                f"{axis.maximum:g} {axis.unit}: its last cells are used there",
                stacklevel=2,
            )
    return found


def _numbered(
    keys: Sequence[npt.NDArray[np.int64]],
) -> tuple[npt.NDArray[np.int64], list[npt.NDArray[np.int32]]]:
    """Return the keys in use, ascending; and for each set the number of each pixel's key, -1 where invisible."""
    ends = [each for key in keys for each in for_bands(_plan_kernels.key_range, len(key), key)]
    lowest, highest = min(low for low, _ in ends), max(high for _, high in ends)
    is_used, place = buffer((1 + highest - lowest,), np.bool_), buffer((1 + highest - lowest,), np.int32)
    is_used[:] = False
    for key in keys:
        for_bands(_plan_kernels.mark_keys, len(key), key, lowest, is_used)
    used = np.flatnonzero(is_used)
    place[used] = np.arange(len(used))
    indices = [np.empty(key.shape, np.int32) for key in keys]
    for key, index in zip(keys, indices, strict=True):
        for_bands(_plan_kernels.replace_keys, len(key), key, lowest, place, index)
    return used + lowest, indices


def _warn_beyond_range(grid: PsfGrid, excess: npt.NDArray[np.float64], keys: Sequence[npt.NDArray[np.int64]]) -> None:
    """Say which share of the pixels has a PSF beyond the database's range, if any."""
    beyond = excess[:, 1].sum()
    if not beyond:
        return
    n_visible = sum(int(np.count_nonzero(key != _plan_kernels.INVISIBLE)) for key in keys)
    limits = ", ".join(f"{axis.name} 0 to {axis.maximum:g} {axis.unit}" for axis in grid.model.axes)
    warnings.warn(
        f"{100.0 * beyond / n_visible:.2f} % of the pixels have a PSF beyond the database's range ({limits}; largest "
        f"needed is {excess[:, 0].max():.2f} times that): scaled from the nearest cell",
        stacklevel=2,
    )


def _decoded(keys: npt.NDArray[np.int64], cell_start: npt.NDArray[np.int64]) -> list[Variant]:
    """Turn keys of the kernel, ascending, back into what they stand for."""
    stored = keys[keys != _plan_kernels.SHARP]
    scaled, orientation = np.divmod(stored - 1, 8)
    step, spreadlet = np.divmod(scaled, cell_start[-1])
    cell = np.searchsorted(cell_start, spreadlet, side="right") - 1
    # Columns in the order of a variant's fields.
    turned = (orientation & bit != 0 for bit in (1, 2, 4))
    columns = cell, spreadlet - cell_start[cell], *turned, np.exp2(step / SCALE_STEPS_PER_OCTAVE)
    found = list(map(Variant, *(column.tolist() for column in columns)))
    return found if len(stored) == len(keys) else [SHARP, *found]


def _point_table(
    streaks: list[Points], points: list[Points], spikes: list[npt.NDArray[np.float32]], n_channels: int
) -> tuple[PointTable, npt.NDArray[np.int32]]:
    """Concatenate the points of streaks, of variants, then the spikes; say which is each one's spike, -1 if none."""
    n_streaks = len(streaks)
    spiked = np.flatnonzero(np.stack(spikes).any(axis=1)) if spikes else np.zeros(0, np.int64)
    spike_of = np.full(n_streaks + len(points) + len(spiked), -1, np.int32)
    spike_of[n_streaks + spiked] = n_streaks + len(points) + np.arange(len(spiked))
    own = ((np.zeros((1, 2), np.int32), spikes[number][None], True) for number in spiked)
    nothing = np.zeros((0, 2), np.int32), np.zeros((0, n_channels), np.float32), True
    offset_rc, value, direct = zip(nothing, *streaks, *points, *own, strict=True)
    return PointTable(
        np.concatenate(offset_rc),
        np.concatenate(value),
        np.cumsum([len(each) for each in offset_rc], dtype=np.int64),
        np.where(direct[1:], DIRECT, 0).astype(np.int64),
    ), spike_of


def _groups(
    direct: npt.NDArray[np.bool_], variation: npt.NDArray[np.float32], tolerance: float
) -> npt.NDArray[np.int64]:
    """Choose how each variant is drawn: directly, or by the coarsest pixels that the tolerance allows."""
    group = np.zeros(len(direct), np.int64)
    for number, side in enumerate(STRIDES[1:], start=1):
        group[coarse_error(variation, side) <= tolerance] = number
    return np.where(direct, DIRECT, group)


def _spike_pass(frame: SplatPass, spike_of: npt.NDArray[np.int32], n_layers: int) -> SplatPass:
    """Return the pass that draws the spikes of the pixels of another."""
    base = len(spike_of) * np.arange(n_layers, dtype=np.int32)[:, None]
    label = np.append(np.where(spike_of >= 0, base + spike_of, np.int32(-1)), np.int32(-1))
    return frame._replace(label=label[frame.label])


def _all_parts(
    pixel_sets: Sequence[Pixels],
    members: Sequence[Membership],
    borders: Sequence[Border],
    n_layers: int,
    n_variants: int,
) -> Iterator[_Part]:
    """Yield all parts of all pixels, and how each set goes on beyond the border."""
    for pixels, member, border in zip(pixel_sets, members, borders, strict=True):
        if (member.variant >= 0).any():
            for label, weight in _parts(pixels, member, n_layers, n_variants):
                yield _Part(pixels, label, weight, border)


def _parts(
    pixels: Pixels, members: Membership, n_layers: int, n_variants: int
) -> Iterator[tuple[npt.NDArray[np.int32], npt.NDArray[np.float32]]]:
    """Yield labels and weights of the pixels' parts in the nearer and in the farther of their layers."""
    if n_layers == 1:
        yield members.variant.copy(), pixels.weight
        return
    for part in (0, 1):
        label = np.empty(members.variant.shape, np.int32)
        share = np.empty(members.variant.shape, np.float32)
        place = n_variants, part
        if sum(for_bands(_layer_kernels.layer_labels, len(label), *members, pixels.weight, *place, label, share)):
            yield label, share


def _splat_passes(
    parts: Iterator[_Part],
    shape: tuple[int, int],
    table: PointTable,
    n_layers: int,
    wide: npt.NDArray[np.bool_],
) -> Iterator[SplatPass]:
    """Yield what to draw, continued beyond the border: pixels where they are, then those with shifts, pooled."""
    shifted = []
    for pixels, label, weight, border in parts:
        if pixels.labels.shift is None:
            whole = SplatPass((0, 0), pixels.radiance, label)
            yield extended_pass(whole, weight, table.reaches, border, pixels.labels.view.corner)
        else:
            places = pixels.labels.view.places
            at = None if places is None else places.at
            own = pixels.labels.shift, at, wide, border.limit, pixels.labels.trail
            shifted.append(place_pixels(pixels.radiance, weight, label, *own))
    yield from pool(shifted, shape, table.reaches, n_layers)


def _variation(
    n_streaks: int,
    variants: list[Variant],
    spikes: list[npt.NDArray[np.float32]],
    table: PointTable,
    database: Database,
) -> npt.NDArray[np.float32]:
    """Return the total variation of each variant's PSF without its spike, infinite where it is drawn directly."""
    stored = database.statistics()["total_variation"]
    variation = np.full(table.n_variants, np.inf, np.float32)
    sparse = np.flatnonzero(~table.direct[n_streaks : n_streaks + len(variants)])
    if not len(sparse):
        return variation
    chosen = [variants[number] for number in sparse]
    # A PSF stretched by s is lower by s^2 and its outline longer by s.
    places = database.cell_start[[each.cell for each in chosen]] + np.array([each.pose for each in chosen])
    whole = stored[places] / np.array([each.scale for each in chosen], stored.dtype)
    # A spike has four neighbours. What is stored is the variation of one channel, whichever varies most.
    least = np.stack([spikes[number] for number in sparse]).min(axis=1)
    variation[n_streaks + sparse] = np.maximum(whole - 4.0 * least, 0.0)
    return variation


def _left_out(
    chosen: _Choice, n_layers: int, n_skipped: int, pixel_sets: Sequence[Pixels], *, stochastic: bool
) -> list[str]:
    """Name what is not needed."""
    frames = [each for each in pixel_sets if not each.is_list]
    labels = [each.labels for each in pixel_sets]
    skipped: dict[str, bool] = {
        "empty pixels": n_skipped > 0,
        "motion": not any(holds_anything(each.length) for each in labels),
        "curved motion": all(each.curved is None for each in frames),
        "blended depths": stochastic or not any(_is_shared(each) for each in frames),
        "defocus": not any(holds_anything(each.coc) for each in labels),
        "depth layers": n_layers == 1,
        "sparse image": bool(chosen.table.direct.all()),
        "direct image": not chosen.table.direct.any(),
        "scaled PSFs": all(variant.scale == 1.0 for variant in chosen.variants),
        "sub-pixel placement": all(each.labels.shift is None and each.curved is None for each in frames),
    }
    return [name for name, is_skipped in skipped.items() if is_skipped]


def _is_shared(pixels: Pixels) -> bool:
    """Return whether pixels of a frame show several surfaces."""
    return len(pixels.weight) > 0 and bool(((pixels.weight > 0.0) & (pixels.weight < 1.0)).any())


def _count_skipped(pixel_sets: Sequence[Pixels], indices: Sequence[npt.NDArray[np.int32]]) -> int:
    """Return how many pixels of a frame contribute nothing; what has weight 0 is drawn from a list."""
    drawn = [
        (index >= 0) | (each.weight == 0.0) if len(each.weight) else index >= 0
        for each, index in zip(pixel_sets, indices, strict=True)
        if not each.is_list
    ]
    return int(np.count_nonzero(~np.logical_or.reduce(drawn)))
