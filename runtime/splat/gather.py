"""Gathering: filtering a layer with the PSFs of the receiving pixels (LKS section 7, FILTERING)."""

from __future__ import annotations

import numpy as np

from spreadlets.arrays import Image
from spreadlets.parallel import for_bands
from spreadlets.runtime.label.labels import NO_SHIFT
from spreadlets.runtime.splat import _splat_kernels
from spreadlets.runtime.splat.passes import PointTable, SplatPass, find_runs


def gather(source: SplatPass, table: PointTable) -> Image:
    """Filter a layer: each pixel becomes the mean of its surroundings under its own PSF (LKS section 7, FILTERING).

    Parameters
    ----------
    source : SplatPass
        The pixels of the frame; shifts are ignored, as a filter has no place to move light to.
    table : PointTable
        Direct points of the variants.

    Returns
    -------
    ndarray of shape (H, W, 4), float32
        Zero where the label is negative. Beyond the border the frame's edge is repeated.
    """
    padding = int(table.reaches.max(initial=0))
    padded = np.pad(source.radiance, ((padding, padding), (padding, padding), (0, 0)), mode="edge")
    runs = find_runs(source._replace(shift=NO_SHIFT, origin=(padding, padding)), table, 1).runs
    # A filter mirrors its kernel: the light under offset d is light that a splat would have moved by -d.
    row, col = -table.offset_rc.T.astype(np.int64)
    cols = padded.shape[1]
    image = np.zeros_like(source.radiance)
    images, offsets = (image.reshape(-1), padded.reshape(-1)), 4 * (row * cols + col)
    for_bands(_splat_kernels.gather_runs, len(runs), *images, runs, offsets, table.lanes, table.point_start, cols)
    return image
