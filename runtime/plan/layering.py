"""Global depth layers: equal steps of parallax, hard or soft (LKS section 6.2)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import Image
from spreadlets.parallel import for_bands
from spreadlets.runtime.label.labels import Labels
from spreadlets.runtime.options import DEFAULT_SOFTNESS
from spreadlets.runtime.plan import _layer_kernels

STRAY_SHARE = 0.002
STRAY_STRETCH = 2.0
"""So small a share of the pixels must not stretch the range of inverse depths by more than this factor: a stray depth
of a millimetre would put all else into one layer. Such pixels go to the first or the last layer."""
RANGE_PIXELS = 1 << 16
"""About so many pixels are looked at to find them."""

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
    """Layers between two depths: the i-th holds ``(-1 / depth - first) * scale`` from i to i + 1.

    A thin lens's parallax is proportional to the difference of inverse depths, so these are equal steps of CoC.
    """

    n_layers: int
    first: float = 0.0
    scale: float = 0.0
    softness: float = DEFAULT_SOFTNESS

    @classmethod
    def of(cls, passes: Sequence[tuple[Labels, npt.NDArray[np.int32]]], n_layers: int, softness: float) -> Layering:
        """Divide the range of depths of some passes, each with labels and variants, into layers."""
        if n_layers == 1:
            return cls(1)
        bounds = [np.empty((len(variant), 2), np.float64) for _, variant in passes]
        for (labels, variant), found in zip(passes, bounds, strict=True):
            for_bands(_layer_kernels.nearness_range, len(found), labels.view.depth, variant, found)
        low, high = min(float(each[:, 0].min()) for each in bounds), max(float(each[:, 1].max()) for each in bounds)
        if not high > low:
            return cls(1)
        inner = _inner_range(passes)
        if high - low > STRAY_STRETCH * (inner[1] - inner[0]) > 0.0:
            low, high = inner
        return cls(n_layers, low, n_layers / (high - low), softness)

    def members(self, labels: Labels, variant: npt.NDArray[np.int32]) -> Membership:
        """Find the layers of each pixel."""
        layer = np.zeros(variant.shape, np.int32)
        farther = np.zeros(variant.shape, np.float32)
        if self.n_layers > 1:
            division = self.first, self.scale, self.n_layers, self.softness
            for_bands(_layer_kernels.assign_layers, len(layer), labels.view.depth, *division, layer, farther)
        return Membership(variant, layer, farther)


def _inner_range(passes: Sequence[tuple[Labels, npt.NDArray[np.int32]]]) -> tuple[float, float]:
    """Return the range of ``-1 / depth`` without a small share of the drawn pixels at either end."""
    found = []
    for labels, variant in passes:
        step = max(1, math.isqrt(variant.size // RANGE_PIXELS))
        depth = labels.view.depth[::step, ::step]
        found.append(-1.0 / depth[variant[::step, ::step] >= 0].astype(np.float64))
    nearness = np.sort(np.concatenate(found))
    if not len(nearness):
        return 0.0, 0.0
    cut = int(STRAY_SHARE * len(nearness))
    return float(nearness[cut]), float(nearness[len(nearness) - 1 - cut])
