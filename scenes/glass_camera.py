"""The camera of `glass_camera.osl`: its constants for a lens, and putting it into Cycles."""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from glass import Lens
from shot import SENSOR_MM

SOURCE = Path(__file__).with_suffix(".osl")
PUPIL = 1.06
"""Radius of the part of the exit pupil that is sampled: off the axis the pupil is larger than its paraxial disc."""
N_STRATA = 16
"""Strata of wavelengths."""
PROBE_NM = (420.0, 460.0, 500.0, 550.0, 600.0, 650.0, 690.0)
N_PROBES = 257
"""Points across the pupil with which its light is summed."""
MARGIN = 1.05
"""By how much the part of the pupil that a lamp shines through is taken too large."""
WIDEST_PART = 0.8
"""Lamps that shine through more of the pupil are found by even points."""

LOBES = np.array(
    [
        (1.056, 599.8, 37.9, 31.0),
        (0.362, 442.0, 16.0, 26.7),
        (-0.065, 501.1, 20.4, 26.2),
        (0.821, 568.8, 46.9, 40.5),
        (0.286, 530.9, 16.3, 31.1),
        (1.217, 437.0, 11.8, 36.0),
        (0.681, 459.0, 26.0, 13.8),
    ]
)
"""Height, peak, width below and above it (nm) of the lobes of CIE x, y and z (Wyman, Sloan and Shirley 2013)."""
LOBE_OF = (0, 0, 0, 1, 1, 2, 2)
"""Which of x, y and z each is a part of."""
SRGB_OF_XYZ = np.array(
    [[3.2404542, -1.5371385, -0.4985314], [-0.9692660, 1.8760108, 0.0415560], [0.0556434, -0.2040259, 1.0572252]]
)


def matching(nm: np.ndarray) -> np.ndarray:
    """Return CIE x, y and z at wavelengths, (3, n)."""
    found = np.zeros((3, len(nm)))
    for which, (height, peak, below, above) in zip(LOBE_OF, LOBES, strict=True):
        found[which] += height * np.exp(-0.5 * ((nm - peak) / np.where(nm < peak, below, above)) ** 2)
    return found


def colour_matrix() -> np.ndarray:
    """Return the matrix from CIE x, y and z to linear sRGB in which the mean from 400 to 700 nm is white."""
    white = matching(400 + 300 * (np.arange(1201) + 0.5) / 1201).mean(axis=1)
    return SRGB_OF_XYZ / (SRGB_OF_XYZ @ white)[:, None]


def disc(count: int) -> np.ndarray:
    """Return points of a lattice in the unit disc, (n, 2)."""
    axis = (np.arange(count) + 0.5) / count * 2 - 1
    points = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    return points[np.hypot(*points.T) < 1]


def part_of_pupil(lens: Lens, place: Sequence[float], radius: float, *, focus_m: float | None) -> tuple[float, ...]:
    """Return where on the pupil a lamp shines through, for a place of the sensor.

    Parameters
    ----------
    lens : Lens
    place : sequence of float
        Of the lamp's middle, metres from the entrance pupil: right, up, away.
    radius : float
        Of the lamp, metres.
    focus_m : float or None
        Of a thin lens in place of the glass.

    Returns
    -------
    x, y, scale, radius : float
        The middle is at ``(X - x, Y - y) * scale`` for a place (X, Y) of the sensor, mm; in radii of the pupil.
    """
    x, y, z = place
    slope, vergence = np.array([x / z, y / z]), 1 / (1000 * z)
    on_sensor = radius / z * lens.image_scale_mm * MARGIN
    if focus_m is not None:
        spread = -lens.entrance_radius_mm * lens.image_scale_mm * (1 / (1000 * focus_m) - vergence)
        return (*(slope * lens.image_scale_mm), 1 / spread, on_sensor / abs(spread) + 0.02)
    # The place on the sensor is nearly linear in that on the pupil; what is not is added to the radius.
    pupil = disc(15) * PUPIL * lens.entrance_radius_mm
    places, through = [], []
    for wavelength in PROBE_NM:
        place_mm, each, passed = lens.to_sensor(pupil, slope + pupil * vergence, wavelength)
        places.append(place_mm[passed])
        through.append(each[passed])
    places, through = np.concatenate(places), np.concatenate(through)
    spread = ((through - through.mean(0)) * (places - places.mean(0))).sum() / ((through - through.mean(0)) ** 2).sum()
    middle = (places - spread * through).mean(axis=0)
    left = np.quantile(np.hypot(*(places - middle - spread * through).T), 0.98)
    return (*middle, 1 / spread, (on_sensor + left) / abs(spread) + 0.01)


