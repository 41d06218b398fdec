"""Reconstruction from 1, 2 and 4 stochastic samples in each pixel of rendered frames, beside two denoisers.

    python benchmarks/reconstruction.py [--frames DIR]

SSIM against the renderer's converged lens and shutter, of `rain` against its thin lens. ``dense`` draws the same PSFs
in full (1 sample only). The peers get the same samples as the mean of each pixel, at 1 sample:

- ``oidn``: Open Image Denoise 2 (package pyoidn), colour only, HDR, highest quality;
- ``bm3d``: package bm3d, on displayed values and on log(1 + radiance), at several standard deviations of the noise; the
  best by SSIM against the reference is shown, which favours it.

``not calibrated`` leaves out the last step, which brings local means to those of the samples; ``fireflies`` are samples
of radiance 2000 in random places. ``ours, --denoise oidn`` denoises the image where it is sharp; ``ours, then oidn``
all of it. Peers whose package is missing are shown as published with the frames, marked with an asterisk. Times are in
seconds, of whole frames after compilation. Writes reconstruction.txt and a picture of each frame (1 sample: ours, the
peers, the mean, the reference, 4 times the difference of ours from it) to benchmarks/results.
"""

import time
from collections.abc import Callable
from importlib.util import find_spec

import numpy as np
from scenes import Report, Scene, ThinRain, parser, result_path, save_pictures, scenes

import spreadlets as sp
from spreadlets.arrays import Image
from spreadlets.metrics import psnr, ssim
from spreadlets.parallel import limit_threads, thread_count
from spreadlets.scene.display import display_encode

COUNTS = (1, 2, 4)
GOAL = {"coins": 0.97, "whirl": 0.97, "fence": 0.95, "gear": 0.97, "rain": 0.96}
GOAL_LEAD = 0.02
SIGMAS = (0.5, 0.8, 1.2)
PUBLISHED_OIDN = {"coins": 0.954, "whirl": 0.969, "fence": 0.944}
N_FIREFLIES, FIREFLY = 20, 2000.0
NODES = {"coins": 0.927, "whirl": 0.965, "fence": 0.807}
"""Similarity of Blender's Defocus and Vector Blur nodes on the pinhole frame, from the frames' own notes."""


def timed(make: Callable[[], Image]) -> tuple[Image, float]:
    """Return an image and the seconds that it took."""
    begin = time.perf_counter()
    return make(), time.perf_counter() - begin


def oidn(image: Image) -> Image:
    """Denoise linear colours (H, W, 3)."""
    import pyoidn

    return pyoidn.denoise(np.ascontiguousarray(image[..., :3], np.float32), hdr=True)


def decoded(shown: Image) -> Image:
    """Return the linear values of displayed ones."""
    return np.where(shown <= 0.04045, shown / 12.92, ((np.maximum(shown, 0.04045) + 0.055) / 1.055) ** 2.4)


DOMAINS: dict[str, tuple[Callable[[Image], Image], Callable[[Image], Image]]] = {
    "displayed": (display_encode, lambda shown: decoded(np.clip(shown, 0, 1))),
    "log": (lambda image: np.log1p(np.maximum(image, 0)), np.expm1),
}
"""What BM3D works on, and back."""


def bm3d(image: Image, reference: Image) -> tuple[Image, float, str]:
    """Return the best result by SSIM, the seconds of that one, and its settings."""
    from bm3d import bm3d_rgb

    tried = []
    for name, (encode, decode) in DOMAINS.items():
        for sigma in SIGMAS:
            denoised, seconds = timed(lambda: decode(bm3d_rgb(encode(image[..., :3]), sigma)))  # noqa: B023
            tried.append((ssim(denoised, reference), f"{name}, sigma {sigma}", denoised, seconds))
    _, setting, denoised, seconds = max(tried, key=lambda each: each[0])
    return denoised, seconds, setting


def ours(scene: Scene, database: sp.Database, report: Report) -> Image:
    """Add the rows of our methods and return the image of 1 sample."""
    found, means, seconds = [], [], []
    images = []
    for count in scene.counts(COUNTS):
        samples = scene.samples.take(count)
        image, figures = sp.reconstruct(samples, scene.camera, database, report=True)
        images.append(image)
        found.append(ssim(image, scene.reference))
        seconds.append(figures["time_s"]["total"])
        means.append(ssim(sp.reconstruct(samples, scene.camera, method="mean"), scene.reference))
    report.row(f"{scene.name}, spreadlets", *found, f">= {GOAL[scene.name]}", *(f"{each:.2f}" for each in seconds))
    bare = [
        sp.reconstruct(scene.samples.take(n), scene.camera, database, calibrate=False) for n in scene.counts(COUNTS)
    ]
    report.row(f"{scene.name}, not calibrated", *(ssim(image, scene.reference) for image in bare))
    for name, made in (("spreadlets", images), ("not calibrated", bare), ("mean", None)):
        made = made or [
            sp.reconstruct(scene.samples.take(n), scene.camera, method="mean") for n in scene.counts(COUNTS)
        ]
        report.row(f"{scene.name}, {name}, PSNR", *(f"{psnr(image, scene.reference):.2f}" for image in made))
    one = scene.samples.take(1)
    dense, figures = sp.reconstruct(one, scene.camera, database, method="dense", report=True)
    report.row(f"{scene.name}, dense", ssim(dense, scene.reference), "-", "-", "-", f"{figures['time_s']['total']:.2f}")
    report.row(f"{scene.name}, mean of the samples", *means)
    return images[0]


