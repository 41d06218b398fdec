"""How renderers store depth and motion, as tables: another renderer is another row of `PRESETS`.

Each convention is used both ways: from a file's channels to the labels of `Frame`, and back when a frame is written.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import BoolArray, FloatArray
from spreadlets.errors import InvalidParameterError, option
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.raster import Raster

Matrix = tuple[tuple[float, ...], tuple[float, ...]]

FAR = np.float32(1e10)
"""Depth that stands for the background where an infinite one would turn a product into NaN."""


@dataclass(frozen=True)
class Scale:
    """What some conventions need besides the channels' values.

    Attributes
    ----------
    camera : ThinLens or None
        For ray distance, disparity and velocity in space.
    depth_scale : float
        Metres per unit of the depth channel; below 0 for depth along an axis that points to the camera.
    baseline_m : float or None
        Distance of the two cameras of a stereo pair, metres, for disparity.
    max_displacement : float or None
        Motion in px that a normalised channel's end of range stands for.
    raster : Raster or None
        Where the pixels of the arrays lie; by default the arrays are the whole picture.
    """

    camera: ThinLens | None = None
    depth_scale: float = 1.0
    baseline_m: float | None = None
    max_displacement: float | None = None
    raster: Raster | None = None

    def __post_init__(self) -> None:
        for name in ("baseline_m", "max_displacement"):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value > 0):
                raise InvalidParameterError(f"{option(name)} is {value:g}; it must be finite and > 0")
        if not (np.isfinite(self.depth_scale) and self.depth_scale != 0):
            raise InvalidParameterError(
                f"{option('depth_scale')} is {self.depth_scale:g}; it must be finite and not 0 (below 0 turns the sign)"
            )

    def raster_of(self, shape: tuple[int, ...]) -> Raster:
        """Return where the pixels of an array (H, W) lie."""
        return self.raster or Raster.of_shape((shape[0], shape[1]))

    def focal_length_px(self, shape: tuple[int, ...], reason: str) -> float:
        """Return the focal length in px of an image of (height, width); without a camera raise why one is needed."""
        if self.camera is None:
            raise InvalidParameterError(f"{reason} needs the camera ({option('camera')})")
        raster = self.raster_of(shape)
        camera = self.camera.fitted(raster.display.shape, raster.pixel_aspect)
        return camera.focal_length_mm / camera.sensor_width_mm * raster.display.width

    def baseline(self) -> float:
        """Return the baseline in metres, or raise InvalidParameterError."""
        if self.baseline_m is None:
            raise InvalidParameterError(
                f"{option('depth_convention')} disparity needs the distance of the two cameras ({option('baseline_m')})"
            )
        return self.baseline_m

    def displacement(self, convention: str) -> float:
        """Return the largest displacement in px, or raise InvalidParameterError."""
        if self.max_displacement is None:
            raise InvalidParameterError(
                f"{option('motion_convention')} {convention} needs the motion in px at the end of the range "
                f"({option('max_displacement')})"
            )
        return self.max_displacement


# --- Depth ---------------------------------------------------------------------------------------------------------


def _same(values: FloatArray, scale: Scale) -> FloatArray:
    return values


def _reciprocal(values: FloatArray, scale: Scale) -> FloatArray:
    with np.errstate(divide="ignore"):  # an inverse depth of zero is infinitely far
        return np.divide(np.float32(1), values)


def _ray_to_planar(values: FloatArray, scale: Scale) -> FloatArray:
    return values / _ray_length(values.shape, scale)


def _planar_to_ray(values: FloatArray, scale: Scale) -> FloatArray:
    return values * _ray_length(values.shape, scale)


def _disparity(values: FloatArray, scale: Scale) -> FloatArray:
    focal_px = scale.focal_length_px(values.shape, f"{option('depth_convention')} disparity")
    return np.float32(scale.baseline() * focal_px / scale.depth_scale) * _reciprocal(values, scale)


def _ray_length(shape: tuple[int, ...], scale: Scale) -> FloatArray:
    """Return how far along its ray each pixel's centre is at a planar depth of 1, (H, W)."""
    focal_px = scale.focal_length_px(shape, f"{option('depth_convention')} ray")
    x, y = _offsets_from_centre(shape, scale)
    return np.asarray(np.sqrt(1 + (x**2 + y**2) / focal_px**2), np.float32)


