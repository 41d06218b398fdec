import struct

import numpy as np
import OpenEXR
import pytest

from spreadlets.errors import InvalidFileError, InvalidFrameError, InvalidParameterError
from spreadlets.files import exr_chunks, exr_file, images
from spreadlets.files import exr_frames as exr
from spreadlets.files.exr_chunks import check_chunks, check_structure
from spreadlets.scene.frame import Frame
from spreadlets.scene.raster import Raster, Window

SHAPE = (5, 7)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "image.exr"


def planes(*names, value=None):
    rng = np.random.default_rng(len(names))
    return {
        name: (rng.random(SHAPE) + 0.5 if value is None else np.full(SHAPE, value)).astype(np.float32) for name in names
    }


def write(path, channels, **header):
    # The binding replaces a dictionary's arrays by its own channel objects, hence the copy.
    OpenEXR.File({"type": OpenEXR.scanlineimage, **header}, dict(channels)).write(str(path))
    return path


def write_parts(path, parts, headers=None):
    headers = headers or {}
    OpenEXR.File(
        [
            OpenEXR.Part({"type": OpenEXR.scanlineimage, "name": name, **headers.get(name, {})}, channels)
            for name, channels in parts.items()
        ]
    ).write(str(path))
    return path


def box(left, top, right, bottom):
    return (np.array([left, top], np.int32), np.array([right, bottom], np.int32))


def random_frame(seed=0, *, curved=False):
    rng = np.random.default_rng(seed)
    radiance = rng.random((*SHAPE, 4))
    radiance[0, 0] = 0
    motions = [rng.normal(size=(*SHAPE, 2)) for _ in range(3)]
    depth = 1 + rng.random(SHAPE)
    depth[1, 1] = np.inf
    if curved:
        return Frame(radiance, depth, motions[0], motion_prev=motions[1], motion_next=motions[2])
    return Frame(radiance, depth, motions[0])


def assert_same_layers(found, expected):
    assert len(found.layers) == len(expected.layers)
    for a, b in zip(found.layers, expected.layers, strict=True):
        for name in ("radiance", "depth", "motion", "motion_prev", "motion_next"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)
        assert a.has_motion == b.has_motion


