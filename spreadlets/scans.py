"""Questions about whole arrays, answered by all threads: NumPy takes one, and a pass over memory for each step."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from spreadlets import _scan_kernels
from spreadlets.arrays import FloatArray, Image
from spreadlets.parallel import for_bands


class Alphas(NamedTuple):
    """How many pixels are transparent, in part so, and opaque."""

    nothing: int
    part: int
    whole: int


def holds_anything(array: FloatArray) -> bool:
    """Return whether any value of an array of two or more dimensions is not 0.

    Examples
    --------
    >>> import numpy as np
    >>> from spreadlets.scans import holds_anything
    >>> holds_anything(np.zeros((2, 3, 2), np.float32))
    False
    """
    if not array.size:
        return False
    rows = np.ascontiguousarray(array, np.float32).reshape(len(array), -1)
    return any(for_bands(_scan_kernels.holds_anything, len(rows), rows))


def count_alphas(radiance: Image) -> Alphas:
    """Return how many pixels of colours (H, W, 4) are transparent, in part so, and opaque."""
    counts = np.empty((len(radiance), 3), np.int64)
    for_bands(_scan_kernels.count_alphas, len(counts), radiance, counts)
    return Alphas(*map(int, counts.sum(axis=0)))


def visible_range(depth: Image, radiance: Image, limit: float) -> tuple[float, float]:
    """Return the least and the largest depth (H, W) of what colours (H, W, 4) show nearer than a limit.

    Infinity and 0, if there is nothing.
    """
    ends = np.empty((len(depth), 2), np.float32)
    for_bands(_scan_kernels.visible_range, len(ends), depth, radiance, limit, ends)
    return float(ends[:, 0].min(initial=np.inf)), float(ends[:, 1].max(initial=0.0))
