"""The four steps in order: plan, splat, integrate, composite; each timed."""

from __future__ import annotations

import math
import resource
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numba.core.event
import numpy as np
import numpy.typing as npt

from spreadlets.errors import InvalidParameterError
from spreadlets.psf.database import Database
from spreadlets.runtime.composite.composite import COUNT, COVERAGE, LAST, LEAST_SEEN, NOTHING, add_layer, is_opaque
from spreadlets.runtime.finish.calibration import calibrate, takes_whole_lens
from spreadlets.runtime.finish.denoise import DENOISERS, denoise_sharp
from spreadlets.runtime.integrate.convolution_pyramid import DEFAULT_CYCLES, DEFAULT_METHOD, METHODS, integrate
from spreadlets.runtime.label.fireflies import NO_SHIFT, clamp_fireflies
from spreadlets.runtime.label.labels import view_differences
from spreadlets.runtime.label.pixels import Pixels, frame_pixels, sample_pixels
from spreadlets.runtime.plan import layering as layers
from spreadlets.runtime.plan.plan import DEFAULT_TOLERANCE, Plan, Settings, plan_pixels
from spreadlets.runtime.plan.variant import DensePsf
from spreadlets.runtime.splat.splat import (
    Canvas,
    Runs,
    canvas_of,
    find_runs,
    gather,
    splat_direct,
    splat_laplacian,
    sum_rows,
)
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.frame import Frame, Layer
from spreadlets.scene.samples import SampleBuffer

SOLVER_MARGIN = 8
"""Extra border, px, of the Poisson solve: the field of a fitted spreadlet has died off that far from its PSF."""
LEAST_SAMPLES = 4.0
"""Samples that must have met a layer, or passed it, for a pixel to stand for itself."""

SAMPLE_CLAMP = 32.0
"""How many times as bright as all others around it a sample may be, by default."""

STEPS = ("read", "plan", "splat", "integrate", "composite", "write")

Image = npt.NDArray[np.float32]
Solver = Callable[[Image], Image]


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


class Tally:
    """The figures of a run, over all its plans."""

    def __init__(self) -> None:
        self.plans: list[Plan] = []
        self.layers = 0
        self.padding = 0
        self.clamped = 0

    def add_plan(self, plan: Plan, n_layers: int) -> None:
        """Add a plan and how many layers it drew."""
        self.plans.append(plan)
        self.layers += n_layers

    def add_canvas(self, canvas: Canvas, shape: tuple[int, ...]) -> None:
        """Note how far beyond the frame there was something to compute."""
        behind = canvas.top + canvas.rows - shape[0], canvas.left + canvas.cols - shape[1]
        self.padding = max(self.padding, -canvas.top, -canvas.left, *behind)


