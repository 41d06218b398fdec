"""Global depth layers: between cuts that the frame asks for, or in equal steps of parallax (LKS section 6.2)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import DoubleArray, Image
from spreadlets.parallel import for_bands
from spreadlets.remembered import Remembered
from spreadlets.runtime.label.labels import Labels
from spreadlets.runtime.plan import _layer_kernels
from spreadlets.runtime.plan.cuts import Labelled, best_cuts, find_steps

STRAY_SHARE = 0.002
STRAY_STRETCH = 2.0
"""So small a share of the pixels must not stretch the range of inverse depths by more than this factor: a stray depth
of a millimetre would put all else into one layer. Such pixels go to the first or the last layer."""
RANGE_PIXELS = 1 << 16
"""About so many pixels are looked at to find them."""
N_STEPS = 64
"""Equal steps of parallax between whose borders the cuts are chosen."""

BEHIND_ALL = 1 << 20


class Membership(NamedTuple):
    """The layers of the pixels of one pass.

    Attributes
    ----------
    variant : ndarray of shape (H, W), int32
        Negative where nothing is drawn.
    layer : ndarray of shape (H, W), int32
        Nearer layer of each pixel; behind all layers for a sample that met nothing.
    farther : ndarray of shape (H, W), float32
        Share of the pixel that belongs to the next layer.
    """

    variant: npt.NDArray[np.int32]
    layer: npt.NDArray[np.int32]
    farther: Image


@dataclass(frozen=True)
class Layering:
    """Layers between cuts of ``-1 / depth``, ascending; a thin lens's parallax is proportional to that, as is its CoC.

    Attributes
    ----------
    cuts : tuple of float
        One less than the layers.
    widths : tuple of float
        Width of the transition around each cut, 0 for a hard one.
    """

    cuts: tuple[float, ...] = ()
    widths: tuple[float, ...] = ()

    @property
    def n_layers(self) -> int:
        """Number of layers, empty ones included."""
        return len(self.cuts) + 1

    @property
    def hard(self) -> Layering:
        """The same layers, without transitions."""
        return Layering(self.cuts, (0.0,) * len(self.cuts))

    @classmethod
    def equal(cls, labelled: Sequence[Labelled], n_layers: int, softness: float) -> Layering:
        """Divide the range of depths of some pixels, sets of labels and variants, into equal layers."""
        return cls._of_borders(np.linspace(*_range(labelled), n_layers + 1), softness)

    @classmethod
    def fitted(
        cls, labelled: Sequence[Labelled], most: int, softness: float, lists: Sequence[Labelled] = ()
    ) -> Layering:
        """Cut the range of depths of frames, at most so many layers, where surfaces meet that blur differently.

        Lists of pixels meet the first frame's.
        """
        if most == 1:
            return cls()
        low, high = _range(labelled)
        if not high > low:
            return cls()
        cuts = best_cuts(find_steps(labelled, low, high, N_STEPS, lists), most)
        borders = low + (high - low) / N_STEPS * np.concatenate([[0.0], cuts, [N_STEPS]])
        return cls._of_borders(borders, softness)

    @classmethod
    def _of_borders(cls, borders: DoubleArray, softness: float) -> Layering:
        """Return layers between borders, with transitions as wide as a share of the thinner layer beside each cut."""
        steps = np.diff(borders)
        if not steps.all():
            return cls()
        return cls(tuple(borders[1:-1]), tuple(softness * np.minimum(steps[1:], steps[:-1])))

    def members(self, labels: Labels, variant: npt.NDArray[np.int32]) -> Membership:
        """Find the layers of each pixel."""
        return Membership(variant, *self._assigned(labels.view.depth))

    @cached_property
    def _assigned(self) -> Remembered[tuple[npt.NDArray[np.int32], Image]]:
        """What is hidden is looked for in the same layers as pixels are drawn in."""
        # It must not hold the layers that hold it: what it remembers is large, and is to go when they do.
        return Remembered(partial(_assign, np.array(self.cuts), np.array(self.widths)))


def _assign(cuts: DoubleArray, widths: DoubleArray, depth: Image) -> tuple[npt.NDArray[np.int32], Image]:
    """Return the nearer layer, and the share of the next one, of pixels by their depths (H, W)."""
    layer, farther = np.zeros(depth.shape, np.int32), np.zeros(depth.shape, np.float32)
    if len(cuts):
        for_bands(_layer_kernels.assign_layers, len(layer), depth, cuts, widths, layer, farther)
    return layer, farther


def _range(labelled: Sequence[Labelled]) -> tuple[float, float]:
    """Return the range of ``-1 / depth`` of the drawn pixels, without a few that lie far off."""
    bounds = [np.empty((len(variant), 2), np.float64) for _, variant in labelled]
    for (labels, variant), found in zip(labelled, bounds, strict=True):
        for_bands(_layer_kernels.nearness_range, len(found), labels.view.depth, variant, found)
    low, high = min(float(each[:, 0].min()) for each in bounds), max(float(each[:, 1].max()) for each in bounds)
    if not high > low:
        return 0.0, 0.0
    inner = _inner_range(labelled)
    return inner if high - low > STRAY_STRETCH * (inner[1] - inner[0]) > 0.0 else (low, high)


def _inner_range(labelled: Sequence[Labelled]) -> tuple[float, float]:
    """Return the range of ``-1 / depth`` without a small share of the drawn pixels at either end."""
    nearness = np.sort(_nearness(labelled))
    if not len(nearness):
        return 0.0, 0.0
    cut = int(STRAY_SHARE * len(nearness))
    return float(nearness[cut]), float(nearness[len(nearness) - 1 - cut])


def _nearness(labelled: Sequence[Labelled]) -> DoubleArray:
    """Return ``-1 / depth`` of drawn pixels, of about `RANGE_PIXELS` of each set, in a list."""
    found = []
    for labels, variant in labelled:
        step = max(1, math.isqrt(variant.size // RANGE_PIXELS))
        depth = labels.view.depth[::step, ::step]
        found.append(-1.0 / depth[variant[::step, ::step] >= 0].astype(np.float64))
    return np.concatenate(found)
