"""The other side: a command line that a warm process runs."""

from __future__ import annotations

import http.client
import json
import os
import socket
from collections.abc import Sequence
from typing import Any
from urllib.parse import urlsplit

from spreadlets.errors import InvalidParameterError, MissingServerError
from spreadlets.serve.protocol import Answer

ADDRESS, TOKEN = "SPREADLETS_SERVER", "SPREADLETS_TOKEN"
"""Environment variables that say where the server is, and what it wants to hear."""


def ask(address: str, token: str, arguments: Sequence[str], folder: str | None = None) -> Answer:
    """Let a warm process run a command.

    Parameters
    ----------
    address : str
        ``http://127.0.0.1:PORT``, or the path of a Unix socket.
    token : str
        As the server has said.
    arguments : sequence of str
        The command line, such as ``["synth", "frame.exr", "-o", "out.exr"]``.
    folder : str, optional
        Where relative paths begin; by default the current folder.

    Returns
    -------
    Answer
        Exit ``status``, ``report``, and ``messages``.

    Raises
    ------
    MissingServerError
        If nobody answers there.
    InvalidParameterError
        If the request is refused: a wrong token, another command.
    """
    body = json.dumps({"arguments": list(arguments), "folder": folder or os.getcwd()})
    connection = _connection(address)
    try:
        connection.request("POST", "/run", body, {"Authorization": f"Bearer {token}"})
        content: dict[str, Any] = json.loads(connection.getresponse().read())
    except (OSError, http.client.HTTPException, ValueError) as error:
        raise MissingServerError(f"no server answers at {address}: {error}") from error
    finally:
        connection.close()
    if "error" in content:
        raise InvalidParameterError(f"the server at {address} refuses: {content['error']}")
    return Answer(content["status"], content["report"], content["messages"])


def _connection(address: str) -> http.client.HTTPConnection:
    if "://" not in address:
        return _UnixConnection(address)
    place = urlsplit(address)
    if place.scheme != "http" or not place.hostname:
        raise InvalidParameterError(f"{address} is no address of a server: it is like http://127.0.0.1:8717")
    return http.client.HTTPConnection(place.hostname, place.port)


class _UnixConnection(http.client.HTTPConnection):
    """A connection through a Unix socket."""

    def __init__(self, path: str) -> None:
        super().__init__("localhost")
        self._path = path

    def connect(self) -> None:
        """Connect to the socket."""
        self.sock = socket.socket(socket.AF_UNIX)
        self.sock.connect(self._path)
