"""Kernels of the PSF of a round thin lens with straight, even motion: a disc swept along its path, in closed form.

Light on a line along the motion is a chord of the disc, a box, convolved with the path, another box: a trapezoid, whose
integral over the piece of the line that lies in a pixel is known. What is left is the mean over lines across a pixel.
"""

import math

import numpy as np

from spreadlets.compiled import helper, kernel

CLOSED_RADIUS_PX = 4.0
"""Radius up to which the PSFs of a round thin lens are drawn in closed form (`spreadlets.psf.capsule`), px, and no
cells are stored. There they are a few rows of pixels: sparsified, each cell would be stored as those."""

EDGE_LINES, THIN_LINES = 8, 16
"""Lines across a pixel at the rim: with them the pixels of a disc err by 1 % of its level or so; and for a disc that is
thinner than `THIN_RADIUS_PX`, which lines across a pixel could miss."""
THIN_RADIUS_PX = 2.0
INNER_LINES = 2
"""Lines across a pixel away from the rim, where the light hardly changes across."""
RIM_PX = 1.25
"""How close to the rim a pixel counts as at it, px: half its diagonal, and room for the chords, which end steeply."""
LEAST_RADIUS_PX = 0.25
"""Radius of a thinner disc as it is drawn: a pixel hides the difference, but lines across it could miss the disc."""
RADIUS_STEPS = 24.0
"""Radii of thin capsules are rounded to steps of ``2 sqrt(r) / 24``, which moves their rims by a sixteenth of a pixel
or so; twice as fine, more of them would be drawn, and no figure of a frame would change."""
DISC_STEPS = 96.0
"""The same for what stands still: a focus that is pulled over a texture must not be seen to jump."""
N_DISCS, N_RADII = (math.floor(steps * math.sqrt(CLOSED_RADIUS_PX) + 0.5) + 1 for steps in (DISC_STEPS, RADIUS_STEPS))
"""Rounded radii of what is drawn in closed form."""
FINE_PATH_PX = 128
"""Extent along an axis up to which paths are rounded to whole pixels, which moves their ends by a quarter of one at
most; those up to twice as long to two pixels, and so on."""
N_SHAPES = N_DISCS + (2 * FINE_PATH_PX + 1) ** 2 * N_RADII
"""Discs and capsules without those of longer paths."""
LONGEST_PATH_PX = 2048.0
"""Extent along an axis of the longest path that is drawn; a longer one covers the frame evenly."""
FAINT = 0.01
"""Share of the peak below which pixels of a thin capsule are left out: a sixteenth of all."""


@helper
def thin_code(radius, x, y, excess):
    """Return the code of a capsule of a radius and path, px, rounded; that of a short path is small.

    Opposite paths are the same. ``excess``, at least 1, is how many times wider the capsule may be than those that are
    always drawn in closed form.
    """
    size, largest = 1.0, max(abs(x), abs(y))
    if largest > LONGEST_PATH_PX:
        x, y, largest = x * LONGEST_PATH_PX / largest, y * LONGEST_PATH_PX / largest, LONGEST_PATH_PX
    octave = 0
    while largest > FINE_PATH_PX * size or excess > size:
        size *= 2.0
        octave += 1
    right, below, root = int(np.rint(x / size)), int(np.rint(y / size)), math.sqrt(radius / size)
    if right == 0 and below == 0:
        return octave * N_SHAPES + int(math.floor(DISC_STEPS * root + 0.5))
    if below < 0 or (below == 0 and right < 0):
        right, below = -right, -below
    # Pairs of numbers are counted along squares around 0 (Szudzik 2006, "An elegant pairing function").
    right = 2 * right if right >= 0 else -2 * right - 1
    path = right * right + below if below < right else below * below + below + right
    return octave * N_SHAPES + N_DISCS + path * N_RADII + int(math.floor(RADIUS_STEPS * root + 0.5))


@helper
def thin_shape(code):
    """Return what a code stands for: the radius, the length of the path, px, and its direction, radians."""
    octave, rest = divmod(code, N_SHAPES)
    size = 2.0**octave
    if rest < N_DISCS:
        return size * (rest / DISC_STEPS) ** 2, 0.0, 0.0
    path, step = divmod(rest - N_DISCS, N_RADII)
    side = int(math.sqrt(path))
    rest = path - side * side
    right, below = (side, rest) if rest < side else (rest - side, side)
    right = -(right + 1) // 2 if right % 2 else right // 2
    return size * (step / RADIUS_STEPS) ** 2, size * math.hypot(right, below), math.atan2(below, right)


@kernel
def half_sizes(radius, length, angle):
    """Return the half-sizes, rows and columns, of the pixels that a capsule may touch."""
    size = max(radius, LEAST_RADIUS_PX) - 0.5
    half_row = int(math.ceil(size + 0.5 * length * abs(math.sin(angle))))
    half_col = int(math.ceil(size + 0.5 * length * abs(math.cos(angle))))
    return half_row, half_col


