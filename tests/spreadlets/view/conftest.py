import json
import os
import shutil
import subprocess
import sys
import threading

import numpy as np
import pytest
from view_scene import CAMERA, SHAPE, make_frame

import spreadlets as sp
from spreadlets.view.server import Server
from spreadlets.view.session import Scene, Studio


@pytest.fixture(scope="session")
def frame():
    return make_frame()


@pytest.fixture
def studio(frame):
    reference = np.full((*SHAPE, 3), 0.5, np.float32)
    made = Studio(Scene(frame, CAMERA, "combined", reference, ("frame.exr",), "camera.json"))
    yield made
    made.close()


@pytest.fixture
def server(studio):
    made = Server(studio)
    thread = threading.Thread(target=made.run)
    thread.start()
    yield made
    made.stop()
    thread.join(10)
    assert not thread.is_alive()


@pytest.fixture(scope="session")
def files(tmp_path_factory):
    """The frame, its camera and a reference as files."""
    folder = tmp_path_factory.mktemp("view")
    frame = make_frame()
    sp.write_frame(folder / "frame.exr", frame)
    sp.write_image(folder / "reference.exr", sp.synthesize(frame, CAMERA, "combined"))
    camera = {"focal_length_mm": 80, "sensor_width_mm": 36, "f_number": 1.0, "focus_distance_m": 2.0}
    camera["shutter_open_close_frames"] = [-0.25, 0.25]
    (folder / "camera.json").write_text(json.dumps(camera))
    return folder


@pytest.fixture(scope="session")
def command(files):
    """The address of the page of a command that runs."""
    words = ["view", "frame.exr", "--camera", "camera.json", "--reference", "reference.exr", "--json"]
    process = subprocess.Popen(
        [sys.executable, "-m", "spreadlets.cli.main", *words], cwd=files, stdout=subprocess.PIPE, text=True
    )
    yield json.loads(process.stdout.readline())["url"]
    process.terminate()
    process.wait(20)
    process.stdout.close()


@pytest.fixture(scope="session")
def chromium():
    """A browser; the tests that need one are skipped without."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    path = os.environ.get("CHROMIUM") or next(
        filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
    )
    if path is None:
        pytest.skip("there is no Chromium: install it, or name it in the environment variable CHROMIUM")
    with playwright.sync_playwright() as started:
        browser = started.chromium.launch(executable_path=path, args=["--no-sandbox"])
        yield browser
        browser.close()
