"""Files as people bring them: each is read as what it is, or says in one line what to do about it.

The scene is a checkerboard at 20 m before which a red disc at 2 m moves by (12, 4) px per frame, y down.
"""

import json
import warnings

import numpy as np
import OpenEXR
import pytest

import spreadlets as sp
from spreadlets.errors import AmbiguousInputWarning, InvalidFileError, InvalidFrameError, SpreadletsError
from spreadlets.files.deep import DeepImage
from spreadlets.files.inspect import frame_info

HEIGHT, WIDTH = 30, 40
MOTION = (12.0, 4.0)
ROWS, COLS = np.mgrid[:HEIGHT, :WIDTH]
DISC = (COLS - 14) ** 2 + (ROWS - 16) ** 2 < 49
CHECK = ((COLS // 4 + ROWS // 4) % 2).astype(np.float32)
RGB = np.where(DISC[..., None], (0.8, 0.1, 0.05), np.stack([0.15 + 0.3 * CHECK, 0.2 + 0.4 * CHECK, 0.3 + CHECK / 2], 2))
RGB = RGB.astype(np.float32)
DEPTH = np.where(DISC, 2, 20).astype(np.float32)
RIGHT = np.where(DISC, MOTION[0], 0).astype(np.float32)
DOWN = np.where(DISC, MOTION[1], 0).astype(np.float32)
ONES = np.ones_like(DEPTH)
COLOUR = {"R": RGB[..., 0], "G": RGB[..., 1], "B": RGB[..., 2], "A": ONES}
INSIDE, OUTSIDE = (16, 14), (2, 35)


def prefixed(prefix, channels):
    return {prefix + name: pixels for name, pixels in channels.items()}


def vector(prefix="Vector."):
    """Blender's: XY = P(previous) - P(current), ZW = P(current) - P(next), y up."""
    return {prefix + "X": -RIGHT, prefix + "Y": DOWN, prefix + "Z": -RIGHT, prefix + "W": DOWN}


def write(path, channels, **header):
    stored = {name: np.ascontiguousarray(pixels, np.float32) for name, pixels in channels.items()}
    OpenEXR.File({"type": OpenEXR.scanlineimage, **header}, stored).write(str(path))
    return path


def write_parts(path, parts, headers=None):
    headers = headers or {}
    OpenEXR.File(
        [
            OpenEXR.Part(
                {"type": OpenEXR.scanlineimage, "name": name, **headers.get(name, {})},
                {each: np.ascontiguousarray(pixels, np.float32) for each, pixels in channels.items()},
            )
            for name, channels in parts.items()
        ]
    ).write(str(path))
    return path


def read(path, **options):
    """Return the frame and what was warned of."""
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        frame = sp.read_frame(path, **options)
    assert all(issubclass(each.category, AmbiguousInputWarning) for each in told)
    return frame, "\n".join(str(each.message) for each in told)


def assert_scene(frame, *, motion=True, alpha=None):
    """Check colour, depth and motion of the scene, straight or curved."""
    np.testing.assert_allclose(frame.depth, DEPTH, rtol=1e-5)
    np.testing.assert_allclose(frame.radiance[..., :3], RGB, rtol=1e-5)
    np.testing.assert_array_equal(frame.radiance[..., 3], ONES if alpha is None else alpha)
    expected = np.stack([RIGHT, DOWN], 2) if motion else np.zeros((HEIGHT, WIDTH, 2))
    np.testing.assert_allclose(frame.motion, expected, atol=1e-4)


# --- Motion --------------------------------------------------------------------------------------------------------

MOTIONS = {
    "3ds Max": {"velX": RIGHT, "velY": -DOWN},
    "Unreal": {
        "FinalImageMovieRenderQueue_MotionVectors.R": 0.5 + RIGHT / (2 * WIDTH),
        "FinalImageMovieRenderQueue_MotionVectors.G": 0.5 + DOWN / (2 * HEIGHT),
    },
    "Octane": {"Motion vector.R": RIGHT, "Motion vector.G": -DOWN},
    "Blender's file output": {"Vector.X": -RIGHT, "Vector.Y": DOWN, "Vector.Z": -RIGHT},
}


@pytest.mark.parametrize("program", MOTIONS)
def test_motion_vectors_are_known_by_the_names_that_programs_give_them(tmp_path, program):
    frame, told = read(write(tmp_path / "f.exr", COLOUR | {"Z": DEPTH} | MOTIONS[program]))
    assert_scene(frame)
    assert program.startswith("Blender") or "motion" in told.lower() or "vel" in told  # what is not verified is said


def test_what_looks_like_motion_and_is_not_used_is_named_with_the_options_to_give(tmp_path):
    path = write(tmp_path / "f.exr", COLOUR | {"Z": DEPTH, "mvec_raw.r": RIGHT, "mvec_raw.g": DOWN})
    frame, told = read(path)
    assert_scene(frame, motion=False)
    assert "mvec_raw.r" in told and "motion_channels" in told and "motion_convention" in told
    assert read(path, motion_channels=())[1] == ""
    given = {"motion_channels": ("mvec_raw.r", "mvec_raw.g"), "motion_convention": "forward-px"}
    frame, told = read(path, **given)
    assert_scene(frame)
    assert told == ""


def test_the_hero_view_of_a_stereo_file_is_read_unless_another_is_named(tmp_path):
    """As in the Beachball files: the hero is the right view, whose plain channels have no view in their names."""
    channels = COLOUR | {"Z": DEPTH} | {"forward.right.u": RIGHT, "forward.right.v": -DOWN}
    channels |= prefixed("left.", COLOUR | {"Z": DEPTH + 1}) | {"forward.left.u": 0 * RIGHT, "forward.left.v": 0 * DOWN}
    path = write(tmp_path / "f.exr", channels, multiView=["right", "left"])
    assert_scene(read(path)[0])
    left = read(path, view="left")[0]
    np.testing.assert_array_equal(left.depth, DEPTH + 1)
    assert not left.motion.any()
    with pytest.raises(SpreadletsError, match="right, left"):
        sp.read_frame(path, view="centre")


@pytest.mark.parametrize("ending", ["_", ".", "-"])
def test_views_in_parts_are_told_apart(tmp_path, ending):
    parts, headers = {}, {}
    for view, shift in (("left", 0), ("right", 5)):
        passes = {"rgba": COLOUR, "depth": {"Z": DEPTH + shift}, "forward": {"forward.u": RIGHT, "forward.v": -DOWN}}
        for name, channels in passes.items():
            parts[name + ending + view] = channels
            headers[name + ending + view] = {"view": view}
    path = write_parts(tmp_path / "f.exr", parts, headers)
    assert_scene(read(path)[0])
    np.testing.assert_array_equal(read(path, view="right")[0].depth, DEPTH + 5)


# --- Beside the colour ---------------------------------------------------------------------------------------------


def test_the_chosen_colour_settles_depth_and_motion(tmp_path):
    beside = {"Z": DEPTH, "forward.u": RIGHT, "forward.v": -DOWN}
    other = {"right.Z": DEPTH + 3, "right.forward.u": 0 * RIGHT, "right.forward.v": 0 * DOWN}
    path = write(tmp_path / "f.exr", COLOUR | beside | prefixed("right.", COLOUR) | other)
    frame, told = read(path)
    assert_scene(frame)
    right, _ = read(path, colour_layer="right")
    np.testing.assert_array_equal(right.depth, DEPTH + 3)
    assert not right.motion.any() and told == ""


def view_layers():
    foreground = prefixed("FG.Combined.", COLOUR) | {"FG.Depth.Z": DEPTH} | vector("FG.Vector.")
    background = prefixed("BG.Combined.", COLOUR) | {"BG.Depth.Z": DEPTH + 30} | prefixed("BG.", vector())
    return foreground | background


@pytest.mark.parametrize("layer", ["FG", "FG.Combined"])
def test_a_view_layer_brings_its_own_labels(tmp_path, layer):
    frame, told = read(write(tmp_path / "f.exr", view_layers()), colour_layer=layer)
    assert_scene(frame)
    assert told == ""


def test_view_layers_can_be_depth_layers(tmp_path):
    channels = view_layers()
    channels["FG.Combined.A"] = DISC.astype(np.float32)
    for name in "RGB":
        channels[f"FG.Combined.{name}"] = channels[f"FG.Combined.{name}"] * DISC
    frame, told = read(write(tmp_path / "f.exr", channels), colour_layer=("FG", "BG"))
    assert len(frame.layers) == 2 and told == ""
    assert (frame.layers[0].depth[DISC] == 2).all() and frame.layers[1].depth.min() == 32


def test_of_several_view_layers_the_first_is_read_and_the_others_named(tmp_path):
    parts = {}
    for name, shift in (("ViewLayer", 0), ("Background", 30)):
        parts |= {
            f"{name}.Combined": prefixed(f"{name}.Combined.", COLOUR),
            f"{name}.Depth": {f"{name}.Depth.Z": DEPTH + shift},
            f"{name}.Mist": {f"{name}.Mist.Z": DEPTH / 20},
            f"{name}.Vector": vector(f"{name}.Vector."),
        }
    frame, told = read(write_parts(tmp_path / "f.exr", parts))
    assert_scene(frame)
    assert "Background" in told and "colour_layer" in told


def test_the_compositors_colour_takes_the_first_view_layers_labels(tmp_path):
    parts = {
        "Composite.Combined": prefixed("Composite.Combined.", COLOUR),
        "ViewLayer.Combined": prefixed("ViewLayer.Combined.", {name: pixels / 2 for name, pixels in COLOUR.items()}),
        "ViewLayer.Depth": {"ViewLayer.Depth.Z": DEPTH},
        "ViewLayer.Vector": vector("ViewLayer.Vector."),
        "Second.Combined": prefixed("Second.Combined.", COLOUR),
        "Second.Depth": {"Second.Depth.Z": DEPTH + 9},
        "Second.Vector": vector("Second.Vector."),
    }
    frame, told = read(write_parts(tmp_path / "f.exr", parts))
    assert_scene(frame)
    assert "ViewLayer.Depth.Z" in told


def test_labels_of_another_layer_are_not_taken_without_a_word(tmp_path):
    channels = (
        prefixed("a.", COLOUR) | prefixed("b.", COLOUR) | {"b.Z": DEPTH, "b.forward.u": RIGHT, "b.forward.v": DOWN}
    )
    path = write(tmp_path / "f.exr", channels)
    with pytest.raises(InvalidFileError, match=r"b\.Z.*depth_channel"):
        read(path, colour_layer="a")
    assert_scene(read(path, colour_layer="a", depth_channel="b.Z", motion_channels=())[0], motion=False)


def test_two_depths_of_the_same_values_are_no_choice(tmp_path):
    assert_scene(read(write(tmp_path / "f.exr", COLOUR | {"Z": DEPTH, "depth.Z": DEPTH}))[0], motion=False)


# --- Names ---------------------------------------------------------------------------------------------------------

DEPTH_NAMES = (
    *(
        "Depth.V",
        "ViewLayer.Depth.V",
        "depth_main",
        "FinalImageMovieRenderQueue_WorldDepth.R",
        "Pz",
        "depth",
        "depth.Y",
    ),
    *("dd.y", "DEPTH.R", "Z depth.R", "VRayZDepth", "zDepth.R", "DEPTH.Y", "depth.R"),
)


@pytest.mark.parametrize("name", DEPTH_NAMES)
def test_depth_is_known_by_the_names_that_programs_give_it(tmp_path, name):
    assert_scene(read(write(tmp_path / "f.exr", COLOUR | {name: DEPTH}))[0], motion=False)


@pytest.mark.parametrize("part", ["Z depth", "layer7", "z"])
def test_a_bare_z_is_depth_whatever_its_part_is_called_unless_x_and_y_are_beside_it(tmp_path, part):
    normals = {name: ONES for name in "XYZ"}
    path = write_parts(tmp_path / "f.exr", {"main": COLOUR, part: {"Z": DEPTH}, "normals": normals})
    assert_scene(read(path)[0], motion=False)


COVERED = DISC.astype(np.float32)
ALPHAS = {
    "RenderMan": {"Ci.r": "R", "Ci.g": "G", "Ci.b": "B", "a": "A"},
    "named colours": {"red": "R", "green": "G", "blue": "B", "alpha": "A"},
    "a layer": {"rgba.red": "R", "rgba.green": "G", "rgba.blue": "B", "rgba.alpha": "A"},
    "lower case": {"C.r": "R", "C.g": "G", "C.b": "B", "C.a": "A"},
}


@pytest.mark.parametrize("program", ALPHAS)
def test_colour_and_alpha_are_known_by_other_names(tmp_path, program):
    element = {name: COLOUR[name] * COVERED for name in "RGB"} | {"A": COVERED}
    channels = {name: element[of] for name, of in ALPHAS[program].items()}
    frame, _ = read(write(tmp_path / "f.exr", channels | {"Z": DEPTH}))
    np.testing.assert_array_equal(frame.radiance[..., 3], COVERED)
    np.testing.assert_array_equal(frame.radiance[..., 1], element["G"])


def test_what_looks_like_alpha_and_is_not_used_is_named_with_the_option_to_give(tmp_path):
    channels = {name: COLOUR[name] for name in "RGB"} | {"Z": DEPTH, "matte.opacity": COVERED}
    path = write(tmp_path / "f.exr", channels)
    frame, told = read(path)
    assert (frame.radiance[..., 3] == 1).all() and "matte.opacity" in told and "alpha_channel" in told
    frame, told = read(path, alpha_channel="matte.opacity")
    np.testing.assert_array_equal(frame.radiance[..., 3], COVERED)
    assert told == ""


def test_luminance_is_grey(tmp_path):
    frame, _ = read(write(tmp_path / "f.exr", {"Y": RGB[..., 1], "Z": DEPTH}))
    np.testing.assert_array_equal(frame.radiance[..., :3], np.repeat(RGB[..., 1:2], 3, axis=2))


WEIGHTS = {
    "Rec. 709": ({}, (0.2126, 0.7152, 0.0722)),
    "XYZ": ({"chromaticities": (1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1 / 3, 1 / 3)}, (0.0, 1.0, 0.0)),
}


@pytest.mark.parametrize("primaries", WEIGHTS)
def test_luminance_and_chroma_become_colours_by_the_files_own_primaries(tmp_path, primaries):
    header, weights = WEIGHTS[primaries]
    luminance = RGB @ np.array(weights, np.float32)
    chroma = {"RY": RGB[..., 0] / luminance - 1, "BY": RGB[..., 2] / luminance - 1}
    frame, _ = read(write(tmp_path / "f.exr", {"Y": luminance, "Z": DEPTH} | chroma, **header))
    np.testing.assert_allclose(frame.radiance[..., :3], RGB, atol=1e-3)


# --- Passes in files of their own ----------------------------------------------------------------------------------


def test_passes_come_from_files_of_their_own(tmp_path):
    beauty = write(tmp_path / "beauty.exr", {name: COLOUR[name] for name in "RGB"})
    depth = write(tmp_path / "depth.exr", {"V": DEPTH})
    grey = write(tmp_path / "grey.exr", {"R": DEPTH, "G": DEPTH, "B": DEPTH})
    motion = write(tmp_path / "vector.exr", {"R": RIGHT, "G": -DOWN, "B": 0 * DOWN})
    alpha = write(tmp_path / "alpha.exr", {"R": COVERED, "G": COVERED, "B": COVERED})
    for file in (depth, grey):
        assert_scene(read(beauty, depth_file=file)[0], motion=False)
    given = {"depth_file": depth, "motion_file": motion, "motion_convention": "forward-px-up"}
    assert_scene(read(beauty, **given)[0])
    masked, _ = read(beauty, **given, alpha_file=alpha)
    np.testing.assert_array_equal(masked.radiance[..., 3], COVERED)


def test_a_pass_of_another_size_is_refused(tmp_path):
    beauty = write(tmp_path / "beauty.exr", COLOUR)
    small = write(tmp_path / "depth.exr", {"Z": DEPTH[:-1]})
    with pytest.raises(SpreadletsError, match="29"):
        sp.read_frame(beauty, depth_file=small)


# --- Invalid values and the background -----------------------------------------------------------------------------

SKY = ~DISC


def with_sky(value):
    return np.where(SKY, np.float32(value), DEPTH)


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, -np.inf])
def test_a_bad_label_under_a_good_colour_is_mended_not_the_colour(tmp_path, value):
    path = write(tmp_path / "f.exr", COLOUR | {"Z": with_sky(value)})
    with pytest.raises(InvalidFrameError, match="background_depth"):
        read(path)
    frame, told = read(path, repair=True)
    np.testing.assert_array_equal(frame.radiance[..., :3], RGB)
    assert (frame.radiance[..., 3] == 1).all() and np.isinf(frame.depth[SKY]).all() and (frame.depth[DISC] == 2).all()
    assert frame.repaired_pixels == np.count_nonzero(SKY)


