"""What lies behind: surfaces that nearer ones hide, found before anything is blurred.

A blur shows what a sharp image hides: beside a near thing out of focus, and through it. Layer by layer, what nearer
ones hide of it is taken from neighbouring frames of the sequence, if there are any, and else guessed: strands go on,
where what was seen around looks like some other place, what lies there is copied; lines go on across narrow gaps; and
behind the edge of a nearer thing, what lies beside it goes on. What is not found so is left to compositing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import BoolArray, Image
from spreadlets.parallel import for_bands
from spreadlets.runtime.box_blur import box_blurred
from spreadlets.runtime.buffers import buffer, cleared
from spreadlets.runtime.label.labels import EVERYWHERE
from spreadlets.runtime.label.lists import LIST_WIDTH
from spreadlets.runtime.label.pixels import Labelled
from spreadlets.runtime.label.surfaces import DEPTHS, MOTIONS, Surface, take_features
from spreadlets.runtime.label.tiles import largest_around, tiling
from spreadlets.runtime.plan import _behind_kernels, _bridge_kernels, _hidden_kernels
from spreadlets.runtime.plan._alike_kernels import BLOCK
from spreadlets.runtime.plan.alike import (
    BLOCKS_AROUND,
    Cells,
    Found,
    coarser_blocks,
    find_alike,
    halved,
    judged,
    refine,
)
from spreadlets.runtime.plan.layering import Layering
from spreadlets.runtime.plan.strands import Strands, find_strands
from spreadlets.scene.frame import Layer

TILES_AROUND = 4
"""So many tiles around, the blur of what was seen of a layer tells that of what lies hidden of it."""
TINY = 1e-6
"""Share of a pixel that counts as nothing."""
FINENESS = 4.0
"""What lies hidden is looked up in cells of this share of the blur that reveals it: it shows nothing finer."""
COMPARED = 5
"""Features that are compared: colour with alpha, and how far it blurs."""
COARSEST = 1
"""Cells are no larger than 2 to this power, px: of larger blocks too much is alike by chance."""

GOING_ON = 0.3
"""Width of a gap, in the correlation length of what a layer covers, up to which what is seen beside it goes on in it.

At that distance the correlation is .74. From .5 on, what lies beside is as good a guess as the mean around, that
compositing takes; but a wrong guess is a blot where the mean is even.
"""


class Behind(NamedTuple):
    """The hidden surfaces of a frame.

    Attributes
    ----------
    surface : Surface or None
        A list of the pixels in which there is one, of several the largest, and strands; its share of the pixel is the
        one that it would have if nothing nearer were there. None if there are none.
    known : ndarray of shape (H, W), uint64
        Bit k says that all that is hidden of depth layer k in the pixel is known.
    """

    surface: Surface | None
    known: npt.NDArray[np.uint64]


class _Pass(NamedTuple):
    """A surface of each pixel, or of a list of some: its depth layers, its colours, weights and how far it blurs."""

    layer: npt.NDArray[np.int32]
    farther: Image
    radiance: Image
    weight: Image
    coc: Image
    length: Image


class _Seen(NamedTuple):
    """All that was seen: surfaces, where they lie, and what they cover; the frame's own comes last."""

    passes: list[_Pass]
    at: list[npt.NDArray[np.int32]]
    cover: list[Image]
    corner: tuple[int, int]


