"""Compiled kernel of the canvas: linear colours to bytes."""

import numpy as np

from spreadlets.compiled import kernel

DROPPED_BITS = 13
"""Bits of a 32-bit float that its code leaves out: ten are left of the fraction."""
N_CODES = 1 << 32 - DROPPED_BITS


@kernel
def encode(begin, end, bits, table, canvas):
    """Fill a canvas (H, W, 4), uint8, with opaque pixels.

    Parameters
    ----------
    bits : ndarray of shape (H, W, 3 or 4), uint32
        Those of linear colours, float32.
    table : ndarray of shape (N_CODES,), uint8
        What a canvas shows of each float, by its first bits.
    """
    for row in range(begin, end):
        for col in range(bits.shape[1]):
            for c in range(3):
                canvas[row, col, c] = table[bits[row, col, c] >> np.uint32(DROPPED_BITS)]
            canvas[row, col, 3] = 255
