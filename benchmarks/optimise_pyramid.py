"""Find the filters and weights of the `pyramid` integrator.

    python benchmarks/optimise_pyramid.py

The pyramid is modelled in float64 with small dense matrices, and the sum of squared relative errors over a training set
of capsules is minimised by least squares, from full weighting, cubic interpolation and Chebyshev weights. Takes under a
minute; prints the constants for `runtime/convolution_pyramid.py`, how far the shipped ones are from them, and the
errors on families that were not trained on.
"""

import argparse
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from poisson_sources import TRAINING, UNSEEN, Plane
from scipy.optimize import least_squares

from spreadlets.psf.laplacian import laplacian, solve_dirichlet
from spreadlets.runtime.integrate.convolution_pyramid import COARSER_FILTERS, FINEST_FILTERS, LevelFilters

SEED = 20111
TRAINING_SIDE, TEST_SIDE, COARSEST_SIDE = 127, 255, 15
IMAGES_PER_FAMILY = 4
STEPS = (5, 6)
"""Relaxation steps on the finest level and on the coarser ones."""
LARGEST_EIGENVALUE = 8.0
SMOOTHEST_EIGENVALUE = 0.4
"""Interval of the Chebyshev weights to start from."""
LARGEST_WEIGHT = 1.5
"""Bound of the weights, against float32 rounding: a step multiplies the roughest error by `8 * weight - 1`."""


def reflected(index: int, count: int) -> tuple[int, int]:
    """Index and sign of a pixel continued by odd reflection about the zero pixels just outside."""
    if index < 0:
        return -2 - index, -1 if index < -1 else 0
    if index >= count:
        return 2 * count - index, -1 if index > count else 0
    return index, 1


def complete_taps(outer: NDArray[np.float64]) -> Plane:
    """Centre tap and side taps from the two free ones."""
    return np.array([1 - 2 * outer[0], 0.5 - outer[1], *outer])


