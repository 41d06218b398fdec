"""Commands that judge: comparison of images, the demonstration, the benchmark and the stability report."""

from __future__ import annotations

import sys
from dataclasses import replace
from typing import Any

import click
import cloup

from spreadlets.cli.options import json_option, take_reading
from spreadlets.cli.show import print_figures, progress_bar
from spreadlets.cli.status import EXIT_FAILURE


@cloup.command()
@cloup.argument("image", type=click.Path(dir_okay=False), metavar="IMAGE.exr")
@cloup.argument("reference", type=click.Path(dir_okay=False), metavar="REFERENCE.exr")
@cloup.option_group(
    "Reading the images (what is not given is recognised)",
    cloup.option("--view", help="View of stereo files (default: the hero view)."),
    cloup.option("--colour-layer", help="Colour layer of IMAGE, and of REFERENCE if it has it."),
    cloup.option("--reference-layer", help="Colour layer of REFERENCE."),
    cloup.option("--alpha-channel", help="Name of the alpha channel of IMAGE."),
    cloup.option("--unpremultiplied", is_flag=True, help="The colours are not multiplied by alpha."),
)
@json_option
def compare(image: str, reference: str, reference_layer: str | None, as_json: bool, **options: Any) -> None:
    """Compare an image with a reference: SSIM, PSNR and FLIP as displayed, relMSE and mean error on linear values.

    Example: spreadlets compare out.exr reference.exr
    """
    from spreadlets import metrics
    from spreadlets.files import exr_frames as exr
    from spreadlets.files.recognise import ReadOptions

    reading = ReadOptions(**take_reading(options))
    truth = (
        exr.read_reference(reference, reading)
        if reference_layer is None
        else exr.read_image(reference, options=replace(reading, colour_layer=reference_layer, alpha_channel=None))
    )
    print_figures(metrics.compare(exr.read_image(image, options=reading), truth), as_json)


@cloup.command()
@cloup.option("-o", "--output", default="demo_output", show_default=True, type=click.Path(file_okay=False))
@cloup.option("--reconstruct", "from_samples", is_flag=True, help="Clean the samples that ship, instead.")
@json_option
def demo(output: str, from_samples: bool, as_json: bool) -> None:
    """Blur the frame that ships with the package and compare it with the renderer's own depth of field and motion blur.

    Example: spreadlets demo -o demo_output

    Example: spreadlets demo --reconstruct -o demo_output
    """
    from spreadlets.ahead import compiled_ahead
    from spreadlets.reports.demo import run_demo, run_reconstruction_demo

    with compiled_ahead("reconstruct" if from_samples else "synthesize"):
        report = (run_reconstruction_demo if from_samples else run_demo)(output)
    print_figures(report, as_json)


@cloup.command()
@cloup.option("--out", default="bench_output", show_default=True, type=click.Path(file_okay=False))
@cloup.option("--quick", is_flag=True, help="One frame, the main methods, fewer rounds: within two minutes.")
@cloup.option(
    "--frames", "folder", type=click.Path(file_okay=False), help="Folder of frames (default: the shipped one)."
)
@cloup.option("--frame", multiple=True, type=click.Path(dir_okay=False), help="A frame of yours; several are layers.")
@cloup.option("--samples", type=click.Path(dir_okay=False), help="Samples of yours.")
@cloup.option("--camera", "camera_path", type=click.Path(dir_okay=False), help="Camera file (JSON) of yours.")
@cloup.option("--reference", type=click.Path(dir_okay=False), help="What yours should become (EXR).")
@cloup.option("--fresh", is_flag=True, help="Measure anew what an interrupted run has measured.")
@json_option
def bench(
    out: str,
    quick: bool,
    folder: str | None,
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

    # Find the frames to measure on.
    if folder and (frame or samples):
        raise click.UsageError("--frames and --frame or --samples exclude each other")
    if frame or samples:
        subjects = [given_subject(frame, samples, camera_path, reference)]
    elif camera_path or reference:
        raise click.UsageError("--camera and --reference come with --frame or --samples")
    else:
        subjects = subjects_in(Path(folder)) if folder else [shipped_subject()]
    # Measure, and show the summary.
    with progress_bar("bench", quiet=as_json) as progress:
        report = run_bench(subjects[:1] if quick else subjects, out, quick=quick, fresh=fresh, progress=progress)
    if as_json:
        print_figures(report, as_json)
        return
    for line in report["summary"]:
        click.echo(line)
    click.echo(f"written to {report['written_to']}: bench.csv, bench.txt, bench.html, plots")


@cloup.command()
@cloup.option("--out", default="stability_output", show_default=True, type=click.Path(file_okay=False))
@cloup.option("--quick", is_flag=True, help="Smaller sizes: under a minute, as the tests do.")
@cloup.option("--only", help="Run the cases whose name contains this, such as 'layers' or 'CoC'.")
@json_option
def stability(out: str, quick: bool, only: str | None, as_json: bool) -> None:
    """Run every stiff and extreme case, each against an oracle; exit with 1 if one is beyond its budget.

    Example: spreadlets stability --quick --out stability_output
    """
    from spreadlets.reports.stability.stability import Outcome, run_stability, text_lines

    with progress_bar("stability", quiet=as_json) as progress:
        report = run_stability(out, quick=quick, only=only, progress=progress)
    if as_json:
        print_figures(report, as_json)
    else:
        for line in text_lines([Outcome(**each) for each in report["cases"]]):
            click.echo(line)
        counts = ", ".join(f"{report[name]} {name}" for name in ("passed", "limits", "failed"))
        click.echo(f"{counts} in {report['total_s']:.1f} s; written to {report['written_to']}")
    if report["failed"]:
        sys.exit(EXIT_FAILURE)
