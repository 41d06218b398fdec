"""Cameras from files: JSON, the attributes of OpenEXR files, and USD; single values are laid over what a file says."""

from __future__ import annotations

import difflib
import json
import math
import os
import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypedDict, Unpack

import numpy as np

from spreadlets.arrays import PathLike
from spreadlets.errors import (
    AmbiguousInputWarning,
    InvalidCameraError,
    InvalidFileError,
    MissingPackageError,
    option,
)
from spreadlets.files.exr_file import Source, opened
from spreadlets.files.kinds import OPENEXR, file_kind
from spreadlets.scene.camera import KEYED, MM_PER_M, LensKey, LensModel, SensorFit, ThinLens, checked_number
from spreadlets.scene.pose import Pose, checked_pose, rigid

MAX_CAMERA_BYTES = 1 << 20
"""A camera file holds a few numbers; 1 MiB is far above any real one and keeps a wrong file from filling memory."""

NUMBER_KEYS = ("focal_length_mm", "sensor_width_mm", "f_number", "focus_distance_m")
SHUTTER_KEY = "shutter_open_close_frames"
OPTIONAL_KEYS = (
    "lens_model",
    "sensor_fit",
    "sensor_height_mm",
    "keys",
    "readout_frames",
    "camera_to_world",
    "shutter_curve",
)

DESCRIPTIVE_KEYS = frozenset(
    (
        "aperture_diameter_m aperture_shape camera_location_m camera_place coc_radius_px coc_scale_px_m colour comment "
        "denoised depth description focal_length_px fps frame height layer_format layers lens name note "
        "pinhole_focal_length_mm pixel_filter ref_dofmb_halves_ssim ref_halves_ssim render render_time_s renderer "
        "scene shutter_frames shutter_position source spp vector width"
    ).split()
)
"""Keys that describe a render, or follow from the others, and are passed over without a warning."""

INFINITY_NAMES = ("inf", "infinity")
"""Spellings of a focus at infinity for writers whose JSON has no Infinity (compared in lower case)."""

HALF_A_FRAME = {"shutter": (-0.25, 0.25)}
"""A shutter of 180 degrees, which is assumed where nothing says otherwise."""

DEFAULT_SENSOR_MM = 36.0
"""Width of a full-frame sensor, which is assumed where nothing says otherwise."""

USD_SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")
USD_MM_PER_TENTH = MM_PER_M / 10
"""USD counts lenses and sensors in tenths of its unit of length: this times the metres of a unit is millimetres."""

LARGEST_SENSOR_MM = 250.0
"""Plate cameras end here; a wider sensor in a USD file means that its lens is in millimetres, as some write it."""

DEGREES_PER_FRAME = 360.0


class CameraValues(TypedDict, total=False):
    """Single values of a camera, by the names of `ThinLens`'s parameters."""

    focal_length_mm: float | None
    sensor_width_mm: float | None
    sensor_height_mm: float | None
    sensor_fit: SensorFit | None
    f_number: float | None
    focus_distance_m: float | None
    shutter: tuple[float, float] | str | None
    shutter_curve: Sequence[float] | str | None
    lens_model: LensModel | None


