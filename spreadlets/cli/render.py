"""Commands that make images: synthesis on frames and sequences, reconstruction from samples."""

from __future__ import annotations

import json
import os
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any, NamedTuple

import click
import cloup

from spreadlets.arrays import Image
from spreadlets.cli.controls import bokeh_options, control_options, take_bokeh
from spreadlets.cli.options import (
    TableChoice,
    camera_of,
    camera_options,
    effect_options,
    input_options,
    json_option,
    output_options,
    splatting_options,
    take_camera,
    take_reading,
)
from spreadlets.cli.show import print_figures, progress_bar
from spreadlets.cli.status import EXIT_FAILURE
from spreadlets.errors import AmbiguousInputWarning


class _Job(NamedTuple):
    """One image to make: the files it is made from, and how."""

    frames: Sequence[str]
    output: str
    camera: str | None
    lens: dict[str, Any]
    reference: str | None
    reading: dict[str, Any]
    rendering: dict[str, Any]
    also: Sequence[str] = ()
    pass_through: bool = False
    output_coc: str | None = None
    bit_depth: int | None = None

    def check(self) -> None:
        """Raise an error, before anything is computed, if the image cannot be written or would replace what is read."""
        from spreadlets.files.images import OPENEXR, image_extension
        from spreadlets.files.outputs import check_outputs

        database = self.rendering["database"]
        passes = [value for name, value in self.reading.items() if name.endswith("_file")]
        others = (self.camera, self.reference, *passes, database if isinstance(database, str) else None)
        if self.output_coc and image_extension(self.output_coc) != OPENEXR:
            raise click.UsageError(f"--output-coc {self.output_coc}: radii have a sign; name the file {OPENEXR}")
        if self.pass_through and (self.rendering.get("proxy") or self.rendering.get("region")):
            raise click.UsageError("--pass-through copies channels of the whole frame: leave --proxy and --region out")
        outputs = [self.output, *filter(None, [self.output_coc])]
        check_outputs(outputs, [*self.frames, *filter(None, (*others, self.rendering.get("mask")))])


