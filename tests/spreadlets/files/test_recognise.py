"""Which channels are taken, of files as programs write them: names, views, view layers, parts, and single passes."""

import warnings

import numpy as np
import OpenEXR
import pytest

import spreadlets as sp
from spreadlets.errors import AmbiguousInputWarning, InvalidFileError, InvalidParameterError

SHAPE = (5, 7)


def plane(value):
    return np.broadcast_to(np.float32(value), SHAPE).copy()


def colours(prefix="", value=0.5, names="RGBA"):
    return {prefix + name: (1.0 if name == "A" else value) for name in names}


def write(path, channels, **header):
    planes = {name: plane(value) for name, value in channels.items()}
    OpenEXR.File({"type": OpenEXR.scanlineimage, **header}, planes).write(str(path))
    return path


def write_parts(path, parts):
    """Write parts of (name, channels, header)."""
    made = [
        OpenEXR.Part(
            {"type": OpenEXR.scanlineimage, "name": name, **header}, {k: plane(v) for k, v in channels.items()}
        )
        for name, channels, header in parts
    ]
    OpenEXR.File(made).write(str(path))
    return path


@pytest.fixture
def path(tmp_path):
    return tmp_path / "f.exr"


# --- Motion --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("channels", "motion", "doubt"),
    [
        ({"velX": 3, "velY": 2}, (3, -2), "3ds Max"),
        ({"Motion vector.R": 3, "Motion vector.G": 2}, (3, -2), "Octane"),
        (
            {
                "FinalImageMovieRenderQueue_MotionVectors.R": 0.5 + 3 / 14,
                "FinalImageMovieRenderQueue_MotionVectors.G": 0.5 + 2 / 10,
            },
            (3, 2),
            "Unreal",
        ),
    ],
)
def test_motion_of_other_programs_is_read_with_a_doubt(path, channels, motion, doubt):
    with pytest.warns(AmbiguousInputWarning, match=f"{doubt}.*say motion_convention"):
        frame = sp.read_frame(write(path, colours() | {"Z": 2} | channels))
    np.testing.assert_allclose(frame.motion[0, 0], motion, atol=1e-5)


def test_three_channels_of_blenders_vector_are_the_way_from_the_frame_before(path):
    frame = sp.read_frame(write(path, colours() | {"Z": 2, "Vector.X": -3, "Vector.Y": 2, "Vector.Z": 9}))
    assert tuple(frame.motion[0, 0]) == (3, 2)


@pytest.mark.parametrize("names", ["P.X P.Y P.Z", "ViewLayer.Position.X ViewLayer.Position.Y ViewLayer.Position.Z"])
def test_positions_in_the_world_are_a_depth_where_the_camera_is_known(path, names):
    rows, cols = np.indices(SHAPE)
    depth = 2.0 + 0.1 * rows + 0.2 * cols
    pose = np.array([[0.0, 0.0, 1.0, 5.0], [0.0, 1.0, 0.0, 1.0], [-1.0, 0.0, 0.0, -3.0], [0.0, 0.0, 0.0, 1.0]])
    seen = np.stack([0.1 * cols * depth, -0.1 * rows * depth, -depth, np.ones(SHAPE)], axis=-1)
    world = 100.0 * (seen @ pose.T)[..., :3]
    world[2, 3] = 0.0
    prefix = names.split("P")[0]
    given = colours(f"{prefix}Combined." if prefix else "") | {
        name: world[..., axis] for axis, name in enumerate(names.split())
    }
    camera = sp.ThinLens(50, 36, 2, 3, camera_to_world=pose)
    frame = sp.read_frame(write(path, given), camera=camera, depth_scale=0.01)
    depth[2, 3] = np.inf
    np.testing.assert_allclose(frame.depth, depth, rtol=1e-5)
    with pytest.raises(InvalidParameterError, match="needs to know where the camera is.*camera_to_world"):
        sp.read_frame(path, camera=sp.ThinLens(50, 36, 2, 3))
    # A depth channel comes first.
    assert (
        sp.read_frame(write(path, given | {f"{prefix}Z" if not prefix else "ViewLayer.Depth.Z": 4.0})).depth[0, 0] == 4
    )


@pytest.mark.parametrize("names", ["motion.x motion.y motion.z", "velX velY velZ", "motion.u motion.v motion.w"])
def test_a_third_component_of_motion_that_is_not_used_is_named(path, names):
    first, second, third = names.split()
    given = {**colours(), "Z": 2, first: 3, second: 2, third: np.arange(35.0).reshape(SHAPE)}
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        sp.read_frame(write(path, given))
    said = [str(each.message) for each in caught]
    assert sum(f"{third} beside the motion {first}, {second} is not used" in each for each in said) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        sp.read_frame(path, motion_convention="forward-px")
        # A filler says nothing; nor is there anything left out of a velocity in space.
        if first == "motion.x":
            sp.read_frame(write(path, given | {third: 1.0}))
        sp.read_frame(
            write(path, given),
            motion_convention="camera-velocity",
            motion_channels=(first, second, third),
            camera=sp.ThinLens(50, 36, 2, 3),
        )


