"""Pooling: pixels that lie elsewhere than where they were seen are drawn together with those that lie there, too.

Stochastic samples, moved to where they would lie without lens and at mid-shutter, fall onto the pixels that see them
through a pinhole, wherever on the lens they were taken; and a pixel that is moved by part of a pixel is split over up
to four. Splats with one PSF, in one layer and on one pixel add up before they are drawn, which is exact, since
splatting is linear; and neighbours with one PSF become runs.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import Image
from spreadlets.parallel import for_bands, for_blocks
from spreadlets.runtime.label.labels import NO_SHIFT
from spreadlets.runtime.plan import _pool_kernels
from spreadlets.runtime.plan._pool_kernels import Pooled, Sides, Splats, Stepped
from spreadlets.runtime.splat.passes import SplatPass

CHUNKS = 16
"""Parts of the rows of pixels that are listed independently; fixed, so that sums are the same for any thread count."""
MOST_SPLATS = 1 << 25
"""Splats that are pooled at a time, 1 GiB."""


class PlacedPixels(NamedTuple):
    """Pixels, or one sample of each, in one of their layers, and where their splats lie.

    Attributes
    ----------
    radiance : ndarray of shape (H, W, 4), float32
    weight : ndarray of shape (H, W), float32
    label : ndarray of shape (H, W), int32
        ``layer * n_variants + variant``, negative where there is none.
    steps : ndarray of shape (H, W, 2), int32
        Displacement (row, col) of the splat's centre from the pixel, in 1/16 px.
    at : ndarray of shape (H, W, 2), int32
        Row and column in the frame of the pixels of a list; empty for all pixels of a frame.
    limit : ndarray of shape (h, w), float32
        How bright they may be where they are repeated beyond the border, see `runtime.plan.border.border_limit`; empty
        if they are not.
    """

    radiance: Image
    weight: Image
    label: npt.NDArray[np.int32]
    steps: npt.NDArray[np.int32]
    at: npt.NDArray[np.int32]
    limit: Image


def place_pixels(
    radiance: Image,
    weight: Image,
    label: npt.NDArray[np.int32],
    shift: Image,
    at: npt.NDArray[np.int32] | None,
    wide: npt.NDArray[np.bool_],
    limit: Image,
) -> PlacedPixels:
    """Return pixels with their places.

    Parameters
    ----------
    radiance, label, limit
        See `PlacedPixels`.
    weight : ndarray of shape (H, W) or (0, 0), float32
        Empty if all weights are 1.
    shift : ndarray of shape (H, W, 2), float32
        Displacement (x, y) of the splat's centre from the pixel, px.
    at : ndarray of shape (H, W, 2), int32, or None
        Row and column in the frame of the pixels of a list.
    wide : ndarray of shape (n_variants,), bool
        Variants whose centres are moved to the next pixel.
    """
    steps = np.empty(shift.shape, np.int32)
    for_bands(_pool_kernels.place_steps, len(label), shift, label, wide, steps)
    weight = weight if len(weight) else np.ones(label.shape, np.float32)
    return PlacedPixels(radiance, weight, label, steps, NO_SHIFT if at is None else at, limit)


def pool(
    pixels: Sequence[PlacedPixels], shape: tuple[int, int], reaches: npt.NDArray[np.int64], n_layers: int
) -> Iterator[SplatPass]:
    """Yield the splats of pixels, those of one label and place added up, as passes of one row.

    Parameters
    ----------
    pixels : sequence of PlacedPixels
    shape : tuple of two ints
        Height and width of the frame.
    reaches : ndarray of shape (n_variants,), int64
        How far each variant reaches from its centre, px.
    n_layers : int
        Depth layers.
    """
    if not pixels or not len(reaches):
        return
    far = int(reaches.max())
    n_rows = shape[0] + 2 * far
    counts = np.zeros((len(pixels), CHUNKS, n_rows), np.int64)
    nothing = Splats(np.zeros(0, np.int32), np.zeros(0, np.int32), np.zeros((0, 4), np.float32))
    for each, count in zip(pixels, counts, strict=True):
        _list(each, shape, reaches, far, count, nothing)
    sizes = counts.sum(axis=(1, 2))
    begin = 0
    while begin < len(pixels):
        end = begin + max(1, int(np.searchsorted(np.cumsum(sizes[begin:]), MOST_SPLATS, side="right")))
        if sizes[begin:end].any():
            yield _pooled(pixels[begin:end], counts[begin:end], shape, reaches, far, n_layers)
        begin = end


def _list(
    pixels: PlacedPixels,
    shape: tuple[int, int],
    reaches: npt.NDArray[np.int64],
    far: int,
    at: npt.NDArray[np.int64],
    splats: Splats,
) -> None:
    """Count or list the splats of pixels, see the kernel."""
    padding = _padding(pixels, shape, reaches) if len(pixels.limit) else Sides(0, 0, 0, 0)
    drawn = Stepped(*pixels[:5]), shape, pixels.limit, padding, reaches, -far
    for_blocks(_pool_kernels.list_splats, len(at), *drawn, at, splats)


def _padding(pixels: PlacedPixels, shape: tuple[int, int], reaches: npt.NDArray[np.int64]) -> Sides:
    """Return how far beyond each side a pixel like those on the border reaches back into the frame."""
    found = []
    for axis, sign in ((0, 1), (0, -1), (1, 1), (1, -1)):
        border = 0 if sign > 0 else shape[axis] - 1
        edge: Any = [slice(None)] * 2
        edge[axis] = border
        edge = pixels.at[..., axis] == border if len(pixels.at) else tuple(edge)
        label, steps = pixels.label[edge], pixels.steps[edge][..., axis]
        towards = sign * (steps[label >= 0] // _pool_kernels.STEPS_PER_PIXEL) + 1
        found.append(int((reaches[label[label >= 0] % len(reaches)] + towards).max(initial=0)))
    return Sides(*found)


def _pooled(
    pixels: Sequence[PlacedPixels],
    counts: npt.NDArray[np.int64],
    shape: tuple[int, int],
    reaches: npt.NDArray[np.int64],
    far: int,
    n_layers: int,
) -> SplatPass:
    """Return the splats of pixels, added up."""
    n_rows = counts.shape[2]
    # All of a row together, in the order of pixels and chunks.
    by_row = counts.reshape(-1, n_rows).T
    ends = np.cumsum(by_row.ravel())
    at = np.ascontiguousarray((ends - by_row.ravel()).reshape(by_row.shape).T).reshape(counts.shape)
    row_start = np.concatenate([[0], ends[by_row.shape[1] - 1 :: by_row.shape[1]]])
    total = int(row_start[-1])
    splats = Splats(np.empty(total, np.int32), np.empty(total, np.int32), np.empty((total, 4), np.float32))
    for each, place in zip(pixels, at, strict=True):
        _list(each, shape, reaches, far, place, splats)
    first_col = int(splats.col.min())
    splats.col[:] -= first_col
    order, n_places = np.empty(total, np.int64), np.empty(n_rows, np.int64)
    sizes = n_layers * len(reaches), int(splats.col.max()) + 1
    for_bands(_pool_kernels.sort_rows, n_rows, splats.label, splats.col, row_start, *sizes, order, n_places)
    place_start = np.concatenate([[0], np.cumsum(n_places)])
    m = int(place_start[-1])
    pooled = Pooled(np.empty((m, 4), np.float32), np.empty(m, np.int32), np.empty((m, 2), np.int32))
    for_bands(_pool_kernels.add_up, n_rows, splats, order, row_start, place_start, (-far, first_col), pooled)
    return SplatPass((0, 0), pooled.radiance[None], pooled.label[None], pooled.shift[None])
