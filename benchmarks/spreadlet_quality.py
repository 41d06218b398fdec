"""How good and how sparse spreadlets are: one table beside the figures of LKS section 7.3, and its curves.

    python benchmarks/spreadlet_quality.py [PART ...] [--quick] [--results FOLDER]

LKS is Laplacian Kernel Splatting (Leimkuehler, Seidel, Ritschel 2018). The whole run takes about 20 minutes on two
cores. Each part can be run alone; it replaces its own section of spreadlet_quality.txt and its own pictures in
benchmarks/results. --quick tries every part on few PSFs and writes to a temporary folder.

Similarity is `spreadlets.metrics.psf_similarity`: SSIM over the PSF's box and a margin. Sparsity is points over pixels
above 1e-4 of the peak. *As drawn*, a cell has the points that the renderer draws for it: those of the Laplacian, or the
PSF's own pixels, whichever are stored. *Every cell sparsified*, it has those of the Laplacian in any case. Each cell
counts once, in the reference direction. Unless a row says otherwise, a PSF is that of the combined model, CoC to
100 px, motion to 256 px, 400 cells, direction 0, density 1.
"""

from __future__ import annotations

import argparse
import math
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

import joblib
import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from skimage.metrics import structural_similarity

import spreadlets as sp
from spreadlets.metrics import PSF_MARGIN_FRACTION, PSF_MARGIN_PX, psf_l1, psf_similarity
from spreadlets.precompute.build.work import CellTask, build_unit, plan_units
from spreadlets.precompute.models.registry import trace_psf
from spreadlets.precompute.sparsify import fitted
from spreadlets.precompute.sparsify.annealing import anneal
from spreadlets.precompute.sparsify.dart_throwing import throw_darts
from spreadlets.precompute.sparsify.fit import fit_values
from spreadlets.precompute.sparsify.green import reconstruct
from spreadlets.precompute.sparsify.lloyd import collapse, relax
from spreadlets.precompute.sparsify.sparsify import DEFAULT_SPARSIFIER, SPARSIFIERS, sparsify
from spreadlets.psf.laplacian import laplacian
from spreadlets.psf.model import PsfGrid, get_model
from spreadlets.psf.spreadlet import Spreadlet

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))
from naive import psfs  # noqa: E402  (the analytic PSFs live with the tests)

RESULTS = ROOT / "benchmarks" / "results"
NAME = "spreadlet_quality"
SEED = 7
PROCESSES = 2
MAX_COC, MAX_MOTION, N_CELLS = 100.0, 256.0, 400
DENSITIES = (0.5, 1.0, 2.0)
SSIM_OPTIONS = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False, "data_range": 1.0}
LKS_WINDOW = 512
"""Side of the window in which LKS measures similarity, px."""

LARGE_COC = 4.0
"""CoC radius, px, from which the worst cell and the tracer are judged: smaller PSFs are but a few pixels."""

LKS_SPARSITY, LKS_SIMILARITY = 0.093, 0.97
LKS_QUADTREE = 0.89

COC_BANDS = (0.0, 2.0, 4.0, 8.0, 16.0, 100.0)
"""CoC radii, px, between which means are also shown."""

SHOWN_SIMILARITY = 0.8
"""Least similarity of the histogram."""


class Effort(NamedTuple):
    """How many PSFs the parts look at."""

    cells: int
    """Of the 400, for the corpus; spread evenly."""
    angles: int
    coordinates: int
    grids: tuple[int, ...]
    """Cell counts of the grids that random coordinates are looked up in."""
    ablated: int
    built: int
    shape_densities: tuple[float, ...]


FULL = Effort(400, 200, 1000, (100, 400, 1600), 40, 60, (0.25, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8))
QUICK = Effort(24, 8, 16, (16, 64), 3, 4, (0.5, 1.0))


class Row(NamedTuple):
    """One line of the table."""

    figure: str
    lks: str
    asked: str
    measured: str


class Made(NamedTuple):
    """A spreadlet and the figures that its making gave."""

    spreadlet: Spreadlet
    figures: dict[str, float]


# --- PSFs and spreadlets ---------------------------------------------------------------------------------------------


def grid_of(n_cells: int = N_CELLS) -> PsfGrid:
    return PsfGrid.of(get_model("combined", MAX_COC, MAX_MOTION), n_cells)


def parallel(function: Callable[..., Any], arguments: Iterable[tuple[Any, ...]]) -> list[Any]:
    """Call a function in two processes, each with one thread."""
    return list(joblib.Parallel(n_jobs=PROCESSES)(joblib.delayed(function)(*some) for some in arguments))


def cell_psf(grid: PsfGrid, cell: int, number: int = 0, prefilter: bool = True) -> np.ndarray:
    """Trace a cell's PSF as a build does; without pre-filter at the midpoint of the cell's box."""
    angle = float(grid.angles(cell)[number])
    seed = int(np.random.SeedSequence((SEED, cell, number)).generate_state(1)[0])
    if prefilter:
        width = grid.angle_half_width(cell)
        return trace_psf(grid.model, grid.box(cell), angle=angle, angle_half_width=width, seed=seed)
    return exact_psf(grid.coordinate(cell), angle)


