"""Parts of a frame: a smaller one for a quick look, what is held out of the blur, and what lies under a point."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from spreadlets.arrays import FloatArray
from spreadlets.errors import InvalidFrameError, InvalidParameterError, option
from spreadlets.scene.frame import BACKGROUND_DEPTH, LIKE_DEPTH, Frame, Layer, check_finite, real_array
from spreadlets.scene.raster import Raster, Window, overlap

HALF_SEEN = 0.5
"""Coverage from which a layer is what is seen in a pixel."""
AROUND = 3
"""Pixels on either side of a point whose depths are looked at."""


def smaller(frame: Frame, share: float) -> Frame:
    """Return a frame of fewer pixels for a quick look.

    Parameters
    ----------
    frame : Frame
    share : float
        Size of the new frame, above 0 to 1.

    Returns
    -------
    Frame
        Colours are means; depth and motion are those of the pixel in the middle of each new one, as renderers sample
        them, and the motion is in new pixels.

    Examples
    --------
    >>> import numpy as np
    >>> from spreadlets.scene.parts import smaller
    >>> smaller(sp.Frame(np.ones((40, 60, 3)), depth=np.ones((40, 60))), 0.5)
    Frame(20 x 30 px, 1 layer)
    """
    if share == 1.0:
        return frame
    raster = smaller_raster(frame.raster, share)
    return Frame.of([_smaller_layer(layer, raster) for layer in frame.layers])


def smaller_raster(raster: Raster, share: float) -> Raster:
    """Return where the pixels of a smaller frame lie."""
    if share == 1.0:
        return raster

    def less(window: Window) -> Window:
        left, top = (round(share * begin) for begin in window[:2])
        right, bottom = (round(share * (begin + size)) for begin, size in zip(window[:2], window[2:], strict=True))
        return Window(left, top, max(right - left, 1), max(bottom - top, 1))

    stored = None if raster.stored is None else less(raster.stored)
    return replace(raster, data=less(raster.data), display=less(raster.display), stored=stored)


def _smaller_layer(layer: Layer, raster: Raster) -> Layer:
    # Take the labels of the pixels in the middle of each reduced one; motion shrinks with the frame.
    rows, cols = (_middles(*sizes) for sizes in zip(layer.shape, raster.data.shape, strict=True))
    place = np.ix_(rows, cols)
    ratios = [after / before for after, before in zip(raster.data.shape, layer.shape, strict=True)]
    stretch = np.array(ratios[::-1], np.float32)

    def stretched(motion: FloatArray) -> FloatArray:
        return np.asarray(motion[place] * stretch, np.float32)

    reduced = layer.mapped(lambda depth: depth[place], stretched, means(layer.radiance, raster.data.shape))
    return replace(reduced, raster=raster)


def _middles(before: int, after: int) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
    """Return which of some pixels in a row lies in the middle of each of fewer."""
    return ((np.arange(after) + 0.5) * (before / after)).astype(np.intp)


def means(values: FloatArray, shape: tuple[int, int]) -> FloatArray:
    """Return an array (H, W, ...) in fewer pixels, each the mean of what it covers, float32."""
    for axis, after in enumerate(shape):
        values = np.moveaxis(_row_means(np.moveaxis(values, axis, 0), after), 0, axis)
    return np.ascontiguousarray(values)


def _row_means(values: FloatArray, after: int) -> FloatArray:
    """Return the means along the first axis: of whole entries if their number divides, else of parts of them."""
    before = len(values)
    if before % after == 0:
        grouped = values.reshape(after, before // after, *values.shape[1:])
        return np.asarray(grouped.mean(axis=1, dtype=np.float32))
    # The running sum, looked up at the borders of the new pixels.
    sums = np.concatenate([np.zeros_like(values[:1], np.float64), np.cumsum(values, axis=0, dtype=np.float64)])
    edges = np.arange(after + 1) * (before / after)
    below = np.minimum(edges.astype(np.intp), before - 1)
    between = (edges - below).reshape(-1, *[1] * (values.ndim - 1))
    at_edges = sums[below] + between * (sums[below + 1] - sums[below])
    return np.asarray(np.diff(at_edges, axis=0) * (after / before), np.float32)


def checked_mask(mask: FloatArray, frame: Frame) -> FloatArray:
    """Return a mask (H, W), of numbers in [0, 1] or booleans, as float32.

    Raises
    ------
    InvalidFrameError
        If it has not the frame's shape, holds what is no number, or leaves [0, 1].
    InvalidParameterError
        If the frame comes in layers: what is to stay sharp is then a layer of its own.
    """
    if len(frame.layers) > 1:
        raise InvalidParameterError(
            f"{option('mask')} is for frames of one layer, this one has {len(frame.layers)}: leave what stays sharp out"
        )
    given = np.asarray(mask)
    array = real_array("mask", given.astype(np.float32) if given.dtype == np.bool_ else given)
    if array.shape != frame.shape:
        raise InvalidFrameError(f"mask has shape {array.shape}, the frame {frame.shape}; they must agree")
    check_finite("mask", array)
    if array.min() < 0.0 or array.max() > 1.0:
        raise InvalidFrameError(f"mask holds {array.min():g} to {array.max():g}; allowed are 0 to 1")
    return array


def without(frame: Frame, mask: FloatArray) -> Frame:
    """Return a frame of one layer without the light and the coverage that a mask (H, W) holds out."""
    return frame.coloured(frame.radiance * (np.float32(1.0) - mask)[..., None])


def put_before(image: FloatArray, frame: Frame, mask: FloatArray) -> FloatArray:
    """Return a blurred image of a frame without what a mask holds out, with that sharp before it.

    Where the frame is opaque, so is what is behind the mask: near its edge less of it was blurred, and that is made up
    for.
    """
    behind = image
    if frame.radiance[..., 3].min() == 1.0:
        behind = np.asarray(image / np.maximum(image[..., 3:], np.float32(1e-6)), np.float32)
    share = mask[..., None]
    return np.asarray(share * frame.radiance + (np.float32(1.0) - share) * behind, np.float32)


def region_window(region: tuple[int, int, int, int], raster: Raster, share: float = 1.0) -> Window:
    """Return a region of a frame's picture as a window of its data, in pixels of a proxy of it.

    Parameters
    ----------
    region : tuple of int
        Left column, top row, width and height, px of the whole frame, counted as its windows are.
    raster : Raster
        Of the whole frame.
    share : float
        Size of the proxy.

    Raises
    ------
    InvalidParameterError
        If the region does not lie within the data window.
    """
    wanted = Window(*region)
    if wanted.union(raster.data) != raster.data:
        left, top, width, height = raster.data
        raise InvalidParameterError(
            f"{option('region')} is {','.join(map(str, region))}: it must lie within the frame's {width} x {height} px "
            f"at {left},{top}"
        )
    return smaller_raster(replace(raster, data=wanted, stored=None), share).data


def cut(values: FloatArray, window: Window, wanted: Window) -> FloatArray:
    """Return the part of an array (H, W, ...) of one window that another shows."""
    return np.ascontiguousarray(values[overlap(window, wanted)[0]])


def seen_depth(frame: Frame) -> FloatArray:
    """Return the depth (H, W) of what is seen in each pixel of a frame, float32, metres; ``inf`` where that is nothing.

    Of several layers it is that of the first with which the pixel is half covered.
    """
    depth = np.full(frame.shape, BACKGROUND_DEPTH, np.float32)
    passing, found = np.ones(frame.shape, np.float32), np.zeros(frame.shape, np.bool_)
    for layer in frame.layers:
        passing = passing * (np.float32(1.0) - layer.radiance[..., 3])
        here = ~found & (passing <= HALF_SEEN)
        depth[here] = layer.depth[here]
        found |= here
    return depth


def pixel_under(raster: Raster, x: float, y: float) -> tuple[int, int]:
    """Return row and column, in arrays, of the pixel under a point; parameters and errors as of `depth_at`."""
    left, top, width, height = raster.data
    finite = math.isfinite(x) and math.isfinite(y)
    col, row = (round(x) - left, round(y) - top) if finite else (-1, -1)
    if not (0 <= col < width and 0 <= row < height):
        raise InvalidParameterError(
            f"the point {x:g},{y:g} lies outside the frame's {width} x {height} px at {left},{top}"
        )
    return row, col


def depth_at(depth: FloatArray, raster: Raster, x: float, y: float) -> float:
    """Return the depth of the surface under a point: the median of the pixels around it that belong to that surface.

    Parameters
    ----------
    depth : ndarray of shape (H, W), float32
        Metres.
    raster : Raster
        Where its pixels lie.
    x, y : float
        Column and row, px, counted as the frame's windows are; 0, 0 is the first pixel of a plain image.

    Raises
    ------
    InvalidParameterError
        If there is no pixel there.
    """
    row, col = pixel_under(raster, x, y)
    around = depth[max(row - AROUND, 0) : row + AROUND + 1, max(col - AROUND, 0) : col + AROUND + 1]
    own = depth[row, col]
    if not np.isfinite(own):
        return float(own)
    return float(np.median(around[(around < LIKE_DEPTH * own) & (around > own / LIKE_DEPTH)]))