def uncompressed_file(channels, width, height, *, data_window=None):
    """Return the bytes of a float EXR of zeros; channels maps names to subsampling, which the binding cannot write."""

    def attribute(name, kind, value):
        return name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<i", len(value)) + value

    rows = [
        struct.pack("<iB3xii", 2, 0, sampling, sampling).join([name.encode() + b"\0", b""])
        for name, sampling in sorted(channels.items())
    ]
    window = struct.pack("<4i", *(data_window or (0, 0, width - 1, height - 1)))
    header = b"\x76\x2f\x31\x01\x02\0\0\0" + attribute("channels", "chlist", b"".join(rows) + b"\0")
    header += attribute("compression", "compression", b"\0")
    header += attribute("dataWindow", "box2i", window) + attribute("displayWindow", "box2i", window)
    header += attribute("lineOrder", "lineOrder", b"\0") + attribute("pixelAspectRatio", "float", struct.pack("<f", 1))
    header += attribute("screenWindowCenter", "v2f", bytes(8))
    header += attribute("screenWindowWidth", "float", struct.pack("<f", 1)) + b"\0"
    sizes = [sum(4 * (width // s) for s in channels.values() if y % s == 0) for y in range(height)]
    lines = [struct.pack("<ii", y, size) + bytes(size) for y, size in enumerate(sizes)]
    starts = np.cumsum([len(header) + 8 * height, *(len(line) for line in lines[:-1])])
    return header + b"".join(struct.pack("<Q", start) for start in starts) + b"".join(lines)


# --- Round trips ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "frame",
    [
        random_frame(),
        random_frame(curved=True),
        Frame(np.ones((*SHAPE, 3)), np.ones(SHAPE)),
        Frame.from_layers([random_frame(1), random_frame(2, curved=True), random_frame(3)]),
    ],
    ids=["straight", "curved", "still", "layers"],
)
@pytest.mark.filterwarnings("ignore:layer . lies behind")
def test_a_frame_comes_back_as_it_was_written(path, frame):
    exr.write_frame(path, frame)
    assert_same_layers(exr.read_frame(path), frame)


# --- Conventions ---------------------------------------------------------------------------------------------------


def test_blender_vectors_become_forward_motion_with_y_down(path):
    # A point at (100, 50) px, y up, that was at (97, 52) and will be at (105, 46): XY = prev - cur, ZW = cur - next.
    vector = {"X": -3, "Y": 2, "Z": -5, "W": 4}
    channels = planes("R", "G", "B", "Z")
    channels |= {f"Vector.{axis}": np.full(SHAPE, value, np.float32) for axis, value in vector.items()}
    layer = exr.read_frame(write(path, channels)).layers[0]
    assert tuple(layer.motion_prev[2, 3]) == (3, 2)  # right, and down where y is down
    assert tuple(layer.motion_next[2, 3]) == (5, 4)
    assert tuple(layer.motion[2, 3]) == (4, 3)  # ((-Z - X) / 2, (W + Y) / 2)
    np.testing.assert_array_equal(layer.depth, channels["Z"])
    np.testing.assert_array_equal(layer.radiance[..., 0], channels["R"])


@pytest.mark.parametrize(
    ("names", "expected"), [(("motion.x", "motion.y"), (2, 3)), (("forward.u", "forward.v"), (2, -3))]
)
def test_forward_motion_is_recognised(path, names, expected):
    channels = planes("R", "G", "B", "Z") | planes(names[0], value=2) | planes(names[1], value=3)
    layer = exr.read_frame(write(path, channels)).layers[0]
    assert tuple(layer.motion[0, 0]) == expected
    assert layer.motion_prev is None and layer.has_motion


def test_without_motion_channels_the_frame_is_still(path):
    assert not exr.read_frame(write(path, planes("R", "G", "B", "Z"))).layers[0].has_motion


@pytest.mark.parametrize("name", ["Z", "depth.Z", "Depth.V", "depth.R", "zdepth.Y", "Pz", "VRayZDepth"])
@pytest.mark.filterwarnings("ignore:.*depth whose program")
def test_depth_channels_are_recognised(path, name):
    channels = planes("R", "G", "B", name, "Normal.Z", "Position.Z", "Mist.Z")
    np.testing.assert_array_equal(exr.read_frame(write(path, channels)).depth, channels[name])


BLENDER_PASSES = {
    "ViewLayer.Combined": "RGBA",
    "ViewLayer.Depth": "Z",
    "ViewLayer.Vector": "XYZW",
    "ViewLayer.Normal": "XYZ",
    "ViewLayer.DiffCol": "RGB",
}


@pytest.mark.parametrize("prefixed", [True, False])
def test_multi_part_files_with_a_part_per_pass(path, prefixed):
    parts = {
        name: planes(*(f"{name}.{c}" if prefixed else c for c in axes), value=0.25 + i)
        for i, (name, axes) in enumerate(BLENDER_PASSES.items())
    }
    layer = exr.read_frame(write_parts(path, parts)).layers[0]
    assert (layer.radiance == 0.25).all() and (layer.depth == 1.25).all()
    assert (layer.motion == (-2.25, 2.25)).all()
    assert exr.read_image(path).shape == (*SHAPE, 4)


def test_single_part_files_with_layer_prefixes(path):
    channels = {}
    for i, (name, axes) in enumerate(BLENDER_PASSES.items()):
        channels |= planes(*(f"{name}.{c}" for c in axes), value=0.25 + i)
    frame = exr.read_frame(write(path, channels))
    assert (frame.radiance == 0.25).all() and (frame.depth == 1.25).all()


@pytest.mark.filterwarnings("ignore:layer . lies behind")
def test_several_files_are_layers_nearest_first(tmp_path):
    frames = [random_frame(seed) for seed in (1, 2)]
    paths = [tmp_path / f"layer{i}.exr" for i in (0, 1)]
    for path, frame in zip(paths, frames, strict=True):
        exr.write_frame(path, frame)
    assert_same_layers(exr.read_frame(paths), Frame.from_layers(frames))


def test_labels_of_empty_layer_pixels_are_ignored(path):
    channels = planes("R", "G", "B", "A", "Z", value=0)
    assert np.isinf(exr.read_frame(write(path, channels)).depth).all()


# --- Options -------------------------------------------------------------------------------------------------------


def test_explicit_channels_settle_an_ambiguous_file(path):
    channels = planes("left.R", "left.G", "left.B", "right.R", "right.G", "right.B", "Z", "depth.Z")
    channels |= planes("motion.x", "motion.y", "b.u", "b.v", value=3)
    frame = exr.read_frame(
        write(path, channels),
        colour_layer="right",
        depth_channel="depth.Z",
        motion_channels=("b.u", "b.v"),
        motion_convention="backward-px",
    )
    np.testing.assert_array_equal(frame.radiance[..., 0], channels["right.R"])
    np.testing.assert_array_equal(frame.depth, channels["depth.Z"])
    assert (frame.motion == -3).all()
    np.testing.assert_array_equal(exr.read_image(path, colour_layer="left")[..., 1], channels["left.G"])


def test_motion_channels_with_known_names_need_no_convention(path):
    channels = planes("R", "G", "B", "Z", "a.forward.u", "a.forward.v", "b.forward.u", "b.forward.v")
    frame = exr.read_frame(write(path, channels), motion_channels=("b.forward.u", "b.forward.v"))
    np.testing.assert_array_equal(frame.motion[..., 1], -channels["b.forward.v"])


def test_motion_convention_chooses_between_sets(path):
    channels = planes("R", "G", "B", "Z") | planes("motion.x", "motion.y", value=1)
    channels |= planes("forward.u", "forward.v", value=2)
    with pytest.raises(InvalidFileError, match="motion_convention"):
        exr.read_frame(write(path, channels))
    assert (exr.read_frame(path, motion_convention="nuke-forward").motion == (2, -2)).all()


def test_inverse_depth(path):
    channels = planes("R", "G", "B") | planes("Z", value=0.25)
    channels["Z"][0, 0] = 0
    depth = exr.read_frame(write(path, channels), depth_convention="inverse").depth
    assert depth[1, 1] == 4 and np.isinf(depth[0, 0])


def test_repair_mends_bad_pixels(path):
    channels = planes("R", "G", "B", "Z")
    channels["Z"][2, 3] = -1
    with pytest.raises(InvalidFrameError, match=r"image\.exr: depth .*\(row 2, col 3\)"):
        exr.read_frame(write(path, channels))
    assert exr.read_frame(path, repair=True).repaired_pixels == 1


@pytest.mark.parametrize(
    ("names", "options", "settled_by"),
    [
        ("a.R a.G a.B b.R b.G b.B Z", {}, "colour_layer"),
        ("R G B Z", {"colour_layer": "rgba"}, "colour_layer"),
        ("R G B", {}, "depth_channel"),
        ("R G B Z depth.Z", {}, "depth_channel"),
        ("R G B Normal.Z", {}, "depth_channel"),
        ("R G B Z", {"depth_channel": "Depth.Z"}, "depth_channel"),
        ("R G B Z a.motion.x a.motion.y b.motion.x b.motion.y", {}, "motion_channels"),
        ("R G B Z", {"motion_channels": ("motion.x", "motion.y")}, "motion_channels"),
        ("R G B Z", {"motion_convention": "blender"}, "motion_channels"),
        ("R G B Z u v", {"motion_channels": ("u", "v")}, "motion_convention"),
    ],
)
def test_missing_and_ambiguous_channels_list_what_is_there_and_name_the_option(path, names, options, settled_by):
    names = names.split()
    with pytest.raises(InvalidFileError) as error:
        exr.read_frame(write(path, planes(*names)), **options)
    message = str(error.value)
    assert str(path) in message and f"name it with {settled_by}" in message
    assert message.endswith("Channels found: " + ", ".join(sorted(names)))


@pytest.mark.parametrize("names", ["Z", "R G Z", "A Z"])
def test_a_file_without_a_picture_says_what_a_picture_is_and_what_single_passes_are_for(path, names):
    with pytest.raises(InvalidFileError, match=r"no layer has R, G and B .* single pass goes to depth_file") as error:
        exr.read_frame(write(path, planes(*names.split())))
    assert str(error.value).endswith("Channels found: " + ", ".join(sorted(names.split())))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"depth_convention": "metres"}, "depth_convention is 'metres'; allowed are planar, ray, inverse"),
        ({"motion_convention": "up"}, "motion_convention is 'up'; allowed are blender, curved-px"),
        ({"motion_convention": "blender", "motion_channels": ("R", "G")}, "names 2 channels; .* blender takes 4"),
    ],
)
def test_unknown_conventions_are_refused_with_the_allowed_ones(path, options, message):
    with pytest.raises(InvalidParameterError, match=message):
        exr.read_frame(write(path, planes("R", "G", "B", "Z")), **options)


