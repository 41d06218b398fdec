"""Time and memory of whole frames at the defaults, enlarged to 1024 x 1024, and beside another version of the product.

    python benchmarks/frame_time.py [--frames DIR] [--rounds 3] [--baseline FOLDER]

Pixels of the rendered frames are repeated and motion is multiplied as often, that to the previous and the next frame
too. Each round runs a process for each version, in turns: five renderings after one that loads the kernels. Figures are
medians over rounds of the medians of a process, ms, and the peak memory of the process, MB. With a ``--baseline``, a
checkout of another version, its figures follow and how many times longer it takes. Writes frame_time.txt to
benchmarks/results.
"""

import json
import os
import statistics
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
from scenes import Scene, parser, result_path, scenes

import spreadlets as sp

SIZE = 1024
RENDERINGS = 5
STEPS = ("plan", "splat", "integrate", "composite", "total")


def enlarged(scene: Scene) -> sp.Frame:
    """Return a frame whose pixels are repeated to fill the size."""
    (layer,) = scene.pinhole.layers
    times = SIZE // layer.radiance.shape[0]

    def repeated(plane: np.ndarray | None, factor: int = 1) -> np.ndarray | None:
        return None if plane is None else np.repeat(np.repeat(plane, times, 0), times, 1) * np.float32(factor)

    neighbours = {name: repeated(getattr(layer, name), times) for name in ("motion_prev", "motion_next")}
    return sp.Frame(repeated(layer.radiance), repeated(layer.depth), repeated(layer.motion, times), **neighbours)


def render_all(folder: Path) -> None:
    """Print the figures of each frame as a line of JSON: what one process of the study does."""
    warnings.simplefilter("ignore")
    for scene in scenes(folder, "_pinhole.exr"):
        frame, found = enlarged(scene), []
        for _ in range(1 + RENDERINGS):
            _, report = sp.synthesize(frame, scene.camera, report=True)
            found.append(report.time_s)
        medians = {step: 1e3 * statistics.median(each[step] for each in found[1:]) for step in STEPS}
        print(json.dumps({"name": scene.name, "memory": report.peak_rss_mb, "layers": report.plan.layers, **medians}))


def run(version: Path, folder: Path) -> list[dict[str, float]]:
    """Return what a process of a version of the product finds."""
    environment = os.environ | {"PYTHONPATH": str(version)}
    command = [sys.executable, __file__, "--process", "--frames", str(folder)]
    ran = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return [json.loads(line) for line in ran.stdout.splitlines() if line.startswith("{")]


def main() -> None:
    """Run the processes in turns, and write the table."""
    arguments = parser(__doc__)
    arguments.add_argument("--rounds", type=int, default=3)
    arguments.add_argument("--baseline", type=Path)
    arguments.add_argument("--process", action="store_true", help="render in this process and print figures")
    given = arguments.parse_args()
    if given.process:
        render_all(given.frames)
        return
    scenes(given.frames, "_pinhole.exr")
    versions = [Path(__file__).resolve().parent.parent, *([given.baseline] if given.baseline else [])]
    rounds = [[run(version, given.frames) for version in versions] for _ in range(given.rounds)]
    lines = [f"{'frame':>8}{'layers':>8}" + "".join(f"{step:>11}" for step in STEPS) + f"{'MB':>8}{'x':>7}"]
    for number, first in enumerate(rounds[0][0]):
        totals = []
        for version in range(len(versions)):
            found = [each[version][number] for each in rounds]
            median = {key: statistics.median(each[key] for each in found) for key in (*STEPS, "memory", "layers")}
            totals.append(median["total"])
            cells = "".join(f"{median[step]:11.0f}" for step in STEPS)
            factor = totals[-1] / totals[0]
            lines.append(f"{first['name']:>8}{median['layers']:8.0f}{cells}{median['memory']:8.0f}{factor:7.2f}")
    text = "\n".join(lines) + "\n"
    print(text)
    result_path("frame_time.txt").write_text(text)


if __name__ == "__main__":
    main()
