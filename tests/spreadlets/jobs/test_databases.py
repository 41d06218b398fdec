"""Databases that a process keeps open."""

import os
import shutil

import pytest

from spreadlets.errors import InvalidDatabaseError
from spreadlets.jobs import databases


@pytest.fixture(autouse=True)
def none_open(monkeypatch):
    kept = {}
    monkeypatch.setattr(databases, "_opened", kept)
    yield kept
    for database in kept.values():
        database.close()


def test_a_database_is_opened_once_by_whatever_name_and_anew_when_it_has_changed(small_combined_path, tmp_path):
    path = tmp_path / "a.h5"
    shutil.copy(small_combined_path, path)
    first = databases.kept_database(str(path))
    assert databases.kept_database(os.path.relpath(path)) is first
    shutil.copy2(path, tmp_path / "b.h5")  # with its time, as tools that synchronise do
    (tmp_path / "b.h5").replace(path)
    assert databases.kept_database(str(path)) is not first
    with pytest.raises(InvalidDatabaseError, match="no database"):
        databases.kept_database("nothing")


def test_the_ones_not_used_for_the_longest_are_closed(small_combined_path, tmp_path, monkeypatch, none_open):
    monkeypatch.setattr(databases, "MOST_OPEN", 2)
    paths = [str(tmp_path / f"{number}.h5") for number in range(3)]
    for path in paths:
        shutil.copy(small_combined_path, path)
    first, second = (databases.kept_database(path) for path in paths[:2])
    databases.kept_database(paths[0])
    databases.kept_database(paths[2])
    assert len(none_open) == 2 and databases.kept_database(paths[0]) is first
    assert databases.kept_database(paths[1]) is not second
