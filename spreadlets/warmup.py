"""Compiling all kernels ahead of their first use, by running on frames of a few pixels, and from lists."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from spreadlets.ahead import RUNS, compile_entries, compiled_ahead, listed
from spreadlets.api import reconstruct, synthesize
from spreadlets.arrays import Image
from spreadlets.compiled import count_compiled, kernel_folder
from spreadlets.psf.database import shipped_folder
from spreadlets.runtime.clock import Clock
from spreadlets.runtime.options import METHODS, PUBLISHED_METHODS
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.frame import Frame
from spreadlets.scene.samples import SampleBuffer

SIDE = 64
"""Side of the frames, px: the smallest that all steps have something to do on."""
CAMERA = ThinLens(focal_length_mm=50, sensor_width_mm=36, f_number=0.5, focus_distance_m=2, shutter=(-0.25, 0.25))


class Warmup(NamedTuple):
    """What was compiled.

    Attributes
    ----------
    compiled : int
        Number of kernels that were not there before.
    compile_s : float
        How long that took, seconds.
    folder : str
        Where kernels are kept.
    """

    compiled: int
    compile_s: float
    folder: str


def warm_up(*, every_method: bool = False, progress: Callable[[int, int], None] = lambda done, total: None) -> Warmup:
    """Compile what synthesis and reconstruction call, so that no later process has to.

    Parameters
    ----------
    every_method : bool
        Also for the methods that spreadlets are compared with.
    progress : callable
        Told after each run how many are done, and of how many.

    Returns
    -------
    Warmup

    Examples
    --------
    >>> from spreadlets.warmup import warm_up
    >>> warm_up().folder  # doctest: +SKIP
    '/home/user/.cache/spreadlets/kernels'
    """
    runs, clock = [*_usual_runs(), *(_other_runs() if every_method else ())], Clock()
    before = count_compiled()
    with warnings.catch_warnings(), compiled_ahead(*RUNS), clock.step("plan"):
        # Nobody looks at these images.
        warnings.simplefilter("ignore")
        for done, run in enumerate(runs):
            progress(done, len(runs))
            run()
        # Larger frames call more than these do.
        compile_entries(listed(*RUNS))
        progress(len(runs), len(runs))
    return Warmup(count_compiled() - before, clock.compile_s, str(kernel_folder()))


def _usual_runs() -> Iterator[Callable[[], Any]]:
    frame, samples = _frame(), _samples()
    radiance, depth, motion = _labels((SIDE, SIDE))
    curved = Frame(radiance, depth, motion, motion_prev=motion, motion_next=-motion[::-1])
    near = Frame(np.float32(0.5) * radiance, np.float32(0.5) * depth, motion)
    yield partial(synthesize, frame, CAMERA, "combined")
    yield partial(synthesize, curved, CAMERA, "combined", layers=1)
    for database in ("combined", "volume"):
        yield partial(synthesize, [near, frame], CAMERA, database)
    for path in sorted(shipped_folder().glob("*.h5")):
        yield partial(synthesize, frame, CAMERA, str(path))
    yield partial(reconstruct, samples, CAMERA, "combined")


def _other_runs() -> Iterator[Callable[[], Any]]:
    frame, samples = _frame(), _samples()
    for method in METHODS[1:]:
        yield partial(synthesize, frame, CAMERA, "combined", method=method)
    for method in PUBLISHED_METHODS:
        yield partial(reconstruct, samples, CAMERA, method=method)


def _labels(shape: tuple[int, ...]) -> tuple[Image, Image, Image]:
    """Return colours, two surfaces' depths and motions of random pixels."""
    rng = np.random.default_rng(1)
    # Only lamps stand out: of what does, physicallens traces every PSF.
    radiance = np.float32(0.5) + np.float32(0.1) * rng.random((*shape, 4), np.float32)
    radiance[..., 3] = 1.0
    radiance[:4, :4, ..., :3] *= 1000.0
    depth = np.where(rng.random(shape) < 0.5, np.float32(1.0), np.float32(8.0))
    depth[: SIDE // 2] = 3.0
    return radiance, depth, np.float32(16.0) * rng.random((*shape, 2), np.float32)


def _frame() -> Frame:
    return Frame(*_labels((SIDE, SIDE)))


def _samples() -> SampleBuffer:
    radiance, depth, motion = _labels((SIDE, SIDE, 1))
    rng = np.random.default_rng(2)
    # All over a square lens, the shutter and the pixel.
    lens, offset = rng.random((2, *depth.shape, 2), np.float32) - np.float32(0.5)
    return SampleBuffer(radiance, depth, motion, 2 * lens, np.float32(0.5) * lens[..., 0], offset)
