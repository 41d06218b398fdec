"""Run the cases of a folder with two versions of the command, and set what they print side by side.

Each case is a folder with ``make.py``, which writes its input, and ``repro.sh``, which runs the commands named by the
variables ``SPREADLETS`` and ``PYTHON`` and prints what matters. The first heading of its ``README.md`` is its title.

    python benchmarks/field_cases.py FOLDER --before OLD_CHECKOUT [--out benchmarks/results/field_cases.md] [--only 05]
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
TIMEOUT_S = 300
WIDEST = 240
"""Characters of a line that are kept."""


def runner(folder: Path, name: str, checkout: Path, maker: Path) -> dict[str, str]:
    """Write a command and an interpreter for a checkout, and return the variables that name them.

    Inputs are made by `maker`, one and the same for both versions.
    """
    folder.mkdir(parents=True, exist_ok=True)
    module = "spreadlets.cli.main" if (checkout / "spreadlets" / "cli").is_dir() else "spreadlets.cli"
    command = f"{sys.executable} -c 'from {module} import main; main()'"
    command_file, python_file = folder / f"{name}-spreadlets", folder / f"{name}-python"
    command_file.write_text(f'#!/bin/bash\nPYTHONPATH={checkout}:$PYTHONPATH exec {command} "$@"\n')
    python_file.write_text(
        f'#!/bin/bash\ntree={checkout}; [ "$1" = make.py ] && tree={maker}\n'
        f'PYTHONPATH=$tree:$PYTHONPATH exec {sys.executable} "$@"\n'
    )
    for file in (command_file, python_file):
        file.chmod(0o755)
    return {"SPREADLETS": str(command_file), "PYTHON": str(python_file)}


def run_case(case: Path, variables: dict[str, str]) -> list[str]:
    """Run a case in a copy of its folder and return the lines that it prints."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) / case.name
        shutil.copytree(case, folder)
        if (case.parent / "tools").is_dir():
            shutil.copytree(case.parent / "tools", folder.parent / "tools")
        try:
            done = subprocess.run(
                ["bash", "repro.sh"],
                cwd=folder,
                env=os.environ | variables,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                timeout=TIMEOUT_S,
                text=True,
                errors="replace",
            )
        except subprocess.TimeoutExpired:
            return [f"did not end within {TIMEOUT_S} s"]
    return [line.rstrip().replace(str(folder), ".")[:WIDEST] for line in done.stdout.splitlines() if line.strip()]


def title(case: Path) -> str:
    """Return the heading of a case."""
    return (case / "README.md").read_text().splitlines()[0].lstrip("# ")


def report(case: Path, before: list[str], after: list[str]) -> str:
    """Return what a case printed before and after, as Markdown."""
    blocks = [f"{name}:\n\n```\n{chr(10).join(lines)}\n```" for name, lines in (("Before", before), ("After", after))]
    return f"## {case.name}: {title(case)}\n\n" + "\n\n".join(blocks) + "\n"


def main() -> None:
    """Run the cases that are asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--before", type=Path, required=True, help="checkout of the version to compare with")
    parser.add_argument("--after", type=Path, default=ROOT, help="checkout of the other version (default: this one)")
    parser.add_argument("--out", type=Path, help="Markdown file to write")
    parser.add_argument("--only", nargs="*", default=[], help="beginnings of the cases' names")
    given = parser.parse_args()
    cases = sorted(path.parent for path in given.folder.resolve().glob("*/repro.sh"))
    cases = [case for case in cases if not given.only or case.name.startswith(tuple(given.only))]
    with tempfile.TemporaryDirectory() as temporary:
        os.chmod(temporary, 0o755)  # cases may run the commands as another user
        old = runner(Path(temporary), "before", given.before.resolve(), given.before.resolve())
        new = runner(Path(temporary), "after", given.after.resolve(), given.before.resolve())
        reports = []
        for case in cases:
            reports.append(report(case, run_case(case, old), run_case(case, new)))
            print(reports[-1], flush=True)
    if given.out:
        given.out.write_text("# Field cases, before and after\n\n" + "\n".join(reports))


if __name__ == "__main__":
    main()
