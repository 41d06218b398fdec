"""The server: HTTP on this machine only, for whoever knows the token; one command at a time, in the order they come."""

from __future__ import annotations

import json
import os
import socket
import socketserver
import threading
import time
from collections.abc import Callable, Collection
from contextlib import suppress
from http.server import BaseHTTPRequestHandler
from pathlib import Path
from typing import Any

from spreadlets.errors import InvalidParameterError, SpreadletsError
from spreadlets.serve.local import HOST, is_token, new_token
from spreadlets.serve.protocol import MOST_BYTES, Answer, RefusedError, Request, parse_request
from spreadlets.version import __version__

READ_S = 10.0
"""How long a request may take to arrive, s; the connection is then closed."""
MOST_CONNECTIONS = 32
"""Requests that are read or wait for their turn at the same time; more are refused."""
GRACE_S = 30.0
"""How long the command under way may still take when the server is stopped, s."""
HTTP_OF_STATUS = {0: 200, 2: 422}
"""Statuses of HTTP for those of commands; what is not here is a failure, 500."""

Run = Callable[[Request], Answer]


class Server:
    """Listens for commands and runs them.

    Parameters
    ----------
    run : callable
        Runs a command.
    commands : collection of str
        Those that may be run.
    port : int
        Of this machine; 0 for any that is free.
    path : path, optional
        Listen on a Unix socket there instead, which only this user can open.
    token : str, optional
        What a host must know; by default a random one.
    idle_s : float, optional
        Stop after so long without a request.

    Raises
    ------
    InvalidParameterError
        If the port or the path cannot be used.
    """

    def __init__(
        self,
        run: Run,
        commands: Collection[str],
        *,
        port: int = 0,
        path: str | None = None,
        token: str | None = None,
        idle_s: float | None = None,
    ) -> None:
        self.token = token or new_token()
        self._run, self._commands, self._path = run, commands, path
        self._turn = threading.Lock()
        self._idle_s, self._asked = idle_s, time.monotonic()
        self._server = _bound(port, path)
        self._server.owner = self

    @property
    def address(self) -> dict[str, str]:
        """How to reach the server: ``url``, or the path of the ``socket``."""
        if self._path is not None:
            return {"socket": os.path.abspath(self._path)}
        return {"url": f"http://{HOST}:{self._server.server_address[1]}"}

    def in_turn(self, work: Callable[[], Any]) -> Any:
        """Do something when all commands that came before are done."""
        with self._turn:
            return work()

    def serve(self) -> None:
        """Answer requests until an exception, such as `SystemExit` by a signal; the command under way is finished."""
        try:
            self._server.serve_forever(poll_interval=0.2)
        finally:
            self._server.server_close()
            if self._path is not None:
                Path(self._path).unlink(missing_ok=True)
            self._turn.acquire(timeout=GRACE_S)

    def answer(self, method: str, target: str, token: str, body: bytes) -> tuple[int, dict[str, Any]]:
        """Return the status of HTTP and the content for a request."""
        if not is_token(token, f"Bearer {self.token}"):
            raise RefusedError(401, "the token is missing or wrong")
        self._asked = time.monotonic()
        if (method, target) == ("GET", "/"):
            return 200, {"version": __version__, "commands": list(self._commands)}
        if (method, target) != ("POST", "/run"):
            raise RefusedError(404, "there are GET / and POST /run")
        request = parse_request(body, self._commands)
        answer: Answer = self.in_turn(lambda: self._run(request))
        self._asked = time.monotonic()
        return HTTP_OF_STATUS.get(answer.status, 500), answer._asdict()

    def look(self) -> None:
        """Stop if nobody has asked for long."""
        if self._idle_s is not None and not self._turn.locked() and time.monotonic() - self._asked > self._idle_s:
            raise SystemExit(0)


