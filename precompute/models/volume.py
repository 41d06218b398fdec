"""The ``volume`` model: a homogeneous scattering medium between the scene and a pinhole (LKS section 5.1).

Paths start at the pinhole, which by reciprocity gives the same PSF as paths from the scene. They end where they first
reach the plane of the scene. The PSF is round, so only the distance of their ends from the axis is counted, and what
was never scattered is known in closed form: the PSF's central pixel.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from spreadlets.arrays import DoubleArray
from spreadlets.errors import InvalidParameterError, option
from spreadlets.parallel import for_blocks
from spreadlets.precompute.models._volume_kernels import walk
from spreadlets.precompute.trace.line_sample import Painter, tent
from spreadlets.psf.model import DEFAULT_MAX_DISTANCE_M, PsfModel
from spreadlets.scene.camera import ThinLens

DENSITY_PER_M = 0.9
ANISOTROPY = 0.8
ALBEDO = (1.0, 1.0, 0.9)
"""The medium of LKS section 5.1: collisions per metre, mean cosine of the scattering angle, light that is kept."""

DEFAULT_FOCAL_LENGTHS = 50.0 / 36.0
"""Focal length in widths of the image: a lens of 50 mm on a sensor of 36 mm."""

DEFAULT_WIDTH_PX = 1024

DEFAULT_RADIUS_PX = 128.0
"""Light that is scattered farther than this from its pixel is left out: far from it, haze is an even veil."""

DEFAULT_PATHS = 1 << 20

RINGS_PER_PX = 4
SUBSAMPLES = 8
"""Resolution of the radial profile, and of a pixel along each axis when it is drawn."""

FINE_RINGS = 16
RING_GROWTH = 1.08
"""Rings that are kept as they are, and by how much the merged ones beyond grow: the profile is smooth there."""

N_NODES = 1024
"""Nodes of the mean of the direct light over the pre-filter."""

N_BLOCKS = 8
"""Sets of paths that are traced independently and then summed in order: the same sum for any number of threads."""


HIDING_PATHS, HIDING_SEED = 1 << 16, 0
"""Of each of the three tracings that tell what a layer hides: to .01 of `blurred_share`."""
MOST_DISTANCES = 1 << 10
"""Tracings that are kept: a layer meets many others, and the next frame mostly has the same."""
LEAST_GAP = 0.01
"""Distance of two layers, as a share of the farther one's, below which what passes one meets the other."""


class Medium(NamedTuple):
    """A homogeneous medium.

    Attributes
    ----------
    density_per_m : float
        Mean number of collisions per metre, the inverse of the mean free path.
    anisotropy : float
        Mean cosine of the scattering angle (Henyey and Greenstein 1941), in (-1, 1).
    albedo : tuple of three floats
        Share of R, G and B that a collision scatters rather than absorbs.
    """

    density_per_m: float = DENSITY_PER_M
    anisotropy: float = ANISOTROPY
    albedo: tuple[float, ...] = ALBEDO


class Tally(NamedTuple):
    """Where the energy of paths went, for each channel, as shares of all.

    Attributes
    ----------
    rings : ndarray of shape (R, 3), float64
        Scattered light that reached the plane, by distance from the axis; the last ring takes all beyond.
    direct : float
        Light that reached the plane without a collision.
    absorbed, lost : ndarray of shape (3,), float64
        Light that a collision absorbed; light that went astray (after `MAX_COLLISIONS` of the kernel).
    """

    rings: DoubleArray
    direct: float
    absorbed: DoubleArray
    lost: DoubleArray