@helper
def _lines_through_pixel(angle, lines):
    """Fill ``lines`` (n, 4) with lines through a pixel along a direction: place across; begin, end; share of light."""
    n = lines.shape[0]
    cos, sin = math.cos(angle), math.sin(angle)
    total = 0.0
    for k in range(n):
        across = (abs(cos) + abs(sin)) * ((k + 0.5) / n - 0.5)
        # Where x = t cos - across sin, y = t sin + across cos enters and leaves the square |x|, |y| <= 1/2.
        begin, end = -math.inf, math.inf
        for slope, offset in ((cos, -across * sin), (sin, across * cos)):
            if abs(slope) > 1e-9:
                near, far = (-0.5 - offset) / slope, (0.5 - offset) / slope
                begin, end = max(begin, min(near, far)), min(end, max(near, far))
        lines[k, 0], lines[k, 1], lines[k, 2] = across, begin, end
        lines[k, 3] = max(end - begin, 0.0)
        total += lines[k, 3]
    for k in range(n):
        # Light of a line for each unit of its length, so that a pixel in an even disc gets the disc's level.
        lines[k, 3] = 1.0 / total if lines[k, 3] > 0.0 else 0.0


@helper
def _share_up_to(x, chord, path):
    """Return which share of a chord's light, moved along its path, lies up to x; both are given by their halves."""
    inner, outer = abs(chord - path), chord + path
    size = min(abs(x), outer)
    flat = min(size, inner)
    share = 0.5 * flat / max(chord, path)
    if size > inner:
        beyond = size - inner
        share += 0.5 * beyond * (1.0 - 0.5 * beyond / (outer - inner)) / max(chord, path)
    return 0.5 + math.copysign(share, x)


@helper
def _pixel_light(along, across, radius, path, lines):
    """Return the light of a pixel: its mean over the lines through it."""
    light = 0.0
    for k in range(lines.shape[0]):
        place = across + lines[k, 0]
        if abs(place) >= radius or lines[k, 3] == 0.0:
            continue
        chord = math.sqrt(radius * radius - place * place)
        begin, end = along + lines[k, 1], along + lines[k, 2]
        share = _share_up_to(end, chord, path) - _share_up_to(begin, chord, path)
        light += lines[k, 3] * 2.0 * chord * share
    return light


@helper
def capsule_light(radius, length, angle):
    """Return the light of a capsule, of any sum, in a rectangle about its middle, float64 (rows, columns)."""
    half_row, half_col = half_sizes(radius, length, angle)
    radius, path = max(radius, LEAST_RADIUS_PX), 0.5 * length
    edge = np.empty((THIN_LINES if radius < THIN_RADIUS_PX else EDGE_LINES, 4))
    inner = np.empty((INNER_LINES, 4))
    _lines_through_pixel(angle, edge)
    _lines_through_pixel(angle, inner)
    cos, sin = math.cos(angle), math.sin(angle)
    light = np.zeros((2 * half_row + 1, 2 * half_col + 1))
    for row in range(-half_row, half_row + 1):
        for col in range(-half_col, half_col + 1):
            along, across = col * cos + row * sin, row * cos - col * sin
            # Distance from the capsule's middle line.
            distance = math.hypot(across, max(abs(along) - path, 0.0))
            if distance < radius + RIM_PX:
                lines = edge if distance > radius - RIM_PX else inner
                light[half_row + row, half_col + col] = _pixel_light(along, across, radius, path, lines)
    return light


@helper
def list_light(light, faint, offset_rc, value):
    """List the pixels of a rectangle (rows, columns) above a share of the peak, of unit sum; return their number."""
    peak, total, n = 0.0, 0.0, 0
    for row in range(light.shape[0]):
        for col in range(light.shape[1]):
            peak = max(peak, light[row, col])
    least = faint * peak
    for row in range(light.shape[0]):
        for col in range(light.shape[1]):
            if light[row, col] > least:
                offset_rc[n, 0], offset_rc[n, 1] = row - light.shape[0] // 2, col - light.shape[1] // 2
                value[n, 0] = light[row, col]
                total += light[row, col]
                n += 1
    for k in range(n):
        value[k, 0] /= np.float32(total)
    return n


@kernel
def draw_capsules(begin, end, shape, faint, first, offset_rc, value, count):
    """List the pixels of discs swept along straight paths; their rows ascend.

    Parameters
    ----------
    shape : float64 array of shape (n, 3)
        Radius, length of the path, px; its direction, radians.
    faint : float
        Share of the peak below which pixels are left out.
    first : int64 array of shape (n + 1,)
        The pixels of capsule k may fill the rows from ``first[k]`` to ``first[k + 1]`` of the next two: at least those
        of its box, see `half_sizes`.
    offset_rc : int16 array of shape (m, 2)
        Filled with rows and columns from the centre.
    value : float32 array of shape (m, 1)
        Filled with each pixel's share of the light.
    count : int64 array of shape (n,)
        Filled with the number of each capsule's pixels.
    """
    for k in range(begin, end):
        i, j = first[k], first[k + 1]
        light = capsule_light(shape[k, 0], shape[k, 1], shape[k, 2])
        count[k] = list_light(light, faint, offset_rc[i:j], value[i:j])


@kernel
def round_thin(begin, end, shape):
    """Round radius, length of the path and its direction of thin capsules, (n, 3), float64, as they are drawn."""
    for k in range(begin, end):
        x, y = shape[k, 1] * math.cos(shape[k, 2]), shape[k, 1] * math.sin(shape[k, 2])
        shape[k, 0], shape[k, 1], shape[k, 2] = thin_shape(thin_code(shape[k, 0], x, y, 1.0))
