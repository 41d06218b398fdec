"""The warm process: who is answered, and who is not."""

import http.client
import json
import os
import random
import socket
import stat
import threading
import time
from contextlib import suppress

import pytest

from spreadlets.errors import InvalidParameterError, MissingServerError
from spreadlets.serve import server as server_module
from spreadlets.serve.client import ask
from spreadlets.serve.protocol import MOST_ARGUMENTS, MOST_BYTES, Answer, RefusedError, parse_request
from spreadlets.serve.server import Server

TOKEN = "secret"


@pytest.fixture
def serve():
    """Give a function that starts servers; they end with the test."""
    started = []

    def start(run=lambda request: Answer(0, {"arguments": request.arguments}, []), **options):
        server = Server(run, ["synth"], token=TOKEN, **options)
        thread = threading.Thread(target=serve_until_idle, args=(server,))
        thread.start()
        started.append((server, thread))
        return server

    yield start
    for server, thread in started:
        server._idle_s = 0.0
        thread.join()


def serve_until_idle(server):
    with suppress(SystemExit):
        server.serve()


def url_of(server):
    return server.address["url"]


def exchange(server, data, *, close=True):
    """Send bytes and return what comes back."""
    with socket.create_connection(server._server.server_address, timeout=20) as connection:
        try:
            connection.sendall(data)
            if close:
                connection.shutdown(socket.SHUT_WR)
            return b"".join(iter(lambda: connection.recv(1 << 16), b""))
        except (ConnectionResetError, BrokenPipeError):
            return b""


def post(body, token=TOKEN, length=None, target="/run"):
    head = f"POST {target} HTTP/1.1\r\nHost: a\r\nAuthorization: Bearer {token}\r\n"
    return f"{head}Content-Length: {len(body) if length is None else length}\r\n\r\n".encode() + body


GOOD = json.dumps({"arguments": ["synth", "a.exr"], "folder": "/"}).encode()


def test_a_command_is_run_in_the_folder_of_who_asks(serve, tmp_path, monkeypatch):
    asked = []
    server = serve(lambda request: asked.append(request) or Answer(2, {"a": 1}, ["error: no"]))
    monkeypatch.chdir(tmp_path)
    assert ask(url_of(server), TOKEN, ["synth", "a b.exr"]) == Answer(2, {"a": 1}, ["error: no"])
    ask(url_of(server), TOKEN, ["synth"], "/")
    assert asked == [(["synth", "a b.exr"], str(tmp_path)), (["synth"], "/")]


@pytest.mark.parametrize("token", ["", "wrong", TOKEN + " ", "ß"])
def test_who_does_not_know_the_token_is_refused(serve, token):
    server = serve(lambda request: pytest.fail("it ran"))
    answer = exchange(server, post(GOOD, token))
    assert answer.startswith(b"HTTP/1.0 401") and b"token is missing or wrong" in answer


@pytest.mark.parametrize(
    ("data", "status"),
    [
        (post(b"", length=MOST_BYTES + 1), 413),
        (post(b"", length="9" * 5000), 413),
        (post(b"", length=-1), 411),
        (post(b"", length="x"), 411),
        (post(GOOD, length=len(GOOD) + 5), 400),
        (post(GOOD).replace(b"Content-Length", b"Length"), 411),
        (post(GOOD, target="/other"), 404),
        (post(b"[" * 100_000), 400),
        (post(b"\xff"), 400),
        (b"\0\1\2\r\n\r\n", 400),
        (b"POST\r\n\r\n", 400),
        (b"GET / HTTP/9.9\r\n\r\n", 505),
        (b"BREW / HTTP/1.1\r\n\r\n", 501),
        (b"GET /" + b"a" * 70_000 + b" HTTP/1.1\r\n\r\n", 414),
        (b"GET / HTTP/1.1\r\n" + b"A: b\r\n" * 200 + b"\r\n", 431),
    ],
)
def test_a_damaged_request_is_one_clear_line(serve, data, status):
    answer = exchange(serve(lambda request: pytest.fail("it ran")), data)
    head, _, body = answer.partition(b"\r\n\r\n")
    assert head.split()[1] == str(status).encode()
    assert list(json.loads(body)) == ["error"] and "\n" not in json.loads(body)["error"]


def test_a_thousand_damaged_requests_do_not_end_the_server(serve):
    server, rng = serve(), random.Random(0)
    for _ in range(1000):
        data = bytearray(post(GOOD))
        for _ in range(rng.randint(1, 8)):
            data[rng.randrange(len(data))] = rng.randrange(256)
        exchange(server, bytes(data[: rng.randint(0, len(data))]))
    assert ask(url_of(server), TOKEN, ["synth"]).status == 0


