"""Writes optical_reference.txt: what an independent library, optiland, makes of the lenses that ship.

    pip install optiland lazy_loader && PYTHONPATH=. python tests/optical_reference.py

For each lens, field and wavelength: paraxial focal length, height of the chief ray, and the root mean square radius of
the spot of `PUPIL_RAYS`, all in mm, for an infinitely distant point and a sensor at the paraxial focus of the d line.
Glasses with Sellmeier terms are looked up by name in optiland's own catalogue; the others have no name, and get the
index of Cauchy's formula, worked out here.
"""

from pathlib import Path

import numpy as np

REFERENCE = Path(__file__).with_suffix(".txt")
LENSES = {"singlet": 10.0, "doublet": 10.0, "double_gauss": 18.0}
"""Largest field angle, degrees."""

FIELDS = (0.0, 0.25, 0.5, 0.75, 1.0)
LINES_NM = (486.1327, 587.5618, 656.2725)
NAMES = {1.03961212: "N-BK7", 1.52481889: "N-SF5"}
"""Names in the catalogue of Schott, by their first Sellmeier term."""

RINGS, SPOKES, WIDEST = (0.25, 0.5, 0.75, 1.0), 12, 0.6


def pupil_rays(pupil_radius):
    """Return places on the entrance pupil, (n, 2) mm: four rings of twelve, and the chief ray, which comes first."""
    angle = 2 * np.pi * np.arange(SPOKES) / SPOKES + 0.1
    rings = [WIDEST * pupil_radius * ring * np.stack([np.cos(angle), np.sin(angle)], axis=-1) for ring in RINGS]
    return np.concatenate([[[0.0, 0.0]], *rings])


def spot_radius(x, y):
    """Return the root mean square distance from the centroid."""
    return float(np.sqrt(np.mean((x - x.mean()) ** 2 + (y - y.mean()) ** 2)))


def _index(glass, wavelength_nm):
    from optiland.materials import Material

    if not glass:
        return 1.0
    if len(glass) == 6:
        return float(np.squeeze(Material(NAMES[glass[0]], catalog="schott").n(wavelength_nm / 1000.0)))
    nd, abbe = glass
    rise = (nd - 1) / abbe / (LINES_NM[0] ** -2 - LINES_NM[2] ** -2)
    return nd + rise * (wavelength_nm**-2 - LINES_NM[1] ** -2)


def _optic(lens, wavelength_nm, sensor):
    from optiland.materials import IdealMaterial
    from optiland.optic import Optic

    optic = Optic()
    optic.surfaces.add(index=0, thickness=np.inf)
    for number, surface in enumerate(lens.surfaces):
        optic.surfaces.add(
            index=number + 1,
            radius=surface.radius,
            conic=surface.conic,
            thickness=sensor if number == len(lens.surfaces) - 1 else surface.thickness,
            material=IdealMaterial(_index(surface.glass, wavelength_nm)),
            is_stop=surface.is_stop,
        )
    optic.surfaces.add(index=len(lens.surfaces) + 1)
    optic.set_aperture(aperture_type="float_by_stop_size", value=2 * lens.surfaces[lens.stop].semi_diameter)
    optic.fields.set_type("angle")
    optic.fields.add(y=0)
    optic.wavelengths.add(value=wavelength_nm / 1000.0, is_primary=True)
    return optic


def _rows(name, largest_field):
    from optiland.rays import RealRays

    from spreadlets.precompute.models.prescription import read_prescription

    lens = read_prescription(name)
    at_d = _optic(lens, LINES_NM[1], 0.0)
    pupil, pupil_radius = float(np.squeeze(at_d.paraxial.EPL())), float(np.squeeze(at_d.paraxial.EPD())) / 2
    sensor = float(np.squeeze(at_d.paraxial.F2()))
    place = pupil_rays(pupil_radius)
    for wavelength in LINES_NM:
        optic = _optic(lens, wavelength, sensor)
        focal_length = float(np.squeeze(optic.paraxial.f2()))
        for field in FIELDS:
            slope = np.tan(np.radians(field * largest_field))
            direction = np.array([slope, 0.0, 1.0]) / np.hypot(slope, 1.0)
            # Start well before the first surface.
            start = -50.0
            x, y = place[:, 0] + (start - pupil) * slope, place[:, 1]
            ones = np.ones(len(place))
            rays = RealRays(x, y, start * ones, *(d * ones for d in direction), ones, wavelength / 1000.0 * ones)
            optic.surfaces.trace(rays, skip=1)
            spot = spot_radius(np.asarray(rays.x), np.asarray(rays.y))
            yield (
                name,
                field * largest_field,
                wavelength,
                pupil,
                pupil_radius,
                sensor,
                focal_length,
                float(rays.x[0]),
                spot,
            )


def main():
    lines = ["# lens field_deg wavelength_nm pupil_mm pupil_radius_mm sensor_mm focal_length_mm chief_mm spot_mm"]
    for name, largest_field in LENSES.items():
        for lens, *numbers in _rows(name, largest_field):
            lines.append(" ".join([lens, *(f"{number:.15g}" for number in numbers)]))
    REFERENCE.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