@dataclass(frozen=True)
class Options:
    """How to render.

    Attributes
    ----------
    defocus, motion : bool
        Whether to apply each effect.
    integrator : str
        Poisson solver, see `spreadlets.runtime.integrate.convolution_pyramid.integrate`.
    cycles : int
        Cycles of the integrator ``multigrid``; the others take no notice.
    tolerance : float
        Error of the displayed image, as a share of its range, that may be traded for speed; 0 draws every pixel.
    n_layers : int or None
        Depth layers; by default those that the frame has, or a usual number if it has none.
    softness : float
        Width of the transition between depth layers, in layers: 0 (hard) to 1 (soft).
    firefly_clamp : float or None
        How many times as bright as any other within a pixel of where it comes from a sample may be; infinite for any.
        By default any in synthesis, and `SAMPLE_CLAMP` in reconstruction.
    denoise : str or None
        Denoiser for the sharp parts of a reconstruction, see `spreadlets.runtime.finish.denoise.denoise_sharp`.
    calibrate : bool
        Whether a reconstruction is brought to its samples' local means, where those are of the whole lens and shutter,
        see `spreadlets.runtime.finish.calibration.calibrate`.
    dense_psf : callable or None
        If given, PSFs are drawn in full from it, every pixel by itself: methods ``dense`` and ``dense-rows``.
    filtering : bool
        Gather with the PSF of the receiving pixel instead of splatting, see `spreadlets.runtime.splat.splat.gather`; needs `dense_psf`.
    """

    defocus: bool = True
    motion: bool = True
    integrator: str = DEFAULT_METHOD
    cycles: int = DEFAULT_CYCLES
    tolerance: float = DEFAULT_TOLERANCE
    n_layers: int | None = None
    softness: float = layers.DEFAULT_SOFTNESS
    firefly_clamp: float | None = None
    denoise: str | None = None
    calibrate: bool = True
    dense_psf: DensePsf | None = None
    filtering: bool = False

    def __post_init__(self) -> None:
        if self.integrator not in METHODS:
            raise InvalidParameterError(f"integrator {self.integrator!r} is unknown: allowed are {', '.join(METHODS)}")
        if not 0.0 <= self.tolerance < 1.0:
            raise InvalidParameterError(
                f"tolerance is {self.tolerance}: allowed are 0 (off) to below 1 (the displayed range)"
            )
        if self.n_layers is not None and not 1 <= self.n_layers <= layers.MAX_LAYERS:
            raise InvalidParameterError(f"layers is {self.n_layers}: allowed are 1 to {layers.MAX_LAYERS}")
        if not 0.0 <= self.softness <= 1.0:
            raise InvalidParameterError(f"softness is {self.softness}: allowed are 0 (hard layers) to 1 (soft)")
        if self.firefly_clamp is not None and not self.firefly_clamp >= 1.0:
            raise InvalidParameterError(f"firefly_clamp is {self.firefly_clamp}: allowed are 1 and more, inf for off")
        if self.denoise is not None and self.denoise not in DENOISERS:
            raise InvalidParameterError(f"denoise is {self.denoise!r}: allowed are {', '.join(DENOISERS)}, or none")

    def solver(self) -> Solver:
        """Return what makes images from what is splatted."""
        if self.dense_psf is not None and self.dense_psf.by_rows:
            return sum_rows
        return partial(integrate, method=self.integrator, cycles=self.cycles)

    def settings(self, n_layers: int, *, border: bool = True, stochastic: bool = False) -> Settings:
        """Return the settings of the plan."""
        return Settings(self.tolerance, self.dense_psf, border, n_layers, self.softness, stochastic)


