"""Written images: what the extension says, with the windows and attributes of the frame."""

import zlib

import numpy as np
import OpenEXR
import pytest

from spreadlets.errors import InvalidParameterError
from spreadlets.files import exr_frames as exr
from spreadlets.files import images
from spreadlets.files.exr_chunks import read_attributes
from spreadlets.files.pictures import read_picture
from spreadlets.files.png_tiff import in_steps
from spreadlets.scene.display import display_encode
from spreadlets.scene.raster import Attribute, Raster, Window

SHAPE = (5, 7)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "image.exr"


@pytest.mark.parametrize("channels", [3, 4])
def test_an_image_comes_back_as_it_was_written(path, channels):
    image = np.random.default_rng(0).normal(size=(*SHAPE, channels)).astype(np.float32)
    images.write_image(path, image)
    np.testing.assert_array_equal(exr.read_image(path), image)


def test_half_images_are_rounded_and_clipped(path):
    image = np.full((*SHAPE, 3), 1.0001, np.float32)
    image[0, 0] = 1e6
    images.write_image(path, image, bit_depth=16)
    found = exr.read_image(path)
    assert (found[0, 0] == 65504).all() and (found[1, 1] == 1).all()
    assert OpenEXR.File(str(path), separate_channels=True).channels()["R"].pixels.dtype == np.float16


def test_metadata_goes_into_the_header(path):
    images.write_image(path, np.ones((*SHAPE, 3)), metadata={"method": "dense", "layers": 4, "seconds": 0.5})
    header = OpenEXR.File(str(path), header_only=True).header()
    assert (header["method"], header["layers"], header["seconds"]) == ("dense", 4, 0.5)


@pytest.mark.parametrize("metadata", [{"channels": "x"}, {"a": None}, {"a": True}, {"a": [1]}])
def test_unusable_metadata_is_refused(path, metadata):
    with pytest.raises(InvalidParameterError, match="metadata"):
        images.write_image(path, np.ones((*SHAPE, 3)), metadata=metadata)
    assert not path.exists()


def test_png_holds_the_display_encoding(tmp_path):
    from skimage.io import imread

    image = np.random.default_rng(0).random((*SHAPE, 4)) * 1.5 - 0.2
    image[0, 0] = np.nan
    images.write_png(tmp_path / "image.png", image)
    found = imread(tmp_path / "image.png")
    assert found.dtype == np.uint8 and found.shape == (*SHAPE, 3)
    assert not found[0, 0].any()
    assert np.abs(found[1:] / 255 - display_encode(image[1:, :, :3])).max() < 1 / 255


SIGNATURES = {
    ".exr": b"v/1\x01",
    ".png": b"\x89PNG",
    ".jpg": b"\xff\xd8\xff",
    ".JPEG": b"\xff\xd8\xff",
    ".tif": b"II*\0",
    ".tiff": b"II*\0",
}


@pytest.mark.parametrize("extension", SIGNATURES)
def test_a_file_is_what_its_extension_says(tmp_path, extension):
    images.write_image(tmp_path / f"out{extension}", np.full((*SHAPE, 3), 0.2))
    assert (tmp_path / f"out{extension}").read_bytes().startswith(SIGNATURES[extension])


@pytest.mark.parametrize("name", ["out", "out.json", "out.exr.bak", "out.hdr"])
def test_an_extension_of_no_format_is_refused(tmp_path, name):
    with pytest.raises(InvalidParameterError, match=r"ends with \.exr, \.png"):
        images.write_image(tmp_path / name, np.ones((*SHAPE, 3)))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("extension", [".png", ".jpg", ".tif"])
def test_pictures_show_the_display_window_dithered(tmp_path, extension):
    from skimage.io import imread

    value = 0.2
    image = np.full((64, 80, 3), value, np.float32)
    image[:, :16] = 1.0
    raster = Raster(Window(-16, 0, 80, 64), Window(0, 0, 64, 64))
    images.write_image(tmp_path / f"out{extension}", image, raster=raster)
    found = imread(tmp_path / f"out{extension}").astype(float)
    assert found.shape == (64, 64, 3)
    exact = 255 * float(display_encode(value))
    assert len(np.unique(found)) > 1 and found.mean() == pytest.approx(exact, abs=0.05) and abs(exact % 1 - 0.5) < 0.4


@pytest.mark.parametrize("bits", [8, 16])
def test_whole_steps_stay_what_they_are(bits):
    most = 2**bits - 1
    steps = np.tile(np.arange(most + 1) / most, (4, 1)).astype(np.float32)
    np.testing.assert_array_equal(in_steps(steps, bits), np.tile(np.arange(most + 1), (4, 1)))


@pytest.mark.parametrize(("extension", "bits"), [(".png", 8), (".tif", 8), (".tif", 16), (".tiff", 16)])
def test_pictures_of_8_and_16_bits_are_read_by_others(tmp_path, extension, bits):
    from skimage.io import imread

    image = np.random.default_rng(0).random((33, 47, 3)).astype(np.float32)
    images.write_image(tmp_path / f"out{extension}", image, bit_depth=bits)
    found = imread(tmp_path / f"out{extension}")
    assert found.dtype == f"uint{bits}" and found.shape == image.shape
    assert np.abs(found / (2**bits - 1) - display_encode(image)).max() < 1 / (2**bits - 1)


