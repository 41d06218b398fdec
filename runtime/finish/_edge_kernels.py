"""Compiled kernels of edges and outlines: what samples say of the pixels they were seen in, averaged along edges."""

import math

import numpy as np

from spreadlets.compiled import helper, kernel

UNSTEERED = np.float32(np.inf)
"""The variance where the layer is even, and no mean was made: it is not believed at all."""


@kernel
def find_in_focus(begin, end, place, coc, number, reach, found):
    """Mark the rows with a sample of a layer that is in focus, at least in part, see `add_sharp`; ``found`` is (H,)."""
    one, farthest = np.float32(1.0), np.float32(reach) + np.float32(1.0)
    for row in range(begin, end):
        for col in range(place.shape[1]):
            if abs(place[row, col] - np.float32(number)) < one and abs(coc[row, col]) < farthest:
                found[row] = True
                break


@helper
def _across(xx, xy, yy, dx, dy):
    """Return how far, px, a path (dx, dy) leads across an edge, of which the squares of slopes tell the direction."""
    squared, difference = dx * dx + dy * dy, math.sqrt((xx - yy) ** 2 + np.float32(4.0) * xy * xy)
    largest = np.float32(0.5) * (xx + yy + difference)
    if largest > np.float32(0.0):
        squared = min(squared, (xx * dx * dx + np.float32(2.0) * xy * dx * dy + yy * dy * dy) / largest)
    return math.sqrt(max(squared, np.float32(0.0)))


@helper
def _beside(image, row, col, dx, dy, c):
    """Return by how much channel ``c`` of an image (H, W, C) changes from a pixel's centre to a place beside it."""
    height, width, _ = image.shape
    right, down = 1 if dx > np.float32(0.0) else -1, 1 if dy > np.float32(0.0) else -1
    x, y = min(max(col + right, 0), width - 1), min(max(row + down, 0), height - 1)
    across, along = abs(dx), abs(dy)
    here = image[row, col, c]
    beside, below, aslant = image[row, x, c] - here, image[y, col, c] - here, image[y, x, c] - here
    return across * beside + along * below + across * along * (aslant - beside - below)


@kernel
def add_sharp(begin, end, sample, layer, products, number, reach, least_share, lacking, count, every):
    """Add what one sample of each pixel differs from a layer by, as far as it is of it, and sharp across its edges.

    It is compared with the layer right where it was seen.

    Parameters
    ----------
    sample : tuple
        See `runtime.finish.edges.PlacedSamples`.
    layer : ndarray of shape (H, W, 4), float32
        Premultiplied.
    products : ndarray of shape (3, H, W), float32
        Of the layer, see `multiply_slopes`, blurred.
    number : int
        The layer.
    reach : float
        What the PSF of a sharp sample reaches at most, px; up to one pixel more, it is so in part.
    least_share : float
        Alpha of the layer from which it counts.
    lacking : ndarray of shape (H, W, 3), float32
        Differences of the sharp samples; added to.
    count, every : ndarray of shape (H, W), float32
        Shares of the sharp samples, and of all; added to.
    """
    zero, one = np.float32(0.0), np.float32(1.0)
    radiance, place, coc, path, offset = sample
    for row in range(begin, end):
        for col in range(place.shape[1]):
            share = one - abs(place[row, col] - np.float32(number))
            if share <= zero:
                continue
            every[row, col] += share
            # See how sharp it is across the edges there.
            beyond = abs(coc[row, col]) - np.float32(reach)
            if beyond >= one:
                continue
            xx, xy, yy = products[0, row, col], products[1, row, col], products[2, row, col]
            beyond += np.float32(0.5) * _across(xx, xy, yy, path[row, col, 0], path[row, col, 1])
            if beyond >= one:
                continue
            share *= min(one - beyond, one)
            # Compare it with the layer where it was seen.
            alpha, dx, dy = layer[row, col, 3], offset[row, col, 0], offset[row, col, 1]
            there = alpha + _beside(layer, row, col, dx, dy, 3)
            if min(alpha, there) < np.float32(least_share):
                continue
            count[row, col] += share
            for c in range(3):
                lies = (layer[row, col, c] + _beside(layer, row, col, dx, dy, c)) / there
                lacking[row, col, c] += share * (radiance[row, col, c] - lies)


@helper
def _brightness(layer, row, col, floor):
    """Return the mean of a pixel's colours, without alpha, plus ``floor``."""
    alpha = layer[row, col, 3]
    if alpha <= np.float32(0.0):
        return np.float32(floor)
    bright = (layer[row, col, 0] + layer[row, col, 1] + layer[row, col, 2]) / (np.float32(3.0) * alpha)
    return max(bright, np.float32(0.0)) + np.float32(floor)


@kernel
def take_logarithms(begin, end, layer, floor, logarithm):
    """Fill ``logarithm`` (H, W), float32, with that of a layer's brightness (H, W, 4), premultiplied, plus a floor."""
    for row in range(begin, end):
        for col in range(logarithm.shape[1]):
            logarithm[row, col] = math.log(_brightness(layer, row, col, floor))


