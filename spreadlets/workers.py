"""Who computes tasks that do not depend on each other: processes of this machine, or the workers of a cluster.

Workers only compute. A task whose worker dies is computed again by another; results come in any order.
"""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from functools import partial
from itertools import chain, islice
from typing import Any, Protocol, TypeVar

from threadpoolctl import threadpool_limits

from spreadlets.errors import StoppedError, WorkerLostError
from spreadlets.packages import optional_package
from spreadlets.processes import Lane
from spreadlets.version import __version__

CONNECT_S = 10.0
"""How long a scheduler may take to answer, and a cluster to have its first worker, s."""

RECONNECT_S = 30.0
"""How long a connection may be lost before the cluster counts as lost, s."""

WATCH_S = 1.0
"""How often to look whether a cluster is still there, s."""

RETRY_S = 0.1
"""How long to wait before a result that did not arrive is asked for again, s."""

WORKERLESS_S = 60.0
"""How long a cluster may be without any worker before the work stops, s: a new one may be on its way."""

TASKS_PER_THREAD = 4
"""Tasks that a cluster is given at a time, for each of its threads: none waits, and few are done in vain."""

GIVEN_UP = ("lost", "cancelled")
"""States of a task that tell that the cluster has forgotten it."""

AGAIN = "what is finished is kept, and the same command goes on from there"

Task = TypeVar("Task")
Result = TypeVar("Result")


class Compute(Protocol):
    """Compute a function of each task; yields each task with its result, or with the exception in its place."""

    def __call__(
        self, function: Callable[[Task], Result], tasks: Sequence[Task]
    ) -> Iterator[tuple[Task, Result | Exception]]:
        """Yield tasks and results as they come.

        The exception is the function's own, or `WorkerLostError` if workers died on this task again and again.
        """
        ...


@contextmanager
def open_workers(
    jobs: int, scheduler: str | None, error: type[StoppedError] = StoppedError
) -> Iterator[tuple[int, Compute]]:
    """Give the number of workers, and what makes them compute tasks.

    Parameters
    ----------
    jobs : int
        Processes of this machine, which share its threads; with one, this process computes.
    scheduler : str, optional
        Address of a Dask scheduler, whose workers compute instead. Each computes one task at a time, with all of its
        threads.
    error : type
        What is raised if the cluster is lost.

    Raises
    ------
    StoppedError
        If the scheduler does not answer; and while computing, if the cluster is lost.
    MissingPackageError
        If the packages for a cluster are missing.
    """
    if scheduler is not None:
        with _connected(scheduler, error) as client:
            cluster = _Cluster(client, error)
            yield cluster.threads, cluster.compute
    elif jobs > 1:
        yield jobs, _Processes(jobs).compute
    else:
        yield 1, _compute_alone


def _compute_alone(
    function: Callable[[Task], Result], tasks: Sequence[Task]
) -> Iterator[tuple[Task, Result | Exception]]:
    for task in tasks:
        yield task, _result_of(function, task)


def _result_of(function: Callable[[Task], Result], task: Task) -> Result | Exception:
    try:
        return function(task)
    except Exception as error:
        # A kernel that is interrupted as it begins makes a SystemError of it: that is no fault of the task.
        if isinstance(error.__cause__, KeyboardInterrupt):
            raise error.__cause__ from None
        return error


# --- Processes of this machine -------------------------------------------------------------------------------------


class _Processes:
    """Processes with one task each at a time, so that a death costs one task, and is known to be that task's."""

    def __init__(self, jobs: int) -> None:
        self._jobs = jobs

    def compute(
        self, function: Callable[[Task], Result], tasks: Sequence[Task]
    ) -> Iterator[tuple[Task, Result | Exception]]:
        """Yield tasks and results as they come; if the caller leaves, all processes end."""
        waiting: queue.SimpleQueue[tuple[Task, int]] = queue.SimpleQueue()
        results: queue.SimpleQueue[tuple[Task, Result | Exception]] = queue.SimpleQueue()
        for task in tasks:
            waiting.put((task, 1))
        lanes = [Lane() for _ in range(min(self._jobs, len(tasks)))]
        here = partial(_run_here, self._jobs, function)
        threads = [threading.Thread(target=lane.work, args=(here, waiting, results), daemon=True) for lane in lanes]
        for thread in threads:
            thread.start()
        try:
            for _ in tasks:
                yield results.get()
        finally:
            for lane in lanes:
                lane.end()
            for thread in threads:
                thread.join()


def _run_here(jobs: int, function: Callable[[Task], Result], task: Task) -> Result:
    """Compute a task with this process's share of the threads."""
    with _threads(jobs):
        return function(task)


