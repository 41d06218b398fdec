"""Highlights: pixels so bright that the rim of their PSF shows are drawn with a PSF of their own, and not of a cell.

The PSF of a cell is blurred over the cell: at the rim it is off by up to half of its level, which is invisible in a dim
pixel among its like, and all that is seen of a lamp. A pixel's error is its light times that of its PSF: where it would
show, the PSF is made at the pixel's own coordinate. Labels are rounded so that the pixels of a lamp, and neighbours
along a row, share one.

Only the light is drawn so. What the pixel covers, its alpha, stays with its cell as its neighbours' does, so that
together they still cover all.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import NOTHING, BoolArray, DoubleArray, FloatArray, Image, IntArray
from spreadlets.parallel import for_bands
from spreadlets.psf.exact import RADIUS_STEPS, THIN_RADIUS_PX, ExactPsf, heading_steps, longest_step
from spreadlets.psf.model import PsfModel
from spreadlets.psf.spreadlet import Spreadlet
from spreadlets.remembered import Remembered
from spreadlets.runtime.buffers import copied
from spreadlets.runtime.label.labels import HEADINGS, View
from spreadlets.runtime.label.lists import Pixels
from spreadlets.runtime.options import DEFAULT_TOLERANCE
from spreadlets.runtime.plan import _highlight_kernels
from spreadlets.runtime.plan._highlight_kernels import HEADING_BITS, HEADING_ZERO, NOT_ALONE, CodedLabels, CodeSteps
from spreadlets.runtime.plan._plan_kernels import INVISIBLE, SHARP
from spreadlets.runtime.plan.layering import Membership
from spreadlets.runtime.plan.pool import PlacedPixels, place_pixels

HALF_WIDTHS = 3, 15
"""Of the group of pixels that a highlight may be, and of its surroundings, px."""
STANDS_OUT = 5.0
"""How many times brighter than its surroundings a pixel of a highlight is; along a straight edge it is twice."""
MUCH_BRIGHTER = 2.0
"""How many times as bright a neighbour is for a pixel to be the edge of it, with its light."""
LEAST_KNOWN = 0.25
"""Share of its surroundings that must be known to tell whether a pixel stands out."""
LEAST_CHANGE = 10.0 * DEFAULT_TOLERANCE
"""Change of the display under a PSF from which its rim shows. A cell's PSF has a ramp in place of its rim, off by half
of the level at most; over the whole of the PSF that is a tenth of it in the mean, and so one step of the display."""
LONGEST_PATH = 2.0
"""Longest path of a light, in its CoC radii: a few times of the shutter then tell what is hidden of it."""
LARGEST_AREA = 1 << 18
"""Largest PSF that is drawn in full, px; a lamp that is spread over more has no rim to see."""


class Highlights(NamedTuple):
    """The pixels that have a PSF of their own.

    Attributes
    ----------
    places : list of ndarrays of shape (n,), int64
        For each set, the numbers in raster order of the pixels that have one, ascending.
    number : list of ndarrays of shape (n,), int32
        Which of the PSFs is theirs.
    psfs : list of Spreadlet
        Direct points, their rows ascending.
    lights : list of ndarrays of shape (n,), bool
        Which of them are no splats of a layer, but lights, see `runtime.finish.lights`.
    """

    places: list[IntArray]
    number: list[npt.NDArray[np.int32]]
    psfs: list[Spreadlet]
    lights: list[BoolArray]

    def dimmed(self, pixel_sets: Sequence[Pixels]) -> list[Pixels]:
        """Return the sets without the colours of highlights; their alpha stays."""
        return [_dimmed(pixels, at) for pixels, at in zip(pixel_sets, self.places, strict=True)]

    def without_lights(self, pixel_sets: Sequence[Pixels]) -> list[Pixels]:
        """Return the first sets without the colours of lights; their alpha stays."""
        found = zip(pixel_sets, self.places, self.lights, strict=False)
        return [_dimmed(pixels, at[chosen]) for pixels, at, chosen in found]

    def placed(
        self,
        pixel_sets: Sequence[Pixels],
        members: Sequence[Membership],
        first_variant: int,
        wide: BoolArray,
        *,
        completed: bool,
    ) -> Iterator[PlacedPixels]:
        """Yield the colours of highlights but for lights, without alpha, as lists of pixels to be pooled.

        Parameters
        ----------
        pixel_sets : sequence of Pixels
        members : sequence of Membership
            The layers of their pixels.
        first_variant : int
            Of all variants, the PSFs of highlights are those from this one on.
        wide : ndarray of shape (n_variants,), bool
            Variants whose centres are moved to the next pixel, see `runtime.plan.pool.place_pixels`.
        completed : bool
            Whether lamps that the frame's border cuts are drawn beyond it, too.
        """
        given = zip(pixel_sets, members, self.places, self.number, self.lights, strict=True)
        for pixels, member, found, numbers, lights in given:
            chosen, number = found[~lights], numbers[~lights]
            at = np.unravel_index(chosen, member.layer.shape)
            places, shift, trail = pixels.labels.view.places, pixels.labels.shift, pixels.labels.trail
            at_frame = (np.stack(at, axis=1).astype(np.int32) if places is None else places.at[at])[None]
            if completed:
                again, outwards = _completed(at_frame[0], pixels.labels.view.frame_shape)
                at_frame, number = (at_frame[0][again] + outwards)[None], number[again]
                at = tuple(each[again] for each in at)
            shift = np.zeros((1, len(number), 2), np.float32) if shift is None else shift[at][None]
            radiance = pixels.radiance[at][None]
            radiance[..., 3] = 0.0
            # Draw the parts in the nearer and the farther layers.
            for part, share in enumerate((1.0 - member.farther[at], member.farther[at])):
                label = (member.layer[at] + np.int32(part)) * np.int32(len(wide)) + np.int32(first_variant) + number
                label = np.where(share > 0.0, label, np.int32(-1))[None]
                weight = (share * pixels.weight[at] if len(pixels.weight) else share)[None]
                if (label >= 0).any():
                    own = None if trail is None else trail.of_pixels(at)
                    yield place_pixels(radiance, weight, label, shift, at_frame, wide, NOTHING, own)


def _completed(at: npt.NDArray[np.int32], shape: tuple[int, int]) -> tuple[IntArray, npt.NDArray[np.int32]]:
    """Return which pixels of lamps are drawn, by their numbers (n,), and how far outwards, (n, 2), px.

    All are drawn where they are, and those on the border again beyond it, as far as the disc reaches there that the
    border would cut as it does the lamp.
    """
    again, outwards = [np.arange(len(at))], [np.zeros((len(at), 2), np.int32)]
    lit = np.zeros(shape, np.bool_)
    lit[at[:, 0], at[:, 1]] = True
    for axis, sign in ((0, -1), (0, 1), (1, -1), (1, 1)):
        # Find runs of pixels along this side of the border.
        along = at[:, 1 - axis]
        side = np.flatnonzero(at[:, axis] == (0 if sign < 0 else shape[axis] - 1))
        side = side[np.argsort(along[side], kind="stable")]
        inwards = np.moveaxis(lit, axis, 0)[::-sign]
        for run in np.split(side, np.flatnonzero(np.diff(along[side]) > 1) + 1):
            steps = _steps_beyond(along[run], inwards)
            again.append(np.repeat(run, steps))
            moved = np.zeros((steps.sum(), 2), np.int32)
            moved[:, axis] = sign * (1 + np.arange(len(moved)) - np.repeat(np.cumsum(steps) - steps, steps))
            outwards.append(moved)
    return np.concatenate(again), np.concatenate(outwards)


def _steps_beyond(along: npt.NDArray[np.int32], inwards: BoolArray) -> IntArray:
    """Return how many pixels of a disc lie beyond the border, at the places of its chord along it.

    Parameters
    ----------
    along : ndarray of shape (n,), int32
        The places, ascending; some may come twice.
    inwards : ndarray of shape (rows, cols), bool
        Where lamps are, of which the first row is the border.
    """
    if not len(along):
        return np.zeros(0, np.int64)
    # Find the circle through both ends of the chord that is as deep as what is seen.
    chord = along[-1] - along[0] + 1
    depth = np.logical_and.accumulate(inwards[:, along], axis=0).sum(axis=0).max()
    radius = (depth**2 + 0.25 * chord**2) / (2.0 * depth)
    across = along - 0.5 * (along[0] + along[-1])
    beyond = np.sqrt(np.maximum(radius**2 - across**2, 0.0)) + radius - depth
    # Little of a disc is seen as a strip: then it may as well be one.
    return np.asarray(np.rint(np.clip(beyond, 0.0, chord)), np.int64)


def find_highlights(
    pixel_sets: Sequence[Pixels],
    keys: Sequence[IntArray],
    model: PsfModel,
    exact_psf: ExactPsf | None,
    *,
    stochastic: bool = False,
    lights: bool = False,
) -> Highlights:
    """Find the pixels whose light shows the rim of a PSF, and make their PSFs.

    Parameters
    ----------
    pixel_sets : sequence of Pixels
    keys : sequence of ndarrays of shape (H, W), int64
        The variant of each pixel of a pass, see `runtime.plan._plan_kernels.variant_keys`.
    model : PsfModel
    exact_psf : ExactPsf or None
        What makes the PSFs; None if there are none but those of cells.
    stochastic : bool
        Whether the pixels are samples, which may be missing.
    lights : bool
        Whether samples that do not move far are lights.
    """
    if exact_psf is None:
        none = [np.zeros(0, np.int64) for _ in keys]
        return Highlights(none, [each.astype(np.int32) for each in none], [], [each.astype(np.bool_) for each in none])
    found = _lights(pixel_sets, stochastic)
    sets = zip(pixel_sets, keys, found, strict=True)
    listed = [_listed(pixels, key, light.excess, model) for pixels, key, light in sets]
    alone = _from_sources(pixel_sets, keys, listed, found)
    used, number = np.unique(np.concatenate([codes for _, codes in alone]), return_inverse=True)
    ends = np.cumsum([len(at) for at, _ in alone])[:-1]
    view = pixel_sets[0].labels.view
    coordinates = _coordinates(used, model, view)
    psfs = list(exact_psf(*coordinates)) if len(used) else []
    places = [at for at, _ in alone]
    chosen = [lights & _are_lights(pixels, at) for pixels, at in zip(pixel_sets, places, strict=True)]
    return Highlights(places, np.split(number.astype(np.int32), ends), psfs, chosen)


def _are_lights(pixels: Pixels, at: IntArray) -> BoolArray:
    """Tell which pixels are drawn as lights: those that a list draws at steps of time are not."""
    if pixels.is_list:
        return np.zeros(len(at), np.bool_)
    labels = pixels.labels
    near = labels.length.ravel()[at] <= LONGEST_PATH * np.abs(labels.coc.ravel()[at])
    return near if pixels.curved is None else near & ~pixels.curved.ravel()[at]


def _dimmed(pixels: Pixels, highlights: IntArray) -> Pixels:
    if not len(highlights):
        return pixels
    radiance = copied(pixels.radiance)
    radiance.reshape(-1, 4)[highlights, :3] = 0.0
    return pixels._replace(radiance=radiance)


class _Light(NamedTuple):
    """What the colours of some sets say: how far each pixel stands out, and from what.

    Attributes
    ----------
    excess, level : ndarray of shape (H, W), float32
        See the kernels.
    light : ndarray of shape (H, W), float32
        How bright each pixel is; empty where all light is the pixel's own.
    """

    excess: FloatArray
    level: FloatArray
    light: FloatArray


def _lights(pixel_sets: Sequence[Pixels], stochastic: bool) -> list[_Light]:
    """Return what the colours of each set say; sets often share them, and lists stand out from a frame."""
    look = _light_of_samples if stochastic else _light_of_pixels
    found = [look(pixels.radiance if pixels.frame is None else pixels.frame) for pixels in pixel_sets]
    return [
        _listed_light(pixels, light) if pixels.is_list else light
        for pixels, light in zip(pixel_sets, found, strict=True)
    ]


def _light(radiance: Image, stochastic: bool) -> _Light:
    shape = radiance.shape[:2]
    light, (excess, level) = _brightest(radiance), np.empty((2, *shape), np.float32)
    # A pixel without a sample is not dark: nothing is known of it.
    counts = _row_sums(radiance[..., 3]) if stochastic else np.zeros((0, 0, 0), np.float32)
    limits = STANDS_OUT, LEAST_KNOWN
    n_stripes = -(-shape[1] // _highlight_kernels.COLUMNS)
    planes = light, _row_sums(light), counts
    for_bands(_highlight_kernels.standing_out, n_stripes, *planes, HALF_WIDTHS, limits, excess, level)
    # Neighbours among samples have seen a lamp through other places of the lens.
    return _Light(excess, level, NOTHING if stochastic else light)


def _listed_light(pixels: Pixels, frame: _Light) -> _Light:
    places, light = pixels.labels.view.places, _brightest(pixels.radiance)
    assert places is not None, "only lists have places"
    excess = np.empty_like(light)
    given = light, places.at, frame.excess, frame.level
    for_bands(_highlight_kernels.listed_excess, len(light), *given, STANDS_OUT, excess)
    # The surfaces of a list have light of their own.
    return _Light(excess, frame.level, NOTHING)


def _brightest(radiance: Image) -> FloatArray:
    light = np.empty(radiance.shape[:2], np.float32)
    for_bands(_highlight_kernels.brightest, len(light), radiance, light)
    return light


_light_of_pixels = Remembered(partial(_light, stochastic=False))
_light_of_samples = Remembered(partial(_light, stochastic=True))


def _from_sources(
    pixel_sets: Sequence[Pixels],
    keys: Sequence[IntArray],
    listed: Sequence[tuple[IntArray, IntArray]],
    lights: Sequence[_Light],
) -> list[tuple[IntArray, IntArray]]:
    """Return the highlights of each pass: their numbers in raster order, and their codes.

    The edges of lamps get the codes of what their light is from, in whichever pass that is drawn.
    """
    alone = []
    for key, (at, codes), light in zip(keys, listed, lights, strict=True):
        source = at
        if len(light.light):
            source = np.empty_like(at)
            for_bands(_highlight_kernels.sources_of_light, len(at), at, light.light, MUCH_BRIGHTER, source)
        most, best = np.zeros(len(at), np.float32), codes.copy()
        # What stays sharp needs no PSF of its own, save for the light that is another's.
        best[(source == at) & (key.ravel()[at] == SHARP)] = NOT_ALONE
        edges = source != at
        for pixels, other, (places, theirs), shared in zip(pixel_sets, keys, listed, lights, strict=True):
            if shared is not light or not edges.any() or not len(places):
                continue
            weight = np.where(other.ravel()[source] == INVISIBLE, np.float32(0.0), np.float32(1.0))
            if len(pixels.weight):
                weight *= pixels.weight.ravel()[source]
            number = np.minimum(np.searchsorted(places, source), len(places) - 1)
            better = edges & (weight > most) & (places[number] == source)
            most[better], best[better] = weight[better], theirs[number[better]]
        alone.append((at[best != NOT_ALONE], best[best != NOT_ALONE]))
    return alone


def _row_sums(plane: FloatArray) -> FloatArray:
    sums = np.empty((2, *plane.shape), np.float32)
    for_bands(_highlight_kernels.sums_along_rows, len(plane), np.ascontiguousarray(plane), HALF_WIDTHS, sums)
    return sums


def _listed(pixels: Pixels, key: IntArray, excess: FloatArray, model: PsfModel) -> tuple[IntArray, IntArray]:
    """Return the numbers, in raster order, and the codes of a pass's highlights."""
    labels, counts = pixels.labels, np.empty(len(key), np.int64)
    nothing = np.zeros((), np.float32)
    length = labels.length if model.has_motion else np.broadcast_to(nothing, key.shape)
    heading = HEADINGS[model.symmetry.heading](labels) if model.has_direction else nothing
    heading = np.broadcast_to(heading, (*key.shape, 2))
    sided = model.symmetry.sign != "ignored"
    steps = CodeSteps(RADIUS_STEPS, longest_step(model, labels.view.frame_shape[1]), THIN_RADIUS_PX, sided)
    given = key, excess, CodedLabels(labels.coc, length, heading), steps, (LEAST_CHANGE, float(LARGEST_AREA))
    for_bands(_highlight_kernels.count_highlights, len(key), *given, counts)
    at, code = np.empty((2, int(counts.sum())), np.int64)
    for_bands(_highlight_kernels.list_highlights, len(key), *given, np.cumsum(counts) - counts, at, code)
    return at, code


def _coordinates(codes: IntArray, model: PsfModel, view: View) -> tuple[DoubleArray, DoubleArray, IntArray]:
    """Return the coordinates (n, n_axes), directions (n,) and sides (n,) that codes stand for."""
    rest, mask = codes >> 2 * HEADING_BITS, (1 << HEADING_BITS) - 1
    radius = ((rest >> 1) / RADIUS_STEPS) ** 2
    step = heading_steps(radius, longest_step(model, view.frame_shape[1]))
    x, y = (((codes >> bits & mask) - HEADING_ZERO) * step for bits in (HEADING_BITS, 0))
    heading = np.hypot(x, y)
    known = {"coc": radius, "depth": radius, "motion": heading}
    known |= {"eccentricity": heading * view.sensor_mm_per_px, "field": heading / view.half_diagonal_px}
    coordinate = np.stack([known[axis.name] for axis in model.axes], axis=-1)
    return coordinate, np.arctan2(y, x), np.where(rest & 1, -1, 1).astype(np.int64)