def read_camera(
    path: PathLike | None = None, *, time_code: float | None = None, **values: Unpack[CameraValues]
) -> ThinLens:
    """Read a camera from a file, or make one of single values.

    Parameters
    ----------
    path : path, optional
        A JSON object with the numbers ``focal_length_mm``, ``sensor_width_mm``, ``f_number``, ``focus_distance_m``
        (``Infinity`` or ``"inf"`` is allowed) and the pair ``shutter_open_close_frames``; optionally ``lens_model``,
        ``sensor_fit``, ``sensor_height_mm``, ``readout_frames``, ``shutter_curve``, ``camera_to_world`` (4 rows) and
        ``keys``, see `ThinLens`. Or an OpenEXR file with camera attributes: OpenEXR's standard ones, or those of V-Ray,
        Redshift, Arnold, Unreal, or a note of Blender's that holds such JSON. Or a USD file, optionally followed by a
        colon and the camera's path, ``shot.usda:/World/Camera``; needs the extra ``usd``. What is animated in it is
        keyed.
    time_code : float, optional
        Of a USD file, the frame's; by default where the file begins.
    **values
        Parameters of `ThinLens`, which override the file's; the shutter also as ``"180deg"`` or ``"OPEN,CLOSE"``.

    Returns
    -------
    ThinLens
        Without a file, the sensor is 36 mm wide and the shutter open for half a frame, unless the values say otherwise.

    Raises
    ------
    InvalidCameraError
        If the file is missing, too large, malformed, lacks a value, or describes an impossible camera; the message
        starts with the path, or with the single value that is at fault.
    MissingPackageError
        If a USD file is given and the package is missing.

    Warns
    -----
    AmbiguousInputWarning
        If a JSON file has keys that are not known, or the sensor's width had to be assumed.

    Examples
    --------
    >>> from pathlib import Path
    >>> _ = Path("camera.json").write_text(
    ...     '{"focal_length_mm": 50, "sensor_width_mm": 36, "f_number": 2, "focus_distance_m": 3,'
    ...     ' "shutter_open_close_frames": [-0.25, 0.25]}'
    ... )
    >>> sp.read_camera("camera.json").shutter_duration
    0.5
    >>> sp.read_camera("camera.json", f_number=4).f_number
    4
    """
    given: dict[str, Any] = {name: value for name, value in values.items() if value is not None}
    if isinstance(given.get("shutter"), str):
        given["shutter"] = parse_shutter(given["shutter"])
    try:
        if path is None:
            return _camera(given, "the camera", HALF_A_FRAME)
        found, defaults = _values_in_file(path, given, time_code)
        if "keys" in found:
            # What is given holds at all times.
            unkeyed: dict[str, Any] = {name: None for name in KEYED if name in given}
            found["keys"] = tuple(replace(key, **unkeyed) for key in found["keys"])
        return _camera(found | given, "", defaults)
    except (InvalidCameraError, InvalidFileError) as error:
        raise InvalidCameraError(_blamed(str(error), path, given)) from None


def _blamed(text: str, path: PathLike | None, given: Mapping[str, Any]) -> str:
    """Return an error's text with what is at fault in front: a single value, as the caller spells it, or the file."""
    name = text.partition(" ")[0]
    if name in given:
        return option(name) + text.removeprefix(name)
    return text if path is None or text.startswith(f"{path}:") else f"{path}: {text}"


def frame_camera(path: Source, scene_scale: float = 1.0) -> dict[str, Any]:
    """Return the values of a camera that a frame's own file carries, by the names of `ThinLens`'s parameters.

    Parameters
    ----------
    path : path or ExrFile
        An OpenEXR file; any other carries none.
    scene_scale : float
        Metres of the scene's unit, as for the depth.
    """
    try:
        with opened(path) as (file,):
            return _carried_values(file.headers, scene_scale)
    except InvalidFileError:
        return {}


def camera_of(
    path: str | None,
    values: Mapping[str, Any],
    frame: Source | None = None,
    scene_scale: float = 1.0,
    time_code: float | None = None,
) -> ThinLens:
    """Return the camera of a file and single values; without a file, of what the frame itself carries.

    Parameters
    ----------
    path : str or None
        The camera's file.
    values : mapping
        Single values, which override.
    frame : path or ExrFile, optional
        The frame's file.
    scene_scale : float
        Metres of the frame's unit.
    time_code : float, optional
        Of an animated USD file, the frame's.

    Raises
    ------
    InvalidCameraError
        If they do not make a camera.
    """
    if path is None and frame is not None:
        carried = frame_camera(frame, scene_scale)
        if not carried and not values:
            names = [option(name) for name in ("camera", "focal_length_mm", "f_number", "focus_distance_m")]
            raise InvalidCameraError(
                f"no camera: give {names[0]} FILE, or {names[1]}, {names[2]} and {names[3]}; the frame carries none"
            )
        values = carried | dict(values)
    return read_camera(path, time_code=time_code, **dict(values))


