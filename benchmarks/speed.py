"""Time of dense splatting against spreadlets on 1024 x 1024 frames, two threads, after compilation.

    python benchmarks/speed.py [--size 1024] [--rounds 3] [--frames DIR]

Synthetic frames: a picture with texture and highlights; CoC radius constant, smoothly varying, or random for each pixel
(from half the radius to the radius), alone and with motion. Rendered frames are read from ``--frames`` (default
frames, or the small ones that ship) and tiled to the size. Beyond the shipped database's range, one with just the
cells in use is built for the run. Times are medians of interleaved rounds. Dense splatting draws the same PSFs in full,
pixel by pixel (dense) or as differences along rows that are summed up at the end (rows); tracing them is not counted.
Columns: seconds of the four, spreadlets without and with level of detail; dense over spreadlets without and with it
(x), rows over spreadlets; SSIM lost against dense; cost of a point without level of detail in units of the first line;
points per pixel without and with it; milliseconds of the steps. Writes speed.txt to benchmarks/results.
"""

import statistics
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from scenes import Scene, parser, result_path, scenes
from scipy import ndimage

import spreadlets as sp
from spreadlets.api import DensePsfs
from spreadlets.compiled import kernel
from spreadlets.parallel import for_blocks, limit_threads, thread_count
from spreadlets.runtime.clock import Clock
from spreadlets.runtime.options import Options
from spreadlets.runtime.render import synthesize

RADII = (16, 32, 64, 128)
CAMERA = sp.ThinLens(focal_length_mm=50, sensor_width_mm=36, f_number=0.01, focus_distance_m=4.0, shutter=(-0.25, 0.25))


@kernel
def multiply_add(begin: int, end: int, image: np.ndarray, radiance: np.ndarray, weight: np.float32, repeats: int):
    """Add a scaled block to another, over and over: the machine's rate for contiguous data in cache."""
    for thread in range(begin, end):
        for _ in range(repeats):
            for k in range(image.shape[1]):
                image[thread, k] += weight * radiance[thread, k]


def unit_time() -> float:
    """Return the seconds that two threads take for one contiguous float4 multiply-add."""
    image, radiance = np.zeros((2, 2, 1 << 14), np.float32)
    for_blocks(multiply_add, 2, image, radiance, np.float32(1), 1)
    best = np.inf
    for _ in range(9):
        begin = time.perf_counter()
        for_blocks(multiply_add, 2, image, radiance, np.float32(1), 2000)
        best = min(best, time.perf_counter() - begin)
    return best / (2 * 2000 * (1 << 12))


def picture(size: int) -> np.ndarray:
    """Return a picture with smooth shading, texture, and one highlight in a thousand pixels."""
    rng = np.random.default_rng(0)
    shading = ndimage.gaussian_filter(rng.random((size, size, 3)), (40, 40, 0), mode="wrap")
    shading = (shading - shading.min()) / np.ptp(shading)
    texture = ndimage.gaussian_filter(rng.random((size, size, 1)), (2, 2, 0), mode="wrap") - 0.5
    highlights = np.where(rng.random((size, size, 1)) < 1e-3, 20 * rng.random((size, size, 1)), 0)
    return np.clip(0.1 + 0.6 * shading + texture, 0.01, None) + highlights


