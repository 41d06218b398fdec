"""References: the mean of two renderings with noise of their own, denoised where that brings it nearer to the truth.

How near cannot be seen from what denoised images agree on: an error that denoising makes is in all of them. But the
noise of one rendering knows nothing of the other. So what a denoised half differs by from the other half as it was
rendered is, in the mean of its square, its own error and the other's noise; and that is known, as half of what the two
differ by.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from spreadlets.metrics import ssim

MOST_LEFT = 0.5
"""Share of a half's squared error, at most, that denoising may leave for a reference to be denoised: the plain mean of
both halves has as much."""
MOST_LIGHT = 0.005
"""Share of all light that denoising may take away or add: of few samples it loses the light of lamps out of focus,
which few samples have met, though it takes away so much noise that the squared error is less."""
DARK = 0.01
"""Added to squared radiance where errors are divided by it, as in the metric relMSE."""


def denoised(colour: np.ndarray) -> np.ndarray:
    """Return what Open Image Denoise makes of linear colours (H, W, 3), which it is told nothing else about."""
    import pyoidn

    return np.asarray(pyoidn.denoise(np.ascontiguousarray(colour, np.float32), hdr=True))


def reference(
    first: np.ndarray, second: np.ndarray, denoise: Callable[[np.ndarray], np.ndarray] = denoised
) -> tuple[np.ndarray, dict[str, float]]:
    """Return the image that two halves make, and what is known of it.

    Parameters
    ----------
    first, second : ndarray of shape (H, W, 3)
        Renderings of equally many samples and different seeds.
    denoise : callable, optional

    Returns
    -------
    image : ndarray of shape (H, W, 3)
    figures : dict
        ``halves_ssim`` and ``denoised_halves_ssim``: how well the halves agree, before and after; ``error_left``: the
        share of the squared error of a half that denoising leaves in it; ``light_kept``: all light of the denoised mean
        over that of the mean. Beyond `MOST_LEFT` or `MOST_LIGHT`, the mean is returned as it is.
    """
    mean = 0.5 * (first + second)
    clean, halves = denoise(mean), [denoise(first), denoise(second)]
    # The error that is left in the halves, which each judges of the other.
    scale = 1.0 / (clean**2 + DARK)
    noise = 0.5 * float(np.mean((first - second) ** 2 * scale))
    differences = ((halves[0] - second) ** 2 + (halves[1] - first) ** 2) * scale
    left = (0.5 * float(np.mean(differences)) - noise) / noise if noise else 1.0
    light = float(clean.mean() / mean.mean()) if mean.any() else 1.0
    figures = {
        "halves_ssim": round(float(ssim(first, second)), 4),
        "denoised_halves_ssim": round(float(ssim(*halves)), 4),
        "error_left": round(left, 4),
        "light_kept": round(light, 4),
    }
    return (clean if left < MOST_LEFT and abs(light - 1.0) < MOST_LIGHT else mean), figures
