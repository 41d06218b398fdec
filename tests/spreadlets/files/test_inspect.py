import numpy as np
import OpenEXR
import pytest

import spreadlets as sp
from spreadlets.errors import InvalidFileError
from spreadlets.files.deep import DeepImage
from spreadlets.files.inspect import frame_info, is_frame_file
from spreadlets.files.recognise import ReadOptions
from spreadlets.scene.camera import ThinLens

SHAPE = (4, 6)


def simple_frame(depth=3.0, **labels):
    radiance = np.full((*SHAPE, 4), 0.5)
    radiance[0, 0] = 0
    z = np.full(SHAPE, depth)
    z[0, 0], z[1, 1], z[2, 2] = -1, np.inf, 2 * depth
    return sp.Frame(radiance, z, **labels)


def test_a_frame_says_what_was_recognised_and_its_ranges(tmp_path):
    motion = np.zeros((*SHAPE, 2))
    motion[1, 2] = 3, 4
    sp.write_frame(tmp_path / "f.exr", simple_frame(motion=motion))
    report = frame_info(tmp_path / "f.exr")
    assert (report["kind"], report["width"], report["height"]) == ("frame", 6, 4)
    assert report["warnings"] == report["problems"] == []
    (part,) = report["parts"]
    assert part["type"] == "flat" and part["compression"] == "ZIP_COMPRESSION" and "motion.x" in part["channels"]
    (layer,) = report["layers"]
    assert layer["colour"] == {"channels": list("RGBA"), "alpha": True, "min": 0.5, "max": 0.5, "not_finite": 0}
    assert layer["depth"] == {"channel": "Z", "convention": "planar", "min_m": 3, "max_m": 6, "background": 1}
    assert layer["motion"]["convention"] == "forward-px" and layer["motion"]["longest_px"] == 5
    assert not layer["motion"]["curved"]


def test_presets_and_units_apply(tmp_path):
    before, after = np.ones((*SHAPE, 2)), np.full((*SHAPE, 2), 2.0)
    frame = simple_frame(motion_prev=before, motion_next=after)
    sp.write_frame(tmp_path / "f.exr", frame, preset="nuke", depth_scale=0.01)
    (layer,) = frame_info(tmp_path / "f.exr", ReadOptions(preset="nuke", depth_scale=0.01))["layers"]
    assert layer["depth"]["convention"] == "inverse" and layer["depth"]["max_m"] == pytest.approx(6, rel=1e-6)
    assert layer["motion"]["curved"] and layer["motion"]["longest_px"] == pytest.approx(np.sqrt(8))
    doubtful = frame_info(tmp_path / "f.exr")
    assert any("depth_convention inverse" in warning for warning in doubtful["warnings"])


def write(path, *names):
    channels = {name: np.full(SHAPE, 2 + (name == "Z"), np.float32) for name in names}
    OpenEXR.File({"type": OpenEXR.scanlineimage}, channels).write(str(path))
    return path


def test_what_reading_would_stop_at_is_listed(tmp_path):
    path = write(tmp_path / "f.exr", *"RGB", "velocity.R", "velocity.G", "depth.Z", "Z")
    report = frame_info(path)
    assert any("has several depth channels" in problem for problem in report["problems"])
    assert report["layers"][0]["colour"]["channels"] == ["R", "G", "B"]
    assert report["layers"][0]["motion"]["convention"] == "forward-norm-up"
    assert any("V-Ray" in warning for warning in report["warnings"])
    report = frame_info(path, ReadOptions(depth_channel="Z"))
    assert any("max_displacement" in problem for problem in report["problems"])
    assert any("needs the camera" in p for p in frame_info(write(path, *"RGB", "hitdist"))["problems"])
    assert frame_info(path, ReadOptions(camera=ThinLens(50, 36, 2.0, 3.0)))["problems"] == []


