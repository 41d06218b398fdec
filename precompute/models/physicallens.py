"""The ``physicallens`` model: sequential ray tracing through real glass (LKS section 5.1).

A point of the scene sends rays to the entrance pupil. There they are traced along straight lines; neighbouring rays of
a line are joined by segments on the sensor, cut where a rim blocks the line, so that a few thousand lines draw a PSF
without noise. Each line has a wavelength of its own; its colour is what the CIE 1931 observer sees.

Coordinates on the sensor are turned as on the image, where a point of the scene lies on the side where it is seen. A
PSF is centred where a pinhole in the entrance pupil would image the point: distortion moves the PSF off that place.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from spreadlets.arrays import DoubleArray, IntArray
from spreadlets.errors import InvalidParameterError
from spreadlets.parallel import for_bands
from spreadlets.precompute.models import prescription
from spreadlets.precompute.models._lens_kernels import BLOCKED, MISSED, PASSED, REFLECTED, trace_lines
from spreadlets.precompute.models.colour import LONGEST_NM, SHORTEST_NM, rgb_response
from spreadlets.precompute.models.prescription import Prescription
from spreadlets.precompute.trace.line_sample import Segments, Tracer, polylines, tent
from spreadlets.psf.model import PsfModel
from spreadlets.scene.camera import MM_PER_M, ThinLens

N_DIMENSIONS = 5
"""Place of the line across the pupil, wavelength, distance from focus, eccentricity, azimuth."""

GENERATORS = (0.5 * (math.sqrt(5.0) - 1.0), math.sqrt(2.0) - 1.0, math.sqrt(3.0) - 1.0, math.sqrt(7.0) - 2.0)
"""Steps of all coordinates but the first. Lines that cross a pixel are neighbours in the sequence, and need many
wavelengths: those of R_n are jointly even, but one of them is nearly 6/7. This lowers the error to a third."""

RAYS_PER_PIXEL = 2048
"""Point-equivalent deposits: two in place of one, as colours share them."""

LINE_ANGLE = 0.3
"""Direction of all lines, radians: far from the lattice's axes and diagonals, to which parallel lines would beat."""

BLUR = 0.3
"""Standard deviation of the pre-filter's blur, in units of the half-width of the cell's CoC. The tent over the cell
itself blurs a rim by 0.41 of it, but smooth light within the rim hardly, where noise remains: parallel lines beat."""

N_NODES = 33
"""Rays along a line: aberrations are smooth, so that straight segments between them err by less than 1/1000."""

PILOT_SIDE = 33
PILOT_RADIUS = 2.0
"""Rays along each side of the square in which the lit part of the pupil is looked for; its half-side in paraxial radii.
Off the axis, real pupils are shifted and larger than the paraxial one."""

N_HEIGHTS = 33
"""Image heights at which the illumination of the sensor is known: it falls smoothly, even where rims begin to cut."""

N_AREA_LINES = 129
"""Lines across the pupil, and rays along each, by which its lit area is measured: to 1/1000, as rims cut lines."""

FOCUS_NM = 550.0
"""Wavelength at which the sensor is focused."""

EXTENT_MARGIN_PX = 1.0
"""Added to the reach of the pilot's rays: the lines' own may reach a little farther."""

DEFAULT_CAMERA = {"focal_length_mm": 50.0, "sensor_width_mm": 36.0, "focus_distance_m": 3.0}
DEFAULT_WIDTH_PX = 1024
DEFAULT_LENS = "double_gauss"
OPENING_MARGIN = 1e-3
"""By how much, relatively, a camera may ask for a wider aperture than the lens has: f-numbers are rounded."""

EVENT_NAMES = {BLOCKED: "its rim blocks them", MISSED: "they miss it", REFLECTED: "it reflects them totally"}


