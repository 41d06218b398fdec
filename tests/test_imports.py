"""The import rules: data flows one way, and only `spreadlets` is imported."""

import ast
import json
import os
import subprocess
import sys
from collections import defaultdict
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
FOLDERS = ("spreadlets", "precompute", "runtime")

ORDER = (
    {"errors", "arrays", "version", "kernel_compiler"},
    {
        "compiled",
        "garbage",
        "parallel",
        "packages",
        "remembered",
        "kept",
        "runtime.controls",
        "runtime._vector_kernels",
    },
    {"processes", "serve", "_scan_kernels", "runtime._box_kernels", "runtime._lamp_kernels"},
    {"scans", "runtime.buffers"},
    {"workers", "scene", "runtime.options", "runtime.box_blur"},
    {"metrics", "models", "psf"},
    {"files", "precompute.trace", "runtime.clock", "runtime.memory", "runtime.label"},
    {"precompute.models", "runtime.splat", "runtime.integrate"},
    {"precompute.sparsify", "runtime.plan"},
    {"precompute.build", "runtime.composite", "runtime.report"},
    {"runtime.finish"},
    {"runtime.render", "runtime.sheared"},
    {"full_psfs", "bokeh"},
    {"renderer"},
    {"api"},
    {"jobs", "reports", "view", "photograph"},
    {"ahead"},
    {"warmup"},
    {"cli"},
)
"""The order of the tree, stated once: what stands in a row may import only from rows above it."""

LEVEL = {name: level for level, names in enumerate(ORDER) for name in names}