def test_stereo_parts_are_not_layers(path):
    parts = {view: planes("R", "G", "B", "A", "Z", value=0.5) for view in ("left", "right")}
    write_parts(path, parts, {view: {"view": view} for view in parts})
    for options in ({}, {"view": "left"}, {"colour_layer": "right"}):
        frame = exr.read_frame(path, **options)
        assert len(frame.layers) == 1


# --- Windows -------------------------------------------------------------------------------------------------------


def test_a_frame_is_read_in_its_data_window(path):
    channels = planes("R", "G", "B", "Z")
    write(path, channels, dataWindow=box(2, 1, 8, 5), displayWindow=box(0, 0, 5, 7), pixelAspectRatio=2.0)
    frame = exr.read_frame(path)
    assert frame.shape == SHAPE and frame.raster.stored is None
    assert frame.raster.data == (2, 1, 7, 5) and frame.raster.display == (0, 0, 6, 8)
    assert frame.raster.pixel_aspect == 2
    np.testing.assert_array_equal(frame.depth, channels["Z"])


@pytest.mark.parametrize("n_layers", [1, 2])
@pytest.mark.filterwarnings("ignore:layer 0 is opaque")
def test_a_frame_that_was_read_keeps_its_windows_aspect_and_attributes_when_it_is_written(path, n_layers):
    raster = Raster(Window(-3, 2, 6, 4), Window(0, 0, 5, 8), pixel_aspect=2.0)
    frame = Frame(np.ones((4, 6, 3)), depth=np.full((4, 6), 2.0), raster=raster)
    images.write_image(
        path, np.ones((4, 6, 3)), raster=raster, metadata={"comments": "take 3"}, channels={"Z": frame.depth}
    )
    given = exr.read_frame(path, preset="arnold", motion_channels=())
    exr.write_frame(path, Frame.from_layers([given] * n_layers))
    found = exr.read_frame(path)
    assert (found.raster.data, found.raster.display) == (raster.data, raster.display)
    assert found.raster.pixel_aspect == 2.0 and found.raster.attributes == given.raster.attributes
    assert "comments" in found.raster.attributes


