"""What follows from an array, remembered for as long as the array lives: the next camera looks at the same one."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from typing import Any, Generic, TypeVar

import numpy as np
import numpy.typing as npt

Found = TypeVar("Found")


class Remembered(Generic[Found]):
    """A function of one array that computes each result once.

    Arrays are told apart by identity, and must not be changed afterwards. It may be used from several threads.

    Parameters
    ----------
    function : callable

    Examples
    --------
    >>> import numpy as np
    >>> from spreadlets.remembered import Remembered
    >>> total = Remembered(lambda array: float(array.sum()))
    >>> total(np.ones(3))
    3.0
    """

    def __init__(self, function: Callable[[npt.NDArray[Any]], Found]) -> None:
        self._function = function
        self._known: dict[int, tuple[weakref.ref[npt.NDArray[Any]], Found]] = {}

    def __call__(self, array: npt.NDArray[np.float32]) -> Found:
        """Return what follows from an array."""
        key = id(array)
        known = self._known.get(key)
        if known is not None and known[0]() is array:
            return known[1]
        found = self._function(array)
        # When the array goes, so does what is known of it; and when this goes, all of it does.
        itself = weakref.ref(self)
        self._known[key] = weakref.ref(array, lambda gone: _forget(itself, key, gone)), found
        return found


def _forget(remembered: weakref.ref[Remembered[Any]], key: int, gone: weakref.ref[npt.NDArray[Any]]) -> None:
    owner = remembered()
    known = None if owner is None else owner._known.get(key)
    if owner is not None and known is not None and known[0] is gone:
        del owner._known[key]
