"""The one Laplacian of the package: its 5-point stencil, its exact inverse, and its lattice Green's functions.

Everywhere in this package "the Laplacian" is the 5-point stencil on the unit pixel grid, and everything outside an
array is zero. A convolution with the lattice Green's function inverts the stencil in free space; `solve_dirichlet`
inverts it exactly on a box. The two agree for sources whose field has died off before it reaches the sides of the box,
which is what a fitted spreadlet gives.
"""

from collections.abc import Callable, Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray

from spreadlets.arrays import RealArray
from spreadlets.errors import InvalidParameterError

Table = NDArray[np.float64]
Amplitudes = Callable[[Table], tuple[Table, Table]]

MAX_GREEN_RADIUS = 8192
"""Largest table that is offered: its two matrices take 2 GiB."""

# Quadrature of the lattice Green's functions. Below `_SERIES_PHASE / radius` the integrand is a short power series in
# the pixel coordinates; above it a Gauss-Legendre panel of `_PANEL_NODES` nodes resolves `_PANEL_PHASE` radians of the
# fastest cosine to rounding, provided that it is no wider than its distance to the singularity at wavenumber 0.
_SERIES_PHASE = 1.0
_SERIES_TERMS = 22
_PANEL_PHASE = 30.0
_PANEL_NODES = 32
_WIDEST_PANEL = 0.5

MOST_ON_ONE_THREAD = 1 << 18
"""Multiplications of a matrix product up to which BLAS keeps to the thread that asks (OpenBLAS)."""
LARGEST_BY_MATRIX = 128
"""Side, px, up to which a sine transform is a product with its matrix. That is faster up to some 64 px; and it needs no
SciPy, whose import takes as long as a hundred transforms of the largest."""


def laplacian(image: RealArray) -> RealArray:
    """Apply the 5-point stencil to an image that is zero outside its array.

    Parameters
    ----------
    image : ndarray of shape (H, W) or (H, W, C)
        Any unit; floating point.

    Returns
    -------
    ndarray of shape (H + 2, W + 2) or (H + 2, W + 2, C)
        The Laplacian in the same unit per squared pixel and in the same dtype, on a grid grown by one pixel each side,
        so that nothing is cut off: its sum and its first moments vanish.

    Raises
    ------
    InvalidParameterError
        If the image is not floating point or has the wrong number of axes.
    """
    image = _checked(image, "image")
    rows, cols = image.shape[:2]
    out = np.zeros((rows + 2, cols + 2, *image.shape[2:]), image.dtype)
    out[1:-1, 1:-1] = -4 * image
    out[:-2, 1:-1] += image
    out[2:, 1:-1] += image
    out[1:-1, :-2] += image
    out[1:-1, 2:] += image
    return out


def solve_dirichlet(source: RealArray, *, workers: int = 1, overwrite: bool = False) -> RealArray:
    """Solve `Lap u = source` exactly, with `u = 0` on the ring of pixels just outside the array.

    Parameters
    ----------
    source : ndarray of shape (H, W) or (H, W, C)
        The Laplacian; floating point. The solve runs in its dtype.
    workers : int
        Number of threads for the sine transforms.
    overwrite : bool
        Allow the contents of `source` to be destroyed, which saves one copy.

    Returns
    -------
    ndarray of the shape and dtype of `source`

    Raises
    ------
    InvalidParameterError
        If `source` is not floating point or has the wrong number of axes.

    Notes
    -----
    The type-I sine transform diagonalises the stencil on the box. In float32 the relative error is near 1e-6 at 2047^2.
    """
    source = _checked(source, "source")
    if max(source.shape[:2]) <= LARGEST_BY_MATRIX:
        return _solve_by_matrix(source)
    from scipy import fft

    along_rows, along_cols = (_sine_eigenvalues(n).astype(source.dtype) for n in source.shape[:2])
    eigenvalues = along_rows[:, None] + along_cols

    spectrum = fft.dstn(source, type=1, axes=(0, 1), workers=workers, overwrite_x=overwrite)
    spectrum /= eigenvalues if source.ndim == 2 else eigenvalues[:, :, None]
    solution: RealArray = fft.idstn(spectrum, type=1, axes=(0, 1), workers=workers, overwrite_x=True)
    return solution


