"""What was made for one camera, kept for the next: points of PSFs, by what they are of."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Sequence
from threading import Lock
from typing import Generic, TypeVar

Key = TypeVar("Key", bound=Hashable)
Value = TypeVar("Value")


class Kept(Generic[Key, Value]):
    """Values that were made for keys; it may be used from several threads.

    Parameters
    ----------
    most : int
        Total size of what is kept; what has been there the longest goes first.
    size : callable
        Returns that of a value.

    Examples
    --------
    >>> from spreadlets.kept import Kept
    >>> kept, made = Kept(most=100, size=len), []
    >>> for _ in range(2):
    ...     kept.of(["a"], lambda keys: made.append(keys) or [10 * key for key in keys])
    ['aaaaaaaaaa']
    ['aaaaaaaaaa']
    >>> made
    [['a']]
    """

    def __init__(self, most: int, size: Callable[[Value], int]) -> None:
        self._most, self._size = most, size
        self._known: dict[Key, Value] = {}
        self._total = 0
        self._lock = Lock()

    def of(self, keys: Sequence[Key], make: Callable[[list[Key]], Iterable[Value]]) -> list[Value]:
        """Return the values of keys that differ; those that are missing are made together."""
        with self._lock:
            found = {key: self._known[key] for key in keys if key in self._known}
        missing = [key for key in keys if key not in found]
        if missing:
            made = dict(zip(missing, make(missing), strict=True))
            self._keep(made)
            found |= made
        return [found[key] for key in keys]

    def _keep(self, made: dict[Key, Value]) -> None:
        with self._lock:
            for key, value in made.items():
                self._total += self._size(value) if key not in self._known else 0
                self._known.setdefault(key, value)
            while self._total > self._most:
                self._total -= self._size(self._known.pop(next(iter(self._known))))
