"""Kernel of meshes of rays on the sensor: the light of their triangles, spread evenly over each."""

import math

from spreadlets.compiled import helper, kernel

LEAST_AREA = 2.0
"""Samples that a triangle must cover for its light to be spread over them; that of a smaller one goes to its middle."""


@helper
def _fill_small(a, b, c, energy, image):
    """Give the light of a small triangle, as far as its corners are clear, to the sample at its middle."""
    clear, whole = 0.0, 0.0
    for corner in (a, b, c):
        clear += max(corner[2], 0.0)
        whole += abs(corner[2])
    row, col = int((a[1] + b[1] + c[1]) / 3.0), int((a[0] + b[0] + c[0]) / 3.0)
    if clear > 0.0 and 0 <= row < image.shape[0] and 0 <= col < image.shape[1]:
        image[row, col] += energy * clear / whole


@helper
def _fill_triangle(a, b, c, energy, image):
    """Spread a triangle's light over the samples in it that are clear; a corner is x, y and clearance."""
    twice_area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    if twice_area < 0.0:
        b, c = c, b
        twice_area = -twice_area
    if twice_area < 2.0 * LEAST_AREA:
        _fill_small(a, b, c, energy, image)
        return
    level = 2.0 * energy / twice_area
    top, bottom = math.ceil(min(a[1], b[1], c[1]) - 0.5), math.floor(max(a[1], b[1], c[1]) - 0.5)
    left, right = math.ceil(min(a[0], b[0], c[0]) - 0.5), math.floor(max(a[0], b[0], c[0]) - 0.5)
    for row in range(max(int(top), 0), min(int(bottom), image.shape[0] - 1) + 1):
        y = row + 0.5
        for col in range(max(int(left), 0), min(int(right), image.shape[1] - 1) + 1):
            x = col + 0.5
            # Barycentric coordinates: a sample belongs to the triangle where none is negative.
            to_a = (c[0] - b[0]) * (y - b[1]) - (c[1] - b[1]) * (x - b[0])
            to_b = (a[0] - c[0]) * (y - c[1]) - (a[1] - c[1]) * (x - c[0])
            to_c = (b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])
            inside = to_a >= 0.0 and to_b >= 0.0 and to_c >= 0.0
            if inside and to_a * a[2] + to_b * b[2] + to_c * c[2] > 0.0:
                image[row, col] += level


@kernel
def fill_meshes(begin, end, corner, planes):
    """Add the light of meshes of rays to an image for each.

    Parameters
    ----------
    corner : float64 array of shape (n, G, G, 3)
        Place x, y on the image, in its samples, and clearance of each ray: above 0 where light passes, and linear in
        between. The light is 1 for each square of a mesh.
    planes : float64 array of shape (n, H, W)
    """
    side = corner.shape[1] - 1
    for number in range(begin, end):
        for i in range(side):
            for j in range(side):
                a, b = corner[number, i, j], corner[number, i, j + 1]
                c, d = corner[number, i + 1, j], corner[number, i + 1, j + 1]
                if max(a[2], b[2], c[2], d[2]) > 0.0:
                    _fill_triangle(a, b, c, 0.5, planes[number])
                    _fill_triangle(d, c, b, 0.5, planes[number])
