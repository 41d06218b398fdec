"""A frame of labelled pixels: colour, depth and motion in one or more depth layers, validated once on entry."""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import BoolArray, FloatArray
from spreadlets.errors import AmbiguousInputWarning, InvalidFrameError, option
from spreadlets.scene.display import display_decode
from spreadlets.scene.raster import Raster, Window, placed

ALPHA_TOLERANCE = 1e-3
"""Alpha may leave [0, 1] by this much and is clipped without a word: half floats near 1 step by 5e-4."""

ALPHA_OVERSHOOT = 0.05
"""Alpha may leave [0, 1] by this much and is clipped with a warning: sharpening pixel filters overshoot."""

LIKE_DEPTH = 1.1
"""Ratio of depths up to which two neighbouring pixels count as one surface when a colour is mended."""

BACKGROUND_DEPTH = np.float32(np.inf)

PlaneChange = Callable[[FloatArray], FloatArray]
"""What is done to a plane of labels."""


@dataclass(frozen=True, eq=False)
class Layer:
    """One depth layer of labelled pixels; made by `Frame`, which validates it.

    Attributes
    ----------
    radiance : ndarray of shape (H, W, 4), float32
        Linear RGB premultiplied by alpha, and alpha in [0, 1].
    depth : ndarray of shape (H, W), float32
        Planar camera-space depth in metres, > 0; ``inf`` is background, and stands where an empty pixel had no depth.
    motion : ndarray of shape (H, W, 2), float32
        ``(dx, dy)`` in px per frame, y down, forward in time, at the label's time; zero where there is none.
    motion_prev, motion_next : ndarray of shape (H, W, 2), float32, or None
        The same over the frame before and the frame after, both forward in time, for a curved path.
    depth_prev, depth_next : ndarray of shape (H, W), float32, or None
        Depth of what the pixel shows, one frame before and one frame after.
    has_motion : bool
        Whether motion was given; if not, `motion` is zero.
    raster : Raster
        Where the pixels lie.
    """

    radiance: FloatArray
    depth: FloatArray
    motion: FloatArray
    motion_prev: FloatArray | None = None
    motion_next: FloatArray | None = None
    depth_prev: FloatArray | None = None
    depth_next: FloatArray | None = None
    has_motion: bool = True
    raster: Raster = field(kw_only=True)

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width in pixels."""
        return self.depth.shape[0], self.depth.shape[1]

    @property
    def depths(self) -> tuple[FloatArray, ...]:
        """The depths that are known: `depth`, and perhaps those one frame before and after."""
        return tuple(each for each in (self.depth, self.depth_prev, self.depth_next) if each is not None)

    @property
    def motions(self) -> tuple[FloatArray, ...]:
        """The motions that are known: `motion`, and for a curved path those over the frames before and after."""
        return tuple(each for each in (self.motion, self.motion_prev, self.motion_next) if each is not None)

    def straight(self) -> Layer:
        """Return the layer as it moves along straight paths at constant depth."""
        return replace(self, motion_prev=None, motion_next=None, depth_prev=None, depth_next=None)

    def mapped(self, depth: PlaneChange, motion: PlaneChange, radiance: FloatArray) -> Layer:
        """Return the layer with each depth and each motion that is known changed, and with another radiance."""
        depths, motions = (self.depth_prev, self.depth_next), (self.motion_prev, self.motion_next)
        depth_prev, depth_next = (None if each is None else depth(each) for each in depths)
        motion_prev, motion_next = (None if each is None else motion(each) for each in motions)
        return replace(
            self,
            radiance=radiance,
            depth=depth(self.depth),
            motion=motion(self.motion),
            motion_prev=motion_prev,
            motion_next=motion_next,
            depth_prev=depth_prev,
            depth_next=depth_next,
        )


class Frame:
    """One or more layers of labelled pixels, nearest first.

    Parameters
    ----------
    radiance : array_like of shape (H, W, 3) or (H, W, 4)
        Linear RGB, or RGB premultiplied by alpha, and alpha in [0, 1]; without alpha every pixel is opaque.
    depth : array_like of shape (H, W)
        Planar camera-space depth in metres, > 0; ``inf`` is background.
    motion : array_like of shape (H, W, 2), optional
        ``(dx, dy)`` in px per frame, y down, forward in time. Without it the mean of `motion_prev` and `motion_next`
        is taken; without those the frame is still.
    motion_prev, motion_next : array_like of shape (H, W, 2), optional
        Motion from the frame before and to the frame after, both forward in time; they come together.
    depth_prev, depth_next : array_like of shape (H, W), optional
        Depth, in metres, of what the pixel shows, one frame before and one frame after, for what moves towards the
        camera or away from it; they come together.
    raster : Raster, optional
        Where the pixels lie: the data window has the arrays' shape. By default all of them are displayed, as squares.
    repair : bool
        Mend offending pixels and count them in `repaired_pixels` instead of raising: a bad depth becomes background, a
        bad motion still, alpha is clipped, and a bad colour is filled from valid neighbours of like depth.

    Raises
    ------
    InvalidFrameError
        If shapes are wrong or disagree, if the radiance is in 8- or 16-bit codes or, unless `repair`, if a pixel has
        non-finite radiance or alpha outside [0, 1] by more than `ALPHA_OVERSHOOT`, or has alpha > 0 and a depth that is
        NaN or <= 0 or motion that is not finite. The message names the array, the first offending pixel as (row,
        col), how many there are, and what is allowed.

    Warns
    -----
    AmbiguousInputWarning
        If alpha leaves [0, 1] by more than rounding does, and is clipped.

    Notes
    -----
    Pixels with alpha 0 may carry any depth and motion: a bad depth becomes ``inf`` there and bad motion becomes zero.
    Contiguous float32 arrays are kept without a copy unless a pixel has to be mended.

    Examples
    --------
    >>> import numpy as np
    >>> frame = sp.Frame(np.ones((4, 6, 3)), depth=np.full((4, 6), 2.0))
    >>> frame
    Frame(4 x 6 px, 1 layer)
    >>> frame.radiance.shape  # alpha was added
    (4, 6, 4)
    >>> sp.Frame(np.ones((4, 6, 3)), depth=np.zeros((4, 6)))
    Traceback (most recent call last):
    spreadlets.errors.InvalidFrameError: depth is zero or negative at 24 of 24 pixels, first at (row 0, col 0); ...
    """

    def __init__(
        self,
        radiance: npt.ArrayLike,
        depth: npt.ArrayLike,
        motion: npt.ArrayLike | None = None,
        *,
        motion_prev: npt.ArrayLike | None = None,
        motion_next: npt.ArrayLike | None = None,
        depth_prev: npt.ArrayLike | None = None,
        depth_next: npt.ArrayLike | None = None,
        raster: Raster | None = None,
        repair: bool = False,
    ) -> None:
        layer = _converted_layer(radiance, depth, (motion, motion_prev, motion_next), raster)
        layer = _with_depths(layer, depth_prev, depth_next)
        layer, self._repaired_pixels, self._dropped_pixels = _validated_layer(layer, repair)
        self._layers: tuple[Layer, ...] = (layer,)

    @classmethod
    def from_layers(cls, layers: Iterable[Frame | tuple[npt.ArrayLike, ...]], *, repair: bool = False) -> Frame:
        """Stack layers into one frame; where data windows differ, each is placed in the smallest that holds all.

        Parameters
        ----------
        layers : iterable of Frame or tuple
            Nearest first; a tuple is ``(radiance, depth)`` or ``(radiance, depth, motion)``.
        repair : bool
            As for `Frame`, applied to the tuples.

        Returns
        -------
        Frame

        Raises
        ------
        InvalidFrameError
            If there is no layer, a layer is invalid, or the layers' display windows or pixel aspects differ; the
            message says which layer.
        """
        frames = [_frame_from_item(index, item, repair) for index, item in enumerate(layers)]
        if not frames:
            raise InvalidFrameError("a frame needs at least one layer; none was given")
        # Check that all are displayed alike.
        first = frames[0].raster
        for index, frame in enumerate(frames):
            if (frame.raster.display, frame.raster.pixel_aspect) != (first.display, first.pixel_aspect):
                raise InvalidFrameError(
                    f"layer {index} is displayed as {_displayed(frame.raster)}, layer 0 as {_displayed(first)}; all "
                    "layers share one display window"
                )
        # Place them in the smallest window that holds all.
        window = functools.reduce(Window.union, (frame.raster.data for frame in frames))
        stored = functools.reduce(Window.union, (frame.raster.stored or frame.raster.data for frame in frames))
        shared = replace(first, data=window, stored=None if stored == window else stored)
        placed_layers = [_placed_layer(layer, shared) for frame in frames for layer in frame.layers]
        repaired, dropped = (
            sum(getattr(frame, name) for frame in frames) for name in ("repaired_pixels", "dropped_pixels")
        )
        return cls.of(placed_layers, dropped, repaired)

    def reaching(self, window: Window) -> Frame:
        """Return the frame with empty pixels around it, in a data window that holds its own."""
        return self._of([_placed_layer(layer, self.raster.reaching(window)) for layer in self.layers])

    def lying_at(self, raster: Raster) -> Frame:
        """Return the frame's pixels elsewhere: in a data window of the same shape, or otherwise displayed.

        Raises
        ------
        InvalidFrameError
            If the data window has another shape.
        """
        check_raster(raster, self.shape)
        return self._of([replace(layer, raster=raster) for layer in self.layers])

    def coloured(self, radiance: FloatArray) -> Frame:
        """Return the frame with another radiance (H, W, 4) in its only layer."""
        return self._of([replace(self._only_layer(), radiance=image_array("radiance", radiance))])

    @classmethod
    def of(cls, layers: Sequence[Layer], dropped_pixels: int = 0, repaired_pixels: int = 0) -> Frame:
        """Return a frame of layers that were made of another frame's, and are valid as those were."""
        made = cls.__new__(cls)
        made._layers, made._dropped_pixels, made._repaired_pixels = tuple(layers), dropped_pixels, repaired_pixels
        return made

    def _of(self, layers: Sequence[Layer]) -> Frame:
        """Return a frame of layers that were made of this one's."""
        return Frame.of(layers, self.dropped_pixels, self.repaired_pixels)

    @property
    def raster(self) -> Raster:
        """Where the pixels of all layers lie, and what the header of the first layer's file says besides."""
        return self._layers[0].raster

    @property
    def layers(self) -> tuple[Layer, ...]:
        """The layers, nearest first."""
        return self._layers

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of the data window in pixels."""
        return self._layers[0].shape

    @property
    def repaired_pixels(self) -> int:
        """How many pixels `repair` mended, over all layers."""
        return self._repaired_pixels

    @property
    def dropped_pixels(self) -> int:
        """How many pixels, or samples of a deep image, `repair` could not mend and made empty, over all layers."""
        return self._dropped_pixels

    @property
    def radiance(self) -> FloatArray:
        """Radiance of the only layer, (H, W, 4) float32; raises InvalidFrameError if there are several layers."""
        return self._only_layer().radiance

    @property
    def depth(self) -> FloatArray:
        """Depth of the only layer, (H, W) float32; raises InvalidFrameError if there are several layers."""
        return self._only_layer().depth

    @property
    def motion(self) -> FloatArray:
        """Motion of the only layer, (H, W, 2) float32; raises InvalidFrameError if there are several layers."""
        return self._only_layer().motion

    def _only_layer(self) -> Layer:
        if len(self._layers) != 1:
            raise InvalidFrameError(f"the frame has {len(self._layers)} layers; take the arrays from .layers")
        return self._layers[0]

    def __repr__(self) -> str:
        height, width = self.shape
        return f"Frame({height} x {width} px, {len(self._layers)} layer{'s' if len(self._layers) > 1 else ''})"


def real_array(name: str, values: npt.ArrayLike) -> FloatArray:
    """Return values as a contiguous float32 array; what float32 cannot hold becomes infinite.

    Parameters
    ----------
    name : str
        What the array is called in the error's message.
    values : array_like
        Integers or floats.

    Raises
    ------
    InvalidFrameError
        If `values` is no array of real numbers, or a masked array with values that are masked.
    """
    try:
        array = np.asarray(values)
    except ValueError as error:
        raise InvalidFrameError(f"{name} is not an array: {error}") from error
    if np.ma.is_masked(values):
        raise InvalidFrameError(f"{name} is masked in places; fill these with values first")
    if array.dtype.kind not in "fiu":
        raise InvalidFrameError(f"{name} has dtype {array.dtype}; it must hold integers or floats")
    with np.errstate(over="ignore"):
        return np.ascontiguousarray(array, dtype=np.float32)


def image_array(name: str, values: npt.ArrayLike) -> FloatArray:
    """Return a colour image as contiguous float32, checked for its shape only.

    Parameters
    ----------
    name : str
        What the array is called in the error's message.
    values : array_like of shape (H, W, 3) or (H, W, 4)
        The image; neither side may be empty.

    Raises
    ------
    InvalidFrameError
        If the shape or the type is another.
    """
    array = real_array(name, values)
    if array.ndim != 3 or array.shape[2] not in (3, 4):
        raise InvalidFrameError(f"{name} has shape {array.shape}; it must be (H, W, 3) or (H, W, 4)")
    if array.size == 0:
        raise InvalidFrameError(f"{name} has shape {array.shape}; it must hold at least one pixel")
    return array


def shown_array(name: str, values: npt.ArrayLike) -> FloatArray:
    """Return a colour image as `image_array` does, linear also where it comes as a picture for display.

    Parameters
    ----------
    name : str
        What the array is called in the error's message.
    values : array_like of shape (H, W, 3) or (H, W, 4)
        Linear radiance; or (H, W, 3) of 8- or 16-bit integers without a sign, in sRGB encoding.

    Raises
    ------
    InvalidFrameError
        If the shape or the type is another.
    """
    array, codes = image_array(name, values), np.asarray(values)
    if codes.dtype not in (np.uint8, np.uint16):
        return array
    if codes.shape[2] != 3:
        raise InvalidFrameError(f"{name} has shape {codes.shape}; a picture of {codes.dtype} must be (H, W, 3)")
    return display_decode(codes)


def check_finite(name: str, array: FloatArray) -> None:
    """Raise InvalidFrameError naming the first pixel and the count if an (H, W, ...) array is not finite."""
    bad = _not_finite(array)
    if bad.any():
        raise InvalidFrameError(Problem(name, "not finite", "finite numbers", bad).message())


class Problem(NamedTuple):
    """What is wrong with which pixels of an array, or with which samples of its pixels."""

    array: str
    what: str
    allowed: str
    places: BoolArray

    def message(self) -> str:
        """Return a line that names the array, the count, the first place, and what is allowed."""
        first = np.unravel_index(int(np.argmax(self.places)), self.places.shape)
        count = int(np.count_nonzero(self.places))
        kind = "pixels" if self.places.ndim == 2 else "samples"
        where = ", ".join(f"{axis} {index}" for axis, index in zip(("row", "col", "sample"), first, strict=False))
        return (
            f"{self.array} is {self.what} at {count} of {self.places.size} {kind}, first at ({where}); "
            f"allowed: {self.allowed}"
        )


def _not_finite(array: FloatArray) -> BoolArray:
    """Return the (H, W) mask of pixels with a non-finite value in any channel."""
    finite = np.isfinite(array)
    # Channel by channel: NumPy takes several times as long along a short last axis.
    return ~(finite if finite.ndim == 2 else functools.reduce(np.logical_and, np.moveaxis(finite, 2, 0)))


def _frame_from_item(index: int, item: Frame | tuple[npt.ArrayLike, ...], repair: bool) -> Frame:
    """Return one entry of `Frame.from_layers` as a frame; errors say which entry it was."""
    if isinstance(item, Frame):
        return item
    if not isinstance(item, tuple) or len(item) not in (2, 3):
        raise InvalidFrameError(
            f"layer {index} is a {type(item).__name__}; it must be a Frame or a tuple (radiance, depth[, motion])"
        )
    try:
        return Frame(*item, repair=repair)
    except InvalidFrameError as error:
        raise InvalidFrameError(f"layer {index}: {error}") from error


def _converted_layer(
    radiance: npt.ArrayLike,
    depth: npt.ArrayLike,
    motions: tuple[npt.ArrayLike | None, npt.ArrayLike | None, npt.ArrayLike | None],
    raster: Raster | None,
) -> Layer:
    """Return a layer of contiguous float32 arrays whose shapes agree; the values are not looked at."""
    # Refuse the codes of a picture.
    colour = image_array("radiance", radiance)
    codes = np.asarray(radiance).dtype
    if codes.kind == "u" and codes.itemsize <= 2:
        raise InvalidFrameError(
            f"radiance holds {8 * codes.itemsize}-bit integers, as a picture for display does; a frame holds linear "
            f"values: divide by {2 ** (8 * codes.itemsize) - 1} and undo the display's encoding"
        )
    # Give colours an alpha.
    height, width = colour.shape[:2]
    raster = raster or Raster.of_shape((height, width))
    check_raster(raster, (height, width))
    motion, motion_prev, motion_next = motions
    if colour.shape[2] == 3:
        colour = np.concatenate([colour, np.ones((height, width, 1), np.float32)], axis=2)
    # Check that the labels fit, and that the curved motions come together.
    z = _label_array("depth", depth, (height, width))
    if (motion_prev is None) != (motion_next is None):
        lacking = "motion_prev" if motion_prev is None else "motion_next"
        raise InvalidFrameError(f"{lacking} is missing; motion_prev and motion_next come together")
    named = {"motion": motion, "motion_prev": motion_prev, "motion_next": motion_next}
    given = {
        name: _label_array(name, values, (height, width, 2)) for name, values in named.items() if values is not None
    }
    # Take the mean of both for a motion that is not given.
    before, after = given.get("motion_prev"), given.get("motion_next")
    if "motion" not in given and before is not None and after is not None:
        with np.errstate(invalid="ignore"):  # infinities of both signs: found by the validation
            given["motion"] = 0.5 * before + 0.5 * after
    path = given["motion"] if "motion" in given else np.zeros((height, width, 2), np.float32)
    return Layer(colour, z, path, before, after, has_motion=bool(given), raster=raster)


def _with_depths(layer: Layer, depth_prev: npt.ArrayLike | None, depth_next: npt.ArrayLike | None) -> Layer:
    """Return a layer with the depths of the frame before and after."""
    if (depth_prev is None) != (depth_next is None):
        lacking = "depth_prev" if depth_prev is None else "depth_next"
        raise InvalidFrameError(f"{lacking} is missing; depth_prev and depth_next come together")
    if depth_prev is None or depth_next is None:
        return layer
    before, after = (
        _label_array("depth_prev", depth_prev, layer.shape),
        _label_array("depth_next", depth_next, layer.shape),
    )
    return replace(layer, depth_prev=before, depth_next=after)


def check_raster(raster: Raster, shape: tuple[int, int]) -> None:
    """Raise InvalidFrameError unless a raster's data window has the shape of the pixels (H, W)."""
    if raster.data.shape != shape:
        raise InvalidFrameError(f"the data window has the shape {raster.data.shape}, the pixels {shape}")


