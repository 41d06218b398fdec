"""What is installed: the files of a wheel and a source archive, and what a plain installation can do without."""

import os
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent

LINKED = (
    "spreadlets/runtime/render.py",
    "spreadlets/precompute/models/lenses/double_gauss.txt",
    "spreadlets/data/psf_db/combined.h5",
)
"""Files that stand behind links in the tree."""

BESIDE = {".gitignore", "LICENSE", "PKG-INFO", "README.md", "pyproject.toml"}
"""Files that a source archive holds beside the package."""

NOT_EVERYWHERE = ("resource", "fcntl")
"""Modules that Windows lacks."""

OPTIONAL = ("matplotlib", "rich", "flip_evaluator", "skimage", "distributed")
"""Packages that only extras bring."""

SYNTHESIS = """
import sys
sys.modules.update(dict.fromkeys({blocked}))
import warnings
import numpy as np
import spreadlets as sp
import spreadlets.cli.main
frame = sp.Frame(np.ones((12, 12, 3)), np.full((12, 12), 4.0), np.full((12, 12, 2), 3.0))
camera = sp.ThinLens(focal_length_mm=50, sensor_width_mm=36, f_number=2, focus_distance_m=2)
image, report = sp.synthesize(frame, camera, report=True)
assert abs(image - 1).max() < 0.02 and "peak_rss_mb" in report
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
    figures = sp.metrics.compare(image, image)
assert figures["ssim"] == 1 and np.isnan(figures["flip"])
assert "pip install 'spreadlets[metrics]'" in str(caught[0].message)
"""


def run(code, folder=ROOT):
    """Run code that imports the package from a folder, and return what it prints."""
    environment = os.environ | {"PYTHONPATH": str(folder)}
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
    assert not done.returncode, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def archives(tmp_path_factory):
    """The wheel and the source archive of this tree, built once."""
    folder = tmp_path_factory.mktemp("dist")
    subprocess.run([sys.executable, "-m", "hatchling", "build", "-d", str(folder)], cwd=ROOT, check=True)
    return next(folder.glob("*.whl")), next(folder.glob("*.tar.gz"))


def test_wheel_holds_only_the_package_and_real_files_in_place_of_links(archives):
    with zipfile.ZipFile(archives[0]) as wheel:
        names = {name for name in wheel.namelist() if ".dist-info/" not in name}
        assert all(wheel.getinfo(name).file_size == (ROOT / name).stat().st_size for name in LINKED)
    assert {name.split("/")[0] for name in names} == {"spreadlets"}


def test_source_archive_holds_the_same_package_and_no_links(archives):
    with zipfile.ZipFile(archives[0]) as wheel, tarfile.open(archives[1]) as source:
        packaged = {name for name in wheel.namelist() if ".dist-info/" not in name}
        members = {member.name.split("/", 1)[1]: member for member in source.getmembers()}
    assert packaged == {name for name in members if name.startswith("spreadlets/")}
    assert all(member.isfile() for member in members.values())
    assert {name for name in members if "/" not in name} <= BESIDE


def test_unpacked_wheel_works(archives, tmp_path):
    with zipfile.ZipFile(archives[0]) as wheel:
        wheel.extractall(tmp_path)
    code = (
        "import spreadlets as sp, spreadlets.runtime.render, spreadlets.precompute.build.build\n"
        "with sp.open_database('combined') as database: print(sp.__file__, database.n_cells)"
    )
    place, n_cells = run(code, tmp_path).split()
    assert Path(place).is_relative_to(tmp_path) and int(n_cells) == 1000


def test_synthesis_needs_neither_unix_nor_optional_packages():
    run(SYNTHESIS.format(blocked=NOT_EVERYWHERE + OPTIONAL))
