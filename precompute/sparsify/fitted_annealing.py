"""Simulated annealing of the points' positions, judged by the error that the constrained fit would leave.

The move of one of n points changes the fit's equations by a matrix of rank 2. With the inverse S of the equations at
hand, dropping point j costs ``v_j^2 / S_jj``, v being the values, and the new point gains ``r^2 / z``, r being what is
left of its equation and z the Schur complement: O(n^2) operations for each proposal.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from spreadlets.arrays import DoubleArray, IntArray
from spreadlets.errors import InvalidParameterError
from spreadlets.precompute.sparsify.annealing import N_STEPS, propose
from spreadlets.precompute.sparsify.fit import RIDGE, moment_constraints, orthonormal_constraints, project
from spreadlets.precompute.sparsify.lloyd import merge
from spreadlets.psf.laplacian import lattice_biharmonic, solve_free_space

INITIAL_TEMPERATURE = 1e-4
"""Relative rise of the root of the squared error that is accepted with probability 1/e at first; it falls linearly to
zero. A move of one point changes the error that much less than under Voronoi sums, as all values answer to it."""

REFRESH_MOVES = 64
"""Moves after which the inverse is computed anew: updates accumulate rounding."""


class Field(NamedTuple):
    """The fit's equations for a point at any pixel of the window."""

    biharmonic: DoubleArray
    """The lattice biharmonic Green's function by row and column distance."""
    moments: DoubleArray
    """The monomials by which the constraints weigh the values, shape (H, W, 6)."""
    potential: DoubleArray
    """The PSF's potential, the right-hand side, shape (H, W, C)."""
    fixed: DoubleArray
    """The PSF's moments, shape (6, C)."""
    energy: float
    """Sum of the squared PSF: the squared error without any point."""


class Fit(NamedTuple):
    """The best values of some points; `_move` updates the arrays in place."""

    point_rc: IntArray
    inverse: DoubleArray
    """Inverse of the equations of values and Lagrange multipliers, shape (n + 6, n + 6)."""
    solution: DoubleArray
    """Values, then multipliers, shape (n + 6, C)."""


class Proposal(NamedTuple):
    """The move of one point, and what the fit becomes."""

    point: int
    target: IntArray
    column: DoubleArray
    """The inverse's answer to the new point's equation once the old one is gone, -1 at the point itself."""
    schur: float
    residual: DoubleArray
    """What is left of the new point's equation, shape (C,)."""
    rise: float
    """Of the squared error over the plane, summed over the channels."""


def anneal_fitted(
    psf: DoubleArray, point_rc: IntArray, rng: np.random.Generator, n_steps: int = N_STEPS
) -> tuple[IntArray, float]:
    """Move points at random, keeping moves that lower the error that `precompute.sparsify.fit.fit_values` would leave.

    Parameters
    ----------
    psf : ndarray of shape (H, W, C), float64
        PSF, centred, odd sizes, on a window on whose borders it is zero.
    point_rc : ndarray of shape (n, 2), int64
        Points inside the window.
    rng : numpy.random.Generator
        Source of all randomness.
    n_steps : int
        Number of proposals.

    Returns
    -------
    point_rc : ndarray of shape (m, 2), int64
        The best set of points that was met, in row-major order: as many as there were distinct ones.
    error : float
        Squared error of their fit over the plane, summed over the channels.

    Raises
    ------
    InvalidParameterError
        If the points are too few or too aligned to carry the moments.

    Notes
    -----
    The schedule is that of LKS section 5.5, save that no point moves onto another and that each move of a step is
    judged by itself.
    """
    field = _field(psf)
    points = merge(point_rc)
    ridge = _ridge(field, points)
    fit, error = _fitted(field, points, ridge)
    best, least = points, error
    n_moves = 0
    for step in range(n_steps):
        temperature = INITIAL_TEMPERATURE * (1.0 - step / n_steps)
        for index, target in _moves(fit.point_rc, psf.shape, rng):
            proposal = _judged(field, fit, index, target, ridge)
            if proposal.rise >= 0.0 and rng.random() >= np.exp(-proposal.rise / (2.0 * temperature * error)):
                continue
            _move(fit, proposal)
            error += proposal.rise
            n_moves += 1
            if n_moves % REFRESH_MOVES == 0:
                fit, error = _fitted(field, fit.point_rc, ridge)
        if error < least:
            best, least = fit.point_rc.copy(), error
    points = merge(best)
    return points, _fitted(field, points, ridge)[1]


