"""What was measured, a row for each contender on each frame, and the Pareto front of rows."""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

METRICS = {"ssim": 1, "flip": -1, "psnr": 1, "relmse": -1}
"""The errors, and whether more is better (1) or less (-1)."""


@dataclass
class Row:
    """What one contender came to on one frame.

    Attributes
    ----------
    frame, task, source, method, knob : str
        See `spreadlets.reports.bench.contenders.Contender`.
    ssim, flip, psnr, relmse : float
        NaN where it was not run.
    runs_s : list of float
        Seconds of each timed run.
    note : str
        Why there is no figure.
    """

    frame: str
    task: str
    source: str
    method: str
    knob: str
    ssim: float = math.nan
    flip: float = math.nan
    psnr: float = math.nan
    relmse: float = math.nan
    runs_s: list[float] = field(default_factory=list)
    note: str = ""

    @property
    def key(self) -> str:
        """A name of its own."""
        return "/".join((self.frame, self.task, self.source, self.method, self.knob))

    @property
    def name(self) -> str:
        """Method and knob, for people."""
        return self.method if self.knob == "default" else f"{self.method}, {self.knob}"

    @property
    def seconds(self) -> float:
        """The median of the runs, NaN if there are none."""
        return statistics.median(self.runs_s) if self.runs_s else math.nan

    @property
    def spread(self) -> tuple[float, float]:
        """The fastest and the slowest run, s."""
        return (min(self.runs_s), max(self.runs_s)) if self.runs_s else (math.nan, math.nan)

    @property
    def measured(self) -> bool:
        """Whether there are error and time."""
        return bool(self.runs_s) and not math.isnan(self.ssim)


def front(rows: Iterable[Row], metric: str) -> list[Row]:
    """Return the rows than which none is both faster and better, by rising time.

    Parameters
    ----------
    rows : iterable of Row
        Of one frame, task and source; those without error or time are left out.
    metric : str
        A name of `METRICS`.
    """
    sign = METRICS[metric]
    best, kept = -math.inf, []
    for row in sorted(
        (row for row in rows if row.measured), key=lambda row: (row.seconds, -sign * getattr(row, metric))
    ):
        if sign * getattr(row, metric) > best:
            best = sign * getattr(row, metric)
            kept.append(row)
    return kept


def panels(rows: Sequence[Row]) -> dict[tuple[str, str, str], list[Row]]:
    """Return the rows by what can be compared: frame, task and source."""
    found: dict[tuple[str, str, str], list[Row]] = {}
    for row in rows:
        if row.source != "render":
            found.setdefault((row.frame, row.task, row.source), []).append(row)
    return found
