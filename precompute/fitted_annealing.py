"""Simulated annealing of the points' positions, judged by the error that the constrained fit would leave.

Of n points, k proposed moves change the fit's equations by a matrix of rank 2 k. With the inverse of the equations at
hand, dropping k points costs ``v' S^-1 v``, v being their values and S their block of the inverse, and k new points gain
``r' Z^-1 r``, r being what is left of their equations and Z the Schur complement: O(k n^2) operations for each proposal.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from precompute.annealing import N_STEPS, propose
from precompute.fit import RIDGE, moment_constraints, orthonormal_constraints, project
from precompute.lloyd import merge
from spreadlets.errors import InvalidParameterError
from spreadlets.laplacian import lattice_biharmonic, solve_free_space

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

INITIAL_TEMPERATURE = 1e-4
REFRESH_STEPS = 32
"""Accepted proposals after which the inverse is computed anew: updates accumulate rounding."""


class Field(NamedTuple):
    """The fit's equations for a point at any pixel of the window."""

    biharmonic: FloatArray
    """The lattice biharmonic Green's function by row and column distance."""
    moments: FloatArray
    """The monomials by which the constraints weigh the values, shape (H, W, 6)."""
    potential: FloatArray
    """The PSF's potential, the right-hand side, shape (H, W, C)."""
    fixed: FloatArray
    """The PSF's moments, shape (6, C)."""
    energy: float
    """Sum of the squared PSF: the squared error without any point."""


class Fit(NamedTuple):
    """The best values of some points."""

    point_rc: IntArray
    inverse: FloatArray
    """Inverse of the equations of values and Lagrange multipliers, shape (n + 6, n + 6)."""
    solution: FloatArray
    """Values, then multipliers, shape (n + 6, C)."""
    error: float
    """Squared error over the plane, summed over the channels."""


def anneal_fitted(
    psf: FloatArray, point_rc: IntArray, rng: np.random.Generator, n_steps: int = N_STEPS
) -> tuple[IntArray, float]:
    """Move points at random, keeping moves that lower the error that `precompute.fit.fit_values` would leave.

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
    The schedule is that of LKS section 5.5, save that no point moves onto another; temperatures are relative to the root
    of the squared error.
    """
    field = _field(psf)
    points = merge(point_rc)
    ridge = _ridge(field, points)
    fit = best = _fitted(field, points, ridge)
    n_accepted = 0
    for step in range(n_steps):
        index, target = _moves(fit.point_rc, psf.shape, rng)
        temperature = INITIAL_TEMPERATURE * (1.0 - step / n_steps)
        if len(index) == 0:
            continue
        trial = _moved(field, fit, index, target, ridge)
        if not _accepted(trial.error, fit.error, temperature, rng):
            continue
        n_accepted += 1
        fit = trial if n_accepted % REFRESH_STEPS else _fitted(field, trial.point_rc, ridge)
        if fit.error < best.error:
            best = fit
    points = merge(best.point_rc)
    return points, _fitted(field, points, ridge).error


def _accepted(new: float, old: float, temperature: float, rng: np.random.Generator) -> bool:
    rise = np.sqrt(max(new, 0.0) / max(old, np.finfo(np.float64).tiny)) - 1.0
    return bool(rise < 0.0 or rng.random() < np.exp(-rise / temperature))


def _field(psf: FloatArray) -> Field:
    half = np.asarray(psf.shape[:2]) // 2
    offset = np.argwhere(np.ones(psf.shape[:2], dtype=np.bool_)) - half
    matrix, fixed = moment_constraints(psf, offset)
    moments = matrix.T.reshape(*psf.shape[:2], -1)
    table = lattice_biharmonic(max(psf.shape[:2]))
    return Field(table, np.ascontiguousarray(moments), solve_free_space(psf), fixed, float((psf**2).sum()))


def _gram(field: Field, first: IntArray, second: IntArray) -> FloatArray:
    distance = np.abs(first[:, None, :] - second[None, :, :])
    return np.asarray(field.biharmonic[distance[..., 0], distance[..., 1]])


def _ridge(field: Field, points: IntArray) -> float:
    """Return the weight of the squared values, that of `precompute.fit`."""
    basis, _ = orthonormal_constraints(field.moments[points[:, 0], points[:, 1]].T, field.fixed)
    return RIDGE * float(np.trace(project(_gram(field, points, points), basis))) / len(points)


def _fitted(field: Field, points: IntArray, ridge: float) -> Fit:
    """Solve the equations of some points from scratch."""
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
    return Fit(points, inverse, solution, field.energy - float((rhs * solution).sum()))


def _moves(points: IntArray, shape: tuple[int, ...], rng: np.random.Generator) -> tuple[IntArray, IntArray]:
    """Propose moves by at most a pixel, but none onto another point: return who moves (k,), and where to (k, 2)."""
    moved = propose(points, shape, rng)
    changed = np.flatnonzero((moved != points).any(axis=1))
    occupied = {tuple(point) for point in points.tolist()}
    kept = []
    for index in changed.tolist():
        target = tuple(moved[index].tolist())
        if target not in occupied:
            occupied.add(target)
            kept.append(index)
    return np.array(kept, dtype=np.int64), moved[kept]


def _moved(field: Field, fit: Fit, index: IntArray, target: IntArray, ridge: float) -> Fit:
    """Return the fit after some of the points have moved to free pixels."""
    # Step 1: without these points. Their rows and columns of the inverse vanish.
    block = fit.inverse[:, index]
    spread = 0.5 * (block[index] + block[index].T)
    lifted = np.linalg.solve(spread, block.T)
    value = fit.solution[index]
    inverse = fit.inverse - block @ lifted
    inverse[index] = 0.0
    inverse[:, index] = 0.0
    solution = fit.solution - lifted.T @ value
    solution[index] = 0.0
    error = fit.error + float((value * np.linalg.solve(spread, value)).sum())
    # Step 2: with points at the targets, in their places.
    column = np.concatenate([_gram(field, fit.point_rc, target), field.moments[target[:, 0], target[:, 1]].T])
    column[index] = 0.0
    answer = inverse @ column
    schur = _gram(field, target, target) + ridge * np.eye(len(target)) - column.T @ answer
    residual = field.potential[target[:, 0], target[:, 1]] - column.T @ solution
    answer[index] = -np.eye(len(index))
    inverse += answer @ np.linalg.solve(schur, answer.T)
    # Rounding that is not symmetric grows exponentially with the moves.
    inverse = 0.5 * (inverse + inverse.T)
    value = np.linalg.solve(schur, residual)
    points = fit.point_rc.copy()
    points[index] = target
    return Fit(points, inverse, solution - answer @ value, error - float((residual * value).sum()))
