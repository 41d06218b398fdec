"""A photograph and its depth map: with the blur of a lens wider than the one that took it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import FloatArray
from spreadlets.bokeh import Progress
from spreadlets.errors import InvalidFrameError, InvalidParameterError, option
from spreadlets.photograph.depth_map import DepthKind, inverse_depth, refined
from spreadlets.photograph.grain import grain_of, grained
from spreadlets.psf.database import Database
from spreadlets.renderer import Renderer
from spreadlets.runtime.clock import Clock
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.display import display_decode, display_encode
from spreadlets.scene.frame import Frame, image_array, real_array
from spreadlets.scene.parts import depth_at

if TYPE_CHECKING:
    from spreadlets.models import Model
    from spreadlets.runtime.options import RenderOptions

DEFAULT_BLUR = 25.0
FOCAL_LENGTH_MM, SENSOR_MM = 50.0, 36.0
"""Of the lens that stands for any other: what counts is how the blur grows with inverse depth."""
FARTHEST = 0.05
"""Inverse depth, 1/m, that the farthest pixel is given where the scale is unknown; the nearest has 1."""


def photo(
    rgb: npt.ArrayLike,
    depth: npt.ArrayLike,
    *,
    focus: Sequence[float],
    blur: float | None = None,
    f_number: float | None = None,
    focal_length: float | None = None,
    depth_kind: DepthKind = "inverse",
    refine: bool = True,
    grain: bool = False,
    database: Database | Model | str | None = None,
    progress: Progress | None = None,
    clock: Clock | None = None,
    **options: Unpack[RenderOptions],
) -> npt.NDArray[Any]:
    """Give a photograph the depth of field of another lens.

    Parameters
    ----------
    rgb : array_like of shape (H, W, 3)
        The photograph: 8- or 16-bit integers in sRGB encoding, or linear floats.
    depth : array_like of shape (h, w)
        Its depth; stretched if it has another size.
    focus : sequence of two or four floats
        A point ``(x, y)``, or a box ``(left, top, right, bottom)`` with whatever is to be sharp, px of the photograph.
    blur : float, optional
        Radius of the blur at the far end, px, or at the near end if that is farther from the focus; 25 by default.
    f_number : float, optional
        In place of `blur`, for depths in metres: that of a full-frame camera.
    focal_length : float, optional
        With `f_number`: for a film 36 mm wide, mm; 50 by default.
    depth_kind : {"inverse", "metric", "disparity"}
        Inverse depth as networks predict it and disparity, both of unknown scale and offset, larger is nearer; or
        metres.
    refine : bool
        Whether to move the edges of the depth to those of the photograph.
    grain : bool
        Whether to give what is blurred the grain of the photograph.
    database : Database, Model or str, optional
        The lens, see `synthesize`; by default a round aperture.
    progress : callable, optional
        Told how far the lens is built, if it is; see `Renderer`.
    clock : Clock, optional
        Adds the times of the steps to those that the caller has already taken.
    options
        Of `synthesize`; ``highlights=(gain, threshold)`` gives clipped light back, a ``mask`` keeps a subject sharp.

    Returns
    -------
    ndarray of shape (H, W, 3)
        Of the type of `rgb`, and encoded as that.

    Raises
    ------
    InvalidFrameError
        If an array has a wrong shape or values.
    InvalidParameterError
        If a parameter is out of its range, an f-number is given beside `blur` or for depths of unknown scale, or a
        focal length without an f-number.

    Examples
    --------
    >>> import numpy as np
    >>> rgb = np.random.default_rng(0).integers(0, 256, (48, 64, 3), np.uint8)
    >>> near = np.zeros((48, 64))
    >>> near[16:32, 20:40] = 1.0
    >>> image = sp.photo(rgb, near, focus=(30, 24), blur=4)
    >>> image.dtype, image.shape
    (dtype('uint8'), (48, 64, 3))
    >>> bool(image[:10].std() < 0.5 * rgb[:10].std())  # what lies behind is blurred
    True
    """
    _check_lens(blur, f_number, focal_length)
    codes, clock = np.asarray(rgb), clock or Clock()
    with clock.step("plan"):
        linear = _linear(codes)
        encoded = _encoded(codes, linear) if refine or grain else None
        depths, known = _inverse(real_array("depth", depth), depth_kind, linear.shape[:2], encoded if refine else None)
        if f_number is None:
            camera = blurring_camera(depths, _focus(depths, focus), DEFAULT_BLUR if blur is None else blur)
        elif not known:
            raise InvalidParameterError(
                f"{option('f_number')} needs depths in metres ({option('depth_kind')} metric); of an unknown scale, "
                f"give {option('blur')}"
            )
        else:
            lens = FOCAL_LENGTH_MM if focal_length is None else focal_length, SENSOR_MM, f_number
            camera = ThinLens(*lens, _distance(_focus(depths, focus)), sensor_fit="auto")
        deviation = grain_of(encoded) if grain and encoded is not None else None
        with np.errstate(divide="ignore"):
            frame = Frame(linear, np.float32(1.0) / depths)
    # Of a large photograph each plane counts.
    del linear, encoded, depths
    with Renderer(frame, database or "simplelens", progress=progress) as renderer:
        image = renderer.render(camera, clock=clock, **options)[..., :3]
        coc = None if deviation is None else renderer.coc(camera, **options)
    return _coded(image if coc is None or deviation is None else grained(image, deviation, coc), codes.dtype)


def _inverse(
    depth: FloatArray, kind: DepthKind, shape: tuple[int, ...], guide: FloatArray | None
) -> tuple[FloatArray, bool]:
    """Return the inverse depth of each pixel, 1/m, and whether its scale is known; else the nearest pixel is at 1 m.

    Edges are moved to those of the guide, the photograph as displayed, if there is one.
    """
    inverse, least, most = inverse_depth(depth, kind, (shape[0], shape[1]))
    if guide is not None:
        inverse = refined(inverse, guide)
    if kind != "metric":
        least, most = FARTHEST, 1.0
    return np.maximum(np.float32(most - least) * inverse + np.float32(least), np.float32(0.0)), kind == "metric"


def blurring_camera(inverse: FloatArray, focus: float, blur: float) -> ThinLens:
    """Return a camera that blurs the end of some inverse depths (H, W), 1/m, that is farther from focus, by a radius.

    Raises
    ------
    InvalidParameterError
        If the radius is not above 0.
    """
    if not 0.0 < blur < np.inf:
        raise InvalidParameterError(f"{option('blur')} is {blur:g}: needed is a radius above 0 px")
    scale = blur / max(focus - float(inverse.min()), float(inverse.max()) - focus)
    focal_length_px = FOCAL_LENGTH_MM / SENSOR_MM * inverse.shape[1]
    f_number = 0.5 * FOCAL_LENGTH_MM / 1000.0 * focal_length_px / scale
    return ThinLens(FOCAL_LENGTH_MM, SENSOR_MM, f_number, _distance(focus))


def _distance(inverse: float) -> float:
    """Return the distance, m, of an inverse depth, 1/m; the sky's is infinite."""
    return 1.0 / inverse if inverse > 0.0 else np.inf


