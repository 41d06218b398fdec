"""Finding the work sizes of LRDM's steps for a machine (LRDM section 3)."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from spreadlets.runtime.sheared.lrdm import LrdmFilter, PracticalLrdm, Work, in_parts, spread_of
from spreadlets.runtime.sheared.samples import Samples
from spreadlets.runtime.sheared.work import WorkSizes
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.samples import SampleBuffer

CANDIDATES = (1, 2, 4, 8, 16, 32)
SIDE = 256
"""px: of the frame that is measured."""
PER_PIXEL = 2
REPEATS = 3
SHUTTER = 0.25
"""frames: half of it."""


def tune(repeats: int = REPEATS, side: int = SIDE) -> tuple[WorkSizes, dict[str, dict[int, float]]]:
    """Measure every step with several work sizes.

    Parameters
    ----------
    repeats : int
        The least time of so many runs counts.
    side : int
        Of the test frame, px.

    Returns
    -------
    sizes : WorkSizes
        The fastest.
    times : dict
        Milliseconds by step and work size.
    """
    samples = trial_samples(side)
    method = PracticalLrdm(screen_filter="sheared", block=0)
    prepared = method.prepare(samples, method.tiling(samples.shape))
    times = {"set_up": _times(lambda size: _set_up(prepared, size), repeats)}
    image = np.zeros((side, side, 4), np.float32)
    block = next(prepared.blocks())
    for name, step in prepared.steps(block, image).items():
        times[name] = _times(_parts(*step), repeats)  # each step finds what the ones before it have left
    return WorkSizes(**{name: min(found, key=lambda size: found[size]) for name, found in times.items()}), times


def trial_samples(side: int) -> Samples:
    """Return samples of a floor from near to far, before which half of the pixels' samples move."""
    rng = np.random.default_rng(1)
    shape = side, side, PER_PIXEL
    angle, radius = 2.0 * np.pi * rng.random(shape), np.sqrt(rng.random(shape))
    moving = np.broadcast_to((np.arange(side) // 32 % 2 == 0)[None, :, None], shape)
    coc = np.where(moving, -8.0, np.linspace(20.0, -10.0, side)[:, None, None])
    motion = np.where(moving[..., None], np.array([20.0, 12.0]), 0.0)
    lens = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)
    camera = ThinLens(50.0, 36.0, 2.0, 4.0, (-SHUTTER, SHUTTER))
    depth, shutter = np.full(shape, 4.0), rng.uniform(-SHUTTER, SHUTTER, shape)
    buffer = SampleBuffer(rng.random((*shape, 3)), depth, motion, lens, shutter, coc_radius=coc)
    return Samples.from_buffer(buffer, camera)


def _set_up(prepared: LrdmFilter, size: int) -> None:
    """Set the filters up, so many tiles at a time."""
    spread = spread_of(prepared.samples)
    prepared.method.set_up(prepared.samples, prepared.partition, prepared.layout, spread, True, size)


def _parts(work: Work, n: int) -> Callable[[int], None]:
    """Return a function that does a work for a work size."""
    return lambda size: in_parts(work, n, size)


def _times(run: Callable[[int], None], repeats: int) -> dict[int, float]:
    """Return the least milliseconds of some runs for every candidate, after one run that may compile."""
    run(CANDIDATES[-1])
    found = dict.fromkeys(CANDIDATES, np.inf)
    for _ in range(repeats):
        for size in CANDIDATES:
            begin = time.perf_counter()
            run(size)
            found[size] = min(found[size], 1e3 * (time.perf_counter() - begin))
    return {size: round(value, 3) for size, value in found.items()}
