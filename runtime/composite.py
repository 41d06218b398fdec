"""Compositing: re-weighting by accumulated alpha (Lee et al. 2008), and `over`."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from runtime import _composite_kernels

Image = npt.NDArray[np.float32]

MIN_WEIGHT = 1e-6
"""Accumulated alpha under which a pixel counts as empty: far below any visible share, above float32 noise."""


def reweight(padded: Image, origin: tuple[int, int], shape: tuple[int, int], *, opaque: bool) -> Image:
    """Cut a layer out of its canvas and normalise it by its accumulated alpha.

    An opaque layer is divided by its alpha: what a moved or blurred object uncovers is filled from what is known there,
    and splats that overlap do not add up. A partly transparent one is divided only where its alpha exceeds 1.

    Parameters
    ----------
    padded : ndarray of shape (rows, cols, 4), float32
        Accumulated premultiplied colour and alpha.
    origin : tuple of two ints
        Row and column, in the layer, of the canvas's first pixel.
    shape : tuple of two ints
        Height and width of the layer.
    opaque : bool
        Whether every pixel of the layer was opaque before blurring.

    Returns
    -------
    ndarray of shape (*shape, 4), float32
        Premultiplied layer, alpha in [0, 1]; empty where the canvas does not reach.

    Notes
    -----
    Lee et al. 2008, "Real-time depth-of-field rendering using point splatting on per-pixel layers".
    """
    layer = np.empty((*shape, 4), np.float32)
    least = np.float32(MIN_WEIGHT if opaque else 1.0)
    _composite_kernels.reweight(padded, *origin, opaque, least, layer)
    return layer


def is_opaque(radiance: Image) -> bool:
    """Return whether every pixel (H, W, 4) is opaque."""
    return bool(_composite_kernels.all_opaque(radiance))


def over(front: Image, back: Image) -> Image:
    """Composite premultiplied layers: ``front + (1 - alpha_front) back``; all of shape (H, W, 4)."""
    composite: Image = front + (1.0 - front[..., 3:]) * back
    return composite
