"""Ways of pixels whose PSFs do not move: such a pixel is drawn at several places, with a share of its light at each."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import FloatArray, Image, IntArray
from spreadlets.parallel import for_bands
from spreadlets.runtime.label import _label_kernels
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

    def places(self, chosen: IntArray) -> tuple[IntArray, Image, FloatArray]:
        """Return the places of some pixels, by their numbers in raster order.

        Returns
        -------
        which : ndarray of shape (n,), int64
            The pixel of each place, counted among those chosen.
        place : ndarray of shape (n, 2), float32
            From where the pixel lies at the frame's time, (dx, dy), px.
        share : ndarray of shape (n,), float32
        """
        n_places, (opens, closes) = self.n_places.ravel()[chosen].astype(np.int64), self.shutter
        which = np.repeat(np.arange(len(n_places)), n_places)
        number = np.arange(len(which)) - (np.cumsum(n_places) - n_places)[which]
        share = self.share[number + (n_places * (n_places - 1) // 2)[which]]
        time = (opens + (closes - opens) * (number + 0.5) / n_places[which]).astype(np.float32)
        before, after = (each.reshape(-1, 2)[chosen][which] for each in (self.before, self.after))
        return which, curved_places(before[None], after[None], time[None])[0], share


def curved_places(before: Image, after: Image, time: FloatArray) -> Image:
    """Return where pixels are at times (H, W), frames, on the curves through three places, px (dx, dy), (H, W, 2)."""
    place = np.empty_like(before)
    for_bands(_label_kernels.path_places, len(place), before, after, time, place)
    return place
