"""A table at night, in focus, before a street of lamps: seen through real glass, whose bokeh changes over the image."""

from __future__ import annotations

import random
from typing import NamedTuple

from blocks import (
    QUARTER,
    Colour,
    add,
    ambient,
    area_light,
    at,
    box,
    glowing,
    head,
    plane,
    sphere,
    textured,
)
from glass import Lens
from shot import Glass, Shot

GLASS = Glass("double_gauss", focal_length_mm=85.0, f_number=2.1)
FOCUS_M = 2.0
LENS = Lens.focused(GLASS.path, GLASS.focal_length_mm, GLASS.f_number, FOCUS_M)
SHOT = Shot(
    focal_length_mm=LENS.image_scale_mm,
    f_number=LENS.image_scale_mm / (2 * LENS.entrance_radius_mm),
    focus_distance_m=FOCUS_M,
    shutter=0.0,
    aspect=0.625,
    pixel_filter="BLACKMAN_HARRIS",
    glass=GLASS,
)
"""The thin lens with the pupil and the image scale of the glass."""
LAMP_WIDTH = 1024
"""Radii of lamps and of their bokeh are in pixels of an image of this width."""
LAMP_COLOURS = (
    (1, 0.72, 0.38),
    (1, 0.62, 0.25),
    (0.55, 0.75, 1),
    (1, 0.3, 0.22),
    (0.4, 1, 0.55),
    (1, 0.93, 0.8),
    (0.9, 0.45, 1),
)
FAR_CORNERS = ((-0.965, 0.59), (0.965, 0.59), (-0.95, -0.22), (0.96, -0.25), (0, 0.02), (0.5, 0.31), (-0.5, 0.31))
TABLE = -0.30
"""Below this height of the image, in half widths, is the table."""
N_FAIRY, N_FOCUSED = 11, 8


class Lamp(NamedTuple):
    """A ball that shines: where (metres from the pupil: right, up, away), radius, colour, radiance."""

    place: tuple[float, float, float]
    radius: float
    colour: Colour
    radiance: float


def _lamp(chance: random.Random, x: float, y: float, depth: float, radius_px: float, peak: float) -> Lamp:
    """Return a lamp at a place of the image; its bokeh has a radiance of some `peak`, or it shows where it is small."""
    focal = SHOT.focal_length_px(LAMP_WIDTH)
    coc = abs(0.5 * SHOT.aperture_m * focal * (1 / FOCUS_M - 1 / depth))
    radiance = max(3.0, peak * max(1, coc / radius_px) ** 2) if coc > 2 else peak * 6
    right, away, up = at(depth, x, y, SHOT.focal_length_mm)
    return Lamp((right, up, away), radius_px / focal * depth, chance.choice(LAMP_COLOURS), radiance)


def lamps() -> list[Lamp]:
    """Return all lamps: of the street, far ones up to the corners, a near string, and some in focus."""
    chance, found = random.Random(8), []
    columns, rows = 9, 6
    for column in range(columns):
        for row in range(rows):
            x = (column + 0.5 + chance.uniform(-0.42, 0.42)) / columns * 2 - 1
            y = ((row + 0.5 + chance.uniform(-0.42, 0.42)) / rows * 2 - 1) * SHOT.aspect
            if y >= TABLE:
                depth = 1 / chance.uniform(1 / 30, 1 / 5)
                found.append(_lamp(chance, x, y, depth, chance.uniform(1.1, 2.8), chance.uniform(0.25, 1.6)))
    found += [_lamp(chance, x, y, 20, 1.6, 0.9) for x, y in FAR_CORNERS]
    for number in range(N_FAIRY):
        along = -1 + 2 * number / (N_FAIRY - 1)
        y = 0.50 - 0.16 * (1 - along**2) + chance.uniform(-0.02, 0.02)
        radius, peak = chance.uniform(1.2, 2.0), chance.uniform(0.3, 0.9)
        found.append(_lamp(chance, 0.97 * along, y, 0.92 + 0.04 * number, radius, peak))
    for _ in range(N_FOCUSED):
        x, y, depth = chance.uniform(-0.9, 0.9), chance.uniform(-0.25, 0.5), chance.uniform(1.85, 2.2)
        found.append(_lamp(chance, x, y, depth, chance.uniform(0.8, 1.6), 1.0))
    return found


def _table() -> None:
    """Add what is in focus or near it."""
    wood = textured("noise", ((0.42, 0.24, 0.12), (0.12, 0.06, 0.03)), 9.0, roughness=0.6)
    add(plane(2.2, 1.7), wood, (0, 2.1, -0.175))
    cube = textured("checker", ((0.9, 0.85, 0.7), (0.6, 0.1, 0.08)), 28.0)
    add(box(0.12, 0.12, 0.12), cube, (-0.14, 2.04, -0.115), angles=(0, 0, 0.5))
    fur = textured("noise", ((0.85, 0.55, 0.3), (0.35, 0.15, 0.08)), 30, roughness=0.35)
    monkey = add(head(0.085), fur, (0.12, 2.0, -0.07), angles=(0, 0, 0.35), smooth=True)
    monkey.modifiers.new("finer", "SUBSURF").render_levels = 2
    blue = textured("checker", ((0.3, 0.5, 0.9), (0.9, 0.9, 0.9)), 30.0, roughness=0.3)
    add(sphere(0.05, 48), blue, (0.25, 1.45, -0.125), smooth=True)
    yellow = textured("cells", ((0.9, 0.8, 0.2), (0.2, 0.1, 0.02)), 25.0, roughness=0.3)
    add(sphere(0.06, 48), yellow, (-0.27, 2.6, -0.115), smooth=True)


def _street() -> None:
    """Add what is behind the table."""
    floor = textured("checker", ((0.20, 0.20, 0.22), (0.05, 0.05, 0.06)), 0.9, roughness=0.6)
    add(plane(60, 60), floor, (0, 30, -1.15))
    wall = textured("noise", ((0.02, 0.03, 0.06), (0.07, 0.06, 0.09)), 0.5, roughness=0.9)
    add(plane(60, 30), wall, (0, 32, 5), angles=(QUARTER, 0, 0))
    stone = textured("checker", ((0.5, 0.45, 0.4), (0.1, 0.09, 0.09)), 5.0, roughness=0.7)
    for x, y, width in ((-1.1, 6, 0.18), (0.75, 4.2, 0.10), (1.9, 9, 0.3), (-0.35, 11, 0.25)):
        add(box(width, width, 6), stone, (x, y, 0), angles=(0, 0, 0.4))


def build() -> None:
    """Build the scene."""
    ambient((0.02, 0.03, 0.06), 0.25)
    _table()
    _street()
    area_light((-1.5, 0.6, 2.2), (0, 2.1, -0.1), 0.5, 26, (1, 0.85, 0.7))
    area_light((3, 2, 4), (0, 8, 0), 1.0, 260, (0.7, 0.8, 1))
    for (right, up, away), radius, colour, radiance in lamps():
        ball = add(sphere(radius, 16), glowing(colour, radiance), (right, away, up), smooth=True)
        ball.visible_diffuse = ball.visible_glossy = ball.visible_shadow = False
