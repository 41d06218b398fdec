"""Error of the light tracer against the work it is given, for PSFs with a closed form.

Prints and writes benchmarks/results/tracing_error.txt and tracing_error.png. Relative L1, no pre-filter. For
comparison: independent random rays, one point each, as a plain light tracer shoots them.

    python benchmarks/tracing_error.py
"""

import argparse
import sys
import time
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from spreadlets.precompute.models.registry import trace_psf
from spreadlets.psf.model import get_model

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))
from naive import psfs  # noqa: E402  (the analytic PSFs live with the tests)

RESULTS = ROOT / "benchmarks" / "results"
ANGLE = 0.3
CASES = {  # name: radius and path length, px
    "disc 4": (4.0, 0.0),
    "disc 16": (16.0, 0.0),
    "disc 64": (64.0, 0.0),
    "capsule 30, 60": (30.0, 60.0),
    "capsule 8, 100": (8.0, 100.0),
}
RAYS = [10**k for k in range(4, 8)]


def traced(radius, length, rays):
    if length == 0.0:
        return trace_psf(get_model("simplelens"), [[radius, radius]], rays=rays)[..., 0]
    box = [[radius, radius], [length, length]]
    return trace_psf(get_model("combined"), box, angle=ANGLE, rays=rays)[..., 0]


def random_rays(radius, length, rays, size):
    rng = np.random.default_rng(0)
    lens = radius * np.sqrt(rng.random(rays)) * np.exp(2j * np.pi * rng.random(rays))
    place = lens + (rng.random(rays) - 0.5) * length * np.exp(1j * ANGLE)
    edges = np.arange(size + 1) - size / 2
    return np.histogram2d(place.imag, place.real, bins=(edges, edges))[0] / rays


def relative_l1(psf, expected):
    rows, cols = np.subtract(expected.shape, psf.shape) // 2
    return np.abs(np.pad(psf, ((rows, rows), (cols, cols))) - expected).sum()


def measure(radius, length):
    expected = psfs.capsule_psf(radius, length, ANGLE, 2 * int(radius + length / 2 + 4) + 1)
    for rays in [*RAYS, None]:
        traced(radius, length, rays)
        began = time.perf_counter()
        psf = traced(radius, length, rays)
        seconds = time.perf_counter() - began
        plain = relative_l1(random_rays(radius, length, rays, len(expected)), expected) if rays else None
        yield rays, relative_l1(psf, expected), seconds, plain


def main():
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    lines = [f"{'PSF':16}{'rays':>10}{'relative L1':>14}{'ms':>8}{'random rays L1':>16}"]
    for i, (name, (radius, length)) in enumerate(CASES.items()):
        rows = list(measure(radius, length))
        for rays, error, seconds, plain in rows:
            shown = f"{plain:16.2e}" if rays else ""
            lines.append(f"{name:16}{rays or 'default':>10}{error:14.2e}{seconds * 1e3:8.1f}{shown}")
        plt.loglog(RAYS, [row[1] for row in rows[:-1]], f"C{i}o-", label=name)
        plt.loglog(RAYS, [row[3] for row in rows[:-1]], f"C{i}:")
    plt.xlabel("point-equivalent deposits")
    plt.ylabel("relative L1 error (dotted: random rays)")
    plt.legend()
    plt.savefig(RESULTS / "tracing_error.png", dpi=100, bbox_inches="tight")
    (RESULTS / "tracing_error.txt").write_text("\n".join(lines) + "\n")
    print("\n".join(lines))


if __name__ == "__main__":
    RESULTS.mkdir(exist_ok=True)
    main()
