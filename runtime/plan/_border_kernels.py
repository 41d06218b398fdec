"""Compiled kernels that continue a frame beyond its border."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import DoubleArray, Image
from spreadlets.compiled import helper, kernel
from spreadlets.runtime._lamp_kernels import evened
from spreadlets.runtime._vector_kernels import load, multiply, store

_U = np.uint64
BLOCK = 16
"""Side, px, of the blocks whose light, with that of those beside them, tells what is a lamp."""
BRIGHTEST = 8.0
"""How many times as bright as the mean around it what is continued may be: of a lamp, it would be a row of lamps."""


class Weighted(NamedTuple):
    """Pixels: colours (H, W, 4), float32; weights (H, W), or (0, 0) if all are 1, float32; labels (H, W), int32."""

    radiance: Image
    weight: Image
    label: npt.NDArray[np.int32]


Slopes = tuple[DoubleArray, DoubleArray, DoubleArray, DoubleArray]


class Border(NamedTuple):
    """How a frame goes on beyond its border.

    Attributes
    ----------
    limit : ndarray of shape (h, w), float32
        How bright what is repeated there may be, in blocks, see `limit_light`. What it says of blocks
        that are not on the border means nothing. Empty if nothing lies there.
    slopes : tuple of four ndarrays of shapes (W,), (W,), (H,) and (H,), float64
        For each pixel of the upper border, the lower, the left and the right one, the direction in which outlines reach
        it: px along it for each px outwards.
    """

    limit: Image
    slopes: Slopes


@kernel
def sum_light(begin, end, radiance, light):
    """Fill ``light`` (h, w, 2), float64, with the sums of evened light and of alpha in blocks on the border.

    Those beside them are summed up, too; all others are left at 0.

    Parameters
    ----------
    radiance : ndarray of shape (H, W, 4), float32
    """
    height, width = radiance.shape[:2]
    n_blocks, n_across = light.shape[:2]
    for block in range(begin, end):
        light[block] = 0.0
        # Of rows off the border, only the first two blocks and the last two are wanted.
        skipped = 2 * BLOCK if 2 <= block < n_blocks - 2 and n_across > 4 else width
        resumed = (n_across - 2) * BLOCK
        for row in range(block * BLOCK, min((block + 1) * BLOCK, height)):
            for j in range(skipped + (width - resumed if skipped < width else 0)):
                col = j if j < skipped else resumed + j - skipped
                brightest = max(radiance[row, col, 0], radiance[row, col, 1], radiance[row, col, 2])
                alpha = np.float64(radiance[row, col, 3])
                if alpha > 0.0 and brightest > 0.0:
                    light[block, col // BLOCK, 0] += alpha * evened(brightest / alpha)
                light[block, col // BLOCK, 1] += alpha


@kernel
def limit_light(begin, end, light, limit):
    """Fill ``limit`` (h, w), float32, with how bright what is continued of blocks on the border may be."""
    for block in range(begin, end):
        for across in range(light.shape[1]):
            total, cover = 0.0, 0.0
            for k in range(max(block - 1, 0), min(block + 2, light.shape[0])):
                for m in range(max(across - 1, 0), min(across + 2, light.shape[1])):
                    total += light[k, m, 0]
                    cover += light[k, m, 1]
            # Where nothing covers anything, there is but light that is added to what lies behind.
            limit[block, across] = BRIGHTEST * (total / cover) ** 4 if cover > 0.0 else np.inf


@helper
def dimming(radiance, i, j, limit, row, col):
    """Return the factor by which the light of a pixel, at (row, col) on the border, is dimmed beyond it."""
    brightest = max(radiance[i, j, 0], radiance[i, j, 1], radiance[i, j, 2])
    most = limit[row // BLOCK, col // BLOCK]
    return most / brightest if brightest > most else np.float32(1.0)


@helper
def _slid(place, outside, slope):
    """Return the pixel along a side of the border that reaches a place beyond it."""
    last = len(slope) - 1
    own = min(max(place, 0), last)
    own = min(max(int(np.rint(place - outside * slope[own])), 0), last)
    return min(max(int(np.rint(place - outside * slope[own])), 0), last)


@helper
def on_border(row, col, shape, slopes):
    """Return row and column of the pixel on the border that goes on at a place beyond it, and how far out that is."""
    top, bottom, left, right = slopes
    height, width = shape
    y, x = min(max(row, 0), height - 1), min(max(col, 0), width - 1)
    down, across = abs(row - y), abs(col - x)
    if down >= across:
        return y, _slid(col, down, top if row < 0 else bottom), max(down, across)
    return _slid(row, across, left if col < 0 else right), x, max(down, across)


@kernel
def extend_frame(begin, end, frame, border, reach, origin, radiance, label):
    """Weight the pixels of a frame, and continue its border outwards, as far as the PSFs of its pixels reach back.

    Parameters
    ----------
    frame : Weighted
    border : Border
        Not read where nothing lies beyond.
    reach : ndarray of shape (n_variants,), int64
        How far each variant's splat reaches, px. A label is ``layer * n_variants + variant``.
    origin : tuple of two ints
        Row and column, in the frame, of the first extended pixel.
    radiance, label : ndarray of shapes (h, w, 4), float32, and (h, w), int32
        Colours and labels of the extended frame; filled, labels with -1 where nothing is drawn. There, colours mean
        nothing.
    """
    own, weight, labels = frame.radiance.reshape(frame.radiance.size), frame.weight, frame.label
    target, pitch, (height, width) = radiance.reshape(radiance.size), label.shape[1], labels.shape
    limit, slopes = border
    for i in range(begin, end):
        down = origin[0] + i
        row = min(max(down, 0), height - 1)
        first = -origin[1] if down == row else pitch
        # Repeat pixels on the border; draw nothing that is black, or too far outside for its PSF to reach back.
        for j in range(pitch - (width if down == row else 0)):
            j += width if j >= first else 0
            y, x, outside = on_border(down, origin[1] + j, (height, width), slopes)
            index = labels[y, x]
            label[i, j] = -1
            if index < 0 or outside > reach[index % len(reach)]:
                continue
            share = weight[y, x] if weight.shape[0] else np.float32(1.0)
            light = share * dimming(frame.radiance, y, x, limit, y, x)
            for c in range(4):
                radiance[i, j, c] = (light if c < 3 else share) * frame.radiance[y, x, c]
                if frame.radiance[y, x, c] != 0:
                    label[i, j] = index
        if down != row:
            continue
        # Weight the frame's own pixels.
        for col in range(width):
            index = labels[row, col]
            label[i, first + col] = max(index, np.int32(-1))
            if index >= 0:
                share = weight[row, col] if weight.shape[0] else np.float32(1.0)
                pixel = load(own, _U(4 * (row * width + col)))
                store(target, _U(4 * (i * pitch + first + col)), multiply((share, share, share, share), pixel))