class FocusedLens(NamedTuple):
    """A lens, scaled, stopped down and focused, before a sensor.

    Attributes
    ----------
    lens : Prescription
        Lengths in mm.
    pupil_distance, pupil_radius : float
        Entrance pupil: behind the first surface; its paraxial radius, mm.
    sensor_distance : float
        From the last surface, mm.
    chief_scale : float
        Image height, mm, of a unit tangent of the field angle.
    focus_per_m : float
        Inverse distance in focus, 1 / m.
    coc_scale : float
        Radius of the circle of confusion for a unit of ``1/zf - 1/z``, px m.
    mm_per_px : float
        Size of a pixel.
    """

    lens: Prescription
    pupil_distance: float
    pupil_radius: float
    sensor_distance: float
    chief_scale: float
    focus_per_m: float
    coc_scale: float
    mm_per_px: float


class Bundle(NamedTuple):
    """Rays along lines, traced to the sensor.

    Attributes
    ----------
    x, y : ndarray of shape (n, K), float64
        On the sensor from where a pinhole would image the point, px; x away from the image's centre.
    clearance : ndarray of shape (n, K), float64
        Below 0 where a ray is blocked.
    events : ndarray of shape (n_surfaces, 4), int64
        What each surface did to how many rays.
    """

    x: DoubleArray
    y: DoubleArray
    clearance: DoubleArray
    events: IntArray


def read_settings(
    *, lens: str = DEFAULT_LENS, camera: ThinLens | None = None, width: int = DEFAULT_WIDTH_PX
) -> dict[str, Any]:
    """Return the settings of a lens before a camera's sensor.

    Parameters
    ----------
    lens : str
        A prescription: a file, or the name of a lens that ships.
    camera : ThinLens, optional
        Its focal length scales the prescription, its f-number sets the stop, its focus moves the sensor; by default
        50 mm at full opening on 36 mm, focused at 3 m.
    width : int
        Width of the frames to come, px.

    Raises
    ------
    InvalidFileError
        If the prescription cannot be read.
    InvalidParameterError
        If the lens cannot be as wide open, or focus as near, as the camera asks for, or blocks all light in a corner.
    """
    if width < 1:
        raise InvalidParameterError(f"width is {width}: frames have at least 1 px")
    # Read the prescription; its pupil tells how wide it opens.
    found = prescription.read_prescription(lens)
    first_order = prescription.paraxial(found)
    widest = first_order.focal_length / (2.0 * first_order.pupil_radius)
    # Take focal length, f-number, focus and sensor from the camera.
    view: dict[str, float] = dict(DEFAULT_CAMERA, f_number=widest)
    if camera is not None:
        view = {name: getattr(camera, name) for name in view}
    if view["f_number"] < widest * (1.0 - OPENING_MARGIN):
        raise InvalidParameterError(
            f"the camera's f-number is {view['f_number']:g}; the lens {found.title!r} opens to {widest:.3g}, no wider"
        )
    focus_per_m = 1.0 / view.pop("focus_distance_m")
    # Record surfaces and view.
    settings = {
        "lens": {"title": found.title, "surfaces": [_as_json(surface) for surface in found.surfaces]},
        "view": {name: float(value) for name, value in view.items()} | {"focus_per_m": focus_per_m, "width_px": width},
    }
    # Measure aberrations and illumination, out to the corner of a square sensor.
    corner = 0.5 * math.sqrt(2.0) * view["sensor_width_mm"]
    return settings | {
        "max_eccentricity_mm": corner,
        "aberration_px": _aberration(settings, corner),
        "illumination": _illumination(settings, corner),
    }


def _as_json(surface: prescription.Surface) -> list[Any]:
    radius = None if math.isinf(surface.radius) else surface.radius
    return [radius, surface.thickness, list(surface.glass), surface.semi_diameter, surface.conic, surface.is_stop]


def _aberration(settings: Mapping[str, Any], corner_mm: float) -> float:
    """Return how far light lands from its place in the corner where the lens is in focus, px."""
    box = np.array([[0.0, 0.0], [corner_mm, corner_mm]])
    return lit_pupil(focused_lens(settings), box, 1)[2]


def _illumination(settings: Mapping[str, Any], corner_mm: float) -> list[float]:
    """Return the illumination of the sensor relative to its middle, at evenly spaced heights up to the corner's.

    The lit part of the entrance pupil shrinks where rims cut it; the rest is the law of the fourth power of the cosine
    of the field angle. Points are in focus: their distance hardly matters.
    """
    focused = focused_lens(settings)
    height = np.linspace(0.0, corner_mm, N_HEIGHTS)
    cosine = np.cos(np.arctan(height / focused.chief_scale))
    area = np.array([_lit_area(focused, float(each)) for each in height])
    return [float(share) for share in area / area[0] * cosine**4]


