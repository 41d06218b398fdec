"""Measure the Poisson integrators: error, time against the exact solve, cost per pixel, stiff cases.

    python benchmarks/integrators.py [--quick] [--out benchmarks/results/integrators.txt]

Errors are against the free-space answer in float64: the image itself where the source is a whole image's Laplacian, a
convolution with the lattice Green's function for sparse sources. Times are the best of several interleaved runs on two
threads, four channels, with the result array given; "exact" is `scipy.fft.dstn` and back, float32, two workers.
"""

import argparse
import time
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from poisson_sources import TRAINING, UNSEEN, Family, Rng

from spreadlets.arrays import Image
from spreadlets.errors import InvalidParameterError
from spreadlets.parallel import limit_threads
from spreadlets.psf.laplacian import laplacian, solve_dirichlet, solve_free_space
from spreadlets.runtime.integrate.convolution_pyramid import Integrator, UnbalancedSourceWarning, integrate

SEED = 7
N_CHANNELS = 4
THREADS = 2
INTEGRATORS = (
    ("pyramid-f5", 0),
    ("pyramid-f7", 0),
    ("pyramid", 0),
    ("multigrid", 1),
    ("multigrid", 2),
    ("multigrid", 3),
    ("exact", 0),
)
MEASURED_SECONDS = 3.0
"""Time spent on each integrator and size, so that the best run finds the machine idle."""
FEWEST_RUNS, MOST_RUNS = 3, 100


def name_of(method: str, cycles: int) -> str:
    """Name of a row."""
    return f"{method}, {cycles} cycle{'s' if cycles > 1 else ''}" if cycles else method


def make(method: str, cycles: int) -> Integrator:
    """Make the integrator of a row."""
    return Integrator(method, cycles=cycles, threads=THREADS)


def draw(family: Family, side: int, rng: Rng) -> tuple[Image, NDArray[np.float64]]:
    """Float32 source of four independent channels, and its free-space answer."""
    planes = [family((side, side), rng) for _ in range(N_CHANNELS)]
    source = np.stack([plane for plane, _ in planes], axis=2).astype(np.float32)
    images = [image for _, image in planes if image is not None]
    answer = np.stack(images, axis=2) if images else solve_free_space(source, workers=THREADS)
    return source, answer


def errors(image: Image, answer: NDArray[np.float64]) -> tuple[float, float]:
    """Relative L2 and worst pixel relative to the range, each the worst channel's."""
    error = image - answer
    norms = np.linalg.norm(error, axis=(0, 1)) / np.linalg.norm(answer, axis=(0, 1))
    return float(norms.max()), float((np.abs(error).max(axis=(0, 1)) / np.ptp(answer, axis=(0, 1))).max())


def report_errors(side: int) -> list[str]:
    """Make the table of errors, a family at a time."""
    rng = np.random.default_rng(SEED)
    lines = [f"Relative L2 (worst pixel of the range), {side}^2, the worst of {N_CHANNELS} channels"]
    families = [(f"{name} (trained on)", f) for name, f in TRAINING.items()] + list(UNSEEN.items())
    lines.append(f"{'':28s}" + "".join(f"{name_of(*row):>20s}" for row in INTEGRATORS))
    for name, family in families:
        source, answer = draw(family, side, rng)
        lines.append(error_line(name, source, answer))
        if family is UNSEEN["sparse discs"]:
            boxed = solve_dirichlet(source.astype(np.float64), workers=THREADS)
            lines.append(error_line("  against zero at the sides", source, boxed))
    lines.append(
        "The far field of sparse sources is not zero at the sides; all but the published pyramids hold it there."
    )
    return lines


def error_line(name: str, source: Image, answer: NDArray[np.float64]) -> str:
    """Make a row of the table of errors."""
    cells = [errors(make(*row)(source), answer) for row in INTEGRATORS]
    return f"{name:28s}" + "".join(f"{norm:11.1e} ({worst:.0e})" for norm, worst in cells)


def time_together(jobs: dict[str, Callable[[], object]]) -> dict[str, float]:
    """Best time of each job, seconds; the jobs take turns."""
    for job in jobs.values():
        job()
    best = dict.fromkeys(jobs, np.inf)
    begin, runs = time.perf_counter(), 0
    while runs < FEWEST_RUNS or (runs < MOST_RUNS and time.perf_counter() - begin < MEASURED_SECONDS):
        for name, job in jobs.items():
            start = time.perf_counter()
            job()
            best[name] = min(best[name], time.perf_counter() - start)
        runs += 1
    return best


def report_times(sides: list[int]) -> list[str]:
    """Make the table of times relative to the exact solve."""
    lines = ["Time relative to exact = scipy dstn and back at the array's own size (best case of dstn: side 2^k - 1)"]
    lines.append(f"{'side':>6s}{'exact, ms':>12s}" + "".join(f"{name_of(*row):>20s}" for row in INTEGRATORS))
    for side in sides:
        source = np.random.default_rng(SEED).normal(size=(side, side, N_CHANNELS)).astype(np.float32)
        out = np.empty_like(source)
        jobs: dict[str, Callable[[], object]] = {name_of(*row): partial(make(*row), source, out) for row in INTEGRATORS}
        jobs["dstn"] = partial(solve_dirichlet, source, workers=THREADS)
        best = time_together(jobs)
        ratios = "".join(f"{best[name_of(*row)] / best['dstn']:20.3f}" for row in INTEGRATORS)
        lines.append(f"{side:6d}{1e3 * best['dstn']:12.2f}{ratios}")
    return lines