def down_matrix(count: int, taps: Plane) -> Plane:
    """Filter and decimate `count` pixels to `(count - 1) / 2`."""
    matrix = np.zeros(((count - 1) // 2, count))
    for coarse in range(matrix.shape[0]):
        for tap in range(-3, 4):
            fine, sign = reflected(2 * coarse + 1 + tap, count)
            if sign:
                matrix[coarse, fine] += sign * taps[abs(tap)]
    return matrix


def up_matrix(count: int, taps: Plane) -> Plane:
    """Interpolate `(count - 1) / 2` pixels to `count`."""
    matrix = np.zeros((count, (count - 1) // 2))
    for position in range(-3, matrix.shape[1] + 3):
        coarse, sign = reflected(position, matrix.shape[1])
        for tap in range(-3, 4):
            fine = 2 * position + 1 + tap
            if sign and 0 <= fine < count:
                matrix[fine, coarse] += sign * taps[abs(tap)]
    return matrix


@dataclass
class Model:
    """The pyramid in float64; `filters` holds those of the finest level and those of the others."""

    filters: tuple[LevelFilters, LevelFilters]

    def __post_init__(self) -> None:
        self.matrices: dict[tuple[int, int], tuple[Plane, Plane]] = {}

    def solve(self, source: Plane, level: int = 0) -> Plane:
        """Approximate the image of a square Laplacian of side 2^k - 1."""
        side, kind = source.shape[0], min(level, 1)
        if side <= COARSEST_SIDE:
            return solve_dirichlet(source)
        filters = self.filters[kind]
        if (side, kind) not in self.matrices:
            down, up = (complete_taps(np.array(taps)) for taps in (filters.down, filters.up))
            self.matrices[side, kind] = down_matrix(side, down), up_matrix(side, up)
        down, up = self.matrices[side, kind]
        image = up @ self.solve(down @ source @ down.T, level + 1) @ up.T
        for weight in filters.weights:
            image = image + weight * (laplacian(image)[1:-1, 1:-1] - source)
        return image

    def cycle(self, image: Plane, source: Plane) -> Plane:
        """One multigrid cycle."""
        return image + self.solve(source - laplacian(image)[1:-1, 1:-1])


def unpack(parameters: NDArray[np.float64]) -> tuple[LevelFilters, LevelFilters]:
    """Split the parameter vector; weights descend."""
    sets, start = [], 0
    for n_steps in STEPS:
        down, up = (tuple(float(p) for p in parameters[start + k : start + k + 2]) for k in (0, 2))
        weights = tuple(sorted((float(w) for w in parameters[start + 4 : start + 4 + n_steps]), reverse=True))
        sets.append(LevelFilters((down[0], down[1]), (up[0], up[1]), weights))
        start += 4 + n_steps
    return sets[0], sets[1]


def pack(sets: tuple[LevelFilters, LevelFilters]) -> NDArray[np.float64]:
    """Inverse of `unpack`."""
    return np.concatenate([[*s.down, *s.up, *s.weights] for s in sets])


def start() -> NDArray[np.float64]:
    """Full weighting, cubic interpolation and Chebyshev weights."""
    centre = 0.5 * (LARGEST_EIGENVALUE + SMOOTHEST_EIGENVALUE)
    spread = 0.5 * (LARGEST_EIGENVALUE - SMOOTHEST_EIGENVALUE)
    parts = []
    for n in STEPS:
        weights = 1 / (centre + spread * np.cos(np.pi * (np.arange(n) + 0.5) / n))
        parts.append(np.concatenate([[0, 0, 0, -1 / 16], np.minimum(weights, 0.99 * LARGEST_WEIGHT)]))
    return np.concatenate(parts)


def optimise() -> tuple[LevelFilters, LevelFilters]:
    """Fit the pyramid to the training set."""
    rng = np.random.default_rng(SEED)
    shape = (TRAINING_SIDE, TRAINING_SIDE)
    images = [family(shape, rng) for family in TRAINING.values() for _ in range(IMAGES_PER_FAMILY)]

    def errors(parameters: NDArray[np.float64]) -> Plane:
        model = Model(unpack(parameters))
        return np.concatenate([((model.solve(s) - u) / np.linalg.norm(u)).ravel() for s, u in images])

    free = start()
    bounds = np.full_like(free, np.inf)
    first = 0
    for n in STEPS:
        bounds[first + 4 : first + 4 + n] = LARGEST_WEIGHT
        first += 4 + n
    fit = least_squares(errors, free, bounds=(-np.inf, bounds), x_scale=0.05, max_nfev=200, xtol=1e-7, ftol=1e-9)
    print(f"training error {np.sqrt(2 * fit.cost / len(images)):.5f} after {fit.nfev} steps")
    return unpack(fit.x)


def main() -> None:
    """Optimise, print and test."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    found = optimise()
    for name, filters in zip(("FINEST_FILTERS", "COARSER_FILTERS"), found, strict=True):
        print(
            name, *(f"{key}={tuple(round(v, 5) for v in getattr(filters, key))}" for key in ("down", "up", "weights"))
        )
    shipped = (FINEST_FILTERS, COARSER_FILTERS)
    print(f"largest difference to the shipped constants {np.abs(pack(found) - pack(shipped)).max():.2g}")
    rng, model = np.random.default_rng(SEED + 1), Model(found)
    for name, family in {**TRAINING, **UNSEEN}.items():
        source, _ = family((TEST_SIDE, TEST_SIDE), rng)
        exact, image, cells = solve_dirichlet(source), np.zeros_like(source), []
        for _ in range(4):
            image = model.cycle(image, source)
            error = image - exact
            cells.append(
                f"{np.linalg.norm(error) / np.linalg.norm(exact):.1e} ({np.abs(error).max() / np.ptp(exact):.1e})"
            )
        print(f"{name:15s} relative L2 (worst pixel) after each pass: {', '.join(cells)}")


if __name__ == "__main__":
    main()
