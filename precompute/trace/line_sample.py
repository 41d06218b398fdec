"""What the tracers of single PSF models share: segments on the image, the tent of the pre-filter, chords of a lens."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from spreadlets.arrays import DoubleArray, IntArray
from spreadlets.precompute.trace._tracing_kernels import cut_lines, lit_runs

RAYS_PER_PIXEL = 1024
"""Default point-equivalent deposits per pixel of the smallest box along the motion that holds the PSF."""


class Segments(NamedTuple):
    """Straight segments on the image, each with an energy density that is linear along it."""

    ends: DoubleArray
    """x0, y0, x1, y1 in px from the PSF's centre, shape (n, 4). No length: a point."""
    start: DoubleArray
    """Energy density per unit of the segment's parameter in [0, 1] at (x0, y0), shape (n, C)."""
    stop: DoubleArray
    """The same at (x1, y1); a segment's energy is the mean of the two."""


def sharp(box: DoubleArray) -> float:
    """Return no blur, px, whatever the box."""
    return 0.0


@dataclass(frozen=True)
class Tracer:
    """How the rays of one PSF model are made.

    Parameters
    ----------
    n_dimensions : int
        Length of the points that ``trace`` takes. The first coordinate is the best distributed.
    trace : callable
        ``(points, box, angle, angle_half_width) -> Segments``.
    reach : callable
        ``(box) -> px``: no segment leaves the square of this half-side.
    symmetrise : callable
        ``(psf) -> psf``: average over the symmetries that the PSF has, for less noise and none in its symmetry.
    segments_per_point : int
        How many segments ``trace`` makes of a point, about.
    rays_per_pixel : int
        Default number of point-equivalent deposits for each pixel of the smallest box along the motion
        that holds the PSF.
    blur : callable
        ``(box) -> px``: standard deviation of a Gaussian that is part of the pre-filter.
    generators : tuple of floats, optional
        Steps of all coordinates but the first from point to point, modulo 1; by default those of the R_n sequence.
    """

    n_dimensions: int
    trace: Callable[[DoubleArray, DoubleArray, float, float], Segments]
    reach: Callable[[DoubleArray], float]
    symmetrise: Callable[[DoubleArray], DoubleArray]
    segments_per_point: int = 1
    rays_per_pixel: int = RAYS_PER_PIXEL
    blur: Callable[[DoubleArray], float] = sharp
    generators: tuple[float, ...] | None = None


def point_symmetric(psf: DoubleArray) -> DoubleArray:
    """Average a PSF (H, W, C) with its half turn."""
    return 0.5 * (psf + psf[::-1, ::-1])


def lattice_symmetric(psf: DoubleArray) -> DoubleArray:
    """Average a square PSF (H, H, C) over the lattice's eight symmetries."""
    mirrored = psf + psf[::-1]
    mirrored = mirrored + mirrored[:, ::-1]
    return 0.125 * (mirrored + mirrored.swapaxes(0, 1))


@dataclass(frozen=True)
class Painter:
    """How a PSF is made that is not traced by segments.

    Parameters
    ----------
    paint : callable
        ``(box, rays, seed) -> psf``, (H, W, C) with H and W odd, centred; ``rays`` is None for the model's own number.
    """

    paint: Callable[[DoubleArray, int | None, int], DoubleArray]


def unchanged(psf: DoubleArray) -> DoubleArray:
    """Return a PSF that has no symmetry as it is."""
    return psf


def polylines(x: DoubleArray, y: DoubleArray, density: DoubleArray, clearance: DoubleArray | None = None) -> Segments:
    """Join the nodes of lines by segments, cut where a clearance falls below zero.

    Parameters
    ----------
    x, y : ndarray of shape (n, K), float64
        Nodes of n lines on the image, px.
    density : ndarray of shape (n, K, C), float64
        Energy density per unit of the line's parameter, in which the nodes are equally spaced, at the nodes.
    clearance : ndarray of shape (n, K), float64, optional
        At least 0 where light passes; between the nodes it is linear.

    Returns
    -------
    Segments
        At most n (K - 1); those without light are left out.
    """
    n_lines, n_nodes, n_channels = density.shape
    n_most = n_lines * (n_nodes - 1)
    found = Segments(np.empty((n_most, 4)), np.empty((n_most, n_channels)), np.empty((n_most, n_channels)))
    lit = density.max(axis=2) if clearance is None else clearance
    count = cut_lines(np.stack([x, y], axis=-1), density, lit, *found)
    return Segments(*(part[:count] for part in found))