def _check_lens(blur: float | None, f_number: float | None, focal_length: float | None) -> None:
    """Raise InvalidParameterError if what is given of the lens does not go together."""
    if blur is not None and f_number is not None:
        raise InvalidParameterError(f"{option('blur')} and {option('f_number')} exclude each other: give one of them")
    if focal_length is not None and f_number is None:
        raise InvalidParameterError(f"{option('focal_length')} is for {option('f_number')}: give it, too")


def _linear(codes: npt.NDArray[Any]) -> FloatArray:
    """Return a photograph as linear light."""
    if codes.dtype.kind in "iu" and not _is_encoded(codes.dtype):
        raise InvalidFrameError(
            f"rgb has dtype {codes.dtype}; it must hold uint8 or uint16 in sRGB encoding, or linear floats"
        )
    linear = display_decode(codes) if _is_encoded(codes.dtype) else codes
    return np.ascontiguousarray(image_array("rgb", linear)[..., :3])


def _encoded(codes: npt.NDArray[Any], linear: FloatArray) -> FloatArray:
    """Return a photograph as it is displayed, 0 to 1."""
    if _is_encoded(codes.dtype):
        return np.asarray(np.divide(codes[..., :3], np.iinfo(codes.dtype).max, dtype=np.float32))
    return np.asarray(display_encode(linear), np.float32)


def _is_encoded(kind: np.dtype[Any]) -> bool:
    return kind.kind == "u" and kind.itemsize <= 2


def _coded(image: FloatArray, kind: np.dtype[Any]) -> npt.NDArray[Any]:
    """Return linear light in the type of a photograph."""
    if not _is_encoded(kind):
        return np.ascontiguousarray(image)
    return np.asarray(np.rint(np.iinfo(kind).max * display_encode(image)), kind)


def _focus(inverse: FloatArray, focus: Sequence[float]) -> float:
    """Return the inverse depth of what is to be sharp."""
    from spreadlets.scene.raster import Raster

    height, width = inverse.shape
    if np.shape(focus) not in ((2,), (4,)):
        raise InvalidParameterError(f"{option('focus')} is {focus!r}: needed are x,y or left,top,right,bottom")
    with np.errstate(divide="ignore"):
        if len(focus) == 2:
            return float(1.0 / depth_at(1.0 / inverse, Raster.of_shape((height, width)), *focus))
    left, top, right, bottom = (round(each) if math.isfinite(each) else -1 for each in focus)
    if not (0 <= left < right <= width and 0 <= top < bottom <= height):
        raise InvalidParameterError(
            f"{option('focus')} is {tuple(focus)}: the box must lie within {width} x {height} px"
        )
    return float(np.median(inverse[top:bottom, left:right]))
