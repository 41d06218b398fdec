"""Compiled kernel of the level of detail: which blocks of four can be drawn as one."""

import numpy as np

from spreadlets.compiled import kernel
from spreadlets.runtime.plan._display_kernels import display_slope


@kernel
def merge_blocks(begin, end, radiance, label, factor, tolerance, merged, merged_label, worst):
    """Merge blocks of 2 x 2 pixels of one label whose deviation from their mean stays below the tolerance.

    Parameters
    ----------
    radiance : ndarray of shape (H, W, 4), float32
        Pixels, or means of blocks of the level before.
    label : ndarray of shape (H, W), int32
        Set to -1, in place, where a pixel has been merged.
    factor : ndarray of shape (n_labels,), float32
        Change of the image for a deviation of 1 in the mean of the four.
    tolerance : float32
        Largest change allowed, in units of the displayed range.
    merged : ndarray of shape (H // 2, W // 2, 4), float32
        Filled with the blocks' means.
    merged_label : ndarray of shape (H // 2, W // 2), int32
        Filled with their labels, -1 where the pixels stay as they are.
    worst : ndarray of shape (H // 2,), float32
        Filled with the largest change that a merged block of the row may cause.
    """
    quarter = np.float32(0.25)
    for row in range(begin, end):
        for col in range(merged.shape[1]):
            index = label[2 * row, 2 * col]
            merged_label[row, col] = -1
            alike = index == label[2 * row, 2 * col + 1] and index == label[2 * row + 1, 2 * col]
            if index < 0 or not alike or index != label[2 * row + 1, 2 * col + 1]:
                continue
            change = np.float32(0.0)
            for c in range(4):
                p, q = radiance[2 * row, 2 * col, c], radiance[2 * row, 2 * col + 1, c]
                r, s = radiance[2 * row + 1, 2 * col, c], radiance[2 * row + 1, 2 * col + 1, c]
                mean = quarter * (p + q + r + s)
                merged[row, col, c] = mean
                # Half the sum of the deviations, per pixel of the four; alpha counts as it is.
                deviation = np.float32(0.5) * quarter * (abs(p - mean) + abs(q - mean) + abs(r - mean) + abs(s - mean))
                if deviation > 0:
                    change = max(change, deviation * (display_slope(mean) if c < 3 else np.float32(1.0)))
            change *= np.float32(4.0) * factor[index]
            if change <= tolerance:
                merged_label[row, col] = index
                label[2 * row, 2 * col] = -1
                label[2 * row, 2 * col + 1] = -1
                label[2 * row + 1, 2 * col] = -1
                label[2 * row + 1, 2 * col + 1] = -1
                worst[row] = max(worst[row], change)
