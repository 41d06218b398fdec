"""The PSF models as types: what a database can be built for, with the options that each model has.

A value of one of these classes stands for a model's name and its options; None stands for the model's own value.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, ClassVar

from spreadlets.scene.camera import ThinLens

RANGES = ("samples", "max_coc", "max_motion")
"""Fields that say how large the database is; the others are options of the PSFs."""


@dataclass(frozen=True, kw_only=True)
class Model:
    """What all models have in common.

    Parameters
    ----------
    samples : int, optional
        Number of cells to aim at.

    Examples
    --------
    >>> sp.models.SimpleLens().options()  # nothing given: the model's own values
    {}
    """

    name: ClassVar[str]

    samples: int | None = None

    def options(self) -> dict[str, Any]:
        """Return what is given, by name."""
        given = ((each.name, getattr(self, each.name)) for each in fields(self))
        return {name: value for name, value in given if value is not None}


@dataclass(frozen=True, kw_only=True)
class _Lens(Model):
    """A lens whose PSFs grow with the circle of confusion."""

    max_coc: float | None = None


@dataclass(frozen=True, kw_only=True)
class SimpleLens(_Lens):
    """A thin lens, and no motion.

    Parameters
    ----------
    samples : int, optional
        Number of cells to aim at.
    max_coc : float, optional
        Largest radius of the circle of confusion, px.
    blades, blade_curvature, rotation, cats_eye, cats_eye_angle, cats_eye_radial, squeeze, spherical_aberration, \
obstruction
        Shape of the aperture, see `precompute.models.aperture.Aperture`.

    Examples
    --------
    >>> sp.models.SimpleLens(max_coc=64, blades=6).options()
    {'max_coc': 64, 'blades': 6}
    """

    name: ClassVar[str] = "simplelens"

    blades: int | None = None
    blade_curvature: float | None = None
    rotation: float | None = None
    cats_eye: float | None = None
    cats_eye_angle: float | None = None
    cats_eye_radial: bool | None = None
    squeeze: float | None = None
    spherical_aberration: float | None = None
    obstruction: float | None = None


@dataclass(frozen=True, kw_only=True)
class Combined(SimpleLens):
    """A thin lens and straight motion.

    Parameters
    ----------
    max_motion : float, optional
        Longest path over the shutter, px.
    shutter_curve : sequence of floats or str, optional
        How far the shutter is open over time, see `precompute.models.aperture.read_settings`.
    samples, max_coc, blades, blade_curvature, rotation, cats_eye, cats_eye_angle, squeeze, spherical_aberration, \
obstruction
        As for `SimpleLens`. ``cats_eye_radial`` is refused: a cell knows the direction of the motion only.

    Examples
    --------
    >>> sp.models.Combined(max_coc=64, max_motion=128, shutter_curve=(0, 1, 1, 0)).name
    'combined'
    """

    name: ClassVar[str] = "combined"

    max_motion: float | None = None
    shutter_curve: Sequence[float] | str | None = None


@dataclass(frozen=True, kw_only=True)
class PhysicalLens(_Lens):
    """Real glass, with its colours.

    Parameters
    ----------
    samples, max_coc
        As for `SimpleLens`; the circle of confusion is that of a thin lens.
    lens : str, optional
        A prescription: a file, or ``singlet``, ``doublet`` or ``double_gauss``.
    camera : ThinLens, optional
        Its focal length scales the prescription, its f-number sets the stop, its focus moves the sensor.
    width : int, optional
        Width of the frames to come, px.

    Examples
    --------
    >>> camera = sp.ThinLens(focal_length_mm=50, sensor_width_mm=36, f_number=2, focus_distance_m=3)
    >>> sp.models.PhysicalLens(lens="double_gauss", camera=camera, width=1024).name
    'physicallens'
    """

    name: ClassVar[str] = "physicallens"

    lens: str | None = None
    camera: ThinLens | None = None
    width: int | None = None


@dataclass(frozen=True, kw_only=True)
class Volume(Model):
    """A homogeneous scattering medium between the scene and the camera.

    Parameters
    ----------
    samples
        As for `SimpleLens`.
    medium_density : float, optional
        Collisions per metre.
    anisotropy : float, optional
        Mean cosine of the scattering angle, -1 to 1.
    albedo : sequence of three floats, optional
        Share of R, G and B that a collision keeps.
    max_distance : float, optional
        Farthest distance, metres.
    camera : ThinLens, optional
        Its focal length and sensor.
    width : int, optional
        Width of the frames to come, px.
    psf_radius : float, optional
        Radius of the PSFs, px.

    Examples
    --------
    >>> sp.models.Volume(medium_density=0.9, albedo=(1, 1, 0.9)).options()
    {'medium_density': 0.9, 'albedo': (1, 1, 0.9)}
    """

    name: ClassVar[str] = "volume"

    medium_density: float | None = None
    anisotropy: float | None = None
    albedo: Sequence[float] | None = None
    max_distance: float | None = None
    camera: ThinLens | None = None
    width: int | None = None
    psf_radius: float | None = None


@dataclass(frozen=True, kw_only=True)
class Stylized(_Lens):
    """Any image, as large as the circle of confusion.

    Parameters
    ----------
    samples, max_coc
        As for `SimpleLens`.
    image : str
        The PSF, a PNG file.
    colour_offset : float, optional
        Shift of red and blue, in radii of the PSF.

    Examples
    --------
    >>> sp.models.Stylized(image="heart.png", colour_offset=0.06).options()
    {'image': 'heart.png', 'colour_offset': 0.06}
    """

    name: ClassVar[str] = "stylized"

    image: str | None = None
    colour_offset: float | None = None


TYPES: dict[str, type[Model]] = {each.name: each for each in (SimpleLens, Combined, PhysicalLens, Volume, Stylized)}
"""The types by the names of their models."""


def option_names(model: str) -> list[str]:
    """Return the names of the options of a model's PSFs; none of a model that is unknown.

    Examples
    --------
    >>> sp.models.option_names("stylized")
    ['image', 'colour_offset']
    """
    return [each.name for each in fields(TYPES[model]) if each.name not in RANGES] if model in TYPES else []
