"""What cases of the stability report share: their record, the frames they are made of, and how they are rendered."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from spreadlets.api import synthesize
from spreadlets.errors import AmbiguousInputWarning
from spreadlets.psf.database import Database
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.frame import Frame

Array = npt.NDArray[Any]
Path = tuple[float, float]

CAMERA = ThinLens(
    focal_length_mm=50.0, sensor_width_mm=36.0, f_number=0.02, focus_distance_m=4.0, shutter=(-0.25, 0.25)
)
"""A lens so wide that CoC radii of any size lie between its near limit and infinity."""

SMOOTHNESS_PX = 1.5
"""Deviation of the filter that makes a texture of noise."""


@dataclass(frozen=True)
class Lab:
    """Where cases are run.

    Attributes
    ----------
    database : Database
        The shipped database ``combined``.
    quick : bool
        Whether the sizes are those of the tests.
    """

    database: Database
    quick: bool

    def size(self, quick: int, full: int) -> int:
        """Return the size for this run."""
        return quick if self.quick else full

    def render(self, frame: Frame, camera: ThinLens = CAMERA, **options: Any) -> Array:
        """Synthesise a frame, pixel by pixel unless a tolerance is given; return the image (H, W, 4) in float64."""
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message=".*beyond the database's range")
            warnings.simplefilter("ignore", AmbiguousInputWarning)  # extreme cases are doubtful, as they should be
            image = synthesize(frame, camera, self.database, **({"tolerance": 0.0} | options))
        return np.asarray(image, np.float64)


Measure = Callable[[Lab, Any], float]


@dataclass(frozen=True)
class Case:
    """A stiff or extreme input whose answer is known.

    Attributes
    ----------
    group, name : str
        What is strained, and by what.
    given, oracle : str
        The input, and what the answer is compared with.
    budget : float
        Largest error that passes.
    measure : callable
        Takes a `Lab` and the case's value, and returns the error.
    value : object
        What this case's input has in the place of those of its siblings.
    limit : str
        Not empty if the budget is one that a user can notice: what the docs say about it.
    """

    group: str
    name: str
    given: str
    oracle: str
    budget: float
    measure: Measure
    value: Any
    limit: str = ""

    @property
    def label(self) -> str:
        """The case's full name."""
        return f"{self.group}: {self.name}"


CASES: list[Case] = []
"""Every case that has been registered, in the order of the report."""


def cases(
    group: str, name: str, values: Iterable[Any], *, given: str, oracle: str, budget: float, limit: str = ""
) -> Callable[[Measure], Measure]:
    """Register a function as one case for each value; ``{}`` in the name stands for the value."""

    def register(measure: Measure) -> Measure:
        for value in values:
            shown = f"{value:g}" if isinstance(value, float) else value
            CASES.append(Case(group, name.format(shown), given, oracle, budget, measure, value, limit))
        return measure

    return register


def case(group: str, name: str, **about: Any) -> Callable[[Callable[[Lab], float]], Callable[[Lab], float]]:
    """Register a function of the lab alone as a case; keywords are those of `cases`."""

    def register(measure: Callable[[Lab], float]) -> Callable[[Lab], float]:
        cases(group, name, (None,), **about)(lambda lab, _: measure(lab))
        return measure

    return register


def depth_of(coc: npt.ArrayLike, width: int, camera: ThinLens = CAMERA) -> Array:
    """Return the depth, metres, of signed CoC radii, px, in an image of some width."""
    nearness = 1.0 / camera.focus_distance_m - np.asarray(coc, np.float64) / camera.coc_scale(width)
    return np.asarray(1.0 / nearness)


def frame_of(radiance: npt.ArrayLike, coc: npt.ArrayLike, path: npt.ArrayLike = (0.0, 0.0)) -> Frame:
    """Return a frame with the given CoC radii, px, and motions (dx, dy) over the shutter, px."""
    colour = np.asarray(radiance, np.float32)
    height, width = colour.shape[:2]
    depth = np.broadcast_to(depth_of(coc, width), (height, width))
    motion = np.broadcast_to(np.asarray(path, np.float64) / CAMERA.shutter_duration, (height, width, 2))
    return Frame(colour, depth, motion)


def texture(height: int, width: int, seed: int = 0) -> Array:
    """Return smooth noise that fills 0 to 1, shape (height, width, 3), float32."""
    noise = np.random.default_rng(seed).random((height, width, 3))
    smooth = ndimage.gaussian_filter(noise, (SMOOTHNESS_PX, SMOOTHNESS_PX, 0), mode="wrap")
    span = float(np.ptp(smooth)) or 1.0
    return np.asarray((smooth - smooth.min()) / span, np.float32)


def island(height: int, width: int, margin: int, seed: int = 0) -> Array:
    """Return an opaque texture with a transparent margin, so that nothing of it crosses the border, (H, W, 4)."""
    image = np.zeros((height, width, 4), np.float32)
    inner = height - 2 * margin, width - 2 * margin
    image[margin : margin + inner[0], margin : margin + inner[1], :3] = texture(*inner, seed)
    image[margin : margin + inner[0], margin : margin + inner[1], 3] = 1.0
    return image


def spot(size: int, row: int, col: int, value: float = 1.0) -> Array:
    """Return an opaque black image with one bright pixel, shape (size, size, 3), float32."""
    image = np.zeros((size, size, 3), np.float32)
    image[row, col] = value
    return image


def worst(difference: Array) -> float:
    """Return the largest magnitude; infinite if a value is not finite."""
    return float(np.abs(difference).max()) if np.isfinite(difference).all() else math.inf


def mean_error(image: Array, expected: Array) -> float:
    """Return the mean magnitude of the difference; infinite if a value is not finite."""
    difference = image - expected
    return float(np.abs(difference).mean()) if np.isfinite(difference).all() else math.inf


def relative_l2(image: Array, expected: Array) -> float:
    """Return the norm of the difference over that of what is expected; infinite if a value is not finite."""
    if not np.isfinite(image).all():
        return math.inf
    return float(np.linalg.norm(image - expected) / np.linalg.norm(expected))


def centroid(image: Array) -> Array:
    """Return the mean place (row, col) of the light of an image (H, W)."""
    rows, cols = np.indices(image.shape)
    return np.asarray(np.array([(image * rows).sum(), (image * cols).sum()]) / image.sum())


def spread(image: Array) -> float:
    """Return the sum of the variances along rows and columns of the light of an image (H, W), px^2."""
    rows, cols = np.indices(image.shape) - centroid(image)[:, None, None]
    return float((image * (rows**2 + cols**2)).sum() / image.sum())


def with_camera(**changes: Any) -> ThinLens:
    """Return the lab's camera with some values changed."""
    return replace(CAMERA, **changes)
