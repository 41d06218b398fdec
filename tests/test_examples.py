"""Every public name has an example in its docstring, and each of them runs as it is printed."""

import doctest
import inspect

import pytest

import spreadlets as sp

MODULES = {"metrics", "models"}
"""Public modules whose names are public, too."""

OPTIONS = doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS


def defined_in(name):
    """Public functions and classes of a public module."""
    module = getattr(sp, name)
    items = inspect.getmembers(module, lambda item: inspect.isfunction(item) or inspect.isclass(item))
    return [f"{name}.{key}" for key, item in items if item.__module__ == module.__name__ and not key.startswith("_")]


PUBLIC = sorted(set(sp.__all__) - MODULES - {"errors", "__version__"}) + [
    n for m in sorted(MODULES) for n in defined_in(m)
]


@pytest.mark.parametrize("name", PUBLIC)
def test_example_runs(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    item = sp
    for part in name.split("."):
        item = getattr(item, part)
    example = doctest.DocTestParser().get_doctest(inspect.getdoc(item) or "", {"sp": sp}, name, None, None)
    assert example.examples, f"{name} has no example: its docstring needs a section Examples"
    printed = []
    failures, _ = doctest.DocTestRunner(optionflags=OPTIONS).run(example, out=printed.append)
    assert not failures, "".join(printed)