def test_a_png_of_16_bits_is_one_to_others_and_holds_all_bits(tmp_path):
    from skimage.io import imread

    image = np.random.default_rng(0).random((33, 47, 3)).astype(np.float32)
    images.write_image(tmp_path / "out.png", image, bit_depth=16)
    content = (tmp_path / "out.png").read_bytes()
    at = content.index(b"IDAT")
    rows = np.frombuffer(zlib.decompressobj().decompress(content[at + 4 :]), np.uint8).reshape(33, 1 + 47 * 6)
    found = np.cumsum(rows[:, 1:].reshape(33, 47, 6), axis=1, dtype=np.uint8).view(">u2").reshape(image.shape)
    assert np.abs(found / 65535 - display_encode(image)).max() < 1 / 65535
    shown = imread(tmp_path / "out.png")  # Pillow takes the upper bytes
    np.testing.assert_array_equal(shown, found >> 8)


def test_a_bit_depth_that_a_format_has_not_is_refused(tmp_path):
    for name, bits, allowed in (("a.jpg", 16, "8"), ("a.png", 32, "8 or 16"), ("a.exr", 8, "16 or 32")):
        with pytest.raises(InvalidParameterError, match=f"bit_depth is {bits}; this format has {allowed}"):
            images.write_image(tmp_path / name, np.ones((*SHAPE, 3)), bit_depth=bits)
    assert not list(tmp_path.iterdir())


def test_windows_aspect_and_attributes_of_a_frame_come_back(path, tmp_path):
    box = (np.array([-3, 2], np.int32), np.array([3, 6], np.int32))
    display = (np.array([0, 0], np.int32), np.array([9, 5], np.int32))
    header = {
        "dataWindow": box,
        "displayWindow": display,
        "pixelAspectRatio": 1.5,
        "chromaticities": (0.713, 0.293, 0.165, 0.83, 0.128, 0.044, 0.32168, 0.33767),
        "comments": "shot 010",
        "nuke/frame_rate": 24.0,
        "a/name/of/more/than/thirty-one/characters": "long",
        "worldToCamera": np.arange(16, dtype=np.float32).reshape(4, 4),
        "screenWindowCenter": np.array([0.25, -0.5], np.float32),
    }
    channels = {name: np.full(SHAPE, 2, np.float32) for name in "RGBZ"}
    OpenEXR.File({"type": OpenEXR.scanlineimage, **header}, channels).write(str(path))
    frame = exr.read_frame(path)
    images.write_image(tmp_path / "out.exr", frame.radiance, raster=frame.raster)
    with open(path, "rb") as given, open(tmp_path / "out.exr", "rb") as written:
        (before,), (after,) = read_attributes(given), read_attributes(written)
    own = {"channels", "compression", "type", "chunkCount"}
    assert {name: each for name, each in after.items() if name not in own} == {
        name: each for name, each in before.items() if name not in own
    }
    found = OpenEXR.File(str(tmp_path / "out.exr"), separate_channels=True)
    assert (tmp_path / "out.exr").read_bytes()[5] & 4, "the bit of long names"
    assert found.header()["comments"] == "shot 010" and (found.channels()["R"].pixels == 2).all()


def test_an_element_is_written_as_far_as_its_blur_reaches(path):
    raster = Raster(Window(-2, 0, 14, 8), Window(0, 0, 12, 8), stored=Window(-2, 1, 7, 5))
    image = np.zeros((8, 14, 4), np.float32)
    image[1:6, :7] = 1
    images.write_image(path, image, raster=raster)
    assert [each.tolist() for each in OpenEXR.File(str(path)).header()["dataWindow"]] == [[-2, 1], [4, 5]]
    image[3, 9] = 0.5
    images.write_image(path, image, raster=raster)
    assert [each.tolist() for each in OpenEXR.File(str(path)).header()["dataWindow"]] == [[-2, 1], [7, 5]]


def test_further_channels_keep_their_type_and_values(path):
    ids = np.arange(35, dtype=np.uint32).reshape(SHAPE) + 2**31
    halves = np.full(SHAPE, 0.1, np.float16)
    images.write_image(path, np.ones((*SHAPE, 4)), channels={"id": ids, "mask.A": halves})
    found = OpenEXR.File(str(path), separate_channels=True).channels()
    assert sorted(found) == ["A", "B", "G", "R", "id", "mask.A"]
    np.testing.assert_array_equal(found["id"].pixels, ids)
    assert found["mask.A"].pixels.dtype == np.float16 and (found["mask.A"].pixels == halves).all()


@pytest.mark.parametrize("settings", [{"half": True}, {"metadata": {"a": 1}}, {"channels": {"Z": np.ones(SHAPE)}}])
def test_what_a_picture_cannot_hold_is_refused(tmp_path, settings):
    with pytest.raises(InvalidParameterError, match=f"{next(iter(settings))} is for OpenEXR"):
        images.write_image(tmp_path / "out.png", np.ones((*SHAPE, 3)), **settings)


def test_pictures_are_in_the_primaries_of_a_display(tmp_path):
    from skimage.io import imread

    xyz = np.array([1, 0, 0, 1, 0, 0, 1 / 3, 1 / 3], "<f4")
    window = Window(0, 0, 7, 5)
    raster = Raster(window, window, attributes={"chromaticities": Attribute("chromaticities", xyz.tobytes())})
    red = np.broadcast_to(np.float32([0.4124, 0.2126, 0.0193]) / (0.9505, 1, 1.089), (*SHAPE, 3))
    images.write_image(tmp_path / "out.png", red, raster=raster)
    found = imread(tmp_path / "out.png").reshape(-1, 3).mean(axis=0)
    assert found[0] > 240 and found[1:].max() < 40


def test_a_picture_of_integers_is_stored_as_it_is(tmp_path):
    codes = np.random.default_rng(0).integers(0, 256, (9, 12, 3), np.uint8)
    images.write_image(tmp_path / "picture.png", codes)
    shown = display_encode(read_picture(tmp_path / "picture.png").radiance) * 255
    assert np.abs(shown - codes).max() < 0.01
