import numpy as np
import pytest
from naive import sparsify as naive
from naive.psfs import disc_coverage

from spreadlets.precompute.sparsify import elimination
from spreadlets.precompute.sparsify.elimination import eliminate
from spreadlets.precompute.sparsify.similarity import similarity_equations
from spreadlets.precompute.sparsify.symmetry import IDENTITY, orbits
from spreadlets.psf.laplacian import laplacian


@pytest.fixture(scope="module")
def problem():
    psf = np.pad(disc_coverage(6.0), 9)[..., None]
    psf = psf / psf.max()
    field = laplacian(psf)[1:-1, 1:-1, 0]
    offset = np.argwhere(np.abs(field) > 1e-2 * np.abs(field).max()) - np.array(psf.shape[:2]) // 2
    members, size = orbits(offset, (IDENTITY,))
    return similarity_equations(psf, members, size, (IDENTITY,)), size


def test_the_cost_of_a_point_is_what_fitting_without_it_costs(problem):
    equations, size = problem
    index, value = eliminate(equations, size, 1e-4, 1.0)
    left = equations.subset(index)
    cost = value[:, 0] ** 2 / np.diag(left.free_inverse())
    expected = naive.eliminate_one(left.gram, left.rhs[:, 0], left.basis.T, left.fixed[:, 0])
    np.testing.assert_allclose(cost, expected, rtol=1e-4, atol=1e-9)
    assert cost.min() >= 1e-4


def test_a_higher_price_leaves_fewer_points(problem):
    equations, size = problem
    counts = [len(eliminate(equations, size, price, 1.0)[0]) for price in (1e-5, 1e-4, 1e-3, 1e-2)]
    assert counts == sorted(counts, reverse=True) and len(set(counts)) == 4


def test_the_limit_is_kept_at_any_price(problem):
    equations, size = problem
    everything = equations.objective(equations.solve(equations.free_inverse()))
    for limit in (0.003, 0.03):
        index, value = eliminate(equations, size, np.inf, limit)
        assert len(index) < len(size)
        rise = equations.subset(index).objective(value) - everything
        assert 0.3 * limit < rise <= 1.01 * limit


def test_without_a_limit_as_many_points_are_left_as_there_are_constraints(problem):
    equations, size = problem
    index, _ = eliminate(equations, size, np.inf, np.inf)
    assert len(index) == equations.basis.shape[1]


def test_batches_cost_little_against_one_at_a_time(problem, monkeypatch):
    equations, size = problem
    batched, value = eliminate(equations, size, 1e-4, 1.0)
    loss = equations.subset(batched).objective(value) + 1e-4 * len(batched)
    monkeypatch.setattr(elimination, "BATCH_FRACTION", 0.0)
    single, value = eliminate(equations, size, 1e-4, 1.0)
    assert loss < 1.1 * (equations.subset(single).objective(value) + 1e-4 * len(single))


def test_greater_orbits_are_dropped_for_more(problem):
    equations, size = problem
    small, _ = eliminate(equations, size, 1e-5, 1.0)
    large, _ = eliminate(equations, 8 * size, 1e-5, 1.0)
    assert len(large) < len(small)