@kernel
def find_lacking(begin, end, layer, count, floor, lacking):
    """Make sums of what a layer lacks its mean, relative to the layer's brightness.

    Parameters
    ----------
    layer : ndarray of shape (H, W, 4), float32
        Premultiplied.
    count : ndarray of shape (H, W), float32
        See `add_sharp`.
    floor : float
        Brightness that is added to all.
    lacking : ndarray of shape (H, W, 3), float32
        See `add_sharp`; changed in place.
    """
    for row in range(begin, end):
        for col in range(count.shape[1]):
            if count[row, col] > np.float32(0.0):
                whole = count[row, col] * _brightness(layer, row, col, floor)
                for c in range(3):
                    lacking[row, col, c] /= whole


@kernel
def add_seen(begin, end, place, offset, cover, number, lacking, count):
    """Add how much of one sample of each pixel met a layer, less the layer's cover where it was seen.

    Parameters
    ----------
    place : ndarray of shape (H, W), float32
        See `runtime.finish._calibration_kernels.add_samples`.
    offset : ndarray of shape (H, W, 2), float32
        Where in its pixel it was seen, px (dx, dy) from the centre.
    cover : ndarray of shape (H, W, 1), float32
        Share of each pixel that shows the layer.
    number : int
        The layer.
    lacking : ndarray of shape (H, W, 1), float32
        Added to.
    count : ndarray of shape (H, W), float32
        Samples of any layer; added to.
    """
    zero, one = np.float32(0.0), np.float32(1.0)
    for row in range(begin, end):
        for col in range(count.shape[1]):
            if place[row, col] >= zero:
                share = max(one - abs(place[row, col] - np.float32(number)), zero)
                there = cover[row, col, 0] + _beside(cover, row, col, offset[row, col, 0], offset[row, col, 1], 0)
                lacking[row, col, 0] += share - there
                count[row, col] += one


@kernel
def multiply_slopes(begin, end, values, products):
    """Fill ``products`` (3, H, W), float32, with the squares of the slopes across and down, and their product between.

    Slopes are of ``values`` (H, W), per px.
    """
    height, width = values.shape
    for row in range(begin, end):
        above, below = max(row - 1, 0), min(row + 1, height - 1)
        for col in range(width):
            left, right = max(col - 1, 0), min(col + 1, width - 1)
            across = (values[row, right] - values[row, left]) / np.float32(max(right - left, 1))
            down = (values[below, col] - values[above, col]) / np.float32(max(below - above, 1))
            products[0, row, col], products[1, row, col] = across * across, across * down
            products[2, row, col] = down * down


@kernel
def find_directions(begin, end, products, least_slope, wanted, directions):
    """Find which way edges run, and how much the slopes around agree on it.

    Parameters
    ----------
    products : ndarray of shape (3, H, W), float32
        See `multiply_slopes`, blurred.
    least_slope : float
        Where slopes are smaller, there is no edge.
    wanted : ndarray of shape (H, W), float32
        Where it is 0, none is looked for.
    directions : ndarray of shape (H, W, 3), float32
        Filled with a unit vector (x, y) along the edge, and how much slopes agree, from 0 to 1; the vector is 0 where
        there is no edge.
    """
    half, two, four = np.float32(0.5), np.float32(2.0), np.float32(4.0)
    for row in range(begin, end):
        for col in range(directions.shape[1]):
            xx, xy, yy = products[0, row, col], products[1, row, col], products[2, row, col]
            found = directions[row, col]
            found[0], found[1], found[2] = np.float32(0.0), np.float32(0.0), np.float32(0.0)
            if wanted[row, col] == np.float32(0.0) or xx + yy < np.float32(least_slope) ** 2:
                continue
            # The eigenvector of the smaller eigenvalue runs along the edge.
            angle = half * math.atan2(two * xy, xx - yy)
            found[0], found[1] = -math.sin(angle), math.cos(angle)
            found[2] = ((xx - yy) ** 2 + four * xy * xy) / (xx + yy) ** 2


@helper
def _next_along(directions, y, x, along_x, along_y, straight):
    """Return the direction (x, y) in which the edge goes on at a place that was come to; 0 where it ends, or turns."""
    height, width, _ = directions.shape
    row, col, zero = int(np.rint(y)), int(np.rint(x)), np.float32(0.0)
    if row < 0 or col < 0 or row >= height or col >= width:
        return zero, zero
    to_x, to_y = directions[row, col, 0], directions[row, col, 1]
    turned = to_x * along_x + to_y * along_y
    if abs(turned) < np.float32(straight):
        return zero, zero
    return (to_x, to_y) if turned > zero else (-to_x, -to_y)


@helper
def _add_between(lacking, count, y, x, is_level, taper, total):
    """Add what is lacking at a place (y, x) on an edge to a total (C,); return its weight, and its weighed square.

    Of the two pixels that the edge runs between there, each counts as far as it is near.
    """
    height, width, n_channels = lacking.shape
    zero, one = np.float32(0.0), np.float32(1.0)
    samples, squares = zero, zero
    between = y if is_level else x
    before = int(np.floor(between))
    part = between - np.float32(before)
    for k in range(2):
        row = before + k if is_level else int(np.rint(y))
        col = int(np.rint(x)) if is_level else before + k
        weight = taper * (part if k else one - part)
        if weight <= zero or row < 0 or col < 0 or row >= height or col >= width:
            continue
        # Weigh it by the samples in the pixel.
        weight *= count[row, col]
        square = zero
        for c in range(n_channels):
            total[c] += weight * lacking[row, col, c]
            square += lacking[row, col, c] ** 2
        samples += weight
        squares += weight * weight * square
    return samples, squares


