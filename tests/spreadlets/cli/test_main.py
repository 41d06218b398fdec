"""The command line as scripts call it: JSON on standard output, one line for an error, nothing half-written."""

import json
import shutil
from pathlib import Path

import h5py
import numpy as np
import OpenEXR
import pytest

from spreadlets.cli import main as cli
from spreadlets.files import exr_frames as exr
from spreadlets.files import images
from spreadlets.files.exr_samples import write_samples
from spreadlets.psf.database import open_database
from spreadlets.scene.frame import Frame
from spreadlets.scene.samples import SampleBuffer

CAMERA = {
    "focal_length_mm": 50.0,
    "sensor_width_mm": 36.0,
    "f_number": 0.01,
    "focus_distance_m": 4.0,
    "shutter_open_close_frames": [-0.25, 0.25],
}


@pytest.fixture
def scene(tmp_path):
    rng = np.random.default_rng(0)
    radiance = rng.random((24, 32, 3)).astype(np.float32)
    motion = np.full((24, 32, 2), 4.0, np.float32)
    exr.write_frame(tmp_path / "frame.exr", Frame(radiance, np.full((24, 32), 5.0), motion))
    images.write_image(tmp_path / "reference.exr", radiance)
    (tmp_path / "camera.json").write_text(json.dumps(CAMERA))
    return tmp_path


def synth_arguments(scene, database, **changed):
    options = {"-o": scene / "out.exr", "--camera": scene / "camera.json", "--db": database} | changed
    return ["synth", scene / "frame.exr", *(item for pair in options.items() for item in pair)]


def test_synth_prints_one_json_object(run, scene, small_combined_path):
    arguments = synth_arguments(scene, small_combined_path, **{"--reference": scene / "reference.exr"})
    status, out, err = run(*arguments, "--json")
    assert status == 0 and err == ""
    report = json.loads(out)
    assert set(report["time_s"]) == {"read", "plan", "splat", "integrate", "composite", "write", "total"}
    assert set(report["plan"]) >= {"layers", "cells_used", "cells_total", "pixels_sparse", "pixels_dense"}
    assert set(report["plan"]) >= {"pixels_skipped", "points_splatted", "padding_px", "left_out"}
    assert {"compile_s", "peak_rss_mb", "ssim", "psnr", "flip", "relmse", "mae"} <= set(report)
    assert report["time_s"]["total"] == pytest.approx(sum(report["time_s"].values()) - report["time_s"]["total"])
    assert exr.read_image(scene / "out.exr").shape == (24, 32, 4)


def test_without_json_the_steps_are_a_chart(run, scene, small_combined_path):
    status, out, _ = run(*synth_arguments(scene, small_combined_path))
    bars = [line.count("#") for line in out.splitlines() if line.startswith("  ") and "#" in line]
    assert status == 0 and bars and 35 <= sum(bars) <= 45


def test_a_tolerance_out_of_range_is_refused(run, scene, small_combined_path):
    status, _, err = run(*synth_arguments(scene, small_combined_path), "--tolerance", "-1")
    assert status == 2 and "tolerance is -1.0: allowed are 0" in err


def test_switches_reach_the_result(run, scene, small_combined_path):
    images = {}
    for name in ("--no-defocus", "--no-motion", "--json"):
        assert run(*synth_arguments(scene, small_combined_path), name)[0] == 0
        images[name] = exr.read_image(scene / "out.exr")
    assert not np.allclose(images["--no-defocus"], images["--json"], atol=1e-3)
    assert not np.allclose(images["--no-motion"], images["--json"], atol=1e-3)


def test_repair_mends_invalid_pixels_and_says_how_many(run, scene, small_combined_path):
    frame = exr.read_frame(scene / "frame.exr")
    depth = frame.depth.copy()
    depth[3, 4:6] = -1.0
    channels = dict(zip("RGB", np.moveaxis(frame.radiance[..., :3], -1, 0).copy(), strict=True)) | {"Z": depth}
    OpenEXR.File({"type": OpenEXR.scanlineimage}, channels).write(str(scene / "frame.exr"))
    assert run(*synth_arguments(scene, small_combined_path))[0] == 2
    status, _, err = run(*synth_arguments(scene, small_combined_path), "--repair")
    assert status == 0 and "2 invalid pixels were mended, 0 dropped" in err


def test_several_frames_are_layers(run, scene, small_combined_path):
    radiance = np.zeros((24, 32, 4), np.float32)
    radiance[:8] = 1.0
    exr.write_frame(scene / "front.exr", Frame(radiance, np.full((24, 32), 4.0)))
    arguments = synth_arguments(scene, small_combined_path)
    status, out, _ = run(arguments[0], scene / "front.exr", *arguments[1:], "--json")
    assert status == 0 and json.loads(out)["plan"]["layers"] == 2
    assert np.allclose(exr.read_image(scene / "out.exr")[:7], 1.0, atol=1e-2)


