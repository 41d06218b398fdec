"""Numba kernels of deep pixels: tidying the samples of each pixel, and sorting them into depth layers.

A table holds one sample per row: front, back, alpha, red, green, blue (premultiplied), then labels such as motion.
Nothing here validates: the wrappers in ``deep`` do.
"""

import math

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import DoubleArray, IntArray
from spreadlets.compiled import helper, kernel

LayerArray = npt.NDArray[np.float32]

FRONT, BACK, ALPHA, COLOUR, LABELS = 0, 1, 2, 3, 6


@kernel
def density(alpha: float) -> float:
    """Return the optical depth of an alpha, infinite for an opaque sample."""
    return math.inf if alpha >= 1.0 else -math.log1p(-alpha)


@helper
def merge_into(row: DoubleArray, table: DoubleArray, share: DoubleArray) -> None:
    """Mix parts of samples that fill the same range of depth into one.

    Parameters
    ----------
    row : float64 array of shape (n,)
        The result; its front and back are left alone.
    table : float64 array of shape (m, n)
        The samples.
    share : float64 array of shape (m,)
        How much of each sample's length lies in the range; 0 for those that do not take part.

    Notes
    -----
    "Interpreting OpenEXR Deep Pixels": alpha is ``1 - prod (1 - alpha_i)^share_i``, and light is emitted along the way
    in proportion to ``u_i = -log(1 - alpha_i)``: a part's colour is its sample's times ``share_i u_i / alpha_i``,
    attenuated by ``alpha / u``. The document merges two at a time, which gives the same in any order; of opaque samples
    it takes the mean of two, here of all.
    """
    # Sum up the optical depths, and count what is opaque.
    n_opaque = 0
    total = 0.0
    for i in range(table.shape[0]):
        if share[i] > 0.0:
            if table[i, ALPHA] >= 1.0:
                n_opaque += 1
            else:
                total += share[i] * density(table[i, ALPHA])
    # Their sum gives the alpha; opaque samples hide the rest.
    alpha = 1.0 if n_opaque > 0 else -math.expm1(-total)
    attenuation = alpha / total if total > 0.0 else 1.0
    row[ALPHA:] = 0.0
    row[ALPHA] = alpha
    # Add colours by their share of the light, labels by their share of the density.
    weight_sum = 0.0
    for i in range(table.shape[0]):
        if share[i] <= 0.0 or (n_opaque > 0 and table[i, ALPHA] < 1.0):
            continue
        if n_opaque > 0:
            weight = scale = 1.0 / n_opaque
        else:
            u = share[i] * density(table[i, ALPHA])
            scale = (u / table[i, ALPHA] if table[i, ALPHA] > 0.0 else share[i]) * attenuation
            weight = u if total > 0.0 else share[i]
        for k in range(COLOUR, LABELS):
            row[k] += scale * table[i, k]
        for k in range(LABELS, table.shape[1]):
            row[k] += weight * table[i, k]
        weight_sum += weight
    for k in range(LABELS, table.shape[1]):
        row[k] /= weight_sum


@helper
def insert(ascending: DoubleArray, count: int, value: float) -> int:
    """Insert a value into the first numbers of an array, unless it is there; return how many they are now."""
    place = count
    while place > 0 and ascending[place - 1] > value:
        place -= 1
    if place > 0 and ascending[place - 1] == value:
        return count
    for i in range(count, place, -1):
        ascending[i] = ascending[i - 1]
    ascending[place] = value
    return count + 1


@helper
def tidy_pixel(table: DoubleArray, out: DoubleArray) -> int:
    """Split the samples of a pixel where others begin or end, sort them, and merge those that coincide.

    Parameters
    ----------
    table : float64 array of shape (m, n)
        The samples in any order.
    out : float64 array of shape (at least 3 m, n)
        Takes the tidy samples, nearest first.

    Returns
    -------
    int
        How many there are.
    """
    # Between the bounds of all samples, none begins or ends.
    bounds = np.empty(2 * table.shape[0])
    n_bounds = 0
    for i in range(table.shape[0]):
        n_bounds = insert(bounds, n_bounds, table[i, FRONT])
        n_bounds = insert(bounds, n_bounds, table[i, BACK])
    share = np.zeros(table.shape[0])
    count = 0
    for b in range(n_bounds):
        present = False
        for i in range(table.shape[0]):  # points, as surfaces are
            share[i] = 1.0 if table[i, FRONT] == bounds[b] and table[i, BACK] == bounds[b] else 0.0
            present = present or share[i] > 0.0
        if present:
            out[count, FRONT] = out[count, BACK] = bounds[b]
            merge_into(out[count], table, share)
            count += 1
        if b + 1 == n_bounds:
            break
        present = False
        for i in range(table.shape[0]):  # volumes between this bound and the next
            share[i] = 0.0
            if table[i, FRONT] <= bounds[b] and table[i, BACK] >= bounds[b + 1]:
                share[i] = (bounds[b + 1] - bounds[b]) / (table[i, BACK] - table[i, FRONT])
                present = True
        if present:
            out[count, FRONT], out[count, BACK] = bounds[b], bounds[b + 1]
            merge_into(out[count], table, share)
            count += 1
    return count


