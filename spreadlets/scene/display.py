"""From linear values to what a display shows."""

from typing import Any

import numpy as np
import numpy.typing as npt


def display_encode(image: npt.ArrayLike) -> npt.NDArray[np.floating[Any]]:
    """Return linear values in sRGB encoding, clipped to [0, 1].

    Parameters
    ----------
    image : array_like of any shape
        Linear values; NaN stays NaN.

    Returns
    -------
    ndarray of the same shape, float32 for float32 input, else float64

    Notes
    -----
    IEC 61966-2-1: linear below 0.0031308, a power of 1/2.4 above.
    """
    values = np.asarray(image)
    dtype = np.float32 if values.dtype == np.float32 else np.float64
    linear = np.clip(values.astype(dtype, copy=False), 0, 1)
    curved = 1.055 * np.power(linear, 1 / 2.4) - 0.055
    return np.asarray(np.where(linear <= 0.0031308, 12.92 * linear, curved), dtype=dtype)


def display_decode(encoded: npt.ArrayLike) -> npt.NDArray[np.float32]:
    """Return linear values of what is in sRGB encoding, 0 to 1.

    Parameters
    ----------
    encoded : array_like of any shape
        Unsigned integers of 8 or 16 bits are parts of the largest.

    Returns
    -------
    ndarray of the same shape, float32

    Notes
    -----
    The inverse of `display_encode`.
    """
    codes = np.asarray(encoded)
    if codes.dtype in (np.uint8, np.uint16):
        # There are few codes, and many pixels.
        most = np.iinfo(codes.dtype).max
        table = display_decode(np.arange(most + 1, dtype=np.float32) / np.float32(most))
        return np.asarray(table[codes])
    values = codes.astype(np.float32, copy=False)
    curved = np.power((np.maximum(values, 0.0) + np.float32(0.055)) / np.float32(1.055), np.float32(2.4))
    return np.asarray(np.where(values <= 0.04045, values / np.float32(12.92), curved), np.float32)