def test_info_and_compare(run, scene, small_combined_path):
    status, out, _ = run("info", small_combined_path, "--json")
    figures = json.loads(out)
    assert status == 0 and figures["model"] == "combined" and figures["n_cells"] == 14 and figures["seed"] == 1
    assert {"n_channels", "size_bytes", "mean_sparsity", "mean_ssim", "min_ssim", "mean_l1"} <= set(figures)
    assert {"max_energy_error", "build_s", "parameters"} <= set(figures)
    status, out, _ = run("compare", scene / "reference.exr", scene / "reference.exr", "--json")
    assert status == 0
    assert json.loads(out) == {"ssim": 1.0, "psnr": None, "flip": 0.0, "relmse": 0.0, "mae": 0.0}
    status, out, _ = run("compare", scene / "reference.exr", scene / "reference.exr")
    assert "ssim" in out


def test_info_of_a_frame_shows_what_was_recognised(run, scene):
    status, out, _ = run("info", scene / "frame.exr", "--json")
    report = json.loads(out)
    assert status == 0 and report["kind"] == "frame" and report["width"] == 32
    assert report["layers"][0]["motion"]["longest_px"] == pytest.approx(np.sqrt(32)) and report["problems"] == []
    status, out, _ = run("info", scene / "frame.exr", "--depth-scale", "0.01")
    assert status == 0 and "planar" in out and "min_m" in out and "0.05" in out
    options = ("--depth-convention", "ray", "--camera", scene / "camera.json", "--motion-channels", "none")
    status, out, _ = run("info", scene / "frame.exr", *options, "--json")
    layer = json.loads(out)["layers"][0]
    assert layer["depth"]["min_m"] < 5 and layer["motion"] is None


def test_options_of_frames_and_databases_are_not_mixed(run, scene, small_combined_path):
    status, _, err = run("info", small_combined_path, "--preset", "nuke")
    assert status == 2 and "is no frame" in err
    status, _, err = run("info", scene / "frame.exr", "--plot", scene / "plot.png")
    assert status == 2 and "--plot is for databases" in err


def test_a_preset_reaches_the_frame(run, scene, small_combined_path):
    expected = exr.read_frame(scene / "frame.exr")
    assert run(*synth_arguments(scene, small_combined_path))[0] == 0
    image = exr.read_image(scene / "out.exr")
    exr.write_frame(scene / "frame.exr", expected, preset="nuke", unpremultiplied=True, depth_scale=0.01)
    named = ("--preset", "nuke", "--unpremultiplied", "--depth-scale", "0.01")
    status, _, err = run(*synth_arguments(scene, small_combined_path), *named)
    assert status == 0 and err == ""
    assert np.allclose(exr.read_image(scene / "out.exr"), image, atol=1e-5)
    named = ("--motion-channels", "forward.u,forward.v", "--motion-convention", "backward-norm", *named)
    status, _, err = run(*synth_arguments(scene, small_combined_path), *named, "--max-displacement", "2")
    assert status == 0 and not np.allclose(exr.read_image(scene / "out.exr"), image, atol=1e-3)