@pytest.mark.parametrize(
    ("content", "named"),
    [
        ([], "must be"),
        ({"arguments": ["synth"]}, "must be"),
        ({"arguments": "synth", "folder": "/"}, "list of texts"),
        ({"arguments": ["synth", 1], "folder": "/"}, "list of texts"),
        ({"arguments": ["synth", "a\0b"], "folder": "/"}, "list of texts"),
        ({"arguments": ["synth", "\udc00\ud800"], "folder": "/"}, "list of texts"),
        ({"arguments": [], "folder": "/"}, "one of synth"),
        ({"arguments": ["build"], "folder": "/"}, "one of synth"),
        ({"arguments": ["synth"] * (MOST_ARGUMENTS + 1), "folder": "/"}, "at most"),
        ({"arguments": ["synth"], "folder": "a"}, "folder must be"),
        ({"arguments": ["synth"], "folder": "/there is none"}, "folder must be"),
    ],
)
def test_only_whole_commands_that_may_be_run_are_taken(content, named):
    with pytest.raises(RefusedError, match=named) as refused:
        parse_request(json.dumps(content).encode(), ["synth"])
    assert refused.value.status == 400


def test_commands_run_one_at_a_time(serve):
    running, most = [], []

    def run(request):
        running.append(request)
        most.append(len(running))
        time.sleep(0.02)
        running.pop()
        return Answer(0, None, [])

    server = serve(run)
    threads = [threading.Thread(target=ask, args=(url_of(server), TOKEN, ["synth"])) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert most == [1, 1, 1, 1]


def test_too_many_and_too_slow_requests_are_refused(serve, monkeypatch):
    monkeypatch.setattr(server_module, "MOST_CONNECTIONS", 1)
    monkeypatch.setattr(server_module, "READ_S", 1.0)
    server = serve()
    with socket.create_connection(server._server.server_address, timeout=20) as slow:
        slow.sendall(b"POST /run HT")
        while server._server._free._value:
            time.sleep(0.01)
        assert exchange(server, b"").startswith(b"HTTP/1.0 503")
        assert slow.recv(100) == b""
    while not server._server._free._value:
        time.sleep(0.01)
    assert ask(url_of(server), TOKEN, ["synth"]).status == 0


def test_a_status_of_http_says_how_a_command_ended(serve):
    for status, expected in ((0, 200), (2, 422), (1, 500)):
        server = serve(lambda request, status=status: Answer(status, None, []))
        assert int(exchange(server, post(GOOD)).split()[1]) == expected


def test_a_host_can_see_who_listens(serve):
    connection = http.client.HTTPConnection(*serve()._server.server_address)
    connection.request("GET", "/", headers={"Authorization": f"Bearer {TOKEN}"})
    assert json.loads(connection.getresponse().read())["commands"] == ["synth"]
    connection.close()


def test_a_server_that_nobody_asks_ends(serve):
    server = Server(lambda request: Answer(0, None, []), [], idle_s=0.05)
    with pytest.raises(SystemExit):
        server.serve()


@pytest.mark.skipif(not hasattr(socket, "AF_UNIX"), reason="needs Unix sockets")
def test_a_unix_socket_is_this_users_and_goes_with_the_server(serve, tmp_path):
    path = tmp_path / "s"
    server = serve(path=str(path))
    assert stat.S_IMODE(os.stat(path).st_mode) == 0o600 and server.address == {"socket": str(path)}
    assert ask(str(path), TOKEN, ["synth"]).status == 0
    with pytest.raises(InvalidParameterError, match="cannot be used as a socket"):
        serve(path=str(path))
    server._idle_s = 0.0
    server._server.owner = server
    while path.exists():
        time.sleep(0.01)
    with socket.socket(socket.AF_UNIX) as dead:
        dead.bind(str(path))
    assert ask(serve(path=str(path)).address["socket"], TOKEN, ["synth"]).status == 0


def test_what_cannot_be_listened_on_is_an_error(serve, tmp_path):
    server = serve()
    with pytest.raises(InvalidParameterError, match="cannot be used"):
        serve(port=server._server.server_address[1])
    (tmp_path / "file").write_text("mine")
    with pytest.raises(InvalidParameterError, match="cannot be used as a socket"):
        serve(path=str(tmp_path / "file"))
    assert (tmp_path / "file").read_text() == "mine"


def test_a_client_says_who_does_not_answer(serve):
    with pytest.raises(MissingServerError, match="no server answers at http://127.0.0.1:9"):
        ask("http://127.0.0.1:9", TOKEN, ["synth"])
    with pytest.raises(InvalidParameterError, match="no address of a server"):
        ask("ftp://127.0.0.1", TOKEN, ["synth"])
    with pytest.raises(InvalidParameterError, match="refuses: the token"):
        ask(url_of(serve()), "wrong", ["synth"])
