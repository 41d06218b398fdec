"""Small glossy coins that fall and spin before a wall, nearer than the focus, in it and beyond: strong bokeh."""

from __future__ import annotations

import random

from blocks import QUARTER, add, ambient, area_light, at, coin, material, move, plane, spin, textured
from mathutils import Vector
from shot import Shot

SHOT = Shot(focal_length_mm=85, f_number=0.2125, focus_distance_m=6.0, n_layers=4)
BANDS = ((2.9, 4.2, 20), (5.2, 7.5, 46), (8.5, 17.0, 120))
"""Nearest and farthest depth of each layer, metres, and how many coins it has."""
APART = 0.34
"""Least distance of two coins of a layer, metres."""
METALS = (((1, 0.72, 0.3), 0.36), ((0.9, 0.9, 0.92), 0.33), ((0.95, 0.5, 0.32), 0.38), ((0.7, 0.75, 0.85), 0.34))
"""Colour and roughness."""


def _places(chance: random.Random, near: float, far: float, count: int) -> list[Vector]:
    """Yield places that keep their distance; what is drawn between two of them is drawn from the same `chance`."""
    places: list[Vector] = []
    for _ in range(5000):
        depth, x, y = chance.uniform(near, far), chance.uniform(-1.1, 1.1), chance.uniform(-1.1, 1.1)
        place = Vector(at(depth, x, y, SHOT.focal_length_mm))
        if all((place - other).length >= APART for other in places):
            places.append(place)
            yield place
        if len(places) == count:
            return


def build() -> None:
    """Build the scene."""
    chance = random.Random(3)
    ambient((0.25, 0.3, 0.4), 0.25)
    metals = [material(colour, metallic=1, roughness=roughness) for colour, roughness in METALS]
    wall = textured("noise", ((0.05, 0.07, 0.12), (0.22, 0.15, 0.1)), 0.5, roughness=0.9)
    add(plane(30, 30), wall, (0, 20, 0), angles=(QUARTER, 0, 0), layer=3)
    count = 0
    for layer, band in enumerate(BANDS):
        for place in _places(chance, *band):
            shape = coin(chance.uniform(0.085, 0.14), 0.022)
            item = add(shape, metals[count % len(metals)], place, layer=layer, smooth=True)
            axis = Vector((chance.gauss(0, 1), chance.gauss(0, 0.4), chance.gauss(0, 1))).normalized()
            spin(item, axis, chance.uniform(0.6, 2.4), chance.uniform(-0.22, 0.22))
            # Farther coins are faster, so that all move about as far in the image.
            faster = place.y / 6.0 * 0.8 + 0.2
            move(item, (chance.gauss(0, 0.08) * faster, chance.gauss(0, 0.03), -chance.uniform(0.2, 0.5) * faster))
            count += 1
    area_light((-5, 0, 6), (0, 7, 0), 1.5, 1300)
    area_light((3, -4, 1.5), (0, 8, 0), 1.5, 1300, (1, 0.85, 0.7))
