"""Cases of laws that hold for every frame: linearity, symmetry, energy, continuity; and of nearly singular fits."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from spreadlets.errors import InvalidParameterError
from spreadlets.parallel import limit_threads
from spreadlets.precompute.sparsify.fit import fit_values, moment_constraints
from spreadlets.reports.stability.lab import (
    CAMERA,
    Array,
    Lab,
    case,
    cases,
    depth_of,
    frame_of,
    texture,
    with_camera,
    worst,
)
from spreadlets.scene.display import display_encode
from spreadlets.scene.frame import Frame

SIDE = 72
LAW_BUDGET = 1e-3
"""Largest difference, of a texture that fills 0 to 1."""
FILL_LIMIT = "what nothing was seen of is filled from a pyramid, whose blocks lie at multiples of powers of two"


def random_labels(seed: int, *, alike: bool = False) -> tuple[Array, Array]:
    """Return depth and motion of a few surfaces; they move alike, or leave holes between them."""
    rng = np.random.default_rng(seed)
    kind = (np.indices((SIDE, SIDE)) // 18).sum(axis=0) % 4
    coc, path = rng.uniform(-10, 10, 4)[kind], rng.uniform(-20, 20, (4, 2))[kind * (not alike)]
    return depth_of(coc, SIDE), path / CAMERA.shutter_duration


# --- linearity


def framed(seed: int) -> Array:
    """Return a texture with an even rim."""
    image = np.full((SIDE, SIDE, 3), 0.5, np.float32)
    image[8:-8, 8:-8] = texture(SIDE - 16, SIDE - 16, seed)
    return image


@case(
    "linearity",
    "sum of frames",
    given="two textures, up to the border, on a slanted plane that moves, tolerance 0",
    oracle="the image of the sum is the sum of the images",
    budget=1e-5,
)
def linear(lab: Lab) -> float:
    """Rendering is linear in radiance, and so is what goes on beyond the border."""
    slant = depth_of(np.broadcast_to(np.linspace(-10, 10, SIDE), (SIDE, SIDE)), SIDE)
    motion = np.broadcast_to(np.array((20.0, -8.0)), (SIDE, SIDE, 2))
    return sum_error(lab, [texture(SIDE, SIDE, seed) for seed in (1, 2)], slant, motion)


@case(
    "linearity",
    "sum of frames with edges",
    given="two textures with even rims and the same labels, four surfaces, tolerance 0",
    oracle="the image of the sum is the sum of the images",
    budget=0.03,
    limit="at edges the surfaces' shares of a pixel, and what lies hidden, follow from colours, which is not linear",
)
def linear_at_edges(lab: Lab) -> float:
    """Where surfaces meet it is nearly so."""
    return sum_error(lab, [framed(seed) for seed in (1, 2)], *random_labels(5))


def sum_error(lab: Lab, colours: Sequence[Array], depth: Array, motion: Array) -> float:
    """Return how far the image of two frames' sum is from the sum of their images."""
    first, second = colours
    images = [lab.render(Frame(each, depth, motion))[..., :3] for each in (first, second, first + second)]
    return worst(images[2] - images[0] - images[1])


# --- symmetry


@case(
    "symmetry",
    "time",
    given="surfaces of random labels; their motion reversed, centred shutter",
    oracle="the same image",
    budget=1e-6,
)
def reversed_motion(lab: Lab) -> float:
    """A centred shutter does not tell forwards from backwards."""
    depth, motion = random_labels(6)
    colours = texture(SIDE, SIDE)
    forward, backward = (lab.render(Frame(colours, depth, sign * motion)) for sign in (1, -1))
    return worst(forward - backward)


@case(
    "symmetry",
    "time, shutter after the frame",
    given="surfaces of random labels, shutter (0, 0.5); their motion reversed, shutter (-0.5, 0)",
    oracle="the same image",
    budget=1e-6,
)
def reversed_shutter(lab: Lab) -> float:
    """Reversing time and shutter changes nothing."""
    depth, motion = random_labels(7)
    colours = texture(SIDE, SIDE)
    forward = lab.render(Frame(colours, depth, motion), with_camera(shutter=(0.0, 0.5)))
    backward = lab.render(Frame(colours, depth, -motion), with_camera(shutter=(-0.5, 0.0)))
    return worst(forward - backward)


