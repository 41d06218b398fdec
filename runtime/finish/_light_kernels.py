"""Compiled kernels of lights: what nearer samples hide of each, and its light drawn past them."""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import FloatArray, IntArray
from spreadlets.compiled import helper, kernel

X, Y, COC, PATH_X, PATH_Y, COVER = range(6)
"""Columns of lights and of samples: where they lie without lens at mid-shutter, px; CoC radius, px; the path while the
shutter is open, px; and, of samples, their alpha."""
LEAST_APART = 1.0
"""Difference of CoC radii, px, from which a sample may hide a light: the shadows of what is nearer are too wide."""
TIMES = 4
"""Times, in the middle of as many parts of the shutter, at which the lens is looked through."""
ACROSS = 11
"""Places across the lens, and across the PSF, at which it is told how much is hidden."""
STEP = 2.0 / (ACROSS - 1)
"""Distance of places on the lens, in radii."""
FOOTPRINT = 25.0
"""Samples, side by side on a surface, over whose area each is spread: without gaps, and with the noise of so many."""
STILL_PX = 0.5
"""Length of a path, px, up to which all times are alike."""
LEAST_CLEAR = np.float32(0.02)
"""Share of lens and shutter that is clear at least: a light that samples have met is not hidden."""


class Cells(NamedTuple):
    """Samples in square cells, row by row.

    Attributes
    ----------
    samples : ndarray of shape (n, 6), float32
        Columns as named above.
    start : ndarray of shape (rows * cols + 1,), int64
        Where those of each cell begin.
    cols : int
        Cells in a row.
    side : int
        Of a cell, px.
    margin : int
        How far before the frame's first row and column the cells begin, px.
    """

    samples: FloatArray
    start: IntArray
    cols: int
    side: int
    margin: int


class Points(NamedTuple):
    """Offsets (n, 2), values (n, 1) or (n, 3), and first points of the PSFs: see `runtime.splat.passes.PointTable`."""

    offset_rc: npt.NDArray[np.int32]
    value: FloatArray
    start: IntArray


@helper
def _cell(place, side, margin, count):
    """Return the row or the column of a place's cell, or -1 if it is beyond all."""
    number = math.floor((place + margin) / side)
    return int(number) if 0 <= number < count else -1


@kernel
def count_occluders(shift, coc, alpha, farthest, wanted, side, margin, count):
    """Add to ``count`` (rows, cols), int64, the samples of a set in each cell; arguments as for `list_occluders`."""
    for row in range(coc.shape[0]):
        for col in range(coc.shape[1]):
            if coc[row, col] >= farthest or alpha[row, col, 3] == 0:
                continue
            i = _cell(row + shift[row, col, 1], side, margin, wanted.shape[0])
            j = _cell(col + shift[row, col, 0], side, margin, wanted.shape[1])
            if i >= 0 and j >= 0 and wanted[i, j]:
                count[i, j] += 1


@kernel
def list_occluders(shift, coc, alpha, farthest, wanted, side, margin, path, place, samples):
    """List the samples of a set that may hide a light, cell by cell.

    Parameters
    ----------
    shift, coc, alpha : ndarray of shapes (H, W, 2), (H, W) and (H, W, 4), float32
        Where samples lie, from their pixels, px; CoC radii, px; colours, of which alpha is taken.
    farthest : float
        CoC radius below which samples are taken, px.
    wanted : ndarray of shape (rows, cols), bool
        Cells of which samples are taken.
    side, margin : int
        See `Cells`.
    path : ndarray of shape (H, W, 2), float32
        While the shutter is open, px.
    place : ndarray of shape (rows, cols), int64
        Where the next sample of each cell is listed; moved on.
    samples : ndarray of shape (n, 6), float32
        Filled.
    """
    for row in range(coc.shape[0]):
        for col in range(coc.shape[1]):
            if coc[row, col] >= farthest or alpha[row, col, 3] == 0:
                continue
            x, y = col + shift[row, col, 0], row + shift[row, col, 1]
            i, j = _cell(y, side, margin, wanted.shape[0]), _cell(x, side, margin, wanted.shape[1])
            if i >= 0 and j >= 0 and wanted[i, j]:
                number = place[i, j]
                samples[number, X], samples[number, Y] = x, y
                samples[number, COC], samples[number, COVER] = coc[row, col], alpha[row, col, 3]
                samples[number, PATH_X], samples[number, PATH_Y] = path[row, col, 0], path[row, col, 1]
                place[i, j] += 1


@helper
def _time(number):
    """Return a time of `TIMES`, in shutters from mid-shutter."""
    return (number + 0.5) / TIMES - 0.5


