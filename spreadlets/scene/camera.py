"""The thin-lens camera: depth to circle of confusion, the shutter interval, and reading camera files."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt

from spreadlets.errors import InvalidCameraError, InvalidParameterError

LensModel = Literal["renderer", "textbook"]

MM_PER_M = 1000.0

MAX_CAMERA_BYTES = 1 << 20
"""A camera file holds a few numbers; 1 MiB is far above any real one and keeps a wrong file from filling memory."""

NUMBER_KEYS = ("focal_length_mm", "sensor_width_mm", "f_number", "focus_distance_m")
SHUTTER_KEY = "shutter_open_close_frames"
LENS_MODEL_KEY = "lens_model"

INFINITY_NAMES = ("inf", "infinity")
"""Spellings of a focus at infinity for writers whose JSON has no Infinity (compared in lower case)."""


@dataclass(frozen=True)
class ThinLens:
    """A thin-lens camera with a shutter.

    Parameters
    ----------
    focal_length_mm : float
        Focal length in millimetres, > 0.
    sensor_width_mm : float
        Width of the sensor in millimetres, > 0; it spans the image's width.
    f_number : float
        Focal length over aperture diameter, > 0.
    focus_distance_m : float
        Planar distance in metres that is in focus, beyond the focal length; ``inf`` focuses at infinity.
    shutter : tuple of two floats
        ``(open, close)`` in frames relative to the label's time; ``close >= open``.
    lens_model : {'renderer', 'textbook'}
        Scale of the circle of confusion: ``f/zf`` as renderers do (measured on Cycles), or the textbook's
        ``f/(zf - f)``.

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

    def __post_init__(self) -> None:
        for key in ("focal_length_mm", "sensor_width_mm", "f_number"):
            value = _checked_number(key, getattr(self, key))
            if not (math.isfinite(value) and value > 0):
                raise InvalidCameraError(f"{key} is {value:g}; it must be finite and > 0")
        _check_focus(_checked_number("focus_distance_m", self.focus_distance_m), self.focal_length_mm)
        _check_shutter(self.shutter)
        if self.lens_model not in get_args(LensModel):
            raise InvalidCameraError(f"lens_model is {self.lens_model!r}; allowed are {', '.join(get_args(LensModel))}")

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


def read_camera(path: str | os.PathLike[str]) -> ThinLens:
    """Read a camera from a JSON file.

    Parameters
    ----------
    path : path
        JSON object with the numbers ``focal_length_mm``, ``sensor_width_mm``, ``f_number``, ``focus_distance_m``
        (``Infinity`` or ``"inf"`` is allowed) and the pair ``shutter_open_close_frames``; optionally ``lens_model``.
        Other keys are ignored.

    Returns
    -------
    ThinLens

    Raises
    ------
    InvalidCameraError
        If the file is missing, too large, not such JSON, lacks a key, or describes an impossible camera; the message
        starts with the path.

    Examples
    --------
    >>> from pathlib import Path
    >>> _ = Path("camera.json").write_text(
    ...     '{"focal_length_mm": 50, "sensor_width_mm": 36, "f_number": 2, "focus_distance_m": 3,'
    ...     ' "shutter_open_close_frames": [-0.25, 0.25]}'
    ... )
    >>> sp.read_camera("camera.json").shutter_duration
    0.5
    """
    try:
        return _camera_from_mapping(_read_object(Path(path)))
    except InvalidCameraError as error:
        raise InvalidCameraError(f"{path}: {error}") from None


def _read_object(path: Path) -> Mapping[str, object]:
    """Return the JSON object in a file of at most `MAX_CAMERA_BYTES`."""
    if path.exists() and not path.is_file():
        raise InvalidCameraError("the camera file cannot be read: it is not a regular file")
    try:
        with path.open("rb") as file:
            text = file.read(MAX_CAMERA_BYTES + 1)
    except OSError as error:
        raise InvalidCameraError(f"the camera file cannot be read: {error.strerror}") from error
    if len(text) > MAX_CAMERA_BYTES:
        raise InvalidCameraError(f"is larger than {MAX_CAMERA_BYTES} bytes: this is not a camera file")
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InvalidCameraError(f"is not valid JSON: {error}") from error
    if not isinstance(content, dict):
        raise InvalidCameraError(f"holds a JSON {type(content).__name__}; a camera is an object with named values")
    return content


def _camera_from_mapping(content: Mapping[str, object]) -> ThinLens:
    """Return the camera that a parsed JSON object describes."""
    missing = [key for key in (*NUMBER_KEYS, SHUTTER_KEY) if key not in content]
    if missing:
        raise InvalidCameraError(f"lacks {', '.join(missing)}; needed are {', '.join((*NUMBER_KEYS, SHUTTER_KEY))}")
    focus = content["focus_distance_m"]
    if isinstance(focus, str) and focus.lower() in INFINITY_NAMES:
        focus = math.inf
    shutter = content[SHUTTER_KEY]
    if not isinstance(shutter, list) or len(shutter) != 2:
        raise InvalidCameraError(f"{SHUTTER_KEY} is {shutter!r}; it must be a pair [open, close] in frames")
    return ThinLens(
        focal_length_mm=_checked_number("focal_length_mm", content["focal_length_mm"]),
        sensor_width_mm=_checked_number("sensor_width_mm", content["sensor_width_mm"]),
        f_number=_checked_number("f_number", content["f_number"]),
        focus_distance_m=_checked_number("focus_distance_m", focus),
        shutter=(_checked_number("shutter open", shutter[0]), _checked_number("shutter close", shutter[1])),
        lens_model=content.get(LENS_MODEL_KEY, "renderer"),  # type: ignore[arg-type]  # ThinLens checks the name
    )


def _checked_number(name: str, value: object) -> float:
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
    opens, closes = (_checked_number(f"shutter {name}", t) for name, t in zip(("open", "close"), shutter, strict=True))
    if not (math.isfinite(opens) and math.isfinite(closes)):
        raise InvalidCameraError(f"shutter is ({opens:g}, {closes:g}); both times must be finite")
    if closes < opens:
        raise InvalidCameraError(f"the shutter closes at {closes:g}, before it opens at {opens:g} frames")
