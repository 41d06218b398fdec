"""The demonstrations as a newcomer runs them: what is written, and that the figures are those of what is written."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

import spreadlets
from spreadlets import metrics
from spreadlets.cli.main import cli
from spreadlets.files import exr_frames as exr

DATA = Path(spreadlets.__file__).resolve().parent / "data"

DEMOS = [((), "coins", "pinhole", 0.9725), (("--reconstruct",), "fence", "samples", 0.955)]
"""Options, frame, the picture beside the result, and the least similarity to the renderer's image."""


@pytest.mark.parametrize(("options", "frame", "before", "least"), DEMOS, ids=("synthesis", "reconstruction"))
def test_a_demonstration_shows_how_near_it_comes_to_the_renderer(tmp_path, options, frame, before, least):
    folder = tmp_path / "output"
    ran = CliRunner().invoke(cli, ["demo", *options, "-o", str(folder), "--json"])
    assert ran.exit_code == 0, ran.output
    report = json.loads(ran.stdout)
    assert {"time_s", "compile_s", "peak_rss_mb", "plan", "ssim", "psnr", "flip", "relmse", "mae"} <= set(report)
    assert report["time_s"]["read"] > 0 and report["time_s"]["write"] > 0
    assert {path.name for path in folder.iterdir()} == {"result.exr", "result.png", f"{before}.png", "reference.png"}
    image, reference = exr.read_image(folder / "result.exr"), exr.read_image(DATA / f"{frame}_ref_dofmb.exr")
    figures = metrics.compare(image, reference)
    assert {name: report[name] for name in figures} == pytest.approx(figures)
    assert figures["ssim"] > least


def test_a_folder_that_cannot_be_made_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    ran = CliRunner().invoke(cli, ["demo", "-o", str(tmp_path / "file" / "output")])
    assert isinstance(ran.exception, Exception) and "cannot write to" in str(ran.exception)
