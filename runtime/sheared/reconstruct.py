"""The reconstructions by name, and a run of one of them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from functools import partial

import numpy as np

from spreadlets.arrays import Image
from spreadlets.errors import InvalidParameterError
from spreadlets.runtime.clock import Clock
from spreadlets.runtime.report import Report
from spreadlets.runtime.sheared.lrdm import Lrdm, PracticalLrdm
from spreadlets.runtime.sheared.method import Method, Progress
from spreadlets.runtime.sheared.samples import Samples
from spreadlets.runtime.sheared.slr import Slr
from spreadlets.runtime.sheared.tlfr import Tlfr
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.samples import SampleBuffer

METHODS: dict[str, Callable[..., Method]] = {
    "sheared": partial(Slr, sheared=True),
    "axis-aligned": partial(Slr, sheared=False),
    "lrdm": partial(Lrdm, screen_filter="rotated"),
    "lrdm-sheared": partial(PracticalLrdm, screen_filter="sheared"),
    "lrdm-ewa": partial(PracticalLrdm, screen_filter="ewa"),
    "tlfr": Tlfr,
}
"""Dataclasses of the methods' settings, some of them fixed."""


def make_method(name: str, settings: Mapping[str, object]) -> Method:
    """Return a method with its settings.

    Parameters
    ----------
    name : str
        One of `METHODS`.
    settings : mapping
        Values by the names of the fields of its dataclass, such as those of `runtime.sheared.slr.Slr`.

    Raises
    ------
    InvalidParameterError
        If a setting is unknown or of the wrong type.
    """
    make = METHODS[name]
    kind, fixed = (make.func, make.keywords) if isinstance(make, partial) else (make, {})
    defaults = {each.name: each.default for each in dataclasses.fields(kind) if each.name not in fixed}  # type: ignore[arg-type]
    for key, value in settings.items():
        if key not in defaults:
            raise InvalidParameterError(f"{key!r} is no setting of method {name!r}: allowed are {', '.join(defaults)}")
        wanted = type(defaults[key])
        if type(value) is not wanted and (wanted, type(value)) != (float, int):
            raise InvalidParameterError(f"{key} is {value!r}: method {name!r} wants {wanted.__name__}")
    return make(**settings)


def reconstruct(
    samples: SampleBuffer,
    camera: ThinLens,
    method: Method,
    *,
    defocus: bool = True,
    motion: bool = True,
    clock: Clock | None = None,
    progress: Progress | None = None,
) -> tuple[Image, Report]:
    """Make a clean image of a buffer of stochastic samples.

    Parameters
    ----------
    samples : SampleBuffer
    camera : ThinLens
    method : Method
        See `make_method`.
    defocus, motion : bool
        Without an effect, samples are moved to where they would lie without it.
    clock : Clock, optional
        Where the steps' times are added.
    progress : callable, optional
        Told how many parts of the image are done, and of how many.

    Returns
    -------
    image : ndarray of shape (H, W, 4), float32
        Linear, premultiplied.
    report : Report
    """
    clock = clock or Clock()
    image = np.zeros((*samples.shape, 4), np.float32)
    with clock.step("plan"):
        flat = Samples.from_buffer(samples, camera, defocus=defocus, motion=motion)
        tiling = method.tiling(flat.shape)
        tile_filter = method.prepare(flat, tiling)
    with clock.step("composite"):
        tile_filter.fill(image, progress)
    plan = {"tiles": len(tiling.inner()), **tile_filter.figures()}
    return image, Report.of(clock, plan)
