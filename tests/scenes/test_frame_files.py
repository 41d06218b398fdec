"""Files of rendered frames are read by the product as what was rendered; with Blender's package, whole scenes are."""

import json
import os
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest

import spreadlets as sp

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "scenes"))
from frame_files import channels, filled, motion_at_frame, write_camera, write_image, write_samples  # noqa: E402  (scripts, no package)
from shot import Glass, Shot  # noqa: E402

NEEDED = "import bpy, OpenEXR, scipy, numba, h5py, pyoidn"
"""What rendering needs of its Python."""


def python_with_blender():
    """Return a Python that can render, or nothing."""
    wanted = os.environ.get("SPREADLETS_BPY", sys.executable)
    return wanted if subprocess.run([wanted, "-c", NEEDED], capture_output=True).returncode == 0 else None


BPY = python_with_blender()
needs_bpy = pytest.mark.skipif(BPY is None, reason="set SPREADLETS_BPY to a Python that has the extra `scenes`")


def test_a_frame_is_read_as_it_was_written(tmp_path):
    rng = np.random.default_rng(0)
    colour, depth, vectors = rng.random((5, 7, 3)), rng.uniform(1, 9, (5, 7)), rng.normal(0, 9, (5, 7, 4))
    write_image(tmp_path / "a.exr", channels(colour, depth, vectors))
    frame = sp.read_frame(tmp_path / "a.exr")
    np.testing.assert_allclose(frame.radiance[..., :3], colour, rtol=1e-3)
    np.testing.assert_allclose(frame.depth, depth, rtol=1e-6)
    # Forwards with y down: Z, W from the next place to this one, X, Y from this one to the previous.
    np.testing.assert_allclose(frame.layers[0].motion_next, vectors[..., 2:] * [-1, 1], rtol=1e-3)
    np.testing.assert_allclose(frame.layers[0].motion_prev, vectors[..., :2] * [-1, 1], rtol=1e-3)


def test_samples_are_read_as_they_were_written(tmp_path):
    rng = np.random.default_rng(0)
    names = ("R", "G", "B", "Z", "motion.x", "motion.y", "lens.u", "lens.v", "time", "offset.x", "offset.y")
    given = {name: rng.uniform(0.1, 0.45, (4, 6, 3)) for name in names}
    write_samples(tmp_path / "a.exr", given)
    read = sp.read_samples(tmp_path / "a.exr")
    np.testing.assert_allclose(read.radiance[..., 2], given["B"], rtol=1e-3)
    np.testing.assert_allclose(read.depth, given["Z"], rtol=1e-6)
    np.testing.assert_allclose(read.motion[..., 1], given["motion.y"], rtol=1e-3)
    np.testing.assert_allclose(read.lens_uv[..., 0], given["lens.u"], rtol=1e-3)
    np.testing.assert_allclose(read.offset[..., 1], given["offset.y"], rtol=1e-3)


def test_samples_tell_their_motion_at_the_frames_time():
    velocity, acceleration, time = np.array([6.0, -2.0]), np.array([1.5, 4.0]), 0.25
    before, now, after = (velocity * t + 0.5 * acceleration * t**2 for t in (time - 1, time, time + 1))
    vectors = np.concatenate([before - now, now - after]) * [1, -1, 1, -1]
    np.testing.assert_allclose(motion_at_frame(vectors, time), velocity)


def test_light_that_no_half_float_holds_is_the_most_that_one_holds(tmp_path):
    write_image(tmp_path / "a.exr", channels(np.full((2, 2, 3), 1e9)))
    assert sp.read_image(tmp_path / "a.exr").max() == 65504


def test_holes_take_the_nearest_value():
    there = np.array([[True, False, False, False, True]])
    assert filled(np.array([[1.0, 0, 0, 0, 2]]), there)[0, [1, 3]].tolist() == [1, 2]


