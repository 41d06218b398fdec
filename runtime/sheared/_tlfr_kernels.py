"""Compiled kernels of TLFR: samples moved to a place on the lens and a time, their surfaces, and which one is seen."""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import FloatArray
from spreadlets.compiled import helper, kernel
from spreadlets.runtime.sheared._tile_kernels import MET, N_SUMS, SEEN, blur, composite, gaussian, share_out

ALL_QUADRANTS = 15
LEAST_OF_A_SURFACE = 4
"""Samples: a surface of fewer, one for each quadrant, cannot be triangulated and joins the next one behind it."""
CELLS_PER_RADIUS = 2.0
"""Of the grid that samples near a place are looked up in: a disc of one radius touches 5 x 5 cells."""
MOST_CELLS = 256
"""Along each side of that grid."""


class Trajectories(NamedTuple):
    """Samples as straight paths in groups of neighbours; see `runtime.sheared.tlfr.trajectories`.

    Attributes
    ----------
    path : ndarray of shape (N, 5), float32
        x, y, CoC radius, dx, dy: a sample is seen at ``(x, y) + CoC * (u, v) + (dx, dy) * t``.
    depth : ndarray of shape (N,), float32
    colour : ndarray of shape (N, 4), float32
    first : ndarray of shape (G + 1,), int64
        The samples of a group are ``first[group]`` to ``first[group + 1] - 1``.
    low, high : ndarray of shape (G, 5), float32
        Bounds of the paths of each group.
    """

    path: FloatArray
    depth: FloatArray
    colour: FloatArray
    first: npt.NDArray[np.int64]
    low: FloatArray
    high: FloatArray


class Views(NamedTuple):
    """Where on lens, shutter and pixel light is gathered; see `runtime.sheared.tlfr.views`.

    Attributes
    ----------
    place : ndarray of shape (P, K, 5), float32
        u, v, t (frames from mid-shutter) and x, y (px from the pixel's centre) of K views in each of P patterns.
    pattern : ndarray of shape (H, W), uint8
        Pattern of each pixel.
    radius : ndarray of shape (H, W), float32
        px within which some sample of a surface lies, wherever it is.
    half_shutter : float32
        Frames.
    tolerance : float32
        px by which trajectories must cross to be of two surfaces.
    near : ndarray of shape (L,), float32
        CoC radius that each layer begins at, ascending; the first is -infinity.
    """

    place: FloatArray
    pattern: npt.NDArray[np.uint8]
    radius: FloatArray
    half_shutter: np.float32
    tolerance: np.float32
    near: FloatArray


class Grid(NamedTuple):
    """The samples around a tile as one view has them, sorted by cell.

    Attributes
    ----------
    begin : ndarray of shape (rows * cols + 1,), int64
        The samples of a cell are ``begin[cell]`` to ``begin[cell + 1] - 1``.
    number : ndarray of shape (M,), int64
        Which sample each is.
    place : ndarray of shape (M, 2), float32
        x, y, px.
    corner : tuple of float32
        x and y of the first cell's corner, px.
    size : float32
        Side of a cell, px.
    shape : tuple of int
        Rows and columns.
    """

    begin: npt.NDArray[np.int64]
    number: npt.NDArray[np.int64]
    place: FloatArray
    corner: tuple[np.float32, np.float32]
    size: np.float32
    shape: tuple[int, int]


class Near(NamedTuple):
    """Samples near a place, from near to far, and where the surfaces among them begin.

    Attributes
    ----------
    number : ndarray of shape (M,), int64
    depth : ndarray of shape (M,), float32
    offset : ndarray of shape (M, 2), float32
        x, y from the place, px.
    path : ndarray of shape (M, 5), float32
        As of `Trajectories`.
    begin : ndarray of shape (M + 1,), int64
    """

    number: npt.NDArray[np.int64]
    depth: FloatArray
    offset: FloatArray
    path: FloatArray
    begin: npt.NDArray[np.int64]


# --- Samples as a view has them ------------------------------------------------------------------------------------


@helper
def reach(low, high, factor):
    """Return the least and the most of values in a range times a factor."""
    return min(low * factor, high * factor), max(low * factor, high * factor)


@helper
def may_touch(low, high, view, box):
    """Say whether a group of paths may come into a box (left, top, right, bottom) at a view (u, v, t)."""
    for axis in range(2):
        from_lens, to_lens = reach(low[2], high[2], view[axis])
        from_time, to_time = reach(low[3 + axis], high[3 + axis], view[2])
        if low[axis] + from_lens + from_time > box[2 + axis] or high[axis] + to_lens + to_time < box[axis]:
            return False
    return True


