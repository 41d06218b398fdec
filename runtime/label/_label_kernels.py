"""Compiled kernels of the label step: radii of circles of confusion, lengths of paths, chords of curved paths."""

import math

import numpy as np

from spreadlets.compiled import helper, kernel

MOST_GROWTH = 2.0
"""Change of speed over a frame from which a motion no longer changes evenly."""
MOST_TURN = 0.8 * math.pi
"""Turn over a frame from which it cannot be told to which side it was."""
LEAST_CHANGE = 1e-3
"""Relative change of the velocity below which all paths are the same to single precision."""


@kernel
def coc_radii(begin, end, depth, scale, inverse_focus, coc):
    """Fill ``coc`` (H, W), float32, with ``scale * (inverse_focus - 1 / depth)``: signed CoC radii, px."""
    for row in range(begin, end):
        for col in range(depth.shape[1]):
            coc[row, col] = scale * (inverse_focus - 1.0 / np.float64(depth[row, col]))


@kernel
def count_segments(begin, end, before, after, radius, time, tolerance, most, segments):
    """Fill ``segments`` (H, W), int32, with the number, a power of 2, of chords that follow each path closely enough.

    Parameters
    ----------
    before, after : ndarray of shape (H, W, 2), float32
        Motion to the frame's time and from it, px per frame.
    radius : ndarray of shape (H, W), float32
        CoC radii, px, >= 0.
    time : float
        Duration of the shutter, frames.
    tolerance : tuple of two floats
        Largest distance of the path from its chords: px, or so much of the radius.
    most : int
        Largest number.
    """
    for row in range(begin, end):
        for col in range(before.shape[1]):
            x = np.float64(after[row, col, 0]) - np.float64(before[row, col, 0])
            y = np.float64(after[row, col, 1]) - np.float64(before[row, col, 1])
            # A parabola is farthest from its chord at half time, by acceleration time^2 / 8; halving divides by 4.
            distance = 0.125 * time * time * math.sqrt(x * x + y * y)
            count, allowed = 1, max(tolerance[0], tolerance[1] * np.float64(radius[row, col]))
            while count < most and distance > allowed:
                count *= 2
                distance *= 0.25
            segments[row, col] = count


@helper
def turns_evenly(p, n):
    """Tell whether a path turns and grows evenly, with ``p`` and ``n`` the motion before and after as complex numbers.

    Where the velocity changes by too much for that to mean something (a start, a stop, a bounce), the path is a
    parabola, and so it is where the two are the same.
    """
    if p == 0.0 or p == n:
        return False
    q = n / p
    even = 1.0 / MOST_GROWTH < abs(q) < MOST_GROWTH and abs(math.atan2(q.imag, q.real)) < MOST_TURN
    return even and abs(q - 1.0) > LEAST_CHANGE


@helper
def power(q, t):
    """Return a power of a complex number with a turn of less than half a circle."""
    size, angle = abs(q) ** t, math.atan2(q.imag, q.real) * t
    return complex(size * math.cos(angle), size * math.sin(angle))


@helper
def on_parabola(p, n, t):
    """Return where a parabola leads in a time."""
    return 0.5 * t * (n + p) + 0.5 * t * t * (n - p)


@kernel
def path_places(begin, end, before, after, time, place):
    """Fill ``place`` (H, W, 2), float32, with where each path leads in a time, px from where it is at time 0.

    The path leads through the places one frame before and after. It is the one whose velocity turns and grows evenly,
    with ``q = after / before`` as complex numbers: ``after (q^time - 1) / (q - 1)``, an arc for what turns at constant
    speed; else it is a parabola, see `turns_evenly`.

    Parameters
    ----------
    before, after : ndarray of shape (H, W, 2), float32
        Motion to the frame's time and from it, px per frame.
    time : ndarray of shape (H, W), float32
        Frames.
    """
    for row in range(begin, end):
        for col in range(before.shape[1]):
            t = np.float64(time[row, col])
            p = complex(before[row, col, 0], before[row, col, 1])
            n = complex(after[row, col, 0], after[row, col, 1])
            z = on_parabola(p, n, t)
            if turns_evenly(p, n):
                z = n * (power(n / p, t) - 1.0) / (n / p - 1.0)
            place[row, col, 0], place[row, col, 1] = z.real, z.imag


@kernel
def path_lengths(begin, end, path, length):
    """Fill ``length`` (H, W), float32, with the lengths of the paths (H, W, 2), px."""
    for row in range(begin, end):
        for col in range(path.shape[1]):
            x, y = np.float64(path[row, col, 0]), np.float64(path[row, col, 1])
            length[row, col] = math.sqrt(x * x + y * y)


@kernel
def take(begin, end, values, source, taken):
    """Fill ``taken`` (h, w, C) with the values (H, W, C) at the rows and columns of ``source`` (h, w, 2), int32."""
    for row in range(begin, end):
        for col in range(source.shape[1]):
            i, j = source[row, col, 0], source[row, col, 1]
            for c in range(values.shape[2]):
                taken[row, col, c] = values[i, j, c]
