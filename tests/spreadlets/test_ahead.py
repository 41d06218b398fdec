import os
import subprocess
import sys

import numba
import pytest
from numba.core.caching import NullCache

from spreadlets import ahead
from spreadlets.ahead import RUNS, compiled_ahead, list_of, listed
from spreadlets.compiled import kernel

pytestmark = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="is about compiled code")

COMPILE = """
import sys
from spreadlets.ahead import compile_entries, listed
from spreadlets.compiled import count_compiled
compile_entries([entry for entry in listed("synthesize") if entry[1] in ("take", "half_sizes", "list_runs")])
print(count_compiled())
"""


@pytest.mark.parametrize("run", RUNS)
def test_lists_hold_what_a_run_calls(run):
    called = subprocess.run([sys.executable, "-m", "spreadlets.ahead", run], capture_output=True, text=True)
    # Threads may come to two kernels in either order.
    assert sorted(called.stdout.splitlines()) == sorted(list_of(run).read_text().splitlines()), "make kernels"


def test_what_one_process_compiles_another_finds(tmp_path):
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    counts = [
        subprocess.run([sys.executable, "-c", COMPILE], env=environment, capture_output=True, text=True).stdout
        for _ in range(2)
    ]
    assert counts == ["3\n", "0\n"]


def test_several_runs_have_each_kernel_once():
    both = listed(*RUNS)
    assert both[: len(listed(RUNS[0]))] == listed(RUNS[0])
    assert len({str(entry) for entry in both}) == len(both) > max(len(listed(run)) for run in RUNS)


@pytest.fixture
def started(monkeypatch):
    """The arguments of the processes that are started on a machine of four processors, and "ended" for each end."""
    told = []

    class Process:
        def __init__(self, command, **_):
            told.append(command[3:])

        def terminate(self):
            told.append("ended")

        def wait(self):
            pass

    monkeypatch.setattr(ahead.subprocess, "Popen", Process)
    monkeypatch.setattr(ahead, "thread_count", lambda: 4)
    monkeypatch.setattr(ahead, "are_kept", lambda: True)
    return told


def new_kernel():
    @kernel
    def one_more(number):
        return number + 1

    one_more._cache = NullCache()  # new in each run of the tests
    return one_more


def test_the_first_kernel_that_is_compiled_calls_the_others_for_help(started):
    with compiled_ahead("reconstruct"):
        assert not started
        compiled = new_kernel()
        compiled(1)
        compiled(1.0)
        assert started == [["reconstruct", str(index), "3"] for index in range(3)]
    assert started[3:] == ["ended"] * 3


def test_nobody_is_called_for_what_is_compiled_already_or_cannot_be_shared(started, monkeypatch):
    compiled = new_kernel()
    compiled(1)
    with compiled_ahead("synthesize"):
        compiled(1)
    monkeypatch.setattr(ahead, "are_kept", lambda: False)
    with compiled_ahead("synthesize"):
        new_kernel()(1)
    assert not started


def test_without_room_for_another_process_this_one_compiles_alone(started, monkeypatch):
    def refuse(*_, **__):
        raise BlockingIOError("no more processes")

    monkeypatch.setattr(ahead.subprocess, "Popen", refuse)
    with compiled_ahead("synthesize"):
        assert new_kernel()(1) == 2
