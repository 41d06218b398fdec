"""Databases of an aperture of one's own, built as frames need them and kept in this user's cache.

A database holds only the spreadlets that have been asked for; what a frame needs besides is added. Its name tells the
model and all of its settings, so that equal apertures share one, whoever asks.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import platformdirs
from filelock import FileLock

from spreadlets.models import Combined, Model, SimpleLens, Stylized
from spreadlets.psf.database import Database, open_database
from spreadlets.psf.model import PsfGrid

FOLDER = "SPREADLETS_BOKEH_CACHE"
"""Environment variable that names another folder for the cache."""
MOST_BYTES = 1 << 28
"""Room for the cache, 256 MB, several hundred apertures; those not used for the longest go first."""

Progress = Callable[..., None]


def bokeh_model(*, moving: bool, kernel: str | None = None, **shape: Any) -> Model:
    """Return the model of an aperture.

    Parameters
    ----------
    moving : bool
        Whether there is motion to be blurred.
    kernel : str, optional
        An image of the PSF, PNG, which takes the place of a shape; motion is then left out.
    shape
        See `spreadlets.models.SimpleLens`; None stands for a round aperture.

    Examples
    --------
    >>> from spreadlets.bokeh import bokeh_model
    >>> bokeh_model(moving=True, blades=6).options()
    {'blades': 6}
    """
    if kernel is not None:
        return Stylized(image=kernel)
    return Combined(**shape) if moving else SimpleLens(**shape)


class BokehCache:
    """The database of a model in this user's cache.

    Parameters
    ----------
    model : Model
    progress : callable, optional
        Told the numbers of what is built and of all.
    """

    def __init__(self, model: Model, progress: Progress | None = None) -> None:
        from spreadlets.precompute.build.build import model_grid

        self.model, self.progress = model, progress
        self.path = cache_folder() / f"{model.name}-{_fingerprint(model_grid(model.name, **model.options()))}.h5"

    def open(self) -> Database:
        """Return the database as it is; without any spreadlet, if it is new."""
        with self._locked():
            if not self.path.is_file():
                self._build((), extend=False)
            os.utime(self.path)
            return open_database(self.path)

    def add(self, places: Iterable[tuple[int, int]]) -> None:
        """Build what is missing of some (cell, pose) pairs."""
        with self._locked():
            self._build(places, extend=self.path.is_file())
            _make_room(self.path)

    def _locked(self) -> FileLock:
        self.path.parent.mkdir(parents=True, exist_ok=True)
        return FileLock(self.path.with_suffix(".lock"))

    def _build(self, places: Iterable[tuple[int, int]], *, extend: bool) -> None:
        from spreadlets.precompute.build.build import build_database

        options = {} if extend else self.model.options()
        build_database(
            self.model.name, self.path, only=places, extend=extend, judge=False, progress=self.progress, **options
        )


def cache_folder() -> Path:
    """Return where the databases of apertures are kept."""
    return Path(os.environ.get(FOLDER) or platformdirs.user_cache_path("spreadlets", appauthor=False) / "bokeh")


def _fingerprint(grid: PsfGrid) -> str:
    """Return what tells a model with its cells and settings from all others."""
    from spreadlets.precompute.build.work import ALGORITHM_VERSION

    axes = [[axis.name, axis.maximum, axis.power, axis.floor] for axis in grid.model.axes]
    content = [ALGORITHM_VERSION, grid.model.name, grid.shape, axes, dict(grid.model.settings)]
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:24]


def _make_room(kept: Path) -> None:
    """Delete the databases that have not been used for the longest, while they take more than `MOST_BYTES`."""
    files = sorted(kept.parent.glob("*.h5"), key=lambda file: file.stat().st_mtime)
    total = sum(file.stat().st_size for file in files)
    for file in files:
        if total <= MOST_BYTES:
            return
        if file != kept:
            total -= file.stat().st_size
            file.unlink(missing_ok=True)
            file.with_suffix(".lock").unlink(missing_ok=True)
