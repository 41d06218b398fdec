"""What the tests of the page look at."""

import numpy as np

import spreadlets as sp

CAMERA = sp.ThinLens(focal_length_mm=80, sensor_width_mm=36, f_number=1.0, focus_distance_m=2.0)
SHAPE = (96, 128)
DEPTHS = {(24, 30): 1.5, (64, 30): 2.0, (104, 30): 4.0, (5, 90): 9.0}
"""Depth at places (x, y): three objects before a wall."""


def make_frame():
    rng = np.random.default_rng(3)
    depth = np.full(SHAPE, 9.0, np.float32)
    for (x, y), z in list(DEPTHS.items())[:3]:
        depth[y - 16 : y + 16, x - 14 : x + 14] = z
    motion = np.zeros((*SHAPE, 2), np.float32)
    motion[depth == 4.0] = (6.0, 0.0)
    return sp.Frame(rng.random((*SHAPE, 3)).astype(np.float32), depth, motion)
