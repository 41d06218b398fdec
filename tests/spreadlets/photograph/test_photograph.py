"""Photographs: focus, blur, units, edges, highlights and grain; and the command."""

import json

import numpy as np
import pytest
from PIL import Image
from scipy import ndimage

import spreadlets as sp
from spreadlets.cli import main as cli
from spreadlets.errors import InvalidFrameError, InvalidParameterError
from spreadlets.photograph.depth_map import filled, inverse_depth, refined, sharpened
from spreadlets.photograph.grain import grain_of
from spreadlets.photograph.photograph import blurring_camera

SHAPE = (96, 128)
NEAR = np.zeros(SHAPE, bool)
NEAR[32:64, 44:84] = True
INVERSE = np.where(NEAR, 0.9, 0.2).astype(np.float32)
RGB = np.random.default_rng(0).integers(0, 256, (*SHAPE, 3), np.uint8)
SUBJECT, AROUND = (slice(40, 56), slice(54, 74)), (slice(4, 20), slice(10, 118))


def detail(image, where):
    return image[where].astype(float).std()


def test_the_subject_is_sharp_and_what_lies_behind_is_not():
    image = sp.photo(RGB, INVERSE, focus=(64, 48), blur=5, refine=False)
    assert image.dtype == np.uint8 and image.shape == RGB.shape
    np.testing.assert_array_equal(image[SUBJECT], RGB[SUBJECT])
    assert detail(image, AROUND) < 0.3 * detail(RGB, AROUND)


def test_the_focus_may_be_a_box_and_may_be_far():
    far = sp.photo(RGB, INVERSE, focus=(2, 2, 40, 20), blur=5, refine=False)
    assert detail(far, SUBJECT) < 0.5 * detail(RGB, SUBJECT) and detail(far, AROUND) > 0.99 * detail(RGB, AROUND)


def test_the_blur_is_the_radius_at_the_far_end():
    inverse = np.linspace(0.05, 1.0, 100, dtype=np.float32).reshape(1, 100)
    camera = blurring_camera(inverse, focus=0.8, blur=12.0)
    coc = camera.coc_radius(1.0 / inverse, 100)
    assert coc.max() == pytest.approx(12.0) and coc[0, -1] < 0


@pytest.mark.parametrize(("scale", "offset"), [(1.0, 0.0), (300.0, -40.0), (0.01, 5.0)])
@pytest.mark.parametrize("kind", ["inverse", "disparity"])
def test_scale_and_offset_of_inverse_depth_do_not_matter(scale, offset, kind):
    values = scale * INVERSE + (abs(offset) if kind == "disparity" else offset)
    image = sp.photo(RGB, values, focus=(64, 48), blur=5, depth_kind=kind, refine=False)
    np.testing.assert_array_equal(image, sp.photo(RGB, INVERSE, focus=(64, 48), blur=5, refine=False))


def test_metric_depth_with_an_f_number_is_what_a_camera_sees():
    depth = np.where(NEAR, 2.0, 8.0)
    linear = np.random.default_rng(1).random((*SHAPE, 3)).astype(np.float32)
    image = sp.photo(linear, depth, focus=(64, 48), depth_kind="metric", f_number=0.5, focal_length=80, refine=False)
    camera = sp.ThinLens(focal_length_mm=80, sensor_width_mm=36, f_number=0.5, focus_distance_m=2.0)
    expected = sp.synthesize(sp.Frame(linear, depth), camera, "simplelens")[..., :3]
    np.testing.assert_allclose(image, expected, atol=2e-3)
    assert image.dtype == np.float32


def test_sixteen_bits_stay_sixteen_bits():
    codes = RGB.astype(np.uint16) * 257
    image = sp.photo(codes, INVERSE, focus=(64, 48), blur=5, refine=False)
    assert image.dtype == np.uint16
    np.testing.assert_array_equal(image[SUBJECT], codes[SUBJECT])


