"""Tables and figures of SLR and LRDM that `sheared.py`, `lrdm.py` and `tlfr.py` do not make.

    python benchmarks/layered_figures.py [--frames DIR] [--figures NAME ...]

- filters (SLR figure 13): an axis-aligned filter without and with layers, a sheared filter, and the reference;
- layers (SLR figure 15): the layers in colours, and 8 times the difference of the image from the reference;
- fewer (SLR figure 16): fewer and fewer layers, with their time;
- gaussian (SLR's own lens): frames at rest, traced through their depth layers with a lens whose weight is a Gaussian
  that the rim cuts at three standard deviations; against the mean of 640 samples in each pixel, with the aperture of
  the filters set to it and not;
- steps (SLR table IV, LRDM table 2): the processor time of the steps of each method;
- sigma (LRDM figure 9): the moving board of `fence` by the width of the pixel's filter.

As many samples in a pixel as there are: four. Times are CPU seconds with one thread, the least of three runs. Writes
layered_NAME.txt, and a picture of one scene each, layered_NAME.png, to benchmarks/results.
"""

import time
from collections.abc import Callable

import numpy as np
from scenes import Report, Scene, parser, result_path, save_tables, scenes
from sheared import traced
from skimage.transform import downscale_local_mean

import spreadlets as sp
from spreadlets.arrays import Image
from spreadlets.metrics import psnr, ssim
from spreadlets.parallel import limit_threads
from spreadlets.runtime.sheared.filters import SIGMA_LENS
from spreadlets.runtime.sheared.lrdm import Lrdm, in_parts
from spreadlets.runtime.sheared.partitions import Partitioning
from spreadlets.runtime.sheared.reconstruct import make_method
from spreadlets.runtime.sheared.samples import Samples
from spreadlets.runtime.sheared.work import WorkSizes
from spreadlets.scene.display import display_encode

REPEATS = 3
FEWEST = 4
"""The least number of layers that the methods take: two on each side of the focus."""
NUMBERS_OF_LAYERS = (60, 30, 8, FEWEST)
SIGMAS = (0.33, 0.5, 0.7, 1.0)
STEPS = "set-up", "reproject", "blur", "composite", "in one"
DIFFERENCE_GAIN = 8
PICTURED = {"filters": "fence", "layers": "fence", "fewer": "coins", "gaussian": "coins", "sigma": "fence"}
"""The scene that each picture shows."""
BOARD = (slice(0.2, 0.6), slice(0.15, 0.55))
"""The part of `fence` in which the board moves, in shares of rows and columns."""
N_BATCHES, BATCH = 40, 16
"""Samples in a pixel of a reference through a Gaussian lens, in batches that memory holds."""
HUES = np.array(
    [[0.9, 0.15, 0.1], [0.95, 0.6, 0.1], [0.9, 0.9, 0.2], [0.3, 0.75, 0.2], [0.1, 0.6, 0.8], [0.3, 0.25, 0.8]]
)
"""Colours of layers, from near to far, again and again."""


def reconstruct(scene: Scene, method: str, **settings: object) -> tuple[Image, dict[str, float]]:
    """Return an image of all samples, and the figures of its plan."""
    image, report = sp.reconstruct(scene.samples, scene.camera, method=method, settings=settings, report=True)
    return image, report["plan"]


def cpu_seconds(run: Callable[[], object]) -> float:
    """Return the least processor time of some runs; the first may compile and does not count."""
    found = []
    for _ in range(REPEATS + 1):
        begin = time.process_time()
        run()
        found.append(time.process_time() - begin)
    return min(found[1:])