@pytest.mark.parametrize(
    ("value", "said"), [(0.0, "0"), (0.0, 0), (-1.0, "-1"), (-5.0, "<0"), (np.nan, "nan"), (1e7, ">1e6")]
)
def test_what_stands_for_the_background_can_be_said(tmp_path, value, said):
    frame, told = read(write(tmp_path / "f.exr", COLOUR | {"Z": with_sky(value)}), background_depth=said)
    assert np.isinf(frame.depth[SKY]).all() and (frame.depth[DISC] == 2).all() and told == ""


def test_depth_that_is_negative_everywhere_has_its_sign_turned_on_demand(tmp_path):
    path = write(tmp_path / "f.exr", COLOUR | {"Z": -DEPTH})
    with pytest.raises(InvalidFrameError, match="depth_scale"):
        read(path)
    assert_scene(read(path, depth_scale=-1)[0], motion=False)


def test_motion_that_is_not_finite_becomes_still(tmp_path):
    channels = COLOUR | {"Z": DEPTH, "motion.x": np.where(SKY, np.nan, RIGHT), "motion.y": np.where(SKY, np.nan, DOWN)}
    frame, _ = read(write(tmp_path / "f.exr", channels), repair=True)
    assert_scene(frame)


def test_a_colour_that_is_not_finite_is_filled_from_neighbours_of_like_depth(tmp_path):
    red = RGB[..., 0].copy()
    edge = (16, 20)
    assert DISC[edge] and not DISC[16, 21]
    red[edge] = np.inf
    frame, _ = read(write(tmp_path / "f.exr", COLOUR | {"R": red, "Z": DEPTH}), repair=True)
    np.testing.assert_allclose(frame.radiance[edge], (0.8, 0.1, 0.05, 1), rtol=1e-5)


