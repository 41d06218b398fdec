"""Processes of this machine that compute tasks, each one at a time.

Each is another Python that runs this module: it loads what its tasks need and nothing else, whatever program asks.
It reads tasks from its standard input and writes results to its standard output, as pickles of pickles: one that cannot
be understood leaves the next in place.
"""

from __future__ import annotations

import os
import pickle
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import IO, Any

from spreadlets.errors import WorkerLostError
from spreadlets.garbage import collect_rarely

ATTEMPTS = 3
"""How many processes a task may cost: what kills three is no chance. Dask's own limit is about the same."""

DIED = f"{ATTEMPTS} processes died on it: they were killed, or ran out of memory (fewer jobs need less)"

WATCH_S = 1.0
"""How often a process looks whether the one that asked is still there, s."""


class Lane:
    """One process, replaced when it dies, and what the thread does that feeds it."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._lock = threading.Lock()
        self._ended = False

    def work(self, function: Callable[[Any], Any], waiting: Any, results: Any) -> None:
        """Compute tasks until none waits, or the end is called for; one that its process died on waits again.

        Parameters
        ----------
        function : callable
            It can be pickled by its name. What it raises becomes the result.
        waiting : queue of (task, int)
            Tasks, each with the number of this attempt.
        results : queue of (task, result)
            What came of them; `WorkerLostError` after `ATTEMPTS`.
        """
        while not self._ended:
            try:
                task, attempt = waiting.get_nowait()
            except queue.Empty:
                return
            try:
                results.put((task, self._computed(function, task)))
            except _LostError:
                if attempt < ATTEMPTS:
                    waiting.put((task, attempt + 1))
                else:
                    results.put((task, WorkerLostError(DIED)))
            except Exception as error:
                results.put((task, error))

    def end(self) -> None:
        """End the process, whatever it does."""
        with self._lock:
            self._ended = True
            self._leave_process()

    def _computed(self, function: Callable[[Any], Any], task: Any) -> Any:
        message = pickle.dumps((function, task))
        with self._lock:
            if self._ended:
                raise _LostError
            self._process = process = self._process or _started()
        assert process.stdin and process.stdout
        try:
            _send(process.stdin, message)
            answer = pickle.load(process.stdout)
        except (OSError, ValueError, EOFError, pickle.UnpicklingError) as error:
            with self._lock:
                self._leave_process()
            raise _LostError from error
        return pickle.loads(answer)

    def _leave_process(self) -> None:
        if self._process is None:
            return
        self._process.kill()
        # What it was not sent yet cannot be sent now.
        with suppress(OSError), self._process:
            self._process = None


class _LostError(Exception):
    """The process has died, or was ended."""


def _started() -> subprocess.Popen[bytes]:
    """Start a process, which finds the modules that this one finds."""
    places = os.pathsep.join(map(os.path.abspath, sys.path))
    return subprocess.Popen(
        [sys.executable, "-P", "-m", __name__],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env=os.environ | {"PYTHONPATH": places},
    )


def _send(stream: IO[bytes], message: bytes) -> None:
    pickle.dump(message, stream)
    stream.flush()


# --- What the process runs -----------------------------------------------------------------------------------------


def compute_what_is_asked() -> None:
    """Compute tasks until no more can come; a process whose parent is gone ends itself, even within a task."""
    # What a task prints must not come among the results; who ends this process is its parent.
    results = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_leave_with, args=(os.getppid(),), daemon=True).start()
    collect_rarely()
    while True:
        try:
            message = pickle.load(sys.stdin.buffer)
        except EOFError:
            return
        _send(results, _answer(message))


def _answer(message: bytes) -> bytes:
    """Return the pickle of what came of a task: its result, or the error in its place; at least what that says."""
    try:
        function, task = pickle.loads(message)
        return pickle.dumps(function(task))
    except Exception as error:
        with suppress(Exception):
            pickle.loads(answer := pickle.dumps(error))
            return answer
        return pickle.dumps(RuntimeError(f"{type(error).__name__}: {error}"))


def _leave_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(WATCH_S)
    os._exit(1)


if __name__ == "__main__":
    compute_what_is_asked()
