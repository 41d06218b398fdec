"""Fireflies: a sample that is far brighter than all others from the same place, and would paint a bokeh of its own.

A highlight that a lens or the motion spreads is met by many samples; moved back to where they come from, they lie side
by side and are alike. A firefly, the rare path that a renderer has weighted by thousands, is alone there. It is dimmed
to a multiple of the brightest other sample within a pixel. In a pinhole frame nothing tells a firefly from a highlight
of one pixel, so that nothing is done unless asked for.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from spreadlets.arrays import Image
from spreadlets.parallel import for_bands
from spreadlets.runtime.label import _firefly_kernels

NO_MOVE = np.zeros((0, 0, 2), np.float32)


def clamp_fireflies(samples: Sequence[tuple[Image, Image | None]], factor: float) -> tuple[list[Image], int]:
    """Dim samples that are alone with their brightness.

    Parameters
    ----------
    samples : sequence of (radiance, shift)
        Colours (H, W, 4), float32, and the way (dx, dy) from each pixel to where it comes from, (H, W, 2), float32,
        px; None if nothing is moved.
    factor : float
        How many times as bright as any other sample within a pixel a sample may be; the others count as no darker than
        the median of all samples that are not black.

    Returns
    -------
    radiance : list of ndarrays of shape (H, W, 4), float32
        New arrays.
    count : int
        Number of samples that were dimmed.
    """
    colours = [radiance.copy() for radiance, _ in samples]
    shifts = [NO_MOVE if shift is None else np.ascontiguousarray(shift) for _, shift in samples]
    brightest = np.zeros((*colours[0].shape[:2], 2), np.float32)
    for radiance, shift in zip(colours, shifts, strict=True):
        _firefly_kernels.gather_brightest(radiance, shift, brightest)
    levels = np.stack([radiance[..., :3] for radiance in colours]).mean(axis=-1)
    bright = levels[levels > 0]
    floor = np.float32(np.median(bright)) if len(bright) else np.float32(0.0)
    counts = [
        sum(for_bands(_firefly_kernels.clamp, len(radiance), radiance, shift, brightest, np.float32(factor), floor))
        for radiance, shift in zip(colours, shifts, strict=True)
    ]
    return colours, sum(counts)