def lit_parts(clearance: DoubleArray) -> tuple[IntArray, DoubleArray, DoubleArray]:
    """Find the parts of lines from -1 to 1 along which light passes.

    Parameters
    ----------
    clearance : ndarray of shape (n, K), float64
        Above 0 where light passes, at K equally spaced nodes; between them it is linear.

    Returns
    -------
    line : ndarray of shape (m,), int64
        The line of each part.
    begin, end : ndarray of shape (m,), float64
    """
    n_lines, n_nodes = clearance.shape
    line = np.empty(n_lines * n_nodes, np.int64)
    ends = np.empty((2, n_lines * n_nodes))
    count = lit_runs(clearance, line, *ends)
    begin, end = 2.0 / (n_nodes - 1) * ends[:, :count] - 1.0
    return line[:count], begin, end


def tent(u: DoubleArray, low: float, high: float) -> DoubleArray:
    """Map uniform numbers to the tent over [low, high]: densest at its middle, zero at its ends.

    Parameters
    ----------
    u : ndarray of shape (n,), float64
        In [0, 1].
    low, high : float

    Returns
    -------
    ndarray of shape (n,), float64

    Notes
    -----
    The reconstruction kernel r of LKS section 5.4, by its inverse distribution function.
    """
    t = np.where(u < 0.5, np.sqrt(2.0 * u) - 1.0, 1.0 - np.sqrt(2.0 - 2.0 * u))
    return 0.5 * (low + high) + 0.5 * (high - low) * t


def lens_chords(u: DoubleArray, radius: DoubleArray, half_path: DoubleArray, angle: DoubleArray) -> Segments:
    """Trace the chords of a thin lens that are parallel to a constant motion, over the whole shutter.

    Parameters
    ----------
    u : ndarray of shape (n,), float64
        Place of the chord across the lens, in [0, 1].
    radius : ndarray of shape (n,), float64
        Radius of the circle of confusion, px.
    half_path : ndarray of shape (n,), float64
        Half the length of the motion path over the shutter, px.
    angle : ndarray of shape (n,), float64
        Direction of chord and motion, radians, y down.

    Returns
    -------
    Segments
        Three per chord: its image, a box of half-width a, convolved with the path, a box of half-width h, is a
        trapezoid that rises from -(a + h) to -abs(a - h) and falls from abs(a - h) to a + h.
    """
    # Chords are dense near the rim, where the chord's length, the integrand, is steep.
    across = np.sin(np.pi * (u - 0.5))
    chord = np.sqrt(np.maximum(1.0 - across**2, 0.0))
    # Energy: the lens area between neighbouring chords; the second factor is d across / d u.
    centre = -radius * across * np.sin(angle), radius * across * np.cos(angle)
    return moving_chords(centre, radius * chord, half_path, angle, chord * chord)


def moving_chords(
    centre: tuple[DoubleArray, DoubleArray],
    half_chord: DoubleArray,
    half_path: DoubleArray,
    angle: DoubleArray,
    energy: DoubleArray,
) -> Segments:
    """Move the straight images of chords evenly along themselves.

    Parameters
    ----------
    centre : two ndarrays of shape (n,), float64
        Middle of each chord's image at mid-shutter, x and y, px.
    half_chord, half_path : ndarray of shape (n,), float64
        Half the length of the image, and of the path, px.
    angle : ndarray of shape (n,), float64
        Direction of both, radians, y down.
    energy : ndarray of shape (n,), float64

    Returns
    -------
    Segments
        Three per chord, see `lens_chords`.
    """
    outer, inner = half_chord + half_path, np.abs(half_chord - half_path)
    longer = np.maximum(half_chord, half_path)
    ramp = 0.5 * np.divide(np.minimum(half_chord, half_path), longer, out=np.zeros_like(longer), where=longer > 0.0)
    along = np.stack([-outer, -inner, inner, outer])
    x, y = along * np.cos(angle) + centre[0], along * np.sin(angle) + centre[1]
    ends = np.stack([x[:-1], y[:-1], x[1:], y[1:]], axis=-1)
    flat = energy * (1.0 - 2.0 * ramp)
    rise, zero = 2.0 * energy * ramp, np.zeros_like(energy)
    start, stop = np.stack([zero, flat, rise]), np.stack([rise, flat, zero])
    return Segments(ends.reshape(-1, 4), start.reshape(-1, 1), stop.reshape(-1, 1))
