"""Compiled kernels of the calibration by samples: sums over blocks of pixels, and gains laid over layers."""

import numpy as np

from spreadlets.compiled import helper, kernel


@kernel
def add_samples(begin, end, radiance, place, coc, number, total, count, blur):
    """Add one sample of each pixel, as far as it is of a layer, to the layer's.

    Parameters
    ----------
    radiance : ndarray of shape (H, W, 4), float32
    place : ndarray of shape (H, W), float32
        The number of the nearer of its layers plus the share of the next one; below -1 where there is no sample.
    coc : ndarray of shape (H, W), float32
        CoC radius, px.
    number : int
        The layer.
    total : ndarray of shape (H, W, 3), float32
        Colours; added to.
    count : ndarray of shape (H, W), float32
        Shares; added to.
    blur : ndarray of shape (H, W), float32
        CoC radii without sign; added to.
    """
    for row in range(begin, end):
        for col in range(place.shape[1]):
            share = np.float32(1.0) - abs(place[row, col] - np.float32(number))
            if share > np.float32(0.0):
                count[row, col] += share
                blur[row, col] += share * abs(coc[row, col])
                for c in range(3):
                    total[row, col, c] += share * radiance[row, col, c]


@helper
def _with_pixel(sums, product, square, value):
    """Return the sums of a block with those of a pixel, see `block_sums`."""
    part = product - square
    part *= part
    return sums[0] + product, sums[1] + square, sums[2] + part, sums[3] + part * part, sums[4] + value


@helper
def _store(sums, planes, number, i, j):
    """Write the sums of a block to their planes."""
    planes[0, number, i, j], planes[1, number, i, j], planes[2, number, i, j] = sums[0], sums[1], sums[2]
    planes[3, number, i, j], planes[4, number, i, j] = sums[3], sums[4]


@kernel
def block_sums(begin, end, layer, own, every, limits, side, colour, cover, spread):
    """Sum, over blocks of pixels, what the gains of a layer and their errors are made of.

    Sums are those of `runtime.finish.gains.believed_gains`.

    Parameters
    ----------
    layer : ndarray of shape (H, W, 4), float32
        What the layer adds to the image: premultiplied colour, and the share of the pixel that shows it.
    own : tuple of ndarrays of shapes (H, W, 3), (H, W) and (H, W), float32
        Sums of the layer's samples: total, count and blur of `add_samples`.
    every : ndarray of shape (H, W), float32
        Number of the samples of all layers.
    limits : tuple of three floats
        Share of a pixel from which it counts; brightness below which the weight of a colour grows no more; the
        least variance of a share.
    side : int
        Of a block, px.
    colour : ndarray of shape (5, 3, rows, cols), float32
        Filled with the sums of R, G and B, weighted by the layer's samples over the squared brightness.
    cover : ndarray of shape (5, 1, rows, cols), float32
        Filled with those of the shares, weighted by all samples over the variance of whether one is of the layer.
    spread : ndarray of shape (rows, cols), float32
        Filled with the mean CoC radius of the layer's samples, without sign, px; 0 where there are none.
    """
    total, count, blur = own
    height, width = count.shape
    least_share, floor, least_variance = limits
    none = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(begin, end):
        for j in range(-(-width // side)):
            covers, reds, greens, blues, samples, radii = none, none, none, none, 0.0, 0.0
            for row in range(i * side, min((i + 1) * side, height)):
                for col in range(j * side, min((j + 1) * side, width)):
                    n, share = np.float64(count[row, col]), np.float64(layer[row, col, 3])
                    samples, radii = samples + n, radii + np.float64(blur[row, col])
                    if share < least_share:
                        continue
                    # Compare how much of the pixel shows the layer with the share of the samples that do.
                    weight = 1.0 / (max(share * (1.0 - share), 0.0) + least_variance)
                    product, square = weight * share * n, weight * share * share * every[row, col]
                    covers = _with_pixel(covers, product, square, share)
                    if n == 0.0:
                        continue
                    # Compare its colour there with theirs.
                    scale = 1.0 / share
                    red, green, blue = (
                        layer[row, col, 0] * scale,
                        layer[row, col, 1] * scale,
                        layer[row, col, 2] * scale,
                    )
                    bright = (red + green + blue) / 3.0
                    weight = 1.0 / (bright * bright + floor * floor)
                    red_weight, green_weight, blue_weight = weight * red, weight * green, weight * blue
                    reds = _with_pixel(reds, red_weight * total[row, col, 0], red_weight * n * red, red)
                    greens = _with_pixel(greens, green_weight * total[row, col, 1], green_weight * n * green, green)
                    blues = _with_pixel(blues, blue_weight * total[row, col, 2], blue_weight * n * blue, blue)
            spread[i, j] = radii / samples if samples > 0.0 else 0.0
            _store(covers, cover, 0, i, j)
            _store(reds, colour, 0, i, j)
            _store(greens, colour, 1, i, j)
            _store(blues, colour, 2, i, j)


@kernel
def add_layer(begin, end, layer, gain, side, image, whole):
    """Add a layer times the gains of blocks, bilinearly, to an image.

    Parameters
    ----------
    layer : ndarray of shape (H, W, 4), float32
    gain : ndarray of shape (rows, cols, 4), float32
    side : int
        Of a block, px.
    image : ndarray of shape (H, W, 4), float32
        Added to.
    whole : ndarray of shape (H, W), float32
        What the layer's alpha is without a gain is added to it.
    """
    rows, cols = gain.shape[:2]
    line = np.empty((cols, 4), np.float32)
    for row in range(begin, end):
        # Interpolate down the columns of blocks, then along the row.
        y = min(max((row + 0.5) / side - 0.5, 0.0), rows - 1.0)
        top = min(int(y), max(rows - 2, 0))
        below, down = min(top + 1, rows - 1), np.float32(y - top)
        for j in range(cols):
            for c in range(4):
                line[j, c] = gain[top, j, c] + down * (gain[below, j, c] - gain[top, j, c])
        for col in range(image.shape[1]):
            if layer[row, col, 3] == np.float32(0.0):
                continue
            x = min(max((col + 0.5) / side - 0.5, 0.0), cols - 1.0)
            left = min(int(x), max(cols - 2, 0))
            right, across = min(left + 1, cols - 1), np.float32(x - left)
            for c in range(4):
                factor = line[left, c] + across * (line[right, c] - line[left, c])
                image[row, col, c] += factor * layer[row, col, c]
            whole[row, col] += layer[row, col, 3]