@kernel
def steered_means(begin, end, lacking, count, directions, lengths, straight, mean, variance):
    """Average what a layer lacks along its edges, which are followed as far as they do not turn sharply.

    Parameters
    ----------
    lacking, count : ndarray of shapes (H, W, C) and (H, W), float32
        In the mean of the samples of a pixel, and how many these are.
    directions : ndarray of shape (H, W, 3), float32
        See `find_directions`.
    lengths : tuple of two floats
        How far an edge is followed to either side where slopes around agree on it, and where they do not, px.
    straight : float
        Cosine of the largest turn from a pixel to the next.
    mean : ndarray of shape (H, W, C), float32
        Filled: 0 where there is none.
    variance : ndarray of shape (H, W), float32
        Filled with that of the mean, summed over the channels, as the spread of what is averaged tells; `UNSTEERED`
        where there is no edge.
    """
    width, n_channels = lacking.shape[1:]
    zero, one = np.float32(0.0), np.float32(1.0)
    for row in range(begin, end):
        for col in range(width):
            variance[row, col] = UNSTEERED
            for c in range(n_channels):
                mean[row, col, c] = zero
            first_x, first_y, agree = directions[row, col, 0], directions[row, col, 1], directions[row, col, 2]
            if first_x == zero and first_y == zero:
                continue
            length = np.float32(lengths[1]) + agree * np.float32(lengths[0] - lengths[1])
            samples, squares = zero, zero
            for side in range(2):
                # Follow the edge to this side, by a row or a column each time.
                along_x, along_y = (first_x, first_y) if side == 0 else (-first_x, -first_y)
                y, x, gone = np.float32(row), np.float32(col), zero
                while gone < length and (along_x != zero or along_y != zero):
                    taper = (one - (gone / length) ** 2) ** 2 if gone > zero or side == 0 else zero
                    weight, square = _add_between(
                        lacking, count, y, x, abs(along_x) >= abs(along_y), taper, mean[row, col]
                    )
                    samples, squares = samples + weight, squares + square
                    stride = one / max(abs(along_x), abs(along_y))
                    y, x, gone = y + stride * along_y, x + stride * along_x, gone + stride
                    along_x, along_y = _next_along(directions, y, x, along_x, along_y, straight)
            # Divide by the weight; without a sample nothing is known.
            if samples > zero:
                variance[row, col] = squares / (samples * samples)
                for c in range(n_channels):
                    mean[row, col, c] /= samples


@helper
def _belief(variance, products, row, col, power):
    """Return how far a mean is to be believed, see `add_edges`."""
    expected = np.float32(power) * (products[0, row, col] + products[2, row, col])
    return expected / (expected + variance[row, col])


@kernel
def add_edges(begin, end, layer, mean, variance, products, sharp, power, floor):
    """Add to a layer what it lacks, as far as that is believed.

    Parameters
    ----------
    layer : ndarray of shape (H, W, 4), float32
        Premultiplied; changed in place.
    mean, variance : ndarray of shapes (H, W, 3) and (H, W), float32
        See `steered_means`.
    products : ndarray of shape (3, H, W), float32
    sharp : ndarray of shape (H, W), float32
        Share of the layer's samples around that are sharp.
    power : float
        Expected square of what is lacking, for a square of the slopes of 1.
    floor : float
        See `find_lacking`.
    """
    zero = np.float32(0.0)
    for row in range(begin, end):
        for col in range(sharp.shape[1]):
            believed = sharp[row, col] * _belief(variance, products, row, col, power)
            if believed > zero:
                scale = believed * _brightness(layer, row, col, floor) * layer[row, col, 3]
                for c in range(3):
                    changed = layer[row, col, c] + scale * mean[row, col, c]
                    layer[row, col, c] = max(changed, min(layer[row, col, c], zero))


@kernel
def add_outlines(begin, end, layer, mean, variance, products, power, least_share):
    """Cover with a layer, in its own colours, what it lacks, as far as that is believed.

    Parameters
    ----------
    layer : ndarray of shape (H, W, 4), float32
        Premultiplied; changed in place where its alpha is ``least_share``, at least.
    mean, variance, products, power
        As for `add_edges`, the mean of shape (H, W, 1).
    least_share : float
    """
    zero, one = np.float32(0.0), np.float32(1.0)
    for row in range(begin, end):
        for col in range(layer.shape[1]):
            believed, alpha = _belief(variance, products, row, col, power), layer[row, col, 3]
            if believed > zero and alpha >= np.float32(least_share):
                gain = min(max(alpha + believed * mean[row, col, 0], zero), max(alpha, one)) / alpha
                for c in range(4):
                    layer[row, col, c] *= gain
