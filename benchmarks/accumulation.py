"""What float32 sums cost: hundreds of millions of adds into a Laplacian image, against the same sums in float64.

    python benchmarks/accumulation.py

Splats one spreadlet of the shipped database from each pixel of frames of 1024 x 1024, some 10^8 adds, once from noise
and once from noise with highlights of 10^6. The same sum is a convolution of the frame with the points, in float64;
both are integrated exactly in float64. Writes accumulation.txt to benchmarks/results.
"""

from pathlib import Path

import numpy as np
from scipy.signal import oaconvolve

import spreadlets as sp
from runtime.splat import PointTable, SplatPass, splat
from spreadlets.laplacian import solve_dirichlet
from spreadlets.spreadlet import Spreadlet

RESULTS = Path(__file__).parent / "results"
SIZE = 1024
RADII = (16.0, 60.0)


def point_table(spreadlet: Spreadlet) -> PointTable:
    """Return the table of a single variant."""
    order = np.lexsort(spreadlet.offset_rc.T[::-1])
    offset = spreadlet.offset_rc[order].astype(np.int32)
    return PointTable(offset, spreadlet.value[order], np.array([0, len(offset)]), np.zeros(1, np.bool_))


def measure(radiance: np.ndarray, table: PointTable) -> tuple[float, float]:
    """Return the worst error of the Laplacian and of the image, each relative to its largest value."""
    padding = table.reach() + 8
    image = np.zeros((SIZE + 2 * padding, SIZE + 2 * padding, 4), np.float32)
    splat(image, SplatPass((0, 0), radiance, np.zeros((SIZE, SIZE), np.int32)), table, padding, ~table.direct)
    kernel = np.zeros((2 * padding + 1, 2 * padding + 1))
    kernel[tuple(table.offset_rc.T + padding)] = table.value[:, 0]
    exact = oaconvolve(radiance[..., 0].astype(np.float64), kernel)
    error = image[..., 0] - exact
    solved = solve_dirichlet(np.stack([exact, error], axis=-1))
    return np.abs(error).max() / np.abs(exact).max(), np.abs(solved[..., 1]).max() / np.abs(solved[..., 0]).max()


def main() -> None:
    rng = np.random.default_rng(0)
    noise = rng.random((SIZE, SIZE, 4)).astype(np.float32)
    bright = np.where(rng.random((SIZE, SIZE, 1)) < 1e-4, np.float32(1e6), noise)
    lines = [f"{'CoC, frame':>24}{'adds':>12}{'Laplacian':>12}{'image':>12}"]
    with sp.open_database("simplelens") as database:
        for radius in RADII:
            table = point_table(database.cell(int(database.find([radius]))))
            for name, radiance in (("noise", noise), ("highlights", bright)):
                errors = measure(radiance, table)
                adds = SIZE * SIZE * len(table.value)
                lines.append(f"{f'{radius:g} px, {name}':>24}{adds:>12.2g}{errors[0]:>12.2g}{errors[1]:>12.2g}")
    print("\n".join(lines))
    (RESULTS / "accumulation.txt").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
