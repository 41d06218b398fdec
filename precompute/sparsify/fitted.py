"""The default way from a dense PSF to a spreadlet: far too many points are fitted, and the least useful dropped.

The candidates are every pixel where the Laplacian is not small; if those are too many, dart throwing chooses, and Lloyd
relaxation spreads out. They are fitted to the PSF at once, in a quadratic form that stands for structural
dissimilarity, and the least useful are dropped until dropping more would cost more similarity than the sparsity is
worth. Those left are annealed by the error that the fit leaves. A PSF that needs nearly as many points as it has pixels
is kept as pixels instead.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter

from spreadlets.arrays import DoubleArray, IntArray
from spreadlets.precompute.sparsify.dart_throwing import throw_darts
from spreadlets.precompute.sparsify.direct import direct_choices, direct_spreadlet
from spreadlets.precompute.sparsify.elimination import eliminate
from spreadlets.precompute.sparsify.fit import QUANTUM_BITS, quantise
from spreadlets.precompute.sparsify.fitted_annealing import anneal_fitted, candidates_near
from spreadlets.precompute.sparsify.lloyd import relax
from spreadlets.precompute.sparsify.measurement import Result, measured
from spreadlets.precompute.sparsify.preparation import (
    THIN_RADIUS,
    moved,
    offset_of_support,
    on_box,
    split_spike,
    support,
    width_radius,
)
from spreadlets.precompute.sparsify.similarity import similarity_equations
from spreadlets.precompute.sparsify.symmetry import Symmetry, expand, find_group, orbits, representatives, symmetrise
from spreadlets.psf.laplacian import laplacian
from spreadlets.psf.spreadlet import Spreadlet

PRICE = 0.8
"""Loss of similarity that is accepted, at density 1, for a sparsity that is lower by 1: dropping a point may cost
this much divided by the number of pixels of the support. One price for all PSFs gives the best mean of each for the
mean of the other: over LKS's range, 9 % at a similarity of .978. On frames, a third of it with more points changes no
figure."""

PRICE_EXPONENT = 3.0
"""The price falls with this power of the density, so that twice the density about doubles the points."""

WORST_LOSS = 0.03
"""Loss of similarity, at density 1, beyond which no point is dropped at any price; it falls with the density's root.
It bounds the step in quality where neighbouring directions of a cell fall to either side of the choice between points
and pixels."""

MISJUDGED_LOSS = 0.038
"""Loss of similarity, at density 1, above which a lower price is tried: the form that the points are chosen by is of
second order, and may be wrong by as much as it allows; and the candidates may be too few."""

MISJUDGED_TRIES = ((1.0, 1.0), (0.5, 1.0), (0.5, 2.0))
"""What is tried in turn: a share of the price and of the loss that is allowed, and of the candidates."""

WORST_L1 = 0.09
"""Share of a narrow PSF's light, at density 1, that may be drawn in wrong places: above it, one more try is made, on
terms that should lead to it; it falls with the fourth root of the density. The similarity is a mean over the PSF's box,
and hardly sees what is wrong with a long, narrow PSF, which may fill a tenth of it. A viewer does: neighbouring pixels
whose PSFs are of neighbouring cells differ by about as much."""

NARROW_RADIUS = 8.0
"""PSFs no wider than a disc of this radius, px, are narrow. On a wider disc or path the loss bounds the L1 error, too;
the uneven PSFs of real glass would take a tenth more points, and their neighbours differ by more."""

SMOOTHING = 1.0
"""Standard deviation, px, that keeps the tracing's noise out of the candidates."""

CANDIDATE_THRESHOLD = 1e-3
"""Pixels whose smoothed Laplacian exceeds this fraction of its largest absolute value may become points."""

MAX_ORBITS = 800
"""Most unknowns to start from; among more candidates, dart throwing chooses. The time grows with the third power."""

QUICK_ORBITS = 400
"""Most unknowns where an aperture is waited for; none of those left looks for a better place, and no try is made for
the L1 error: half of the time. The similarity is lower by .006; a frame drawn with it agrees with that of the usual
points at an SSIM of .9999."""

RELAXATIONS = 5
"""Lloyd iterations of those darts: they bring what the fifty of LKS do, at a sixth of the time."""

SPIKED = 0.2
"""Share of the price and of the worst loss for what surrounds a spike: it is seen around highlights only, many times
brighter than displayed, where its outskirts count as much as its peak."""

