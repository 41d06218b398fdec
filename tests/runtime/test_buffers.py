import threading

import numpy as np
import pytest

from spreadlets.runtime import buffers
from spreadlets.runtime.buffers import buffer


@pytest.fixture(autouse=True)
def _own_pool(monkeypatch):
    monkeypatch.setattr(buffers, "_pool", buffers._Pool())


def place(array):
    return array.__array_interface__["data"][0]


def test_memory_is_lent_again_when_nobody_has_it():
    first = buffer((300, 400))
    begin, part = place(first), first[10:].reshape(-1)
    del first
    other = buffer((300, 400))
    assert not np.shares_memory(part, other)
    del part
    assert place(buffer((300, 390), np.int32)) == begin


def test_arrays_are_as_asked_for():
    for shape, dtype in (((2, 3), np.float32), ((500, 400, 4), np.float32), ((600, 700), np.int64)):
        array = buffer(shape, dtype)
        array[...] = 1
        assert (array.shape, array.dtype, array.flags.c_contiguous) == (shape, dtype, True)


def test_a_much_larger_piece_waits_for_a_larger_array():
    large = buffer((2000, 1000))
    begin = place(large)
    del large
    assert place(buffer((400, 500))) != begin
    assert place(buffer((1900, 1000))) == begin


def test_what_waits_is_limited(monkeypatch):
    monkeypatch.setattr(buffers, "MOST_IDLE_BYTES", 3_000_000)
    arrays = [buffer((500, 1000)) for _ in range(4)]
    del arrays
    assert sum(map(len, buffers._pool._idle)) <= 3_000_000


def test_threads_never_share():
    def work():
        for number in range(200):
            mine = buffer((300, 300))
            mine[:] = number
            same.append(bool((mine == number).all()))

    same = []
    threads = [threading.Thread(target=work) for _ in range(4)]
    for each in threads:
        each.start()
    for each in threads:
        each.join()
    assert len(same) == 800
    assert all(same)


def test_what_is_too_small_makes_room():
    small = buffer((400, 500))
    del small
    large = buffer((2000, 1000))
    assert not buffers._pool._idle
    assert large.size == 2_000_000
