"""The four steps in order: plan, splat, integrate, composite; each timed."""

from __future__ import annotations

import resource
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numba.core.event
import numpy as np
import numpy.typing as npt

from runtime._kernels import add_spread
from runtime.composite import over, reweight
from runtime.convolution_pyramid import DEFAULT_CYCLES, DEFAULT_METHOD, METHODS, integrate
from runtime.plan import Plan, label_pixels, plan_layer
from runtime.splat import gather, splat
from runtime.variant import DensePsf
from spreadlets.camera import ThinLens
from spreadlets.database import Database
from spreadlets.errors import InvalidParameterError
from spreadlets.frame import Frame, Layer
from spreadlets.labels import view_differences

DEFAULT_TOLERANCE = 0.004
"""One step of an 8-bit display."""
SOLVER_MARGIN = 8
"""Extra border, px, of the Poisson solve: the field of a fitted spreadlet has died off that far from its PSF."""

STEPS = ("read", "plan", "splat", "integrate", "composite", "write")

Image = npt.NDArray[np.float32]


class Clock:
    """Wall time of each named step, seconds, and the share of it spent in compiling."""

    def __init__(self) -> None:
        self.time_s: dict[str, float] = {}
        self.compile_s = 0.0

    @contextmanager
    def step(self, name: str) -> Iterator[None]:
        """Add the time of the enclosed block to a step; compilation is counted apart."""
        begin = time.perf_counter()
        recorder = numba.core.event.RecordingListener()  # type: ignore[no-untyped-call]
        with numba.core.event.install_listener("numba:compile", recorder):
            yield
        compiled = _compile_time(recorder)
        self.compile_s += compiled
        elapsed = time.perf_counter() - begin - compiled
        self.time_s[name] = self.time_s.get(name, 0.0) + elapsed

    def times(self) -> dict[str, float]:
        """Return the seconds of every step, and of all together."""
        time_s = {name: self.time_s.get(name, 0.0) for name in STEPS}
        return time_s | {"total": sum(time_s.values())}


def _compile_time(recorder: Any) -> float:
    """Sum the outermost compile events of a recorder, seconds."""
    total, depth, begin = 0.0, 0, 0.0
    for stamp, event in recorder.buffer:
        if event.is_start:
            begin = stamp if depth == 0 else begin
            depth += 1
        else:
            depth -= 1
            total += stamp - begin if depth == 0 else 0.0
    return total


def synthesize(
    frame: Frame,
    camera: ThinLens,
    database: Database,
    *,
    defocus: bool = True,
    motion: bool = True,
    integrator: str = DEFAULT_METHOD,
    cycles: int = DEFAULT_CYCLES,
    tolerance: float = DEFAULT_TOLERANCE,
    dense_psf: DensePsf | None = None,
    filtering: bool = False,
    clock: Clock | None = None,
) -> tuple[Image, dict[str, Any]]:
    """Blur a frame as the camera's lens and shutter would have.

    Parameters
    ----------
    frame : Frame
        One or more layers of labelled pixels, nearest first.
    camera : ThinLens
        Lens and shutter.
    database : Database
        Spreadlets of the PSF model to use.
    defocus, motion : bool
        Whether to apply each effect.
    integrator : str
        Poisson solver, see `runtime.convolution_pyramid.integrate`.
    cycles : int
        Cycles of the integrator ``multigrid``; the others take no notice.
    tolerance : float
        Error of the displayed image, as a share of its range, that may be traded for speed; 0 draws every pixel.
    dense_psf : callable or None
        If given, PSFs are drawn in full from it, every pixel by itself: method ``dense``.
    filtering : bool
        Gather with the PSF of the receiving pixel instead of splatting, see `runtime.splat.gather`; needs `dense_psf`.
    clock : Clock or None
        Where the steps' times are added.

    Returns
    -------
    image : ndarray of shape (H, W, 4), float32
        Premultiplied, linear.
    report : dict
        ``plan`` (what was drawn and what was left out), ``time_s``, ``compile_s`` and ``peak_rss_mb``.

    Notes
    -----
    LKS section 6.
    """
    if integrator not in METHODS:
        raise InvalidParameterError(f"integrator {integrator!r} is unknown: allowed are {', '.join(METHODS)}")
    if not 0.0 <= tolerance < 1.0:
        raise InvalidParameterError(f"tolerance is {tolerance}: allowed are 0 (off) to below 1 (the displayed range)")
    _warn_about_view(database, camera, frame.shape[1])
    clock = clock or Clock()
    composite: Image | None = None
    plans = []
    for layer in frame.layers:
        with clock.step("plan"):
            labels = label_pixels(layer, camera, defocus=defocus, motion=motion)
            plan = plan_layer(layer, labels, database, tolerance, dense_psf)
        if filtering:
            with clock.step("splat"):
                image = gather(plan.passes[0], plan.table)
        else:
            image = _render_layer(layer, plan, (integrator, cycles), clock)
        with clock.step("composite"):
            composite = image if composite is None else over(composite, image)
        plans.append(plan)
    assert composite is not None, "a frame has at least one layer"
    return composite, _report(plans, database, clock)