def exact_psf(coordinate: Sequence[float], angle: float = 0.0) -> np.ndarray:
    """Trace the PSF of one CoC radius, one motion and one direction."""
    box = np.repeat(np.asarray(coordinate, dtype=np.float64)[:, None], 2, axis=1)
    return trace_psf(grid_of().model, box, angle=angle)


def make(n_cells: int, cell: int, number: int = 0, density: float = 1.0, prefilter: bool = True) -> Made:
    return Made(*sparsify(cell_psf(grid_of(n_cells), cell, number, prefilter), density=density, seed=SEED))


def draw(spreadlet: Spreadlet, half: Sequence[int]) -> np.ndarray:
    """Return what a spreadlet stands for on a window of such half-sizes, which must hold its points."""
    shape = (2 * int(half[0]) + 1, 2 * int(half[1]) + 1)
    offset, value = spreadlet.offset_rc.astype(np.int64), spreadlet.value.astype(np.float64)
    if not spreadlet.direct:
        return reconstruct(offset, value, shape)
    image = np.zeros((*shape, spreadlet.n_channels))
    row, col = (offset + np.asarray(shape) // 2).T
    image[row, col] = value
    return image


def framed(psf: np.ndarray, half: Sequence[int] = (0, 0)) -> np.ndarray:
    """Pad a centred PSF by the margin of its similarity, and to at least these half-sizes."""
    own = np.asarray(psf.shape[:2]) // 2
    margin = np.maximum(PSF_MARGIN_PX, np.ceil(PSF_MARGIN_FRACTION * (2 * own + 1))).astype(int)
    pad = np.maximum(own + margin, half) - own
    return np.pad(psf, [(pad[0],) * 2, (pad[1],) * 2, (0, 0)])


def similarity(psf: np.ndarray, spreadlet: Spreadlet) -> float:
    window = framed(psf, spreadlet.extent)
    return psf_similarity(window, draw(spreadlet, np.asarray(window.shape[:2]) // 2))


def window_similarity(psf: np.ndarray, spreadlet: Spreadlet) -> float:
    """Return the SSIM over LKS's whole window, both scaled by the PSF's peak."""
    half = LKS_WINDOW // 2
    window = framed(psf, (half, half))
    cut = [slice(n // 2 - half, n // 2 + half) for n in window.shape[:2]]
    pair = (window, draw(spreadlet, np.asarray(window.shape[:2]) // 2))
    true, drawn = (image[cut[0], cut[1], 0] / psf.max() for image in pair)
    return float(structural_similarity(true, drawn, **SSIM_OPTIONS))


def sample(count: int, size: int, part: str) -> np.ndarray:
    """Choose ``count`` of ``size`` at random, seeded by the part's name."""
    return np.sort(generator(part).permutation(size)[:count])


def generator(part: str) -> np.random.Generator:
    return np.random.default_rng([SEED, *part.encode()])


def pair(similarity: float, sparsity: float) -> str:
    return f"{similarity:.4f} / {100 * sparsity:.2f} %"


# --- The corpus: every cell's first direction ------------------------------------------------------------------------


class Measured(NamedTuple):
    """What is known of one cell at one density."""

    direct: bool
    points: int
    support: int
    similarity: float
    window: float
    forced_points: int
    """Points and similarity where no PSF may be stored as its own pixels."""
    forced_similarity: float
    quadtree: float


def measure_cell(cell: int) -> list[Measured]:
    """Measure a cell at each of the densities."""
    psf = cell_psf(grid_of(), cell)
    return [measure_psf(psf, density) for density in DENSITIES]


def measure_psf(psf: np.ndarray, density: float) -> Measured:
    stored, figures = sparsify(psf, density=density, seed=SEED)
    forced = forced_sparse(psf, density) if stored.direct else stored
    close = similarity(psf, stored)
    return Measured(
        direct=stored.direct,
        points=stored.n_points,
        support=int(figures["n_support"]),
        similarity=close,
        window=window_similarity(psf, stored) if density == 1.0 else math.nan,
        forced_points=forced.n_points,
        forced_similarity=similarity(psf, forced) if forced is not stored else close,
        quadtree=psf_similarity(*quadtree_pair(psf, stored.n_points)) if density == 1.0 else math.nan,
    )


def forced_sparse(psf: np.ndarray, density: float) -> Spreadlet:
    """Sparsify a PSF's Laplacian even if its own pixels are cheaper."""
    with patch.multiple(fitted, THIN_RADIUS=0.0, direct_choices=lambda psf: iter(())):
        return sparsify(psf, density=density, seed=SEED)[0]


def quadtree_pair(psf: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a PSF and what its ``count`` largest Haar coefficients give, on the smallest window of 2^n px."""
    window = framed(psf)
    side = 1 << int(max(window.shape[:2]) - 1).bit_length()
    window = np.pad(window[..., 0], [(0, side - n) for n in window.shape[:2]])
    coefficient = haar(window)
    kept = np.argsort(np.abs(coefficient), axis=None)[-count:]
    sparse = np.zeros(coefficient.size)
    sparse[kept] = coefficient.ravel()[kept]
    return window, inverse_haar(sparse.reshape(coefficient.shape))


def haar(image: np.ndarray) -> np.ndarray:
    """Return the orthonormal two-dimensional Haar transform, level by level as in a quad-tree."""
    out = image.copy()
    side = len(out)
    while side > 1:
        part = out[:side, :side]
        for _ in range(2):
            part = part.T
            part[:] = np.concatenate([part[::2] + part[1::2], part[::2] - part[1::2]]) * math.sqrt(0.5)
        side //= 2
    return out


def inverse_haar(coefficient: np.ndarray) -> np.ndarray:
    out = coefficient.copy()
    side = 2
    while side <= len(out):
        part = out[:side, :side]
        for _ in range(2):
            part = part.T
            low, high = part[: side // 2].copy(), part[side // 2 :].copy()
            part[::2], part[1::2] = (low + high) * math.sqrt(0.5), (low - high) * math.sqrt(0.5)
        side *= 2
    return out


ASKED_PAIR = {0.5: "-", 1.0: ">= .97 / <= 9.3 %", 2.0: "-"}
LKS_PAIR = {0.5: "-", 1.0: ".97 / 9.3 %", 2.0: "-"}


def corpus(effort: Effort, folder: Path) -> list[Row]:
    """LKS Fig. 10 a to d: mean similarity and sparsity, the worst cell, the quad-tree, three operating points."""
    cells = np.unique(np.linspace(0, N_CELLS - 1, effort.cells).round().astype(int))
    grid = grid_of()
    large = np.array([grid.coordinate(cell)[0] >= LARGE_COC for cell in cells])
    kept = {}
    measured = parallel(measure_cell, [(int(cell),) for cell in cells])
    for number, density in enumerate(DENSITIES):
        c = {name: np.array([getattr(m[number], name) for m in measured]) for name in Measured._fields}
        c["sparsity"], c["forced_sparsity"] = c["points"] / c["support"], c["forced_points"] / c["support"]
        kept[density] = c
    always = np.all([~c["direct"] for c in kept.values()], axis=0)
    plot_corpus(kept, always, folder)
    rows = [row for density in DENSITIES for row in operating_rows(density, kept[density], large, always)]
    return rows + single_rows(kept[1.0], cells, large)


def operating_rows(density: float, c: dict[str, np.ndarray], large: np.ndarray, always: np.ndarray) -> list[Row]:
    """Return the rows of one operating point; ``always`` tells the cells that are sparse at each of them."""
    every = np.full(len(large), True)
    direct = c["direct"]
    as_one = np.where(direct, 1.0, c["similarity"]), np.where(direct, 1.0, c["sparsity"])
    pairs = {
        f"density {density:g}: similarity / sparsity, means, every cell sparsified": means(c, every, "forced_"),
        "  direct cells counted as similarity 1, sparsity 1": (as_one[0].mean(), as_one[1].mean()),
        "  as drawn": means(c, every),
        f"  the {np.sum(~direct)} cells of {len(direct)} that are stored sparse": means(c, ~direct),
        f"  the {always.sum()} cells that are stored sparse at every density": means(c, always),
        f"  CoC >= 4 px, every cell sparsified ({large.sum()} cells)": means(c, large, "forced_"),
    }
    rows = [Row(name, LKS_PAIR[density], ASKED_PAIR[density], pair(*means)) for name, means in pairs.items()]
    efficient = [f"{a / b:.1f}" for a, b in pairs.values()]
    points, support = c["forced_points"].sum(), c["support"].sum()
    return [
        *rows,
        Row(
            "  efficiency, similarity / sparsity, of these six", "10.4 to 10.75", ">= 16 (aim 21)", ", ".join(efficient)
        ),
        Row(
            "  all points over all pixels of all supports, every cell sparsified",
            "-",
            "-",
            f"{100 * points / support:.2f} %",
        ),
    ]


def means(c: dict[str, np.ndarray], chosen: np.ndarray, kind: str = "") -> tuple[float, float]:
    return float(c[kind + "similarity"][chosen].mean()), float(c[kind + "sparsity"][chosen].mean())


def single_rows(c: dict[str, np.ndarray], cells: np.ndarray, large: np.ndarray) -> list[Row]:
    """Return the rows of density 1 alone."""
    worst = np.flatnonzero(large)[np.argmin(c["similarity"][large])]
    coordinate = grid_of().coordinate(int(cells[worst])).round(1).tolist()
    place = f"{c['similarity'][worst]:.4f} (cell {cells[worst]}: CoC, motion {coordinate} px)"
    sparse = ~c["direct"]
    trees = f"{c['quadtree'].mean():.4f} (as drawn {c['similarity'].mean():.4f}); cells stored sparse "
    trees += f"{c['quadtree'][sparse].mean():.4f} ({c['similarity'][sparse].mean():.4f})"
    whole = f"{c['window'].mean():.4f} (over the box and margin {c['similarity'].mean():.4f})"
    return [
        *band_rows(c, cells),
        Row("density 1: similarity over the whole 512 x 512 px window, as drawn", ".97", "-", whole),
        Row("worst cell's similarity, CoC >= 4 px", "-", ">= .93", place),
        Row("quad-tree (Haar) of as many coefficients: mean similarity", ".89", "-", trees),
    ]


def band_rows(c: dict[str, np.ndarray], cells: np.ndarray) -> list[Row]:
    radius = np.array([grid_of().coordinate(cell)[0] for cell in cells])
    rows = []
    for low, high in zip(COC_BANDS[:-1], COC_BANDS[1:], strict=True):
        band = (radius >= low) & (radius < high)
        if band.any():
            name = f"density 1: {band.sum()} cells of CoC {low:g} to {high:g} px, every cell sparsified; as drawn"
            rows.append(Row(name, "-", "-", f"{pair(*means(c, band, 'forced_'))}; {pair(*means(c, band))}"))
    return rows


def plot_corpus(kept: dict[float, dict[str, np.ndarray]], always: np.ndarray, folder: Path) -> None:
    figure, axes = plt.subplots(1, 3, figsize=(12, 3.6), layout="constrained")
    c, sparse = kept[1.0], ~kept[1.0]["direct"]
    points = np.array([means(some, always)[::-1] for some in kept.values()])
    axes[0].plot(*points.T, "C0o-")
    for density, point in zip(kept, points, strict=True):
        axes[0].annotate(f"{density:g}", point, xytext=(4, -12), textcoords="offset points")
    axes[0].plot(points[1, 0], c["quadtree"][always].mean(), "C1s", label="quad-tree, equal points")
    axes[0].plot(LKS_SPARSITY, LKS_SIMILARITY, "k^", label="LKS")
    axes[0].plot(LKS_SPARSITY, LKS_QUADTREE, "kv", label="LKS's quad-tree")
    axes[0].set(xlabel="mean sparsity", ylabel="mean similarity", title="Cells sparse at every density", xlim=(0, None))
    axes[0].legend()
    groups = [c["sparsity"][sparse], c["sparsity"][~sparse]]
    axes[1].hist(groups, np.linspace(0, 1, 41), stacked=True, label=["stored sparse", "stored direct"])
    axes[1].set(xlabel="sparsity", ylabel="cells", title="Density 1")
    axes[1].legend()
    clipped = [np.maximum(c[name], SHOWN_SIMILARITY) for name in ("similarity", "quadtree")]
    axes[2].hist(clipped, np.linspace(SHOWN_SIMILARITY, 1, 41), label=["stored", "quad-tree"])
    axes[2].set(xlabel=f"similarity (below {SHOWN_SIMILARITY:g}: in the first bin)", ylabel="cells", title="Density 1")
    axes[2].legend()
    save(figure, folder, "corpus")


# --- Directions ------------------------------------------------------------------------------------------------------


WORST_DIRECTION_LOSS = 0.02


def direction_loss(cell: int, angle: float) -> float:
    """Return the similarity at the reference direction less that at an angle, both against the exact direction."""
    grid, scores = grid_of(), []
    for wanted in (0.0, angle):
        number, transpose, flip_row, flip_col = (x.item() for x in grid.nearest_pose(cell, wanted))
        stored = make(N_CELLS, cell, number).spreadlet
        turned = stored.transformed(transpose=transpose, flip_row=flip_row, flip_col=flip_col)
        scores.append(similarity(trace_psf(grid.model, grid.box(cell), angle=wanted), turned))
    return scores[0] - scores[1]


def directions(effort: Effort, folder: Path) -> list[Row]:
    """Similarity in a random direction against that in the reference direction."""
    rng = generator("directions")
    cells = rng.integers(0, N_CELLS, effort.angles)
    angles = rng.uniform(-math.pi, math.pi, effort.angles)
    loss = np.array(parallel(direction_loss, zip(cells.tolist(), angles.tolist(), strict=True)))
    worst = int(np.argmax(loss))
    place = f"cell {cells[worst]}: CoC, motion {grid_of().coordinate(int(cells[worst])).round(1).tolist()} px"
    large = np.array([grid_of().coordinate(int(cell))[0] >= LARGE_COC for cell in cells])
    name = f"similarity lost in {effort.angles} random (cell, direction): mean / worst"
    few = f"  the same, the {large.sum()} of CoC >= 4 px"
    high = np.sum(loss > WORST_DIRECTION_LOSS)
    return [
        Row(name, "-", "<= .005 / <= .02", f"{loss.mean():.4f} / {loss.max():.4f} ({place}; {high} above .02)"),
        Row(few, "-", "<= .005 / <= .02", f"{loss[large].mean():.4f} / {loss[large].max():.4f}"),
    ]


# --- Random coordinates ----------------------------------------------------------------------------------------------


def coordinate_scores(coordinate: np.ndarray, candidates: list[Spreadlet]) -> list[float]:
    psf = exact_psf(coordinate)
    return [similarity(psf, spreadlet) for spreadlet in candidates]


def coordinates(effort: Effort, folder: Path) -> list[Row]:
    """LKS Fig. 10 e: the nearest cell's spreadlet against the exact PSF at random coordinates."""
    grid = grid_of()
    fraction = generator("coordinates").random((effort.coordinates, 2))
    places = grid.maximum * (grid.first + (1.0 - grid.first) * fraction) ** grid.power
    columns = []
    for n_cells in effort.grids:
        cells = grid_of(n_cells).find(places)
        distinct, index = np.unique(cells, return_inverse=True)
        for prefilter in (True, False):
            made = parallel(make, [(n_cells, int(cell), 0, 1.0, prefilter) for cell in distinct])
            columns.append([made[i].spreadlet for i in index])
    scores = np.array(parallel(coordinate_scores, zip(places, map(list, zip(*columns, strict=True)), strict=True)))
    curves = scores.mean(axis=0).reshape(-1, 2)
    large = scores[places[:, 0] >= LARGE_COC].mean(axis=0).reshape(-1, 2)
    plot_coordinates(effort.grids, curves, large, folder)
    rows = []
    for n_cells, mean, some in zip(effort.grids, curves, large, strict=True):
        asked = "rising with cells"
        for i, name in enumerate(("pre-filtered", "no pre-filter")):
            figure = f"{effort.coordinates} random coordinates, {grid_of(n_cells).n_cells} cells, {name}"
            rows.append(Row(figure, "rising curve", asked, f"{mean[i]:.4f} (CoC >= 4 px: {some[i]:.4f})"))
    return rows


def plot_coordinates(grids: Sequence[int], curves: np.ndarray, large: np.ndarray, folder: Path) -> None:
    figure, axis = plt.subplots(figsize=(5, 3.6), layout="constrained")
    for i, name in enumerate(("pre-filtered", "no pre-filter")):
        axis.semilogx(grids, curves[:, i], f"C{i}o-", label=name)
        axis.semilogx(grids, large[:, i], f"C{i}o:", label=f"{name}, CoC >= 4 px")
    axis.set(xlabel="cells", ylabel="mean similarity to the exact PSF", xticks=grids, xticklabels=grids)
    axis.minorticks_off()
    axis.legend()
    save(figure, folder, "coordinates")


# --- The stages of sparsification -------------------------------------------------------------------------------------


STAGES = {  # name: LKS's figure, what is asked
    "dart throwing": ("100 %", "100 %"),
    "+ Lloyd": ("96.7 %", "same row"),
    "dart throwing + annealing": ("87.1 %", "same row"),
    "dart throwing + Lloyd + annealing": ("86.5 %", "same row"),
    "dart throwing, values fitted": ("-", "< 25 %"),
    "dart throwing + Lloyd, values fitted": ("-", "< 25 %"),
    "dart throwing + Lloyd + annealing, values fitted": ("-", "< 25 %"),
    "fit: dart throwing + Lloyd where candidates are many, elimination": ("-", "< 25 %"),
    "fit, whole: + annealing under the fit": ("-", "< 25 %"),
}
DART_TRIES = 4


def stage_errors(cell: int) -> tuple[list[tuple[float, float]], list[int]] | None:
    """Return L1 error, similarity and number of points of each stage at about equal numbers; None for a direct cell."""
    psf = cell_psf(grid_of(), cell)
    final = sparsify(psf, seed=SEED)[0]
    if final.direct:
        return None
    window = framed(psf, np.asarray(final.extent) + 1)
    dense = laplacian(window)[1:-1, 1:-1]
    importance = np.abs(dense).max(axis=2)
    rng = np.random.default_rng((SEED, cell))
    darts = as_many_darts(importance, final.n_points, rng)
    relaxed = relax(importance, darts)
    annealed = anneal(window, dense, darts, rng)
    both = anneal(window, dense, relaxed, rng)
    half = np.asarray(window.shape[:2]) // 2
    sums = [(points, collapse(dense, points)) for points in (darts, relaxed, annealed, both)]
    fits = [(points, fit_values(window, points - half)) for points in (darts, relaxed, both)]
    with patch.object(fitted, "anneal_fitted", lambda equations, near, index, rng: index):
        eliminated = sparsify(psf, seed=SEED)[0]
    drawn = [reconstruct(points - half, value, window.shape[:2]) for points, value in sums + fits]
    drawn += [draw(each, half) for each in (eliminated, final)]
    counts = [len(points) for points, _ in sums + fits] + [eliminated.n_points, final.n_points]
    return [(psf_l1(window, image), psf_similarity(window, image)) for image in drawn], counts


def as_many_darts(importance: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """Throw darts a few times, to come as near as one can to a number of points."""
    tries, wanted = [], float(count)
    for _ in range(DART_TRIES):
        tries.append(throw_darts(importance, wanted, rng))
        wanted *= count / len(tries[-1])
    return min(tries, key=lambda points: abs(len(points) - count))


def ablation(effort: Effort, folder: Path) -> list[Row]:
    """LKS section 7.3, Optimization: mean L1 error relative to dart throwing alone."""
    results = []
    order = generator("ablation").permutation(N_CELLS)
    # Direct cells are skipped, so that somewhat more cells are tried than wanted.
    for begin in range(0, N_CELLS, effort.ablated):
        batch = order[begin : begin + effort.ablated]
        results += [result for result in parallel(stage_errors, [(int(cell),) for cell in batch]) if result]
        if len(results) >= effort.ablated:
            break
    figures, counts = (np.array(column) for column in zip(*results[: effort.ablated], strict=True))
    errors, similarities = figures.mean(axis=0).T
    relative = errors / errors[0]
    rows = [Row(f"mean L1 error of {len(figures)} sparse cells relative to dart throwing:", "", "", "")]
    for i, (name, (lks, asked)) in enumerate(STAGES.items()):
        found = f"{100 * relative[i]:.1f} % (L1 {errors[i]:.4f}, {counts[:, i].mean():.0f} points"
        found += f", similarity {similarities[i]:.4f})"
        rows.append(Row(f"  {name}", lks, asked, found))
    return rows


# --- Shapes and sizes ------------------------------------------------------------------------------------------------


SIZES = "SML"
SHAPES = {  # name: its parameters, px, small to large (LKS section 7.3)
    "Gaussian": ((25,), (40,), (55,)),
    "disc": ((25, 0), (50, 0), (100, 0)),
    "capsule": ((50, 50), (50, 128), (100, 128)),
}
GAUSSIAN_REACH = 5.0
"""Standard deviations at which a Gaussian is cut: 4e-6 of the peak."""


def shape_psf(name: str, parameters: tuple[float, ...]) -> np.ndarray:
    if name != "Gaussian":
        return exact_psf(parameters)
    reach = math.ceil(GAUSSIAN_REACH * parameters[0])
    profile = np.exp(-0.5 * (np.arange(-reach, reach + 1) / parameters[0]) ** 2)
    psf = np.outer(profile, profile)
    return (psf / psf.sum())[..., None]


def shape_figures(name: str, parameters: tuple[float, ...], density: float) -> tuple[float, float]:
    figures = sparsify(shape_psf(name, parameters), density=density, seed=SEED)[1]
    return figures["sparsity"], figures["ssim"]


def shapes(effort: Effort, folder: Path) -> list[Row]:
    """LKS Fig. 10 f: similarity against sparsity of PSFs of three shapes and sizes."""
    tasks = [(name, size, density) for name in SHAPES for size in SHAPES[name] for density in effort.shape_densities]
    found = np.array(parallel(shape_figures, tasks)).reshape(len(SHAPES), 3, -1, 2)
    figure, axes = plt.subplots(1, 3, figsize=(12, 3.6), layout="constrained", sharex=True, sharey=True)
    rows = []
    for axis, (name, sizes), curves in zip(axes, SHAPES.items(), found, strict=True):
        for letter, size, curve in zip(SIZES, sizes, curves, strict=True):
            label = f"{name} {letter} ({', '.join(str(s) for s in size if s)} px)"
            curve = curve[np.argsort(curve[:, 0])]
            axis.semilogx(100 * curve[:, 0], curve[:, 1], "o-", label=label)
            shown = [curve[0], curve[len(curve) // 2], curve[-1]]
            points = ", ".join(f"{s:.3f} at {100 * x:.2g} %" for x, s in shown)
            rows.append(Row(f"{label}: similarity at sparsity", "curve", "curve", points))
        axis.set(xlabel="sparsity, %", title=name)
        axis.legend(loc="lower left" if name == "disc" else "lower right")
    axes[0].set_ylabel("similarity")
    save(figure, folder, "shapes")
    return rows


# --- Tracing ---------------------------------------------------------------------------------------------------------


TRACED = ((4, 0), (16, 0), (64, 0), (100, 0), (4, 20), (30, 60), (8, 100), (64, 100))
TRACED_ANGLES = (0.0, 0.3, math.pi / 4)


def tracing_error(radius: float, length: float, angle: float) -> float:
    psf = exact_psf((radius, length), angle)[..., 0]
    size = 2 * math.ceil(radius + length / 2 + 2) + 1
    analytic = psfs.capsule_psf(radius, length, angle, size) if length else psfs.disc_coverage(radius, size=size)
    pad = [((size - n) // 2,) * 2 for n in psf.shape]
    return float(np.abs(np.pad(psf, pad) - analytic).sum())


def tracing(effort: Effort, folder: Path) -> list[Row]:
    """Traced PSFs against closed forms."""
    tasks = [(*shape, angle) for shape in TRACED for angle in TRACED_ANGLES if shape[1] or angle == 0.0]
    if effort is QUICK:
        tasks = [task for task in tasks if task[0] <= 16]
    errors = parallel(tracing_error, tasks)
    worst = int(np.argmax(errors))
    place = (
        f"worst {errors[worst]:.1e} (CoC, motion, angle {tasks[worst][0]}, {tasks[worst][1]} px, {tasks[worst][2]:.1f})"
    )
    figure = f"traced against analytic PSF, relative L1, {len(tasks)} PSFs of CoC >= 4 px, default rays"
    return [Row(figure, "-", "<= 5e-3", place)]


# --- Whole cells -----------------------------------------------------------------------------------------------------


def built_cell(cell: int) -> tuple[float, list[tuple[float, float, bool]]]:
    """Build a cell as a database does; return its CPU time, and energy error and largest value of each direction."""
    began = time.process_time()
    grid = grid_of()
    every = tuple(range(int(grid.direction_counts[cell])))
    units = plan_units([CellTask(grid, cell, every, 1.0, None, SEED, cell, DEFAULT_SPARSIFIER)], 1)
    records = [record for unit in units for record in build_unit(unit).records.values()]
    seconds = time.process_time() - began
    return seconds, [
        (energy_error(r.spreadlet), float(r.statistics["max_value_ratio"]), r.spreadlet.direct) for r in records
    ]


def energy_error(spreadlet: Spreadlet) -> float:
    moments = spreadlet.moments()
    energy = moments[0] if spreadlet.direct else 0.25 * (moments[4] + moments[5])
    return float(np.abs(energy - 1.0).max())


def build(effort: Effort, folder: Path) -> list[Row]:
    """Time, energy and values of whole cells, all their directions."""
    grid = grid_of()
    cost = grid.direction_counts * (1 + grid.boxes[:, 0, 1]) * (1 + grid.boxes[:, 0, 1] + 0.5 * grid.boxes[:, 1, 1])
    rng = generator("build")
    strata = np.array_split(np.argsort(cost), effort.built)
    cells = [int(rng.choice(stratum)) for stratum in strata]
    parallel(built_cell, [(0,), (0,), (N_CELLS - 1,), (N_CELLS - 1,)])  # compile, fill tables
    began = time.perf_counter()
    results = parallel(built_cell, [(cell,) for cell in reversed(cells)])
    wall = time.perf_counter() - began
    cpu = sum(seconds for seconds, _ in results)
    energy, largest, direct = (
        np.array(column) for column in zip(*(r for _, some in results for r in some), strict=True)
    )
    sparse = largest[~direct]
    bound = f"median {np.median(sparse):.1f}, 99 % {np.quantile(sparse, 0.99):.1f}, worst {sparse.max():.1f}"
    spent = f"{wall / len(cells):.2f} s (CPU {cpu / len(cells):.2f} s)"
    about = f"{len(cells)} cells, all {len(energy)} directions"
    return [
        Row(f"build time per cell on two cores; {about}", "20 s on a GPU", "<= 6 s", spent),
        Row("energy error, any of these", "-", "<= 1e-4", f"worst {energy.max():.1e}"),
        Row(f"largest |value| / largest |Laplacian|, the {len(sparse)} sparse ones", "-", "bounded", bound),
    ]


# --- The two sparsifiers ----------------------------------------------------------------------------------------------


LINES_COC = (3.0, 20.0)
"""Range of CoC radii, px, of the slanted lines of LKS Fig. 11."""


def compared_cell(cell: int, sparsifier: str) -> tuple[float, float]:
    """Return similarity and sparsity of a cell's first direction."""
    figures = sparsify(cell_psf(grid_of(), cell), seed=SEED, sparsifier=sparsifier)[1]
    return figures["ssim"], figures["sparsity"]


def slanted_lines(size: int = 192) -> sp.Frame:
    """Return bright lines on a plane that recedes from left to right."""
    radiance = np.full((size, size, 3), 0.02, np.float32)
    radiance[::24] = 1.0
    coc = np.linspace(*LINES_COC, size)
    depth = 1.0 / (1.0 / LINES_CAMERA.focus_distance_m - coc / LINES_CAMERA.coc_scale(size))
    return sp.Frame(radiance, np.broadcast_to(depth, (size, size)).astype(np.float32))


LINES_CAMERA = sp.ThinLens(focal_length_mm=50.0, sensor_width_mm=36.0, f_number=0.02, focus_distance_m=4.0)


def frame_figures(sparsifier: str) -> tuple[float, float, float]:
    """Return SSIM and points per pixel of the shipped frame, and the largest step between columns of Fig. 11."""
    shipped = Path(sp.__file__).parent / "data"
    frame, camera = sp.read_frame(shipped / "coins_pinhole.exr"), sp.read_camera(shipped / "coins.json")
    with tempfile.TemporaryDirectory() as folder:
        options: dict[str, Any] = {"samples": 100, "sparsifier": sparsifier, "jobs": PROCESSES, "seed": SEED}
        sp.build_database("combined", Path(folder) / "frame.h5", frames=[frame], camera=camera, **options)
        image, report = sp.synthesize(frame, camera, Path(folder) / "frame.h5", report=True)
        sp.build_database("simplelens", Path(folder) / "lines.h5", max_coc=24.0, **options)
        lines = sp.synthesize(slanted_lines(), LINES_CAMERA, Path(folder) / "lines.h5", layers=1)
    reference_image = sp.read_image(shipped / "coins_ref_dofmb.exr")
    steps = np.abs(np.diff(lines[48:144, 24:168, 0], axis=1)).max()
    return sp.metrics.ssim(image, reference_image), report.plan.points_splatted / frame.depth.size, float(steps)


def sparsifiers(effort: Effort, folder: Path) -> list[Row]:
    """Compare the default with LKS's own chain: LKS Fig. 10 a to c on some cells, a frame, and Fig. 11."""
    cells = sample(effort.ablated, N_CELLS, "sparsifiers")
    rows = []
    for name in SPARSIFIERS:
        figures = np.array(parallel(compared_cell, [(int(cell), name) for cell in cells]))
        ssim, points, step = frame_figures(name)
        rows += [
            Row(
                f"{name}: similarity / sparsity, means of {len(cells)} cells",
                ".97 / 9.3 %",
                "-",
                pair(*figures.mean(0)),
            ),
            Row(
                f"{name}: the shipped frame, 100 cells: SSIM / points for each pixel",
                "-",
                "-",
                f"{ssim:.4f} / {points:.0f}",
            ),
            Row(f"{name}: slanted lines (Fig. 11), largest step between columns", "-", "-", f"{step:.4f}"),
        ]
    return rows


# --- The table -------------------------------------------------------------------------------------------------------


PARTS: dict[str, Callable[[Effort, Path], list[Row]]] = {
    "corpus": corpus,
    "directions": directions,
    "build": build,
    "coordinates": coordinates,
    "ablation": ablation,
    "sparsifiers": sparsifiers,
    "shapes": shapes,
    "tracing": tracing,
}
TITLE = (
    "Combined model, CoC to 100 px, motion to 256 px, 400 cells, direction 0, density 1, unless a row says otherwise."
)
HEADER = Row("figure", "LKS", "asked", "measured")
WIDTHS = (84, 14, 30)


def save(figure: Any, folder: Path, part: str) -> None:
    figure.savefig(folder / f"{NAME}_{part}.png", dpi=80)
    plt.close(figure)


def line(row: Row) -> str:
    return "| ".join([*(f"{text:<{width}}" for text, width in zip(row, WIDTHS, strict=False)), row.measured]).rstrip()


def section(part: str, rows: list[Row]) -> str:
    description = (PARTS[part].__doc__ or "").strip()
    return "\n".join([f"[{part}] {description}", *map(line, rows)])


def update_table(path: Path, part: str, text: str) -> str:
    """Replace one part's section in the table, which keeps those of the others, in their order."""
    blocks = path.read_text().strip().split("\n\n") if path.exists() else []
    sections = {block[1 : block.index("]")]: block for block in blocks if block.startswith("[")}
    sections[part] = text
    blocks = [TITLE + "\n" + line(HEADER), *(sections[name] for name in PARTS if name in sections)]
    path.write_text("\n\n".join(blocks) + "\n")
    return text


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"which parts: {', '.join(PARTS)}; default: all")
    parser.add_argument("--cells", type=int, help="of the 400, how many the corpus takes (default: all)")
    parser.add_argument("--quick", action="store_true", help="a trial on few PSFs")
    parser.add_argument("--results", type=Path, help="folder to write to")
    arguments = parser.parse_args()
    unknown = set(arguments.parts) - set(PARTS)
    if unknown:
        parser.error(f"unknown part {', '.join(sorted(unknown))}; there are {', '.join(PARTS)}")
    effort = QUICK if arguments.quick else FULL
    if arguments.cells:
        effort = effort._replace(cells=arguments.cells)
    default = Path(tempfile.gettempdir()) / NAME if arguments.quick else RESULTS
    folder = arguments.results or default
    folder.mkdir(parents=True, exist_ok=True)
    for part in arguments.parts or PARTS:
        began = time.perf_counter()
        rows = PARTS[part](effort, folder)
        print(update_table(folder / f"{NAME}.txt", part, section(part, rows)))
        print(f"({part}: {time.perf_counter() - began:.0f} s)\n", flush=True)


if __name__ == "__main__":
    main()