def moved_along(camera: ThinLens, around: Sequence[tuple[float, str]], scene_scale: float = 1.0) -> ThinLens:
    """Return a camera with the poses that the cameras of other frames of a sequence have, as keys.

    Parameters
    ----------
    camera : ThinLens
        Without keys of its own pose, and with one, else it is returned as it is.
    around : sequence of (float, str)
        Times, frames from the camera's own, and files: of cameras, or frames that carry them.
    scene_scale : float
        Metres of the frames' unit.
    """
    if camera.camera_to_world is None or any(key.camera_to_world is not None for key in camera.keys):
        return camera
    keys = [LensKey(0.0, camera_to_world=camera.camera_to_world)]
    for time, path in around:
        if file_kind(path) == OPENEXR:
            pose = frame_camera(path, scene_scale).get("camera_to_world")
        else:
            pose = _json_values(_read_object(Path(path))).get("camera_to_world")
        keys += [] if pose is None else [LensKey(time, camera_to_world=pose)]
    return camera if len(keys) == 1 else replace(camera, keys=(*camera.keys, *keys))


def _carried_values(headers: Sequence[Mapping[str, Any]], scene_scale: float = 1.0) -> dict[str, Any]:
    """Return the values of a camera in the headers of a file's parts; the first part that says something counts."""
    values: dict[str, Any] = {}
    for header in headers:
        values = attribute_values(header, scene_scale) | values
    return values


def parse_shutter(text: str) -> tuple[float, float]:
    """Return the shutter's opening and closing in frames of ``"180deg"``, centred, or ``"OPEN,CLOSE"``.

    Raises
    ------
    InvalidCameraError
        If the text is neither.

    Examples
    --------
    >>> parse_shutter("180deg")
    (-0.25, 0.25)
    """
    try:
        if match := re.fullmatch(r"\s*(\S+?)\s*(deg|degrees|°)\s*", text):
            half = 0.5 * float(match[1]) / DEGREES_PER_FRAME
            return -half, half
        opens, closes = (float(part) for part in text.split(","))
        return opens, closes
    except ValueError:
        raise InvalidCameraError(
            f"{option('shutter')} is {text!r}; it must be an angle such as 180deg, or OPEN,CLOSE in frames"
        ) from None


def _camera(found: Mapping[str, Any], lacking: str, defaults: Mapping[str, Any]) -> ThinLens:
    """Return the camera of some values, or raise InvalidCameraError naming what is missing."""
    values = {**defaults, **found}
    missing = [name for name in (*NUMBER_KEYS, "shutter") if name not in values]
    if "sensor_width_mm" in missing and defaults:
        values["sensor_width_mm"] = DEFAULT_SENSOR_MM
        missing.remove("sensor_width_mm")
        warnings.warn(
            f"the sensor's width is taken for {DEFAULT_SENSOR_MM:g} mm; say {option('sensor_width_mm')}",
            AmbiguousInputWarning,
            stacklevel=3,
        )
    if missing:
        names = ", ".join(SHUTTER_KEY if name == "shutter" else name for name in missing)
        options = ", ".join(option(name) for name in missing)
        raise InvalidCameraError(f"{lacking} lacks {names}; say {options}".strip())
    return ThinLens(**values)


def _values_in_file(
    path: PathLike, given: Mapping[str, Any], time_code: float | None
) -> tuple[dict[str, Any], Mapping[str, Any]]:
    """Return what a file says of a camera, and what is assumed where it says nothing."""
    name, prim = _usd_place(os.fspath(path))
    if name is not None:
        return _usd_values(name, prim, time_code), HALF_A_FRAME
    if file_kind(path) == OPENEXR:
        with opened(path) as (file,):
            found = _carried_values(file.headers)
        if not found and not given:
            raise InvalidCameraError("holds no camera attributes that are known")
        return found, HALF_A_FRAME
    return _json_values(_read_object(Path(path))), {}


