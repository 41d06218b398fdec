"""Compiled kernels that tell filtered depth from point samples, and undo the filter."""

import math

import numpy as np

from spreadlets.compiled import helper, kernel

REACH = 2
"""A blend's surfaces are looked for within this, px: filters are up to 3 px wide."""
FLATNESS = 0.2
"""Largest difference of places on one surface, as a share of the gap between two."""
SMOOTHNESS = 0.05
"""The same for pixels that are taken for no blend: those of a blend's neighbours along an edge may be as close."""
PURITY = 0.98
"""Share of a surface from which a pixel's depth is that of the surface."""
STEPS_ALONG = 3
"""So often, from what is thin, one like it is looked for that is purer: along it, some pixel's centre lies amid it."""

NOTHING_REACH = 4
"""The same for a pixel with nothing in it: half a filter from the edge of a thing half a filter thick."""
CLEAR_ALPHA = 0.1
"""Alpha from which a pixel's depth tells that of its surface when nothing is behind it."""
MISSED_REACH = 16
"""How far, px, the surface is looked for of a pixel that shows a part of one while its depth is that of nothing."""


@helper
def _edge_kind(line, start, gap):
    """Return 1 if an edge jumps right behind a place of a line, 2 if it passes through one to three others, else 0.

    It leads from what is flat to what is flat, too, or to the ridge of something thin, behind which there is again what
    there was before.
    """
    first = line[start]
    for step in range(1, min(5, len(line) - 1 - start)):
        here = line[start + step]
        rise = here - first
        if rise * (here - line[start + step - 1]) <= 0.0:
            return 0
        flat = FLATNESS * abs(rise)
        if abs(rise) < gap or abs(first - line[start - 1]) > flat:
            continue
        # What is still the one surface, or the other already, is no place between them.
        if min(abs(line[start + 1] - first), abs(here - line[start + step - 1])) <= SMOOTHNESS * abs(rise):
            continue
        if abs(line[start + step + 1] - here) <= flat or _returns(line, start, start + step, flat):
            return 1 if step == 1 else 2
    return 0


@helper
def _returns(line, start, ridge, flat):
    """Return whether a line falls behind a ridge, within a few places, to what it was at its start, and stays there."""
    for end in range(ridge + 1, min(ridge + 5, len(line) - 1)):
        if (line[end] - line[end - 1]) * (line[ridge] - line[start]) >= 0.0:
            return False
        if abs(line[end] - line[start]) <= flat:
            return abs(line[end + 1] - line[start]) <= flat
    return False


@kernel
def count_edges(begin, end, place, gap, counts):
    """Count the edges along each row that jump from one pixel to the next, and those that pass through others.

    Parameters
    ----------
    place : ndarray of shape (H, W), float32
        Where surfaces lie in depth, as CoC radii, px.
    gap : float
        Least height of an edge.
    counts : ndarray of shape (H, 2), int64
        Filled; both sides of each edge are flat.
    """
    for row in range(begin, end):
        counts[row, 0] = counts[row, 1] = 0
        for col in range(1, place.shape[1] - 2):
            kind = _edge_kind(place[row], col, gap)
            if kind:
                counts[row, kind - 1] += 1


@helper
def _are_close(depth, place, one, other, most):
    """Return whether two pixels are of one surface: neither depth nor place differs by more than ``most``."""
    if abs(place[one] - place[other]) > most[1]:
        return False
    return depth[one] == depth[other] or abs(depth[one] - depth[other]) <= most[0]


@helper
def _lies_on_surface(depth, place, alpha, row, col, most):
    """Return whether a pixel is, or lies beside, one of its depth that is amid others of this depth."""
    height, width = place.shape
    for i in range(max(row - 1, 0), min(row + 2, height)):
        for j in range(max(col - 1, 0), min(col + 2, width)):
            amid = alpha[i, j] > 0.0 and _are_close(depth, place, (row, col), (i, j), most)
            for k in range(max(i - 1, 0), min(i + 2, height)):
                for m in range(max(j - 1, 0), min(j + 2, width)):
                    amid = amid and _are_close(depth, place, (i, j), (k, m), most)
            if amid:
                return True
    return False


