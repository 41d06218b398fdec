"""Partitions of the axis of CoC, of constant worst-case filter energy (SLR section 6.2)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import FloatArray
from spreadlets.runtime.sheared.samples import Samples

BIN = 0.5
"""px of CoC: edges of partitions and ranges of layers are multiples of it."""
PER_SIDE = 15
"""Partitions in front of focus, and as many behind."""
LEAST_PER_SIDE, MOST_PER_SIDE = 2, 120
"""A bin and the rest; and as many as a byte numbers on both sides, with some to spare."""
BEHIND = -1
"""Index of the extra, last partition: samples that met nothing. They are a hole in all others."""

_STEPS = 60
"""Halvings of the interval in which the step of 1 / CoC is sought: down to the last bit."""


@lru_cache
def edges_behind_focus(per_side: int = PER_SIDE) -> tuple[float, ...]:
    """Return the edges of the partitions behind focus, px of CoC: from 0 to infinity, `per_side` + 1 of them.

    Notes
    -----
    SLR section 6.2: the energy of the sheared filter, ``sigma_x * sigma_u`` of Eq. 17, is by Eqs. 12 and 16 that of
    ``1 / (1 / c_min - 1 / c_max)``, so it is constant where the edges are equal steps of ``1 / c``. Edges are
    multiples of `BIN`, so near focus, where such steps are finer, partitions are single bins. The step is the one that
    makes the number of partitions right.
    """
    low, high = 0.0, 1.0 / BIN
    for _ in range(_STEPS):
        step = 0.5 * (low + high)
        low, high = (step, high) if len(_edges(step)) > per_side + 1 else (low, step)
    return _edges(high)


def _edges(step: float) -> tuple[float, ...]:
    """Return the edges from 0 to infinity for a step of 1 / CoC."""
    edges = [0.0, BIN]
    while edges[-1] * step < 1.0:
        farthest = 1.0 / (1.0 / edges[-1] - step)
        edges.append(max(edges[-1] + BIN, BIN * np.floor(farthest / BIN)))
    return (*(float(edge) for edge in edges), np.inf)


@dataclass(frozen=True)
class Partitioning:
    """Intervals of signed CoC, from near to far, and behind them those that met nothing.

    Attributes
    ----------
    edges : tuple of float
        P + 1 increasing values, px, multiples of `BIN`; the outermost are infinite.
    """

    edges: tuple[float, ...]

    @classmethod
    def of_constant_energy(cls, per_side: int = PER_SIDE) -> Partitioning:
        """Return as many partitions on either side of focus, see `edges_behind_focus`."""
        behind = edges_behind_focus(per_side)
        return cls((*(-edge for edge in behind[:0:-1]), *behind))

    @property
    def n_partitions(self) -> int:
        """Number of partitions, with the last one of samples that met nothing."""
        return len(self.edges)

    def of(self, samples: Samples) -> npt.NDArray[np.uint8]:
        """Return the partition of each sample, shape (N,): 0 is nearest."""
        found = np.searchsorted(np.array(self.edges[1:-1], np.float32), samples.coc, side="right").astype(np.uint8)
        found[samples.colour[:, 3] == 0] = self.n_partitions + BEHIND
        return found

    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Return the least and the largest CoC of each partition, px, each of shape (P + 1,)."""
        near, far = np.array(self.edges[:-1], np.float32), np.array(self.edges[1:], np.float32)
        return np.append(near, near[BEHIND]), np.append(far, far[BEHIND])
