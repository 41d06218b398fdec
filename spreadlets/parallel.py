"""How kernels run in parallel: serial compiled kernels over bands of rows, on the threads of one pool.

A kernel is compiled once, without a parallel loop of its own, and takes the band of rows it works on as its first two
arguments. The thread that asks works on the bands itself; threads of the pool help as soon as they come to run, and
nobody waits for one that has not begun. So a busy machine costs no more than the work itself, and any number of threads
may ask at once. What a row becomes does not depend on the band it is in, so results are the same for any number of
threads.
"""

from __future__ import annotations

import os
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar, copy_context
from typing import Any, TypeVar

import numba

from spreadlets.errors import InvalidParameterError

FIRST_BAND = 32
"""The part of the rows that is done first, to see how long the rest will take."""
WORTH_SHARING_S = 1e-4
"""Time of the rest, s, below which waking other threads costs more than it saves."""
BANDS_PER_THREAD = 4
"""Bands for each thread, at least: one that is held up leaves its share to the others."""
LONGEST_BAND_S = 2e-3
"""Time of a band, s, above which there are more: at the end no thread waits longer for another."""

Item = TypeVar("Item")
Result = TypeVar("Result")

_limit: ContextVar[int | None] = ContextVar("limit", default=None)
_pool: ThreadPoolExecutor | None = None
_pool_lock = threading.Lock()


def thread_count() -> int:
    """Return the number of threads that kernels called from here use.

    All processors of the machine, or ``NUMBA_NUM_THREADS`` of the environment; fewer within `limit_threads`.
    """
    return _limit.get() or _most_threads()


def _most_threads() -> int:
    return int(numba.config.NUMBA_NUM_THREADS)  # type: ignore[attr-defined]


@contextmanager
def limit_threads(count: int | None) -> Iterator[None]:
    """Let what is called from this thread in the enclosed block use at most ``count`` threads; None changes nothing.

    Raises
    ------
    InvalidParameterError
        If ``count`` is no number of threads that this process may have.
    """
    if count is None:
        yield
        return
    most = _most_threads()
    if isinstance(count, bool) or not isinstance(count, int) or not 1 <= count <= most:
        raise InvalidParameterError(f"threads is {count!r}; give a whole number from 1 to {most}")
    token = _limit.set(count)
    try:
        yield
    finally:
        _limit.reset(token)


def for_bands(kernel: Callable[..., Result], n_rows: int, *arguments: Any) -> list[Result]:
    """Call ``kernel(begin, end, *arguments)`` for bands that together are the rows 0 to ``n_rows``.

    Parameters
    ----------
    kernel : callable
        Compiled by `spreadlets.compiled.kernel`. What it does for a row may not depend on the band.
    n_rows : int
        Rows, or whatever else the kernel counts.
    arguments
        Handed on.

    Returns
    -------
    list
        What each call returned, in the order of the bands.
    """
    n_threads = thread_count()
    if n_threads == 1 or n_rows < 2:
        return [kernel(0, n_rows, *arguments)]
    # A small band first: is the rest worth sharing?
    first = max(n_rows // FIRST_BAND, 1)
    begin = time.perf_counter()
    results = [kernel(0, first, *arguments)]
    rest_s = (time.perf_counter() - begin) * (n_rows - first) / first
    if rest_s < WORTH_SHARING_S:
        return [*results, kernel(first, n_rows, *arguments)]
    # The rest in bands, to whoever is free.
    n_bands = min(max(BANDS_PER_THREAD * n_threads, int(rest_s / LONGEST_BAND_S)), n_rows - first)
    edges = [first + (n_rows - first) * band // n_bands for band in range(n_bands + 1)]
    return results + for_each(lambda band: kernel(edges[band], edges[band + 1], *arguments), range(n_bands))


def for_blocks(kernel: Callable[..., Result], n_blocks: int, *arguments: Any) -> list[Result]:
    """Do as `for_bands` for blocks of much work each: every one is shared at once, as a band of its own."""
    return for_each(lambda block: kernel(block, block + 1, *arguments), range(n_blocks))


def for_each(function: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """Call a function for each item, several at a time; return what the calls returned, in the order of the items.

    Within a call, kernels run on its thread alone. The first exception is raised again, after the calls under way.
    """
    waiting = deque(enumerate(items))
    results: list[Any] = [None] * len(waiting)

    def work() -> None:
        while waiting:
            try:
                place, item = waiting.popleft()
            except IndexError:
                # Another thread was faster.
                return
            try:
                results[place] = function(item)
            except BaseException:
                waiting.clear()
                raise

    helpers = [_ask_for_help(work) for _ in range(min(thread_count(), len(waiting)) - 1)]
    try:
        with limit_threads(1):
            work()
    finally:
        for helper in helpers:
            # Who has not begun by now is not needed.
            if not helper.cancel():
                helper.result()
    return results


def _ask_for_help(work: Callable[[], None]) -> Future[None]:
    """Let a thread of the pool do some of the work, in the caller's context."""

    def help_out() -> None:
        _limit.set(1)
        work()

    return _shared_pool().submit(copy_context().run, help_out)


def _shared_pool() -> ThreadPoolExecutor:
    """Return the pool, made when it is first needed."""
    global _pool
    with _pool_lock:
        if _pool is None:
            _pool = ThreadPoolExecutor(max(_most_threads() - 1, 1), "spreadlets")
        return _pool


def _forget_pool() -> None:
    """Begin without a pool: a forked process has none of its parent's threads."""
    global _pool, _pool_lock
    _pool, _pool_lock = None, threading.Lock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_pool)
