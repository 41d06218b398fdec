"""The import rules of the three packages: data flows one way."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("spreadlets", "precompute", "runtime")
JOINING_MODULES = {"spreadlets/__init__.py", "spreadlets/api.py", "spreadlets/cli.py", "spreadlets/demo.py"}
"""The facade and the command line: they alone may name both halves, and the reports, which measure them."""
JOINING_FOLDER = "spreadlets/reports/"


def imported_modules(path: Path) -> set[str]:
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            names.add(node.module or "")
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def product_files() -> list[str]:
    return sorted(str(path.relative_to(ROOT)) for name in PACKAGES for path in (ROOT / name).rglob("*.py"))


def reports() -> set[str]:
    return {name for name in product_files() if name.startswith(JOINING_FOLDER)}


@pytest.mark.parametrize("name", sorted(set(product_files()) - JOINING_MODULES - reports()))
def test_each_module_imports_only_what_its_package_may(name):
    modules = imported_modules(ROOT / name)
    foreign = set(PACKAGES) - {name.split("/")[0], "spreadlets"}
    assert not {module.split(".")[0] for module in modules} & foreign, f"{name} reaches into another package"
    vocabulary = {"spreadlets"} | {f"spreadlets.{path.stem}" for path in (ROOT / "spreadlets").glob("*.py")}
    from_facade = {module for module in modules if module.startswith("spreadlets") and module.count(".") == 1}
    assert from_facade <= vocabulary, f"{name} imports names of the facade"
    assert not modules & {"spreadlets.api", "spreadlets.cli.main", "spreadlets.reports.demo"}, f"{name} imports upwards"
    assert not any(module.startswith("spreadlets.reports") for module in modules), f"{name} imports a report"


@pytest.mark.parametrize("name", [name for name in product_files() if name.endswith("_kernels.py")])
def test_kernel_modules_import_only_numpy_numba_math(name):
    """And the compiler that Numba itself is made with."""
    modules = {module for module in imported_modules(ROOT / name) if "_kernels" not in module}
    assert {module.split(".")[0] for module in modules} <= {"numpy", "numba", "math", "llvmlite", "__future__"}


def test_nothing_but_the_facade_imports_the_layered_reconstructions_and_it_only_when_asked():
    others = [name for name in product_files() if not name.startswith("runtime/sheared/")]
    users = [
        name
        for name in others
        if any(m.startswith("spreadlets.runtime.sheared") for m in imported_modules(ROOT / name))
    ]
    assert users == ["spreadlets/api.py"]
    top = [
        node for node in ast.parse((ROOT / users[0]).read_text()).body if isinstance(node, ast.Import | ast.ImportFrom)
    ]
    assert not [node for node in top if "sheared" in ast.unparse(node)]


def test_importing_the_package_loads_nothing_heavy():
    code = "import sys, spreadlets; print([m for m in ('numpy', 'numba', 'h5py', 'OpenEXR') if m in sys.modules])"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert loaded.strip() == "[]"
