"""Compiled kernels of the calibration by samples: sums over blocks of pixels, and gains laid over the image."""

import numpy as np

from spreadlets.compiled import kernel


@kernel
def add_samples(begin, end, radiance, valid, total, count):
    """Add one sample of each pixel, (H, W, 4) float32 where ``valid`` (H, W), to ``total`` (H, W, 4) and ``count``."""
    for row in range(begin, end):
        for col in range(valid.shape[1]):
            if valid[row, col]:
                count[row, col] += np.float32(1.0)
                for c in range(4):
                    total[row, col, c] += radiance[row, col, c]


@kernel
def block_sums(begin, end, image, total, count, floor, side, sums):
    """Sum, over blocks of pixels, what a least-squares gain and its error are made of.

    Parameters
    ----------
    image : ndarray of shape (H, W, 4), float32
    total, count : ndarray of shapes (H, W, 4) and (H, W), float32
        Sum and number of the samples of each pixel.
    floor : float
        Brightness below which the weight of a pixel grows no more.
    side : int
        Of a block, px.
    sums : ndarray of shape (4, rows, cols, 3), float64
        Filled, for R, G and B: ``p = w y (m - y)``, ``w y y``, ``p^2`` and ``p^4`` with the image y, the mean m of
        the samples, and the weight w, the number of samples over the squared brightness.
    """
    height, width = count.shape
    for i in range(begin, end):
        for j in range(sums.shape[2]):
            sums[:, i, j] = 0.0
            for row in range(i * side, min((i + 1) * side, height)):
                for col in range(j * side, min((j + 1) * side, width)):
                    n = np.float64(count[row, col])
                    if n == 0:
                        continue
                    # Weigh the pixel, and sum up what its samples say of each colour.
                    bright = (np.float64(image[row, col, 0]) + image[row, col, 1] + image[row, col, 2]) / 3.0
                    weight = n / (bright * bright + floor * floor)
                    for c in range(3):
                        value = np.float64(image[row, col, c])
                        part = weight * value * (total[row, col, c] / n - value)
                        sums[0, i, j, c] += part
                        sums[1, i, j, c] += weight * value * value
                        sums[2, i, j, c] += part * part
                        sums[3, i, j, c] += part * part * part * part


@kernel
def apply_gain(begin, end, image, gain, side):
    """Multiply R, G and B of an image (H, W, 4), in place, by the gains (rows, cols, 3) of blocks, bilinearly."""
    rows, cols = gain.shape[:2]
    line = np.empty((cols, 3))
    for row in range(begin, end):
        # Interpolate down the columns of blocks, then along the row.
        y = min(max((row + 0.5) / side - 0.5, 0.0), rows - 1.0)
        top = min(int(y), max(rows - 2, 0))
        below, down = min(top + 1, rows - 1), y - top
        for j in range(cols):
            for c in range(3):
                line[j, c] = gain[top, j, c] + down * (gain[below, j, c] - gain[top, j, c])
        for col in range(image.shape[1]):
            x = min(max((col + 0.5) / side - 0.5, 0.0), cols - 1.0)
            left = min(int(x), max(cols - 2, 0))
            right, across = min(left + 1, cols - 1), x - left
            for c in range(3):
                image[row, col, c] *= np.float32(line[left, c] + across * (line[right, c] - line[left, c]))
