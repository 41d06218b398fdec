import os
import pickle
import re
import shutil
import subprocess
import sys
import warnings
from pathlib import Path

import numba
import numpy as np
import pytest
from numba.core.caching import NullCache
from numba.core.runtime import _nrt_python, rtsys

from spreadlets import compiled
from spreadlets.compiled import count_compiled, helper, kernel, kernel_folder
from spreadlets.psf._grid_kernels import triangular_root

pytestmark = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="is about compiled code")

UNWRITABLE = Path("/dev/null/no/folder")

RUN = """
import logging, sys
from pathlib import Path
import spreadlets.compiled as compiled
logging.basicConfig(level=logging.INFO, format="%(message)s", stream=sys.stdout)
compiled.kernel_folder = lambda: Path(sys.argv[1])
from spreadlets.psf._grid_kernels import triangular_root
print(triangular_root(7.0), compiled.count_compiled())
"""

RUN_WITHIN_ANOTHER = (
    RUN
    + """
@compiled.kernel
def twice(values):
    for k in range(len(values)):
        values[k] = triangular_root(values[k])

import numpy
from numba.core.caching import NullCache
twice._cache = NullCache()
values = numpy.array([7.0, 55.0])
twice(values)
(name,) = (each.fndesc.llvm_func_name for each in triangular_root.overloads.values())
(code,) = twice.inspect_llvm().values()
print(*values, compiled.count_compiled(), name in code)
"""
)


def run(code, *arguments, **environment):
    return subprocess.run(
        [sys.executable, "-c", code, *map(str, arguments)], env=environment or None, capture_output=True, text=True
    )


@pytest.fixture
def places(monkeypatch, tmp_path):
    """The package's own folder and the user's, for a test alone."""
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    package, user = tmp_path / "package", tmp_path / "user"
    monkeypatch.setattr(compiled, "PACKAGE", package)
    monkeypatch.setattr(compiled.platformdirs, "user_cache_path", lambda name: user / name)
    return package / "__pycache__" / "kernels", user / "spreadlets" / "kernels"


def refuse(monkeypatch, *folders):
    can_be_written = compiled._can_be_written
    monkeypatch.setattr(compiled, "_can_be_written", lambda folder: folder not in folders and can_be_written(folder))


def test_kernels_are_kept_beside_the_package(places):
    assert kernel_folder.__wrapped__() == places[0] and places[0].is_dir()


def test_an_installation_that_cannot_be_written_to_keeps_them_with_the_user(places, monkeypatch):
    refuse(monkeypatch, places[0])
    assert kernel_folder.__wrapped__() == places[1]


def test_kernels_that_came_with_an_installation_are_used_where_it_cannot_be_written_to(places, monkeypatch):
    places[0].mkdir(parents=True)
    (places[0] / "one.nbi").write_text("kernel")
    refuse(monkeypatch, places[0])
    assert (kernel_folder.__wrapped__() / "one.nbi").read_text() == "kernel"
    refuse(monkeypatch, *places)
    with pytest.warns(UserWarning, match="compiled again in each run"):
        folder = kernel_folder.__wrapped__()
    assert (folder / "one.nbi").read_text() == "kernel"


def test_without_any_place_a_temporary_one_is_used_with_one_warning(places, monkeypatch):
    refuse(monkeypatch, *places)
    with pytest.warns(UserWarning) as caught:
        folder = kernel_folder.__wrapped__()
    assert folder.is_dir() and len(caught) == 1
    assert all(str(place) in str(caught[0].message) for place in places) and "NUMBA_CACHE_DIR" in str(caught[0].message)


def test_the_environment_decides(places, monkeypatch, tmp_path):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "mine"))
    assert kernel_folder.__wrapped__() == tmp_path / "mine"


@pytest.mark.skipif(sys.platform == "win32", reason="needs a path that nothing can be written to")
def test_a_read_only_installation_without_a_home_works_and_warns_once():
    code = (
        "import sys, pathlib, spreadlets.compiled as compiled\n"
        f"compiled.PACKAGE = pathlib.Path({str(UNWRITABLE)!r})\n"
        "from spreadlets.cli.main import main\n"
        "sys.argv = ['spreadlets', 'info', 'combined', '--json']\n"
        "main()\n"
    )
    done = run(code, HOME=str(UNWRITABLE), XDG_CACHE_HOME=str(UNWRITABLE), PYTHONPATH=":".join(sys.path))
    assert done.returncode == 0 and '"n_cells"' in done.stdout
    assert done.stderr.count("warning:") == 1 and len(done.stderr.splitlines()) == 1


AS_NOBODY = ["setpriv", "--reuid=65534", "--regid=65534", "--clear-groups"]
AS_NOBODY += [f"--{which}=-all,+dac_read_search" for which in ("inh-caps", "ambient-caps", "bounding-set")]
"""Runs a command as a user who may read all, so that the interpreter starts, and write next to nothing."""


@pytest.mark.skipif(not shutil.which("setpriv") or os.geteuid() != 0, reason="only the administrator can be another")
def test_another_user_without_a_home_can_use_what_he_cannot_write_to():
    code = (
        "import os\nfrom spreadlets.compiled import kernel_folder\n"
        "from spreadlets.psf._grid_kernels import triangular_root\n"
        "print(triangular_root(7.0), os.getuid(), kernel_folder())\n"
    )
    environment = {"HOME": "/nonexistent", "PATH": os.environ["PATH"], "PYTHONPATH": ":".join(sys.path)}
    command = [*AS_NOBODY, sys.executable, "-c", code]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, cwd="/")
    assert done.returncode == 0, done.stderr
    root, user, folder = done.stdout.split()
    assert (root, user) == ("3", "65534") and "spreadlets-" in folder and not os.path.exists(folder)
    assert done.stderr.count("kernels are compiled again in each run") == 1


