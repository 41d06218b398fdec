"""Cameras from JSON, from the attributes of OpenEXR files, from USD, and from single values."""

import json
import math
import struct
from fractions import Fraction

import numpy as np
import OpenEXR
import pytest

from spreadlets.errors import AmbiguousInputWarning, InvalidCameraError, MissingPackageError, option, options_spelled
from spreadlets.files.cameras import (
    MAX_CAMERA_BYTES,
    attribute_values,
    frame_camera,
    moved_along,
    parse_shutter,
    read_camera,
)
from spreadlets.scene.camera import ThinLens

VALUES = {"focal_length_mm": 85.0, "sensor_width_mm": 36.0, "f_number": 2.0, "focus_distance_m": 3.0}


def lens(**changes):
    return ThinLens(**(VALUES | {"shutter": (-0.25, 0.25)} | changes))


def write_json(path, **changes):
    content = VALUES | {"shutter_open_close_frames": [-0.25, 0.25]} | changes
    path.write_text(json.dumps({key: value for key, value in content.items() if value is not ...}))
    return path


def write_exr(path, **attributes):
    plane = np.ones((2, 2), np.float32)
    OpenEXR.File({"type": OpenEXR.scanlineimage, **attributes}, {"R": plane}).write(str(path))
    return path


def test_read_camera(tmp_path):
    path = write_json(tmp_path / "camera.json", scene="coins", lens_model="textbook")
    assert read_camera(path) == lens(shutter=(-0.25, 0.25), lens_model="textbook")


@pytest.mark.parametrize("value", [math.inf, "inf", "Infinity"])
def test_read_camera_accepts_a_focus_at_infinity(tmp_path, value):
    assert read_camera(write_json(tmp_path / "camera.json", focus_distance_m=value)).focus_distance_m == math.inf


@pytest.mark.parametrize("key", VALUES)
@pytest.mark.parametrize("value", [..., "six", None, [1], math.nan])
def test_read_camera_names_the_bad_key_and_the_file(tmp_path, key, value):
    path = write_json(tmp_path / "camera.json", **{key: value})
    with pytest.raises(InvalidCameraError, match=rf"camera\.json.*{key}"):
        read_camera(path)


@pytest.mark.parametrize("text", ["", "{", "[]", "7", "[" * 100_000, "\x00\xff", '{"f_number": ' + "9" * 5000 + "}"])
def test_read_camera_refuses_what_is_no_json_object(tmp_path, text):
    path = tmp_path / "camera.json"
    path.write_text(text, encoding="latin-1")
    with pytest.raises(InvalidCameraError, match=r"camera\.json.*JSON"):
        read_camera(path)


def test_a_key_is_not_there_twice(tmp_path):
    path = tmp_path / "camera.json"
    path.write_text(json.dumps(VALUES)[:-1] + ', "f_number": 9}')
    with pytest.raises(InvalidCameraError, match=r"camera\.json: has f_number twice"):
        read_camera(path)


def test_read_camera_refuses_huge_files_missing_files_and_folders(tmp_path):
    huge = tmp_path / "huge.json"
    huge.write_bytes(b" " * (MAX_CAMERA_BYTES + 1))
    with pytest.raises(InvalidCameraError, match="larger than"):
        read_camera(huge)
    for path in (tmp_path / "absent.json", tmp_path):
        with pytest.raises(InvalidCameraError, match="cannot be read"):
            read_camera(path)


def test_unknown_keys_are_named_with_what_may_be_meant(tmp_path):
    path = write_json(tmp_path / "camera.json", lens_modle="textbook", iso=100, renderer="x")
    with pytest.warns(AmbiguousInputWarning, match=r"iso, lens_modle \(did you mean lens_model\?\); known are"):
        assert read_camera(path) == lens()


def test_the_sensors_fit_is_read_as_blender_writes_it(tmp_path):
    path = write_json(tmp_path / "camera.json", sensor_fit="AUTO", sensor_height_mm=24)
    assert read_camera(path) == lens(sensor_fit="auto", sensor_height_mm=24.0)


def test_single_values_override_the_file_and_complete_it(tmp_path):
    path = write_json(tmp_path / "camera.json")
    assert read_camera(path, f_number=4.0, shutter="90deg") == lens(f_number=4.0, shutter=(-0.125, 0.125))
    path = write_json(tmp_path / "part.json", f_number=..., shutter_open_close_frames=...)
    assert read_camera(path, f_number=2.0, shutter="-0.25,0.25") == lens()
    with pytest.raises(InvalidCameraError, match=r"part\.json: lacks f_number, shutter_open.*say f_number, shutter"):
        read_camera(path)