def mirror_error(lab: Lab, how: str, labels: tuple[Array, Array], **options: Any) -> float:
    """Return the difference of the turned frame's image from the turned image."""
    depth, motion = labels
    turn, vector = MIRRORS[how]
    colours = framed(1)
    straight = lab.render(Frame(colours, depth, motion), **options)
    turned = lab.render(Frame(turn(colours), turn(depth), turn(motion) @ np.array(vector, np.float64)), **options)
    return worst(turned - turn(straight))


MIRRORS: dict[str, tuple[Callable[[Array], Array], tuple[tuple[int, int], tuple[int, int]]]] = {
    "mirrored left to right": (lambda image: image[:, ::-1], ((-1, 0), (0, 1))),
    "mirrored top to bottom": (lambda image: image[::-1], ((1, 0), (0, -1))),
    "transposed": (lambda image: image.swapaxes(0, 1), ((0, 1), (1, 0))),
}
"""How an image is turned, and the matrix that turns its motion."""


@cases(
    "symmetry",
    "{}",
    tuple(MIRRORS),
    given="surfaces that move alike, CoC -10 to 10 px, one layer; reversed in space, with their motion",
    oracle="the image, reversed",
    budget=LAW_BUDGET,
)
def mirrored(lab: Lab, how: str) -> float:
    """The pixel grid's symmetries."""
    return mirror_error(lab, how, random_labels(8, alike=True), layers=1)


@cases(
    "symmetry",
    "{}, holes",
    tuple(MIRRORS),
    given="surfaces that move differently, in six layers; reversed in space, with their motion",
    oracle="the image, reversed",
    budget=0.01,
    limit=FILL_LIMIT,
)
def mirrored_holes(lab: Lab, how: str) -> float:
    """Filling does not quite keep them."""
    return mirror_error(lab, how, random_labels(8))


def shift_error(lab: Lab, by: tuple[int, int], labels: tuple[Array, Array], **options: Any) -> float:
    """Return the difference of the image of surfaces in an even frame from that of the same frame, shifted."""
    margin = 52
    side = SIDE + 2 * margin
    place = slice(margin, margin + SIDE)
    scene = np.full((side, side, 3), 0.5, np.float32)
    depth, motion = np.full((side, side), CAMERA.focus_distance_m), np.zeros((side, side, 2))
    scene[place, place], (depth[place, place], motion[place, place]) = texture(SIDE, SIDE), labels
    motion[...] = motion[margin, margin] if (labels[1] == labels[1][0, 0]).all() else motion
    arrays = scene, depth, motion
    straight = lab.render(Frame(*arrays), **options)
    moved = lab.render(Frame(*(np.roll(each, by, axis=(0, 1)) for each in arrays)), **options)
    return worst(np.roll(moved, (-by[0], -by[1]), axis=(0, 1)) - straight)


SHIFTS = ((1, 0), (0, 1), (13, 29))


@cases(
    "shift",
    "by {} px",
    SHIFTS,
    given="surfaces that move alike within an even frame, one layer; shifted by whole pixels",
    oracle="the image, shifted",
    budget=LAW_BUDGET,
)
def shifted(lab: Lab, by: tuple[int, int]) -> float:
    """Rendering does not depend on the place."""
    return shift_error(lab, by, random_labels(9, alike=True), layers=1)


@cases(
    "shift",
    "by {} px, holes",
    SHIFTS,
    given="surfaces that move differently within an even frame, six layers; shifted by whole pixels",
    oracle="the image, shifted",
    budget=0.16,
    limit=f"{FILL_LIMIT}; what lies hidden is copied by blocks that lie as these do",
)
def shifted_holes(lab: Lab, by: tuple[int, int]) -> float:
    """Filling does, a little."""
    return shift_error(lab, by, random_labels(9))


@case(
    "threads",
    "1 and all",
    given="surfaces of random labels on one thread, and on as many as there are",
    oracle="the same image",
    budget=0.0,
)
def any_threads(lab: Lab) -> float:
    """No sum depends on who takes it."""
    depth, motion = random_labels(10)
    frame = Frame(texture(SIDE, SIDE), depth, motion)
    with limit_threads(1):
        alone = lab.render(frame)
    return worst(lab.render(frame) - alone)


# --- energy


