"""The four steps in order: plan, splat, integrate, composite; each timed."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from spreadlets.arrays import NOTHING, BoolArray, Image
from spreadlets.errors import InvalidParameterError, option
from spreadlets.psf.database import Database
from spreadlets.psf.exact import ExactPsf
from spreadlets.runtime.buffers import buffer, cleared, copied, let_go
from spreadlets.runtime.clock import Clock
from spreadlets.runtime.composite.composite import COVERAGE, LAST, LEAST_SEEN, add_layer, even_colours, is_opaque
from spreadlets.runtime.composite.haze import BlurredShare, Haze
from spreadlets.runtime.composite.visibility import (
    GivenLayer,
    PassingSamples,
    ShareBeyond,
    Visibility,
    overlap_of_layers,
)
from spreadlets.runtime.finish.calibration import NOWHERE, calibrated, takes_whole_lens
from spreadlets.runtime.finish.denoise import denoise_sharp
from spreadlets.runtime.finish.edges import PlacedSamples
from spreadlets.runtime.finish.lights import add_lights
from spreadlets.runtime.integrate.convolution_pyramid import integrate
from spreadlets.runtime.label.carried import carried, moves_itself
from spreadlets.runtime.label.fireflies import clamp_fireflies
from spreadlets.runtime.label.labels import illumination, view_differences
from spreadlets.runtime.label.lists import Pixels
from spreadlets.runtime.label.moving import Effects
from spreadlets.runtime.label.pixels import frame_pixels, frame_surfaces, surface_pixels
from spreadlets.runtime.label.sampled import sample_pixels, sample_steps
from spreadlets.runtime.label.surfaces import SharedSurfaces, Split, split_surfaces, undivided
from spreadlets.runtime.options import (
    FRAME_SOFTNESS,
    MOST_LAYERS,
    MOST_SAMPLE_LAYERS,
    SAMPLE_CLAMP,
    SAMPLE_SOFTNESS,
    Options,
)
from spreadlets.runtime.plan.divide import divide_frames
from spreadlets.runtime.plan.evening import Seen, evened
from spreadlets.runtime.plan.layering import Layering
from spreadlets.runtime.plan.plan import Drawing, Plan, plan_pixels
from spreadlets.runtime.plan.variant import DensePsf
from spreadlets.runtime.report import CAMERA, NOTHING_MOVES, VECTORS, Report, Tally, plan_figures
from spreadlets.runtime.splat.gather import gather
from spreadlets.runtime.splat.passes import DIRECT, GROUPS, STRIDES, Canvas, Runs, canvas_of, find_runs, union, within
from spreadlets.runtime.splat.splat import add_to_canvas, splat_direct, splat_laplacian, sum_rows
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.frame import Frame, Layer
from spreadlets.scene.raster import Raster
from spreadlets.scene.samples import SampleBuffer
from spreadlets.scene.squares import squared, unsquared

Solver = Callable[[Image, Image], Image]
"""Makes an image of what was splatted, in some room for it."""

SOLVER_MARGIN = 8
"""Extra border, px, of the Poisson solve: the field of a fitted spreadlet has died off that far from its PSF."""


def synthesize(
    frame: Frame,
    camera: ThinLens,
    database: Database,
    options: Options | None = None,
    clock: Clock | None = None,
    dense_psf: DensePsf | None = None,
    exact_psf: ExactPsf | None = None,
    split: Split = split_surfaces,
    neighbours: Sequence[Frame] = (),
    blurred_share: BlurredShare | None = None,
    *,
    hidden: bool = True,
) -> tuple[Image, Report]:
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
    dense_psf : callable, optional
        Where methods that draw PSFs in full take them from.
    exact_psf : ExactPsf, optional
        What makes the PSFs of highlights, at their own coordinates; without it they are drawn as all other pixels.
    split : callable, optional
        What divides mixed pixels between their surfaces.
    neighbours : sequence of Frame
        The frames right before or after, of one layer each: what they show of what is hidden in a frame of one layer.
    blurred_share : callable, optional
        How a medium lets layers hide each other, see `runtime.composite.haze`.
    hidden : bool
        Whether what is hidden in a frame of one layer is looked for; if not, it is left to compositing.

    Returns
    -------
    image : ndarray of shape (H, W, 4), float32
        Premultiplied, linear.
    report : Report

    Notes
    -----
    LKS section 6. A frame of one layer is divided into depth layers, and what a nearer one hides of a farther one is
    looked for, see `runtime.plan.behind`. A frame that comes in layers is taken as it is, unless a number of depth
    layers is asked for: then the pixels of all its layers are distributed anew.
    """
    given = camera, database, options, clock, dense_psf, exact_psf, split, neighbours, blurred_share
    images, report = synthesize_all([frame], *given, hidden=hidden)
    return images[0], report


