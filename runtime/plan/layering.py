"""Global depth layers: equal steps of parallax, hard or soft, and how much of each was seen (LKS section 6.2)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from spreadlets.runtime.label.labels import Labels
from spreadlets.runtime.plan import _layer_kernels

Image = npt.NDArray[np.float32]

DEFAULT_LAYERS = 4
"""Layers of a frame that comes without any."""
MAX_LAYERS = 64
DEFAULT_SOFTNESS = 1.0
"""Width of the transition from one layer to the next, in layers."""

STRAY_SHARE = 0.002
STRAY_STRETCH = 2.0
"""So small a share of the pixels must not stretch the range of inverse depths by more than this factor: a stray depth
of a millimetre would put all else into one layer. Such pixels go to the first or the last layer."""
RANGE_PIXELS = 1 << 16
"""About so many pixels are looked at to find them."""

BEHIND_ALL = 1 << 20

BOX_PER_DEVIATION = float(np.sqrt(1.5))
"""Half-width of a box that, applied twice, spreads as far as something of standard deviation 1."""


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
        bounds = np.concatenate(
            [_layer_kernels.nearness_range(labels.view.depth, variant) for labels, variant in passes]
        )
        low, high = float(bounds[:, 0].min()), float(bounds[:, 1].max())
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
            _layer_kernels.assign_layers(
                labels.view.depth, self.first, self.scale, self.n_layers, self.softness, layer, farther
            )
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


class Moments(NamedTuple):
    """Means over the pixels of a layer: CoC radius, px; its square; the squared path length; motion (dx, dy)."""

    coc: float
    coc_squared: float
    length_squared: float
    motion: tuple[float, float]

    def box_half_width(self) -> int:
        """Half-width, px, of the box that blurs, applied twice, as the layer's PSFs do in the mean."""
        # A disc of radius r has the variance r^2 / 4 along each axis, a path of length l the mean variance l^2 / 24.
        deviation = np.sqrt(self.coc_squared / 4.0 + self.length_squared / 24.0)
        return max(0, round(BOX_PER_DEVIATION * float(deviation) - 0.5))


def layer_moments(passes: Sequence[tuple[Labels, Image, Membership]], n_layers: int) -> list[Moments | None]:
    """Return the means of each layer over passes of labels, motions (H, W, 2) and members; None for empty layers."""
    total = sum(
        _layer_kernels.layer_moments(*members, labels.coc, labels.length, motion, n_layers).sum(axis=0)
        for labels, motion, members in passes
    )
    return [_means(each) if each[0] > 0 else None for each in np.asarray(total)]


def _means(total: npt.NDArray[np.float64]) -> Moments:
    coc, coc_squared, length_squared, x, y = (float(each) for each in total[1:] / total[0])
    return Moments(coc, coc_squared, length_squared, (x, y))


def seen_share(members: Membership, number: int, moments: Moments) -> Image:
    """Return the share of a layer that nearer ones did not hide, blurred as the layer is, shape (H, W)."""
    seen = np.empty(members.variant.shape, np.float32)
    _layer_kernels.seen_share(*members, number, seen)
    _blur(seen, moments, repeat=True)
    return seen


def passing_samples(passes: Sequence[tuple[Membership, Image, Image, Image]], number: int, moments: Moments) -> Image:
    """Return the number of samples that passed a layer, blurred as the layer is, shape (H, W).

    Beyond the frame's border the nearest samples repeat, as they do for splats.

    Parameters
    ----------
    passes : sequence of (members, offset, lens_uv, time)
        The samples; where in their pixel they were seen, (dx, dy); their places on the lens and in time.
    number : int
    moments : Moments
        Of the layer: where a sample passed through it is taken from its mean CoC and motion.
    """
    farthest = max(
        float(np.abs(offset).max()) + abs(moments.coc) + max(map(abs, moments.motion)) * float(np.abs(time).max())
        for _, offset, _, time in passes
    )
    padding = 2 * moments.box_half_width() + math.ceil(farthest) + 1
    height, width = passes[0][0].variant.shape
    passing = np.zeros((height + 2 * padding, width + 2 * padding), np.float32)
    layer = moments.coc, *moments.motion
    for members, *sample in passes:
        _layer_kernels.scatter_passing(tuple(members), number, tuple(sample), layer, padding, passing)
    _blur(passing, moments, repeat=False)
    return np.ascontiguousarray(passing[padding : padding + height, padding : padding + width])


def _blur(image: Image, moments: Moments, *, repeat: bool) -> None:
    half = moments.box_half_width()
    if half:
        _layer_kernels.box_blur(image, half, repeat, np.empty_like(image))
    np.clip(image, 0.0, None, out=image)
