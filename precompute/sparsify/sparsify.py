"""The chain from a dense PSF to its spreadlet: candidates, elimination, fit, measurement.

Far more candidate points than needed are fitted to the PSF at once, in a quadratic form that stands for structural
dissimilarity, and the least useful are dropped until dropping more would cost more similarity than the sparsity is
worth. A PSF that needs nearly as many points as it has pixels is kept as pixels instead.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter

from spreadlets.arrays import DoubleArray, IntArray
from spreadlets.errors import InvalidParameterError
from spreadlets.metrics import PSF_MARGIN_FRACTION, PSF_MARGIN_PX, PSF_SUPPORT_THRESHOLD, psf_l1, psf_similarity
from spreadlets.precompute.sparsify.dart_throwing import throw_darts
from spreadlets.precompute.sparsify.elimination import eliminate
from spreadlets.precompute.sparsify.fit import QUANTUM_BITS, quantise
from spreadlets.precompute.sparsify.green import reconstruct
from spreadlets.precompute.sparsify.similarity import similarity_equations
from spreadlets.precompute.sparsify.symmetry import Symmetry, expand, find_group, orbits, representatives, symmetrise
from spreadlets.psf.laplacian import laplacian
from spreadlets.psf.spreadlet import Spreadlet

Result = tuple[Spreadlet, dict[str, float]]

PRICE = 0.25
"""Loss of similarity that is accepted, at density 1, for a sparsity that is lower by 1: dropping a point may cost
this much divided by the number of pixels of the support. One price for all PSFs gives the best mean of each for the
mean of the other."""

PRICE_EXPONENT = 3.0
"""The price falls with this power of the density, so that twice the density about doubles the points."""

WORST_LOSS = 0.024
"""Loss of similarity, at density 1, beyond which no point is dropped at any price; it falls with the density's root.
It bounds the step in quality where neighbouring directions of a cell fall to either side of the choice between points
and pixels."""

MISJUDGED_LOSS = 0.03
"""Loss of similarity, at density 1, above which a lower price is tried: the form that the points are chosen by is of
second order, and may be wrong by as much as it allows; and the candidates may be too few."""

MISJUDGED_TRIES = ((1.0, 1.0), (0.5, 1.0), (0.5, 2.0))
"""What is tried in turn: a share of the price and of the loss that is allowed, and of the candidates."""

SMOOTHING = 1.0
"""Standard deviation, px, that keeps the tracing's noise out of the candidates."""

CANDIDATE_THRESHOLD = 1e-3
"""Pixels whose smoothed Laplacian exceeds this fraction of its largest absolute value may become points."""

MAX_ORBITS = 800
"""Most unknowns to start from; among more candidates, dart throwing chooses. The time grows with the third power."""

SPIKE = 3.0
"""A central pixel that is so many times brighter than any around it, and more, is set apart as a spike."""

SPIKED = 0.2
"""Share of the price and of the worst loss for what surrounds a spike: it is seen around highlights only, many times
brighter than displayed, where its outskirts count as much as its peak."""

SPIKED_CANDIDATE_THRESHOLD = 1e-5
"""Takes the place of `CANDIDATE_THRESHOLD` there: a halo has a sharp peak, and a Laplacian that is small far out but
not without effect. With it the L1 error is 3 % in place of 20 %, with as many points."""

ONE_PIXEL = (((0, 0), 1.0),)
ITS_LAPLACIAN = (((0, 0), -4.0), ((-1, 0), 1.0), ((1, 0), 1.0), ((0, -1), 1.0), ((0, 1), 1.0))
"""Offsets and factors of the points of a spike."""

ROUNDING = 1e-9
"""Negative values up to this fraction of the peak count as zero."""

DIRECT_COST = 0.5
"""Price of a pixel that is drawn directly, relative to a point of the Laplacian: neighbours are drawn in one run."""

THIN_RADIUS = 3.5
"""PSFs no wider than a disc of this radius, px, are drawn directly: their few rows of pixels are cheaper, and exact."""