@helper
def may_ever_touch(low, high, half_shutter, box):
    """Say whether a group of paths may come into a box at any place on the lens and any time."""
    coc = max(abs(low[2]), abs(high[2]))
    for axis in range(2):
        far = coc + max(abs(low[3 + axis]), abs(high[3 + axis])) * half_shutter
        if low[axis] - far > box[2 + axis] or high[axis] + far < box[axis]:
            return False
    return True


@helper
def sort_into_cells(trajectories, listed, view, box, grid, spare):
    """Fill a grid with the samples of the listed groups that a view has in a box.

    Parameters
    ----------
    spare : tuple
        Scratch: cell and number (M,), int64, place (M, 2), float32.
    """
    path = trajectories.path
    cell, number, place = spare
    rows, cols = grid.shape
    grid.begin[:] = 0
    n = 0
    # Move the samples, and count those in each cell.
    for group in listed:
        if not may_touch(trajectories.low[group], trajectories.high[group], view, box):
            continue
        for i in range(trajectories.first[group], trajectories.first[group + 1]):
            x = path[i, 0] + path[i, 2] * view[0] + path[i, 3] * view[2]
            y = path[i, 1] + path[i, 2] * view[1] + path[i, 4] * view[2]
            col, row = (x - grid.corner[0]) / grid.size, (y - grid.corner[1]) / grid.size
            if np.float32(0) <= col < cols and np.float32(0) <= row < rows:
                cell[n] = int(row) * cols + int(col)
                number[n] = i
                place[n, 0], place[n, 1] = x, y
                grid.begin[cell[n] + 1] += 1
                n += 1
    # Where each cell begins, moved by one cell while it is filled.
    total = 0
    for k in range(1, rows * cols + 1):
        count = grid.begin[k]
        grid.begin[k] = total
        total += count
    for k in range(n):
        to = grid.begin[cell[k] + 1]
        grid.begin[cell[k] + 1] += 1
        grid.number[to] = number[k]
        grid.place[to, 0], grid.place[to, 1] = place[k, 0], place[k, 1]


@helper
def fetch(grid, x, y, radius, near):
    """Find the samples within a radius of a place; return how many."""
    rows, cols = grid.shape
    left = max(int(math.floor((x - radius - grid.corner[0]) / grid.size)), 0)
    right = min(int(math.floor((x + radius - grid.corner[0]) / grid.size)), cols - 1)
    top = max(int(math.floor((y - radius - grid.corner[1]) / grid.size)), 0)
    bottom = min(int(math.floor((y + radius - grid.corner[1]) / grid.size)), rows - 1)
    n = 0
    for row in range(top, bottom + 1):
        for k in range(grid.begin[row * cols + left], grid.begin[row * cols + right + 1]):
            dx, dy = grid.place[k, 0] - x, grid.place[k, 1] - y
            if dx * dx + dy * dy < radius * radius:
                near.number[n] = grid.number[k]
                near.offset[n, 0], near.offset[n, 1] = dx, dy
                n += 1
    return n


# --- Surfaces ------------------------------------------------------------------------------------------------------


@helper
def sort_by_depth(trajectories, near, n):
    """Bring samples into order from near to far, those at the same depth by number, by Shell's method; take paths."""
    for k in range(n):
        near.depth[k] = trajectories.depth[near.number[k]]
    gap = n // 2
    while gap > 0:
        for i in range(gap, n):
            number, depth, x, y = near.number[i], near.depth[i], near.offset[i, 0], near.offset[i, 1]
            k = i - gap
            while k >= 0 and (near.depth[k] > depth or (near.depth[k] == depth and near.number[k] > number)):
                near.number[k + gap], near.depth[k + gap] = near.number[k], near.depth[k]
                near.offset[k + gap, 0], near.offset[k + gap, 1] = near.offset[k, 0], near.offset[k, 1]
                k -= gap
            near.number[k + gap], near.depth[k + gap] = number, depth
            near.offset[k + gap, 0], near.offset[k + gap, 1] = x, y
        gap //= 2
    for k in range(n):
        for j in range(5):
            near.path[k, j] = trajectories.path[near.number[k], j]