def test_a_deep_frame_is_made_into_layers(run, scene, small_combined_path):
    import spreadlets as sp

    n = 2 * 24 * 32
    depth = np.tile(np.float32([4, 6]), n // 2)
    image = sp.DeepImage(np.full((24, 32), 2), np.tile(np.float32([0.5, 0.5, 0.5, 0.5]), (n, 1)), depth, depth)
    sp.write_deep(scene / "frame.exr", image)
    status, out, _ = run(*synth_arguments(scene, small_combined_path), "--json")
    assert status == 0 and json.loads(out)["plan"]["layers"] == 2
    status, out, _ = run(*synth_arguments(scene, small_combined_path), "--deep-layers", "1", "--json")
    assert status == 0 and json.loads(out)["plan"]["layers"] == 1


@pytest.fixture
def shot(scene):
    frame = exr.read_frame(scene / "frame.exr")
    for number in (1, 2, 3):
        exr.write_frame(scene / f"shot.{number:04d}.exr", Frame(frame.radiance * number / 3, frame.depth, frame.motion))
        images.write_image(scene / f"truth.{number:04d}.exr", frame.radiance)
    return scene


def sequence_arguments(shot, database, *more):
    options = ("-o", shot / "out.%02d.exr", "--camera", shot / "camera.json", "--db", database, *more)
    return ["synth", shot / "shot.####.exr", *options]


def test_a_sequence_is_one_report_and_resumes(run, shot, small_combined_path):
    truth = ("--reference", shot / "truth.####.exr")
    status, out, err = run(*sequence_arguments(shot, small_combined_path, "--frames", "1-2", *truth), "--json")
    report = json.loads(out)
    assert (status, err) == (0, "") and (report["written"], report["skipped"]) == (2, 0)
    assert [entry["frame"] for entry in report["frames"]] == [1, 2]
    assert all("splat" in entry["time_s"] and "ssim" in entry for entry in report["frames"])
    before = (shot / "out.01.exr").read_bytes()
    (shot / "shot.0001.exr").write_bytes((shot / "shot.0003.exr").read_bytes())
    status, out, err = run(*sequence_arguments(shot, small_combined_path))
    assert status == 0 and "written            1" in out and "kept" in out and "out.%02d.exr" in err
    assert (shot / "out.01.exr").read_bytes() == before
    assert run(*sequence_arguments(shot, small_combined_path, "--overwrite"))[0] == 0
    assert np.array_equal(exr.read_image(shot / "out.01.exr"), exr.read_image(shot / "out.03.exr"))


def test_a_shutter_curve_is_an_option_of_the_camera(run, scene, small_combined_path):
    for curve, brighter in (("0,1", True), ("1,0", False)):
        assert run(*synth_arguments(scene, small_combined_path), "--shutter-curve", curve)[0] == 0
        image = exr.read_image(scene / "out.exr")
        if brighter:
            late = image
    assert not np.array_equal(image, late)
    status, _, err = run(*synth_arguments(scene, small_combined_path), "--shutter-curve", "1")
    assert status == 2 and "--shutter-curve is [1.0]" in err


def test_a_camera_that_goes_from_frame_to_frame_carries_a_sequence_along(run, shot, small_combined_path):
    camera = json.loads((shot / "camera.json").read_text())
    for number in (1, 2):
        frame = exr.read_frame(shot / f"shot.000{number}.exr")
        exr.write_frame(shot / f"still.000{number}.exr", Frame(frame.radiance, frame.depth))
        pose = np.eye(4)
        pose[0, 3] = 0.1 * number
        (shot / f"camera.{number}.json").write_text(json.dumps(camera | {"camera_to_world": pose.tolist()}))
    paths = (shot / "still.####.exr", "-o", shot / "out.#.exr", "--db", small_combined_path)
    status, out, err = run("synth", *paths, "--camera", shot / "camera.#.json", "--json")
    assert (status, err) == (0, "")
    assert [each["plan"]["motion_from"] for each in json.loads(out)["frames"]] == ["camera", "camera"]
    status, out, _ = run("synth", *paths, "--camera", shot / "camera.1.json", "--overwrite", "--json")
    assert [each["plan"]["motion_from"] for each in json.loads(out)["frames"]] == ["none", "none"]


def test_a_sequence_opens_its_database_once(run, shot, small_combined_path, monkeypatch):
    from spreadlets.jobs import databases

    opened = []
    plain = databases.open_database
    monkeypatch.setattr(databases, "_opened", {})
    monkeypatch.setattr(databases, "open_database", lambda name: opened.append(name) or plain(name))
    assert run(*sequence_arguments(shot, small_combined_path))[0] == 0
    assert opened == [str(small_combined_path)]


def test_missing_frames_of_a_sequence_are_named(run, shot, small_combined_path):
    status, _, err = run(*sequence_arguments(shot, small_combined_path, "--frames", "4-6"))
    assert status == 2 and "3 frames are missing: 4-6" in err and not list(shot.glob("out*"))
    status, out, err = run(*sequence_arguments(shot, small_combined_path, "--frames", "2-6"))
    assert status == 1 and "failed: 3 of 5 frames could not be made: 4-6" in err and out.count("failed") == 4
    assert sorted(path.name for path in shot.glob("out*")) == ["out.02.exr", "out.03.exr"]
    (shot / "shot.0002.exr").unlink()
    status, out, err = run(*sequence_arguments(shot, small_combined_path), "--json")
    assert status == 0 and "warning: the sequence has no frames 2" in err
    assert len(json.loads(out)["frames"]) == 2


def test_an_interrupted_sequence_leaves_whole_frames_only_and_goes_on(run, shot, small_combined_path, monkeypatch):
    plain, calls = OpenEXR.File.write, []

    def interrupted(file, path):
        calls.append(path)
        if len(calls) == 2:
            Path(path).write_bytes(b"half a frame")
            raise KeyboardInterrupt
        plain(file, path)

    monkeypatch.setattr(OpenEXR.File, "write", interrupted)
    before = set(shot.iterdir())
    status, out, err = run(*sequence_arguments(shot, small_combined_path), "--json")
    assert status == 130 and out == "" and "interrupted" in err and len(calls) == 2
    assert {path.name for path in set(shot.iterdir()) - before} == {"out.01.exr"}
    assert exr.read_image(shot / "out.01.exr").shape == (24, 32, 4)
    status, out, _ = run(*sequence_arguments(shot, small_combined_path), "--json")
    assert (status, json.loads(out)["written"], json.loads(out)["skipped"]) == (0, 2, 1)
    assert exr.read_image(shot / "out.02.exr").shape == (24, 32, 4)


def test_a_kernel_that_is_interrupted_is_an_interrupted_run(run, scene, small_combined_path, monkeypatch):
    def interrupted(*given, **options):
        try:
            raise KeyboardInterrupt
        except KeyboardInterrupt as error:
            raise SystemError("a kernel returned a result with an exception set") from error

    monkeypatch.setattr("spreadlets.runtime.render.synthesize_all", interrupted)
    status, _, err = run(*synth_arguments(scene, small_combined_path))
    assert (status, err.strip()) == (130, "interrupted") and not (scene / "out.exr").exists()


def test_an_interrupted_kernel_stops_a_sequence(run, shot, small_combined_path, monkeypatch):
    calls = []

    def interrupted(*given, **options):
        calls.append(given)
        raise SystemError("a kernel returned a result with an exception set") from KeyboardInterrupt()

    monkeypatch.setattr("spreadlets.runtime.render.synthesize_all", interrupted)
    status, _, err = run(*sequence_arguments(shot, small_combined_path))
    assert status == 130 and "interrupted" in err and len(calls) == 1


def test_a_sequence_goes_on_after_a_bad_frame_and_names_it(run, shot, small_combined_path):
    (shot / "shot.0002.exr").write_bytes(b"no image")
    status, out, err = run(*sequence_arguments(shot, small_combined_path), "--json")
    assert status == 1 and "error: frame 2: " in err and "failed: 1 of 3 frames could not be made: 2\n" in err
    assert json.loads(out)["failed"] == [2] and "shot.0002.exr" in json.loads(out)["frames"][1]["error"]
    assert sorted(path.name for path in shot.glob("out*")) == ["out.01.exr", "out.03.exr"]


def test_an_option_that_suits_no_frame_stops_a_sequence_at_once(run, shot, small_combined_path):
    status, out, err = run(*sequence_arguments(shot, small_combined_path, "--layers", "99999"), "--json")
    assert status == 2 and out == "" and err.count("\n") == 1 and "layers" in err


def test_a_counter_of_the_output_alone_is_refused(run, shot, small_combined_path):
    options = ("--camera", shot / "camera.json", "--db", small_combined_path)
    status, _, err = run("synth", shot / "shot.0001.exr", "-o", shot / "out.%04d.exr", *options)
    assert status == 2 and "out.%04d.exr has a counter, but nothing that is read has one" in err
    assert not list(shot.glob("out*"))


def test_a_hash_in_a_folders_name_is_no_counter(run, shot, small_combined_path):
    folder = shot / "take#2"
    folder.mkdir()
    (folder / "shot.exr").write_bytes((shot / "shot.0001.exr").read_bytes())
    options = ("--camera", shot / "camera.json", "--db", small_combined_path)
    assert run("synth", folder / "shot.exr", "-o", folder / "out.exr", *options)[0] == 0
    assert run("synth", shot / "shot.####.exr", "-o", folder / "####_out.exr", "--frames", "1-2", *options)[0] == 0
    assert sorted(path.name for path in folder.iterdir()) == ["0001_out.exr", "0002_out.exr", "out.exr", "shot.exr"]


def test_a_sequence_warns_of_its_conventions_once(run, shot, small_combined_path):
    for number in (1, 2, 3):
        frame = exr.read_frame(shot / f"shot.{number:04d}.exr")
        exr.write_frame(shot / f"shot.{number:04d}.exr", frame, preset="karma")
    status, _, err = run(*sequence_arguments(shot, small_combined_path), "--json")
    assert status == 0 and err.count("Karma") == 1 and "shot.0001.exr" in err


def test_sequence_options_need_a_sequence(run, scene, small_combined_path):
    for option in (("--frames", "1-2"), ("--overwrite",), ("--jobs", "2"), ("--scheduler", "127.0.0.1:1")):
        status, _, err = run(*synth_arguments(scene, small_combined_path), *option)
        assert status == 2 and f"{option[0]}: for sequences" in err


def test_build_writes_a_database(run, tmp_path):
    output = tmp_path / "tiny.h5"
    arguments = ("--samples", 6, "--max-coc", 5, "--jobs", 1, "--seed", 3, "--density", "0.5")
    status, out, err = run("build", "simplelens", "-o", output, *arguments, "--json")
    assert status == 0 and err == ""
    assert json.loads(out)["parameters"]["density"] == 0.5
    assert [path.name for path in tmp_path.iterdir()] == ["tiny.h5"]


def test_a_database_for_one_frame_holds_what_it_uses_and_gives_the_same_image(run, scene, small_combined_path):
    options = ("--samples", 14, "--max-coc", 12, "--max-motion", 16, "--seed", 1, "--jobs", 1)
    options += ("--sparsifier", "quick")
    for_frame = ("--for", scene / "frame.exr", "--camera", scene / "camera.json")
    status, out, err = run("build", "combined", "-o", scene / "part.h5", *options, *for_frame, "--json")
    assert (status, err) == (0, "") and json.loads(out)["n_spreadlets"] == 1
    images = []
    for database in (small_combined_path, scene / "part.h5"):
        assert run(*synth_arguments(scene, database))[0] == 0
        images.append(exr.read_image(scene / "out.exr"))
    assert np.array_equal(*images)
    (scene / "camera.json").write_text(json.dumps(CAMERA | {"focus_distance_m": 2.0}))
    status, _, err = run(*synth_arguments(scene, scene / "part.h5"))
    assert status == 2 and "left out of this database" in err


def test_for_needs_a_camera_and_a_camera_frames_unless_the_model_depends_on_it(run, scene):
    status, _, err = run("build", "combined", "-o", scene / "part.h5", "--camera", scene / "camera.json")
    assert status == 2 and "only together with the frames" in err
    status, _, err = run("build", "combined", "-o", scene / "part.h5", "--for", scene / "frame.exr")
    assert status == 2 and "no camera: give --camera FILE" in err


def test_options_of_a_model_reach_it_and_are_refused_elsewhere(run, tmp_path):
    path = tmp_path / "blades.h5"
    arguments = "--samples", "3", "--max-coc", "4", "--blades", "5", "--squeeze", "0.8", "--json", "--jobs", "1"
    assert run("build", "simplelens", "-o", path, *arguments)[0] == 0
    with open_database(path) as database:
        aperture = database.grid.model.settings["aperture"]
        assert (aperture["blades"], aperture["squeeze"]) == (5, 0.8)
    for model, option, value in (("volume", "--blades", "5"), ("combined", "--lens", "singlet")):
        status, _, err = run("build", model, "-o", tmp_path / "none.h5", option, value)
        assert status == 2 and f"the model '{model}' has no {option}" in err
    assert not (tmp_path / "none.h5").exists()


def test_a_bad_prescription_is_one_line_with_its_place(run, tmp_path):
    lens = tmp_path / "lens.txt"
    lens.write_text("radius thickness glass semi_diameter\n")
    status, out, err = run("build", "physicallens", "-o", tmp_path / "none.h5", "--lens", lens)
    assert status == 2 and not out and "lens.txt, line 1: the columns are" in err and err.count("\n") == 1


def with_camera(**changes):
    def write(scene):
        camera = CAMERA | changes
        (scene / "camera.json").write_text(json.dumps({key: value for key, value in camera.items() if value != "-"}))

    return write


def with_frame(**changes):
    def write(scene):
        values = {"R": 0.5, "G": 0.5, "B": 0.5, "Z": 5.0} | changes
        channels = {name: np.full((4, 4), value, np.float32) for name, value in values.items() if value is not None}
        header = {"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION}
        OpenEXR.File(header, channels).write(str(scene / "frame.exr"))

    return write


BAD_INPUT = [
    (with_camera(focal_length_mm=0.0), "focal"),
    (with_camera(focus_distance_m=0.01), "focus"),
    (with_camera(f_number="-"), "f_number"),
    (with_frame(Z=None), "depth"),
    (with_frame(Z=-1.0), "depth"),
    (with_frame(Z=float("nan")), "depth"),
    (with_frame(R=float("nan")), "radiance"),
    (with_frame(G=None), "colour channels"),
    (lambda scene: (scene / "frame.exr").write_bytes(b"not an image"), "frame.exr"),
    (lambda scene: (scene / "frame.exr").unlink(), "frame.exr"),
    (lambda scene: (scene / "camera.json").write_text("{"), "camera.json"),
]


@pytest.mark.parametrize(("spoil", "named"), BAD_INPUT)
def test_bad_input_is_one_line_and_leaves_nothing(run, scene, small_combined_path, spoil, named):
    spoil(scene)
    status, out, err = run(*synth_arguments(scene, small_combined_path), "--json")
    assert status == 2 and out == ""
    assert err.startswith("error: ") and err.count("\n") == 1 and named in err
    assert not [path for path in scene.iterdir() if "out" in path.name]


@pytest.mark.parametrize(
    ("option", "value", "named"),
    [
        ("--method", "magic", "magic"),
        ("--integrator", "magic", "magic"),
        ("--db", "nowhere.h5", "nowhere.h5"),
        ("-o", "/nonexistent/out.exr", "/nonexistent"),
    ],
)
def test_bad_options_are_one_line(run, scene, small_combined_path, option, value, named):
    status, _, err = run(*synth_arguments(scene, small_combined_path, **{option: value}))
    assert status == 2 and err.count("\n") == 1 and named in err


def test_vignetting_is_refused_where_the_lens_has_none(run, scene, small_combined_path):
    status, out, err = run(*synth_arguments(scene, small_combined_path), "--vignetting")
    assert (status, out) == (2, "") and "'combined' knows no vignetting" in err and err.count("\n") == 1
    assert not [path for path in scene.iterdir() if "out" in path.name]


def test_wrong_usage_exits_2(run):
    for arguments in (("synth",), ("build", "nothing", "-o", "x.h5"), ("fly",), ("build", "combined", "--seed", "-1")):
        status, out, err = run(*arguments)
        assert (status, out) == (2, "") and err.startswith("error: ")


def test_every_command_shows_an_example(run):
    for command in cli.cli.commands:
        status, out, _ = run(command, "--help")
        assert status == 0 and "Example: spreadlets" in out


def test_a_warning_goes_to_standard_error(run, scene, small_combined_path):
    (scene / "camera.json").write_text(json.dumps(CAMERA | {"f_number": 0.001}))
    status, out, err = run(*synth_arguments(scene, small_combined_path), "--json")
    assert status == 0 and json.loads(out)
    assert err.startswith("warning: ") and "beyond the database's range" in err


def test_a_database_is_extended_and_verified(run, tmp_path):
    path = tmp_path / "tiny.h5"
    arguments = "build", "simplelens", "-o", path, "--jobs", 1, "--json"
    assert run(*arguments, "--samples", 6, "--max-coc", 5)[0] == 0
    status, out, _ = run(*arguments, "--extend", "--max-coc", 6.5, "--log", tmp_path / "log.txt")
    assert status == 0 and json.loads(out)["parameters"]["maximum"]["coc"] >= 6.5
    assert "2 cells, 0 of them finished before" in (tmp_path / "log.txt").read_text()
    status, out, err = run("info", path, "--verify", "--jobs", 1, "--json")
    assert (status, err) == (0, "") and json.loads(out)["verified"]["cells"] == json.loads(out)["n_cells"]
    with h5py.File(path) as file:
        chunk = file["value"].id.get_chunk_info(0)
    content = bytearray(path.read_bytes())
    content[chunk.byte_offset + chunk.size // 2] ^= 0xFF
    path.write_bytes(content)
    status, out, err = run("info", path, "--verify", "--jobs", 1)
    assert status == 2 and out == "" and err.startswith("error: ")


def test_verify_is_for_databases_and_jobs_for_verify(run, scene, small_combined_path):
    status, _, err = run("info", scene / "frame.exr", "--verify")
    assert status == 2 and "--verify is for databases" in err
    status, _, err = run("info", small_combined_path, "--jobs", 2)
    assert status == 2 and "--jobs is for --verify" in err


def test_a_build_that_cannot_go_on_fails_with_one_line(run, tmp_path, monkeypatch):
    from spreadlets.errors import BuildStoppedError
    from spreadlets.precompute.build.parts import Parts

    def refuse(self, task, records):
        raise BuildStoppedError("no room")

    monkeypatch.setattr(Parts, "store", refuse)
    status, out, err = run("build", "simplelens", "-o", tmp_path / "a.h5", "--samples", 3, "--max-coc", 3, "--jobs", 1)
    assert status == 1 and out == "" and err.splitlines()[-1] == "stopped: no room"
    assert list(tmp_path.iterdir()) == []


def test_no_command_writes_over_what_it_reads(run, scene, small_combined_path):
    before = {path.name: path.read_bytes() for path in scene.iterdir()}
    database = scene / "database.exr"
    database.write_bytes(small_combined_path.read_bytes())
    (scene / "link.exr").symlink_to("frame.exr")
    for name in ("frame.exr", "./frame.exr", "link.exr", "reference.exr", "database.exr"):
        options = {"-o": f"{scene}/{name}", "--reference": scene / "reference.exr"}
        status, _, err = run(*synth_arguments(scene, database, **options))
        assert status == 2 and "would replace" in err, name
    status, _, err = run(
        "reconstruct", scene / "frame.exr", "-o", scene / "frame.exr", "--camera", scene / "camera.json"
    )
    assert status == 2 and "would replace" in err
    for output in ("frame.exr", "camera.json"):
        options = ("-o", scene / output, "--for", scene / "frame.exr", "--camera", scene / "camera.json")
        status, _, err = run("build", "combined", *options)
        assert status == 2 and "would replace" in err
    options = ("-o", scene / "a.h5", "--camera", scene / "camera.json", "--log", scene / "camera.json")
    status, _, err = run("build", "physicallens", *options)
    assert status == 2 and "would replace" in err
    stored = scene / "database.h5"
    stored.write_bytes(database.read_bytes())
    status, _, err = run("info", stored, "--plot", stored)
    assert status == 2 and "would replace" in err
    assert before == {name: (scene / name).read_bytes() for name in before}


def test_a_sequence_is_not_written_over_what_it_reads(run, shot, small_combined_path):
    before = {path.name: path.read_bytes() for path in shot.iterdir()}
    options = ("--camera", shot / "camera.json", "--db", small_combined_path, "--overwrite")
    for output in ("shot.%04d.exr", "truth.####.exr"):
        status, _, err = run(
            "synth", shot / "shot.####.exr", "-o", shot / output, "--reference", shot / "truth.####.exr", *options
        )
        assert status == 2 and "would replace" in err
    (shot / "out.02.exr").symlink_to("shot.0003.exr")
    status, _, err = run("synth", shot / "shot.####.exr", "-o", shot / "out.##.exr", *options)
    assert status == 2 and "out.02.exr would replace" in err
    assert before == {name: (shot / name).read_bytes() for name in before}


@pytest.mark.parametrize("output", ["out", "out.jpx", "nowhere/out.exr", "."])
def test_an_output_that_cannot_be_written_is_refused_before_anything_is_read(run, scene, small_combined_path, output):
    (scene / "frame.exr").write_bytes(b"not looked at")
    status, _, err = run(*synth_arguments(scene, small_combined_path, **{"-o": f"{scene}/{output}"}))
    assert status == 2 and "OpenEXR file" not in err and err.count("\n") == 1


def test_further_colour_layers_are_blurred_and_the_rest_is_passed_through(run, scene, small_combined_path):
    frame = exr.read_frame(scene / "frame.exr")
    extra = {f"diffuse.{name}": 0.5 * frame.radiance[..., index] for index, name in enumerate("RGB")}
    ids = np.arange(24 * 32, dtype=np.uint32).reshape(24, 32)
    own = OpenEXR.File(str(scene / "frame.exr"), separate_channels=True).channels()
    channels = {name: channel.pixels for name, channel in own.items()} | extra | {"id": ids}
    stored = {name: np.ascontiguousarray(plane) for name, plane in channels.items()}
    OpenEXR.File({"type": OpenEXR.scanlineimage}, stored).write(str(scene / "frame.exr"))
    arguments = synth_arguments(scene, small_combined_path)
    status, _, err = run(*arguments, "--also", "diffuse", "--pass-through")
    assert (status, err) == (0, "")
    found = {
        name: channel.pixels
        for name, channel in OpenEXR.File(str(scene / "out.exr"), separate_channels=True).channels().items()
    }
    assert found.keys() == channels.keys()
    np.testing.assert_allclose(found["diffuse.G"], 0.5 * found["G"], atol=2e-3)
    for name in ("Z", "id", "motion.x"):
        np.testing.assert_array_equal(found[name], channels[name])
    status, _, err = run(*arguments, "--also", "specular")
    assert status == 2 and "specular" in err
    status, _, err = run(*synth_arguments(scene, small_combined_path, **{"-o": scene / "out.png"}), "--pass-through")
    assert status == 2 and "are for OpenEXR" in err


@pytest.fixture
def posts(tmp_path):
    """Three frames of a near post that moves before noise."""
    noise = np.random.default_rng(0).random((32, 48, 3)).astype(np.float32)
    for number in (1, 2, 3):
        radiance, depth, motion = noise.copy(), np.full((32, 48), 4.0, np.float32), np.zeros((32, 48, 2), np.float32)
        post = slice(8 * number, 8 * number + 5)
        radiance[:, post], depth[:, post], motion[:, post] = (0.5, 0.1, 0.1), 3.0, (8.0, 0.0)
        exr.write_frame(tmp_path / f"shot.{number:04d}.exr", Frame(radiance, depth, motion))
    (tmp_path / "camera.json").write_text(json.dumps(CAMERA | {"shutter_open_close_frames": [0.0, 0.0]}))
    exr.write_frame(tmp_path / "behind.exr", Frame(noise, np.full((32, 48), 4.0)))
    return tmp_path


def test_what_is_hidden_comes_from_other_frames(run, posts, small_combined_path):
    common = "--camera", posts / "camera.json", "--db", small_combined_path
    others = [item for n in (1, 3) for item in ("--hidden-from", posts / f"shot.{n:04d}.exr")]
    for name, more in (("guessed", ()), ("known", others)):
        assert run("synth", posts / "shot.0002.exr", "-o", posts / f"{name}.exr", *common, *more)[0] == 0
    pattern = posts / "shot.####.exr"
    assert run("synth", pattern, "-o", posts / "out.####.exr", *common, "--hidden-from", pattern)[0] == 0
    guessed, known, of_sequence = (
        exr.read_image(posts / name) for name in ("guessed.exr", "known.exr", "out.0002.exr")
    )
    assert np.array_equal(of_sequence, known), "the frames before and after each"
    behind = exr.read_image(posts / "behind.exr")
    error = [np.abs(each - behind)[6:-6, 16:21, :3].mean() for each in (guessed, known)]
    assert error[1] < 0.8 * error[0]


@pytest.mark.parametrize("broken", ["cut off", "of another size"])
def test_a_frame_that_cannot_be_used_fails_none_of_its_neighbours(run, posts, small_combined_path, broken):
    """Each takes what is hidden from the other side alone, and says so."""
    pattern, common = posts / "shot.####.exr", ("--camera", posts / "camera.json", "--db", small_combined_path)
    for number in (4, 5):
        shutil.copy(posts / "shot.0001.exr", posts / f"shot.{number:04d}.exr")
    bad = posts / "shot.0003.exr"
    if broken == "cut off":
        bad.write_bytes(bad.read_bytes()[:400])
    else:
        exr.write_frame(bad, Frame(np.ones((24, 32, 3)), np.full((24, 32), 4.0)))
    status, _, err = run("synth", pattern, "-o", posts / "out.####.exr", *common, "--hidden-from", pattern)
    made = {1, 2, 4, 5} if broken == "cut off" else {1, 2, 3, 4, 5}
    assert {n for n in range(1, 6) if (posts / f"out.{n:04d}.exr").exists()} == made
    assert status == (1 if broken == "cut off" else 0)
    for number in (2, 4):
        assert f"frame {number}: what is hidden is not taken from {bad}: " in err
    assert err.count("what is hidden is not taken from") == (2 if broken == "cut off" else 4)
    # The same by hand; and there the bad frame is an error.
    frame, other = posts / "shot.0002.exr", posts / "shot.0001.exr"
    assert run("synth", frame, "-o", posts / "by_hand.exr", *common, "--hidden-from", other)[0] == 0
    assert np.array_equal(exr.read_image(posts / "by_hand.exr"), exr.read_image(posts / "out.0002.exr"))
    assert run("synth", frame, "-o", posts / "no.exr", *common, "--hidden-from", bad)[0] == 2


def test_a_sequence_takes_what_is_hidden_from_a_sequence(run, posts):
    status, _, err = run(
        "synth",
        posts / "shot.####.exr",
        "-o",
        posts / "o.####.exr",
        "--hidden-from",
        posts / "shot.0001.exr",
    )
    assert status != 0 and "--hidden-from is one, too" in err


@pytest.mark.parametrize("chosen", [("--layers", "1"), ("--method", "gather")])
def test_what_hides_nothing_takes_nothing_from_other_frames(run, posts, small_combined_path, chosen):
    given = "--camera", posts / "camera.json", "--db", small_combined_path, "--hidden-from", posts / "shot.0001.exr"
    status, _, err = run("synth", posts / "shot.0002.exr", "-o", posts / "alone.exr", *given, *chosen)
    assert status == 2 and "--hidden-from is for a frame that is divided by depth" in err
    assert not (posts / "alone.exr").exists()


def test_what_is_read_as_hidden_is_not_replaced(run, posts, small_combined_path):
    given = (
        "-o",
        posts / "shot.0001.exr",
        "--hidden-from",
        posts / "shot.0001.exr",
        "--camera",
        posts / "camera.json",
    )
    status, _, err = run("synth", posts / "shot.0002.exr", *given, "--db", small_combined_path)
    assert status != 0 and "shot.0001.exr" in err


@pytest.mark.parametrize(
    ("chosen", "message"),
    [
        (("--method", "mean", "--no-motion"), "--no-motion is no option of method 'mean'"),
        (("--method", "mean", "--layers", "3"), "--layers is no option of method 'mean'"),
        (("--method", "lrdm", "--no-calibrate"), "--no-calibrate is no option of method 'lrdm'"),
    ],
)
def test_options_of_other_methods_are_named_as_they_are_typed(run, tmp_path, chosen, message):
    pairs = np.zeros((4, 6, 1, 2))
    times = pairs[..., 0]
    samples = SampleBuffer(np.ones((4, 6, 1, 3)), times + 1.0, pairs, pairs, times)
    write_samples(tmp_path / "samples.exr", samples)
    lens = "--focal-length", "50", "--sensor-width", "36", "--f-number", "2", "--focus", "3"
    status, _, err = run("reconstruct", tmp_path / "samples.exr", "-o", tmp_path / "out.exr", *lens, *chosen)
    assert status == 2 and message in err


def test_the_page_is_not_shown_of_files_that_do_not_fit(run, tmp_path):
    frame, lens = tmp_path / "frame.exr", ("--focal-length", "50", "--f-number", "2", "--focus", "3", "--json")
    status, _, err = run("view", frame, *lens)
    assert status == 2 and "frame.exr: there is no such file" in err
    exr.write_frame(frame, Frame(np.ones((8, 12, 3)), np.ones((8, 12))))
    images.write_image(tmp_path / "other.exr", np.ones((12, 8, 3)))
    status, _, err = run("view", frame, *lens, "--reference", tmp_path / "other.exr")
    assert status == 2 and "the reference has 8 x 12 px, the frame displays 12 x 8" in err
    status, _, err = run("view", frame, *lens, "--db", "nothing")
    assert status == 2 and "no database 'nothing'" in err