@pytest.mark.parametrize("glass", [None, Glass("double_gauss", 85.0, 2.1)])
def test_cameras_are_read_without_a_warning(tmp_path, glass):
    shot = Shot(88.0, 2.2, 2.0, aspect=0.5, glass=glass)
    described = shot.glass_description(64) if glass else shot.description(64)
    write_camera(tmp_path / "a.json", described, "pinhole", 4, {"render_time_s": 1.5})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        camera = sp.read_camera(tmp_path / "a.json")
    assert camera.focal_length_mm == (85.0 if glass else 88.0) and tuple(camera.shutter) == (-0.25, 0.25)


def test_a_camera_keeps_what_it_tells_of_other_images_of_its_size(tmp_path):
    shot, path = Shot(85.0, 2.0, 2.0), tmp_path / "a.json"
    for samples, seconds in ((4, 1.5), (8, 3.0)):
        write_camera(path, shot.description(64), "noisy", samples, {"render_time_s": seconds})
    told = json.loads(path.read_text())
    assert told["render"]["noisy"] == {"4": {"render_time_s": 1.5}, "8": {"render_time_s": 3.0}}
    assert told["render_time_s"] == {"4": 1.5, "8": 3.0}
    write_camera(path, shot.description(32), "pinhole", 4, {"render_time_s": 0.5})
    told = json.loads(path.read_text())
    assert list(told["render"]) == ["pinhole"] and told["render_time_s"] == {}


@pytest.fixture(scope="module")
def rendered(tmp_path_factory):
    """Render small frames of two scenes; give their folder."""
    folder = tmp_path_factory.mktemp("frames")
    asked = ("fence", 0.02, ("pinhole", "layers", "samples")), ("rain", 0.1, ("pinhole", "references", "samples"))
    for scene, effort, parts in asked:
        command = [BPY, ROOT / "scenes" / "render.py", scene, "--size", "64", "--effort", effort, "-o", folder]
        command += ["--parts", *parts]
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        done = subprocess.run(list(map(str, command)), env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr[-2000:]
    return folder


@needs_bpy
@pytest.mark.parametrize(("scene", "camera"), [("fence", "fence"), ("rain", "rain_thin")])
def test_samples_lie_where_their_labels_say(rendered, scene, camera):
    frame = sp.read_frame(rendered / f"{scene}_pinhole.exr")
    samples = sp.read_samples(rendered / f"{scene}_samples.exr")
    coc = sp.read_camera(rendered / f"{camera}.json").coc_radius(samples.depth, 64)
    height, width = frame.shape

    def astray(side):
        """Return the share of samples whose depth is not that of the frame at the place that labels lead back to."""
        rows, cols = np.mgrid[:height, :width][..., None]
        moved = samples.motion * samples.time[..., None]
        x = cols + samples.offset[..., 0] - side * (coc * samples.lens_uv[..., 0] + moved[..., 0])
        y = rows + samples.offset[..., 1] - side * (coc * samples.lens_uv[..., 1] + moved[..., 1])
        x, y = (np.clip(np.rint(each).astype(int), 0, last) for each, last in ((x, width - 1), (y, height - 1)))
        return 1 - np.isclose(frame.depth[y, x], samples.depth, rtol=0.02).mean()

    assert astray(1) < 0.75 * astray(-1)


@needs_bpy
def test_layers_are_there_and_cover_the_frame(rendered):
    layers = sp.Frame.from_layers([sp.read_frame(rendered / f"fence_layer{k}.exr") for k in range(3)])
    assert layers.layers[-1].radiance[..., 3].mean() > 0.99


@needs_bpy
def test_glass_lets_as_much_light_through_in_the_middle_as_its_thin_lens(rendered):
    glass, thin = (sp.read_image(rendered / f"rain_ref_{each}.exr")[10:30, 16:48, :3] for each in ("lens", "thin"))
    assert glass.mean() == pytest.approx(thin.mean(), rel=0.1)
