"""Values for given points: linear least squares under exact moments.

With the positions fixed, the values minimise a quadratic form of the error ``e = G v - f`` subject to linear
constraints: all moments of the values up to the second order equal those of the Laplacian of the PSF. Then the energy
is exact and the error dies off with the third power of the distance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.linalg

from spreadlets.arrays import DoubleArray, IntArray
from spreadlets.errors import InvalidParameterError
from spreadlets.psf.laplacian import laplacian, lattice_biharmonic, solve_free_space
from spreadlets.psf.spreadlet import MOMENT_EXPONENTS

RIDGE = 1e-9
"""Weight of the squared values, relative to the mean diagonal of the quadratic form: it bounds cancelling values."""

RANK_TOLERANCE = 1e-9
"""Singular values of the constraints below this fraction of the largest count as dependent."""

ROUNDING = 1e-11
"""Error of the quadratic form, relative to its largest entry."""

FEASIBILITY_TOLERANCE = 1e-7
"""Largest relative violation of the constraints that points which cannot meet them may leave."""


QUANTUM_BITS = 22
"""Values are rounded to the largest one's power of two divided by 2 to this power: float32's precision, less slack."""


@dataclass(frozen=True)
class Equations:
    """A quadratic form ``v' A v - 2 b' v + c`` to be minimised subject to ``Q' v = q`` with orthonormal columns Q.

    Attributes
    ----------
    gram : ndarray of shape (n, n), float64
        A, symmetric, positive semidefinite on the free subspace.
    rhs : ndarray of shape (n, C), float64
        b, one column for each channel.
    constant : float
        c, summed over the channels.
    basis : ndarray of shape (n, k), float64
        Q, the constraints, orthonormalised.
    fixed : ndarray of shape (k, C), float64
        q, the values' components along the constraints.
    """

    gram: DoubleArray
    rhs: DoubleArray
    constant: float
    basis: DoubleArray
    fixed: DoubleArray

    def subset(self, index: IntArray) -> Equations:
        """Return the equations of some of the points, the others' values being zero."""
        basis, fixed = orthonormal_constraints(self.basis[index].T, self.fixed)
        return Equations(self.gram[np.ix_(index, index)], self.rhs[index], self.constant, basis, fixed)

    def free_inverse(self) -> DoubleArray:
        """Return ``Z (Z' A Z)^-1 Z'``, Z spanning the free subspace: how the minimum answers to a change of b."""
        projected = project(self.gram, self.basis)
        scale, weight = ridge(self.gram, projected)
        projected[np.diag_indices(len(projected))] += weight
        # On the span of Q any positive definite stand-in will do; it is taken off again.
        factor, failure = scipy.linalg.lapack.dpotrf(projected + scale * self.basis @ self.basis.T, lower=1)
        if failure:
            raise InvalidParameterError("the points' equations are singular; are two points the same?")
        inverse, _ = scipy.linalg.lapack.dpotri(factor, lower=1)
        inverse = np.tril(inverse) + np.tril(inverse, -1).T
        return project(np.asarray(inverse), self.basis)

    def solve(self, inverse: DoubleArray) -> DoubleArray:
        """Return the values (n, C) at the minimum, given `free_inverse`."""
        particular = self.basis @ self.fixed
        return particular + inverse @ (self.rhs - self.gram @ particular)

    def objective(self, value: DoubleArray) -> float:
        """Return the quadratic form at some values (n, C), summed over the channels."""
        return float(self.constant + np.sum(value * (self.gram @ value - 2.0 * self.rhs)))


def fit_values(psf: DoubleArray, offset_rc: IntArray) -> DoubleArray:
    """Fit the values of given points to a PSF in plain least squares over the whole plane.

    Parameters
    ----------
    psf : ndarray of shape (H, W, C), float64
        PSF, centred, odd sizes.
    offset_rc : ndarray of shape (n, 2), int64
        Distinct points, offsets from the centre.

    Returns
    -------
    ndarray of shape (n, C), float64
        Values of the Laplacian at the points. All moments up to the second order are those of the PSF's Laplacian.

    Raises
    ------
    InvalidParameterError
        If two points coincide, or the points are too few or too aligned to carry the moments.

    Notes
    -----
    The form is ``(v - L)' B (v - L)`` with the lattice biharmonic Green's function B, as ``B = G' G``; no matrix of
    pixels is needed. B is definite only on values whose moments vanish, and that is where the constraints keep v - L.
    """
    equations = biharmonic_equations(psf, offset_rc)
    return equations.solve(equations.free_inverse())


