"""How far a build is, and how long it will still take: for whoever asked, and in a log."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path

from spreadlets.errors import BuildStoppedError

Progress = Callable[[int, int, float | None], None]
"""Called with the numbers of finished and of all cells, and the seconds that are left, None before there is an
estimate."""


class BuildProgress:
    """Counts finished cells and estimates what is left from the share of the expected work that is done.

    Parameters
    ----------
    total : int
        All cells.
    done : int
        Those that were finished before.
    cost : float
        Expected work that is left, in any unit.
    log : path
        A line goes to its end for every finished cell.
    listener : callable, optional
        Told the same.
    """

    def __init__(
        self, total: int, done: int, cost: float, log: str | os.PathLike[str], listener: Progress | None
    ) -> None:
        self._total, self._done, self._cost = total, done, cost
        self._log, self._listener = Path(log), listener
        self._begin = time.monotonic()
        self._worked = 0.0
        self._write(f"{total} cells, {done} of them finished before")
        self._tell()

    @property
    def left_s(self) -> float | None:
        """Seconds that are left, if the rest goes as fast as what was done."""
        if self._worked <= 0.0:
            return None
        return (time.monotonic() - self._begin) * max(self._cost / self._worked - 1.0, 0.0)

    def worked(self, cost: float) -> None:
        """Count work that is done."""
        self._worked += cost

    def finished(self, cell: int, seconds: float) -> None:
        """Count a finished cell that took so long."""
        self._done += 1
        left = self.left_s or 0.0
        self._write(f"cell {cell} took {seconds:.2f} s; {self._done} of {self._total} cells, about {left:.0f} s left")
        self._tell()

    def ended(self, path: Path) -> None:
        """Say that the database is complete."""
        self._write(f"{path} is complete after {time.monotonic() - self._begin:.1f} s")

    def _tell(self) -> None:
        if self._listener is not None:
            self._listener(self._done, self._total, self.left_s)

    def _write(self, text: str) -> None:
        try:
            with open(self._log, "a") as file:
                file.write(f"{time.strftime('%Y-%m-%d %H:%M:%S')}  {text}\n")
        except OSError as error:
            raise BuildStoppedError(
                f"the log {self._log} cannot be written: {error.strerror}; finished cells are kept, and the same "
                "command goes on from there"
            ) from error