@pytest.mark.parametrize("overshoot", [1.02, -0.02])
def test_alpha_a_few_percent_out_of_range_is_clipped_with_a_count(tmp_path, overshoot):
    alpha = ONES.copy()
    alpha[3, 4:9] = overshoot
    frame, told = read(write(tmp_path / "f.exr", COLOUR | {"A": alpha, "Z": DEPTH}))
    assert (frame.radiance[3, 4:9, 3] == np.clip(overshoot, 0, 1)).all() and "5" in told and "alpha" in told


# --- Values against each other -------------------------------------------------------------------------------------


def test_a_named_renderer_does_not_silence_doubt_about_the_values(tmp_path):
    path = write(tmp_path / "f.exr", COLOUR | {"depth.Z": DEPTH})
    assert_scene(read(path)[0], motion=False)
    frame, told = read(path, preset="nuke")
    assert_scene(frame, motion=False)
    assert "depth_convention" in told
    assert "depth_convention planar" not in read(path, preset="nuke", depth_convention="planar")[1]


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_pictures_in_integer_codes_are_no_radiance(kind):
    with pytest.raises(InvalidFrameError, match=r"8-bit|16-bit"):
        sp.Frame(np.full((4, 6, 3), 200, kind), np.ones((4, 6)))


def layers(tmp_path, names=("front.exr", "back.exr"), front_alpha=None):
    alpha = COVERED if front_alpha is None else front_alpha
    front = {name: COLOUR[name] * alpha for name in "RGB"} | {"A": alpha, "Z": DEPTH * 0 + 2}
    return [write(tmp_path / names[0], front), write(tmp_path / names[1], COLOUR | {"Z": DEPTH * 0 + 20})]


