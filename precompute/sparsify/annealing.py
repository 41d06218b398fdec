"""Simulated annealing of the points' positions under Voronoi sums: the last stage of the published procedure."""

from __future__ import annotations

import numpy as np

from spreadlets.arrays import DoubleArray, IntArray
from spreadlets.precompute.sparsify.green import add_sources
from spreadlets.precompute.sparsify.lloyd import collapse, merge

N_STEPS = 400
MOVED_FRACTION = 0.01
"""Steps, and the fraction of the points that each moves by at most a pixel; LKS section 5.5."""

INITIAL_TEMPERATURE = 2e-3
"""Relative rise of the L1 error that is accepted with probability 1/e at first; it falls linearly to zero.

LKS gives no schedule. A step of this size is what moving one point of a disc by a pixel costs."""


def anneal(
    psf: DoubleArray, laplacian: DoubleArray, point_rc: IntArray, rng: np.random.Generator, n_steps: int = N_STEPS
) -> IntArray:
    """Move points at random, keeping moves that lower the L1 error of the PSF made from their Voronoi sums.

    Parameters
    ----------
    psf : ndarray of shape (H, W, C), float64
        PSF.
    laplacian : ndarray of shape (H, W, C), float64
        Its Laplacian on the same window, which must hold all of it.
    point_rc : ndarray of shape (n, 2), int64
        Points inside the window.
    rng : numpy.random.Generator
        Source of all randomness.
    n_steps : int
        Number of proposals.

    Returns
    -------
    ndarray of shape (m, 2), int64
        The best set of distinct points that was met, in row-major order, m at most n.

    Notes
    -----
    LKS section 5.5, last step. Points that meet are merged. The reconstruction is updated by the few values that a
    move changes.
    """
    # Begin with the error of the PSF that the given points make.
    total = float(psf.sum())
    points = merge(point_rc)
    values = collapse(laplacian, points)
    error = -np.ascontiguousarray(np.moveaxis(psf, 2, 0))
    add_sources(error, points, values)
    cost = best_cost = float(np.abs(error).sum()) / total
    best = points
    for step in range(n_steps):
        # Propose a move, and update the error where sources change.
        proposed = merge(propose(points, psf.shape, rng))
        new_values = collapse(laplacian, proposed)
        trial = error.copy()
        add_sources(trial, *_difference(points, values, proposed, new_values))
        new_cost = float(np.abs(trial).sum()) / total
        # Accept by Metropolis' rule; the temperature falls linearly.
        temperature = INITIAL_TEMPERATURE * (1.0 - step / n_steps)
        if rng.random() < np.exp(min(0.0, cost - new_cost) / (temperature * cost)):
            points, values, error, cost = proposed, new_values, trial, new_cost
        # Remember the best set.
        if cost < best_cost:
            best, best_cost = points, cost
    return best


def propose(points: IntArray, shape: tuple[int, ...], rng: np.random.Generator) -> IntArray:
    """Return the points (n, 2), a few of them moved by at most one pixel in each direction inside the window."""
    chosen = rng.choice(len(points), size=max(1, round(MOVED_FRACTION * len(points))), replace=False)
    moved = points.copy()
    moved[chosen] += rng.integers(-1, 2, size=(len(chosen), 2))
    return np.clip(moved, 0, np.asarray(shape[:2]) - 1)


def _difference(
    points: IntArray, values: DoubleArray, new_points: IntArray, new_values: DoubleArray
) -> tuple[IntArray, DoubleArray]:
    """Return the sources (m, 2) and values (m, C) that lead from one set to another."""
    together, owner = np.unique(np.concatenate([points, new_points]), axis=0, return_inverse=True)
    change = np.zeros((len(together), values.shape[1]))
    np.add.at(change, owner.ravel(), np.concatenate([-values, new_values]))
    kept = np.any(change != 0, axis=1)
    return together[kept], change[kept]
