"""The published way from a dense PSF to a spreadlet, to the letter: LKS section 5.5.

Darts are thrown with the absolute Laplacian as importance, relaxed by Lloyd's iteration, given the sum of the Laplacian
over their Voronoi cells, and annealed. A PSF that would need as many points as it has pixels is drawn directly. One
thing is added at the end, lest the images be useless: the moments of the values, which decide the field far away, are
repaired.
"""

from __future__ import annotations

import numpy as np

from spreadlets.arrays import DoubleArray, IntArray
from spreadlets.precompute.sparsify.annealing import anneal
from spreadlets.precompute.sparsify.dart_throwing import throw_darts
from spreadlets.precompute.sparsify.direct import direct_spreadlet
from spreadlets.precompute.sparsify.fit import moment_constraints, quantise
from spreadlets.precompute.sparsify.lloyd import collapse, relax
from spreadlets.precompute.sparsify.measurement import Result, measure_spreadlet
from spreadlets.precompute.sparsify.preparation import on_box, support
from spreadlets.psf.laplacian import laplacian
from spreadlets.psf.spreadlet import Spreadlet

POINTS_PER_PEAK = 3.0
"""Points, at density 1, for as much absolute Laplacian as the PSF's peak. LKS says that the cells' areas fall with the
Laplacian, but not by which factor; with this one the combined model's sparse cells have its mean sparsity of 9 %."""


def sparsify_lks(psf: DoubleArray, density: float, seed: int) -> Result:
    """Turn a PSF into a spreadlet as published.

    Parameters
    ----------
    psf : ndarray of shape (H, W, C), float64
        PSF, non-negative, centred, odd sizes.
    density : float
        Factor of the number of points.
    seed : int
        Of darts and annealing.

    Returns
    -------
    spreadlet, statistics
        As of `precompute.sparsify.sparsify.sparsify`.

    Notes
    -----
    LKS section 5.5 and, for the choice between points and pixels, section 6.4: "simply on the number of points".
    """
    # One more pixel on each side, for the Laplacian.
    boxed = np.pad(on_box(psf), [(1, 1), (1, 1), (0, 0)])
    points, value = place_points(boxed, density, np.random.default_rng(seed))
    pixels = support(boxed)
    if len(points) >= pixels.sum():
        spreadlet = direct_spreadlet(boxed, pixels)
    else:
        offset = points - np.asarray(boxed.shape[:2]) // 2
        spreadlet = Spreadlet(offset.astype(np.int16), quantise(offset, with_moments(boxed, offset, value)))
    return spreadlet, measure_spreadlet(psf, spreadlet)


def place_points(psf: DoubleArray, density: float, rng: np.random.Generator) -> tuple[IntArray, DoubleArray]:
    """Return the points (n, 2) of a PSF on a window whose border it does not touch, and their values (n, C)."""
    # Step 1: the Laplacian, and its absolute value as importance.
    dense = np.asarray(laplacian(psf)[1:-1, 1:-1], np.float64)
    importance = np.abs(dense).max(axis=2)
    # Step 2: Poisson discs; they settle the number of points.
    n_target = density * POINTS_PER_PEAK * float(importance.sum()) / float(psf.max())
    points = throw_darts(importance, n_target, rng)
    # Step 3: relaxation. Step 4: annealing, which judges moves by the sums over the Voronoi cells.
    points = anneal(psf, dense, relax(importance, points), rng)
    return points, collapse(dense, points)


def with_moments(psf: DoubleArray, offset_rc: IntArray, value: DoubleArray) -> DoubleArray:
    """Return the values (n, C) that are nearest to some and have the moments of the PSF's Laplacian up to the second.

    Voronoi sums keep the sum alone. Their dipole leaves a field that falls with the distance only, and that adds up
    over all pixels drawn with the same points; their second moments are off by a hundredth of the energy.
    """
    matrix, target = moment_constraints(psf, offset_rc)
    change = np.linalg.lstsq(matrix, target - matrix @ value, rcond=None)[0]
    return np.asarray(value + change)
