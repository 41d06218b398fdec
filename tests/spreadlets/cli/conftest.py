import sys

import pytest

from spreadlets.cli import main as cli


@pytest.fixture
def run(monkeypatch, capsys, recwarn):
    def run_command(*arguments):
        monkeypatch.setattr(sys, "argv", ["spreadlets", *map(str, arguments)])
        monkeypatch.setattr("warnings.showwarning", None)
        status = 0
        try:
            cli.main()
        except SystemExit as stop:
            status = stop.code
        captured = capsys.readouterr()
        return status, captured.out, captured.err

    return run_command