def report_cost(sides: list[int]) -> list[str]:
    """Make the table of cost per pixel over a wide range of sizes."""
    rows = [row for row in INTEGRATORS if row in (("pyramid-f5", 0), ("pyramid", 0), ("multigrid", 1))]
    lines = ["Nanoseconds per pixel of four channels"]
    lines.append(f"{'side':>6s}" + "".join(f"{name_of(*row):>20s}" for row in rows))
    for side in sides:
        source = np.zeros((side, side, N_CHANNELS), np.float32)
        out = np.empty_like(source)
        cells = []
        for row in rows:
            cells.append(time_together({"": partial(make(*row), source, out)})[""] * 1e9 / side**2)
        lines.append(f"{side:6d}" + "".join(f"{cell:20.1f}" for cell in cells))
    return lines


def disc(shape: tuple[int, int], centre: tuple[float, float], radius: float) -> Image:
    """Draw a hard disc."""
    y, x = np.mgrid[: shape[0], : shape[1]]
    return (np.hypot(y - centre[0], x - centre[1]) < radius).astype(np.float32)


def stiff_images() -> dict[str, Image]:
    """Images that strain an integrator."""
    shapes = {"1 x 500": (1, 500), "17 x 4000": (17, 4000), "odd 301 x 411": (301, 411), "prime 257 x 509": (257, 509)}
    images = {
        name: disc(shape, (shape[0] // 2, shape[1] // 2), 0.4 * min(shape) + 0.2) for name, shape in shapes.items()
    }
    images["PSF as wide as the image"] = disc((400, 400), (199.5, 199.5), 199)
    low, high = disc((400, 400), (300, 300), 60), disc((400, 400), (110, 110), 60)
    images["highlight 1e6 : 1"] = low + 1e6 * high
    images["values of 2^110"] = disc((400, 400), (200, 200), 60) * np.float32(2.0**110)
    return images


def report_stiff() -> list[str]:
    """Make the table of stiff cases: relative L2 of each integrator, or what it says."""
    lines = ["Stiff cases: relative L2"]
    lines.append(f"{'':26s}" + "".join(f"{name_of(*row):>20s}" for row in INTEGRATORS))
    for name, image in stiff_images().items():
        source = np.ascontiguousarray(laplacian(image)[1:-1, 1:-1, None])
        cells = [errors(make(*row)(source), image[:, :, None].astype(np.float64))[0] for row in INTEGRATORS]
        lines.append(f"{name:26s}" + "".join(f"{cell:20.1e}" for cell in cells))
    image = stiff_images()["highlight 1e6 : 1"]
    shadow = (slice(220, 380), slice(220, 380))
    source = np.ascontiguousarray(laplacian(image)[1:-1, 1:-1, None])
    cells = [np.abs(make(*row)(source)[*shadow, 0] - image[shadow]).max() for row in INTEGRATORS]
    lines.append(f"{'  worst pixel in shadow 1':26s}" + "".join(f"{cell:20.1e}" for cell in cells))
    corner = np.zeros((300, 400, 1), np.float32)
    corner[0, 0] = 1
    lines.append(f"{'point in a corner':26s}" + "".join(f"{verdict(row, corner):>20s}" for row in INTEGRATORS))
    huge = np.zeros((300, 400, 1), np.float32)
    huge[100:200, 100:200] = 3e38
    lines.append(f"{'values of 3e38':26s}" + "".join(f"{verdict(row, huge):>20s}" for row in INTEGRATORS))
    wide = np.random.default_rng(SEED).normal(size=(300, 400, N_CHANNELS)).astype(np.float32)
    same = [
        np.array_equal(*(integrate(wide, method, cycles=cycles, threads=n) for n in (1, THREADS)))
        for method, cycles in INTEGRATORS
    ]
    lines.append(f"{'same on 1 and 2 threads':26s}" + "".join(f"{'yes' if cell else 'no':>20s}" for cell in same))
    return lines


def verdict(row: tuple[str, int], source: Image) -> str:
    """Say what an integrator makes of a source that has no good answer."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            image = make(*row)(source)
        except InvalidParameterError:
            return "refused"
    warned = any(issubclass(warning.category, UnbalancedSourceWarning) for warning in caught)
    return f"{'warned' if warned else 'silent'}, {'finite' if np.isfinite(image).all() else 'not finite'}"


@limit_threads(THREADS)
def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="small sizes only")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results" / "integrators.txt")
    options = parser.parse_args()
    warnings.simplefilter("ignore", UnbalancedSourceWarning)
    sections = [
        report_times([255, 256] if options.quick else [511, 512, 1023, 1024, 2047, 2048, 4095, 4096]),
        report_cost([128, 256] if options.quick else [256, 512, 1024, 2048, 4096, 8192]),
        report_errors(255 if options.quick else 1023),
        report_stiff(),
    ]
    text = "\n\n".join("\n".join(section) for section in sections) + "\n"
    print(text)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(text)


if __name__ == "__main__":
    main()
