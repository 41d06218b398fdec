import numpy as np
import pytest
from naive import sparsify as naive

from spreadlets.errors import InvalidParameterError
from spreadlets.precompute.sparsify import _sparsify_kernels as _kernels
from spreadlets.precompute.sparsify.dart_throwing import throw_darts


def ring_importance(size=41, radius=12.0):
    y, x = np.mgrid[:size, :size] - size // 2
    return np.exp(-((np.hypot(y, x) - radius) ** 2))


@pytest.mark.interpreted
def test_kernel_agrees_with_its_naive_twin():
    rng = np.random.default_rng(1)
    importance = rng.random((12, 17))
    cumulative = np.cumsum(importance.ravel()) / importance.sum()
    radius = rng.uniform(0.5, 4.0, importance.shape)
    uniform = rng.random(200)
    placed = np.empty((importance.size, 2), dtype=np.int64)
    n_placed, n_failures = _kernels.throw_darts(cumulative, radius, uniform, 60, placed)
    expected, expected_failures = naive.throw_darts(cumulative, radius, uniform, 60)
    np.testing.assert_array_equal(placed[:n_placed], expected)
    assert n_failures == expected_failures


@pytest.mark.parametrize("n_target", [30, 120, 300])
def test_count_is_near_the_target(n_target):
    y, x = np.mgrid[:101, :101] - 50
    points = throw_darts(np.exp(-((y**2 + x**2) / 1000)), n_target, np.random.default_rng(0))
    assert 0.7 * n_target < len(points) < 1.3 * n_target


def test_density_follows_the_importance():
    importance = np.ones((60, 120))
    importance[:, 60:] = 4.0
    points = throw_darts(importance, 200, np.random.default_rng(0))
    left, right = (points[:, 1] < 60).sum(), (points[:, 1] >= 60).sum()
    assert right == pytest.approx(4 * left, rel=0.3)


def test_points_are_distinct_and_avoid_zero_importance():
    importance = ring_importance()
    importance[importance < 0.1] = 0.0
    points = throw_darts(importance, 10**4, np.random.default_rng(0))
    assert len(np.unique(points, axis=0)) == len(points)
    assert (importance[points[:, 0], points[:, 1]] > 0).all()


def test_fewer_allowed_failures_place_fewer_points():
    few, many = (throw_darts(ring_importance(), 400, np.random.default_rng(0), n) for n in (20, 10_000))
    assert len(few) < len(many)


def test_darts_are_thrown_until_ten_thousand_have_failed(monkeypatch):
    throw, failures = _kernels.throw_darts, []

    def count(*arguments):
        placed, failed = throw(*arguments)
        failures.append(failed)
        return placed, failed

    monkeypatch.setattr(_kernels, "throw_darts", count)
    throw_darts(ring_importance(), 60, np.random.default_rng(0))
    assert failures == [10_000]


def test_same_seed_gives_the_same_points():
    first, second = (throw_darts(ring_importance(), 60, np.random.default_rng(7)) for _ in range(2))
    np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize("importance", [np.zeros((5, 5)), np.full((5, 5), -1.0), np.full((5, 5), np.nan)])
def test_unusable_importance_is_refused(importance):
    with pytest.raises(InvalidParameterError, match="importance must be finite"):
        throw_darts(importance, 5, np.random.default_rng(0))


def test_unusable_target_is_refused():
    with pytest.raises(InvalidParameterError, match="n_target must be above 0, not 0"):
        throw_darts(np.ones((5, 5)), 0, np.random.default_rng(0))
