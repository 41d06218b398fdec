"""Databases that a process keeps open: each is read once, however many images are made from it."""

from __future__ import annotations

import os
import threading

from spreadlets.psf.database import Database, open_database, resolve, shared_database

MOST_OPEN = 8
"""Databases that are kept open: more than a shot uses; those that are not asked for the longest go first."""

_opened: dict[tuple[object, ...], Database] = {}
_lock = threading.Lock()


def kept_database(name: str) -> Database:
    """Return a database, which stays open; a file that has changed meanwhile is opened anew.

    Parameters
    ----------
    name : str
        A path, or a shipped name.

    Raises
    ------
    InvalidDatabaseError
        As `open_database` does.
    """
    if (shared := shared_database(name)) is not None:
        return shared
    status = os.stat(resolve(name))
    key = (status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns)
    with _lock:
        if key not in _opened:
            _opened[key] = open_database(name)
        _opened[key] = _opened.pop(key)
        while len(_opened) > MOST_OPEN:
            _opened.pop(next(iter(_opened))).close()
        return _opened[key]
