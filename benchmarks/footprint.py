"""What a run takes beside its time: compiling, start-up, memory, files; and what a database for one frame saves.

    python benchmarks/footprint.py

Each figure is of a fresh process, and but for the first with the compiled code already in the cache. Frames are
synthetic: a picture of smoothly varying depth and motion, in four layers where it says so. Writes footprint.txt to
benchmarks/results.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from scipy import ndimage

import spreadlets as sp
from spreadlets.files.exr_frames import write_frame

RESULTS = Path(__file__).parent / "results"
DATA = Path(sp.__file__).parent / "data"
COMMAND = "-m", "spreadlets.cli.main"
CAMERA = {
    "focal_length_mm": 50.0,
    "sensor_width_mm": 36.0,
    "f_number": 1.4,
    "focus_distance_m": 3.0,
    "shutter_open_close_frames": [-0.25, 0.25],
}


def picture(height: int, width: int, n_layers: int) -> sp.Frame:
    """Return a frame of a slanted, moving, textured surface, or of several behind each other with holes."""
    rng = np.random.default_rng(0)
    layers = []
    for number in range(n_layers):
        wave = ndimage.zoom(rng.random((9, 9)), (height / 9, width / 9), order=1)[:height, :width]
        colour = ndimage.zoom(rng.random((65, 65, 3)), (height / 65, width / 65, 1), order=1)[:height, :width]
        alpha = (wave > 0.5).astype(np.float32) if number + 1 < n_layers else np.ones((height, width), np.float32)
        motion = np.stack([40 * (wave - 0.5), 20 * (0.5 - wave)], axis=-1)
        layers.append((np.dstack([colour * alpha[..., None], alpha]), 2.0 + 2.0 * number + wave, motion))
    return sp.Frame.from_layers(layers) if n_layers > 1 else sp.Frame(*layers[0])


def synth(*arguments: object) -> tuple[dict[str, object], float]:
    """Run ``synth`` in a process of its own; return its figures and the wall time of the whole process, s."""
    printed, seconds = run(*COMMAND, "synth", *arguments, "--json")
    return json.loads(printed), seconds


def memory(folder: Path, camera: Path) -> list[str]:
    """Return the rows of peak memory against size."""
    lines = [f"{'frame':>18}{'layers':>8}{'peak MB':>10}{'MB/Mpx':>9}{'s':>8}"]
    for height, width, n_layers in ((512, 512, 1), (1024, 1024, 1), (1024, 1024, 4), (2048, 2048, 1), (2160, 4096, 1)):
        write_frame(folder / "frame.exr", picture(height, width, n_layers))
        report, _ = synth(folder / "frame.exr", "-o", folder / "out.exr", "--camera", camera)
        peak, seconds = report["peak_rss_mb"], report["time_s"]["total"]
        lines.append(
            f"{width:>11} x{height:>5}{n_layers:>8}{peak:>10.0f}{peak / (height * width / 1e6):>9.0f}{seconds:>8.2f}"
        )
    return lines


def start_up(folder: Path, camera: Path) -> str:
    """Return the row of the whole process on a small frame: the best of five."""
    write_frame(folder / "small.exr", picture(256, 256, 1))
    walls = [synth(folder / "small.exr", "-o", folder / "out.exr", "--camera", camera)[1] for _ in range(6)]
    return f"whole process, 256 x 256: best of five {min(walls[1:]):.2f} s, worst {max(walls[1:]):.2f} s"


def made_for_a_frame(folder: Path) -> list[str]:
    """Return the rows that compare the shipped database with one made for the sample frame."""
    frame, camera, made = DATA / "coins_pinhole.exr", DATA / "coins.json", folder / "coins.h5"
    sp.build_database("combined", made, samples=1000, frames=[sp.read_frame(frame)], camera=sp.read_camera(camera))
    rows, images = [], []
    for name, database in (("combined", "combined"), ("--for coins", made)):
        best = min(
            (synth(frame, "-o", folder / "out.exr", "--camera", camera, "--db", database)[0] for _ in range(5)),
            key=lambda report: report["time_s"]["total"],
        )
        images.append(sp.read_image(folder / "out.exr"))
        with sp.open_database(database) as opened:
            size = opened.summary()["size_bytes"]
        seconds = best["time_s"]
        rows.append(f"{name:>14}: {size / 1e6:.2f} MB, plan {seconds['plan']:.3f} s, total {seconds['total']:.3f} s")
    return [*rows, f"{'':>14}  largest difference of the images {np.abs(images[0] - images[1]).max():.1e}"]


FILES_PASSED = """
import sys
import spreadlets as sp
from spreadlets.compiled import first_calls

frame, camera = sp.read_frame(sys.argv[1]), sp.read_camera(sys.argv[2])
passed = set()
sys.setprofile(lambda frame, event, argument: passed.add(frame.f_globals.get("__name__", "")))
sp.synthesize(frame, camera)
sys.setprofile(None)
passed |= {module for module, *_ in first_calls()}
print(len({name for name in passed if name.startswith("spreadlets.")}))
"""
"""How many of the package's files run while an image is made of a frame that has been read."""


def run(*arguments: object, **environment: str) -> tuple[str, float]:
    """Run Python with arguments in a fresh process; return what it prints and the wall time of the process, s."""
    begin = time.perf_counter()
    command = [sys.executable, *map(str, arguments)]
    done = subprocess.run(command, check=True, capture_output=True, text=True, env=os.environ | environment)
    return done.stdout, time.perf_counter() - begin


def first_run(folder: Path) -> str:
    """Return the row of the first run of the demonstration, when nothing is compiled yet."""
    printed, whole = run(*COMMAND, "demo", "--json", "-o", folder / "demo", NUMBA_CACHE_DIR=str(folder / "kernels"))
    waited = json.loads(printed)["compile_s"]
    return f"first run of the demonstration: {waited:.1f} s of waiting for kernels, {whole:.1f} s as a whole"


def passed_files() -> str:
    """Return the row of the files of the package that a frame's pixels pass."""
    count, _ = run("-c", FILES_PASSED, DATA / "coins_pinhole.exr", DATA / "coins.json")
    return f"files of the package that run between a frame and its image: {count.strip()}"


def main() -> None:
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        camera = folder / "camera.json"
        camera.write_text(json.dumps(CAMERA))
        lines = [
            first_run(folder),
            start_up(folder, camera),
            passed_files(),
            *memory(folder, camera),
            *made_for_a_frame(folder),
        ]
    print("\n".join(lines))
    (RESULTS / "footprint.txt").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
