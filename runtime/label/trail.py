"""Ways of pixels whose PSFs do not move: such a pixel is drawn at several places, with a share of its light at each."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import FloatArray, Image, IntArray
from spreadlets.scene.shutter import shutter_shares


class Trail(NamedTuple):
    """The places of pixels, counted from where each lies at the frame's time.

    Attributes
    ----------
    n_places : ndarray of shape (H, W), int32
        Number of places of each pixel: where it is amid so many equal steps of the shutter's time.
    before, after : ndarray of shape (H, W, 2), float32
        Motion (dx, dy) to the frame's time and from it, px per frame.
    shutter : tuple of two floats
        When it opens and closes, frames.
    share : ndarray of shape (m,), float32
        Shares of the light of the places of a pixel; those of n places begin at ``n * (n - 1) / 2``.
    """

    n_places: npt.NDArray[np.int32]
    before: Image
    after: Image
    shutter: tuple[float, float]
    share: FloatArray

    @classmethod
    def of(
        cls,
        n_places: npt.NDArray[np.int32],
        motion: tuple[Image, Image],
        shutter: tuple[float, float],
        curve: Sequence[float] | str | None,
    ) -> Trail:
        """Return the trails of pixels by their motion before and after; the shutter is open along a curve."""
        counts = range(1, 1 + int(n_places.max()))
        share = np.concatenate([shutter_shares(curve, each) for each in counts])
        return cls(n_places, *motion, shutter, share.astype(np.float32))

    @classmethod
    def unmoved(cls, shape: tuple[int, ...]) -> Trail:
        """Return the trails of pixels (H, W) that stay where they are."""
        still = np.zeros((*shape, 2), np.float32)
        return cls(np.ones(shape, np.int32), still, still, (0.0, 0.0), np.ones(1, np.float32))

    @classmethod
    def joined(cls, trails: Sequence[Trail]) -> Trail:
        """Return the trails of several lists, of one shutter, as those of one."""
        longest = max(trails, key=lambda each: len(each.share))
        n_places, before, after = (np.concatenate(each) for each in list(zip(*trails, strict=True))[:3])
        return cls(n_places, before, after, longest.shutter, longest.share)

    def of_pixels(self, at: tuple[IntArray, ...]) -> Trail:
        """Return the trails of some pixels by their rows and columns (n,), in one row."""
        n_places, before, after = self.n_places[at][None], self.before[at][None], self.after[at][None]
        return Trail(n_places, before, after, self.shutter, self.share)
