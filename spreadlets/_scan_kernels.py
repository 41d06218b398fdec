"""Compiled kernels that answer questions about whole arrays."""

import numpy as np

from spreadlets.compiled import kernel


@kernel
def holds_anything(begin, end, rows):
    """Tell whether any value of ``rows`` (n, m), float32, is not 0."""
    for row in range(begin, end):
        found = False
        # Row by row: many values are compared at once, and the first row that holds any ends it.
        for col in range(rows.shape[1]):
            found |= rows[row, col] != 0.0
        if found:
            return True
    return False


@kernel
def count_alphas(begin, end, radiance, counts):
    """Fill ``counts`` (H, 3), int64, with the pixels of each row that are transparent, in part so, and opaque.

    Parameters
    ----------
    radiance : ndarray of shape (H, W, 4), float32
    """
    for row in range(begin, end):
        nothing, part, whole = 0, 0, 0
        for col in range(radiance.shape[1]):
            alpha = radiance[row, col, 3]
            nothing += alpha == 0.0
            part += 0.0 < alpha < 1.0
            whole += alpha == 1.0
        counts[row, 0], counts[row, 1], counts[row, 2] = nothing, part, whole


@kernel
def visible_range(begin, end, depth, radiance, limit, ends):
    """Fill ``ends`` (H, 2), float32, with the least and the largest depth of what each row shows nearer than a limit.

    Parameters
    ----------
    depth : ndarray of shape (H, W), float32
    radiance : ndarray of shape (H, W, 4), float32
    limit : float
    """
    for row in range(begin, end):
        low, high = np.float32(np.inf), np.float32(0.0)
        for col in range(depth.shape[1]):
            if depth[row, col] < limit and radiance[row, col, 3] > 0.0:
                low, high = min(low, depth[row, col]), max(high, depth[row, col])
        ends[row, 0], ends[row, 1] = low, high


@kernel
def copy_rows(begin, end, given, out):
    """Copy rows (n, m), float32."""
    for row in range(begin, end):
        source, target = given[row], out[row]
        for i in range(target.shape[0]):
            target[i] = source[i]


@kernel
def clear_rows(begin, end, out):
    """Fill rows (n, m) with 0."""
    for row in range(begin, end):
        out[row] = 0