def read_settings(
    *,
    medium_density: float = DENSITY_PER_M,
    anisotropy: float = ANISOTROPY,
    albedo: Sequence[float] = ALBEDO,
    max_distance: float = DEFAULT_MAX_DISTANCE_M,
    camera: ThinLens | None = None,
    width: int = DEFAULT_WIDTH_PX,
    psf_radius: float = DEFAULT_RADIUS_PX,
) -> dict[str, Any]:
    """Return the settings of a medium, seen by a camera.

    Parameters
    ----------
    medium_density : float
        Collisions per metre, > 0.
    anisotropy : float
        Mean cosine of the scattering angle, in (-1, 1); positive is forward.
    albedo : sequence of three floats
        For R, G and B, each in [0, 1], not all 0.
    max_distance : float
        Farthest distance of the database, metres.
    camera : ThinLens, optional
        Its focal length and sensor; by default 50 mm and 36 mm.
    width : int
        Width of the frames to come, px.
    psf_radius : float
        Radius of the PSFs, px.

    Raises
    ------
    InvalidParameterError
        If a value is out of its range.
    """
    # Check what is to be positive, then the phase function's parameters.
    lengths = {
        "medium_density": medium_density,
        "max_distance": max_distance,
        "width": width,
        "psf_radius": psf_radius,
    }
    for name, value in lengths.items():
        if not (math.isfinite(value) and value > 0):
            raise InvalidParameterError(f"{option(name)} is {value}: it must be finite and > 0")
    if not abs(anisotropy) < 1.0:
        raise InvalidParameterError(
            f"{option('anisotropy')} is {anisotropy}: allowed are numbers between -1 and 1, not these"
        )
    if len(albedo) != 3 or not all(0.0 <= a <= 1.0 for a in albedo) or max(albedo) == 0.0:
        raise InvalidParameterError(
            f"{option('albedo')} is {tuple(albedo)}: three numbers from 0 to 1 are needed, not all 0"
        )
    # Express the view by the focal length in px.
    medium = Medium(float(medium_density), float(anisotropy), tuple(map(float, albedo)))
    widths = camera.focal_length_mm / camera.sensor_width_mm if camera else DEFAULT_FOCAL_LENGTHS
    return {
        "medium": medium._asdict(),
        "max_distance_m": float(max_distance),
        "psf_radius_px": float(psf_radius),
        "view": {"focal_length_px": float(widths * width)},
    }


def tracer(model: PsfModel, side: int) -> Painter:
    """Return what paints the PSFs of a medium; there is no focus."""
    medium = Medium(**model.settings["medium"])
    focal_length_px, radius = model.settings["view"]["focal_length_px"], model.settings["psf_radius_px"]

    def paint(box: DoubleArray, rays: int | None, seed: int) -> DoubleArray:
        tally = trace_paths(medium, (box[0, 0], box[0, 1]), focal_length_px, radius, rays or DEFAULT_PATHS, seed)
        return draw_rings(tally.rings[:-1], tally.direct)

    return Painter(paint)


def trace_paths(
    medium: Medium, distance_m: tuple[float, float], focal_length_px: float, radius: float, n_paths: int, seed: int
) -> Tally:
    """Trace paths from the pinhole to a plane, and tally where their light ends.

    Parameters
    ----------
    medium : Medium
    distance_m : tuple of two floats
        Range of the plane's distance, metres; a tent over it is the pre-filter.
    focal_length_px : float
    radius : float
        Radius of the rings, px.
    n_paths, seed : int
        Number of paths, and the seed of their random numbers.

    Notes
    -----
    Woodcock tracking (Woodcock et al. 1965) with the phase function of Henyey and Greenstein. Unscattered light is not
    left to chance: its share is the mean of ``exp(-density distance)``.
    """
    rings = np.zeros((N_BLOCKS, int(math.ceil(radius * RINGS_PER_PX)) + 1, len(medium.albedo)))
    absorbed, lost = np.zeros((2, N_BLOCKS, len(medium.albedo)))
    properties = np.array([medium.density_per_m, medium.anisotropy, *medium.albedo])
    geometry = np.array([*distance_m, focal_length_px * RINGS_PER_PX])
    if distance_m[1] > 0.0:
        for_blocks(walk, len(rings), n_paths, seed, properties, geometry, rings, absorbed, lost)
    u = (np.arange(N_NODES) + 0.5) / N_NODES
    direct = float(np.exp(-medium.density_per_m * tent(u, *distance_m)).mean())
    scattered = (1.0 - direct) / n_paths
    return Tally(
        *(scattered * rings.sum(axis=0), direct, scattered * absorbed.sum(axis=0), scattered * lost.sum(axis=0))
    )


