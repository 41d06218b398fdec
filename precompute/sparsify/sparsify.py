"""From a dense PSF to its spreadlet, by one of three ways: fitted, which is the default, quickly, or as published."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy.typing as npt

from spreadlets.arrays import DoubleArray
from spreadlets.errors import InvalidParameterError
from spreadlets.precompute.sparsify.fitted import sparsify_fitted
from spreadlets.precompute.sparsify.lks import sparsify_lks
from spreadlets.precompute.sparsify.measurement import Result
from spreadlets.precompute.sparsify.preparation import checked

SPARSIFIERS: dict[str, Callable[[DoubleArray, float, int], Result]] = {
    "fit": sparsify_fitted,
    "quick": partial(sparsify_fitted, quick=True),
    "lks": sparsify_lks,
}
"""What turns a checked PSF, a density and a seed into a spreadlet and its figures. ``fit`` chooses points and values by
least squares; ``quick`` does so in half of the time, for apertures that are waited for, at a similarity lower by .006;
``lks`` is LKS section 5.5 to the letter, for comparisons: it takes more points for less similarity."""

DEFAULT_SPARSIFIER = "fit"


def sparsify(
    psf: npt.ArrayLike, *, density: float = 1.0, seed: int = 0, sparsifier: str = DEFAULT_SPARSIFIER
) -> Result:
    """Turn a dense PSF into a spreadlet.

    Parameters
    ----------
    psf : array_like of shape (H, W, C) or (H, W)
        PSF, non-negative, centred on the middle pixel; H and W odd.
    density : float
        Operating point: 0.5, 1 and 2 give about half, the usual number and twice as many points (LKS Fig. 10 d).
    seed : int
        Of all random choices.
    sparsifier : str
        A key of `SPARSIFIERS`.

    Returns
    -------
    spreadlet : Spreadlet
        Its energy, and if it is fitted and not direct its moments up to the second order, are the PSF's.
    statistics : dict of str to float
        See `precompute.sparsify.measurement.measure_spreadlet`.

    Raises
    ------
    InvalidParameterError
        If the PSF is malformed, the density is not above 0, or there is no such sparsifier.

    Notes
    -----
    LKS section 5.5; the direct track is LKS section 6.4.

    Examples
    --------
    >>> import numpy as np
    >>> rows, cols = np.indices((41, 41)) - 20
    >>> disc = (np.hypot(rows, cols) <= 15).astype(float)
    >>> spreadlet, statistics = sparsify(disc / disc.sum())
    >>> spreadlet.n_points < 0.3 * disc.sum(), statistics["ssim"] > 0.95
    (True, True)
    """
    if not density > 0:
        raise InvalidParameterError(f"density must be above 0, not {density}")
    check_sparsifier(sparsifier)
    return SPARSIFIERS[sparsifier](checked(psf), density, seed)


def check_sparsifier(name: str) -> None:
    """Refuse a name that is no key of `SPARSIFIERS`."""
    if name not in SPARSIFIERS:
        raise InvalidParameterError(f"sparsifier is {name!r}: allowed are {', '.join(map(repr, SPARSIFIERS))}")
