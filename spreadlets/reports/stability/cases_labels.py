"""Cases of labels: circles of confusion, motion, depth, lenses, shapes, depth layers, borders of cells."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np

from spreadlets.reports.stability.lab import (
    CAMERA,
    Array,
    Lab,
    case,
    cases,
    frame_of,
    mean_error,
    spot,
    spread,
    texture,
    with_camera,
    worst,
)
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.frame import Frame

DENSE_BUDGET = 0.004
"""Mean difference from the same PSFs drawn in full, as a share of the texture's range: a display's step."""
CONSTANT_BUDGET = 2e-3
"""Largest relative error on a frame of one colour."""
COLOUR = (0.8, 0.4, 0.1)
SIDE = 64


def against_dense(lab: Lab, frame: Frame) -> float:
    """Return the mean difference of a frame's image from that of the same PSFs drawn in full."""
    image, expected = (lab.render(frame, method=method)[..., :3] for method in ("spreadlets", "dense"))
    return mean_error(image, expected)


def constant_error(lab: Lab, frame: Frame, camera: ThinLens = CAMERA, **options: Any) -> float:
    """Return how far a frame of one colour is from that colour, relative to it."""
    image = lab.render(frame, camera, **options)[..., :3]
    return worst(image / np.array(COLOUR) - 1.0)


def plain(height: int, width: int) -> Array:
    """Return an image of one colour, (height, width, 3)."""
    return np.broadcast_to(np.array(COLOUR, np.float32), (height, width, 3))


# --- circles of confusion and motion


@cases(
    "CoC",
    "{} px, texture",
    (0.0, 0.3, 0.75, 3.0, -12.0, -64.0),
    given=f"a texture of {SIDE} px; the last PSF is twice as wide as the frame",
    oracle="the same PSFs drawn in full",
    budget=DENSE_BUDGET,
)
def coc_texture(lab: Lab, coc: float) -> float:
    """Radii from nothing to several frames."""
    return against_dense(lab, frame_of(texture(SIDE, SIDE), coc))


@cases(
    "CoC",
    "{} px, one colour",
    (0.0, 0.3, 0.75, -12.0, -64.0, -200.0, -1e5),
    given=f"a frame of {SIDE} px of one colour",
    oracle="the colour",
    budget=CONSTANT_BUDGET,
)
def coc_constant(lab: Lab, coc: float) -> float:
    """A blur changes no even surface."""
    return constant_error(lab, frame_of(plain(SIDE, SIDE), coc))


@cases(
    "CoC",
    "{} px stays in its pixel",
    (0.0, 0.1, 0.49),
    given="a texture blurred by no more than half a pixel",
    oracle="the texture",
    budget=1e-6,
)
def sharp(lab: Lab, coc: float) -> float:
    """What lies within a pixel is the pixel."""
    colours = texture(SIDE, SIDE)
    return worst(lab.render(frame_of(colours, coc))[..., :3] - colours)


PATHS = ((0.0, 0.0), (0.3, 0.2), (1.5, 0.0), (40.0, 7.0), (-90.0, 30.0), (300.0, 0.0))


@cases(
    "motion",
    "{} px, texture",
    PATHS,
    given=f"a texture of {SIDE} px moving by that over the shutter; 300 px is beyond frame and database",
    oracle="the same PSFs drawn in full",
    budget=DENSE_BUDGET,
)
def motion_texture(lab: Lab, path: tuple[float, float]) -> float:
    """Paths from nothing to several frames."""
    return against_dense(lab, frame_of(texture(SIDE, SIDE), 0.0, path))


@cases(
    "motion",
    "{} px, one colour",
    (*PATHS, (1e5, 0.0)),
    given=f"a frame of {SIDE} px of one colour",
    oracle="the colour",
    budget=CONSTANT_BUDGET,
)
def motion_constant(lab: Lab, path: tuple[float, float]) -> float:
    """Motion changes no even surface; the tests stop at 400 px."""
    longest = float(lab.size(400, 10**6))
    return constant_error(lab, frame_of(plain(SIDE, SIDE), 3.0, (min(path[0], longest), path[1])))


