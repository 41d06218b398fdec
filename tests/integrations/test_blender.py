"""The Blender extension: the whole loop in a Python that has `bpy`, against Cycles' own blur.

SPREADLETS_BPY names that Python (`pip install bpy` in an environment of its own); without it, this one is tried.
"""

import json
import os
import subprocess
import sys
import tomllib
from importlib.util import find_spec
from pathlib import Path

import numba
import pytest

import spreadlets as sp
from spreadlets.version import __version__

ROOT = Path(__file__).resolve().parents[2]
EXTENSION = ROOT / "integrations" / "blender"
BPY = os.environ.get("SPREADLETS_BPY") or (sys.executable if find_spec("bpy") else None)
SIZE, SAMPLES = 192, 96
LEAST_SSIM = 0.96

needs_bpy = pytest.mark.skipif(BPY is None, reason="bpy is not installed: set SPREADLETS_BPY to a Python that has it")
compiled = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="renders whole frames")


@pytest.fixture(scope="module", params=["in a process of this Python", "within Blender's"])
def loop(request, tmp_path_factory):
    """Run the loop once; give its folder and what it told."""
    folder = tmp_path_factory.mktemp("blender")
    environment = {**os.environ, "TMPDIR": str(folder), "PYTHONPATH": str(ROOT)}
    within = request.param.startswith("within")
    if within:
        code = "import spreadlets.api, numba, cloup"
        found = subprocess.run([BPY, "-c", code], env=environment, capture_output=True, text=True, check=False)
        if found.returncode:
            pytest.skip(f"the Python of bpy lacks what the package needs: {found.stderr.splitlines()[-1]}")
    program = "" if within else sys.executable
    command = [BPY, str(Path(__file__).with_name("blender_scene.py")), str(folder), program]
    done = subprocess.run(
        [*command, "--size", str(SIZE), "--samples", str(SAMPLES)],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return folder, json.loads((folder / "told.json").read_text())


@needs_bpy
@compiled
def test_the_blurred_frame_is_that_of_cycles(loop):
    folder, told = loop
    blurred, reference = (sp.read_image(folder / name) for name in ("blurred.exr", "cycles.exr"))
    assert told["result"] == ["FINISHED"] and told["images"] == ["Spreadlets"]
    assert sp.metrics.ssim(blurred, reference) >= LEAST_SSIM


@needs_bpy
@compiled
def test_settings_are_put_back_and_nothing_is_left(loop):
    folder, told = loop
    assert told["changed"] == [] and told["current"] == 1 and not told["registered"]
    assert told["cancelled_at"] == "blurring"
    assert told["error"].endswith("layers is 999: allowed are 1 to 64")
    assert {path.name for path in folder.iterdir()} == {"blurred.exr", "cycles.exr", "range", "told.json"}


@needs_bpy
@compiled
def test_a_range_is_written_as_files(loop):
    folder, told = loop
    assert told["range"] == ["01.exr", "02.exr"] and __version__ in told["check"]
    assert sp.read_image(folder / "range" / "02.exr").shape == (SIZE, SIZE, 4)


def test_the_manifest_names_this_version():
    manifest = tomllib.loads((EXTENSION / "blender_manifest.toml").read_text())
    assert manifest["version"] == __version__ and manifest["blender_version_min"] == "4.2.0"
    assert manifest["license"] == ["SPDX:GPL-3.0-or-later"]


@needs_bpy
def test_blenders_own_command_builds_it(tmp_path):
    code = "import bpy; print(bpy.utils.script_paths()[0])"
    scripts = subprocess.run([BPY, "-c", code], capture_output=True, text=True, check=True).stdout.split()[-1]
    tool = str(Path(scripts) / "addons_core" / "bl_pkg" / "cli" / "blender_ext.py")
    build = [BPY, tool, "build", "--source-dir", str(EXTENSION), "--output-filepath", str(tmp_path / "a.zip")]
    subprocess.run(build, check=True, capture_output=True)
    subprocess.run([BPY, tool, "validate", str(tmp_path / "a.zip")], check=True, capture_output=True)