def save_row(figure: str, scene: Scene, shown: list[Image], shrink: int = 2) -> None:
    """Save displayed images side by side, if the figure is shown of this scene."""
    from PIL import Image as Picture

    if PICTURED[figure] != scene.name:
        return

    rows, cols = (side - side % shrink for side in shown[0].shape[:2])
    row = np.concatenate([downscale_local_mean(each[:rows, :cols, :3], (shrink, shrink, 1)) for each in shown], axis=1)
    Picture.fromarray(np.rint(255 * row).astype(np.uint8)).save(result_path(f"layered_{figure}.png"), optimize=True)


def filters(report: Report, scene: Scene) -> None:
    """SLR figure 13."""
    shown = []
    for name, method, settings in (
        (f"axis-aligned, {FEWEST} layers", "axis-aligned", {"layers": FEWEST}),
        ("axis-aligned", "axis-aligned", {}),
        ("sheared", "sheared", {}),
    ):
        image, plan = reconstruct(scene, method, **settings)
        figures = f"{psnr(image, scene.reference):.2f}", f"{ssim(image, scene.reference):.4f}"
        report.row(f"{scene.name}, {name}", *figures, f"{plan['layers_per_tile']:.1f}")
        shown.append(display_encode(image))
    save_row("filters", scene, [*shown, display_encode(scene.reference)], shrink=3)


def layers(report: Report, scene: Scene) -> None:
    """SLR figure 15."""
    partitioning, samples = Partitioning.of_constant_energy(), scene.samples
    coc = scene.camera.coc_radius(samples.depth, samples.shape[1])
    number = np.searchsorted(np.array(partitioning.edges[1:-1]), coc, side="right")
    coloured = np.concatenate([HUES[number % len(HUES)], np.ones((*number.shape, 1))], axis=-1).astype(np.float32)
    labels = samples.depth, samples.motion, samples.lens_uv, samples.time, samples.offset
    blended = sp.reconstruct(sp.SampleBuffer(coloured, *labels), scene.camera, method="sheared")
    image, plan = reconstruct(scene, "sheared")
    shown, truth = display_encode(image[..., :3]), display_encode(scene.reference[..., :3])
    difference = np.clip(0.5 + DIFFERENCE_GAIN * (shown - truth), 0, 1)
    save_row("layers", scene, [np.clip(blended[..., :3], 0, 1), shown, difference])
    in_use = f"{len(np.unique(number))} of {partitioning.n_partitions - 1}"
    report.row(scene.name, in_use, f"{plan['layers_per_tile']:.1f}", f"{np.abs(shown - truth).mean():.4f}")


def fewer(report: Report, scene: Scene) -> None:
    """SLR figure 16."""
    shown = []
    for number in NUMBERS_OF_LAYERS:
        image, plan = reconstruct(scene, "sheared", layers=number)
        seconds = cpu_seconds(lambda n=number: reconstruct(scene, "sheared", layers=n))
        figures = f"{psnr(image, scene.reference):.2f}", f"{ssim(image, scene.reference):.4f}"
        report.row(f"{scene.name}, {number}", f"{plan['layers_per_tile']:.1f}", *figures, f"{seconds:.2f}")
        shown.append(display_encode(image))
    save_row("fewer", scene, shown, shrink=3)


def weights(samples: sp.SampleBuffer) -> Image:
    """Return the weight of each sample by a Gaussian lens, (H, W, S, 1)."""
    square = (samples.lens_uv**2).sum(axis=-1, keepdims=True)
    return np.exp(-0.5 * square / SIGMA_LENS["gaussian"] ** 2)


