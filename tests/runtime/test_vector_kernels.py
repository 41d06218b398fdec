"""Vectors in compiled code against what they mean in Python."""

import numba
import numpy as np
import pytest
from numba.core.errors import TypingError

from spreadlets.runtime._vector_kernels import add, load, load_two, multiply, store


def weighted_sum(out, x, y, i, j):
    index = np.uint64(i)
    vector = load(x, index)
    store(out, np.uint64(j), add(multiply(vector, load(y, index)), (vector[0], vector[1], vector[2], vector[3])))


def weighted_sum_of_two(out, x, y, i, j):
    index = np.uint64(i)
    vector = load_two(x, index)
    store(out, np.uint64(j), add(multiply(vector, load_two(y, index)), vector))


@pytest.mark.interpreted
@pytest.mark.parametrize("i, j", [(0, 0), (1, 5), (7, 2)])
@pytest.mark.parametrize("function, width", [(weighted_sum, 4), (weighted_sum_of_two, 8)])
def test_compiled_vectors_are_the_plain_ones(function, width, i, j):
    x, y = np.random.default_rng(i).normal(size=(2, width + 7)).astype(np.float32)
    plain, compiled = np.zeros((2, width + 7), np.float32)
    function(plain, x, y, i, j)
    numba.njit(function)(compiled, x, y, i, j)
    expected = np.zeros(width + 7, np.float32)
    expected[j : j + width] = x[i : i + width] * y[i : i + width] + x[i : i + width]
    assert np.array_equal(plain, expected) and np.array_equal(compiled, expected)


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="is about compiled code")
@pytest.mark.parametrize("array", [np.zeros(16, np.float64), np.zeros(32, np.float32)[::2]])
def test_other_arrays_are_refused(array):
    with pytest.raises(TypingError):
        numba.njit(weighted_sum)(array, array, array, 0, 0)
