"""Haze: how layers hide each other in a medium that scatters light.

The opacity of a layer's blurred pixels says which share of the paths from a pixel of the image meets it. What lies
beyond is seen by those that do not. But light from beyond is seen the more along a path the less the medium has turned
it, and what was not scattered before the layer meets it right at the pixel. So of the light from beyond, less passes
the blurred layer, and more is hidden by its pixels as they are, before any blur.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from spreadlets.arrays import NOTHING, FloatArray, Image
from spreadlets.scene.frame import Layer

BlurredShare = Callable[[float, float], float]
"""Of the distances of a layer and of one beyond, metres: how much of the nearer one's opacity is blurred."""
LEAST_LEFT = 1e-3
"""Share of a pixel that must be left for a layer's opacity to be told from what it adds."""


class Haze:
    """What layers hide in a medium.

    Parameters
    ----------
    layers : sequence of Layer
        Nearest first.
    blurred_share : callable
        See `BlurredShare`.
    """

    def __init__(self, layers: Sequence[Layer], blurred_share: BlurredShare) -> None:
        self._covers = [layer.radiance[..., 3] for layer in layers]
        self._distances = [_distance(layer) for layer in layers]
        self._blurred_share = blurred_share
        self._opacities: list[FloatArray] = []
        self._hidden: FloatArray = NOTHING

    def hide(self, image: Image, number: int | None = None) -> None:
        """Set the alpha of an image of all nearer layers, in place, to what they hide of a layer.

        Parameters
        ----------
        image : ndarray of shape (H, W, 4), float32
        number : int, optional
            Of the layer; by default what they hide of anything far beyond them.
        """
        far = np.inf if number is None else self._distances[number]
        left = np.ones(image.shape[:2], np.float32)
        for near, cover, opacity in zip(self._distances, self._covers, self._opacities, strict=False):
            share = np.float32(self._blurred_share(near, far))
            left *= np.float32(1.0) - cover - share * (opacity - cover)
        self._hidden = np.clip(np.float32(1.0) - left, 0.0, 1.0)
        image[..., 3] = self._hidden

    def add(self, image: Image) -> None:
        """Note the opacity of the layer that was put behind an image since its alpha was set."""
        left, cover = np.float32(1.0) - self._hidden, self._covers[len(self._opacities)]
        opacity = (image[..., 3] - self._hidden) / np.maximum(left, np.float32(LEAST_LEFT))
        self._opacities.append(np.where(left > LEAST_LEFT, opacity, cover))


def _distance(layer: Layer) -> float:
    """Return the mean depth of what a layer shows, metres; of nothing it is infinite."""
    cover = layer.radiance[..., 3] > 0.0
    return float(layer.depth[cover].mean(dtype=np.float64)) if cover.any() else np.inf