class _Limited(socketserver.ThreadingMixIn):
    """A server with a limited number of threads, which do not keep the process from ending."""

    daemon_threads = True
    allow_reuse_address = True
    owner: Server

    def __init__(self, address: Any) -> None:
        self._free = threading.BoundedSemaphore(MOST_CONNECTIONS)
        super().__init__(address, _Handler)  # type: ignore[call-arg]

    def process_request(self, request: Any, client_address: Any) -> None:
        """Answer in a thread, if there is one left."""
        if self._free.acquire(blocking=False):
            super().process_request(request, client_address)
        else:
            with suppress(OSError):
                request.sendall(b"HTTP/1.0 503 Service Unavailable\r\n\r\n" + _content("too many requests wait"))
            self.shutdown_request(request)  # type: ignore[attr-defined]

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Answer, and leave the place to the next."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._free.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Take no notice of a host that has left."""

    def service_actions(self) -> None:
        """Look around between requests."""
        self.owner.look()


class _TcpServer(_Limited, socketserver.TCPServer):
    pass


def _bound(port: int, path: str | None) -> Any:
    """Return a server of sockets that listens."""
    # Listen on a port of this machine.
    if path is None:
        try:
            return _TcpServer((HOST, port))
        except (OSError, OverflowError) as error:
            raise InvalidParameterError(f"port {port} cannot be used: {error}") from None
    if not hasattr(socketserver, "UnixStreamServer"):
        raise InvalidParameterError("this system has no Unix sockets: leave the path out")

    class UnixServer(_Limited, socketserver.UnixStreamServer):
        pass

    # Or on a socket that only this user may open.
    _remove_dead_socket(path)
    mask = os.umask(0o177)
    try:
        return UnixServer(path)
    except OSError as error:
        raise InvalidParameterError(f"{path}: cannot be used as a socket: {error}") from None
    finally:
        os.umask(mask)


def _remove_dead_socket(path: str) -> None:
    """Remove a socket that a killed server has left, and no other file."""
    if not Path(path).is_socket():
        return
    with socket.socket(socket.AF_UNIX) as probe:
        try:
            probe.connect(path)
        except ConnectionRefusedError:
            Path(path).unlink(missing_ok=True)
        except OSError as error:
            raise InvalidParameterError(f"{path}: cannot be used as a socket: {error}") from None


class _Handler(BaseHTTPRequestHandler):
    """One request of one connection."""

    server_version, sys_version = "spreadlets", ""

    def setup(self) -> None:
        """Close the connection if the request does not arrive in time."""
        super().setup()
        self._alarm = threading.Timer(READ_S, self._hang_up)
        self._alarm.daemon = True
        self._alarm.start()

    def finish(self) -> None:
        """Leave."""
        self._alarm.cancel()
        with suppress(OSError):
            super().finish()

    def do_GET(self) -> None:
        """Answer what needs no content."""
        self._answer(b"")

    def do_POST(self) -> None:
        """Answer what has content."""
        length = self.headers.get("Content-Length", "")
        if not (length.isascii() and length.isdigit()):
            self.send_error(411, "Content-Length must say how many bytes follow")
        elif len(length) > len(str(MOST_BYTES)) or int(length) > MOST_BYTES:
            self.send_error(413, f"the request is larger than {MOST_BYTES} bytes")
        else:
            body = self.rfile.read(int(length))
            if len(body) < int(length):
                self.send_error(400, "the request ends early")
            else:
                self._answer(body)

    def _answer(self, body: bytes) -> None:
        self._alarm.cancel()
        token = self.headers.get("Authorization", "")
        try:
            owner: Server = self.server.owner  # type: ignore[attr-defined]
            status, content = owner.answer(str(self.command), self.path, token, body)
        except RefusedError as error:
            self.send_error(error.status, str(error))
        except SpreadletsError as error:
            self.send_error(400, str(error))
        else:
            self._send(status, json.dumps(content).encode())

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:
        """Send what is wrong with a request as JSON, with a head even if the request's own could not be read."""
        self.request_version = self.protocol_version
        self._send(code, _content(message or "the request is damaged"))

    def _send(self, status: int, content: bytes) -> None:
        self.send_response(status)
        self.send_header("Content-Type", "application/json")
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, format: str, *arguments: Any) -> None:
        """Keep no log."""

    def _hang_up(self) -> None:
        with suppress(OSError):
            self.connection.shutdown(socket.SHUT_RDWR)


def _content(message: str) -> bytes:
    """Return an error as one line of JSON."""
    return json.dumps({"error": " ".join(message.split())}).encode()
