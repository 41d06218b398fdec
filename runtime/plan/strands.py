"""Strands: stalks, hairs, wires. Behind something nearer out of focus they are seen, if faintly; there they go on."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from spreadlets.arrays import Image, IntArray
from spreadlets.parallel import for_bands
from spreadlets.runtime.buffers import buffer, cleared
from spreadlets.runtime.label.labels import Labels
from spreadlets.runtime.label.scale import LEAST_GAP
from spreadlets.runtime.label.surfaces import depth_is_noise
from spreadlets.runtime.plan import _strand_kernels


class Strands(NamedTuple):
    """Pixels in which strands lie hidden.

    Attributes
    ----------
    at : ndarray of shape (n,), int64
        Their numbers in the frame, row by row.
    sides : ndarray of shape (n, 2), int32
        Numbers of the pixels on either side in which the strand is seen last.
    share : ndarray of shape (n,), float32
        Share of the pixel that the strand covers.
    """

    at: IntArray
    sides: IntArray
    share: Image


def find_strands(labels: Labels, cover: Image) -> Strands:
    """Find the strands that end beside something nearer, and go on along the same line beyond it.

    Parameters
    ----------
    labels : Labels
        Of all pixels of a frame.
    cover : ndarray of shape (H, W), float32
        Share of each pixel that the labelled surface covers.
    """
    place = np.ascontiguousarray(labels.coc)
    if depth_is_noise(place):
        return Strands(np.zeros(0, np.int64), np.zeros((0, 2), np.int32), np.zeros(0, np.float32))
    ends, shares = buffer(place.shape, np.int32), buffer(place.shape)
    for_bands(_strand_kernels.find_strands, len(place), place, labels.length, LEAST_GAP, ends, shares)
    found = cleared(place.shape), buffer((*place.shape, 2), np.int32)
    _strand_kernels.lay_strands(0, len(place), place, LEAST_GAP, ends, shares, found)
    _strand_kernels.close_holes(0, len(place), *found)
    at = np.flatnonzero(found[0] != 0.0)
    sides, covers = found[1].reshape(-1, 2)[at], cover.ravel()
    return Strands(at, sides, found[0].ravel()[at] * covers[at] * covers[sides].mean(axis=1))
