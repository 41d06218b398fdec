"""The thin-lens camera: depth to circle of confusion, the sensor's fit, and the shutter interval."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt

from spreadlets.errors import InvalidCameraError, InvalidParameterError
from spreadlets.scene.pose import Pose, checked_pose, pose_between
from spreadlets.scene.shutter import read_curve

LensModel = Literal["renderer", "textbook"]
SensorFit = Literal["horizontal", "vertical", "auto"]

MM_PER_M = 1000.0


@dataclass(frozen=True)
class LensKey:
    """A camera at a time; between two keys it changes evenly, before the first and after the last it stays as it is.

    Parameters
    ----------
    time : float
        Frames, relative to the label's time.
    focal_length_mm, f_number, focus_distance_m : float, optional
        As for `ThinLens`; what is not given is not keyed at this time.
    camera_to_world : tuple of 4 rows, optional
        Where the camera is and how it looks, as for `ThinLens`.

    Raises
    ------
    InvalidCameraError
        If the time is not a finite number, or the pose is none.

    Examples
    --------
    >>> sp.LensKey(-0.25, focus_distance_m=2.0).f_number is None
    True
    """

    time: float
    focal_length_mm: float | None = None
    f_number: float | None = None
    focus_distance_m: float | None = None
    camera_to_world: Pose | None = None

    def __post_init__(self) -> None:
        if not math.isfinite(checked_number("time of a key", self.time)):
            raise InvalidCameraError(f"the time of a key is {self.time}; it must be finite, in frames")
        _check_pose(self, f"camera_to_world at {self.time:g} frames")


KEYED = ("focal_length_mm", "f_number", "focus_distance_m")
"""Numbers that may change while the shutter is open."""


@dataclass(frozen=True)
class ThinLens:
    """A thin-lens camera with a shutter.

    Parameters
    ----------
    focal_length_mm : float
        Focal length in millimetres, > 0.
    sensor_width_mm : float
        Width of the sensor in millimetres, > 0; it spans the image's width unless `sensor_fit` says otherwise.
    f_number : float
        Focal length over aperture diameter, > 0.
    focus_distance_m : float
        Planar distance in metres that is in focus, beyond the focal length; ``inf`` focuses at infinity.
    shutter : tuple of two floats
        ``(open, close)`` in frames relative to the label's time; ``close >= open``.
    lens_model : {'renderer', 'textbook'}
        Scale of the circle of confusion: ``f/zf`` as renderers do (measured on Cycles), or the textbook's
        ``f/(zf - f)``.
    sensor_fit : {'horizontal', 'vertical', 'auto'}
        Which side of the image the sensor spans: its width the image's width, its height the image's height, or, as in
        Blender, its width the longer side.
    sensor_height_mm : float, optional
        Height of the sensor in millimetres, > 0, for a vertical fit; by default the width is taken.
    keys : tuple of LensKey
        How the camera changes while the shutter is open: a pull of focus, a zoom, an iris that closes, a move.
    readout_frames : float
        Rolling shutter: by how much later, in frames, the last row is exposed than the first; negative for earlier.
    camera_to_world : tuple of 4 rows, optional
        Where the camera is and how it looks: the matrix that takes its space to the world's, both in metres. The camera
        looks along -z, x points to the right and y up. What counts is how the poses of `keys` differ.
    shutter_curve : sequence of floats or str, optional
        How far the shutter is open at equally spaced times from opening to closing, linear between them; or
        ``"trapezoid:RISE,FALL"`` with the shares of the time in which it opens and closes. By default it is fully open
        all the time.

    Raises
    ------
    InvalidCameraError
        If a value is not a number, not finite where it must be, or outside its range.

    Examples
    --------
    >>> camera = sp.ThinLens(focal_length_mm=50, sensor_width_mm=36, f_number=2, focus_distance_m=3)
    >>> camera.aperture_diameter_m
    0.025
    >>> camera.coc_radius([1.5, 3.0, float("inf")], image_width=1920).round(2).tolist()
    [-11.11, 0.0, 11.11]
    """

    focal_length_mm: float
    sensor_width_mm: float
    f_number: float
    focus_distance_m: float
    shutter: tuple[float, float] = (-0.25, 0.25)
    lens_model: LensModel = "renderer"
    sensor_fit: SensorFit = "horizontal"
    sensor_height_mm: float | None = None
    keys: tuple[LensKey, ...] = ()
    readout_frames: float = 0.0
    camera_to_world: Pose | None = None
    shutter_curve: Sequence[float] | str | None = None

    def __post_init__(self) -> None:
        height = () if self.sensor_height_mm is None else ("sensor_height_mm",)
        for key in ("focal_length_mm", "sensor_width_mm", "f_number", *height):
            value = checked_number(key, getattr(self, key))
            if not (math.isfinite(value) and value > 0):
                raise InvalidCameraError(f"{key} is {value:g}; it must be finite and > 0")
        _check_focus(checked_number("focus_distance_m", self.focus_distance_m), self.focal_length_mm)
        _check_shutter(self.shutter)
        if self.sensor_fit not in get_args(SensorFit):
            raise InvalidCameraError(f"sensor_fit is {self.sensor_fit!r}; allowed are {', '.join(get_args(SensorFit))}")
        if self.lens_model not in get_args(LensModel):
            raise InvalidCameraError(f"lens_model is {self.lens_model!r}; allowed are {', '.join(get_args(LensModel))}")
        if not math.isfinite(checked_number("readout_frames", self.readout_frames)):
            raise InvalidCameraError(f"readout_frames is {self.readout_frames}; it must be finite")
        _check_pose(self, "camera_to_world")
        self._check_keys()
        if self.shutter_curve is not None:
            object.__setattr__(self, "shutter_curve", _checked_curve(self.shutter_curve))

    def _check_keys(self) -> None:
        """Raise InvalidCameraError unless all keys are keys, and the lens is possible at each."""
        if not isinstance(self.keys, tuple) or not all(isinstance(key, LensKey) for key in self.keys):
            raise InvalidCameraError(f"keys is {self.keys!r}; it must be a tuple of LensKey")
        for key in self.keys:
            for name in KEYED:
                if getattr(key, name) is not None:
                    checked_number(f"{name} at {key.time:g} frames", getattr(key, name))
            try:
                self.at(key.time)
            except InvalidCameraError as error:
                raise InvalidCameraError(f"the key at {key.time:g} frames: {error}") from None

    def at(self, time: float) -> ThinLens:
        """Return the camera as it is at a time, without keys.

        Parameters
        ----------
        time : float
            Frames, relative to the label's time.

        Examples
        --------
        >>> keys = sp.LensKey(0, focus_distance_m=3), sp.LensKey(1, focus_distance_m=5)
        >>> pull = sp.ThinLens(50, 36, 2, 3, keys=keys)
        >>> pull.at(0.5).focus_distance_m
        4.0
        """
        if not self.keys:
            return self
        values: dict[str, Any] = {name: self.value_at(name, time) for name in KEYED}
        return replace(self, keys=(), camera_to_world=self.pose_at(time), **values)

    def held(self, **values: float) -> ThinLens:
        """Return the camera with values that hold all the time, whatever its keys say of them.

        Parameters
        ----------
        **values
            ``focal_length_mm``, ``f_number`` or ``focus_distance_m``.

        Examples
        --------
        >>> keys = sp.LensKey(0, focus_distance_m=3), sp.LensKey(1, focus_distance_m=5, f_number=4)
        >>> held = sp.ThinLens(50, 36, 2, 3, keys=keys).held(focus_distance_m=7)
        >>> held.at(1).focus_distance_m, held.at(1).f_number
        (7, 4.0)
        """
        unkeyed: dict[str, Any] = dict.fromkeys(values)
        keys = [replace(key, **unkeyed) for key in self.keys]
        changed: dict[str, Any] = dict(values)
        return replace(self, keys=tuple(key for key in keys if key != LensKey(key.time)), **changed)

    def value_at(self, name: str, time: float) -> float:
        """Return a keyed value at a time; it changes evenly between keys."""
        given = sorted((key.time, float(getattr(key, name))) for key in self.keys if getattr(key, name) is not None)
        if not given:
            return float(getattr(self, name))
        times, values = np.array(given).T
        return float(np.interp(time, times, values))

    def pose_at(self, time: float) -> Pose | None:
        """Return where the camera is and how it looks at a time; None if nothing says it.

        Examples
        --------
        >>> aside = ((1, 0, 0, 2), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1))
        >>> still = ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1))
        >>> keys = sp.LensKey(0, camera_to_world=still), sp.LensKey(1, camera_to_world=aside)
        >>> sp.ThinLens(50, 36, 2, 3, keys=keys).pose_at(0.5)[0]
        (1.0, 0.0, 0.0, 1.0)
        """
        given = sorted((key.time, key.camera_to_world) for key in self.keys if key.camera_to_world is not None)
        if not given:
            return self.camera_to_world
        for (begin, first), (end, second) in itertools.pairwise(given):
            if begin < time < end:
                return pose_between(first, second, (time - begin) / (end - begin))
        return given[0][1] if time <= given[0][0] else next(pose for at, pose in reversed(given) if at <= time)

    @property
    def moves_picture(self) -> bool:
        """Whether the camera itself makes all that it sees move: it has several poses, or several focal lengths."""
        poses = {key.camera_to_world for key in self.keys} - {None}
        zooms = {key.focal_length_mm for key in self.keys} - {None}
        return len(poses) > 1 or len(zooms) > 1

    def fitted(self, shape: tuple[int, int], pixel_aspect: float = 1.0) -> ThinLens:
        """Return the camera with the sensor's width that spans the width of an image.

        Parameters
        ----------
        shape : tuple of int
            Height and width of the whole image, px.
        pixel_aspect : float
            Width over height of a pixel.

        Returns
        -------
        ThinLens
            With a horizontal `sensor_fit`.

        Examples
        --------
        >>> camera = sp.ThinLens(100, 36, 1.4, 2, sensor_fit="auto")
        >>> camera.fitted((160, 90)).sensor_width_mm  # portrait: the 36 mm span the height
        20.25
        """
        height, width = shape[0], shape[1] * pixel_aspect
        if self.sensor_fit == "horizontal" or (self.sensor_fit == "auto" and width >= height):
            return self if self.sensor_fit == "horizontal" else replace(self, sensor_fit="horizontal")
        own_height = self.sensor_height_mm if self.sensor_fit == "vertical" else None
        spanned = self.sensor_width_mm if own_height is None else own_height
        return replace(self, sensor_width_mm=spanned * width / height, sensor_fit="horizontal", sensor_height_mm=None)

    @property
    def aperture_diameter_m(self) -> float:
        """Diameter of the entrance pupil in metres: focal length over f-number."""
        return self.focal_length_mm / MM_PER_M / self.f_number

    @property
    def shutter_duration(self) -> float:
        """Time that the shutter is open, in frames, >= 0."""
        return self.shutter[1] - self.shutter[0]

    @property
    def shutter_centre(self) -> float:
        """Middle of the exposure, in frames relative to the label's time."""
        return 0.5 * (self.shutter[0] + self.shutter[1])

    def coc_scale(self, image_width: int) -> float:
        """Return the factor of the defocus blur, in px metres: ``coc_radius = coc_scale * (1/zf - 1/z)``.

        Parameters
        ----------
        image_width : int
            Width of the whole image in pixels, > 0.

        Raises
        ------
        InvalidParameterError
            If `image_width` is not positive.
        """
        if not image_width > 0:
            raise InvalidParameterError(f"image_width is {image_width}; it must be > 0 pixels")
        if self.sensor_fit != "horizontal":
            raise InvalidParameterError(f"the sensor's fit is {self.sensor_fit}; take camera.fitted((height, width))")
        focal_length_px = self.focal_length_mm / self.sensor_width_mm * image_width
        scale = 0.5 * self.aperture_diameter_m * focal_length_px
        if self.lens_model == "textbook":
            scale /= 1.0 - self.focal_length_mm / MM_PER_M / self.focus_distance_m  # zf / (zf - f), and 1 at infinity
        return scale

    def coc_radius(self, depth: npt.ArrayLike, image_width: int) -> npt.NDArray[np.floating[Any]]:
        """Return the signed radius of the circle of confusion.

        Parameters
        ----------
        depth : array_like of any shape
            Planar camera-space depth in metres, > 0; ``inf`` is background.
        image_width : int
            Width of the whole image in pixels, > 0.

        Returns
        -------
        ndarray of the shape of `depth`, float32 for float16 or float32 input, else float64
            Radius in pixels, negative in front of focus.

        Raises
        ------
        InvalidParameterError
            If `image_width` is not positive.

        Notes
        -----
        ``0.5 * aperture * f_px * (1/zf - 1/z)`` with ``aperture = f/N`` in metres and ``f_px = f/sensor * width``.
        """
        z = np.asarray(depth)
        dtype = np.float32 if z.dtype in (np.float16, np.float32) else np.float64
        radius = self.coc_scale(image_width) * (1.0 / self.focus_distance_m - 1.0 / z.astype(np.float64))
        return np.asarray(radius, dtype=dtype)


