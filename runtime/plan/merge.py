"""Level of detail: blocks of like pixels under a wide PSF are drawn as one, where the eye cannot tell.

The PSF of a wide blur hides what lies within a block of 2 x 2 or 4 x 4 pixels. Replacing the pixels x_i of a block by
their mean changes the result at x by ``sum_i d_i f(x - x_i)``, d_i being their deviations, which is at most
``D osc(f)``, D half the sum of their absolute values and osc(f) the range of the PSF over the block. Summed over blocks
alike, that is at most ``D TV(f) (s - 1) / s^2``, with the PSF's total variation TV and the block's side s. Uniform
blocks are exact; a highlight has a large deviation and keeps its own place.

Blocks are drawn at their first pixels into an image of their own, and the sum over the block's area is taken once, for
all blocks together, by adding moved copies of that image.

What is smooth need not have full resolution at all: PSFs that are wide enough are drawn into, integrated in, and
interpolated from pixels of side s. That blurs the result by some s / 2. It changes it most where an edge of the scene
lies along the rim of the PSF. A disc of radius r beyond a straight edge of contrast 1 adds
``4/3 (2 r)^(1/2) d^(3/2) / (pi r^2)`` at depth d; blurred by a Gaussian of deviation s / 2, that is
``0.09 (s / r)^(3/2)`` where it begins.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from spreadlets.parallel import for_bands
from spreadlets.runtime.label.labels import NO_SHIFT
from spreadlets.runtime.plan import _merge_kernels
from spreadlets.runtime.splat.passes import STRIDES, SplatPass

EDGE_ERROR = 0.2
"""Change of the displayed image by an edge along the rim of a disc as wide as a coarse pixel: the 0.09 above, times the
display's slope in shadows, from which such a rim rises."""
MERGING_SHARE = 0.25
"""Share of the tolerance that is kept for merged blocks; coarse pixels may use the others. Their errors may add up."""


def coarse_error(variation: npt.NDArray[np.float32], side: npt.NDArray[np.int64] | int) -> npt.NDArray[np.float64]:
    """Return how much the displayed image may change where PSFs are drawn by coarse pixels.

    Parameters
    ----------
    variation : ndarray of shape (n,), float32
        Total variation of the PSFs: that of a disc is 2 over its radius in px.
    side : ndarray of shape (n,), int64, or int
        Side of the pixels, px; 1 changes nothing.

    Returns
    -------
    ndarray of shape (n,), float64
        A share of the display's range.
    """
    blurred = EDGE_ERROR * (0.5 * np.float64(side) * variation.astype(np.float64)) ** 1.5
    return np.where(np.asarray(side) > 1, blurred, 0.0)


def merge_blocks(
    frame: SplatPass, variation: npt.NDArray[np.float32], tolerance: float
) -> tuple[list[SplatPass], float]:
    """Split a pass into blocks that can be drawn as one, and the pixels left.

    Parameters
    ----------
    frame : SplatPass
        Labelled pixels with stride 1; its labels are changed in place.
    variation : ndarray of shape (n_labels,), float32
        Total variation of each label's PSF, infinite where pixels must not be merged.
    tolerance : float
        Largest change of the displayed image, as a share of its range, that a merged block may cause.

    Returns
    -------
    levels : list of SplatPass
        Strides 1, 2 and 4, as far as there are any.
    bound : float
        Bound on the change of the displayed image, at most the tolerance.
    """
    levels = [frame]
    if frame.shift is not NO_SHIFT or tolerance <= 0:
        return levels, 0.0
    # Share the tolerance between the two coarser strides.
    share = np.float32(tolerance / (len(STRIDES) - 1))
    bound = 0.0
    for stride in STRIDES[1:]:
        finer = levels[-1]
        height, width = (size // 2 for size in finer.label.shape)
        if not height or not width:
            break
        # Merge blocks of the finer stride, as far as the PSFs' total variation allows.
        radiance = np.empty((height, width, 4), np.float32)
        label = np.empty((height, width), np.int32)
        worst = np.zeros(height, np.float32)
        factor = (variation * np.float32((stride - 1) / 4)).astype(np.float32)
        limits = factor, share
        for_bands(_merge_kernels.merge_blocks, height, finer.radiance, finer.label, *limits, radiance, label, worst)
        bound += float(worst.max())
        levels.append(SplatPass(frame.origin, radiance, label, NO_SHIFT, stride))
    return levels, bound
