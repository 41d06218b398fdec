"""A stochastic frame: several labelled samples in each pixel, each with its place on the lens and in time."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import BoolArray, FloatArray
from spreadlets.errors import InvalidFrameError, InvalidParameterError
from spreadlets.scene.frame import ALPHA_TOLERANCE, BACKGROUND_DEPTH, Problem, check_raster, real_array, replaced
from spreadlets.scene.raster import Raster

LENS_TOLERANCE = 1e-3
"""A lens coordinate may leave [-1, 1] by this much: half floats near 1 step by 5e-4."""


LABELS: Mapping[str, tuple[int, ...]] = {
    "depth": (),
    "time": (),
    "motion": (2,),
    "lens_uv": (2,),
    "offset": (2,),
    "coc_radius": (),
    "motion_prev": (2,),
    "motion_next": (2,),
}
"""Every array beside radiance and valid, and its axes behind (H, W, S)."""


class SampleBuffer:
    """Labelled samples on a regular grid of pixels, up to S in each; missing ones are marked.

    A sample was seen at ``xy = centre + offset``, and ``xy = xy0 + coc_radius * lens_uv + motion * time``: without
    lens and shutter it would be at ``xy0``.

    Parameters
    ----------
    radiance : array_like of shape (H, W, S, 3) or (H, W, S, 4)
        Linear RGB, or RGB premultiplied by alpha, and alpha in [0, 1]; without alpha every sample is opaque.
    depth : array_like of shape (H, W, S)
        Planar camera-space depth in metres, > 0; ``inf`` is background.
    motion : array_like of shape (H, W, S, 2)
        ``(dx, dy)`` in px per frame, y down, forward in time, at the frame's time.
    lens_uv : array_like of shape (H, W, S, 2)
        Place on the lens: the unit disc for a round aperture, never outside [-1, 1].
    time : array_like of shape (H, W, S)
        Frames from the frame's time.
    offset : array_like of shape (H, W, S, 2), optional
        ``(dx, dy)`` from the pixel's centre in px, y down; by default samples lie at the centres.
    valid : array_like of bool of shape (H, W, S), optional
        False where a pixel has fewer than S samples; by default all are there.
    coc_radius : array_like of shape (H, W, S), optional
        Signed radius of the circle of confusion in px, negative in front of focus, if the file carries it; it takes
        precedence over what a camera makes of the depth.
    motion_prev, motion_next : array_like of shape (H, W, S, 2), optional
        As for `Frame`, for curved paths; they come together.
    raster : Raster, optional
        Where the pixels lie, as for `Frame`; by default they are square, and all are displayed.
    repair : bool
        Drop offending samples (mark them as missing) and count them in `dropped_samples` instead of raising.

    Attributes
    ----------
    radiance : ndarray of shape (H, W, S, 4), float32
        With alpha; zero where a sample is missing.
    depth, time : ndarray of shape (H, W, S), float32
    motion, lens_uv, offset : ndarray of shape (H, W, S, 2), float32
    valid : ndarray of shape (H, W, S), bool
    coc_radius : ndarray of shape (H, W, S), float32, or None
    motion_prev, motion_next : ndarray of shape (H, W, S, 2), float32, or None
    raster : Raster
    dropped_samples : int
        How many samples `repair` dropped.

    Raises
    ------
    InvalidFrameError
        If shapes are wrong or disagree or, unless `repair`, if a sample has non-finite radiance, time, motion, lens
        coordinate, offset or CoC radius, alpha outside [0, 1], a lens coordinate outside [-1, 1], or a depth that is
        NaN or <= 0. The message names the array, the first offending (row, col, sample), how many there are, and what
        is allowed.

    Examples
    --------
    Two samples in each of 4 x 6 pixels:

    >>> import numpy as np
    >>> rng = np.random.default_rng(0)
    >>> shape = (4, 6, 2)
    >>> samples = sp.SampleBuffer(
    ...     radiance=np.ones((*shape, 3)),
    ...     depth=np.full(shape, 2.0),
    ...     motion=np.zeros((*shape, 2)),
    ...     lens_uv=rng.uniform(-0.7, 0.7, (*shape, 2)),
    ...     time=rng.uniform(-0.25, 0.25, shape),
    ... )
    >>> samples.shape, samples.n_samples, samples.take(1).n_samples
    ((4, 6), 2, 1)
    """

    def __init__(
        self,
        radiance: npt.ArrayLike,
        depth: npt.ArrayLike,
        motion: npt.ArrayLike,
        lens_uv: npt.ArrayLike,
        time: npt.ArrayLike,
        offset: npt.ArrayLike | None = None,
        *,
        valid: npt.ArrayLike | None = None,
        coc_radius: npt.ArrayLike | None = None,
        motion_prev: npt.ArrayLike | None = None,
        motion_next: npt.ArrayLike | None = None,
        raster: Raster | None = None,
        repair: bool = False,
    ) -> None:
        colours = _colour_array(radiance)
        shape = colours.shape[:3]
        raster = raster or Raster.of_shape((shape[0], shape[1]))
        check_raster(raster, (shape[0], shape[1]))
        if (motion_prev is None) != (motion_next is None):
            raise InvalidFrameError("motion_prev and motion_next come together; one of them is missing")
        given = {"depth": depth, "time": time, "motion": motion, "lens_uv": lens_uv, "offset": offset}
        given |= {"coc_radius": coc_radius, "motion_prev": motion_prev, "motion_next": motion_next}
        labels = {
            name: _label_array(name, values, shape + LABELS[name])
            for name, values in given.items()
            if values is not None
        }
        labels.setdefault("offset", np.zeros((*shape, 2), np.float32))
        there = np.ones(shape, np.bool_) if valid is None else _valid_array(valid, shape)
        self._set(*_validated(colours, labels, there, repair), raster)

    def _set(
        self, radiance: FloatArray, labels: Mapping[str, FloatArray], valid: BoolArray, dropped: int, raster: Raster
    ) -> None:
        self.radiance, self.valid, self.dropped_samples, self.raster = radiance, valid, dropped, raster
        self.depth, self.time, self.motion = labels["depth"], labels["time"], labels["motion"]
        self.lens_uv, self.offset = labels["lens_uv"], labels["offset"]
        self.coc_radius = labels.get("coc_radius")
        self.motion_prev, self.motion_next = labels.get("motion_prev"), labels.get("motion_next")

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width in pixels."""
        return self.depth.shape[0], self.depth.shape[1]

    @property
    def n_samples(self) -> int:
        """Largest number of samples in a pixel."""
        return int(self.depth.shape[2])

    @property
    def labels(self) -> dict[str, FloatArray]:
        """The arrays beside radiance and valid that are there, by name."""
        return {name: values for name in LABELS if (values := getattr(self, name)) is not None}

    def take(self, n: int) -> SampleBuffer:
        """Return a buffer of the first samples of each pixel.

        Parameters
        ----------
        n : int
            How many, 1 to `n_samples`; missing ones count.

        Returns
        -------
        SampleBuffer
            Its arrays are views.

        Raises
        ------
        InvalidParameterError
            If there are not as many.
        """
        if not 1 <= n <= self.n_samples:
            raise InvalidParameterError(f"{n} samples per pixel were asked for; the buffer holds {self.n_samples}")
        labels = {name: values[:, :, :n] for name, values in self.labels.items()}
        return self.of(self.radiance[:, :, :n], labels, self.valid[:, :, :n], self.raster, self.dropped_samples)

    @classmethod
    def of(
        cls,
        radiance: FloatArray,
        labels: Mapping[str, FloatArray],
        valid: BoolArray,
        raster: Raster,
        dropped_samples: int = 0,
    ) -> SampleBuffer:
        """Return a buffer of arrays that were made of another buffer's, and are valid as those were."""
        made = cls.__new__(cls)
        made._set(radiance, labels, valid, dropped_samples, raster)
        return made

    def __repr__(self) -> str:
        height, width = self.shape
        return (
            f"SampleBuffer({height} x {width} px, {self.n_samples} sample{'s' if self.n_samples > 1 else ''} per pixel)"
        )


