"""Shapes of the aperture and of the shutter for the models ``simplelens`` and ``combined``.

A ray through the point (u, v) of the unit lens lands at ``coc (u, v)``, moved by spherical aberration. The lens is
traced along parallel lines, cut where the aperture ends; the time of each line is drawn from the shutter's curve.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from spreadlets.arrays import DoubleArray
from spreadlets.errors import InvalidParameterError, option
from spreadlets.precompute.trace.line_sample import (
    RAYS_PER_PIXEL,
    Segments,
    Tracer,
    lattice_symmetric,
    lit_parts,
    moving_chords,
    point_symmetric,
    polylines,
    tent,
    unchanged,
)
from spreadlets.psf.model import PsfModel
from spreadlets.scene.shutter import read_curve

GENERATORS = (0.5 * (math.sqrt(5.0) - 1.0), math.sqrt(2.0) - 1.0, math.sqrt(3.0) - 1.0, math.sqrt(7.0) - 2.0)
"""Steps of radius, path length, direction and time from line to line: each evenly spread over neighbouring lines."""

LINE_ANGLE = 0.3
"""Direction of the lines where nothing moves, radians: parallel lines would beat with the lattice's axes."""

N_NODES = 65
"""Places along a line at which the aperture is looked at."""

N_TIMES = 4097
"""Nodes of the shutter's distribution function."""

DRAWN_FINER, DRAWN_ACROSS = 8, 320
"""Places along a pixel at which a drawn aperture is looked at, at least, and along all of it."""

LEAST_DRAWN_PX = 0.1
"""Smaller radii lie in one pixel just as well."""

STRAIGHT_RAYS_PER_PIXEL = 256
"""Deposits for each pixel of a PSF whose lines are integrated along themselves and their path: less noise is left."""

MAX_SPHERICAL = 0.45
"""Spherical aberration at which the rim is nearly a caustic; beyond, rays would overtake it."""

LEAST_OPEN = 0.002
"""Share of the lens that an aperture leaves open, at least: between two lines of less, a trace may miss it."""

MIN_SQUEEZE = 0.25
MAX_BLADES = 64


Place = tuple[DoubleArray, DoubleArray]
"""Places on the lens, (u, v)."""