def quantise(offset_rc: IntArray, value: DoubleArray) -> npt.NDArray[np.float32]:
    """Round values to float32 such that each channel's sum is exactly zero and its energy nearly kept.

    A rest of the sum, however small, would give the solution a logarithmic tail over the whole image.

    Parameters
    ----------
    offset_rc : ndarray of shape (n, 2), int64
        Offsets from the centre.
    value : ndarray of shape (n, C), float64
        Values whose sums vanish but for rounding.

    Returns
    -------
    ndarray of shape (n, C), float32
        Multiples of a power of two per channel; the points nearest to and farthest from the centre take up what
        rounding left of the sum and of the second moment.
    """
    largest = np.abs(value).max(axis=0)
    step = np.exp2(np.ceil(np.log2(np.maximum(largest, np.finfo(np.float32).tiny))) - QUANTUM_BITS)
    units = np.rint(value / step)
    square = (offset_rc**2).sum(axis=1)
    near, far = np.argmin(square), np.argmax(square)
    units[near] -= units.sum(axis=0)
    if square[far] > square[near]:
        excess = np.rint(square @ (units - value / step) / (square[far] - square[near]))
        units[far] -= excess
        units[near] += excess
    return np.asarray(units * step, dtype=np.float32)


def biharmonic_equations(psf: DoubleArray, offset_rc: IntArray) -> Equations:
    """Build the equations of `fit_values`; the constant is that of the error relative to zero values, left at 0."""
    _check_distinct(offset_rc)
    basis, fixed = orthonormal_constraints(*moment_constraints(psf, offset_rc))
    distance = np.abs(offset_rc[:, None, :] - offset_rc[None, :, :])
    gram = lattice_biharmonic(int(distance.max(initial=0)))[distance[..., 0], distance[..., 1]]
    half = np.asarray(psf.shape[:2]) // 2
    reach = np.maximum(half, np.abs(offset_rc).max(axis=0, initial=0))
    padding = [(int(n), int(n)) for n in reach - half]
    # B L = G f up to a constant, which the constraint on the sum makes void.
    potential = solve_free_space(np.pad(psf, [*padding, (0, 0)]))
    row, column = (offset_rc + reach).T
    return Equations(gram, potential[row, column], 0.0, basis, fixed)


def moment_constraints(psf: DoubleArray, offset_rc: IntArray) -> tuple[DoubleArray, DoubleArray]:
    """Return the moments' matrix (6, n) at the points and their values (6, C) for the PSF's Laplacian.

    Coordinates are in units of the PSF's half-size, so that the rows are of similar size.
    """
    dense = laplacian(psf)
    half = np.asarray(dense.shape[:2]) // 2
    scale = float(half.max())
    grid = np.stack(np.meshgrid(*(np.arange(-h, h + 1) / scale for h in half), indexing="ij"), axis=-1)
    target = np.tensordot(_powers(grid), dense, axes=((1, 2), (0, 1)))
    return _powers(offset_rc / scale), np.asarray(target)


def orthonormal_constraints(matrix: DoubleArray, target: DoubleArray) -> tuple[DoubleArray, DoubleArray]:
    """Turn constraints ``M v = m`` into ``Q' v = q`` with orthonormal columns Q, dropping dependent ones.

    Parameters
    ----------
    matrix : ndarray of shape (k, n), float64
        M.
    target : ndarray of shape (k, C), float64
        m.

    Returns
    -------
    basis : ndarray of shape (n, r), float64
        Q, r the rank of M.
    fixed : ndarray of shape (r, C), float64
        q.

    Raises
    ------
    InvalidParameterError
        If no values can meet the constraints.
    """
    left, singular, right = np.linalg.svd(matrix, full_matrices=False)
    kept = singular > RANK_TOLERANCE * singular.max(initial=0.0)
    rotated = left.T @ target
    unmet = np.abs(target - left[:, kept] @ rotated[kept]).max(initial=0.0)
    if unmet > FEASIBILITY_TOLERANCE * np.abs(target).max(initial=0.0):
        raise InvalidParameterError(
            f"{matrix.shape[1]} points cannot carry the PSF's moments: use more, and not all on a line or a conic"
        )
    return right[kept].T, rotated[kept] / singular[kept, None]


def _powers(coordinate: DoubleArray) -> DoubleArray:
    """Evaluate the monomials of `MOMENT_EXPONENTS` at coordinates (..., 2) as (6, ...)."""
    return np.stack([coordinate[..., 0] ** a * coordinate[..., 1] ** b for a, b in MOMENT_EXPONENTS])


def ridge(gram: DoubleArray, projected: DoubleArray) -> tuple[float, float]:
    """Return the mean diagonal entry of a form restricted to its free subspace, and the weight of squared values."""
    rounding = ROUNDING * float(np.abs(gram).max())
    scale = max(float(np.trace(projected)) / len(projected), rounding)
    return scale, RIDGE * scale + rounding


def project(matrix: DoubleArray, basis: DoubleArray) -> DoubleArray:
    """Restrict a symmetric matrix to the complement of the basis from both sides."""
    along = matrix @ basis
    crossed = along @ basis.T
    return matrix - crossed - crossed.T + basis @ (basis.T @ along) @ basis.T


def _check_distinct(offset_rc: IntArray) -> None:
    n_distinct = len(np.unique(offset_rc, axis=0))
    if n_distinct != len(offset_rc):
        raise InvalidParameterError(f"only {n_distinct} of {len(offset_rc)} points are distinct; merge the others")
