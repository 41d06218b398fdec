"""A lens of glass, traced in double precision with NumPy: apart from the product's own tracer, which it can so judge.

A ray runs towards +z, from the scene to the sensor; z = 0 is the vertex of the surface it meets next. Lengths in mm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

LINE_F_NM, LINE_D_NM, LINE_C_NM = 486.1327, 587.5618, 656.2725
"""The spectral lines to which index and Abbe number refer."""
FOCUS_NM, N_ZONES = 550.0, 33
"""The lens is focused on the axis in this light, over so many zones of the pupil of the same area."""


@dataclass(frozen=True)
class Surface:
    """A spherical surface: curvature (1 / mm), way to the next one, index and Abbe number behind it, rim."""

    curvature: float
    thickness: float
    glass: tuple[float, float] | None
    semi_diameter: float
    is_stop: bool

    @property
    def cauchy(self) -> tuple[float, float]:
        """A and B of the index A + B / wavelength² behind the surface; wavelengths in nm."""
        if self.glass is None:
            return 1.0, 0.0
        index, abbe = self.glass
        slope = (index - 1) / abbe / (LINE_F_NM**-2 - LINE_C_NM**-2)
        return index - slope * LINE_D_NM**-2, slope

    def index(self, wavelength_nm: np.ndarray | float) -> np.ndarray | float:
        """Return the index of refraction behind the surface."""
        constant, slope = self.cauchy
        return constant + slope / wavelength_nm**2


def read_surfaces(path: Path) -> list[Surface]:
    """Read a prescription: radius, thickness, glass and semi-diameter of each surface, one a line."""
    surfaces = []
    for line in path.read_text().splitlines():
        words = line.split("#")[0].split()
        if not words or words[0] in ("title", "radius"):
            continue
        is_stop = words[0] == "stop"
        index, _, abbe = words[2].partition("/")
        glass = None if words[2] == "air" else (float(index), float(abbe))
        curvature = 0.0 if is_stop else 1 / float(words[0])
        surfaces.append(Surface(curvature, float(words[1]), glass, float(words[3]), is_stop))
    return surfaces


def paraxial(
    surfaces: Sequence[Surface], height: float, slope: float, wavelength_nm: float = LINE_D_NM
) -> tuple[float, float]:
    """Return height and slope behind a system of a ray close to its axis; it starts and ends in air or in glass."""
    before = 1.0
    for number, surface in enumerate(surfaces):
        after = surface.index(wavelength_nm)
        slope = (before * slope - height * surface.curvature * (after - before)) / after
        before = after
        if number + 1 < len(surfaces):
            height += surface.thickness * slope
    return height, slope


def reversed_system(surfaces: Sequence[Surface]) -> list[Surface]:
    """Return a system that stands in air on its first side as light from its last side meets it."""
    order = list(surfaces)[::-1]
    ways = [each.thickness for each in order[1:]] + [0.0]
    glasses = [each.glass for each in order[1:]] + [None]
    return [
        replace(each, curvature=-each.curvature, thickness=way, glass=glass)
        for each, way, glass in zip(order, ways, glasses, strict=True)
    ]


def image_of_the_stop(behind: Sequence[Surface], way: float, radius: float) -> tuple[float, float]:
    """Return how far before the last surface the stop's image lies, seen through what is behind it, and its radius.

    Parameters
    ----------
    behind : sequence of Surface
        From the stop on; the stop stands in air.
    way : float
        From the stop to the first of them.
    radius : float
        Of the stop.
    """
    height, slope = paraxial(behind, way, 1.0)
    # From a point of the rim the same slope: the magnification is that of heights in the image.
    distance = height / slope
    rim_height, rim_slope = paraxial(behind, radius + way, 1.0)
    return distance, rim_height - rim_slope * distance


def trace(
    surfaces: Sequence[Surface], positions: np.ndarray, directions: np.ndarray, wavelength_nm: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Trace rays.

    Parameters
    ----------
    surfaces : sequence of Surface
    positions, directions : ndarray, shape (n, 3)
        z from the first vertex; directions of unit length.
    wavelength_nm : float

    Returns
    -------
    positions, directions : ndarray, shape (n, 3)
        Behind the last surface, z from its vertex.
    passed : ndarray of bool, shape (n,)
        Whether they met every surface within its rim.
    """
    at, way, passed, before = positions, directions, np.ones(len(positions), bool), 1.0
    for number, surface in enumerate(surfaces):
        at = at - way * (at[:, 2:] / way[:, 2:])
        after, curvature = surface.index(wavelength_nm), surface.curvature
        if curvature:
            at, way, met = refract(at, way, curvature, before / after)
            passed &= met
        before = after
        passed &= np.hypot(at[:, 0], at[:, 1]) <= surface.semi_diameter
        if number + 1 < len(surfaces):
            at = at - np.array([0, 0, surface.thickness])
    return at, way, passed


