"""The commands of a warm process: the server, and a command line that it runs."""

from __future__ import annotations

import io
import json
import os
import signal
import sys
import threading
import warnings
from contextlib import chdir, redirect_stderr, redirect_stdout
from functools import partial
from typing import TYPE_CHECKING

import click
import cloup

from spreadlets.cli.options import json_option
from spreadlets.cli.run import run

if TYPE_CHECKING:
    from spreadlets.serve.protocol import Answer, Request

SERVED = ("synth", "reconstruct", "photo", "info", "compare")
"""Commands that a host may ask for: they read files and make images, and end."""


@cloup.command()
@cloup.option("--port", type=click.IntRange(0, 65535), default=0, help="Port on 127.0.0.1 (default: any that is free).")
@cloup.option("--socket", "path", type=click.Path(dir_okay=False), help="Listen on this Unix socket instead.")
@cloup.option("--idle", type=click.FloatRange(min=0, min_open=True), metavar="MIN", help="Stop after MIN idle minutes.")
@json_option
@click.pass_context
def serve(context: click.Context, port: int, path: str | None, idle: float | None, as_json: bool) -> None:
    """Stay and make images for other programs, without the time that starting takes.

    Listens on this machine only. The first line says where, and a token that requests must carry; SPREADLETS_TOKEN in
    the environment sets another. Ctrl-C ends it. The protocol is in the documentation, under hosts.

    Example: spreadlets serve --json
    """
    from spreadlets.serve.client import TOKEN
    from spreadlets.serve.server import Server

    if path and port:
        raise click.UsageError("--port and --socket exclude each other")
    group = context.find_root().command
    assert isinstance(group, click.Group)
    served = [name for name in SERVED if name in group.commands]
    idle_s = None if idle is None else 60.0 * idle
    server = Server(
        partial(run_command, group), served, port=port, path=path, token=os.environ.get(TOKEN), idle_s=idle_s
    )
    ready = {**server.address, "token": server.token, "pid": os.getpid()}
    click.echo(json.dumps(ready) if as_json else f"listening at {next(iter(ready.values()))}, token {server.token}")
    sys.stdout.flush()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _leave)
    threading.Thread(target=lambda: server.in_turn(_warm), daemon=True).start()
    server.serve()


def _leave(*_: object) -> None:
    raise SystemExit(0)


def _warm() -> None:
    """Load what images are made with, so that the first is as fast as the next."""
    from spreadlets.warmup import warm_up

    warm_up()


def run_command(group: click.Group, request: Request) -> Answer:
    """Run a command of a host as if it had been typed, and return what it says."""
    from spreadlets.serve.protocol import Answer

    arguments = request.arguments if "--json" in request.arguments else [*request.arguments, "--json"]
    said, told = io.StringIO(), io.StringIO()
    with chdir(request.folder), redirect_stdout(said), redirect_stderr(told), warnings.catch_warnings():
        status = run(group, arguments)
    try:
        report = json.loads(said.getvalue())
    except ValueError:
        report = None
    return Answer(status, report, told.getvalue().splitlines())


@cloup.command(context_settings={"ignore_unknown_options": True, "allow_interspersed_args": False})
@cloup.option("--server", metavar="ADDRESS", envvar="SPREADLETS_SERVER", required=True, help="As serve has said.")
@cloup.argument("arguments", nargs=-1, required=True, metavar="COMMAND...", type=click.UNPROCESSED)
def send(server: str, arguments: tuple[str, ...]) -> None:
    """Let a server run a command, such as synth: what it prints is that of the command with --json.

    SPREADLETS_TOKEN in the environment is the server's token, and SPREADLETS_SERVER may be its address.

    Example: spreadlets send --server http://127.0.0.1:8717 synth frame.exr -o out.exr --camera camera.json
    """
    from spreadlets.serve.client import TOKEN, ask

    answer = ask(server, os.environ.get(TOKEN, ""), arguments)
    for line in answer.messages:
        click.echo(line, err=True)
    if answer.report is not None:
        click.echo(json.dumps(answer.report))
    sys.exit(answer.status)
