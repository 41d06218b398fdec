"""The warm process as programs start it."""

import json
import os
import signal
import subprocess
import sys

import numpy as np
import pytest

from spreadlets.cli.main import cli
from spreadlets.cli.serve import run_command
from spreadlets.errors import AmbiguousInputWarning
from spreadlets.files import exr_frames as exr
from spreadlets.scene.frame import Frame
from spreadlets.serve.protocol import Request

LENS = ("--focal-length", "50", "--f-number", "0.02", "--focus", "4", "--sensor-width", "36")


@pytest.fixture
def frame(tmp_path):
    rng = np.random.default_rng(0)
    exr.write_frame(tmp_path / "frame.exr", Frame(rng.random((24, 32, 3)), np.full((24, 32), 5.0)))
    return tmp_path


def arguments(database, *more):
    return ["synth", "frame.exr", "-o", "out.exr", *LENS, "--db", str(database), *more]


def test_a_command_of_a_host_is_the_one_that_is_typed(frame, small_combined_path, run, monkeypatch):
    here = os.getcwd()
    answer = run_command(cli, Request(arguments(small_combined_path), str(frame)))
    assert answer.status == 0 and answer.report["plan"]["layers"] >= 1 and os.getcwd() == here
    served = exr.read_image(frame / "out.exr")
    monkeypatch.chdir(frame)
    assert run(*arguments(small_combined_path))[0] == 0
    assert np.array_equal(served, exr.read_image(frame / "out.exr"))


def test_errors_and_warnings_come_back_each_time(frame, small_combined_path):
    request = Request(arguments(small_combined_path, "--layers", "999"), str(frame))
    assert [run_command(cli, request)[::2] for _ in range(2)] == [
        (2, ["error: --layers is 999: allowed are 1 to 64"])
    ] * 2
    far = Request(arguments(small_combined_path, "--focus", "4000"), str(frame))
    with pytest.warns(AmbiguousInputWarning, match="focus"):
        answers = [run_command(cli, far) for _ in range(2)]
    assert [answer.status for answer in answers] == [0, 0]


def test_a_server_tells_where_it_is_answers_and_leaves(frame, tmp_path):
    environment = {**os.environ, "SPREADLETS_TOKEN": "known"}
    command = [sys.executable, "-m", "spreadlets.cli.main"]
    server = subprocess.Popen([*command, "serve", "--json"], stdout=subprocess.PIPE, text=True, env=environment)
    try:
        ready = json.loads(server.stdout.readline())
        assert ready["token"] == "known" and ready["pid"] == server.pid

        def send(*request, **changed):
            environment["SPREADLETS_SERVER"] = ready["url"]
            send = [*command, "send", *request]
            return subprocess.run(
                send, capture_output=True, text=True, cwd=frame, env={**environment, **changed}, check=False
            )

        done = send("info", "frame.exr")
        assert done.returncode == 0 and json.loads(done.stdout)["width"] == 32
        done = send("info", "nothing.exr")
        assert (done.returncode, done.stdout) == (2, "") and "there is no such file" in done.stderr
        done = send("info", "frame.exr", SPREADLETS_TOKEN="wrong")
        assert done.returncode == 2 and "the token is missing or wrong" in done.stderr
        done = send("build", "combined")
        assert done.returncode == 2 and "must be one of synth, reconstruct" in done.stderr
        server.send_signal(signal.SIGTERM)
        assert server.wait() == 0
    finally:
        server.kill()
        server.wait()
        server.stdout.close()


def test_a_server_has_one_address(run, tmp_path):
    status, _, err = run("serve", "--port", "8000", "--socket", tmp_path / "s")
    assert status == 2 and "exclude each other" in err