# --- JSON ----------------------------------------------------------------------------------------------------------


def _read_object(path: Path) -> Mapping[str, object]:
    """Return the JSON object in a file of at most `MAX_CAMERA_BYTES`."""
    # Read the file, if it is one and not too large.
    if path.exists() and not path.is_file():
        raise InvalidCameraError("the camera file cannot be read: it is not a regular file")
    try:
        with path.open("rb") as file:
            text = file.read(MAX_CAMERA_BYTES + 1)
    except OSError as error:
        raise InvalidCameraError(f"the camera file cannot be read: {error.strerror}") from error
    if len(text) > MAX_CAMERA_BYTES:
        raise InvalidCameraError(f"is larger than {MAX_CAMERA_BYTES} bytes: this is not a camera file")
    # Parse it.
    try:
        content = json.loads(text, object_pairs_hook=_once)
    except InvalidCameraError:
        raise
    except (ValueError, RecursionError) as error:
        raise InvalidCameraError(f"is not valid JSON: {error}") from error
    if not isinstance(content, dict):
        raise InvalidCameraError(f"holds a JSON {type(content).__name__}; a camera is an object with named values")
    # Warn of what is not understood.
    unknown = sorted(content.keys() - {*NUMBER_KEYS, SHUTTER_KEY, *OPTIONAL_KEYS} - DESCRIPTIVE_KEYS)
    if unknown:
        warnings.warn(f"{path}: {_unknown_keys(unknown)}", AmbiguousInputWarning, stacklevel=4)
    return content


def _once(pairs: list[tuple[str, object]]) -> dict[str, object]:
    """Return an object of JSON none of whose names is there twice."""
    content = dict(pairs)
    if len(content) < len(pairs):
        names = [name for name, _ in pairs]
        raise InvalidCameraError(f"has {next(name for name in names if names.count(name) > 1)} twice in a JSON object")
    return content


def _unknown_keys(names: list[str]) -> str:
    """Return what is said of keys that are not known; of one that is nearly a known one, that too."""
    known = (*NUMBER_KEYS, SHUTTER_KEY, *OPTIONAL_KEYS)
    shown = []
    for name in names:
        alike = difflib.get_close_matches(name, known, n=1)
        shown.append(f"{name} (did you mean {alike[0]}?)" if alike else name)
    return f"unknown camera keys are ignored: {', '.join(shown)}; known are {', '.join(known)}"


def _json_values(content: Mapping[str, object]) -> dict[str, Any]:
    """Return the values of a camera that a parsed JSON object holds."""
    values: dict[str, Any] = {}
    # Numbers; the focus may be a word for infinity.
    for key in (*NUMBER_KEYS, "sensor_height_mm"):
        if key in content:
            value = content[key]
            infinite = key == "focus_distance_m" and isinstance(value, str) and value.lower() in INFINITY_NAMES
            values[key] = math.inf if infinite else checked_number(key, value)
    # The shutter, a pair of numbers.
    if SHUTTER_KEY in content:
        shutter = content[SHUTTER_KEY]
        if not isinstance(shutter, list) or len(shutter) != 2:
            raise InvalidCameraError(f"{SHUTTER_KEY} is {shutter!r}; it must be a pair [open, close] in frames")
        values["shutter"] = tuple(
            checked_number(f"shutter {name}", time) for name, time in zip(("open", "close"), shutter, strict=True)
        )
    # What is chosen by name.
    if "lens_model" in content:
        values["lens_model"] = content["lens_model"]
    if "sensor_fit" in content:
        fit = content["sensor_fit"]
        values["sensor_fit"] = fit.lower() if isinstance(fit, str) else fit
    # What changes while the shutter is open.
    if "keys" in content:
        values["keys"] = _json_keys(content["keys"])
    if "readout_frames" in content:
        values["readout_frames"] = checked_number("readout_frames", content["readout_frames"])
    if "shutter_curve" in content:
        values["shutter_curve"] = content["shutter_curve"]
    # Where the camera is.
    if "camera_to_world" in content:
        values["camera_to_world"] = checked_pose("camera_to_world", content["camera_to_world"])  # type: ignore[arg-type]
    return values


