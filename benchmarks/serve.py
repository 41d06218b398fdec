"""The warm process: time of a call against the same work in process, and damaged requests.

    python benchmarks/serve.py [--size 512] [--rounds 15] [--damaged 1000] [--seed 0]

Calls and work in process alternate, so that what else the machine does falls on both. The result goes to
benchmarks/results/serve.txt.
"""

import argparse
import json
import os
import random
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np

import spreadlets as sp
from spreadlets.cli.main import cli
from spreadlets.cli.serve import run_command
from spreadlets.serve.client import ask
from spreadlets.serve.protocol import MOST_BYTES, Request

RESULTS = Path(__file__).parent / "results"


def draw(folder: Path, size: int) -> list[str]:
    """Write a frame of discs at many depths and its camera; return the command."""
    rng, (rows, columns) = np.random.default_rng(1), np.indices((size, size))
    radiance, depth, motion = np.full((size, size, 3), 0.2), np.full((size, size), 20.0), np.zeros((size, size, 2))
    for z in np.sort(rng.uniform(1, 12, 60))[::-1]:
        x, y, radius = *rng.uniform(0, size, 2), rng.uniform(0.01, 0.1) * size
        inside = (columns - x) ** 2 + (rows - y) ** 2 < radius**2
        radiance[inside], depth[inside], motion[inside] = rng.random(3), z, rng.uniform(-8, 8, 2)
    sp.write_frame(folder / "frame.exr", sp.Frame(radiance, depth, motion))
    lens = ["--focal-length", "50", "--f-number", "1", "--focus", "3", "--sensor-width", "36"]
    return ["synth", "frame.exr", "-o", "out.exr", *lens]


def times(ready: dict, folder: Path, command: list[str], rounds: int) -> str:
    """Alternate calls and work in this process."""
    served, alone = [], []
    for _ in range(rounds + 2):
        begin = time.perf_counter()
        answer = ask(ready["url"], ready["token"], command, str(folder))
        served.append(time.perf_counter() - begin)
        image = (folder / "out.exr").read_bytes()
        begin = time.perf_counter()
        run_command(cli, Request(command, str(folder)))
        alone.append(time.perf_counter() - begin)
        assert answer.status == 0 and image == (folder / "out.exr").read_bytes()
    served, alone = served[2:], alone[2:]  # the first ones load
    ratios = np.array(served) / np.array(alone)
    return (
        f"a call {np.median(served):.3f} s, the same in process {np.median(alone):.3f} s, medians of {rounds}; ratio "
        f"of medians {np.median(served) / np.median(alone):.3f}, median of ratios {np.median(ratios):.3f}; equal images"
    )


def damaged(ready: dict, count: int, rng: random.Random) -> str:
    """Send damaged requests of several kinds, and see that each is refused and the next good one answered."""
    place, statuses, answered = urlsplit(ready["url"]), {}, 0
    good = json.dumps({"arguments": ["info", "combined"], "folder": "/"}).encode()
    head = f"POST /run HTTP/1.1\r\nAuthorization: Bearer {ready['token']}\r\n"
    for index in range(count):
        data = bytearray(f"{head}Content-Length: {len(good)}\r\n\r\n".encode() + good)
        kind = index % 5
        if kind == 0:
            for _ in range(rng.randint(1, 20)):
                data[rng.randrange(len(data))] = rng.randrange(256)
        elif kind == 1:
            data = data[: rng.randrange(len(data))]
        elif kind == 2:
            data = bytearray(rng.randbytes(rng.randrange(5000)))
        elif kind == 3:
            data = bytearray(f"{head}Content-Length: {MOST_BYTES + rng.randrange(1 << 40)}\r\n\r\n".encode())
        else:
            data = data.replace(ready["token"].encode(), rng.randbytes(8).hex().encode())
        with socket.create_connection((place.hostname, place.port), timeout=60) as connection:
            try:
                connection.sendall(data)
                connection.shutdown(socket.SHUT_WR)
                answer = b"".join(iter(lambda: connection.recv(1 << 16), b""))
            except OSError:
                answer = b""
        status = answer.split()[1].decode() if answer else "closed"
        statuses[status] = statuses.get(status, 0) + 1
        if index % 100 == 99:
            answered += ask(ready["url"], ready["token"], ["info", "combined"], "/").status == 0
    told = ", ".join(f"{status}: {number}" for status, number in sorted(statuses.items()))
    between = f"good ones in between answered: {answered} of {count // 100}"
    return f"{count} damaged requests, by status of HTTP: {told}; {between}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--damaged", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    command = [sys.executable, "-m", "spreadlets.cli.main", "serve", "--json"]
    begin = time.perf_counter()
    with tempfile.TemporaryDirectory() as name, subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        ready = json.loads(server.stdout.readline())
        lines = [f"ready after {time.perf_counter() - begin:.2f} s"]
        lines.append(times(ready, Path(name), draw(Path(name), arguments.size), arguments.rounds))
        lines.append(damaged(ready, arguments.damaged, random.Random(arguments.seed)))
        os.kill(server.pid, signal.SIGTERM)
        lines.append(f"exit status after SIGTERM: {server.wait()}")
    (RESULTS / "serve.txt").write_text("\n".join(lines) + "\n")
    print("\n".join(lines))


if __name__ == "__main__":
    main()