DIRECT_THRESHOLDS = (1e-4, 1e-3, 2e-3, 3e-3, 5e-3, 1e-2, 2e-2, 3e-2)
"""Fractions of the peak below which a direct spreadlet may leave out pixels; the best by price is taken."""

MAX_LEFT_OUT = 0.1
"""Share of a channel's light that those pixels may hold, save at the least fraction: an aberrated PSF has a bright
core, and around it a veil of half its light that the similarity, relative to the peak, hardly sees."""

DIRECT_BITS = 13
"""Direct values are rounded to the peak's power of two divided by 2 to this power: a third of the file is saved, and
no display shows more than 12 bits."""


def sparsify(psf: npt.ArrayLike, *, density: float = 1.0, seed: int = 0) -> Result:
    """Turn a dense PSF into a spreadlet.

    Parameters
    ----------
    psf : array_like of shape (H, W, C) or (H, W)
        PSF, non-negative, centred on the middle pixel; H and W odd.
    density : float
        Operating point: 0.5, 1 and 2 give about half, the usual number and twice as many points (LKS Fig. 10 d).
    seed : int
        Of the choice among too many candidates.

    Returns
    -------
    spreadlet : Spreadlet
        Its energy, and if it is not direct its moments up to the second order, are the PSF's.
    statistics : dict of str to float
        ``n_points``; ``n_support``, pixels above 1e-4 of the peak; ``sparsity``, their ratio; ``ssim`` and ``l1`` of
        the reconstruction (`spreadlets.metrics`); ``energy_error``, relative; ``max_value_ratio``, the largest
        absolute value over that of the dense PSF (if direct) or of its Laplacian. Support and errors are those of
        the PSF without its spike, see `split_spike`.

    Raises
    ------
    InvalidParameterError
        If the PSF is malformed or the density is not above 0.

    Notes
    -----
    Takes the place of LKS section 5.5; the direct track is LKS section 6.4.
    """
    if not density > 0:
        raise InvalidParameterError(f"density must be above 0, not {density}")
    checked = _checked(psf)
    shift = _offset_of_support(checked)
    # The box follows the support, which a spike would hide.
    rest, spike = split_spike(_moved(checked, -shift))
    boxed = _on_box(rest)
    price, limit = PRICE * density**-PRICE_EXPONENT, WORST_LOSS * density**-0.5
    threshold = CANDIDATE_THRESHOLD
    if spike.any():
        price, limit, threshold = SPIKED * price, SPIKED * limit, SPIKED_CANDIDATE_THRESHOLD
    results: list[Result] = []
    if _width_radius(boxed) > THIN_RADIUS:
        for share, more in MISJUDGED_TRIES:
            candidates = threshold, round(more * MAX_ORBITS)
            results = [_measured(boxed, _sparse_spreadlet(boxed, (share * price, share * limit), candidates, seed))]
            if 1.0 - results[0][1]["ssim"] <= MISJUDGED_LOSS * density**-0.5:
                break
    for least in DIRECT_THRESHOLDS:
        kept = (boxed > least * boxed.max()).any(axis=2)
        if least > DIRECT_THRESHOLDS[0] and (boxed[~kept].sum(axis=0) > MAX_LEFT_OUT * boxed.sum(axis=(0, 1))).any():
            break
        sparsity = float(kept.sum() / _support(boxed).sum())
        # A direct spreadlet costs at least its points, so that those of large PSFs need not be measured.
        if not results or DIRECT_COST * PRICE * sparsity < _loss(results[0]):
            results.append(_measured(boxed, _direct_spreadlet(boxed, least)))
    spreadlet, statistics = min(results, key=_loss)
    if spike.any():
        spreadlet, statistics = _measured(boxed, _with_spike(spreadlet, spike), spike)
    return replace(spreadlet, offset_rc=(spreadlet.offset_rc + shift).astype(np.int16)), statistics


