"""Sequences on the workers of a Dask scheduler."""

import time
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from spreadlets import workers
from spreadlets.errors import InvalidFileError, StoppedError
from spreadlets.jobs.job import Job
from spreadlets.jobs.sequence import run_sequence

pytest.importorskip("distributed")


@dataclass(frozen=True)
class SlowCopy(Job):
    """Copies a file after a while."""

    reference: None = None
    database: None = None
    bit_depth: None = None
    rendering: dict = field(default_factory=dict)

    def make(self, progress=None):
        time.sleep(0.3)
        text = Path(self.inputs[0]).read_text()
        if text == "4":
            raise InvalidFileError("no depth")
        Path(self.output).write_text(text)
        return {}


def lose(process, frames):
    """Return a listener that kills a process when so many frames are done."""

    def report(done, total):
        if done == frames:
            process.kill()
            process.wait()

    return report


def test_frames_of_a_lost_worker_are_made_again_and_a_lost_cluster_is_one_error(cluster, tmp_path, monkeypatch):
    address, (scheduler, first, _) = cluster
    for number in range(1, 9):
        (tmp_path / f"in.{number}.exr").write_text(str(number))
    job = SlowCopy((str(tmp_path / "in.#.exr"),), str(tmp_path / "out.#.exr"), None, {})
    report = run_sequence(job, range(1, 9), scheduler=address, progress=lose(first, 2))
    assert [entry["frame"] for entry in report["frames"]] == list(range(1, 9))
    assert report["failed"] == [4] and report["frames"][3]["error"] == "no depth" and report["written"] == 7
    assert all((tmp_path / f"out.{n}.exr").read_text() == str(n) for n in range(1, 9) if n != 4)
    with pytest.raises(StoppedError, match="same command goes on"):
        run_sequence(job, range(1, 9), overwrite=True, scheduler=address, progress=lose(scheduler, 1))


def test_a_worker_of_another_version_is_refused(cluster, tmp_path, monkeypatch):
    address, _ = cluster
    (tmp_path / "in.1.exr").write_text("1")
    job = SlowCopy((str(tmp_path / "in.#.exr"),), str(tmp_path / "out.#.exr"), None, {})
    monkeypatch.setattr(workers, "__version__", "0")
    with pytest.raises(StoppedError, match="this program 0: install the same everywhere"):
        run_sequence(job, [1], scheduler=address)


def test_a_connection_that_cannot_be_closed_hides_no_error(monkeypatch):
    class Client:
        def __init__(self, *arguments, **options):
            pass

        def wait_for_workers(self, count, timeout):
            pass

        def ncores(self):
            return {}

        def close(self, timeout):
            raise TimeoutError

    monkeypatch.setattr("distributed.Client", Client)
    with pytest.raises(KeyError), workers.open_workers(1, "tcp://there:1"):
        raise KeyError