def fireflies(scene: Scene, database: sp.Database, report: Report) -> None:
    """Add the row of what single samples that are far too bright do to 1 sample, clamped and not."""
    one = scene.samples.take(1)
    rng = np.random.default_rng(0)
    radiance = one.radiance.copy()
    rows, cols = rng.integers(0, one.shape[0], N_FIREFLIES), rng.integers(0, one.shape[1], N_FIREFLIES)
    radiance[rows, cols, 0, :3] = FIREFLY
    spoilt = sp.SampleBuffer(
        radiance, one.depth, one.motion, lens_uv=one.lens_uv, time=one.time, offset=one.offset, valid=one.valid
    )
    figures = []
    for samples, clamp in ((one, np.inf), (one, None), (spoilt, np.inf), (spoilt, None)):
        image = sp.reconstruct(samples, scene.camera, database, firefly_clamp=clamp)
        figures.append(ssim(image, scene.reference))
    report.row(f"{scene.name}, 1 sample", *figures)


def peers(scene: Scene, image: Image, database: sp.Database, report: Report) -> list[Image]:
    """Add the rows of the denoisers, which are given 1 sample, and of our lead; return their images."""
    mean = sp.reconstruct(scene.samples.take(1), scene.camera, method="mean")
    mine, images, rival = ssim(image, scene.reference), [], PUBLISHED_OIDN.get(scene.name)
    if find_spec("pyoidn"):
        oidn(mean)  # sets up its device
        denoised, seconds = timed(lambda: oidn(mean))
        rival = ssim(denoised, scene.reference)
        images.append(denoised)
        report.row(f"{scene.name}, oidn", rival, "-", "-", "-", f"{seconds:.2f}")
        last = sp.reconstruct(scene.samples.take(1), scene.camera, database, denoise="oidn")
        for name, result in (("--denoise oidn", last), ("then oidn", oidn(image))):
            after = ssim(result, scene.reference)
            report.row(f"{scene.name}, ours, {name}", after, "-", "-", f"{after - mine:+.4f}")
    elif rival is not None:
        report.row(f"{scene.name}, oidn", f"{rival}*")
    if rival is not None:
        report.row(f"{scene.name}, lead over oidn", mine - rival, "-", "-", "> 0")
    if find_spec("bm3d"):
        denoised, seconds, setting = bm3d(mean, scene.reference)
        rival = ssim(denoised, scene.reference)
        images.append(denoised)
        report.row(f"{scene.name}, bm3d", rival, "-", "-", "-", f"{seconds:.2f}", f"  ({setting})")
        report.row(f"{scene.name}, lead over bm3d", mine - rival, "-", "-", f">= {GOAL_LEAD}")
    if scene.name in NODES:
        report.row(f"{scene.name}, nodes, no samples", f"{NODES[scene.name]}*")
    return [*images, mean]


@limit_threads(min(2, thread_count()))
def main() -> None:
    given = parser(__doc__).parse_args()
    found = scenes(given.frames, "_samples.exr", "_ref_dofmb.exr")
    if not found:
        return
    if all((given.frames / f"rain{ending}").exists() for ending in ("_samples.exr", ThinRain.truth)):
        found.append(ThinRain("rain", given.frames))
    report = Report()
    with sp.open_database("combined") as database:
        sp.reconstruct(found[0].samples.take(1), found[0].camera, database)  # compiles
        report.row("SSIM, samples per pixel", *COUNTS, "goal at 1", *(f"s at {count}" for count in COUNTS))
        for scene in found:
            image = ours(scene, database, report)
            others = peers(scene, image, database, report)
            save_pictures(result_path(f"reconstruction_{scene.name}.png"), [image, *others], scene.reference, shrink=3)
            report.add()
        report.row("SSIM, fireflies", "none, any", "none, clamped", f"{N_FIREFLIES}, any", f"{N_FIREFLIES}, clamped")
        for scene in found:
            fireflies(scene, database, report)
        report.add()
    report.add("* from the notes of the frames, not measured here")
    report.save("reconstruction.txt")


if __name__ == "__main__":
    main()
