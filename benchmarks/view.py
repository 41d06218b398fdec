"""How fast the page answers, in a real browser: first picture, frames per second of a drag, whole picture after it.

    python benchmarks/view.py --frames DIR [--size 1024] [--seconds 4]

For each NAME_pinhole.exr with NAME.json in the folder (coins and whirl), enlarged to the size by repeating pixels.
Columns: seconds from the command to the first whole picture; for a drag of the f-number and one of the focus: pictures
a second, the longer side of the proxy, seconds from the release to the whole picture; and the processor time of a proxy
and of the whole picture, s, summed over threads, which other work on the machine disturbs less. Needs a Chromium, which
is driven by its own protocol: a driver that listens to the network is told of each picture, too, and that takes as long
as it takes to draw one. Writes view.txt to benchmarks/results, with the load of the machine.
"""

import argparse
import itertools
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, Self

import numpy as np
from websockets.sync.client import ClientConnection, connect

import spreadlets as sp
from spreadlets.view.drafts import DRAFT
from spreadlets.view.session import Scene, Settings, Studio

RESULTS = Path(__file__).parent / "results"
SCENES = ("coins", "whirl")
ANNOUNCED = "DevTools listening on "
LOOK_S = 0.02
"""How often it is looked whether a page is ready."""
READY = "document.getElementById('status')?.textContent.startsWith('ready')"
DRAG = """async ([name, seconds]) => {
  const input = document.getElementById(name), value = Number(input.value), begin = performance.now();
  pictures.length = 0;
  for (let step = 0; performance.now() - begin < 1000 * seconds; step++) {
    input.value = value * (1 + 0.3 * Math.abs(Math.sin(step / 40)));
    input.dispatchEvent(new Event("input"));
    await new Promise((done) => setTimeout(done, 16));
  }
  const drafts = pictures.filter((each) => !each.full), released = performance.now();
  input.dispatchEvent(new Event("change"));
  while (!document.getElementById("status").textContent.startsWith("ready"))
    await new Promise((done) => setTimeout(done, 4));
  const last = drafts.slice(Math.floor(drafts.length / 3)), time = last[last.length - 1].at - last[0].at;
  return [(1000 * (last.length - 1)) / time, last[last.length - 1].share, (performance.now() - released) / 1000];
}"""


class Browser:
    """A Chromium without a window."""

    def __init__(self, folder: str) -> None:
        program = os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("google-chrome")
        options = ["--headless", "--no-sandbox", "--remote-debugging-port=0", "--window-size=1280,800"]
        # What it writes goes to a file: nobody would read a pipe.
        told = Path(folder) / "chromium.txt"
        with told.open("w") as file:
            words = [program, *options, f"--user-data-dir={folder}", "about:blank"]
            self._process = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=file)
        while ANNOUNCED not in told.read_text() or not told.read_text().endswith("\n"):
            time.sleep(LOOK_S)
        address = told.read_text().split(ANNOUNCED)[1].split()[0]
        self._connection: ClientConnection = connect(address, max_size=None).__enter__()
        self._numbers = itertools.count(1)
        self._page: dict[str, str] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._ask("Browser.close")
        self._process.wait()

    def open(self, url: str) -> None:
        """Show a page."""
        target = self._ask("Target.createTarget", url=url)["targetId"]
        attached = self._ask("Target.attachToTarget", targetId=target, flatten=True)
        self._page = {"sessionId": attached["sessionId"]}

    def evaluate(self, script: str) -> Any:
        """Return what a script of the page comes to."""
        given = {"expression": script, "awaitPromise": True, "returnByValue": True}
        return self._ask("Runtime.evaluate", **given)["result"].get("value")

    def close(self) -> None:
        """Close the page."""
        self._ask("Page.close")
        self._page = {}

    def _ask(self, method: str, **given: Any) -> dict[str, Any]:
        number = next(self._numbers)
        self._connection.send(json.dumps({"id": number, "method": method, "params": given, **self._page}))
        while True:
            answer = json.loads(self._connection.recv())
            if answer.get("id") == number:
                return answer["result"]