def test_kernels_are_compiled_once_said_so_and_survive_copying(tmp_path):
    first, copy = tmp_path / "first", tmp_path / "copy"
    first.mkdir()
    said = f"compiling once: kernels are kept for later runs in {first}"
    assert run(RUN, first).stdout.splitlines() == [said, "3 1"]
    assert run(RUN_WITHIN_ANOTHER, first).stdout.splitlines() == ["3 0", said, "3.0 10.0 1 False"]
    shutil.move(first, copy)
    assert run(RUN, copy).stdout.splitlines() == ["3 0"]
    for each in copy.glob("*.nbc"):
        each.write_bytes(b"torn")
    assert run(RUN, copy).stdout.splitlines()[-1] == "3 1"


def test_kernels_of_another_version_whose_types_are_gone_are_made_anew(tmp_path):
    assert run(RUN, tmp_path).stdout.splitlines()[-1] == "3 1"
    (index,) = tmp_path.glob("*.nbi")
    index.write_bytes(pickle.dumps(numba.__version__, protocol=-1) + b"cspreadlets.compiled\nGone\n.")
    assert run(RUN, tmp_path).stdout.splitlines()[-1] == "3 1"
    assert run(RUN, tmp_path).stdout.splitlines() == ["3 0"]


def test_a_change_of_any_kernel_makes_all_anew(monkeypatch, tmp_path):
    monkeypatch.setattr(compiled, "PACKAGE", tmp_path)
    one, other = tmp_path / "a_kernels.py", tmp_path / "b" / "b_kernels.py"
    other.parent.mkdir()
    one.write_text("1")
    other.write_text("2")
    states = [compiled._state_of_kernels.__wrapped__()]
    other.write_text("3")
    states.append(compiled._state_of_kernels.__wrapped__())
    (tmp_path / "b" / "wrapper.py").write_text("4")
    states.append(compiled._state_of_kernels.__wrapped__())
    assert states[0] != states[1] == states[2]


def test_a_full_disk_is_no_reason_to_fail(monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(triangular_root._cache._cache_file, "save", full)
    before = count_compiled()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert triangular_root(np.float32(7.0)) == 3
    assert count_compiled() == before + 1


def test_helpers_become_machine_code_within_kernels_alone():
    @helper
    def tripled(number):
        return 3 * number

    @helper
    def more(number):
        return tripled(number) + np.ones(2)[1]

    @kernel
    def fill(values):
        for k in range(len(values)):
            values[k] = more(values[k])

    fill._cache = NullCache()  # new in each run of the tests
    values = np.arange(3.0)
    fill(values)
    assert values.tolist() == [1.0, 4.0, 7.0]
    engine = numba.core.registry.cpu_target.target_context.codegen()._engine
    of_helpers = [compiled.fndesc.llvm_func_name for each in (tripled, more) for compiled in each.overloads.values()]
    assert len(of_helpers) == 2 and not any(map(engine.is_symbol_defined, of_helpers))
    (of_kernel,) = (compiled.fndesc.llvm_func_name for compiled in fill.overloads.values())
    assert engine.is_symbol_defined(of_kernel)


@helper
def either(image, number):
    return image[number] if number >= 0 else image[0]


def add_rows(image, places):
    total = 0.0
    for number in range(len(image)):
        row = image[number].reshape(image.shape[1])
        for k in range(len(places[0])):
            total += row[places[0][k]]
    return total


def add_rows_of_a_copy(image, places):
    copy = np.empty_like(image)
    for number in range(len(image)):
        copy[number] = either(image, number)
    return add_rows_compiled(copy, places)


def add_chosen_rows(image, places):
    chosen, total = image[:, 0][places[0]], 0.0
    for number in range(len(chosen)):
        total += chosen[number]
    return total


add_rows_compiled = helper(add_rows)


def counts_references(function, *arguments):
    made = kernel(function)
    made._cache = NullCache()
    made(*arguments)
    (code,) = made.inspect_llvm().values()
    return bool(re.search(r"call .*@NRT_incref|call .*@NRT_decref|call .*@NRT_adapt", code))


@pytest.mark.skipif(not compiled._is_taken_apart, reason="Numba's own parts are used as they are")
def test_kernels_that_make_no_arrays_count_no_references():
    image, places = np.ones((3, 4), np.float32), (np.array([0, 2]), np.array([1]))
    assert not counts_references(add_rows, image, places)
    assert counts_references(add_rows_of_a_copy, image, places)


@pytest.mark.parametrize("function, expected", [(add_rows, 6.0), (add_rows_of_a_copy, 6.0), (add_chosen_rows, 2.0)])
def test_all_that_kernels_make_is_given_back(function, expected):
    image, places = np.ones((3, 4), np.float32), (np.array([0, 2]), np.array([1]))
    made = kernel(function)
    made._cache = NullCache()
    assert made(image, places) == expected
    _nrt_python.memsys_enable_stats()
    try:
        before = rtsys.get_allocation_stats()
        for _ in range(5):
            made(image, places)
        after = rtsys.get_allocation_stats()
    finally:
        _nrt_python.memsys_disable_stats()
    assert after.alloc - after.free == before.alloc - before.free
    assert sys.getrefcount(image) == 2