def find_behind(
    surfaces: Sequence[Labelled],
    layering: Layering,
    elsewhere: Labelled | None = None,
    further: Sequence[Sequence[Labelled]] = (),
) -> list[Behind]:
    """Find the hidden surfaces of a frame, and of further ones whose surfaces differ in their colours only.

    Parameters
    ----------
    surfaces : sequence of (layer, pixels)
        What is seen: all pixels of the frame, and lists.
    layering : Layering
        Its depth layers.
    elsewhere : (layer, pixels), optional
        What neighbouring frames show behind each pixel, with weight 0 where they show nothing; only of a frame alone.
    further : sequence of sequences of (layer, pixels)
        What is hidden in them is copied from the same places.
    """
    # See what each surface covers of each layer, and how far that blurs.
    frames = [list(reversed(each)) for each in (surfaces, *further)]
    first, shape = surfaces[0][0], surfaces[0][0].shape
    seen, sums, reaches = _seen_of(frames[0], layering)
    # What is hidden: layer, share of the pixel, and features of each frame; and the layers in which pixels are known.
    hidden = [(cleared(shape, np.int32), cleared(shape), buffer((*shape, _n_features(first)))) for _ in frames]
    known = [np.zeros(shape, np.uint64) for _ in frames]
    nearer = cleared(shape)
    # Where a strand lies hidden, nothing else of its layer does.
    strands = find_strands(surfaces[0][1].labels, seen.cover[-1])
    theirs = np.uint64(1) << seen.passes[-1].layer.ravel()[strands.sides[:, 0]].astype(np.uint64)
    for bits in known:
        bits.ravel()[strands.at] |= theirs
    for number in range(1, layering.n_layers):
        mean, own = _blur_around(sums[..., number, :])
        level = min(max(int(np.log2(max(mean, 1.0) / FINENESS)), 0), COARSEST)
        cells = _enter(seen, number, level, nearer)
        if not sums[..., number, 0].any():
            continue
        if elsewhere is not None:
            there = _pass_of(elsewhere, layering)
            given = nearer, there.layer, there.weight, take_features(elsewhere[0], first)
            for_bands(_behind_kernels.take_elsewhere, shape[0], *given, number, hidden[0], known[0])
        blur = reaches[..., :number].max(axis=2), own, float(reaches[..., number].max())
        chosen = _choose(*cells, blur, level, seen.corner)
        if chosen is None:
            continue
        gap, blocks = chosen
        corner = _corner(seen.corner, level)
        places = _places(seen, frames[0], number, level, cells[0], blocks)
        wanted = places.looked_at()
        for index, frame in enumerate(frames):
            # The same places, in the frame's own colours.
            features = _features(seen, frame, number, level, wanted, _n_features(first) + 1)
            here = Cells(cells[0], features, corner)
            if not index:
                refine(here, places)
            # Which places are given up, the first frame alone decides.
            brightest = judged(here, places if not index else places._replace(unlike=places.unlike.copy()))
            comparable = buffer(gap.shape, np.uint8)
            for_bands(_bridge_kernels.mark_comparable, len(gap), cells[0], features, corner, wanted, comparable)
            by_block = corner, *places, brightest, _widest_gaps(comparable, corner)
            looked_up = (cells[0], features, gap, comparable), by_block, level, seen.corner
            for_bands(_behind_kernels.find_behind, len(gap), nearer, *looked_up, number, hidden[index], known[index])
    return [
        Behind(_listed(frame[-1][0], first, *found[1:], strands), each)
        for frame, found, each in zip(frames, hidden, known, strict=True)
    ]


