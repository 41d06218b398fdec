"""What a run says of itself: times, memory, and the figures of its plans."""

from __future__ import annotations

import resource
from typing import Any

from spreadlets.psf.database import Database
from spreadlets.runtime.clock import Clock
from spreadlets.runtime.plan.plan import Plan
from spreadlets.runtime.splat.passes import Canvas


class Tally:
    """The figures of a run, over all its plans."""

    def __init__(self) -> None:
        self.plans: list[Plan] = []
        self.layers = 0
        self.padding = 0
        self.clamped = 0

    def add_plan(self, plan: Plan, n_layers: int) -> None:
        """Add a plan and how many layers it drew."""
        self.plans.append(plan)
        self.layers += n_layers

    def add_canvas(self, canvas: Canvas, shape: tuple[int, ...]) -> None:
        """Note how far beyond the frame there was something to compute."""
        behind = canvas.top + canvas.rows - shape[0], canvas.left + canvas.cols - shape[1]
        self.padding = max(self.padding, -canvas.top, -canvas.left, *behind)


def make_report(tally: Tally, database: Database, clock: Clock) -> dict[str, Any]:
    """Gather the plans' figures under the names of the command line's JSON output."""
    plans = tally.plans
    counts = [plan.counts() for plan in plans]
    left_out = set.intersection(*(set(plan.left_out) for plan in plans))
    figures: dict[str, Any] = {name: sum(count[name] for count in counts) for name in counts[0]}
    figures |= {
        "layers": tally.layers,
        "cells_used": len(set.union(*(plan.cells_used for plan in plans))),
        "cells_total": database.n_cells,
        "pixels_clamped": tally.clamped,
        "pixels_skipped": sum(plan.pixels_skipped for plan in plans),
        "error_bound": max(plan.error_bound for plan in plans),
        "padding_px": tally.padding,
        "left_out": [name for name in plans[0].left_out if name in left_out],
    }
    return {
        "time_s": clock.times(),
        "compile_s": clock.compile_s,
        "peak_rss_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "plan": figures,
    }