@pytest.mark.parametrize("names", ["mv.G mv.R", "vel.x vel.y", "MyVelocity.G MyVelocity.R", "opticalflow.u"])
def test_what_looks_like_motion_is_named_when_the_frame_stays_still(path, names):
    write(path, colours() | {"Z": 2} | dict.fromkeys(names.split(), 1.0))
    with pytest.warns(AmbiguousInputWarning) as caught:
        assert not sp.read_frame(path).layers[0].has_motion
    (message,) = {str(warning.message) for warning in caught}
    assert names.replace(" ", ", ") in message and "motion_channels" in message and "motion_convention" in message
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        sp.read_frame(path, motion_channels=())


def test_spaces_between_named_channels_do_not_count(path):
    write(path, colours() | {"Z": 2, "a": 3, "b": 2})
    frame = sp.read_frame(path, motion_channels=("a", " b"), motion_convention="forward-px")
    assert tuple(frame.motion[0, 0]) == (3, 2)


# --- Depth ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "name",
    "Depth.V ViewLayer.Depth.V FinalImageMovieRenderQueue_WorldDepth.R Pz depth depth.Y dd.y DEPTH.R VRayZDepth "
    "zDepth.R DEPTH.Y depth.R depth_main.Z".split()
    + ["Z depth.R"],
)
@pytest.mark.filterwarnings("ignore:.*taken for planar metres")
def test_depth_of_many_programs_is_recognised(path, name):
    prefix = "ViewLayer.Combined." if name.startswith("ViewLayer") else ""
    assert sp.read_frame(write(path, colours(prefix) | {name: 3})).depth[0, 0] == 3


def test_z_of_a_vector_is_no_depth_but_z_alone_in_a_part_is(path):
    write_parts(path, [("beauty", colours(), {}), ("N", {"X": 0, "Y": 0, "Z": 1}, {}), ("any", {"Z": 3}, {})])
    assert sp.read_frame(path).depth[0, 0] == 3


def test_equal_depths_are_no_ambiguity(path):
    assert sp.read_frame(write(path, colours() | {"Z": 3, "depth.Z": 3})).depth[0, 0] == 3
    with pytest.raises(InvalidFileError, match="several depth channels"):
        sp.read_frame(write(path, colours() | {"Z": 3, "depth.Z": 4}))


def test_what_looks_like_depth_is_named_where_none_is_recognised(path):
    with pytest.raises(InvalidFileError, match=r"lacks a depth channel \(my_dist.R may be it\)"):
        sp.read_frame(write(path, colours() | {"my_dist.R": 3}))


def test_inverse_depth_of_a_preset_is_planar_where_it_would_lie_within_a_metre(path):
    write(path, colours() | {"depth.Z": 3})
    with pytest.warns(AmbiguousInputWarning, match=r"\(nearest 0\.333 m\), and is taken for planar metres; say"):
        assert sp.read_frame(path, preset="nuke").depth[0, 0] == 3
    with pytest.warns(AmbiguousInputWarning, match="taken for planar metres"):
        assert sp.read_frame(path, preset="nuke", depth_channel="depth.Z").depth[0, 0] == 3
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        inverse = sp.read_frame(path, preset="nuke", depth_convention="inverse")
        assert inverse.depth[0, 0] == pytest.approx(1 / 3)
        assert sp.read_frame(write(path, colours() | {"depth.Z": 0.1}), preset="nuke").depth[0, 0] == pytest.approx(10)


@pytest.mark.parametrize(
    ("rule", "values"),
    [(0, 0), ("0", 0), (-1, -1), ("nan", np.nan), ("<0", -7), (">100", 5e4), (65504, 65500)],
)
def test_the_depth_of_the_background_can_be_said(path, rule, values):
    channels = {name: plane(value) for name, value in (colours() | {"Z": 3}).items()}
    channels["Z"][0] = values
    OpenEXR.File({"type": OpenEXR.scanlineimage}, channels).write(str(path))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        frame = sp.read_frame(path, background_depth=rule)
    assert np.isinf(frame.depth[0]).all() and (frame.depth[1:] == 3).all() and (frame.radiance[..., 3] == 1).all()


def test_other_backgrounds_are_refused(path):
    with pytest.raises(InvalidParameterError, match="background_depth is 'sky'; it must be a number, nan, <X or >X"):
        sp.read_frame(path, background_depth="sky")