def measure_spreadlet(psf: npt.ArrayLike, spreadlet: Spreadlet) -> dict[str, float]:
    """Measure a spreadlet against the dense PSF that it stands for, as `sparsify` does.

    Parameters
    ----------
    psf : array_like of shape (H, W, C) or (H, W)
        As for `sparsify`.
    spreadlet : Spreadlet

    Returns
    -------
    dict of str to float
        The statistics that `sparsify` returns.

    Raises
    ------
    InvalidParameterError
        If the PSF is malformed.
    """
    checked = _checked(psf)
    shift = _offset_of_support(checked)
    rest, spike = split_spike(_moved(checked, -shift))
    boxed = _on_box(rest)
    moved = spreadlet.offset_rc.astype(np.int64) - shift
    outside = np.maximum(np.abs(moved).max(axis=0, initial=0) - np.asarray(boxed.shape[:2]) // 2, 0)
    boxed = np.pad(boxed, [(n, n) for n in outside] + [(0, 0)])
    return _measured(boxed, replace(spreadlet, offset_rc=moved.astype(np.int16)), spike)[1]


def _offset_of_support(psf: DoubleArray) -> IntArray:
    """Return how far, in whole px, the middle of the light lies from the centre: an aberrated PSF is off its pixel."""
    place = np.argwhere((psf > 0).any(axis=2))
    middle = (place.min(axis=0) + place.max(axis=0)) // 2
    return np.asarray(middle - np.asarray(psf.shape[:2]) // 2, np.int64)


def _moved(psf: DoubleArray, shift: IntArray) -> DoubleArray:
    """Move a PSF by whole pixels, on a window that grows with the shift."""
    if not shift.any():
        return psf
    padded = np.pad(psf, [(abs(int(n)), abs(int(n))) for n in shift] + [(0, 0)])
    return np.asarray(np.roll(padded, (int(shift[0]), int(shift[1])), axis=(0, 1)))


def _loss(result: Result) -> float:
    """Return what a spreadlet costs in similarity, its points included; at any density, as they cost the same time."""
    spreadlet, figures = result
    return 1.0 - figures["ssim"] + PRICE * figures["sparsity"] * (DIRECT_COST if spreadlet.direct else 1.0)


def _checked(psf: npt.ArrayLike) -> DoubleArray:
    dense = np.asarray(psf, dtype=np.float64)
    dense = dense[..., None] if dense.ndim == 2 else dense
    if dense.ndim != 3 or dense.shape[0] % 2 == 0 or dense.shape[1] % 2 == 0:
        raise InvalidParameterError(f"psf must have shape (H, W, C) with H and W odd, not {np.shape(psf)}")
    if not np.isfinite(dense).all() or not dense.max() > 0 or dense.min() < -ROUNDING * dense.max():
        raise InvalidParameterError("psf must be finite, non-negative and not zero everywhere")
    return np.maximum(dense, 0.0)


def _on_box(psf: DoubleArray) -> DoubleArray:
    """Crop or pad a PSF, about its centre, to a box that holds all of it and where its similarity is measured."""
    centre = np.asarray(psf.shape[:2]) // 2
    reach = np.abs(np.argwhere((psf > 0).any(axis=2)) - centre).max(axis=0)
    rows, columns = (slice(c - r, c + r + 1) for c, r in zip(centre, reach, strict=True))
    cropped = psf[rows, columns]
    offset = np.argwhere(_support(cropped)) - reach
    margin = np.maximum(PSF_MARGIN_PX, np.ceil(PSF_MARGIN_FRACTION * (np.ptp(offset, axis=0) + 1))).astype(np.int64)
    pad = np.maximum(np.abs(offset).max(axis=0) + margin - reach, 0)
    return np.pad(cropped, [(pad[0], pad[0]), (pad[1], pad[1]), (0, 0)])


def _support(psf: DoubleArray) -> npt.NDArray[np.bool_]:
    return np.asarray((psf > PSF_SUPPORT_THRESHOLD * psf.max()).any(axis=2))


def _width_radius(psf: DoubleArray) -> float:
    """Return the radius, px, of the disc that is as wide as the PSF where that is narrowest.

    It does not change when the PSF turns on the lattice or grows along its motion, so that all directions agree.
    """
    weight = psf.sum(axis=2) / psf.sum()
    offset = np.indices(weight.shape).reshape(2, -1)
    return 2.0 * float(np.sqrt(np.linalg.eigvalsh(np.cov(offset, aweights=weight.ravel(), ddof=0))[0]))


def _direct_spreadlet(psf: DoubleArray, threshold: float) -> Spreadlet:
    """Keep the PSF's own pixels but the faintest, scaled to keep each channel's energy."""
    pixel = np.argwhere((psf > threshold * psf.max()).any(axis=2))
    value = psf[pixel[:, 0], pixel[:, 1]]
    sums = value.sum(axis=0)
    value = value * np.divide(psf.sum(axis=(0, 1)), sums, out=np.zeros_like(sums), where=sums > 0)
    offset = pixel - np.asarray(psf.shape[:2]) // 2
    return Spreadlet(offset.astype(np.int16), round_direct(offset, value), direct=True)


def round_direct(offset_rc: IntArray, value: DoubleArray) -> npt.NDArray[np.float32]:
    """Round pixels to few bits, which compress well, keeping each channel's sum.

    Parameters
    ----------
    offset_rc : ndarray of shape (n, 2), int64
        Offsets from the centre, in the order in which each pixel's rounding error passes on to the next: a plateau
        keeps its mean.
    value : ndarray of shape (n, C), float64
        Non-negative values.

    Returns
    -------
    ndarray of shape (n, C), float32
        Multiples of a power of two per channel, less than one of them from ``value``; the pixel nearest to the centre
        takes up the rest of the sum, less than half of one.
    """
    step = np.exp2(np.ceil(np.log2(np.maximum(value.max(axis=0), np.finfo(np.float32).tiny))) - DIRECT_BITS)
    total = np.cumsum(value, axis=0)
    rounded = np.diff(np.rint(total / step), axis=0, prepend=0.0) * step
    rounded[np.argmin((offset_rc**2).sum(axis=1))] += total[-1] - rounded.sum(axis=0)
    return np.asarray(rounded, dtype=np.float32)


def _sparse_spreadlet(
    psf: DoubleArray, terms: tuple[float, float], candidates: tuple[float, int], seed: int
) -> Spreadlet:
    """Choose the points of the Laplacian and fit their values.

    The terms are those of `eliminate`, price and limit; of the candidates, their threshold and how many at most.
    """
    price, limit = terms
    peak = float(psf.max())
    group = find_group(psf)
    scaled = symmetrise(psf, group) / peak
    members, size = orbits(_candidates(scaled, group, candidates, seed), group)
    equations = similarity_equations(scaled, members, size, group)
    index, value = eliminate(equations, size, price / int(_support(psf).sum()), limit)
    offset, spread_value = expand(members[index], size[index], value)
    return Spreadlet(offset.astype(np.int16), quantise(offset, spread_value * peak))


def split_spike(psf: DoubleArray) -> tuple[DoubleArray, DoubleArray]:
    """Take what a central pixel has above its neighbours off a PSF.

    Light that passes a medium unscattered stays in one pixel, a thousand times brighter than the rest. The similarity
    is relative to the peak, and would see nothing else, however much light there is around it.

    Parameters
    ----------
    psf : ndarray of shape (H, W, C), float64
        PSF, centred, odd sizes.

    Returns
    -------
    rest : ndarray of shape (H, W, C), float64
    spike : ndarray of shape (C,), float64
        What was taken off the central pixel: zero, unless that is more than `SPIKE` times as bright as any around it.
    """
    row, column = np.asarray(psf.shape[:2]) // 2
    if min(row, column) < 1:
        return psf, np.zeros(psf.shape[2])
    around = psf[row - 1 : row + 2, column - 1 : column + 2].copy()
    around[1, 1] = 0.0
    highest = around.max(axis=(0, 1))
    spike = psf[row, column] - highest
    if not (spike > SPIKE * highest).all() or not highest.max() > 0.0:
        return psf, np.zeros_like(spike)
    rest = psf.copy()
    rest[row, column] = highest
    # In a PSF of few pixels, a bright one is no spike but the PSF.
    if _width_radius(rest) <= THIN_RADIUS:
        return psf, np.zeros_like(spike)
    return rest, spike


def _with_spike(spreadlet: Spreadlet, spike: DoubleArray) -> Spreadlet:
    """Add a spike to a spreadlet: one pixel, or the five points of its Laplacian.

    The spike is many times larger than the other values, so float32 cannot hold its sum with them. What is rounded off
    goes to the nearest other points, lest the sum of all values cease to be zero; evenly, lest a dipole be left.
    """
    points = {
        (int(row), int(column)): np.asarray(value, np.float64)
        for (row, column), value in zip(spreadlet.offset_rc, spreadlet.value, strict=True)
    }
    step = _quantum(spreadlet.value)
    rounded_off = np.zeros_like(spike)
    shape = ONE_PIXEL if spreadlet.direct else ITS_LAPLACIAN
    for place, factor in shape:
        exact = points.get(place, 0.0) + factor * np.rint(spike / step) * step
        points[place] = exact.astype(np.float32).astype(np.float64)
        rounded_off += exact - points[place]
    if not spreadlet.direct:
        others = {rc: rc[0] ** 2 + rc[1] ** 2 for rc in points.keys() - {place for place, _ in shape}}
        nearest = [rc for rc, square in others.items() if square == min(others.values())]
        for place in nearest:
            points[place] = points[place] + rounded_off / len(nearest)
    offset = sorted(points)
    value = np.stack([points[place] for place in offset])
    return Spreadlet(np.array(offset, np.int16), value.astype(np.float32), spreadlet.direct)


def _quantum(value: npt.NDArray[np.float32]) -> DoubleArray:
    """Return the step of which each channel's values are multiples, see `precompute.sparsify.fit.quantise`."""
    largest = np.maximum(np.abs(value).max(axis=0), np.finfo(np.float32).tiny).astype(np.float64)
    return np.asarray(np.exp2(np.ceil(np.log2(largest)) - QUANTUM_BITS - 1))


def _candidates(psf: DoubleArray, group: tuple[Symmetry, ...], bounds: tuple[float, int], seed: int) -> IntArray:
    """Return offsets (n, 2) of pixels that may become points, one of each orbit, thinned if they are too many."""
    threshold, most = bounds
    smooth = gaussian_filter(psf, SMOOTHING, axes=(0, 1), mode="constant")
    strength = np.abs(laplacian(smooth)[1:-1, 1:-1]).max(axis=2)
    half = np.asarray(strength.shape) // 2
    offset: IntArray = np.argwhere(strength > threshold * strength.max()) - half
    offset = offset[representatives(offset, group)[0]]
    if len(offset) <= most:
        return offset
    row, column = (offset + half).T
    importance = np.zeros_like(strength)
    importance[row, column] = strength[row, column]
    return np.asarray(throw_darts(importance, most, np.random.default_rng(seed)) - half)


def _measured(psf: DoubleArray, spreadlet: Spreadlet, spike: DoubleArray | float = 0.0) -> Result:
    """Measure a spreadlet against the PSF on its box, both without the PSF's spike."""
    offset, value = spreadlet.offset_rc.astype(np.int64), spreadlet.value.astype(np.float64)
    if spreadlet.direct:
        dense = np.zeros_like(psf)
        row, column = (offset + np.asarray(psf.shape[:2]) // 2).T
        dense[row, column] = value
    else:
        dense = reconstruct(offset, value, psf.shape[:2])
    dense[tuple(np.asarray(psf.shape[:2]) // 2)] -= spike
    moments = spreadlet.moments()
    energy = (moments[0] if spreadlet.direct else 0.25 * (moments[4] + moments[5])) - spike
    true_energy = psf.sum(axis=(0, 1))
    largest = float(np.abs(psf if spreadlet.direct else laplacian(psf)).max())
    n_support = int(_support(psf).sum())
    return spreadlet, {
        "n_points": spreadlet.n_points,
        "n_support": n_support,
        "sparsity": spreadlet.n_points / n_support,
        "ssim": psf_similarity(psf, dense),
        "l1": psf_l1(psf, dense),
        "energy_error": float(np.abs(energy - true_energy).max() / true_energy.max()),
        "max_value_ratio": float(np.abs(value).max()) / largest,
    }