def _json_keys(given: object) -> tuple[LensKey, ...]:
    """Return the keys of a camera that a parsed JSON file holds."""
    allowed = ("time", *KEYED, "camera_to_world")
    if not isinstance(given, list) or not all(isinstance(key, dict) and "time" in key for key in given):
        names = ", ".join(allowed[1:])
        raise InvalidCameraError(f"keys is {given!r}; it must be a list of objects with time and {names}")
    found = []
    for key in given:
        unknown = sorted(key.keys() - set(allowed))
        if unknown:
            raise InvalidCameraError(f"a key has {', '.join(unknown)}; allowed are {', '.join(allowed)}")
        numbers = {
            name: checked_number(f"{name} of a key", value) for name, value in key.items() if name != "camera_to_world"
        }
        found.append(LensKey(**numbers, camera_to_world=key.get("camera_to_world")))
    return tuple(found)


# --- OpenEXR -------------------------------------------------------------------------------------------------------


SCENE = 0.0
"""Stands for the metres of the scene's unit, which is the depth's, too."""

MM_PER_INCH = 25.4
SMALLEST_FILM_MM = 4.0
"""Film below this is counted in inches: no sensor is as small."""


@dataclass(frozen=True)
class AttributeRow:
    """How a program's header attributes hold one value of a camera.

    Attributes
    ----------
    pattern : str
        Regular expression of the attribute's whole name, in lower case.
    value : str
        Parameter of `ThinLens`, or ``shutter_degrees``, ``exposure_s``, ``frames_per_s``, ``field_of_view``
        (horizontal, degrees), ``sensor_size`` or ``film_width`` (mm or inches).
    factor : float
        What one unit is in the parameter's unit, or `SCENE`.
    """

    pattern: str
    value: str
    factor: float = 1.0


ATTRIBUTES = (
    # OpenEXR's standard attributes.
    AttributeRow("effectivefocallength", "focal_length_mm"),
    AttributeRow("pinholefocallength", "focal_length_mm"),
    AttributeRow("nominalfocallength", "focal_length_mm"),
    AttributeRow("aperture", "f_number"),
    AttributeRow("focus", "focus_distance_m"),
    AttributeRow("sensoroveralldimensions", "sensor_size"),
    AttributeRow("shutterangle", "shutter_degrees"),
    AttributeRow("exptime", "exposure_s"),
    AttributeRow("capturerate", "frames_per_s"),
    AttributeRow("framespersecond", "frames_per_s"),
    # Unreal's Movie Render Queue and Graph; distances in centimetres.
    AttributeRow(r"unreal/(camera/)?(.*/)?focallength", "focal_length_mm"),
    AttributeRow(r"unreal/(camera/)?(.*/)?fstop", "f_number"),
    AttributeRow(r"unreal/(camera/)?(.*/)?(focaldistance|focusdistance)", "focus_distance_m", 0.01),
    AttributeRow(r"unreal/(camera/)?(.*/)?sensorwidth", "sensor_width_mm"),
    AttributeRow(r"unreal/(camera/)?(.*/)?sensorheight", "sensor_height_mm"),
    AttributeRow(r"unreal/(camera/)?(.*/)?shutterangle", "shutter_degrees"),
    AttributeRow(r"unreal/(camera/)?(.*/)?fov", "field_of_view"),
    # V-Ray: camera..., lengths in mm; what it does not write is the lens's opening in f-stops.
    AttributeRow("camerafocallength", "focal_length_mm"),
    AttributeRow("cameraaperture", "sensor_width_mm"),
    AttributeRow("camerafnumber", "f_number"),
    AttributeRow("camera(focus|target)distance", "focus_distance_m", SCENE),
    # Arnold from Maya, which counts film in inches.
    AttributeRow("camerafilmaperturehorizontal", "film_width"),
    # Blender's stamp.
    AttributeRow("lens", "focal_length_mm"),
    AttributeRow("camerafov", "field_of_view"),
    # Redshift and Arnold write what their cameras' parameters are called.
    AttributeRow(r"(rs|redshift|arnold|ai)/(.*/)?(focal_?length|focallength)", "focal_length_mm"),
    AttributeRow(r"(rs|redshift|arnold|ai)/(.*/)?(f_?stop|f_?number|dof_?fstop)", "f_number"),
    AttributeRow(r"(rs|redshift|arnold|ai)/(.*/)?(sensor_?width|horizontal_?aperture)", "sensor_width_mm"),
    AttributeRow(r"(rs|redshift|arnold|ai)/(.*/)?(shutter_?angle)", "shutter_degrees"),
    AttributeRow(r"(rs|redshift|arnold|ai)/(.*/)?fov", "field_of_view"),
    AttributeRow(r"(rs|redshift|arnold|ai)/(.*/)?aperture", "sensor_size"),
    AttributeRow(r"(rs|redshift|arnold|ai)/(.*/)?(dof_?)?focus_?distance", "focus_distance_m", SCENE),
)
"""Header attributes by program; the first row that a file has for a value counts."""

