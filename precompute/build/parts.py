"""The folder of a build's finished cells: each stored whole or not at all, checked when read, written by one build.

A part is named by a hash of all that its cell depends on, so that whatever of it is there, of this run or of another,
is what the build would compute again.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import socket
import time
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
from filelock import BaseFileLock, FileLock, Timeout

from spreadlets.errors import BuildStoppedError, InvalidParameterError
from spreadlets.precompute.build.work import CellTask
from spreadlets.precompute.models.grids import ALGORITHM_VERSION
from spreadlets.psf.database_file import CellRecord, temporary_path
from spreadlets.psf.model import PsfGrid
from spreadlets.psf.spreadlet import Spreadlet

PART_SUFFIX = ".part"
LOCK_NAME = "lock"
HOLDER_NAME = "holder"
LOG_NAME = "build.log"
DIGEST_BYTES = hashlib.sha256().digest_size

LOCK_ATTEMPTS = 50
"""How often to look again when the folder vanishes while it is being locked: another build is just removing it."""


class Parts:
    """The parts of one build; `open_parts` makes it.

    Parameters
    ----------
    folder : Path
    grid : PsfGrid
        The grid of the cells.
    """

    def __init__(self, folder: Path, grid: PsfGrid) -> None:
        self.folder = folder
        self.removed = False
        self._grid = hashlib.sha256(repr(grid).encode()).hexdigest()

    def path(self, task: CellTask) -> Path:
        """Return where a cell's part lies: its name is a hash of all that the result depends on."""
        facts = (ALGORITHM_VERSION, self._grid, *task[1:])
        return self.folder / (hashlib.sha256(repr(facts).encode()).hexdigest()[:32] + PART_SUFFIX)

    def has(self, task: CellTask) -> bool:
        """Return whether a cell is stored, and undamaged."""
        return _content(self.path(task)) is not None

    def store(self, task: CellTask, records: list[CellRecord]) -> None:
        """Store the records of a cell, whole or not at all.

        Raises
        ------
        BuildStoppedError
            If there is no room, or the folder cannot be written.
        """
        path = self.path(task)
        temporary = path.with_suffix(".tmp")
        content = _packed(records)
        try:
            with open(temporary, "wb") as file:
                file.write(hashlib.sha256(content).digest() + content)
                file.flush()
                os.fsync(file.fileno())
            os.replace(temporary, path)
        except OSError as error:
            with suppress(OSError):
                temporary.unlink(missing_ok=True)
            raise BuildStoppedError(
                f"a finished cell cannot be stored in {self.folder}: {error.strerror or error}; those stored before "
                "are kept, and the same command goes on from there"
            ) from error

    def load(self, task: CellTask) -> list[CellRecord]:
        """Return the records of a stored cell.

        Raises
        ------
        BuildStoppedError
            If the part was removed or damaged since `has` looked.
        """
        content = _content(self.path(task))
        if content is None:
            raise BuildStoppedError(f"{self.path(task)} was removed or changed meanwhile; run the same command again")
        return _unpacked(content)

    def remove(self) -> None:
        """Remove the parts, those of other builds into the same file too, and the folder unless it holds more."""
        for path in self.folder.iterdir():
            if path.suffix in (PART_SUFFIX, ".tmp") or path.name == LOG_NAME:
                path.unlink(missing_ok=True)
        for name in (HOLDER_NAME, LOCK_NAME):
            with suppress(OSError):  # Windows keeps a file that is locked; it goes with the lock
                (self.folder / name).unlink(missing_ok=True)
        with suppress(OSError):
            self.folder.rmdir()
        self.removed = True


