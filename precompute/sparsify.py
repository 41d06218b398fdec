"""The chain from a dense PSF to its spreadlet."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter

from precompute.dart_throwing import throw_darts
from precompute.elimination import eliminate
from precompute.similarity import similarity_equations
from precompute.symmetry import GROUPS, Symmetry, find_group, orbits, symmetrise, transform_offsets
from spreadlets.errors import InvalidParameterError
from spreadlets.laplacian import laplacian, solve_free_space
from spreadlets.metrics import PSF_MARGIN_FRACTION, PSF_MARGIN_PX, PSF_SUPPORT_THRESHOLD, psf_l1, psf_similarity
from spreadlets.spreadlet import Spreadlet

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

PRICE = 0.2
"""Loss of similarity that is accepted for a sparsity lower by one, at density 1."""

PRICE_EXPONENT = 3.0
"""Twice the density lowers the price by this power of two, which about doubles the points."""

WORST_LOSS = 0.03
"""Loss of similarity, at density 1, beyond which no further point is dropped, whatever its price."""

CANDIDATE_THRESHOLD = 1e-3
"""Pixels with a Laplacian above this fraction of its largest absolute value may become points."""

MAX_ORBITS = 600
"""Most unknowns to start from; among more candidates, dart throwing chooses."""

FREE_ORBITS = 400
SMOOTHING = 1.0
IMPORTANCE_POWER = 1.0

DIRECT_THRESHOLDS = (1e-3, 3e-3, 1e-2, 3e-2, 6e-2, 0.1, 0.2)
"""Pixels of the PSF below one of these fractions of its peak are left out of a direct spreadlet."""


def sparsify(psf: npt.ArrayLike, *, density: float = 1.0, seed: int = 0) -> tuple[Spreadlet, dict[str, float]]:
    """Turn a dense PSF into a spreadlet.

    Parameters
    ----------
    psf : array_like of shape (H, W, C) or (H, W)
        PSF, non-negative, centred on the middle pixel; H and W odd.
    density : float
        Operating point: 0.5, 1 or 2 give about half, the usual number, and twice as many points (LKS Fig. 10 d).
    seed : int
        Of the choice of candidates.

    Returns
    -------
    spreadlet : Spreadlet
    statistics : dict
        ``n_points``; ``n_support``, pixels above 1e-4 of the peak; ``sparsity``, their ratio; ``ssim`` and ``l1`` of
        the reconstruction; ``energy_error``, relative; ``max_value_ratio``, largest absolute value over that of the
        Laplacian.

    Raises
    ------
    InvalidParameterError
        If the PSF is malformed or the density not positive.
    """
    boxed = _on_box(_checked(psf))
    if not density > 0:
        raise InvalidParameterError(f"density must be above 0, not {density}")
    price = PRICE * density**-PRICE_EXPONENT
    try:
        sparse = _sparse_spreadlet(boxed, density, seed)
        best = sparse, _statistics(boxed, sparse)
    except InvalidParameterError:
        # Too few pixels for a Laplacian that meets the constraints.
        best = _direct_candidate(boxed, 0.0)
    for threshold in DIRECT_THRESHOLDS:
        loss = price * best[1]["sparsity"] + 1 - best[1]["ssim"]
        if price * float((boxed > threshold * boxed.max()).any(axis=2).sum()) < loss * best[1]["n_support"]:
            direct = _direct_candidate(boxed, threshold)
            if price * direct[1]["sparsity"] + 1 - direct[1]["ssim"] < loss:
                best = direct
    return best


def _direct_candidate(psf: FloatArray, threshold: float) -> tuple[Spreadlet, dict[str, float]]:
    direct = _direct_spreadlet(psf, threshold)
    return direct, _statistics(psf, direct)


def _checked(psf: npt.ArrayLike) -> FloatArray:
    dense = np.asarray(psf, dtype=np.float64)
    dense = dense[..., None] if dense.ndim == 2 else dense
    if dense.ndim != 3 or dense.shape[0] % 2 == 0 or dense.shape[1] % 2 == 0:
        raise InvalidParameterError(f"psf must have shape (H, W, C) with H and W odd, not {np.shape(psf)}")
    if not np.isfinite(dense).all() or dense.min() < 0 or not dense.max() > 0:
        raise InvalidParameterError("psf must be finite, non-negative and not zero everywhere")
    return dense


def _on_box(psf: FloatArray) -> FloatArray:
    """Crop or pad a PSF, symmetrically, to the box in which its similarity is measured."""
    rows, columns = np.nonzero((psf > PSF_SUPPORT_THRESHOLD * psf.max()).any(axis=2))
    halves = []
    for axis, occupied in enumerate((rows, columns)):
        side = int(occupied.max() - occupied.min() + 1)
        reach = int(np.abs(occupied - psf.shape[axis] // 2).max())
        halves.append(reach + max(PSF_MARGIN_PX, math.ceil(PSF_MARGIN_FRACTION * side)))
    out = np.zeros((2 * halves[0] + 1, 2 * halves[1] + 1, psf.shape[2]))
    source, target = [], []
    for axis, half in enumerate(halves):
        common = min(half, psf.shape[axis] // 2)
        source.append(slice(psf.shape[axis] // 2 - common, psf.shape[axis] // 2 + common + 1))
        target.append(slice(half - common, half + common + 1))
    out[tuple(target)] = psf[tuple(source)]
    return out


def _direct_spreadlet(psf: FloatArray, threshold: float) -> Spreadlet:
    """Keep the PSF's own pixels but the faintest, scaled to keep each channel's energy."""
    pixel = np.argwhere((psf > threshold * psf.max()).any(axis=2))
    value = psf[pixel[:, 0], pixel[:, 1]]
    sums = value.sum(axis=0)
    value = value * np.divide(psf.sum(axis=(0, 1)), sums, out=np.zeros_like(sums), where=sums > 0)
    half = np.asarray(psf.shape[:2]) // 2
    return Spreadlet((pixel - half).astype(np.int16), value.astype(np.float32), direct=True)


def _sparse_spreadlet(psf: FloatArray, density: float, seed: int) -> Spreadlet:
    """Choose the points and values of the Laplacian."""
    peak = psf.max()
    importance = _importance(psf / peak)
    group = _choose_group(find_group(psf), int((importance > 0).sum()))
    scaled = symmetrise(psf, group) / peak
    members, size = orbits(_candidates(importance, group, seed), group)
    equations = similarity_equations(scaled, members, size, group)
    n_support = int((psf > PSF_SUPPORT_THRESHOLD * peak).any(axis=2).sum())
    price = PRICE * density**-PRICE_EXPONENT / n_support
    index, value = eliminate(equations, size, price, WORST_LOSS / density)
    repeated = np.repeat(value, len(group), axis=0) * (size[index, None] / len(group)).repeat(len(group), axis=0)
    offset, owner = np.unique(members[index].reshape(-1, 2), axis=0, return_inverse=True)
    summed = np.zeros((len(offset), value.shape[1]))
    np.add.at(summed, owner.ravel(), repeated)
    return Spreadlet(offset.astype(np.int16), (summed * peak).astype(np.float32))


def _choose_group(group: tuple[Symmetry, ...], n_candidates: int) -> tuple[Symmetry, ...]:
    """Return the smallest subgroup that keeps the unknowns few: fewer symmetries leave more choice."""
    fitting = [sub for sub in GROUPS if set(sub) <= set(group)]
    small = [sub for sub in fitting if n_candidates <= FREE_ORBITS * len(sub)]
    return small[-1] if small else fitting[0]


def _importance(psf: FloatArray) -> FloatArray:
    """Return how much a pixel deserves a point: the Laplacian's absolute value, smoothed against the tracing's noise."""
    smooth = gaussian_filter(psf, SMOOTHING, axes=(0, 1), mode="constant")
    strength = np.abs(laplacian(smooth)[1:-1, 1:-1]).max(axis=2)
    strength[strength < CANDIDATE_THRESHOLD * strength.max()] = 0.0
    return np.asarray(strength)


def _candidates(importance: FloatArray, group: tuple[Symmetry, ...], seed: int) -> IntArray:
    """Return offsets of pixels that may become points, one of each orbit, thinned if they are too many."""
    half = np.asarray(importance.shape) // 2
    offset = np.argwhere(importance > 0) - half
    images = np.stack([transform_offsets(offset, symmetry) for symmetry in group], axis=1)
    key = images[..., 0] * (4 * half.max()) + images[..., 1]
    offset = offset[key[:, 0] == key.min(axis=1)]
    if len(offset) <= MAX_ORBITS:
        return offset
    row, column = (offset + half).T
    once = np.zeros_like(importance)
    once[row, column] = importance[row, column] ** IMPORTANCE_POWER
    return throw_darts(once, MAX_ORBITS, np.random.default_rng(seed)) - half


def _statistics(psf: FloatArray, spreadlet: Spreadlet) -> dict[str, float]:
    """Measure a spreadlet against the PSF on its box."""
    half = np.asarray(psf.shape[:2]) // 2
    image = np.zeros(psf.shape)
    row, column = (spreadlet.offset_rc.astype(np.int64) + half).T
    image[row, column] = spreadlet.value
    dense = image if spreadlet.direct else solve_free_space(image)
    n_support = int((psf > PSF_SUPPORT_THRESHOLD * psf.max()).any(axis=2).sum())
    moments = spreadlet.moments()
    energy = moments[0] if spreadlet.direct else 0.25 * (moments[4] + moments[5])
    largest = np.abs(psf if spreadlet.direct else laplacian(psf)).max()
    return {
        "n_points": spreadlet.n_points,
        "n_support": n_support,
        "sparsity": spreadlet.n_points / n_support,
        "ssim": psf_similarity(psf, dense),
        "l1": psf_l1(psf, dense),
        "energy_error": float(np.abs(energy - psf.sum(axis=(0, 1))).max() / psf.sum(axis=(0, 1)).max()),
        "max_value_ratio": float(np.abs(spreadlet.value).max() / largest),
    }