SHUTTER_TIMING = "unreal/camera/shuttertiming"
SHUTTER_CENTRES = {"FrameOpen": 0.5, "FrameCenter": 0.0, "FrameClose": -0.5}
"""Where the frame's time lies in the time that the shutter is open, by Unreal's names: its middle, in that time."""

NOTE_NAMES = ("note", "blendernote")


def attribute_values(header: Mapping[str, Any], scene_scale: float = 1.0) -> dict[str, Any]:
    """Return the values of a camera that the attributes of an OpenEXR header hold.

    Parameters
    ----------
    header : mapping
        A part's header.
    scene_scale : float
        Metres of the scene's unit, in which some programs write the focus.

    Returns
    -------
    dict
        By the names of `ThinLens`'s parameters; empty if there are none.
    """
    # Find the attributes that name a value, and convert their units.
    lowered = {str(name).lower(): value for name, value in header.items()}
    raw: dict[str, Any] = {}
    for row in ATTRIBUTES:
        for name, value in lowered.items():
            if row.value not in raw and re.fullmatch(row.pattern, name) and (number := _number(value)) is not None:
                raw[row.value] = number * (row.factor if row.factor != SCENE else abs(scene_scale))
    # Take the sensor's width from whatever tells it.
    found = {name: raw[name] for name in (*NUMBER_KEYS, "sensor_height_mm") if raw.get(name, 0.0) > 0}
    if "film_width" in raw:
        inches = raw["film_width"] < SMALLEST_FILM_MM
        found.setdefault("sensor_width_mm", raw["film_width"] * (MM_PER_INCH if inches else 1))
    if "sensor_size" in raw:
        found.setdefault("sensor_width_mm", raw["sensor_size"])
    # Turn angles and times into the shutter, and into what is missing of focal length and sensor.
    open_frames = raw.get("shutter_degrees", 0.0) / DEGREES_PER_FRAME
    open_frames = open_frames or raw.get("exposure_s", 0.0) * raw.get("frames_per_s", 0.0)
    if open_frames:
        centre = SHUTTER_CENTRES.get(str(lowered.get(SHUTTER_TIMING)), 0.0)
        found["shutter"] = ((centre - 0.5) * open_frames, (centre + 0.5) * open_frames)
    if 0 < raw.get("field_of_view", 0) < 180:
        ratio = 2 * math.tan(math.radians(raw["field_of_view"]) / 2)  # sensor's width over focal length
        if "sensor_width_mm" in found:
            found.setdefault("focal_length_mm", found["sensor_width_mm"] / ratio)
        elif "focal_length_mm" in found:
            found["sensor_width_mm"] = found["focal_length_mm"] * ratio
    return found | _carried_pose(lowered, abs(scene_scale)) | _noted_values(lowered)


