"""The layered reconstructions of SLR (`runtime.sheared`) on three rendered frames, and on cases whose answer is known.

    python benchmarks/sheared.py [--frames DIR] [--tables quality settings seams speed]

Similarity of displayed images in dB (PSNR) and as SSIM. The tables:

- quality: the renderer's samples against its converged image; "at rest", samples with defocus only, traced through the
  frames' depth layers (hidden surfaces there), against the mean of 512 of them in each pixel; "moved", the renderer's
  samples, moved to mid-shutter, against its converged defocus;
- settings: what they change, and fixed point (SLR Table I) against float on the same 8-bit displayed colours;
- seams: tiles of 64 px against 32 px;
- speed: 1280 x 720 px at 16 samples per pixel, two threads, the frame's samples repeated. Wall time depends on what
  else the machine does, so the CPU time of the process is beside it.

Writes sheared_TABLE.txt, a picture of each frame and the visibility test of SLR Figs. 6 to 8 to benchmarks/results.
"""

import time
from collections.abc import Callable
from pathlib import Path

import matplotlib
import numpy as np
from scenes import Report, Scene, parser, result_path, save_pictures, save_tables, scenes
from scipy import ndimage

import spreadlets as sp
from spreadlets.arrays import Image
from spreadlets.compiled import kernel
from spreadlets.metrics import psnr, ssim
from spreadlets.parallel import for_bands, limit_threads, thread_count
from spreadlets.scene.display import display_encode

COUNTS = (1, 2, 4)
METHODS = ("mean", "axis-aligned", "sheared")
GOAL_OVER_MEAN_DB = 6.0
GOAL_SECONDS = 3.0
REFERENCE_SAMPLES = 512
STEPS = 6
"""Of the search for where a ray meets a layer."""
SETTINGS = (
    {},
    {"bilinear": True},
    {"sigma_pixel": 0.33},
    {"sigma_pixel": 0.7},
    {"actual_range": False},
    {"layers": 16},
    {"layers": 60},
)
SETTINGS += ({"tile": 16}, {"tile": 64}, {"aperture": "gaussian"})
LARGE = (720, 1280)
LARGE_REPEATS = 4
"""Of the 4 samples of a pixel: 16."""


@kernel
def meet(alpha, coc, row, col, offset, lens):
    """Return the layer (or -1) and pixel (row, col) that a ray of a pixel meets, of depth layers, nearest first.

    A ray at a place meets the layer's point p where ``p + coc(p) * lens`` is that place; the search takes the CoC of
    where the last step arrived. Chance decides at partly covered pixels.
    """
    for k in range(alpha.shape[0]):
        r, c = row, col
        for _ in range(STEPS):
            x = col + offset[0] - coc[k, r, c] * lens[0]
            y = row + offset[1] - coc[k, r, c] * lens[1]
            before = r, c
            r = min(max(int(np.rint(y)), 0), alpha.shape[1] - 1)
            c = min(max(int(np.rint(x)), 0), alpha.shape[2] - 1)
            if before == (r, c):
                break
        if np.random.random() < alpha[k, r, c]:  # noqa: NPY002
            return k, r, c
    return -1, row, col


@kernel
def trace(begin, end, alpha, colour, coc, n_samples, seed, samples, total):
    """Trace samples of each pixel, spread evenly over the distance from the lens's centre, in random order.

    Fills `samples` (H, W, S, 10) with colour, CoC, layer, lens (2) and offset (2) of the first S, and `total` (H, W, 4)
    with the mean colour of all.
    """
    for row in range(begin, end):
        np.random.seed(seed * alpha.shape[1] + row)  # noqa: NPY002
        for col in range(alpha.shape[2]):
            for s in range(n_samples):
                radius = np.sqrt((s + np.random.random()) / n_samples)  # noqa: NPY002
                angle = 2 * np.pi * np.random.random()  # noqa: NPY002
                lens = radius * np.cos(angle), radius * np.sin(angle)
                offset = np.random.random() - 0.5, np.random.random() - 0.5  # noqa: NPY002
                k, r, c = meet(alpha, coc, row, col, offset, lens)
                if k >= 0:
                    total[row, col, :3] += colour[k, r, c] / n_samples
                    total[row, col, 3] += 1 / n_samples
                if s < samples.shape[2]:
                    one = samples[row, col, s]
                    one[5] = k
                    if k >= 0:
                        one[:3], one[3], one[4] = colour[k, r, c], 1.0, coc[k, r, c]
                    one[6], one[7], one[8], one[9] = lens[0], lens[1], offset[0], offset[1]


