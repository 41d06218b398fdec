"""How far a shutter is open while it is: its curve over time, and what share of the light a part of the time has."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from spreadlets.arrays import DoubleArray
from spreadlets.errors import InvalidParameterError, option

TRAPEZOID_SAMPLES = 65
"""Of a trapezoid, as a list of numbers: its corners lie within 1/128 of the time of where they should."""


def read_curve(given: Sequence[float] | str) -> list[float]:
    """Return a shutter's curve as how far it is open at equally spaced times, linear between them.

    Parameters
    ----------
    given : sequence of floats or str
        These numbers, in any unit; or as text with commas; or ``"trapezoid:RISE,FALL"`` with the shares of the time in
        which it opens and closes.

    Raises
    ------
    InvalidParameterError
        If it is none of these, or nothing lets light through.

    Examples
    --------
    >>> read_curve("0,1,1,0.5")
    [0.0, 1.0, 1.0, 0.5]
    """
    # Take text apart.
    if isinstance(given, str):
        kind, _, rest = given.rpartition(":")
        try:
            numbers = [float(word) for word in rest.split(",")]
        except ValueError:
            raise InvalidParameterError(
                f"{option('shutter_curve')} is {given!r}: needed are numbers separated by commas"
            ) from None
        if kind == "trapezoid" and len(numbers) == 2:
            return _trapezoid(*numbers)
        if kind:
            allowed = "trapezoid:RISE,FALL and samples"
            raise InvalidParameterError(f"{option('shutter_curve')} is {given!r}: allowed are {allowed}")
        given = numbers
    # Check the numbers.
    try:
        curve = [float(value) for value in given]
    except (TypeError, ValueError):
        raise InvalidParameterError(f"{option('shutter_curve')} is {given!r}: needed are numbers") from None
    good = len(curve) >= 2 and all(math.isfinite(value) and value >= 0.0 for value in curve)
    if not good or max(curve) == 0.0:
        raise InvalidParameterError(
            f"{option('shutter_curve')} is {curve}: two or more numbers from 0 up are needed, not all 0"
        )
    return curve


def _trapezoid(rise: float, fall: float) -> list[float]:
    """Return the samples of a shutter that opens and closes evenly."""
    if not (rise >= 0.0 and fall >= 0.0 and rise + fall <= 1.0):
        raise InvalidParameterError(f"a trapezoid of rise {rise} and fall {fall}: shares from 0 up, together at most 1")
    time = np.linspace(0.0, 1.0, TRAPEZOID_SAMPLES)
    opening = np.minimum(time / rise, 1.0) if rise else np.ones_like(time)
    closing = np.minimum((1.0 - time) / fall, 1.0) if fall else np.ones_like(time)
    return [float(value) for value in np.minimum(opening, closing)]


def shutter_shares(curve: Sequence[float] | str | None, count: int) -> DoubleArray:
    """Return the share of the light in each of some equal steps of the time, (count,), of sum 1.

    Parameters
    ----------
    curve : sequence of floats or str, optional
        As for `read_curve`; by default the shutter is fully open.
    count : int
        Number of steps.

    Examples
    --------
    >>> shutter_shares((0, 1), 2).tolist()
    [0.25, 0.75]
    >>> shutter_shares(None, 4).tolist()
    [0.25, 0.25, 0.25, 0.25]
    """
    if curve is None:
        return np.full(count, 1.0 / count)
    # The integral of the curve up to each of its samples and each step's end.
    known = read_curve(curve)
    samples, steps = np.linspace(0.0, 1.0, len(known)), np.linspace(0.0, 1.0, count + 1)
    times = np.union1d(samples, steps)
    openness = np.interp(times, samples, known)
    passed = np.concatenate([[0.0], np.cumsum(0.5 * np.diff(times) * (openness[1:] + openness[:-1]))])
    return np.asarray(np.diff(np.interp(steps, times, passed)) / passed[-1])