@cloup.command()
@cloup.argument("frames", nargs=-1, required=True, type=click.Path(dir_okay=False), metavar="FRAME.exr...")
@output_options(
    "The image to write: .exr, or for viewing .png, .jpg or .tif.",
    cloup.option("--also", metavar="NAME,...", help="Blur these further colour layers of the file, too."),
    cloup.option("--pass-through", is_flag=True, help="Copy all other channels of the file unchanged."),
    cloup.option("--output-coc", type=click.Path(dir_okay=False), help="Write the signed CoC radii, px (.exr)."),
)
@camera_options
@control_options
@bokeh_options
@cloup.option_group(
    "Method",
    cloup.option(
        "--method",
        type=TableChoice("spreadlets.runtime.options", "METHODS"),
        default="spreadlets",
        show_default=True,
        help="dense and dense-rows draw PSFs in full, gather filters.",
    ),
    cloup.option("--db", "database", help="Database: a file or a shipped name."),
    cloup.option("--vignetting", is_flag=True, help="Darken the corners as the lens of a physicallens database does."),
)
@effect_options("Leave")
@splatting_options(
    layers="the frame's own, else 4", fireflies="Dim pixels brighter than this times any other around them."
)
@input_options
@cloup.option_group(
    "Sequences",
    cloup.option("--frames", "numbers", help="Frames to make, such as 1-24, 1-24x2 or 1,5,9-12 (default: all)."),
    cloup.option("--overwrite", is_flag=True, help="Make frames again whose results exist."),
)
@json_option
def synth(
    frames: tuple[str, ...],
    output: str,
    camera: str | None,
    reference: str | None,
    numbers: str | None,
    overwrite: bool,
    also: str | None,
    pass_through: bool,
    output_coc: str | None,
    bit_depth: int | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Synthesise depth of field and motion blur on a frame: colour, depth and motion vectors as OpenEXR.

    Several frames are depth layers of one view, nearest first. A path with a counter, such as frame.####.exr or
    frame.%04d.exr, is a sequence; camera and reference may have one, too. Results that exist are kept, and a frame that
    cannot be made does not stop the others.

    Example: spreadlets synth frame.####.exr -o out.####.exr --camera camera.json --frames 1-24
    """
    from spreadlets.files.images import OPENEXR, check_bit_depth, image_extension
    from spreadlets.files.sequence import is_pattern, listed, numbered
    from spreadlets.runtime.options import RENDER_OPTIONS

    reading, lens = take_reading(options), take_camera(options)
    rendering = {name: options.pop(name) for name in (*RENDER_OPTIONS, "database") if name in options}
    shape, motion = take_bokeh(options, rendering["database"]), rendering["motion"]
    database = rendering["database"]
    if shape:
        rendering["database"] = partial(_bokeh, shape, motion)
    layers = tuple(name.strip() for name in also.split(",")) if also else ()
    check_bit_depth(output, bit_depth)
    if image_extension(output) != OPENEXR and (layers or pass_through):
        raise click.UsageError(f"--also and --pass-through are for OpenEXR; name the output {OPENEXR}")
    if not any(is_pattern(path) for path in frames):
        if numbers or overwrite:
            raise click.UsageError("--frames and --overwrite are for sequences, such as frame.####.exr")
        job = _Job(
            frames, output, camera, lens, reference, reading, rendering, layers, pass_through, output_coc, bit_depth
        )
        job.check()
        print_figures(_synthesise(job), as_json)
        return
    with _databases() as choose:

        def make(number: int, path: str) -> dict[str, Any]:
            inputs = [numbered(item, number) for item in frames]
            truth = numbered(reference, number) if reference else None
            name, mask = rendering["database"], rendering["mask"]
            chosen = rendering | {"mask": numbered(mask, number) if mask else None}
            chosen["database"] = name if shape else lambda frame: choose(name, frame, motion)
            apart = {key: numbered(value, number) for key, value in reading.items() if key.endswith("_file") and value}
            shot = numbered(camera, number) if camera else None
            radii = numbered(output_coc, number) if output_coc else None
            job = _Job(inputs, path, shot, lens, truth, reading | apart, chosen, layers, pass_through, radii, bit_depth)
            report = _synthesise(job)
            warnings.simplefilter("ignore", AmbiguousInputWarning)  # the first frame has said it
            return report

        passes = [value for key, value in reading.items() if key.endswith("_file") and value]
        others = [each for each in (camera, reference, rendering["mask"], *passes) if each]
        reads = [*frames, *others, *(each for each in (database, shape.get("kernel")) if each)]
        with warnings.catch_warnings():
            report = _sequence(_chosen(frames, others, reads, output, numbers), output, overwrite, make, as_json)
    print_figures(report, as_json)
    if report["failed"]:
        count = f"{len(report['failed'])} of {len(report['frames'])} frames could not be made"
        click.echo(f"failed: {count}: {listed(report['failed'])}", err=True)
        sys.exit(EXIT_FAILURE)


def _compared(image: Image, truth: Image | None) -> dict[str, float]:
    """Return the errors of an image, if there is a reference."""
    if truth is None:
        return {}
    from spreadlets import metrics

    return metrics.compare(image, truth)


def _synthesise(job: _Job) -> dict[str, Any]:
    """Make one image and return its report; the database may be chosen by the frame."""
    from spreadlets.files import exr_frames as exr
    from spreadlets.files import images
    from spreadlets.files.exr_file import opened
    from spreadlets.files.further_channels import named_channels, other_channels, with_colours
    from spreadlets.files.pictures import read_plane
    from spreadlets.files.recognise import ReadOptions
    from spreadlets.renderer import Renderer
    from spreadlets.runtime.clock import Clock

    clock = Clock()
    with clock.step("read"), opened(job.frames) as files:
        camera = camera_of(job.camera, job.lens, files[0], job.reading.get("depth_scale", 1.0))
        options = ReadOptions(**job.reading, camera=camera)
        frame = exr.read_frame(files, options=options)
        elements = list(with_colours(files, frame, job.also, options.view))
        further = other_channels(files, frame.raster, options.colour_layer, options.view) if job.pass_through else {}
        truth = exr.read_reference(job.reference, options) if job.reference else None
    rendering = dict(job.rendering)
    database = rendering.pop("database")
    chosen = database(frame) if callable(database) else database
    if rendering.get("mask"):
        rendering["mask"] = read_plane(rendering["mask"])
    with progress_bar("building", quiet=False) as progress, Renderer(frame, chosen, progress=progress) as renderer:
        frames = [element for _, element in elements]
        (image, *blurred), report = renderer.render_all(frames, camera, clock, **rendering)
        raster, coc = renderer.raster(**rendering), renderer.coc(camera, **rendering) if job.output_coc else None
    if frame.repaired_pixels or frame.dropped_pixels:
        text = f"{frame.repaired_pixels} invalid pixels were mended, {frame.dropped_pixels} dropped"
        warnings.warn(text, stacklevel=1)
    figures = _compared(*_alike(image, truth, raster, rendering))
    for (name, _), element in zip(elements, blurred, strict=True):
        further |= named_channels(name, element)
    with clock.step("write"):
        images.write_image(job.output, image, bit_depth=job.bit_depth, raster=raster, channels=further)
        if job.output_coc is not None and coc is not None:
            images.write_plane(job.output_coc, "coc", coc, raster=renderer.raster(region=rendering.get("region")))
    return report.to_dict() | {"time_s": clock.times()} | figures


def _bokeh(shape: Mapping[str, Any], motion: bool, frame: Any) -> Any:
    """Return the model of an aperture for a frame."""
    from spreadlets.bokeh import bokeh_model

    return bokeh_model(moving=motion and any(layer.has_motion for layer in frame.layers), **shape)


def _alike(image: Image, truth: Image | None, raster: Any, rendering: Mapping[str, Any]) -> tuple[Image, Image | None]:
    """Return an image and its reference as the same pixels: those displayed, or of the region, at the proxy's size."""
    if truth is None:
        return image, None
    from spreadlets.scene.parts import means
    from spreadlets.scene.raster import placed

    window = raster.data if rendering.get("region") else raster.display
    truth = means(truth, raster.display.shape) if rendering.get("proxy") else truth
    return placed(image, raster.data, window), placed(truth, raster.display, window)


def _chosen(
    frames: Sequence[str], others: Sequence[str], reads: Sequence[str], output: str, numbers: str | None
) -> list[int]:
    """Return which frames of a sequence to make, after checking that no result replaces a file that is read."""
    from spreadlets.files.outputs import check_outputs
    from spreadlets.files.sequence import listed, numbered, sequence_frames

    chosen, gaps = sequence_frames(frames, others, output, numbers)
    if gaps:
        warnings.warn(f"the sequence has no frames {listed(gaps)}", stacklevel=1)
    check_outputs(
        [numbered(output, number) for number in chosen],
        {numbered(path, number) for path in reads for number in chosen},
    )
    return chosen


def _sequence(
    chosen: Sequence[int],
    output: str,
    overwrite: bool,
    make: Callable[[int, str], dict[str, Any]],
    as_json: bool,
) -> dict[str, Any]:
    """Make the frames of a sequence, with a bar; for people each frame's report is cut to its time."""
    from spreadlets.files.sequence import run_sequence

    with progress_bar(os.path.basename(output), quiet=as_json) as progress:
        report = run_sequence(chosen, output, make, overwrite=overwrite, progress=progress)
    for entry in report["frames"]:
        if "error" in entry:
            click.echo(f"error: frame {entry['frame']}: {' '.join(entry['error'].split())}", err=True)
    if not as_json:
        report["frames"] = {entry["output"]: _outcome(entry) for entry in report["frames"]}
    return report


def _outcome(entry: Mapping[str, Any]) -> str:
    """Return what people are told of a frame of a sequence."""
    if "error" in entry:
        return "failed"
    return "kept" if entry["skipped"] else f"{entry['time_s']['total']:.2f} s"


@contextmanager
def _databases() -> Iterator[Callable[[str | None, Any, bool], Any]]:
    """Give a function that returns an open database for a frame; each is opened once."""
    from spreadlets.psf.database import Database, open_database
    from spreadlets.renderer import default_database

    opened: dict[str, Database] = {}

    def choose(name: str | None, frame: Any, motion: bool) -> Database:
        wanted = name or default_database(motion and any(layer.has_motion for layer in frame.layers))
        if wanted not in opened:
            opened[wanted] = open_database(wanted)
        return opened[wanted]

    try:
        yield choose
    finally:
        for database in opened.values():
            database.close()


@cloup.command()
@cloup.argument("samples", type=click.Path(dir_okay=False), metavar="SAMPLES.exr")
@output_options("The image to write: .exr, or for viewing .png, .jpg or .tif.")
@camera_options
@cloup.option_group(
    "Method",
    cloup.option(
        "--method",
        type=TableChoice("spreadlets.runtime.options", "RECONSTRUCTION_METHODS"),
        default="spreadlets",
        show_default=True,
        help="dense and dense-rows draw PSFs in full; sheared to lrdm-ewa are layered reconstructions; tlfr has "
        "exact visibility, and is slow; mean is that of each pixel's samples; bm3d and oidn denoise it with an "
        "optional package.",
    ),
    cloup.option("--db", "database", help="Database: a file or a shipped name."),
    cloup.option("--spp", type=click.IntRange(min=1), help="Use so many samples of each pixel (default: all)."),
    cloup.option(
        "--set",
        "assignments",
        multiple=True,
        metavar="NAME=VALUE",
        help="A setting of a method from sheared to tlfr, such as tile=64 or views=128; may be repeated.",
    ),
    cloup.option(
        "--denoise",
        type=TableChoice("spreadlets.runtime.options", "DENOISERS"),
        help="Denoise what is sharp and still, with an optional package.",
    ),
    cloup.option(
        "--no-calibrate",
        "calibrate",
        is_flag=True,
        flag_value=False,
        default=True,
        help="Do not bring the image's local means to those of the samples.",
    ),
)
@effect_options("Take")
@splatting_options(
    layers="4",
    fireflies="Dim samples brighter than this times any other that comes from within a pixel (default: 32; inf: off).",
)
@cloup.option("--repair", is_flag=True, help="Drop invalid samples instead of refusing the buffer.")
@json_option
def reconstruct(
    samples: str,
    output: str,
    camera: str | None,
    reference: str | None,
    bit_depth: int | None,
    spp: int | None,
    repair: bool,
    as_json: bool,
    assignments: tuple[str, ...],
    **options: Any,
) -> None:
    """Clean a buffer of stochastic samples, which were rendered through lens and shutter.

    SAMPLES.exr holds one part per sample, or is a TLFR buffer.

    Example: spreadlets reconstruct samples.exr -o out.exr --camera camera.json --spp 1
    """
    from spreadlets.api import reconstruct as make
    from spreadlets.files import exr_frames as exr
    from spreadlets.files import images
    from spreadlets.files.exr_samples import read_samples, samples_files
    from spreadlets.files.outputs import check_outputs
    from spreadlets.runtime.clock import Clock
    from spreadlets.scene.raster import placed

    images.check_bit_depth(output, bit_depth)
    check_outputs(
        [output], [each for each in (*samples_files(samples), camera, reference, options["database"]) if each]
    )
    clock = Clock()
    with clock.step("read"):
        lens = camera_of(camera, take_camera(options), samples)
        buffer = read_samples(samples, camera=lens, repair=repair)
        truth = exr.read_image(reference) if reference else None
    given = buffer.take(spp) if spp else buffer
    settings = _assigned(assignments)
    with progress_bar(os.path.basename(output), quiet=as_json) as progress:
        image, report = make(given, lens, **options, settings=settings, report=True, clock=clock, progress=progress)
    if buffer.dropped_samples:
        warnings.warn(f"{buffer.dropped_samples} invalid samples were dropped", stacklevel=1)
    raster = buffer.raster
    figures = _compared(placed(image, raster.data, raster.display), truth)
    with clock.step("write"):
        images.write_image(output, image, bit_depth=bit_depth, raster=raster)
    print_figures(report.to_dict() | {"time_s": clock.times()} | figures, as_json)


@cloup.command()
@json_option
def tune(as_json: bool) -> None:
    """Find how much work a thread should take at a time in the methods lrdm, lrdm-sheared and lrdm-ewa, and keep it.

    The sizes are kept in a file of this user's; images do not depend on them. Takes a few seconds.

    Example: spreadlets tune
    """
    from spreadlets.api import tune_layered_methods

    print_figures(tune_layered_methods(), as_json)


def _assigned(assignments: tuple[str, ...]) -> dict[str, object]:
    """Return the values of NAME=VALUE by name: numbers, true and false, or else text."""
    values: dict[str, object] = {}
    for assignment in assignments:
        name, equals, text = assignment.partition("=")
        if not equals:
            raise click.UsageError(f"--set {assignment}: a setting is NAME=VALUE, such as bilinear=true")
        try:
            values[name] = json.loads(text)
        except ValueError:
            values[name] = text
    return values
