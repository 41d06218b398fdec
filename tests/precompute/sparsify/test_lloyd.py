import numpy as np
import pytest
from naive import sparsify as naive

from spreadlets.errors import InvalidParameterError
from spreadlets.precompute.sparsify.lloyd import assign, collapse, merge, relax


@pytest.mark.interpreted
@pytest.mark.parametrize("n_points", [1, 2, 37])
def test_assignment_agrees_with_brute_force(n_points):
    rng = np.random.default_rng(n_points)
    pixel = np.argwhere(np.ones((14, 19))).astype(float)
    point = rng.random((n_points, 2)) * [13, 18]
    np.testing.assert_array_equal(assign(pixel, point), naive.squared_distances(pixel, point).argmin(axis=1))


def test_assignment_to_no_point_is_refused():
    with pytest.raises(InvalidParameterError, match="at least one point"):
        assign(np.zeros((3, 2)), np.zeros((0, 2)))


def test_relaxation_lowers_the_weighted_distance():
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:41, :41] - 20
    importance = np.exp(-((np.hypot(y, x) - 12) ** 2) / 4)
    points = merge(rng.integers(10, 30, (40, 2)))
    pixel = np.argwhere(importance > 0)

    def cost(point):
        return (importance.ravel() * naive.squared_distances(pixel, point).min(axis=1)).sum()

    once, often = relax(importance, points, 1), relax(importance, points)
    assert cost(often) < cost(once) < cost(points)
    assert cost(often) < 1.01 * cost(relax(importance, points, 200)), "further iterations change nothing"


def test_relaxation_finds_the_centroids_of_two_blobs():
    importance = np.zeros((9, 21))
    importance[3:6, 2:5] = 1.0
    importance[3:6, 15:18] = 2.0
    np.testing.assert_array_equal(relax(importance, np.array([[0, 0], [8, 20]])), [[4, 3], [4, 16]])


def test_relaxation_takes_the_fifty_iterations_of_its_naive_twin(monkeypatch):
    rng = np.random.default_rng(2)
    rows, cols = np.indices((31, 31)) - 15
    importance = np.exp(-((np.hypot(rows, cols) - 9) ** 2) / 8)
    points = merge(rng.integers(8, 22, (25, 2)))
    np.testing.assert_array_equal(relax(importance, points), naive.lloyd(importance, points))
    calls = []
    monkeypatch.setattr("spreadlets.precompute.sparsify.lloyd.assign", lambda *a: calls.append(0) or assign(*a))
    relax(importance, points)
    assert len(calls) == 50


def test_points_that_meet_are_merged():
    np.testing.assert_array_equal(merge(np.array([[1, 2], [0, 5], [1, 2]])), [[0, 5], [1, 2]])


def test_a_point_whose_cell_holds_no_weight_stays():
    importance = np.zeros((5, 5))
    importance[2, 2] = 1.0
    np.testing.assert_array_equal(relax(importance, np.array([[2, 1], [4, 4]])), [[2, 2], [4, 4]])


def test_collapse_keeps_each_channel_s_sum_and_nearest_owner():
    rng = np.random.default_rng(0)
    field = rng.normal(size=(11, 13, 3))
    points = np.array([[2, 2], [8, 9], [5, 5]])
    values = collapse(field, points)
    owner = naive.squared_distances(np.argwhere(np.ones((11, 13))), points).argmin(axis=1).reshape(11, 13)
    np.testing.assert_allclose(values, [field[owner == j].sum(axis=0) for j in range(3)], atol=1e-12)
    np.testing.assert_allclose(values.sum(axis=0), field.sum(axis=(0, 1)), atol=1e-12)
