"""From linear images to the bytes of a canvas: exposure and sRGB by a table, and overlays in colours."""

from __future__ import annotations

import functools

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import FloatArray
from spreadlets.parallel import for_bands
from spreadlets.scene.display import display_encode
from spreadlets.view import _picture_kernels

Bytes = npt.NDArray[np.uint8]

IN_FOCUS_PX = 0.5
"""CoC radius up to which the overlay shows a pixel as sharp."""
OVERLAY_SHARE = 0.7
"""Of the overlay's colour in the picture."""
NEAR_COLOURS = ((0.0, 0.9, 0.4), (0.1, 0.7, 1.0), (0.2, 0.2, 1.0))
FAR_COLOURS = ((0.0, 0.9, 0.4), (1.0, 0.8, 0.1), (1.0, 0.15, 0.1))
"""From sharp to the largest blur, in front of the focus and behind it."""
DEPTH_COLOURS = ((0.1, 0.05, 0.25), (0.2, 0.35, 0.6), (0.1, 0.65, 0.55), (0.6, 0.85, 0.3), (1.0, 0.95, 0.5))
"""From far to near."""
MOST_TABLES = 8
"""Exposures whose tables are kept, half a megabyte each."""


def shown(image: FloatArray, exposure: float) -> Bytes:
    """Return a linear image (H, W, 3 or 4) as the bytes of a canvas, (H, W, 4): sRGB, brighter by some stops, opaque.

    Notes
    -----
    Through a table of floats of fewer bits: a tenth of a display's step at most, and fast.
    """
    canvas = np.empty((*image.shape[:2], 4), np.uint8)
    bits = np.ascontiguousarray(image).view(np.uint32)
    for_bands(_picture_kernels.encode, len(canvas), bits, _table(exposure), canvas)
    return canvas


@functools.lru_cache(maxsize=MOST_TABLES)
def _table(exposure: float) -> Bytes:
    """Return the display's code of each float, by its first bits, brighter by some stops."""
    first = np.arange(_picture_kernels.N_CODES, dtype=np.uint32) << np.uint32(_picture_kernels.DROPPED_BITS)
    # A code stands for the floats from its own bits on: that in their middle is nearest to all. Infinity is alone.
    middle = (first | np.uint32(1 << _picture_kernels.DROPPED_BITS - 1)).view(np.float32)
    values = np.where(np.isinf(first.view(np.float32)), first.view(np.float32), np.nan_to_num(middle, nan=0.0))
    with np.errstate(over="ignore"):
        scaled = values * np.float32(2.0**exposure)
    return np.asarray(np.rint(255.0 * display_encode(scaled)), np.uint8)


def with_coc(picture: Bytes, coc: FloatArray) -> Bytes:
    """Lay the circles of confusion over a picture: green is sharp, towards blue in front, towards red behind."""
    largest = max(float(np.abs(coc[np.isfinite(coc)]).max(initial=0.0)), IN_FOCUS_PX)
    share = np.clip((np.abs(coc) - np.float32(IN_FOCUS_PX)) / np.float32(largest), np.float32(0.0), np.float32(1.0))
    colours = np.where((coc < 0.0)[..., None], _ramp(share, NEAR_COLOURS), _ramp(share, FAR_COLOURS))
    return _laid_over(picture, colours)


def with_depth(picture: Bytes, depth: FloatArray) -> Bytes:
    """Lay the depth over a picture, by its inverse."""
    inverse = np.float32(1.0) / depth
    least, most = float(inverse.min()), float(inverse.max())
    return _laid_over(picture, _ramp((inverse - least) / max(most - least, 1e-9), DEPTH_COLOURS))


def _ramp(share: FloatArray, colours: tuple[tuple[float, float, float], ...]) -> FloatArray:
    places = np.linspace(0.0, 1.0, len(colours))
    channels = [np.interp(share, places, channel) for channel in zip(*colours, strict=True)]
    return np.stack(channels, axis=-1, dtype=np.float32)


def _laid_over(picture: Bytes, colours: FloatArray) -> Bytes:
    mixed = picture.copy()
    grey = picture[..., :3].mean(axis=2, keepdims=True)
    mixed[..., :3] = (1.0 - OVERLAY_SHARE) * grey + OVERLAY_SHARE * 255.0 * colours
    return mixed
