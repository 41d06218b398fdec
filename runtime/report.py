"""What a run says of itself: times, memory, and the figures of its plans."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any

from spreadlets.psf.database import Database
from spreadlets.runtime.clock import Clock
from spreadlets.runtime.memory import peak_rss_mb
from spreadlets.runtime.plan.plan import Drawing, Plan
from spreadlets.runtime.splat.passes import Canvas

VECTORS, CAMERA, NOTHING_MOVES = "vectors", "camera", "none"
"""Where motion comes from: the vectors of what is drawn, or the move of the camera; or nothing moves."""


class Record(Mapping[str, Any]):
    """A dataclass whose fields can be read by their names, too, as those of a dict."""

    def __getitem__(self, name: str) -> Any:
        if name not in self.__dataclass_fields__:  # type: ignore[attr-defined]
            raise KeyError(name)
        return getattr(self, name)

    def __iter__(self) -> Iterator[str]:
        return iter(self.__dataclass_fields__)  # type: ignore[attr-defined]

    def __len__(self) -> int:
        return len(self.__dataclass_fields__)  # type: ignore[attr-defined]

    def to_dict(self) -> dict[str, Any]:
        """Return the fields as a dict, all the way down."""
        return asdict(self)  # type: ignore[call-overload, no-any-return]


@dataclass(frozen=True)
class PlanFigures(Record):
    """What was drawn, and what was not needed.

    Attributes
    ----------
    layers : int
        Depth layers that hold something.
    cells_used, cells_total : int
        Cells of the database that the pixels need, and all.
    pixels_sparse, pixels_dense : int
        Pixels drawn by spreadlets, and in full.
    pixels_merged : int
        Pixels that were drawn as blocks.
    pixels_clamped : int
        Fireflies that were dimmed.
    pixels_skipped : int
        Pixels that contribute nothing.
    points_splatted : int
        Points drawn, of all splats.
    error_bound : float
        Bound on the change of the displayed image by drawing blocks of pixels as one.
    padding_px : int
        How far beyond the frame there was something to compute.
    left_out : list of str
        What the frame did not need.
    motion_from : str
        What says how the picture moves: its own ``"vectors"``; or, as it has none, the move of the ``"camera"``, as if
        nothing else moved; or ``"none"``.
    """

    layers: int
    cells_used: int
    cells_total: int
    pixels_sparse: int
    pixels_dense: int
    pixels_merged: int
    pixels_clamped: int
    pixels_skipped: int
    points_splatted: int
    error_bound: float
    padding_px: int
    left_out: list[str]
    motion_from: str


class Tally:
    """The figures of a run, over all its plans."""

    def __init__(self) -> None:
        self.cells_used: set[int] = set()
        self.pixels_skipped = 0
        self.left_out: list[list[str]] = []
        self.counts: Counter[str] = Counter()
        self.error_bound = 0.0
        self.layers = 0
        self.padding = 0
        self.clamped = 0
        self.motion_from = NOTHING_MOVES

    def add_plan(self, plan: Plan) -> None:
        """Note what a plan needs."""
        self.cells_used |= plan.cells_used
        self.pixels_skipped += plan.pixels_skipped
        self.left_out.append(plan.left_out)

    def add_drawing(self, drawing: Drawing, n_layers: int) -> None:
        """Note what was drawn, in how many layers."""
        self.counts.update(drawing.counts())
        self.error_bound = max(self.error_bound, drawing.error_bound)
        self.layers += n_layers

    def add_canvas(self, canvas: Canvas, shape: tuple[int, ...]) -> None:
        """Note how far beyond the frame there was something to compute."""
        behind = canvas.top + canvas.rows - shape[0], canvas.left + canvas.cols - shape[1]
        self.padding = max(self.padding, -canvas.top, -canvas.left, *behind)


@dataclass(frozen=True)
class Report(Record):
    """What a run says of itself, by the names of the command line's JSON output.

    Attributes
    ----------
    time_s : dict
        Seconds of each step of `runtime.clock.STEPS`, and ``total``, without those of compilation.
    compile_s : float
        Seconds of compilation.
    peak_rss_mb : float
        Largest resident memory of the process so far, MB.
    plan : Record or dict
        What was drawn and what was left out: a `PlanFigures`, or what another method tells of its set-up.
    """

    time_s: dict[str, float]
    compile_s: float
    peak_rss_mb: float
    plan: PlanFigures | dict[str, Any]

    @classmethod
    def of(cls, clock: Clock, plan: PlanFigures | dict[str, Any]) -> Report:
        """Return the report of a run that is over."""
        return cls(clock.times(), clock.compile_s, peak_rss_mb(), plan)


def plan_figures(tally: Tally, database: Database) -> PlanFigures:
    """Sum the figures of all plans of a run."""
    first, *others = tally.left_out
    return PlanFigures(
        **tally.counts,
        layers=tally.layers,
        cells_used=len(tally.cells_used),
        cells_total=database.n_cells,
        pixels_clamped=tally.clamped,
        pixels_skipped=tally.pixels_skipped,
        error_bound=tally.error_bound,
        padding_px=tally.padding,
        left_out=[name for name in first if all(name in each for each in others)],
        motion_from=tally.motion_from,
    )
