# SPDX-License-Identifier: GPL-3.0-or-later
"""Who makes the images: the package itself if Blender's Python has it, or else a process that stays warm."""

from __future__ import annotations

import http.client
import json
import os
import subprocess
import threading
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

IDLE_MINUTES = "30"
"""The process ends by itself after that, should Blender not come to end it."""
NEEDED = ("spreadlets", "numba", "h5py", "OpenEXR", "click", "cloup")
"""What must be importable for the package to run inside Blender."""


class MakerError(RuntimeError):
    """An image could not be made; the message is one line for people."""


class InProcess:
    """Makes images in Blender's own Python."""

    @staticmethod
    def is_possible() -> bool:
        """Tell whether Blender's Python has the package and what it needs."""
        return all(find_spec(name) is not None for name in NEEDED)

    def run(self, arguments: list[str], folder: str) -> dict[str, Any]:
        """Run a command and return its report."""
        from spreadlets.cli.main import cli
        from spreadlets.cli.serve import run_command
        from spreadlets.serve.protocol import Request

        answer = run_command(cli, Request(arguments, folder))
        return _report(answer.status, answer.report, answer.messages)

    def check(self) -> str:
        """Return what is there."""
        import spreadlets

        return f"spreadlets {spreadlets.__version__} in Blender's own Python"

    def stop(self) -> None:
        """Do nothing: a command in this process comes to its end."""


class Served:
    """Makes images in a process of its own, which is started when it is first needed, and stays.

    Parameters
    ----------
    program : str
        The command ``spreadlets``, or a Python that has the package.
    """

    def __init__(self, program: str) -> None:
        is_python = Path(program).name.lower().startswith("python")
        self._command = [program, "-m", "spreadlets.cli.main"] if is_python else [program]
        self._process: subprocess.Popen[str] | None = None
        self._ready: dict[str, Any] = {}
        self._lock = threading.Lock()

    def run(self, arguments: list[str], folder: str) -> dict[str, Any]:
        """Run a command and return its report."""
        with self._lock:
            self._start()
            place = urlsplit(self._ready["url"])
        connection = http.client.HTTPConnection(str(place.hostname), place.port)
        body = json.dumps({"arguments": arguments, "folder": folder})
        try:
            connection.request("POST", "/run", body, {"Authorization": f"Bearer {self._ready['token']}"})
            content = json.loads(connection.getresponse().read())
        except (OSError, http.client.HTTPException, ValueError) as error:
            raise MakerError(f"the process that makes images has ended: {error}") from error
        finally:
            connection.close()
        if "error" in content:
            raise MakerError(content["error"])
        return _report(content["status"], content["report"], content["messages"])

    def check(self) -> str:
        """Return what is there; the process itself is not started."""
        try:
            done = subprocess.run(
                [*self._command, "--version"], capture_output=True, text=True, env=_environment(), check=False
            )
        except OSError as error:
            raise MakerError(f"{self._command[0]} cannot be run: {error.strerror}") from error
        if done.returncode:
            raise MakerError(f"{self._command[0]}: {(done.stderr.strip() or 'failed').splitlines()[-1]}")
        return f"{done.stdout.strip()} by {self._command[0]}"

    def stop(self) -> None:
        """End the process, whatever it does."""
        process, self._process = self._process, None
        if process is not None:
            process.kill()
            process.communicate()

    def _start(self) -> None:
        if self._process is not None and self._process.poll() is None:
            return
        command = [*self._command, "serve", "--json", "--idle", IDLE_MINUTES]
        try:
            self._process = subprocess.Popen(
                command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=_environment()
            )
        except OSError as error:
            raise MakerError(f"{command[0]} cannot be run: {error.strerror}") from error
        process = self._process
        assert process.stdout is not None
        try:
            self._ready = json.loads(process.stdout.readline())
        except ValueError:
            said = process.communicate()[1].strip() or "it ended without a word"
            raise MakerError(f"{command[0]}: {said.splitlines()[-1]}") from None


def _environment() -> dict[str, str]:
    """Return the environment without what Blender's own Python is told by it."""
    return {name: value for name, value in os.environ.items() if name not in ("PYTHONHOME", "PYTHONNOUSERSITE")}


def _report(status: int, report: Any, messages: list[str]) -> dict[str, Any]:
    if status:
        raise MakerError(messages[-1] if messages else f"the command failed with status {status}")
    return {**report, "messages": messages}


class Call(threading.Thread):
    """A command that runs while Blender goes on.

    Attributes
    ----------
    report : dict
        When it has ended well.
    error : str
        One line, if it has not.
    """

    def __init__(self, maker: InProcess | Served, arguments: list[str], folder: str) -> None:
        super().__init__(daemon=True)
        self._maker, self._arguments, self._folder = maker, arguments, folder
        self.report: dict[str, Any] = {}
        self.error = ""

    def run(self) -> None:
        """Run the command."""
        try:
            self.report = self._maker.run(self._arguments, self._folder)
        except MakerError as error:
            self.error = str(error)
        except Exception as error:
            self.error = f"{type(error).__name__}: {error}"
