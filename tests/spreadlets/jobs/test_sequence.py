"""Sequences of jobs, made here and by processes."""

import os
import signal
import warnings
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from spreadlets import processes
from spreadlets.errors import AmbiguousInputWarning, InvalidFileError, InvalidParameterError, option, options_spelled
from spreadlets.files.atomic import atomic_path
from spreadlets.jobs.job import Job
from spreadlets.jobs.sequence import chosen_frames, run_sequence


@dataclass(frozen=True)
class Copy(Job):
    """Copies a file; the frame in it may be bad in one way or another."""

    reference: None = None
    database: None = None
    bit_depth: None = None
    rendering: dict = field(default_factory=dict)

    def make(self, progress=None):
        text = Path(self.inputs[0]).read_text()
        if text == "no depth":
            raise InvalidFileError(f"no depth; name {option('depth_channel')}")
        if text == "chance":
            raise ZeroDivisionError("by chance")
        if text == "no layers":
            raise InvalidParameterError("no layers")
        if text == "doubtful":
            warnings.warn("which depth?", AmbiguousInputWarning, stacklevel=1)
            warnings.warn("2 pixels mended", stacklevel=1)
        if text == "kills once" and not Path(self.output + ".tried").exists():
            Path(self.output + ".tried").touch()
            with atomic_path(self.output, ".exr") as path:
                path.write_text("half")
                os.kill(os.getpid(), signal.SIGKILL)
        if text == "kills":
            os.kill(os.getpid(), signal.SIGKILL)
        Path(self.output).write_text(text)
        return {"process": os.getpid(), "peak_rss_mb": 7.0}


def spelled(name):
    return "--" + name.replace("_", "-")


@pytest.fixture
def copy(tmp_path):
    """Give a function that writes frames and returns the job that copies them."""

    def written(*texts):
        for number, text in enumerate(texts, 1):
            (tmp_path / f"in.{number}.exr").write_text(text)
        return Copy((str(tmp_path / "in.#.exr"),), str(tmp_path / "out.#.exr"), None, {})

    return written


def outputs(folder):
    return sorted(path.name for path in folder.glob("out.?.exr"))


def test_a_run_makes_what_is_not_there_and_reports_each_frame(copy, tmp_path):
    job, steps = copy("a", "b", "c"), []
    (tmp_path / "out.2.exr").write_text("old")
    report = run_sequence(job, [1, 2, 3], progress=lambda *step: steps.append(step))
    assert [(entry["frame"], entry["skipped"]) for entry in report["frames"]] == [(1, False), (2, True), (3, False)]
    assert report["frames"][2]["process"] == os.getpid() and "process" not in report["frames"][1]
    assert [entry["output"] for entry in report["frames"]] == [str(tmp_path / f"out.{n}.exr") for n in (1, 2, 3)]
    assert (report["written"], report["skipped"], report["peak_rss_mb"]) == (2, 1, 7.0)
    assert steps == [(1, 3), (2, 3), (3, 3)] and (tmp_path / "out.2.exr").read_text() == "old"
    run_sequence(job, [1, 2, 3], overwrite=True)
    assert (tmp_path / "out.2.exr").read_text() == "b"


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_frames_own_error_does_not_stop_the_others_and_a_shared_one_does(copy, jobs):
    with options_spelled(spelled):
        report = run_sequence(copy("no depth", "chance", "c"), [1, 2, 3], jobs=jobs)
    assert (report["failed"], report["written"], report["skipped"]) == ([1, 2], 1, 0)
    said = [entry.get("error") for entry in report["frames"]]
    assert said == ["no depth; name --depth-channel", "ZeroDivisionError: by chance", None]
    with pytest.raises(InvalidParameterError, match="frame 2: no layers"):
        run_sequence(copy("a", "no layers"), [1, 2], jobs=jobs, overwrite=True)


@pytest.mark.parametrize("jobs", [1, 2])
def test_doubts_are_told_for_the_first_frame_and_what_happened_to_a_frame_for_each(copy, jobs):
    with pytest.warns() as told:
        run_sequence(copy("doubtful", "doubtful"), [1, 2], jobs=jobs)
    said = sorted(str(each.message) for each in told)
    assert said == ["frame 1: 2 pixels mended", "frame 2: 2 pixels mended", "which depth?"]


def test_a_frame_whose_process_dies_is_made_again_and_one_that_kills_them_all_is_named(copy, tmp_path):
    report = run_sequence(copy("a", "kills once", "c", "kills"), [1, 2, 3, 4], jobs=2)
    assert outputs(tmp_path) == ["out.1.exr", "out.2.exr", "out.3.exr"] and report["failed"] == [4]
    assert not list(tmp_path.glob(".*"))
    assert f"{processes.ATTEMPTS} processes died on it" in report["frames"][3]["error"]
    assert all(entry["process"] != os.getpid() for entry in report["frames"][:3])


def test_a_job_for_other_processes_has_whole_paths(copy, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    copy("a")
    job = Copy(("in.#.exr",), "out.#.exr", None, {}).numbered(1).absolute()
    assert (job.inputs, job.output) == ((str(tmp_path / "in.1.exr"),), str(tmp_path / "out.1.exr"))


def test_frames_are_chosen_and_no_result_replaces_what_is_read(copy, tmp_path):
    job = copy("a", "b", "c")
    (tmp_path / "in.2.exr").unlink()
    with pytest.warns(UserWarning, match="no frames 2"):
        assert chosen_frames(job, None) == [1, 3]
    assert chosen_frames(job, "3") == [3]
    (tmp_path / "out.3.exr").touch()
    with pytest.raises(InvalidParameterError, match=r"would replace .*out\.3\.exr"):
        chosen_frames(Copy(job.inputs, job.output, str(tmp_path / "out.3.exr"), {}), "1-3")
