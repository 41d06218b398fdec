"""How the coordinates of every PSF model follow from a pixel's labels: one entry for each axis and each direction."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import FloatArray
from spreadlets.errors import InvalidParameterError
from spreadlets.psf.model import Heading, PsfModel
from spreadlets.runtime.label.trail import Trail
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.raster import Raster

BLOCKS = (1, 2, 4)
"""Sides, px, of blocks of pixels for which a lens may be the same: those that the level of detail can draw as one."""
LEAST_BLOCKS = 64
"""How many of them there are across the image at least; else they are smaller."""


NO_SHIFT = np.zeros((0, 0, 2), np.int32)
"""The shift of pixels that are drawn where they are."""


EVERYWHERE = np.zeros((0, 0, 2), np.int32)
"""The places of all pixels of a frame."""


class Places(NamedTuple):
    """Where the pixels of a list lie: row and column (h, w, 2), int32, in a frame of (H, W) pixels."""

    at: npt.NDArray[np.int32]
    frame_shape: tuple[int, int]


class View(NamedTuple):
    """What the place of a pixel in the image stands for.

    Attributes
    ----------
    depth : ndarray of shape (H, W), float32
        Planar depth, metres.
    focal_length_px : float
        Focal length in pixels: a pixel at this distance from the image's centre is seen at 45 degrees.
    sensor_mm_per_px : float
        Size of a pixel on the sensor.
    half_diagonal_px : float
        From the picture's centre to its corners.
    centre : tuple of float
        From the frame's middle to the picture's centre, (x, y), px: the frame may reach beyond what is displayed.
    places : Places or None
        Where the pixels of a list lie; None if they are all those of the frame.
    """

    depth: FloatArray
    focal_length_px: float
    sensor_mm_per_px: float
    half_diagonal_px: float = 1.0
    centre: tuple[float, float] = (0.0, 0.0)
    places: Places | None = None

    @property
    def frame_shape(self) -> tuple[int, int]:
        """Height and width of the frame, px."""
        return (self.depth.shape[0], self.depth.shape[1]) if self.places is None else self.places.frame_shape

    @property
    def corner(self) -> tuple[int, int]:
        """Row and column of the frame's first pixel, counted from the pixel at the picture's centre."""
        row, column = (
            -math.floor(0.5 * (size - 1) + away) for size, away in zip(self.frame_shape, self.centre[::-1], strict=True)
        )
        return row, column

    def position(self) -> FloatArray:
        """Return the place (x, y) of each pixel from the image's centre, px, shape (H, W, 2)."""
        return self._from_centre(1)

    def block_position(self) -> FloatArray:
        """Return the place (x, y), from the image's centre, of the middle of the block that each pixel is in, px.

        A lens changes from one side of the image to the other. Neighbours that share their PSF are drawn as one.
        """
        return self._from_centre(
            max(size for size in BLOCKS if size * LEAST_BLOCKS <= max(self.frame_shape) or size == 1)
        )

    def image_height(self) -> FloatArray:
        """Return the distance of each pixel from the image's centre, px, shape (H, W)."""
        place = self.position()
        return np.hypot(place[..., 0], place[..., 1])

    def _from_centre(self, block: int) -> FloatArray:
        """Return the places (x, y) of the middles of the blocks of pixels, from the image's centre, px."""
        y, x = (
            (np.arange(size) // block * block + 0.5 * (block - 1) - 0.5 * (size - 1) - off).astype(np.float32)
            for size, off in zip(self.frame_shape, self.centre[::-1], strict=True)
        )
        rows, columns = np.ogrid[: len(y), : len(x)] if self.places is None else np.moveaxis(self.places.at, 2, 0)
        place = np.empty((*np.broadcast(rows, columns).shape, 2), np.float32)
        place[..., 0], place[..., 1] = x[columns], y[rows]
        return place


def camera_view(depth: FloatArray, raster: Raster, camera: ThinLens) -> View:
    """Return how the camera sees pixels, whose display window's width is the sensor's."""
    mm_per_px = camera.sensor_width_mm / raster.display.width
    half_diagonal = 0.5 * math.hypot(*raster.display.shape)
    return View(depth, camera.focal_length_mm / mm_per_px, mm_per_px, half_diagonal, raster.off_middle)


class Labels(NamedTuple):
    """What the PSF of each pixel depends on.

    Attributes
    ----------
    coc : ndarray of shape (H, W), float32
        Signed radius of the circle of confusion, px.
    path : ndarray of shape (H, W, 2), float32
        Motion (dx, dy) over the shutter, px.
    length : ndarray of shape (H, W), float32
        Length of the path, px.
    shift : ndarray of shape (H, W, 2), float32, or None
        From the pixel to its position at mid-shutter, (dx, dy); None if the shutter is centred or nothing moves.
    view : View
        The pixels' places in space.
    sweep : ndarray of shape (H, W, 2), float32, or None
        Of steps of the shutter's time, the motion over all of it, px; None if `path` is that.
    trail : Trail or None
        Of what is drawn at several places, these; they are counted from ``shift``.
    """

    coc: FloatArray
    path: FloatArray
    length: FloatArray
    shift: FloatArray | None
    view: View
    sweep: FloatArray | None = None
    trail: Trail | None = None

    @property
    def whole_path(self) -> FloatArray:
        """Motion (dx, dy) over the shutter, (H, W, 2), px, also of what is drawn in steps."""
        return self.path if self.sweep is None else self.sweep


def _radius(labels: Labels) -> FloatArray:
    return labels.coc


def _path_length(labels: Labels) -> FloatArray:
    return labels.length


def _distance(labels: Labels) -> FloatArray:
    """Distance along the ray: planar depth, lengthened towards the image's borders."""
    slope = labels.view.image_height() / np.float32(labels.view.focal_length_px)
    return np.asarray(labels.view.depth * np.hypot(np.float32(1.0), slope), np.float32)


def _sensor_height(labels: Labels) -> FloatArray:
    place = labels.view.block_position()
    return np.hypot(place[..., 0], place[..., 1]) * np.float32(labels.view.sensor_mm_per_px)


def _field(labels: Labels) -> FloatArray:
    place = labels.view.block_position()
    return np.asarray(np.hypot(place[..., 0], place[..., 1]) / np.float32(labels.view.half_diagonal_px), np.float32)


COORDINATES: dict[str, Callable[[Labels], FloatArray]] = {
    "coc": _radius,
    "motion": _path_length,
    "depth": _radius,
    "distance": _distance,
    "eccentricity": _sensor_height,
    "field": _field,
}
"""The coordinate (H, W) on each axis, by its name, in the axis's unit; its sign has no meaning."""

HEADINGS: dict[Heading, Callable[[Labels], FloatArray]] = {
    "motion": lambda labels: labels.path,
    "azimuth": lambda labels: labels.view.block_position(),
}
"""The vector (dx, dy) that gives a pixel's direction, shape (H, W, 2)."""

EFFECTS: dict[str, tuple[Callable[[Labels], FloatArray], tuple[str, ...]]] = {
    "coc": (_radius, ("coc", "depth")),
    "motion": (_path_length, ("motion",)),
}
"""What a frame may ask for: its extent in px, and the axes of which one must be there to do it."""


EXTENT_SHARES = {"coc": 1.0, "depth": 1.0, "motion": 0.5}
"""How much of a coordinate adds to the extent of the PSF."""


def coordinates(labels: Labels, model: PsfModel) -> tuple[FloatArray, ...]:
    """Return the coordinates (H, W) of each pixel on the axes of a model's parameter space; signs have no meaning."""
    return tuple(COORDINATES[axis.name](labels) for axis in model.axes)


def illumination(model: PsfModel, raster: Raster, sensor_width_mm: float) -> FloatArray:
    """Return how bright a lens leaves each pixel, relative to the image's middle.

    Parameters
    ----------
    model : PsfModel
    raster : Raster
        Where the image's pixels lie.
    sensor_width_mm : float
        Width of the sensor, which is that of the display window.

    Returns
    -------
    ndarray of shape (H, W), float32

    Raises
    ------
    InvalidParameterError
        If the model is not that of a real lens.
    """
    shares = model.settings.get("illumination")
    if shares is None:
        raise InvalidParameterError(
            f"the database of the model {model.name!r} knows no vignetting; build one of 'physicallens'"
        )
    mm_per_px = sensor_width_mm / raster.display.width
    view = View(np.zeros(raster.data.shape, np.float32), 1.0, mm_per_px, centre=raster.off_middle)
    known = np.linspace(0.0, model.settings["max_eccentricity_mm"], len(shares))
    return np.asarray(np.interp(view.image_height() * mm_per_px, known, shares), np.float32)


def ignored_effects(labels: Labels, model: PsfModel) -> list[tuple[str, float]]:
    """Return the effects that a model cannot show, each with the share of the pixels that asks for it."""
    axes = {axis.name for axis in model.axes}
    found = []
    for name, (extent, shown_by) in sorted(EFFECTS.items()):
        share = 0.0 if axes & set(shown_by) else np.count_nonzero(extent(labels)) / labels.coc.size
        if share > 0:
            found.append((name, share))
    return found


VIEW_TOLERANCE = 0.02
"""Relative difference of a camera and the one that a database was built for that is not worth a word."""

VIEW: dict[str, Callable[[ThinLens, int], float]] = {
    "focal_length_mm": lambda camera, width: camera.focal_length_mm,
    "sensor_width_mm": lambda camera, width: camera.sensor_width_mm,
    "f_number": lambda camera, width: camera.f_number,
    "focus_per_m": lambda camera, width: 1.0 / camera.focus_distance_m,
    "width_px": lambda camera, width: float(width),
    "focal_length_px": lambda camera, width: camera.focal_length_mm / camera.sensor_width_mm * width,
}
"""What the PSFs of some models depend on beside the labels, for a camera and an image's width in px."""


def view_differences(model: PsfModel, camera: ThinLens, width: int) -> list[str]:
    """Say in what a camera differs from the one that a model's PSFs were made for."""
    found = []
    for name, built in model.settings.get("view", {}).items():
        given = VIEW[name](camera, width)
        if abs(given - built) > VIEW_TOLERANCE * max(abs(given), abs(built)):
            found.append(f"{name} is {given:.4g}, built for {built:.4g}")
    return found