def _checked_curve(given: Sequence[float] | str) -> tuple[float, ...] | None:
    """Return a shutter's curve as a tuple; None if it is the same all the time."""
    try:
        curve = read_curve(given)
    except InvalidParameterError as error:
        raise InvalidCameraError(str(error)) from None
    return tuple(curve) if min(curve) < max(curve) else None


def _check_pose(holder: LensKey | ThinLens, name: str) -> None:
    """Keep the pose of a camera as tuples, or raise InvalidCameraError."""
    if holder.camera_to_world is not None:
        object.__setattr__(holder, "camera_to_world", checked_pose(name, holder.camera_to_world))


def checked_number(name: str, value: object) -> float:
    """Return a real number as a float; booleans, strings and NaN are refused, infinities are left to the caller."""
    if isinstance(value, bool | np.bool_) or not isinstance(value, int | float | np.integer | np.floating):
        raise InvalidCameraError(f"{name} is {value!r}; it must be a number")
    try:
        number = float(value)
    except OverflowError as error:
        raise InvalidCameraError(f"{name} is too large for a number") from error
    if math.isnan(number):
        raise InvalidCameraError(f"{name} is NaN; it must be a number")
    return number


def _check_focus(focus_distance_m: float, focal_length_mm: float) -> None:
    """Raise InvalidCameraError unless the focus lies beyond the focal length."""
    if focus_distance_m * MM_PER_M <= focal_length_mm:
        raise InvalidCameraError(
            f"focus_distance_m is {focus_distance_m:g}, which puts the focus inside the focal length "
            f"({focal_length_mm:g} mm); it must be greater than {focal_length_mm / MM_PER_M:g} m"
        )


def _check_shutter(shutter: tuple[float, float]) -> None:
    """Raise InvalidCameraError unless the shutter is a finite pair that does not close before it opens."""
    if not isinstance(shutter, tuple) or len(shutter) != 2:
        raise InvalidCameraError(f"shutter is {shutter!r}; it must be a pair (open, close) in frames")
    opens, closes = (checked_number(f"shutter {name}", t) for name, t in zip(("open", "close"), shutter, strict=True))
    if not (math.isfinite(opens) and math.isfinite(closes)):
        raise InvalidCameraError(f"shutter is ({opens:g}, {closes:g}); both times must be finite")
    if closes < opens:
        raise InvalidCameraError(f"the shutter closes at {closes:g}, before it opens at {opens:g} frames")
