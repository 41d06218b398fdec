"""Sample buffers through files: our EXR layout, and TLFR against its formulas."""

import numpy as np
import OpenEXR
import pytest
from click.testing import CliRunner

import spreadlets as sp
from spreadlets.cli.main import cli
from spreadlets.errors import InvalidFileError, InvalidFrameError, InvalidParameterError
from spreadlets.files import tlfr
from spreadlets.files.exr_file import ExrFile
from spreadlets.files.exr_parts import window
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.raster import Attribute, Raster, Window
from spreadlets.scene.samples import SampleBuffer

SHAPE = (3, 5, 4)
CAMERA = ThinLens(50, 36, 2.0, 3.0, (-0.5, 0.25))


def random_samples(seed=0, *, alpha=False, shutter=(-0.25, 0.25), **extra):
    rng = np.random.default_rng(seed)
    return SampleBuffer(
        rng.random((*SHAPE, 4 if alpha else 3)),
        1 + 9 * rng.random(SHAPE),
        rng.normal(size=(*SHAPE, 2)) * 3,
        rng.uniform(-0.7, 0.7, (*SHAPE, 2)),
        rng.uniform(*shutter, SHAPE),
        rng.uniform(-0.5, 0.5, (*SHAPE, 2)),
        **extra,
    )


def assert_same(found, expected, tolerance=0.0):
    assert found.labels.keys() == expected.labels.keys()
    np.testing.assert_array_equal(found.valid, expected.valid)
    for name, values in {"radiance": expected.radiance, **expected.labels}.items():
        np.testing.assert_allclose(getattr(found, name), values, rtol=tolerance, atol=tolerance, err_msg=name)


# --- OpenEXR -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["plain", "alpha", "missing", "everything"])
def test_samples_come_back_as_they_were_written(tmp_path, kind):
    extra = {}
    if kind in ("missing", "everything"):
        extra["valid"] = np.random.default_rng(3).random(SHAPE) > 0.3
    if kind == "everything":
        extra |= {"coc_radius": np.full(SHAPE, 2.5), "motion_prev": np.ones((*SHAPE, 2))}
        extra["motion_next"] = np.full((*SHAPE, 2), 0.5)
    samples = random_samples(alpha=kind in ("alpha", "everything"), **extra)
    sp.write_samples(tmp_path / "samples.exr", samples)
    assert_same(sp.read_samples(tmp_path / "samples.exr"), samples)
    channels = OpenEXR.File(str(tmp_path / "samples.exr"), header_only=True).parts[0].header["channels"]
    assert ("A" in {c.name for c in channels}) == (kind in ("alpha", "everything"))


def sample_part(index, shape=(2, 3), without=(), **header):
    names = ["R", "G", "B", "Z", "motion.x", "motion.y", "lens.u", "lens.v", "time"]
    channels = {name: np.full(shape, 0.5 + index, np.float32) for name in names if name not in without}
    for name in ("lens.u", "lens.v"):
        channels[name] = np.zeros(shape, np.float32)
    return OpenEXR.Part({"type": OpenEXR.scanlineimage, "name": f"sample{index}", **header}, channels)


def test_samples_are_read_in_the_data_window_and_offsets_are_optional(tmp_path):
    display = (np.array([0, 0], np.int32), np.array([3, 2], np.int32))
    windows = {"displayWindow": display, "dataWindow": (np.array([1, 1], np.int32), np.array([3, 2], np.int32))}
    OpenEXR.File([sample_part(0, **windows), sample_part(1, **windows)]).write(str(tmp_path / "s.exr"))
    samples = sp.read_samples(tmp_path / "s.exr")
    assert samples.shape == (2, 3) and samples.n_samples == 2 and not samples.offset.any()
    assert samples.valid.all() and (samples.depth[0, 0] == (0.5, 1.5)).all()
    assert samples.raster == Raster(Window(1, 1, 3, 2), Window(0, 0, 4, 3), attributes=samples.raster.attributes)


def test_samples_outside_their_parts_data_window_are_missing(tmp_path):
    display = (np.array([0, 0], np.int32), np.array([3, 2], np.int32))
    inner = {"displayWindow": display, "dataWindow": (np.array([1, 1], np.int32), np.array([3, 2], np.int32))}
    moved = {"displayWindow": display, "dataWindow": (np.array([0, 1], np.int32), np.array([2, 2], np.int32))}
    OpenEXR.File([sample_part(0, **inner), sample_part(1, **moved)]).write(str(tmp_path / "s.exr"))
    samples = sp.read_samples(tmp_path / "s.exr")
    assert samples.raster.data == Window(0, 1, 4, 2)
    np.testing.assert_array_equal(samples.valid[0], [[False, True], [True, True], [True, True], [True, False]])


