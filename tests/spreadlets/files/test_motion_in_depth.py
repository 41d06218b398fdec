"""Motion in depth, from the file to the blur."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

import spreadlets as sp
from spreadlets.cli.main import cli
from spreadlets.files.conventions import LEAST_APPROACH, Scale, motion_labels

SHAPE = (24, 32)
CAMERA = sp.ThinLens(50.0, 36.0, 0.02, 4.0, shutter=(-0.5, 0.5))
CAMERA_FILE = {
    "focal_length_mm": 50.0,
    "sensor_width_mm": 36.0,
    "f_number": 0.02,
    "focus_distance_m": 4.0,
    "shutter_open_close_frames": [-0.5, 0.5],
}


def approaching(**labels):
    """A lamp before black that comes from 6 m to 3 m."""
    radiance = np.zeros((*SHAPE, 3), np.float32)
    radiance[12, 16] = 1.0
    return sp.Frame(radiance, np.full(SHAPE, 4.0, np.float32), **labels)


def around():
    return {"depth_prev": np.full(SHAPE, 6.0, np.float32), "depth_next": np.full(SHAPE, 3.0, np.float32)}


def test_depths_of_the_frames_before_and_after_come_back(tmp_path):
    sp.write_frame(tmp_path / "frame.exr", approaching(**around()))
    (layer,) = sp.read_frame(tmp_path / "frame.exr").layers
    assert (layer.depth_prev == 6.0).all() and (layer.depth_next == 3.0).all()


def test_they_are_stored_as_the_depth_is(tmp_path):
    sp.write_frame(tmp_path / "frame.exr", approaching(**around()), depth_scale=0.01)
    (layer,) = sp.read_frame(tmp_path / "frame.exr", depth_scale=0.01).layers
    assert layer.depth_next == pytest.approx(3.0)


def test_one_of_them_alone_is_named_and_not_used(tmp_path):
    raster = {"Z": np.full(SHAPE, 4.0, np.float32), "depth_prev": np.full(SHAPE, 6.0, np.float32)}
    sp.write_image(tmp_path / "frame.exr", np.ones((*SHAPE, 4)), channels=raster)
    with pytest.warns(sp.errors.AmbiguousInputWarning, match="depth_prev is not used: depth_prev and depth_next come"):
        (layer,) = sp.read_frame(tmp_path / "frame.exr").layers
    assert layer.depth_prev is None


def test_a_velocity_towards_the_camera_changes_the_depth():
    velocity = np.broadcast_to(np.float32([0.0, 0.0, -50.0]), (*SHAPE, 3))  # centimetres, as the depth
    labels = motion_labels("camera-velocity", velocity, np.full(SHAPE, 4.0, np.float32), Scale(CAMERA, 0.01))
    assert labels["depth_prev"] == pytest.approx(4.5) and labels["depth_next"] == pytest.approx(3.5)


def test_what_would_pass_the_camera_stays_before_it():
    velocity = np.broadcast_to(np.float32([0.0, 0.0, -9.0]), (*SHAPE, 3))
    labels = motion_labels("camera-velocity", velocity, np.full(SHAPE, 4.0, np.float32), Scale(CAMERA))
    assert labels["depth_next"] == pytest.approx(4.0 * LEAST_APPROACH)


def test_a_velocity_parallel_to_the_image_leaves_the_depth_alone():
    velocity = np.broadcast_to(np.float32([1.0, 2.0, 0.0]), (*SHAPE, 3))
    assert motion_labels("camera-velocity", velocity, np.ones(SHAPE, np.float32), Scale(CAMERA)).keys() == {"motion"}


def test_the_command_blurs_what_comes_nearer_and_info_says_that_it_moves(tmp_path, small_combined_path):
    (tmp_path / "camera.json").write_text(json.dumps(CAMERA_FILE))
    lit = {}
    for name, labels in (("still", {}), ("moving", around())):
        path, result = tmp_path / f"{name}.exr", tmp_path / f"{name}_out.exr"
        sp.write_frame(path, approaching(**labels))
        given = ["-o", str(result), "--camera", str(tmp_path / "camera.json"), "--db", str(small_combined_path)]
        run = CliRunner().invoke(cli, ["synth", str(path), *given])
        assert run.exit_code == 0, run.output
        lit[name] = int((sp.read_image(result)[..., 0] > 1e-4).sum())
        shown = json.loads(CliRunner().invoke(cli, ["info", str(path), "--json"]).stdout)
        assert shown["layers"][0]["depth"].get("moves", False) == (name == "moving")
    assert lit["still"] == 1 and lit["moving"] > 20
