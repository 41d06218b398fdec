"""Photographs and planes from files."""

import struct

import numpy as np
import pytest
from PIL import Image, ImageCms

import spreadlets as sp
from spreadlets.errors import InvalidFileError
from spreadlets.files.pictures import read_picture, read_plane
from spreadlets.scene.display import display_decode, display_encode

CODES = np.random.default_rng(1).integers(0, 256, (6, 9, 3), np.uint8)


@pytest.mark.parametrize(("name", "tolerance"), [("a.png", 0), ("a.tif", 0), ("a.webp", 0), ("a.jpg", 4)])
def test_pictures_are_read_as_linear_light(tmp_path, name, tolerance):
    Image.fromarray(CODES).save(tmp_path / name, lossless=True, quality=100, subsampling=0)
    radiance = read_picture(tmp_path / name).radiance
    assert np.abs(np.rint(255 * display_encode(radiance)) - CODES).max() <= tolerance


def test_the_display_s_encoding_is_undone_exactly():
    values = np.linspace(0, 1, 1001)
    np.testing.assert_allclose(display_decode(display_encode(values)), values, atol=1e-6)


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_codes_are_parts_of_the_largest(kind):
    most = np.iinfo(kind).max
    codes = np.array([[0, 1, most // 3], [most // 2, most - 1, most]], kind)
    np.testing.assert_allclose(display_decode(codes), display_decode(codes / np.float32(most)), atol=1e-7)
    assert display_decode(codes)[1, 2] == 1.0


def test_exif_turns_the_picture_and_tells_the_lens(tmp_path):
    image, exif = Image.fromarray(CODES), Image.Exif()
    exif[0x0112] = 6
    exif.get_ifd(0x8769).update({0xA405: 28, 0x829D: 1.8})
    image.save(tmp_path / "a.png", exif=exif)
    picture = read_picture(tmp_path / "a.png")
    assert picture.radiance.shape == (9, 6, 3)
    assert (picture.focal_length_35mm, picture.f_number) == (28.0, pytest.approx(1.8))


def test_a_colour_profile_is_followed(tmp_path):
    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("LAB"))
    usual = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB"))
    Image.fromarray(CODES).save(tmp_path / "a.png", icc_profile=usual.tobytes())
    same = np.rint(255 * display_encode(read_picture(tmp_path / "a.png").radiance))
    assert np.abs(same - CODES).max() <= 1
    Image.fromarray(CODES).save(tmp_path / "b.png", icc_profile=profile.tobytes())
    with pytest.raises(InvalidFileError, match=r"b\.png: its colour profile cannot be used"):
        read_picture(tmp_path / "b.png")


def profile(colours, connection, name, data):
    """The smallest colour profile (ICC.1:2001): a header, a white point, and one table."""
    white = b"XYZ \0\0\0\0" + struct.pack(">3i", 0xF6D6, 0x10000, 0xD32D)
    tags = struct.pack(">I4sII4sII", 2, b"wtpt", 156, len(white), name, 156 + len(white), len(data))
    size, kind = 156 + len(white) + len(data), b"mntr" if colours == b"GRAY" else b"prtr"
    header = struct.pack(">I4xI4s4s4s12x4s28x", size, 0x2100000, kind, colours, connection, b"acsp")
    return header + struct.pack(">3i48x", 0xF6D6, 0x10000, 0xD32D) + tags + white + data


def grey_profile():
    """Linear grey: a curve of no entries."""
    return profile(b"GRAY", b"XYZ ", b"kTRC", b"curv" + bytes(8))


def ink_profile():
    """Inks whose lightness L* falls evenly with the black, and the others do nothing: a table of two places an axis."""
    same, unit = bytes(range(256)), np.eye(3).ravel() * 0x10000
    light = b"".join(bytes([0 if place % 2 else 255, 128, 128]) for place in range(16))
    table = struct.pack(">4s4x4B9i", b"mft1", 4, 3, 2, 0, *map(int, unit)) + 4 * same + light + 3 * same
    return profile(b"CMYK", b"Lab ", b"A2B0", table)


def test_a_profile_of_inks_is_followed(tmp_path):
    inks = np.zeros((4, 6, 4), np.uint8)
    inks[:, 3:, 3] = 128
    inks[2:, :, 0] = 255
    Image.fromarray(inks, "CMYK").save(tmp_path / "a.tif", icc_profile=ink_profile())
    shown = 255 * display_encode(read_picture(tmp_path / "a.tif").radiance)
    np.testing.assert_allclose(shown[:, :3], 255, atol=2)
    np.testing.assert_allclose(shown[:, 3:], 118, atol=3)  # L* of 50


def test_a_profile_of_grey_is_followed(tmp_path):
    grey = CODES[..., 0]
    alone, covered = Image.fromarray(grey), Image.fromarray(np.dstack([grey, np.full_like(grey, 255)]), "LA")
    for name, image in (("a.png", alone), ("b.png", covered)):
        image.save(tmp_path / name, icc_profile=grey_profile())
        found = read_picture(tmp_path / name).radiance
        np.testing.assert_allclose(found, np.repeat(grey[..., None] / 255, 3, axis=2), atol=0.006)


def test_what_is_not_read_of_a_picture_is_named(tmp_path):
    alpha = np.full(CODES.shape[:2], 255, np.uint8)
    Image.fromarray(np.dstack([CODES, alpha])).save(tmp_path / "opaque.png")
    read_picture(tmp_path / "opaque.png")
    alpha[2, 3] = 7
    Image.fromarray(np.dstack([CODES, alpha])).save(tmp_path / "a.png")
    with pytest.warns(UserWarning, match=r"a\.png: its alpha is left out"):
        read_picture(tmp_path / "a.png")
    for name in ("b.png", "b.tif"):
        sp.write_image(tmp_path / name, display_decode(CODES), bit_depth=16)
        with pytest.warns(UserWarning, match="of its 16 bits only 8 are read"):
            read_picture(tmp_path / name)


@pytest.mark.parametrize("name", ["a.png", "a.npy", "a.pfm"])
def test_what_is_not_there_is_named_once(tmp_path, name):
    with pytest.raises(InvalidFileError, match=rf"{name}: cannot be read.*: No such file or directory$") as refused:
        read_plane(tmp_path / name)
    assert str(refused.value).count(name) == 1


def test_integers_that_are_no_codes_are_refused(tmp_path):
    np.save(tmp_path / "a.npy", CODES.astype(np.int64))
    with pytest.raises(InvalidFileError, match="has dtype int64; a picture is of uint8, uint16, or linear floats"):
        read_picture(tmp_path / "a.npy")


def test_integers_of_a_picture_are_no_metres(tmp_path):
    Image.fromarray(CODES[..., 0]).save(tmp_path / "a.png")
    Image.fromarray(PLANE).save(tmp_path / "a.tif")
    np.testing.assert_array_equal(read_plane(tmp_path / "a.tif", in_metres=True), PLANE)
    with pytest.raises(InvalidFileError, match=r"a\.png: its integers have no unit; give metres as floats"):
        read_plane(tmp_path / "a.png", in_metres=True)


def test_arrays_and_openexr_are_linear_and_integers_srgb(tmp_path):
    linear = np.random.default_rng(2).random((4, 5, 3)).astype(np.float32)
    np.save(tmp_path / "a.npy", linear)
    sp.write_image(tmp_path / "a.exr", linear)
    np.save(tmp_path / "codes.npy", CODES)
    np.testing.assert_array_equal(read_picture(tmp_path / "a.npy").radiance, linear)
    np.testing.assert_array_equal(read_picture(tmp_path / "a.exr").radiance, linear)
    np.testing.assert_allclose(read_picture(tmp_path / "codes.npy").radiance, display_decode(CODES / 255.0), atol=1e-6)


PLANE = np.linspace(0.1, 1.0, 12, dtype=np.float32).reshape(3, 4)


def test_planes_of_all_formats_hold_the_same_values(tmp_path):
    np.save(tmp_path / "a.npy", PLANE)
    (tmp_path / "a.pfm").write_bytes(b"Pf\n4 3\n-1.0\n" + PLANE[::-1].astype("<f4").tobytes())
    Image.fromarray(PLANE).save(tmp_path / "a.tif")
    Image.fromarray(np.rint(65535 * PLANE).astype(np.uint16)).save(tmp_path / "a.png")
    Image.fromarray(np.rint(255 * PLANE).astype(np.uint8)).save(tmp_path / "b.png")
    from spreadlets.files.images import write_plane

    write_plane(tmp_path / "a.exr", "Z", PLANE)
    for name, tolerance in [("a.npy", 0), ("a.pfm", 0), ("a.tif", 0), ("a.exr", 0), ("a.png", 1e-5), ("b.png", 2e-3)]:
        np.testing.assert_allclose(read_plane(tmp_path / name), PLANE, atol=tolerance, err_msg=name)


def test_a_plane_in_false_colours_is_doubted_and_one_in_grey_is_not(tmp_path):
    grey = np.repeat(np.rint(255 * PLANE).astype(np.uint8)[..., None], 3, axis=2)
    for name in ("grey.png", "grey.jpg"):
        Image.fromarray(grey).save(tmp_path / name)
        np.testing.assert_allclose(read_plane(tmp_path / name), PLANE, atol=0.05)
    grey[..., 2] = 255 - grey[..., 2]
    Image.fromarray(grey).save(tmp_path / "false.png")
    with pytest.warns(UserWarning, match=r"false\.png: is coloured, and read as grey"):
        read_plane(tmp_path / "false.png")


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.png", b"no picture"),
        ("a.npy", b"no array"),
        ("a.pfm", b"Pf\n4000 3000\n-1.0\nabc"),
        ("a.pfm", b"PF\n1 1\n-1.0\n" + bytes(12)),
        ("a.exr", b"no image"),
        ("missing.png", None),
    ],
)
def test_what_is_no_plane_is_refused_by_name(tmp_path, name, content):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(InvalidFileError, match=name.replace(".", r"\.")):
        read_plane(tmp_path / name)


def test_arrays_of_objects_and_of_other_shapes_are_refused(tmp_path):
    np.save(tmp_path / "a.npy", np.array([{}], object), allow_pickle=True)
    np.save(tmp_path / "b.npy", np.zeros((2, 3, 4, 5)))
    with pytest.raises(InvalidFileError, match=r"a\.npy"):
        read_plane(tmp_path / "a.npy")
    with pytest.raises(InvalidFileError, match=r"one value for each pixel"):
        read_plane(tmp_path / "b.npy")
    with pytest.raises(InvalidFileError, match=r"a picture is \(H, W, 3\)"):
        read_picture(tmp_path / "b.npy")
