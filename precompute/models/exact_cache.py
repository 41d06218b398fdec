"""PSFs of single coordinates, kept for the next frame: neighbours, and the frames of a shot, ask for the same ones."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterator
from threading import Lock

from spreadlets.arrays import DoubleArray, IntArray
from spreadlets.parallel import for_each
from spreadlets.psf.exact import direct_points
from spreadlets.psf.spreadlet import Spreadlet

MOST_KEPT_POINTS = 1 << 23
"""Points that are kept, some 128 MB of them; the PSFs that have not been asked for the longest go first."""

Key = tuple[tuple[float, ...], float, int]
"""Coordinate, direction and side."""


class CachedPsfs:
    """Makes the PSFs of single coordinates, and keeps them; an `spreadlets.psf.exact.ExactPsf`.

    Parameters
    ----------
    make : callable
        ``(coordinate, direction, side) -> psf``, an array (h, w, C), centred.
    """

    def __init__(self, make: Callable[[tuple[float, ...], float, int], DoubleArray]) -> None:
        self._make = make
        self._kept: OrderedDict[Key, Spreadlet] = OrderedDict()
        self._n_points = 0
        self._lock = Lock()

    def __call__(self, coordinate: DoubleArray, angle: DoubleArray, side: IntArray) -> Iterator[Spreadlet]:
        """Return the PSFs, see `spreadlets.psf.exact.ExactPsf`."""
        places = (tuple(each) for each in coordinate.tolist())
        keys = list(zip(places, angle.tolist(), side.tolist(), strict=True))
        with self._lock:
            known = {key: self._kept[key] for key in keys if key in self._kept}
        missing = [key for key in dict.fromkeys(keys) if key not in known]
        known |= zip(missing, for_each(lambda key: direct_points(self._make(*key)), missing), strict=True)
        self.keep(known)
        return (known[key] for key in keys)

    def known(self) -> dict[Key, Spreadlet]:
        """Return the PSFs that are kept."""
        with self._lock:
            return dict(self._kept)

    def keep(self, psfs: dict[Key, Spreadlet]) -> None:
        """Keep PSFs, and let the oldest go."""
        with self._lock:
            for key, psf in psfs.items():
                self._n_points += 0 if key in self._kept else psf.n_points
                self._kept[key] = psf
                self._kept.move_to_end(key)
            while self._n_points > MOST_KEPT_POINTS and self._kept:
                self._n_points -= self._kept.popitem(last=False)[1].n_points
