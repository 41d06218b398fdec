"""Compiled kernels of the overlap of layers, looked at through points of lens and shutter."""

import numpy as np

from spreadlets.compiled import helper, kernel
from spreadlets.runtime._vector_kernels import TWO_PIXELS, add, load_two, multiply, store

CELL = 2
"""Side of the cells that covers are looked at in, px: what is finer, no blur shows."""
TILE = 16
"""Side of the tiles that are looked at at once, in cells; each layer has one blur in each."""
MOMENTS = 4
"""What is summed up of each layer in each tile: cover, and cover times CoC and path."""
LEAST_CHANGE = np.float32(0.02)
"""By how much the cover of a layer must change around a tile: what is even hides all that lies beyond it alike."""
_U = np.uint64


@helper
def _cell(place, corner):
    """Return the cell of a row or column; the first cell holds the frame's first pixel."""
    return (place + corner) // CELL - corner // CELL


@helper
def _add_cover(own, place, row, col, covers):
    """Add what a pixel covers to the sums of its cell."""
    number = int(place)
    farther = place - np.float32(number)
    covers[number, row, col] += own * (np.float32(1.0) - farther)
    if farther > 0.0:
        covers[number + 1, row, col] += own * farther


@helper
def _add_moments(own, place, coc, path, moments):
    """Add how a pixel blurs to the sums (n_layers, MOMENTS) of its tile."""
    number = int(place)
    farther = place - np.float32(number)
    for part in range(2):
        share = own * (farther if part else np.float32(1.0) - farther)
        if share > 0.0:
            each = moments[number + part]
            each[0] += share
            each[1] += share * coc
            each[2] += share * path[0]
            each[3] += share * path[1]


