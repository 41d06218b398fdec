"""Compositing: re-weighting by accumulated alpha (Lee et al. 2008), and `over`."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Image = npt.NDArray[np.float32]

MIN_WEIGHT = 1e-6
"""Accumulated alpha under which a pixel counts as empty: far below any visible share, above float32 noise."""


def reweight(layer: Image, opaque: bool) -> Image:
    """Normalise a layer by its accumulated alpha, in place.

    An opaque layer is divided by its alpha: what a moved or blurred object uncovers is filled from what is known there,
    and splats that overlap do not add up. A partly transparent one is divided only where its alpha exceeds 1.

    Parameters
    ----------
    layer : ndarray of shape (H, W, 4), float32
        Accumulated premultiplied colour and alpha.
    opaque : bool
        Whether every pixel of the layer was opaque before blurring.

    Returns
    -------
    ndarray of shape (H, W, 4), float32
        Premultiplied layer, alpha in [0, 1].

    Notes
    -----
    Lee et al. 2008, "Real-time depth-of-field rendering using point splatting on per-pixel layers".
    """
    layer /= np.maximum(layer[..., 3:], MIN_WEIGHT if opaque else 1.0)
    if opaque:
        layer[..., 3] = 1.0
    np.clip(layer[..., 3], 0.0, 1.0, out=layer[..., 3])
    return layer


def over(front: Image, back: Image) -> Image:
    """Composite premultiplied layers: ``front + (1 - alpha_front) back``; all of shape (H, W, 4)."""
    composite: Image = front + (1.0 - front[..., 3:]) * back
    return composite
