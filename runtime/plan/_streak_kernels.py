"""Compiled kernels of PSFs that are drawn in closed form: streaks of what moves in focus, and thin capsules.

Codes of streaks are even, those of capsules odd.
"""

import math

import numpy as np

from spreadlets.compiled import helper, kernel
from spreadlets.psf._capsule_kernels import FAINT, capsule_light, list_light, thin_shape

STEPS_PER_PX = 2
"""Paths are rounded to half pixels, which moves their ends by an eighth of one at most."""
MIDDLES_PER_PX = 4
N_MIDDLES = MIDDLES_PER_PX + 1
"""The middle of a path, which lies within half a pixel of a pixel's centre, is rounded to quarters."""
FIRST_ROOM = 1 << 12
"""Pixels that there is room for at first in a list."""
SAMPLES_PER_PX = 8
"""Moments of a path within a pixel; each is split over four pixels, bilinearly."""


@helper
def _folded(step):
    """Return a whole number as one from 0 up: 0, -1, 1, -2, 2 ..."""
    return 2 * step if step >= 0 else -2 * step - 1


@helper
def _unfolded(number):
    """Undo `_folded`."""
    return -(number + 1) // 2 if number % 2 else number // 2


@helper
def streak_code(x, y, across, down):
    """Return the code of a path (x, y), px, whose middle is shifted by so much; that of a short path is small.

    Pairs of numbers are counted along squares around 0 (Szudzik 2006, "An elegant pairing function").
    """
    right, below = _folded(int(np.rint(STEPS_PER_PX * x))), _folded(int(np.rint(STEPS_PER_PX * y)))
    code = right * right + below if below < right else below * below + below + right
    # The whole pixels of the shift are not in the code.
    code = code * N_MIDDLES + int(np.rint(MIDDLES_PER_PX * (down - np.rint(down)))) + N_MIDDLES // 2
    return 2 * (code * N_MIDDLES + int(np.rint(MIDDLES_PER_PX * (across - np.rint(across)))) + N_MIDDLES // 2)


@helper
def _path(pair):
    """Return the path (x, y), px, of a pair's number."""
    side = int(math.sqrt(pair))
    rest = pair - side * side
    right, below = (side, rest) if rest < side else (rest - side, side)
    return _unfolded(right) / STEPS_PER_PX, _unfolded(below) / STEPS_PER_PX


@helper
def _streak(code, openness):
    """Return the light of a streak, of any sum, in a rectangle about its pixel."""
    rest, right = divmod(code // 2, N_MIDDLES)
    rest, below = divmod(rest, N_MIDDLES)
    x, y = _path(rest)
    reach_x, reach_y = int(0.5 * abs(x)) + 2, int(0.5 * abs(y)) + 2
    light = np.zeros((2 * reach_y + 1, 2 * reach_x + 1))
    middle_x = (right - N_MIDDLES // 2) / MIDDLES_PER_PX + reach_x
    middle_y = (below - N_MIDDLES // 2) / MIDDLES_PER_PX + reach_y
    # Split the light of each moment over the four pixels around its place.
    n_samples = int(SAMPLES_PER_PX * max(abs(x), abs(y))) + 1
    for k in range(n_samples):
        time = (k + 0.5) / n_samples
        at = time * (len(openness) - 1)
        before = min(int(at), len(openness) - 2)
        share = openness[before] + (at - before) * (openness[before + 1] - openness[before])
        place_y, place_x = middle_y + (time - 0.5) * y, middle_x + (time - 0.5) * x
        row, col = int(math.floor(place_y)), int(math.floor(place_x))
        part_y, part_x = place_y - row, place_x - col
        light[row, col] += share * (1.0 - part_y) * (1.0 - part_x)
        light[row, col + 1] += share * (1.0 - part_y) * part_x
        light[row + 1, col] += share * part_y * (1.0 - part_x)
        light[row + 1, col + 1] += share * part_y * part_x
    return light


@kernel
def draw_own(begin, end, code, openness, counts):
    """List the pixels of streaks and capsules with their shares of the light, by row.

    Parameters
    ----------
    code : ndarray of shape (n,), int64
        See `streak_code`; of a capsule one more than twice its `spreadlets.psf._capsule_kernels.thin_code`.
    openness : ndarray of shape (m,), float64
        How far the shutter is open, at equally spaced times from opening to closing.
    counts : ndarray of shape (n,), int64
        Filled with the number of pixels of each PSF.

    Returns
    -------
    offset_rc : ndarray of shape (n_points, 2), int32
        The pixels' rows and columns, from the one that the middle was rounded to.
    value : ndarray of shape (n_points, 1), float32
        Their shares of the light, of sum 1.
    """
    offset_rc, value, n_points = np.empty((FIRST_ROOM, 2), np.int32), np.empty((FIRST_ROOM, 1), np.float32), 0
    for i in range(begin, end):
        if code[i] % 2:
            radius, length, angle = thin_shape(code[i] // 2)
            light, faint = capsule_light(radius, length, angle), FAINT
        else:
            light, faint = _streak(code[i], openness), 0.0
        # Make room for all that may be lit.
        if n_points + light.size > len(value):
            shorter, room = (offset_rc, value), 2 * (n_points + light.size)
            offset_rc, value = np.empty((room, 2), np.int32), np.empty((room, 1), np.float32)
            for p in range(n_points):
                offset_rc[p, 0], offset_rc[p, 1], value[p, 0] = shorter[0][p, 0], shorter[0][p, 1], shorter[1][p, 0]
        counts[i] = list_light(light, faint, offset_rc[n_points:], value[n_points:])
        n_points += counts[i]
    return offset_rc[:n_points], value[:n_points]