def gaussian(report: Report, scene: Scene) -> None:
    """Reconstruct what a Gaussian lens sees."""
    light = weight = 0.0
    for seed in range(N_BATCHES):
        batch = traced(scene, BATCH, BATCH, seed=100 + seed)[0]
        each = weights(batch)
        light, weight = light + (each * batch.radiance).sum(axis=2), weight + each.sum(axis=2)
    truth = (light / weight).astype(np.float32)
    samples = traced(scene, 4, 4, seed=2)[0]
    each = weights(samples)
    images = {"mean, weighted": (each * samples.radiance).sum(axis=2) / each.sum(axis=2)}
    for method in ("axis-aligned", "sheared"):
        for aperture in ("gaussian", "disc"):
            settings = {"aperture": aperture}
            images[f"{method}, {aperture}"] = sp.reconstruct(samples, scene.camera, method=method, settings=settings)
    for name, image in images.items():
        report.row(f"{scene.name}, {name}", f"{psnr(image, truth):.2f}", f"{ssim(image, truth):.4f}")
    shown = [images[name] for name in ("sheared, gaussian", "axis-aligned, gaussian", "mean, weighted")]
    save_row("gaussian", scene, [display_encode(each) for each in (*shown, truth)], shrink=3)


def steps(report: Report, scene: Scene) -> None:
    """SLR table IV, LRDM table 2; what SLR does for a tile is one kernel here."""
    samples = Samples.from_buffer(scene.samples, scene.camera)
    for name in ("sheared", "lrdm", "lrdm-sheared", "lrdm-ewa"):
        method, image = make_method(name, {}), np.zeros((*samples.shape, 4), np.float32)
        tiling = method.tiling(samples.shape)
        prepared = method.prepare(samples, tiling)
        found = {"set-up": cpu_seconds(lambda m=method, t=tiling: m.prepare(samples, t))}
        if isinstance(method, Lrdm):
            work = dict.fromkeys(("reproject", "blur", "composite"), 0.0)
            for block in prepared.blocks():
                for step, (run, n) in prepared.steps(block, image).items():
                    size = getattr(WorkSizes.current(), step)
                    work[step] += cpu_seconds(lambda of=(run, n, size): in_parts(*of))
            found |= work
        else:
            found["in one"] = cpu_seconds(lambda p=prepared, i=image: p.fill(i))
        told = (f"{1000 * found[step]:.0f}" if step in found else "-" for step in STEPS)
        report.row(f"{scene.name}, {name}", f"{1000 * sum(found.values()):.0f}", *told)


def sigma(report: Report, scene: Scene) -> None:
    """LRDM figure 9."""
    if scene.name != "fence":
        return
    part = tuple(
        slice(round(share.start * side), round(share.stop * side))
        for share, side in zip(BOARD, scene.samples.shape, strict=True)
    )
    truth, shown = scene.reference[part], []
    for width in SIGMAS:
        image = reconstruct(scene, "lrdm-sheared", sigma_pixel=width)[0][part]
        report.row(f"{scene.name}, {width}", f"{psnr(image, truth):.2f}", f"{ssim(image, truth):.4f}")
        shown.append(display_encode(image))
    save_row("sigma", scene, [*shown, display_encode(truth)], shrink=1)


FIGURES: dict[str, tuple[Callable[[Report, Scene], None], tuple[str, ...]]] = {
    "filters": (filters, ("SLR figure 13", "PSNR, dB", "SSIM", "layers/tile")),
    "layers": (layers, ("SLR figure 15", "layers", "layers/tile", "mean error")),
    "fewer": (fewer, ("SLR figure 16, layers", "layers/tile", "PSNR, dB", "SSIM", "CPU s")),
    "gaussian": (gaussian, ("Gaussian lens, aperture set", "PSNR, dB", "SSIM")),
    "steps": (steps, ("CPU ms", "all", *STEPS)),
    "sigma": (sigma, ("LRDM figure 9, sigma", "PSNR, dB", "SSIM")),
}
"""What makes each, and the head of its table."""


@limit_threads(1)
def main() -> None:
    options = parser(__doc__)
    options.add_argument("--figures", nargs="+", choices=FIGURES, default=list(FIGURES))
    given = options.parse_args()
    found = scenes(given.frames, "_samples.exr", "_layer0.exr", "_ref_dofmb.exr")
    save_tables({name: FIGURES[name] for name in given.figures}, found, "layered")


if __name__ == "__main__":
    main()