SPIKED_CANDIDATE_THRESHOLD = 1e-5
"""Takes the place of `CANDIDATE_THRESHOLD` there: a halo has a sharp peak, and a Laplacian that is small far out but
not without effect. With it the L1 error is 3 % in place of 20 %, with as many points."""

ONE_PIXEL = (((0, 0), 1.0),)
ITS_LAPLACIAN = (((0, 0), -4.0), ((-1, 0), 1.0), ((1, 0), 1.0), ((0, -1), 1.0), ((0, 1), 1.0))
"""Offsets and factors of the points of a spike."""

DIRECT_COST = 0.5
"""Price of a pixel that is drawn directly, relative to a point of the Laplacian: neighbours are drawn in one run."""


class Terms(NamedTuple):
    """What points are chosen by."""

    price: float
    """Loss of similarity that is accepted for a sparsity that is lower by 1."""
    limit: float
    """Loss beyond which no point is dropped."""
    misjudged: float
    """Measured loss above which another try is made."""
    l1: float
    """Measured L1 error above which a last one is made."""
    threshold: float
    """Share of the largest Laplacian above which a pixel may become a point."""
    most: int
    """Candidates at most."""
    annealed: bool
    """Whether the points that are left look for better places."""

    @classmethod
    def of(cls, density: float, *, spiked: bool, narrow: bool, quick: bool) -> Terms:
        """Return the terms of an operating point; what surrounds a spike, and what is narrow, has its own."""
        share, threshold = (SPIKED, SPIKED_CANDIDATE_THRESHOLD) if spiked else (1.0, CANDIDATE_THRESHOLD)
        price, looser = PRICE * density**-PRICE_EXPONENT, density**-0.5
        most = QUICK_ORBITS if quick else MAX_ORBITS
        limit, misjudged = share * WORST_LOSS * looser, MISJUDGED_LOSS * looser
        l1 = WORST_L1 * math.sqrt(looser) if narrow and not quick else math.inf
        return cls(share * price, limit, misjudged, l1, threshold, most, not quick)

    def cheaper(self, share: float) -> Terms:
        """Return these terms with a share of the price and of the limit: more points are worth their while."""
        return self._replace(price=share * self.price, limit=share * self.limit)


def sparsify_fitted(psf: DoubleArray, density: float, seed: int, *, quick: bool = False) -> Result:
    """Turn a PSF into a spreadlet of fitted points, or of its own pixels if those are cheaper.

    Parameters
    ----------
    psf : ndarray of shape (H, W, C), float64
        PSF, non-negative, centred, odd sizes.
    density : float
        Operating point.
    seed : int
        Of the choice among too many candidates, and of the annealing.
    quick : bool
        Whether to start from fewer candidates, and not to anneal.

    Returns
    -------
    spreadlet, statistics
        As of `precompute.sparsify.sparsify.sparsify`.

    Notes
    -----
    Takes the place of LKS section 5.5; the direct track is LKS section 6.4.
    """
    shift = offset_of_support(psf)
    # Step 1: set the spike apart; the box follows the support, which a spike would hide.
    rest, spike = split_spike(moved(psf, -shift))
    boxed = on_box(rest)
    # Step 2: points of the Laplacian, unless there are only a few rows of pixels.
    width = width_radius(boxed)
    terms = Terms.of(density, spiked=bool(spike.any()), narrow=width <= NARROW_RADIUS, quick=quick)
    results = [] if width <= THIN_RADIUS else [_fitted(boxed, terms, seed)]
    # Step 3: the pixels themselves, where their number alone does not make them dearer.
    for kept in direct_choices(boxed):
        if not results or DIRECT_COST * PRICE * kept.sum() / support(boxed).sum() < _loss(results[0]):
            results.append(measured(boxed, direct_spreadlet(boxed, kept)))
    spreadlet, statistics = min(results, key=_loss)
    if spike.any():
        spreadlet, statistics = measured(boxed, _with_spike(spreadlet, spike), spike)
    return replace(spreadlet, offset_rc=(spreadlet.offset_rc + shift).astype(np.int16)), statistics


def _loss(result: Result) -> float:
    """Return what a spreadlet costs in similarity, its points included; at any density, as they cost the same time."""
    spreadlet, figures = result
    return 1.0 - figures["ssim"] + PRICE * figures["sparsity"] * (DIRECT_COST if spreadlet.direct else 1.0)


