"""Every PSF model: sparsity and similarity of its spreadlets, size and build time, and images against dense splatting.

Databases that ship are read; of the full-size grid of ``physicallens``, 4,000 cells, a random sample is built. Frames
are read from ``--frames`` (default ../shared/frames) and skipped where they are missing. Writes models.txt to
benchmarks/results.

    python benchmarks/models.py [--frames DIR] [--sample N]
"""

import argparse
import tempfile
import warnings
from pathlib import Path

import numpy as np

import spreadlets as sp
from precompute.build import build_database, model_grid
from spreadlets.database import Database, open_database

ROOT = Path(__file__).resolve().parent.parent
RESULTS = ROOT / "benchmarks" / "results"
SCENES = ("coins", "whirl", "fence")
MODELS = ("simplelens", "combined", "physicallens", "volume", "stylized")
LKS_SPARSITY = {"simplelens": 31.3, "combined": 9.3, "physicallens": 2.2, "volume": 18.4, "stylized": 24.9}
LKS_MEGABYTES = {"simplelens": 1.1, "combined": 4.2, "physicallens": 30.8, "volume": 5.3, "stylized": 9.0}
"""LKS table 1: per cent, and MB."""

LENS = {"lens": "double_gauss", "width": 1024}
HEART = {"image": str(ROOT / "docs" / "models" / "heart.png"), "colour_offset": 0.06}
SAMPLED = {
    "physicallens": {"max_coc": 32.0, **LENS},
    "physicallens, CoC to 128": {"max_coc": 128.0, **LENS},
    "stylized, CoC to 256": {"max_coc": 256.0, **HEART},
}
"""Databases of which a sample is built: their options."""


def sample(name: str, n: int, folder: Path) -> Database:
    """Build a few random poses of a full-size grid."""
    model, options = name.split(",")[0], dict(SAMPLED[name])
    if model == "physicallens":
        options["camera"] = sp.read_camera(ROOT / "psf_db" / "physicallens.json")
    grid = model_grid(model, **options)
    poses = [(cell, number) for cell in range(grid.n_cells) for number in range(int(grid.pose_counts[cell]))]
    chosen = np.random.default_rng(0).choice(len(poses), min(n, len(poses)), replace=False)
    path = folder / f"{name.replace(' ', '_')}.h5"
    build_database(model, path, only=[poses[i] for i in chosen], jobs=1, **options)
    return open_database(path)


def database_row(name: str, database: Database) -> list[object]:
    """Return a row of the first table."""
    figures = database.summary()
    model = database.grid.model.name
    n_poses = int(database.grid.pose_counts.sum())
    share = figures["n_spreadlets"] / n_poses
    # The index tables do not shrink with a sample.
    points = sum(database._file[key].id.get_storage_size() for key in ("offset_rc", "value"))
    megabytes = (figures["size_bytes"] - points + points / share) / 1e6
    seconds = (figures["build_s"] or 0.0) / figures["n_spreadlets"]
    return [
        name,
        figures["n_cells"],
        n_poses,
        figures["n_spreadlets"],
        100 * figures["mean_sparsity"],
        100 * float(np.median(database.statistics()["sparsity"][np.diff(database.point_start) > 0])),
        LKS_SPARSITY[model],
        figures["mean_ssim"],
        figures["min_ssim"],
        figures["mean_l1"],
        megabytes,
        LKS_MEGABYTES[model],
        seconds,
    ]


def frame_row(folder: Path, scene: str, database: Database) -> list[object]:
    """Return a row of the second table: spreadlets against dense splatting of the same PSFs."""
    frame, camera = sp.read_frame(folder / f"{scene}_pinhole.exr"), sp.read_camera(folder / f"{scene}.json")
    with warnings.catch_warnings():
        # These scenes are in units of their own: the CoC is that of the frame's camera, the aberrations the lens's.
        warnings.simplefilter("ignore")
        sp.synthesize(frame, camera, database)
        image, report = sp.synthesize(frame, camera, database, report=True)
        dense, dense_report = sp.synthesize(frame, camera, database, method="dense", report=True)
    figures = sp.metrics.compare(image, dense)
    splat, dense_splat = (each["time_s"]["splat"] + each["time_s"]["integrate"] for each in (report, dense_report))
    points = report["plan"]["points_splatted"] / frame.radiance[..., 0].size
    return [
        database.grid.model.name,
        scene,
        figures["ssim"],
        1 - figures["ssim"],
        figures["psnr"],
        points,
        splat,
        dense_splat,
        dense_splat / splat,
    ]


def table(columns: tuple[str, ...], rows: list[list[object]]) -> str:
    """Lay a table out in aligned columns."""
    cells = [list(columns)] + [[f"{x:.4g}" if isinstance(x, float) else str(x) for x in row] for row in rows]
    widths = [max(len(row[i]) for row in cells) for i in range(len(columns))]
    return "\n".join("  ".join(x.rjust(w) for x, w in zip(row, widths, strict=True)) for row in cells)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=Path, default=ROOT.parent / "shared" / "frames")
    parser.add_argument("--sample", type=int, default=24)
    arguments = parser.parse_args()
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for name in MODELS:
            if name not in SAMPLED:
                with open_database(name) as database:
                    rows.append(database_row(name, database))
        for name in SAMPLED:
            with sample(name, arguments.sample, Path(folder)) as database:
                rows.append(database_row(name, database))
    columns = ("database", "cells", "poses", "built", "sparsity %", "median", "LKS", "ssim", "worst", "l1")
    text = ["Spreadlets", table((*columns, "MB", "LKS MB", "s each"), rows)]
    print(text[-1], flush=True)
    if (arguments.frames / "coins_pinhole.exr").exists():
        found = []
        for name in MODELS:
            with open_database(name) as database:
                found += [frame_row(arguments.frames, scene, database) for scene in SCENES]
        columns = ("database", "scene", "ssim", "loss", "psnr", "points/px", "s", "dense s", "ratio")
        text += ["", "Frames against dense splatting of the same PSFs (s: splat and integrate)", table(columns, found)]
        print(text[-1])
    else:
        print(f"no frames in {arguments.frames}: the second table is left out")
    RESULTS.mkdir(exist_ok=True)
    (RESULTS / "models.txt").write_text("\n".join(text) + "\n")


if __name__ == "__main__":
    main()
