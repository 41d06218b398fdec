"""Backward elimination: from too many points to few, each time dropping those that the fit misses least.

For the minimum of a quadratic form, setting one value to zero and fitting the others again costs exactly
``v_j^2 / S_jj``, S being the free inverse of the form (Hassibi and Stork 1993, "Optimal brain surgeon"). Whole batches
of points that hardly interact are dropped together, which turns the updates into matrix products.
"""

from __future__ import annotations

import math

import numpy as np

from spreadlets.arrays import DoubleArray, IntArray
from spreadlets.precompute.sparsify.fit import Equations

BATCH_FRACTION = 1 / 32
"""Largest fraction of the points that one step drops."""

MAX_CORRELATION = 0.15
"""Points of a batch may depend on each other, as ``|S_ij| / sqrt(S_ii S_jj)``, by no more than this."""

REFRESH_FRACTION = 0.6
"""The inverse is computed anew when this fraction of its points is left: updates accumulate rounding."""

RESOLUTION = 1e-12
"""Diagonal entries of the inverse below this fraction of the largest are rounding."""


def eliminate(equations: Equations, size: IntArray, price: float, limit: float) -> tuple[IntArray, DoubleArray]:
    """Drop points while what they save is worth what it costs.

    Parameters
    ----------
    equations : Equations
        The quadratic form of all candidates.
    size : ndarray of shape (n,), int64
        What each candidate saves: the number of points of its orbit.
    price : float
        Rise of the form that is accepted for each point saved.
    limit : float
        Rise of the form above its value for all candidates that must not be exceeded.

    Returns
    -------
    index : ndarray of shape (m,), int64
        Candidates that are left, ascending.
    value : ndarray of shape (m, C), float64
        Their fitted values.
    """
    index = np.arange(len(size))
    bound = math.inf
    while True:
        left = equations.subset(index)
        inverse = left.free_inverse()
        value = left.solve(inverse)
        bound = min(bound, left.objective(value) + limit)
        # As many points as constraints have no freedom left.
        floor = max(left.basis.shape[1], int(REFRESH_FRACTION * len(index)))
        kept = _eliminate_run(inverse, value, size[index], price, bound - left.objective(value), floor)
        if len(kept) == len(index):
            return index, value
        index = index[kept]


def _eliminate_run(
    inverse: DoubleArray, value: DoubleArray, size: IntArray, price: float, budget: float, floor: int
) -> IntArray:
    """Drop points until none is worth dropping or few enough are left; return the indices of those left."""
    index = np.arange(len(size))
    while len(index) > floor:
        spread = np.diag(inverse)
        # Rounding may leave a diagonal at or below zero where the constraints alone fix a value: never drop those.
        safe = np.maximum(spread, RESOLUTION * spread.max())
        cost = np.where(spread >= safe, (value**2).sum(axis=1) / safe, math.inf)
        batch = _choose_batch(inverse, cost / size[index], price)
        if len(batch) == 0 or cost[batch].sum() > budget:
            batch = batch[:1]
        if len(batch) == 0 or cost[batch[0]] > budget:
            break
        block = inverse[:, batch]
        step = np.linalg.solve(block[batch], np.concatenate([block.T, value[batch]], axis=1))
        budget -= float((value[batch] * step[:, len(index) :]).sum())
        value = value - block @ step[:, len(index) :]
        inverse = inverse - block @ step[:, : len(index)]
        left = np.ones(len(index), np.bool_)
        left[batch] = False
        rest = np.flatnonzero(left)
        inverse, value, index = inverse[rest[:, None], rest], value[rest], index[rest]
    return index


def _choose_batch(inverse: DoubleArray, cost: DoubleArray, price: float) -> IntArray:
    """Choose the cheapest points below the price that hardly depend on each other, cheapest first."""
    n_most = max(1, int(BATCH_FRACTION * len(cost)))
    order = np.argsort(cost, kind="stable")[: 4 * n_most]
    order = order[cost[order] < price]
    spread = np.sqrt(np.diag(inverse)[order])
    related = np.abs(inverse[order[:, None], order]) > MAX_CORRELATION * (spread[:, None] * spread)
    chosen: list[int] = []
    barred = np.zeros(len(order), np.bool_)
    for position in range(len(order)):
        if len(chosen) < n_most and not barred[position]:
            chosen.append(position)
            barred |= related[:, position]
    return order[chosen]