def test_a_scale_below_zero_turns_the_sign(path):
    assert sp.read_frame(write(path, colours() | {"Z": -3}), depth_scale=-1).depth[0, 0] == 3


# --- Colour and alpha ----------------------------------------------------------------------------------------------


def test_alpha_beside_a_prefixed_colour_is_taken(path):
    frame = sp.read_frame(write(path, {"Ci.r": 0.1, "Ci.g": 0.2, "Ci.b": 0.3, "a": 0.25, "z": 2}))
    np.testing.assert_array_equal(frame.radiance[0, 0], np.float32([0.1, 0.2, 0.3, 0.25]))


def test_alpha_that_belongs_to_another_colour_is_not_taken(path):
    write(path, colours(names="RGB") | {"Z": 2} | colours("spec.", 0.25))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert (sp.read_frame(path).radiance[..., 3] == 1).all()


def test_what_looks_like_alpha_is_named(path):
    write(path, colours(names="RGB") | {"Z": 2, "matte.alpha": 0.25})
    with pytest.warns(AmbiguousInputWarning, match=r"matte\.alpha may be alpha; say alpha_channel"):
        sp.read_frame(path)
    assert (sp.read_frame(path, alpha_channel="matte.alpha").radiance[..., 3] == 0.25).all()


@pytest.mark.parametrize(
    ("channels", "options"),
    [
        ({"red": 0.1, "green": 0.2, "blue": 0.3, "alpha": 1}, {}),
        ({"rgba.red": 0.1, "rgba.green": 0.2, "rgba.blue": 0.3}, {}),
        ({"x.red": 0.1, "x.green": 0.2, "x.blue": 0.3}, {"colour_layer": "x"}),
    ],
)
def test_colours_may_be_called_red_green_and_blue(path, channels, options):
    frame = sp.read_frame(write(path, channels | {"Z": 2}), **options)
    np.testing.assert_array_equal(frame.radiance[0, 0, :3], np.float32([0.1, 0.2, 0.3]))


def test_luminance_alone_is_grey(path):
    for options in ({}, {"colour_layer": "Y"}):
        frame = sp.read_frame(write(path, {"Y": 0.5, "A": 0.5, "Z": 2}), **options)
        assert (frame.radiance == 0.5).all()


# --- Beside the colour ---------------------------------------------------------------------------------------------


def test_labels_of_a_view_layer_belong_to_its_colour(path):
    layers = {"FG": 2.0, "BG": 5.0}
    channels = {}
    for name, z in layers.items():
        channels |= colours(f"{name}.Combined.", z / 10) | {f"{name}.Depth.Z": z}
        channels |= {f"{name}.Vector.{axis}": z for axis in "XYZW"}
    write(path, channels)
    for name, z in layers.items():
        for layer in (name, f"{name}.Combined"):
            frame = sp.read_frame(path, colour_layer=layer)
            assert frame.depth[0, 0] == z and frame.layers[0].motion_next[0, 0, 1] == z
    with pytest.warns(
        AmbiguousInputWarning, match="holds the view layers BG.Combined, FG.Combined; the first is taken"
    ):
        assert sp.read_frame(path).depth[0, 0] == 5
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        both = sp.read_frame(path, colour_layer=("FG", "BG"))
    assert [layer.depth[0, 0] for layer in both.layers] == [2, 5]


def test_the_compositors_picture_takes_the_labels_of_the_first_view_layer_and_says_so(path):
    write_parts(
        path,
        [
            ("Composite", colours("Composite.Combined.", 0.75), {}),
            ("B", colours("B.Combined.") | {"B.Depth.Z": 2} | {f"B.Vector.{axis}": 1 for axis in "XYZW"}, {}),
            ("A", colours("A.Combined.") | {"A.Depth.Z": 3} | {f"A.Vector.{axis}": 7 for axis in "XYZW"}, {}),
        ],
    )
    with pytest.warns(
        AmbiguousInputWarning, match=r"B\.Depth\.Z does not stand beside the colour Composite\.Combined\.R"
    ):
        frame = sp.read_frame(path)
    assert frame.radiance[0, 0, 0] == 0.75 and frame.depth[0, 0] == 2 and frame.motion[0, 0, 0] == -1


def test_labels_from_elsewhere_are_taken_with_a_warning_only(path):
    write(path, colours() | {"other.Combined.R": 1, "other.Depth.Z": 3})
    with pytest.warns(AmbiguousInputWarning, match="does not stand beside the colour R, G, B; say depth_channel"):
        assert sp.read_frame(path).depth[0, 0] == 3
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        sp.read_frame(path, depth_channel="other.Depth.Z")