def test_layers_deep_images_and_samples_are_told_apart(tmp_path):
    frame = simple_frame()
    sp.write_frame(tmp_path / "layers.exr", sp.Frame.from_layers([frame, frame]))
    report = frame_info(tmp_path / "layers.exr")
    assert report["kind"] == "layers" and len(report["layers"]) == 2

    counts = np.full(SHAPE, 2)
    counts[0, 0] = 0
    n = int(counts.sum())
    sp.write_deep(tmp_path / "deep.exr", DeepImage(counts, *(np.ones(s, np.float32) for s in ((n, 4), n, n))))
    report = frame_info(tmp_path / "deep.exr")
    assert report["kind"] == "deep" and report["samples_per_pixel"] == [0, 2]
    assert report["layers"][0]["depth"]["channel"] == "Z" and report["parts"][0]["type"] == "deep"

    shape = (*SHAPE, 3)
    samples = sp.SampleBuffer(
        np.ones((*shape, 3)), np.full(shape, 4.0), np.zeros((*shape, 2)), np.zeros((*shape, 2)), np.zeros(shape)
    )
    sp.write_samples(tmp_path / "samples.exr", samples)
    sp.write_tlfr(tmp_path / "samples.tlfr", samples, camera=ThinLens(50, 36, 2.0, 3.0))
    for name in ("samples.exr", "samples.tlfr"):
        report = frame_info(tmp_path / name)
        assert report["kind"] == "samples" and report["samples_per_pixel"] == [3, 3], name
        assert report["labels"]["depth"] == {"min": 4, "max": 4, "not_finite": 0}
        assert is_frame_file(tmp_path / name)


def test_other_files_are_no_frames(tmp_path):
    (tmp_path / "x").write_bytes(b"\x89HDF\r\n\x1a\n")
    assert not is_frame_file(tmp_path / "x") and not is_frame_file(tmp_path / "absent") and not is_frame_file(tmp_path)
    with pytest.raises(InvalidFileError, match="is an HDF5 file, such as a database"):
        frame_info(tmp_path / "x")


def test_info_lists_what_reading_refuses_and_counts_background_and_nan_apart(tmp_path):
    depth = np.full(SHAPE, 3, np.float32)
    depth[0, :2], depth[1, :3], depth[2, 0] = np.inf, np.nan, -1
    planes = {name: np.full(SHAPE, 0.5, np.float32) for name in "RGB"} | {"Z": depth}
    OpenEXR.File({"type": OpenEXR.scanlineimage}, planes).write(str(tmp_path / "f.exr"))
    report = frame_info(tmp_path / "f.exr")
    (problem,) = report["problems"]
    with pytest.raises(sp.errors.InvalidFrameError) as error:
        sp.read_frame(tmp_path / "f.exr")
    assert problem == str(error.value) and "depth is NaN at 3" in problem
    found = report["layers"][0]["depth"]
    assert (found["background"], found["not_a_number"], found["not_positive"]) == (2, 3, 1)
    repaired = frame_info(tmp_path / "f.exr", ReadOptions(repair=True))
    assert repaired["problems"] == [] and any("4 invalid pixels are mended" in text for text in repaired["warnings"])


def test_info_shows_the_camera_fitted_to_the_frame_and_doubts_it(tmp_path):
    sp.write_frame(tmp_path / "f.exr", sp.Frame(np.ones((9, 6, 3)), np.full((9, 6), 300.0)))
    camera = ThinLens(50, 36, 2.0, 3.0, sensor_fit="auto")
    report = frame_info(tmp_path / "f.exr", ReadOptions(camera=camera))
    assert report["camera"]["sensor_width_mm"] == 24
    assert any("the focus is at 3 m" in warning for warning in report["warnings"])


def test_ranges_of_deep_files_are_shown(tmp_path):
    n = 24
    z = np.linspace(2, 9, n, dtype=np.float32)
    image = DeepImage(np.ones(SHAPE, np.int64), np.ones((n, 4), np.float32), z, z)
    sp.write_deep(tmp_path / "deep.exr", image)
    depth = frame_info(tmp_path / "deep.exr")["layers"][0]["depth"]
    assert (depth["min_m"], depth["max_m"]) == (2, 9)