def test_an_element_that_is_not_opaque_reaches_as_far_as_the_display_window(path):
    channels = planes("R", "G", "B", "Z") | planes("A", value=0.5)
    write(path, channels, dataWindow=box(-2, 1, 4, 5), displayWindow=box(0, 0, 11, 7))
    frame = exr.read_frame(path)
    assert frame.raster.data == (-2, 0, 14, 8) and frame.raster.stored == (-2, 1, 7, 5)
    filled = np.zeros((8, 14), bool)
    filled[1:6, :7] = True
    np.testing.assert_array_equal(frame.radiance[..., 3], 0.5 * filled)
    np.testing.assert_array_equal(frame.depth[1:6, :7], channels["Z"])
    assert np.isinf(frame.depth[~filled]).all()


def test_an_image_is_read_in_its_display_window(path):
    channels = planes("R", "G", "B")
    write(path, channels, dataWindow=box(-2, -1, 4, 3), displayWindow=box(0, 0, 2, 2))
    image = exr.read_image(path)
    assert image.shape[:2] == (3, 3)
    np.testing.assert_array_equal(image[..., 0], channels["R"][1:4, 2:5])


def test_parts_with_different_data_windows_are_placed(path):
    parts = {"rgba": planes("R", "G", "B"), "depth": {"Z": np.full((2, 2), 3, np.float32)}}
    display = {"displayWindow": box(0, 0, 6, 4)}
    write_parts(path, parts, {"rgba": display, "depth": {**display, "dataWindow": box(1, 2, 2, 3)}})
    frame = exr.read_frame(path)
    assert frame.shape == SHAPE and (frame.depth[2:4, 1:3] == 3).all() and np.isinf(frame.depth).sum() == 31