def enlarged(folder: Path, name: str, size: int, target: Path) -> Path:
    """Write a frame with its pixels repeated."""
    (layer,) = sp.read_frame(folder / f"{name}_pinhole.exr").layers
    times = size // layer.shape[0]

    def repeated(values: np.ndarray, stretch: int = 1) -> np.ndarray:
        return np.kron(values, np.ones((times, times, *[1] * (values.ndim - 2)), np.float32)) * np.float32(stretch)

    paths = {key: repeated(getattr(layer, key), times) for key in ("motion_prev", "motion_next")}
    frame = sp.Frame(repeated(layer.radiance), repeated(layer.depth), **paths)
    sp.write_frame(target / f"{name}.exr", frame)
    return target / f"{name}.exr"


@contextmanager
def opened(path: Path, camera: Path, browser: Browser) -> Iterator[float]:
    """Start the command and open its page; yield the seconds until the first whole picture is there."""
    begin = time.perf_counter()
    words = ["view", str(path), "--camera", str(camera), "--json"]
    # Bytecode is kept, as where the package is installed.
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    process = subprocess.Popen(
        [sys.executable, "-m", "spreadlets.cli.main", *words],
        stdout=subprocess.PIPE,
        text=True,
        stderr=subprocess.DEVNULL,
        env={**kept, "PYTHONPYCACHEPREFIX": str(path.parent / "bytecode")},
    )
    browser.open(json.loads(process.stdout.readline())["url"])
    while not browser.evaluate(READY):
        time.sleep(LOOK_S)
    yield time.perf_counter() - begin
    browser.close()
    process.terminate()
    process.wait()


def dragged(browser: Browser, seconds: float) -> list[float]:
    """Drag two sliders; return the figures of both."""
    row = []
    for name in ("f-number", "focus"):
        drag = f"({DRAG})({json.dumps([name, seconds])})"
        browser.evaluate(drag)  # compiles, and finds the proxy that keeps up
        row += browser.evaluate(drag)
    return row


def processor_times(path: Path, camera_path: Path) -> list[float]:
    """Return the processor seconds of a proxy of 512 px in one layer, and of the whole picture, as the focus moves."""
    camera = sp.read_camera(camera_path)
    studio, found = Studio(Scene(sp.read_frame(path), camera)), []
    for draft, options in ((True, {**DRAFT, "layers": 1, "proxy": 512 / max(studio.scene.frame.shape)}), (False, {})):
        renderer = studio.renderer(Settings.of_camera(camera), draft=draft)
        times = []
        for step in range(8):
            begin = time.process_time()
            renderer.render(replace(camera, focus_distance_m=camera.focus_distance_m * (1 + 0.01 * step)), **options)
            times.append(time.process_time() - begin)
        found.append(float(np.median(times[2:])))
    studio.close()
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=Path, required=True)
    parser.add_argument("--size", type=int, default=1024)
    parser.add_argument("--seconds", type=float, default=4.0)
    given = parser.parse_args()
    lines = [f"{given.size} px, {os.cpu_count()} processors; load before {os.getloadavg()[0]:.1f}"]
    lines.append(
        "scene   first s | f-number: fps  proxy px  release s | focus: fps  proxy px  release s | proxy s  whole s"
    )
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder, Browser(folder) as browser:
        for name in SCENES:
            path, camera = enlarged(given.frames, name, given.size, Path(folder)), given.frames / f"{name}.json"
            with opened(path, camera, browser):
                pass  # keeps the bytecode
            with opened(path, camera, browser) as first:
                drags = dragged(browser, given.seconds)
            texts = [
                f"{fps:16.1f} {share * given.size:9.0f} {release:9.2f}  |"
                for fps, share, release in (drags[:3], drags[3:])
            ]
            proxy, whole = processor_times(path, camera)
            lines.append(f"{name:7} {first:7.2f} |{''.join(texts)} {proxy:7.3f} {whole:8.3f}")
    lines.append(
        f"load after {os.getloadavg()[0]:.1f}: where it exceeds the processors, times are longer than they need be"
    )
    (RESULTS / "view.txt").write_text("\n".join(lines) + "\n")
    print("\n".join(lines))


if __name__ == "__main__":
    main()
