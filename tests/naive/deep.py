"""Deep pixels as "Interpreting OpenEXR Deep Pixels" writes them down: two samples at a time, in plain Python.

A sample is (front, back, alpha, colour), colour a premultiplied array.
"""

import math

import numpy as np


def split(sample, at):
    """Return the parts of a volume before and behind a depth."""
    front, back, alpha, colour = sample
    parts = []
    for begin, end in ((front, at), (at, back)):
        share = (end - begin) / (back - front)
        if alpha == 1:
            parts.append((begin, end, 1.0, colour))
        elif alpha > 0:
            part_alpha = -math.expm1(share * math.log1p(-alpha))
            parts.append((begin, end, part_alpha, colour * part_alpha / alpha))
        else:
            parts.append((begin, end, 0.0, colour * share))
    return parts


def merge(a, b):
    """Return the mixture of two samples of the same range."""
    (front, back, alpha_a, colour_a), (_, _, alpha_b, colour_b) = a, b
    if alpha_a == 1 and alpha_b == 1:
        return front, back, 1.0, 0.5 * (colour_a + colour_b)
    if alpha_a == 1 or alpha_b == 1:
        return front, back, 1.0, colour_a if alpha_a == 1 else colour_b
    alpha = alpha_a + alpha_b - alpha_a * alpha_b
    u_a, u_b = -math.log1p(-alpha_a), -math.log1p(-alpha_b)
    v_a = u_a / alpha_a if alpha_a > 0 else 1.0
    v_b = u_b / alpha_b if alpha_b > 0 else 1.0
    w = alpha / (u_a + u_b) if u_a + u_b > 0 else 1.0
    return front, back, alpha, (colour_a * v_a + colour_b * v_b) * w


def tidy(samples):
    """Return the sorted, split and merged samples."""
    samples = list(samples)
    for depth in sorted({depth for sample in samples for depth in sample[:2]}):
        samples = [part for s in samples for part in (split(s, depth) if s[0] < depth < s[1] else [s])]
    result = []
    for sample in sorted(samples, key=lambda s: s[:2]):
        if result and result[-1][:2] == sample[:2]:
            result[-1] = merge(result[-1], sample)
        else:
            result.append(sample)
    return result


def flatten(samples):
    """Return colour and alpha of tidy samples, nearest over farthest."""
    colour, alpha = np.zeros(3), 0.0
    for _, _, sample_alpha, sample_colour in samples:
        colour = colour + (1 - alpha) * sample_colour
        alpha = alpha + (1 - alpha) * sample_alpha
    return colour, alpha


def integrate(samples, steps=20000):
    """Return colour and alpha of volumes by marching through them in small steps."""
    begin, end = min(s[0] for s in samples), max(s[1] for s in samples)
    step = (end - begin) / steps
    colour, transmission = np.zeros(3), 1.0
    for z in begin + step * (np.arange(steps) + 0.5):
        density, emission = 0.0, np.zeros(3)
        for front, back, alpha, premultiplied in samples:
            if front <= z < back:
                u = -math.log1p(-alpha)
                density += u / (back - front)
                emission = emission + premultiplied * u / alpha / (back - front)
        colour = colour + transmission * emission * step
        transmission *= math.exp(-density * step)
    return colour, 1 - transmission