def test_layers_in_another_order_than_nearest_first_are_doubted(tmp_path):
    front, back = layers(tmp_path)
    assert read([front, back])[1] == ""
    told = read([back, front])[1]
    assert "nearest" in told


def test_an_opaque_layer_in_front_is_doubted(tmp_path):
    assert "opaque" in read(layers(tmp_path, front_alpha=ONES))[1]


def test_files_whose_names_differ_in_a_counter_may_be_a_sequence(tmp_path):
    told = read(layers(tmp_path, ("frame.0001.exr", "frame.0002.exr")))[1]
    assert "####" in told and "layers" in told


# --- Deep ----------------------------------------------------------------------------------------------------------


def deep(surfaces):
    """Return a deep image of surfaces: where, how deep, what colour."""
    surfaces = sorted(surfaces, key=lambda surface: surface[1])
    counts = sum(places.astype(int) for places, _, _ in surfaces)
    samples = [
        (*colour, 1.0, depth)
        for row in range(HEIGHT)
        for col in range(WIDTH)
        for places, depth, colour in surfaces
        if places[row, col]
    ]
    table = np.array(samples, np.float32)
    return DeepImage(counts, table[:, :4], table[:, 4], table[:, 4])


def flattened(frame):
    """Return what a pinhole sees of a frame."""
    image = np.zeros((HEIGHT, WIDTH, 4), np.float32)
    for layer in frame.layers:
        image += (1 - image[..., 3:]) * layer.radiance
    return image


