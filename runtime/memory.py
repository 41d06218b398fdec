"""How much memory a process has taken, on every system."""

from __future__ import annotations

import math
import sys

try:
    import resource
except ImportError:  # Windows
    resource = None  # type: ignore[assignment]

BYTES_PER_MB = 1 << 20
UNIT_BYTES = 1 if sys.platform == "darwin" else 1024
"""What `ru_maxrss` counts: bytes on macOS, else kibibytes."""


def peak_rss_mb() -> float:
    """Return the most memory that this process has held so far, MiB.

    Returns
    -------
    float
        The peak of the resident set; NaN where the system does not tell.
    """
    if resource is not None:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * UNIT_BYTES / BYTES_PER_MB
    try:
        import psutil
    except ImportError:
        return math.nan
    return float(psutil.Process().memory_info().peak_wset) / BYTES_PER_MB