@helper
def _purer(depth, place, alpha, start, most):
    """Return a pixel that shows more of something thin, all of whose pixels are blends, than one of it does."""
    height, width = place.shape
    near = start
    for _ in range(STEPS_ALONG):
        if _lies_on_surface(depth, place, alpha, near[0], near[1], most):
            break
        row, col = near
        for i in range(max(row - REACH, 0), min(row + REACH + 1, height)):
            for j in range(max(col - REACH, 0), min(col + REACH + 1, width)):
                near = (i, j) if depth[i, j] < depth[near] else near
        if near == (row, col):
            break
    return near


@kernel
def undo_filter(begin, end, depth, place, alpha, gap, source, share):
    """Find the pixels whose depth is a blend of two surfaces', and the nearest or farthest pixel that it is more of.

    Parameters
    ----------
    depth, place : ndarray of shape (H, W), float32
        Metres; CoC radii, px.
    alpha : ndarray of shape (H, W), float32
        Where it is 0, there is no surface.
    gap : float
        Least difference of the surfaces' places.
    source : ndarray of shape (H, W, 2), int32
        Filled with row and column of a pixel that has the label of the greater share; else those of the pixel itself.
    share : ndarray of shape (H, W), float32
        Filled with the share of the nearer surface, -1 where the pixel is no blend of two.
    """
    height, width = depth.shape
    for row in range(begin, end):
        for col in range(width):
            source[row, col, 0], source[row, col, 1] = row, col
            share[row, col] = -1.0
            if alpha[row, col] == 0.0:
                continue
            # Find the nearest and the farthest pixel around it.
            near, far = (row, col), (row, col)
            for i in range(max(row - REACH, 0), min(row + REACH + 1, height)):
                for j in range(max(col - REACH, 0), min(col + REACH + 1, width)):
                    near = (i, j) if depth[i, j] < depth[near] else near
                    far = (i, j) if depth[i, j] > depth[far] else far
            # Without a step in depth, or on its near side, the pixel is no blend.
            step = place[far] - place[near]
            if step >= gap:
                near = _purer(depth, place, alpha, near, (SMOOTHNESS * (depth[far] - depth[near]), SMOOTHNESS * step))
                step = place[far] - place[near]
            if step < gap or place[row, col] <= place[near]:
                continue
            # Find how far its depth lies from the near one's to the far one's: a pure pixel, or a slope, is no blend.
            rise = depth[far] - depth[near]
            part = 0.0 if math.isinf(rise) else (depth[row, col] - depth[near]) / rise
            if part >= PURITY or math.isinf(depth[row, col]):
                continue
            if _lies_on_surface(depth, place, alpha, row, col, (SMOOTHNESS * rise, SMOOTHNESS * step)):
                continue
            # Replace it by the pixel that it is more of.
            whole = alpha[far] == 0.0 or alpha[near] == 0.0
            chosen = near if (part < 0.5 and not whole) or alpha[far] == 0.0 else far
            source[row, col, 0], source[row, col, 1] = chosen
            share[row, col] = -1.0 if whole else 1.0 - part


@helper
def _depth_of_nothing(depth, alpha, row, col):
    """Return the depth of the nearest pixel without a surface, NaN if there is none within reach."""
    height, width = depth.shape
    found, nearest = np.nan, math.inf
    for i in range(max(row - NOTHING_REACH, 0), min(row + NOTHING_REACH + 1, height)):
        for j in range(max(col - NOTHING_REACH, 0), min(col + NOTHING_REACH + 1, width)):
            distance = (i - row) ** 2 + (j - col) ** 2
            if alpha[i, j] == 0.0 and distance < nearest:
                found, nearest = np.float64(depth[i, j]), distance
    return found


@kernel
def take_nothing_out(begin, end, depth, alpha, surface):
    """Fill ``surface`` (H, W), float32, with the depth of what covers a pixel, or a part of it with nothing behind.

    Such a depth, if it is filtered, is the surface's times alpha and what stands for nothing times the rest. NaN where
    that cannot be told: where no empty pixel is near, and from an alpha below `CLEAR_ALPHA`.
    """
    for row in range(begin, end):
        for col in range(depth.shape[1]):
            part = np.float64(alpha[row, col])
            surface[row, col] = depth[row, col] if part == 1.0 else np.nan
            if CLEAR_ALPHA <= part < 1.0:
                behind = _depth_of_nothing(depth, alpha, row, col)
                surface[row, col] = (depth[row, col] - (1.0 - part) * behind) / part


