"""Databases of an aperture of one's own, built as frames need them and kept in this user's cache.

A database holds only the spreadlets that have been asked for; what a frame needs besides is added. Its name tells the
model and all of its settings, so that equal apertures share one, whoever asks.
"""

from __future__ import annotations

import hashlib
import json
import os
import zipfile
import zlib
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import platformdirs
from filelock import FileLock

from spreadlets.files.atomic import atomic_path
from spreadlets.models import Combined, Model, SimpleLens, Stylized
from spreadlets.psf.database import Database, open_database
from spreadlets.psf.model import PsfGrid
from spreadlets.psf.spreadlet import Spreadlet

if TYPE_CHECKING:
    from spreadlets.precompute.models.exact_cache import CachedPsfs, Key

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
    # With an aperture that differs from place to place, motion is drawn in steps.
    return Combined(**shape) if moving and not shape.get("cats_eye_radial") else SimpleLens(**shape)


class BokehCache:
    """The database of a model in this user's cache.

    Parameters
    ----------
    model : Model
    progress : callable, optional
        Told the numbers of what is built and of all.
    """

    def __init__(self, model: Model, progress: Progress | None = None) -> None:
        from spreadlets.precompute.models.grids import model_grid

        self.model, self.progress = model, progress
        self._grid = model_grid(model.name, **model.options())
        self.path = cache_folder() / f"{model.name}-{_fingerprint(self._grid)}.h5"
        self._n_stored = 0

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

    def recall(self) -> None:
        """Take the PSFs of highlights that were made before for this model."""
        exact = self._exact()
        if exact is not None:
            stored = _read_psfs(self._psf_file)
            exact.keep(stored)
            self._n_stored = len(stored)

    def store(self) -> None:
        """Store the PSFs of highlights for the next run, if there are new ones."""
        exact = self._exact()
        psfs = exact.known() if exact is not None else {}
        if len(psfs) > self._n_stored:
            self._n_stored = len(psfs)
            with self._locked():
                _write_psfs(self._psf_file, psfs)

    def _exact(self) -> CachedPsfs | None:
        from spreadlets.precompute.models.exact_cache import CachedPsfs
        from spreadlets.precompute.models.registry import exact_psf

        exact = exact_psf(self._grid.model)
        return exact if isinstance(exact, CachedPsfs) else None

    @property
    def _psf_file(self) -> Path:
        return self.path.with_suffix(".npz")

    def _locked(self) -> FileLock:
        self.path.parent.mkdir(parents=True, exist_ok=True)
        return FileLock(self.path.with_suffix(".lock"))

    def _build(self, places: Iterable[tuple[int, int]], *, extend: bool) -> None:
        from spreadlets.precompute.build.build import build_database

        # It is waited for; what is added is made as what is there.
        options = {} if extend else {"sparsifier": "quick", **self.model.options()}
        build_database(
            self.model.name, self.path, only=places, extend=extend, judge=False, progress=self.progress, **options
        )


def cache_folder() -> Path:
    """Return where the databases of apertures are kept."""
    return Path(os.environ.get(FOLDER) or platformdirs.user_cache_path("spreadlets", appauthor=False) / "bokeh")


def _fingerprint(grid: PsfGrid) -> str:
    """Return what tells a model with its cells and settings from all others."""
    from spreadlets.precompute.models.grids import ALGORITHM_VERSION

    axes = [[axis.name, axis.maximum, axis.power, axis.floor] for axis in grid.model.axes]
    content = [ALGORITHM_VERSION, grid.model.name, grid.shape, axes, dict(grid.model.settings)]
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:24]


def _make_room(kept: Path) -> None:
    """Delete what has not been used for the longest, while all of it takes more than `MOST_BYTES`."""
    files = sorted(kept.parent.glob("*.h5"), key=lambda file: file.stat().st_mtime)
    sizes = {file: sum(each.stat().st_size for each in file.parent.glob(f"{file.stem}.*")) for file in files}
    for file in files:
        if sum(sizes.values()) <= MOST_BYTES:
            return
        if file != kept:
            del sizes[file]
            for each in file.parent.glob(f"{file.stem}.*"):
                each.unlink(missing_ok=True)


def _write_psfs(path: Path, psfs: Mapping[Key, Spreadlet]) -> None:
    """Store PSFs: keys, and the points of each as they are, so that the next run draws the same picture."""
    points = list(psfs.values())
    with atomic_path(path, ".npz") as temporary, open(temporary, "wb") as file:
        np.savez_compressed(
            file,
            coordinate=np.array([key[0] for key in psfs]),
            angle=np.array([key[1] for key in psfs]),
            side=np.array([key[2] for key in psfs]),
            count=np.array([each.n_points for each in points]),
            offset=np.concatenate([each.offset_rc for each in points]),
            light=np.concatenate([each.value for each in points]),
        )


def _read_psfs(path: Path) -> dict[Key, Spreadlet]:
    """Return the PSFs of a file; none if there is no such file, or not a whole one."""
    try:
        with open(path, "rb") as file, np.load(file, allow_pickle=False) as stored:
            keys = [
                (tuple(map(float, place)), float(angle), int(side))
                for place, angle, side in zip(stored["coordinate"], stored["angle"], stored["side"], strict=True)
            ]
            ends = np.cumsum(stored["count"])[:-1]
            offsets, lights = np.split(stored["offset"], ends), np.split(stored["light"], ends)
            return {
                key: Spreadlet(offset, light, True) for key, offset, light in zip(keys, offsets, lights, strict=True)
            }
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error):
        return {}