def blurred_share(model: PsfModel, near_m: float, far_m: float) -> float:
    """Return how much of a layer's opacity is blurred, as its light is, to what lies beyond; the rest is not.

    What is not scattered before a layer meets it where it is seen. Of the layer's own light that is the spike of its
    PSF; of the light of a farther layer that ends within the radius of a PSF it is more.

    Parameters
    ----------
    model : PsfModel
    near_m, far_m : float
        Distances of the layer and of the one beyond, metres; what is farther than the database is as far as that.

    Returns
    -------
    float
        From 0 to 1.

    Notes
    -----
    Paths that reach the nearer layer without a collision start anew there, so that light of the farther one that ends
    within a radius is that of its distance from the nearer one, within as many metres.
    """
    medium, radius = Medium(**model.settings["medium"]), model.settings["psf_radius_px"]
    lit = medium._replace(albedo=tuple(medium.albedo)), model.settings["view"]["focal_length_px"]
    near, far = (min(each, model.settings["max_distance_m"]) for each in (near_m, far_m))
    gap = far - near
    if near <= 0.0 or gap < LEAST_GAP * far:
        return 1.0
    # Find the shares that are not scattered before the nearer layer: of the farther one's light, and of its own.
    straight = math.exp(-medium.density_per_m * near)
    passing = straight * _arriving(*lit, gap, radius * far / gap) / _arriving(*lit, far, radius)
    own = straight / _arriving(*lit, near, radius)
    # Blur as much of the opacity that just the first share meets it right there.
    return min(max((1.0 - passing) / (1.0 - own), 0.0), 1.0)


@functools.lru_cache(maxsize=MOST_DISTANCES)
def _arriving(medium: Medium, focal_length_px: float, distance_m: float, radius: float) -> float:
    """Return the share of paths, in the mean of all channels, that reach a plane within a radius, px."""
    tally = trace_paths(medium, (distance_m, distance_m), focal_length_px, radius, HIDING_PATHS, HIDING_SEED)
    return float(tally.direct + tally.rings[:-1].sum(axis=0).mean())


def draw_rings(rings: DoubleArray, direct: float) -> DoubleArray:
    """Draw a round PSF from the energy of its rings (R, C), and a central pixel of its own; (H, H, C)."""
    radius, density = _profile(rings)
    half = math.ceil(len(rings) / RINGS_PER_PX)
    fine = (np.arange((2 * half + 1) * SUBSAMPLES) + 0.5) / SUBSAMPLES - half - 0.5
    psf = np.zeros((2 * half + 1, 2 * half + 1, rings.shape[1]))
    for row in range(half + 1):
        distance = np.hypot(fine, fine[row * SUBSAMPLES : (row + 1) * SUBSAMPLES, None])
        for channel in range(rings.shape[1]):
            light = np.interp(distance, radius, density[:, channel], right=0.0)
            psf[row, :, channel] = light.reshape(SUBSAMPLES, 2 * half + 1, SUBSAMPLES).mean(axis=(0, 2))
    psf[half + 1 :] = psf[half - 1 :: -1]
    psf *= rings.sum(axis=0) / np.maximum(psf.sum(axis=(0, 1)), np.finfo(np.float64).tiny)
    psf[half, half] += direct
    return psf


def _profile(rings: DoubleArray) -> tuple[DoubleArray, DoubleArray]:
    """Return radii (K,), px, and the energy density (K, C) there; far out, rings are merged against their noise."""
    n_rings = len(rings)
    edges = list(range(min(FINE_RINGS, n_rings)))
    while edges[-1] < n_rings:
        edges.append(min(max(edges[-1] + 1, int(edges[-1] * RING_GROWTH)), n_rings))
    edge = np.array(edges) / RINGS_PER_PX
    density = np.add.reduceat(rings, edges[:-1]) / (np.pi * np.diff(edge**2))[:, None]
    middle = np.sqrt(0.5 * (edge[:-1] ** 2 + edge[1:] ** 2))
    return np.append(middle, edge[-1]), np.concatenate([density, density[-1:]])