@contextmanager
def open_parts(target: Path, grid: PsfGrid) -> Iterator[Parts]:
    """Give the parts of the build of a file, for this process alone; what a killed build left half-written is removed.

    The lock is the system's, on a file in the folder: it ends with the process that holds it, however that ends. Who
    holds it stands in a file beside it.

    Raises
    ------
    BuildStoppedError
        If another process is building the same file; the message says which.
    InvalidParameterError
        If the folder cannot be made.
    """
    folder = target.with_name(target.name + ".parts")
    lock = _locked(folder, target)
    try:
        for stale in (*target.parent.glob(temporary_path(target, "*").name), *folder.glob("*.tmp")):
            stale.unlink(missing_ok=True)
        parts = Parts(folder, grid)
        try:
            yield parts
        finally:
            if not parts.removed and not any(path.suffix == PART_SUFFIX for path in folder.iterdir()):
                parts.remove()
    finally:
        lock.release()
        with suppress(OSError):
            folder.rmdir()


def _locked(folder: Path, target: Path) -> BaseFileLock:
    """Make the folder, and return its lock, taken."""
    lock = FileLock(folder / LOCK_NAME)
    for _ in range(LOCK_ATTEMPTS):
        try:
            # Make the folder and take its lock.
            folder.mkdir(exist_ok=True)
            lock.acquire(timeout=0)
            # A build that ended meanwhile has removed the file that is locked: then once more.
            if (folder / LOCK_NAME).exists():
                _sign(folder)
                return lock
            lock.release()
        except Timeout:
            raise BuildStoppedError(
                f"another build is writing {str(target)!r} ({_holder(folder)}); wait for it, or choose another output"
            ) from None
        except FileNotFoundError:
            if not target.parent.is_dir():
                raise InvalidParameterError(f"cannot write {str(target)!r}: there is no such folder") from None
        except OSError as error:
            raise InvalidParameterError(
                f"cannot write beside the database: {error.strerror}: {str(folder)!r}; name another place with -o"
            ) from error
    raise BuildStoppedError(f"other builds keep writing {str(target)!r}; wait for them, or choose another output")


def _sign(folder: Path) -> None:
    """Say beside the lock who holds it."""
    since = time.strftime("%Y-%m-%d %H:%M:%S")
    with suppress(OSError):  # a full disk must not keep a build from saying so itself
        (folder / HOLDER_NAME).write_text(f"process {os.getpid()} on {socket.gethostname()}, since {since}")


def _holder(folder: Path) -> str:
    with suppress(OSError):
        return (folder / HOLDER_NAME).read_text()[:200] or "it has just begun"
    return "it has just begun"


def _packed(records: list[CellRecord]) -> bytes:
    arrays = {
        "direction": np.array([record.angle for record in records]),
        "count": np.array([record.spreadlet.n_points for record in records]),
        "direct": np.array([record.spreadlet.direct for record in records]),
        "offset_rc": np.concatenate([record.spreadlet.offset_rc for record in records]),
        "value": np.concatenate([record.spreadlet.value for record in records]),
        "statistics": np.array(json.dumps([dict(record.statistics) for record in records])),
    }
    content = io.BytesIO()
    np.savez(content, allow_pickle=False, **arrays)
    return content.getvalue()


def _content(path: Path) -> bytes | None:
    """Return what a part holds; None if there is none, or it is not what was written."""
    try:
        stored = path.read_bytes()
    except OSError:
        return None
    digest, content = stored[:DIGEST_BYTES], stored[DIGEST_BYTES:]
    return content if hashlib.sha256(content).digest() == digest else None


def _unpacked(content: bytes) -> list[CellRecord]:
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as part:
            start = np.concatenate([[0], np.cumsum(part["count"])])
            offset_rc, value, direct = part["offset_rc"], part["value"], part["direct"]
            statistics = json.loads(str(part["statistics"]))
            return [
                CellRecord(
                    float(angle),
                    Spreadlet(offset_rc[start[i] : start[i + 1]], value[start[i] : start[i + 1]], bool(direct[i])),
                    statistics[i],
                )
                for i, angle in enumerate(part["direction"])
            ]
    except (ValueError, KeyError, zipfile.BadZipFile) as error:
        raise BuildStoppedError(f"a stored cell is not readable: {error}; remove the folder of parts") from error