@dataclass(frozen=True)
class Aperture:
    """The shape of an aperture behind focus, in units of the lens's radius, and what the lens does to it.

    Parameters
    ----------
    blades : int
        Number of straight or curved edges; 0 is a round aperture.
    blade_curvature : float
        From 0, straight edges, to 1, a circle.
    rotation : float
        Of the blades, degrees, from x to y (y down); at 0 a corner points along x.
    cats_eye : float
        Distance of a second circle of the lens's radius, which clips the first, from its centre, radii; below 2.
    cats_eye_angle : float
        Direction of that circle, degrees, from x to y (y down).
    cats_eye_radial : bool
        Whether that circle's distance grows from the picture's middle, where it is 0, to its corners, and its
        direction is that of the middle, as the front rim of a lens clips.
    squeeze : float
        Width over height of an anamorphic lens's PSF.
    spherical_aberration : float
        Above 0 (undercorrected), the rim is dark behind focus and bright in front of it.
    obstruction : float
        Radius of a central obstruction, as that of a mirror lens.
    """

    blades: int = 0
    blade_curvature: float = 0.0
    rotation: float = 0.0
    cats_eye: float = 0.0
    cats_eye_angle: float = 0.0
    cats_eye_radial: bool = False
    squeeze: float = 1.0
    spherical_aberration: float = 0.0
    obstruction: float = 0.0

    def __post_init__(self) -> None:
        # Check each parameter by itself.
        allowed = {
            "blades": (self.blades == 0 or 3 <= self.blades <= MAX_BLADES, f"0 or 3 to {MAX_BLADES}"),
            "blade_curvature": (0.0 <= self.blade_curvature <= 1.0, "0 to 1"),
            "rotation": (math.isfinite(self.rotation), "finite degrees"),
            "cats_eye": (0.0 <= self.cats_eye < 2.0, "0 to below 2 radii, where no light is left"),
            "cats_eye_angle": (math.isfinite(self.cats_eye_angle), "finite degrees"),
            "cats_eye_radial": (
                not self.cats_eye_radial or (self.cats_eye > 0.0 and not self.cats_eye_angle),
                f"True with a {option('cats_eye')} above 0 and without a {option('cats_eye_angle')}",
            ),
            "squeeze": (MIN_SQUEEZE <= self.squeeze <= 1.0, f"{MIN_SQUEEZE} to 1"),
            "spherical_aberration": (
                abs(self.spherical_aberration) <= MAX_SPHERICAL,
                f"up to {MAX_SPHERICAL} either way",
            ),
            "obstruction": (0.0 <= self.obstruction < 1.0, "0 to below 1"),
        }
        for name, (is_good, text) in allowed.items():
            if not is_good:
                raise InvalidParameterError(f"{option(name)} is {getattr(self, name)}: allowed are {text}")
        # Check that all of them together leave a part of the pupil open.
        share = _open_share(self)
        if share < LEAST_OPEN:
            raise InvalidParameterError(
                f"the aperture lets no light through, or too little: {100 * share:.2g} % of the open lens, where "
                f"{100 * LEAST_OPEN:g} % are needed: {self}"
            )

    @property
    def is_round(self) -> bool:
        """Whether every turn and mirror image of the aperture is the aperture."""
        return (not self.blades or self.blade_curvature == 1.0) and not self.cats_eye and self.squeeze == 1.0

    @property
    def is_point_symmetric(self) -> bool:
        """Whether half a turn leaves the aperture as it is."""
        return self.is_round or (not self.cats_eye and self.blades % 2 == 0)

    def clearance(self, u: DoubleArray, v: DoubleArray, eye: Place | None = None) -> DoubleArray:
        """Return a function of places on the lens that is above 0 where light passes and 0 at the aperture's edge.

        ``eye`` is where the clipping circle lies, by default as in the picture's corner at the right, if that counts.
        """
        radius = np.hypot(u, v)
        room = 1.0 - radius**2
        if self.blades:
            room = np.minimum(room, 1.0 - self._share_of_edge(u, v, radius))
        if self.cats_eye:
            at = self.eye(math.radians(self.cats_eye_angle), 1.0) if eye is None else eye
            room = np.minimum(room, 1.0 - (u - at[0]) ** 2 - (v - at[1]) ** 2)
        if self.obstruction:
            room = np.minimum(room, radius**2 - self.obstruction**2)
        return np.asarray(room)

    def eye(self, angle: float | DoubleArray, share: float | DoubleArray) -> Place:
        """Return where the clipping circle lies: in a direction, radians, at a share of its distance."""
        return np.asarray(self.cats_eye * share * np.cos(angle)), np.asarray(self.cats_eye * share * np.sin(angle))

    def _share_of_edge(self, u: DoubleArray, v: DoubleArray, radius: DoubleArray) -> DoubleArray:
        """Return how far places lie towards the blades' edge, 1 at the edge."""
        sector = 2.0 * math.pi / self.blades
        middles = math.radians(self.rotation) + sector * (np.arange(self.blades) + 0.5)
        # Of straight edges that is the largest distance along a blade's normal.
        straight = np.full(u.shape, -np.inf)
        for x, y in zip(np.cos(middles), np.sin(middles), strict=True):
            np.maximum(straight, x * u + y * v, out=straight)
        straight /= math.cos(0.5 * sector)
        if not self.blade_curvature:
            return straight
        edge = (1.0 - self.blade_curvature) * radius / np.maximum(straight, np.finfo(np.float64).tiny)
        return np.asarray(radius / (edge + self.blade_curvature))

    def image(self, u: DoubleArray, v: DoubleArray, side: int) -> tuple[DoubleArray, DoubleArray]:
        """Return where rays through places on the lens land, in units of the CoC radius."""
        stretch = side * (1.0 + side * self.spherical_aberration * (u**2 + v**2 - 1.0))
        return self.squeeze * stretch * u, stretch * v


