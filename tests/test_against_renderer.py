"""The commands as they are given without options, on small frames, against the renderer's own depth of field and motion
blur; see data/README.md."""

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import spreadlets
from spreadlets import metrics
from spreadlets.cli.main import cli
from spreadlets.files import exr_frames as exr
from spreadlets.scene.frame import Frame

DATA = Path(__file__).resolve().parent / "data"
SHIPPED = Path(spreadlets.__file__).resolve().parent / "data"

MARGIN = 16
"""Pixels along the border that are not compared: what lies outside is unknown."""

MOST_LOSS = {
    "defocus and motion": 0.026,
    "defocus alone": 0.042,
    "layers": 0.009,
    "samples": 0.036,
}
"""1 - SSIM, about a fifth above what was measured; what falls back to no motion or to raw samples lies far beyond."""


def run(*arguments):
    ran = CliRunner().invoke(cli, [*map(str, arguments), "--json"])
    assert ran.exit_code == 0, ran.output
    return json.loads(ran.stdout)


def loss(path, reference):
    inside = slice(MARGIN, -MARGIN), slice(MARGIN, -MARGIN)
    image, truth = exr.read_image(path), exr.read_image(reference)
    assert np.array_equal(image.shape[:2], truth.shape[:2])
    return 1.0 - metrics.ssim(image[inside], truth[inside])


EFFECTS = [("defocus and motion", (), "dofmb", 1000), ("defocus alone", ("--no-motion",), "dof", 400)]


@pytest.mark.parametrize(("name", "options", "reference", "n_cells"), EFFECTS, ids=[each[0] for each in EFFECTS])
def test_synthesis_with_the_database_that_a_frame_gets_by_itself(tmp_path, name, options, reference, n_cells):
    output = tmp_path / "out.exr"
    report = run("synth", DATA / "coins_pinhole.exr", "-o", output, "--camera", DATA / "coins.json", *options)
    assert report["plan"]["cells_total"] == n_cells
    assert loss(output, DATA / f"coins_ref_{reference}.exr") < MOST_LOSS[name]


def test_a_still_frame_and_no_database_named(tmp_path):
    frame = exr.read_frame(DATA / "coins_pinhole.exr")
    exr.write_frame(tmp_path / "still.exr", Frame(frame.radiance, frame.depth))
    report = run("synth", tmp_path / "still.exr", "-o", tmp_path / "out.exr", "--camera", DATA / "coins.json")
    assert report["plan"]["cells_total"] == 400
    assert loss(tmp_path / "out.exr", DATA / "coins_ref_dof.exr") < MOST_LOSS["defocus alone"]


def test_synthesis_from_depth_layers(tmp_path):
    layers = sorted(DATA.glob("fence_layer*.exr"))
    run("synth", *layers, "-o", tmp_path / "out.exr", "--camera", SHIPPED / "fence.json")
    assert len(layers) == 3
    assert loss(tmp_path / "out.exr", SHIPPED / "fence_ref_dofmb.exr") < MOST_LOSS["layers"]


def test_reconstruction_of_one_sample_a_pixel(tmp_path):
    samples, camera = SHIPPED / "fence_samples.exr", SHIPPED / "fence.json"
    report = run("reconstruct", samples, "-o", tmp_path / "out.exr", "--camera", camera)
    assert report["plan"]["cells_total"] == 1000
    assert loss(tmp_path / "out.exr", SHIPPED / "fence_ref_dofmb.exr") < MOST_LOSS["samples"]
