"""The clock of a run: wall time of each step, with compilation counted apart."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numba.core.event

STEPS = ("read", "plan", "splat", "integrate", "composite", "write")


class Clock:
    """Wall time of each named step, seconds, and the share of it spent in compiling."""

    def __init__(self) -> None:
        self.time_s: dict[str, float] = {}
        self.compile_s = 0.0

    @contextmanager
    def step(self, name: str) -> Iterator[None]:
        """Add the time of the enclosed block to a step; compilation is counted apart."""
        begin = time.perf_counter()
        recorder = numba.core.event.RecordingListener()  # type: ignore[no-untyped-call]
        with numba.core.event.install_listener("numba:compile", recorder):
            yield
        compiled = _compile_time(recorder)
        self.compile_s += compiled
        elapsed = time.perf_counter() - begin - compiled
        self.time_s[name] = self.time_s.get(name, 0.0) + elapsed

    def times(self) -> dict[str, float]:
        """Return the seconds of every step, and of all together."""
        time_s = {name: self.time_s.get(name, 0.0) for name in STEPS}
        return time_s | {"total": sum(time_s.values())}


def _compile_time(recorder: Any) -> float:
    """Sum the outermost compile events of a recorder, seconds."""
    total, depth, begin = 0.0, 0, 0.0
    for stamp, event in recorder.buffer:
        if event.is_start:
            begin = stamp if depth == 0 else begin
            depth += 1
        else:
            depth -= 1
            total += stamp - begin if depth == 0 else 0.0
    return total
