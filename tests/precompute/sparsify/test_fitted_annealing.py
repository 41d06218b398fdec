import numpy as np
import pytest
from naive import sparsify as naive
from naive.psfs import disc_coverage

from spreadlets.precompute.sparsify.fitted_annealing import anneal_fitted, candidates_near
from spreadlets.precompute.sparsify.similarity import similarity_equations
from spreadlets.precompute.sparsify.symmetry import GROUPS, IDENTITY, orbits


def start(n_channels=1, n_points=160):
    """Return equations of the pixels around the rims of discs, each pixel's neighbours, and some of the pixels."""
    planes = [np.pad(disc_coverage(radius, size=25), 10) for radius in (9.0, 7.5)[:n_channels]]
    psf = np.stack(planes, axis=-1) / max(plane.max() for plane in planes)
    rows, cols = np.indices(psf.shape[:2]) - psf.shape[0] // 2
    near = np.abs(np.hypot(rows, cols) - 8.0) < 4.0
    members, size = orbits(np.stack([rows[near], cols[near]], axis=1), (IDENTITY,))
    equations = similarity_equations(psf, members, size, (IDENTITY,))
    index = np.sort(np.random.default_rng(0).permutation(len(members))[:n_points])
    return equations, candidates_near(members), index


def error_of(equations, index):
    left = equations.subset(index)
    return left.objective(left.solve(left.free_inverse()))


@pytest.mark.parametrize("n_channels", [1, 2])
def test_it_takes_the_moves_of_its_naive_twin(n_channels):
    # Of 160 points a hundredth is two.
    equations, near, index = start(n_channels)
    expected, least = naive.anneal_fitted(equations, near, index, np.random.default_rng(4), n_steps=150)
    found = anneal_fitted(equations, near, index, np.random.default_rng(4), n_steps=150)
    np.testing.assert_array_equal(found, expected)
    assert error_of(equations, found) == pytest.approx(least, rel=1e-4)


def test_annealing_lowers_the_error_of_the_fit():
    equations, near, index = start(n_points=60)
    errors = [error_of(equations, anneal_fitted(equations, near, index, np.random.default_rng(0), n)) for n in (0, 400)]
    assert errors[1] < 0.97 * errors[0]


def test_updated_fit_agrees_with_one_from_scratch(monkeypatch):
    # With a fresh inverse after every move, rounding aside the same moves are taken as with updates alone.
    equations, near, index = start(2, 60)
    found = []
    for refresh in (1, 10_000):
        monkeypatch.setattr("spreadlets.precompute.sparsify.fitted_annealing.REFRESH_MOVES", refresh)
        found.append(anneal_fitted(equations, near, index, np.random.default_rng(2), 80))
    assert not np.array_equal(found[0], index)
    np.testing.assert_array_equal(*found)


def test_points_stay_distinct_and_as_many():
    equations, near, index = start(n_points=60)
    annealed = anneal_fitted(equations, near, index, np.random.default_rng(1), 200)
    assert len(np.unique(annealed)) == len(annealed) == len(index)


def test_same_seed_gives_the_same_points():
    equations, near, index = start(n_points=60)
    first, second, other = (anneal_fitted(equations, near, index, np.random.default_rng(seed)) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first, second)
    assert not np.array_equal(first, other)


def test_points_that_carry_the_moments_by_luck_stay_where_they_are():
    equations, near, _ = start()
    disc = np.array([[0, 5], [0, -5], [5, 0], [-5, 0], [3, 4], [3, -4], [-3, 4], [-3, -4]])
    members, size = orbits(disc, (IDENTITY,))
    # On a circle, the second moments follow from the sum.
    rows, cols = np.indices((45, 45)) - 22
    psf = disc_coverage(5.0, size=45)[..., None]
    wide, _ = orbits(np.argwhere(np.hypot(rows, cols) < 8) - 22, (IDENTITY,))
    equations = similarity_equations(psf / psf.max(), wide, np.ones(len(wide), np.int64), (IDENTITY,))
    place = {tuple(rc): i for i, rc in enumerate(wide[:, 0].tolist())}
    circle = np.array([place[tuple(rc)] for rc in members[:, 0].tolist()])
    loose = equations.__class__(
        equations.gram, equations.rhs, equations.constant, equations.basis, 0.0 * equations.fixed
    )
    found = anneal_fitted(loose, candidates_near(wide), circle, np.random.default_rng(0))
    np.testing.assert_array_equal(found, np.sort(circle))


def test_where_rounding_leaves_less_than_no_error_no_move_may_raise_it():
    equations, near, index = start(n_points=60)
    exact = equations.__class__(
        equations.gram,
        equations.rhs,
        equations.constant - error_of(equations, index) - 1e-9,
        equations.basis,
        equations.fixed,
    )
    # Moves that lower it are taken; any other would be, one after the other, with a chance beyond all numbers.
    found = anneal_fitted(exact, near, index, np.random.default_rng(0), 20)
    assert error_of(equations, found) < error_of(equations, index)


def test_neighbours_are_the_orbits_around_a_pixel():
    offset = np.argwhere(np.ones((5, 5))) - 2
    members, _ = orbits(offset, (IDENTITY,))
    near = candidates_near(members)
    for one, others in enumerate(near):
        distance = np.abs(members[:, 0] - members[one, 0]).max(axis=1)
        np.testing.assert_array_equal(others, np.flatnonzero(distance == 1))
    # Under all eight symmetries an octant is left, whose pixels meet mirror images too.
    members, _ = orbits(offset, GROUPS[0])
    images = [{tuple(rc) for rc in orbit.tolist()} for orbit in members]
    for one, others in enumerate(candidates_near(members)):
        row, col = members[one, 0]
        around = {(row + r, col + c) for r in (-1, 0, 1) for c in (-1, 0, 1)}
        assert set(others.tolist()) == {j for j, image in enumerate(images) if image & around and j != one}