def views(hero, other):
    return {
        **colours(value=hero / 10),
        "Z": hero,
        "forward.u": hero,
        "forward.v": 0,
        **colours("right.", other / 10),
        "right.Z": other,
        "right.forward.u": other,
        "right.forward.v": 0,
    }


@pytest.mark.parametrize(
    ("options", "value"), [({}, 2), ({"view": "left"}, 2), ({"view": "right"}, 5), ({"colour_layer": "right"}, 5)]
)
def test_views_are_told_apart_and_the_first_is_the_hero(path, options, value):
    frame = sp.read_frame(write(path, views(2, 5), multiView=["left", "right"]), **options)
    assert (frame.radiance[0, 0, 0], frame.depth[0, 0], frame.motion[0, 0, 0]) == (np.float32(value / 10), value, value)


def test_a_view_may_stand_before_the_last_word(path):
    channels = colours() | {"Z": 2}
    channels |= {"forward.left.u": 7, "forward.left.v": 0, "forward.right.u": 3, "forward.right.v": 0}
    assert sp.read_frame(write(path, channels, multiView=["right", "left"])).motion[0, 0, 0] == 3


def test_views_in_parts_are_told_apart(path):
    parts = [(f"rgba.{view}", colours() | {"Z": z}, {"view": view}) for view, z in (("left", 2), ("right", 5))]
    write_parts(path, parts)
    assert [sp.read_frame(path, view=view).depth[0, 0] for view in (None, "left", "right")] == [2, 2, 5]
    with pytest.raises(InvalidFileError, match="lacks the view 'middle'; its views are left, right"):
        sp.read_frame(path, view="middle")


# --- Files of single passes ----------------------------------------------------------------------------------------


def test_passes_may_stand_in_files_of_their_own(tmp_path):
    picture = write(tmp_path / "rgb.exr", colours(names="RGB"))
    grey = write(tmp_path / "z.exr", {"R": 3, "G": 3, "B": 3})
    single = write(tmp_path / "v.exr", {"V": 4})
    vectors = write(tmp_path / "mv.exr", {"R": 3, "G": 2, "B": 0})
    alpha = write(tmp_path / "a.exr", {"A": 0.25})
    frame = sp.read_frame(
        picture, depth_file=grey, motion_file=vectors, motion_convention="forward-px", alpha_file=alpha
    )
    assert frame.depth[0, 0] == 3 and tuple(frame.motion[0, 0]) == (3, 2) and frame.radiance[0, 0, 3] == 0.25
    assert sp.read_frame(picture, depth_file=single).depth[0, 0] == 4
    with pytest.warns(AmbiguousInputWarning, match="direction its name does not tell"):
        sp.read_frame(picture, depth_file=single, motion_file=vectors)
    assert sp.read_frame(picture, depth_file=vectors, depth_channel="G").depth[0, 0] == 2
    with pytest.raises(InvalidFileError, match=r"mv\.exr: holds several channels; name it with depth_channel"):
        sp.read_frame(picture, depth_file=vectors)


def test_passes_of_another_size_are_refused(tmp_path):
    picture = write(tmp_path / "rgb.exr", colours())
    OpenEXR.File({"type": OpenEXR.scanlineimage}, {"Z": np.ones((3, 3), np.float32)}).write(str(tmp_path / "z.exr"))
    with pytest.raises(sp.errors.InvalidFileError, match=r"the depth in .*z\.exr has 3 x 3 px, the colours have 7 x 5"):
        sp.read_frame(picture, depth_file=tmp_path / "z.exr")


# --- Order ---------------------------------------------------------------------------------------------------------


def test_files_that_differ_in_a_counter_are_doubted(tmp_path):
    paths = [write(tmp_path / f"v2.{n:04d}.exr", colours(value=0.5) | {"Z": n}) for n in (1, 2)]
    with pytest.warns(AmbiguousInputWarning) as caught:
        sp.read_frame(paths)
    assert any("name a sequence like v2.####.exr" in str(warning.message) for warning in caught)


def test_keywords_that_reading_does_not_know_are_refused(path):
    with pytest.raises(TypeError, match="reading knows no option 'depth_chanel'"):
        sp.read_frame(write(path, colours() | {"Z": 2}), depth_chanel="Z")


def test_the_keywords_are_the_fields():
    from dataclasses import fields

    from spreadlets.files.recognise import ReadKeywords

    assert set(ReadKeywords.__annotations__) == {field.name for field in fields(sp.ReadOptions)}


@pytest.mark.parametrize("other", ["motion_convention", "motion_file"])
def test_motion_that_is_left_out_has_no_meaning_and_no_file(other):
    with pytest.raises(InvalidParameterError, match=rf"motion_channels is \(\): {other} is then of nothing"):
        sp.ReadOptions(motion_channels=(), **{other: "blender"})
