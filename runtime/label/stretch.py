"""Stretch: how much more, or less, of the picture a moving surface covers while the shutter is open.

Where neighbours move apart, as on what comes nearer or is read out row by row, each pixel stands for more than a pixel.
An image that is full of light is divided by what was drawn of it. What has nothing behind is not: there its pixels must
cover as much as they stand for, or one could see through it.
"""

from __future__ import annotations

import numpy as np

from spreadlets.arrays import Image
from spreadlets.parallel import for_bands
from spreadlets.runtime.label import _stretch_kernels
from spreadlets.runtime.label.moving import places_at
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.frame import Layer

LEAST_CHANGE = 1e-3
"""A change of all areas below which nothing is changed: a quarter of a step of a display."""


def stretch(layer: Layer, camera: ThinLens) -> Image | None:
    """Return what each pixel of a layer covers in the mean over the shutter, in pixels; None where all cover one.

    Parameters
    ----------
    layer : Layer
    camera : ThinLens

    Returns
    -------
    ndarray of shape (H, W), float32, or None

    Notes
    -----
    The area is the determinant of the places' derivatives, by Simpson's rule over the shutter: exact for straight
    paths.
    """
    area = np.zeros(layer.shape, np.float32)
    for time, share in zip((camera.shutter[0], camera.shutter_centre, camera.shutter[1]), (1, 4, 1), strict=True):
        given = layer.depth, layer.radiance, places_at(layer, camera, time), np.float32(share / 6)
        for_bands(_stretch_kernels.add_areas, len(area), *given, area)
    return area if np.abs(area - 1.0).max() >= LEAST_CHANGE else None
