import json
import os
import subprocess
import sys
import time

import pytest
from threadpoolctl import threadpool_limits

from spreadlets import workers
from spreadlets.garbage import collect_rarely
from spreadlets.precompute.build import between_cells
from spreadlets.precompute.build.build import build_database
from spreadlets.psf.database import open_database

collect_rarely()

# Databases that tests build are compared with the exact PSF at a few places: a thousand take many seconds.
between_cells.N_COORDINATES, between_cells.N_TRACED = 8, 2


def pytest_collection_modifyitems(items):
    """Programs that run in processes of their own come last: what they need is compiled once, in this one."""
    items.sort(key=lambda item: "integrations" in item.path.parts)


@pytest.fixture(autouse=True, scope="session")
def one_thread():
    """As in a build: the threads of small matrix products would only wait for each other."""
    with threadpool_limits(1):
        yield


@pytest.fixture
def one_processor(monkeypatch):
    """Builds that are not told how many processes to take have none start, which takes longer than their few cells."""
    monkeypatch.setattr(os, "cpu_count", lambda: 1)


SMALL = {"samples": 14, "max_coc": 12.0, "max_motion": 16.0, "seed": 1, "sparsifier": "quick"}


@pytest.fixture(scope="session")
def small_combined_path(tmp_path_factory):
    """A database of a few cells, built once for the whole run: CoC to 12 px, motion to 16 px."""
    path = tmp_path_factory.mktemp("databases") / "small.h5"
    build_database("combined", path, **SMALL, jobs=1)
    return path


@pytest.fixture
def small_combined(small_combined_path):
    with open_database(small_combined_path) as database:
        yield database


START_S = 120.0
"""How long a scheduler may take to start on a busy machine."""


def dask(*arguments, folder):
    command = [sys.executable, "-m", "dask", *arguments, "--scheduler-file", str(folder / "scheduler.json")]
    return subprocess.Popen([*command, "--no-dashboard"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


@pytest.fixture
def cluster(tmp_path, monkeypatch):
    """Give the address of a scheduler, its process, and those of two workers."""
    monkeypatch.setattr(workers, "CONNECT_S", START_S)
    monkeypatch.setattr(workers, "RECONNECT_S", 1.0)
    scheduler = dask("scheduler", "--host", "127.0.0.1", "--port", "0", folder=tmp_path)
    processes = [scheduler]
    try:
        end = time.monotonic() + START_S
        while not (tmp_path / "scheduler.json").exists() and time.monotonic() < end:
            time.sleep(0.05)
        processes += [dask("worker", "--nthreads", "1", "--no-nanny", folder=tmp_path) for _ in range(2)]
        yield json.loads((tmp_path / "scheduler.json").read_text())["address"], processes
    finally:
        for process in processes:
            process.kill()
            process.wait()
