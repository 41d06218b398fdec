"""The ``spreadlets`` command: exits 0 on success, 2 on bad input (one line on standard error), 1 on its own failure."""

from __future__ import annotations

import logging
import sys
import warnings
from typing import Any

import click
import cloup

from spreadlets.cli import databases, photo, render, reports, serve, setup, view
from spreadlets.cli.run import run
from spreadlets.garbage import collect_rarely
from spreadlets.version import __version__


@cloup.group(context_settings={"help_option_names": ["-h", "--help"]})
@cloup.version_option(__version__)
def cli() -> None:
    """Depth of field and motion blur for rendered frames, by splatting sparse Laplacians of PSFs.

    Example: spreadlets synth frame.exr -o out.exr --camera camera.json
    """


cli.section("Make images", render.synth, render.reconstruct, photo.photo)
cli.section("Look", view.view)
cli.section("Databases and files", databases.build, databases.info)
cli.section("For other programs", serve.serve, serve.send)
cli.section("Set up", setup.warmup)
cli.section("Judge", reports.compare, reports.demo, reports.bench, reports.stability, render.tune)


def _show_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    click.echo(f"warning: {message}", err=True)


class _Notices(logging.Handler):
    """Shows what the package tells while it works on standard error."""

    def emit(self, record: logging.LogRecord) -> None:
        """Show one line."""
        click.echo(record.getMessage(), err=True)


def main() -> None:
    """Run the command line; warnings and notices become lines on standard error."""
    collect_rarely()
    # Warnings and notices become lines on standard error.
    warnings.showwarning = _show_warning
    logging.basicConfig(handlers=[_Notices()], level=logging.WARNING)
    logging.getLogger("spreadlets").setLevel(logging.INFO)
    if status := run(cli, sys.argv[1:]):
        sys.exit(status)


if __name__ == "__main__":
    main()
