"""Compiled kernels between pixels and coarser ones: a coarse pixel of side s covers s x s pixels."""

import math

import numpy as np

from spreadlets.compiled import helper, kernel
from spreadlets.runtime._vector_kernels import add, load, multiply, store

_U = np.uint64


@helper
def _share(number, step):
    """Return the share of a pixel, of those that a coarse one takes from along an axis, that it gets."""
    return np.float32(1.0 - abs(number + 0.5 - step) / step)


@helper
def shrink_row(out, fine, row, step, pitch, scratch):
    """Share the values of pixels between the coarse pixels around them, linearly: all of a value arrives.

    Parameters
    ----------
    out : ndarray of shape (n * 4,), float32
        A row of coarse pixels; overwritten.
    fine : ndarray of shape (rows * pitch,), float32
        Rows of pixels; the first lies ``step / 2`` above the coarse row 0.
    row : int
        Which coarse row.
    step : int
        Side of the coarse pixels, a multiple of 2.
    pitch : int
        Floats in a row of pixels, ``n * 4 * step``.
    scratch : ndarray of shape (at least pitch,), float32
    """
    # Share along the columns, four rows at a time.
    for k in range(0, 2 * step, 4):
        a, b, c, d = _share(k, step), _share(k + 1, step), _share(k + 2, step), _share(k + 3, step)
        begin = (step * row + k) * pitch
        first, second = fine[begin : begin + pitch], fine[begin + pitch : begin + 2 * pitch]
        third, fourth = fine[begin + 2 * pitch : begin + 3 * pitch], fine[begin + 3 * pitch : begin + 4 * pitch]
        if k == 0:
            for j in range(pitch):
                scratch[j] = a * first[j] + b * second[j] + c * third[j] + d * fourth[j]
        else:
            for j in range(pitch):
                scratch[j] = scratch[j] + a * first[j] + b * second[j] + c * third[j] + d * fourth[j]
    # Share along the row; nothing lies beyond its ends.
    n = out.shape[0] // 4
    for i in range(n):
        total = np.float32(0.0), np.float32(0.0), np.float32(0.0), np.float32(0.0)
        first = step * i - step // 2
        for k in range(max(0, -first), min(2 * step, step * n - first)):
            weight = _share(k, step)
            each = load(scratch, _U(4 * (first + k)))
            total = add(total, multiply((weight, weight, weight, weight), each))
        store(out, _U(4 * i), total)


@helper
def _cubic(place):
    """Return the first of four neighbours for interpolation at a place, and their weights (Keys 1981, a = -1/2)."""
    before = math.floor(place)
    t = place - before
    weights = (
        np.float32(-0.5 * t * (1.0 - t) ** 2),
        np.float32(1.0 + t * t * (1.5 * t - 2.5)),
        np.float32(t * (0.5 + t * (2.0 - 1.5 * t))),
        np.float32(-0.5 * t * t * (1.0 - t)),
    )
    return int(before) - 1, weights


@kernel
def add_enlarged(begin, end, coarse, top, left, step, image):
    """Add an image of coarse pixels, interpolated cubically, to one of pixels that holds a part of it.

    Nothing lies beyond the sides of the coarse pixels.

    Parameters
    ----------
    coarse : ndarray of shape (h, w * 4), float32
    top, left : int
        Row and column, in the image, of its first pixel's first pixel; either may be negative.
    step : int
        Side of its pixels.
    image : ndarray of shape (H, W * 4), float32
        Changed in place.
    """
    height, n, width = coarse.shape[0], coarse.shape[1] // 4, image.shape[1] // 4
    # Three pixels of nothing lie on both sides of a row.
    line = np.zeros(4 * (n + 6), np.float32)
    for row in range(max(begin, top), min(end, top + step * height)):
        # Interpolate along the columns.
        first, weights = _cubic((row - top + 0.5) / step - 0.5)
        line[:] = np.float32(0.0)
        for k in range(4):
            if 0 <= first + k < height:
                weight, source = weights[k], coarse[first + k]
                for j in range(_U(4 * n)):
                    line[_U(12) + j] += weight * source[j]
        # Interpolate along the row, pixels of like phase together.
        target = image[row]
        for phase in range(step):
            before, (a, b, c, d) = _cubic((phase + 0.5) / step - 0.5)
            for i in range(max(-((left + phase) // step), 0), min((width - left - phase + step - 1) // step, n)):
                at, to = _U(4 * (i + before + 3)), _U(4 * (left + step * i + phase))
                p, q = multiply((a, a, a, a), load(line, at)), multiply((b, b, b, b), load(line, at + _U(4)))
                r, s = multiply((c, c, c, c), load(line, at + _U(8))), multiply((d, d, d, d), load(line, at + _U(12)))
                store(target, to, add(load(target, to), add(add(q, r), add(p, s))))


@kernel
def add_placed(begin, end, placed, top, left, image):
    """Add an image (h, w * 4), float32, to another (H, W * 4) at a row and a column of it, in place.

    Of an image that reaches beyond the other, that part is left out.
    """
    first, last = max(4 * left, 0), min(4 * left + placed.shape[1], image.shape[1])
    for row in range(max(begin, top), min(end, top + placed.shape[0])):
        source, target = placed[row - top, first - 4 * left :], image[row, first:last]
        for j in range(target.shape[0]):
            target[j] += source[j]
