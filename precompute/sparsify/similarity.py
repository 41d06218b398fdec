"""The quadratic form of structural dissimilarity: what least squares must minimise for SSIM to rise.

With a known PSF f (peak 1), an error e, the SSIM's window w (mean ``w * e``) and its constants C1 and C2,

    1 - SSIM  ~  mean of  (w * e)^2 / (2 mu^2 + C1)  +  (w * e^2 - (w * e)^2) / (2 sigma^2 + C2)

to second order in e, where mu and sigma are the window's mean and standard deviation of f. Dark and flat regions weigh
a thousand times more than edges, which hide errors. The second term, a local variance, is replaced by the squared
gradient of a filtered error, ``|D (k * e)|^2``, with k such that both agree for every plane wave. Then the form is a
sum of squares of translation-invariant filters of e, each row of the least-squares problem is a look-up in a filtered
lattice Green's function, and away from the points, where e is smooth, few samples suffice.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import scipy.linalg
from scipy import fft
from scipy.ndimage import correlate1d, distance_transform_edt, uniform_filter

from spreadlets.arrays import DoubleArray, IntArray
from spreadlets.precompute.sparsify import _sparsify_kernels as _kernels
from spreadlets.precompute.sparsify.fit import Equations, moment_constraints, orthonormal_constraints, project
from spreadlets.precompute.sparsify.green import green_table
from spreadlets.precompute.sparsify.symmetry import Symmetry, representatives

MEAN_CONSTANT = 1e-4
VARIANCE_CONSTANT = 9e-4
"""C1 and C2 of the SSIM for a data range of 1: (0.01)^2 and (0.03)^2."""

WINDOW_SIGMA = 1.5
WINDOW_RADIUS = 5
"""Gaussian window of the SSIM (Wang et al. 2004), px; windows that leave the image are not counted."""

DETAIL_RADIUS = 5
"""Radius at which the detail filter is cut, px; beyond it lies less than 1e-3 of its sum."""

STRIDES = ((1, 0.0), (2, 3.0), (4, 8.0), (8, 20.0))
"""Spacing of the samples and the distance from the points, px, from which it suffices: the error smooths with it."""

CHUNK = 2048
"""Samples whose rows are held at a time; they stay in the cache between their making and their product."""

MAX_SAMPLES = 6000
"""More samples than this, in the largest PSFs, are thinned evenly: three rows each stay far more than the unknowns."""

GOLDEN = (np.sqrt(5.0) - 1.0) / 2.0
_FREQUENCIES = 256


class Samples(NamedTuple):
    """Where the form is sampled, and what the reconstruction should give there."""

    offset_rc: IntArray
    """Offsets from the centre, shape (S, 2)."""
    weight: DoubleArray
    """Square roots of the weights of the window mean and of the detail's two differences, shape (S, 3)."""
    target: DoubleArray
    """The weighted rows' values for the PSF itself, shape (S, 3, C)."""


def window() -> DoubleArray:
    """Return the SSIM's one-dimensional window, shape (11,)."""
    taps = np.exp(-0.5 * (np.arange(-WINDOW_RADIUS, WINDOW_RADIUS + 1) / WINDOW_SIGMA) ** 2)
    return np.asarray(taps / taps.sum())