def synthesize_all(
    frames: Sequence[Frame],
    camera: ThinLens,
    database: Database,
    options: Options | None = None,
    clock: Clock | None = None,
    dense_psf: DensePsf | None = None,
    exact_psf: ExactPsf | None = None,
    split: Split = split_surfaces,
    neighbours: Sequence[Frame] = (),
    blurred_share: BlurredShare | None = None,
    *,
    hidden: bool = True,
) -> tuple[list[Image], Report]:
    """Blur frames that differ in their colours only, all by the plan of the first.

    Parameters
    ----------
    frames : sequence of Frame
        At least one. The colours of the first say which surfaces a pixel shows, and which pixels are highlights.
    camera, database, options, clock, dense_psf, exact_psf, split, blurred_share
        As for `synthesize`.
    neighbours : sequence of Frame
        As there, if there is but one frame.
    hidden : bool
        As there.

    Returns
    -------
    images : list of ndarray of shape (H, W, 4), float32
        Premultiplied, linear.
    report : Report
        With the figures of the first frame.
    """
    options, clock = options or Options(), clock or Clock()
    raster, frames = frames[0].raster, [squared(frame) for frame in frames]
    frame, tally = frames[0], Tally()
    _check_fit(database, camera, frame.raster.display.width)
    # Clamp fireflies, and divide mixed pixels as those of the first frame.
    with clock.step("plan"):
        clamped = [_clamped_frame(each.layers, options.firefly_clamp) for each in frames]
        shown, tally.clamped = [layers for layers, _ in clamped], clamped[0][1]
        around = [squared(each).layers[0] for each in neighbours]
        if options.motion:
            tally.motion_from = VECTORS if moves_itself(shown[0]) else CAMERA if camera.moves_picture else NOTHING_MOVES
            if camera.moves_picture:
                shown = [carried(layers, camera) for layers in shown]
                around = [layer for each in around for layer in carried([each], camera)]
    if options.method == "gather":
        images = [_filtered(each, camera, database, options, clock, tally, dense_psf) for each in shown]
    else:
        closed = is_opaque(frame.layers[-1].radiance)
        defocus = options.defocus and _has_defocus(database)
        effects = Effects(defocus, options.motion, database.grid.model.has_motion, options, stretches=not closed)
        draw = partial(plan_pixels, database=database, options=options, dense_psf=dense_psf, exact_psf=exact_psf)
        given = camera, effects, options, draw, clock, tally, split
        if len(shown[0]) == 1:
            first = [each[0] for each in shown]
            images = _drawn_by_depth(first, *given, neighbours=around, hidden=hidden, closed=closed)
        else:
            images = _drawn_in_layers(shown, *given, closed=closed, blurred_share=blurred_share)
    images = [_finished(image, frame.raster, raster, camera, database, options) for image in images]
    return images, Report.of(clock, plan_figures(tally, database))


