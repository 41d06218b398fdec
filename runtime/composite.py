"""Compositing: re-weighting by accumulated alpha (Lee et al. 2008), the frame's border, and `over`."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy import ndimage

Image = npt.NDArray[np.float32]

BORDER_STRIP = 8
"""Depth, px, of the strip along a border whose median colour continues the frame beyond it."""
BORDER_MEDIAN = 15
"""Length, px, of the median along the border: highlights up to half of it are not continued."""
MIN_WEIGHT = 1e-6
"""Accumulated alpha under which a pixel counts as empty: far below any visible share, above float32 noise."""


def reweight(padded: Image, radiance: Image, padding: int) -> Image:
    """Cut the frame out of a padded layer and normalise it by its accumulated alpha.

    What a frame's border hides would have been blurred into the frame. Weight is conserved: by symmetry, what leaves
    the frame across a border is what would have come in, so the weight that lies outside is folded back and takes
    the colour that the frame's border has (a median, so that a highlight near the border is not repeated). An opaque
    layer is then divided by its alpha (what a moved or blurred object uncovers is filled from what is known there);
    a partly transparent one only where its alpha exceeds 1.

    Parameters
    ----------
    padded : ndarray of shape (H + 2 padding, W + 2 padding, 4), float32
        Accumulated premultiplied colour and alpha.
    radiance : ndarray of shape (H, W, 4), float32
        The layer before blurring.
    padding : int
        Border, px.

    Returns
    -------
    ndarray of shape (H, W, 4), float32
        Premultiplied layer, alpha in [0, 1].
    """
    height, width = radiance.shape[:2]
    image = padded[padding : padding + height, padding : padding + width].copy()
    if padding:
        _add_border(image, padded[..., 3], radiance, padding)
    alpha = image[..., 3:]
    opaque = bool((radiance[..., 3] == 1.0).all())
    divisor = np.maximum(alpha, MIN_WEIGHT) if opaque else np.maximum(alpha, 1.0)
    image /= divisor
    if opaque:
        image[..., 3] = 1.0
    np.clip(image[..., 3], 0.0, 1.0, out=image[..., 3])
    return image


def over(front: Image, back: Image) -> Image:
    """Composite premultiplied layers: ``front + (1 - alpha_front) back``; all of shape (H, W, 4)."""
    composite: Image = front + (1.0 - front[..., 3:]) * back
    return composite


def _add_border(image: Image, weight: npt.NDArray[np.float32], radiance: Image, padding: int) -> None:
    """Add what lies beyond the four borders: the folded weight times the colour of each border."""
    height, width = radiance.shape[:2]
    columns = slice(padding, padding + width)
    for side in (0, 1):
        beyond = weight[:, :padding][:, ::-1] if side == 0 else weight[:, padding + width :]
        share = _fold(_fold_both(beyond, padding, height).T, width).T
        colour = _border_colour(radiance if side == 0 else radiance[:, ::-1], padding)
        strip = image if side == 0 else image[:, ::-1]
        strip += share[..., None] * colour[:, None]
    for side in (0, 1):
        beyond = weight[:padding, columns][::-1] if side == 0 else weight[padding + height :, columns]
        share = _fold(beyond, height)
        turned = radiance.transpose(1, 0, 2)
        colour = _border_colour(turned if side == 0 else turned[:, ::-1], padding)
        strip = image if side == 0 else image[::-1]
        strip += share[..., None] * colour[None]


def _fold_both(weight: npt.NDArray[np.float32], padding: int, height: int) -> npt.NDArray[np.float32]:
    """Fold the corners of a padded side strip, above and below, onto its rows within the frame."""
    inside = weight[padding : padding + height].copy()
    inside += _fold(weight[:padding][::-1], height)
    inside += _fold(weight[padding + height :], height)[::-1]
    return inside


def _fold(beyond: npt.NDArray[np.float32], size: int) -> npt.NDArray[np.float32]:
    """Mirror rows counted outwards from a border onto rows counted inwards, back and forth where there are more."""
    folded = np.zeros((size, *beyond.shape[1:]), np.float32)
    for begin in range(0, len(beyond), size):
        part = beyond[begin : begin + size]
        if (begin // size) % 2 == 0:
            folded[: len(part)] += part
        else:
            folded[size - len(part) :] += part[::-1]
    return folded


def _border_colour(radiance: Image, padding: int) -> Image:
    """Return the robust colour of the left border, shape (H, 4), smoothed along it as the blur beyond it would be."""
    strip = np.median(radiance[:, :BORDER_STRIP], axis=1)
    strip = ndimage.median_filter(strip, size=(BORDER_MEDIAN, 1), mode="nearest")
    colour: Image = ndimage.uniform_filter1d(strip, size=1 + padding // 2, axis=0, mode="nearest")
    return colour
