"""Outputs are told from inputs, whatever they are called."""

import os

import pytest

from spreadlets.errors import InvalidFileError, InvalidParameterError
from spreadlets.files.outputs import check_outputs


def test_a_file_that_is_read_is_refused_by_every_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "in.exr").touch()
    (tmp_path / "folder").mkdir()
    (tmp_path / "other").symlink_to(tmp_path)
    (tmp_path / "link.exr").symlink_to("in.exr")
    os.link(tmp_path / "in.exr", tmp_path / "hard.exr")
    for name in ("in.exr", "folder/../in.exr", "other/in.exr", "link.exr", "hard.exr", tmp_path / "in.exr"):
        with pytest.raises(InvalidParameterError, match="would replace in.exr"):
            check_outputs([name], ["missing.exr", "in.exr"])
        with pytest.raises(InvalidParameterError, match="would replace"):
            check_outputs(["in.exr"], [name])
    check_outputs(["out.exr", "folder/in.exr"], ["in.exr"])


def test_two_outputs_are_two_files(tmp_path):
    with pytest.raises(InvalidParameterError, match="same file as the output"):
        check_outputs([tmp_path / "a.exr", tmp_path / "." / "b.exr", f"{tmp_path}/./a.exr"])


def test_what_cannot_be_written_is_refused(tmp_path):
    (tmp_path / "file").touch()
    for path, reason in (
        (tmp_path, "not a regular file"),
        (tmp_path / "none" / "out.exr", "no folder"),
        (tmp_path / "file" / "out.exr", "no folder"),
    ):
        with pytest.raises(InvalidFileError, match=f"cannot be written: .*{reason}"):
            check_outputs([path])
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.skipif(os.name == "nt" or os.geteuid() == 0, reason="the superuser may write everywhere")
def test_protected_files_and_folders_are_refused(tmp_path):
    (tmp_path / "out.exr").touch(mode=0o444)
    with pytest.raises(InvalidFileError, match="protected"):
        check_outputs([tmp_path / "out.exr"])
    tmp_path.chmod(0o555)
    with pytest.raises(InvalidFileError, match="cannot be written"):
        check_outputs([tmp_path / "new.exr"])


def test_a_folder_that_takes_no_file_is_refused(tmp_path, monkeypatch):
    def refuse(dir):
        raise PermissionError("read-only file system")

    monkeypatch.setattr("tempfile.TemporaryFile", refuse)
    with pytest.raises(InvalidFileError, match="read-only file system"):
        check_outputs([tmp_path / "out.exr"])