def _drawn_by_depth(
    shown: Sequence[Layer],
    camera: ThinLens,
    effects: Effects,
    options: Options,
    draw: Callable[..., Plan],
    clock: Clock,
    tally: Tally,
    split: Split,
    *,
    neighbours: Sequence[Layer],
    hidden: bool,
    closed: bool,
) -> list[Image]:
    """Draw frames of one layer, divided by depth; all by the plan of the first, which is opaque if ``closed``."""
    # Divide by depth, and plan the first frame.
    with clock.step("plan"):
        divided = divide_frames(
            shown,
            camera,
            effects,
            most=options.layers or MOST_LAYERS,
            softness=FRAME_SOFTNESS if options.softness is None else options.softness,
            split=split,
            neighbours=neighbours,
            hidden=hidden,
        )
        first = divided.pixel_sets[0]
        plan = draw(first, n_layers=divided.layering.n_layers, layering=divided.layering)
        tally.add_plan(plan)
        visibility = (
            ShareBeyond(first, plan, divided.known, divided.n_hidden, closed=closed) if plan.n_layers > 1 else None
        )
        drawings = [plan.lay_out(each) for each in divided.pixel_sets]
        # What the pixels were labelled with, and what they were planned in, is not needed any more.
        del divided, first, plan
        let_go()
    # Draw all frames by that plan.
    images = [np.zeros((*shown[0].shape, 4), np.float32) for _ in shown]
    _add_drawings(images, drawings, visibility, options, clock, tally, closed=closed)
    return images


def _drawn_in_layers(
    shown: Sequence[Sequence[Layer]],
    camera: ThinLens,
    effects: Effects,
    options: Options,
    draw: Callable[..., Plan],
    clock: Clock,
    tally: Tally,
    split: Split,
    *,
    closed: bool,
    blurred_share: BlurredShare | None,
) -> list[Image]:
    """Draw frames that come in layers, all by the plans of the first, whose last layer is opaque if ``closed``."""
    with clock.step("plan"):
        shared = [SharedSurfaces(split) for _ in shown[0]]
        # The last layer is divided by its cover if it is opaque; the others never are.
        each_effects = [*[effects._replace(stretches=True)] * (len(shared) - 1), effects]
        given = [
            [
                surface_pixels(frame_surfaces(layer, camera, own, each), camera, own)
                for layer, each, own in zip(layers, shared, each_effects, strict=True)
            ]
            for layers in shown
        ]
        overlap = overlap_of_layers(given[0], closed=closed) if options.layers is None else None
    if options.layers is not None:
        given = [[[pixels for group in groups for pixels in group]] for groups in given]
    images = [np.zeros((*shown[0][0].shape, 4), np.float32) for _ in shown]
    n_given = len(given[0])
    hazes = [Haze(shown[0], blurred_share) for _ in shown] if blurred_share and n_given > 1 else []
    for number in range(n_given):
        with clock.step("plan"):
            # What a layer was labelled with is not needed any more when it is laid out.
            groups = [each.pop(0) for each in given]
            plan = draw(groups[0], n_layers=options.layers or 1)
            tally.add_plan(plan)
            drawings = [plan.lay_out(each) for each in groups]
            del groups, plan
            # Pixels of the farthest layer only: nearer ones are opaque, or not, where they are.
            last = closed and number == n_given - 1
        # In a medium, what is hidden of a layer depends on how far beyond the nearer ones it lies.
        for haze, image in zip(hazes, images, strict=False):
            haze.hide(image, number)
        _add_drawings(images, drawings, GivenLayer(number, overlap), options, clock, tally, closed=last)
        del drawings
        for haze, image in zip(hazes, images, strict=False):
            haze.add(image)
    for haze, image in zip(hazes, images, strict=False):
        if not closed:
            haze.hide(image)
    return images


