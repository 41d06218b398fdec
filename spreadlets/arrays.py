"""The names of the array types, once for the whole tree."""

import os

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float32]
"""Colours and labels: what is as large as an image."""
Image = FloatArray
"""An image, (H, W, C) or one plane of it (H, W)."""
DoubleArray = npt.NDArray[np.float64]
"""What is computed offline or is small."""
RealArray = npt.NDArray[np.floating]
"""Of either precision."""
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]
PathLike = str | os.PathLike[str]

NOTHING: Image = np.zeros((0, 0), np.float32)
"""A plane that is not given."""
