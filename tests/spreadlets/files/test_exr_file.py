"""An OpenEXR file is opened once, whatever is asked of it."""

import sys
import warnings

import numpy as np
import OpenEXR
import pytest
from click.testing import CliRunner

import spreadlets as sp
from spreadlets.cli.main import cli
from spreadlets.errors import InvalidFileError
from spreadlets.files.exr_file import ExrFile, opened
from spreadlets.files.inspect import frame_info
from spreadlets.files.kinds import file_kind

CAMERA = "--focal-length 50 --sensor-width 36 --f-number 2 --focus 2".split()
OPENED: list[str] = []
sys.addaudithook(lambda event, arguments: OPENED.append(str(arguments[0])) if event == "open" else None)


@pytest.fixture
def openings(monkeypatch):
    """Count how often a file is opened: by Python, or by the library, which is not audited, by its path."""
    library = OpenEXR.File
    by_path = []

    def watched(source, *arguments, **keywords):
        by_path.extend([source] if isinstance(source, str) else [])
        return library(source, *arguments, **keywords)

    def count(function, path):
        OPENED.clear()
        by_path.clear()
        function()
        return [*OPENED, *by_path].count(str(path))

    monkeypatch.setattr(OpenEXR, "File", watched)
    return count


@pytest.fixture
def frame_path(tmp_path):
    path = tmp_path / "frame.exr"
    channels = {f"{layer}{name}": np.full((8, 9), 0.5, np.float32) for layer in ("", "spec.") for name in "RGB"}
    channels["Z"] = np.full((8, 9), 3, np.float32)
    OpenEXR.File({"type": OpenEXR.scanlineimage}, channels).write(str(path))
    return path


@pytest.fixture
def deep_path(tmp_path):
    path = tmp_path / "deep.exr"
    one = np.ones(4, np.float32)
    sp.write_deep(path, sp.DeepImage(np.ones((2, 2), int), np.ones((4, 4), np.float32), one, one))
    return path


@pytest.fixture
def samples():
    lens_uv = np.zeros((4, 6, 2, 2))
    return sp.SampleBuffer(np.ones((4, 6, 2, 3)), np.ones((4, 6, 2)), lens_uv, lens_uv, np.zeros((4, 6, 2)))


def test_reading_opens_a_file_once(openings, frame_path, deep_path, samples, tmp_path):
    sp.write_samples(tmp_path / "samples.exr", samples)
    for function, path in (
        (sp.read_frame, frame_path),
        (sp.read_image, frame_path),
        (frame_info, frame_path),
        (sp.read_frame, deep_path),
        (frame_info, deep_path),
        (sp.read_samples, tmp_path / "samples.exr"),
    ):
        assert openings(lambda read=function, source=path: read(source), path) == 1


def test_synth_opens_a_frame_once_though_it_takes_the_camera_and_further_channels_from_it(
    openings, frame_path, tmp_path
):
    command = ["synth", str(frame_path), "-o", str(tmp_path / "out.exr"), *CAMERA, "--also", "spec", "--pass-through"]

    def run():
        with warnings.catch_warnings(action="ignore"):
            assert CliRunner().invoke(cli, command).exit_code == 0

    assert openings(run, frame_path) == 1


def test_a_tlfr_buffer_of_one_file_is_opened_once(openings, samples, tmp_path):
    sp.write_tlfr(tmp_path / "two", samples, camera=sp.ThinLens(50, 36, 2.0, 2.0))
    one = tmp_path / "one"
    one.write_bytes((tmp_path / "two.header").read_bytes() + (tmp_path / "two").read_bytes())
    assert openings(lambda: sp.read_samples(one), one) == 1


def test_files_that_are_open_stay_open_and_others_are_closed(frame_path):
    with ExrFile(frame_path) as file:
        with opened([file, frame_path]) as (same, other):
            assert same is file and other.parts[0].planes.keys() == file.parts[0].planes.keys()
        assert sp.read_frame(file).shape == (8, 9)
        with pytest.raises(ValueError, match="closed"):
            other.check_size()


def test_a_file_that_is_refused_is_closed(tmp_path):
    (tmp_path / "frame.exr").write_bytes(b"\x76\x2f\x31\x01 no header")
    with pytest.raises(InvalidFileError, match="is not a readable OpenEXR file"):
        ExrFile(tmp_path / "frame.exr")  # an open file would warn


@pytest.mark.parametrize(
    ("start", "kind"),
    [
        (b"\x89HDF\r\n\x1a\n", "an HDF5 file, such as a database"),
        (b"Version 1.3", "a TLFR sample buffer"),
        (b"MM\0*", "a TIFF"),
        (b"", ""),
    ],
)
def test_the_first_bytes_tell_the_kind_of_a_file(tmp_path, start, kind):
    path = tmp_path / "x"
    path.write_bytes(start)
    with open(path, "rb") as file:
        assert file_kind(path) == file_kind(file) == kind and file.tell() == 0
