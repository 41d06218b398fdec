"""The ``spreadlets`` command: exits 0 on success, 2 on bad input (one line on standard error), 1 on its own failure."""

from __future__ import annotations

import json
import math
import os
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import click

from spreadlets.errors import AmbiguousInputWarning, BuildStoppedError, SpreadletsError

BAR_WIDTH = 40
"""Characters of the whole time in the chart of steps."""

_DEFAULT = click.core.ParameterSource.DEFAULT

EXIT_BAD_INPUT = 2
EXIT_FAILURE = 1
EXIT_INTERRUPTED = 130

INPUT_OPTIONS = (
    click.option("--preset", help="Renderer: blender, arnold, renderman, vray, redshift, karma or nuke."),
    click.option("--colour-layer", help="Name of the colour layer, if there are several."),
    click.option("--depth-channel", help="Name of the depth channel, if it is not recognised."),
    click.option("--depth-convention", help="planar, ray (distance along the ray), inverse (1/depth) or disparity."),
    click.option("--depth-scale", type=float, default=1.0, show_default=True, help="Metres per unit of depth."),
    click.option("--baseline", "baseline_m", type=float, help="Distance of the two cameras, metres, for disparity."),
    click.option("--motion-channels", help="Names of the motion channels, separated by commas; none ignores them."),
    click.option(
        "--motion-convention",
        help="DIRECTION-UNIT[-up] with forward or backward, and px, ndc, uv, norm, norm8 or norm16; blender, nuke, "
        "nuke-forward, nuke-backward, curved-px, camera-velocity, camera-velocity-sum or ndc.",
    ),
    click.option("--max-displacement", type=float, help="Motion in px at the end of a normalised range."),
    click.option("--unpremultiplied", is_flag=True, help="The colours are not multiplied by alpha."),
)
"""How to read a frame; what is not given is recognised."""


def input_options(command: Callable[..., None]) -> Callable[..., None]:
    """Add the options of reading a frame to a command."""
    for option in reversed(INPUT_OPTIONS):
        command = option(command)
    return command


json_option = click.option("--json", "as_json", is_flag=True, help="Print one JSON object on standard output.")


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="spreadlets")
def cli() -> None:
    """Depth of field and motion blur for rendered frames, by splatting sparse Laplacians of PSFs.

    Example: spreadlets synth frame.exr -o out.exr --camera camera.json
    """