def discs(*places):
    return [((COLS - x) ** 2 + (ROWS - 15) ** 2 < 64, depth, colour) for x, depth, colour in places]


RED, BLUE = (0.8, 0.1, 0.1), (0.1, 0.2, 0.8)


def test_deep_files_of_one_scene_are_merged_sample_by_sample(tmp_path):
    """A red disc in front of and one behind blue ones: neither file lies before the other."""
    red, blue = discs((10, 2, RED), (32, 20, RED)), discs((16, 6, BLUE), (26, 6, BLUE))
    sp.write_deep(tmp_path / "red.exr", deep(red))
    sp.write_deep(tmp_path / "blue.exr", deep(blue))
    sp.write_deep(tmp_path / "both.exr", deep(red + blue))
    truth = flattened(sp.read_frame(tmp_path / "both.exr"))
    for order in (("red", "blue"), ("blue", "red")):
        frame, told = read([tmp_path / f"{name}.exr" for name in order])
        np.testing.assert_allclose(flattened(frame), truth, atol=1e-6)
        assert told == ""


def write_deep_parts(path, parts, headers):
    written = []
    for name, channels in parts.items():
        planes = {each: deep_pixels(value) for each, value in channels.items()}
        header = {"type": OpenEXR.deepscanline, "compression": OpenEXR.ZIPS_COMPRESSION, "name": name}
        written.append(OpenEXR.Part(header | headers.get(name, {}), planes))
    OpenEXR.File(written).write(str(path))
    return path


