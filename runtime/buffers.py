"""Memory that is used again: what one layer was drawn in, the next is drawn in, too, and the next frame.

Fresh memory costs more than what is then done with it: the system clears each page when it is first touched. So large
arrays are lent, and what comes back when nobody has them any more is lent again.
"""

from __future__ import annotations

import math
import weakref
from collections import deque
from threading import Lock
from typing import Any

import numpy as np
import numpy.typing as npt

from spreadlets import _scan_kernels
from spreadlets.arrays import FloatArray
from spreadlets.parallel import for_bands

LEAST_BYTES = 1 << 18
"""Smaller arrays are cheap as they are."""
MOST_IDLE_BYTES = 96 << 20
"""Memory that waits to be lent, at most: the canvases of a frame of some 1024 x 1024 pixels."""
MOST_TOO_LARGE = 2
"""A piece of memory is lent for arrays of at least its size over this."""
SIZE_BITS = 4
"""Leading bits of the size of a piece: arrays that differ little in size take each other's place."""


class _Loan:
    """Memory as NumPy takes it: every array that lies in it keeps this alive, and with it the loan."""

    def __init__(self, piece: npt.NDArray[np.uint8], shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
        place = piece.__array_interface__["data"]
        self.__array_interface__ = {"data": place, "shape": shape, "typestr": dtype.str, "version": 3}


class _Pool:
    """Pieces of memory that nobody has; it may be used from several threads."""

    def __init__(self) -> None:
        # Appending and popping need no lock, which a piece that comes back at any moment could not wait for.
        self._back: deque[npt.NDArray[np.uint8]] = deque()
        self._idle: list[npt.NDArray[np.uint8]] = []
        self._lock = Lock()

    def lend(self, shape: tuple[int, ...], dtype: np.dtype[Any]) -> npt.NDArray[Any]:
        """Return an array in a piece of memory, which comes back with the last array in it."""
        piece = self._piece(math.prod(shape) * dtype.itemsize)
        loan = _Loan(piece, shape, dtype)
        weakref.finalize(loan, self._take_back, piece).atexit = False
        return np.asarray(loan)

    def _take_back(self, piece: npt.NDArray[np.uint8]) -> None:
        self._back.append(piece)
        if self._lock.acquire(blocking=False):
            try:
                self._sort()
            finally:
                self._lock.release()

    def _piece(self, n_bytes: int) -> npt.NDArray[np.uint8]:
        with self._lock:
            self._sort()
            for number, each in enumerate(self._idle):
                if n_bytes <= len(each) <= MOST_TOO_LARGE * n_bytes:
                    return self._idle.pop(number)
            # As much of what is too small for it makes room.
            freed = 0
            while freed < n_bytes and self._idle and len(self._idle[0]) < n_bytes:
                freed += len(self._idle.pop(0))
        step = 1 << max(n_bytes.bit_length() - SIZE_BITS, 0)
        return np.empty(-(-n_bytes // step) * step, np.uint8)

    def _sort(self) -> None:
        """Sort what has come back among the idle pieces by size, and let the smallest go while there is too much."""
        while self._back:
            self._idle.append(self._back.popleft())
        self._idle.sort(key=len)
        while sum(map(len, self._idle)) > MOST_IDLE_BYTES:
            self._idle.pop(0)

    def let_go(self) -> None:
        """Return all idle pieces to the system."""
        with self._lock:
            self._sort()
            self._idle.clear()


_pool = _Pool()


def buffer(shape: tuple[int, ...], dtype: npt.DTypeLike = np.float32) -> npt.NDArray[Any]:
    """Return an array whose values mean nothing, in memory that may have been used before.

    Parameters
    ----------
    shape : tuple of int
    dtype : data type

    Returns
    -------
    ndarray
        C-contiguous.

    Examples
    --------
    >>> from spreadlets.runtime.buffers import buffer
    >>> canvas = buffer((512, 512))
    >>> place = canvas.ctypes.data
    >>> del canvas
    >>> buffer((512, 512)).ctypes.data == place
    True
    """
    kind = np.dtype(dtype)
    if math.prod(shape) * kind.itemsize < LEAST_BYTES:
        return np.empty(shape, kind)
    return _pool.lend(shape, kind)


def let_go() -> None:
    """Return the memory that waits to be lent to the system: what comes next needs other sizes."""
    _pool.let_go()


def cleared(shape: tuple[int, ...], dtype: npt.DTypeLike = np.float32) -> npt.NDArray[Any]:
    """Return an array of zeros in such memory, of two or more dimensions."""
    array = buffer(shape, dtype)
    for_bands(_scan_kernels.clear_rows, len(array), array.reshape(len(array), -1))
    return array


def copied(given: FloatArray) -> FloatArray:
    """Return a copy, in such memory, of an array of two or more dimensions."""
    array = buffer(given.shape)
    rows = np.ascontiguousarray(given).reshape(len(given), -1)
    for_bands(_scan_kernels.copy_rows, len(array), rows, array.reshape(len(array), -1))
    return array