@helper
def cross(one, other, half_shutter, tolerance):
    """Say whether two trajectories cross somewhere on the lens and in the shutter, so are of different surfaces.

    At a time t, seen from the lens's centre, they are ``d(t)`` apart; on a lens point they are ``d(t) + c * (u, v)``
    apart, c being the difference of their CoC. They meet on some point of the lens if ``|d(t)| <= |c|``, and pass each
    other while the shutter is open if d turns to its opposite side.
    """
    dx, dy = one[0] - other[0], one[1] - other[1]
    mx, my = (one[3] - other[3]) * half_shutter, (one[4] - other[4]) * half_shutter
    coc = max(abs(one[2] - other[2]) - tolerance, np.float32(0))
    # Most are too far apart for either.
    far = abs(mx) + abs(my) + coc
    if dx * dx + dy * dy >= far * far:
        return False
    # From opening to closing: do they change sides?
    if (dx - mx) * (dx + mx) + (dy - my) * (dy + my) < -tolerance * tolerance:
        return True
    # The nearest that they come to each other.
    squared = mx * mx + my * my
    t = np.float32(0)
    if squared > np.float32(0):
        t = min(max(-(dx * mx + dy * my) / squared, np.float32(-1)), np.float32(1))
    x, y = dx + t * mx, dy + t * my
    return x * x + y * y < coc * coc


@helper
def are_alike(path, near, n, half_shutter, tolerance):
    """Say whether paths differ by so little in CoC and motion that none of them can cross."""
    one = path[near.number[0]]
    coc_low, x_low, y_low = one[2], one[3], one[4]
    coc_high, x_high, y_high = coc_low, x_low, y_low
    for k in range(1, n):
        one = path[near.number[k]]
        coc_low, coc_high = min(coc_low, one[2]), max(coc_high, one[2])
        x_low, x_high = min(x_low, one[3]), max(x_high, one[3])
        y_low, y_high = min(y_low, one[4]), max(y_high, one[4])
    moved = max(x_high - x_low, y_high - y_low) * half_shutter
    return coc_high - coc_low < tolerance and moved < np.float32(0.5) * tolerance


@helper
def divide(near, n, half_shutter, tolerance):
    """Divide samples, sorted from near to far, into surfaces: one begins where a trajectory crosses one before it.

    Returns the number of surfaces; ``near.begin`` says where each begins, and where the last ends.
    """
    near.begin[0] = 0
    n_surfaces = 1
    for k in range(1, n):
        for earlier in range(near.begin[n_surfaces - 1], k):
            if cross(near.path[earlier], near.path[k], half_shutter, tolerance):
                near.begin[n_surfaces] = k
                n_surfaces += 1
                break
    near.begin[n_surfaces] = n
    return n_surfaces


@helper
def merge_small(near, n_surfaces):
    """Let surfaces of too few samples join the next one behind; return how many surfaces remain."""
    kept = 0
    for k in range(1, n_surfaces + 1):
        if k == n_surfaces or near.begin[k] - near.begin[kept] >= LEAST_OF_A_SURFACE:
            kept += 1
            near.begin[kept] = near.begin[k]
    return kept


@helper
def fills_quadrants(offset, begin, end):
    """Say whether samples lie in all four quadrants around a place."""
    found = 0
    for k in range(begin, end):
        found |= 1 << ((offset[k, 0] >= 0) + 2 * (offset[k, 1] >= 0))
    return found == ALL_QUADRANTS


@helper
def surrounds(offset, begin, end, radius):
    """Say whether a place is in the convex hull of those samples that are within a radius of it."""
    n = 0
    ax = ay = bx = by = np.float32(0)
    for k in range(begin, end):
        x, y = offset[k, 0], offset[k, 1]
        if x * x + y * y >= radius * radius:
            continue
        if n == 0:
            ax, ay, bx, by = x, y, x, y
        n += 1
        # The samples so far are within a wedge, less than half a turn from a to b.
        after, before = ax * y - ay * x, x * by - y * bx
        if after < 0 and before < 0:
            return True
        if after < 0:
            ax, ay = x, y
        elif before < 0:
            bx, by = x, y
    return False


@helper
def in_triangle(offset, begin, end, radius):
    """Say whether a place is in a triangle of samples, no edge longer than a diameter, one corner within a radius."""
    longest = np.float32(4) * radius * radius
    for a in range(begin, end):
        ax, ay = offset[a, 0], offset[a, 1]
        if ax * ax + ay * ay >= radius * radius:
            continue
        for b in range(begin, end):
            bx, by = offset[b, 0], offset[b, 1]
            if ax * by - ay * bx <= 0 or (ax - bx) ** 2 + (ay - by) ** 2 > longest:
                continue
            for c in range(begin, end):
                cx, cy = offset[c, 0], offset[c, 1]
                if ax * cy - ay * cx < 0 and bx * cy - by * cx > 0:
                    if (ax - cx) ** 2 + (ay - cy) ** 2 <= longest and (bx - cx) ** 2 + (by - cy) ** 2 <= longest:
                        return True
    return False


