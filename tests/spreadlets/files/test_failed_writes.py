"""What is written is there whole or not at all: a write that fails leaves what was there before, and nothing else."""

import os

import numpy as np
import pytest

import spreadlets as sp
from spreadlets.errors import SpreadletsError
from spreadlets.files import exr_frames as exr
from spreadlets.files import images
from spreadlets.files.exr_samples import write_samples
from spreadlets.files.tlfr import write_tlfr
from spreadlets.precompute.build.build import build_database
from spreadlets.psf.database_file import SIGNATURE
from spreadlets.reports import database_plot as plot

SHAPE = 4, 6
CAMERA = sp.ThinLens(50.0, 36.0, 2.0, 4.0)


def write_frame(path):
    exr.write_frame(path, sp.Frame(np.ones((*SHAPE, 3)), np.ones(SHAPE)))


def write_deep(path):
    ones = np.ones(SHAPE[0] * SHAPE[1])
    sp.write_deep(path, sp.DeepImage(np.ones(SHAPE, int), np.tile(ones[:, None], 4), ones, ones))


def samples():
    shape = *SHAPE, 1
    pairs = np.zeros((*shape, 2))
    return sp.SampleBuffer(np.ones((*shape, 3)), np.ones(shape), pairs, pairs, np.zeros(shape))


def plot_database(path):
    with pytest.MonkeyPatch.context() as patched, sp.open_database("simplelens") as database:
        patched.setattr(plot, "N_WORST", 1)  # takes a third of the time
        plot.plot_database(database, path, lambda cell, pose, scale: np.ones((9, 9, 1)))


WRITERS = {
    "image.exr": lambda path: images.write_image(path, np.ones((*SHAPE, 4))),
    "frame.exr": write_frame,
    "deep.exr": write_deep,
    "picture.png": lambda path: images.write_png(path, np.ones((*SHAPE, 3))),
    "samples.exr": lambda path: write_samples(path, samples()),
    "samples.tlfr": lambda path: write_tlfr(path, samples(), camera=CAMERA),
    "plot.png": plot_database,
    "database.h5": lambda path: build_database("simplelens", path, samples=2, max_coc=2.0, jobs=1),
}


@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.parametrize("before", [None, SIGNATURE], ids=["new", "existing"])
def test_a_write_that_fails_at_its_end_leaves_nothing_behind(tmp_path, monkeypatch, name, before):
    if before is not None:
        (tmp_path / name).write_bytes(before)
    finished, plain = [], os.replace

    def fail(source, target):
        if os.path.basename(target) != name:  # cells of a build are stored on its way
            return plain(source, target)
        finished.append(os.path.getsize(source))
        raise OSError("no room")

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(SpreadletsError, match="no room"):
        WRITERS[name](tmp_path / name)
    assert len(finished) == 1 and finished[0] > 0
    left = {path.name: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()}
    assert left == ({} if before is None else {name: before})


def test_a_cell_that_cannot_be_stored_leaves_those_before_it(tmp_path, monkeypatch):
    stored, plain = [], os.replace

    def fail(source, target):
        if len(stored) == 2:
            raise OSError("no room")
        stored.append(os.path.basename(target))
        plain(source, target)

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(SpreadletsError, match="no room"):
        build_database("simplelens", tmp_path / "database.h5", samples=5, max_coc=4.0, jobs=1)
    left = {path.name for path in (tmp_path / "database.h5.parts").iterdir()}
    assert left >= set(stored) and not [name for name in left if name.endswith(".tmp")]
    assert [path.name for path in tmp_path.iterdir()] == ["database.h5.parts"]
