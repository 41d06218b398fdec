"""The layered reconstructions of defocus and motion blur (`runtime.sheared.lrdm`) on three rendered frames.

    python benchmarks/lrdm.py [--frames DIR] [--tables quality merging sparse settings memory speed defocus]

PSNR is of displayed images against the renderer's converged lens and shutter. Tables:

- the methods at 1, 2 and 4 samples per pixel: PSNR, SSIM, loss of the faster screen filters, gain over the mean;
- their time against that of `lrdm`, each as its authors have it (`lrdm`: all statistics, no merging);
- merging of layers, sparse statistics, and the path for defocus alone on samples moved to mid-shutter;
- other settings;
- memory of blocks of 256 px against the whole image at once: all that NumPy holds at most (its own copy of the samples
  and the image, too) beyond the samples that were given; and the share of what layers take alone, without that copy.
  Of `lrdm-ewa` the copy is most, so there is little for blocks to save.

Times are CPU seconds of the process with one thread, the least of several runs that alternate, so they compare even
when the machine does other things. Writes lrdm.txt, in which tables that were not asked for stay, and a picture of each
frame (4 samples: `lrdm`, `lrdm-sheared`, `lrdm-ewa`, the mean, the reference, 4 times the difference of the first from
it) to benchmarks/results.
"""

import time
import tracemalloc
from collections.abc import Callable

import numpy as np
from scenes import Report, Scene, parser, result_path, save_pictures, scenes

import spreadlets as sp
from spreadlets.arrays import Image
from spreadlets.metrics import psnr, ssim
from spreadlets.parallel import limit_threads
from spreadlets.runtime.sheared.lrdm import Lrdm, PracticalLrdm, spread_of
from spreadlets.runtime.sheared.reconstruct import make_method
from spreadlets.runtime.sheared.samples import Samples

METHODS = ("lrdm", "lrdm-sheared", "lrdm-ewa")
COUNTS = (1, 2, 4)
REPEATS = 3
SHORT_REPEATS = 200
"""Of what takes milliseconds, in which other work shows more."""
GOAL_LOSS_DB = {"lrdm-sheared": 1.1, "lrdm-ewa": 2.6}
GOAL_OVER_MEAN_DB = 6.0
SETTINGS = ({}, {"sigma_pixel": 0.33}, {"sigma_pixel": 0.7}, {"largest_sigma": 5.0}, {"step": 8.0}, {"tile": 64})
LARGE = (720, 1280)


def least_times(runs: dict[str, Callable[[], object]], repeats: int = REPEATS) -> dict[str, float]:
    """Return the least CPU seconds of each, run in turn; the first round may compile and does not count."""
    found = dict.fromkeys(runs, np.inf)
    for number in range(repeats + 1):
        for name, run in runs.items():
            begin = time.process_time()
            run()
            if number:
                found[name] = min(found[name], time.process_time() - begin)
    return found


def reconstruct(
    scene: Scene, method: str, count: int | None = None, **settings: object
) -> tuple[Image, dict[str, float]]:
    """Return an image, by default of 4 samples if there are as many, and the figures of its set-up."""
    samples = scene.samples.take(count or scene.counts(COUNTS)[-1])
    image, report = sp.reconstruct(samples, scene.camera, method=method, settings=settings, report=True)
    return image, report["plan"]


def quality(found: list[Scene], report: Report) -> None:
    """Add PSNR and SSIM of every method, and save the pictures."""
    columns = [f"{what} at {count}" for what in ("PSNR", "SSIM") for count in COUNTS]
    report.row("samples per pixel", *columns, "loss at 4", "allowed", "over mean", "goal")
    for scene in found:
        images, of_lrdm, of_mean = {}, 0.0, 0.0
        for method in ("mean", *METHODS):
            made = [
                sp.reconstruct(scene.samples.take(count), scene.camera, method="mean")
                if method == "mean"
                else reconstruct(scene, method, count)[0]
                for count in scene.counts(COUNTS)
            ]
            images[method] = made[-1]
            decibels = [psnr(image, scene.reference) for image in made]
            of_mean = decibels[-1] if method == "mean" else of_mean
            of_lrdm = decibels[-1] if method == "lrdm" else of_lrdm
            loss = f"{of_lrdm - decibels[-1]:.2f}" if method in GOAL_LOSS_DB else "-"
            gain = f"{decibels[-1] - of_mean:.1f}" if method != "mean" else "-"
            figures = [f"{each:.2f}" for each in decibels] + [f"{ssim(image, scene.reference):.3f}" for image in made]
            goal = f">= {GOAL_OVER_MEAN_DB:g}" if method != "mean" else "-"
            report.row(f"{scene.name}, {method}", *figures, loss, GOAL_LOSS_DB.get(method, "-"), gain, goal)
        pictures = [images[method] for method in (*METHODS, "mean")]
        save_pictures(result_path(f"lrdm_{scene.name}.png"), pictures, scene.reference, shrink=3)
    report.add()