def test_subsampled_channels_are_refused(path):
    path.write_bytes(uncompressed_file({"R": 1, "G": 1, "B": 1, "Z": 2}, 6, 4))
    with pytest.raises(InvalidFileError, match="channel Z is subsampled"):
        exr.read_frame(path)
    assert exr.read_image(path).shape == (4, 6, 3)


# --- Broken files --------------------------------------------------------------------------------------------------


def test_missing_files_and_folders_are_refused(tmp_path):
    for path in (tmp_path / "absent.exr", tmp_path, tmp_path / ("x" * 300)):
        with pytest.raises(InvalidFileError, match="no such file|not a regular file"):
            exr.read_frame(path)


@pytest.mark.parametrize("share", [0, 0.001, 0.05, 0.1, 0.5, 0.99])
def test_truncated_files_are_refused_in_one_line_and_silently(path, share, capfd):
    image = np.random.default_rng(0).random((64, 64, 3))
    images.write_image(path, image)
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    with pytest.raises(InvalidFileError) as error:
        exr.read_image(path)
    assert str(path) in str(error.value) and "\n" not in str(error.value)
    assert capfd.readouterr() == ("", "")


def test_corrupt_pixels_are_refused(path):
    images.write_image(path, np.random.default_rng(0).random((64, 64, 3)))
    content = bytearray(path.read_bytes())
    content[len(content) // 2 : len(content) // 2 + 200] = bytes(200)
    path.write_bytes(content)
    with pytest.raises(InvalidFileError, match="truncated or corrupt"):
        exr.read_image(path)


def test_other_files_are_refused(path):
    path.write_bytes(b"\x89PNG\r\n\x1a\n" * 40)
    with pytest.raises(InvalidFileError, match="is a PNG; frames and images are read from OpenEXR"):
        exr.read_frame(path)


def test_a_file_beyond_the_limit_is_refused_before_its_pixels_are_read(path, monkeypatch):
    write(path, planes("R", "G", "B"))
    monkeypatch.setattr(exr_file, "MAX_VALUES", 3 * SHAPE[0] * SHAPE[1] - 1)
    with pytest.raises(InvalidFileError, match="holds 105 values .* at most 104"):
        exr.read_image(path)


def test_a_small_file_that_promises_a_huge_image_is_refused(path):
    path.write_bytes(uncompressed_file({"R": 1}, 6, 4, data_window=(0, 0, 2**20, 2**20)))
    with pytest.raises(InvalidFileError):
        exr.read_image(path)


def test_a_file_too_short_for_what_it_promises_is_refused(tmp_path):
    images.write_image(tmp_path / "a.exr", np.zeros((64, 64, 3), np.float32))
    content = bytearray((tmp_path / "a.exr").read_bytes())
    for name in (b"dataWindow\0box2i\0", b"displayWindow\0box2i\0"):
        at = content.index(name) + len(name) + 4
        content[at : at + 16] = np.array([0, 0, 9_999, 9_999], "<i4").tobytes()
    (tmp_path / "a.exr").write_bytes(content)
    with pytest.raises(InvalidFileError, match="too short for the 300000000 values"):
        exr.read_image(tmp_path / "a.exr")


def test_a_malformed_header_is_refused_where_the_library_would_guess(tmp_path):
    images.write_image(tmp_path / "a.exr", np.zeros((8, 8, 3), np.float32), metadata={"note": "abc"})
    content = (tmp_path / "a.exr").read_bytes()
    at = content.index(b"note\0string\0") + len(b"note\0string\0")
    (tmp_path / "a.exr").write_bytes(content[:at] + b"\xff\xff\xff\x7f" + content[at + 4 :])
    with pytest.raises(InvalidFileError):
        exr.read_image(tmp_path / "a.exr")
    with pytest.raises(InvalidFileError, match="its header is malformed"):
        with open(tmp_path / "a.exr", "rb") as file:
            check_structure(file)


def test_a_table_that_does_not_point_to_its_chunks_is_refused_where_the_library_would_search(tmp_path):
    images.write_image(tmp_path / "a.exr", np.random.default_rng(0).random((40, 8, 3)).astype(np.float32))
    content = (tmp_path / "a.exr").read_bytes()
    at = content.index(b"type\0string\0")
    inserted = content[:at] + b"note\0string\0\3\0\0\0abc" + content[at:]
    (tmp_path / "a.exr").write_bytes(inserted)
    assert OpenEXR.File(str(tmp_path / "a.exr")).parts[0].channels  # the library finds chunks of its own
    with pytest.raises(InvalidFileError, match="the lines from 0 on are not where the table says"):
        exr.read_image(tmp_path / "a.exr")


@pytest.mark.parametrize("compression", "NO RLE ZIPS ZIP PIZ PXR24 B44 B44A DWAA DWAB".split())
def test_chunks_of_every_compression_are_found(tmp_path, compression):
    pixels = np.random.default_rng(0).random((300, 5)).astype(np.float32)
    header = {"compression": getattr(OpenEXR, f"{compression}_COMPRESSION"), "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"Y": pixels}).write(str(tmp_path / "a.exr"))
    with open(tmp_path / "a.exr", "rb") as file:
        check_chunks(file)


def test_channels_out_of_order_are_refused(tmp_path):
    images.write_image(tmp_path / "a.exr", np.ones((8, 8, 3), np.float32))
    content = (tmp_path / "a.exr").read_bytes()
    assert content.count(b"B\0\2\0\0\0") == 1
    (tmp_path / "a.exr").write_bytes(content.replace(b"B\0\2\0\0\0", b"H\0\2\0\0\0"))
    with pytest.raises(InvalidFileError, match="its channels are not in alphabetical order"):
        exr.read_image(tmp_path / "a.exr")


def test_tiles_are_read_and_refused_where_the_table_does_not_point_to_them(tmp_path):
    path = tmp_path / "a.exr"
    pixels = np.random.default_rng(0).random((40, 50)).astype(np.float32)
    tiles = OpenEXR.TileDescription()
    tiles.xSize, tiles.ySize = 16, 8
    OpenEXR.File({"type": OpenEXR.tiledimage, "tiles": tiles}, {name: pixels.copy() for name in "RGB"}).write(str(path))
    np.testing.assert_array_equal(exr.read_image(path)[..., 0], pixels)
    content = path.read_bytes()
    with open(path, "rb") as file:
        _, _, ((first, second, *_),) = exr_chunks._tables(file)
    pair = np.array([first, second], "<u8")
    assert content.count(pair.tobytes()) == 1
    path.write_bytes(content.replace(pair.tobytes(), pair[::-1].tobytes()))
    with pytest.raises(InvalidFileError, match=r"the tile \(0, 0, 0, 0\) is not where the table says"):
        exr.read_image(path)
