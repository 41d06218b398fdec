"""Every PSF model: sparsity and similarity of its spreadlets, size and build time, and images against dense splatting.

Databases that ship are read; of the full-size grid of ``physicallens``, 4,000 cells, a random sample is built. For the
sparsity at the similarity of LKS, a mean of .97, PSFs of grids up to a CoC of 256 px, which fill the window of LKS, are
sparsified at several prices of a point. Frames are read from ``--frames`` (default frames), or else
the small ones that ship. Writes models.txt, models_sparsity.txt and models_frames.txt to benchmarks/results. The model
``combined`` is the subject of spreadlet_quality.py and frames.py, too.

    python benchmarks/models.py [--frames DIR] [--sample N] [--cells N] [--scenes NAME ...] [--models NAME ...]
                                [--enlarged NAME ...]
"""

import itertools
import math
import tempfile
import time
import warnings
from pathlib import Path
from unittest.mock import patch

import numpy as np
from scenes import RESULTS, SCENES, Scene, result_path, scenes
from scenes import parser as frames_parser
from scipy import ndimage

import spreadlets as sp
from spreadlets.precompute.build.build import build_database
from spreadlets.precompute.models.grids import model_grid
from spreadlets.precompute.models.registry import trace_psf
from spreadlets.precompute.sparsify import direct, fitted
from spreadlets.precompute.sparsify.sparsify import sparsify
from spreadlets.psf.database import Database, open_database
from spreadlets.psf.model import PsfGrid
from spreadlets.runtime.options import Options
from spreadlets.runtime.render import synthesize

ROOT = Path(__file__).resolve().parent.parent
MODELS = ("simplelens", "combined", "physicallens", "volume", "stylized")
LKS_SPARSITY = {"simplelens": 31.3, "combined": 9.3, "physicallens": 2.2, "volume": 18.4, "stylized": 24.9}
LKS_MEGABYTES = {"simplelens": 1.1, "combined": 4.2, "physicallens": 30.8, "volume": 5.3, "stylized": 9.0}
"""LKS table 1: per cent, and MB."""

LENS = {"lens": "double_gauss", "width": 1024}
HEART = {"image": str(ROOT / "docs" / "models" / "heart.png"), "colour_offset": 0.06}
SAMPLED = {
    "physicallens": {"max_coc": 32.0, **LENS},
    "physicallens, CoC to 128": {"max_coc": 128.0, **LENS},
}
"""Databases of which a sample is built: their options."""

LKS_SIMILARITY = 0.97
LARGE_COC = 4.0
"""CoC radius, px: smaller PSFs are but a few pixels."""

DENSE_RAYS = 1_000_000
"""For the PSFs of dense splatting; those of large PSFs are more when a database is built."""

CPU_CORES = 2
"""Cores that the build time of a cell is given for."""

WIDE = {
    "simplelens": {},
    "combined": {"max_motion": 256.0},
    "stylized": HEART,
    "physicallens": {"lens": "singlet", "width": 1024, "camera": sp.ThinLens(50.0, 36.0, 5.0, 3.0)},
}
"""Grids up to a CoC of 256 px: their options. The lens is LKS's, a bi-convex singlet, wide open."""

PRICES = (0.125, 0.25, 0.5, 1.0, 2.0)
"""Loss of similarity for a sparsity that is lower by 1, in place of `precompute.sparsify.fitted.PRICE`."""

UNBOUND = {"WORST_LOSS": 0.2, "MISJUDGED_LOSS": 1.0, "WORST_L1": math.inf, "THIN_RADIUS": 0.0, "DIRECT_COST": 1.0}
UNBOUND_DIRECT = {"DIRECT_THRESHOLDS": (1e-3, 1e-2, 0.1), "MAX_LEFT_OUT": 1.0}
"""What takes the place of constants of `precompute.sparsify.fitted` and `direct`: points count alike, drawn directly or
not, and the mean alone counts, as in the figures of LKS."""

ENLARGED_DEPTH_STEP = 0.02
"""Relative difference of depths that are not on one surface."""

FRAME_COLUMNS = ("database", "scene", "ssim", "loss", "psnr", "points/px", "s", "dense s", "ratio")
FRAME_NOTE = """s: splat and integrate, of spreadlets and of the same PSFs drawn in full, pixel by pixel.
1024 px: the same frames, enlarged, for the width that the database is made for.
"""
SPREADLET_NOTE = """s each: the time of a pose; of a sample it is the processor's, of a database that ships what its
build recorded, on a machine that others used as well. MB: of a sample, for all its cells.
"""
SPARSITY_NOTE = """Grids up to a CoC of 256 px, every cell weighing the same; lens: singlet, 50 mm, f/5, focused at 3 m.
Sparsity, %, at a mean similarity of .97; then sparsity, %, and similarity at each price of a point.
"""


