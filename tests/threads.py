"""The same work on one, two and three threads."""

from concurrent.futures import ThreadPoolExecutor
from unittest import mock

import numba

from spreadlets import parallel


def for_thread_counts(work):
    """Return what ``work()`` gives on one, two and three threads, however few processors there are.

    Every call of `for_bands` is shared, however little there is to do.
    """
    with (
        ThreadPoolExecutor(2) as pool,
        mock.patch.object(parallel, "_pool", pool),
        mock.patch.object(parallel, "WORTH_SHARING_S", 0.0),
        mock.patch.object(numba.config, "NUMBA_NUM_THREADS", 3),
    ):
        found = []
        for count in (1, 2, 3):
            with parallel.limit_threads(count):
                found.append(work())
        return found