def traced(scene: Scene, n_samples: int, kept: int, seed: int) -> tuple[sp.SampleBuffer, Image]:
    """Return samples of a scene at rest, through its depth layers, and the mean of all.

    Kept are the first of each pixel: all of them if they are to be spread over the lens.
    """
    layers = scene.layered.layers
    alpha = np.stack([layer.radiance[..., 3] for layer in layers])
    colour = np.stack([layer.radiance[..., :3] for layer in layers]) / np.maximum(alpha, 1e-6)[..., None]
    depth = np.stack([filled(layer.depth, layer.radiance[..., 3] > 0) for layer in layers])
    coc = scene.camera.coc_radius(depth, alpha.shape[2]).astype(np.float64)
    samples, total = np.zeros((*alpha.shape[1:], kept, 10)), np.zeros((*alpha.shape[1:], 4))
    for_bands(trace, alpha.shape[1], alpha, colour.astype(np.float64), coc, n_samples, seed, samples, total)
    lens, offset = samples[..., 6:8], samples[..., 8:]
    far = np.where(samples[..., 5] < 0, np.inf, 1.0)  # the CoC stands for the depth
    still = np.zeros_like(lens)
    coc_radius = samples[..., 4]
    buffer = sp.SampleBuffer(samples[..., :4], far, still, lens, still[..., 0], offset, coc_radius=coc_radius)
    return buffer, total.astype(np.float32)


def filled(values: Image, there: Image) -> Image:
    """Return an array with the nearest value where there is none."""
    nearest = ndimage.distance_transform_edt(~there, return_distances=False, return_indices=True)
    return values[tuple(nearest)]


def compare_methods(
    report: Report,
    title: str,
    buffers: list[sp.SampleBuffer],
    camera: sp.ThinLens,
    reference: Image,
    methods: tuple[str, ...],
) -> dict[str, list[Image]]:
    """Add a row for each method: PSNR and SSIM at each number of samples; return the images."""
    images = {}
    for method in methods:
        motion = {} if method == "mean" or "moved" not in title else {"motion": False}
        images[method] = [sp.reconstruct(buffer, camera, method=method, **motion) for buffer in buffers]
        values = [f"{psnr(image, reference):.2f}" for image in images[method]]
        values += [f"{ssim(image, reference):.4f}" for image in images[method]]
        report.row(f"{title}, {method}", *values)
    return images


def gain(better: Image, worse: Image, reference: Image) -> float:
    """Return the gain in dB."""
    return psnr(better, reference) - psnr(worse, reference)


def quality(report: Report, scene: Scene) -> None:
    """Add the tables of a frame and save its picture."""
    taken = [scene.samples.take(n) for n in scene.counts(COUNTS)]
    images = compare_methods(report, scene.name, taken, scene.camera, scene.reference, METHODS)
    for method in METHODS[1:]:
        over = gain(images[method][-1], images["mean"][-1], scene.reference)
        report.row(f"{scene.name}, {method} over mean", "-", "-", f"{over:+.2f}", f">= {GOAL_OVER_MEAN_DB:g}")
    shown = [images[method][-1] for method in ("sheared", "axis-aligned", "mean")]
    save_pictures(result_path(f"sheared_{scene.name}.png"), shown, scene.reference, shrink=3)
    truth = traced(scene, REFERENCE_SAMPLES, 1, seed=1)[1]
    buffers = [traced(scene, n, n, seed=2)[0] for n in COUNTS]
    still = compare_methods(report, f"{scene.name} at rest", buffers, scene.camera, truth, METHODS)
    gains = [gain(a, b, truth) for a, b in zip(still["sheared"], still["axis-aligned"], strict=True)]
    report.row(f"{scene.name} at rest, sheared's lead", *(f"{each:+.2f}" for each in gains), "> 0")
    shown = [still[method][-1] for method in ("sheared", "axis-aligned", "mean")]
    save_pictures(result_path(f"sheared_{scene.name}_at_rest.png"), shown, truth, shrink=3)
    if scene.path("_ref_dof.exr").exists():
        moved_to_mid_shutter(report, scene, taken)
    report.add()


def moved_to_mid_shutter(report: Report, scene: Scene, taken: list[sp.SampleBuffer]) -> None:
    """Add the tables of samples that are moved to mid-shutter."""
    defocus = sp.read_image(scene.path("_ref_dof.exr"))
    moved = compare_methods(report, f"{scene.name} moved", taken, scene.camera, defocus, METHODS[1:])
    gains = [gain(a, b, defocus) for a, b in zip(moved["sheared"], moved["axis-aligned"], strict=True)]
    report.row(f"{scene.name} moved, sheared's lead", *(f"{each:+.2f}" for each in gains), "> 0")