def sample(name: str, n: int, folder: Path) -> tuple[Database, float]:
    """Build a few random poses of a full-size grid; return them and the processor's time for each, seconds."""
    model, options = name.split(",")[0], dict(SAMPLED[name])
    if model == "physicallens":
        options["camera"] = sp.read_camera(ROOT / "psf_db" / "physicallens.json")
    grid = model_grid(model, **options)
    poses = [(cell, number) for cell in range(grid.n_cells) for number in range(int(grid.pose_counts[cell]))]
    chosen = np.random.default_rng(0).choice(len(poses), min(n, len(poses)), replace=False)
    path = folder / f"{name.replace(' ', '_')}.h5"
    begin = time.process_time()
    # Without what is drawn between the cells, which a build judges once, by as many traces again.
    build_database(model, path, only=[poses[i] for i in chosen], jobs=1, judge=False, **options)
    return open_database(path), (time.process_time() - begin) / len(chosen)


def database_row(name: str, database: Database, seconds: float | None = None) -> list[object]:
    """Return a row of the first table."""
    figures = database.summary()
    model = database.grid.model.name
    n_poses = int(database.grid.pose_counts.sum())
    share = figures["n_spreadlets"] / n_poses
    # The index tables do not shrink with a sample.
    points = sum(database._file[key].id.get_storage_size() for key in ("offset_rc", "value"))
    megabytes = (figures["size_bytes"] - points + points / share) / 1e6
    if seconds is None:
        seconds = figures["build_s"] / figures["n_spreadlets"]
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
        seconds * n_poses / figures["n_cells"] / CPU_CORES,
    ]


class DensePsfs:
    """The full PSFs of a database's cells, each traced once, with as many rays as an average over pixels needs."""

    by_rows = False

    def __init__(self, database: Database) -> None:
        self.database, self.known = database, {}

    def __call__(self, cell: int, pose: int, scale: float) -> np.ndarray:
        """Return the PSF of a pose, its parameters times a scale."""
        key = (cell, pose, scale)
        if key not in self.known:
            grid = self.database.grid
            stretch = np.array([[scale if axis.scales else 1.0] for axis in grid.model.axes])
            self.known[key] = trace_psf(
                grid.model,
                grid.box(cell) * stretch,
                angle=float(self.database.angles(cell)[pose]),
                angle_half_width=grid.angle_half_width(cell),
                side=grid.side(cell, pose),
                rays=DENSE_RAYS,
            )
        return self.known[key]


def enlarged(frame: sp.Frame) -> sp.Frame:
    """Return a frame of twice the width: colours and depths interpolated, but not across the edges of objects."""
    height, width = frame.shape
    place = [np.clip((np.arange(2 * size) - 0.5) / 2, 0, size - 1) for size in (height, width)]
    grid = np.meshgrid(*place, indexing="ij")
    nearest = tuple(np.rint(axis).astype(int) for axis in grid)
    inverse = 1.0 / frame.depth.astype(np.float64)
    smooth = ndimage.map_coordinates(inverse, grid, order=1)
    flat = np.abs(smooth - inverse[nearest]) < ENLARGED_DEPTH_STEP * inverse[nearest]
    radiance = np.stack([ndimage.map_coordinates(frame.radiance[..., c], grid, order=1) for c in range(4)], axis=2)
    with np.errstate(divide="ignore"):
        depth = 1.0 / np.where(flat, smooth, inverse[nearest])
    return sp.Frame(np.where(flat[..., None], radiance, frame.radiance[nearest]), depth)


