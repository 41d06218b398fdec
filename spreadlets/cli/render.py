"""Commands that make images: synthesis on frames and sequences, reconstruction from samples."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Mapping
from contextlib import AbstractContextManager, nullcontext
from typing import TYPE_CHECKING, Any

import click
import cloup

from spreadlets.cli.controls import bokeh_options, control_options, take_bokeh
from spreadlets.cli.options import (
    TableChoice,
    drawn_camera_options,
    effect_options,
    input_options,
    json_option,
    output_options,
    sequence_options,
    splatting_options,
    take_camera,
    take_reading,
    take_sequence,
)
from spreadlets.cli.show import print_figures, progress_bar
from spreadlets.cli.status import EXIT_FAILURE

if TYPE_CHECKING:
    from spreadlets.jobs.job import Job


@cloup.command()
@cloup.argument("frames", nargs=-1, required=True, type=click.Path(dir_okay=False), metavar="FRAME.exr...")
@output_options(
    "The image to write: .exr, or for viewing .png, .jpg or .tif.",
    cloup.option("--also", metavar="NAME,...", help="Blur these further colour layers of the file, too."),
    cloup.option("--pass-through", is_flag=True, help="Copy all other channels of the file unchanged."),
    cloup.option(
        "--hidden-from",
        multiple=True,
        type=click.Path(dir_okay=False),
        metavar="FRAME.exr",
        help="Take what is hidden from this frame right before or after, too; may be repeated. Of a sequence, such as "
        "frame.####.exr, from the frames before and after each.",
    ),
    cloup.option("--output-coc", type=click.Path(dir_okay=False), help="Write the signed CoC radii, px (.exr)."),
)
@drawn_camera_options
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
    layers="the frame's own, else as many as it needs, at most 12",
    fireflies="Dim pixels brighter than this times any other around them.",
)
@input_options
@sequence_options
@json_option
def synth(
    frames: tuple[str, ...],
    output: str,
    camera: str | None,
    reference: str | None,
    also: str | None,
    pass_through: bool,
    output_coc: str | None,
    bit_depth: int | None,
    hidden_from: tuple[str, ...],
    as_json: bool,
    **options: Any,
) -> None:
    """Synthesise depth of field and motion blur on a frame: colour, depth and motion vectors as OpenEXR.

    Several frames are depth layers of one view, nearest first. A path with a counter, such as frame.####.exr or
    frame.%04d.exr, is a sequence; camera and reference may have one, too. Results that exist are kept, and a frame that
    cannot be made does not stop the others.

    Example: spreadlets synth frame.####.exr -o out.####.exr --camera camera.json --frames 1-24
    """
    from spreadlets.files.sequence import is_pattern
    from spreadlets.jobs.synthesis import Synthesis
    from spreadlets.runtime.options import RENDER_OPTIONS

    if any(map(is_pattern, frames)) and not all(map(is_pattern, hidden_from)):
        raise click.UsageError("of a sequence, --hidden-from is one, too, such as frame.####.exr")

    # Sort the options by what takes them.
    sequence, reading, lens = take_sequence(options), take_reading(options), take_camera(options)
    database = options.pop("database")
    aperture = take_bokeh(options, database)
    job = Synthesis(
        frames,
        output,
        camera,
        lens,
        reference,
        database,
        bit_depth,
        {name: options[name] for name in RENDER_OPTIONS if name in options},
        reading,
        aperture,
        tuple(name.strip() for name in also.split(",")) if also else (),
        pass_through,
        output_coc,
        tuple((path, reading) for path in hidden_from),
    )
    with _compiling("synthesize", sequence):
        _run(job, sequence, as_json)


def _compiling(run: str, sequence: Mapping[str, Any]) -> AbstractContextManager[None]:
    """Let other processors help with compiling, if this process makes the frames; if not, it loads no kernels."""
    if sequence.get("jobs", 1) > 1 or sequence.get("scheduler"):
        return nullcontext()
    from spreadlets.ahead import compiled_ahead

    return compiled_ahead(run)


def _run(job: Job, sequence: dict[str, Any], as_json: bool) -> None:
    """Make an image or a sequence and print the report."""
    from spreadlets.files.sequence import is_pattern

    if any(is_pattern(path) for path in job.inputs):
        _run_sequence(job, sequence, as_json)
        return
    if sequence:
        given = ", ".join(f"--{name}" for name in sequence)
        raise click.UsageError(f"{given}: for sequences, such as frame.####.exr")
    if is_pattern(job.output):
        raise click.UsageError(f"the output {job.output} has a counter, but nothing that is read has one")
    job.check()
    with progress_bar(os.path.basename(job.output), quiet=as_json) as progress:
        report = job.make(progress)
    print_figures(report, as_json)


def _run_sequence(job: Job, sequence: dict[str, Any], as_json: bool) -> None:
    """Make a sequence, with a bar; for people each frame's report is cut to its time."""
    from spreadlets.files.sequence import listed
    from spreadlets.jobs.sequence import chosen_frames, run_sequence

    chosen = chosen_frames(job, sequence.pop("frames", None))
    with progress_bar(os.path.basename(job.output), quiet=as_json) as progress:
        report = run_sequence(job, chosen, progress=progress, **sequence)
    for entry in report["frames"]:
        if "error" in entry:
            click.echo(f"error: frame {entry['frame']}: {' '.join(entry['error'].split())}", err=True)
    if not as_json:
        report["frames"] = {entry["output"]: _outcome(entry) for entry in report["frames"]}
    print_figures(report, as_json)
    if report["failed"]:
        count = f"{len(report['failed'])} of {len(report['frames'])} frames could not be made"
        click.echo(f"failed: {count}: {listed(report['failed'])}", err=True)
        sys.exit(EXIT_FAILURE)


def _outcome(entry: Mapping[str, Any]) -> str:
    """Return what people are told of a frame of a sequence."""
    if "error" in entry:
        return "failed"
    return "kept" if entry["skipped"] else f"{entry['time_s']['total']:.2f} s"


@cloup.command()
@cloup.argument("samples", type=click.Path(dir_okay=False), metavar="SAMPLES.exr")
@output_options("The image to write: .exr, or for viewing .png, .jpg or .tif.")
@drawn_camera_options
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
    layers="as many as they need, at most 7",
    fireflies="Dim samples brighter than this times any other that comes from within a pixel (default: 32; inf: off).",
)
@cloup.option("--repair", is_flag=True, help="Drop invalid samples instead of refusing the buffer.")
@sequence_options
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

    SAMPLES.exr holds one part per sample, or is a TLFR buffer. A path with a counter, such as samples.####.exr, is a
    sequence.

    Example: spreadlets reconstruct samples.exr -o out.exr --camera camera.json --spp 1
    """
    from spreadlets.jobs.reconstruction import Reconstruction

    sequence, lens, database = take_sequence(options), take_camera(options), options.pop("database")
    settings = _assigned(assignments)
    job = Reconstruction(
        (samples,), output, camera, lens, reference, database, bit_depth, options, settings, spp, repair
    )
    with _compiling("reconstruct", sequence):
        _run(job, sequence, as_json)


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