@lru_cache(maxsize=1)
def detail_filter() -> DoubleArray:
    """Return the filter k whose gradient has the window variance's spectrum, shape (11, 11).

    With the window's transfer function W and the 5-point Laplacian's, -lambda, it is ``sqrt((1 - W^2) / lambda)``.
    """
    taps = window()
    omega = 2 * np.pi * np.fft.fftfreq(_FREQUENCIES)
    offset = np.arange(-WINDOW_RADIUS, WINDOW_RADIUS + 1)
    transfer = np.cos(np.outer(omega, offset)) @ taps
    eigenvalue = (2 - 2 * np.cos(omega))[:, None] + (2 - 2 * np.cos(omega))[None, :]
    eigenvalue[0, 0] = 1.0
    spectrum = np.sqrt(np.maximum(1 - np.outer(transfer, transfer) ** 2, 0.0) / eigenvalue)
    spectrum[0, 0] = np.sqrt(taps @ offset**2)
    centred = np.fft.fftshift(np.fft.ifft2(spectrum).real)
    cut = slice(_FREQUENCIES // 2 - DETAIL_RADIUS, _FREQUENCIES // 2 + DETAIL_RADIUS + 1)
    kernel = centred[cut, cut]
    return np.asarray(kernel * (spectrum[0, 0] / kernel.sum()))


def with_detail(image: DoubleArray) -> DoubleArray:
    """Return an image (H, W), zero outside, convolved with `detail_filter`.

    By its spectrum, as SciPy's `fftconvolve` does, whose module takes a second to import.
    """
    kernel = detail_filter()
    room = [fft.next_fast_len(sum(sizes) - 1, real=True) for sizes in zip(image.shape, kernel.shape, strict=True)]
    whole = fft.irfftn(fft.rfftn(image, room) * fft.rfftn(kernel, room), room)
    return np.asarray(whole[DETAIL_RADIUS:, DETAIL_RADIUS:][: image.shape[0], : image.shape[1]])


@lru_cache(maxsize=4)
def _tables(size: int) -> tuple[DoubleArray, DoubleArray]:
    """Filter the table of the lattice Green's function of a size by the window and by the detail filter."""
    margin = max(WINDOW_RADIUS, DETAIL_RADIUS)
    quarter = green_table(size - 1)
    half = np.concatenate([quarter[margin:0:-1], quarter])
    mirrored = np.concatenate([half[:, margin:0:-1], half], axis=1)
    taps, inner = window(), slice(margin, -margin)
    mean = correlate1d(correlate1d(mirrored, taps, axis=0), taps, axis=1)
    detail = with_detail(mirrored)
    return np.ascontiguousarray(mean[inner, inner]), np.ascontiguousarray(detail[inner, inner])


def similarity_weights(psf: DoubleArray) -> DoubleArray:
    """Return the pixel weights of the squared window mean and of the squared differences of the detail of the error.

    Parameters
    ----------
    psf : ndarray of shape (H, W, C), float64
        PSF scaled to peak 1, over the box in which the similarity is measured.

    Returns
    -------
    ndarray of shape (H, W, 3), float64
        Of the mean, and of the detail's forward differences along columns and rows; the same for all channels. The
        sum of weight times square over all pixels and channels approximates 1 - SSIM.
    """
    mean = _blur(psf)
    variance = np.maximum(_blur(psf * psf) - mean * mean, 0.0)
    counted = np.zeros((*psf.shape[:2], 1))
    counted[WINDOW_RADIUS:-WINDOW_RADIUS, WINDOW_RADIUS:-WINDOW_RADIUS] = 1.0
    # Once for the mean of the weights over the channels, once for that of the squares which they will multiply.
    counted /= counted.sum() * psf.shape[2] ** 2
    mean_weight = (counted / (2 * mean * mean + MEAN_CONSTANT)).sum(axis=2)
    detail_weight = _blur((counted / (2 * variance + VARIANCE_CONSTANT)).sum(axis=2))
    # A forward difference lies half a pixel on, and the weights change steeply at the PSF's edges.
    ahead = [0.5 * (detail_weight + np.roll(detail_weight, -1, axis=axis)) for axis in (1, 0)]
    return np.stack([mean_weight, *ahead], axis=2)


def similarity_equations(psf: DoubleArray, members: IntArray, size: IntArray, group: tuple[Symmetry, ...]) -> Equations:
    """Build the least-squares problem of the orbits' values in the similarity form.

    Parameters
    ----------
    psf : ndarray of shape (H, W, C), float64
        PSF scaled to peak 1, symmetric under the group, centred on the box in which the similarity is measured.
    members : ndarray of shape (m, g, 2), int64
        The orbits, as `precompute.sparsify.symmetry.orbits` gives them.
    size : ndarray of shape (m,), int64
        Number of distinct points of each.
    group : tuple of Symmetry
        The PSF's symmetries.

    Returns
    -------
    Equations
        One unknown per orbit; the form is an estimate of 1 - SSIM.
    """
    # Sum the moment constraints over each orbit, and make them orthonormal.
    matrix, target = moment_constraints(psf, members.reshape(-1, 2))
    share = size / members.shape[1]
    matrix = matrix.reshape(len(matrix), *members.shape[:2]).sum(axis=2) * share
    basis, fixed = orthonormal_constraints(matrix, target)
    # Choose the samples, and tabulate the Green's function as far as they lie from points.
    samples = _choose_samples(psf, members, group)
    reach = int(np.abs(samples.offset_rc).max()) + int(np.abs(members).max()) + 1
    tables = _tables(len(green_table(reach + max(WINDOW_RADIUS, DETAIL_RADIUS))))
    # Accumulate the normal equations of what the constraints leave open, chunk by chunk.
    gram = np.zeros((len(members), len(members)), order="F")
    rhs = np.zeros((len(members), psf.shape[2]))
    particular, constant = basis @ fixed, 0.0
    for begin in range(0, len(samples.offset_rc), CHUNK):
        part = slice(begin, begin + CHUNK)
        rows = np.empty((3 * len(samples.offset_rc[part]), len(members)))
        _kernels.fill_rows(samples.offset_rc[part], samples.weight[part], members, share, *tables, rows)
        residual = samples.target[part].reshape(-1, psf.shape[2]) - rows @ particular
        gram = scipy.linalg.blas.dsyrk(1.0, rows.T, beta=1.0, c=gram, overwrite_c=1)
        rhs += rows.T @ residual
        constant += float((residual**2).sum())
    # Fill the other triangle, and project onto the constraints' complement.
    gram = np.triu(gram) + np.triu(gram, 1).T
    return Equations(project(gram, basis), rhs - basis @ (basis.T @ rhs), constant, basis, fixed)


def _choose_samples(psf: DoubleArray, members: IntArray, group: tuple[Symmetry, ...]) -> Samples:
    """Sample densely near the points and sparsely elsewhere, and only one of each set of symmetric pixels."""
    # Find each pixel's distance from the points.
    half = np.asarray(psf.shape[:2]) // 2
    free = np.ones(psf.shape[:2], dtype=np.bool_)
    rows, columns = (members.reshape(-1, 2) + half).T
    free[rows, columns] = False
    distance = distance_transform_edt(free)
    weights = similarity_weights(psf)
    # Farther out, take pixels at wider strides; each stands for all of its block.
    offsets, scaled = [], []
    for index, (stride, begin) in enumerate(STRIDES):
        end = STRIDES[index + 1][1] if index + 1 < len(STRIDES) else np.inf
        picked = np.argwhere((distance >= begin) & (distance < end)) - half
        picked = picked[(picked % stride == 0).all(axis=1)]
        spread = uniform_filter(weights, (stride, stride, 1)) if stride > 1 else weights
        offsets.append(picked)
        scaled.append(stride**2 * spread[picked[:, 0] + half[0], picked[:, 1] + half[1]])
    offset, weight = np.concatenate(offsets), np.concatenate(scaled)
    # Take one of each set of symmetric pixels, which stands for all of them.
    chosen, repeats = representatives(offset, group)
    offset, weight = offset[chosen], weight[chosen] * repeats[:, None]
    # Thin out what is too many.
    kept, share = _thin(free[tuple((offset + half).T)])
    offset, weight = offset[kept], np.sqrt(np.maximum(weight[kept], 0.0) / share[:, None])
    return Samples(offset, weight, _targets(psf, offset + half, weight))


def _thin(between: npt.NDArray[np.bool_]) -> tuple[IntArray, DoubleArray]:
    """Keep the samples on points, lest a spike hide there, and some of those between; return how many each stands for.

    Returns
    -------
    index : ndarray of shape (m,), int64
        The kept samples, spread evenly over all of them by the golden ratio.
    share : ndarray of shape (m,), float64
        Fraction that was kept of their kind.
    """
    on_points, others = np.flatnonzero(~between), np.flatnonzero(between)
    room = max(MAX_SAMPLES - len(on_points), 1)
    share = 1.0
    if len(others) > room:
        others = others[np.unique((np.arange(room) * GOLDEN % 1.0 * len(others)).astype(np.int64))]
        share = len(others) / np.count_nonzero(between)
    return np.concatenate([on_points, others]), np.repeat([1.0, share], [len(on_points), len(others)])


def _targets(psf: DoubleArray, pixel_rc: IntArray, weight: DoubleArray) -> DoubleArray:
    """Return the weighted rows' values (S, 3, C) for the PSF itself."""
    row, column = pixel_rc.T
    padded = np.pad(psf, ((0, 1), (0, 1), (0, 0)))
    detail = np.stack([with_detail(plane) for plane in np.moveaxis(padded, 2, 0)], -1)
    here = detail[row, column]
    values = [_blur(psf)[row, column], detail[row, column + 1] - here, detail[row + 1, column] - here]
    return np.asarray(weight[:, :, None] * np.stack(values, axis=1))


def _blur(image: DoubleArray) -> DoubleArray:
    """Apply the SSIM's window along both axes, zero outside the image."""
    taps = window()
    return np.asarray(correlate1d(correlate1d(image, taps, axis=0, mode="constant"), taps, axis=1, mode="constant"))