def synthesize(
    frame: Frame, camera: ThinLens, database: Database, options: Options | None = None, clock: Clock | None = None
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
    options : Options, optional
    clock : Clock, optional
        Where the steps' times are added.

    Returns
    -------
    image : ndarray of shape (H, W, 4), float32
        Premultiplied, linear.
    report : dict
        ``plan`` (what was drawn and what was left out), ``time_s``, ``compile_s`` and ``peak_rss_mb``.

    Notes
    -----
    LKS section 6. A frame of one layer is divided into depth layers: what a nearer one hides of a farther one is
    filled from what was seen of it. A frame that comes in layers is taken as it is, unless a number of depth layers is
    asked for: then the pixels of all its layers are distributed anew.
    """
    options, clock = options or Options(), clock or Clock()
    _warn_about_view(database, camera, frame.shape[1])
    effects = {"defocus": options.defocus, "motion": options.motion, "curved": database.grid.model.has_motion}
    tally = Tally()
    with clock.step("plan"):
        shown, tally.clamped = _clamped_frame(frame.layers, options.firefly_clamp)
    if options.filtering:
        return _filtered(shown, camera, database, options, clock, tally)
    image = np.zeros((*frame.shape, 4), np.float32)
    with clock.step("plan"):
        given = [frame_pixels(layer, camera, **effects) for layer in shown]
    is_whole = len(given) > 1
    if is_whole and options.n_layers is not None:
        given = [[pixels for group in given for pixels in group]]
    n_layers = options.n_layers or (1 if is_whole else layers.DEFAULT_LAYERS)
    for number, group in enumerate(given):
        with clock.step("plan"):
            plan = plan_pixels(group, database, options.settings(n_layers))
            # Pixels of the farthest layer only: nearer ones are opaque, or not, where they are.
            closed = number == len(given) - 1 and is_opaque(frame.layers[-1].radiance)
            view = _HiddenShare(group, plan) if plan.n_layers > 1 and not is_whole else None
        _add_plan(image, plan, view, options.solver(), clock, tally, closed=closed)
    return image, _report(tally, database, clock)


def reconstruct(
    samples: SampleBuffer,
    camera: ThinLens,
    database: Database,
    options: Options | None = None,
    clock: Clock | None = None,
) -> tuple[Image, dict[str, Any]]:
    """Make a clean image of a buffer of stochastic samples, blurred by the camera's lens and shutter.

    Parameters
    ----------
    samples : SampleBuffer
        Labelled samples.
    camera, database, options, clock
        As for `synthesize`.

    Returns
    -------
    image : ndarray of shape (H, W, 4), float32
        Premultiplied, linear.
    report : dict
        As for `synthesize`.

    Notes
    -----
    LKS section 6.2, "Stochastic frame-buffers"; the opacity of layers is that of SLR section 5: a sample that passes
    a layer is a hole in it.
    """
    options, clock, tally = options or Options(), clock or Clock(), Tally()
    _warn_about_view(database, camera, samples.shape[1])
    with clock.step("plan"):
        passes = sample_pixels(samples, camera, defocus=options.defocus, motion=options.motion)
        passes, tally.clamped = _clamped_samples(passes, options.firefly_clamp or SAMPLE_CLAMP)
        settings = options.settings(options.n_layers or layers.DEFAULT_LAYERS, stochastic=True)
        plan = plan_pixels(passes, database, settings)
        view = _PassingSamples(samples, camera, passes, plan, defocus=options.defocus)
        closed = bool((samples.radiance[..., 3] == samples.valid).all())
    image = np.zeros((*samples.shape, 4), np.float32)
    _add_plan(image, plan, view, options.solver(), clock, tally, closed=closed)
    with clock.step("composite"):
        # A gain of the colours alone would part them from an alpha that is as inexact.
        if closed and options.calibrate and _shows_samples(samples, camera, database, options):
            calibrate(image, [each.radiance for each in passes], samples.valid)
        else:
            plan.left_out.append("calibration")
    if options.denoise is not None:
        with clock.step("composite"):
            image = denoise_sharp(image, _sharp_share(plan, samples.valid), options.denoise)
    return image, _report(tally, database, clock)


def _shows_samples(samples: SampleBuffer, camera: ThinLens, database: Database, options: Options) -> bool:
    """Tell whether the image should be the mean of many samples: same effects, round lens, all of lens and shutter."""
    model = database.grid.model
    moves = bool(samples.motion.any())
    if model.settings or not options.defocus or (moves and not options.motion):
        return False
    shown = model.name == "combined" or (model.name == "simplelens" and not moves)
    return shown and takes_whole_lens(samples, camera)


def _sharp_share(plan: Plan, valid: npt.NDArray[np.bool_]) -> Image:
    """Return the share of each pixel's samples whose PSF reaches no farther than the pixels around it, (H, W)."""
    narrow = np.append(plan.table.reaches <= 1, False)  # variant -1 is nothing
    count = sum(narrow[members.variant].astype(np.float32) for members in plan.members)
    return np.asarray(count / np.maximum(valid.sum(axis=2), 1), np.float32)


def _clamped_frame(frame_layers: Sequence[Layer], factor: float | None) -> tuple[list[Layer], int]:
    """Clamp the fireflies of each layer of a frame, if asked for; return how many pixels were."""
    if factor is None or math.isinf(factor):
        return list(frame_layers), 0
    found = [clamp_fireflies([(layer.radiance, NO_SHIFT)], factor) for layer in frame_layers]
    clamped = [replace(layer, radiance=colours[0]) for layer, (colours, _) in zip(frame_layers, found, strict=True)]
    return clamped, sum(count for _, count in found)


def _clamped_samples(passes: list[Pixels], factor: float) -> tuple[list[Pixels], int]:
    """Clamp the fireflies among samples; return how many were."""
    if math.isinf(factor):
        return passes, 0
    shifts = [NO_SHIFT if each.labels.shift is None else each.labels.shift for each in passes]
    colours, count = clamp_fireflies([(each.radiance, s) for each, s in zip(passes, shifts, strict=True)], factor)
    return [each._replace(radiance=colour) for each, colour in zip(passes, colours, strict=True)], count


def average(samples: SampleBuffer, clock: Clock | None = None) -> tuple[Image, dict[str, Any]]:
    """Return the mean of each pixel's samples, and a report of the time; where there is none, the pixel is empty."""
    clock = clock or Clock()
    with clock.step("composite"):
        count = np.maximum(samples.valid.sum(axis=2), 1)
        image = (samples.radiance.sum(axis=2) / count[..., None]).astype(np.float32)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return image, {"time_s": clock.times(), "compile_s": clock.compile_s, "peak_rss_mb": peak}


class _HiddenShare:
    """How much of each layer of a frame nearer layers leave to be seen."""

    kind = COVERAGE
    least = LEAST_SEEN

    def __init__(self, passes: Sequence[Pixels], plan: Plan) -> None:
        # All passes are of the same pixels: they differ in their motion.
        variant = np.max([each.variant for each in plan.members], axis=0)
        self.members = plan.members[0]._replace(variant=variant)
        labels = passes[0].labels
        self.moments = layers.layer_moments([(labels, labels.path, self.members)], plan.n_layers)

    def seen(self, number: int) -> Image | None:
        """Return the share of a layer that was seen, or None if it was all seen."""
        moments = self.moments[number]
        if moments is None or all(each is None for each in self.moments[:number]):
            return None
        return layers.seen_share(self.members, number, moments)


class _PassingSamples:
    """How many samples have passed each layer."""

    kind = COUNT
    least = LEAST_SAMPLES

    def __init__(
        self, samples: SampleBuffer, camera: ThinLens, passes: Sequence[Pixels], plan: Plan, *, defocus: bool
    ) -> None:
        self.members = []
        for number, members in enumerate(plan.members):
            met_nothing = samples.valid[:, :, number] & (samples.radiance[:, :, number, 3] == 0)
            layer = np.where(samples.valid[:, :, number], members.layer, np.int32(0))  # a missing one passes nothing
            layer = np.where(met_nothing, np.int32(layers.BEHIND_ALL), layer)
            self.members.append(members._replace(layer=layer))
        self.samples, self.camera = samples, camera
        self.moments = self._moments(passes, plan.n_layers)
        if not defocus:
            # They passed the layers through the lens that took them, even where its blur is taken out of the image.
            taken = self._moments(sample_pixels(samples, camera, defocus=True, motion=False), plan.n_layers)
            self.moments = [
                None if mean is None or through is None else mean._replace(coc=through.coc)
                for mean, through in zip(self.moments, taken, strict=True)
            ]

    def _moments(self, passes: Sequence[Pixels], n_layers: int) -> list[layers.Moments | None]:
        motion = np.ascontiguousarray(np.moveaxis(self.samples.motion, 2, 0))
        return layers.layer_moments(
            [(each.labels, path, m) for each, path, m in zip(passes, motion, self.members, strict=True)], n_layers
        )

    def seen(self, number: int) -> Image | None:
        """Return the number of samples that passed a layer."""
        moments = self.moments[number]
        if moments is None:
            return None
        samples = self.samples
        since_centre = samples.time - np.float32(self.camera.shutter_centre)
        return layers.passing_samples(
            [
                (members, samples.offset[:, :, i], samples.lens_uv[:, :, i], since_centre[:, :, i])
                for i, members in enumerate(self.members)
            ],
            number,
            moments,
        )


View = _HiddenShare | _PassingSamples


def _add_plan(
    image: Image, plan: Plan, view: View | None, solver: Solver, clock: Clock, tally: Tally, *, closed: bool
) -> None:
    """Put the layers of a plan behind an image, in place."""
    with clock.step("splat"):
        sources = [[find_runs(each, plan.table, plan.n_layers) for each in levels] for levels in plan.sources]
    used = [
        k
        for k in range(plan.n_layers)
        if any(len(r.of(2 * k)) + len(r.of(2 * k + 1)) for levels in sources for r in levels)
    ]
    for number in used:
        canvas, padded = _splat_layer(sources, number, plan, solver, clock)
        last = closed and number == used[-1]
        with clock.step("composite"):
            seen = None if view is None or last else view.seen(number)
            kind = LAST if last else COVERAGE if view is None else view.kind
            least = LEAST_SEEN if view is None else view.least
            add_layer(
                image, padded, (canvas.top, canvas.left), kind, seen=NOTHING if seen is None else seen, least=least
            )
        tally.add_canvas(canvas, image.shape)
    tally.add_plan(plan, len(used))


def _splat_layer(
    sources: list[list[Runs]], number: int, plan: Plan, solver: Solver, clock: Clock
) -> tuple[Canvas, Image]:
    """Return the sum of all splats of a layer, and the canvas that it lies on."""
    sparse, direct = 2 * number, 2 * number + 1
    flat = [each for levels in sources for each in levels]
    with clock.step("splat"):
        canvas = canvas_of(flat, (sparse, direct), plan.table, SOLVER_MARGIN)
        assert canvas is not None, "only layers with splats are drawn"
        padded = np.empty((canvas.rows, canvas.cols, 4), np.float32)
        drawn = [levels for levels in sources if any(len(each.of(sparse)) for each in levels)]
        if drawn:
            splat_laplacian(padded, canvas, drawn, sparse, plan.table)
    if drawn:
        with clock.step("integrate"):
            padded = solver(padded)
    else:
        padded[...] = 0.0
    with clock.step("splat"):
        for levels in sources:
            splat_direct(padded, canvas, levels[0], direct, plan.table)
    return canvas, padded


def _filtered(
    given: Sequence[Layer], camera: ThinLens, database: Database, options: Options, clock: Clock, tally: Tally
) -> tuple[Image, dict[str, Any]]:
    """Filter each layer of a frame with the PSFs of the receiving pixels, straight paths only, and composite."""
    image = np.zeros((*given[0].shape, 4), np.float32)
    for layer in given:
        with clock.step("plan"):
            straight = replace(layer, motion_prev=None, motion_next=None)
            moved = frame_pixels(straight, camera, defocus=options.defocus, motion=options.motion)
            # A filter has no place to move light to.
            passes = [each._replace(labels=each.labels._replace(shift=None)) for each in moved]
            plan = plan_pixels(passes, database, options.settings(1, border=False))
        with clock.step("splat"):
            # All that is filtered counts, also where nothing is drawn.
            filtered = np.zeros_like(image)
            if plan.sources:
                filtered = gather(plan.sources[0][0]._replace(radiance=layer.radiance), plan.table)
        with clock.step("composite"):
            add_layer(image, filtered, (0, 0), COVERAGE)
        tally.add_plan(plan, 1)
    return image, _report(tally, database, clock)


def _warn_about_view(database: Database, camera: ThinLens, width: int) -> None:
    """Say in what the camera differs from the one that the database was built for."""
    differences = view_differences(database.grid.model, camera, width)
    if differences:
        warnings.warn(
            f"the database {database.path.name!r} was built for another camera: {'; '.join(differences)}", stacklevel=3
        )


def _report(tally: Tally, database: Database, clock: Clock) -> dict[str, Any]:
    """Gather the plans' figures under the names of the command line's JSON output."""
    plans = tally.plans
    counts = [plan.counts() for plan in plans]
    left_out = set.intersection(*(set(plan.left_out) for plan in plans))
    figures: dict[str, Any] = {name: sum(count[name] for count in counts) for name in counts[0]}
    figures |= {
        "layers": tally.layers,
        "cells_used": len(set.union(*(plan.cells_used for plan in plans))),
        "cells_total": database.n_cells,
        "pixels_clamped": tally.clamped,
        "pixels_skipped": sum(plan.pixels_skipped for plan in plans),
        "error_bound": max(plan.error_bound for plan in plans),
        "padding_px": tally.padding,
        "left_out": [name for name in plans[0].left_out if name in left_out],
    }
    return {
        "time_s": clock.times(),
        "compile_s": clock.compile_s,
        "peak_rss_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "plan": figures,
    }