def test_holes_are_filled_and_a_small_map_is_stretched():
    values = INVERSE.copy()
    values[::7, ::5] = np.inf
    share, _, _ = inverse_depth(values, "disparity", SHAPE)
    assert set(np.unique(share)) == {0.0, 1.0}
    small, _, _ = inverse_depth(INVERSE[::2, ::2], "inverse", SHAPE)
    assert small.shape == SHAPE and np.abs(small - share).mean() < 0.05
    np.testing.assert_array_equal(filled(np.array([[1.0, 9.0]]), np.array([[True, False]])), [[1.0, 1.0]])


def test_edges_of_the_depth_move_to_those_of_the_image():
    image = np.where(NEAR[..., None], 0.8, 0.2).astype(np.float32) + np.zeros(3, np.float32)
    image += np.random.default_rng(2).normal(0, 0.02, image.shape).astype(np.float32)
    sloppy = ndimage.gaussian_filter(np.roll(NEAR, 2, axis=1).astype(np.float32), 1.5)
    found = refined(sloppy, image)
    wrong = np.abs(found - NEAR) > 0.25
    assert wrong.sum() < 0.15 * (np.abs(sloppy - NEAR) > 0.25).sum()


def test_soft_edges_of_the_depth_become_steps_where_they_were():
    wires = np.zeros(SHAPE, bool)
    wires[:, 60:69] = wires[20:29] = True
    for thing in (NEAR, wires):
        soft = ndimage.gaussian_filter(thing.astype(np.float32), 2.5)
        found = sharpened(soft, 10)
        wrong = np.abs(found - thing) > 0.25
        assert wrong.sum() < 0.15 * (np.abs(soft - thing) > 0.25).sum()


def test_slopes_and_sharp_edges_of_the_depth_stay():
    slope = np.add.outer(np.linspace(0.0, 0.8, SHAPE[0]), np.zeros(SHAPE[1])).astype(np.float32)
    for inverse in (slope, np.where(NEAR, np.float32(0.9), slope)):
        np.testing.assert_array_equal(sharpened(inverse, 10), inverse)


def test_clipped_light_shines_again():
    night = np.full((*SHAPE, 3), 20, np.uint8)
    night[10, 20] = 255
    options = {"focus": (64, 48), "blur": 5, "refine": False}
    dim, bright = (sp.photo(night, INVERSE, **options, highlights=each) for each in (None, (20.0, 0.9)))
    assert bright[10, 20, 0] > dim[10, 20, 0] + 5


def test_a_mask_keeps_the_subject_sharp_whatever_its_depth():
    image = sp.photo(RGB, INVERSE, focus=(2, 2), blur=5, refine=False, mask=NEAR.astype(np.float32))
    np.testing.assert_array_equal(image[NEAR], RGB[NEAR])


def test_a_mask_may_be_of_booleans():
    given = {"focus": (2, 2), "blur": 5, "refine": False}
    masked = sp.photo(RGB, INVERSE, mask=NEAR, **given)
    np.testing.assert_array_equal(masked, sp.photo(RGB, INVERSE, mask=NEAR.astype(np.float32), **given))


@pytest.mark.parametrize("lens", [{"blur": 4}, {"f_number": 0.5}])
def test_the_sky_may_be_in_focus(lens):
    depth = np.where(NEAR, 2.0, np.inf)
    image = sp.photo(RGB, depth, focus=(2, 2), depth_kind="metric", refine=False, **lens)
    assert detail(image, AROUND) > 0.99 * detail(RGB, AROUND) and detail(image, SUBJECT) < 0.5 * detail(RGB, SUBJECT)


def test_grain_comes_back_where_the_blur_took_it():
    rng = np.random.default_rng(3)
    noisy = np.clip(128 + rng.normal(0, 8, RGB.shape), 0, 255).astype(np.uint8)
    np.testing.assert_allclose(grain_of(noisy.astype(np.float32) / 255), 8 / 255, rtol=0.15)
    options = {"focus": (64, 48), "blur": 6, "refine": False}
    smooth, grainy = (sp.photo(noisy, INVERSE, **options, grain=each) for each in (False, True))
    assert detail(smooth, AROUND) < 3 and detail(grainy, AROUND) == pytest.approx(8, rel=0.2)


