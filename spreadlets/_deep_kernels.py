"""Numba kernels of deep pixels: tidying the samples of each pixel, and thinning them out.

A table holds one sample per row: front, back, alpha, red, green, blue (premultiplied), then labels such as motion.
Nothing here validates: the wrappers in ``deep`` do.
"""

import math

import numba
import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

FRONT, BACK, ALPHA, COLOUR, LABELS = 0, 1, 2, 3, 6


@numba.njit(cache=True, fastmath=False)
def density(alpha: float) -> float:
    """Return the optical depth of an alpha, infinite for an opaque sample."""
    return math.inf if alpha >= 1.0 else -math.log1p(-alpha)


@numba.njit(cache=True, fastmath=False)
def merge_into(row: FloatArray, table: FloatArray, share: FloatArray) -> None:
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
    n_opaque = 0
    total = 0.0
    for i in range(table.shape[0]):
        if share[i] > 0.0:
            if table[i, ALPHA] >= 1.0:
                n_opaque += 1
            else:
                total += share[i] * density(table[i, ALPHA])
    alpha = 1.0 if n_opaque > 0 else -math.expm1(-total)
    attenuation = alpha / total if total > 0.0 else 1.0
    row[ALPHA:] = 0.0
    row[ALPHA] = alpha
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


@numba.njit(cache=True, fastmath=False)
def tidy_pixel(table: FloatArray, out: FloatArray) -> int:
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
    bounds = np.unique(np.concatenate((table[:, FRONT], table[:, BACK])))
    share = np.zeros(table.shape[0])
    count = 0
    for b in range(bounds.size):
        present = False
        for i in range(table.shape[0]):  # points, as surfaces are
            share[i] = 1.0 if table[i, FRONT] == bounds[b] and table[i, BACK] == bounds[b] else 0.0
            present = present or share[i] > 0.0
        if present:
            out[count, FRONT] = out[count, BACK] = bounds[b]
            merge_into(out[count], table, share)
            count += 1
        if b + 1 == bounds.size:
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


@numba.njit(cache=True, fastmath=False)
def tidy_pixels(start: IntArray, table: FloatArray, out: FloatArray, count: IntArray) -> None:
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


@numba.njit(cache=True, fastmath=False)
def thin_pixel(table: FloatArray, count: int, most: int) -> int:
    """Composite the neighbours that are closest together, in 1 over the depth, until few enough samples are left.

    Parameters
    ----------
    table : float64 array of shape (at least count, n)
        Tidy samples, nearest first; changed in place. A merged sample's depth and labels are means by visible alpha.
    count, most : int
        How many samples there are, and may be left.

    Returns
    -------
    int
        How many are left.
    """
    while count > most:
        best, smallest = 0, math.inf
        for i in range(count - 1):
            gap = 2.0 / (table[i, FRONT] + table[i, BACK]) - 2.0 / (table[i + 1, FRONT] + table[i + 1, BACK])
            if gap < smallest:
                best, smallest = i, gap
        near, far = table[best], table[best + 1]
        seen = (1.0 - near[ALPHA]) * far[ALPHA]
        total = near[ALPHA] + seen
        weight = seen / total if total > 0.0 else 0.5
        for k in range(COLOUR, LABELS):
            near[k] += (1.0 - near[ALPHA]) * far[k]
        for k in range(LABELS, table.shape[1]):
            near[k] += weight * (far[k] - near[k])
        if math.isfinite(far[BACK]):
            near[FRONT] += weight * (far[FRONT] - near[FRONT])
            near[BACK] += weight * (far[BACK] - near[BACK])
        elif weight > 0.5:
            near[FRONT], near[BACK] = far[FRONT], far[BACK]
        near[ALPHA] = total
        table[best + 1 : count - 1] = table[best + 2 : count].copy()
        count -= 1
    return count


@numba.njit(cache=True, fastmath=False)
def thin_pixels(start: IntArray, table: FloatArray, count: IntArray, most: int) -> None:
    """Thin out every pixel; `count`, an int64 array of shape (n_pixels,), is updated. See `thin_pixel`."""
    for pixel in range(count.size):
        count[pixel] = thin_pixel(table[start[pixel] : start[pixel + 1]], count[pixel], most)