def _warn_about_view(database: Database, camera: ThinLens, width: int) -> None:
    """Say in what the camera differs from the one that the database was built for."""
    differences = view_differences(database.grid.model, camera, width)
    if differences:
        warnings.warn(
            f"the database {database.path.name!r} was built for another camera: {'; '.join(differences)}", stacklevel=3
        )


def _render_layer(layer: Layer, plan: Plan, solver: tuple[str, int], clock: Clock) -> Image:
    """Splat one layer's Laplacian and direct images, integrate the first, add, and re-weight."""
    height, width = layer.depth.shape
    padding = plan.padding + SOLVER_MARGIN
    padded = np.zeros((height + 2 * padding, width + 2 * padding, 4), np.float32)
    if not plan.table.direct.all():
        with clock.step("splat"):
            _splat_laplacian(padded, plan, padding)
        with clock.step("integrate"):
            padded = integrate(padded, solver[0], cycles=solver[1])
    if plan.table.direct.any():
        with clock.step("splat"):
            for source in plan.passes:
                if source.stride == 1:
                    splat(padded, source, plan.table, padding, plan.table.direct)
    with clock.step("composite"):
        inside = padded[padding : padding + height, padding : padding + width].copy()
        return reweight(inside, opaque=bool((layer.radiance[..., 3] == 1.0).all()))


def _splat_laplacian(padded: Image, plan: Plan, padding: int) -> None:
    """Splat the Laplacian of all passes: blocks into images of their own, spread over their area afterwards."""
    sparse = ~plan.table.direct
    stride = max((source.stride for source in plan.passes), default=1)
    blocks: Image | None = None
    while True:
        image = padded if stride == 1 else np.zeros_like(padded)
        for source in plan.passes:
            if source.stride == stride:
                splat(image, source, plan.table, padding, sparse)
        if blocks is not None:
            add_spread(image, blocks, stride)
        if stride == 1:
            return
        blocks, stride = image, stride // 2


def _report(plans: list[Plan], database: Database, clock: Clock) -> dict[str, Any]:
    """Gather the plans' figures under the names of the command line's JSON output."""
    counts = [plan.counts() for plan in plans]
    left_out = set.intersection(*(set(plan.left_out) for plan in plans))
    figures: dict[str, Any] = {name: sum(count[name] for count in counts) for name in counts[0]}
    figures |= {
        "layers": len(plans),
        "cells_used": len(set.union(*(plan.cells_used for plan in plans))),
        "cells_total": database.n_cells,
        "pixels_skipped": sum(plan.pixels_skipped for plan in plans),
        "error_bound": max(plan.error_bound for plan in plans),
        "padding_px": max(plan.padding for plan in plans) + SOLVER_MARGIN,
        "left_out": [name for name in plans[0].left_out if name in left_out],
    }
    return {
        "time_s": clock.times(),
        "compile_s": clock.compile_s,
        "peak_rss_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "plan": figures,
    }