def solve_free_space(source: RealArray, *, workers: int = 1) -> Table:
    """Solve `Lap u = source` in free space by convolution with the lattice Green's function, in float64.

    Parameters
    ----------
    source : ndarray of shape (H, W) or (H, W, C)
        The Laplacian. For an answer that is zero at infinity its sum must vanish; with a net source the answer grows
        with the logarithm of the distance and is fixed by `g(0, 0) = 0`.
    workers : int
        Number of threads for the Fourier transforms.

    Returns
    -------
    float64 ndarray of the shape of `source`

    Raises
    ------
    InvalidParameterError
        If `source` is not floating point or has the wrong number of axes.

    Notes
    -----
    Exact to rounding, and the oracle for the fast integrators: the transform has room for every pair of pixels, so
    nothing wraps around.
    """
    from scipy import fft

    charge: Table = _checked(source, "source").astype(np.float64)
    rows, cols = charge.shape[:2]
    shape = tuple(fft.next_fast_len(2 * n - 1, real=True) for n in (rows, cols))
    quarter = lattice_green(max(rows, cols) - 1)
    row_distance, col_distance = (np.minimum(i, n - i) for n in shape for i in [np.arange(n)])
    # Distances that exceed the array never meet two pixels of it; any finite value will do there.
    kernel = quarter[np.minimum(row_distance, rows - 1)][:, np.minimum(col_distance, cols - 1)]
    kernel_spectrum = fft.rfft2(kernel, workers=workers)
    planes = charge.reshape(rows, cols, -1)
    solution = np.empty_like(planes)
    for channel in range(planes.shape[2]):
        spectrum = fft.rfft2(planes[:, :, channel], shape, workers=workers)
        spectrum *= kernel_spectrum
        solution[:, :, channel] = fft.irfft2(spectrum, shape, workers=workers)[:rows, :cols]
    free: Table = solution.reshape(charge.shape)
    return free


def lattice_green(radius: int) -> Table:
    """Tabulate the Green's function of the 5-point Laplacian on the infinite lattice.

    Parameters
    ----------
    radius : int
        Largest coordinate in pixels, 0 to `MAX_GREEN_RADIUS`.

    Returns
    -------
    float64 ndarray of shape (radius + 1, radius + 1)
        The quarter `g[m, n]`, `m, n >= 0`, with `Lap g = delta` and `g[0, 0] = 0`. The function is even in both
        coordinates and symmetric; far out it is `(ln r + gamma + 1.5 ln 2) / (2 pi)`.

    Raises
    ------
    InvalidParameterError
        If the radius is out of range.

    Notes
    -----
    With wavenumber k along one axis and `cosh alpha = 2 - cos k`, the transform over that axis is
    `-exp(-alpha |n|) / (2 sinh alpha)`. Its integral over (0, pi) is a matrix product of cosines and exponentials.
    """
    table = _integrate_modes(radius, lambda alpha: (-0.5 / np.sinh(alpha), np.zeros_like(alpha)), [(0, 0)])
    table -= table[0, 0]
    return table


def lattice_biharmonic(radius: int) -> Table:
    """Tabulate the Green's function of the squared 5-point Laplacian on the infinite lattice.

    Parameters
    ----------
    radius : int
        Largest coordinate in pixels, 0 to `MAX_GREEN_RADIUS`.

    Returns
    -------
    float64 ndarray of shape (radius + 1, radius + 1)
        The quarter `B[m, n]`, `m, n >= 0`, with `Lap B = g`, hence `Lap Lap B = delta`; even in both coordinates and
        symmetric. An even polynomial of degree 2 is free, and without effect on sources whose moments up to the second
        vanish: it is chosen so that `B[0, 0] = B[1, 0] = 0`.

    Raises
    ------
    InvalidParameterError
        If the radius is out of range.

    Notes
    -----
    The transform over one axis is `exp(-alpha |n|) (|n| + coth alpha) / (4 sinh^2 alpha)`, with alpha as in
    `lattice_green`. If G inverts the Laplacian and the moments of two point sources a and b vanish up to the second,
    `sum (G a) (G b) = sum_ij a_i b_j B[x_i - x_j]`.
    """
    table = _integrate_modes(radius, _biharmonic_amplitudes, [(0, 0), (2, 0), (0, 2)])
    # Dropping the singular terms treats the two axes differently, by a multiple of m^2 - n^2.
    symmetric: Table = 0.5 * (table + table.T)
    symmetric -= symmetric[0, 0]
    if radius > 0:
        squares: Table = np.arange(radius + 1.0) ** 2
        symmetric -= symmetric[1, 0] * (squares[:, None] + squares)
    return symmetric


def _checked(array: RealArray, name: str) -> RealArray:
    array = np.asarray(array)
    if array.ndim not in (2, 3) or array.size == 0 or not np.issubdtype(array.dtype, np.floating):
        raise InvalidParameterError(
            f"{name} has shape {array.shape} and dtype {array.dtype}; "
            "give a non-empty floating-point array of shape (H, W) or (H, W, C)"
        )
    return array


def _solve_by_matrix(source: RealArray) -> RealArray:
    """Do as `solve_dirichlet`, in float64, for a small array."""
    rows, cols = (_sine_matrix(n) for n in source.shape[:2])
    along_rows, along_cols = (_sine_eigenvalues(n) for n in source.shape[:2])
    # Channels come first, as a stack of matrices. The sine matrix is its own inverse.
    planes = np.ascontiguousarray(np.moveaxis(source.reshape(*source.shape[:2], -1), 2, 0), np.float64)
    spectrum = _product(_product(rows, planes), cols) / (along_rows[:, None] + along_cols)
    planes = _product(_product(rows, spectrum), cols)
    return np.moveaxis(planes, 0, 2).reshape(source.shape).astype(source.dtype)