def test_single_values_make_a_camera():
    values = {name: value for name, value in VALUES.items() if name != "sensor_width_mm"}
    with pytest.warns(AmbiguousInputWarning, match="sensor's width is taken for 36 mm; say sensor_width_mm"):
        assert read_camera(**values) == lens()
    with pytest.raises(InvalidCameraError, match="the camera lacks f_number, focus_distance_m; say f_number, focus"):
        read_camera(focal_length_mm=50.0, sensor_width_mm=36.0)


@pytest.mark.parametrize("text", ["180", "deg", "1,2,3", "a,b", ""])
def test_other_shutters_are_refused(text):
    with pytest.raises(InvalidCameraError, match="shutter is .* an angle such as 180deg"):
        parse_shutter(text)


# --- OpenEXR -------------------------------------------------------------------------------------------------------

HEADERS = {
    "standard": {
        "nominalFocalLength": 84.0,
        "effectiveFocalLength": 85.0,
        "aperture": 2.0,
        "focus": 3.0,
        "sensorOverallDimensions": (36.0, 24.0),
        "shutterAngle": 180.0,
    },
    "unreal": {
        "unreal/camera/FinalImage/focalLength": "85.0",
        "unreal/camera/FinalImage/fstop": "2.0",
        "unreal/camera/FinalImage/focalDistance": "300.0",
        "unreal/camera/FinalImage/sensorWidth": "36.0",
        "unreal/camera/shutterAngle": "180.0",
    },
    "vray": {"cameraFocalLength": 85.0, "cameraAperture": 36.0, "cameraFNumber": 2.0, "cameraTargetDistance": 3.0},
    "arnold": {
        "CameraFocalLength": 85.0,
        "CameraFilmApertureHorizontal": 36 / 25.4,
        "CameraFNumber": 2.0,
        "CameraFocusDistance": 3.0,
    },
    "redshift": {
        "rs/camera/focalLength": 85.0,
        "rs/camera/aperture": (36.0, 24.0),
        "rs/camera/FStop": 2.0,
        "rs/camera/DOFFocusDistance": 3.0,
    },
    "note": {"Note": json.dumps(VALUES)},
    "note in words": {"Note": "focal_length_mm=85 sensor_width_mm: 36; f_number=2.0, focus_distance_m=3"},
    "field of view": {
        "rs/camera/fov": math.degrees(2 * math.atan(18 / 85)),
        "rs/camera/aperture": 36.0,
        "rs/camera/FStop": 2.0,
        "focus": 3.0,
    },
}


@pytest.mark.parametrize("program", HEADERS)
def test_attributes_of_programs_make_the_camera(program):
    values = attribute_values(HEADERS[program])
    camera = ThinLens(**({"shutter": (-0.25, 0.25)} | values))
    for name, value in VALUES.items():
        assert getattr(camera, name) == pytest.approx(value), name
    assert camera.shutter == (-0.25, 0.25)


def test_focus_in_the_scenes_unit_is_scaled_with_the_depth():
    assert attribute_values({"cameraFocusDistance": 300.0}, 0.01)["focus_distance_m"] == 3


def test_an_exr_is_a_camera_file_and_a_frame_may_carry_its_camera(tmp_path):
    attributes = {name: value for name, value in HEADERS["vray"].items()}
    path = write_exr(tmp_path / "f.exr", **attributes)
    assert read_camera(path) == lens() and frame_camera(path) == VALUES
    assert read_camera(path, focus_distance_m=7.0) == lens(focus_distance_m=7.0)
    bare = write_exr(tmp_path / "bare.exr")
    assert frame_camera(bare) == frame_camera(tmp_path / "absent.exr") == {}
    with pytest.raises(InvalidCameraError, match=r"bare\.exr: holds no camera attributes"):
        read_camera(bare)


@pytest.mark.parametrize("rate", [{"framesPerSecond": Fraction(24, 1)}, {"captureRate": 24.0}])
def test_the_time_of_exposure_and_the_frame_rate_make_the_shutter(tmp_path, rate):
    path = write_exr(tmp_path / "f.exr", **HEADERS["vray"], expTime=1 / 96, **rate)
    assert read_camera(path).shutter == pytest.approx((-0.125, 0.125))
    angle = attribute_values({"expTime": 1 / 96, **rate, "shutterAngle": 90.0})
    assert angle["shutter"] == (-0.125, 0.125)  # the angle of a camera that says both is exact
    assert "shutter" not in attribute_values({"expTime": 1 / 96})


@pytest.mark.parametrize(
    ("timing", "shutter"), [("FrameOpen", (0.0, 0.5)), ("FrameCenter", (-0.25, 0.25)), ("FrameClose", (-0.5, 0.0))]
)
def test_the_shutters_timing_of_unreal(timing, shutter):
    header = HEADERS["unreal"] | {"unreal/camera/shutterTiming": timing}
    assert attribute_values(header)["shutter"] == shutter


