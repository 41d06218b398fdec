"""Families of sources on which the Poisson integrators are optimised and measured.

Each family is a function of (shape, rng) that returns the Laplacian and, where it is known without a solve, the image;
both float64 of shape (H, W). Positions keep `MARGIN` of the size from the sides.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from spreadlets.psf.laplacian import laplacian, lattice_biharmonic

Plane = NDArray[np.float64]
Rng = np.random.Generator
Family = Callable[[tuple[int, int], Rng], tuple[Plane, Plane | None]]

MARGIN = 0.04
WEIGHT_SPREAD = 1.5
"""Standard deviation of the logarithm of a shape's weight: heavy-tailed, as highlights are."""
SHAPES_PER_IMAGE = 12


def of_image(image: Plane) -> tuple[Plane, Plane]:
    """Laplacian of an image whose border pixels are zero."""
    return laplacian(image)[1:-1, 1:-1], image


def add_capsule(image: Plane, rng: Rng, radius: float, length: float, softness: float) -> None:
    """Add a capsule of random position, direction and weight, its edge a tent of the given width, px."""
    reach = radius + 0.5 * length + softness + 2 + MARGIN * min(image.shape)
    row, col = (rng.uniform(min(reach, 0.5 * side), max(side - reach, 0.5 * side)) for side in image.shape)
    angle, weight = rng.uniform(0, np.pi), np.exp(rng.normal() * WEIGHT_SPREAD)
    span = int(np.ceil(reach))
    rows = slice(max(int(row) - span, 1), min(int(row) + span, image.shape[0] - 1))
    cols = slice(max(int(col) - span, 1), min(int(col) + span, image.shape[1] - 1))
    y, x = np.mgrid[rows, cols]
    direction = np.array([np.sin(angle), np.cos(angle)])
    along = np.clip((y - row) * direction[0] + (x - col) * direction[1], -0.5 * length, 0.5 * length)
    distance = np.hypot(y - row - along * direction[0], x - col - along * direction[1])
    # Mean of a step under a tent: two parabolas.
    ramp = np.clip((radius - distance) / softness, -1, 1)
    image[rows, cols] += weight * np.where(ramp < 0, 0.5 * (1 + ramp) ** 2, 1 - 0.5 * (1 - ramp) ** 2)


def _log_uniform(rng: Rng, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(max(high, low)))))


def soft_capsules(shape: tuple[int, int], rng: Rng) -> tuple[Plane, Plane | None]:
    """Capsules with edges of 1 to 4 px, as antialiasing, diffraction and motion leave them."""
    image = np.zeros(shape)
    for _ in range(SHAPES_PER_IMAGE):
        radius = _log_uniform(rng, 3, 0.12 * min(shape))
        add_capsule(image, rng, radius, rng.uniform(0, 0.2 * min(shape)), rng.uniform(1, 4))
    return of_image(image)


def hard_discs(shape: tuple[int, int], rng: Rng) -> tuple[Plane, Plane | None]:
    """Discs of one value with a pixel-sharp edge: the worst a PSF gets."""
    image = np.zeros(shape)
    for _ in range(SHAPES_PER_IMAGE):
        add_capsule(image, rng, _log_uniform(rng, 3, min(100, 0.2 * min(shape))), 0, 1e-6)
    return of_image(image)


def hard_capsules(shape: tuple[int, int], rng: Rng) -> tuple[Plane, Plane | None]:
    """Capsules with a pixel-sharp edge."""
    image = np.zeros(shape)
    for _ in range(SHAPES_PER_IMAGE):
        radius = _log_uniform(rng, 3, 0.12 * min(shape))
        add_capsule(image, rng, radius, rng.uniform(0, 0.2 * min(shape)), 1e-6)
    return of_image(image)


def dense_noise(shape: tuple[int, int], rng: Rng) -> tuple[Plane, Plane | None]:
    """Noise with detail at every scale, faded to zero at the sides."""
    rows, cols = (np.fft.fftfreq(side) for side in shape)
    amplitude = 1 / np.maximum(np.hypot(rows[:, None], cols), 1 / max(shape)) ** 1.2
    noise = np.fft.ifft2(np.fft.fft2(rng.normal(size=shape)) * amplitude).real
    fade = np.outer(*(np.sin(np.pi * np.arange(side) / (side - 1)) ** 2 for side in shape))
    return of_image((noise - noise.min()) * fade)


def sparse_discs(shape: tuple[int, int], rng: Rng) -> tuple[Plane, Plane | None]:
    """Fitted sparse approximations of discs, as a database holds them."""
    source = np.zeros(shape)
    for _ in range(SHAPES_PER_IMAGE):
        radius = _log_uniform(rng, 8, min(40, 0.15 * min(shape)))
        offsets, values = fit_sparse_disc(radius, rng)
        reach = int(radius) + 3 + int(MARGIN * min(shape))
        centre = [int(rng.integers(reach, side - reach)) for side in shape]
        weight = np.exp(rng.normal() * WEIGHT_SPREAD)
        np.add.at(source, (offsets[:, 0] + centre[0], offsets[:, 1] + centre[1]), weight * values)
    return source, None


def fit_sparse_disc(radius: float, rng: Rng, share: float = 0.6) -> tuple[NDArray[np.int64], Plane]:
    """Keep a random share of the points of a disc's Laplacian and fit their values.

    Returns
    -------
    offsets : int64 ndarray of shape (n, 2)
    values : float64 ndarray of shape (n,)
        Least-squares fit of the disc, with its moments up to the second.
    """
    side = int(radius) + 2
    image = np.zeros((2 * side + 1, 2 * side + 1))
    y, x = np.mgrid[-side : side + 1, -side : side + 1]
    image[np.hypot(y, x) < radius] = 1
    source = laplacian(image)[1:-1, 1:-1]
    points = np.argwhere(source) - side
    weights = source[tuple((points + side).T)]
    kept = points[rng.permutation(len(points))[: max(int(share * len(points)), 12)]]
    table = lattice_biharmonic(4 * side)
    gram = table[tuple(np.abs(kept[:, None] - kept).transpose(2, 0, 1))]
    target = table[tuple(np.abs(kept[:, None] - points).transpose(2, 0, 1))] @ weights

    def moments(at: NDArray[np.int64]) -> Plane:
        v, u = at.T / radius
        return np.stack([np.ones(len(at)), u, v, u * v, u * u, v * v])

    constraints, n = moments(kept), len(kept)
    system = np.block([[gram, constraints.T], [constraints, np.zeros((6, 6))]])
    solution = np.linalg.lstsq(system, np.concatenate([target, moments(points) @ weights]), rcond=1e-14)[0]
    return kept, solution[:n]


TRAINING: dict[str, Family] = {"soft capsules": soft_capsules, "hard capsules": hard_capsules}
UNSEEN: dict[str, Family] = {"hard discs": hard_discs, "sparse discs": sparse_discs, "dense image": dense_noise}