def _offsets_from_centre(
    shape: tuple[int, ...], scale: Scale
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Return how far right of (1, W) and below (H, 1) the picture's centre each pixel lies, in widths of a pixel."""
    raster = scale.raster_of(shape)
    x = np.arange(shape[1], dtype=np.float64)[None, :] - raster.centre[0]
    y = (np.arange(shape[0], dtype=np.float64)[:, None] - raster.centre[1]) / raster.pixel_aspect
    return x, y


DepthMap = Callable[[FloatArray, Scale], FloatArray]

DEPTH_CONVENTIONS: Mapping[str, tuple[DepthMap, DepthMap]] = {
    "planar": (_same, _same),
    "ray": (_ray_to_planar, _planar_to_ray),
    "inverse": (_reciprocal, _reciprocal),
    "disparity": (_disparity, _disparity),
}
"""Stored values to planar depth and back, both in the file's units, by the name that `depth_convention` takes.

``planar`` is the distance along the optical axis, ``ray`` along the ray through the pixel's centre, ``inverse`` is
1 over the planar depth, and ``disparity`` the shift in px between the two images of a parallel stereo pair.
"""

POSITION = "position"
"""Where what is seen is in the world, three channels: from a camera whose place is known, its planar depth."""

POSITION_LAYERS = ("P", "Position", "WorldPosition", "ray:hitP", "hitP")
POSITION_COMPONENTS = (("X", "Y", "Z"), ("R", "G", "B"))
"""Names of position passes of Arnold and Houdini, Blender, Redshift, and Karma."""

HALF_STEP = 1e-3
"""Relative step of a half float: a file of halves holds a number only to about this."""

RECIPROCAL_DEPTH = frozenset({"inverse", "disparity"})
"""Depth conventions whose values fall with distance."""


def planar_depth(convention: str, values: FloatArray, scale: Scale) -> FloatArray:
    """Return planar depth in metres from the values of a depth channel.

    Parameters
    ----------
    convention : str
        A key of `DEPTH_CONVENTIONS`.
    values : ndarray of shape (H, W), float32
        The channel.
    scale : Scale
        Camera, units and baseline, as far as the convention needs them.

    Returns
    -------
    ndarray of shape (H, W), float32

    Raises
    ------
    InvalidParameterError
        If the convention needs something that `scale` lacks.
    """
    return np.asarray(DEPTH_CONVENTIONS[convention][0](values, scale) * np.float32(scale.depth_scale), np.float32)


def channels_depth(convention: str, channels: FloatArray, scale: Scale) -> FloatArray:
    """Return planar depth in metres of a depth channel, or of the three of positions in the world.

    Parameters
    ----------
    convention : str
        A key of `DEPTH_CONVENTIONS`, or `POSITION`.
    channels : ndarray of shape (H, W, n), float32
        In the file's units.
    scale : Scale
        As for `planar_depth`; for positions the camera, with its place, and metres per unit.

    Returns
    -------
    ndarray of shape (H, W), float32
        ``inf`` where a position is the origin itself, which stands where nothing was seen.

    Raises
    ------
    InvalidParameterError
        If the convention needs something that `scale` lacks, such as where the camera is.
    """
    if convention != POSITION:
        return planar_depth(convention, channels[..., 0], scale)
    pose = None if scale.camera is None else scale.camera.pose_at(0.0)
    if pose is None:
        raise InvalidParameterError(
            f"depth from positions needs to know where the camera is: {option('camera')} with camera_to_world"
        )
    matrix = np.asarray(pose)
    away = channels.astype(np.float64) * abs(scale.depth_scale) - matrix[:3, 3]
    planar = -(away @ matrix[:3, 2])
    return np.where(channels.any(axis=2), planar, np.inf).astype(np.float32)


def stored_depth(convention: str, depth: FloatArray, scale: Scale) -> FloatArray:
    """Return the values of a depth channel from planar depth in metres, (H, W) float32: undoes `planar_depth`."""
    return np.asarray(DEPTH_CONVENTIONS[convention][1](depth / np.float32(scale.depth_scale), scale), np.float32)


def background_places(rule: float | str, values: FloatArray) -> BoolArray:
    """Return where stored depths mean background.

    Parameters
    ----------
    rule : float or str
        A number, ``"nan"``, or ``"<X"`` or ``">X"`` for all values beyond a number.
    values : ndarray of any shape
        Stored depths.

    Raises
    ------
    InvalidParameterError
        If the rule is none of these.
    """
    text = str(rule).strip().lower()
    try:
        number = np.float32(text.lstrip("<>"))
    except ValueError:
        raise InvalidParameterError(
            f"{option('background_depth')} is {rule!r}; it must be a number, nan, <X or >X"
        ) from None
    with np.errstate(invalid="ignore"):
        if text.startswith("<"):
            return np.asarray(values < number)
        if text.startswith(">"):
            return np.asarray(values > number)
        return np.asarray(np.isclose(values, number, rtol=HALF_STEP, atol=0, equal_nan=True))


def planar_samples(
    convention: str, values: FloatArray, pixel: npt.NDArray[np.int64], shape: tuple[int, int], scale: Scale
) -> FloatArray:
    """Return planar depth in metres of samples that lie in the pixels of an image.

    Parameters
    ----------
    convention, scale
        As for `planar_depth`.
    values : ndarray of shape (N,), float32
        Stored depths.
    pixel : ndarray of shape (N,), int64
        The pixel of each, in row-major order.
    shape : tuple of int
        Height and width of the image.

    Returns
    -------
    ndarray of shape (N,), float32
    """
    # Every convention is linear in the stored value or in 1 over it, with a factor for each pixel.
    factor = planar_depth(convention, np.ones(shape, np.float32), scale).ravel()[pixel]
    with np.errstate(divide="ignore"):
        return np.asarray(factor / values if convention in RECIPROCAL_DEPTH else factor * values, np.float32)


# --- Motion --------------------------------------------------------------------------------------------------------


LEAST_APPROACH = 0.1
"""Share of its depth that is left of it after a frame, at least, of what moves towards the camera."""


@dataclass(frozen=True)
class MotionConvention:
    """How a renderer's motion channels become px per frame, y down, forward in time.

    Attributes
    ----------
    motion, motion_prev, motion_next : 2 x n matrix or None
        Rows of dx and dy as weights of the n channels; `motion` is None where it is the mean of the other two.
    unit : str
        A key of `MOTION_UNITS`: what one unit of the weighted channels is.
    """

    motion: Matrix | None = None
    motion_prev: Matrix | None = None
    motion_next: Matrix | None = None
    unit: str = "px"

    @property
    def rows(self) -> dict[str, Matrix]:
        """The labels that the channels define, by the names of `Frame`'s parameters."""
        named = {"motion": self.motion, "motion_prev": self.motion_prev, "motion_next": self.motion_next}
        return {name: matrix for name, matrix in named.items() if matrix is not None}

    @property
    def n_channels(self) -> int:
        """How many channels the convention takes."""
        return max(len(matrix[0]) for matrix in self.rows.values())

    @property
    def curved(self) -> bool:
        """Whether the path before and after the frame are stored apart."""
        return self.motion_prev is not None


@dataclass(frozen=True)
class MotionUnit:
    """What a motion channel's values mean.

    Attributes
    ----------
    step, zero : float
        A stored value v stands for ``v * step - zero``.
    per_image : float
        What 1 stands for, in widths (dx) and heights (dy) of the image; 0 for px.
    limited : bool
        Whether 1 stands for the option `max_displacement`.
    quantised : int
        Number of integer codes between a stored 0 and 1, or 0 if every value can be stored.
    """

    step: float = 1.0
    zero: float = 0.0
    per_image: float = 0.0
    limited: bool = False
    quantised: int = 0


MOTION_UNITS: Mapping[str, MotionUnit] = {
    "px": MotionUnit(),
    # Normalised device coordinates: -1 and 1 are the image's borders.
    "ndc": MotionUnit(per_image=0.5),
    # Image coordinates from 0 to 1.
    "uv": MotionUnit(per_image=1.0),
    # Grey 0.5 is at rest, 0 and 1 are the largest displacement.
    "norm": MotionUnit(step=2.0, zero=1.0, limited=True),
    # RE:Vision's integer images, read as floats from 0 to 1: codes 0..254 around 127, and 0..65534 around 32767.
    "norm8": MotionUnit(step=255 / 127, zero=1.0, limited=True, quantised=255),
    "norm16": MotionUnit(step=65535 / 32767, zero=1.0, limited=True, quantised=65535),
    # Grey 0.5 is at rest, 0 and 1 are the width or height of the image.
    "grey": MotionUnit(step=2.0, zero=1.0, per_image=1.0),
    # Velocity of the surface in camera space, depth units per frame; handled by `_projected`.
    "space": MotionUnit(),
}


def _straight_conventions() -> dict[str, MotionConvention]:
    """Return every pairing of direction, unit and orientation, such as ``backward-ndc-up``."""
    rows = {}
    units = [unit for unit in MOTION_UNITS if unit != "space"]
    for direction, unit, up in itertools.product(("forward", "backward"), units, (False, True)):
        sign = 1.0 if direction == "forward" else -1.0
        name = f"{direction}-{unit}" + ("-up" if up else "")
        rows[name] = MotionConvention(((sign, 0.0), (0.0, -sign if up else sign)), unit=unit)
    return rows


MOTION_CONVENTIONS: Mapping[str, MotionConvention] = {
    # XY = P(prev) - P(cur), ZW = P(cur) - P(next), px per frame, y up.
    "blender": MotionConvention(
        motion_prev=((-1, 0, 0, 0), (0, 1, 0, 0)),
        motion_next=((0, 0, -1, 0), (0, 0, 0, 1)),
    ),
    # Our own with a curved path, as `write_frame` stores it: px per frame, y down, forward in time.
    "curved-px": MotionConvention(
        motion=((1, 0, 0, 0, 0, 0), (0, 1, 0, 0, 0, 0)),
        motion_prev=((0, 0, 1, 0, 0, 0), (0, 0, 0, 1, 0, 0)),
        motion_next=((0, 0, 0, 0, 1, 0), (0, 0, 0, 0, 0, 1)),
    ),
    # forward.u, .v = P(next) - P(cur) and backward.u, .v = P(prev) - P(cur), px per frame, y up.
    "nuke": MotionConvention(
        motion_prev=((0, 0, -1, 0), (0, 0, 0, 1)),
        motion_next=((1, 0, 0, 0), (0, -1, 0, 0)),
    ),
    "nuke-forward": MotionConvention(((1, 0), (0, -1))),
    "nuke-backward": MotionConvention(((-1, 0), (0, 1))),
    # Three channels: velocity in camera space, x right, y up, z away from the camera, depth units per frame.
    "camera-velocity": MotionConvention(((1, 0, 0), (0, -1, 0)), unit="space"),
    # Six channels: the same of the object, and of what the camera's own motion adds.
    "camera-velocity-sum": MotionConvention(((1, 0, 0, 1, 0, 0), (0, -1, 0, 0, -1, 0)), unit="space"),
    # -1..1 over the image, per frame, y up.
    "ndc": MotionConvention(((1, 0), (0, -1)), unit="ndc"),
    **_straight_conventions(),
}
"""Motion conventions by the name that the `motion_convention` option takes.

Most are named ``DIRECTION-UNIT[-up]``. DIRECTION: ``forward`` is P(next) - P(cur), ``backward`` is P(prev) - P(cur).
UNIT: ``px`` per frame; ``ndc`` -1..1 and ``uv`` 0..1 over the image; ``norm`` (floats), ``norm8`` and ``norm16``
(integer codes) are normalised by `max_displacement`, ``grey`` by the image's size. ``-up`` where y points up.
"""


def motion_labels(
    name: str, channels: FloatArray, depth: FloatArray, scale: Scale, shape: tuple[int, int] | None = None
) -> dict[str, FloatArray]:
    """Return the motion arrays that a convention defines, by the names of `Frame`'s parameters.

    Parameters
    ----------
    name : str
        A key of `MOTION_CONVENTIONS`.
    channels : ndarray of shape (H, W, n), float32
        The channels' values in the convention's order.
    depth : ndarray of shape (H, W), float32
        Planar depth in metres, for velocities in space.
    scale : Scale
        Camera and largest displacement, as far as the convention needs them.
    shape : tuple of int, optional
        Height and width of the image, if the arrays hold something else than its pixels.

    Returns
    -------
    dict of str to ndarray of shape (H, W, 2), float32
        px per frame, y down, forward in time. From a velocity in space that is not all parallel to the image, also
        `depth_prev` and `depth_next`, (H, W), metres.

    Raises
    ------
    InvalidParameterError
        If the convention needs something that `scale` lacks.
    """
    convention = MOTION_CONVENTIONS[name]
    if convention.unit == "space":
        if shape is not None:
            raise InvalidParameterError(f"{option('motion_convention')} {name} is for flat images only")
        return {"motion": _projected(channels, depth, scale), **_depths_around(channels, depth, scale)}
    unit = MOTION_UNITS[convention.unit]
    values = channels if unit == MotionUnit() else np.float32(unit.step) * channels - np.float32(unit.zero)
    factors = _px_per_unit(name, shape or channels.shape[:2], scale)
    found = {label: _combined(values, matrix) for label, matrix in convention.rows.items()}
    for motion in found.values():
        motion *= factors
    return found


def stored_motion(name: str, labels: Mapping[str, FloatArray], depth: FloatArray, scale: Scale) -> FloatArray:
    """Return the channels that store motion labels: undoes `motion_labels`.

    Parameters
    ----------
    name, depth, scale
        As for `motion_labels`.
    labels : mapping of str to ndarray of shape (H, W, 2)
        Every label that the convention stores.

    Returns
    -------
    ndarray of shape (H, W, n), float32
        Rounded to the codes of ``norm8`` and ``norm16``.

    Raises
    ------
    InvalidParameterError
        If the convention needs something that `scale` lacks, or a motion exceeds what integer codes can hold.
    """
    # Unproject the motion into a velocity in space, if that is what is stored.
    convention = MOTION_CONVENTIONS[name]
    if convention.unit == "space":
        velocity = _unprojected(labels["motion"], depth, scale)
        return np.pad(velocity, ((0, 0), (0, 0), (0, convention.n_channels - velocity.shape[2])))
    # Undo the signs and the order of the channels.
    unit = MOTION_UNITS[convention.unit]
    factors = _px_per_unit(name, depth.shape, scale)
    stacked = np.concatenate([labels[label] / factors for label in convention.rows], axis=2)
    inverse = np.linalg.inv(np.concatenate(list(convention.rows.values())))  # of a signed permutation: exact
    values = stacked @ inverse.T.astype(np.float32)
    # Encode, if the range suffices.
    if unit.quantised and np.abs(values).max() > 1:
        longest = float(np.abs(stacked * np.tile(factors, len(convention.rows))).max())
        raise InvalidParameterError(
            f"{option('max_displacement')} is {scale.max_displacement:g} px, but the frame moves by {longest:g} px"
        )
    stored = (values + np.float32(unit.zero)) / np.float32(unit.step)
    if unit.quantised:
        stored = np.rint(stored * unit.quantised) / unit.quantised
    return np.asarray(stored, np.float32)


def _px_per_unit(name: str, shape: tuple[int, ...], scale: Scale) -> FloatArray:
    """Return what one unit of dx and of dy is in px, (2,)."""
    unit = MOTION_UNITS[MOTION_CONVENTIONS[name].unit]
    if unit.limited:
        return np.full(2, scale.displacement(name), np.float32)
    if unit.per_image:
        height, width = scale.raster_of(shape).display.shape
        return np.array([width, height], np.float32) * np.float32(unit.per_image)
    return np.ones(2, np.float32)


def _combined(channels: FloatArray, matrix: Matrix) -> FloatArray:
    """Return weighted sums of channels, (H, W, 2); a channel of weight zero is not touched, so its NaN stays out."""
    result = np.zeros((*channels.shape[:2], 2), np.float32)
    for axis, weights in enumerate(matrix):
        for index, weight in enumerate(weights):
            if weight:
                result[..., axis] += np.float32(weight) * channels[..., index]
    return result


def _projected(velocity: FloatArray, depth: FloatArray, scale: Scale) -> FloatArray:
    """Return the motion in the image of points that move in space: the derivative of the perspective projection."""
    focal_px, x, y, z = _perspective(depth, scale)
    vx, vy, vz = (velocity[..., axis::3].sum(axis=2, dtype=np.float64) for axis in range(3))
    with np.errstate(invalid="ignore"):  # empty pixels may hold anything; visible ones are checked by `Frame`
        dx, dy = (focal_px * vx - x * vz) / z, (-focal_px * vy - y * vz) / z
        return np.stack([dx, dy * scale.raster_of(depth.shape).pixel_aspect], axis=2).astype(np.float32)


def _depths_around(velocity: FloatArray, depth: FloatArray, scale: Scale) -> dict[str, FloatArray]:
    """Return the depths one frame before and after of points that move in space; none if all keep theirs."""
    away = velocity[..., 2::3].sum(axis=2, dtype=np.float64) * abs(scale.depth_scale)
    if not np.nan_to_num(away).any():
        return {}
    # What passes the camera within a frame is held before it.
    before, after = (np.maximum(depth + way, LEAST_APPROACH * depth) for way in (-away, away))
    return {"depth_prev": before.astype(np.float32), "depth_next": after.astype(np.float32)}


def _unprojected(motion: FloatArray, depth: FloatArray, scale: Scale) -> FloatArray:
    """Return a velocity parallel to the image that projects to a motion, (H, W, 3)."""
    focal_px, _, _, z = _perspective(depth, scale)
    vx, vy = motion[..., 0] * z / focal_px, -motion[..., 1] / scale.raster_of(depth.shape).pixel_aspect * z / focal_px
    return np.stack([vx, vy, np.zeros_like(vx)], axis=2).astype(np.float32)


def _perspective(
    depth: FloatArray, scale: Scale
) -> tuple[float, npt.NDArray[np.float64], npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Return the focal length in px, the pixels' places from the centre, px, and depth in the file's units."""
    focal_px = scale.focal_length_px(depth.shape, f"{option('motion_convention')} camera-velocity")
    x, y = _offsets_from_centre(depth.shape, scale)
    return focal_px, x, y, np.minimum(depth, FAR).astype(np.float64) / abs(scale.depth_scale)


# --- Renderers -----------------------------------------------------------------------------------------------------

ChannelNames = tuple[str, ...]


@dataclass(frozen=True)
class Preset:
    """The channels of one renderer; names are compared without regard to case, behind any layer prefix.

    Attributes
    ----------
    depth : tuple of (name, convention)
        Depth channels, the preferred one first; the first is what `write_frame` writes.
    motion : tuple of (names, convention)
        Sets of motion channels, the fullest first.
    colour : str
        What stands before R, G, B, A.
    prefix : str
        What `write_frame` puts before every name.
    depth_doubt, motion_doubt : str
        What was not verified about this renderer; the user is warned.
    """

    depth: tuple[tuple[str, str], ...]
    motion: tuple[tuple[ChannelNames, str], ...]
    colour: str = ""
    prefix: str = ""
    depth_doubt: str = ""
    motion_doubt: str = ""


OWN = Preset(
    (("Z", "planar"),),
    (
        (("motion.x", "motion.y", "motion_prev.x", "motion_prev.y", "motion_next.x", "motion_next.y"), "curved-px"),
        (("motion.x", "motion.y"), "forward-px"),
    ),
)
"""What `write_frame` writes when it is given no preset."""

PRESETS: Mapping[str, Preset] = {
    # Measured on Cycles 5. Older releases stored the distance along the ray: depth_convention ray.
    "blender": Preset(
        (("Depth.Z", "planar"), ("Depth.V", "planar")),
        (
            (("Vector.X", "Vector.Y", "Vector.Z", "Vector.W"), "blender"),
            (("Vector.X", "Vector.Y"), "backward-px-up"),  # of three channels the third is half of the way to the next
        ),
        colour="Combined.",
        prefix="ViewLayer.",
    ),
    "arnold": Preset(
        (("Z", "planar"),),
        (
            (("motionvector.R", "motionvector.G"), "forward-px-up"),
            (("motionvector.X", "motionvector.Y"), "forward-px-up"),
        ),
        motion_doubt="Arnold's motionvector is taken for px per frame, forward, y up; it depends on the camera's "
        "instantaneous shutter",
    ),
    # dPdtime leaves the camera's own motion out; dPcameradtime holds it.
    "renderman": Preset(
        (("z", "planar"),),
        (
            (
                ("dPdtime.r", "dPdtime.g", "dPdtime.b", "dPcameradtime.r", "dPcameradtime.g", "dPcameradtime.b"),
                "camera-velocity-sum",
            ),
            (("dPdtime.r", "dPdtime.g", "dPdtime.b"), "camera-velocity"),
        ),
        motion_doubt="RenderMan's dPdtime is taken for camera space per frame, forward, y up; without dPcameradtime it "
        "lacks the camera's own motion",
    ),
    # Grey is at rest; the render element's Max Velocity is `max_displacement`.
    "vray": Preset(
        (("Z", "planar"),),
        (
            (("velocity.R", "velocity.G"), "forward-norm-up"),
            (("velocity.X", "velocity.Y"), "forward-norm-up"),
        ),
        depth_doubt="V-Ray's Z is taken for planar metres",
        motion_doubt="V-Ray's velocity is taken for normalised, forward, y up",
    ),
    "redshift": Preset(
        (("Z", "planar"),),
        (
            (("MotionVectors.R", "MotionVectors.G"), "forward-px-up"),
            (("MotionVectors.X", "MotionVectors.Y"), "forward-px-up"),
        ),
        depth_doubt="Redshift's Z is taken for planar metres",
        motion_doubt="Redshift's motion vectors are taken for raw px per frame, forward, y up",
    ),
    "karma": Preset(
        (("ray:hitPz", "planar"), ("hitPz", "planar"), ("ray:hitdist", "ray"), ("hitdist", "ray")),
        (
            (("ray:motionvector.x", "ray:motionvector.y"), "forward-px-up"),
            (("ray:motionvector.R", "ray:motionvector.G"), "forward-px-up"),
        ),
        motion_doubt="Karma's raster-space motionvector is taken for px per frame, forward, y up",
    ),
    # Nuke's own ScanlineRender writes 1/Z.
    "nuke": Preset(
        (("depth.Z", "inverse"),),
        (
            (("forward.u", "forward.v", "backward.u", "backward.v"), "nuke"),
            (("forward.u", "forward.v"), "nuke-forward"),
            (("backward.u", "backward.v"), "nuke-backward"),
        ),
    ),
    "unreal": Preset(
        (("FinalImageMovieRenderQueue_WorldDepth.R", "planar"), ("WorldDepth.R", "planar")),
        (
            (
                ("FinalImageMovieRenderQueue_MotionVectors.R", "FinalImageMovieRenderQueue_MotionVectors.G"),
                "forward-grey",
            ),
        ),
        depth_doubt="Unreal's WorldDepth is taken for planar metres; Unreal counts in centimetres (depth scale 0.01)",
        motion_doubt="Unreal's MotionVectors are taken for forward, y down, grey at rest, one image wide",
    ),
    "octane": Preset(
        (("Z depth.R", "planar"), ("Z-depth.R", "planar"), ("Zdepth.R", "planar")),
        (
            (("Motion vector.R", "Motion vector.G"), "forward-px-up"),
            (("MotionVector.R", "MotionVector.G"), "forward-px-up"),
        ),
        depth_doubt="Octane's Z depth is taken for planar metres",
        motion_doubt="Octane's motion vectors are taken for px per frame, forward, y up",
    ),
    "3dsmax": Preset(
        (("Z", "planar"),),
        ((("velX", "velY"), "forward-px-up"),),
        motion_doubt="3ds Max's velX and velY are taken for px per frame, forward, y up",
    ),
}
"""Renderers by the name that the `preset` option takes."""

DEPTH_LAYERS = ("depth", "zdepth", "z_depth", "depth_main", "VRayZDepth", "dd", "Pz")
DEPTH_COMPONENTS = ("", ".Z", ".V", ".R", ".Y", ".red")
"""Many programs name depth by one of these layers and components."""

UNCLEAR = Preset(
    tuple((layer + component, "planar") for layer in DEPTH_LAYERS for component in DEPTH_COMPONENTS),
    (
        (("motion.u", "motion.v"), "forward-px-up"),
        (("motionvector.u", "motionvector.v"), "forward-px-up"),
        (("motion.R", "motion.G"), "forward-px-up"),
    ),
    depth_doubt="depth whose program its name does not tell is taken for planar metres",
    motion_doubt="two-channel motion whose direction its name does not tell is taken for px per frame, forward, y up",
)
"""Names that several programs use, each with its own meaning."""

# What looks like depth, motion or alpha though no table has its name, in lower case.
DEPTH_LIKE = re.compile(r"depth|dist|(^|[._ ])(z|pz|hitpz|zbuf\w*)([._ ]\w{1,5})?$")
MOTION_LIKE = re.compile(
    r"motion|veloc|vector|forward|backward|flow|mvec|(^|[._ ])(mv|vel)([._ ]?[xyzuvrgb])?([._ ]|$)"
)
ALPHA_LIKE = re.compile(r"(^|[._ ])(a|alpha|opacity|coverage)$")


def check_choice(name: str, value: str | None, allowed: Mapping[str, object]) -> None:
    """Raise InvalidParameterError unless an option that was given has one of its values."""
    if value is not None and value not in allowed:
        raise InvalidParameterError(f"{option(name)} is {value!r}; allowed are {', '.join(allowed)}")