def deep_pixels(value):
    pixels = np.empty((HEIGHT, WIDTH), object)
    for row, col in np.ndindex(HEIGHT, WIDTH):
        pixels[row, col] = np.full(int(DISC[row, col]), value, np.float32)
    return pixels


def test_the_hero_view_of_a_deep_stereo_file_is_read_unless_another_is_named(tmp_path):
    channels = {"R": 0.5, "G": 0.5, "B": 0.5, "A": 1.0}
    parts = {"rgba.left": channels | {"Z": 3.0}, "rgba.right": channels | {"Z": 7.0}}
    path = write_deep_parts(tmp_path / "f.exr", parts, {"rgba.left": {"view": "left"}, "rgba.right": {"view": "right"}})
    assert read(path)[0].layers[0].depth[INSIDE] == 3
    assert read(path, view="right")[0].layers[0].depth[INSIDE] == 7
    report = frame_info(path)
    assert report["layers"][0]["depth"]["min_m"] == report["layers"][0]["depth"]["max_m"] == 3


@pytest.mark.parametrize("alpha", [("AR", "AG", "AB"), ("alpha",)])
def test_deep_alpha_is_known_by_other_names(tmp_path, alpha):
    channels = {"R": 0.25, "G": 0.25, "B": 0.25, "Z": 3.0} | dict.fromkeys(alpha, 0.5)
    frame, _ = read(write_deep_parts(tmp_path / "f.exr", {"rgba": channels}, {}))
    np.testing.assert_allclose(flattened(frame)[INSIDE], (0.25, 0.25, 0.25, 0.5))


def test_deep_samples_without_colour_are_refused_with_what_is_needed(tmp_path):
    path = write_deep_parts(tmp_path / "f.exr", {"rgba": {"A": 1.0, "Z": 3.0}}, {})
    with pytest.raises(InvalidFileError, match="colour"):
        sp.read_frame(path)


# --- Samples -------------------------------------------------------------------------------------------------------


def test_samples_whose_header_stands_in_the_same_file_are_reconstructed(tmp_path, run, small_combined_path):
    shape = (HEIGHT, WIDTH, 1)
    camera = sp.ThinLens(50, 36, 16, 4)
    samples = sp.SampleBuffer(
        RGB[:, :, None], np.full(shape, 4.0), np.zeros((*shape, 2)), np.zeros((*shape, 2)), np.zeros(shape)
    )
    sp.write_tlfr(tmp_path / "two.txt", samples, camera=camera, binary=False)
    one = tmp_path / "one.txt"
    one.write_text((tmp_path / "two.txt.header").read_text() + (tmp_path / "two.txt").read_text())
    given = ["--focal-length", 50, "--sensor-width", 36, "--f-number", 16, "--focus", 4, "--shutter", "180deg"]
    for name in ("one", "two"):
        made = ["reconstruct", tmp_path / f"{name}.txt", "-o", tmp_path / f"{name}.exr", "--db", small_combined_path]
        status, _, error = run(*made, *given)
        assert status == 0, error
    np.testing.assert_array_equal(sp.read_image(tmp_path / "one.exr"), sp.read_image(tmp_path / "two.exr"))


# --- What info says ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("value", [-1.0, np.nan])
def test_info_lists_what_reading_stops_at(tmp_path, value):
    path = write(tmp_path / "f.exr", COLOUR | {"Z": with_sky(value)})
    with pytest.raises(InvalidFrameError) as stopped:
        sp.read_frame(path)
    assert frame_info(path)["problems"] == [str(stopped.value)]
    assert frame_info(write(path, COLOUR | {"Z": with_sky(np.inf)}))["problems"] == []


# --- Cameras -------------------------------------------------------------------------------------------------------

ATTRIBUTES = {
    "OpenEXR": {
        "nominalFocalLength": 85.0,
        "aperture": 2.0,
        "focus": 3.0,
        "sensorOverallDimensions": (36.0, 24.0),
        "shutterAngle": 180.0,
    },
    "Unreal": {
        "unreal/camera/FinalImage/focalLength": "85.0",
        "unreal/camera/FinalImage/fstop": "2.0",
        "unreal/camera/FinalImage/focalDistance": "300.0",
        "unreal/camera/FinalImage/sensorWidth": "36.0",
        "unreal/camera/FinalImage/fov": "23.9",
    },
    "Redshift": {
        "rs/camera/fov": float(2 * np.degrees(np.arctan(18 / 85))),
        "rs/camera/aperture": (36.0, 24.0),
        "rs/camera/FStop": 2.0,
        "rs/camera/DOFFocusDistance": 3.0,
    },
    "V-Ray": {"cameraFocalLength": 85.0, "cameraAperture": 36.0, "aperture": 2.0, "focus": 3.0},
    "Arnold": {
        "CameraFocalLength": 85.0,
        "CameraFilmApertureHorizontal": 36.0 / 25.4,
        "aperture": 2.0,
        "focus": 3.0,
    },
    "Blender's note": {"Note": '{"focal_length_mm": 85, "sensor_width_mm": 36, "f_number": 2, "focus_distance_m": 3}'},
}