def _lit_area(focused: FocusedLens, height_mm: float) -> float:
    """Return the lit area of the entrance pupil seen from a point in focus at an image height, relative to a square."""
    ticks = np.linspace(-PILOT_RADIUS, PILOT_RADIUS, N_AREA_LINES) * focused.pupil_radius
    place = np.stack(np.meshgrid(ticks, ticks), axis=-1)
    same = np.ones(N_AREA_LINES)
    bundle = trace_bundle(focused, place, same * FOCUS_NM, same * focused.focus_per_m, same * height_mm)
    lines = polylines(place[..., 0], place[..., 1], np.ones((*place.shape[:2], 1)), bundle.clearance)
    return float(np.hypot(*(lines.ends[:, 2:] - lines.ends[:, :2]).T).sum())


def focused_lens(settings: Mapping[str, Any]) -> FocusedLens:
    """Scale, stop down and focus the lens of some settings."""
    # Scale the prescription to the camera's focal length.
    rows = settings["lens"]["surfaces"]
    surfaces = tuple(
        prescription.Surface(math.inf if r is None else r, t, tuple(glass), s, k, stop)
        for r, t, glass, s, k, stop in rows
    )
    camera = settings["view"]
    lens = Prescription(settings["lens"]["title"], surfaces)
    lens = lens.scaled(camera["focal_length_mm"] / prescription.paraxial(lens).focal_length)
    # Stop it down to the camera's f-number.
    first_order = prescription.paraxial(lens)
    radius = 0.5 * camera["focal_length_mm"] / camera["f_number"]
    opening = lens.surfaces[lens.stop].semi_diameter * radius / first_order.pupil_radius
    lens = lens.stopped(min(opening, lens.surfaces[lens.stop].semi_diameter))
    # Move the sensor to the best focus.
    focus = camera["focus_per_m"]
    sensor_distance = _best_focus(lens, focus / MM_PER_M)
    mm_per_px = camera["sensor_width_mm"] / camera["width_px"]
    return FocusedLens(
        lens=lens,
        pupil_distance=first_order.pupil_distance,
        pupil_radius=radius,
        sensor_distance=sensor_distance,
        chief_scale=prescription.chief_scale(lens, sensor_distance, FOCUS_NM),
        focus_per_m=focus,
        coc_scale=radius / MM_PER_M * camera["focal_length_mm"] / mm_per_px,
        mm_per_px=mm_per_px,
    )


def _best_focus(lens: Prescription, inverse_distance: float) -> float:
    """Return the distance of the sensor at which the spot of a point on the axis has the least mean square radius, mm.

    Spherical aberration moves it off the paraxial focus, where a wide lens would not look sharp.
    """
    start = prescription.image_distance(lens, 1.0 / inverse_distance if inverse_distance else math.inf, FOCUS_NM)
    first_order = prescription.paraxial(lens)
    height = first_order.pupil_radius * np.sqrt((np.arange(N_NODES) + 0.5) / N_NODES)
    place = np.stack([height, np.zeros(N_NODES)], axis=-1)[None]
    index = lens.indices(np.array([FOCUS_NM]))
    found = []
    for distance in (start, start + 1.0):
        out, events = _trace(lens, first_order.pupil_distance, distance, place, place * inverse_distance, index)
        found.append(out[0])
    passed = found[0][:, 2] >= 0.0
    if not passed.any():
        raise InvalidParameterError(_explain_darkness(lens, events, "on its axis"))
    here, slope = found[0][passed, 0], found[1][passed, 0] - found[0][passed, 0]
    return float(start - (here * slope).sum() / (slope * slope).sum())