@lru_cache(maxsize=64)
def _open_share(aperture: Aperture) -> float:
    """Return the share of the open lens that an aperture leaves open; a build asks for the same one for each PSF."""
    u, v = np.meshgrid(np.linspace(-1.0, 1.0, N_TIMES // 8), np.linspace(-1.0, 1.0, N_TIMES // 8))
    return float((aperture.clearance(u, v) > 0.0).mean()) / (math.pi / 4.0)


PARTS = {"blade_curvature": "blades", "rotation": "blades", "cats_eye_angle": "cats_eye"}
"""Parameters that mean nothing without another."""


def read_settings(shutter_curve: Sequence[float] | str | None, shape: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings of an aperture and a shutter; none for a round, even one.

    Parameters
    ----------
    shutter_curve : sequence of floats or str, optional
        How far the shutter is open, see `spreadlets.scene.shutter.read_curve`.
    shape : mapping
        Arguments of `Aperture`.

    Raises
    ------
    InvalidParameterError
        If a value is out of its range or of a part that is not there, or nothing lets light through.
    """
    aperture = Aperture(**shape)
    for name, of in PARTS.items():
        if getattr(aperture, name) and not getattr(aperture, of):
            raise InvalidParameterError(
                f"{option(name)} is {getattr(aperture, name)}: without {option(of)} it is of nothing"
            )
    curve = None if shutter_curve is None else read_curve(shutter_curve)
    if aperture == Aperture() and curve is None:
        return {}
    sign = "stored" if aperture.spherical_aberration else "ignored" if aperture.is_point_symmetric else "turned"
    arrow = curve is not None and curve != curve[::-1]
    symmetry = {"arrow": arrow, "lattice": aperture.is_round, "sign": sign}
    if aperture.cats_eye_radial:
        middle = replace(aperture, cats_eye=0.0, cats_eye_radial=False)
        symmetry = {"heading": "azimuth", "arrow": True, "lattice": middle.is_round, "sign": sign}
    return {"aperture": asdict(aperture), "shutter_curve": curve, "symmetry": symmetry}


def shutter_times(u: DoubleArray, curve: Sequence[float] | None) -> DoubleArray:
    """Map uniform numbers to times in [-1/2, 1/2], as often as the shutter is open; the middle is mid-shutter."""
    if curve is None:
        return u - 0.5
    time = np.linspace(0.0, 1.0, N_TIMES)
    openness = np.interp(time, np.linspace(0.0, 1.0, len(curve)), curve)
    share = np.concatenate([[0.0], np.cumsum(0.5 * (openness[1:] + openness[:-1]))])
    return np.asarray(np.interp(u, share / share[-1], time) - 0.5)


def tracer(model: PsfModel, side: int) -> Tracer:
    """Return what traces a model with an aperture of its own behind (1) or in front (-1) of the focus.

    Without spherical aberration, straight lines across the aperture have straight images, and an even shutter moves
    them evenly: then every line is integrated along both, as a round lens's are.
    """
    aperture = Aperture(**model.settings["aperture"])
    curve = model.settings["shutter_curve"]
    moves, radial = model.has_motion, aperture.cats_eye_radial
    straight = not aperture.spherical_aberration and not (moves and curve)

    def trace(points: DoubleArray, box: DoubleArray, angle: float, angle_half_width: float) -> Segments:
        # Sample the CoC radius, and length and direction of the path, or of the place in the picture.
        radius = tent(points[:, 1], *box[0])
        heading, path, eye = np.full(len(points), LINE_ANGLE), np.zeros(len(points)), None
        if model.has_direction:
            direction = tent(points[:, 3], angle - angle_half_width, angle + angle_half_width)
            length = tent(points[:, 2], *box[1])
            if moves:
                heading, path = direction, length
            else:
                eye = aperture.eye(direction[:, None] + math.pi, length[:, None])
        if straight:
            return _straight_chords(aperture, points[:, 0], radius * side, path, heading, eye)
        times = shutter_times(points[:, 4], curve) if moves else np.zeros(len(points))
        moved = path * times, heading
        return _curved_chords(aperture, points[:, 0], radius, side, moved, angle if moves else LINE_ANGLE, eye)

    n_dimensions = 5 if moves and not straight else 4 if moves or radial else 2
    return Tracer(
        n_dimensions,
        trace,
        lambda box: float(box[0, 1] + (0.5 * box[1, 1] if moves else 0.0)),
        _symmetriser(model),
        segments_per_point=N_NODES,
        rays_per_pixel=STRAIGHT_RAYS_PER_PIXEL if straight else RAYS_PER_PIXEL,
        generators=GENERATORS[: n_dimensions - 1],
    )


def is_drawn(model: PsfModel) -> bool:
    """Return whether `drawn_psf` makes the PSFs of a model at single coordinates."""
    return not model.has_motion and not model.settings["aperture"]["spherical_aberration"]


def drawn_psf(model: PsfModel, coordinate: Sequence[float], angle: float, side: int) -> DoubleArray:
    """Draw the PSF of a single coordinate: the aperture, anti-aliased, as wide as the circle of confusion.

    Parameters
    ----------
    model : PsfModel
        One that `is_drawn`.
    coordinate : sequence of floats
        Radius of the circle of confusion, px, and, if it counts, the place in the picture.
    angle : float
        Direction of that place, radians.
    side : int
        1 behind the focus, -1 in front of it.

    Returns
    -------
    ndarray of shape (n, n, 1), float64
        Centred; of sum 1.
    """
    aperture = Aperture(**model.settings["aperture"])
    radius, field = max(coordinate[0], LEAST_DRAWN_PX), coordinate[1:]
    half = math.ceil(radius) + 1
    # Look at places on the lens, several for each pixel along both axes.
    size = 2 * half + 1
    finer = max(DRAWN_FINER, DRAWN_ACROSS // size)
    ticks = ((np.arange(size * finer) + 0.5) / finer - half - 0.5) * side / radius
    eye = aperture.eye(angle + math.pi, field[0]) if field else None
    lit = aperture.clearance(*np.meshgrid(ticks / aperture.squeeze, ticks), eye) > 0.0
    psf = lit.reshape(size, finer, size, finer).mean(axis=(1, 3))
    return np.asarray((psf / psf.sum())[..., None])


def _straight_chords(
    aperture: Aperture,
    u: DoubleArray,
    radius: DoubleArray,
    path: DoubleArray,
    heading: DoubleArray,
    eye: Place | None = None,
) -> Segments:
    """Move the images of lines across the aperture along themselves, each integrated over line and path.

    Parameters
    ----------
    u : ndarray of shape (n,), float64
        Place of the line, in [0, 1].
    radius : ndarray of shape (n,), float64
        Of the circle of confusion, px, negative in front of the focus.
    path, heading : ndarray of shape (n,), float64
        Length, px, and direction, radians, of the path.
    eye : tuple of two ndarrays of shape (n, 1), float64, or None
        Where the clipping circle lies, see `Aperture.clearance`.
    """
    # A line whose image has the path's direction: a squeezed lens turns and shortens it.
    cos, sin = np.cos(heading) / aperture.squeeze, np.sin(heading)
    stretch = np.hypot(cos, sin)
    cos, sin = cos / stretch, sin / stretch
    # Find where light passes along it.
    across, along = 2.0 * u - 1.0, np.linspace(-1.0, 1.0, N_NODES)
    places = (along * cos[:, None] - (across * sin)[:, None], along * sin[:, None] + (across * cos)[:, None])
    line, begin, end = lit_parts(aperture.clearance(*places, eye))
    # Move the image of each lit part.
    middle, half = 0.5 * (begin + end), 0.5 * (end - begin)
    cos, sin, across, radius, stretch = (each[line] for each in (cos, sin, across, radius, stretch))
    centre = (aperture.squeeze * radius * (middle * cos - across * sin), radius * (middle * sin + across * cos))
    return moving_chords(centre, np.abs(radius) * half / stretch, 0.5 * path[line], heading[line], half)


def _curved_chords(
    aperture: Aperture,
    u: DoubleArray,
    radius: DoubleArray,
    side: int,
    moved: tuple[DoubleArray, DoubleArray],
    angle: float,
    eye: Place | None = None,
) -> Segments:
    """Place the images of lines across the aperture, node by node, each at one time: moved by a length in a direction.

    Parameters
    ----------
    u, radius
        As for `_straight_chords`, the radius without a sign.
    moved : two ndarrays of shape (n,), float64
        Length, px, and direction, radians.
    angle : float
        Direction of the lines.
    eye : tuple of two ndarrays of shape (n, 1), float64, or None
        As for `_straight_chords`.
    """
    along, across = np.linspace(-1.0, 1.0, N_NODES)[None, :], 2.0 * u[:, None] - 1.0
    places = (along * math.cos(angle) - across * math.sin(angle), along * math.sin(angle) + across * math.cos(angle))
    x, y = (radius[:, None] * part for part in aperture.image(*places, side))
    way, heading = (each[:, None] for each in moved)
    x, y = x + way * np.cos(heading), y + way * np.sin(heading)
    return polylines(x, y, np.ones((*x.shape, 1)), aperture.clearance(*places, eye))


def _symmetriser(model: PsfModel) -> Any:
    """Return the average over the symmetries that aperture and shutter leave."""
    symmetry = model.symmetry
    if symmetry.lattice and not model.has_direction:
        return lattice_symmetric
    even = Aperture(**model.settings["aperture"]).is_point_symmetric and not symmetry.arrow
    return point_symmetric if even else unchanged