def _colour_array(radiance: npt.ArrayLike) -> FloatArray:
    """Return the colours as contiguous float32 with alpha."""
    array = real_array("radiance", radiance)
    if array.ndim != 4 or array.shape[3] not in (3, 4):
        raise InvalidFrameError(f"radiance has shape {array.shape}; it must be (H, W, S, 3) or (H, W, S, 4)")
    if array.size == 0:
        raise InvalidFrameError(f"radiance has shape {array.shape}; it must hold at least one sample")
    if array.shape[3] == 4:
        return array
    return np.concatenate([array, np.ones((*array.shape[:3], 1), np.float32)], axis=3)


def _label_array(name: str, values: npt.ArrayLike, shape: tuple[int, ...]) -> FloatArray:
    """Return a label as contiguous float32 of the shape that the radiance demands."""
    array = real_array(name, values)
    if array.shape != shape:
        raise InvalidFrameError(f"{name} has shape {array.shape}, but the radiance asks for {shape}")
    return array


def _valid_array(valid: npt.ArrayLike, shape: tuple[int, ...]) -> BoolArray:
    array = np.asarray(valid)
    if array.dtype != np.bool_ or array.shape != shape:
        raise InvalidFrameError(f"valid has shape {array.shape} and dtype {array.dtype}; it must be {shape} and bool")
    return np.ascontiguousarray(array)


