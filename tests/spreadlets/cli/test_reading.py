"""The options of reading a frame and of the camera, on the commands that take them."""

import json

import numpy as np
import OpenEXR
import pytest

from spreadlets.files import exr_frames as exr

SHAPE = (24, 32)
CAMERA = {
    "focal_length_mm": 50,
    "sensor_width_mm": 36,
    "f_number": 1,
    "focus_distance_m": 3,
    "shutter_open_close_frames": [-0.25, 0.25],
}


def write(path, channels, **header):
    planes = {name: np.broadcast_to(np.float32(value), SHAPE).copy() for name, value in channels.items()}
    OpenEXR.File({"type": OpenEXR.scanlineimage, **header}, planes).write(str(path))
    return path


COLOURS = {"R": 0.5, "G": 0.25, "B": 0.125}


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "camera.json").write_text(json.dumps(CAMERA))
    write(tmp_path / "rgb.exr", COLOURS)
    write(tmp_path / "z.exr", {"V": 5})
    write(tmp_path / "mv.exr", {"R": 4, "G": 0, "B": 0})
    write(tmp_path / "frame.exr", COLOURS | {"Z": 5})
    return tmp_path


def test_passes_of_their_own_files_make_the_frame(run, folder, small_combined_path):
    common = ["-o", folder / "out.exr", "--camera", folder / "camera.json", "--db", small_combined_path, "--json"]
    status, _, err = run("synth", folder / "rgb.exr", *common)
    assert status == 2 and "lacks a depth channel; name it with --depth-channel or --depth." in err
    passes = ["--depth", folder / "z.exr", "--motion", f"{folder / 'mv.exr'}:R,G", "--motion-convention", "forward-px"]
    status, out, err = run("synth", folder / "rgb.exr", *passes, *common)
    assert (status, err) == (0, "") and "motion" not in json.loads(out)["plan"]["left_out"]
    assert np.allclose(exr.read_image(folder / "out.exr")[12, 16, 0], 0.5, atol=0.01)


def test_single_options_make_the_camera(run, folder, small_combined_path):
    common = ["synth", folder / "frame.exr", "-o", folder / "out.exr", "--db", small_combined_path]
    status, _, err = run(*common)
    assert status == 2 and "no camera: give --camera FILE, or --focal-length, --f-number and --focus" in err
    lens = ["--focal-length", 85, "--f-number", 8, "--focus", 3.2, "--shutter", "180deg"]
    status, _, err = run(*common, *lens)
    assert status == 0 and "the sensor's width is taken for 36 mm; say --sensor-width" in err
    status, _, err = run(*common, "--camera", folder / "camera.json", "--shutter", "180")
    assert status == 2 and "--shutter is '180'; it must be an angle such as 180deg, or OPEN,CLOSE" in err


def test_a_frame_that_carries_its_camera_needs_none(run, folder, small_combined_path):
    attributes = {"cameraFocalLength": 50.0, "cameraAperture": 36.0, "cameraFNumber": 8.0, "cameraFocusDistance": 300.0}
    frame = write(folder / "own.exr", COLOURS | {"Z": 500}, **attributes)
    status, _, err = run("synth", frame, "-o", folder / "out.exr", "--db", small_combined_path, "--depth-scale", 0.01)
    assert (status, err) == (0, "")
    report = json.loads(run("info", frame, "--depth-scale", 0.01, "--focus", 2, "--json")[1])
    assert report["camera"]["f_number"] == 8 and report["camera"]["focus_distance_m"] == 2


def test_errors_spell_options_as_they_are_typed(run, folder):
    common = ["-o", folder / "out.exr", "--camera", folder / "camera.json"]
    write(folder / "two.exr", COLOURS | {"Z": 5, "depth.Z": 6})
    assert "name it with --depth-channel" in run("synth", folder / "two.exr", *common)[2]
    write(folder / "vray.exr", COLOURS | {"Z": 5, "velocity.X": 0.5, "velocity.Y": 0.5})
    assert "--motion-convention forward-norm-up needs the motion" in run("synth", folder / "vray.exr", *common)[2]
    write(folder / "bad.exr", COLOURS | {"Z": -5})
    said = run("synth", folder / "bad.exr", *common)[2]
    assert "say --depth-scale -1, or no longer if you did (or --repair, which mends" in said


def test_compare_and_reference_take_the_reading_options(run, folder, small_combined_path):
    layers = {f"{name}.{axis}": value for name, value in (("a", 0.5), ("b", 0.25)) for axis in "RGB"}
    write(folder / "layers.exr", layers)
    status, _, err = run("compare", folder / "rgb.exr", folder / "layers.exr")
    assert status == 2 and "ambiguous" in err and "--colour-layer" in err
    compared = run("compare", folder / "layers.exr", folder / "layers.exr", "--colour-layer", "a", "--json")
    assert json.loads(compared[1])["mae"] == 0
    other = ["--colour-layer", "a", "--reference-layer", "b", "--json"]
    assert json.loads(run("compare", folder / "layers.exr", folder / "layers.exr", *other)[1])["mae"] == 0.25
    write(folder / "layered.exr", layers | {"Z": 5})
    common = ["-o", folder / "out.exr", "--camera", folder / "camera.json", "--db", small_combined_path, "--json"]
    reading = ["--colour-layer", "b", "--reference", folder / "layers.exr"]
    assert json.loads(run("synth", folder / "layered.exr", *reading, *common)[1])["mae"] < 0.01


def test_a_database_is_built_for_a_frame_that_needs_reading_options(run, folder):
    write(folder / "named.exr", COLOURS | {"my.depth_of_it": 5})
    common = ["build", "combined", "-o", folder / "part.h5", "--for", folder / "named.exr", "--max-coc", 16]
    common += ["--max-motion", 4, "--samples", 4, "--camera", folder / "camera.json"]
    status, _, err = run(*common)
    assert status == 2 and "--depth-channel" in err
    assert run(*common, "--depth-channel", "my.depth_of_it")[0] == 0
    prman = COLOURS | {"z": 5, "dPdtime.r": 0.1, "dPdtime.g": 0, "dPdtime.b": 0}
    write(folder / "named.exr", prman)
    (folder / "part.h5").unlink()
    assert run(*common)[0] == 0


def test_info_of_other_files_says_what_they_are(run, folder):
    (folder / "photo.jpg").write_bytes(b"\xff\xd8\xff\xe0" + bytes(100))
    assert "photo.jpg: is a JPEG; frames are OpenEXR, databases HDF5" in run("info", folder / "photo.jpg")[2]
    assert "absent.exr: there is no such file" in run("info", folder / "absent.exr")[2]
    assert "is a folder" in run("info", folder)[2]
    assert (
        "is a JPEG; frames and images are read from OpenEXR"
        in run("synth", folder / "photo.jpg", "-o", folder / "o.exr", "--camera", folder / "camera.json")[2]
    )
