"""Variable-radius dart throwing: the first guess at a spreadlet's points."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from spreadlets.errors import InvalidParameterError
from spreadlets.precompute.sparsify import _sparsify_kernels as _kernels

MAX_FAILURES = 10_000
"""Refused attempts after which placement stops; LKS section 5.5."""

PACKING_DENSITY = 0.75
"""Points per squared radius that saturated random placement leaves; turns a wanted density into a radius."""

_ATTEMPTS_PER_POINT = 64
_MIN_RADIUS = 0.5


def throw_darts(
    importance: npt.NDArray[np.float64], n_target: float, rng: np.random.Generator, max_failures: int = MAX_FAILURES
) -> npt.NDArray[np.int64]:
    """Place about `n_target` points on pixels, with a density proportional to the importance.

    Parameters
    ----------
    importance : ndarray of shape (H, W), float64
        Non-negative weights, the absolute Laplacian; zero forbids a pixel.
    n_target : float
        Wanted number of points, above 0. It sets the radius at each pixel; the count comes out near it.
    rng : numpy.random.Generator
        Source of all randomness.
    max_failures : int
        Refused attempts after which to stop.

    Returns
    -------
    ndarray of shape (n, 2), int64
        Row and column of the placed pixels, in order of placement.

    Raises
    ------
    InvalidParameterError
        If the importance has a negative or non-finite entry or is zero everywhere, or `n_target` is not positive.

    Notes
    -----
    LKS section 5.5, second step. A pixel is refused if an earlier point lies within its own radius, which is that of
    random packing at its wanted density.
    """
    total = float(importance.sum())
    if not np.isfinite(total) or total <= 0 or importance.min() < 0:
        raise InvalidParameterError("importance must be finite, non-negative and somewhere positive")
    if not n_target > 0:
        raise InvalidParameterError(f"n_target must be above 0, not {n_target}")
    density = importance * (n_target / total)
    diagonal = float(np.hypot(*importance.shape))
    radius = np.sqrt(PACKING_DENSITY / np.maximum(density, PACKING_DENSITY / diagonal**2))
    cumulative = np.cumsum(importance.ravel()) / total
    n_attempts = max_failures + _ATTEMPTS_PER_POINT * int(np.ceil(n_target))
    accepted = np.empty((importance.size, 2), dtype=np.int64)
    n_accepted, _ = _kernels.throw_darts(
        cumulative, np.maximum(radius, _MIN_RADIUS), rng.random(n_attempts), max_failures, accepted
    )
    return accepted[:n_accepted].copy()
