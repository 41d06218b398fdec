"""What a page may ask for."""

import json
from dataclasses import replace

import numpy as np
import pytest

import spreadlets as sp
from spreadlets.errors import InvalidParameterError
from spreadlets.files.cameras import read_camera
from spreadlets.view.keys import camera_files
from spreadlets.view.settings import Settings

CAMERA = sp.ThinLens(
    focal_length_mm=80,
    sensor_width_mm=36,
    f_number=2.0,
    focus_distance_m=2.0,
    shutter=(0.0, 0.5),
    lens_model="textbook",
)


def settings(**given):
    return Settings.of_camera(CAMERA).changed(given)


def test_unchanged_settings_are_the_camera_and_no_options():
    assert settings().camera(CAMERA) == CAMERA
    assert settings().options() == {} and settings().model(moving=True) is None


def test_a_camera_at_infinity_stays_there():
    far = replace(CAMERA, focus_distance_m=np.inf)
    chosen = Settings.of_camera(far)
    assert chosen.camera(far) == far and "--focus inf" in chosen.command_line(["frame.exr"], None, far)


def test_each_setting_reaches_the_camera_the_options_or_the_aperture():
    camera = settings(f_number=4, focal_length=50, focus=3, shutter=90).camera(CAMERA)
    assert camera == replace(CAMERA, f_number=4, focal_length_mm=50, focus_distance_m=3, shutter=(0.125, 0.375))
    options = settings(
        layers=3, max_coc=9, near=1, far=2, gain=4, threshold=0.5, near_strength=0.5, far_strength=2
    ).options()
    assert options == {
        "layers": 3,
        "max_coc": 9,
        "in_focus": (1, 2),
        "highlights": (4, 0.5),
        "near_strength": 0.5,
        "far_strength": 2,
    }
    shape = {"blades": 6, "rotation": 20.0, "cats_eye": 0.7, "squeeze": 0.5}
    assert settings(**shape).model(moving=True) == sp.models.Combined(**shape)
    assert settings(blades=5).model(moving=False) == sp.models.SimpleLens(blades=5)
    eye = settings(cats_eye=0.7, cats_eye_at="corners")
    assert eye.model(moving=True) == sp.models.SimpleLens(cats_eye=0.7, cats_eye_radial=True)
    assert "--cats-eye 0.7 --cats-eye-radial" in eye.command_line(["frame.exr"], None, CAMERA)
    assert settings(cats_eye_at="corners").model(moving=True) is None


def test_exposure_and_overlay_change_no_rendering():
    assert settings(exposure=2, overlay="coc").rendering == settings().rendering != settings(f_number=3).rendering


@pytest.mark.parametrize(
    "bad",
    [
        {"f_number": 0},
        {"f_number": "2"},
        {"f_number": True},
        {"f_number": None},
        {"focus": float("nan")},
        {"focus": float("inf")},
        {"overlay": "evil"},
        {"cats_eye_at": "moon"},
        {"kernel": "/etc/passwd"},
        {"shutter_curve": 1},
    ],
)
def test_bad_settings_are_refused(bad):
    with pytest.raises(InvalidParameterError):
        settings(**bad)


def test_the_command_line_makes_the_same_picture(files, tmp_path, monkeypatch):
    import shlex
    import sys

    from spreadlets.cli import main as cli

    base = read_camera(files / "camera.json")
    chosen = Settings.of_camera(base).changed({"f_number": 1.5, "focus": 3.0, "near": 2.0, "far": 4.0, "max_coc": 3.0})
    line = chosen.command_line(["frame.exr"], "camera.json", base)
    words = [word.replace("out.exr", str(tmp_path / "out.exr")) for word in shlex.split(line)]
    monkeypatch.chdir(files)
    monkeypatch.setattr(sys, "argv", words)
    cli.main()
    frame = sp.read_frame("frame.exr")
    expected = sp.synthesize(frame, chosen.camera(base), **chosen.options())
    np.testing.assert_allclose(sp.read_image(tmp_path / "out.exr"), expected, atol=1e-4)


def test_a_camera_that_moves_goes_on_moving_while_its_lens_is_chosen():
    aside = np.eye(4)
    aside[0, 3] = 0.5
    begin = sp.LensKey(-0.25, focus_distance_m=2.0, camera_to_world=np.eye(4))
    moving = replace(CAMERA, keys=(begin, sp.LensKey(0.25, f_number=4.0), sp.LensKey(0.25, camera_to_world=aside)))
    found = settings(focus=3).camera(moving)
    assert found.moves_picture and found.pose_at(0.25)[0][3] == 0.5
    assert found.at(-0.25).focus_distance_m == found.at(0.25).focus_distance_m == 3.0
    assert found.at(0.25).f_number == CAMERA.f_number


def test_cameras_of_a_sequence_hold_the_cameras_move(tmp_path):
    aside = np.eye(4)
    aside[0, 3] = 0.5
    moving = replace(CAMERA, keys=(sp.LensKey(0.0, camera_to_world=np.eye(4)), sp.LensKey(0.5, camera_to_world=aside)))
    (tmp_path / "camera.json").write_text(camera_files(moving, [[8, 2.0]])["camera.0008.json"])
    assert read_camera(tmp_path / "camera.json") == replace(moving, focus_distance_m=2.0)


def test_focus_keys_become_a_camera_for_each_frame(tmp_path):
    found = camera_files(CAMERA, [[8, 1.0], [10, 2.0], [14, 2.0]])
    assert list(found) == [f"camera.{number:04d}.json" for number in range(8, 15)]
    for name, text in found.items():
        (tmp_path / name).write_text(text)
    cameras = [read_camera(tmp_path / name) for name in found]
    assert [camera.focus_distance_m for camera in cameras] == pytest.approx([1.0, 4 / 3, 2.0, 2.0, 2.0, 2.0, 2.0])
    assert all(replace(camera, focus_distance_m=2.0) == CAMERA for camera in cameras)


@pytest.mark.parametrize("bad", [None, [], [[1]], [["a", 1.0]], [[1, 0.0]], [[0, 1.0], [200_000, 1.0]], {"a": 1}])
def test_bad_keys_are_refused(bad):
    with pytest.raises(InvalidParameterError):
        camera_files(CAMERA, bad)


def test_a_camera_without_a_height_reads_back():
    (text,) = camera_files(replace(CAMERA, sensor_height_mm=24.0), [[1, 2.0]]).values()
    assert json.loads(text)["sensor_height_mm"] == 24.0