@pytest.mark.parametrize("program", ATTRIBUTES)
def test_a_frames_header_holds_the_camera(tmp_path, program):
    path = write(tmp_path / "f.exr", COLOUR | {"Z": DEPTH}, **ATTRIBUTES[program])
    camera = sp.read_camera(path, shutter="180deg")
    found = camera.focal_length_mm, camera.sensor_width_mm, camera.f_number, camera.focus_distance_m, *camera.shutter
    np.testing.assert_allclose(found, (85, 36, 2, 3, -0.25, 0.25), rtol=1e-4)


def test_of_several_parts_any_may_hold_the_camera(tmp_path):
    parts = {"mask": {"m": ONES}, "rgba": COLOUR | {"Z": DEPTH}}
    path = write_parts(tmp_path / "f.exr", parts, {"rgba": ATTRIBUTES["OpenEXR"]})
    assert sp.read_camera(path).focal_length_mm == 85


@pytest.mark.parametrize(
    ("fit", "shape", "width"),
    [
        ("horizontal", (40, 30), 36),
        ("auto", (40, 30), 27),
        ("auto", (30, 40), 36),
        ("vertical", (40, 30), 18),
        ("vertical", (30, 40), 32),
    ],
)
def test_the_sensor_spans_the_side_that_its_fit_says(tmp_path, fit, shape, width):
    content = CAMERA | {"sensor_fit": fit.upper(), "sensor_height_mm": 24.0}
    (tmp_path / "camera.json").write_text(json.dumps(content))
    camera = sp.read_camera(tmp_path / "camera.json").fitted(shape)
    assert camera.sensor_width_mm == pytest.approx(width)


def test_keys_of_a_camera_that_are_not_known_are_named(tmp_path):
    (tmp_path / "camera.json").write_text(json.dumps(CAMERA | {"lens_modle": "textbook"}))
    with pytest.warns(AmbiguousInputWarning, match="lens_modle"):
        sp.read_camera(tmp_path / "camera.json")


USD = """#usda 1.0
(
    metersPerUnit = 0.01
)
def Camera "main"
{
    float focalLength = 85
    float horizontalAperture = 36
    float verticalAperture = 24
    float fStop = 2
    float focusDistance = 300
    double shutter:open = -0.25
    double shutter:close = 0.25
}
"""


def test_a_usd_file_holds_the_camera(tmp_path):
    pytest.importorskip("pxr")
    (tmp_path / "shot.usda").write_text(USD + USD[USD.index("def") :].replace("main", "witness"))
    camera = sp.read_camera(f"{tmp_path / 'shot.usda'}:/main", f_number=4)
    found = camera.focal_length_mm, camera.sensor_width_mm, camera.f_number, camera.focus_distance_m, *camera.shutter
    np.testing.assert_allclose(found, (85, 36, 4, 3, -0.25, 0.25), rtol=1e-6)
    with pytest.raises(SpreadletsError, match="/main, /witness"):
        sp.read_camera(tmp_path / "shot.usda")


# --- The command line ----------------------------------------------------------------------------------------------


@pytest.fixture
def run(monkeypatch, capsys):
    from spreadlets.cli import main as command

    def run_command(*arguments):
        monkeypatch.setattr("sys.argv", ["spreadlets", *map(str, arguments)])
        monkeypatch.setattr(warnings, "showwarning", warnings.showwarning)
        status = 0
        with warnings.catch_warnings():
            warnings.simplefilter("always", AmbiguousInputWarning)
            try:
                command.main()
            except SystemExit as stop:
                status = stop.code
        captured = capsys.readouterr()
        return status, captured.out, captured.err

    return run_command