def synthetic(size: int, kind: str, radius: float, motion: float) -> sp.Frame:
    """Return a frame of one kind of labels: constant, smooth or noisy."""
    rng = np.random.default_rng(1)
    if kind == "constant":
        wave = np.ones((size, size))
    elif kind == "smooth":
        wave = ndimage.gaussian_filter(rng.random((size, size)), 60, mode="wrap")
        wave = 0.5 + 0.5 * (wave - wave.min()) / np.ptp(wave)
    else:
        wave = rng.uniform(0.5, 1.0, (size, size))
    scale = 0.5 * (0.05 / CAMERA.f_number) * (50 / 36 * size)
    depth = 1 / (1 / CAMERA.focus_distance_m - radius * wave / scale)
    angle = 0.4 + (wave - 1) * (0 if kind == "constant" else 2)
    path = motion * wave[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return sp.Frame(picture(size), depth, path / CAMERA.shutter_duration)


def rendered(scene: Scene, size: int) -> tuple[sp.Frame, sp.ThinLens]:
    """Return a rendered frame tiled to the size, and its camera with the same CoC in pixels."""
    frame, camera = scene.pinhole, scene.camera
    times = -(-size // frame.shape[0])
    tiled = (
        np.tile(array, (times, times, *(1,) * (array.ndim - 2)))[:size, :size]
        for array in (frame.radiance, frame.depth, frame.motion)
    )
    return sp.Frame(*tiled), replace(camera, sensor_width_mm=camera.sensor_width_mm * size / frame.shape[1])


class DenseCache:
    """Traces each PSF once."""

    def __init__(self, database: sp.Database, by_rows: bool) -> None:
        self.trace, self.by_rows, self.known = DensePsfs(database), by_rows, {}

    def __call__(self, cell: int, pose: int, scale: float) -> np.ndarray:
        """Return the PSF of a cell."""
        key = cell, pose, scale
        if key not in self.known:
            self.known[key] = self.trace(*key)
        return self.known[key]


def measure(name: str, frame: sp.Frame, camera: sp.ThinLens, rounds: int, unit: float, layers: int) -> str:
    """Return a row of the table for one frame."""
    with tempfile.TemporaryDirectory() as folder:
        path: str | Path = "combined"
        limit = float(np.ceil(np.abs(camera.coc_radius(frame.depth, frame.shape[1])).max()))
        longest = float(np.ceil(np.hypot(*np.moveaxis(frame.motion, 2, 0)).max() * camera.shutter_duration))
        sizes = {"max_coc": max(64.0, limit), "max_motion": max(128.0, longest)}
        if limit > 64.0 or longest > 128.0:
            path = Path(folder) / "frame.h5"
            sp.build_database("combined", path, frames=[frame], camera=camera, **sizes)
        with sp.open_database(path) as database:
            options = {
                "dense": Options(method="dense", layers=layers),
                "rows": Options(method="dense-rows", layers=layers),
                "exact": Options(tolerance=0.0, layers=layers),
                "default": Options(layers=layers),
            }
            psfs = {method: DenseCache(database, by_rows=method == "rows") for method in ("dense", "rows")}
            for method, each in options.items():
                synthesize(frame, camera, database, each, dense_psf=psfs.get(method))
            times: dict[str, list[dict[str, float]]] = {method: [] for method in options}
            results = {}
            for _ in range(rounds):
                for method, each in options.items():
                    clock = Clock()
                    image, report = synthesize(frame, camera, database, each, clock, psfs.get(method))
                    times[method].append(clock.times())
                    results[method] = image, report["plan"]
    steps = {m: {s: statistics.median(t[s] for t in each) for s in each[0]} for m, each in times.items()}
    # Planning is the same for all methods, but for tracing the PSFs in full.
    full = {
        method: steps["exact"]["plan"] + sum(steps[method][step] for step in ("splat", "integrate", "composite"))
        for method in ("dense", "rows")
    }
    points = results["exact"][1]["points_splatted"]
    total = steps["default"]["total"]
    cells = [name, full["dense"], full["rows"], steps["exact"]["total"], total]
    cells += [full["dense"] / steps["exact"]["total"], full["dense"] / total, full["rows"] / total]
    cells += [1 - sp.metrics.ssim(results["default"][0], results["dense"][0])]
    cells += [steps["exact"]["splat"] / points / unit, points / frame.depth.size]
    cells += [results["default"][1]["points_splatted"] / frame.depth.size]
    cells += [1000 * steps["default"][step] for step in ("plan", "splat", "integrate", "composite")]
    return "".join(f"{cell:>22}" if isinstance(cell, str) else f"{cell:>9.3f}" for cell in cells)


@limit_threads(min(2, thread_count()))
def main() -> None:
    options = parser(__doc__)
    options.add_argument("--size", type=int, default=1024)
    options.add_argument("--rounds", type=int, default=3)
    options.add_argument("--layers", type=int, default=1, help="depth layers; 1 compares drawing alone")
    options.add_argument("--only", help="rows whose name contains this")
    arguments = options.parse_args()
    found = scenes(arguments.frames, "_pinhole.exr")
    unit = unit_time()
    titles = ("dense s", "rows s", "tol 0 s", "s", "x tol 0", "x", "x rows", "1-SSIM", "unit/pt", "pts tol0", "pts")
    titles += ("plan ms", "splat", "integr.", "compos.")
    lines = [f"contiguous float4 multiply-add, two threads: {1e9 * unit:.3f} ns", f"{'frame':>22}"]
    lines[1] += "".join(f"{title:>9}" for title in titles)
    print("\n".join(lines), flush=True)
    rows = [(kind, radius, 0) for kind in ("constant", "smooth", "noisy") for radius in RADII]
    rows.remove(("noisy", 128, 0))  # its database would take longer to build than all the rest
    rows += [(kind, 32, motion) for kind in ("constant", "smooth", "noisy") for motion in (64, 128)]
    for kind, radius, motion in rows:
        name = f"{kind} {radius} + {motion}"
        if arguments.only in (None, "") or arguments.only in name:
            frame = synthetic(arguments.size, kind, radius, motion)
            lines.append(measure(name, frame, CAMERA, arguments.rounds, unit, arguments.layers))
            print(lines[-1], flush=True)
    for scene in found:
        if arguments.only in (None, "") or arguments.only in scene.name:
            frame, camera = rendered(scene, arguments.size)
            lines.append(measure(scene.name, frame, camera, arguments.rounds, unit, arguments.layers))
            print(lines[-1], flush=True)
    if arguments.only is None:
        result_path("speed.txt").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