def _add_drawings(
    images: Sequence[Image],
    drawings: Sequence[Drawing],
    visibility: Visibility | None,
    options: Options,
    clock: Clock,
    tally: Tally,
    *,
    closed: bool,
) -> None:
    """Put the layers of each frame's drawing behind its image; those of the first are counted."""
    for number, (image, drawing) in enumerate(zip(images, drawings, strict=True)):
        _add_drawing(image, drawing, visibility, _solver(options), clock, Tally() if number else tally, closed=closed)


def reconstruct(
    samples: SampleBuffer,
    camera: ThinLens,
    database: Database,
    options: Options | None = None,
    clock: Clock | None = None,
    dense_psf: DensePsf | None = None,
    exact_psf: ExactPsf | None = None,
) -> tuple[Image, Report]:
    """Make a clean image of a buffer of stochastic samples, blurred by the camera's lens and shutter.

    Parameters
    ----------
    samples : SampleBuffer
        Labelled samples.
    camera, database, options, clock, dense_psf, exact_psf
        As for `synthesize`.

    Returns
    -------
    image : ndarray of shape (H, W, 4), float32
        Premultiplied, linear.
    report : Report

    Notes
    -----
    LKS section 6.2, "Stochastic frame-buffers"; the opacity of layers is that of SLR section 5: a sample that passes
    a layer is a hole in it.
    """
    options, clock, tally = options or Options(), clock or Clock(), Tally()
    if options.motion and samples.motion.any():
        tally.motion_from = VECTORS
    _check_fit(database, camera, samples.raster.display.width)
    with clock.step("plan"):
        pixel_sets = sample_pixels(samples, camera, defocus=options.defocus, motion=options.motion)
        pixel_sets, tally.clamped = _clamped_samples(pixel_sets, options.firefly_clamp or SAMPLE_CLAMP)
        layering = _layers_of_samples(pixel_sets[0], options)
        pixel_sets, passing_weights = evened(pixel_sets, _taken(samples, pixel_sets, camera, options), layering)
        effects = Effects(options.defocus, options.motion, database.grid.model.has_motion)
        drawn = sample_steps(samples, pixel_sets, camera, effects)
        shows_samples = _shows_samples(samples, camera, database, options)
        draw = partial(plan_pixels, layering=layering, dense_psf=dense_psf, exact_psf=exact_psf)
        plan = draw(drawn, database, options, layering.n_layers, stochastic=True, lights=shows_samples)
        n_samples = samples.n_samples
        seen = replace(plan, members=plan.members[:n_samples])
        sets = pixel_sets, drawn[:n_samples], seen, passing_weights
        visibility = PassingSamples(samples, camera, *sets, defocus=options.defocus)
        closed = bool((samples.radiance[..., 3] == samples.valid).all())
        tally.add_plan(plan)
        drawing = plan.lay_out(drawn)
    image = np.zeros((*samples.shape, 4), np.float32)
    # A gain of the colours alone would part them from an alpha that is as inexact.
    calibrates = closed and options.calibrate and shows_samples
    parts: list[tuple[int, Image]] = []
    _add_drawing(
        image, drawing, visibility, _solver(options), clock, tally, closed=closed, parts=parts if calibrates else None
    )
    with clock.step("composite"):
        if parts:
            shown = plan.highlights.without_lights(pixel_sets)
            given = zip(shown, _places(samples, visibility), visibility.paths, visibility.offsets, strict=True)
            placed = [PlacedSamples(each.radiance, place, each.labels.coc, *seen) for each, place, *seen in given]
            image = calibrated(parts, placed)
        else:
            plan.left_out.append("calibration")
        add_lights(image, plan, drawn, samples.valid)
    if options.denoise is not None:
        with clock.step("composite"):
            image = denoise_sharp(image, _sharp_share(seen, samples.valid), options.denoise)
    return image, Report.of(clock, plan_figures(tally, database))