@cases(
    "motion",
    "out of the frame by {} px",
    (0.0, 10.0, 30.0),
    given="a bright pixel 5 px from the right border on its way out, path 30 px, shutter from the frame's time on",
    oracle="the share of the path within the frame times the light",
    budget=0.02,
)
def motion_outwards(lab: Lab, start: float) -> float:
    """Light leaves the frame with what carries it; ``start`` is where the shutter opens beyond 5 px before it."""
    size, length = 65, 30.0
    camera = with_camera(shutter=(start / length, start / length + 1.0))
    motion = np.broadcast_to(np.array((length, 0.0)), (size, size, 2))
    depth = np.full((size, size), CAMERA.focus_distance_m)
    image = lab.render(Frame(spot(size, 32, size - 6), depth, motion), camera)
    remaining = min(1.0, max(0.0, (5.5 - start) / length))
    return abs(float(image[..., 0].sum()) - remaining)


# --- depth and lens


def textured_plane(depth: float) -> Frame:
    """Return a texture at one depth, metres."""
    return Frame(texture(SIDE, SIDE), np.full((SIDE, SIDE), depth))


@case(
    "depth",
    "at the focus",
    given="a texture in focus",
    oracle="the texture",
    budget=1e-6,
)
def in_focus(lab: Lab) -> float:
    """No blur."""
    frame = textured_plane(CAMERA.focus_distance_m)
    return worst(lab.render(frame)[..., :3] - frame.radiance[..., :3])


@case(
    "depth",
    "1e9 m and infinity",
    given="a texture at 1e9 m",
    oracle="the texture at infinity",
    budget=1e-6,
)
def far_away(lab: Lab) -> float:
    """Infinity is a limit."""
    near, far = (lab.render(textured_plane(depth), with_camera(f_number=1.0)) for depth in (1e9, math.inf))
    return worst(near - far)


@cases(
    "depth",
    "{} m, one colour",
    (1e-6, 1e-3, 1e9, math.inf),
    given="a frame of one colour at that depth; at 1e-6 m the CoC radius is 4e7 px",
    oracle="the colour",
    budget=CONSTANT_BUDGET,
)
def extreme_depth(lab: Lab, depth: float) -> float:
    """The ends of depth."""
    return constant_error(lab, Frame(plain(SIDE, SIDE), np.full((SIDE, SIDE), depth)), with_camera(f_number=2.0))


@cases(
    "depth",
    "one pixel at {} m",
    (1e-6, 1e9, math.inf),
    given="bars in focus at 4 m before a texture at 12 m, f/0.02, and one black pixel at that depth",
    oracle="the frame without that pixel; mean error farther than 30 px from it",
    budget=DENSE_BUDGET,
)
def stray_depth(lab: Lab, depth: float) -> float:
    """A stray depth must not spoil the layers of the rest."""
    size = 96
    colours, rows_cols = texture(size, size), np.indices((size, size))
    depths = np.where(rows_cols[1] % 24 < 6, CAMERA.focus_distance_m, 12.0)
    camera = with_camera(f_number=0.1)
    usual = lab.render(Frame(colours, depths), camera)
    colours[8, 8], depths[8, 8] = 0.0, depth
    stray = lab.render(Frame(colours, depths), camera)
    far = np.hypot(*(rows_cols - 8)) > 30
    return mean_error(stray[far], usual[far])


@cases(
    "lens",
    "f/{}",
    (0.5, 1.4, 8.0, 64.0, 1000.0),
    given="a bright pixel at 0.5 m, 50 mm lens focused at 4 m",
    oracle="variance of a disc of the lens equation's radius; error relative to the radius squared plus 1 px^2",
    budget=0.1,
)
def f_number(lab: Lab, number: float) -> float:
    """Radii follow the f-number."""
    camera, size = with_camera(f_number=number), 65
    frame = Frame(spot(size, 32, 32), np.full((size, size), 0.5))
    radius = 0.5 * (0.05 / number) * (50.0 / 36.0 * size) * abs(1 / 4.0 - 1 / 0.5)
    image = lab.render(frame, camera)[..., 0]
    return abs(spread(image) - radius**2 / 2.0) / (radius**2 + 1.0)