def displayed(buffer: sp.SampleBuffer) -> sp.SampleBuffer:
    """Return a buffer whose colours are those of an 8-bit display."""
    colour = np.rint(255 * display_encode(buffer.radiance[..., :3])) / 255
    colour = np.concatenate([colour, buffer.radiance[..., 3:]], axis=-1)
    parts = buffer.depth, buffer.motion, buffer.lens_uv, buffer.time, buffer.offset
    return sp.SampleBuffer(colour, *parts, valid=buffer.valid, coc_radius=buffer.coc_radius)


def knobs(report: Report, scene: Scene) -> None:
    """Add what the settings change: PSNR, SSIM and layers of a tile."""
    for settings in SETTINGS:
        image, figures = sp.reconstruct(scene.samples, scene.camera, method="sheared", settings=settings, report=True)
        name = ", ".join(f"{key} {value}" for key, value in settings.items()) or "default"
        cells = f"{psnr(image, scene.reference):.2f}", f"{ssim(image, scene.reference):.4f}"
        report.row(f"{scene.name}, {name}", *cells, f"{figures['plan']['layers_per_tile']:.2f}")
    shown = displayed(scene.samples)
    for aperture in ("disc", "gaussian"):
        exact, rounded = (
            sp.reconstruct(shown, scene.camera, method="sheared", settings={"aperture": aperture, "fixed_point": on})
            for on in (False, True)
        )
        difference = 255 * np.abs(exact - rounded)[..., :3]
        cells = f"{difference.mean():.3f}", f"{np.quantile(difference, 0.999):.2f}", f"{difference.max():.2f}"
        report.row(f"{scene.name}, fixed point, {aperture}", *cells, "8-bit steps: mean, 99.9 %, largest")


def steps_at_borders(image: Image, reference: Image, tile: int) -> float:
    """Return how much steeper the error is from tile to tile than from pixel to pixel elsewhere, as a ratio."""
    error = display_encode(image[..., :3]) - display_encode(reference[..., :3])
    ratios = []
    for axis in (0, 1):
        steps = np.abs(np.diff(error, axis=axis)).mean(axis=(1 - axis, 2))
        border = np.arange(1, len(steps) + 1) % tile == 0
        ratios.append(steps[border].mean() / steps[~border].mean())
    return float(np.mean(ratios))


def seams(report: Report, scene: Scene) -> None:
    """Add how tiles of 64 px differ from those of 32 px, and how visible the borders of tiles are."""
    for name, settings in (("actual range", {}), ("full range", {"actual_range": False})):
        small, large = (
            sp.reconstruct(scene.samples, scene.camera, method="sheared", settings=settings | {"tile": tile})
            for tile in (32, 64)
        )
        difference = np.abs(display_encode(small[..., :3]) - display_encode(large[..., :3])) * 255
        cells = f"{difference.mean():.4f}", f"{np.quantile(difference, 0.999):.3f}", f"{difference.max():.3f}"
        ratio = steps_at_borders(small, scene.reference, 32)
        report.row(f"{scene.name}, {name}", *cells, f"{ratio:.3f}")


