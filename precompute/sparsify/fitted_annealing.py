"""Simulated annealing of fitted points among candidates, judged by the error that the constrained fit would leave.

Moving one of n points changes the fit's equations by a matrix of rank 2. With the inverse S of the equations at hand,
dropping point j costs ``v_j^2 / S_jj``, v being the values, and the new point gains ``r^2 / z``, r being what is left
of its equation and z the Schur complement: O(n^2) operations for each proposal.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from spreadlets.arrays import DoubleArray, IntArray
from spreadlets.precompute.sparsify.annealing import MOVED_FRACTION, N_STEPS
from spreadlets.precompute.sparsify.fit import Equations, ridge

INITIAL_TEMPERATURE = 1e-4
"""Relative rise of the root of the error that is accepted with probability 1/e at first; it falls linearly to zero. A
move of one point changes the error that much less than under Voronoi sums, as all values answer to it."""

REFRESH_MOVES = 64
"""Moves after which the inverse is computed anew: updates accumulate rounding."""


class Fit(NamedTuple):
    """The best values of some candidates; `_move` updates the arrays in place."""

    ridge: float
    """Weight of the squared values."""

    chosen: IntArray
    """The candidates that are points, shape (n,)."""
    inverse: DoubleArray
    """Inverse of the equations of values and Lagrange multipliers, shape (n + k, n + k)."""
    solution: DoubleArray
    """Values, then multipliers, shape (n + k, C)."""


class Proposal(NamedTuple):
    """The move of one point, and what the fit becomes."""

    point: int
    target: int
    column: DoubleArray
    """The inverse's answer to the new point's equation once the old one is gone, -1 at the point itself."""
    schur: float
    residual: DoubleArray
    """What is left of the new point's equation, shape (C,)."""
    rise: float
    """Of the form, summed over the channels."""


def anneal_fitted(
    equations: Equations,
    neighbours: Sequence[IntArray],
    index: IntArray,
    rng: np.random.Generator,
    n_steps: int = N_STEPS,
) -> IntArray:
    """Move points to neighbouring candidates at random, keeping moves that lower the error that the fit leaves.

    Parameters
    ----------
    equations : Equations
        The quadratic form of all m candidates.
    neighbours : sequence of ndarray of int64
        For each candidate those that a point may move to from it in one step, see `candidates_near`.
    index : ndarray of shape (n,), int64
        The candidates that are points.
    rng : numpy.random.Generator
        Source of all randomness.
    n_steps : int
        Number of steps, in each of which `MOVED_FRACTION` of the points try to move.

    Returns
    -------
    ndarray of shape (n,), int64
        The best points that were met, ascending.

    Notes
    -----
    The schedule is that of LKS section 5.5, save that no point moves onto another and that each move of a step is
    judged by itself.
    """
    if len(equations.subset(index).fixed) < len(equations.fixed):
        # On a conic some moments are met by luck, which a move would end.
        return np.sort(index)
    _, weight = ridge(equations.gram, equations.gram)
    fit, error = _fitted(equations, index, weight)
    best, least, start = fit.chosen.copy(), error, error
    occupied = np.zeros(len(neighbours), np.bool_)
    occupied[index] = True
    n_moves = 0
    for step in range(n_steps):
        temperature = INITIAL_TEMPERATURE * (1.0 - step / n_steps)
        for point in rng.choice(len(index), size=max(1, round(MOVED_FRACTION * len(index))), replace=False):
            free = neighbours[fit.chosen[point]]
            free = free[~occupied[free]]
            # Rounding may leave nothing where the constraints alone fix a value: such a point stays.
            if len(free) == 0 or fit.inverse[point, point] <= 0.0:
                continue
            proposal = _judged(equations, fit, int(point), int(free[rng.integers(len(free))]))
            # Of an exact fit rounding leaves an error of 0 or below, which nothing may raise.
            chance = np.exp(-proposal.rise / (2.0 * temperature * error)) if proposal.rise >= 0.0 < error else 0.0
            if proposal.rise >= 0.0 and rng.random() >= chance:
                continue
            occupied[fit.chosen[point]], occupied[proposal.target] = False, True
            _move(fit, proposal)
            error += proposal.rise
            n_moves += 1
            if n_moves % REFRESH_MOVES == 0:
                fit, error = _fitted(equations, fit.chosen, weight)
        if error < least:
            best, least = fit.chosen.copy(), error
    best = np.sort(best)
    return best if _fitted(equations, best, weight)[1] < start else np.sort(index)


