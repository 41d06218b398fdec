"""Pixels that are no squares: the frame as squares, for what is round on the sensor, and the image back as pixels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import FloatArray
from spreadlets.scene.frame import Frame, Layer
from spreadlets.scene.raster import Raster, Window

WHOLE = 0.02
"""How far, relatively, a pixel aspect may lie from a whole number to count as one."""
FINER = 2
"""Squares along a pixel's shorter side, where its longer side would not be a whole number of them."""

Indices = npt.NDArray[np.intp]


def squared(frame: Frame) -> Frame:
    """Return a frame with every pixel repeated, so that its picture consists of squares.

    Parameters
    ----------
    frame : Frame
        Its raster tells the shape of a pixel.

    Returns
    -------
    Frame
        The same picture; the motion is in squares. The frame itself, if its pixels are squares.

    Notes
    -----
    A pixel of an aspect near 1, 2, 1/2 ... is a whole number of squares. One of another aspect is finer squares, not
    all of the same number: the light of a single pixel is then up to a third off, that of a surface is not.
    """
    if frame.raster.pixel_aspect == 1:
        return frame
    across, down = squares_per_pixel(frame.raster.pixel_aspect)
    rows, columns = _owners(frame.shape[0], down), _owners(frame.shape[1], across)
    data, display = (
        Window(round(w.left * across), round(w.top * down), len(_owners(w.width, across)), len(_owners(w.height, down)))
        for w in (frame.raster.data, frame.raster.display)
    )
    raster = Raster(data, display)
    return Frame.of([_repeated(layer, rows, columns, (across, down), raster) for layer in frame.layers])


def unsquared(image: FloatArray, raster: Raster) -> FloatArray:
    """Return an image (H, W, C) of the squares of a frame as the pixels of its raster: the means of their squares."""
    if raster.pixel_aspect == 1:
        return image
    for axis, factor in enumerate(reversed(squares_per_pixel(raster.pixel_aspect))):
        owners = _owners(raster.data.shape[axis], factor)
        first = np.searchsorted(owners, np.arange(raster.data.shape[axis]))
        counts = np.diff(first, append=len(owners)).astype(np.float32)
        sums = np.add.reduceat(image, first, axis=axis)
        image = np.asarray(sums / np.expand_dims(counts, [each for each in range(image.ndim) if each != axis]))
    return image


def squares_per_pixel(pixel_aspect: float) -> tuple[float, float]:
    """Return how many squares a pixel is wide and high; both are 1 or more."""
    longer = max(pixel_aspect, 1 / pixel_aspect)
    is_whole = abs(longer - round(longer)) <= WHOLE * longer
    longer, shorter = (float(round(longer)), 1.0) if is_whole else (FINER * longer, float(FINER))
    return (longer, shorter) if pixel_aspect > 1 else (shorter, longer)


def _owners(size: int, factor: float) -> Indices:
    """Return, along an axis of so many pixels, which pixel each square lies in by its middle."""
    middles = (np.arange(round(size * factor)) + 0.5) / factor
    return np.minimum(middles.astype(np.intp), size - 1)


def _repeated(layer: Layer, rows: Indices, columns: Indices, factors: tuple[float, float], raster: Raster) -> Layer:
    def repeat(values: FloatArray) -> FloatArray:
        return np.ascontiguousarray(values[rows][:, columns])

    def scale(motion: FloatArray) -> FloatArray:
        return repeat(motion) * np.array(factors, np.float32)

    before, after = layer.motion_prev, layer.motion_next
    nearer, farther = layer.depth_prev, layer.depth_next
    return replace(
        layer,
        radiance=repeat(layer.radiance),
        depth=repeat(layer.depth),
        motion=scale(layer.motion),
        motion_prev=None if before is None else scale(before),
        motion_next=None if after is None else scale(after),
        depth_prev=None if nearer is None else repeat(nearer),
        depth_next=None if farther is None else repeat(farther),
        raster=raster,
    )
