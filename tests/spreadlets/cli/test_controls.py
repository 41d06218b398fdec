"""The look and the aperture on the command line, each by its effect."""

import json

import numpy as np
import OpenEXR
import pytest
from PIL import Image

import spreadlets as sp
from spreadlets.files.pictures import read_plane

CAMERA = {"focal_length_mm": 80, "sensor_width_mm": 36, "f_number": 0.4, "focus_distance_m": 2.0}
SHAPE = (48, 64)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A near half and a far half of noise."""
    radiance = np.random.default_rng(5).random((*SHAPE, 3)).astype(np.float32)
    depth = np.where(np.arange(SHAPE[1]) < 32, 2.0, 6.0) * np.ones((SHAPE[0], 1))
    sp.write_frame(tmp_path / "frame.exr", sp.Frame(radiance, depth))
    (tmp_path / "camera.json").write_text(json.dumps(CAMERA | {"shutter_open_close_frames": [0, 0]}))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("SPREADLETS_BOKEH_CACHE", str(tmp_path / "cache"))
    return tmp_path


@pytest.fixture
def synth(run, folder):
    def made(*options):
        status, _, err = run("synth", "frame.exr", "-o", "out.exr", "--camera", "camera.json", "--json", *options)
        assert status == 0, err
        return sp.read_image("out.exr")

    return made


def detail(image, cols):
    return float(image[8:40, cols, :3].std())


NEAR, FAR = slice(8, 24), slice(40, 56)


def test_focus_at_a_pixel_makes_it_sharp(synth):
    plain, at = synth(), synth("--focus-at", "50,20")
    assert detail(at, FAR) > 2 * detail(plain, FAR) and detail(at, NEAR) < 0.7 * detail(plain, NEAR)


def test_a_range_in_focus_is_all_sharp(synth):
    image = synth("--in-focus", "2,6")
    np.testing.assert_allclose(image[..., :3], sp.read_frame("frame.exr").radiance[..., :3], atol=1e-3)


@pytest.mark.parametrize(("option", "value"), [("--far-strength", "0"), ("--max-coc", "0"), ("--f-number", "40")])
def test_less_blur_behind_the_focus(synth, option, value):
    assert detail(synth(option, value), FAR) > 2 * detail(synth(), FAR)


def test_a_proxy_is_smaller(synth):
    assert synth("--proxy", "0.5").shape == (24, 32, 4)


def test_near_strength_is_for_what_lies_before_the_focus(synth):
    behind = synth("--focus", "6")
    assert detail(synth("--focus", "6", "--near-strength", "0"), NEAR) > 2 * detail(behind, NEAR)


def test_highlights_brighten_what_is_blurred(synth):
    plain, bright = synth(), synth("--highlights", "4,0.5")
    assert bright[8:40, FAR, :3].mean() > 1.3 * plain[8:40, FAR, :3].mean()
    np.testing.assert_allclose(bright[8:40, :16], plain[8:40, :16], atol=0.02)


def test_a_mask_keeps_what_is_white_sharp(synth, folder):
    mask = np.zeros(SHAPE, np.uint8)
    mask[16:32, 40:56] = 255
    Image.fromarray(mask).save(folder / "mask.png")
    image = synth("--mask", "mask.png")
    truth = sp.read_frame("frame.exr").radiance
    np.testing.assert_allclose(image[16:32, 40:56], truth[16:32, 40:56], atol=1e-5)


def test_a_region_lies_where_it_is_in_the_whole(synth):
    whole, part = synth(), synth("--region", "20,10,30,25")
    np.testing.assert_allclose(part[10:35, 20:50], whole[10:35, 20:50], atol=1e-5)
    assert not part[:10].any() and not part[:, 50:].any()
    with OpenEXR.File("out.exr") as file:
        assert file.header()["dataWindow"][0].tolist() == [20, 10]


def test_the_coc_is_written_with_its_sign(synth):
    synth("--focus", "3", "--output-coc", "coc.exr")
    coc = read_plane("coc.exr")
    camera = sp.read_camera("camera.json", focus_distance_m=3.0)
    np.testing.assert_allclose(coc[0, [0, 63]], camera.coc_radius([2.0, 6.0], 64), rtol=1e-5)
    assert coc[0, 0] < 0 < coc[0, 63]


def test_the_coc_of_a_part_of_a_proxy_lies_where_the_picture_does(synth):
    synth("--focus", "3", "--proxy", "0.5", "--region", "20,10,30,24", "--output-coc", "coc.exr")
    with OpenEXR.File("out.exr") as image, OpenEXR.File("coc.exr") as coc:
        assert image.header()["dataWindow"][0].tolist() == coc.header()["dataWindow"][0].tolist() == [10, 5]
    camera = sp.read_camera("camera.json", focus_distance_m=3.0)
    np.testing.assert_allclose(read_plane("coc.exr")[0, [0, 14]], camera.coc_radius([2.0, 6.0], 64), rtol=1e-5)


def test_an_aperture_of_blades_is_built_once(synth, folder):
    hexagon = synth("--blades", "4", "--max-coc", "3")
    files = list((folder / "cache").glob("*.h5"))
    again = synth("--blades", "4", "--max-coc", "3")
    assert len(files) == 1 and list((folder / "cache").glob("*.h5")) == files
    np.testing.assert_allclose(hexagon, again, atol=1e-5)
    assert np.abs(hexagon - synth("--max-coc", "3")).max() > 0.01


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--focus-at", "1"), "has 1 numbers; needed is X,Y"),
        (("--focus-at", "1,x"), "'1,x' is not X,Y"),
        (("--focus-at", "64,0"), "lies outside the frame's 64 x 48 px"),
        (("--f-number", "0"), "error: --f-number is 0; it must be finite and > 0"),
        (("--focus", "-1"), "error: --focus is -1, which puts the focus inside the focal length"),
        (("--focus", "2", "--focus-at", "1,1"), "--focus and --focus-at exclude each other"),
        (("--in-focus", "3,2"), "--in-focus is (3.0, 2.0): allowed are depths 0 < NEAR <= FAR"),
        (("--region", "0,0,65,10"), "--region is 0,0,65,10: it must lie within"),
        (("--region", "0,0,1.5,10"), "'0,0,1.5,10' is not X,Y,W,H"),
        (("--proxy", "2"), "--proxy is 2.0: allowed are 1/64 to 1"),
        (("--mask", "missing.png"), "missing.png"),
        (("--blades", "6", "--db", "combined"), "--blades and --db exclude each other"),
        (("--kernel", "k.png", "--squeeze", "0.5"), "--kernel is the whole PSF"),
        (("--blades", "2"), "--blades is 2: allowed are 0 or 3 to 64"),
        (("--cats-eye-radial",), "a --cats-eye above 0 and without a --cats-eye-angle"),
        (("--tolerance", "3"), "--tolerance is 3.0: allowed are 0 (off) to below 1"),
        (("--layers", "100"), "--layers is 100: allowed are 1 to 64"),
        (("--softness", "2"), "--softness is 2.0: allowed are 0"),
        (("--firefly-clamp", "0"), "--firefly-clamp is 0.0: allowed are 1 and more"),
        (("--output-coc", "coc.png"), "radii have a sign"),
        (("--output-coc", "./out.exr"), "the same file"),
        (("--pass-through", "--proxy", "0.5"), "leave --proxy and --region out"),
    ],
)
def test_bad_options_are_one_clear_line_and_write_nothing(run, folder, options, message):
    status, out, err = run("synth", "frame.exr", "-o", "out.exr", "--camera", "camera.json", *options)
    assert (status, out) == (2, "") and message in err and err.count("\n") == 1
    assert not (folder / "out.exr").exists() and not (folder / "coc.exr").exists()
