"""Every aperture option against a naive drawing of a million lens points: alone, on both sides of the focus, in motion.

Writes the relative L1 differences, and what the spreadlets of these PSFs cost, to benchmarks/results/apertures.txt.

    python benchmarks/apertures.py
"""

import argparse
import sys
from pathlib import Path

import numpy as np

from spreadlets.precompute.models.registry import trace_psf
from spreadlets.precompute.sparsify.sparsify import sparsify

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "tests" / "precompute" / "models"))
from test_aperture import SHAPES, drawn, make, relative_l1  # noqa: E402  (the naive drawing lives with the tests)

RESULT = ROOT / "benchmarks" / "results" / "apertures.txt"
RADIUS, MOVING_RADIUS = 14.0, 9.0
LENGTH, DIRECTION = 20.0, 0.5
PATH = (LENGTH * np.cos(DIRECTION), LENGTH * np.sin(DIRECTION))


def row(name: str) -> str:
    """Return a line of the table: L1 in per cent behind and in front of focus and in motion, and two spreadlets."""
    shape = SHAPES[name]
    still = [trace_psf(make("simplelens", **shape), [[RADIUS, RADIUS]], side=side) for side in (1, -1)]
    errors = [relative_l1(psf, drawn(shape, RADIUS, side=side)) for psf, side in zip(still, (1, -1), strict=True)]
    box = [[MOVING_RADIUS, MOVING_RADIUS], [LENGTH, LENGTH]]
    moving = trace_psf(make("combined", **shape), box, angle=DIRECTION)
    errors.append(relative_l1(moving, drawn(shape, MOVING_RADIUS, PATH, np.ones(160), n=400)))
    points = [sparsify(psf)[1] for psf in (still[0], moving)]
    figures = "  ".join(f"{100 * each['sparsity']:5.1f} %  {each['ssim']:.3f}" for each in points)
    return f"{name:10}  " + "  ".join(f"{100 * error:6.3f} %" for error in errors) + f"  {figures}"


def main() -> None:
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    head = "option        behind  in front  moving    sparsity, similarity of the spreadlet: behind, moving"
    lines = [head, *(row(name) for name in SHAPES)]
    RESULT.write_text("\n".join(lines) + "\n")
    print(*lines, sep="\n")


if __name__ == "__main__":
    main()
