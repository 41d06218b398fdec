import numpy as np

from spreadlets.runtime.buffers import buffer, kept_buffers


def test_memory_is_used_again_within_the_block_only():
    with kept_buffers():
        first = buffer("one", (4, 5))
        again, other = buffer("one", (3, 2)), buffer("other", (3, 2))
        assert np.shares_memory(first, again)
        assert not np.shares_memory(again, other)
        assert again.flags.c_contiguous
        assert (again.shape, again.dtype) == ((3, 2), np.float32)
    assert not np.shares_memory(buffer("one", (4, 5)), buffer("one", (4, 5)))


def test_what_does_not_fit_gets_room_that_is_kept():
    with kept_buffers():
        buffer("one", (2, 2), np.int64)
        larger = buffer("one", (9, 9), np.int64)
        assert np.shares_memory(larger, buffer("one", (80,), np.int64))