@helper
def _spread(hidden, u, v, half, amount):
    """Spread an amount of what hides evenly over a square about a place on the lens, cut by the cells of its places."""
    first_row, last_row = math.ceil((v - half + 1.0) / STEP - 0.5), math.floor((v + half + 1.0) / STEP + 0.5)
    first_col, last_col = math.ceil((u - half + 1.0) / STEP - 0.5), math.floor((u + half + 1.0) / STEP + 0.5)
    for i in range(max(int(first_row), 0), min(int(last_row) + 1, ACROSS)):
        y = -1.0 + i * STEP
        tall = min(y + 0.5 * STEP, v + half) - max(y - 0.5 * STEP, v - half)
        for j in range(max(int(first_col), 0), min(int(last_col) + 1, ACROSS)):
            x = -1.0 + j * STEP
            wide = min(x + 0.5 * STEP, u + half) - max(x - 0.5 * STEP, u - half)
            if tall > 0.0 and wide > 0.0:
                hidden[i, j] += amount * tall * wide


@helper
def _hide(hidden, light, sample, reach, still):
    """Add what a sample hides of a light on the lens, at each time; return whether it is any of it.

    Without lens, at mid-shutter, light and sample lie at places p and q, px. Both are seen at one place through (u, v)
    at time t if ``p + c (u, v) + m t = q + c' (u, v) + m' t``, with their CoC radii c, c' and paths m, m'. The sample
    is spread over a square of half the width ``reach``, px, which holds `FOOTPRINT` samples.
    """
    apart = np.float64(light[COC]) - np.float64(sample[COC])
    x, y = np.float64(sample[X]) - np.float64(light[X]), np.float64(sample[Y]) - np.float64(light[Y])
    along_x = np.float64(sample[PATH_X]) - np.float64(light[PATH_X])
    along_y = np.float64(sample[PATH_Y]) - np.float64(light[PATH_Y])
    # Most lie too far off at all times.
    half = max(reach, 0.5 * STEP * apart)
    limit = (1.0 + 0.5 * STEP) * apart + half
    if abs(x) >= limit + 0.5 * abs(along_x) or abs(y) >= limit + 0.5 * abs(along_y):
        return False
    # On the lens the sample stands for an area; spread over the square, that is a density, and so a share of a cell.
    amount = np.float64(sample[COVER]) * (reach / (half * STEP)) ** 2 / FOOTPRINT
    times = 1 if still and abs(along_x) + abs(along_y) <= STILL_PX else TIMES
    hides = False
    for number in range(times):
        time = _time(number) if times == TIMES else 0.0
        u, v = x + along_x * time, y + along_y * time
        if abs(u) < limit and abs(v) < limit:
            hides = True
            plane = hidden[0 if still else number]
            _spread(plane, u / apart, v / apart, half / apart, amount / times if still else amount)
    return hides


@helper
def _at(plane, row, col):
    """Interpolate a plane of places linearly, held within it."""
    y, x = min(max(row, 0.0), ACROSS - 1.0), min(max(col, 0.0), ACROSS - 1.0)
    i, j = min(int(y), ACROSS - 2), min(int(x), ACROSS - 2)
    down, right = y - i, x - j
    upper = plane[i, j] + right * (plane[i, j + 1] - plane[i, j])
    lower = plane[i + 1, j] + right * (plane[i + 1, j + 1] - plane[i + 1, j])
    return upper + down * (lower - upper)


@helper
def _box(light):
    """Return the half width and height, px, of the box about a light's PSF."""
    radius = max(abs(np.float64(light[COC])), 0.5)
    return radius + 0.5 * abs(np.float64(light[PATH_X])), radius + 0.5 * abs(np.float64(light[PATH_Y]))


@helper
def _clear_at(hidden, light, x, y, still):
    """Return how clear a place of a light's PSF is, (x, y) px from its centre: the mean over the times that show it."""
    radius = np.float64(light[COC])
    radius = math.copysign(max(abs(radius), 0.5), radius)
    total, count, nearest, least = 0.0, 0, 0.0, math.inf
    for number in range(1 if still else TIMES):
        time = 0.0 if still else _time(number)
        u, v = (x - light[PATH_X] * time) / radius, (y - light[PATH_Y] * time) / radius
        # Beyond the rim the lens is taken to go on as at the rim.
        distance = math.sqrt(u * u + v * v)
        if distance > 1.0:
            u, v = u / distance, v / distance
        value = _at(hidden[number], (v + 1.0) / STEP, (u + 1.0) / STEP)
        if distance <= 1.0 + STEP:
            total, count = total + value, count + 1
        if distance < least:
            least, nearest = distance, value
    share = total / count if count else nearest
    return min(max(np.float32(1.0 - share), LEAST_CLEAR), np.float32(1.0))


@helper
def _clear_of_point(clear, light, x, y):
    """Interpolate how clear the places across a light's PSF are, at (x, y) px from its centre."""
    wide, tall = _box(light)
    middle = 0.5 * (ACROSS - 1)
    return _at(clear, (y / tall + 1.0) * middle, (x / wide + 1.0) * middle)


