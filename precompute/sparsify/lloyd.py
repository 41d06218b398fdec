"""Weighted Lloyd relaxation of points on the pixel grid, and the Voronoi collapse of values."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from spreadlets.errors import InvalidParameterError
from spreadlets.precompute.sparsify import _sparsify_kernels as _kernels

N_ITERATIONS = 50
"""Lloyd iterations; LKS section 5.5."""


def assign(pixel_rc: npt.NDArray[np.float64], point_rc: npt.NDArray[np.float64]) -> npt.NDArray[np.int64]:
    """Find the nearest point of each pixel: the discrete Voronoi diagram.

    Parameters
    ----------
    pixel_rc : ndarray of shape (P, 2)
        Pixels, px.
    point_rc : ndarray of shape (n, 2)
        Points, px; at least one.

    Returns
    -------
    ndarray of shape (P,), int64
        Index into `point_rc` for each pixel.

    Raises
    ------
    InvalidParameterError
        If there is no point.
    """
    if len(point_rc) == 0:
        raise InvalidParameterError("a Voronoi diagram needs at least one point")
    order = np.lexsort((point_rc[:, 1], point_rc[:, 0]))
    owner = np.empty(len(pixel_rc), dtype=np.int64)
    _kernels.nearest_points(
        np.ascontiguousarray(pixel_rc, dtype=np.float64),
        np.ascontiguousarray(point_rc[order], dtype=np.float64),
        owner,
    )
    return order[owner]


def relax(
    importance: npt.NDArray[np.float64], point_rc: npt.NDArray[np.int64], n_iterations: int = N_ITERATIONS
) -> npt.NDArray[np.int64]:
    """Move points to the weighted centroids of their Voronoi cells, then round them to pixels and merge.

    Parameters
    ----------
    importance : ndarray of shape (H, W), float64
        Non-negative weights of the pixels.
    point_rc : ndarray of shape (n, 2), int64
        Points inside the image; at least one.
    n_iterations : int
        Number of iterations.

    Returns
    -------
    ndarray of shape (m, 2), int64
        Distinct points in row-major order, m at most n.

    Notes
    -----
    LKS section 5.5, third step. A point whose cell holds no weight stays where it is.
    """
    support = np.argwhere(importance > 0)
    weight = importance[support[:, 0], support[:, 1]]
    pixel = support.astype(np.float64)
    point = point_rc.astype(np.float64)
    for _ in range(n_iterations):
        owner = assign(pixel, point)
        mass = np.bincount(owner, weights=weight, minlength=len(point))
        occupied = mass > 0
        for axis in range(2):
            first = np.bincount(owner, weights=weight * pixel[:, axis], minlength=len(point))
            point[occupied, axis] = first[occupied] / mass[occupied]
    return merge(np.rint(point).astype(np.int64))


def merge(point_rc: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Keep one of each set of coincident points.

    Parameters
    ----------
    point_rc : ndarray of shape (n, 2), int64
        Points.

    Returns
    -------
    ndarray of shape (m, 2), int64
        Distinct points in row-major order.
    """
    return np.unique(point_rc, axis=0)


def collapse(laplacian: npt.NDArray[np.float64], point_rc: npt.NDArray[np.int64]) -> npt.NDArray[np.float64]:
    """Sum the Laplacian over the Voronoi cell of each point.

    Parameters
    ----------
    laplacian : ndarray of shape (H, W, C), float64
        Dense Laplacian.
    point_rc : ndarray of shape (n, 2), int64
        Points; at least one.

    Returns
    -------
    ndarray of shape (n, C), float64
        One value per point; their sum is that of the Laplacian.

    Notes
    -----
    LKS section 5.5, fourth step.
    """
    support = np.argwhere(np.any(laplacian != 0, axis=-1))
    owner = assign(support.astype(np.float64), point_rc.astype(np.float64))
    content = laplacian[support[:, 0], support[:, 1]]
    sums = [np.bincount(owner, weights=channel, minlength=len(point_rc)) for channel in content.T]
    return np.stack(sums, axis=-1)