@pytest.mark.parametrize(
    ("changed", "error", "message"),
    [
        ({"focus": (200, 0)}, InvalidParameterError, "lies outside"),
        ({"focus": (1, 2, 3)}, InvalidParameterError, "needed are x,y or left,top,right,bottom"),
        ({"focus": "64,48"}, InvalidParameterError, "focus is '64,48': needed are x,y"),
        ({"focus": 64}, InvalidParameterError, "focus is 64: needed are x,y"),
        ({"focus": (64, np.nan)}, InvalidParameterError, "lies outside"),
        ({"focus": (1, 1, np.inf, 9)}, InvalidParameterError, "the box must lie within 128 x 96 px"),
        ({"focus": (0, 0, 0, 5)}, InvalidParameterError, "the box must lie within 128 x 96 px"),
        ({"blur": 0}, InvalidParameterError, "blur is 0: needed is a radius above 0 px"),
        ({"f_number": 2.0, "blur": 3.0}, InvalidParameterError, "blur and f_number exclude each other"),
        ({"focal_length": 50.0}, InvalidParameterError, "focal_length is for f_number"),
        ({"f_number": 2.0}, InvalidParameterError, "needs depths in metres"),
        ({"depth_kind": "parallax"}, InvalidParameterError, "allowed are inverse, metric, disparity"),
        ({"depth": INVERSE.T}, InvalidFrameError, "was one of them turned?"),
        ({"depth": np.ones(SHAPE)}, InvalidFrameError, "the depth map is 1 everywhere"),
        ({"depth": np.full(SHAPE, np.nan)}, InvalidFrameError, "holds no valid value"),
        ({"depth": INVERSE[..., None]}, InvalidFrameError, r"depth has shape \(96, 128, 1\); it must be \(h, w\)"),
        ({"rgb": RGB.astype(int)}, InvalidFrameError, "rgb has dtype int64; it must hold uint8 or uint16"),
        ({"rgb": RGB[..., 0]}, InvalidFrameError, "rgb has shape"),
    ],
)
def test_what_cannot_be_done_is_refused(changed, error, message):
    given = {"rgb": RGB, "depth": INVERSE, "focus": (64, 48)} | changed
    with pytest.raises(error, match=message):
        sp.photo(given.pop("rgb"), given.pop("depth"), **given)


def test_the_command_reads_and_writes_files(tmp_path, monkeypatch, capsys):
    Image.fromarray(RGB).save(tmp_path / "in.png")
    Image.fromarray(np.rint(65535 * INVERSE).astype(np.uint16)).save(tmp_path / "depth.png")
    monkeypatch.chdir(tmp_path)
    call(monkeypatch, "photo in.png depth.png -o out.png --focus 64,48 --blur 5 --no-refine --json")
    told = json.loads(capsys.readouterr().out)
    assert (told["width"], told["height"]) == (128, 96) and told["time_s"]["total"] > 0
    image = np.asarray(Image.open("out.png"))
    assert np.abs(image[SUBJECT].astype(int) - RGB[SUBJECT]).max() <= 1


def call(monkeypatch, words):
    monkeypatch.setattr("sys.argv", ["spreadlets", *words.split()])
    cli.main()


def test_the_command_takes_and_gives_colour_spaces_by_their_names(tmp_path, monkeypatch):
    pytest.importorskip("PyOpenColorIO")
    Image.fromarray(RGB).save(tmp_path / "in.png")
    np.save(tmp_path / "depth.npy", INVERSE)
    monkeypatch.chdir(tmp_path)
    words = "photo in.png depth.npy --focus 64,48 --blur 5 --no-refine --input-space ACEScct --output-space ACEScct -o"
    # What is sharp keeps its values, in a picture for viewing and in OpenEXR.
    for name, step in (("out.png", 1.0), ("out.exr", 0.1)):
        call(monkeypatch, f"{words} {name}")
        image = sp.read_image(name)[..., :3] * 255 if name == "out.exr" else np.asarray(Image.open(name), float)
        assert np.abs(image[SUBJECT] - RGB[SUBJECT]).max() <= step
