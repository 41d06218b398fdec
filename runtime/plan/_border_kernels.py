"""Compiled kernels that continue a frame beyond its border."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import Image
from spreadlets.compiled import helper, kernel
from spreadlets.runtime._vector_kernels import load, multiply, store

_U = np.uint64


class Weighted(NamedTuple):
    """Pixels: colours (H, W, 4), float32; weights (H, W), or (0, 0) if all are 1, float32; labels (H, W), int32."""

    radiance: Image
    weight: Image
    label: npt.NDArray[np.int32]


@helper
def mirrored(place, size):
    """Return the row of a frame of ``size`` rows that is seen at a place beyond it, mirrored as often as it takes."""
    place %= 2 * size
    return place if place < size else 2 * size - 1 - place


@helper
def first_image(place, size, least):
    """Return the first place, from ``least`` on, that a row is seen at, of those that lie whole periods apart."""
    return least + (place - least) % (2 * size)


@kernel
def row_reaches(begin, end, label, reach, found):
    """Fill ``found`` (H,), int64, with how far the PSFs of each row reach; -1 where nothing is drawn."""
    for row in range(begin, end):
        found[row] = -1
        for col in range(label.shape[1]):
            if label[row, col] >= 0:
                found[row] = max(found[row], reach[label[row, col] % len(reach)])


@kernel
def extend_frame(begin, end, frame, reach, origin, radiance, label):
    """Weight the pixels of a frame, and mirror it at its border, as far as the PSFs of its pixels reach back.

    Parameters
    ----------
    frame : Weighted
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
    for i in range(begin, end):
        down = origin[0] + i
        row, above = mirrored(down, height), max(-down, down - height + 1, 0)
        first = pitch if above else -origin[1]
        # Mirror what lies near the border; draw nothing that is black, or too far outside for its PSF to reach back.
        for j in range(pitch - (0 if above else width)):
            j += width if j >= first else 0
            right = origin[1] + j
            col = mirrored(right, width)
            index = labels[row, col]
            label[i, j] = -1
            if index < 0 or max(above, -right, right - width + 1) > reach[index % len(reach)]:
                continue
            share = weight[row, col] if weight.shape[0] else np.float32(1.0)
            for c in range(4):
                radiance[i, j, c] = share * frame.radiance[row, col, c]
                if frame.radiance[row, col, c] != 0:
                    label[i, j] = index
        if above:
            continue
        # Weight the frame's own pixels.
        for col in range(width):
            index = labels[row, col]
            label[i, first + col] = max(index, np.int32(-1))
            if index >= 0:
                share = weight[row, col] if weight.shape[0] else np.float32(1.0)
                pixel = load(own, _U(4 * (row * width + col)))
                store(target, _U(4 * (i * pitch + first + col)), multiply((share, share, share, share), pixel))
