"""Cuts between depth layers: where surfaces meet that blur differently."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import BoolArray, DoubleArray, Image, IntArray
from spreadlets.parallel import for_blocks
from spreadlets.runtime.label.labels import EVERYWHERE, Labels
from spreadlets.runtime.plan import _cut_kernels

MEETING_PIXELS = 1 << 16
"""About so many pixels are looked at, in rows and in columns."""
LEAST_GAIN = 0.005
"""Mean harm, px of blur for each pair of pixels, that a further layer must spare: it costs a pass over its canvas."""
SEAM_PRICE = 1.0
"""Harm, px, of a cut through a surface, for each pair of neighbours that it parts: each hides a little of the other."""

PATH_RADIUS = 1.0 / math.sqrt(6.0)
"""Radius of the disc that, in the mean over both axes, has the variance of a path of length 1."""


Labelled = tuple[Labels, npt.NDArray[np.int32]]
"""Labels, and the number of each pixel's variant."""


class Steps(NamedTuple):
    """What lies in equal steps of depth, and what meets.

    Attributes
    ----------
    filled : ndarray of shape (n,), bool
        Whether there is a pixel in each.
    meetings : ndarray of shape (n, n), float64
        Share of the pairs of pixels that lie in two steps, (nearer, farther); 0 where both are the same.
    seams : ndarray of shape (n + 1,), float64
        The same of the pairs of neighbours on one surface that each border of steps parts.
    coc : ndarray of shape (n,), float64
        Mean CoC radius of each step, px; 0 where it is empty.
    apart : ndarray of shape (n, n), float64
        By how much the paths of the pairs differ in the mean, px.
    """

    filled: BoolArray
    meetings: DoubleArray
    seams: DoubleArray
    coc: DoubleArray
    apart: DoubleArray


