"""From wavelengths to linear sRGB through the CIE 1931 observer."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import DoubleArray

SHORTEST_NM, LONGEST_NM = 400.0, 700.0
"""Range of the wavelengths that are sampled; beyond it lies less than 1 % of the observer's response."""

LOBES = (
    ((1.056, 599.8, 37.9, 31.0), (0.362, 442.0, 16.0, 26.7), (-0.065, 501.1, 20.4, 26.2)),
    ((0.821, 568.8, 46.9, 40.5), (0.286, 530.9, 16.3, 31.1)),
    ((1.217, 437.0, 11.8, 36.0), (0.681, 459.0, 26.0, 13.8)),
)
"""Height, place and the widths to either side, nm, of the lobes of x, y and z (Wyman, Sloan and Shirley 2013)."""

XYZ_TO_SRGB = np.array(
    [[3.2404542, -1.5371385, -0.4985314], [-0.9692660, 1.8760108, 0.0415560], [0.0556434, -0.2040259, 1.0572252]]
)
"""IEC 61966-2-1, for white D65."""

N_NODES = 1201


def observer(wavelength_nm: npt.ArrayLike) -> DoubleArray:
    """Return the colour matching functions x, y and z of the CIE 1931 observer at wavelengths (...), as (..., 3)."""
    wavelength = np.asarray(wavelength_nm, np.float64)
    curves = []
    for lobes in LOBES:
        curve = np.zeros_like(wavelength)
        for height, place, below, above in lobes:
            width = np.where(wavelength < place, below, above)
            curve += height * np.exp(-0.5 * ((wavelength - place) / width) ** 2)
        curves.append(curve)
    return np.stack(curves, axis=-1)


def rgb_response(wavelength_nm: npt.ArrayLike) -> DoubleArray:
    """Return what light of single wavelengths (...) adds to linear sRGB, as (..., 3).

    An even spectrum is white: the mean over the range of wavelengths is (1, 1, 1). Single wavelengths lie outside the
    gamut, so some values are negative; where colours meet again they cancel.
    """
    return np.asarray(observer(wavelength_nm) @ XYZ_TO_SRGB.T / _white())


@lru_cache(maxsize=1)
def _white() -> DoubleArray:
    """Return the mean of the unscaled response over the range of wavelengths."""
    step = (np.arange(N_NODES) + 0.5) / N_NODES
    return np.asarray((observer(SHORTEST_NM + (LONGEST_NM - SHORTEST_NM) * step) @ XYZ_TO_SRGB.T).mean(axis=0))