@kernel
def tidy_pixels(start: IntArray, table: DoubleArray, out: DoubleArray, count: IntArray) -> None:
    """Tidy every pixel.

    Parameters
    ----------
    start : int64 array of shape (n_pixels + 1,)
        First row of each pixel in `table`; three times that in `out`.
    table, out : float64 arrays
        As for `tidy_pixel`.
    count : int64 array of shape (n_pixels,)
        Takes the number of tidy samples of each pixel.
    """
    for pixel in range(count.size):
        begin, end = start[pixel], start[pixel + 1]
        count[pixel] = tidy_pixel(table[begin:end], out[3 * begin : 3 * end]) if end > begin else 0


@kernel
def composite(near: DoubleArray, far: DoubleArray) -> None:
    """Put a nearer sample over a farther one; depth and labels become means by visible alpha. Changes `near`."""
    seen = (1.0 - near[ALPHA]) * far[ALPHA]
    total = near[ALPHA] + seen
    weight = seen / total if total > 0.0 else 0.5
    for k in range(COLOUR, LABELS):
        near[k] += (1.0 - near[ALPHA]) * far[k]
    for k in range(LABELS, near.size):
        near[k] += weight * (far[k] - near[k])
    if math.isfinite(far[BACK]):
        near[FRONT] += weight * (far[FRONT] - near[FRONT])
        near[BACK] += weight * (far[BACK] - near[BACK])
    elif weight > 0.5:
        near[FRONT], near[BACK] = far[FRONT], far[BACK]
    near[ALPHA] = total


@kernel
def collect_layers(start: IntArray, table: DoubleArray, layer: IntArray, out: LayerArray) -> None:
    """Composite the samples of each pixel that share a layer.

    Parameters
    ----------
    start : int64 array of shape (n_pixels + 1,)
        First row of each pixel in `table`.
    table : float64 array of shape (N, n)
        Tidy samples, nearest first; changed in place.
    layer : int64 array of shape (N,)
        The layer of each sample, ascending within a pixel.
    out : float32 array of shape (n_layers, n_pixels, n)
        Takes the layers; rows without a sample are left alone.
    """
    for pixel in range(start.size - 1):
        i = start[pixel]
        while i < start[pixel + 1]:
            first = i
            i += 1
            while i < start[pixel + 1] and layer[i] == layer[first]:
                composite(table[first], table[i])
                i += 1
            for k in range(table.shape[1]):
                out[layer[first], pixel, k] = table[first, k]


@helper
def add_seams(bins: IntArray, begin: int, end: int, other: int, other_end: int, seam: DoubleArray) -> None:
    """Count, for every cut, the samples of a pixel that it parts from the nearest in depth of a neighbour's samples.

    Parameters
    ----------
    bins : int64 array of shape (N,)
        Samples' bins of 1 over the depth, descending within a pixel.
    begin, end, other, other_end : int
        The pixel's samples and the neighbour's.
    seam : float64 array
        Differences of the counts: a cut below bin t parts what is in t from what is in t - 1.
    """
    if other == other_end:
        return
    j = other
    for i in range(begin, end):
        while j + 1 < other_end and abs(bins[j + 1] - bins[i]) <= abs(bins[j] - bins[i]):
            j += 1
        seam[min(bins[i], bins[j]) + 1] += 0.5
        seam[max(bins[i], bins[j]) + 1] -= 0.5


@kernel
def seam_lengths(start: IntArray, bins: IntArray, width: int, seam: DoubleArray) -> None:
    """Add the seams between all neighbouring pixels of an image to `seam`; see `add_seams`."""
    n_pixels = start.size - 1
    for pixel in range(n_pixels):
        for other in (pixel + 1, pixel + width):
            if other >= n_pixels or (other == pixel + 1 and other % width == 0):
                continue
            add_seams(bins, start[pixel], start[pixel + 1], start[other], start[other + 1], seam)
            add_seams(bins, start[other], start[other + 1], start[pixel], start[pixel + 1], seam)