def find_steps(
    frames: Sequence[Labelled], low: float, high: float, n_steps: int, lists: Sequence[Labelled] = ()
) -> Steps:
    """Count which steps of depth meet in some pixels.

    Parameters
    ----------
    frames : sequence of (labels, variant)
        Of all pixels of a frame. Variants, (H, W), are negative where nothing is drawn.
    low, high : float
        Range of ``-1 / depth`` that the steps divide; what lies beyond is in the first or the last.
    n_steps : int
    lists : sequence of (labels, variant)
        Of lists of pixels, which meet the first frame's.
    """
    shapes = (2, n_steps), (2, n_steps, n_steps), (n_steps + 1,)
    blocks = [np.zeros((_cut_kernels.COUNTING_BLOCKS, *shape)) for shape in shapes]
    # Thin the rows and columns of large frames.
    stride = max(1, math.isqrt(frames[0][1].size // MEETING_PIXELS))
    steps = low, n_steps / (high - low)
    # Count which steps meet along rows and columns, and which borders part neighbours; take the mean of both.
    positions = [np.empty((-(-len(variant) // stride), variant.shape[1], 3)) for _, variant in frames]
    for (labels, variant), position in zip(frames, positions, strict=True):
        given = _planes(labels, variant), EVERYWHERE, stride, steps, position
        for_blocks(_cut_kernels.count_steps, _cut_kernels.COUNTING_BLOCKS, *given, *blocks)
        columns = tuple(np.ascontiguousarray(each[:, ::stride].swapaxes(0, 1)) for each in given[0])
        upright = columns, EVERYWHERE, 1, steps, np.empty((*columns[0].shape, 3))
        for_blocks(_cut_kernels.count_steps, _cut_kernels.COUNTING_BLOCKS, *upright, *blocks)
    sums, meetings, seams = (0.5 * each.sum(axis=0) for each in blocks)
    # Count which steps meet between the passes.
    for first, second in combinations(positions, 2):
        _add_meetings(first, second, meetings)
    # Count which steps of a list meet those of the frame at the same pixel.
    for labels, variant in lists:
        assert labels.view.places is not None, "only lists have places"
        given = _planes(labels, variant), labels.view.places.at, stride, steps, positions[0]
        _cut_kernels.count_steps(0, 1, *given, sums[None], meetings[None], seams[None])
    n_pairs = max(len(_cut_kernels.DISTANCES) * sums[0].sum(), 1.0)
    coc, apart = sums[1] / np.maximum(sums[0], 1.0), meetings[1] / np.maximum(meetings[0], 1.0)
    return Steps(sums[0] > 0, meetings[0] / n_pairs, seams / n_pairs, coc, apart)


def _planes(labels: Labels, variant: npt.NDArray[np.int32]) -> tuple[Image, Image, Image, npt.NDArray[np.int32]]:
    return labels.view.depth, labels.coc, labels.whole_path, variant


def _add_meetings(first: DoubleArray, second: DoubleArray, meetings: DoubleArray) -> None:
    """Add the pairs of steps of pixels that both are drawn, by their positions."""
    both = (first[..., 0] >= 0) & (second[..., 0] >= 0)
    nearer, farther = (each(first[both, 0], second[both, 0]).astype(np.int64) for each in (np.minimum, np.maximum))
    apart, n_steps = np.hypot(*(first[both, 1:] - second[both, 1:]).T), meetings.shape[1]
    for counted, weights in zip(meetings, (None, apart), strict=True):
        counted += np.bincount(nearer * n_steps + farther, weights, n_steps**2).reshape(counted.shape)


def best_cuts(steps: Steps, most_layers: int) -> DoubleArray:
    """Choose the cuts between layers.

    Parameters
    ----------
    steps : Steps
    most_layers : int

    Returns
    -------
    ndarray of shape (n,), float64
        In steps, ascending, each above 0 and below their number.

    Notes
    -----
    Surfaces that meet within one layer do each other harm: neither hides the other, and one mean stands for both of
    their blurs. A cut through a surface does harm, too. The partition with least harm, for each number of layers,
    follows from the best ones of what lies before its last cut (dynamic programming). A layer more is taken while it
    spares `LEAST_GAIN`.
    """
    n = len(steps.coc)
    total = np.zeros((n + 1, n + 1))
    total[1:, 1:] = (steps.meetings * _harm(steps)).cumsum(axis=0).cumsum(axis=1)
    diagonal = np.diag(total)
    # cost[i, j] is that of a layer of steps i to j.
    cost = np.triu(diagonal[None, :] - total - total.T + diagonal[:, None]) + np.tril(
        np.full((n + 1, n + 1), np.inf), -1
    )
    least, cuts = cost[0], [np.zeros((n + 1, 0), np.int64)]
    while len(cuts) < most_layers:
        sums = (least + SEAM_PRICE * steps.seams)[:, None] + cost
        last = sums.argmin(axis=0)
        fewer = least
        least = sums[last, np.arange(n + 1)]
        if fewer[n] - least[n] < LEAST_GAIN:
            break
        cuts.append(np.concatenate([cuts[-1][last], last[:, None]], axis=1))
    found = np.unique(cuts[-1][n])
    return _amid_empty(found[(found > 0) & (found < n)], steps.filled)


def _amid_empty(cuts: IntArray, filled: BoolArray) -> DoubleArray:
    """Move cuts to the middle of the empty steps around them."""
    places = np.flatnonzero(filled)
    behind = np.searchsorted(places, cuts)
    return np.asarray(0.5 * (places[behind - 1] + 1 + places[behind]), np.float64)


def _harm(steps: Steps) -> DoubleArray:
    """Return how much two steps in one layer harm each other, px: more where one is sharp and the other wide.

    What counts is how their CoC radii differ; or their paths where they meet, in a frame that these blur more
    differently.
    """
    apart = np.abs(steps.coc[:, None] - steps.coc)
    along = PATH_RADIUS * np.where(np.eye(len(steps.coc)), 0.0, steps.apart)
    sharper = np.minimum(*np.abs(np.broadcast_arrays(steps.coc[:, None], steps.coc)))
    if along.max() > apart.max():
        apart, sharper = along, np.zeros_like(along)
    return np.asarray(apart**2 / (1.0 + apart + sharper), np.float64)
