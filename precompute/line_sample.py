"""What the tracers of single PSF models share: segments on the image, the tent of the pre-filter, chords of a lens."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


class Segments(NamedTuple):
    """Straight segments on the image, each with an energy density that is linear along it."""

    ends: FloatArray
    """x0, y0, x1, y1 in px from the PSF's centre, shape (n, 4). No length: a point."""
    start: FloatArray
    """Energy density per unit of the segment's parameter in [0, 1] at (x0, y0), shape (n, C)."""
    stop: FloatArray
    """The same at (x1, y1); a segment's energy is the mean of the two."""


def tent(u: FloatArray, low: float, high: float) -> FloatArray:
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


def lens_chords(u: FloatArray, radius: FloatArray, half_path: FloatArray, angle: FloatArray) -> Segments:
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
    energy = chord * chord
    half_chord = radius * chord
    outer, inner = half_chord + half_path, np.abs(half_chord - half_path)
    longer = np.maximum(half_chord, half_path)
    ramp = 0.5 * np.divide(np.minimum(half_chord, half_path), longer, out=np.zeros_like(longer), where=longer > 0.0)
    along = np.stack([-outer, -inner, inner, outer])
    x = along * np.cos(angle) - radius * across * np.sin(angle)
    y = along * np.sin(angle) + radius * across * np.cos(angle)
    ends = np.stack([x[:-1], y[:-1], x[1:], y[1:]], axis=-1)
    flat = energy * (1.0 - 2.0 * ramp)
    rise, zero = 2.0 * energy * ramp, np.zeros_like(energy)
    start, stop = np.stack([zero, flat, rise]), np.stack([rise, flat, zero])
    return Segments(ends.reshape(-1, 4), start.reshape(-1, 1), stop.reshape(-1, 1))