@helper
def covers(offset, begin, end, radius):
    """Say whether a surface covers a place, by its samples within two radii of it."""
    if surrounds(offset, begin, end, radius):
        return True
    # None of the triangles holds what the hull of all does not.
    return surrounds(offset, begin, end, np.float32(2) * radius) and in_triangle(offset, begin, end, radius)


# --- The colour of a view ------------------------------------------------------------------------------------------


@helper
def add_surface(trajectories, near, begin, end, radius, layers, sums):
    """Add the colour of a surface at a place, by a tent over its samples, to the sums (L, N_SUMS) of a pixel.

    Its layer is that of the nearest of its samples.
    """
    # Sum the weights of the surface's samples, and find the nearest.
    total = np.float32(0)
    nearest, distance = begin, np.float32(np.inf)
    for k in range(begin, end):
        away = math.sqrt(near.offset[k, 0] ** 2 + near.offset[k, 1] ** 2)
        total += max(np.float32(1) - away / radius, np.float32(0))
        if away < distance:
            nearest, distance = k, away
    layer = np.searchsorted(layers, trajectories.path[near.number[nearest], 2], "right") - 1
    sums[layer, SEEN] += np.float32(1)
    if total == np.float32(0):
        for channel in range(4):
            sums[layer, channel] += trajectories.colour[near.number[nearest], channel]
        return
    # Add their mean, weighted by a tent.
    for k in range(begin, end):
        away = math.sqrt(near.offset[k, 0] ** 2 + near.offset[k, 1] ** 2)
        weight = max(np.float32(1) - away / radius, np.float32(0)) / total
        for channel in range(4):
            sums[layer, channel] += weight * trajectories.colour[near.number[k], channel]


@helper
def add_view(x, y, radius, trajectories, views, grid, near, sums):
    """Add what is seen at a place of a view to the sums (L, N_SUMS) of a pixel; nothing where no sample is near.

    A surface that is alone within a radius, or surrounds the place there, is seen. Elsewhere the nearest surface is
    that has a triangle of samples over the place, or else the farthest.
    """
    path, half_shutter, tolerance = trajectories.path, views.half_shutter, views.tolerance
    # Most views show one surface within the radius.
    n = fetch(grid, x, y, radius, near)
    if n > 0:
        if are_alike(path, near, n, half_shutter, tolerance):
            add_surface(trajectories, near, 0, n, radius, views.near, sums)
            return
        sort_by_depth(trajectories, near, n)
        n_surfaces = divide(near, n, half_shutter, tolerance)
        if n_surfaces == 1 or fills_quadrants(near.offset, 0, near.begin[1]):
            add_surface(trajectories, near, 0, near.begin[1], radius, views.near, sums)
            return
    # Else the first surface that covers the view within twice the radius is seen.
    n = fetch(grid, x, y, np.float32(2) * radius, near)
    if n == 0:
        return
    sort_by_depth(trajectories, near, n)
    n_surfaces = merge_small(near, divide(near, n, half_shutter, tolerance))
    for k in range(n_surfaces):
        begin, end = near.begin[k], near.begin[k + 1]
        if k == n_surfaces - 1 or covers(near.offset, begin, end, radius):
            add_surface(trajectories, near, begin, end, radius, views.near, sums)
            return


@helper
def groups_near(trajectories, half_shutter, box):
    """Return the groups that may come into a box, and how many samples they have."""
    n_groups = trajectories.first.size - 1
    listed = np.empty(n_groups, np.int64)
    n = n_samples = 0
    for group in range(n_groups):
        if may_ever_touch(trajectories.low[group], trajectories.high[group], half_shutter, box):
            listed[n] = group
            n += 1
            n_samples += trajectories.first[group + 1] - trajectories.first[group]
    return listed[:n].copy(), n_samples


@helper
def empty_grid(box, size, n_samples):
    """Return a grid over a box (left, top, right, bottom), with room for samples."""
    cols, rows = int(math.ceil((box[2] - box[0]) / size)), int(math.ceil((box[3] - box[1]) / size))
    return Grid(
        np.empty(rows * cols + 1, np.int64),
        np.empty(n_samples, np.int64),
        np.empty((n_samples, 2), np.float32),
        (box[0], box[1]),
        size,
        (rows, cols),
    )