def _validated(
    radiance: FloatArray, labels: dict[str, FloatArray], valid: BoolArray, repair: bool
) -> tuple[FloatArray, dict[str, FloatArray], BoolArray, int]:
    """Return the arrays with clipped alpha and harmless values where samples are missing, and how many were dropped."""
    dropped = np.zeros(valid.shape, np.bool_)
    for problem in _problems(radiance, labels, valid):
        if not repair:
            raise InvalidFrameError(f"{problem.message()} (or repair the buffer, which drops these samples)")
        dropped |= problem.places
    there = valid & ~dropped
    clean = replaced(radiance, ~there, np.float32(0))
    alpha = clean[..., 3]
    if ((alpha < 0) | (alpha > 1)).any():
        clean = np.concatenate([clean[..., :3], np.clip(alpha, 0, 1)[..., None]], axis=3)
    empty = {name: BACKGROUND_DEPTH if name == "depth" else np.float32(0) for name in labels}
    mended = {name: replaced(values, ~there, empty[name]) for name, values in labels.items()}
    return clean, mended, there, int(np.count_nonzero(dropped))


def _problems(radiance: FloatArray, labels: Mapping[str, FloatArray], valid: BoolArray) -> list[Problem]:
    """Return what is wrong with the samples that are there, one array and kind at a time."""
    alpha, depth = radiance[..., 3], labels["depth"]
    wrong_alpha = (alpha < -ALPHA_TOLERANCE) | (alpha > 1 + ALPHA_TOLERANCE)
    metres = "metres > 0, or inf for background"
    checks = [
        Problem("radiance", "not finite", "finite linear values", _not_finite(radiance)),
        Problem("alpha (the fourth channel of radiance)", "out of range", "0 to 1", wrong_alpha),
        Problem("depth", "NaN", metres, np.isnan(depth)),
        Problem("depth", "zero or negative", metres, depth <= 0),
    ]
    for name, values in labels.items():
        if name != "depth":
            checks.append(Problem(name, "not finite", "finite numbers", _not_finite(values)))
    outside = np.asarray((np.abs(labels["lens_uv"]) > 1 + LENS_TOLERANCE).any(axis=3))
    checks.append(Problem("lens_uv", "outside the lens", "-1 to 1", outside))
    checks = [check._replace(places=check.places & valid) for check in checks]
    return [check for check in checks if check.places.any()]


def _not_finite(array: FloatArray) -> BoolArray:
    """Return the (H, W, S) mask of samples with a non-finite value in any channel."""
    bad = ~np.isfinite(array)
    return bad if bad.ndim == 3 else np.asarray(bad.any(axis=3))


def valid_values(values: FloatArray, valid: BoolArray) -> FloatArray:
    """Return the values (H, W, S, ...) of the samples that are there, of shape (n, ...); no copy where all are."""
    return values.reshape(-1, *values.shape[3:]) if valid.all() else values[valid]
