"""How much a display shows of a change: the slope of its curve, for the kernels that hold errors against it."""

import numpy as np

from spreadlets.compiled import helper

LINEAR_END = np.float32(0.0031308)
LINEAR_SLOPE = np.float32(12.92)
"""The linear part of the sRGB curve: where it ends, and how steep it is."""


@helper
def display_slope(level):
    """Return the slope of the sRGB curve at a linear level; beyond 1, where the display clips, that at 1."""
    if level <= LINEAR_END:
        return LINEAR_SLOPE
    return np.float32(1.055 / 2.4) * min(level, np.float32(1.0)) ** np.float32(1.0 / 2.4 - 1.0)
