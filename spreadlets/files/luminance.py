"""Luminance and chroma as OpenEXR stores them, Y, RY and BY, the chroma of every second pixel: as R, G and B."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import FloatArray
from spreadlets.files.attributes import chromaticities
from spreadlets.files.exr_parts import Image, Plane

NAMES = ("Y", "RY", "BY")

REC_709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
"""Chromaticities x, y of red, green, blue and white, which OpenEXR takes where the file does not say."""


def luminance_weights(xy: Sequence[float]) -> FloatArray:
    """Return the share of red, green and blue in the luminance, (3,).

    Parameters
    ----------
    xy : sequence of 8 floats
        Chromaticities x, y of red, green, blue and white.

    Examples
    --------
    >>> luminance_weights(REC_709).round(3).tolist()
    [0.2129999..., 0.715..., 0.0719999...]
    """
    x, y = np.reshape(np.asarray(xy, np.float64), (4, 2)).T
    xyz = np.stack([x, y, 1 - x - y])  # each up to a factor
    factors = np.linalg.solve(xyz[:, :3], xyz[:, 3] / y[3])
    return np.asarray(factors * xyz[1, :3], np.float32)


def with_rgb(image: Image) -> Image:
    """Return an image with R, G and B in place of Y, RY and BY, if it holds these; any other as it is.

    Parameters
    ----------
    image : Image
        The channels of a file.

    Returns
    -------
    Image

    Notes
    -----
    RY = (R - Y) / Y and BY = (B - Y) / Y, as in OpenEXR's ImfRgbaYca.h; chroma between stored pixels is interpolated.
    """
    if not set(NAMES) <= image.planes.keys() or {"R", "G", "B"} <= image.planes.keys():
        return image
    y, ry, by = (image.planes[name] for name in NAMES)
    if y.sampling != (1, 1) or y.pixels.shape != (y.window.height, y.window.width):
        return image
    luminance = np.asarray(y.pixels, np.float32)
    red, blue = ((_spread(chroma, luminance.shape) + 1) * luminance for chroma in (ry, by))
    own = chromaticities(image.parts[y.part].attributes) if image.parts else None
    weights = luminance_weights(own or REC_709)
    green = (luminance - weights[0] * red - weights[2] * blue) / weights[1]
    planes = {name: plane for name, plane in image.planes.items() if name not in NAMES}
    for name, pixels in zip("RGB", (red, green, blue), strict=True):
        planes[name] = replace(y, pixels=pixels, bare=name, place=name)
    names = tuple(name for name in image.names if name not in NAMES)
    return replace(image, planes=planes, names=(*names, "R", "G", "B"))


def _spread(chroma: Plane, shape: tuple[int, ...]) -> FloatArray:
    """Return a value for each pixel of a channel that has one for every few columns and rows."""
    rows = _between(np.asarray(chroma.pixels, np.float32), shape[0], chroma.sampling[1])
    return _between(rows.T, shape[1], chroma.sampling[0]).T


def _between(values: npt.NDArray[Any], n: int, step: int) -> FloatArray:
    """Return n rows that run linearly between given ones, which are so many rows apart."""
    place = np.minimum(np.arange(n) / step, len(values) - 1)
    first = np.minimum(place.astype(np.int64), max(len(values) - 2, 0))
    share = (place - first).astype(np.float32)[:, None]
    return np.asarray((1 - share) * values[first] + share * values[np.minimum(first + 1, len(values) - 1)], np.float32)