def module_name(path: Path) -> str:
    """Name by which a file of the product is imported."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    name = ".".join(parts if parts[0] == "spreadlets" else ("spreadlets", *parts))
    return name.removesuffix(".__init__")


MODULES = {
    module_name(path): path for folder in FOLDERS for path in sorted((ROOT / folder).rglob("*.py")) if path.is_file()
}
MODULES = {name: path for name, path in MODULES.items() if path.resolve() == path}


def imported_modules(name: str) -> set[str]:
    found = set()
    for node in ast.walk(ast.parse(MODULES[name].read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{name}: relative import"
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                found.add(inner if inner in MODULES else str(node.module))
    return found


def room(name: str) -> str:
    """What a module belongs to in `ORDER`."""
    parts = name.split(".")[1:]
    return ".".join(parts[: 2 if parts and parts[0] in ("runtime", "precompute") else 1])


@pytest.mark.parametrize("name", sorted(set(MODULES) - {"spreadlets", "spreadlets.runtime", "spreadlets.precompute"}))
def test_each_module_imports_only_from_its_own_folder_or_what_stands_below_it(name):
    for other in imported_modules(name):
        if not other.startswith("spreadlets"):
            assert other.split(".")[0] not in ("runtime", "precompute"), f"{name} imports {other}"
            continue
        own, its = room(name), room(other)
        assert own == its or LEVEL[its] < LEVEL[own], f"{name} ({own}) imports {other} ({its})"
        halves = {part.split(".")[0] for part in (own, its)}
        assert halves != {"runtime", "precompute"}, f"{name} reaches into the other half: {other}"


def test_no_modules_import_each_other_in_a_circle():
    graph = defaultdict(set)
    for name in MODULES:
        graph[name] = imported_modules(name) & MODULES.keys()
    TopologicalSorter(graph).prepare()


@pytest.mark.parametrize("name", [name for name in MODULES if name.endswith("_kernels")])
def test_kernel_modules_import_only_what_kernels_are_made_of(name):
    """NumPy, Numba and the compiler that it is made with, and names for tuples of arguments."""
    modules = {module for module in imported_modules(name) if "_kernels" not in module}
    allowed = {"numpy", "numba", "math", "typing", "llvmlite", "__future__", "spreadlets.arrays", "spreadlets.compiled"}
    assert {module if module.startswith("spreadlets") else module.split(".")[0] for module in modules} <= allowed


def test_one_place_says_how_kernels_are_compiled_and_one_how_they_run_in_parallel():
    """A kernel with a parallel loop of its own takes three times as long to compile, and threads would abort in it."""
    for name, path in MODULES.items():
        text = path.read_text()
        assert name == "spreadlets.compiled" or not any(word in text for word in ("njit", ".jit", "prange")), name
        assert name == "spreadlets.parallel" or "ThreadPoolExecutor" not in text, name


def test_no_two_kernel_modules_have_the_same_name():
    names = [name.split(".")[-1] for name in MODULES if name.endswith("_kernels")]
    assert len(names) == len(set(names)) and "_kernels" not in names


def test_nothing_but_the_facade_imports_the_layered_reconstructions_and_it_only_when_asked():
    others = [name for name in MODULES if not name.startswith("spreadlets.runtime.sheared")]
    users = [n for n in others if any(m.startswith("spreadlets.runtime.sheared") for m in imported_modules(n))]
    assert users == ["spreadlets.api"]
    body = ast.parse(MODULES["spreadlets.api"].read_text()).body
    top = [node for node in body if isinstance(node, ast.Import | ast.ImportFrom)]
    assert not [node for node in top if "sheared" in ast.unparse(node)]


def test_importing_the_package_loads_nothing_heavy():
    code = "import sys, spreadlets; print([m for m in ('numpy', 'numba', 'h5py', 'OpenEXR') if m in sys.modules])"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert loaded.strip() == "[]"


def test_a_usual_run_loads_only_what_it_needs():
    """Half of what a run on a small frame takes is loading: kernels that are kept need nothing that compiles."""
    kernel = (
        "import numpy; from spreadlets.runtime.plan._plan_kernels import count_labels\n"
        "assert count_labels(0, 1, numpy.zeros((1, 1), numpy.int32), 2).tolist() == [1, 0]\n"
    )
    exec(kernel)  # keeps it
    code = (
        "import sys, spreadlets.cli.main, spreadlets.api, spreadlets.files.exr_frames, spreadlets.runtime.render\n"
        f"{kernel}"
        "unwanted = 'scipy.ndimage', 'scipy.spatial', 'scipy.linalg', 'matplotlib', 'skimage', 'numba.np.arrayobj'\n"
        "print([name for name in unwanted if name in sys.modules])"
    )
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert loaded.strip() == "[]"


def test_who_only_hands_frames_out_loads_no_kernels(tmp_path):
    for name in ("a.0001.exr", "b.0001.exr"):
        (tmp_path / name).touch()
    arguments = "synth", "a.####.exr", "-o", "b.####.exr", "--jobs", "2", "--focal-length", "50", "--json"
    code = (
        "import sys; from spreadlets.cli.main import main\n"
        f"sys.argv = ['spreadlets', *{arguments}]\n"
        "try: main()\n"
        "finally: print([name for name in ('numba', 'spreadlets.runtime.render') if name in sys.modules])"
    )
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    told = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, env=environment, capture_output=True, text=True, check=True
    )
    report, loaded = told.stdout.splitlines()
    assert json.loads(report)["skipped"] == 1 and loaded == "[]"


def test_an_aperture_that_was_built_before_is_found_without_what_builds_them(tmp_path):
    code = (
        "import sys, spreadlets as sp, spreadlets.bokeh\n"
        "spreadlets.bokeh.BokehCache(sp.models.SimpleLens(blades=5)).recall()\n"
        "print([name for name in ('scipy.signal', 'spreadlets.precompute.build') if name in sys.modules])"
    )
    environment = {**os.environ, "SPREADLETS_BOKEH_CACHE": str(tmp_path)}
    loaded = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert loaded.stdout.strip() == "[]"


def test_folders_of_the_users_own_do_not_stand_in_the_way(tmp_path):
    (tmp_path / "runtime").mkdir()
    (tmp_path / "runtime" / "__init__.py").write_text("raise ImportError('not ours')")
    (tmp_path / "precompute.py").write_text("raise ImportError('not ours')")
    script = tmp_path / "script.py"
    script.write_text(
        "import spreadlets.api, spreadlets.runtime.render, spreadlets.precompute.build.build, spreadlets.cli.main"
    )
    subprocess.run([sys.executable, str(script)], cwd=tmp_path, check=True)