def test_errors_and_warnings_spell_options_as_the_command_line_does(tmp_path, run):
    path = write(tmp_path / "f.exr", COLOUR)
    status, _, error = run("compare", path, write(tmp_path / "g.exr", prefixed("a.", COLOUR) | prefixed("b.", COLOUR)))
    assert status == 2 and "--colour-layer" in error and "colour_layer" not in error
    camera = tmp_path / "camera.json"
    camera.write_text(json.dumps(CAMERA))
    status, _, error = run("synth", path, "-o", tmp_path / "o.exr", "--camera", camera)
    assert status == 2 and "--depth-channel" in error and "depth_channel" not in error
    unused = write(path, COLOUR | {"Z": DEPTH, "mvec_raw.r": RIGHT, "mvec_raw.g": DOWN})
    report = json.loads(run("info", unused, "--json")[1])
    assert any("--motion-channels" in each for each in report["warnings"])


def test_commands_that_read_frames_take_the_options_that_their_errors_name(tmp_path, run, small_combined_path):
    camera = tmp_path / "camera.json"
    camera.write_text(json.dumps(CAMERA))
    odd = write(tmp_path / "odd.exr", prefixed("a.", COLOUR) | prefixed("b.", COLOUR) | {"w": DEPTH})
    plain = write(tmp_path / "plain.exr", COLOUR | {"w": DEPTH})
    status, out, error = run("compare", odd, plain, "--colour-layer", "b", "--json")
    assert status == 0, error
    assert json.loads(out)["mae"] == 0
    reading = ["--depth-channel", "w", "--colour-layer", "b", "--motion-channels", "none"]
    made = ["synth", odd, "-o", tmp_path / "o.exr", "--camera", camera, "--db", small_combined_path, *reading]
    status, _, error = run(*made, "--reference", odd, "--json")
    assert status == 0, error


def test_a_frame_that_carries_its_camera_needs_none_and_single_options_override(tmp_path, run, small_combined_path):
    path = write(tmp_path / "f.exr", COLOUR | {"Z": DEPTH}, **ATTRIBUTES["OpenEXR"])
    status, out, error = run("info", path, "--json")
    assert status == 0 and json.loads(out)["camera"]["focus_distance_m"] == 3, error
    given = ["--db", small_combined_path, "--focus", "4", "--f-number", "16", "--shutter", "90deg"]
    status, _, error = run("synth", path, "-o", tmp_path / "o.exr", *given, "--json")
    assert status == 0, error
    bare = write(tmp_path / "bare.exr", COLOUR | {"Z": DEPTH})
    status, _, error = run("synth", bare, "-o", tmp_path / "p.exr", "--db", small_combined_path)
    assert status == 2 and "--focal-length" in error and "--camera" in error


UNLIKELY = {
    "focus in millimetres": ({"focus_distance_m": 4000.0}, "focus"),
    "sensor in metres": ({"sensor_width_mm": 0.036}, "field of view"),
    "focal length in metres": ({"focal_length_mm": 0.05}, "field of view"),
    "shutter in degrees": ({"shutter_open_close_frames": [-90, 90]}, "shutter"),
}


@pytest.mark.parametrize("slip", UNLIKELY)
def test_units_that_do_not_fit_the_frame_are_doubted(tmp_path, run, small_combined_path, slip):
    """Even with a sky at 1e10, as Cycles has it."""
    changed, word = UNLIKELY[slip]
    (tmp_path / "camera.json").write_text(json.dumps(CAMERA | {"f_number": 16.0} | changed))
    path = write(tmp_path / "f.exr", COLOUR | {"Z": np.where(ROWS < 5, 1e10, DEPTH)})
    status, out, error = run("info", path, "--camera", tmp_path / "camera.json", "--json")
    assert status == 0, error
    assert any(word in each for each in json.loads(out)["warnings"])


def test_depth_in_centimetres_is_doubted(tmp_path, run):
    (tmp_path / "camera.json").write_text(json.dumps(CAMERA))
    path = write(tmp_path / "f.exr", COLOUR | {"Z": 100 * DEPTH})
    told = json.loads(run("info", path, "--camera", tmp_path / "camera.json", "--json")[1])["warnings"]
    assert any("--depth-scale 0.01" in each for each in told)
    scaled = ["--depth-scale", "0.01", "--camera", tmp_path / "camera.json", "--json"]
    assert json.loads(run("info", path, *scaled)[1])["warnings"] == []


def test_names_of_channels_may_be_separated_by_a_comma_and_a_space(tmp_path, run):
    path = write(tmp_path / "f.exr", COLOUR | {"Z": DEPTH, "p": RIGHT, "q": DOWN})
    given = ["--motion-channels", "p, q", "--motion-convention", "forward-px"]
    status, out, error = run("info", path, *given, "--json")
    assert status == 0, error
    assert json.loads(out)["problems"] == []


CAMERA = {
    "focal_length_mm": 50.0,
    "sensor_width_mm": 36.0,
    "f_number": 0.1,
    "focus_distance_m": 4.0,
    "shutter_open_close_frames": [-0.25, 0.25],
}