def _placed_layer(layer: Layer, raster: Raster) -> Layer:
    """Return a layer as it lies in another data window, with empty pixels where it does not reach."""
    if layer.raster == raster:
        return layer
    place = functools.partial(placed, window=layer.raster.data, target=raster.data)
    beyond = functools.partial(place, fill=float(BACKGROUND_DEPTH))
    return replace(layer.mapped(beyond, place, place(layer.radiance)), raster=raster)


def _displayed(raster: Raster) -> str:
    """Return what errors say of a display window."""
    left, top, width, height = raster.display
    shape = "" if raster.pixel_aspect == 1 else f", pixel aspect {raster.pixel_aspect:g}"
    return f"{width} x {height} px at ({left}, {top}){shape}"


def _label_array(name: str, values: npt.ArrayLike, shape: tuple[int, ...]) -> FloatArray:
    """Return a label as contiguous float32 of the shape that the radiance demands."""
    array = real_array(name, values)
    if array.shape != shape:
        raise InvalidFrameError(f"{name} has shape {array.shape}, but the radiance asks for {shape}")
    return array


def _validated_layer(layer: Layer, repair: bool) -> tuple[Layer, int, int]:
    """Return the layer with clipped alpha and mended labels, and how many pixels were mended and how many dropped."""
    # Find what is not finite or not allowed.
    problems = _problems(layer)
    if problems and not repair:
        raise InvalidFrameError(f"{problems[0].message()} (or {option('repair')}, which mends these pixels)")
    bad = (
        np.logical_or.reduce([problem.places for problem in problems]) if problems else np.zeros(layer.shape, np.bool_)
    )
    # Background where the depth is no distance; colours from their neighbours.
    depth = replaced(layer.depth, ~(layer.depth > 0), BACKGROUND_DEPTH)
    radiance, dropped = _filled(layer.radiance, depth) if problems else (layer.radiance, 0)
    before, after = layer.motion_prev, layer.motion_next
    # No motion where it is not finite.
    mended = replace(
        layer,
        radiance=_clipped(radiance, quiet=repair),
        depth=depth,
        motion=replaced(layer.motion, _not_finite(layer.motion), np.float32(0)),
        motion_prev=None if before is None else replaced(before, _not_finite(before), np.float32(0)),
        motion_next=None if after is None else replaced(after, _not_finite(after), np.float32(0)),
        depth_prev=_distances(layer.depth_prev, depth),
        depth_next=_distances(layer.depth_next, depth),
    )
    return mended, int(np.count_nonzero(bad)) - dropped, dropped


