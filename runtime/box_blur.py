"""The blur by a box, at the same cost for any size."""

from __future__ import annotations

import numpy as np

from spreadlets.arrays import Image
from spreadlets.parallel import for_bands
from spreadlets.runtime import _box_kernels


def box_blurred(image: Image, half: int, times: int = 1) -> Image:
    """Return an image blurred by a box of ``2 half + 1`` px; beyond its border there is nothing.

    Parameters
    ----------
    image : ndarray of shape (H, W), float32
    half : int
    times : int
        How often: twice is about as smooth as a tent.

    Returns
    -------
    ndarray of shape (H, W), float32

    Examples
    --------
    >>> import numpy as np
    >>> from spreadlets.runtime.box_blur import box_blurred
    >>> box_blurred(np.float32([[0, 0, 9], [0, 0, 0], [0, 0, 0]]), 1)[0]
    array([0., 1., 1.], dtype=float32)
    """
    height, width = image.shape
    across, blurred = np.empty_like(image), image
    for _ in range(times if half else 0):
        for_bands(_box_kernels.box_rows, height, blurred, half, across)
        blurred = np.empty_like(image)
        for_bands(_box_kernels.box_columns, -(-width // _box_kernels.STRIPE), across, half, blurred)
    return blurred
