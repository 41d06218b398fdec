"""Means over depth layers, and how much each leaves to be seen, blurred as the layer is (LKS section 6.2)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import NOTHING, Image
from spreadlets.parallel import for_bands
from spreadlets.runtime.box_blur import box_blurred
from spreadlets.runtime.buffers import cleared
from spreadlets.runtime.composite import _sweep_kernels, _visibility_kernels
from spreadlets.runtime.composite.sweep import enlarged, reduced_blur, reduction
from spreadlets.runtime.label.lists import Pixels
from spreadlets.runtime.plan.layering import Membership

LEAST_REST = np.float32(1e-6)
"""Share of a pixel that is left of it by no more than rounding."""
BLOCKS_AROUND, FARTHEST_BLOCKS = 3.0, 24.0
"""Blocks of pixels beyond what blurs farthest in a layer that are looked at, and beyond its mean blur at most: as wide
as a disc may be, see `runtime.composite._sweep_kernels`."""
BOX_PER_DEVIATION = float(np.sqrt(1.5))
"""Half-width of a box that, applied twice, spreads as far as something of standard deviation 1."""
LEAST_LENGTH = 6.0
"""Root mean square path, px, from which a layer blurs along its own."""
FACTOR, LEAST_HALF = 2, 8
"""That blur is done in pixels so many times as wide where boxes of such a half width, px, and more blur to all sides:
that adds 2 % to their variance."""
PATH_BITS, PATH_AROUND = 3, 1
"""Tiles of 2^3 px have one path, and so many tiles around tell it."""
PATH_TILE = 1 << PATH_BITS
"""Their side, px."""
TINY_SHARE = np.float32(1e-3)
"""Samples of a layer, around a tile, that are none."""
NO_PATHS = np.zeros((0, 0, 3), np.float32)
"""Those of a layer that hardly moves."""
MOST_PADDING, LEAST_PADDING = 2, 1024
"""How far beyond the border samples repeat at most, in longer sides of the frame, or px if that is more."""


class Moments(NamedTuple):
    """Means over the pixels of a layer: CoC radius, px; its square; the squared path length; motion (dx, dy).

    And how far, px, any of them blurs.
    """

    coc: float
    coc_squared: float
    length_squared: float
    motion: tuple[float, float]
    farthest: float = 0.0

    def disc_radius(self) -> float:
        """Radius, px, of the disc that, swept along the mean motion, blurs as the layer's PSFs do in the mean."""
        # What differs from the mean motion blurs to all sides; for both variances see below.
        unlike = max(self.length_squared - self.motion[0] ** 2 - self.motion[1] ** 2, 0.0)
        return math.sqrt(self.coc_squared + unlike / 6.0)

    def box_half_widths(self) -> tuple[int, int]:
        """Half-widths, px, of the two boxes that blur, one after the other, as the layer's PSFs do in the mean."""
        # A disc of radius r has the variance r^2 / 4 along each axis, a path of length l the mean variance l^2 / 24.
        deviation = np.sqrt(self.coc_squared / 4.0 + self.length_squared / 24.0)
        both = max(0, round(2.0 * BOX_PER_DEVIATION * float(deviation) - 1.0))
        return both // 2, both - both // 2

    def scaled(self, factor: float) -> Moments:
        """Return the moments of PSFs that are a factor as wide."""
        motion = self.motion[0] * factor, self.motion[1] * factor
        squares = self.coc_squared * factor**2, self.length_squared * factor**2
        return Moments(self.coc * factor, *squares, motion, self.farthest * factor)


def layer_moments(labelled: Sequence[tuple[Pixels, Image, Membership]], n_layers: int) -> list[Moments | None]:
    """Return the means of each layer over sets of pixels, motions (H, W, 2) and members; None for empty layers."""
    total = np.zeros((n_layers, len(_visibility_kernels.MOMENTS) + 1), np.float64)
    for pixels, motion, members in labelled:
        rows = np.zeros((len(motion), *total.shape), np.float64)
        given = pixels.weight, pixels.labels.coc, pixels.labels.whole_path, motion
        for_bands(_visibility_kernels.layer_moments, len(rows), *members, *given, rows)
        total[:, :-1] += rows[..., :-1].sum(axis=0)
        total[:, -1] = np.maximum(total[:, -1], rows[..., -1].max(axis=0))
    return [_means(each) if each[0] > 0 else None for each in total]


def _means(total: npt.NDArray[np.float64]) -> Moments:
    coc, coc_squared, length_squared, x, y = (float(each) for each in total[1:-1] / total[0])
    return Moments(coc, coc_squared, length_squared, (x, y), float(total[-1]))


class CoverPart(NamedTuple):
    """What a set of pixels covers, and where those of a list lie.

    Attributes
    ----------
    cover, place : ndarray of shape (H, W), float32
        See `runtime.composite._visibility_kernels.cover_planes`.
    at : ndarray of shape (H, W, 2), int32, or None
        Rows and columns; None for all pixels of a frame.
    """

    cover: Image
    place: Image
    at: npt.NDArray[np.int32] | None


