"""Temporal light field reconstruction (`runtime.sheared.tlfr`) beside layered methods, on rendered frames.

    python benchmarks/tlfr.py [--frames DIR] [--tables quality views settings]

SSIM and PSNR of displayed images against the renderer's converged lens and shutter. The tables:

- quality: every method at 1 and 4 samples in each pixel, and its processor time on two threads, in seconds and as a
  multiple of that of `sheared` on the same samples, measured in turns in one process (SLR Table III has 8 to 10 for
  one thread against twelve); "as published" is without the filter on the screen;
- views: what the number of views of a pixel changes, with and without that filter;
- settings: what the others change.

Writes tlfr_TABLE.txt, and of the frames at full size a picture each (4 samples: tlfr, as published, sheared, lrdm, the
reference, 4 times the difference of tlfr from it), to benchmarks/results.
"""

import time
from collections.abc import Callable, Mapping

from scenes import Report, Scene, parser, result_path, save_pictures, scenes

import spreadlets as sp
from spreadlets.arrays import Image
from spreadlets.metrics import psnr, ssim
from spreadlets.parallel import limit_threads, thread_count

COUNTS = (1, 4)
GOAL = 0.96
"""SSIM at 4 samples."""
AS_PUBLISHED = {"softness": 0.0}
METHODS: dict[str, tuple[str, Mapping[str, object]]] = {
    "mean": ("mean", {}),
    "axis-aligned": ("axis-aligned", {}),
    "sheared": ("sheared", {}),
    "lrdm": ("lrdm", {}),
    "tlfr": ("tlfr", {}),
    "tlfr, as published": ("tlfr", AS_PUBLISHED),
    "spreadlets": ("spreadlets", {}),
}
VIEWS = (32, 64, 128)
SETTINGS: tuple[Mapping[str, object], ...] = (
    {},
    {"dispersion": 1.5},
    {"dispersion": 2.5},
    {"tolerance": 0.1},
    {"tolerance": 1.0},
    {"softness": 0.1},
    {"softness": 0.25},
)


def timed(scene: Scene, count: int, name: str, settings: Mapping[str, object]) -> tuple[Image, float]:
    """Return an image and the processor time that it took, seconds."""
    samples = scene.samples.take(count)
    begin = time.process_time()
    image = sp.reconstruct(samples, scene.camera, method=name, settings=settings)
    return image, time.process_time() - begin


def quality(report: Report, scene: Scene) -> None:
    """Add the rows of a frame, and save its picture."""
    for count in scene.counts(COUNTS):
        found = {title: timed(scene, count, *method) for title, method in METHODS.items()}
        unit = found["sheared"][1]
        for title, (image, seconds) in found.items():
            goal = f">= {GOAL}" if title == "tlfr" and count == COUNTS[-1] else ""
            figures = f"{ssim(image, scene.reference):.4f}", f"{psnr(image, scene.reference):.2f}"
            report.row(
                f"{scene.name}, {count}, {title}", *figures, f"{seconds:.2f}", f"{seconds / unit:.1f}", goal, first=40
            )
        report.add()
    if scene.samples.n_samples >= COUNTS[-1]:
        shown = [found[title][0] for title in ("tlfr", "tlfr, as published", "sheared", "lrdm")]
        save_pictures(result_path(f"tlfr_{scene.name}.png"), shown, scene.reference, shrink=3)


def rows(report: Report, scene: Scene, tried: list[Mapping[str, object]]) -> None:
    """Add a row for each of some settings, with as many samples as there are."""
    count = scene.counts(COUNTS)[-1]
    for settings in tried:
        image, seconds = timed(scene, count, "tlfr", settings)
        name = ", ".join(f"{key} {value}" for key, value in settings.items()) or "default"
        figures = f"{ssim(image, scene.reference):.4f}", f"{psnr(image, scene.reference):.2f}", f"{seconds:.1f}"
        report.row(f"{scene.name}, {count}, {name}", *figures, first=40)


def views(report: Report, scene: Scene) -> None:
    """Add what the number of views changes."""
    rows(report, scene, [{"views": n} | more for more in ({}, AS_PUBLISHED) for n in VIEWS])


def settings(report: Report, scene: Scene) -> None:
    """Add what the other settings change."""
    rows(report, scene, list(SETTINGS))


TABLES: dict[str, tuple[Callable[[Report, Scene], None], tuple[str, ...]]] = {
    "quality": (quality, ("frame, samples, method", "SSIM", "PSNR, dB", "CPU s", "of sheared's", "goal")),
    "views": (views, ("frame, samples, settings", "SSIM", "PSNR, dB", "CPU s")),
    "settings": (settings, ("frame, samples, settings", "SSIM", "PSNR, dB", "CPU s")),
}
"""What makes each table, and its head."""


@limit_threads(min(2, thread_count()))
def main() -> None:
    options = parser(__doc__)
    options.add_argument("--tables", nargs="+", choices=TABLES, default=list(TABLES))
    given = options.parse_args()
    found = scenes(given.frames, "_samples.exr", "_ref_dofmb.exr")
    small = min(found, key=lambda scene: scene.samples.shape)
    for name, method in METHODS.values():
        # Compiles.
        timed(small, 1, name, method if name != "tlfr" else {**method, "views": 1})
    for name in given.tables:
        make, head = TABLES[name]
        report = Report()
        report.row(*head, first=40)
        for scene in found:
            make(report, scene)
        report.save(f"tlfr_{name}.txt")


if __name__ == "__main__":
    main()