def refract(
    at: np.ndarray, way: np.ndarray, curvature: float, ratio: np.ndarray | float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Take rays from the plane through the vertex of a sphere to the sphere and through it.

    Parameters
    ----------
    at, way : ndarray, shape (n, 3)
        Places with z = 0, and unit directions with either sign of z.
    curvature : float
    ratio : float or ndarray, shape (n,)
        Index before over that behind.
    """
    # The nearer root of curvature / 2 * |p|^2 = z along the ray, in the form that bears small curvatures.
    sign = np.sign(way[:, 2])
    linear = curvature * (at[:, :2] * way[:, :2]).sum(axis=1) - way[:, 2]
    constant = curvature * (at[:, :2] ** 2).sum(axis=1)
    root = linear**2 - curvature * constant
    met, cosine = root >= 0, np.sqrt(np.maximum(root, 0))
    at = at + way * (constant / (sign * cosine - linear))[:, None]
    # The normal along the ray.
    normal = sign[:, None] * (np.array([0.0, 0.0, 1.0]) - curvature * at)
    inside = 1 - ratio**2 * (1 - cosine**2)
    met &= inside >= 0
    bent = np.sqrt(np.maximum(inside, 0)) - ratio * cosine
    return at, np.reshape(ratio, (-1, 1)) * way + bent[:, None] * normal, met


@dataclass(frozen=True)
class Lens:
    """A lens of glass, scaled, stopped down and focused.

    Parameters
    ----------
    surfaces : tuple of Surface
    entrance_mm : float
        How far the entrance pupil lies behind the first surface.
    entrance_radius_mm : float
    exit_mm : float
        How far the exit pupil lies behind the last surface; negative: inside the lens.
    exit_radius_mm : float
    sensor_mm : float
        From the last surface to the sensor.
    image_scale_mm : float
        Height on the sensor for a unit slope from the entrance pupil: the focal length of a pinhole of the same view.
    """

    surfaces: tuple[Surface, ...]
    entrance_mm: float
    entrance_radius_mm: float
    exit_mm: float
    exit_radius_mm: float
    sensor_mm: float
    image_scale_mm: float

    @property
    def vertices_mm(self) -> np.ndarray:
        """Places of the surfaces along the axis, from the first."""
        return np.concatenate([[0.0], np.cumsum([each.thickness for each in self.surfaces[:-1]])])

    @classmethod
    def focused(cls, path: Path, focal_length_mm: float, f_number: float, focus_m: float) -> Lens:
        """Return a prescription's lens, scaled to a focal length, stopped to an f-number, and focused."""
        surfaces = read_surfaces(path)
        scale = -focal_length_mm * paraxial(surfaces, 1.0, 0.0)[1]
        surfaces = [
            replace(
                each,
                curvature=each.curvature / scale,
                thickness=each.thickness * scale,
                semi_diameter=each.semi_diameter * scale,
            )
            for each in surfaces
        ]
        stop = [each.is_stop for each in surfaces].index(True)
        radius = focal_length_mm / f_number / 2
        _, widest = _entrance(surfaces, stop)
        closed = surfaces[stop].semi_diameter * min(1.0, radius / widest)
        surfaces[stop] = replace(surfaces[stop], semi_diameter=closed)
        entrance, _ = _entrance(surfaces, stop)
        before_last, exit_radius = image_of_the_stop(surfaces[stop + 1 :], surfaces[stop].thickness, closed)
        sensor = _best_focus(surfaces, entrance, radius, 1000 * focus_m)
        height, slope = paraxial(surfaces, -entrance, 1.0, FOCUS_NM)
        image_scale = height + sensor * slope
        return cls(tuple(surfaces), entrance, radius, -before_last, exit_radius, sensor, image_scale)

    def to_sensor(
        self, pupil: np.ndarray, slope: np.ndarray, wavelength_nm: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Trace rays from the entrance pupil to the sensor.

        Parameters
        ----------
        pupil : ndarray, shape (n, 2)
            Places on the entrance pupil, mm.
        slope : ndarray, shape (n, 2)
            Of the rays there.
        wavelength_nm : float

        Returns
        -------
        places : ndarray, shape (n, 2)
            On the sensor, mm.
        through : ndarray, shape (n, 2)
            Places on the exit pupil, in its radii.
        passed : ndarray of bool, shape (n,)
        """
        count = len(pupil)
        way = np.concatenate([slope, np.ones((count, 1))], axis=1)
        way /= np.linalg.norm(way, axis=1)[:, None]
        at = np.concatenate([pupil, np.full((count, 1), self.entrance_mm)], axis=1)
        at, way, passed = trace(self.surfaces, at - way * (at[:, 2:] / way[:, 2:]), way, wavelength_nm)

        def cut(z: float) -> np.ndarray:
            return at[:, :2] + way[:, :2] * ((z - at[:, 2]) / way[:, 2])[:, None]

        return cut(self.sensor_mm), cut(self.exit_mm) / self.exit_radius_mm, passed

    def from_sensor(
        self, places: np.ndarray, through: np.ndarray, wavelength_nm: np.ndarray | float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Trace rays from the sensor into the scene; the opposite of `to_sensor`, and what the renderer's camera does.

        Returns
        -------
        origins, directions : ndarray, shape (n, 3)
            From the middle of the entrance pupil, metres; as the image shows it: x to the right, y up, z away.
        passed : ndarray of bool, shape (n,)
        """
        count, vertices = len(places), self.vertices_mm
        at = np.concatenate([places, np.full((count, 1), vertices[-1] + self.sensor_mm)], axis=1)
        pupil = np.concatenate(
            [through * self.exit_radius_mm, np.full((count, 1), vertices[-1] + self.exit_mm)], axis=1
        )
        way = pupil - at
        way /= np.linalg.norm(way, axis=1)[:, None]
        passed, behind = np.ones(count, bool), np.ones(count)
        for number in range(len(self.surfaces) - 1, -1, -1):
            surface, vertex = self.surfaces[number], np.array([0, 0, vertices[number]])
            before = self.surfaces[number - 1].index(wavelength_nm) if number else 1.0
            at = at - vertex
            at = at - way * (at[:, 2:] / way[:, 2:])
            if surface.curvature:
                at, way, met = refract(at, way, surface.curvature, behind / before)
                passed &= met
            passed &= np.hypot(at[:, 0], at[:, 1]) <= surface.semi_diameter
            at, behind = at + vertex, np.broadcast_to(before, count)
        origin = np.array([0, 0, self.entrance_mm])
        return (origin - at) / 1000, -way, passed


def _entrance(surfaces: Sequence[Surface], stop: int) -> tuple[float, float]:
    """Return how far the entrance pupil lies behind the first surface, and its radius."""
    turned = reversed_system(surfaces[:stop])
    distance, radius = image_of_the_stop(turned, surfaces[stop - 1].thickness, surfaces[stop].semi_diameter)
    return distance, radius


def _best_focus(surfaces: Sequence[Surface], entrance: float, radius: float, distance: float) -> float:
    """Return where rays from a point of the axis are closest together, from the last surface."""
    height = radius * np.sqrt((np.arange(N_ZONES) + 0.5) / N_ZONES)
    zero = np.zeros(N_ZONES)
    way = np.stack([height / distance, zero, np.ones(N_ZONES)], axis=1)
    way /= np.linalg.norm(way, axis=1)[:, None]
    at = np.stack([height, zero, np.full(N_ZONES, entrance)], axis=1)
    at, way, passed = trace(surfaces, at - way * (at[:, 2:] / way[:, 2:]), way, FOCUS_NM)
    slope = way[:, 0] / way[:, 2]
    place = at[:, 0] - slope * at[:, 2]
    return -float((place * slope)[passed].sum() / (slope**2)[passed].sum())