def _product(left: Table, right: Table) -> Table:
    """Return the product of small matrices, made on this thread: on a busy machine, others would be waited for."""
    step = max(MOST_ON_ONE_THREAD // (right.shape[-2] * right.shape[-1]), 1)
    parts = [left[..., row : row + step, :] @ right for row in range(0, left.shape[-2], step)]
    return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=-2)


@cache
def _sine_matrix(n: int) -> Table:
    """Return the orthonormal type-I sine transform of n values as a matrix, which is symmetric."""
    k = np.arange(1, n + 1)
    matrix: Table = np.sqrt(2.0 / (n + 1)) * np.sin(np.pi / (n + 1) * np.outer(k, k))
    return matrix


def _sine_eigenvalues(n: int) -> Table:
    """Eigenvalues of the second difference on n pixels between two zeros, without cancellation at the low end."""
    half_angles: Table = np.arange(1.0, n + 1) * (0.5 * np.pi / (n + 1))
    eigenvalues: Table = -4 * np.sin(half_angles) ** 2
    return eigenvalues


def _biharmonic_amplitudes(alpha: Table) -> tuple[Table, Table]:
    per_distance = 0.25 / np.sinh(alpha) ** 2
    return per_distance / np.tanh(alpha), per_distance


def _integrate_modes(radius: int, amplitudes: Amplitudes, dropped: Sequence[tuple[int, int]]) -> Table:
    """Integrate `cos(k m) exp(-alpha n) (p + q n) / pi` over k in (0, pi), less some terms of its series at 0.

    Parameters
    ----------
    radius : int
        Largest m and n.
    amplitudes : callable
        Gives p and q as functions of alpha.
    dropped : sequence of (power of m, power of n)
        The terms of the series at wavenumber 0 whose coefficients cannot be integrated. They are polynomials in m and n
        that the caller does not need.

    Returns
    -------
    float64 ndarray of shape (radius + 1, radius + 1)
    """
    if not 0 <= radius <= MAX_GREEN_RADIUS:
        raise InvalidParameterError(f"radius is {radius}; the allowed range is 0 to {MAX_GREEN_RADIUS} pixels")
    first_edge = _SERIES_PHASE / max(radius, 1)
    coordinate = np.arange(radius + 1.0)
    wavenumber, weight = _panel_nodes(first_edge, radius)
    alpha = 2 * np.arcsinh(np.sin(0.5 * wavenumber))
    constant, per_distance = amplitudes(alpha)
    decay = np.exp(-np.outer(alpha, coordinate))
    decay *= weight[:, None] * (constant[:, None] + per_distance[:, None] * coordinate)
    table: Table = np.cos(np.outer(coordinate, wavenumber)) @ decay
    coefficients = _series_coefficients(first_edge, amplitudes)
    for power in dropped:
        coefficients[power] = 0
    powers = (first_edge * coordinate)[:, None] ** np.arange(_SERIES_TERMS)
    return (table + powers @ coefficients @ powers.T) / np.pi


def _panel_nodes(first_edge: float, radius: int) -> tuple[Table, Table]:
    """Nodes and weights from `first_edge` to pi: panels widen with the distance to 0 until the cosine limits them."""
    edges = [first_edge]
    while edges[-1] < np.pi:
        edges.append(edges[-1] + min(edges[-1], _PANEL_PHASE / max(radius, 1), _WIDEST_PANEL))
    edges[-1] = np.pi
    node, weight = np.polynomial.legendre.leggauss(_PANEL_NODES)
    centre, half_width = 0.5 * np.add(edges[1:], edges[:-1]), 0.5 * np.diff(edges)
    return (centre[:, None] + half_width[:, None] * node).ravel(), (half_width[:, None] * weight).ravel()


def _series_coefficients(first_edge: float, amplitudes: Amplitudes) -> Table:
    """Coefficients of `(first_edge m)^i (first_edge n)^j` in the integral over wavenumbers (0, first_edge)."""
    node, weight = np.polynomial.legendre.leggauss(_PANEL_NODES)
    wavenumber = 0.5 * first_edge * (node + 1)
    alpha = 2 * np.arcsinh(np.sin(0.5 * wavenumber))
    constant, per_distance = amplitudes(alpha)
    order = np.arange(_SERIES_TERMS)
    factorial = np.cumprod(np.maximum(order, 1).astype(np.float64))
    cosine = np.where(order % 2, 0.0, (-1.0) ** (order // 2)) / factorial
    exponential = (-1.0) ** order / factorial
    along_m = cosine * (wavenumber / first_edge)[:, None] ** order
    along_n = exponential * (alpha / first_edge)[:, None] ** order
    # The factor n shifts the exponential's series by one power.
    shifted = np.zeros_like(along_n)
    shifted[:, 1:] = along_n[:, :-1] / first_edge
    along_n = constant[:, None] * along_n + per_distance[:, None] * shifted
    coefficients: Table = along_m.T @ (along_n * (0.5 * first_edge * weight)[:, None])
    return coefficients