@contextmanager
def _threads(jobs: int, most: int | None = None) -> Iterator[None]:
    """Let a task use its share of the threads; loaded here, since who only hands out tasks needs no kernels."""
    from spreadlets.parallel import limit_threads, thread_count

    threads = max(min(thread_count(), most or thread_count()) // jobs, 1)
    with limit_threads(threads), threadpool_limits(threads):
        yield


# --- A cluster -----------------------------------------------------------------------------------------------------


@contextmanager
def _connected(address: str, stopped: type[StoppedError]) -> Iterator[Any]:
    """Give a client of a Dask scheduler that has workers."""
    connect = optional_package("distributed", "cluster", "a cluster").Client
    from dask import config

    with _quiet("distributed", "tornado"), config.set({"distributed.comm.timeouts.connect": CONNECT_S}):
        try:
            client = connect(address, timeout=CONNECT_S, set_as_default=False)
        except (OSError, ValueError, TimeoutError) as error:
            raise stopped(f"no Dask scheduler answers at {address!r}: {error}") from error
        try:
            client.wait_for_workers(1, timeout=CONNECT_S)
            yield client
        except TimeoutError as error:
            raise stopped(f"the scheduler at {address!r} has no worker after {CONNECT_S:g} s") from error
        finally:
            # What went wrong before tells more than that a lost scheduler does not answer a farewell.
            with suppress(OSError):
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


class _Cluster:
    """The workers of a scheduler, and whether they are still there."""

    def __init__(self, client: Any, error: type[StoppedError]) -> None:
        self._client, self._error = client, error
        self._seen = self._staffed = self._looked = time.monotonic()
        self._threads = int(sum(client.ncores().values()))

    @property
    def threads(self) -> int:
        """Threads of all workers, when this was last looked at."""
        return max(self._threads, 1)

    def compute(
        self, function: Callable[[Task], Result], tasks: Sequence[Task]
    ) -> Iterator[tuple[Task, Result | Exception]]:
        """Yield tasks and results as they come, and stop if the cluster is gone."""
        waiting: Iterator[Task] = iter(tasks)
        running = dict[str, tuple[Any, Task]]()
        ended: queue.SimpleQueue[Any] = queue.SimpleQueue()
        while True:
            # Give the cluster as much as it can begin soon.
            for task in islice(waiting, max(TASKS_PER_THREAD * self.threads - len(running), 0)):
                future = self._client.submit(_run_there, __version__, function, task, pure=False)
                running[future.key] = future, task
                future.add_done_callback(ended.put)
            if not running:
                return
            # Wait for one to end, and look now and then whether somebody is there to end it.
            self._look()
            try:
                future = ended.get(timeout=WATCH_S)
            except queue.Empty:
                continue
            if future.status in GIVEN_UP and self._client.status == "running":
                # The scheduler is there, but lost sight of the task with its worker: it is handed out again.
                waiting = chain([running.pop(future.key)[1]], waiting)
                time.sleep(RETRY_S)
                continue
            try:
                result = self._result(future)
            except OSError:
                # Its worker has gone with the result, and another computes it again; or the scheduler has gone.
                ended.put(future)
                time.sleep(RETRY_S)
                continue
            yield running.pop(future.key)[1], result

    def _result(self, future: Any) -> Any:
        """Return what came of a task that has ended; OSError, such as TimeoutError, if the result does not arrive."""
        if future.status in GIVEN_UP:
            raise self._error(f"the connection to the scheduler is lost; {AGAIN}")
        if future.status == "error":
            return WorkerLostError(f"workers of the cluster died on it, or cannot compute it: {future.exception()}")
        try:
            result = future.result(timeout=WATCH_S)
        except CancelledError as error:
            raise self._error(f"the connection to the scheduler is lost; {AGAIN}") from error
        if isinstance(result, StoppedError):
            raise self._error(f"{result}; {AGAIN}")
        return result

    def _look(self) -> None:
        """Raise an error if the scheduler or all workers are gone; from time to time."""
        now = time.monotonic()
        if now - self._looked < WATCH_S:
            return
        self._looked = now
        if self._client.status == "running":
            self._seen = now
            with suppress(OSError, TimeoutError):
                counts = self._client.sync(self._client.scheduler.ncores, callback_timeout=WATCH_S)
                self._threads = sum(counts.values())
                self._staffed = now if self._threads else self._staffed
        if self._client.status == "closed" or now - self._seen > RECONNECT_S:
            raise self._error(f"the connection to the scheduler is lost; {AGAIN}")
        if now - self._staffed > WORKERLESS_S:
            raise self._error(f"the cluster has had no worker for {WORKERLESS_S:g} s; {AGAIN}")


_ONE_AT_A_TIME = threading.Lock()
"""A worker of a cluster may have several threads: they serve one task, which bounds its memory."""


def _run_there(version: str, function: Callable[[Task], Result], task: Task) -> Result | Exception:
    """Compute a task in a worker of a cluster."""
    from distributed import get_worker

    if version != __version__:
        return StoppedError(
            f"a worker of the cluster has spreadlets {__version__}, this program {version}: install the same everywhere"
        )
    with _ONE_AT_A_TIME, _threads(1, get_worker().state.nthreads):
        return _result_of(function, task)
