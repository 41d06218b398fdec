"""Lens prescriptions: reading the text files, refractive indices, and the paraxial quantities of a lens.

A file lists the surfaces from the scene to the sensor, one a line, under a line that names the columns. Lengths are in
mm. After ``#`` comes a comment; a line ``title ...`` names the lens.

    radius     thickness  glass       semi_diameter  conic
    58.950     7.520      1.670/47.1  25.2           0
    stop       9.000      air         17.1           -

``radius`` is positive where the centre of curvature lies behind the surface, ``inf`` for a plane, and ``stop`` for the
aperture stop, of which there is one. ``thickness`` is the way to the next surface; the last one's is replaced by
focusing. ``glass`` is what follows the surface: ``air``, index and Abbe number ``nd/Vd``, or the six Sellmeier terms
``B1,B2,B3,C1,C2,C3`` (C in square micrometres). ``conic`` is the conic constant, 0 for a sphere, ``-`` for the stop.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import DoubleArray
from spreadlets.errors import InvalidFileError, InvalidParameterError

COLUMNS = ("radius", "thickness", "glass", "semi_diameter", "conic")
MAX_SURFACES = 64
MAX_BYTES = 1 << 16

LINE_F_NM, LINE_D_NM, LINE_C_NM = 486.1327, 587.5618, 656.2725
"""The spectral lines to which index and Abbe number refer, nm."""


class Surface(NamedTuple):
    """One surface and the medium behind it, mm.

    Attributes
    ----------
    radius : float
        Radius of curvature, infinite for a plane and for the stop.
    thickness : float
        Distance to the next surface.
    glass : tuple of floats
        Empty for air, (nd, Vd), or six Sellmeier terms.
    semi_diameter : float
        Rays farther from the axis are blocked.
    conic : float
        Conic constant.
    is_stop : bool
    """

    radius: float
    thickness: float
    glass: tuple[float, ...]
    semi_diameter: float
    conic: float
    is_stop: bool


@dataclass(frozen=True)
class Prescription:
    """A lens: its surfaces from the scene to the sensor.

    Parameters
    ----------
    title : str
    surfaces : tuple of Surface
    """

    title: str
    surfaces: tuple[Surface, ...]

    @property
    def stop(self) -> int:
        """Index of the aperture stop."""
        return next(number for number, surface in enumerate(self.surfaces) if surface.is_stop)

    def indices(self, wavelength_nm: npt.ArrayLike) -> DoubleArray:
        """Return the refractive index behind each surface, shape (..., n_surfaces), at wavelengths (...), nm."""
        wavelength = np.asarray(wavelength_nm, np.float64)
        return np.stack([refractive_index(surface.glass, wavelength) for surface in self.surfaces], axis=-1)

    def scaled(self, factor: float) -> Prescription:
        """Return the lens with all lengths multiplied by a factor."""
        surfaces = (
            surface._replace(
                radius=surface.radius * factor,
                thickness=surface.thickness * factor,
                semi_diameter=surface.semi_diameter * factor,
            )
            for surface in self.surfaces
        )
        return replace(self, surfaces=tuple(surfaces))

    def stopped(self, semi_diameter: float) -> Prescription:
        """Return the lens with another semi-diameter of its stop, mm."""
        surfaces = list(self.surfaces)
        surfaces[self.stop] = surfaces[self.stop]._replace(semi_diameter=semi_diameter)
        return replace(self, surfaces=tuple(surfaces))

    def table(self) -> DoubleArray:
        """Return curvature, thickness, conic constant and semi-diameter, shape (n_surfaces, 4), for the kernels."""
        return np.array([[1.0 / s.radius, s.thickness, s.conic, s.semi_diameter] for s in self.surfaces])


class Paraxial(NamedTuple):
    """First-order quantities of a lens in air, mm.

    Attributes
    ----------
    focal_length : float
    back_focus : float
        From the last surface to the image of an infinitely distant point.
    pupil_distance : float
        From the first surface to the entrance pupil, positive behind it.
    pupil_radius : float
        Of the entrance pupil.
    """

    focal_length: float
    back_focus: float
    pupil_distance: float
    pupil_radius: float


def refractive_index(glass: Sequence[float], wavelength_nm: DoubleArray) -> DoubleArray:
    """Return the refractive index of a `Surface.glass` at wavelengths, nm.

    Notes
    -----
    Index and Abbe number stand for Cauchy's formula ``A + B / wavelength^2`` that has them.
    """
    square = (np.asarray(wavelength_nm, np.float64) / 1000.0) ** 2
    if not glass:
        return np.ones_like(square)
    if len(glass) == 2:
        slope = (glass[0] - 1.0) / glass[1] / (LINE_F_NM**-2 - LINE_C_NM**-2) * 1e-6
        return np.asarray(glass[0] + slope * (1.0 / square - (LINE_D_NM / 1000.0) ** -2))
    terms = zip(glass[:3], glass[3:], strict=True)
    return np.asarray(np.sqrt(1.0 + sum(b * square / (square - c) for b, c in terms)))


def paraxial(lens: Prescription, wavelength_nm: float = LINE_D_NM) -> Paraxial:
    """Return the first-order quantities of a lens at a wavelength.

    Raises
    ------
    InvalidParameterError
        If the lens does not focus.
    """
    table, index = lens.table(), lens.indices(wavelength_nm)
    height, slope = _paraxial_trace(table, index, 1.0, 0.0)
    if not slope < 0.0:
        raise InvalidParameterError(f"the lens {lens.title!r} does not focus: its focal length is not positive")
    # Backwards from the middle of the stop; the slopes keep their meaning, dy / dz.
    stop = lens.stop
    y, u = 0.0, 1.0
    before = np.concatenate([[1.0], index[:-1]])
    for number in range(stop - 1, -1, -1):
        y -= table[number, 1] * u
        u = (index[number] * u + y * table[number, 0] * (index[number] - before[number])) / before[number]
    distance = -y / u
    # By the Lagrange invariant, slopes are as the inverse of the magnification of the stop.
    medium = float(before[stop])
    return Paraxial(-1.0 / slope, -height / slope, distance, lens.surfaces[stop].semi_diameter * medium / u)


def image_distance(lens: Prescription, object_distance: float, wavelength_nm: float = LINE_D_NM) -> float:
    """Return the distance of the paraxial image from the last surface, mm.

    Parameters
    ----------
    lens : Prescription
    object_distance : float
        From the entrance pupil, mm; may be infinite.
    wavelength_nm : float
    """
    place = object_distance + paraxial(lens, wavelength_nm).pupil_distance
    start = (1.0, 0.0) if math.isinf(object_distance) else (place, 1.0)
    height, slope = _paraxial_trace(lens.table(), lens.indices(wavelength_nm), *start)
    if not slope < 0.0:
        raise InvalidParameterError(
            f"the lens {lens.title!r} cannot focus at {object_distance:g} mm: that is within its focal length"
        )
    return -height / slope


def chief_scale(lens: Prescription, sensor_distance: float, wavelength_nm: float = LINE_D_NM) -> float:
    """Return the paraxial image height on a sensor for a unit tangent of the field angle at the entrance pupil, mm."""
    start = -paraxial(lens, wavelength_nm).pupil_distance, 1.0
    height, slope = _paraxial_trace(lens.table(), lens.indices(wavelength_nm), *start)
    return height + sensor_distance * slope


def _paraxial_trace(table: DoubleArray, index: DoubleArray, height: float, slope: float) -> tuple[float, float]:
    """Trace a paraxial ray from the first surface to just behind the last; return its height and slope there."""
    before = 1.0
    for number, (curvature, thickness, _, _) in enumerate(table):
        slope = (before * slope - height * curvature * (index[number] - before)) / index[number]
        before = float(index[number])
        if number < len(table) - 1:
            height += thickness * slope
    return height, slope


def shipped_lenses() -> dict[str, Path]:
    """Return the files of the lenses that ship, by name."""
    folder = Path(str(resources.files("spreadlets.precompute.models") / "lenses"))
    return {path.stem: path for path in sorted(folder.glob("*.txt"))}


def read_prescription(name_or_path: str) -> Prescription:
    """Read a prescription: a file, or the name of a lens that ships.

    Raises
    ------
    InvalidFileError
        If there is no such file, or it is malformed; the message names file and line.
    """
    shipped = shipped_lenses()
    path = Path(name_or_path)
    if not path.is_file() and name_or_path in shipped:
        path = shipped[name_or_path]
    try:
        if path.exists() and not path.is_file():
            raise IsADirectoryError("not a regular file")
        with path.open("rb") as file:
            content = file.read(MAX_BYTES + 1)
        if len(content) > MAX_BYTES:
            raise InvalidFileError(f"{path}: larger than {MAX_BYTES} bytes: this is not a lens prescription")
        text = content.decode()
    except (OSError, UnicodeDecodeError) as error:
        raise InvalidFileError(
            f"no lens prescription {name_or_path!r}: give a text file, or a shipped name ({', '.join(shipped)})"
        ) from error
    return parse_prescription(text, str(path))


def parse_prescription(text: str, source: str) -> Prescription:
    """Parse a prescription; ``source`` names it in errors."""
    title, has_header, surfaces = source, False, []
    for number, line in enumerate(text.splitlines(), 1):
        words = line.split("#")[0].split()
        place = f"{source}, line {number}"
        if not words:
            continue
        if words[0] == "title":
            title = " ".join(words[1:])
        elif not has_header:
            if tuple(words) != COLUMNS:
                raise InvalidFileError(f"{place}: the columns are {' '.join(words)}; needed are {' '.join(COLUMNS)}")
            has_header = True
        else:
            surfaces.append(_parse_surface(words, place))
    return _checked(Prescription(title, tuple(surfaces)), source)


def _parse_surface(words: list[str], place: str) -> Surface:
    """Return the surface that one line describes."""
    if len(words) != len(COLUMNS):
        raise InvalidFileError(f"{place}: {len(words)} columns; needed are {len(COLUMNS)}: {' '.join(COLUMNS)}")
    is_stop = words[0] == "stop"
    radius = math.inf if is_stop else _number(words[0], "radius", place)
    thickness, semi_diameter = _number(words[1], "thickness", place), _number(words[3], "semi_diameter", place)
    conic = 0.0 if is_stop else _number(words[4], "conic", place)
    if radius == 0.0 or math.isnan(radius):
        raise InvalidFileError(f"{place}: radius is {words[0]}; it must not be 0 (a plane is inf)")
    if not (math.isfinite(thickness) and 0.0 < semi_diameter < math.inf and math.isfinite(conic)):
        raise InvalidFileError(f"{place}: thickness and conic must be finite, and semi_diameter finite and > 0")
    return Surface(radius, thickness, _parse_glass(words[2], place), semi_diameter, conic, is_stop)


def _parse_glass(word: str, place: str) -> tuple[float, ...]:
    if word == "air":
        return ()
    terms = tuple(_number(part, "glass", place) for part in word.replace("/", ",").split(","))
    n_terms = 2 if "/" in word else 6
    if len(terms) != n_terms or not all(map(math.isfinite, terms)):
        raise InvalidFileError(f"{place}: glass is {word!r}; allowed are air, nd/Vd, and B1,B2,B3,C1,C2,C3")
    if n_terms == 2 and not (1.0 <= terms[0] < 5.0 and terms[1] > 0.0):
        raise InvalidFileError(f"{place}: glass is {word!r}; the index must be 1 to 5 and the Abbe number > 0")
    if n_terms == 6 and not all(0.0 < c < 0.15 or c > 1.0 for c in terms[3:]):
        raise InvalidFileError(f"{place}: glass is {word!r}; no C may lie within the visible range, 0.15 to 1 um^2")
    return terms


def _number(word: str, column: str, place: str) -> float:
    try:
        return float(word)
    except ValueError:
        raise InvalidFileError(f"{place}: {column} is {word!r}; it must be a number") from None


def _checked(lens: Prescription, source: str) -> Prescription:
    """Return the lens, or say what is missing."""
    n_stops = sum(surface.is_stop for surface in lens.surfaces)
    if n_stops != 1:
        raise InvalidFileError(f"{source}: {n_stops} aperture stops; one line must have 'stop' as its radius")
    if not any(surface.glass for surface in lens.surfaces) or len(lens.surfaces) > MAX_SURFACES:
        raise InvalidFileError(f"{source}: a lens has 1 to {MAX_SURFACES} surfaces and some glass")
    if lens.surfaces[-1].glass:
        raise InvalidFileError(f"{source}: glass up to the sensor; the last surface must be followed by air")
    return lens
