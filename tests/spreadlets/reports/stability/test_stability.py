"""Every stiff and extreme case within its recorded budget, and the report about them."""

import json

import pytest
from click.testing import CliRunner

from spreadlets.cli.main import cli
from spreadlets.errors import InvalidParameterError
from spreadlets.psf.database import open_database
from spreadlets.reports.stability import stability
from spreadlets.reports.stability.lab import CASES, Case, Lab


@pytest.fixture(scope="module")
def lab():
    with open_database(stability.DATABASE) as database:
        yield Lab(database, quick=True)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.label)
def test_the_error_stays_within_its_budget(lab, case):
    assert case.measure(lab, case.value) <= case.budget


def test_every_case_has_a_name_of_its_own():
    labels = [case.label for case in CASES]
    assert len(set(labels)) == len(labels)


def made(budget, limit="", error=0.5):
    def measure(lab, value):
        if error is None:
            raise InvalidParameterError("refused")
        return error

    return Case("group", "name", "input", "oracle", budget, measure, None, limit)


@pytest.mark.parametrize(
    ("case", "verdict", "note"),
    [
        (made(0.6), "pass", ""),
        (made(0.6, "known"), "limit", "known"),
        (made(0.4, "known"), "fail", "known"),
        (made(0.4), "fail", ""),
        (made(1.0, error=float("nan")), "fail", ""),
        (made(1.0, error=None), "fail", "InvalidParameterError: refused"),
    ],
)
def test_the_verdict_follows_from_error_and_budget(lab, case, verdict, note):
    outcome = stability.run_case(case, lab)
    assert (outcome.verdict, outcome.note) == (verdict, note)


def test_the_command_writes_a_report_and_prints_it(tmp_path):
    result = CliRunner().invoke(cli, ["stability", "--quick", "--only", "solver: 1 x", "--out", str(tmp_path)])
    assert result.exit_code == 0 and "2 passed, 0 limits, 0 failed" in result.output
    assert "solver: 1 x 500 px" in (tmp_path / "stability.txt").read_text()
    assert (tmp_path / "stability.csv").read_text().startswith("case,error,budget,verdict")


def test_the_command_prints_json_and_fails_if_a_case_does(tmp_path, monkeypatch):
    monkeypatch.setattr(stability, "CASES", [made(0.6), made(0.4)])
    result = CliRunner().invoke(cli, ["stability", "--json", "--out", str(tmp_path)])
    report = json.loads(result.output)
    assert result.exit_code == 1 and (report["passed"], report["failed"]) == (1, 1)


def test_an_unknown_case_is_named(tmp_path):
    with pytest.raises(InvalidParameterError, match="no case is called 'magic'; the groups are .*solver, highlights"):
        stability.run_stability(tmp_path, only="magic")
