import numpy as np
import pytest
from naive import sparsify as naive
from naive.psfs import capsule_psf, disc_coverage

from spreadlets.errors import InvalidParameterError
from spreadlets.precompute.sparsify.fit import biharmonic_equations, fit_values, quantise
from spreadlets.precompute.sparsify.green import reconstruct
from spreadlets.precompute.sparsify.lloyd import collapse
from spreadlets.psf.laplacian import laplacian

MOMENT_TOLERANCE = 1e-9
"""Of the moments in units of the PSF's energy and half-size: rounding of a solve with a few hundred unknowns."""


def edge_points(psf, every=3):
    field = laplacian(psf)[1:-1, 1:-1]
    points = np.argwhere(np.abs(field).max(axis=2) > 1e-3 * np.abs(field).max())
    return points[::every] - np.array(psf.shape[:2]) // 2


@pytest.fixture(params=[(6.0, 0.0, 0.0), (4.0, 9.0, 0.4)], ids=["disc", "capsule"])
def psf(request):
    return np.pad(capsule_psf(*request.param), 2)[..., None]


def test_all_moments_up_to_the_second_order_are_exact(psf):
    points = edge_points(psf)
    values = fit_values(psf, points)[:, 0]
    half = max(psf.shape) // 2
    scale = np.array([1, half, half, half**2, half**2, half**2])
    moments = naive.moment_rows(points) @ values
    np.testing.assert_allclose(moments / scale, np.array([0, 0, 0, 0, 2, 2]) / scale, atol=MOMENT_TOLERANCE)


def test_the_fit_is_the_constrained_least_squares_solution(psf):
    points = edge_points(psf)
    shape = (161, 161)
    window = np.zeros(shape)
    half, centre = np.array(psf.shape[:2]) // 2, np.array(shape) // 2
    window[centre[0] - half[0] : centre[0] + half[0] + 1, centre[1] - half[1] : centre[1] + half[1] + 1] = psf[..., 0]
    columns = naive.green_columns(points, shape).reshape(-1, len(points))
    target = np.array([0, 0, 0, 0, 2.0, 2.0])
    expected = naive.constrained_least_squares(columns, window.ravel(), naive.moment_rows(points), target)
    values = fit_values(psf, points)[:, 0]
    # The oracle's window is finite, which cuts off some of the error's tail.
    np.testing.assert_allclose(values, expected, atol=2e-3 * np.abs(expected).max())


def test_the_fit_is_better_than_voronoi_sums(psf):
    points = edge_points(psf)
    half = np.array(psf.shape[:2]) // 2
    summed = collapse(laplacian(psf)[1:-1, 1:-1], points + half)
    errors = [np.abs(reconstruct(points, v, psf.shape[:2]) - psf).sum() for v in (fit_values(psf, points), summed)]
    assert errors[0] < 0.7 * errors[1]


def test_all_pixels_of_the_laplacian_give_the_laplacian_itself():
    psf = np.pad(disc_coverage(3.0), 2)[..., None]
    field = laplacian(psf)[1:-1, 1:-1, 0]
    points = np.argwhere(field != 0)
    values = fit_values(psf, points - np.array(psf.shape[:2]) // 2)
    np.testing.assert_allclose(values[:, 0], field[points[:, 0], points[:, 1]], atol=1e-5 * np.abs(field).max())


def test_channels_are_fitted_independently():
    psf = np.pad(disc_coverage(5.0), 2)[..., None]
    points = edge_points(psf)
    both = fit_values(np.concatenate([psf, 0.3 * psf], axis=2), points)
    np.testing.assert_allclose(both, fit_values(psf, points) * [1.0, 0.3], rtol=1e-9)


def test_a_subset_of_the_equations_is_the_subset_s_own_fit():
    psf = np.pad(disc_coverage(5.0), 2)[..., None]
    points = edge_points(psf)
    index = np.arange(0, len(points), 2)
    subset = biharmonic_equations(psf, points).subset(index)
    expected = fit_values(psf, points[index])
    np.testing.assert_allclose(subset.solve(subset.free_inverse()), expected, atol=1e-6 * np.abs(expected).max())


@pytest.mark.parametrize(
    "points", [[[0, 0]], [[0, k] for k in range(-6, 7)], [[0, 0], [0, 1], [1, 0]]], ids=["one", "line", "few"]
)
def test_points_that_cannot_carry_the_moments_are_refused(points):
    with pytest.raises(InvalidParameterError, match=f"{len(points)} points cannot carry the PSF's moments"):
        fit_values(disc_coverage(5.0)[..., None], np.array(points))


def test_coincident_points_are_refused():
    points = edge_points(np.pad(disc_coverage(5.0), 2)[..., None])
    with pytest.raises(InvalidParameterError, match="points are distinct; merge the others"):
        fit_values(disc_coverage(5.0)[..., None], np.concatenate([points, points[:2]]))


def test_quantised_values_sum_to_exactly_zero_and_keep_the_energy():
    rng = np.random.default_rng(0)
    offset = rng.integers(-200, 200, (500, 2))
    value = rng.normal(size=(500, 3)) * [1.0, 1e-3, 1e4]
    value -= value.mean(axis=0)
    rounded = quantise(offset, value)
    assert rounded.dtype == np.float32
    assert (rounded.astype(np.float64).sum(axis=0) == 0).all()
    np.testing.assert_allclose(rounded, value, atol=2e-4 * np.abs(value).max())
    square = (offset**2).sum(axis=1)
    step = 2.0 ** np.ceil(np.log2(np.abs(value).max(axis=0))) / 2**22
    assert (np.abs(square @ rounded.astype(np.float64) - square @ value) <= 0.51 * step * np.ptp(square)).all()


def test_a_single_point_is_quantised_without_division_by_zero():
    assert quantise(np.array([[0, 0]]), np.array([[0.0]])) == 0