@cases(
    "energy",
    "CoC {0[0]:g} px, path {0[1]} px",
    ((3.0, (0, 0)), (12.0, (0, 0)), (0.0, (40, 9)), (-20.0, (-31, 17)), (60.0, (0, 0))),
    given="an opaque texture with a transparent margin that holds its blur",
    oracle="the sum of its light and of its alpha",
    budget=1e-4,
)
def energy(lab: Lab, label: tuple[float, tuple[float, float]]) -> float:
    """No light is lost or made."""
    coc, path = label
    margin = int(abs(coc) + 0.5 * np.hypot(*path)) + 12
    side = 2 * margin + 40
    radiance = np.zeros((side, side, 4), np.float32)
    radiance[margin:-margin, margin:-margin, :3] = texture(40, 40)
    radiance[margin:-margin, margin:-margin, 3] = 1.0
    image = lab.render(frame_of(radiance, coc, path))
    total = radiance.sum(axis=(0, 1), dtype=np.float64)
    return worst(image.sum(axis=(0, 1)) / total - 1.0)


# --- continuity

RACK_STEPS = 100
RACK_SIDE = 48


def flicker(lab: Lab, frames: npt.NDArray[np.float64], colours: Array, **options: Any) -> float:
    """Return the largest mean second difference of displayed images over frames of CoC radii (n, H, W) or (n,)."""
    shown = [display_encode(lab.render(frame_of(colours, coc), **options)[..., :3]) for coc in frames]
    return float(np.abs(np.diff(np.stack(shown), n=2, axis=0)).mean(axis=(1, 2, 3)).max())


@case(
    "continuity",
    "rack focus over a slanted surface",
    given=f"a texture whose CoC goes from -2 to -12 px over {RACK_STEPS} frames, and by 4 px from left to right",
    oracle="0: largest mean second difference between frames, displayed",
    budget=0.002,
)
def rack_slanted(lab: Lab) -> float:
    """Cells change here and there."""
    across = np.linspace(-2.0, 2.0, RACK_SIDE)
    middle = np.linspace(-4.0, -10.0, RACK_STEPS)
    return flicker(lab, middle[:, None, None] + np.tile(across, (RACK_SIDE, 1)), texture(RACK_SIDE, RACK_SIDE))


@case(
    "continuity",
    "rack focus over a flat surface",
    given=f"a texture of one depth whose CoC goes from -2 to -12 px over {RACK_STEPS} frames",
    oracle="0: largest mean second difference between frames, displayed",
    budget=0.004,
)
def rack_flat(lab: Lab) -> float:
    """Cells change all at once."""
    return flicker(lab, np.linspace(-2.0, -12.0, RACK_STEPS), texture(RACK_SIDE, RACK_SIDE))


# --- nearly singular fits

GRID_POINTS = [(row, col) for row in (-6, 0, 6) for col in (-6, 0, 6)]
FITS: dict[str, list[tuple[int, int]]] = {
    "two points": [(0, 0), (0, 5)],
    "collinear points": [(0, col) for col in range(-8, 9, 2)],
    "points on a circle's axes": [(0, 5), (0, -5), (5, 0), (-5, 0)],
    "duplicate points": [*GRID_POINTS, (0, 0)],
}
BARELY = {
    "one point off a line": [*((0, col) for col in range(-8, 9)), (1, 0), (-1, 3), (1, 3)],
    "neighbours only": [(row, col) for row in (-1, 0, 1) for col in (-1, 0, 1)],
    "far apart": [(400 * row, 400 * col) for row in (-1, 0, 1) for col in (-1, 0, 1)],
}


def disc_psf(radius: float = 6.0) -> Array:
    """Return a hard disc of unit sum, (17, 17, 1)."""
    rows, cols = np.indices((17, 17)) - 8
    image = (np.hypot(rows, cols) < radius).astype(np.float64)[..., None]
    return np.asarray(image / image.sum())


@cases(
    "fit",
    "{}",
    tuple(FITS),
    given="a disc of radius 6 px and points that cannot carry its moments, or not each of them",
    oracle="one error that says so; 1 if there is none",
    budget=0.0,
)
def singular_fit(lab: Lab, points: str) -> float:
    """No values are made up."""
    try:
        fit_values(disc_psf(), np.array(FITS[points], np.int64))
    except InvalidParameterError:
        return 0.0
    return 1.0


@cases(
    "fit",
    "{}",
    tuple(BARELY),
    given="a disc of radius 6 px and points that barely carry its moments",
    oracle="moments up to the second order, relative to the largest",
    budget=1e-6,
)
def barely_regular_fit(lab: Lab, points: str) -> float:
    """Moments hold, values stay finite."""
    psf, offset = disc_psf(), np.array(BARELY[points], np.int64)
    value = fit_values(psf, offset)
    matrix, target = moment_constraints(psf, offset)
    return worst(matrix @ value - target) / float(np.abs(target).max())