def test_a_part_that_is_no_sample_is_named(tmp_path):
    OpenEXR.File([sample_part(0), sample_part(1, without=("time",))]).write(str(tmp_path / "s.exr"))
    with pytest.raises(InvalidFileError, match="part 'sample1' lacks time; every sample needs .* Channels found: B, G"):
        sp.read_samples(tmp_path / "s.exr")


def test_invalid_samples_are_refused_with_the_path_or_repaired(tmp_path):
    samples = random_samples()
    samples.depth[1, 1, 1] = -1
    sp.write_samples(tmp_path / "s.exr", samples)
    with pytest.raises(InvalidFrameError, match=r"s\.exr: depth .*\(row 1, col 1, sample 1\)"):
        sp.read_samples(tmp_path / "s.exr")
    assert sp.read_samples(tmp_path / "s.exr", repair=True).dropped_samples == 1


# --- TLFR ----------------------------------------------------------------------------------------------------------

HEADER = """Version 1.3
Width {width}
Height {height}
Samples per pixel {samples}
Motion model: affine
CoC coefficients (coc radius = C0/w+C1): -15.242497,19.053122
Encoding = {encoding}
x,y,z/w,w,u,v,t,r,g,b,a,mv_x,mv_y,mv_w,dwdx,dwdy
"""
C0, C1 = -15.242497, 19.053122


def write_tlfr_files(path, rows, *, width=2, height=1, samples=1, encoding="text", header=HEADER):
    path.with_name(path.name + ".header").write_text(
        header.format(width=width, height=height, samples=samples, encoding=encoding)
    )
    if encoding == "binary":
        np.asarray(rows, "<f4").tofile(path)
    else:
        # As the authors' own writer: a comma ends each line, too.
        path.write_text("".join("".join(f"{value:f}," for value in row) + "\n" for row in rows))
    return path


def tlfr_row(x=0.5, y=0.5, w=2.0, u=0.0, v=0.0, t=0.5, mv=(0.0, 0.0, 0.0)):
    return [x, y, 0.0, w, u, v, t, 0.25, 0.5, 0.75, 0.3, *mv, 0.0, 0.0]


@pytest.mark.parametrize("encoding", ["text", "binary"])
def test_tlfr_columns_become_labels(tmp_path, encoding):
    rows = [tlfr_row(0.75, 0.25, 2.0, 0.5, -0.25, 0.75, (4.0, -2.0, 0.0)), tlfr_row(1.5)]
    samples = sp.read_samples(write_tlfr_files(tmp_path / "buffer", rows, encoding=encoding), camera=CAMERA)
    assert samples.shape == (1, 2) and samples.n_samples == 1 and samples.motion_prev is None
    np.testing.assert_allclose(samples.radiance[0, 0, 0], (0.25, 0.5, 0.75, 1))  # alpha is not used by the format
    np.testing.assert_allclose(samples.offset[0, 0, 0], (0.25, -0.25))
    np.testing.assert_allclose(samples.lens_uv[0, 0, 0], (0.5, -0.25))
    np.testing.assert_allclose(samples.time[0, 0, 0], -0.5 + 0.75 * 0.75)
    np.testing.assert_allclose(samples.coc_radius[0, 0, 0], C0 / 2 + C1, rtol=1e-6)
    # (x w) changes by 4 and w stays 2: 2 px over a shutter of .75 frames.
    np.testing.assert_allclose(samples.motion[0, 0, 0], (2 / 0.75, -1 / 0.75), rtol=1e-6)


def test_tlfr_motion_of_a_point_that_comes_nearer(tmp_path):
    # A point seen through the lens's edge at t = .25; its pinhole position follows from the homogeneous equation.
    row = tlfr_row(0.6, 0.5, 3.0, 0.5, -0.5, 0.25, (3.0, 1.5, -1.2))
    samples = sp.read_samples(write_tlfr_files(tmp_path / "buffer", [row, tlfr_row(1.5)]), camera=CAMERA)
    xy = np.array([0.6, 0.5]) - (C0 / 3 + C1) * np.array([0.5, -0.5])
    at = [(xy * 3 + (t - 0.25) * np.array([3.0, 1.5])) / (3 + (t - 0.25) * -1.2) for t in (0.0, 0.5, 1.0)]
    np.testing.assert_allclose(samples.motion[0, 0, 0], (at[2] - at[0]) / 0.75, rtol=1e-5)
    np.testing.assert_allclose(samples.motion_prev[0, 0, 0], (at[1] - at[0]) / 0.375, rtol=1e-5)
    np.testing.assert_allclose(samples.motion_next[0, 0, 0], (at[2] - at[1]) / 0.375, rtol=1e-5)


