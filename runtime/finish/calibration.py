"""Calibration: what is reconstructed from samples must, seen from afar, be what the samples say.

Splatting makes a smooth image, but a biased one: light from beyond the border is a guess, hidden surfaces are filled,
and a surface that is seen through part of the lens only, past a nearer one, is drawn as if seen through all of it. The
mean of a pixel's samples is noisy, but right. So gains that vary slowly bring local means to those of the samples, see
`runtime.finish.gains`. Most of the noise of a pixel's samples is that they meet now this layer, now that. So each layer
is compared with its own samples, its colour with their colours; and how much is seen of it, with their share of all.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from spreadlets.arrays import FloatArray, Image
from spreadlets.parallel import for_bands
from spreadlets.runtime.finish import _calibration_kernels
from spreadlets.runtime.finish.edges import PlacedSamples, keep_edges, keep_outlines
from spreadlets.runtime.finish.gains import BLOCK, SCALES, believed_gains, block_counts
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.samples import SampleBuffer, valid_values

COVER_SCALES = SCALES[:-1]
"""Scales of how much is seen of each layer: a sample is of a layer or not, which is noisier than a colour."""
LOOK = 4
"""Distance of the pixels that tell how bright the image is, px."""
FLOOR = 0.5
"""Brightness, in medians of the image, below which noise does not get less."""
LEAST_SHARE = 1e-3
"""Share of a pixel that a layer has at least where it counts."""
LEAST_VARIANCE = 0.02
"""Variance, at least, of whether a sample is of a layer: what is nearly certain may be wrong."""
LEAST_WINDOWS = 4.0
"""A scale is left out where the image has fewer standard deviations across."""
NOWHERE = np.float32(-2.0)
"""The place, among the layers, of a sample that there is not."""

LENS_SPREAD = 0.25, 1.0
"""Mean squared distance from the lens's centre of samples that are spread over it; a disc has 1/2, a square 2/3."""
LENS_OFFSET = 0.1
TIME_SPREAD = 0.5, 1.5
"""Variance of times in that of an open shutter."""
TIME_OFFSET = 0.1
"""Largest distance of the mean place from the lens's centre, in radii, and of the mean time, in durations."""


def takes_whole_lens(samples: SampleBuffer, camera: ThinLens, *, pinhole: bool = False) -> bool:
    """Tell whether the samples are spread over lens and shutter, so that their mean is the blurred image.

    Of a ``pinhole`` they all come through the lens's centre.
    """
    if not samples.valid.any():
        return False
    u, v = valid_values(samples.lens_uv, samples.valid).T
    spread, middle = _mean(u * u) + _mean(v * v), (_mean(u), _mean(v))
    fits = LENS_SPREAD[0] <= spread <= LENS_SPREAD[1] and max(map(abs, middle)) <= LENS_OFFSET
    if pinhole:
        fits = spread == 0.0
    if not fits or not camera.shutter_duration or not samples.motion.any():
        return fits
    time = (valid_values(samples.time, samples.valid) - np.float32(camera.shutter_centre)) / np.float32(
        camera.shutter_duration
    )
    variance = 12.0 * (_mean(time * time) - _mean(time) ** 2)
    return abs(_mean(time)) <= TIME_OFFSET and TIME_SPREAD[0] <= variance <= TIME_SPREAD[1]


def _mean(values: FloatArray) -> float:
    return float(values.mean(dtype=np.float64))


def calibrated(layers: Sequence[tuple[int, Image]], samples: Sequence[PlacedSamples]) -> Image:
    """Return the image of some layers, the local means of each brought to those of its samples.

    Parameters
    ----------
    layers : sequence of (number, ndarray of shape (H, W, 4), float32)
        What each layer adds to the image, premultiplied: its alpha is the share of the pixel that shows it. At least
        one.
    samples : sequence of PlacedSamples
        One for each sample of a pixel.

    Returns
    -------
    ndarray of shape (H, W, 4), float32
        Premultiplied; alpha is the layers' sum.
    """
    shape = layers[0][1].shape[:2]
    scales = [scale for scale in SCALES if LEAST_WINDOWS * scale <= min(shape)]
    # Sum up how much is seen of each layer, and its colours.
    every = np.sum([each.place != NOWHERE for each in samples], axis=0, dtype=np.float32)
    cells, limits = block_counts(shape), (LEAST_SHARE, _floor(layers), LEAST_VARIANCE)
    colour = np.zeros((len(layers), 5, 3, *cells), np.float32)
    cover = np.zeros((len(layers), 5, 1, *cells), np.float32)
    spread = np.zeros((len(layers), *cells), np.float32)
    for k, (number, layer) in enumerate(layers):
        total, count, blur = np.zeros((*shape, 3), np.float32), np.zeros(shape, np.float32), np.zeros(shape, np.float32)
        for each in samples:
            for_bands(_calibration_kernels.add_samples, len(count), *each[:3], number, total, count, blur)
        given = layer, (total, count, blur), every, limits, BLOCK
        for_bands(_calibration_kernels.block_sums, -(-len(count) // BLOCK), *given, colour[k], cover[k], spread[k])
    # Find the gains of both, and add up the layers with them; what is sharp stays where it was seen.
    image, whole = np.zeros_like(layers[0][1]), np.zeros(shape, np.float32)
    shares = [scale for scale in scales if scale in COVER_SCALES]
    seen = believed_gains(cover[:, :, 0].swapaxes(0, 1), shares, shared=True)
    for (number, layer), sums, share, radius in zip(layers, colour, seen, spread, strict=True):
        gain = np.ascontiguousarray(np.stack([*(share * believed_gains(sums, scales, radius)), share], axis=-1))
        shown = np.zeros_like(image)
        for_bands(_calibration_kernels.add_layer, len(image), layer, gain, BLOCK, shown, whole)
        keep_edges(shown, samples, number, limits[1])
        keep_outlines(shown, samples, number)
        image += shown
    # Together they cover as much as before.
    image[..., :3] *= (whole / np.where(image[..., 3] > 0.0, image[..., 3], np.float32(1.0)))[..., None]
    image[..., 3] = whole
    return image


def _floor(layers: Sequence[tuple[int, Image]]) -> float:
    """Return the brightness below which noise does not get less."""
    bright = np.sum([layer[::LOOK, ::LOOK, :3].mean(axis=2) for _, layer in layers], axis=0)
    lit = bright[bright > 0.0]
    return FLOOR * float(np.median(lit)) if len(lit) else 1.0