def test_a_rational_without_a_denominator_is_refused_in_one_line(tmp_path):
    path = write_exr(tmp_path / "f.exr", framesPerSecond=Fraction(24, 1))
    rational = b"framesPerSecond\0rational\0" + struct.pack("<i", 8)
    content = path.read_bytes().replace(rational + struct.pack("<2i", 24, 1), rational + struct.pack("<2i", 24, 0))
    path.write_bytes(content)
    with pytest.raises(InvalidCameraError, match=r"not a readable OpenEXR file \(Fraction\(24, 0\)\)"):
        read_camera(path)


@pytest.mark.parametrize("value", ["", "x", 0.0, -1.0, math.nan])
def test_attributes_that_are_no_positive_numbers_do_not_count(value):
    assert attribute_values({"aperture": value}) == {}


# --- USD -----------------------------------------------------------------------------------------------------------


def test_usd_without_its_package_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pxr", None)
    with pytest.raises(MissingPackageError, match=r"pip install 'spreadlets\[usd\]'"):
        read_camera(tmp_path / "shot.usda")


USD = """#usda 1.0
( metersPerUnit = {unit} )
def Xform "World"
{{
    def Camera "A"
    {{
        float focalLength = 85
        float horizontalAperture = 36
        float verticalAperture = 24
        float fStop = 2
        float focusDistance = {focus}
        double shutter:open = -0.25
        double shutter:close = 0.25
    }}
{more}
}}
"""


def test_a_camera_of_a_usd_file(tmp_path):
    pytest.importorskip("pxr")
    path = tmp_path / "shot.usda"
    path.write_text(USD.format(unit=0.01, focus=300, more=""))
    assert read_camera(path) == lens(sensor_height_mm=24.0, camera_to_world=np.eye(4))
    path.write_text(USD.format(unit=0.01, focus=300, more='def Camera "B" {}'))
    assert read_camera(f"{path}:/World/A", f_number=4.0) == lens(
        sensor_height_mm=24.0, f_number=4.0, camera_to_world=np.eye(4)
    )
    with pytest.raises(InvalidCameraError, match=r"holds 2 cameras \(/World/A, /World/B\); say which"):
        read_camera(path)
    with pytest.raises(InvalidCameraError, match="has no camera at /World/C; its cameras: /World/A, /World/B"):
        read_camera(f"{path}:/World/C")
    path.write_text("no USD")
    with pytest.raises(InvalidCameraError, match="is not a readable USD file"):
        read_camera(path)
    with pytest.raises(InvalidCameraError, match="there is no such file"):
        read_camera(tmp_path / "absent.usd")


def test_a_lens_that_is_written_in_millimetres_at_metres_is_taken_so(tmp_path):
    pytest.importorskip("pxr")
    path = tmp_path / "shot.usda"
    path.write_text(USD.format(unit=1, focus=3, more=""))
    with pytest.warns(AmbiguousInputWarning, match="lens and sensor are taken for millimetres"):
        assert read_camera(path) == lens(sensor_height_mm=24.0, camera_to_world=np.eye(4))


ANIMATED = """#usda 1.0
(
    metersPerUnit = 0.01
    startTimeCode = 1
    endTimeCode = 3
)
def Xform "Crane"
{
    double3 xformOp:scale = (2, 2, 2)
    double3 xformOp:translate.timeSamples = { 1: (0, 0, 0), 2: (100, 0, 0), 3: (100, 300, 0) }
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:scale"]
    def Camera "A"
    {
        float focalLength = 85
        float horizontalAperture = 36
        float fStop = 2
        float focusDistance.timeSamples = { 1: 300, 2: 400, 3: 400 }
        float3 xformOp:rotateXYZ = (0, 90, 0)
        uniform token[] xformOpOrder = ["xformOp:rotateXYZ"]
        double shutter:open = -0.25
        double shutter:close = 0.25
    }
}
"""


def test_a_camera_that_a_usd_file_moves_has_keys_around_the_frame(tmp_path):
    pytest.importorskip("pxr")
    path = tmp_path / "shot.usda"
    path.write_text(ANIMATED)
    camera = read_camera(path, time_code=2)
    assert [key.time for key in camera.keys] == [-1.0, 0.0, 1.0]
    places = [np.asarray(camera.pose_at(time))[:3, 3].tolist() for time in (-1.0, 0.0, 1.0)]
    assert np.array(places) == pytest.approx(np.array([(0, 0, 0), (1, 0, 0), (1, 3, 0)]), abs=1e-6)
    # It looks along -x, and is not scaled.
    assert np.asarray(camera.pose_at(0.0))[:3, 2] == pytest.approx([1, 0, 0], abs=1e-6)
    assert camera.at(-0.25).focus_distance_m == pytest.approx(3.75)
    assert read_camera(path, time_code=2, focus_distance_m=9.0).at(-0.25).focus_distance_m == 9.0
    # Where the file begins, there is no frame before.
    assert [key.time for key in read_camera(path).keys] == [0.0, 1.0]


