"""Naive twins of LRDM's set-up and screen filters, and flatland: one screen axis, one lens axis, brute force."""

import math

import numpy as np


def set_up(coc, motion, lens_variance, time_variance, s_pix, s_max=np.inf):
    """Equations (2) to (7) of docs/lrdm.md in matrices, for samples that weigh the same.

    Returns the slopes eta and b, the shares f and g, the excess variances K and the screen covariance.
    """
    m, n = coc.mean(), motion.mean(axis=0)
    coc_var = ((coc - m) ** 2).mean()
    motion_cov = (motion - n).T @ (motion - n) / len(motion)
    eye = np.eye(2)
    narrow = (s_pix**2 + m**2 * lens_variance) * eye + time_variance * np.outer(n, n)
    inverse = np.linalg.inv(narrow)
    k_u = 1 / max(1.5 * coc_var * np.trace(inverse), 1e-12)
    k_t = 1 / max(3 * np.trace(inverse @ motion_cov), 1e-12)
    f, g = k_u / (k_u + lens_variance), k_t / (k_t + time_variance)
    lens_seen = weighted_disc_variance(lens_variance, k_u + lens_variance)
    time_seen = weighted_box_variance(time_variance, k_t + time_variance)
    covariance = (s_pix**2 + m**2 * (lens_variance - (1 - f) ** 2 * lens_seen)) * eye
    covariance += coc_var * (lens_variance - lens_seen) * eye
    covariance += (time_variance - (1 - g) ** 2 * time_seen) * np.outer(n, n)
    covariance += (time_variance - time_seen) * motion_cov
    return m * f, n * g, (k_u, k_t), covariance


def weighted_disc_variance(variance, of_weight):
    """Variance along an axis of a disc with a Gaussian weight, by summation over a fine grid."""
    radius = 2 * math.sqrt(variance)
    r = (np.arange(20000) + 0.5) / 20000 * radius
    weight = r * np.exp(-(r**2) / (2 * of_weight))
    return (weight * r**2).sum() / weight.sum() / 2


def weighted_box_variance(variance, of_weight):
    """Variance of an interval with a Gaussian weight, by summation over a fine grid."""
    half = math.sqrt(3 * variance)
    t = (np.arange(20000) + 0.5) / 20000 * half
    weight = np.exp(-(t**2) / (2 * of_weight))
    return (weight * t**2).sum() / weight.sum()


def gaussian_image(covariance, radius):
    """A Gaussian of unit sum on (2 radius + 1)^2 pixels, with x along columns."""
    y, x = np.mgrid[-radius : radius + 1, -radius : radius + 1]
    inverse = np.linalg.inv(covariance)
    weight = np.exp(-0.5 * (inverse[0, 0] * x**2 + 2 * inverse[0, 1] * x * y + inverse[1, 1] * y**2))
    return weight / weight.sum()


def reprojected_sums(samples, layer_of, layer, eta, b, rates, box):
    """The sums of a layer over a box (top, left, bottom, right), sample by sample, (h, w, 6)."""
    top, left, bottom, right = box
    sums = np.zeros((bottom - top, right - left, 6))
    for i in range(len(samples.coc)):
        if layer_of[i] < layer:
            continue
        x, y = samples.place[i] - eta * samples.lens[i] - b * samples.time[i]
        col, row = math.floor(x + 0.5) - left, math.floor(y + 0.5) - top
        if 0 <= row < sums.shape[0] and 0 <= col < sums.shape[1]:
            squared = (samples.lens[i] ** 2).sum()
            weight = math.exp(-rates[0] * squared - rates[1] * samples.time[i] ** 2)
            sums[row, col, 5] += weight
            if layer_of[i] == layer:
                sums[row, col, 4] += weight
                sums[row, col, :4] += weight * samples.colour[i]
    return sums
