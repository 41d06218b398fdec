"""Every study tells what it does when it is asked, and does nothing else."""

import subprocess
import sys
from pathlib import Path

BENCHMARKS = Path(__file__).resolve().parent.parent / "benchmarks"
SHARED = {"poisson_sources.py", "scenes.py"}
"""What studies import, no studies themselves."""
LIMIT_S = 60
"""For all of them, which take 3 s; a study that runs instead may take hours."""

ASK = """
import contextlib, io, runpy, sys
for study in sys.argv[1:]:
    sys.argv, answer = [study, "--help"], io.StringIO()
    try:
        with contextlib.redirect_stdout(answer):
            runpy.run_path(study, run_name="__main__")
    except SystemExit as end:
        told = end.code == 0 and answer.getvalue().startswith("usage:")
    else:
        told = False
    print("" if told else study)
"""
"""Asks in one process: each module that several studies need is imported once."""


def silent(studies):
    """Return those of some studies that do not answer ``--help``."""
    command = [sys.executable, "-c", ASK, *map(str, studies)]
    # From their folder, as studies import what they share.
    done = subprocess.run(command, cwd=BENCHMARKS, capture_output=True, text=True, check=True, timeout=LIMIT_S)
    return done.stdout.split()


def test_every_study_answers_help():
    studies = [path for path in sorted(BENCHMARKS.glob("*.py")) if path.name not in SHARED]
    assert len(studies) > 30
    assert silent(studies) == []


def test_the_page_of_tables_is_made_of_the_results(tmp_path):
    page = tmp_path / "tables.md"
    command = [sys.executable, "tables.py", "-o", str(page)]
    subprocess.run(command, cwd=BENCHMARKS, capture_output=True, check=True, timeout=LIMIT_S)
    made, kept = (path.read_text().splitlines() for path in (page, BENCHMARKS.parent / "docs" / "tables.md"))
    # Figures change with each run of a study; what there is does not.
    assert [line for line in made if line.startswith("#")] == [line for line in kept if line.startswith("#")]
    assert sum(line.startswith("|---") for line in made) > 15


def test_a_study_that_runs_is_noticed(tmp_path):
    study = tmp_path / "runs.py"
    study.write_text("print('a result')\n")
    assert silent([study]) == [str(study)]
