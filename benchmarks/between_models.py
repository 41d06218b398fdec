"""LKS figure 10 e for each model: what is drawn between the cells, by how many cells there are.

    python benchmarks/between_models.py [--models NAME ...]

A pixel's PSF lies anywhere in the space of its model, and is drawn with the spreadlet of the nearest cell: the more
cells, the more alike they are. Grids have the options of the databases that ship (`make databases`). Of each only those
spreadlets are made that random coordinates fall on. What ships is added as its build recorded it, with 1000 coordinates
(64 where the exact PSF must be traced).

Given is the similarity to the exact PSF, of dim pixels, which are drawn with the spreadlet of their cell, and of
highlights, which are drawn with PSFs of their own. Takes a quarter of an hour on one core. Writes between_models.txt to
benchmarks/results; models that are not asked for keep their rows there.
"""

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from unittest.mock import patch

from models import cell_psf
from scenes import Report, result_path

import spreadlets as sp
from spreadlets.precompute.build import between_cells
from spreadlets.precompute.models.grids import model_grid
from spreadlets.precompute.sparsify.sparsify import sparsify
from spreadlets.psf.model import PsfGrid
from spreadlets.psf.spreadlet import Spreadlet

ROOT = Path(__file__).resolve().parent.parent
HEART = ROOT / "docs" / "models" / "heart.png"
CAMERA = ROOT / "psf_db" / "physicallens.json"
GRIDS: Mapping[str, tuple[int, ...]] = {
    "simplelens": (25, 100),
    "combined": (25, 100, 400),
    "stylized": (25, 100),
    "volume": (2, 6, 25),
    "physicallens": (32, 125, 4000),
}
"""Numbers of cells that are asked for, beside those that ship; grids have about as many. 4000 are LKS's."""
COORDINATES: Mapping[str, int] = {
    "simplelens": 1000,
    "combined": 40,
    "stylized": 1000,
    "volume": 16,
    "physicallens": 40,
}
"""How many random ones; fewer where each falls on a cell and direction of its own, or its exact PSF must be traced."""
COLUMNS = "dim", "CoC >= 4", "worst 1 %", "highlights", "coordinates"


class Spreadlets:
    """The spreadlets of a grid, each made when it is first asked for, as a build makes it."""

    def __init__(self, grid: PsfGrid) -> None:
        self.grid, self.known = grid, dict[tuple[int, int], Spreadlet]()

    def __call__(self, cell: int, pose: int) -> Spreadlet:
        """Return the spreadlet of a cell and pose."""
        if (cell, pose) not in self.known:
            psf = cell_psf(self.grid, cell, pose)
            self.known[cell, pose] = sparsify(psf)[0]
        return self.known[cell, pose]


def options(name: str) -> dict[str, Any]:
    """Return the options of a grid, as those of the database that ships."""
    return {
        "stylized": {"image": str(HEART), "colour_offset": 0.06},
        "volume": {"width": 512},
        "physicallens": {"camera": sp.read_camera(CAMERA), "width": 1024, "max_coc": 32.0},
    }.get(name, {})


def add_row(report: Report, label: str, found: Mapping[str, Any]) -> None:
    """Add the row of what `precompute.build.between_cells` found."""
    dim, highlight = found["dim"], found["highlight"]
    large = f"{dim['mean_large']:.4f}" if "mean_large" in dim else "-"
    report.row(label, dim["mean"], large, dim["percentile_1"], highlight["mean"], found["coordinates"])


def judged(grid: PsfGrid, count: int) -> dict[str, Any]:
    """Compare what a grid's cells draw at some random coordinates to the exact PSFs there."""
    with patch.multiple(between_cells, N_COORDINATES=count, N_TRACED=count):
        return between_cells.between_cells(grid, Spreadlets(grid))


def add_model(report: Report, name: str) -> None:
    """Add the rows of a model, fewest cells first."""
    with sp.open_database(name) as database:
        summary = database.summary()
    grids = [model_grid(name, samples=count, **options(name)) for count in GRIDS[name]]
    fewer = [grid for grid in grids if grid.n_cells < summary["n_cells"]]
    for grid in fewer:
        add_row(report, f"{name}, {grid.n_cells}", judged(grid, COORDINATES[name]))
    add_row(report, f"{name}, {summary['n_cells']}, ships", summary["between_cells"])
    for grid in grids[len(fewer) :]:
        add_row(report, f"{name}, {grid.n_cells}", judged(grid, COORDINATES[name]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--models", nargs="+", choices=GRIDS, default=list(GRIDS))
    given, report = parser.parse_args(), Report()
    path = result_path("between_models.txt")
    kept = path.read_text().splitlines()[1:] if path.exists() else []
    report.row("model, cells", *COLUMNS)
    for name in GRIDS:
        if name in given.models:
            add_model(report, name)
        else:
            for line in kept:
                if line.startswith(f"{name},"):
                    report.add(line)
    report.save("between_models.txt")


if __name__ == "__main__":
    main()
