"""Naive twins of the sparsification's fast paths: slow, plain, and one formula at a time."""

import numpy as np
from scipy.ndimage import correlate1d

from spreadlets.psf.laplacian import lattice_green


def throw_darts(cumulative, radius, uniform, max_failures):
    """Place drawn pixels unless an earlier one lies within the pixel's own radius."""
    placed, n_failures = [], 0
    for u in uniform:
        if n_failures >= max_failures:
            break
        row, col = divmod(int(np.searchsorted(cumulative, u, side="right")), radius.shape[1])
        if all((r - row) ** 2 + (c - col) ** 2 > radius[row, col] ** 2 for r, c in placed):
            placed.append((row, col))
        else:
            n_failures += 1
    return np.array(placed), n_failures


def squared_distances(pixel_rc, point_rc):
    """All squared distances of pixels (P, 2) to points (n, 2)."""
    return ((np.asarray(pixel_rc)[:, None, :] - np.asarray(point_rc)[None, :, :]) ** 2).sum(axis=2)


def green_columns(offset_rc, shape):
    """The Green's function of each point over a centred window, (H, W, n)."""
    table = lattice_green(int(sum(shape) + np.abs(offset_rc).max()))
    row = np.arange(shape[0]) - shape[0] // 2
    col = np.arange(shape[1]) - shape[1] // 2
    return np.stack([table[np.abs(row - r)[:, None], np.abs(col - c)[None, :]] for r, c in offset_rc], axis=-1)


def moment_rows(offset_rc):
    """The monomials 1, r, c, r c, r^2, c^2 at the points, (6, n)."""
    r, c = np.asarray(offset_rc, dtype=float).T
    return np.stack([np.ones_like(r), r, c, r * c, r * r, c * c])


def constrained_least_squares(matrix, target, constraint, value):
    """Minimise ``|A v - t|^2`` subject to ``C v = d``, by eliminating the constraints with a dense null space."""
    left, singular, right = np.linalg.svd(constraint)
    rank = int((singular > 1e-10 * singular.max()).sum())
    particular = right[:rank].T @ ((left.T @ value)[:rank] / singular[:rank])
    free = right[rank:].T
    step = np.linalg.lstsq(matrix @ free, target - matrix @ particular, rcond=None)[0]
    return particular + free @ step


def dissimilarity_form(psf, error):
    """1 - SSIM to second order in the error, written out from its definition; psf (H, W) has peak 1."""
    offset = np.arange(-5, 6)
    taps = np.exp(-0.5 * (offset / 1.5) ** 2)
    taps /= taps.sum()

    def blur(image):
        return correlate1d(correlate1d(image, taps, axis=0, mode="constant"), taps, axis=1, mode="constant")

    mean, error_mean = blur(psf), blur(error)
    variance = blur(psf**2) - mean**2
    error_variance = blur(error**2) - error_mean**2
    loss = error_mean**2 / (2 * mean**2 + 1e-4) + error_variance / (2 * variance + 9e-4)
    return loss[5:-5, 5:-5].mean()


def eliminate_one(gram, rhs, constraint, value):
    """Return the rise of the form's minimum for leaving out each point in turn, by fitting the others again."""

    def minimum(index):
        sub, side, rows = gram[np.ix_(index, index)], rhs[index], constraint[:, index]
        n, k = len(index), len(constraint)
        system = np.block([[sub, rows.T], [rows, np.zeros((k, k))]])
        v = np.linalg.solve(system, np.concatenate([side, value]))[:n]
        return v @ sub @ v - 2 * side @ v

    everything = np.arange(len(rhs))
    whole = minimum(everything)
    return np.array([minimum(np.delete(everything, j)) - whole for j in everything])
