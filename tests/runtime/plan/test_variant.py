"""Points of PSF variants: what is taken off a spike, and what is left."""

from itertools import product

import numpy as np
import pytest

from spreadlets.psf.laplacian import laplacian, solve_dirichlet
from spreadlets.runtime.plan.variant import SHARP, Variant, split_spike, variant_points

HALF = 12


def points_of(psf):
    """All points of the Laplacian of a centred PSF (H, W, C)."""
    values = laplacian(psf).astype(np.float32)
    places = np.argwhere(values.any(axis=2))
    return (places - np.asarray(values.shape[:2]) // 2).astype(np.int32), values[tuple(places.T)], False


def image_of(points):
    offset_rc, value, _ = points
    image = np.zeros((2 * HALF + 9, 2 * HALF + 9, value.shape[1]))
    np.add.at(image, tuple((offset_rc + HALF + 4).T), value)
    return solve_dirichlet(image)


def halo(spike):
    """A round halo, peak 0.002, and a spike in its middle."""
    rows, cols = np.indices((2 * HALF - 1, 2 * HALF - 1)) - HALF + 1
    smooth = 0.002 * np.maximum(1.0 - np.hypot(rows, cols) / 10.0, 0.0) ** 2
    psf = np.stack([smooth, 0.5 * smooth, smooth], axis=2)
    psf[HALF - 1, HALF - 1] += spike
    return psf


@pytest.mark.parametrize("spike", [(0.6, 0.6, 0.5), (0.05, 0.04, 0.05)])
def test_a_spike_and_the_rest_are_the_psf(spike):
    points = points_of(halo(spike))
    rest, taken = split_spike(points)
    image = image_of(rest)
    centre = tuple(np.asarray(image.shape[:2]) // 2)
    np.testing.assert_allclose(taken, spike, rtol=0.02)
    assert np.abs(image).max() < 0.0025, "a peak that does not stand out"
    image[centre] += taken
    np.testing.assert_allclose(image, image_of(points), atol=1e-6)


def test_psfs_without_a_spike_are_left_as_they_are():
    for points in (points_of(halo((0.0, 0.0, 0.0))), points_of(halo((0.3, 0.3, 0.0)))):
        rest, taken = split_spike(points)
        assert rest is points and not taken.any()
    offset_rc, value, _ = points_of(halo((0.6, 0.6, 0.6)))
    assert not split_spike((offset_rc, value, True))[1].any()


def test_points_of_a_variant_are_sorted_by_row(small_combined):
    cells = range(0, small_combined.n_cells, 3)
    turned = [Variant(cell, 0, *turn, 1.5) for cell in cells for turn in product((False, True), repeat=3)]
    for (offset_rc, value, _), _ in variant_points([SHARP, *turned], small_combined, None):
        assert (np.diff(offset_rc[:, 0]) >= 0).all() and len(value) == len(offset_rc)