@kernel
def find_missed(begin, end, depth, alpha, nothing, source):
    """Find the surfaces of pixels that show a part of one, while the sample of their depth has missed it.

    Parameters
    ----------
    depth, alpha : ndarray of shape (H, W), float32
    nothing : float32
        Depth of what is empty.
    source : ndarray of shape (H, W, 2), int32
        Filled with row and column of the pixel that tells a pixel's labels: the nearest one of a surface.

    Returns
    -------
    bool
        Whether there are such pixels.
    """
    height, width = depth.shape
    found = False
    for row in range(begin, end):
        for col in range(width):
            source[row, col, 0], source[row, col, 1] = row, col
            if not 0.0 < alpha[row, col] < 1.0 or depth[row, col] != nothing:
                continue
            # Look around it, farther and farther, until nothing beyond can be nearer.
            best, reach = MISSED_REACH * MISSED_REACH + 1, 1
            while reach * reach < best:
                for i in range(max(row - reach, 0), min(row + reach + 1, height)):
                    step = 1 if abs(i - row) == reach else 2 * reach
                    for j in range(col - reach, col + reach + 1, step):
                        away = (i - row) ** 2 + (j - col) ** 2
                        if not 0 <= j < width or away >= best or alpha[i, j] == 0.0:
                            continue
                        if depth[i, j] != nothing or alpha[i, j] == 1.0:
                            source[row, col, 0], source[row, col, 1], best, found = i, j, away, True
                reach += 1
    return found


@kernel
def count_element_depths(begin, end, depth, surface, counts):
    """Count the neighbours along each row whose depths, or surfaces' depths, are the more alike.

    Parameters
    ----------
    depth, surface : ndarray of shape (H, W), float32
        See `take_nothing_out`.
    counts : ndarray of shape (H, 2), int64
        Filled: those for point samples, and those for filtered depth.
    """
    for row in range(begin, end):
        counts[row, 0] = counts[row, 1] = 0
        for col in range(1, depth.shape[1]):
            as_point = abs(depth[row, col] - depth[row, col - 1])
            as_filtered = abs(surface[row, col] - surface[row, col - 1])
            if not math.isfinite(as_point + as_filtered) or as_point == as_filtered:
                continue
            counts[row, 1 if as_filtered < as_point else 0] += 1


@kernel
def mend_element(begin, end, depth, alpha, surface, source, mended):
    """Give the parts of pixels with nothing behind their surface's depth.

    Parameters
    ----------
    depth, alpha, surface : ndarray of shape (H, W), float32
        See `take_nothing_out`.
    source : ndarray of shape (H, W, 2), int32
        Filled with row and column of the pixel that tells a pixel's labels: the one of the largest alpha near it.
    mended : ndarray of shape (H, W), float32
        Filled with the depths.
    """
    height, width = depth.shape
    for row in range(begin, end):
        for col in range(width):
            source[row, col, 0], source[row, col, 1] = row, col
            mended[row, col] = depth[row, col]
            if not 0.0 < alpha[row, col] < 1.0:
                continue
            # Find the pixel around it that shows most of the surface, and where its depth is known.
            most, best = (row, col), alpha[row, col]
            for i in range(max(row - REACH, 0), min(row + REACH + 1, height)):
                for j in range(max(col - REACH, 0), min(col + REACH + 1, width)):
                    if alpha[i, j] > best and not math.isnan(surface[i, j]):
                        most, best = (i, j), alpha[i, j]
            source[row, col, 0], source[row, col, 1] = most
            # Take the surface's depth for one that lies behind it.
            own = surface[row, col] if not math.isnan(surface[row, col]) else surface[most]
            if 0.0 < own < depth[row, col]:
                mended[row, col] = own
            elif alpha[most] == 1.0:
                mended[row, col] = depth[most]
