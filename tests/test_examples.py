"""Every public name has an example in its docstring, and each of them runs as it is printed."""

import doctest
import inspect

import pytest

import spreadlets as sp

PUBLIC = sorted(set(sp.__all__) - {"errors", "metrics", "models", "__version__"})
METRICS = [
    f"metrics.{name}" for name in ("compare", "flip", "mae", "psf_l1", "psf_similarity", "psnr", "relmse", "ssim")
]


def public(name):
    found = sp
    for part in name.split("."):
        found = getattr(found, part)
    return found


@pytest.mark.parametrize("name", [*PUBLIC, *METRICS])
def test_example_runs(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    item = public(name)
    tests = [test for test in doctest.DocTestFinder(recurse=False).find(item, name, globs={"sp": sp}) if test.examples]
    assert tests, f"{name} has no example: add a section Examples to its docstring"
    runner = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS)
    report = []
    for test in tests:
        runner.run(test, out=report.append)
    assert not runner.failures, "".join(report)


def test_public_names_are_documented():
    assert all(inspect.getdoc(public(name)) for name in PUBLIC)
