"""The grain of a photograph, for what lost its own to the blur."""

from __future__ import annotations

import numpy as np

from spreadlets.arrays import FloatArray
from spreadlets.scene.display import display_decode, display_encode

SMOOTH_SHARE = 0.25
"""The grain is measured in this share of the picture's blocks, those with the least detail."""
BLOCK = 16
"""Side of a block, px."""
LAPLACIAN_DEVIATION = 6.0
"""Of the difference of two Laplacians, for noise of deviation 1 (Immerkaer 1996)."""


def grained(image: FloatArray, deviation: FloatArray, coc: FloatArray) -> FloatArray:
    """Return a blurred image with the grain that its original has, where the blur took it.

    Parameters
    ----------
    image : ndarray of shape (H, W, 3), float32
        Linear.
    deviation : ndarray of shape (3,), float32
        Of the original's grain, see `grain_of`.
    coc : ndarray of shape (H, W), float32
        CoC radius, px: a mean over its area leaves so much less noise.
    """
    lost = 1.0 - 1.0 / np.maximum(np.pi * coc * coc, 1.0)
    noise = np.random.default_rng(0).standard_normal(image.shape, np.float32)
    noisy = display_encode(image) + np.sqrt(lost)[..., None].astype(np.float32) * deviation * noise
    return display_decode(np.clip(noisy, 0.0, 1.0))


def grain_of(encoded: FloatArray) -> FloatArray:
    """Return the deviation of the grain of each channel of an image (H, W, 3), as displayed.

    Notes
    -----
    Immerkaer 1996, "Fast noise variance estimation", in the blocks with the least of it: the others have detail.
    """
    mask = encoded[:-2] - 2.0 * encoded[1:-1] + encoded[2:]
    residual = np.abs(mask[:, :-2] - 2.0 * mask[:, 1:-1] + mask[:, 2:])
    rows, cols = (size // BLOCK for size in residual.shape[:2])
    if not rows or not cols:
        return np.zeros(3, np.float32)
    blocks = residual[: rows * BLOCK, : cols * BLOCK].reshape(rows, BLOCK, cols, BLOCK, 3).mean(axis=(1, 3))
    deviations = np.sqrt(0.5 * np.pi) / LAPLACIAN_DEVIATION * blocks.reshape(-1, 3)
    return np.asarray(np.quantile(deviations, 0.5 * SMOOTH_SHARE, axis=0), np.float32)