def _taken(samples: SampleBuffer, pixel_sets: Sequence[Pixels], camera: ThinLens, options: Options) -> list[Seen]:
    """Return how samples were taken: by lens and shutter, even where their blur is taken out of the image."""
    if not (options.defocus and options.motion):
        pixel_sets = sample_pixels(samples, camera, defocus=True, motion=True)
    # While a shutter that opens and closes at once is open, nothing moves.
    time = (samples.time - np.float32(camera.shutter_centre)) / np.float32(camera.shutter_duration or 1.0)
    return [
        Seen(
            samples.valid[:, :, number],
            pixels.labels,
            *(np.ascontiguousarray(each[:, :, number]) for each in (samples.offset, samples.lens_uv, time)),
        )
        for number, pixels in enumerate(pixel_sets)
    ]


def _solver(options: Options) -> Solver:
    """Return what makes images from what is splatted."""
    if options.method == "dense-rows":
        return sum_rows
    return lambda laplacian, room: integrate(laplacian, options.integrator, cycles=options.cycles, out=room)


def _finished(
    image: Image, squares: Raster, raster: Raster, camera: ThinLens, database: Database, options: Options
) -> Image:
    """Return the image as dark towards its corners as the lens leaves it, if asked for, and in the frame's pixels."""
    if options.vignetting:
        image[..., :3] *= illumination(database.grid.model, squares, camera.sensor_width_mm)[..., None]
    return unsquared(image, raster)


def _shows_samples(samples: SampleBuffer, camera: ThinLens, database: Database, options: Options) -> bool:
    """Tell whether the image should be the mean of many samples: same effects, round lens, all of lens and shutter."""
    model = database.grid.model
    moves = bool(samples.motion.any())
    as_samples = (options.motion or not moves) and camera.shutter_curve is None
    if model.settings or not as_samples:
        return False
    axes = {axis.name for axis in model.axes}
    shown = axes == {"coc", "motion"} or (axes == {"coc"} and not moves)
    return shown and takes_whole_lens(samples, camera, pinhole=not options.defocus)


def _places(samples: SampleBuffer, visibility: PassingSamples) -> list[Image]:
    """Return the place of each sample among the layers, one array (H, W) for each of a pixel."""
    return [
        np.where(valid & (each.variant >= 0), each.layer.astype(np.float32) + each.farther, NOWHERE)
        for valid, each in zip(np.moveaxis(samples.valid, 2, 0), visibility.members, strict=True)
    ]


def _sharp_share(plan: Plan, valid: BoolArray) -> Image:
    """Return the share of each pixel's samples whose PSF reaches no farther than the pixels around it, (H, W)."""
    narrow = np.append(plan.table.reaches <= 1, False)  # variant -1 is nothing
    count = sum(narrow[members.variant].astype(np.float32) for members in plan.members)
    return np.asarray(count / np.maximum(valid.sum(axis=2), 1), np.float32)


def _clamped_frame(frame_layers: Sequence[Layer], factor: float | None) -> tuple[list[Layer], int]:
    """Clamp the fireflies of each layer of a frame, if asked for; return how many pixels were."""
    if factor is None or math.isinf(factor):
        return list(frame_layers), 0
    found = [clamp_fireflies([(layer.radiance, None)], factor) for layer in frame_layers]
    clamped = [replace(layer, radiance=colours[0]) for layer, (colours, _) in zip(frame_layers, found, strict=True)]
    return clamped, sum(count for _, count in found)


def _clamped_samples(pixel_sets: list[Pixels], factor: float) -> tuple[list[Pixels], int]:
    """Clamp the fireflies among samples; return how many were."""
    if math.isinf(factor):
        return pixel_sets, 0
    colours, count = clamp_fireflies([(each.radiance, each.labels.shift) for each in pixel_sets], factor)
    return [each._replace(radiance=colour) for each, colour in zip(pixel_sets, colours, strict=True)], count