@kernel
def clear_shares(begin, end, lights, reach, cells, density, most, clear, hides):
    """Find how much of lens and shutter nearer samples leave of each light.

    Parameters
    ----------
    lights : ndarray of shape (n, 5), float32
        Columns as named above.
    reach : ndarray of shape (n,), int64
        How far off samples may hide it, px.
    cells : Cells
        Of the samples that may.
    density : float
        Samples for each pixel.
    most : int
        Samples looked at for each light; of more, every so many-th.
    clear : ndarray of shape (n, ACROSS, ACROSS), float32
        Filled, where anything is hidden, with the share that is clear at places across the box about each PSF.
    hides : ndarray of shape (n,), bool
        Filled: whether anything is.
    """
    hidden = np.empty((TIMES, ACROSS, ACROSS), np.float64)
    n_rows = (len(cells.start) - 1) // cells.cols
    for number in range(begin, end):
        light = lights[number]
        still = abs(light[PATH_X]) + abs(light[PATH_Y]) <= STILL_PX
        top = max(int((light[Y] - reach[number] + cells.margin) // cells.side), 0)
        bottom = min(int((light[Y] + reach[number] + cells.margin) // cells.side), n_rows - 1)
        left = max(int((light[X] - reach[number] + cells.margin) // cells.side), 0)
        right = min(int((light[X] + reach[number] + cells.margin) // cells.side), cells.cols - 1)
        # Count the samples around, and add up what each so many-th hides.
        around = 0
        for row in range(top, bottom + 1):
            around += max(cells.start[row * cells.cols + right + 1] - cells.start[row * cells.cols + left], 0)
        step, skipped = 1 + around // most, 0
        width = 0.5 * math.sqrt(FOOTPRINT * step / density)
        hidden[:], hides[number] = 0.0, False
        for row in range(top, bottom + 1):
            first, last = cells.start[row * cells.cols + left], cells.start[row * cells.cols + right + 1]
            for each in range(first + skipped, last, step):
                if light[COC] - cells.samples[each, COC] >= LEAST_APART:
                    hides[number] |= _hide(hidden, light, cells.samples[each], width, still)
            skipped = (skipped - max(last - first, 0)) % step
        if not hides[number]:
            continue
        # Tell how clear the places across the PSF are.
        wide, tall = _box(light)
        for i in range(ACROSS):
            for j in range(ACROSS):
                x, y = (j * STEP - 1.0) * wide, (i * STEP - 1.0) * tall
                clear[number, i, j] = _clear_at(hidden, light, x, y, still)


@kernel
def light_scales(begin, end, group, lights, clear, hides, label, points, scale):
    """Find by what PSFs are to be multiplied so that, where they are clear, they hold as much light as the whole.

    Parameters
    ----------
    group : ndarray of shape (n,), int64
        Which of ``lights``, ``clear`` and ``hides`` of `clear_shares` each light has.
    label : ndarray of shape (n,), int64
        The PSF of each.
    points : Points
        Of the PSFs.
    scale : ndarray of shape (n,), float32
        Filled; 0 where nothing is hidden.
    """
    for number in range(begin, end):
        scale[number] = np.float32(0.0)
        if not hides[group[number]]:
            continue
        whole, through = 0.0, 0.0
        for k in range(points.start[label[number]], points.start[label[number] + 1]):
            value, x, y = np.float64(points.value[k, 0]), points.offset_rc[k, 1], points.offset_rc[k, 0]
            whole += value
            through += value * _clear_of_point(clear[group[number]], lights[group[number]], x, y)
        scale[number] = np.float32(whole / through)


@kernel
def add_lights(begin, end, place, colour, group, lights, clear, label, points, scale, image):
    """Add the light of each, past what hides it, to a band of rows of an image.

    Parameters
    ----------
    place : ndarray of shape (n, 2), float32
        Where each lies without lens, (x, y), px.
    colour : ndarray of shape (n, 3), float32
    group, lights, clear, label, points, scale
        See `light_scales`.
    image : ndarray of shape (H, W, 4), float32
        Premultiplied; alpha stays.
    """
    width, n_channels = image.shape[1], points.value.shape[1]
    for number in range(len(place)):
        first, last = points.start[label[number]], points.start[label[number] + 1]
        above, before = math.floor(place[number, Y]), math.floor(place[number, X])
        down, right = np.float32(place[number, Y] - above), np.float32(place[number, X] - before)
        if above + points.offset_rc[first, 0] >= end or above + 1 + points.offset_rc[last - 1, 0] < begin:
            continue
        for k in range(first, last):
            row, col = int(above) + points.offset_rc[k, 0], int(before) + points.offset_rc[k, 1]
            if row + 1 < begin or row >= end or col + 1 < 0 or col >= width:
                continue
            share = np.float32(1.0)
            if scale[number] > 0.0:
                x, y = points.offset_rc[k, 1], points.offset_rc[k, 0]
                share = scale[number] * np.float32(_clear_of_point(clear[group[number]], lights[group[number]], x, y))
            # Split it bilinearly.
            for corner in range(4):
                i, j = row + corner // 2, col + corner % 2
                weight = (down if corner // 2 else np.float32(1.0) - down) * (
                    right if corner % 2 else np.float32(1.0) - right
                )
                if weight > 0.0 and begin <= i < end and 0 <= j < width:
                    for c in range(3):
                        value = points.value[k, c if n_channels > 1 else 0]
                        image[i, j, c] += share * weight * value * colour[number, c]