@cli.command()
@click.argument("model")
@click.option("-o", "--output", required=True, type=click.Path(dir_okay=False), help="The database to write (HDF5).")
@click.option("--samples", type=click.IntRange(min=1), help="Number of cells (default: the model's own).")
@click.option("--max-coc", type=float, help="Largest CoC radius, px.")
@click.option("--max-motion", type=float, help="Longest motion over the shutter, px.")
@click.option("--density", type=click.Choice(["0.5", "1", "2"]), help="Points, times the usual number (default: 1).")
@click.option("--lens", help="physicallens: a prescription file, or singlet, doublet, double_gauss (shipped).")
@click.option("--width", type=click.IntRange(min=1), help="physicallens, volume: width of the frames to come, px.")
@click.option("--image", help="stylized: the PSF (PNG).")
@click.option("--colour-offset", type=float, help="stylized: shift of red and blue, in radii of the PSF.")
@click.option("--medium-density", type=float, help="volume: collisions per metre.")
@click.option("--anisotropy", type=float, help="volume: mean cosine of the scattering angle, -1 to 1.")
@click.option("--albedo", type=float, nargs=3, help="volume: share of R, G and B that a collision keeps.")
@click.option("--max-distance", type=float, help="volume: farthest distance, m.")
@click.option("--psf-radius", type=float, help="volume: radius of the PSFs, px.")
@click.option("--blades", type=click.IntRange(min=0), help="simplelens, combined: edges of the aperture (0: round).")
@click.option("--blade-curvature", type=float, help="... from 0 (straight edges) to 1 (round).")
@click.option("--rotation", type=float, help="... of the blades, degrees.")
@click.option("--cats-eye", type=float, help="... distance of a second, clipping circle, radii.")
@click.option("--cats-eye-angle", type=float, help="... its direction, degrees.")
@click.option("--squeeze", type=float, help="... width over height of an anamorphic PSF.")
@click.option("--spherical-aberration", type=float, help="... above 0: dark rim behind focus, bright in front.")
@click.option("--obstruction", type=float, help="... radius of a central obstruction, radii.")
@click.option("--shutter-curve", help="combined: openness over time (0,1,1,0.5) or trapezoid:RISE,FALL.")
@click.option("--for", "frame_paths", multiple=True, help="Build only what this frame uses (EXR; can be repeated).")
@click.option("--camera", "camera_path", help="Camera file (JSON): of those frames; for physicallens and volume.")
@click.option("--jobs", type=click.IntRange(min=1), help="Processes (default: all cores).")
@click.option("--scheduler", metavar="ADDRESS", help="Compute on the workers of this Dask scheduler (HOST:PORT).")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of all random choices.")
@click.option("--extend", is_flag=True, help="Widen the database OUTPUT: its range, its density, or for more frames.")
@click.option("--log", type=click.Path(dir_okay=False), help="Add a line for each finished cell to this file.")
@json_option
def build(
    model: str,
    output: str,
    density: str | None,
    frame_paths: tuple[str, ...],
    camera_path: str | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Build a database of spreadlets for a PSF MODEL: simplelens, combined, physicallens, volume or stylized.

    Options that start with a model's name belong to that model.

    An interrupted build leaves its finished cells in OUTPUT.parts; the same command goes on from there. With --extend,
    what is not given stays as it is, and what is there is kept.

    Example: spreadlets build combined -o combined.h5 --max-coc 64 --max-motion 128

    Example: spreadlets build physicallens -o gauss.h5 --lens double_gauss --camera camera.json --width 1024
    """
    from spreadlets.api import build_database
    from spreadlets.files.exr_frames import read_frame
    from spreadlets.psf.database import open_database
    from spreadlets.scene.camera import read_camera

    if frame_paths and not camera_path:
        raise click.UsageError("--for needs --camera, too")
    if camera_path:
        options["camera"] = read_camera(camera_path)
    if frame_paths:
        options["frames"] = [read_frame(path) for path in frame_paths]
    with _progress(f"building {model}", quiet=as_json) as progress:
        build_database(model, output, density=float(density) if density else None, progress=progress, **options)
    with open_database(output) as database:
        _print(database.summary(), as_json)


@cli.command()
@click.argument("target", metavar="DB|FRAME.exr")
@click.option("--plot", type=click.Path(dir_okay=False), help="Draw histograms and the worst cells of a DB (PNG).")
@click.option("--verify", is_flag=True, help="Check every cell of a DB against its recorded figures; takes a while.")
@click.option("--jobs", type=click.IntRange(min=1), help="Processes for --verify (default: all cores).")
@click.option("--camera", "camera_path", type=click.Path(dir_okay=False), help="Camera file (JSON) of a frame.")
@input_options
@json_option
@click.pass_context
def info(
    context: click.Context,
    /,
    target: str,
    plot: str | None,
    verify: bool,
    jobs: int | None,
    camera_path: str | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Show what a database holds and how good it is (a file or a shipped name), or how a frame would be read.

    Of a frame: size, parts, what was recognised as colour, depth and motion, by which convention, and the ranges of
    values.

    Example: spreadlets info frame.exr --preset nuke
    """
    from spreadlets.files.inspect import is_frame_file

    if is_frame_file(target):
        if plot or verify:
            raise click.UsageError(f"{'--plot' if plot else '--verify'} is for databases")
        _print(_frame_info(target, camera_path, options), as_json)
        return
    given = [name for name in ("camera_path", *options) if context.get_parameter_source(name) is not _DEFAULT]
    if given:
        raise click.UsageError(
            f"{target} is no frame: --camera and the options of reading a frame are not for databases"
        )
    if jobs and not verify:
        raise click.UsageError("--jobs is for --verify")
    _database_info(target, plot, as_json, (verify, jobs))


def _frame_info(path: str, camera_path: str | None, options: dict[str, Any]) -> dict[str, Any]:
    from spreadlets.files.conventions import Scale
    from spreadlets.files.inspect import frame_info
    from spreadlets.files.recognise import ReadOptions
    from spreadlets.scene.camera import read_camera

    settings = _input_settings(options)
    camera = read_camera(camera_path) if camera_path else None
    scale = Scale(camera, *(settings.pop(name) for name in ("depth_scale", "baseline_m", "max_displacement")))
    return frame_info(path, ReadOptions(**settings, scale=scale))


def _database_info(database: str, plot: str | None, as_json: bool, verification: tuple[bool, int | None]) -> None:
    """Print the summary of a database, verified if that is asked for: then a bad one is an error."""
    from spreadlets.api import DensePsfs, verify_database
    from spreadlets.psf.database import open_database
    from spreadlets.reports.database_plot import plot_database

    verify, jobs = verification
    with open_database(database) as opened:
        if plot:
            plot_database(opened, plot, DensePsfs(opened))
        figures = opened.summary()
        if verify:
            with _progress(f"verifying {opened.path.name}", quiet=as_json) as progress:
                figures["verified"] = verify_database(opened, jobs=jobs, progress=progress)
        _print(figures, as_json)


def _input_settings(options: dict[str, Any]) -> dict[str, Any]:
    """Return the options of reading a frame as `read_frame` takes them."""
    names = options["motion_channels"]
    channels = () if names == "none" else tuple(names.split(",")) if names else None
    return options | {"motion_channels": channels}


@cli.command()
@click.argument("frames", nargs=-1, required=True, type=click.Path(dir_okay=False), metavar="FRAME.exr...")
@click.option("-o", "--output", required=True, type=click.Path(dir_okay=False), help="The image to write (EXR).")
@click.option("--camera", "camera_path", required=True, type=click.Path(dir_okay=False), help="Camera file (JSON).")
@click.option("--db", "database", help="Database: a file or a shipped name.")
@click.option(
    "--method",
    default="spreadlets",
    show_default=True,
    help="spreadlets, dense or dense-rows (PSFs drawn in full), or gather (filtering).",
)
@click.option("--integrator", help="Poisson solver: multigrid, pyramid, exact, pyramid-f5 or pyramid-f7.")
@click.option("--cycles", type=click.IntRange(min=0), help="Cycles of the integrator multigrid.")
@click.option("--tolerance", type=float, help="Display error to trade for speed; 0 draws every pixel by itself.")
@click.option("--layers", type=click.IntRange(min=1), help="Depth layers (default: the frame's own, else 4).")
@click.option("--softness", type=float, help="Transition between depth layers: 0 (hard) to 1 (soft, the default).")
@click.option(
    "--firefly-clamp",
    type=float,
    metavar="FACTOR",
    help="Dim pixels brighter than this times any other around them (default: off).",
)
@click.option("--vignetting", is_flag=True, help="Darken the corners as the lens of a physicallens database does.")
@click.option("--no-defocus", is_flag=True, help="Leave depth of field out.")
@click.option("--no-motion", is_flag=True, help="Leave motion blur out.")
@input_options
@click.option("--deep-layers", type=click.IntRange(min=1), help="Most layers made of a deep image (default: 8).")
@click.option("--repair", is_flag=True, help="Drop pixels with invalid values instead of refusing the frame.")
@click.option("--frames", "numbers", help="Frames of a sequence, such as 1-24, 1-24x2 or 1,5,9-12 (default: all).")
@click.option("--overwrite", is_flag=True, help="Make frames of a sequence again whose results exist.")
@click.option("--reference", type=click.Path(dir_okay=False), help="Compare the result with this image.")
@json_option
def synth(
    frames: tuple[str, ...],
    output: str,
    camera_path: str,
    database: str | None,
    deep_layers: int | None,
    repair: bool,
    numbers: str | None,
    overwrite: bool,
    reference: str | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Synthesise depth of field and motion blur on a frame: colour, depth and motion vectors as OpenEXR.

    Several frames are depth layers of one view, nearest first. A path with a counter, such as frame.####.exr or
    frame.%04d.exr, is a sequence; camera and reference may have one, too. Results that exist are kept.

    Example: spreadlets synth frame.####.exr -o out.####.exr --camera camera.json --frames 1-24
    """
    from spreadlets.files.sequence import is_pattern, numbered

    settings = _synthesis_settings(options)
    reading = _input_settings(options) | {"repair": repair} | ({"max_layers": deep_layers} if deep_layers else {})
    if not any(is_pattern(path) for path in frames):
        if numbers or overwrite:
            raise click.UsageError("--frames and --overwrite are for sequences, such as frame.####.exr")
        _print(_synthesise(frames, output, camera_path, reference, reading, settings | {"database": database}), as_json)
        return
    with _databases() as choose:

        def make(number: int, path: str) -> dict[str, Any]:
            inputs = [numbered(item, number) for item in frames]
            truth = numbered(reference, number) if reference else None
            chosen = settings | {"database": lambda frame: choose(database, frame, settings["motion"])}
            report = _synthesise(inputs, path, numbered(camera_path, number), truth, reading, chosen)
            warnings.simplefilter("ignore", AmbiguousInputWarning)  # the first frame has said it
            return report

        others = [camera_path, *([reference] if reference else [])]
        with warnings.catch_warnings():
            _print(_sequence(frames, others, output, numbers, overwrite, make, as_json), as_json)


def _synthesis_settings(options: dict[str, Any]) -> dict[str, Any]:
    """Take the options of `synthesize` out of a command's options."""
    names = ("method", "integrator", "cycles", "tolerance", "layers", "softness", "firefly_clamp", "vignetting")
    settings = {name: options.pop(name) for name in names}
    return settings | {"defocus": not options.pop("no_defocus"), "motion": not options.pop("no_motion")}


def _synthesise(
    frames: Sequence[str],
    output: str,
    camera_path: str,
    reference: str | None,
    reading: dict[str, Any],
    settings: dict[str, Any],
) -> dict[str, Any]:
    """Make one image and return its report; the database may be chosen by the frame."""
    from spreadlets import metrics
    from spreadlets.api import synthesize
    from spreadlets.files import exr_frames as exr
    from spreadlets.runtime.clock import Clock
    from spreadlets.scene.camera import read_camera

    clock = Clock()
    with clock.step("read"):
        camera = read_camera(camera_path)
        frame = exr.read_frame(list(frames), camera=camera, **reading)
        truth = exr.read_image(reference) if reference else None
    database = settings["database"]
    settings = settings | {"database": database(frame) if callable(database) else database}
    image, report = synthesize(frame, camera, **settings, report=True, clock=clock)
    if frame.dropped_pixels:
        warnings.warn(f"{frame.dropped_pixels} invalid pixels were dropped", stacklevel=1)
    figures = metrics.compare(image, truth) if truth is not None else {}
    with clock.step("write"):
        exr.write_image(output, image)
    report["time_s"] = clock.times()
    return report | figures


def _sequence(
    frames: Sequence[str],
    others: Sequence[str],
    output: str,
    numbers: str | None,
    overwrite: bool,
    make: Callable[[int, str], dict[str, Any]],
    as_json: bool,
) -> dict[str, Any]:
    """Make the frames of a sequence, with a bar; for people each frame's report is cut to its time."""
    from spreadlets.files.sequence import listed, run_sequence, sequence_frames

    chosen, gaps = sequence_frames(frames, others, output, numbers)
    if gaps:
        warnings.warn(f"the sequence has no frames {listed(gaps)}", stacklevel=1)
    with _progress(os.path.basename(output), quiet=as_json) as progress:
        report = run_sequence(chosen, output, make, overwrite=overwrite, progress=progress)
    if not as_json:
        times = [None if entry["skipped"] else entry["time_s"]["total"] for entry in report["frames"]]
        shown = ["kept" if seconds is None else f"{seconds:.2f} s" for seconds in times]
        report["frames"] = {entry["output"]: text for entry, text in zip(report["frames"], shown, strict=True)}
    return report


@contextmanager
def _databases() -> Iterator[Callable[[str | None, Any, bool], Any]]:
    """Give a function that returns an open database for a frame; each is opened once."""
    from spreadlets.api import default_database
    from spreadlets.psf.database import Database, open_database

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


@cli.command()
@click.argument("samples", type=click.Path(dir_okay=False), metavar="SAMPLES.exr")
@click.option("-o", "--output", required=True, type=click.Path(dir_okay=False), help="The image to write (EXR).")
@click.option("--camera", "camera_path", required=True, type=click.Path(dir_okay=False), help="Camera file (JSON).")
@click.option("--db", "database", help="Database: a file or a shipped name.")
@click.option("--spp", type=click.IntRange(min=1), help="Use so many samples of each pixel (default: all).")
@click.option(
    "--method",
    default="spreadlets",
    show_default=True,
    help="spreadlets; dense or dense-rows (PSFs drawn in full); sheared, axis-aligned, lrdm, "
    "lrdm-sheared or lrdm-ewa (layered reconstruction); mean (of each pixel's samples); bm3d or oidn (that "
    "mean, denoised by an optional package).",
)
@click.option(
    "--set",
    "assignments",
    multiple=True,
    metavar="NAME=VALUE",
    help="A setting of a layered reconstruction, such as tile=64 or block=0; may be repeated.",
)
@click.option("--integrator", help="Poisson solver: multigrid, pyramid, exact, pyramid-f5 or pyramid-f7.")
@click.option("--cycles", type=click.IntRange(min=0), help="Cycles of the integrator multigrid.")
@click.option("--layers", type=click.IntRange(min=1), help="Depth layers (default: 4).")
@click.option("--softness", type=float, help="Transition between depth layers: 0 (hard) to 1 (soft, the default).")
@click.option(
    "--firefly-clamp",
    type=float,
    metavar="FACTOR",
    help="Dim samples brighter than this times any other that comes from within a pixel (default: 32; inf: off).",
)
@click.option("--denoise", metavar="NAME", help="Denoise what is sharp and still: oidn or bm3d, optional packages.")
@click.option("--no-calibrate", is_flag=True, help="Do not bring the image's local means to those of the samples.")
@click.option("--no-defocus", is_flag=True, help="Take depth of field out.")
@click.option("--no-motion", is_flag=True, help="Take motion blur out.")
@click.option("--repair", is_flag=True, help="Drop invalid samples instead of refusing the buffer.")
@click.option("--reference", type=click.Path(dir_okay=False), help="Compare the result with this image.")
@json_option
def reconstruct(
    samples: str,
    output: str,
    camera_path: str,
    database: str | None,
    spp: int | None,
    repair: bool,
    reference: str | None,
    no_defocus: bool,
    no_motion: bool,
    no_calibrate: bool,
    as_json: bool,
    assignments: tuple[str, ...],
    **settings: Any,
) -> None:
    """Clean a buffer of stochastic samples, which were rendered through lens and shutter.

    SAMPLES.exr holds one part per sample, or is a TLFR buffer.

    Example: spreadlets reconstruct samples.exr -o out.exr --camera camera.json --spp 1
    """
    from spreadlets import metrics
    from spreadlets.api import reconstruct as make
    from spreadlets.files import exr_frames as exr
    from spreadlets.files.exr_samples import read_samples
    from spreadlets.runtime.clock import Clock
    from spreadlets.scene.camera import read_camera

    clock = Clock()
    with clock.step("read"):
        camera = read_camera(camera_path)
        buffer = read_samples(samples, camera=camera, repair=repair)
        truth = exr.read_image(reference) if reference else None
    settings |= {"defocus": not no_defocus, "motion": not no_motion, "calibrate": not no_calibrate}
    settings |= {"settings": _assigned(assignments)}
    image, report = make(buffer.take(spp) if spp else buffer, camera, database, **settings, report=True, clock=clock)
    if buffer.dropped_samples:
        warnings.warn(f"{buffer.dropped_samples} invalid samples were dropped", stacklevel=1)
    figures = metrics.compare(image, truth) if truth is not None else {}
    with clock.step("write"):
        exr.write_image(output, image)
    report["time_s"] = clock.times()
    _print(report | figures, as_json)


@cli.command()
@json_option
def tune(as_json: bool) -> None:
    """Find how much work a thread should take at a time in the methods lrdm, lrdm-sheared and lrdm-ewa, and keep it.

    The sizes are kept in a file of this user's; images do not depend on them. Takes a few seconds.

    Example: spreadlets tune
    """
    from spreadlets.api import tune_layered_methods

    _print(tune_layered_methods(), as_json)


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


@cli.command()
@click.argument("image", type=click.Path(dir_okay=False), metavar="IMAGE.exr")
@click.argument("reference", type=click.Path(dir_okay=False), metavar="REFERENCE.exr")
@json_option
def compare(image: str, reference: str, as_json: bool) -> None:
    """Compare an image with a reference: SSIM, PSNR and FLIP as displayed, relMSE and mean error on linear values.

    Example: spreadlets compare out.exr reference.exr
    """
    from spreadlets import metrics
    from spreadlets.files import exr_frames as exr

    _print(metrics.compare(exr.read_image(image), exr.read_image(reference)), as_json)


@cli.command()
@click.option("-o", "--output", default="demo_output", show_default=True, type=click.Path(file_okay=False))
@json_option
def demo(output: str, as_json: bool) -> None:
    """Blur the frame that ships with the package and compare it with the renderer's own depth of field and motion blur.

    Example: spreadlets demo -o demo_output
    """
    from spreadlets.reports.demo import run_demo

    _print(run_demo(output), as_json)


@cli.command()
@click.option("--out", default="bench_output", show_default=True, type=click.Path(file_okay=False))
@click.option("--quick", is_flag=True, help="One frame, the main methods, fewer rounds: within two minutes.")
@click.option("--frames", "folder", default="../shared/frames", show_default=True, type=click.Path(file_okay=False))
@click.option("--frame", multiple=True, type=click.Path(dir_okay=False), help="A frame of yours; several are layers.")
@click.option("--samples", type=click.Path(dir_okay=False), help="Samples of yours.")
@click.option("--camera", "camera_path", type=click.Path(dir_okay=False), help="Camera file (JSON) of yours.")
@click.option("--reference", type=click.Path(dir_okay=False), help="What yours should become (EXR).")
@click.option("--fresh", is_flag=True, help="Measure anew what an interrupted run has measured.")
@json_option
def bench(
    out: str,
    quick: bool,
    folder: str,
    frame: tuple[str, ...],
    samples: str | None,
    camera_path: str | None,
    reference: str | None,
    fresh: bool,
    as_json: bool,
) -> None:
    """Measure error against run time of every method and knob, on the frames of a folder, the shipped one, or yours.

    A folder holds NAME.json, NAME_pinhole.exr, NAME_ref_dofmb.exr and, if there are any, NAME_layer0.exr ...,
    NAME_samples.exr and NAME_noisy1.exr .... Without it the shipped frame is taken. Methods whose package is missing
    are left out, and named.

    Example: spreadlets bench --out bench_output --frame frame.exr --camera camera.json --reference reference.exr
    """
    from pathlib import Path

    from spreadlets.reports.bench.bench import run_bench
    from spreadlets.reports.bench.subjects import given_subject, shipped_subject, subjects_in

    if frame or samples:
        subjects = [given_subject(frame, samples, camera_path, reference)]
    elif camera_path or reference:
        raise click.UsageError("--camera and --reference come with --frame or --samples")
    else:
        subjects = subjects_in(Path(folder)) or [shipped_subject()]
    with _progress("bench", quiet=as_json) as progress:
        report = run_bench(subjects[:1] if quick else subjects, out, quick=quick, fresh=fresh, progress=progress)
    if as_json:
        _print(report, as_json)
        return
    for line in report["summary"]:
        click.echo(line)
    click.echo(f"written to {report['written_to']}: bench.csv, bench.txt, bench.html, plots")


@cli.command()
@click.option("--out", default="stability_output", show_default=True, type=click.Path(file_okay=False))
@click.option("--quick", is_flag=True, help="Smaller sizes: under a minute, as the tests do.")
@click.option("--only", help="Run the cases whose name contains this, such as 'layers' or 'CoC'.")
@json_option
def stability(out: str, quick: bool, only: str | None, as_json: bool) -> None:
    """Run every stiff and extreme case, each against an oracle; exit with 1 if one is beyond its budget.

    Example: spreadlets stability --quick --out stability_output
    """
    from spreadlets.reports.stability.stability import Outcome, run_stability, text_lines

    with _progress("stability", quiet=as_json) as progress:
        report = run_stability(out, quick=quick, only=only, progress=progress)
    if as_json:
        _print(report, as_json)
    else:
        for line in text_lines([Outcome(**each) for each in report["cases"]]):
            click.echo(line)
        counts = ", ".join(f"{report[name]} {name}" for name in ("passed", "limits", "failed"))
        click.echo(f"{counts} in {report['total_s']:.1f} s; written to {report['written_to']}")
    if report["failed"]:
        sys.exit(EXIT_FAILURE)


@contextmanager
def _progress(title: str, *, quiet: bool) -> Iterator[Callable[..., None]]:
    """Show a bar with an estimate on standard error, from the first report of progress on.

    What is yielded takes the numbers of what is done and of all, and the seconds left, if the caller knows better than
    by counting.
    """
    from datetime import timedelta

    from rich import progress as bar
    from rich.console import Console

    columns = bar.TextColumn("{task.description}"), bar.BarColumn(), bar.MofNCompleteColumn()
    times = bar.TimeElapsedColumn(), bar.TextColumn("{task.fields[left]}")
    shown = bar.Progress(*columns, *times, console=Console(stderr=True), disable=quiet)
    task = shown.add_task(title, total=None, left="")

    def report(done: int, total: int, *left_s: float | None) -> None:
        shown.start()
        shown.update(task, completed=done, total=total)
        left = next(iter(left_s), None)
        left = shown.tasks[0].time_remaining if left is None else left
        shown.update(task, left="" if left is None else f"left {timedelta(seconds=round(left))}")

    try:
        yield report
    finally:
        if shown.live.is_started:
            shown.stop()


def _print(figures: dict[str, Any], as_json: bool) -> None:
    if as_json:
        click.echo(json.dumps(_finite(figures)))
    else:
        for line in _lines(figures, ""):
            click.echo(line)


def _finite(value: Any) -> Any:
    """Replace what JSON cannot say (infinite PSNR of equal images) by null."""
    if isinstance(value, dict):
        return {name: _finite(item) for name, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _lines(figures: dict[str, Any], indent: str) -> list[str]:
    lines = []
    for name, value in figures.items():
        if name == "time_s":
            lines += [f"{indent}{name}", *_time_chart(value, indent + "  ")]
        elif isinstance(value, dict):
            lines += [f"{indent}{name}", *_lines(value, indent + "  ")]
        elif isinstance(value, float):
            lines.append(f"{indent}{name:<18} {value:.5g}")
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            for index, item in enumerate(value):
                lines += [f"{indent}{name} {index}", *_lines(item, indent + "  ")]
        else:
            text = ", ".join(map(str, value)) if isinstance(value, list) else value
            lines.append(f"{indent}{name:<18} {text}")
    return lines


def _time_chart(time_s: dict[str, float], indent: str) -> list[str]:
    """Draw the share of each step in the total as a bar."""
    total = max(time_s["total"], 1e-9)
    bars = {name: "#" * round(BAR_WIDTH * seconds / total) for name, seconds in time_s.items() if name != "total"}
    return [f"{indent}{name:<16} {seconds:8.3f} {bars.get(name, '')}".rstrip() for name, seconds in time_s.items()]


def _show_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    click.echo(f"warning: {message}", err=True)


def main() -> None:
    """Run the command line; errors of the caller's become one line and exit status 2."""
    warnings.showwarning = _show_warning
    try:
        cli.main(standalone_mode=False)
    except click.exceptions.Abort:
        click.echo("interrupted", err=True)
        sys.exit(EXIT_INTERRUPTED)
    except click.ClickException as error:
        click.echo(f"error: {error.format_message()}", err=True)
        sys.exit(EXIT_BAD_INPUT)
    except BuildStoppedError as error:
        click.echo("stopped: " + " ".join(str(error).split()), err=True)
        sys.exit(EXIT_FAILURE)
    except SpreadletsError as error:
        click.echo("error: " + " ".join(str(error).split()), err=True)
        sys.exit(EXIT_BAD_INPUT)
    except Exception as error:
        click.echo(f"failed: {type(error).__name__}: {' '.join(str(error).split())}", err=True)
        sys.exit(EXIT_FAILURE)


if __name__ == "__main__":
    main()
