"""Kernels of the PSF of a round thin lens with straight, even motion: a disc swept along its path, in closed form.

Light on a line along the motion is a chord of the disc, a box, convolved with the path, another box: a trapezoid, whose
integral over the piece of the line that lies in a pixel is known. What is left is the mean over lines across a pixel.
"""

import math

import numpy as np

from spreadlets.compiled import helper, kernel

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
def _draw_capsule(radius, length, angle, offset_rc, value):
    """List the pixels of one capsule, of unit sum; return how many there are."""
    half_row, half_col = half_sizes(radius, length, angle)
    radius, path = max(radius, LEAST_RADIUS_PX), 0.5 * length
    edge = np.empty((THIN_LINES if radius < THIN_RADIUS_PX else EDGE_LINES, 4))
    inner = np.empty((INNER_LINES, 4))
    _lines_through_pixel(angle, edge)
    _lines_through_pixel(angle, inner)
    cos, sin = math.cos(angle), math.sin(angle)
    n, total = 0, 0.0
    for row in range(-half_row, half_row + 1):
        for col in range(-half_col, half_col + 1):
            along, across = col * cos + row * sin, row * cos - col * sin
            # Distance from the capsule's middle line.
            distance = math.hypot(across, max(abs(along) - path, 0.0))
            if distance >= radius + RIM_PX:
                continue
            lines = edge if distance > radius - RIM_PX else inner
            light = _pixel_light(along, across, radius, path, lines)
            if light > 0.0:
                offset_rc[n, 0], offset_rc[n, 1], value[n, 0] = row, col, light
                total += light
                n += 1
    for k in range(n):
        value[k, 0] /= total
    return n


@kernel
def draw_capsules(begin, end, shape, first, offset_rc, value, count):
    """List the pixels of discs swept along straight paths; their rows ascend.

    Parameters
    ----------
    shape : float64 array of shape (n, 3)
        Radius, length of the path, px; its direction, radians.
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
        count[k] = _draw_capsule(shape[k, 0], shape[k, 1], shape[k, 2], offset_rc[i:j], value[i:j])
