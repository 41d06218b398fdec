"""Kernels compiled by all processors: other processes compile what this one has not come to yet.

The first run compiles one kernel after the other as it comes to them. What it will come to is known, and listed in
``synthesize.json`` and ``reconstruct.json``: so other processes compile that list from its end, and keep what they
compile where this one looks before it compiles. They meet in the middle.
"""

from __future__ import annotations

import importlib
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numba
import numba.core.event
import numba.types
import numpy as np
from numba.np.numpy_support import from_dtype

from spreadlets.compiled import are_kept, first_calls, is_kernel
from spreadlets.parallel import thread_count

RUNS = ("synthesize", "reconstruct")
"""For each there is a list: the kernels in the order it first calls them, each with the types of its arguments."""
MOST_PROCESSES = 7
"""Beyond these, one kernel that takes long decides."""

types: Any = numba.types
"""Without the package's annotations, which lack the classes of tuples."""

Entry = tuple[str, str, list[Any]]
"""Module, name, and types of the arguments of a kernel."""


@contextmanager
def compiled_ahead(*runs: str) -> Iterator[None]:
    """Let other processors help with compiling, should the enclosed block compile any kernel.

    Parameters
    ----------
    *runs : str
        What the block will do: of `RUNS`.

    Examples
    --------
    >>> import spreadlets as sp
    >>> from spreadlets.ahead import compiled_ahead
    >>> with compiled_ahead("synthesize"):
    ...     image, _ = sp.synthesize(sp.Frame(*labels), camera)  # doctest: +SKIP
    """
    starter = _Starter(runs)
    try:
        with numba.core.event.install_listener("numba:compile", starter):
            yield
    finally:
        starter.stop()


class _Starter(numba.core.event.Listener):
    """Starts the other processes when the first kernel is compiled."""

    def __init__(self, runs: Sequence[str]) -> None:
        self._runs = runs
        self._processes: list[subprocess.Popen[bytes]] = []
        self._count = min(thread_count() - 1, MOST_PROCESSES)

    def on_start(self, event: numba.core.event.Event) -> None:
        if not self._processes and is_kernel(event.data["dispatcher"]) and are_kept():
            quiet: dict[str, Any] = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.DEVNULL)
            # Without room for another process, this one compiles alone.
            with suppress(OSError):
                for index in range(self._count):
                    command = [sys.executable, "-m", __name__, *self._runs, str(index), str(self._count)]
                    self._processes.append(subprocess.Popen(command, **quiet))

    def on_end(self, event: numba.core.event.Event) -> None:
        pass

    def stop(self) -> None:
        for process in self._processes:
            process.terminate()
            process.wait()


def compile_entries(entries: Sequence[Entry]) -> None:
    """Compile kernels, or find that they are kept already; stop when the process that asked has ended."""
    asked_by = os.getppid()
    for module, name, arguments in entries:
        if os.getppid() != asked_by:
            return
        kernel = getattr(importlib.import_module(module), name)
        kernel.compile(tuple(map(_type, arguments)))


def listed(*runs: str) -> list[Entry]:
    """Return the kernels of runs, in the order of their first calls."""
    entries = [tuple(entry) for run in runs for entry in json.loads(list_of(run).read_text())]
    return [entry for place, entry in enumerate(entries) if entry not in entries[:place]]


def list_of(run: str) -> Path:
    """Return the file that lists a run's kernels."""
    return Path(__file__).with_name(f"{run}.json")


def record(run: str) -> str:
    """Return what `list_of` a run has to hold: the kernels that a process comes to call which has called none yet."""
    from spreadlets.reports.demo import run_demo, run_reconstruction_demo

    with tempfile.TemporaryDirectory() as folder:
        {"synthesize": run_demo, "reconstruct": run_reconstruction_demo}[run](folder)
    lines = (json.dumps(described(call)) for call in first_calls())
    # Two threads may both have looked for one.
    return "[\n" + ",\n".join(dict.fromkeys(lines)) + "\n]\n"


def described(call: tuple[str, str, Any]) -> Entry:
    """Return one of the `first_calls` as lists hold it."""
    module, name, arguments = call
    return module, name, [*map(_description, arguments)]


def _description(numba_type: Any) -> Any:
    """Return a type as what JSON holds: an array or a number as text, a tuple as a list, a named one with its class."""
    if isinstance(numba_type, types.Array):
        readonly = "" if numba_type.mutable else " readonly"
        return f"{numba_type.dtype} {numba_type.ndim} {numba_type.layout}{readonly}"
    if isinstance(numba_type, types.BaseNamedTuple):
        named = numba_type.instance_class
        return {f"{named.__module__} {named.__qualname__}": [_description(each) for each in numba_type]}
    if isinstance(numba_type, types.BaseTuple):
        return [_description(each) for each in numba_type]
    return str(numba_type)


def _type(description: Any) -> Any:
    """Return the type that was described."""
    if isinstance(description, str):
        scalar, *array = description.split()
        number = from_dtype(np.dtype(scalar))
        return types.Array(number, int(array[0]), array[1], readonly="readonly" in array) if array else number
    if isinstance(description, dict):
        ((place, fields),) = description.items()
        module, name = place.split()
        return types.BaseTuple.from_types(list(map(_type, fields)), getattr(importlib.import_module(module), name))
    return types.BaseTuple.from_types(list(map(_type, description)))