def enlarged(scene: Scene) -> sp.SampleBuffer:
    """Return the samples of a scene repeated over 1280 x 720 px, 16 in each."""
    given = scene.samples

    def repeat(array: Image) -> Image:
        times = [-(-wanted // side) for wanted, side in zip(LARGE, array.shape, strict=False)]
        tiled = np.tile(array, (*times, *(1 for _ in array.shape[2:])))[: LARGE[0], : LARGE[1]]
        return np.concatenate([tiled] * LARGE_REPEATS, axis=2)

    coc = scene.camera.coc_radius(given.depth, given.shape[1])
    arrays = given.radiance, given.depth, given.motion, given.lens_uv, given.time, given.offset
    return sp.SampleBuffer(*map(repeat, arrays), coc_radius=repeat(coc))


def speed(report: Report, scene: Scene) -> None:
    """Add the times of a large frame."""
    buffer = enlarged(scene)
    for method in METHODS:
        begin = time.process_time()
        _, figures = sp.reconstruct(buffer, scene.camera, method=method, report=True)
        used = time.process_time() - begin
        goal = f"< {GOAL_SECONDS:g}" if method == "sheared" else ""
        layers = figures["plan"].get("layers_per_tile", 1.0)
        report.row(f"{scene.name}, {method}", f"{figures['time_s']['total']:.2f}", f"{used:.2f}", f"{layers:.1f}", goal)


def two_discs(size: int, radius: float, blur: float, n_samples: int, rng: np.random.Generator) -> sp.SampleBuffer:
    """Return samples of SLR Fig. 6: a red disc in front of focus and a green one behind it, before black."""
    shape = size, size, n_samples
    r, angle = np.sqrt(rng.random(shape)), 2 * np.pi * rng.random(shape)
    u, v = r * np.cos(angle), r * np.sin(angle)
    offset = rng.random((*shape, 2)) - 0.5
    x = np.arange(size)[None, :, None] + offset[..., 0] - size // 2
    y = np.arange(size)[:, None, None] + offset[..., 1] - size // 2
    red, green = (np.hypot(x + side * blur * u, y + side * blur * v) < radius for side in (1, -1))
    colour = np.select([red[..., None], green[..., None]], [[1.0, 0, 0], [0, 1.0, 0]], [0.0, 0, 0])
    coc = np.select([red, green], [-blur, blur], 3 * blur)
    zero = np.zeros((*shape, 2))
    lens = np.stack([u, v], axis=-1)
    return sp.SampleBuffer(colour, np.full(shape, 9.0), zero, lens, zero[..., 0], offset, coc_radius=coc)


def visibility(path: Path) -> None:
    """Draw SLR Figs. 6 to 8: the exact image, the reconstruction, and both along a line with Eqs. 36 and 37."""
    matplotlib.use("Agg")
    from matplotlib import pyplot

    size, camera = 96, sp.ThinLens(focal_length_mm=50, sensor_width_mm=36, f_number=2, focus_distance_m=4)
    cases = {"as in Fig. 6": (26.0, 16.0), "smaller lens": (26.0, 5.0), "smaller disc": (13.0, 16.0)}
    figure, axes = pyplot.subplots(3, 3, figsize=(9, 8.6), layout="constrained")
    for (name, (radius, blur)), (exact_at, found_at, line_at) in zip(cases.items(), axes, strict=True):
        rng = np.random.default_rng(2)
        truth = sum(two_discs(size, radius, blur, 64, rng).radiance.mean(axis=2) for _ in range(12)) / 12
        found = sp.reconstruct(two_discs(size, radius, blur, 8, rng), camera, method="sheared")
        for place, image, title in ((exact_at, truth, f"{name}: exact"), (found_at, found, "reconstructed, 8 samples")):
            place.imshow(display_encode(image[..., :3]))
            place.set(title=title, xticks=[], yticks=[])
        distance, (red, green, seen) = seen_along(radius, blur, size // 2)
        line_at.plot(distance, red, "r--", label="red, Eq. 36 and 37")
        line_at.plot(distance, seen, "g--", label="green, exact (36)")
        line_at.plot(distance, (1 - red) * green, "g:", label="green, Eq. 37")
        line = found[size // 2, size // 2 :]
        line_at.plot(line[:, 0], "r", line[:, 1], "g", lw=1)
        line_at.set(title="solid: reconstructed", xlabel="px from the centre", xlim=(0, size // 2 - 1))
        line_at.legend(fontsize=7)
    figure.savefig(path, dpi=70)
    pyplot.close(figure)


def seen_along(radius: float, blur: float, end: int) -> tuple[Image, Image]:
    """Return distances from the centre, px, and the means over a round lens there: red, green, green not hidden."""
    u, v = np.meshgrid(*[np.linspace(-1, 1, 161)] * 2)
    u, v = (each[np.hypot(u, v) <= 1] for each in (u, v))
    distance = np.arange(0, end, 0.5)
    red, green = (np.hypot(distance[:, None] + side * blur * u, blur * v) < radius for side in (1, -1))
    return distance, np.stack([each.mean(axis=1) for each in (red, green, green & ~red)])


TABLES: dict[str, tuple[Callable[[Report, Scene], None], tuple[str, ...]]] = {
    "quality": (quality, ("", *(f"dB at {n}" for n in COUNTS), *(f"SSIM at {n}" for n in COUNTS))),
    "settings": (knobs, ("sheared, 4 samples", "dB", "SSIM", "layers/tile")),
    "seams": (seams, ("64 px tiles against 32 px", "mean", "99.9 %", "largest", "borders")),
    "speed": (speed, ("1280 x 720, 16 samples", "wall s", "CPU s", "layers/tile", "goal")),
}
"""What makes each table, and its head. Differences are in steps of 8 bits; borders are the error's steps there."""


@limit_threads(min(2, thread_count()))
def main() -> None:
    options = parser(__doc__)
    options.add_argument("--tables", nargs="+", choices=TABLES, default=list(TABLES))
    given = options.parse_args()
    found = scenes(given.frames, "_samples.exr", "_layer0.exr", "_ref_dofmb.exr")
    visibility(result_path("sheared_visibility.png"))
    save_tables({name: TABLES[name] for name in given.tables}, found, "sheared")


if __name__ == "__main__":
    main()