def test_tlfr_samples_in_another_order_are_sorted_into_their_pixels(tmp_path):
    rows = [tlfr_row(1.2, t=0.1), tlfr_row(0.5, t=0.2), tlfr_row(1.9, t=0.3), tlfr_row(2.0, t=0.4)]
    samples = sp.read_samples(write_tlfr_files(tmp_path / "buffer", rows, samples=2))
    assert samples.n_samples == 3 and samples.valid.tolist() == [[[True, False, False], [True, True, True]]]
    np.testing.assert_allclose(samples.time[0, 1], -0.25 + 0.5 * np.array([0.1, 0.3, 0.4]), rtol=1e-5)


@pytest.mark.parametrize("binary", [True, False])
@pytest.mark.parametrize("curved", [True, False])
def test_tlfr_buffers_come_back_as_they_were_written(tmp_path, binary, curved):
    extra = {}
    if curved:  # halves of a straight path in space: in proportion to w at closing and opening
        motion = random_samples().motion
        ratio = np.random.default_rng(5).uniform(0.8, 1.25, (*SHAPE, 1))
        extra = {"motion_prev": motion * 2 / (1 + ratio), "motion_next": motion * 2 * ratio / (1 + ratio)}
    samples = random_samples(**extra, shutter=CAMERA.shutter)
    path = tmp_path / "buffer.bin"
    sp.write_tlfr(path, samples, camera=CAMERA, binary=binary)
    found = sp.read_samples(path, camera=CAMERA)
    np.testing.assert_allclose(found.coc_radius, CAMERA.coc_radius(samples.depth, SHAPE[1]), rtol=1e-4, atol=1e-5)
    found.coc_radius = None
    assert_same(found, samples, 2e-4)
    # Written again, from the radii instead of the camera.
    again = sp.read_samples(path, camera=CAMERA)
    sp.write_tlfr(tmp_path / "again", again, camera=ThinLens(20, 36, 8.0, 1.0, CAMERA.shutter), binary=binary)
    assert_same(sp.read_samples(str(tmp_path / "again.header"), camera=CAMERA), again, 1e-3)


def test_tlfr_stores_the_background_far_away(tmp_path):
    samples = random_samples(shutter=CAMERA.shutter)
    samples.depth[0, 0] = np.inf
    sp.write_tlfr(tmp_path / "b", samples, camera=CAMERA)
    found = sp.read_samples(tmp_path / "b", camera=CAMERA)
    assert (found.depth[0, 0] == 1e10).all()
    np.testing.assert_allclose(found.motion, samples.motion, rtol=1e-3, atol=1e-3)


def test_tlfr_cannot_hold_every_buffer(tmp_path):
    path = tmp_path / "b"
    with pytest.raises(InvalidFrameError, match="1 samples are missing"):
        sp.write_tlfr(path, random_samples(valid=np.arange(60).reshape(SHAPE) != 7), camera=CAMERA)
    with pytest.raises(InvalidFrameError, match=r"time spans .* in the shutter, -0\.25 to 0\.25"):
        sp.write_tlfr(path, random_samples(shutter=(0, 1), coc_radius=np.ones(SHAPE)))
    with pytest.raises(InvalidParameterError, match="need the camera"):
        sp.write_tlfr(path, random_samples())
    with pytest.raises(InvalidFrameError, match="it must be of one lens"):
        sp.write_tlfr(path, random_samples(coc_radius=np.random.default_rng(0).random(SHAPE)))
    still = ThinLens(50, 36, 2.0, 3.0, (0.0, 0.0))
    with pytest.raises(InvalidParameterError, match="must stay open"):
        sp.write_tlfr(path, random_samples(), camera=still)
    assert list(tmp_path.iterdir()) == []


ROWS = [tlfr_row(0.5), tlfr_row(1.5)]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("Version 1.3", "Version 2.2"), "is of version 2.2; only 1.3"),
        (("Width {width}", "Width two"), "lacks a valid line 'Width'"),
        (("Samples per pixel", "Samples"), "lacks a valid line 'Samples per pixel'"),
        (("-15.242497,19.053122", "-15"), "two numbers are needed"),
        (("Encoding = {encoding}", "Encoding = zip"), "allowed are text, binary"),
        (("mv_w,dwdx", "dwdx"), "must name the columns"),
        (("Height {height}", "Height 900000000"), "promises .* samples"),
        (("Height {height}", "Height 0"), "promises 0 samples"),
        (("Width {width}", "Width 3"), "holds 32 numbers; its header promises 48"),
        (("Width {width}", "Width 1"), "more than the 16 numbers"),
    ],
)
def test_bad_tlfr_headers_are_refused(tmp_path, change, message):
    path = write_tlfr_files(tmp_path / "buffer", ROWS, header=HEADER.replace(*change))
    with pytest.raises(InvalidFileError, match=message):
        sp.read_samples(path)