def _distances(other: FloatArray | None, depth: FloatArray) -> FloatArray | None:
    """Return the depths of another frame, this one's where they are no distances."""
    return None if other is None else np.where(other > 0, other, depth)


def _clipped(radiance: FloatArray, *, quiet: bool) -> FloatArray:
    """Return the radiance with alpha in [0, 1]; a warning tells where it left that by more than rounding does."""
    alpha = radiance[..., 3]
    if not ((alpha < 0) | (alpha > 1)).any():
        return radiance
    outside = int(np.count_nonzero((alpha < -ALPHA_TOLERANCE) | (alpha > 1 + ALPHA_TOLERANCE)))
    if outside and not quiet:
        warnings.warn(
            f"alpha is {alpha.min():.3g} to {alpha.max():.3g}, as sharpening filters make it, outside 0 to 1 at "
            f"{outside} pixels; it is clipped",
            AmbiguousInputWarning,
            stacklevel=5,
        )
    radiance = radiance.copy()
    radiance[..., 3] = np.clip(alpha, 0, 1)
    return radiance


def _filled(radiance: FloatArray, depth: FloatArray) -> tuple[FloatArray, int]:
    """Return the radiance with bad colours filled, ring by ring, from the valid neighbours that are nearest in depth.

    Neighbours within `LIKE_DEPTH` of the nearest in depth are averaged. Where there is no valid pixel at all, pixels
    are dropped; their number is returned.
    """
    valid = ~_not_finite(radiance)
    if not valid.any():
        return np.zeros_like(radiance), valid.size
    radiance = radiance.copy()
    inverse = np.pad(np.float32(1) / depth, 1)
    while not valid.all():
        shown, there = np.pad(radiance, ((1, 1), (1, 1), (0, 0))), np.pad(valid, 1)
        # Find the bad pixels that have a valid neighbour.
        rows, cols = np.nonzero(~valid)
        steps = [(row, col) for row in range(3) for col in range(3) if (row, col) != (1, 1)]
        around = np.stack([there[rows + row, cols + col] for row, col in steps])
        filled = around.any(axis=0)
        rows, cols, around = rows[filled], cols[filled], around[:, filled]
        # Choose the neighbours nearest in depth.
        own = inverse[rows + 1, cols + 1]
        other = np.stack([inverse[rows + row, cols + col] for row, col in steps])
        apart = np.where(around, np.abs(other - own), np.inf)
        chosen = around & (apart <= apart.min(axis=0) + (LIKE_DEPTH - 1) * own)
        # Fill in their mean.
        colours = np.stack([shown[rows + row, cols + col] for row, col in steps])
        weight = chosen[..., None].astype(np.float32)
        radiance[rows, cols] = np.where(weight > 0, colours, 0).sum(axis=0) / weight.sum(axis=0)
        valid[rows, cols] = True
    return radiance, 0