@case(
    "lens",
    "focus at infinity",
    given="a bright pixel at 1 m, focus at infinity, f/1",
    oracle="variance of a disc of the lens equation's radius, relative",
    budget=0.1,
)
def focus_at_infinity(lab: Lab) -> float:
    """The limit of the lens equation."""
    size = 65
    frame = Frame(spot(size, 32, 32), np.full((size, size), 0.2))
    radius = 0.5 * 0.05 * (50.0 / 36.0 * size) / 0.2
    image = lab.render(frame, with_camera(f_number=1.0, focus_distance_m=math.inf))[..., 0]
    return abs(spread(image) / (radius**2 / 2.0) - 1.0)


# --- shapes


@cases(
    "shape",
    "{} px, one colour",
    ("1 x 1", "1 x 500", "500 x 1", "2 x 3", "101 x 103"),
    given="a frame of that shape and one colour, CoC 6 px, path (9, 4) px",
    oracle="the colour",
    budget=CONSTANT_BUDGET,
)
def shape(lab: Lab, sides: str) -> float:
    """Frames without room."""
    height, width = (int(side) for side in sides.split(" x "))
    return constant_error(lab, frame_of(plain(height, width), -6.0, (9, 4)))


@case(
    "shape",
    "8192 x 8192 px",
    given="a texture of 128 px repeated to 8192 (512 in the tests) px a side, CoC 6 px",
    oracle="the same repeated to 384 px, at the same phase, in the middle and off the far corner",
    budget=1e-3,
)
def large(lab: Lab) -> float:
    """Indices of a quarter of a billion floats."""
    tile, side = texture(128, 128), lab.size(512, 8192)

    def repeated(count: int) -> Array:
        # The lens is as wide in px for each size.
        radiance = np.tile(tile, (count, count, 1))
        return lab.render(frame_of(radiance, 6.0), layers=1)[..., :3]

    small = repeated(3)[128:256, 128:256]
    image = repeated(side // 128)
    middle, last = side // 256 * 128, side - 256
    return max(worst(image[at : at + 128, at : at + 128] - small) for at in (middle, last))


# --- depth layers

LAYER_COUNTS = (1, 2, 3, 6, 16, 64)


LAYERED_SIDE = 72


def plane_on_borders(layers: int) -> Array:
    """Return depths of columns whose inverse lies exactly on the borders of so many layers, again and again."""
    nearness = 0.5 - 0.4 * (np.arange(LAYERED_SIDE) % (layers + 1)) / layers
    return np.broadcast_to(1.0 / nearness, (LAYERED_SIDE, LAYERED_SIDE))


@cases(
    "layers",
    "{}, sharp",
    LAYER_COUNTS,
    given="a texture seen through a pinhole, every depth on a border of two layers",
    oracle="the texture",
    budget=1e-6,
)
def sharp_layers(lab: Lab, layers: int) -> float:
    """Layers alone change nothing."""
    colours = texture(LAYERED_SIDE, LAYERED_SIDE)
    frame = Frame(colours, plane_on_borders(layers))
    return worst(lab.render(frame, with_camera(f_number=1e5), layers=layers)[..., :3] - colours)


@cases(
    "layers",
    "{}, one colour",
    LAYER_COUNTS,
    given="one colour, f/1, every depth on a border of two layers",
    oracle="the colour",
    budget=CONSTANT_BUDGET,
)
def even_layers(lab: Lab, layers: int) -> float:
    """No seams in an even surface."""
    frame = Frame(plain(LAYERED_SIDE, LAYERED_SIDE), plane_on_borders(layers))
    return constant_error(lab, frame, with_camera(f_number=1.0), layers=layers)


@cases(
    "layers",
    "{}, a hair off the border",
    LAYER_COUNTS,
    given="a texture, f/1, every depth a float32 step before or behind the border of two layers",
    oracle="every depth on the border",
    budget=1e-3,
)
def beside_borders(lab: Lab, layers: int) -> float:
    """Continuous in depth."""
    depth = np.float32(plane_on_borders(layers))
    sides = np.where(np.random.default_rng(3).random(depth.shape) < 0.5, np.float32(0), np.float32(np.inf))
    frames = (Frame(texture(LAYERED_SIDE, LAYERED_SIDE), each) for each in (depth, np.nextafter(depth, sides)))
    on, beside = (lab.render(frame, with_camera(f_number=1.0), layers=layers) for frame in frames)
    return mean_error(on, beside)


@cases(
    "layers",
    "{}, sharp, between borders",
    (3, 6, 16),
    given="a texture seen through a pinhole, on a slanted plane",
    oracle="the texture",
    budget=0.03,
    limit="with --softness, a sharp surface that runs through layers mixes with its neighbours near the cuts, by a "
    "fiftieth of the contrast",
)
def sharp_between(lab: Lab, layers: int) -> float:
    """Where less than 0.3 of a pixel lies in a layer, its colour there is filled."""
    colours = texture(LAYERED_SIDE, LAYERED_SIDE)
    nearness = np.broadcast_to(np.linspace(0.5, 0.1, LAYERED_SIDE), (LAYERED_SIDE, LAYERED_SIDE))
    image = lab.render(Frame(colours, 1.0 / nearness), with_camera(f_number=1e5), layers=layers, softness=1.0)
    return worst(image[..., :3] - colours)


# --- borders of the grid's cells


def axis_borders(lab: Lab, axis: int) -> list[tuple[float, float]]:
    """Return places on the borders that cells share across an axis: (CoC, motion), each in the middle of its side."""
    boxes = lab.database.grid.boxes
    inner = boxes[boxes[:, axis, 1] < lab.database.grid.maximum[axis]]
    places = inner.mean(axis=2)
    places[:, axis] = inner[:, axis, 1]
    return [(float(coc), float(motion)) for coc, motion in places]


def spot_image(lab: Lab, place: Array, half: int) -> Array:
    """Return the image (2 * half + 1 pixels square) of a bright pixel, moving to the right."""
    coc, length = (float(each) for each in place)
    size = 2 * half + 1
    return lab.render(frame_of(spot(size, half, half), -coc, (length, 0.0)))[..., 0]


@case(
    "cells",
    "index on every border",
    given="every corner and middle of a side of every cell's box, and float64's neighbours of them",
    oracle="a cell whose box holds the place",
    budget=0.0,
)
def border_index(lab: Lab) -> float:
    """No place falls between cells; the error is the number of places that did."""
    grid = lab.database.grid
    ends = np.concatenate([grid.boxes, grid.boxes.mean(axis=2, keepdims=True)], axis=2)
    corners = np.stack([ends[:, 0, [0, 0, 1, 1, 2, 2, 0, 1]], ends[:, 1, [0, 1, 0, 1, 0, 1, 2, 2]]], axis=-1)
    wrong = 0
    for towards in (-np.inf, None, np.inf):
        places = corners if towards is None else np.nextafter(corners, towards)
        places = np.clip(places, 0.0, grid.maximum)
        boxes = grid.boxes[grid.find(places)]
        slack = 1e-9 * grid.maximum
        wrong += int((~((boxes[..., 0] - slack <= places) & (places <= boxes[..., 1] + slack)).all(axis=-1)).sum())
    return float(wrong)


@cases(
    "cells",
    "jump across borders of {}",
    ("CoC", "motion"),
    given="a bright pixel a hair before and behind every border (every 80th in the tests) of two cells",
    oracle="the two cells' PSFs traced in full: the jump, L1, may exceed theirs by that much",
    budget=0.1,
)
def border_jump(lab: Lab, axis: str) -> float:
    """No jump larger than that between the neighbours' true PSFs."""
    number = ("CoC", "motion").index(axis)
    step = np.zeros(2)
    excess = 0.0
    for place in itertools.islice(axis_borders(lab, number), 0, None, lab.size(80, 1)):
        step[number] = 1e-6 * place[number]
        half = math.ceil(place[0] + 0.5 * place[1]) + 7
        before, after = (spot_image(lab, np.array(place) + side * step, half) for side in (-1, 1))
        traced = true_jump(lab, np.array(place) - step, np.array(place) + step)
        excess = max(excess, float(np.abs(after - before).sum()) - traced)
    return excess


def true_jump(lab: Lab, before: Array, after: Array) -> float:
    """Return the L1 distance of the full PSFs of two places' cells."""
    from spreadlets.api import DensePsfs

    traced = DensePsfs(lab.database)
    psfs = [traced(int(lab.database.find(place)), 0, 1.0)[..., 0] for place in (before, after)]
    sides = np.max([psf.shape for psf in psfs], axis=0)
    grown = [np.pad(psf, [((a - b) // 2,) * 2 for a, b in zip(sides, psf.shape, strict=True)]) for psf in psfs]
    return float(np.abs(grown[0] - grown[1]).sum())
