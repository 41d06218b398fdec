"""Builds on the workers of a Dask scheduler."""

import numba
import pytest
from building import CASE, Stop, assert_same, stop_after

from spreadlets import workers
from spreadlets.errors import BuildStoppedError
from spreadlets.precompute.build.build import build_database

pytest.importorskip("distributed")
pytestmark = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="builds databases")


def lose(process, cells):
    """Return a listener that kills a process when so many cells are finished."""

    def report(done, total, left_s):
        if done == cells:
            process.kill()
            process.wait()

    return report


def test_a_cluster_builds_the_same_database_through_the_loss_of_a_worker_and_of_the_scheduler(cluster, tmp_path):
    address, (scheduler, first, _) = cluster
    build_database("combined", tmp_path / "here.h5", jobs=1, **CASE)
    build_database("combined", tmp_path / "there.h5", scheduler=address, progress=lose(first, 1), **CASE)
    assert_same(tmp_path / "there.h5", tmp_path / "here.h5")
    with pytest.raises(Stop):
        build_database("combined", tmp_path / "lost.h5", jobs=1, progress=stop_after(5), **CASE)
    with pytest.raises(BuildStoppedError, match="same command goes on from there"):
        build_database("combined", tmp_path / "lost.h5", scheduler=address, progress=lose(scheduler, 5), **CASE)
    assert len(list((tmp_path / "lost.h5.parts").glob("*.part"))) == 5
    build_database("combined", tmp_path / "lost.h5", jobs=1, **CASE)
    assert_same(tmp_path / "lost.h5", tmp_path / "here.h5")


def test_a_scheduler_that_does_not_answer_is_one_error(tmp_path, monkeypatch):
    monkeypatch.setattr(workers, "CONNECT_S", 0.5)
    with pytest.raises(BuildStoppedError, match="no Dask scheduler answers at 'tcp://127.0.0.1:9'"):
        build_database("combined", tmp_path / "a.h5", scheduler="tcp://127.0.0.1:9", **CASE)
    assert list(tmp_path.iterdir()) == []