def speed(found: list[Scene], report: Report) -> None:
    """Add the times of the methods, of whole images."""
    report.row("CPU seconds, 4 samples", *METHODS, "sheared x", "ewa x", "goal")
    total = dict.fromkeys(METHODS, 0.0)
    for scene in found:
        taken = least_times({method: lambda m=method: reconstruct(scene, m) for method in METHODS})  # noqa: B023
        total = {method: total[method] + taken[method] for method in METHODS}
        gains = [f"{taken['lrdm'] / taken[method]:.2f}" for method in METHODS[1:]]
        report.row(scene.name, *(f"{taken[method]:.3f}" for method in METHODS), *gains, ">= 2")
    gains = [f"{total['lrdm'] / total[method]:.2f}" for method in METHODS[1:]]
    report.row("all", *(f"{total[method]:.3f}" for method in METHODS), *gains, ">= 2")
    report.add()


def merging(found: list[Scene], report: Report) -> None:
    """Add what merging of layers does, all else as in `lrdm`."""
    report.row("merging of layers", "before", "after", "fewer", "goal", "PSNR loss", "allowed")
    before, after = 0.0, 0.0
    for scene in found:
        image, _ = reconstruct(scene, "lrdm")
        merged, figures = reconstruct(scene, "lrdm", shrink=0.1)
        loss = psnr(image, scene.reference) - psnr(merged, scene.reference)
        many, few = figures["partitions_per_tile"], figures["layers_per_tile"]
        before, after = before + many / len(found), after + few / len(found)
        report.row(scene.name, f"{many:.2f}", f"{few:.2f}", f"{1 - few / many:.0%}", ">= 25%", f"{loss:.3f}", "<= .1")
    report.row("all (authors: 2.7, 1.9)", f"{before:.2f}", f"{after:.2f}", f"{1 - after / before:.0%}", ">= 25%")
    report.add()


def sparse(found: list[Scene], report: Report) -> None:
    """Add what sparse statistics do to set-up time and image, all else as in `lrdm-sheared`."""
    report.row("set-up, ms", "all samples", "sparse", "x", "goal", "PSNR loss", "allowed")
    for scene in found:
        samples = Samples.from_buffer(scene.samples, scene.camera)
        spread = spread_of(samples)
        runs = {}
        for sparsity in (0, 3):
            method = PracticalLrdm(screen_filter="sheared", sparsity=sparsity)
            given = samples, method.partitions(samples), method.tiling(samples.shape), spread, True
            runs[str(sparsity)] = lambda m=method, g=given: m.set_up(*g)
        taken = least_times(runs, repeats=SHORT_REPEATS)
        decibels = [psnr(reconstruct(scene, "lrdm-sheared", sparsity=each)[0], scene.reference) for each in (0, 3)]
        times = [f"{1e3 * taken[each]:.2f}" for each in ("0", "3")]
        gain, loss = taken["0"] / taken["3"], decibels[0] - decibels[1]
        report.row(scene.name, *times, f"{gain:.2f}", ">= 1.5", f"{loss:.3f}", "<= .1")
    report.add()


def defocus_only(found: list[Scene], report: Report) -> None:
    """Add what it saves to leave motion out where nothing moves."""
    report.row("defocus only, CPU seconds", "method", "5D", "4D", "faster", "goal", "difference")
    for scene in found:
        samples = Samples.from_buffer(scene.samples, scene.camera, motion=False)
        for name in METHODS:
            images: dict[str, Image] = {}

            def run(skip: bool, name: str = name, images: dict[str, Image] = images) -> None:
                method = make_method(name, {"skip_motion": skip})
                image = np.zeros((*samples.shape, 4), np.float32)  # noqa: B023
                method.prepare(samples, method.tiling(samples.shape)).fill(image)  # noqa: B023
                images[str(skip)] = image

            taken = least_times({"False": lambda r=run: r(False), "True": lambda r=run: r(True)})
            faster = taken["False"] / taken["True"] - 1
            apart = float(np.abs(images["False"] - images["True"]).max())
            times = [f"{taken[each]:.3f}" for each in ("False", "True")]
            report.row(scene.name, name, *times, f"{faster:.0%}", ">= 10%", f"{apart:.1e}")
    report.add()