def _field(psf: DoubleArray) -> Field:
    half = np.asarray(psf.shape[:2]) // 2
    offset = np.argwhere(np.ones(psf.shape[:2], dtype=np.bool_)) - half
    matrix, fixed = moment_constraints(psf, offset)
    moments = matrix.T.reshape(*psf.shape[:2], -1)
    table = lattice_biharmonic(max(psf.shape[:2]))
    return Field(table, np.ascontiguousarray(moments), solve_free_space(psf), fixed, float((psf**2).sum()))


def _gram(field: Field, first: IntArray, second: IntArray) -> DoubleArray:
    distance = np.abs(first[:, None, :] - second[None, :, :])
    return np.asarray(field.biharmonic[distance[..., 0], distance[..., 1]])


def _ridge(field: Field, points: IntArray) -> float:
    """Return the weight of the squared values, that of `precompute.sparsify.fit`."""
    basis, _ = orthonormal_constraints(field.moments[points[:, 0], points[:, 1]].T, field.fixed)
    return RIDGE * float(np.trace(project(_gram(field, points, points), basis))) / len(points)


def _fitted(field: Field, points: IntArray, ridge: float) -> tuple[Fit, float]:
    """Solve the equations of some points from scratch; return the fit and its squared error."""
    moments = field.moments[points[:, 0], points[:, 1]]
    gram = _gram(field, points, points) + ridge * np.eye(len(points))
    matrix = np.block([[gram, moments], [moments.T, np.zeros((moments.shape[1],) * 2)]])
    try:
        inverse = np.linalg.inv(matrix)
    except np.linalg.LinAlgError:
        raise InvalidParameterError(
            f"{len(points)} points cannot carry the PSF's moments: use more, and not all on a line or a conic"
        ) from None
    rhs = np.concatenate([field.potential[points[:, 0], points[:, 1]], field.fixed])
    solution = inverse @ rhs
    # At the minimum v'Av - 2 b'v = -b'v - q'l, l being the multipliers with A v + M l = b.
    error = field.energy - float((rhs * solution).sum())
    return Fit(points.copy(), 0.5 * (inverse + inverse.T), solution), error


def _moves(points: IntArray, shape: tuple[int, ...], rng: np.random.Generator) -> list[tuple[int, IntArray]]:
    """Propose moves of a few points by at most a pixel, none onto another point: who moves, and where to."""
    moved = propose(points, shape, rng)
    occupied = {tuple(point) for point in points.tolist()}
    moves = []
    for index in np.flatnonzero((moved != points).any(axis=1)).tolist():
        target = tuple(moved[index].tolist())
        if target not in occupied:
            occupied.add(target)
            moves.append((index, moved[index]))
    return moves


def _judged(field: Field, fit: Fit, index: int, target: IntArray, ridge: float) -> Proposal:
    """Return what moving one point to a free pixel does to the fit."""
    old = fit.inverse[index] / fit.inverse[index, index]
    value = fit.solution[index]
    # Step 1: without the old point.
    rise = float(value @ value) / fit.inverse[index, index]
    equation = np.concatenate([_gram(field, fit.point_rc, target[None])[:, 0], field.moments[tuple(target)]])
    equation[index] = 0.0
    answer = fit.inverse @ equation
    answer -= fit.inverse[index] * (old @ equation)
    # Step 2: with the new one.
    schur = ridge - float(equation @ answer)
    residual = field.potential[tuple(target)] - equation @ (fit.solution - np.outer(old, value))
    answer[index] = -1.0
    return Proposal(index, target, answer, schur, residual, rise - float(residual @ residual) / schur)


def _move(fit: Fit, proposal: Proposal) -> None:
    """Move a point: two updates of rank one, the first of which takes the old point out."""
    index, column = proposal.point, proposal.column
    old, spread = fit.inverse[index].copy(), fit.inverse[index, index]
    fit.solution[:] -= np.outer(old / spread, fit.solution[index])
    fit.inverse[:] -= np.outer(old / spread, old)
    fit.inverse[index] = fit.inverse[:, index] = 0.0
    fit.solution[index] = 0.0
    fit.solution[:] -= np.outer(column, proposal.residual / proposal.schur)
    fit.inverse[:] += np.outer(column / proposal.schur, column)
    fit.point_rc[index] = proposal.target