def _layers_of_samples(pixels: Pixels, options: Options) -> Layering:
    """Divide samples by depth where surfaces meet, as one sample of each pixel tells."""
    met = np.where(pixels.radiance[..., 3] > 0.0, np.int32(0), np.int32(-1))
    softness = SAMPLE_SOFTNESS if options.softness is None else options.softness
    return Layering.fitted([(pixels.labels, met)], options.layers or MOST_SAMPLE_LAYERS, softness)


def _add_drawing(
    image: Image,
    drawing: Drawing,
    visibility: Visibility | None,
    solver: Solver,
    clock: Clock,
    tally: Tally,
    *,
    closed: bool,
    parts: list[tuple[int, Image]] | None = None,
) -> None:
    """Put the layers of a drawing behind an image, in place; list their numbers and what each adds, if asked for."""
    # List the runs of each layer.
    with clock.step("splat"):
        sources = [[find_runs(each, drawing.table, drawing.n_layers) for each in levels] for levels in drawing.sources]
    # Go through the layers that draw anything, nearest first.
    used = [
        k
        for k in range(drawing.n_layers)
        if any(len(runs.of(GROUPS * k + group)) for levels in sources for runs in levels for group in range(GROUPS))
    ]
    for number in used:
        covered, canvas, padded = _splat_layer(sources, number, drawing, image.shape, solver, clock)
        last = closed and number == used[-1]
        if last and drawing.parts_colours:
            _, _, white = _splat_layer(_in_white(sources), number, drawing, image.shape, solver, clock)
            lights = cleared(padded.shape)
            for levels in sources[len(sources) - drawing.n_lights :]:
                splat_direct(lights, canvas, levels[0], GROUPS * number + DIRECT, drawing.table)
            even_colours(padded, white, lights)
        # Normalise the layer by its visibility, and put it behind the image.
        with clock.step("composite"):
            seen = None if visibility is None or last else visibility.seen(number)
            kind = LAST if last else COVERAGE if visibility is None else visibility.kind
            least = LEAST_SEEN if visibility is None else visibility.least
            seen = NOTHING if seen is None else seen
            beyond = NOTHING if visibility is None or last else visibility.beyond(number)
            placed = (canvas.top, canvas.left), kind
            before = None if parts is None else copied(image)
            blur = None if visibility is None else visibility.guessed_blur(number)
            lanes = None if visibility is None else visibility.lanes(number)
            add_layer(
                image,
                padded,
                *placed,
                seen=seen,
                beyond=beyond,
                least=least,
                corner=drawing.corner,
                blur=blur,
                lanes=lanes,
            )
            if parts is not None and before is not None:
                parts.append((number, np.subtract(image, before, out=before)))
            # The next layer is drawn where this one was.
            del padded, seen, beyond, lanes
        tally.add_canvas(covered, image.shape)
    tally.add_drawing(drawing, len(used))


def _in_white(sources: list[list[Runs]]) -> list[list[Runs]]:
    """Return runs whose pixels are as opaque as they are, and white."""
    return [
        [
            runs._replace(source=runs.source._replace(radiance=np.repeat(runs.source.radiance[..., 3:], 4, axis=-1)))
            for runs in levels
        ]
        for levels in sources
    ]