def other_settings(found: list[Scene], report: Report) -> None:
    """Add the PSNR of `lrdm` with other settings at 1 and at 4 samples."""
    report.row("lrdm, PSNR", *(f"{scene.name} at {count}" for scene in found for count in scene.counts((1, 4))))
    for settings in SETTINGS:
        name = ", ".join(f"{key} {value}" for key, value in settings.items()) or "as it is"
        cells = [
            f"{psnr(reconstruct(scene, 'lrdm', count, **settings)[0], scene.reference):.2f}"
            for scene in found
            for count in scene.counts((1, 4))
        ]
        report.row(name, *cells)
    report.add()


def enlarged(scene: Scene) -> sp.SampleBuffer:
    """Return the samples of a scene, repeated to a larger image."""
    samples = scene.samples
    rows, cols = (np.arange(n) % size for n, size in zip(LARGE, samples.shape, strict=True))
    arrays = {name: each[rows][:, cols] for name, each in samples.labels.items()}
    return sp.SampleBuffer(samples.radiance[rows][:, cols], **arrays)


def needed(buffer: sp.SampleBuffer, scene: Scene, method: str, block: int) -> tuple[Image, float, float]:
    """Return an image, the most memory that making it took beyond what was there, and that of its layers alone, MB."""
    made = make_method(method, {"block": block})
    tracemalloc.start()
    samples = Samples.from_buffer(buffer, scene.camera)
    prepared = made.prepare(samples, made.tiling(samples.shape))
    image = np.zeros((*samples.shape, 4), np.float32)
    held, before = tracemalloc.get_traced_memory()
    tracemalloc.reset_peak()
    prepared.fill(image)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return image, max(peak, before) / 1e6, (peak - held) / 1e6


def memory(found: list[Scene], report: Report) -> None:
    """Add the memory of the whole image at once and of blocks, and how far their images are apart."""
    columns = "at once", "blocks", "share", "goal", "layers' own", "difference", "goal", "samples"
    report.row(f"{LARGE[1]} x {LARGE[0]}, MB", "method", *columns)
    for scene in found:
        buffer = enlarged(scene)
        given = (buffer.radiance.nbytes + sum(each.nbytes for each in buffer.labels.values())) / 1e6
        for method in METHODS:
            made = (needed(buffer, scene, method, block) for block in (0, 256))
            images, peaks, own = zip(*made, strict=True)
            apart = float(np.abs(images[0] - images[1]).max())
            sizes = [f"{each:.0f}" for each in peaks]
            shares = f"{peaks[1] / peaks[0]:.2f}", "<= .5", f"{own[1] / own[0]:.2f}"
            report.row(scene.name, method, *sizes, *shares, f"{apart:.1e}", "<= 1e-5", f"{given:.0f}")
    report.add()


TABLES = {
    "quality": quality,
    "merging": merging,
    "sparse": sparse,
    "settings": other_settings,
    "memory": memory,
    "speed": speed,
    "defocus": defocus_only,
}
"""In the order of lrdm.txt, in which an empty line ends each."""


@limit_threads(1)
def main() -> None:
    options = parser(__doc__)
    options.add_argument("--tables", nargs="+", choices=TABLES, default=list(TABLES))
    given = options.parse_args()
    found = scenes(given.frames, "_samples.exr", "_ref_dofmb.exr")
    if not found:
        return
    assert Lrdm().shrink < 0 and Lrdm().sparsity == 0  # `lrdm` is as its authors have it
    path = result_path("lrdm.txt")
    texts = path.read_text().strip("\n").split("\n\n") if path.exists() else []
    kept = dict(zip(TABLES, texts, strict=True)) if len(texts) == len(TABLES) else {}
    for name in TABLES:
        if name in given.tables:
            report = Report()
            TABLES[name](found, report)
            kept[name] = "\n".join(report.lines).rstrip("\n")
    path.write_text("\n\n".join(kept[name] for name in TABLES if name in kept) + "\n")


if __name__ == "__main__":
    main()