def gain(lens: Lens) -> float:
    """Return what makes the middle of an even scene as bright as the scene."""
    points = PUPIL * disc(N_PROBES)
    light = 0.0
    for wavelength in (450.0, 550.0, 650.0):
        passed = lens.from_sensor(np.zeros_like(points), points, wavelength)[2]
        away = (points**2).sum(axis=1) * (lens.exit_radius_mm / (lens.sensor_mm - lens.exit_mm)) ** 2
        light += (passed / (1 + away) ** 2).mean() / 3
    return 1 / light


def source(lens: Lens, aspect: float, parts: Sequence[tuple[float, ...]], *, focus_m: float | None) -> str:
    """Return the camera's source for a lens.

    Parameters
    ----------
    lens : Lens
    aspect : float
        Height over width of the image.
    parts : sequence of tuple
        Of each lamp, see `part_of_pupil`.
    focus_m : float or None
        Of a thin lens in place of the glass.
    """
    surfaces, vertices = lens.surfaces, lens.vertices_mm
    # The medium before each surface: what a ray from the sensor enters.
    cauchy = [(1.0, 0.0)] + [each.cauchy for each in surfaces[:-1]]
    numbers = {
        "SENSOR_WIDTH": SENSOR_MM,
        "SENSOR_HEIGHT": SENSOR_MM * aspect,
        "PUPIL": PUPIL if focus_m is None else 1.0,
        "ENTRANCE_RADIUS": lens.entrance_radius_mm,
        "ENTRANCE_Z": lens.entrance_mm,
        "IMAGE_SCALE": lens.image_scale_mm,
        "EXIT_RADIUS": lens.exit_radius_mm,
        "EXIT_Z": vertices[-1] + lens.exit_mm,
        "SENSOR_Z": vertices[-1] + lens.sensor_mm,
        "GAIN": gain(lens),
        "FOCUS_M": focus_m or 0.0,
    }
    tables = {
        "COLOUR_MATRIX": colour_matrix().ravel(),
        **dict(zip(("LOBE_HEIGHT", "LOBE_PEAK", "LOBE_BELOW", "LOBE_ABOVE"), LOBES.T, strict=True)),
        "LOBE_OF": LOBE_OF,
        "VERTEX": vertices,
        "CURVATURE": [each.curvature for each in surfaces],
        "RIM": [each.semi_diameter for each in surfaces],
        "CAUCHY_A": [a for a, _ in cauchy],
        "CAUCHY_B": [b for _, b in cauchy],
        **dict(zip(("LAMP_X", "LAMP_Y", "LAMP_SCALE", "LAMP_RADIUS"), zip(*parts, strict=True), strict=True)),
    }
    defined = {name: f"{value:.9g}" for name, value in numbers.items()}
    defined |= {name: _table(values) for name, values in tables.items()}
    defined |= {"N_STRATA": str(N_STRATA), "N_LAMPS": str(len(parts)), "N_SURFACES": str(len(surfaces))}
    defined["N_LOBES"] = str(len(LOBES))
    if focus_m is not None:
        defined["THIN"] = "1"
    head = "".join(f"#define {name} {value}\n" for name, value in defined.items())
    return head + SOURCE.read_text()


def _table(values: Iterable[float]) -> str:
    """Return numbers as the language writes an array."""
    return "{" + ", ".join(f"{value:.9g}" for value in values) + "}"


def attach(camera, text: str) -> None:
    """Compile a source and give it to a camera, which then is of Cycles' custom kind."""
    import _cycles
    import bpy

    with tempfile.TemporaryDirectory() as folder:
        written, compiled = Path(folder) / "camera.osl", Path(folder) / "camera.oso"
        written.write_text(text)
        if not _cycles.osl_compile(str(written), str(compiled)):
            raise RuntimeError("the camera's source does not compile")
        code = compiled.read_text()
    camera.type, camera.custom_mode = "CUSTOM", "INTERNAL"
    camera.custom_bytecode, camera.custom_bytecode_hash = code, hashlib.md5(code.encode()).hexdigest()
    camera.update_tag()
    bpy.context.scene.cycles.shading_system = True


def detach(camera) -> None:
    """Make a camera a usual one again."""
    import bpy

    camera.type = "PERSP"
    bpy.context.scene.cycles.shading_system = False