def _splat_layer(
    sources: list[list[Runs]], number: int, drawing: Drawing, shape: tuple[int, ...], solver: Solver, clock: Clock
) -> tuple[Canvas, Canvas, Image]:
    """Return what a layer's splats cover, and the canvas and the image of their sum, as far as a frame shows it."""
    flat = [each for levels in sources for each in levels]
    # Find what each group covers; what is shown lies on one canvas.
    with clock.step("splat"):
        canvases = {
            group: canvas_of(flat, GROUPS * number + group, drawing.table, margin, drawing.corner)
            for group, margin in enumerate((*(SOLVER_MARGIN * stride for stride in STRIDES), 0))
        }
        covered = {group: canvas for group, canvas in canvases.items() if canvas is not None}
        seen = [canvas if group == DIRECT else within(canvas, shape) for group, canvas in covered.items()]
        shown = union(seen)
    # Draw sparse Laplacians, and integrate them; what is smooth is done by coarser pixels.
    drawn = [
        (canvas, STRIDES[group], _integrated(sources, number, group, drawing, canvas, solver, clock))
        for group, canvas in covered.items()
        if group != DIRECT
    ]
    with clock.step("composite"):
        if len(drawn) == 1 and drawn[0][1] == 1 and union([shown, drawn[0][0]]) == drawn[0][0]:
            shown, _, padded = drawn[0]
        else:
            padded = cleared((shown.rows, shown.cols, 4))
            for canvas, step, image in drawn:
                add_to_canvas(padded, shown, image, canvas, step)
    with clock.step("splat"):
        # Add small PSFs and exact highlights on top.
        for levels in sources:
            splat_direct(padded, shown, levels[0], GROUPS * number + DIRECT, drawing.table)
    return union(list(covered.values())), shown, padded


def _integrated(
    sources: list[list[Runs]], number: int, group: int, drawing: Drawing, canvas: Canvas, solver: Solver, clock: Clock
) -> Image:
    """Draw a group of a layer's sparse Laplacians, and return the image that they are of."""
    with clock.step("splat"):
        laplacian = splat_laplacian(canvas, sources, GROUPS * number + group, drawing.table, STRIDES[group])
    with clock.step("integrate"):
        return solver(laplacian, buffer(laplacian.shape))


def _filtered(
    given: Sequence[Layer],
    camera: ThinLens,
    database: Database,
    options: Options,
    clock: Clock,
    tally: Tally,
    dense_psf: DensePsf | None,
) -> Image:
    """Filter each layer of a frame with the PSFs of the receiving pixels, and composite.

    A filter has one PSF for each pixel: that of its own surface, at mid-shutter, along a straight path, with a shutter
    that is open evenly.
    """
    label = partial(frame_pixels, defocus=options.defocus, motion=options.motion, controls=options, split=undivided)
    middle = replace(camera.at(camera.shutter_centre), shutter_curve=None)
    image = np.zeros((*given[0].shape, 4), np.float32)
    for layer in given:
        with clock.step("plan"):
            (pixels,) = label(layer.straight(), middle)
            # A filter has no place to move light to.
            unmoved = pixels._replace(labels=pixels.labels._replace(shift=None))
            plan = plan_pixels([unmoved], database, options, 1, border=False, dense_psf=dense_psf, shared=False)
            drawing = plan.lay_out([unmoved])
            tally.add_plan(plan)
        with clock.step("splat"):
            # All that is filtered counts, also where nothing is drawn.
            filtered = np.zeros_like(image)
            if drawing.sources:
                filtered = gather(drawing.sources[0][0]._replace(radiance=pixels.radiance), drawing.table)
        with clock.step("composite"):
            add_layer(image, filtered, (0, 0), COVERAGE)
        tally.add_drawing(drawing, 1)
    return image


def _has_defocus(database: Database) -> bool:
    """Tell whether the database's PSFs are those of a lens; say so if not, for then the camera's changes nothing."""
    model = database.grid.model
    if not model.has_defocus:
        warnings.warn(
            f"the database's model {model.name!r} has no axis 'coc': the camera's defocus is ignored", stacklevel=3
        )
    return model.has_defocus


def _check_fit(database: Database, camera: ThinLens, width: int) -> None:
    """Refuse two shutter curves, and say in what the camera differs from the one that the database was built for."""
    if camera.shutter_curve is not None and database.grid.model.settings.get("shutter_curve") is not None:
        raise InvalidParameterError(
            f"the database {database.path.name!r} has a shutter curve, and so has the camera "
            f"({option('shutter_curve')}): one of them is enough"
        )
    differences = view_differences(database.grid.model, camera, width)
    if differences:
        warnings.warn(
            f"the database {database.path.name!r} was built for another camera: {'; '.join(differences)}", stacklevel=3
        )