def frame_row(scene: Scene, database: Database, dense_psf: DensePsfs, enlarge: bool) -> list[object]:
    """Return a row of the second table: spreadlets against dense splatting of the same PSFs."""
    frame, camera = scene.pinhole, scene.camera
    frame = enlarged(frame) if enlarge else frame
    with warnings.catch_warnings():
        # These scenes are in units of their own: the CoC is that of the frame's camera, the aberrations the lens's.
        warnings.simplefilter("ignore")
        sp.synthesize(frame, camera, database)
        image, report = sp.synthesize(frame, camera, database, report=True)
        dense, dense_report = synthesize(frame, camera, database, Options(method="dense"), dense_psf=dense_psf)
    figures = sp.metrics.compare(image, dense)
    splat, dense_splat = (each["time_s"]["splat"] + each["time_s"]["integrate"] for each in (report, dense_report))
    points = report["plan"]["points_splatted"] / frame.radiance[..., 0].size
    return [
        database.grid.model.name,
        f"{scene.name}, {frame.shape[1]} px",
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


def cell_psf(grid: PsfGrid, cell: int, number: int) -> np.ndarray:
    """Trace the PSF of one pose of a cell, as a build does."""
    return trace_psf(
        grid.model,
        grid.box(cell),
        angle=float(grid.angles(cell)[number]),
        angle_half_width=grid.angle_half_width(cell),
        side=grid.side(cell, number),
    )


def priced(grid: PsfGrid, cell: int, number: int) -> list[tuple[float, float, float]]:
    """Return sparsity, similarity and support of one pose at each price."""
    psf = cell_psf(grid, cell, number)
    found = []
    for price in PRICES:
        with patch.multiple(fitted, PRICE=price, **UNBOUND), patch.multiple(direct, **UNBOUND_DIRECT):
            figures = sparsify(psf)[1]
        found.append((figures["sparsity"], figures["ssim"], figures["n_support"]))
    return found


def sparsity_rows(name: str, n_cells: int) -> list[list[object]]:
    """Return the rows of one model in the table of sparsity at equal similarity: all cells, and those of large CoC."""
    grid = model_grid(name, max_coc=256.0, **WIDE[name])
    rng = np.random.default_rng(0)
    cells = np.sort(rng.choice(grid.n_cells, min(n_cells, grid.n_cells), replace=False))
    figures = np.array([priced(grid, int(cell), int(rng.integers(grid.pose_counts[cell]))) for cell in cells])
    large = np.array([grid.coordinate(int(cell))[0] >= LARGE_COC for cell in cells])
    asked = 2.0 / 3.0 * LKS_SPARSITY[name]
    rows: list[list[object]] = []
    for kind, chosen in (("all", np.ones(len(cells), np.bool_)), (f"CoC >= {LARGE_COC:g} px", large)):
        sparsity, similarity, support = figures[chosen].mean(axis=0).T
        curve = [f"{100 * x:.1f}/{y:.3f}" for x, y in zip(sparsity, similarity, strict=True)]
        at = 100 * float(np.interp(LKS_SIMILARITY, similarity[::-1], sparsity[::-1]))
        reached = f"{at:.1f}" if similarity.max() >= LKS_SIMILARITY else "-"
        rows.append([name, kind, int(chosen.sum()), int(support[0]), reached, LKS_SPARSITY[name], asked, *curve])
    return rows


def sparsity_table(n_cells: int) -> str:
    """Return the table of sparsity at equal similarity."""
    rows = []
    for name in WIDE:
        rows += sparsity_rows(name, n_cells)
        print(*rows[-2:], sep="\n", flush=True)
    columns = ("model", "cells", "measured", "support px", f"% at {LKS_SIMILARITY}", "LKS", "asked")
    return table((*columns, *(f"price {price:g}" for price in PRICES)), rows)


def spreadlet_table(n_sampled: int) -> str:
    """Return the first table: every model's spreadlets."""
    rows = []
    for name in MODELS:
        if name not in SAMPLED:
            with open_database(name) as database:
                rows.append(database_row(name, database))
    with tempfile.TemporaryDirectory() as folder:
        for name in SAMPLED:
            database, seconds = sample(name, n_sampled, Path(folder))
            with database:
                rows.append(database_row(name, database, seconds))
            print(rows[-1], flush=True)
    columns = ("database", "cells", "poses", "built", "sparsity %", "median", "LKS", "ssim", "worst", "l1")
    return table((*columns, "MB", "LKS MB", "s each", "s per cell, 2 cores"), rows)


def frame_table(found: list[Scene], names: list[str], larger: list[str]) -> str:
    """Return the table of images against dense splatting of the same PSFs; it is written as it grows.

    Those of some models are also drawn at twice the width.
    """
    rows: list[list[object]] = []
    text = ""
    for name in names:
        with open_database(name) as database:
            traced = DensePsfs(database)
            sizes = (False, True) if name in larger else (False,)
            for enlarge, scene in itertools.product(sizes, found):
                rows.append(frame_row(scene, database, traced, enlarge))
                text = table(FRAME_COLUMNS, rows)
                result_path("models_frames.txt").write_text(FRAME_NOTE + text + "\n")
    return text


def main() -> None:
    parser = frames_parser(__doc__)
    parser.add_argument("--sample", type=int, default=24, help="poses of each sampled database; 0: no such table")
    parser.add_argument("--cells", type=int, default=40, help="cells of each wide grid; 0: no such table")
    parser.add_argument("--scenes", nargs="*", default=list(SCENES))
    parser.add_argument("--models", nargs="*", default=[name for name in MODELS if name != "combined"])
    parser.add_argument("--enlarged", nargs="*", default=["physicallens"], help="models drawn at 1024 px, too")
    arguments = parser.parse_args()
    RESULTS.mkdir(exist_ok=True)
    if arguments.sample:
        text = spreadlet_table(arguments.sample)
        print(text)
        (RESULTS / "models.txt").write_text(SPREADLET_NOTE + text + "\n")
    if arguments.cells:
        text = sparsity_table(arguments.cells)
        print(text)
        (RESULTS / "models_sparsity.txt").write_text(SPARSITY_NOTE + text + "\n")
    if arguments.models:
        found = [scene for scene in scenes(arguments.frames, "_pinhole.exr") if scene.name in arguments.scenes]
        text = frame_table(found, arguments.models, arguments.enlarged)
        print(text)


if __name__ == "__main__":
    main()
