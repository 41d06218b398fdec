"""What a spreadlet is worth: its figures beside the dense PSF that it stands for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import DoubleArray
from spreadlets.metrics import psf_l1, psf_similarity
from spreadlets.precompute.sparsify.green import reconstruct
from spreadlets.precompute.sparsify.preparation import checked, moved, offset_of_support, on_box, split_spike, support
from spreadlets.psf.laplacian import laplacian
from spreadlets.psf.spreadlet import Spreadlet

Result = tuple[Spreadlet, dict[str, float]]


def measure_spreadlet(psf: npt.ArrayLike, spreadlet: Spreadlet) -> dict[str, float]:
    """Measure a spreadlet against the dense PSF that it stands for, as `sparsify` does.

    Parameters
    ----------
    psf : array_like of shape (H, W, C) or (H, W)
        As for `sparsify`.
    spreadlet : Spreadlet

    Returns
    -------
    dict of str to float
        The statistics that `sparsify` returns.

    Raises
    ------
    InvalidParameterError
        If the PSF is malformed.
    """
    dense = checked(psf)
    shift = offset_of_support(dense)
    rest, spike = split_spike(moved(dense, -shift))
    boxed = on_box(rest)
    offset = spreadlet.offset_rc.astype(np.int64) - shift
    outside = np.maximum(np.abs(offset).max(axis=0, initial=0) - np.asarray(boxed.shape[:2]) // 2, 0)
    boxed = np.pad(boxed, [(n, n) for n in outside] + [(0, 0)])
    return measured(boxed, replace(spreadlet, offset_rc=offset.astype(np.int16)), spike)[1]


def measured(psf: DoubleArray, spreadlet: Spreadlet, spike: DoubleArray | float = 0.0) -> Result:
    """Measure a spreadlet against the PSF on its box, both without the PSF's spike."""
    offset, value = spreadlet.offset_rc.astype(np.int64), spreadlet.value.astype(np.float64)
    # Draw the spreadlet on the PSF's box, and take its spike off.
    if spreadlet.direct:
        dense = np.zeros_like(psf)
        row, column = (offset + np.asarray(psf.shape[:2]) // 2).T
        dense[row, column] = value
    else:
        dense = reconstruct(offset, value, psf.shape[:2])
    dense[tuple(np.asarray(psf.shape[:2]) // 2)] -= spike
    # Its energy: a sum of pixels, or a quarter of the trace of a Laplacian's second moments.
    moments = spreadlet.moments()
    energy = (moments[0] if spreadlet.direct else 0.25 * (moments[4] + moments[5])) - spike
    true_energy = psf.sum(axis=(0, 1))
    # Compare with the PSF.
    largest = float(np.abs(psf if spreadlet.direct else laplacian(psf)).max())
    n_support = int(support(psf).sum())
    return spreadlet, {
        "n_points": spreadlet.n_points,
        "n_support": n_support,
        "sparsity": spreadlet.n_points / n_support,
        "ssim": psf_similarity(psf, dense),
        "l1": psf_l1(psf, dense),
        "energy_error": float(np.abs(energy - true_energy).max() / true_energy.max()),
        "max_value_ratio": float(np.abs(value).max()) / largest,
    }