def _fitted(psf: DoubleArray, terms: Terms, seed: int) -> Result:
    """Choose points at the terms' price, and at a lower one where the form was wrong or too much light goes astray."""
    for share, more in MISJUDGED_TRIES:
        tried = terms.cheaper(share)._replace(most=round(more * terms.most))
        result = measured(psf, _sparse_spreadlet(psf, tried, seed))
        if 1.0 - result[1]["ssim"] <= terms.misjudged:
            break
    # What the points are chosen by rises with the square of the error.
    excess = result[1]["l1"] / terms.l1
    return result if excess <= 1.0 else measured(psf, _sparse_spreadlet(psf, tried.cheaper(excess**-2.0), seed))


def _sparse_spreadlet(psf: DoubleArray, terms: Terms, seed: int) -> Spreadlet:
    """Choose the points of the Laplacian and fit their values."""
    rng = np.random.default_rng(seed)
    peak = float(psf.max())
    # Step 1: candidates, in orbits of the PSF's symmetry, and their equations.
    group = find_group(psf)
    scaled = symmetrise(psf, group) / peak
    members, size = orbits(_candidates(scaled, group, terms, rng), group)
    equations = similarity_equations(scaled, members, size, group)
    # Step 2: drop the least useful; let those left look for better places.
    index, _ = eliminate(equations, size, terms.price / int(support(psf).sum()), terms.limit)
    if terms.annealed:
        index = anneal_fitted(equations, candidates_near(members), index, rng)
    # Step 3: values.
    chosen = equations.subset(index)
    offset, value = expand(members[index], size[index], chosen.solve(chosen.free_inverse()))
    return Spreadlet(offset.astype(np.int16), quantise(offset, value * peak))


def _with_spike(spreadlet: Spreadlet, spike: DoubleArray) -> Spreadlet:
    """Add a spike to a spreadlet: one pixel, or the five points of its Laplacian.

    The spike is many times larger than the other values, so float32 cannot hold its sum with them. What is rounded off
    goes to the nearest other points, lest the sum of all values cease to be zero; evenly, lest a dipole be left.
    """
    points = {
        (int(row), int(column)): np.asarray(value, np.float64)
        for (row, column), value in zip(spreadlet.offset_rc, spreadlet.value, strict=True)
    }
    # Add the spike in whole steps of the fitted values, and sum up what float32 rounds off.
    step = _quantum(spreadlet.value)
    rounded_off = np.zeros_like(spike)
    shape = ONE_PIXEL if spreadlet.direct else ITS_LAPLACIAN
    for place, factor in shape:
        exact = points.get(place, 0.0) + factor * np.rint(spike / step) * step
        points[place] = exact.astype(np.float32).astype(np.float64)
        rounded_off += exact - points[place]
    # Give that to the nearest other points.
    if not spreadlet.direct:
        others = {rc: rc[0] ** 2 + rc[1] ** 2 for rc in points.keys() - {place for place, _ in shape}}
        nearest = [rc for rc, square in others.items() if square == min(others.values())]
        for place in nearest:
            points[place] = points[place] + rounded_off / len(nearest)
    # Put the points back in row-major order.
    offset = sorted(points)
    value = np.stack([points[place] for place in offset])
    return Spreadlet(np.array(offset, np.int16), value.astype(np.float32), spreadlet.direct)


def _quantum(value: npt.NDArray[np.float32]) -> DoubleArray:
    """Return the step of which each channel's values are multiples, see `precompute.sparsify.fit.quantise`."""
    largest = np.maximum(np.abs(value).max(axis=0), np.finfo(np.float32).tiny).astype(np.float64)
    return np.asarray(np.exp2(np.ceil(np.log2(largest)) - QUANTUM_BITS - 1))


def _candidates(psf: DoubleArray, group: tuple[Symmetry, ...], terms: Terms, rng: np.random.Generator) -> IntArray:
    """Return offsets (n, 2) of pixels that may become points, one of each orbit, thinned if they are too many."""
    smooth = gaussian_filter(psf, SMOOTHING, axes=(0, 1), mode="constant")
    strength = np.abs(laplacian(smooth)[1:-1, 1:-1]).max(axis=2)
    half = np.asarray(strength.shape) // 2
    offset: IntArray = np.argwhere(strength > terms.threshold * strength.max()) - half
    offset = offset[representatives(offset, group)[0]]
    if len(offset) <= terms.most:
        return offset
    row, column = (offset + half).T
    importance = np.zeros_like(strength)
    importance[row, column] = strength[row, column]
    return np.asarray(relax(importance, throw_darts(importance, terms.most, rng), RELAXATIONS) - half)
