"""What a page of the view does: asks, and reads what comes."""

import json
import struct

from websockets.sync.client import connect

DEADLINE_S = 30


def live(server, token=None, origin=None):
    address = f"ws://127.0.0.1:{server.port}/live?token={server.token if token is None else token}"
    return connect(address, origin=origin or f"http://127.0.0.1:{server.port}", max_size=None, compression=None)


def unpacked(data):
    (length,) = struct.unpack_from("<I", data)
    return json.loads(data[4 : 4 + length]), data[4 + length :]


def receive(page, kind, until=lambda message: True):
    """Return the next message of a kind."""
    while True:
        message, data = unpacked(page.recv(timeout=DEADLINE_S))
        assert message["type"] != "error" or kind == "error", message
        if message["type"] == kind and until(message):
            return message, data


def ask(page, number, dragging=False, judging=False, **settings):
    message = {"type": "render", "number": number, "dragging": dragging, "judging": judging, "settings": settings}
    page.send(json.dumps(message))


def full(page, number):
    return receive(page, "picture", lambda message: message["full"] and message["number"] == number)
