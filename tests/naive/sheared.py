"""Naive twin of the layered reconstruction, every pixel asks every sample; and SLR's integrals in flatland."""

import math

import numpy as np


def reconstruct_naive(samples, partition, filters, reach):
    """SLR Algorithms 1 and 2 for a filter (shear, screen, lens) per partition, without tiles.

    Samples are added to the nearest pixel, which is reconstructed at once, for each pixel and each of its neighbours.
    """
    height, width = samples.shape
    image = np.zeros((height, width, 4))
    for row, col in np.ndindex(height, width):
        left_over = 1.0
        for layer in sorted(set(partition.tolist())):
            shear, screen, lens = (float(each[layer]) for each in filters)
            radius = min(reach, math.ceil(3 * screen))
            colour, stopped, met = np.zeros(4), 0.0, 0.0
            for i in np.flatnonzero(partition >= layer):
                x, y = (math.floor(v + 0.5) for v in samples.place[i] - np.float32(shear) * samples.lens[i])
                if max(abs(x - col), abs(y - row)) > radius:
                    continue
                weight = math.exp(-0.5 * ((x - col) ** 2 + (y - row) ** 2) / screen**2)
                weight *= math.exp(-0.5 * float((samples.lens[i] ** 2).sum()) / lens**2)
                met += weight
                if partition[i] == layer:
                    stopped += weight
                    colour += weight * samples.colour[i]
            if met > 0:
                image[row, col] += left_over * colour / met
                left_over *= 1 - stopped / met
        if left_over < 1:
            image[row, col] /= 1 - left_over
    return image


def gaussian(x, sigma):
    """SLR Eq. 9."""
    return np.exp(-0.5 * (x / sigma) ** 2) / (math.sqrt(2 * math.pi) * sigma)


def irradiance(texture, coc, x, sigma_lens, limit=8.0, steps=4001):
    """SLR Eq. 3 in flatland: a Lambertian texture of one CoC radius, seen at x through a Gaussian aperture."""
    u = np.linspace(-limit * sigma_lens, limit * sigma_lens, steps)
    weight = gaussian(u, sigma_lens)
    return float((texture(x - coc * u) * weight).sum() / weight.sum())


def filtered(texture, coc, x, shear, screen, lens, steps=801):
    """SLR Eq. 24 in flatland: the light field of that texture under ``w(x' - x - shear u; screen) w(u; lens)``."""
    u = np.linspace(-6 * lens, 6 * lens, steps)[None, :]
    q = np.linspace(-6 * screen, 6 * screen, steps)[:, None]
    weight = gaussian(q, screen) * gaussian(u, lens)
    return float((texture(x + q + shear * u - coc * u) * weight).sum() / weight.sum())
