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


def lloyd(importance, points):
    """Move points to the weighted centroids of their Voronoi cells fifty times, and round."""
    pixel = np.argwhere(importance > 0)
    weight = importance[tuple(pixel.T)]
    point = np.asarray(points, dtype=float)
    for _ in range(50):
        owner = squared_distances(pixel, point).argmin(axis=1)
        for j in range(len(point)):
            if (owner == j).any():
                point[j] = np.average(pixel[owner == j], axis=0, weights=weight[owner == j])
    return np.unique(np.rint(point).astype(int), axis=0)


def anneal(psf, laplacian, points, rng, n_steps=400):
    """Steps, each moving a hundredth of the points by at most a pixel, judged by the L1 error of Voronoi sums."""
    height, width = psf.shape[:2]
    pixel = np.argwhere(np.ones((height, width)))
    half = np.array([height // 2, width // 2])

    def cost(point):
        owner = squared_distances(pixel, point).argmin(axis=1).reshape(height, width)
        value = np.stack([laplacian[owner == j].sum(axis=0) for j in range(len(point))])
        return np.abs(green_columns(point - half, (height, width)) @ value - psf).sum() / psf.sum()

    points = np.unique(points, axis=0)
    best, least, now = points, cost(points), cost(points)
    for step in range(n_steps):
        chosen = rng.choice(len(points), size=max(1, round(0.01 * len(points))), replace=False)
        moved = points.copy()
        moved[chosen] += rng.integers(-1, 2, size=(len(chosen), 2))
        moved = np.unique(np.clip(moved, 0, [height - 1, width - 1]), axis=0)
        after = cost(moved)
        if rng.random() < np.exp(-max(after - now, 0) / (2e-3 * (1 - step / n_steps) * now)):
            points, now = moved, after
        if now < least:
            best, least = points, now
    return best


def anneal_fitted(equations, neighbours, index, rng, n_steps=400):
    """Steps, each moving a hundredth of the points to a free neighbour, judged by the minimum of the form."""

    def minimum(chosen):
        chosen = np.array(chosen)
        gram, rhs, rows = equations.gram[np.ix_(chosen, chosen)], equations.rhs[chosen], equations.basis[chosen]
        system = np.block([[gram, rows], [rows.T, np.zeros((rows.shape[1],) * 2)]])
        v = np.linalg.solve(system, np.concatenate([rhs, equations.fixed]))[: len(chosen)]
        return equations.constant + (v * (gram @ v - 2 * rhs)).sum()

    index = list(index)
    best, least, now = sorted(index), minimum(index), minimum(index)
    for step in range(n_steps):
        for point in rng.choice(len(index), size=max(1, round(0.01 * len(index))), replace=False):
            free = [c for c in neighbours[index[point]] if c not in index]
            if not free:
                continue
            moved = list(index)
            moved[point] = int(rng.choice(free))
            after = minimum(moved)
            # The error is a root: half the relative rise of its square.
            if after < now or rng.random() < np.exp(-(after - now) / (2 * 1e-4 * (1 - step / n_steps) * now)):
                index, now = moved, after
        if now < least:
            best, least = sorted(index), now
    return np.array(best), least
