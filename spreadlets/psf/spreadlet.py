"""The spreadlet: a PSF as a short list of integer points, usually of its Laplacian."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import DoubleArray
from spreadlets.errors import InvalidParameterError
from spreadlets.psf.laplacian import solve_free_space

MOMENT_EXPONENTS = ((0, 0), (1, 0), (0, 1), (1, 1), (2, 0), (0, 2))
"""Exponents (of the row, of the column) of the six moments up to second order, in the order `moments` returns them."""


@dataclass(frozen=True)
class Spreadlet:
    """Integer points and their values, whose free-space Poisson solution (or plain image, if direct) is a PSF.

    Attributes
    ----------
    offset_rc : ndarray of shape (n, 2), int16
        Row and column of each point relative to the PSF's centre, px; no two points coincide.
    value : ndarray of shape (n, C), float32
        Values of the 5-point Laplacian (``direct`` false) or of the PSF itself (``direct`` true).
    direct : bool
        Whether the points are pixels of the PSF, to be drawn without integration.

    Raises
    ------
    InvalidParameterError
        If the arrays' shapes or types do not fit each other.

    Notes
    -----
    LKS sections 5.5 and 6.4 (the direct track).
    """

    offset_rc: npt.NDArray[np.int16]
    value: npt.NDArray[np.float32]
    direct: bool = False

    def __post_init__(self) -> None:
        if self.offset_rc.dtype != np.int16 or self.value.dtype != np.float32:
            raise InvalidParameterError(
                f"offset_rc must be int16 and value float32, not {self.offset_rc.dtype} and {self.value.dtype}"
            )
        n_points = len(self.offset_rc)
        if self.offset_rc.shape != (n_points, 2) or self.value.ndim != 2 or len(self.value) != n_points:
            raise InvalidParameterError(
                f"offset_rc must have shape (n, 2) and value (n, C), not {self.offset_rc.shape} and {self.value.shape}"
            )

    @property
    def n_points(self) -> int:
        """Number of points: what splatting one pixel costs."""
        return len(self.offset_rc)

    @property
    def n_channels(self) -> int:
        """Colour channels of a value: 1 (achromatic) or 3."""
        return int(self.value.shape[1])

    @property
    def extent(self) -> tuple[int, int]:
        """Largest absolute row and column offset, px."""
        if self.n_points == 0:
            return 0, 0
        rows, columns = np.abs(self.offset_rc.astype(np.int64)).max(axis=0)
        return int(rows), int(columns)

    def to_dense(self, margin: int = 0) -> DoubleArray:
        """Reconstruct the dense PSF with the exact free-space solution.

        Parameters
        ----------
        margin : int
            Pixels to add on each side beyond the points' extent; at least 0.

        Returns
        -------
        ndarray of shape (h, w, C), float64
            Odd sizes; offset (0, 0) is the centre pixel.
        """
        if margin < 0:
            raise InvalidParameterError(f"margin must be at least 0 px, not {margin}")
        half = np.asarray(self.extent) + margin
        image = np.zeros((2 * half[0] + 1, 2 * half[1] + 1, self.n_channels))
        rows, columns = (self.offset_rc.astype(np.int64) + half).T
        image[rows, columns] = self.value
        return image if self.direct else solve_free_space(image)

    def moments(self) -> DoubleArray:
        """Moments of the values up to second order, about offset (0, 0).

        Returns
        -------
        ndarray of shape (6, C), float64
            Sums of ``value * row**a * column**b`` for (a, b) in `MOMENT_EXPONENTS`. The Laplacian of a centred PSF of
            unit sum has (0, 0, 0, 0, 2, 2).
        """
        rows, columns = self.offset_rc.astype(np.float64).T
        powers = np.stack([rows**a * columns**b for a, b in MOMENT_EXPONENTS])
        return np.asarray(powers @ self.value.astype(np.float64))

    def transformed(self, *, transpose: bool = False, flip_row: bool = False, flip_col: bool = False) -> Spreadlet:
        """Apply one of the eight exact symmetries of the pixel grid.

        Parameters
        ----------
        transpose : bool
            Swap rows and columns; done first.
        flip_row, flip_col : bool
            Negate the row, the column.

        Returns
        -------
        Spreadlet
            Same values at transformed offsets; the reconstruction is transformed exactly alike.
        """
        offset = self.offset_rc[:, ::-1] if transpose else self.offset_rc
        sign = np.asarray([-1 if flip_row else 1, -1 if flip_col else 1], dtype=np.int16)
        return Spreadlet(np.ascontiguousarray(offset * sign), self.value, self.direct)