@kernel
def gather_tile(trajectories, views, inner, sums, first_row):
    """Add what all views of a tile's pixels see to sums by layers of CoC.

    Parameters
    ----------
    trajectories : Trajectories
    views : Views
    inner : ndarray of shape (4,), int32
        Top, left, bottom, right of the tile, px.
    sums : ndarray of shape (h, W, L, N_SUMS), float32
        Of some rows of the image; zero in the tile, filled there.
    first_row : int
        Row of the image that the sums begin at.
    """
    top, left, bottom, right = inner
    radius = views.radius[top:bottom, left:right]
    # What may come near the tile.
    half = np.float32(0.5)
    margin = np.float32(2) * radius.max() + half
    box = np.float32(left) - margin, np.float32(top) - margin, np.float32(right) + margin, np.float32(bottom) + margin
    listed, n_samples = groups_near(trajectories, views.half_shutter, box)
    size = np.float32(max(radius.min() / CELLS_PER_RADIUS, max(box[2] - box[0], box[3] - box[1]) / MOST_CELLS))
    grid = empty_grid(box, size, n_samples)
    spare = np.empty(n_samples, np.int64), np.empty(n_samples, np.int64), np.empty((n_samples, 2), np.float32)
    near = Near(
        np.empty(n_samples, np.int64),
        np.empty(n_samples, np.float32),
        np.empty((n_samples, 2), np.float32),
        np.empty((n_samples, 5), np.float32),
        np.empty(n_samples + 1, np.int64),
    )
    # View by view: move all samples once, then gather for the pixels that take this view.
    for pattern in range(views.place.shape[0]):
        for k in range(views.place.shape[1]):
            view = views.place[pattern, k]
            sort_into_cells(trajectories, listed, view, box, grid, spare)
            for row in range(top, bottom):
                for col in range(left, right):
                    if views.pattern[row, col] == pattern:
                        x, y = np.float32(col) + view[3], np.float32(row) + view[4]
                        at = radius[row - top, col - left]
                        add_view(x, y, at, trajectories, views, grid, near, sums[row - first_row, col])
    # How many views met a layer: all that no nearer one stopped.
    for row in range(top - first_row, bottom - first_row):
        for col in range(left, right):
            met = sums[row, col, :, SEEN].sum()
            for layer in range(sums.shape[2]):
                sums[row, col, layer, MET] = met
                met -= sums[row, col, layer, SEEN]


# --- The screen filter ---------------------------------------------------------------------------------------------


@helper
def take_layer(sums, layer, row, col, patch):
    """Copy a layer of sums (h, W, L, N_SUMS) into a patch from a pixel on, 0 beyond; say whether anything is seen."""
    seen = False
    for i in range(patch.shape[0]):
        for j in range(patch.shape[1]):
            inside = 0 <= row + i < sums.shape[0] and 0 <= col + j < sums.shape[1]
            for k in range(N_SUMS):
                patch[i, j, k] = sums[row + i, col + j, layer, k] if inside else np.float32(0)
            seen |= patch[i, j, SEEN] > np.float32(0)
    return seen


@kernel
def filter_tile(sums, first_row, sigma, reach, inner, image):
    """Filter the layers of a tile on the screen, and composite them front to back.

    Parameters
    ----------
    sums, first_row
        As for `gather_tile`, filled `reach` rows beyond the tile as far as the image goes.
    sigma : ndarray of shape (L,), float32
        Standard deviation of each layer's filter, px, > 0.
    reach : int
        Largest radius of a filter, px.
    inner : ndarray of shape (4,), int32
        Top, left, bottom, right of the tile, px.
    image : ndarray of shape (H, W, 4), float32
        Zero in the tile; filled there.
    """
    top, left, bottom, right = inner
    height, width = bottom - top, right - left
    patch = np.empty((height + 2 * reach, width + 2 * reach, N_SUMS), np.float32)
    between = np.empty((height + 2 * reach, width * N_SUMS), np.float32)
    blurred = np.empty((height, width * N_SUMS), np.float32)
    left_over = np.ones((height, width), np.float32)
    for layer in range(sigma.size):
        if take_layer(sums, layer, top - first_row - reach, left - reach, patch):
            blur(patch, reach, gaussian(sigma[layer], reach), between, blurred)
            composite(blurred, top, left, image, left_over)
    share_out(top, left, image, left_over)