@kernel
def enter_frame(begin, end, cover, place, coc, path, corner, covers, moments):
    """Sum up what the pixels of a frame cover, in cells, and how they blur, in tiles.

    Parameters
    ----------
    begin, end : int
        Rows of tiles.
    cover, place : ndarray of shape (H, W), float32
        See `runtime.composite._visibility_kernels.cover_planes`.
    coc, path : ndarray of shapes (H, W) and (H, W, 2), float32
        CoC radius and path, px.
    corner : tuple of two ints
        Row and column of the frame's first pixel, counted from a pixel that tiles begin at; not negative.
    covers : ndarray of shape (n_layers, h, w), float32
        Sums of what each layer covers; changed.
    moments : ndarray of shape (h / TILE, w / TILE, n_layers, MOMENTS), float32
        Changed.
    """
    down, left, side = corner[0], corner[1], CELL * TILE
    for tile in range(begin, end):
        for row in range(max(tile * side - down, 0), min((tile + 1) * side - down, cover.shape[0])):
            i = _cell(row, down)
            for col in range(cover.shape[1]):
                own = cover[row, col]
                if own > 0.0:
                    _add_cover(own, place[row, col], i, _cell(col, left), covers)
                    sums = moments[tile, (col + left) // side]
                    _add_moments(own, place[row, col], coc[row, col], path[row, col], sums)


@kernel
def enter_list(cover, place, at, corner, covers):
    """Sum up what the pixels of a list cover.

    Parameters
    ----------
    cover, place : ndarray of shape (h, w), float32
    at : ndarray of shape (h, w, 2), int32
        Their rows and columns in the frame.
    corner, covers
        See `enter_frame`.
    """
    for i in range(cover.shape[0]):
        for j in range(cover.shape[1]):
            if cover[i, j] > 0.0:
                y, x = _cell(at[i, j, 0], corner[0]), _cell(at[i, j, 1], corner[1])
                _add_cover(cover[i, j], place[i, j], y, x, covers)


@kernel
def make_shares(begin, end, corner, shape, covers):
    """Divide the sums of rows of cells by their pixels, within 1; ``shape`` is the frame's, see `enter_frame`."""
    one, down, left = np.float32(1.0), corner[0] % CELL, corner[1] % CELL
    for i in range(begin, end):
        rows = min((i + 1) * CELL - down, shape[0]) - max(i * CELL - down, 0)
        for number in range(covers.shape[0]):
            for j in range(covers.shape[2]):
                cols = min((j + 1) * CELL - left, shape[1]) - max(j * CELL - left, 0)
                covers[number, i, j] = min(covers[number, i, j] / np.float32(rows * cols), one)


@kernel
def hide(begin, end, covers, number, known):
    """Take what a layer before a number covers off ``known`` (h, w), float32: the share of a cell that it leaves."""
    for i in range(begin, end):
        for j in range(known.shape[1]):
            known[i, j] = max(known[i, j] - covers[number - 1, i, j], np.float32(0.0))


@kernel
def fill_unknown(begin, end, cover, known, mean, mean_known, prior, padding, filled):
    """Let what is unknown of a layer be covered as what was seen around it, and repeat the cells at the border.

    Parameters
    ----------
    begin, end : int
        Rows, without padding.
    cover, known : ndarray of shape (h, w), float32
        What is seen of the layer, and the share of each cell in which nothing hides it.
    mean, mean_known : ndarray of shape (h, w), float32
        The same, means around each cell.
    prior : tuple of two float32
        Added to both: the layer's own in the mean, small beside what was seen nearby.
    padding : int
        Cells around those of the frame.
    filled : ndarray of shape (h + 2 padding, w + 2 padding), float32
        Filled.
    """
    zero, one = np.float32(0.0), np.float32(1.0)
    width, last = cover.shape[1], cover.shape[0] - 1
    for i in range(begin, end):
        # Fill the row, and repeat its ends.
        out = filled[padding + i]
        for j in range(width):
            around = (max(mean[i, j], zero) + prior[0]) / (max(mean_known[i, j], zero) + prior[1])
            out[padding + j] = min(cover[i, j] + (one - known[i, j]) * around, one)
        out[:padding] = out[padding]
        out[padding + width :] = out[padding + width - 1]
        # Repeat the first and the last row.
        if i == 0:
            for k in range(padding):
                for j in range(len(out)):
                    filled[k, j] = out[j]
        if i == last:
            for k in range(padding):
                for j in range(len(out)):
                    filled[padding + i + 1 + k, j] = out[j]


@kernel
def cover_range(begin, end, corner, padding, covers, low, high):
    """Fill ``low`` and ``high`` (h / TILE, w / TILE, n_layers), float32, with the range of covers in each tile."""
    above, before = corner[0] // CELL, corner[1] // CELL
    height, width = covers.shape[1] - 2 * padding, covers.shape[2] - 2 * padding
    for tile in range(begin, end):
        low[tile], high[tile] = np.float32(1.0), np.float32(0.0)
        for number in range(covers.shape[0]):
            for i in range(max(tile * TILE - above, 0), min((tile + 1) * TILE - above, height)):
                for j in range(width):
                    each, across = covers[number, padding + i, padding + j], (j + before) // TILE
                    low[tile, across, number] = min(low[tile, across, number], each)
                    high[tile, across, number] = max(high[tile, across, number], each)


@helper
def _eight(value):
    return value, value, value, value, value, value, value, value


@helper
def _look_through(plane, start, width, weights, passing, sums, place):
    """Add what a layer shows of a tile through one point of lens and shutter, and hide it from those beyond.

    Parameters
    ----------
    plane : ndarray of shape (n,), float32
        Rows of what layers cover.
    start, width : int
        Where in it the tile's first cell is seen, and the cells in a row.
    weights : tuple of four float32
        Of the four cells that each one is interpolated from.
    passing : ndarray of shape (TILE * TILE,), float32
        What passes all nearer layers; changed.
    sums : tuple of two ndarrays of shape (n_layers * TILE * TILE,), float32
        Sums of what is seen of each layer, and of what it covers.
    place : int
        Where those of the layer begin.
    """
    joint, mean = sums
    a, b, c, d = _eight(weights[0]), _eight(weights[1]), _eight(weights[2]), _eight(weights[3])
    minus = _eight(np.float32(-1.0))
    for i in range(TILE):
        for j in range(0, TILE, TWO_PIXELS):
            here, below = _U(start + i * width + j), _U(start + (i + 1) * width + j)
            own, to = _U(i * TILE + j), _U(place + i * TILE + j)
            upper = add(multiply(a, load_two(plane, here)), multiply(b, load_two(plane, here + _U(1))))
            lower = add(multiply(c, load_two(plane, below)), multiply(d, load_two(plane, below + _U(1))))
            cover = add(upper, lower)
            left = load_two(passing, own)
            shown = multiply(left, cover)
            store(joint, to, add(load_two(joint, to), shown))
            store(mean, to, add(load_two(mean, to), cover))
            store(passing, own, add(left, multiply(minus, shown)))


@kernel
def look_through(begin, end, points, blurs, wanted, corner, padding, covers, covariance):
    """Find by how much more is seen of each layer than if all blurred apart.

    Parameters
    ----------
    begin, end : int
        Rows of tiles.
    points : ndarray of shape (n, 3), float64
        Points of the lens, in its radius, and times, in the shutter's.
    blurs : ndarray of shape (h / TILE, w / TILE, n_layers, 3), float64
        CoC radius and path of each layer in each tile, cells.
    wanted : ndarray of shape (h / TILE, w / TILE), int64
        Layers of each tile that are looked at, counted from the nearest; 0 leaves it at 0.
    corner, padding
        See `enter_frame` and `fill_unknown`; padding reaches two cells and a tile farther than any blur.
    covers : ndarray of shape (n_layers, h + 2 padding, w + 2 padding), float32
        What each layer covers.
    covariance : ndarray of shape (n_layers, h, w), float32
        Filled.
    """
    n, size, height, width = len(points), TILE * TILE, covariance.shape[1], covariance.shape[2]
    plane, (_, n_rows, n_cols) = covers.reshape(covers.size), covers.shape
    passing, joint, mean = (
        np.empty(size, np.float32),
        np.empty(len(covers) * size, np.float32),
        np.empty(len(covers) * size, np.float32),
    )
    for tile in range(begin, end):
        for across in range(wanted.shape[1]):
            top, left = tile * TILE - corner[0] // CELL, across * TILE - corner[1] // CELL
            rows, cols = (max(top, 0), min(top + TILE, height)), (max(left, 0), min(left + TILE, width))
            n_layers = wanted[tile, across]
            covariance[:, rows[0] : rows[1], cols[0] : cols[1]] = np.float32(0.0)
            if not n_layers:
                continue
            # Through each point, see the layers one behind the other, each moved as it blurs.
            joint[: n_layers * size], mean[: n_layers * size] = np.float32(0.0), np.float32(0.0)
            for point in range(n):
                passing[:] = np.float32(1.0)
                for number in range(n_layers):
                    coc, x, y = blurs[tile, across, number]
                    row = padding + top - coc * points[point, 1] - y * points[point, 2]
                    col = padding + left - coc * points[point, 0] - x * points[point, 2]
                    i, j = int(row), int(col)
                    down, aside = np.float32(row - i), np.float32(col - j)
                    up, before = np.float32(1.0) - down, np.float32(1.0) - aside
                    weights = up * before, up * aside, down * before, down * aside
                    start = (number * n_rows + i) * n_cols + j
                    _look_through(plane, start, n_cols, weights, passing, (joint, mean), number * size)
            # Compare with what the means of all would show.
            passing[:] = np.float32(1.0)
            scale = np.float32(1.0 / n)
            for number in range(n_layers):
                for i in range(rows[0], rows[1]):
                    for j in range(cols[0], cols[1]):
                        k = (i - top) * TILE + j - left
                        seen = scale * joint[number * size + k]
                        covariance[number, i, j] = seen - passing[k] * scale * mean[number * size + k]
                        passing[k] -= seen


@helper
def _between_cells(place, count):
    """Return the cells that a row or column of pixels lies between, of some, and how far from the first one."""
    at = np.float32((place + 0.5) / CELL - 0.5)
    first = min(max(int(np.floor(at)), 0), count - 1)
    return first, min(first + 1, count - 1), min(max(at - np.float32(first), np.float32(0.0)), np.float32(1.0))


@helper
def _lay_line(cells, places, line):
    """Fill ``line`` (n,) with a row of cells, interpolated along itself."""
    lefts, rights, asides = places
    for col in range(len(line)):
        left = cells[lefts[col]]
        line[col] = left + asides[col] * (cells[rights[col]] - left)


@helper
def _blend_lines(lines, first, below, down, out):
    """Fill ``out`` (n,) with what lies between two of the lines."""
    upper, lower = lines[first % 2], lines[below % 2]
    for col in range(len(out)):
        out[col] = upper[col] + down * (lower[col] - upper[col])


@kernel
def enlarge_cells(begin, end, cells, corner, image):
    """Fill ``image`` (H, W), float32, with ``cells`` (h, w), interpolated linearly; ``corner`` as in `enter_frame`."""
    (height, width), n = cells.shape, image.shape[1]
    within, aside_of = corner[0] % CELL, corner[1] % CELL
    # Where along a row of cells each pixel lies: between which two, and how far from the first.
    lefts, rights, asides = np.empty(n, np.int64), np.empty(n, np.int64), np.empty(n, np.float32)
    for col in range(n):
        lefts[col], rights[col], asides[col] = _between_cells(col + aside_of, width)
    # Each row of cells serves a few rows of pixels.
    lines, known = np.empty((2, n), np.float32), np.array([-1, -1])
    for row in range(begin, end):
        first, below, down = _between_cells(row + within, height)
        for each in (first, below):
            if known[each % 2] != each:
                known[each % 2] = each
                _lay_line(cells[each], (lefts, rights, asides), lines[each % 2])
        _blend_lines(lines, first, below, down, image[row])