# --- Poses ---------------------------------------------------------------------------------------------------------

ASIDE = [[1.0, 0.0, 0.0, 2.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]


def test_a_json_camera_has_poses_at_keys(tmp_path):
    keys = [{"time": 0, "camera_to_world": np.eye(4).tolist()}, {"time": 1, "camera_to_world": ASIDE}]
    camera = read_camera(write_json(tmp_path / "truck.json", keys=keys))
    assert camera.moves_picture and camera.pose_at(0.5)[0] == (1.0, 0.0, 0.0, 1.0)
    keys[1]["camera_to_world"] = [[1.0]]
    with pytest.raises(InvalidCameraError, match="camera_to_world at 1 frames.*4 rows of 4"):
        read_camera(write_json(tmp_path / "bad.json", keys=keys))


def test_the_pose_of_an_exr_is_the_inverse_of_world_to_camera_in_its_own_unit():
    stored = np.linalg.inv(np.array(ASIDE)).T.astype(np.float32)
    assert attribute_values({"worldToCamera": stored}, 0.01)["camera_to_world"][0] == pytest.approx((1, 0, 0, 0.02))
    # A space that is mirrored against the world's is looked into along z.
    mirrored = np.linalg.inv(np.array(ASIDE) @ np.diag([1.0, 1.0, -1.0, 1.0])).T
    assert np.array(attribute_values({"worldToCamera": mirrored})["camera_to_world"]) == pytest.approx(np.array(ASIDE))
    assert attribute_values({"worldToCamera": np.zeros((4, 4))}) == {}


def test_a_camera_goes_through_those_of_the_frames_around(tmp_path):
    for number, x in ((1, 0.0), (2, 2.0)):
        place = np.array(ASIDE)
        place[0, 3] = x
        write_json(tmp_path / f"camera.{number}.json", camera_to_world=place.tolist())
    write_json(tmp_path / "camera.3.json")
    around = [(-1.0, str(tmp_path / "camera.1.json")), (1.0, str(tmp_path / "camera.3.json"))]
    camera = moved_along(read_camera(tmp_path / "camera.2.json"), around)
    assert [(key.time, key.camera_to_world[0][3]) for key in camera.keys] == [(0.0, 2.0), (-1.0, 0.0)]
    assert moved_along(lens(), around) == lens()


# --- Names of options ----------------------------------------------------------------------------------------------


def test_messages_spell_options_as_they_are_typed():
    assert option("f_number") == "f_number"
    with options_spelled(lambda name: "--" + name.replace("_", "-")):
        assert option("f_number") == "--f-number"
    assert option("f_number") == "f_number"


def test_the_shutter_curve_of_a_json_camera(tmp_path):
    path = write_json(tmp_path / "camera.json", shutter_curve="trapezoid:0.5,0.5")
    assert read_camera(path).shutter_curve[32] == 1.0
    assert read_camera(path, shutter_curve=(0, 1)).shutter_curve == (0.0, 1.0)
    with pytest.raises(InvalidCameraError, match=r"camera\.json: shutter_curve is \[1.0\]"):
        read_camera(write_json(path, shutter_curve=[1]))


def test_keys_of_a_json_camera_change_the_lens_over_time(tmp_path):
    keys = [{"time": -0.5, "focus_distance_m": 2.0}, {"time": 0.5, "focus_distance_m": 4.0}]
    camera = read_camera(write_json(tmp_path / "pull.json", keys=keys, readout_frames=0.25))
    assert camera.at(0.25).focus_distance_m == pytest.approx(3.5) and camera.readout_frames == 0.25
    assert camera.at(9.0).focus_distance_m == 4.0 and camera.at(0.0).f_number == camera.f_number


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({}, "must be a list of objects with time"),
        ([{"focus_distance_m": 2.0}], "must be a list of objects with time"),
        ([{"time": 0.0, "focus": 2.0}], "a key has focus; allowed are time, focal_length_mm"),
        ([{"time": 0.0, "f_number": "2"}], "f_number of a key is '2'; it must be a number"),
        ([{"time": 0.0, "f_number": 0.0}], "the key at 0 frames: f_number is 0"),
    ],
)
def test_bad_keys_of_a_json_camera_are_refused(tmp_path, keys, said):
    with pytest.raises(InvalidCameraError, match=said):
        read_camera(write_json(tmp_path / "bad.json", keys=keys))
