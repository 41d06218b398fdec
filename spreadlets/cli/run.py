"""Running a command line: what goes wrong becomes one line on standard error, and an exit status."""

from __future__ import annotations

from collections.abc import Sequence

import click

from spreadlets.cli.options import spelled
from spreadlets.cli.status import EXIT_BAD_INPUT, EXIT_FAILURE, EXIT_INTERRUPTED
from spreadlets.errors import SpreadletsError, StoppedError, options_spelled


def run(group: click.Group, arguments: Sequence[str]) -> int:
    """Run a command of a group; errors of the caller's become one line. Return the exit status."""
    try:
        with options_spelled(spelled):
            group.main(list(arguments), prog_name="spreadlets", standalone_mode=False)
    # Who can mend an error decides its first word and the exit status.
    except SystemExit as stop:
        return int(stop.code or 0)
    except click.exceptions.Abort:
        click.echo("interrupted", err=True)
        return EXIT_INTERRUPTED
    except click.ClickException as error:
        click.echo(f"error: {error.format_message()}", err=True)
        return EXIT_BAD_INPUT
    except StoppedError as error:
        click.echo("stopped: " + " ".join(str(error).split()), err=True)
        return EXIT_FAILURE
    except SpreadletsError as error:
        click.echo("error: " + " ".join(str(error).split()), err=True)
        return EXIT_BAD_INPUT
    except Exception as error:
        if isinstance(error.__cause__ or error.__context__, KeyboardInterrupt):
            # A kernel that is interrupted as it begins makes a SystemError of it.
            click.echo("interrupted", err=True)
            return EXIT_INTERRUPTED
        click.echo(f"failed: {type(error).__name__}: {' '.join(str(error).split())}", err=True)
        return EXIT_FAILURE
    return 0