class Cover(NamedTuple):
    """What the pixels of a frame cover.

    Attributes
    ----------
    frame : CoverPart
        All pixels of the frame.
    seen : sequence of CoverPart
        Lists of what else is seen of them.
    hidden : sequence of CoverPart
        Lists; what they would cover if nothing were nearer.
    known : ndarray of shape (H, W), uint64
        Bits of the layers in which nothing of a pixel is unknown, even where nearer ones hide it.
    blur : ndarray of shape (H, W), float32, or empty
        How far the pixels of the frame blur, px, if that is to be reckoned with.
    """

    frame: CoverPart
    seen: Sequence[CoverPart]
    hidden: Sequence[CoverPart]
    known: npt.NDArray[np.uint64]
    blur: Image = NOTHING


def cover_part(members: Membership, pixels: Pixels) -> CoverPart:
    """Return what pixels cover; their weights and alphas are the shares that they do."""
    places = pixels.labels.view.places
    cover, place = np.empty((2, *members.variant.shape), np.float32)
    for_bands(_visibility_kernels.cover_planes, len(cover), *members, pixels.radiance, pixels.weight, cover, place)
    return CoverPart(cover, place, None if places is None else places.at)


def share_beyond(cover: Cover, number: int, moments: Moments) -> Image:
    """Return how much of what a layer leaves lies beyond it, blurred as the layer is, shape (H, W).

    Parameters
    ----------
    cover : Cover
    number : int
    moments : Moments
        Of the layer.
    """
    # Sum what nearer layers cover, and take off what they and this one do.
    nearer, beyond = cleared(cover.known.shape), cleared(cover.known.shape)
    for part in cover.seen:
        _visibility_kernels.add_listed_cover(*part, number, nearer, beyond)
    for part in cover.hidden:
        _visibility_kernels.take_hidden(*part, number, beyond)
    planes = *cover.frame[:2], cover.known, number, nearer, beyond
    for_bands(_visibility_kernels.complete_cover, len(beyond), *planes)
    # Blur both as the layer is, and where that meets neither, a little farther than any of its pixels blurs.
    blur = moments.disc_radius(), moments.motion
    factor = reduction(*blur)
    hidden, left = (reduced_blur(each, *blur, factor) for each in (nearer, beyond))
    farther = min(max(moments.farthest - blur[0], 0.0) / factor + BLOCKS_AROUND, FARTHEST_BLOCKS)
    around = tuple(reduced_blur(each, farther, (0.0, 0.0), 1) for each in (hidden, left))
    # Divide them: what hardly blurs is still the plane that was given, which is asked below.
    seen = left.copy() if left is beyond else left
    for_bands(_visibility_kernels.divide_shares, len(seen), hidden, seen, around, LEAST_REST)
    seen = enlarged(seen, cover.known.shape, factor)
    # What a pixel's own blur does not reach is not seen there.
    if cover.blur.size:
        distance = np.empty(seen.shape, np.int32)
        for_bands(_visibility_kernels.uncovered_distances, len(distance), nearer, beyond, distance)
        given = nearer, beyond, distance, cover.frame.place, cover.blur, number
        for_bands(_visibility_kernels.hide_unreached, len(seen), *given, seen)
    return seen


def _padding(passes: Sequence[Pass], moments: Moments, local: Image, duration: float) -> float:
    """Return how far, px, samples beyond the border can be from what they blur into; arguments as `passing_samples`."""
    fastest = max(map(abs, moments.motion))
    if local.size:
        border = local[:1, :, :2], local[-1:, :, :2], local[:, :1, :2], local[:, -1:, :2]
        fastest = max(map(_largest, border)) / duration
    farthest = max(_largest(each.offset) + abs(moments.coc) + fastest * _largest(each.time) for each in passes)
    return sum(moments.box_half_widths()) + farthest + 1.0


class Pass(NamedTuple):
    """One sample of each pixel, (H, W), float32 and contiguous, and how much of it may pass layers.

    Attributes
    ----------
    members : Membership
        Its layers.
    offset, lens_uv : ndarray of shape (H, W, 2), float32
        Where in its pixel it was seen, (dx, dy), px; its place on the lens.
    time : ndarray of shape (H, W), float32
        From the middle of the shutter's.
    alpha : ndarray of shape (H, W), float32
        Its layer lets the rest pass.
    weight : ndarray of shape (H, W), float32
        How many samples it stands for.
    """

    members: Membership
    offset: Image
    lens_uv: Image
    time: Image
    alpha: Image
    weight: Image


