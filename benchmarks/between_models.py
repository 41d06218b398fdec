"""LKS figure 10 e for each model: what is drawn between the cells, by how many cells there are.

    python benchmarks/between_models.py [--models NAME ...]

Builds databases of few cells, with the options of those that ship (`make databases`), and adds those that ship. Given
is the similarity to the exact PSF at 1000 random coordinates (64 where it must be traced) that each build records: of
dim pixels, which are drawn with the spreadlet of their cell, and of highlights, which are drawn with PSFs of their own.
Takes half an hour on two cores. Writes between_models.txt to benchmarks/results.
"""

import argparse
import tempfile
from collections.abc import Mapping
from pathlib import Path

from scenes import Report

import spreadlets as sp

ROOT = Path(__file__).resolve().parent.parent
HEART = ROOT / "docs" / "models" / "heart.png"
CAMERA = ROOT / "psf_db" / "physicallens.json"
FEW: Mapping[str, tuple[int, ...]] = {
    "simplelens": (25, 100),
    "combined": (25, 100),
    "stylized": (25, 100),
    "volume": (25, 100),
    "physicallens": (32, 125),
}
"""Numbers of cells that are asked for; grids have about as many."""


def options(name: str) -> dict[str, object]:
    """Return the options of a build, as those of the database that ships."""
    return {
        "stylized": {"image": str(HEART), "colour_offset": 0.06},
        "volume": {"width": 512},
        "physicallens": {"camera": sp.read_camera(CAMERA), "width": 1024, "max_coc": 32.0},
    }.get(name, {})


def row(report: Report, name: str, path: str | Path) -> None:
    """Add the row of a database."""
    with sp.open_database(path) as database:
        summary = database.summary()
    found = summary["between_cells"]
    dim, highlight = found["dim"], found["highlight"]
    large = f"{dim['mean_large']:.4f}" if "mean_large" in dim else "-"
    report.row(f"{name}, {summary['n_cells']}", dim["mean"], large, dim["percentile_1"], highlight["mean"])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--models", nargs="+", choices=FEW, default=list(FEW))
    given, report = parser.parse_args(), Report()
    report.row("model, cells", "dim", "CoC >= 4", "worst 1 %", "highlights")
    for name in given.models:
        for count in FEW[name]:
            with tempfile.TemporaryDirectory() as folder:
                path = Path(folder) / "few.h5"
                sp.build_database(name, path, samples=count, **options(name))
                row(report, name, path)
        row(report, name, name)
    report.save("between_models.txt")


if __name__ == "__main__":
    main()
