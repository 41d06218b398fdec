"""Renderer conventions: each against its definition, and every preset through a file and back."""

import warnings

import numpy as np
import OpenEXR
import pytest

from spreadlets.errors import AmbiguousInputWarning, InvalidFileError, InvalidFrameError, InvalidParameterError
from spreadlets.files import exr_frames as exr
from spreadlets.files.conventions import (
    DEPTH_CONVENTIONS,
    MOTION_CONVENTIONS,
    PRESETS,
    Scale,
    motion_labels,
    planar_depth,
    stored_depth,
    stored_motion,
)
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.frame import Frame

SHAPE = (6, 8)
CAMERA = ThinLens(40, 32, 2.0, 3.0)  # 10 px at a width of 8
SCALE = Scale(CAMERA, depth_scale=0.01, baseline_m=0.065, max_displacement=20.0)


def random_frame(seed=0, *, curved=False, moving=True):
    rng = np.random.default_rng(seed)
    alpha = rng.random((*SHAPE, 1)).astype(np.float32)
    alpha[0] = 1
    radiance = np.concatenate([rng.random((*SHAPE, 3)).astype(np.float32) * alpha, alpha], axis=2)
    depth = (2 + 9 * rng.random(SHAPE)).astype(np.float32)
    depth[1, 1] = np.inf
    before, after = (rng.uniform(-8, 8, (*SHAPE, 2)).astype(np.float32) for _ in range(2))
    if curved:  # formats that store the halves alone have their mean as motion
        return Frame(radiance, depth, motion_prev=before, motion_next=after)
    return Frame(radiance, depth, before if moving else None)


# --- Depth ---------------------------------------------------------------------------------------------------------


def test_depth_conventions_are_what_their_names_say():
    planar = np.full(SHAPE, 4.0, np.float32)
    assert (planar_depth("planar", planar, Scale(depth_scale=0.01)) == np.float32(0.04)).all()
    np.testing.assert_allclose(planar_depth("inverse", np.float32(0.25) + 0 * planar, Scale()), 4)
    # A wall at 4 m, seen at 3.5 px right of and 2.5 px above the centre with a focal length of 10 px.
    length = 4 * np.sqrt(10**2 + 3.5**2 + 2.5**2) / 10
    ray = stored_depth("ray", planar, Scale(CAMERA))
    np.testing.assert_allclose(ray[0, 7], length, rtol=1e-6)
    np.testing.assert_allclose(planar_depth("ray", ray, Scale(CAMERA)), 4, rtol=1e-6)
    # Two cameras 6.5 cm apart: a point at 4 m shifts by 10 * .065 / 4 px.
    shift = np.full(SHAPE, 10 * 0.065 / 4, np.float32)
    np.testing.assert_allclose(planar_depth("disparity", shift, Scale(CAMERA, baseline_m=0.065)), 4, rtol=1e-6)


@pytest.mark.parametrize("convention", DEPTH_CONVENTIONS)
def test_depth_comes_back_in_every_convention(convention):
    depth = random_frame().depth
    np.testing.assert_allclose(
        planar_depth(convention, stored_depth(convention, depth, SCALE), SCALE), depth, rtol=1e-6
    )


def test_infinite_depth_is_zero_in_the_inverse_conventions():
    for convention in ("inverse", "disparity"):
        assert stored_depth(convention, np.full(SHAPE, np.inf, np.float32), SCALE)[0, 0] == 0
        assert np.isinf(planar_depth(convention, np.zeros(SHAPE, np.float32), SCALE)).all()


# --- Motion --------------------------------------------------------------------------------------------------------

# Right by 3 and down by 2 px per frame on a frame of 8 x 6 px, by its definition in each convention.
STORED = {
    "forward-px": (3, 2),
    "forward-px-up": (3, -2),
    "backward-px": (-3, -2),
    "backward-px-up": (-3, 2),
    "forward-ndc": (3 / 4, 2 / 3),
    "ndc": (3 / 4, -2 / 3),
    "backward-ndc-up": (-3 / 4, 2 / 3),
    "forward-uv-up": (3 / 8, -2 / 6),
    "backward-uv": (-3 / 8, -2 / 6),
    "forward-norm": (0.5 + 3 / 40, 0.5 + 2 / 40),
    "backward-norm-up": (0.5 - 3 / 40, 0.5 + 2 / 40),
    "forward-norm8": (127 * (1 + 3 / 20) / 255, 127 * (1 + 2 / 20) / 255),
    "forward-norm16-up": (32767 * (1 + 3 / 20) / 65535, 32767 * (1 - 2 / 20) / 65535),
    "nuke-forward": (3, -2),
    "nuke-backward": (-3, 2),
}