def _trace(
    lens: Prescription,
    pupil_distance: float,
    sensor_distance: float,
    place: DoubleArray,
    slope: DoubleArray,
    index: DoubleArray,
) -> tuple[DoubleArray, IntArray]:
    """Trace rays (n, K, 2); return x, y and clearance (n, K, 3), and the surfaces' events (n_surfaces, 4)."""
    out = np.empty((*place.shape[:2], 3))
    events = np.zeros((len(place), len(lens.surfaces), 4), np.int64)
    slopes = np.ascontiguousarray(np.broadcast_to(slope, place.shape))
    for_bands(
        trace_lines,
        len(place),
        np.ascontiguousarray(place),
        slopes,
        index,
        lens.table(),
        (float(pupil_distance), float(sensor_distance)),
        out,
        events,
    )
    return out, events.sum(axis=0)


def trace_bundle(
    focused: FocusedLens, place: DoubleArray, wavelength_nm: DoubleArray, inverse_m: DoubleArray, height_mm: DoubleArray
) -> Bundle:
    """Trace lines of rays from points of the scene to the sensor.

    Parameters
    ----------
    focused : FocusedLens
    place : ndarray of shape (n, K, 2), float64
        Where the rays cross the entrance pupil, mm.
    wavelength_nm, inverse_m, height_mm : ndarray of shape (n,), float64
        For each line its wavelength; the inverse distance of the point (1 / m, not above 0 beyond infinity); and the
        image height at which a pinhole would see it.
    """
    field = np.stack([height_mm / focused.chief_scale, np.zeros_like(height_mm)], axis=-1)
    slope = field[:, None, :] + place * (inverse_m / MM_PER_M)[:, None, None]
    index = focused.lens.indices(wavelength_nm)
    out, events = _trace(focused.lens, focused.pupil_distance, focused.sensor_distance, place, slope, index)
    x = (out[..., 0] - height_mm[:, None]) / focused.mm_per_px
    return Bundle(x, out[..., 1] / focused.mm_per_px, out[..., 2], events)


def tracer(model: PsfModel, side: int) -> Tracer:
    """Return what traces a lens behind (1) or in front (-1) of its focus."""
    focused = focused_lens(model.settings)

    @lru_cache(maxsize=1)
    def lit(box: tuple[tuple[float, float], ...]) -> tuple[DoubleArray, DoubleArray, float]:
        return lit_pupil(focused, np.array(box), side)

    def trace(points: DoubleArray, box: DoubleArray, angle: float, angle_half_width: float) -> Segments:
        # Place nodes along lines across the lit part of the pupil.
        low, high, extent = lit(_hashable(box))
        across = low[1] + (high[1] - low[1]) * points[:, :1]
        along = np.linspace(low[0], high[0], N_NODES)[None, :]
        place = turned(np.broadcast_to(along, (len(points), N_NODES)), across, LINE_ANGLE)
        # Sample wavelength, distance and image height, and trace the bundles.
        wavelength = SHORTEST_NM + (LONGEST_NM - SHORTEST_NM) * points[:, 1]
        inverse = inverse_distance(focused, tent(points[:, 2], *box[0]), side)
        bundle = trace_bundle(focused, place, wavelength, inverse, tent(points[:, 3], *box[1]))
        clearance = np.where(np.hypot(bundle.x, bundle.y) < extent, bundle.clearance, -1.0)
        # Colour the light by the response to its wavelength.
        density = np.broadcast_to(rgb_response(wavelength)[:, None, :], (*clearance.shape, 3))
        # Turn it by the sampled direction, and add its mirror image.
        spread = tent(points[:, 4], -angle_half_width, angle_half_width)[:, None]
        place_on_image = turned(bundle.x, bundle.y, angle + spread)
        half = polylines(place_on_image[..., 0], place_on_image[..., 1], density, clearance)
        return Segments(*map(np.concatenate, zip(half, _mirror_image(half, angle), strict=True)))

    return Tracer(
        N_DIMENSIONS,
        trace,
        lambda box: lit(_hashable(box))[2],
        without_negative_light,
        segments_per_point=2 * N_NODES,
        rays_per_pixel=RAYS_PER_PIXEL,
        blur=lambda box: 0.5 * BLUR * float(box[0, 1] - box[0, 0]),
        generators=GENERATORS,
    )