def _problems(layer: Layer) -> list[Problem]:
    """Return what is wrong with a layer's values, one array and kind at a time."""
    checks = [Problem("radiance", "not finite", "finite linear values", _not_finite(layer.radiance))]
    alpha = layer.radiance[..., 3]
    wrong_alpha = (alpha < -ALPHA_OVERSHOOT) | (alpha > 1 + ALPHA_OVERSHOOT)
    checks.append(Problem("alpha (the fourth channel of radiance)", "out of range", "0 to 1", wrong_alpha))
    visible = alpha > 0
    metres = "metres > 0, or inf for background" + _turned(layer.depth, visible)
    checks.append(Problem("depth", "NaN", metres, visible & np.isnan(layer.depth)))
    checks.append(Problem("depth", "zero or negative", metres, visible & (layer.depth <= 0)))
    for name, other in (("depth_prev", layer.depth_prev), ("depth_next", layer.depth_next)):
        if other is not None:
            checks.append(Problem(name, "not a distance", metres, visible & ~(other > 0)))
    paths = {"motion_prev": layer.motion_prev, "motion_next": layer.motion_next, "motion": layer.motion}
    for name, path in paths.items():
        if path is not None:
            checks.append(Problem(name, "not finite", "finite px per frame", visible & _not_finite(path)))
    return [check for check in checks if check.places.any()]


def _turned(depth: FloatArray, visible: BoolArray) -> str:
    """Return a remark if the depth of everything visible is negative."""
    seen = depth[visible]
    if seen.size and seen.max() < 0:
        return f"; all depths are negative: the sign is turned, say {option('depth_scale')} -1, or no longer if you did"
    return ""


def replaced(array: FloatArray, places: BoolArray, value: np.float32) -> FloatArray:
    """Return the array with some pixels or samples set to a value; a copy only if there are any."""
    if not places.any():
        return array
    changed = array.copy()
    changed[places] = value
    return changed