def candidates_near(members: IntArray) -> list[IntArray]:
    """Return for each orbit the others that have a pixel next to its first one, across corners too.

    Parameters
    ----------
    members : ndarray of shape (m, g, 2), int64
        The orbits, as `precompute.sparsify.symmetry.orbits` gives them.

    Returns
    -------
    list of ndarray of int64, ascending
    """
    # A border wide enough for every step.
    origin = members.min(axis=(0, 1)) - 1
    place = np.full(tuple(members.max(axis=(0, 1)) - origin + 2), -1, np.int64)
    row, column = (members - origin).reshape(-1, 2).T
    place[row, column] = np.repeat(np.arange(len(members)), members.shape[1])
    near = []
    for orbit, (r, c) in enumerate(members[:, 0] - origin):
        around = np.unique(place[r - 1 : r + 2, c - 1 : c + 2])
        near.append(around[(around >= 0) & (around != orbit)])
    return near


def _fitted(equations: Equations, index: IntArray, weight: float) -> tuple[Fit, float]:
    """Solve the equations of some candidates from scratch; return the fit and its error."""
    basis = equations.basis[index]
    gram = equations.gram[np.ix_(index, index)] + weight * np.eye(len(index))
    matrix = np.block([[gram, basis], [basis.T, np.zeros((basis.shape[1],) * 2)]])
    inverse = np.linalg.inv(matrix)
    rhs = np.concatenate([equations.rhs[index], equations.fixed])
    solution = inverse @ rhs
    # At the minimum v'Av - 2 b'v = -b'v - q'l, l being the multipliers with A v + Q l = b.
    error = equations.constant - float((rhs * solution).sum())
    return Fit(weight, index.copy(), 0.5 * (inverse + inverse.T), solution), error


def _judged(equations: Equations, fit: Fit, point: int, target: int) -> Proposal:
    """Return what moving one point to a free candidate does to the fit."""
    old = fit.inverse[point] / fit.inverse[point, point]
    value = fit.solution[point]
    # Step 1: without the old point.
    rise = float(value @ value) / fit.inverse[point, point]
    equation = np.concatenate([equations.gram[fit.chosen, target], equations.basis[target]])
    equation[point] = 0.0
    answer = fit.inverse @ equation
    answer -= fit.inverse[point] * (old @ equation)
    # Step 2: with the new one.
    schur = equations.gram[target, target] + fit.ridge - float(equation @ answer)
    residual = equations.rhs[target] - equation @ (fit.solution - old[:, None] * value)
    answer[point] = -1.0
    return Proposal(point, target, answer, schur, residual, rise - float(residual @ residual) / schur)


def _move(fit: Fit, proposal: Proposal) -> None:
    """Move a point: two updates of rank one, the first of which takes the old point out."""
    point, column = proposal.point, proposal.column
    old, spread = fit.inverse[point].copy(), fit.inverse[point, point]
    fit.solution[:] -= np.outer(old / spread, fit.solution[point])
    fit.inverse[:] -= np.outer(old / spread, old)
    fit.inverse[point] = fit.inverse[:, point] = 0.0
    fit.solution[point] = 0.0
    fit.solution[:] -= np.outer(column, proposal.residual / proposal.schur)
    fit.inverse[:] += np.outer(column / proposal.schur, column)
    fit.chosen[point] = proposal.target
