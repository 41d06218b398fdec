"""How often a process looks for garbage: what is imported and made for a frame is hardly ever any."""

from __future__ import annotations

import atexit
import gc

ALLOCATIONS_BETWEEN_COLLECTIONS = 100_000
"""Looking as often as Python does takes a tenth of a short command's time."""


def collect_rarely() -> None:
    """Let this process look for garbage less often, and not at its end; it is one of this package's own, not a host's.

    What a process holds goes with it anyway: taking it apart piece by piece takes another third of a short command's
    time.
    """
    gc.set_threshold(ALLOCATIONS_BETWEEN_COLLECTIONS)
    atexit.register(gc.freeze)
