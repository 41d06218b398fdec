"""A small build, and how its databases are compared."""

import json

import h5py
import numpy as np

CASE = {"samples": 12, "max_coc": 4.0, "max_motion": 4.0, "rays": 10_000, "seed": 2, "sparsifier": "quick"}


def contents(path):
    """Everything in a database but the time that it took."""
    with h5py.File(path) as file:
        tables = {name: file[name][...] for name in file if name != "provenance"}
        provenance = json.loads(file["provenance"][...].tobytes()) | {"build_s": 0}
        return tables | dict(file.attrs), provenance


def assert_same(one, other):
    (a, b), (p, q) = zip(contents(one), contents(other), strict=True)
    assert p == q and a.keys() == b.keys()
    for name in a:
        assert np.array_equal(a[name], b[name]), name


class Stop(Exception):
    """What `stop_after` raises."""


def stop_after(cells):
    """Return a listener that breaks a build off when so many cells are finished."""

    def report(done, total, left_s):
        if done == cells:
            raise Stop

    return report