def _carried_pose(lowered: Mapping[str, Any], metres: float) -> dict[str, Pose]:
    """Return where the camera is by OpenEXR's attribute worldToCamera, which multiplies rows from the right.

    Renderers whose space is mirrored against the world's, such as RenderMan, look along z; the others along -z.
    """
    stored = np.asarray(lowered.get("worldtocamera", ()))
    if stored.shape != (4, 4) or not np.isfinite(stored).all() or not np.linalg.det(stored.astype(np.float64)):
        return {}
    matrix = np.linalg.inv(stored.T.astype(np.float64))
    if np.linalg.det(matrix) < 0:
        matrix[:, 2] *= -1.0
    pose = rigid(matrix)
    pose[:3, 3] *= metres
    return {"camera_to_world": checked_pose("worldToCamera", pose)}


def _number(value: Any) -> float | None:
    """Return an attribute as a number: of a pair the first, of text what it says; None if it is none, or not > 0."""
    try:
        if isinstance(value, str):
            number = float(value.split()[0])
        else:
            number = float(value) if not hasattr(value, "__len__") else float(value[0])
    except (ValueError, TypeError, IndexError, OverflowError):
        return None
    return number if number > 0 and not math.isnan(number) else None


def _noted_values(lowered: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values in a note of Blender's stamp: a JSON object, or ``key=value`` or ``key: value`` of its keys."""
    for name in NOTE_NAMES:
        note = lowered.get(name)
        if not isinstance(note, str):
            continue
        try:
            content = json.loads(note)
        except (ValueError, RecursionError):
            content = {
                key: float(value)
                for key, value in re.findall(r"(\w+)\s*[=:]\s*(-?[\d.]+(?:e-?\d+)?)", note)
                if key in NUMBER_KEYS and re.fullmatch(r"-?(\d+\.?\d*|\.\d+)(e-?\d+)?", value)
            }
        if isinstance(content, dict):
            return _json_values(content)
    return {}


# --- USD -----------------------------------------------------------------------------------------------------------


def _usd_place(path: str) -> tuple[str | None, str | None]:
    """Return the file and the camera's path in it, of ``FILE.usd[:/PRIM/PATH]``; None if it is no USD file."""
    name, colon, prim = path.rpartition(":/")
    if colon and name.lower().endswith(USD_SUFFIXES):
        return name, "/" + prim
    return (path, None) if path.lower().endswith(USD_SUFFIXES) else (None, None)


def _usd_values(path: str, prim_path: str | None, time_code: float | None) -> dict[str, Any]:
    """Return the values of a camera in a USD file at a time, with keys of what changes around it."""
    # Find the camera.
    try:
        from pxr import Tf, Usd, UsdGeom  # type: ignore[import-not-found,unused-ignore]
    except ImportError:
        raise MissingPackageError(
            "reading a camera from USD needs the package usd-core: pip install 'spreadlets[usd]'"
        ) from None
    if not os.path.isfile(path):
        raise InvalidCameraError("there is no such file")
    try:
        stage = Usd.Stage.Open(path)
    except Tf.ErrorException as error:
        raise InvalidCameraError(f"is not a readable USD file ({str(error).splitlines()[0]})") from None
    camera = UsdGeom.Camera(_usd_prim(stage, prim_path, lambda prim: bool(prim.IsA(UsdGeom.Camera))))
    # USD counts lengths of lens and sensor in tenths of the scene's unit; many files count them in millimetres.
    time = Usd.TimeCode(stage.GetStartTimeCode()) if stage.HasAuthoredTimeCodeRange() else Usd.TimeCode.EarliestTime()
    time = time if time_code is None else Usd.TimeCode(time_code)
    metres = UsdGeom.GetStageMetersPerUnit(stage)
    mm = metres * USD_MM_PER_TENTH
    width = camera.GetHorizontalApertureAttr().Get(time)
    if width * mm > LARGEST_SENSOR_MM >= width:
        warnings.warn(
            f"{path}: the sensor would be {width * mm:g} mm wide; lens and sensor are taken for millimetres",
            AmbiguousInputWarning,
            stacklevel=4,
        )
        mm = 1.0
    # Read the values; a shutter of no length was not set.
    values: dict[str, Any] = {
        "sensor_width_mm": width * mm,
        "sensor_height_mm": camera.GetVerticalApertureAttr().Get(time) * mm,
        "shutter": (camera.GetShutterOpenAttr().Get(time), camera.GetShutterCloseAttr().Get(time)),
    }
    if values["shutter"] == (0.0, 0.0):
        del values["shutter"]
    now = _usd_moment(camera, time, mm, metres)
    return values | now | _usd_keys(stage, camera, time, now, mm, metres)


def _usd_moment(camera: Any, time: Any, mm: float, metres: float) -> dict[str, Any]:
    """Return what may be animated of a camera in a USD file, at a time; what is 0 was not set."""
    pose = rigid(np.asarray(camera.ComputeLocalToWorldTransform(time)).T)
    pose[:3, 3] *= metres
    found = {
        "focal_length_mm": camera.GetFocalLengthAttr().Get(time) * mm,
        "f_number": camera.GetFStopAttr().Get(time),
        "focus_distance_m": camera.GetFocusDistanceAttr().Get(time) * metres,
    }
    return {name: value for name, value in found.items() if value > 0} | {
        "camera_to_world": checked_pose(f"the transform of {camera.GetPath()}", pose)
    }


def _usd_keys(
    stage: Any, camera: Any, time: Any, now: Mapping[str, Any], mm: float, metres: float
) -> dict[str, tuple[LensKey, ...]]:
    """Return the camera at the file's samples from one frame before a time to one after as keys, if it changes."""
    from pxr import UsdGeom

    # Find the samples, in frames from the time; beyond a frame they are interpolated.
    parents = [prim for path in camera.GetPath().GetPrefixes() if (prim := stage.GetPrimAtPath(path))]
    sampled = [UsdGeom.Xformable(prim).GetTimeSamples() for prim in parents if prim.IsA(UsdGeom.Xformable)]
    lens = camera.GetFocalLengthAttr(), camera.GetFStopAttr(), camera.GetFocusDistanceAttr()
    sampled += [attribute.GetTimeSamples() for attribute in lens]
    frame = stage.GetTimeCodesPerSecond() / (stage.GetFramesPerSecond() or stage.GetTimeCodesPerSecond())
    middle = 0.0 if time.IsEarliestTime() else time.GetValue()
    found = {min(max((code - middle) / frame, -1.0), 1.0) for codes in sampled for code in codes}
    # Read the camera at each.
    moments = {at: _usd_moment(camera, middle + at * frame, mm, metres) for at in found - {0.0}}
    if all(moment == now for moment in moments.values()):
        return {}
    return {"keys": tuple(LensKey(at, **moment) for at, moment in sorted(({0.0: now} | moments).items()))}


def _usd_prim(stage: Any, prim_path: str | None, is_camera: Callable[[Any], bool]) -> Any:
    """Return the camera at a path, or the only one."""
    cameras = [prim for prim in stage.Traverse() if is_camera(prim)]
    paths = [str(prim.GetPath()) for prim in cameras]
    if prim_path is not None:
        if prim_path not in paths:
            there = ", ".join(paths) or "none"
            raise InvalidCameraError(f"has no camera at {prim_path}; its cameras: {there}")
        return cameras[paths.index(prim_path)]
    if len(cameras) != 1:
        there = ", ".join(paths) or "none"
        raise InvalidCameraError(
            f"holds {len(cameras)} cameras ({there}); say which: FILE.usd:{(paths or ['/PATH'])[0]}"
        )
    return cameras[0]
