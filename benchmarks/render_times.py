"""How long Cycles takes for the frames of the studies, by number of samples in a pixel: the REF columns of the papers.

    python benchmarks/render_times.py [--frames DIR] [--larger DIR]

Read from the cameras' files, where `scenes/render.py` records them. A reference is rendered in two halves; how well
they agree (SSIM), as rendered and denoised, tells how much noise is left. Writes render_times.txt to
benchmarks/results.
"""

import json
from pathlib import Path

from scenes import SCENES, Report, parser


def main() -> None:
    arguments = parser(__doc__)
    arguments.add_argument("--larger", type=Path)
    given = arguments.parse_args()
    folders = [*([given.larger] if given.larger else []), given.frames]
    report = Report()
    report.row("frame", "px", "samples", "s", "s for each", "halves", "denoised", first=22)
    for path in (folder / f"{name}.json" for folder in folders for name in (*SCENES, "rain")):
        told = json.loads(path.read_text()) if path.exists() else {}
        for image, counts in told.get("render", {}).items():
            if not image.startswith(("ref", "noisy")) or not isinstance(counts, dict):
                continue
            for count, found in counts.items():
                seconds = found["render_time_s"]
                halves, denoised = (found.get(name, "-") for name in ("halves_ssim", "denoised_halves_ssim"))
                size = f"{told['width']} x {told['height']}"
                report.row(
                    f"{path.stem}_{image}",
                    size,
                    count,
                    f"{seconds:.1f}",
                    f"{seconds / int(count):.3f}",
                    halves,
                    denoised,
                    first=22,
                )
    if len(report.lines) == 1:
        print(f"no times are recorded in {given.frames}")
        return
    report.save("render_times.txt")


if __name__ == "__main__":
    main()
