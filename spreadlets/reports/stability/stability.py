"""The stability report: every stiff and extreme case with input, oracle, error, verdict and time."""

from __future__ import annotations

import csv
import math
import os
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from spreadlets.errors import InvalidParameterError
from spreadlets.psf.database import open_database
from spreadlets.reports.stability import cases_edges, cases_labels, cases_laws, cases_numbers
from spreadlets.reports.stability.lab import CASES, Case, Lab

__all__ = ["CASES", "DATABASE", "Outcome", "run_case", "run_stability", "selected_cases"]

DATABASE = "combined"
SOURCES = (cases_numbers, cases_labels, cases_edges, cases_laws)
"""The modules whose cases are run: importing them registers them in `CASES`."""

COLUMNS = ("case", "error", "budget", "verdict", "seconds", "input", "oracle", "note")


@dataclass(frozen=True)
class Outcome:
    """What a case came to.

    Attributes
    ----------
    case : str
    input, oracle : str
    error, budget : float
    verdict : str
        ``pass``; ``limit``, if the budget is one that a user can notice; ``fail``.
    note : str
        The limit, or what went wrong.
    seconds : float
    """

    case: str
    input: str
    oracle: str
    error: float
    budget: float
    verdict: str
    note: str
    seconds: float


def run_case(case: Case, lab: Lab) -> Outcome:
    """Run a case; an exception is a failure, too."""
    begin = time.perf_counter()
    error, note = math.inf, case.limit
    try:
        error = case.measure(lab, case.value)
    except Exception as failure:
        note = f"{type(failure).__name__}: {failure}"
    verdict = "fail" if not error <= case.budget else "limit" if case.limit else "pass"
    seconds = time.perf_counter() - begin
    return Outcome(case.label, case.given, case.oracle, error, case.budget, verdict, note, seconds)


def selected_cases(only: str | None) -> list[Case]:
    """Return the cases whose name contains a text, all if there is none."""
    chosen = [case for case in CASES if not only or only in case.label]
    if not chosen:
        groups = ", ".join(dict.fromkeys(case.group for case in CASES))
        raise InvalidParameterError(f"no case is called {only!r}; the groups are {groups}")
    return chosen


def run_stability(
    folder: str | os.PathLike[str],
    *,
    quick: bool = False,
    only: str | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, Any]:
    """Run the cases and write ``stability.txt`` and ``stability.csv``.

    Parameters
    ----------
    folder : path-like
        Made if need be.
    quick : bool
        Take the sizes of the tests: under a minute, where all take some minutes and 8 GB.
    only : str, optional
        Run the cases whose name contains this.
    progress : callable, optional
        Called with the number of cases done and of all.

    Returns
    -------
    dict
        ``cases`` (a list of dict, see `Outcome`), ``passed``, ``limits``, ``failed``, ``total_s``, ``written_to``.

    Raises
    ------
    InvalidParameterError
        If no case fits, or the folder cannot be written to.
    """
    # Find the cases, and a folder for their table, before any of them runs.
    chosen, output = selected_cases(only), Path(folder)
    try:
        output.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InvalidParameterError(f"cannot write to {str(output)!r}: {error}") from error
    # Run them; warnings are what they provoke.
    outcomes = []
    with open_database(DATABASE) as database, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        lab = Lab(database, quick)
        for number, case in enumerate(chosen):
            outcomes.append(run_case(case, lab))
            if progress:
                progress(number + 1, len(chosen))
    # Write the table, and count the verdicts.
    (output / "stability.txt").write_text("\n".join(text_lines(outcomes)) + "\n")
    _write_csv(output / "stability.csv", outcomes)
    counts = {name: sum(each.verdict == verdict for each in outcomes) for name, verdict in VERDICTS.items()}
    total = sum(each.seconds for each in outcomes)
    return {"cases": [asdict(each) for each in outcomes], **counts, "total_s": total, "written_to": str(output)}


VERDICTS = {"passed": "pass", "limits": "limit", "failed": "fail"}


def text_lines(outcomes: Sequence[Outcome]) -> list[str]:
    """Return the report as lines of text: a table, then what each case is, then the limits."""
    width = max(len(each.case) for each in outcomes)
    lines = [f"{'case':<{width}} {'error':>9} {'budget':>9} verdict {'s':>7}"]
    for each in outcomes:
        lines.append(f"{each.case:<{width}} {each.error:9.2g} {each.budget:9.2g} {each.verdict:<7} {each.seconds:7.2f}")
    lines += ["", "Input and oracle"]
    about = dict.fromkeys((each.case.split(":")[0], each.input, each.oracle) for each in outcomes)
    lines += [f"- {group}: {given}. Against: {oracle}." for group, given, oracle in about]
    notes = dict.fromkeys((each.verdict, each.case.split(":")[0], each.note) for each in outcomes if each.note)
    lines += ["", *(f"{verdict}, {group}: {note}" for verdict, group, note in notes)]
    return lines


def _write_csv(path: Path, outcomes: Sequence[Outcome]) -> None:
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        writer.writerows(asdict(each) for each in outcomes)
