"""Who computes the units of a build: processes of this machine, or a cluster; both through joblib.

Workers only compute; what they send back is written by the one that asked.
"""

from __future__ import annotations

import logging
import os
import queue
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import joblib
from joblib.externals.loky.process_executor import TerminatedWorkerError

from spreadlets.errors import BuildStoppedError, SpreadletsError
from spreadlets.packages import optional_package
from spreadlets.precompute.build.work import ALGORITHM_VERSION, UnitResult, WorkUnit, build_unit

CONNECT_S = 10.0
"""How long a scheduler may take to answer, and a cluster to have its first worker, s."""

RECONNECT_S = 30.0
"""How long a connection may be lost before the cluster counts as lost, s."""

WATCH_S = 1.0
"""How often to look whether a parent process or a cluster is still there, s."""

WORKERLESS_S = 60.0
"""How long a cluster may be without any worker before the build stops, s: a new one may be on its way."""

LOST = ("error", "lost", "cancelled")
"""States of a unit that the cluster has given up: what a unit itself raises comes back as its result."""

AGAIN = "finished cells are kept, and the same command goes on from there"

Compute = Callable[[Sequence[WorkUnit]], Iterator[UnitResult]]


@contextmanager
def open_workers(jobs: int, scheduler: str | None) -> Iterator[tuple[int, Compute]]:
    """Give the number of workers, and what makes them compute units, whose results come in any order.

    Parameters
    ----------
    jobs : int
        Processes of this machine; each computes with one thread.
    scheduler : str, optional
        Address of a Dask scheduler, whose workers compute instead.

    Raises
    ------
    BuildStoppedError
        If the scheduler does not answer; and while computing, if a worker or the cluster is lost.
    MissingPackageError
        If the packages for a cluster are missing.
    """
    if scheduler is None:
        yield jobs, lambda units: _compute_here(units, jobs)
        return
    with _connected(scheduler) as client:
        yield max(sum(client.ncores().values()), 1), lambda units: _compute_there(units, client)


def _compute_here(units: Sequence[WorkUnit], jobs: int) -> Iterator[UnitResult]:
    parallel = joblib.Parallel(n_jobs=min(jobs, max(len(units), 1)), batch_size=1, return_as="generator_unordered")
    with joblib.parallel_config(backend="loky", inner_max_num_threads=1):
        try:
            yield from parallel(joblib.delayed(_build_for)(os.getpid(), unit) for unit in units)
        except TerminatedWorkerError as error:
            raise BuildStoppedError(
                f"a worker process died: it was killed, or ran out of memory (fewer --jobs need less); {AGAIN}"
            ) from error


def _build_for(parent: int, unit: WorkUnit) -> UnitResult:
    """Compute a unit; a worker whose parent is gone ends itself."""
    if os.getpid() != parent and not any(thread.name == _leave_with.__name__ for thread in threading.enumerate()):
        threading.Thread(target=_leave_with, args=(parent,), name=_leave_with.__name__, daemon=True).start()
    return build_unit(unit)


def _leave_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(WATCH_S)
    os._exit(1)


# --- A cluster -----------------------------------------------------------------------------------------------------


@contextmanager
def _connected(address: str) -> Iterator[Any]:
    """Give a client of a Dask scheduler that has workers."""
    connect = optional_package("distributed", "cluster", "a cluster").Client
    from dask import config

    with _quiet("distributed", "tornado"), config.set({"distributed.comm.timeouts.connect": CONNECT_S}):
        try:
            client = connect(address, timeout=CONNECT_S, set_as_default=False)
        except (OSError, ValueError, TimeoutError) as error:
            raise BuildStoppedError(f"no Dask scheduler answers at {address!r}: {error}") from error
        try:
            _wait_for_workers(client, address)
            yield client
        finally:
            client.close(timeout=WATCH_S)


@contextmanager
def _quiet(*packages: str) -> Iterator[None]:
    """Silence the logs of libraries: a lost cluster is told once, and by us."""
    names = [name for name in logging.root.manager.loggerDict if name.split(".")[0] in packages]
    levels = {name: logging.getLogger(name).level for name in names}
    for name in names:
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for name, level in levels.items():
            logging.getLogger(name).setLevel(level)


def _wait_for_workers(client: Any, address: str) -> None:
    try:
        client.wait_for_workers(1, timeout=CONNECT_S)
    except TimeoutError as error:
        raise BuildStoppedError(f"the scheduler at {address!r} has no worker after {CONNECT_S:g} s") from error


def _compute_there(units: Sequence[WorkUnit], client: Any) -> Iterator[UnitResult]:
    """Yield results as they come, and stop if the cluster is gone.

    The results are taken in a thread of its own, since joblib waits for ever for a cluster that is gone.
    """
    results: queue.Queue[UnitResult | Exception | None] = queue.Queue()

    # Producer: let the cluster compute, and put what it returns into a queue.
    def take() -> None:
        try:
            with joblib.parallel_config(backend="dask", client=client, wait_for_workers_timeout=CONNECT_S):
                parallel = joblib.Parallel(n_jobs=-1, batch_size=1, return_as="generator_unordered")
                for result in parallel(joblib.delayed(build_unit)(unit) for unit in units):
                    results.put(result)
            results.put(None)
        except Exception as error:
            results.put(error)

    threading.Thread(target=take, name="spreadlets-cluster", daemon=True).start()
    # Consumer: take from the queue; while nothing comes, look whether the cluster is still there.
    watch = _Watch(client)
    while True:
        try:
            result = results.get(timeout=WATCH_S)
        except queue.Empty:
            watch.look()
            continue
        # Tell the end, errors and results of another version from what was asked for.
        if result is None:
            return
        if isinstance(result, SpreadletsError):
            raise result
        if isinstance(result, Exception):
            raise BuildStoppedError(f"the cluster failed: {str(result).rstrip('.')}; {AGAIN}") from result
        if result.algorithm_version != ALGORITHM_VERSION:
            raise BuildStoppedError(
                f"a worker of the cluster has version {result.algorithm_version} of the algorithm, this program "
                f"{ALGORITHM_VERSION}: install the same spreadlets everywhere; {AGAIN}"
            )
        yield result


class _Watch:
    """Looks whether a cluster is still there."""

    def __init__(self, client: Any) -> None:
        self._client = client
        self._seen = self._staffed = time.monotonic()

    def look(self) -> None:
        """Raise BuildStoppedError if the scheduler or all workers are gone, or a unit was given up."""
        now = time.monotonic()
        if self._client.status == "running":
            self._seen = now
            if self._client.ncores():
                self._staffed = now
        if self._client.status == "closed" or now - self._seen > RECONNECT_S:
            raise BuildStoppedError(f"the connection to the scheduler is lost; {AGAIN}")
        if now - self._staffed > WORKERLESS_S:
            raise BuildStoppedError(f"the cluster has had no worker for {WORKERLESS_S:g} s; {AGAIN}")
        if any(state.status in LOST for state in list(self._client.futures.values())):
            raise BuildStoppedError(f"the cluster has given up a unit: its workers died on it, or were lost; {AGAIN}")
