"""Lanes: what is in focus and moves far keeps what differs across its paths, as far as samples tell it from noise.

Few samples make a noisy layer, which is averaged with what lies around each pixel. What moves far, though, has been
averaged along its path by its splats: what is left to differ lies across, as between the rings of a wheel. So a pixel's
lane, along the path through it, is compared with what lies around to all sides. Where samples within the lane hardly
differ from each other, and much from those beside, that difference is no noise, and stays; on a disc whose sectors the
motion has blurred it is noise, and goes (Wiener).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from spreadlets.arrays import Image
from spreadlets.parallel import for_bands
from spreadlets.runtime.box_blur import box_blurred
from spreadlets.runtime.buffers import buffer, cleared
from spreadlets.runtime.composite import _lane_kernels
from spreadlets.runtime.plan.layering import Membership

SHARP_REACH = 1.0
"""CoC radius, px, up to which a sample is sharp: a wider disc takes in more lanes than one."""
LEAST_LENGTH = 6.0
"""Length of a path, px, from which it has a lane: shorter ones hold too few samples to tell how much they differ."""
REACH = 0.1, 2.0
"""Half length of the tent along a lane under which splats are summed: in paths, so that what the motion has blurred is
hardly blurred more; and px at most: next to each other they are of the same samples, and farther ones tell little more.
"""
AROUND_HALF, FOUND_HALF = 1, 2
"""Half widths, px, of the boxes, applied twice, that make what lies around; and over which differences are averaged."""
CHANCE = 0.5
"""Variance of a difference that is noise, in that of a mean of as many samples as the lane has. Of splats that two
pixels share across it is 2/3, less what the lane shares with those around."""
PATH_TILE, PATH_AROUND = 8, 1
"""Side of the tiles, px, that have one path; and half width of the box, in tiles, applied twice, that averages it."""


class Lanes(NamedTuple):
    """Lanes of a layer.

    Attributes
    ----------
    planes : ndarray of shape (H, W, 6), float32
        Samples of each pixel, see `runtime.composite._lane_kernels.sum_samples`.
    path : ndarray of shape (H, W, 2), float32
        How far the layer moves through each pixel while the shutter is open, px (dx, dy); 0 where it has no lane.
    """

    planes: Image
    path: Image

    def told(self, padded: Image, origin: tuple[int, int], seen: Image, kind: int) -> Image:
        """Return what the lanes tell of a layer, (H, W, 5): premultiplied colours, alpha, and 1 where they do, else 0.

        Parameters
        ----------
        padded, origin, seen, kind
            The layer's sums, see `runtime.composite.composite.add_layer`.
        """
        # Take the rows and columns that have lanes.
        told, moves = cleared((*self.path.shape[:2], 5)), (self.path != 0.0).any(axis=2)
        rows, cols = np.flatnonzero(moves.any(axis=1)), np.flatnonzero(moves.any(axis=0))
        part = slice(int(rows[0]), int(rows[-1]) + 1), slice(int(cols[0]), int(cols[-1]) + 1)
        path, planes = (np.ascontiguousarray(each[part]) for each in (self.path, self.planes))
        # Sum up what was seen along them, and to all sides.
        shape, corner = path.shape[:2], (origin[0] - part[0].start, origin[1] - part[1].start)
        along, lane, around = buffer((*shape, 5)), buffer((*shape, 6)), buffer((*shape, 5))
        seen = np.ascontiguousarray(seen[part]) if seen.size else seen
        given = padded, *corner, seen, kind, planes, path, REACH
        for_bands(_lane_kernels.sum_along, len(along), *given, along, lane)
        for c in range(5):
            around[..., c] = box_blurred(np.ascontiguousarray(along[..., c]), AROUND_HALF, times=2)
        # Compare both, and believe as much of what differs as is more than chance.
        found = buffer((4, *shape))
        for_bands(_lane_kernels.compare, len(along), along, around, lane, found)
        for k in range(4):
            found[k] = box_blurred(found[k], FOUND_HALF, times=2)
        for_bands(_lane_kernels.believe, len(along), along, around, found, CHANCE)
        told[part] = along
        return told


def find_lanes(
    members: Sequence[Membership],
    radiance: Sequence[Image],
    coc: Sequence[Image],
    paths: Sequence[Image],
    number: int,
) -> Lanes | None:
    """Find the lanes of a layer; None if hardly anything of it moves in focus.

    Parameters
    ----------
    members : sequence of Membership
        One sample of each pixel.
    radiance, coc, paths : sequence of ndarray of shapes (H, W, 4), (H, W) and (H, W, 2), float32
        Of the same samples; how far they blur, px; and how far they move while the shutter is open, px (dx, dy).
    number : int
        The layer's.
    """
    shape = members[0].variant.shape
    planes = np.zeros((*shape, 6), np.float32)
    sums = np.zeros((4, *(-(-size // PATH_TILE) for size in shape)), np.float32)
    for each, *sample in zip(members, radiance, coc, paths, strict=True):
        given = tuple(each), tuple(sample), number, SHARP_REACH, PATH_TILE, planes, sums
        for_bands(_lane_kernels.sum_samples, sums.shape[1], *given)
    if not sums[1].any():
        return None
    path = np.empty((*shape, 2), np.float32)
    blurred = np.stack([box_blurred(each, PATH_AROUND, times=2) for each in sums])
    for_bands(_lane_kernels.spread_paths, len(path), blurred, PATH_TILE, LEAST_LENGTH, path)
    return Lanes(planes, path) if path.any() else None
