import numpy as np
import pytest
from reference import disc_coverage

from spreadlets.errors import InvalidParameterError
from spreadlets.precompute.sparsify.dart_throwing import throw_darts
from spreadlets.precompute.sparsify.fit import fit_values
from spreadlets.precompute.sparsify.fitted_annealing import anneal_fitted
from spreadlets.precompute.sparsify.green import reconstruct
from spreadlets.psf.laplacian import laplacian

WINDOW = 121
"""Side, px, beyond which the error of a fitted disc of 9 px is negligible."""


def start(n_channels=1):
    planes = [np.pad(disc_coverage(radius, size=25), 2) for radius in (9.0, 7.5)[:n_channels]]
    psf = np.stack(planes, axis=-1)
    field = laplacian(psf)[1:-1, 1:-1]
    return psf, throw_darts(np.abs(field).max(axis=2), 40, np.random.default_rng(0))


def squared_error(psf, points):
    """Fit the points from scratch and sum the squared error over a window far larger than the PSF."""
    offset = points - np.array(psf.shape[:2]) // 2
    margin = (WINDOW - psf.shape[0]) // 2
    dense = reconstruct(offset, fit_values(psf, offset), (WINDOW, WINDOW))
    return float(((dense - np.pad(psf, [(margin,) * 2, (margin,) * 2, (0, 0)])) ** 2).sum())


@pytest.mark.parametrize("n_channels", [1, 2])
@pytest.mark.parametrize("n_steps", [0, 150])
def test_error_is_that_of_the_fit_over_the_plane(n_channels, n_steps):
    psf, points = start(n_channels)
    annealed, error = anneal_fitted(psf, points, np.random.default_rng(0), n_steps)
    assert error == pytest.approx(squared_error(psf, annealed), rel=1e-3)


def test_annealing_lowers_the_error_of_the_fit():
    psf, points = start()
    errors = [anneal_fitted(psf, points, np.random.default_rng(0), n)[1] for n in (0, 60, 400)]
    assert errors[1] < 0.98 * errors[0]
    assert errors[2] < 0.85 * errors[0]


def test_updated_fit_agrees_with_one_from_scratch(monkeypatch):
    # With a fresh inverse after every move, rounding aside the same moves are taken as with updates alone.
    psf, points = start(2)
    found = []
    for refresh in (1, 10_000):
        monkeypatch.setattr("spreadlets.precompute.sparsify.fitted_annealing.REFRESH_MOVES", refresh)
        found.append(anneal_fitted(psf, points, np.random.default_rng(2), 80)[0])
    assert not np.array_equal(found[0], points[np.lexsort(points.T[::-1])])
    np.testing.assert_array_equal(*found)


def test_points_stay_distinct_inside_and_as_many():
    psf, points = start()
    border = np.array([[0, 0], [0, 1], [28, 28]])
    annealed, _ = anneal_fitted(psf, np.concatenate([points, border]), np.random.default_rng(1), 200)
    assert len(np.unique(annealed, axis=0)) == len(annealed) == len(points) + len(border)
    assert (annealed >= 0).all() and (annealed < psf.shape[:2]).all()


def test_same_seed_gives_the_same_points():
    psf, points = start()
    first, second, other = (anneal_fitted(psf, points, np.random.default_rng(seed), 60)[0] for seed in (3, 3, 4))
    np.testing.assert_array_equal(first, second)
    assert not np.array_equal(first, other)


def test_points_on_a_line_are_refused():
    psf, _ = start()
    with pytest.raises(InvalidParameterError, match="moments"):
        anneal_fitted(psf, np.stack([np.full(12, 14), np.arange(12)], axis=1), np.random.default_rng(0))