@pytest.mark.parametrize("name", STORED)
def test_straight_motion_conventions_are_what_their_names_say(name):
    channels = np.broadcast_to(np.array(STORED[name], np.float32), (*SHAPE, 2))
    labels = motion_labels(name, channels, np.ones(SHAPE, np.float32), SCALE)
    np.testing.assert_allclose(labels["motion"], np.broadcast_to((3, 2), (*SHAPE, 2)), rtol=2e-6)


def test_curved_motion_conventions_are_what_their_names_say():
    # At (100, 50) px with y up, it was at (97, 52) and will be at (105, 46).
    stored = {"blender": (97 - 100, 52 - 50, 100 - 105, 50 - 46), "nuke": (105 - 100, 46 - 50, 97 - 100, 52 - 50)}
    for name, values in stored.items():
        labels = motion_labels(name, np.full((*SHAPE, 4), values, np.float32), np.ones(SHAPE, np.float32), SCALE)
        assert (labels["motion_prev"] == (3, 2)).all() and (labels["motion_next"] == (5, 4)).all(), name


def test_velocity_in_space_is_projected():
    # A point at pixel (row 1, col 6) at 5 m: moved by a small step in space and projected again.
    velocity, focal_px = np.array([0.3, -0.2, 0.4]), 10.0
    x, y = (6.5 - 4) / focal_px * 5, -(1.5 - 3) / focal_px * 5
    step = 1e-5

    def project(p):
        return np.array([4 + focal_px * p[0] / p[2], 3 - focal_px * p[1] / p[2]])

    point = np.array([x, y, 5.0])
    expected = (project(point + step * velocity) - project(point - step * velocity)) / (2 * step)
    channels = np.broadcast_to((velocity * 100).astype(np.float32), (*SHAPE, 3))  # in centimetres, as the depth
    labels = motion_labels("camera-velocity", channels, np.full(SHAPE, 5.0, np.float32), SCALE)
    np.testing.assert_allclose(labels["motion"][1, 6], expected, rtol=1e-5)
    parts = np.concatenate([0.75 * channels, 0.25 * channels], axis=2).astype(np.float32)
    both = motion_labels("camera-velocity-sum", parts, np.full(SHAPE, 5.0, np.float32), SCALE)
    np.testing.assert_allclose(both["motion"], labels["motion"], rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("name", MOTION_CONVENTIONS)
def test_motion_comes_back_in_every_convention(name):
    convention = MOTION_CONVENTIONS[name]
    layer = random_frame(curved=convention.curved).layers[0]
    labels = {"motion": layer.motion, "motion_prev": layer.motion_prev, "motion_next": layer.motion_next}
    found = motion_labels(name, stored_motion(name, labels, layer.depth, SCALE), layer.depth, SCALE)
    # Integer codes are a step of max_displacement / 127 (or 32767) apart.
    step = {"norm8": 20 / 127, "norm16": 20 / 32767}.get(convention.unit, 0)
    assert found.keys() == convention.rows.keys()
    for label, values in found.items():
        np.testing.assert_allclose(values, labels[label], rtol=3e-6, atol=0.51 * step + 2e-5, err_msg=label)
        if step:
            assert np.abs(values - labels[label]).max() > 0.25 * step


@pytest.mark.parametrize("options", [{"depth_scale": 0}, {"baseline_m": -1}, {"max_displacement": np.inf}])
def test_impossible_scales_are_refused(options):
    with pytest.raises(InvalidParameterError, match="must be finite and (> 0|not 0)"):
        Scale(**options)


def test_motion_beyond_the_integer_codes_is_refused():
    layer = random_frame().layers[0]
    with pytest.raises(InvalidParameterError, match="max_displacement is 2 px, but the frame moves by 7"):
        stored_motion("forward-norm8", {"motion": layer.motion}, layer.depth, Scale(max_displacement=2))


# --- Presets -------------------------------------------------------------------------------------------------------

NEEDS = {"camera": CAMERA, "max_displacement": 20.0}


@pytest.mark.parametrize("unpremultiplied", [False, True])
@pytest.mark.parametrize("path_kind", ["straight", "curved", "still"])
@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.filterwarnings("ignore::spreadlets.errors.AmbiguousInputWarning")
def test_a_frame_comes_back_through_every_preset(tmp_path, preset, path_kind, unpremultiplied):
    frame = random_frame(curved=path_kind == "curved", moving=path_kind != "still")
    path = tmp_path / "frame.exr"
    options = {"preset": preset, "unpremultiplied": unpremultiplied, "depth_scale": 0.01, **NEEDS}
    exr.write_frame(path, frame, **options)
    (found,), (expected,) = exr.read_frame(path, **options).layers, frame.layers
    # Inverse depth, normalised and projected motion are rounded to float32 on the way: 1e-6 of the range.
    np.testing.assert_allclose(found.radiance, expected.radiance, rtol=1e-6)
    np.testing.assert_allclose(found.depth, expected.depth, rtol=1e-6)
    np.testing.assert_allclose(found.motion, expected.motion, rtol=1e-6, atol=4e-6)
    assert found.has_motion == expected.has_motion
    if path_kind == "curved" and preset in ("blender", "nuke"):
        np.testing.assert_array_equal(found.motion_prev, expected.motion_prev)
        np.testing.assert_array_equal(found.motion_next, expected.motion_next)


EXPECTED_CHANNELS = {
    "blender": "ViewLayer.Combined.R ViewLayer.Depth.Z ViewLayer.Vector.X ViewLayer.Vector.W",
    "arnold": "R Z motionvector.R motionvector.G",
    "renderman": "R z dPdtime.r dPcameradtime.b",
    "vray": "R Z velocity.R velocity.G",
    "redshift": "R Z MotionVectors.R MotionVectors.G",
    "karma": "R ray:hitPz ray:motionvector.x ray:motionvector.y",
    "nuke": "R depth.Z forward.u backward.v",
    "unreal": "R FinalImageMovieRenderQueue_WorldDepth.R FinalImageMovieRenderQueue_MotionVectors.G",
    "octane": "R Z_depth.R Motion_vector.G",
    "3dsmax": "R Z velX velY",
}


@pytest.mark.parametrize("preset", PRESETS)
def test_presets_write_the_names_of_their_renderer(tmp_path, preset):
    exr.write_frame(tmp_path / "f.exr", random_frame(curved=True), preset=preset, **NEEDS)
    names = {channel.name for channel in OpenEXR.File(str(tmp_path / "f.exr"), header_only=True).header()["channels"]}
    assert set(EXPECTED_CHANNELS[preset].split()) <= {name.replace(" ", "_") for name in names}


@pytest.mark.parametrize("preset", sorted(set(PRESETS) - {"nuke"}))
def test_every_preset_but_one_is_recognised_without_being_named(tmp_path, preset):
    frame = random_frame()
    exr.write_frame(tmp_path / "f.exr", frame, preset=preset, **NEEDS)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = exr.read_frame(tmp_path / "f.exr", **NEEDS)
    np.testing.assert_allclose(found.depth, frame.depth, rtol=1e-6)
    np.testing.assert_allclose(found.motion, frame.motion, rtol=1e-6, atol=4e-6)
    doubtful = [str(warning.message) for warning in caught]
    assert bool(doubtful) == bool(PRESETS[preset].motion_doubt)
    assert all("to choose another or to silence this" in message for message in doubtful)


def test_inverse_depth_of_unknown_origin_is_taken_for_metres_with_a_warning(tmp_path):
    exr.write_frame(tmp_path / "f.exr", random_frame(), preset="nuke")
    with pytest.warns(AmbiguousInputWarning, match=r"depth\.Z is 0 at 1 pixels.*say depth_convention inverse"):
        with pytest.raises(InvalidFrameError, match="depth is zero"):
            exr.read_frame(tmp_path / "f.exr")
    assert np.isinf(exr.read_frame(tmp_path / "f.exr", depth_convention="inverse").depth[1, 1])


def write(path, **channels):
    planes = {"R": 0.5, "G": 0.5, "B": 0.5, "Z": 3.0} | {name.replace("_", "."): v for name, v in channels.items()}
    stored = {name: np.broadcast_to(np.float32(v), SHAPE).copy() for name, v in planes.items() if v is not None}
    OpenEXR.File({"type": OpenEXR.scanlineimage}, stored).write(str(path))
    return path


RAMP = np.linspace(0.05, 0.8, 48).reshape(SHAPE)


def test_small_varied_depth_is_doubtful_until_the_caller_says_what_it_is(tmp_path):
    path = write(tmp_path / "f.exr", Z=RAMP)
    with pytest.warns(AmbiguousInputWarning, match=r"Z holds 0\.05 to 0\.8, taken for planar metres"):
        exr.read_frame(path)
    for options in ({"depth_convention": "planar"}, {"preset": "arnold"}, {"depth_convention": "inverse"}):
        exr.read_frame(path, **options)
    exr.read_frame(write(path, Z=RAMP / 2 + 0.3))  # a close-up: 0.33 to 0.7 m
    exr.read_frame(write(path, Z=RAMP, A=0.0))  # nothing to see


def test_two_channels_of_unknown_direction_are_read_with_a_warning(tmp_path):
    path = write(tmp_path / "f.exr", motion_u=3, motion_v=2)
    with pytest.warns(AmbiguousInputWarning, match="direction its name does not tell"):
        assert (exr.read_frame(path).motion == (3, -2)).all()
    assert (exr.read_frame(path, motion_convention="backward-px").motion == (-3, -2)).all()


def test_unverified_presets_warn_unless_their_conventions_are_named(tmp_path):
    path = write(tmp_path / "f.exr", velocity_R=0.6, velocity_G=0.5)
    with pytest.warns(AmbiguousInputWarning) as caught:
        frame = exr.read_frame(path, preset="vray", max_displacement=10)
    assert len(caught) == 2 and "V-Ray's Z" in str(caught[0].message)
    np.testing.assert_allclose(frame.motion[0, 0], (2, 0), atol=1e-5)
    named = {"depth_convention": "planar", "motion_convention": "forward-px-up"}
    assert (exr.read_frame(path, preset="vray", **named).motion == np.float32((0.6, -0.5))).all()


def test_unpremultiplied_colours_are_multiplied_by_alpha(tmp_path):
    path = write(tmp_path / "f.exr", A=0.25)
    assert (exr.read_frame(path, unpremultiplied=True).radiance == (0.125, 0.125, 0.125, 0.25)).all()


def test_ray_distance_is_recognised_where_there_is_no_planar_depth(tmp_path):
    distance = {"ray:hitdist": stored_depth("ray", np.full(SHAPE, 3.0, np.float32), SCALE) * np.float32(0.01)}
    path = write(tmp_path / "f.exr", Z=None, **distance)
    np.testing.assert_allclose(exr.read_frame(path, camera=CAMERA).depth, 3, rtol=1e-6)
    path = write(tmp_path / "f.exr", Z=None, **distance, **{"ray:hitPz": 4.0})
    assert (exr.read_frame(path).depth == 4).all()


def test_an_empty_list_of_motion_channels_means_none(tmp_path):
    path = write(tmp_path / "f.exr", forward_u=1, forward_v=1)
    assert not exr.read_frame(path, motion_channels=()).layers[0].has_motion


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"depth_convention": "ray"}, "f.exr: depth_convention ray needs the camera"),
        ({"depth_convention": "disparity"}, "f.exr: depth_convention disparity needs the camera"),
        ({"depth_convention": "disparity", "camera": CAMERA}, r"needs the distance of the two cameras \(baseline_m\)"),
        ({"motion_convention": "forward-norm"}, r"forward-norm needs the motion in px .* \(max_displacement\)"),
        (
            {"preset": "maya"},
            "preset is 'maya'; allowed are blender, arnold, renderman, vray, redshift, karma, nuke, unreal",
        ),
    ],
)
def test_what_a_convention_needs_is_asked_for(tmp_path, options, message):
    path = write(tmp_path / "f.exr", forward_u=1, forward_v=1)
    with pytest.raises(InvalidParameterError, match=message):
        exr.read_frame(path, **options)


def test_a_preset_looks_for_its_own_channels_only(tmp_path):
    path = write(tmp_path / "f.exr", forward_u=1, forward_v=1)
    with pytest.warns(AmbiguousInputWarning, match=r"no motion was recognised, but forward\.u, forward\.v may be"):
        assert not exr.read_frame(path, preset="arnold").layers[0].has_motion
    with pytest.raises(InvalidFileError, match="lacks a depth channel"):
        exr.read_frame(path, preset="nuke")


def test_several_layers_do_not_fit_in_a_preset(tmp_path):
    layers = Frame.from_layers([random_frame(), random_frame(1)])
    with pytest.raises(InvalidFrameError, match="the preset nuke holds one layer, the frame has 2"):
        exr.write_frame(tmp_path / "f.exr", layers, preset="nuke")
