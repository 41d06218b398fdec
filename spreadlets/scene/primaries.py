"""What the red, green and blue of an image are: from other primaries to those of a display."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from spreadlets.arrays import DoubleArray, FloatArray

REC_709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
"""Chromaticities x, y of red, green, blue and white of an sRGB display, and of a file that does not say its own."""

BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])
"""From XYZ to the responses of the eye's cones, in which one white is taken for another."""

SAME = 1e-4
"""How far chromaticities may differ from Rec. 709's and be the same: files round them."""


def luminance_weights(xy: Sequence[float]) -> FloatArray:
    """Return the share of red, green and blue in the luminance, (3,), from x and y of red, green, blue and white.

    Examples
    --------
    >>> from spreadlets.scene.primaries import REC_709, luminance_weights
    >>> [round(float(share), 3) for share in luminance_weights(REC_709)]
    [0.213, 0.715, 0.072]
    """
    return np.asarray(_to_xyz(xy)[1], np.float32)


def to_rec_709(image: FloatArray, xy: Sequence[float]) -> FloatArray:
    """Return linear colours in the primaries of an sRGB display.

    Parameters
    ----------
    image : ndarray of shape (H, W, 3), float32
    xy : sequence of 8 floats
        x and y of the image's red, green, blue and white; its white becomes the display's.

    Returns
    -------
    ndarray of shape (H, W, 3), float32
        Colours that the display cannot show are negative somewhere. The image itself, if its primaries are the
        display's, or are no colours.

    Notes
    -----
    SMPTE RP 177 for the matrices; whites by Bradford's adaptation.
    """
    if np.allclose(xy, REC_709, atol=SAME):
        return image
    try:
        matrix = np.linalg.solve(_to_xyz(REC_709), _adaptation(xy) @ _to_xyz(xy))
    except np.linalg.LinAlgError:
        return image
    return np.asarray(image @ matrix.T, np.float32) if np.isfinite(matrix).all() else image


def _to_xyz(xy: Sequence[float]) -> DoubleArray:
    """Return the matrix (3, 3) from red, green and blue to XYZ, whose white has Y = 1."""
    primaries = np.stack([_xyz(xy[index], xy[index + 1]) for index in (0, 2, 4)], axis=1)
    return np.asarray(primaries * np.linalg.solve(primaries, _xyz(xy[6], xy[7])))


def _xyz(x: float, y: float) -> DoubleArray:
    """Return a chromaticity as XYZ; with Y = 1 unless it has none."""
    return np.array([x, y, 1.0 - x - y]) / (y or 1.0)


def _adaptation(xy: Sequence[float]) -> DoubleArray:
    """Return the matrix (3, 3) in XYZ that takes a white to the display's."""
    own, display = (BRADFORD @ _xyz(*white) for white in (xy[6:8], REC_709[6:8]))
    return np.asarray(np.linalg.solve(BRADFORD, (display / own)[:, None] * BRADFORD))
