"""Processes of this machine: what tasks do to their process harms neither results nor other tasks."""

import os
import subprocess
import sys
import threading
import time
from functools import partial

from spreadlets.errors import WorkerLostError
from spreadlets.workers import open_workers


class UnusualError(Exception):
    """No pickle brings it back: it wants two arguments."""

    def __init__(self, first, second):
        super().__init__(f"{first} {second}")


def misbehave(task):
    print("what a task prints is no result", flush=True)
    if task == "unusual":
        raise UnusualError("of", "its own")
    if task == "cannot be sent":
        return threading.Lock()
    return task if task == "good" else os._exit(3)


def results_of(function, *tasks):
    with open_workers(2, None) as (_, compute):
        return dict(compute(function, tasks))


def test_each_task_has_its_own_result_whatever_the_others_do(capfd):
    results = results_of(misbehave, "unusual", "good", "cannot be sent", "ends")
    assert results["good"] == "good" and "of its own" in str(results["unusual"])
    assert "pickle" in str(results["cannot be sent"]) and isinstance(results["ends"], WorkerLostError)
    assert not capfd.readouterr().out


def test_a_function_that_no_process_can_find_is_an_error_and_not_the_end():
    (error,) = results_of(partial(map, lambda task: task), "a").values()
    assert "pickle" in str(error)


def test_processes_end_with_the_one_that_asked(tmp_path):
    code = (
        "import sys, time\nfrom functools import partial\nfrom spreadlets.workers import open_workers\n"
        "from test_processes import wait_in\n"
        "with open_workers(2, None) as (_, compute):\n    list(compute(partial(wait_in, sys.argv[1]), range(2)))"
    )
    places = os.pathsep.join([os.path.dirname(__file__), *sys.path])
    asked = subprocess.Popen([sys.executable, "-c", code, str(tmp_path)], env=os.environ | {"PYTHONPATH": places})
    while len(list(tmp_path.iterdir())) < 2:
        time.sleep(0.05)
    asked.kill()
    asked.wait()
    numbers = [int(path.name) for path in tmp_path.iterdir()]
    begin = time.monotonic()
    while any(map(is_there, numbers)) and time.monotonic() < begin + 20:
        time.sleep(0.05)
    assert not any(map(is_there, numbers))


def wait_in(folder, task):
    with open(os.path.join(folder, str(os.getpid())), "w"):
        time.sleep(60)


def is_there(number):
    try:
        with open(f"/proc/{number}/stat") as file:
            return file.read().split()[2] != "Z"
    except OSError:
        return False
