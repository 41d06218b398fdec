"""Rerun small inputs on which the product once failed, and print what each case says now.

    python benchmarks/field_cases.py FOLDER [CASE ...]

FOLDER holds a folder for each case, with ``make.py`` (writes the input) and ``repro.sh`` (runs the commands and prints
what matters). They are copied to a temporary folder and run there. What they print is shown case by case.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

TIMEOUT_S = 300


def run_case(case: Path, tools: Path) -> str:
    """Return what a case prints when it is run in a copy of its folder."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        shutil.copytree(case, folder / case.name)
        if tools.is_dir():
            shutil.copytree(tools, folder / "tools")
        launcher = folder / "spreadlets"
        root = Path(__file__).resolve().parents[1]
        launcher.write_text(f'#!/bin/sh\nPYTHONPATH="{root}" exec "{sys.executable}" -m spreadlets.cli.main "$@"\n')
        launcher.chmod(0o755)
        python = folder / "python"
        python.write_text(f'#!/bin/sh\nPYTHONPATH="{root}:$PYTHONPATH" exec "{sys.executable}" "$@"\n')
        python.chmod(0o755)
        environment = os.environ | {"SPREADLETS": str(launcher), "PYTHON": str(python)}
        done = subprocess.run(
            ["bash", str(folder / case.name / "repro.sh")],
            env=environment,
            capture_output=True,
            text=True,
            timeout=TIMEOUT_S,
        )
        return (done.stdout + done.stderr).replace(f"{folder}/", "")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("cases", nargs="*", help="Only those that start with one of these.")
    arguments = parser.parse_args()
    for case in sorted(arguments.folder.iterdir()):
        if not (case / "repro.sh").is_file():
            continue
        if arguments.cases and not case.name.startswith(tuple(arguments.cases)):
            continue
        print(f"==== {case.name}")
        try:
            print(run_case(case, arguments.folder / "tools").rstrip())
        except subprocess.TimeoutExpired:
            print(f"ran longer than {TIMEOUT_S} s")


if __name__ == "__main__":
    main()
