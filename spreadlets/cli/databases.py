"""Commands on databases: building them, and saying what they, or a frame, hold."""

from __future__ import annotations

import os
from contextlib import ExitStack
from typing import Any

import click
import cloup

from spreadlets.cli.options import camera_options, input_options, json_option, take_camera, take_reading
from spreadlets.cli.show import print_figures, progress_bar

_DATABASE_SUFFIXES = (".h5", ".hdf5")

_DEFAULT = click.core.ParameterSource.DEFAULT


@cloup.command()
@cloup.argument("model")
@cloup.option("-o", "--output", required=True, type=click.Path(dir_okay=False), help="The database to write (HDF5).")
@cloup.option("--samples", type=click.IntRange(min=1), help="Number of cells (default: the model's own).")
@cloup.option("--max-coc", type=float, help="Largest CoC radius, px.")
@cloup.option("--max-motion", type=float, help="Longest motion over the shutter, px.")
@cloup.option("--density", type=click.Choice(["0.5", "1", "2"]), help="Points, times the usual number (default: 1).")
@cloup.option(
    "--sparsifier",
    type=click.Choice(["fit", "quick", "lks"]),
    help="Least squares (default), the same in half of the time, or as LKS published.",
)
@cloup.option("--lens", help="physicallens: a prescription file, or singlet, doublet, double_gauss (shipped).")
@cloup.option("--width", type=click.IntRange(min=1), help="physicallens, volume: width of the frames to come, px.")
@cloup.option("--image", help="stylized: the PSF (PNG).")
@cloup.option("--colour-offset", type=float, help="stylized: shift of red and blue, in radii of the PSF.")
@cloup.option("--medium-density", type=float, help="volume: collisions per metre.")
@cloup.option("--anisotropy", type=float, help="volume: mean cosine of the scattering angle, -1 to 1.")
@cloup.option("--albedo", type=float, nargs=3, help="volume: share of R, G and B that a collision keeps.")
@cloup.option("--max-distance", type=float, help="volume: farthest distance, m.")
@cloup.option("--psf-radius", type=float, help="volume: radius of the PSFs, px.")
@cloup.option("--blades", type=click.IntRange(min=0), help="simplelens, combined: edges of the aperture (0: round).")
@cloup.option("--blade-curvature", type=float, help="... from 0 (straight edges) to 1 (round).")
@cloup.option("--rotation", type=float, help="... of the blades, degrees.")
@cloup.option("--cats-eye", type=float, help="... distance of a second, clipping circle, radii.")
@cloup.option("--cats-eye-angle", type=float, help="... its direction, degrees.")
@cloup.option("--cats-eye-radial", is_flag=True, default=None, help="... growing from the middle to the corners.")
@cloup.option("--squeeze", type=float, help="... width over height of an anamorphic PSF.")
@cloup.option("--spherical-aberration", type=float, help="... above 0: dark rim behind focus, bright in front.")
@cloup.option("--obstruction", type=float, help="... radius of a central obstruction, radii.")
@cloup.option("--shutter-curve", help="combined: openness over time (0,1,1,0.5) or trapezoid:RISE,FALL.")
@cloup.option("--for", "frame_paths", multiple=True, help="Build only what this frame uses (EXR; can be repeated).")
@cloup.option("--jobs", type=click.IntRange(min=1), help="Processes (default: all cores).")
@cloup.option("--scheduler", metavar="ADDRESS", help="Compute on the workers of this Dask scheduler (HOST:PORT).")
@cloup.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of all random choices.")
@cloup.option("--extend", is_flag=True, help="Widen the database OUTPUT: its range, its density, or for more frames.")
@cloup.option("--log", type=click.Path(dir_okay=False), help="Add a line for each finished cell to this file.")
@camera_options
@input_options
@json_option
def build(
    model: str,
    output: str,
    density: str | None,
    frame_paths: tuple[str, ...],
    camera: str | None,
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
    from spreadlets.files.cameras import camera_of
    from spreadlets.files.exr_frames import read_frame
    from spreadlets.files.outputs import check_outputs
    from spreadlets.files.recognise import ReadOptions
    from spreadlets.psf.database import open_database

    # Check the outputs before anything is read.
    reading, lens = take_reading(options), take_camera(options)
    log = [options["log"]] if options["log"] else []
    passes = [value for name, value in reading.items() if name.endswith("_file")]
    check_outputs([output, *log], [*frame_paths, *passes, *filter(None, (camera, options["lens"], options["image"]))])
    # Read the camera and the frames to build for.
    if frame_paths or camera or lens:
        options["camera"] = camera_of(camera, lens, frame_paths[0] if frame_paths else None)
    if frame_paths:
        chosen = ReadOptions(**reading, camera=options["camera"])
        options["frames"] = [read_frame(path, options=chosen) for path in frame_paths]
    # Build, and show what was built.
    with progress_bar(f"building {model}", quiet=as_json) as progress:
        build_database(model, output, density=float(density) if density else None, progress=progress, **options)
    with open_database(output) as database:
        print_figures(database.summary(), as_json)


@cloup.command()
@cloup.argument("target", metavar="DB|FRAME.exr")
@cloup.option("--plot", type=click.Path(dir_okay=False), help="Draw histograms and the worst cells of a DB (PNG).")
@cloup.option("--verify", is_flag=True, help="Check every cell of a DB against its recorded figures; takes a while.")
@cloup.option("--jobs", type=click.IntRange(min=1), help="Processes for --verify (default: all cores).")
@camera_options
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
    camera: str | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Show what a database holds and how good it is (a file or a shipped name), or how a frame would be read.

    Of a frame: size, parts, what was recognised as colour, depth and motion, by which convention, the ranges of values,
    the camera that would be used, and what synth would warn of or refuse.

    Example: spreadlets info frame.exr --preset nuke
    """
    from spreadlets.files.inspect import is_frame_file
    from spreadlets.files.kinds import HDF5, file_kind

    # A frame has a report of its own.
    if is_frame_file(target):
        if plot or verify:
            raise click.UsageError(f"{'--plot' if plot else '--verify'} is for databases")
        print_figures(_frame_info(target, camera, options), as_json)
        return
    # Anything else must be a database, and its options a database's.
    named_so = os.path.splitext(target)[1].lower() in ("", *_DATABASE_SUFFIXES)
    if os.path.isdir(target) or not (named_so or file_kind(target) == HDF5):
        raise click.UsageError(_no_frame(target))
    given = [name for name in ("camera", *options) if context.get_parameter_source(name) is not _DEFAULT]
    if given:
        raise click.UsageError(
            f"{target} is no frame: --camera and the options of reading a frame are not for databases"
        )
    if jobs and not verify:
        raise click.UsageError("--jobs is for --verify")
    _database_info(target, plot, as_json, (verify, jobs))


def _no_frame(path: str) -> str:
    """Return what is wrong with a file that is neither a frame nor a database."""
    if not os.path.exists(path):
        return f"{path}: there is no such file"
    if os.path.isdir(path):
        return f"{path}: is a folder"
    from spreadlets.files.kinds import file_kind

    kind = file_kind(path) or "neither an OpenEXR file nor a database"
    return f"{path}: is {kind}; frames are OpenEXR, databases HDF5"


def _frame_info(path: str, camera: str | None, options: dict[str, Any]) -> dict[str, Any]:
    from spreadlets.errors import InvalidCameraError
    from spreadlets.files.cameras import camera_of, frame_camera
    from spreadlets.files.exr_file import ExrFile
    from spreadlets.files.inspect import frame_info
    from spreadlets.files.recognise import ReadOptions
    from spreadlets.files.tlfr import is_tlfr

    reading, values = take_reading(options), take_camera(options)
    lens, problem = None, []
    with ExitStack() as stack:
        source = path if is_tlfr(path) else stack.enter_context(ExrFile(path))
        try:
            if camera or values or frame_camera(source):
                lens = camera_of(camera, values, source, reading.get("depth_scale", 1.0))
        except InvalidCameraError as error:
            if camera or values:
                raise
            problem = [f"the camera that the frame carries: {error}"]
        report = frame_info(source, ReadOptions(**reading, camera=lens))
    report["problems"] = [*report["problems"], *problem]
    return report


def _database_info(database: str, plot: str | None, as_json: bool, verification: tuple[bool, int | None]) -> None:
    """Print the summary of a database, verified if that is asked for: then a bad one is an error."""
    from spreadlets.api import DensePsfs, verify_database
    from spreadlets.files.outputs import check_outputs
    from spreadlets.psf.database import open_database
    from spreadlets.reports.database_plot import plot_database

    verify, jobs = verification
    with open_database(database) as opened:
        if plot:
            check_outputs([plot], [opened.path])
            plot_database(opened, plot, DensePsfs(opened))
        figures = opened.summary()
        if verify:
            with progress_bar(f"verifying {opened.path.name}", quiet=as_json) as progress:
                figures["verified"] = verify_database(opened, jobs=jobs, progress=progress)
        print_figures(figures, as_json)