def _mirror_image(segments: Segments, angle: float) -> Segments:
    """Return the mirror image of segments about the meridional plane, which appears in a direction."""
    cos, sin = math.cos(2.0 * angle), math.sin(2.0 * angle)
    ends = segments.ends.reshape(-1, 2) @ np.array([[cos, sin], [sin, -cos]])
    return segments._replace(ends=ends.reshape(-1, 4))


def turned(x: DoubleArray, y: DoubleArray, angle: DoubleArray | float) -> DoubleArray:
    """Turn places by an angle; return them as (..., 2)."""
    return np.stack([x * np.cos(angle) - y * np.sin(angle), x * np.sin(angle) + y * np.cos(angle)], axis=-1)


def _hashable(box: DoubleArray) -> tuple[tuple[float, float], ...]:
    return tuple((float(low), float(high)) for low, high in box)


def inverse_distance(focused: FocusedLens, coc: DoubleArray, side: int) -> DoubleArray:
    """Return the inverse distance, 1 / m, at which a thin lens has a circle of confusion of radius ``coc``, px."""
    return np.asarray(focused.focus_per_m - side * coc / focused.coc_scale)


def without_negative_light(psf: DoubleArray) -> DoubleArray:
    """Bring colours outside the gamut to its border, and keep each channel's energy."""
    energy = psf.sum(axis=(0, 1))
    inside = np.maximum(psf, 0.0)
    return np.asarray(inside * (np.maximum(energy, 0.0) / np.maximum(inside.sum(axis=(0, 1)), 1e-300)))


def lit_pupil(focused: FocusedLens, box: DoubleArray, side: int) -> tuple[DoubleArray, DoubleArray, float]:
    """Find the lit part of the pupil and how far its light reaches, over the corners of a cell and the spectrum.

    Returns
    -------
    low, high : ndarray of shape (2,), float64
        Ranges, along and across the lines, of the places on the entrance pupil that are lit, mm.
    extent : float
        Largest distance of the light from its place, px.

    Raises
    ------
    InvalidParameterError
        If no light gets through; the message names the surface that stops most of it.
    """
    # Lay a grid over the entrance pupil.
    half = PILOT_RADIUS * focused.pupil_radius
    ticks = np.linspace(-half, half, PILOT_SIDE)
    along, across = np.meshgrid(ticks, ticks)
    # Trace it from each corner of the cell, at three wavelengths.
    coc, height, wavelength = (
        values.ravel() for values in np.meshgrid(box[0], box[1], (SHORTEST_NM, FOCUS_NM, LONGEST_NM), indexing="ij")
    )
    flat = turned(along, across, LINE_ANGLE).reshape(1, -1, 2)
    place = np.repeat(flat, len(coc), axis=0)
    bundle = trace_bundle(focused, place, wavelength, inverse_distance(focused, coc, side), height)
    lit = bundle.clearance >= 0.0
    if not lit.any():
        where = f"at an image height of {box[1, 0]:.3g} to {box[1, 1]:.3g} mm"
        raise InvalidParameterError(_explain_darkness(focused.lens, bundle.events, where))
    # Bound what is lit from any of them, a step of the grid wider.
    some = lit.any(axis=0)
    step = ticks[1] - ticks[0]
    ranges = [(values.ravel()[some].min() - step, values.ravel()[some].max() + step) for values in (along, across)]
    extent = float(np.hypot(bundle.x, bundle.y)[lit].max())
    low, high = np.array(ranges).T
    return low, high, extent * 1.02 + EXTENT_MARGIN_PX


def _explain_darkness(lens: Prescription, events: IntArray, place: str) -> str:
    """Say which surface stops the light, and how."""
    stopped = events.copy()
    stopped[:, PASSED] = 0
    surface, event = np.unravel_index(int(stopped.argmax()), stopped.shape)
    what = "the stop" if lens.surfaces[int(surface)].is_stop else f"surface {int(surface) + 1}"
    return (
        f"the lens {lens.title!r} lets no light through {place}: {stopped[surface, event]} of {int(events.sum())} rays "
        f"end at {what} ({EVENT_NAMES[int(event)]})"
    )
