"""Naive twins of the fast paths and closed-form PSFs: slow, plain, and independent of the packages."""

import numpy as np

NODES_PER_PX = 16
"""Quadrature nodes per px of a capsule's path: from radius 4 px up, the relative L1 error is below 1e-5."""


def _half_disc(t, radius):
    """Area of the part of a disc about the origin with x <= t."""
    t = np.clip(t, -radius, radius)
    return t * np.sqrt(radius**2 - t**2) + radius**2 * (np.arcsin(t / radius) + np.pi / 2)


def _corner_area(x, y, radius):
    """Area of the part of a disc about the origin with X <= x and Y <= y, in closed form."""
    inside = (_half_disc(x, radius) + _half_disc(y, radius)) / 2 - np.pi * radius**2 / 4 + x * y
    both = _half_disc(x, radius) + _half_disc(y, radius) - np.pi * radius**2
    outside = np.where(x > 0, np.where(y > 0, both, _half_disc(y, radius)), _half_disc(x, radius))
    outside = np.where((x <= 0) & (y <= 0), 0.0, outside)
    return np.where(x**2 + y**2 < radius**2, inside, outside)


def disc_coverage(radius, centre=(0.0, 0.0), size=None):
    """Exact coverage of pixels by a disc, unit sum.

    ``centre`` is (x, y) px from the central pixel's centre; ``size`` is the odd side (or (H, W)) of the result.
    Pixel (row, col) covers half a px to either side of its integer coordinate.
    """
    if size is None:
        size = 2 * int(np.ceil(radius + max(np.abs(centre)) + 0.5)) + 1
    height, width = np.broadcast_to(size, 2)
    x = np.arange(width + 1) - width // 2 - 0.5 - centre[0]
    y = np.arange(height + 1) - height // 2 - 0.5 - centre[1]
    corner = _corner_area(x[None, :], y[:, None], radius)
    return np.diff(np.diff(corner, axis=0), axis=1) / (np.pi * radius**2)


def capsule_psf(radius, length, angle, size=None):
    """Disc convolved with a uniform segment of ``length`` px at ``angle`` (radians, y down), unit sum.

    Composite Gauss-Legendre average of `disc_coverage` along the segment.
    """
    if size is None:
        size = 2 * int(np.ceil(radius + length / 2 + 0.5)) + 1
    node, weight = np.polynomial.legendre.leggauss(4)
    n_parts = max(1, int(np.ceil(length * NODES_PER_PX / 4)))
    total = 0.0
    for part in range(n_parts):
        for x, w in zip(node, weight, strict=True):
            along = length * ((part + 0.5 + x / 2) / n_parts - 0.5)
            centre = (along * np.cos(angle), along * np.sin(angle))
            total = total + w / 2 / n_parts * disc_coverage(radius, centre, size)
    return total


def tent_nodes(low, high, n=64):
    """Midpoint nodes and weights of the tent over [low, high] that is zero at its ends."""
    t = (np.arange(n) + 0.5) / n * 2 - 1
    weight = 1 - np.abs(t)
    return (low + high) / 2 + t * (high - low) / 2, weight / weight.sum()


def deposit_segments(ends, start, stop, image):
    """Naive twin of the segment deposit: cut at every pixel border, look up the pixel of each piece's midpoint."""
    half_row, half_col = image.shape[0] // 2, image.shape[1] // 2
    for (x0, y0, x1, y1), first, last in zip(ends, start, stop, strict=True):
        cuts = [0.0, 1.0]
        for a, b in ((x0, x1), (y0, y1)):
            borders = np.arange(np.floor(min(a, b)) - 0.5, max(a, b) + 1.0)
            if a != b:
                cuts.extend(t for t in (borders - a) / (b - a) if 0 < t < 1)
        cuts.sort()
        for t0, t1 in zip(cuts[:-1], cuts[1:], strict=True):
            t = (t0 + t1) / 2
            row = int(np.floor(y0 + t * (y1 - y0) + 0.5)) + half_row
            col = int(np.floor(x0 + t * (x1 - x0) + 0.5)) + half_col
            image[row, col] += (t1 - t0) * ((1 - t) * first + t * last)
    return image


def trace_points(coc, motion, angle, size, n_rays, rng):
    """Naive tracer of the combined model: random points of the lens and of the shutter, one deposit each."""
    image = np.zeros((size, size))
    for area, turn, time in rng.random((n_rays, 3)):
        radius, phi, along = np.sqrt(area), 2 * np.pi * turn, (time - 0.5) * motion
        col = int(np.floor(coc * radius * np.cos(phi) + along * np.cos(angle) + 0.5)) + size // 2
        row = int(np.floor(coc * radius * np.sin(phi) + along * np.sin(angle) + 0.5)) + size // 2
        image[row, col] += 1 / n_rays
    return image