def _seen_of(surfaces: Sequence[Labelled], layering: Layering) -> tuple[_Seen, Image, Image]:
    """Return what was seen; and of each layer sums and the reach in each tile, see the kernel."""
    labels = [pixels.labels for _, pixels in surfaces]
    passes, corner = [_pass_of(each, layering) for each in surfaces], labels[-1].view.corner
    at = [EVERYWHERE if each.view.places is None else each.view.places.at for each in labels]
    cover = [np.empty_like(each.coc) for each in labels]
    tiles = tiling(surfaces[-1][0].shape, BLOCK, corner)
    sums = np.zeros((*tiles, layering.n_layers, 2), np.float32)
    reach = np.zeros((*tiles, layering.n_layers), np.float32)
    for given in zip(passes, at, cover, strict=True):
        surface, places, covered = given
        if len(places):
            n_tiles = -(-len(covered) // BLOCK)
            _behind_kernels.sum_layers(0, n_tiles, surface, places, corner, covered, sums, reach)
        else:
            for_bands(_behind_kernels.sum_layers, tiles[0], surface, places, corner, covered, sums, reach)
    return _Seen(passes, at, cover, corner), sums, reach


def _blur_around(sums: Image) -> tuple[float, Image]:
    """Return how far, px, what was seen of a layer blurs in the mean, and around each tile; far from it, the same."""
    total = sums.sum(axis=(0, 1), dtype=np.float64)
    mean = float(total[1] / max(total[0], TINY))
    cover, blur = (box_blurred(np.ascontiguousarray(sums[..., k]), TILES_AROUND) for k in range(2))
    return mean, (blur + np.float32(TINY * mean)) / (cover + np.float32(TINY))


def _pass_of(surface: Labelled, layering: Layering) -> _Pass:
    layer, pixels = surface
    labels = pixels.labels
    members = layering.members(labels, np.empty(layer.shape, np.int32))
    return _Pass(members.layer, members.farther, layer.radiance, pixels.weight, labels.coc, labels.length)


def _enter(seen: _Seen, number: int, level: int, nearer: Image) -> tuple[Image, Image]:
    """Let the layer before hide what lies in a layer; return what nearer ones hide and it covers, see the kernel."""
    shape = tiling(seen.cover[-1].shape, 1 << level, seen.corner)
    cells = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    for each, at, cover in zip(seen.passes, seen.at, seen.cover, strict=True):
        given = each[:2], cover, at, number, level, seen.corner, nearer, cells
        if len(at):
            _behind_kernels.enter_layer(0, len(at), *given)
        else:
            for_bands(_behind_kernels.enter_layer, shape[0], *given)
    return cells


def _choose(
    hides: Image, covers: Image, blur: tuple[Image, Image, float], level: int, corner: tuple[int, int]
) -> tuple[Image, BoolArray] | None:
    """Return the widths of a layer's gaps, and which blocks are to be looked up, see the kernels; None if none are."""
    across, gap = np.empty(hides.shape, np.int32), np.empty_like(hides)
    inner = _corner(corner, level)
    blocks = tiling(hides.shape, BLOCK, inner)
    is_seen = np.zeros(blocks, np.bool_)
    for_bands(_behind_kernels.row_distances, len(hides), hides, inner, across, is_seen)
    if not is_seen.any():
        return None
    # How far blocks lie from the next one of which something was seen.
    apart, away = np.empty(blocks, np.int32), np.empty(blocks)
    for_bands(_behind_kernels.row_distances, blocks[0], (~is_seen).astype(np.float32), (0, 0), apart, is_seen.copy())
    for_bands(_behind_kernels.nearest, blocks[0], apart, away)
    for_bands(_behind_kernels.find_gaps, len(hides), hides, across, away, blur, level, corner, gap)
    chosen = np.empty(blocks, np.bool_)
    for_bands(_behind_kernels.choose_blocks, len(chosen), hides, covers, gap, blur[1], level, corner, chosen)
    return (gap, chosen) if chosen.any() else None


def _n_features(layer: Layer) -> int:
    """Return the features of a layer's pixels: colour and alpha, nearness and motions."""
    return 4 + len(layer.depths) + 2 * len(layer.motions)


def _corner(corner: tuple[int, int], level: int) -> tuple[int, int]:
    """Return row and column of the first cell, counted from the picture's centre."""
    return corner[0] >> level, corner[1] >> level


def _features(
    seen: _Seen,
    surfaces: Sequence[Labelled],
    number: int,
    level: int,
    wanted: BoolArray,
    n_features: int = COMPARED,
) -> Image:
    """Return what the surfaces of a frame show of a layer in wanted blocks, without highlights, see the kernels."""
    shape = tiling(seen.cover[-1].shape, 1 << level, seen.corner)
    features = buffer((*shape, n_features))
    corner = _corner(seen.corner, level)
    for_bands(_behind_kernels.clear_features, len(wanted), corner, wanted, features)
    for each, at, (layer, _) in zip(seen.passes, seen.at, surfaces, strict=True):
        planes = layer.depths, layer.motions
        given = each._replace(radiance=layer.radiance), at, planes, number, level, seen.corner, wanted, features
        if len(at):
            _behind_kernels.add_features(0, len(at), *given)
        else:
            for_bands(_behind_kernels.add_features, len(features), *given)
    # What is copied holds no lamps.
    light = np.empty((*wanted.shape, 2))
    for_bands(_behind_kernels.sum_light, len(light), features, corner, wanted, light)
    for_bands(_behind_kernels.dim_highlights, len(light), light, corner, features)
    return features


def _places(
    seen: _Seen, surfaces: Sequence[Labelled], number: int, level: int, hides: Image, chosen: BoolArray
) -> Found:
    """Return for chosen blocks where what was seen around them is most alike, from cells twice as large.

    What is wider than a block's surroundings, as the squares of a board, would be matched wrongly in cells of the size
    that is copied.
    """
    corner = _corner(seen.corner, level)
    coarse, inner = halved(hides, corner)
    holding = coarser_blocks(chosen, coarse.shape, corner)
    wanted = largest_around(holding, BLOCKS_AROUND)
    features = _features(seen, surfaces, number, level + 1, wanted)
    return find_alike(Cells(coarse, features, inner), holding).handed_down(chosen, corner)


def _widest_gaps(comparable: npt.NDArray[np.uint8], corner: tuple[int, int]) -> Image:
    """Return up to which width, cells, a layer goes on in gaps, in blocks of cells; see `mark_comparable`."""
    counts = np.empty((4, *tiling(comparable.shape, BLOCK, corner)), np.float32)
    for_bands(_bridge_kernels.count_changes, counts.shape[1], comparable, corner, counts)
    known, covered, pairs, changes = (box_blurred(each, TILES_AROUND) for each in counts)
    share = covered / np.maximum(known, np.float32(TINY))
    # Where pieces begin and end at random, twice the product of both shares over the changes is the correlation length.
    length = 2.0 * share * (1.0 - share) * pairs / np.maximum(changes, np.float32(TINY))
    return (GOING_ON * length).astype(np.float32, copy=False)


def _listed(frame: Layer, first: Layer, share: Image, features: Image, strands: Strands) -> Surface | None:
    """Return a list of the pixels of a frame in which something lies hidden, strands of the frame's colours too."""
    height, width = share.shape
    # Strands come behind what else is hidden in their pixels.
    counts, begins = np.empty(height, np.int64), np.searchsorted(strands.at, np.arange(height + 1) * width)
    for_bands(_hidden_kernels.count_hidden, height, share, counts)
    counts += np.diff(begins)
    if not (n := int(counts.sum())):
        return None
    sides = np.unravel_index(strands.sides, frame.shape)
    lines = strands.at, strands.share, take_features(frame, first, sides).mean(axis=1), begins
    # The last row is filled up with the first pixel, of weight 0.
    rows, n_depths, n_motions = -(-n // LIST_WIDTH), len(first.depths), len(first.motions)
    at, part = np.empty((rows * LIST_WIDTH, 2), np.int32), np.empty(rows * LIST_WIDTH, np.float32)
    radiance, depths, motions = (
        np.empty(each, np.float32) for each in ((len(part), 4), (n_depths, len(part)), (n_motions, len(part), 2))
    )
    given = share, features, lines, np.cumsum(counts) - counts, (at, part), (radiance, depths, motions)
    for_bands(_hidden_kernels.list_hidden, height, *given)
    at[n:], part[n:], radiance[n:], depths[:, n:], motions[:, n:] = (
        at[0],
        0.0,
        radiance[0],
        depths[:, :1],
        motions[:, :1],
    )
    planes: dict[str, Any] = dict(zip(DEPTHS[:n_depths], depths.reshape(n_depths, rows, -1), strict=True))
    planes |= dict(zip(MOTIONS[:n_motions], motions.reshape(n_motions, rows, -1, 2), strict=True))
    layer = replace(first, radiance=radiance.reshape(rows, -1, 4), **planes)
    return Surface(layer, part.reshape(rows, -1), at.reshape(rows, -1, 2))
