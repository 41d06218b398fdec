"""A fence out of focus before a board that moves and a slanted floor, both chequered: what is hidden, and what is not.

After figure 8 of LRDM.
"""

from __future__ import annotations

import math

from blocks import QUARTER, add, ambient, area_light, box, move, plane, textured
from shot import Shot

SHOT = Shot(focal_length_mm=85, f_number=0.28, focus_distance_m=8.0, n_layers=3)
SPACING_M, SLANT_M = 0.165, 0.25
"""From bar to bar, and how much farther the right end of the fence is than its middle."""


def build() -> None:
    """Build the scene."""
    ambient((0.6, 0.65, 0.75), 0.6)
    wood = textured("noise", ((0.55, 0.32, 0.16), (0.3, 0.15, 0.07)), 6)
    for bar in range(-5, 6):
        place = bar * SPACING_M, 2.5 + SLANT_M * bar / 5, 0
        add(box(0.045, 0.03, 2.4), wood, place, angles=(0, math.radians(9), 0))
    along = math.atan2(SLANT_M, 5 * SPACING_M)
    for height in (-0.33, 0.33):
        add(box(2.4, 0.03, 0.05), wood, (0, 2.53, height), angles=(0, 0, along))
    chequered = textured("checker", ((0.9, 0.85, 0.75), (0.7, 0.1, 0.08)), 6.5)
    board = add(box(1.5, 0.05, 1.1), chequered, (-0.25, 8.0, 0.25), layer=1)
    move(board, (0.50, 0, -0.38))
    floor = textured("checker", ((0.92, 0.92, 0.92), (0.06, 0.09, 0.14)), 2.6, roughness=0.6)
    add(box(6, 0.05, 22), floor, (0.5, 13.5, -1.6), angles=(math.radians(62), 0, math.radians(18)), layer=2)
    sky = textured("noise", ((0.35, 0.5, 0.75), (0.75, 0.8, 0.85)), 0.35, roughness=0.9)
    add(plane(60, 60), sky, (0, 26, 0), angles=(QUARTER, 0, 0), layer=2)
    area_light((-4, 1, 6), (0, 8, 0), 1.5, 1500)
    area_light((3, -1, 3), (0, 10, 0), 0.8, 900, (1, 0.85, 0.7))
