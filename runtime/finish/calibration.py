"""Calibration: what is reconstructed from samples must, seen from afar, be what the samples say.

Splatting makes a smooth image, but a biased one: light from beyond the border is a guess, hidden surfaces are filled,
PSFs are those of cells. The mean of a pixel's samples is noisy, but right. So the image is multiplied by a slowly
varying gain that brings its local means to those of the samples: at each scale, coarse to fine, the gain of least
squares under a Gaussian window, with each pixel weighted by the inverse of its squared brightness, as noise grows with
it. Where a gain is no larger than its own standard error it is drawn towards one (James and Stein 1961), so that noise
does not enter.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import FloatArray, Image
from spreadlets.parallel import for_bands
from spreadlets.runtime.finish import _calibration_kernels
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.samples import SampleBuffer, valid_values

SCALES = (16.0, 8.0, 4.0, 2.0)
"""Standard deviations of the windows, px."""
BLOCK = 4
"""Side, px, at most, of the blocks that stand for their pixels: windows are at least one block wide."""
FEW = 16.0
"""The square of a gain, less one, must exceed its variance to be believed at all; and twice that where no more samples
than so many carry the noise around."""
SURROUNDINGS, LEAST_SURROUNDINGS = 4.0, 16.0
"""Gains and their variances are compared over windows so many times wider, and at least so many px: where few samples
carry the light, as under the bokeh of a small lamp, a window may hold none of them, and would look certain of being too
bright."""
STEPS_ACROSS = 4.0
"""Such wide windows are moved in steps of a part of their standard deviation."""
LARGEST_GAIN = 4.0
FLOOR = 0.5
"""Brightness, in medians of the image, below which noise does not get less."""
LEAST_WINDOWS = 4.0
"""A scale is left out where the image has fewer standard deviations across."""

LENS_SPREAD = 0.25, 1.0
"""Mean squared distance from the lens's centre of samples that are spread over it; a disc has 1/2, a square 2/3."""
LENS_OFFSET = 0.1
TIME_SPREAD = 0.5, 1.5
"""Variance of times in that of an open shutter."""
TIME_OFFSET = 0.1
"""Largest distance of the mean place from the lens's centre, in radii, and of the mean time, in durations."""


def takes_whole_lens(samples: SampleBuffer, camera: ThinLens) -> bool:
    """Tell whether the samples are spread over lens and shutter, so that their mean is the blurred image."""
    if not samples.valid.any():
        return False
    u, v = valid_values(samples.lens_uv, samples.valid).T
    spread, middle = _mean(u * u) + _mean(v * v), (_mean(u), _mean(v))
    fits = LENS_SPREAD[0] <= spread <= LENS_SPREAD[1] and max(map(abs, middle)) <= LENS_OFFSET
    if not fits or not camera.shutter_duration or not samples.motion.any():
        return fits
    time = (valid_values(samples.time, samples.valid) - np.float32(camera.shutter_centre)) / np.float32(
        camera.shutter_duration
    )
    variance = 12.0 * (_mean(time * time) - _mean(time) ** 2)
    return abs(_mean(time)) <= TIME_OFFSET and TIME_SPREAD[0] <= variance <= TIME_SPREAD[1]


def _mean(values: FloatArray) -> float:
    return float(values.mean(dtype=np.float64))


def calibrate(image: Image, radiance: Sequence[Image], valid: npt.NDArray[np.bool_]) -> None:
    """Bring the local means of an image to those of its samples, in place.

    Parameters
    ----------
    image : ndarray of shape (H, W, 4), float32
        Premultiplied; alpha stays as it is.
    radiance : sequence of ndarray of shape (H, W, 4), float32
        One sample of each pixel each.
    valid : ndarray of shape (H, W, S), bool
        Which samples there are.
    """
    total, count = np.zeros_like(image), np.zeros(image.shape[:2], np.float32)
    for number, sample in enumerate(radiance):
        there = np.ascontiguousarray(valid[:, :, number])
        for_bands(_calibration_kernels.add_samples, len(count), sample, there, total, count)
    bright = image[::BLOCK, ::BLOCK, :3].mean(axis=2)
    if not (bright > 0).any():
        return
    floor = FLOOR * float(np.median(bright[bright > 0]))
    for scale in SCALES:
        if LEAST_WINDOWS * scale <= min(image.shape[:2]):
            side = min(BLOCK, int(scale))
            rows, cols = (-(-size // side) for size in image.shape[:2])
            sums = np.empty((4, rows, cols, 3), np.float64)
            for_bands(_calibration_kernels.block_sums, rows, image, total, count, floor, side, sums)
            for_bands(_calibration_kernels.apply_gain, len(image), image, _gain(sums, scale, side), side)


def _gain(sums: npt.NDArray[np.float64], scale: float, side: int) -> npt.NDArray[np.float64]:
    """Return the gain of each block, (rows, cols, 3)."""
    part, square, noise, _ = sums
    width = scale / side
    below = _blurred(square, width)
    tiny = 1e-12 * max(float(below.max()), np.finfo(np.float64).tiny)
    change = _blurred(part, width) / (below + tiny)
    # The square of a Gaussian window is one that is narrower by the square root of 2.
    variance = _blurred(noise, width / np.sqrt(2)) / (below + tiny) ** 2 / (4 * np.pi * width**2)
    wide = max(SURROUNDINGS * scale, LEAST_SURROUNDINGS) / side
    power = _around(change**2, wide)
    believed = 1.0 - _around(_doubt(sums, wide) * variance, wide) / np.where(power > 0, power, np.inf)
    gain = 1.0 + np.where(power > 0, np.clip(believed, 0.0, 1.0), 0.0) * change
    return np.clip(gain, 1.0 / LARGEST_GAIN, LARGEST_GAIN)


def _doubt(sums: npt.NDArray[np.float64], width: float) -> npt.NDArray[np.float64]:
    """Return by what to multiply variances, 1 to 2: a mean of squares is as uncertain as its few largest make it."""
    noise, fourth = (_around(each, width) for each in sums[2:])
    carrying = 2 * np.pi * width**2 * noise**2 / np.maximum(fourth, np.finfo(np.float64).tiny)
    return np.asarray(1.0 + np.minimum(1.0, np.sqrt(FEW / np.maximum(carrying, FEW))))


def _around(planes: npt.NDArray[np.float64], width: float) -> npt.NDArray[np.float64]:
    """Return the means (rows, cols, 3) of planes over a wide Gaussian window."""
    step = int(width / STEPS_ACROSS)
    if step < 2:
        return _blurred(planes, width)
    rows, cols = planes.shape[:2]
    padded = np.pad(planes, ((0, -rows % step), (0, -cols % step), (0, 0)), mode="edge")
    # Along the columns first: what lies side by side in memory is then added at once.
    lines = padded.reshape(-1, step, 3 * padded.shape[1]).sum(axis=1)
    means = lines.reshape(len(lines), -1, step, 3).sum(axis=2) / step**2
    blurred = _blurred(means, width / step)
    return np.repeat(np.repeat(blurred, step, axis=0), step, axis=1)[:rows, :cols]


def _blurred(planes: npt.NDArray[np.float64], width: float) -> npt.NDArray[np.float64]:
    from scipy import ndimage

    return np.asarray(ndimage.gaussian_filter(planes, (width, width, 0), mode="reflect", truncate=3.0))