def test_bad_tlfr_samples_are_refused(tmp_path):
    path = write_tlfr_files(tmp_path / "buffer", ROWS)
    text = path.read_text()
    path.write_text(text.replace("2.000000", "two"))
    with pytest.raises(InvalidFileError, match="not a number separated by commas"):
        sp.read_samples(path)
    path.write_text("1,")
    with pytest.raises(InvalidFileError, match="cannot be the 32 numbers"):
        sp.read_samples(path)
    path.unlink()
    with pytest.raises(InvalidFileError, match="no such file"):
        sp.read_samples(path)
    write_tlfr_files(path, ROWS, encoding="binary")
    path.write_bytes(path.read_bytes()[:-4])
    with pytest.raises(InvalidFileError, match="has 124 bytes; its header promises 128"):
        sp.read_samples(path)
    write_tlfr_files(path, [tlfr_row(0.5), tlfr_row(7.0)])
    with pytest.raises(InvalidFileError, match=r"outside the image at 1 of 2 samples, first at sample 1: \(7, 0.5\)"):
        sp.read_samples(path)
    write_tlfr_files(path, [tlfr_row(0.5), tlfr_row(1.5, w=-2)])
    with pytest.raises(InvalidFrameError, match=r"buffer: depth is zero or negative .*\(row 0, col 1, sample 0\)"):
        sp.read_samples(path)


def test_a_large_tlfr_text_is_parsed_in_blocks(tmp_path, monkeypatch):
    rows = [tlfr_row(0.5 + x, t=x / 40) for x in range(40)]
    path = write_tlfr_files(tmp_path / "buffer", rows, width=40)
    whole = sp.read_samples(path)
    monkeypatch.setattr(tlfr, "BLOCK_BYTES", 300)
    assert_same(sp.read_samples(path), whole)


def test_a_pixel_that_holds_nearly_everything_is_refused(tmp_path, monkeypatch):
    rows = [tlfr_row(0.5, t=x / 40) for x in range(40)]
    path = write_tlfr_files(tmp_path / "buffer", rows, width=40)
    monkeypatch.setattr(tlfr, "MAX_VALUES", 40 * 16)
    with pytest.raises(InvalidFileError, match="40 samples lie in one pixel"):
        sp.read_samples(path)


def test_windows_pixel_aspect_and_attributes_of_samples_come_back(tmp_path):
    raster = Raster(Window(-3, 2, 6, 4), Window(0, 0, 5, 8), 2.0, attributes={"owner": Attribute("string", b"me")})
    lens_uv = np.zeros((4, 6, 2, 2))
    given = sp.SampleBuffer(
        np.ones((4, 6, 2, 3)), np.ones((4, 6, 2)), lens_uv, lens_uv, np.zeros((4, 6, 2)), raster=raster
    )
    sp.write_samples(tmp_path / "samples.exr", given)
    found = sp.read_samples(tmp_path / "samples.exr").raster
    assert (found.data, found.display, found.pixel_aspect) == (raster.data, raster.display, 2.0)
    assert found.attributes["owner"] == raster.attributes["owner"]


def test_reconstructed_images_have_the_windows_of_the_samples(tmp_path):
    raster = Raster(Window(-3, 2, 6, 4), Window(0, 0, 5, 8), 2.0)
    lens_uv = np.random.default_rng(0).uniform(-0.7, 0.7, (4, 6, 2, 2))
    sp.write_samples(
        tmp_path / "samples.exr",
        sp.SampleBuffer(
            np.ones((4, 6, 2, 3)), np.ones((4, 6, 2)), 0 * lens_uv, lens_uv, np.zeros((4, 6, 2)), raster=raster
        ),
    )
    command = f"reconstruct {tmp_path}/samples.exr -o {tmp_path}/out.exr --method mean --focal-length 50 --focus 2"
    done = CliRunner().invoke(cli, [*command.split(), "--sensor-width", "36", "--f-number", "2"])
    assert done.exit_code == 0, done.output
    with ExrFile(tmp_path / "out.exr") as file:
        header = file.headers[0]
    assert window(header["dataWindow"]) == raster.data and window(header["displayWindow"]) == raster.display
    assert header["pixelAspectRatio"] == 2.0
