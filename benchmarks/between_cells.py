"""What is drawn between the cells of the shipped databases, against the exact PSF at random coordinates.

    python benchmarks/between_cells.py [--frames DIR] [--count 1000]

Writes between_cells.txt to benchmarks/results: the figures that every database records
(`spreadlets.precompute.build.between_cells`), the PSFs of single coordinates against the tracer's, and, on rendered
frames, how many points highlights take and what they change.
"""

import numpy as np
from scenes import Scene, parser, result_path, scenes

import spreadlets as sp
from spreadlets.metrics import psf_similarity
from spreadlets.precompute.build import between_cells
from spreadlets.precompute.models.registry import exact_psf, trace_psf

MODELS = ("simplelens", "combined", "stylized", "volume", "physicallens")
TRACED = {"simplelens": 100, "combined": 100, "stylized": 40, "physicallens": 40}
"""How many exact PSFs are held against the tracer's, which takes a second for those of glass."""


def figures_of(name: str) -> list[str]:
    """Return the lines of a database."""
    with sp.open_database(name) as database:
        found = between_cells.between_cells(database.grid, database.cell)
    lines = []
    for kind in ("highlight", "dim"):
        row = found[kind]
        cells = [f"{row.get(key, np.nan):>14.4f}" for key in ("mean", "percentile_1", "mean_large")]
        cells += [f"{row.get(key, np.nan):>14.5f}" for key in ("radius_error", "centre_error_px")]
        lines.append(f"{name:<14}{kind:<11}{found['coordinates']:>6}" + "".join(cells))
    return lines


def traced_row(name: str, count: int) -> str:
    """Return the line that holds a model's PSFs of single coordinates against traced ones."""
    with sp.open_database(name) as database:
        grid = database.grid
    places = between_cells.random_places(grid, count)
    scores = []
    for made, coordinate, angle, side in zip(exact_psf(grid.model)(*places), *places, strict=True):
        box = np.repeat(coordinate[:, None], 2, axis=1)
        traced = trace_psf(grid.model, box, angle=angle, side=int(side))
        scores.append(psf_similarity(*between_cells.on_one_window(traced, made.to_dense())))
    return f"{name:<14}{count:>6}{np.mean(scores):>14.4f}{np.percentile(scores, 1):>14.4f}{min(scores):>14.4f}"


def frame_rows(found: list[Scene]) -> list[str]:
    """Return what highlights change in frames: points for each drawn pixel, and the metrics."""
    lines = []
    for scene in found:
        image, report = sp.synthesize(scene.pinhole, scene.camera, "combined", report=True)
        plan, scores = report["plan"], sp.metrics.compare(image, scene.reference)
        points = plan["points_splatted"] / (plan["pixels_sparse"] + plan["pixels_dense"])
        lines.append(
            f"{scene.name:<14}{points:>14.1f}{scores['ssim']:>14.4f}{scores['psnr']:>14.2f}{scores['flip']:>14.4f}"
        )
    return lines


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--count", type=int, default=between_cells.N_COORDINATES)
    arguments = options.parse_args()
    found = scenes(arguments.frames, "_pinhole.exr", "_ref_dofmb.exr")
    between_cells.N_COORDINATES = arguments.count
    between_cells.N_TRACED = min(between_cells.N_TRACED, arguments.count)
    names = ("mean", "percentile 1", "CoC >= 4 px", "radius", "centre, px")
    lines = ["As drawn, against the exact PSF: similarity; relative error of the rim's radius, distance of its centre."]
    lines.append(f"{'':<14}{'':<11}{'n':>6}" + "".join(f"{name:>14}" for name in names))
    for name in MODELS:
        lines += figures_of(name)
    lines += ["", "PSFs of single coordinates against traced ones: similarity."]
    lines.append(f"{'':<14}{'n':>6}{'mean':>14}{'percentile 1':>14}{'worst':>14}")
    lines += [traced_row(name, min(count, arguments.count)) for name, count in TRACED.items()]
    lines += ["", f"{'':<14}" + "".join(f"{name:>14}" for name in ("points/pixel", "SSIM", "PSNR", "FLIP"))]
    lines += frame_rows(found)
    print("\n".join(lines))
    result_path("between_cells.txt").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
