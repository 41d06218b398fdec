import os
import subprocess
import sys
import threading
from contextvars import ContextVar

import numpy as np
import pytest
from threads import for_thread_counts

from spreadlets import parallel
from spreadlets.errors import InvalidParameterError
from spreadlets.parallel import for_bands, for_blocks, for_each, limit_threads, thread_count


def mark(begin, end, marks):
    marks[begin:end] += 1
    return begin, end


@pytest.mark.parametrize("n_rows", [0, 1, 2, 31, 32, 1000])
def test_bands_are_all_rows_once_and_results_come_in_their_order(n_rows):
    def work():
        marks = np.zeros(n_rows, np.int64)
        return marks, for_bands(mark, n_rows, marks)

    for marks, results in for_thread_counts(work):
        assert (marks == 1).all()
        edges = [0, *(end for _, end in results)]
        assert results == list(zip(edges[:-1], edges[1:], strict=True)) and edges[-1] == n_rows


def test_small_work_is_not_shared(monkeypatch):
    monkeypatch.setattr(parallel, "WORTH_SHARING_S", 1e9)
    with limit_threads(thread_count()):
        assert len(for_bands(mark, 1000, np.zeros(1000))) <= 2


def test_blocks_are_bands_of_one():
    for results in for_thread_counts(lambda: for_blocks(mark, 5, np.zeros(5))):
        assert results == [(i, i + 1) for i in range(5)]


def test_other_threads_take_part():
    """Two items that wait for each other are done only if two threads have them."""

    def work():
        if thread_count() < 2:
            return None
        meeting = threading.Barrier(2, timeout=60)
        return for_each(lambda _: meeting.wait() >= 0 and thread_count(), range(2))

    assert for_thread_counts(work) == [None, [1, 1], [1, 1]]


def test_nobody_waits_for_a_thread_that_has_not_begun():
    """With its only thread held up elsewhere, the pool's help is not waited for."""
    hold, began = threading.Event(), threading.Event()

    def work():
        if thread_count() != 2:
            return None
        busy = [parallel._shared_pool().submit(lambda: (began.set(), hold.wait(60))) for _ in range(2)]
        began.wait(60)
        try:
            return for_each(str, range(4))
        finally:
            hold.set()
            for each in busy:
                each.result()

    assert for_thread_counts(work)[1] == ["0", "1", "2", "3"]


def test_an_exception_ends_the_work_and_reaches_the_caller():
    def work():
        done = []

        def fail(item):
            done.append(item)
            raise ValueError(f"item {item}")

        with pytest.raises(ValueError, match="item"):
            for_each(fail, range(1000))
        return len(done)

    assert for_thread_counts(work)[0] == 1
    assert all(count <= 3 for count in for_thread_counts(work))


def test_settings_of_the_caller_hold_in_other_threads():
    """NumPy 2 keeps its error handling in such a setting, too; NumPy 1 has one for each thread."""
    setting = ContextVar("setting", default="lost")

    def work():
        token = setting.set("kept")
        try:
            return for_each(lambda _: setting.get(), range(8))
        finally:
            setting.reset(token)

    assert for_thread_counts(work) == [["kept"] * 8] * 3


@pytest.mark.parametrize("count", [0, -1, 1.5, True, 100_000])
def test_an_impossible_number_of_threads_is_refused(count):
    with pytest.raises(InvalidParameterError, match=f"threads is {count}; give a whole number from 1 to"):
        with limit_threads(count):
            pass


def test_the_number_of_threads_is_that_of_the_environment():
    code = "from spreadlets.parallel import thread_count; print(thread_count())"
    environment = os.environ | {"NUMBA_NUM_THREADS": "1"}
    printed = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert printed.stdout.strip() == "1"


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork here")
@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_a_forked_process_has_threads_of_its_own():
    for_each(str, range(4))
    child = os.fork()
    if not child:
        ok = parallel._pool is None and for_each(str, range(4)) == ["0", "1", "2", "3"]
        os._exit(0 if ok else 1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
