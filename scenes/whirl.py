"""Objects that whirl in three rings about a hub, over a chequered floor: turning motion at many depths."""

from __future__ import annotations

import math
import random

from blocks import QUARTER, add, ambient, area_light, box, head, material, moved, plane, sphere, spin, textured, turned
from shot import Shot

SHOT = Shot(focal_length_mm=60, f_number=0.075, focus_distance_m=5.6, place=(0.0, 0.0, 1.3), pitch=-0.13, n_layers=3)
HUB = (0, 7.2, 0)
RINGS = ((1.15, 0.25, 7, 0.45), (2.0, -0.55, 11, -0.30), (2.9, 0.75, 13, 0.22))
"""Radius and height, metres; number of objects; radians per frame."""
COLOURS = (
    (0.9, 0.2, 0.15),
    (0.2, 0.6, 0.9),
    (0.95, 0.8, 0.2),
    (0.3, 0.8, 0.35),
    (0.8, 0.3, 0.8),
    (0.95, 0.95, 0.95),
)
NEAR_M, MIDDLE_M = 6.3, 8.2
"""Depths at which layers end."""


def _object(number: int, size: float):
    """Return a mesh and its material: ball, box, head, ball by turns; one ball is of metal, the rest has patterns."""
    kind, colour = number % 4, COLOURS[number % len(COLOURS)]
    mesh = (sphere(size), box(1.5 * size, 1.5 * size, 1.5 * size), head(size * 1.1), sphere(size))[kind]
    if kind == 0:
        return mesh, material(colour, metallic=0.9, roughness=0.25)
    dark = tuple(0.15 * each for each in colour)
    pattern = "noise" if kind == 2 else "checker"
    return mesh, textured(pattern, (colour, dark), 6.0, roughness=0.3)


def build() -> None:
    """Build the scene."""
    chance = random.Random(5)
    ambient((0.5, 0.55, 0.65), 0.5)
    floor = textured("checker", ((0.5, 0.45, 0.4), (0.14, 0.12, 0.16)), 0.7, roughness=0.7)
    add(plane(40, 40), floor, (0, 10, -1.3), layer=2)
    wall = textured("noise", ((0.1, 0.16, 0.3), (0.5, 0.35, 0.25)), 0.4, roughness=0.9)
    add(plane(40, 20), wall, (0, 16, 0), angles=(QUARTER, 0, 0), layer=2)
    number = 0
    for ring, (radius, height, count, velocity) in enumerate(RINGS):
        for index in range(count):
            angle = 2 * math.pi * index / count + 0.2 * ring
            mesh, of = _object(number, chance.uniform(0.2, 0.33))
            if number % 4 != 2:
                turned(mesh, chance.uniform(0, 3), "X")
            turned(mesh, angle + math.pi / 2, "Z")
            place = radius * math.cos(angle), radius * math.sin(angle), height + chance.uniform(-0.25, 0.25)
            depth = HUB[1] + place[1]
            layer = 0 if depth < NEAR_M else 1 if depth < MIDDLE_M else 2
            item = add(moved(mesh, place), of, HUB, layer=layer, smooth=number % 4 != 1)
            spin(item, (0, 0, 1), 0, velocity)
            number += 1
    add(sphere(0.35), material((0.9, 0.9, 0.9), metallic=1, roughness=0.15), (0, 7.2, 0.1), layer=1, smooth=True)
    area_light((-4, 2, 6), (0, 7, 0), 1.0, 1500)
    area_light((5, 3, 4), (0, 7, 0), 0.6, 900, (1, 0.8, 0.6))