def passing_samples(
    passes: Sequence[Pass],
    paths: Sequence[Image],
    number: int,
    moments: Moments,
    duration: float,
) -> Image:
    """Return the number of samples that passed a layer, blurred as the layer is, shape (H, W).

    Beyond the frame's border the nearest samples repeat, as they do for splats.

    Parameters
    ----------
    passes : sequence of Pass
    paths : sequence of ndarray of shape (H, W, 2), float32
        How far each sample moves while the shutter is open, px, see `runtime.label.sampled.sample_paths`.
    number : int
    moments : Moments
        Of the layer: where a sample passed through it is taken from its mean CoC and motion.
    duration : float
        Of the shutter, in the unit of ``time``.
    """
    height, width = passes[0].members.variant.shape
    local = NO_PATHS
    if moments.length_squared > LEAST_LENGTH**2:
        # What moves alike blurs along its paths, what is left to all sides.
        local, unlike = _local_paths([each.members for each in passes], paths, number)
        moments = moments._replace(length_squared=unlike)
    # Find how far beyond the border samples count; of what blurs wider than a few frames all counts are even.
    most = max(LEAST_PADDING, MOST_PADDING * max(height, width))
    needed = _padding(passes, moments, local, duration)
    if needed > most:
        moments, local = moments.scaled(most / needed), local * np.array((most / needed, most / needed, 1), np.float32)
        needed = min(_padding(passes, moments, local, duration), 2.0 * most)
    padding = math.ceil(needed)
    # Count the samples where they passed, and blur.
    passing = np.zeros((height + 2 * padding, width + 2 * padding), np.float32)
    layer, given = (moments.coc, *moments.motion), (_ways(local, duration), PATH_BITS, padding, passing)
    for members, *sample in passes:
        _visibility_kernels.scatter_passing(tuple(members), number, tuple(sample), layer, *given)
    blurred = passing
    for half in moments.box_half_widths():
        blurred = box_blurred(blurred, half)
    inner = np.ascontiguousarray(blurred[padding : padding + height, padding : padding + width])
    if local.size:
        inner = _blurred_along(inner, local, FACTOR if min(moments.box_half_widths()) >= LEAST_HALF else 1)
    return np.asarray(np.maximum(inner, np.float32(0.0)), np.float32)


def _ways(local: Image, duration: float) -> Image:
    """Return the motion of a layer in each tile, and how it changes for what moves so, see `scatter_passing`."""
    rows, cols = local.shape[:2]
    ways = np.zeros((rows, cols, 4), np.float32)
    if not local.size:
        return ways
    motion, seen = local[..., :2] / np.float32(duration), local[..., 2:]
    ways[..., :2] = motion
    # By how much it changes from tile to tile beside, where both are known, along the motion.
    change = np.zeros_like(motion)
    for axis, count in ((1, cols), (0, rows)):
        before, behind = np.maximum(np.arange(count) - 1, 0), np.minimum(np.arange(count) + 1, count - 1)
        between = np.float32(PATH_TILE) * np.maximum(behind - before, 1).astype(np.float32)
        known = seen.take(before, axis) * seen.take(behind, axis)
        slope = known * (motion.take(behind, axis) - motion.take(before, axis))
        change += motion[..., 1 - axis, None] * slope / between.reshape((-1, 1, 1) if axis == 0 else (1, -1, 1))
    # What changes by more than itself does not turn: it borders on what moves another way.
    size = np.hypot(change[..., 0], change[..., 1]) * np.float32(0.5 * duration)
    speed = np.hypot(motion[..., 0], motion[..., 1])
    ways[..., 2:] = change * (np.minimum(speed, size) / np.maximum(size, TINY_SHARE))[..., None]
    return ways


def _blurred_along(passing: Image, local: Image, factor: int) -> Image:
    """Blur what passed a layer along its paths, in pixels so many times as wide."""
    small = passing
    if factor > 1:
        small = np.empty([-(-size // factor) for size in passing.shape], np.float32)
        for_bands(_sweep_kernels.shrink, len(small), passing, factor, small)
    blurred = np.empty_like(small)
    path = local / np.array((factor, factor, 1.0), np.float32)
    for_bands(_visibility_kernels.blur_along, len(small), small, path, PATH_TILE // factor, blurred)
    return enlarged(blurred, passing.shape, factor)


def _local_paths(members: Sequence[Membership], paths: Sequence[Image], number: int) -> tuple[Image, float]:
    """Return a layer's mean paths around tiles, see `blur_along`, and the mean square of what differs from them."""
    shape = members[0].variant.shape
    sums = np.zeros((4, *(-(-size // PATH_TILE) for size in shape)), np.float32)
    for each, path in zip(members, paths, strict=True):
        for_bands(_visibility_kernels.sum_paths, sums.shape[1], tuple(each), path, number, PATH_TILE, sums)
    share, x, y, square = sums
    # What turns moves unlike around, but alike in a tile.
    unlike = float((square - (x * x + y * y) / np.maximum(share, TINY_SHARE)).sum(dtype=np.float64))
    unlike /= max(float(share.sum(dtype=np.float64)), 1e-6)
    share, x, y = (box_blurred(np.ascontiguousarray(each), PATH_AROUND, times=2) for each in sums[:3])
    found = np.maximum(share, TINY_SHARE)
    seen = box_blurred(np.ascontiguousarray(sums[0]), PATH_AROUND) > TINY_SHARE
    local = np.stack([x / found, y / found, seen.astype(np.float32)], axis=-1)
    return local, max(unlike, 0.0)


def _largest(values: Image) -> float:
    """Return the largest absolute value."""
    return max(float(values.max()), -float(values.min()))
