"""Quality of the databases that ship, and of one that is built from scratch, measured anew from their points."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from spreadlets.metrics import PSF_MARGIN_FRACTION, PSF_MARGIN_PX, PSF_SUPPORT_THRESHOLD, psf_l1, psf_similarity
from spreadlets.precompute.build.build import build_database
from spreadlets.precompute.models.grids import ALGORITHM_VERSION
from spreadlets.precompute.models.registry import trace_psf
from spreadlets.precompute.sparsify.preparation import split_spike
from spreadlets.psf import database_file
from spreadlets.psf.database import open_database

SHIPPED = sorted((Path(__file__).resolve().parent.parent / "psf_db").glob("*.h5"))
FRESH = "built from scratch"

N_SAMPLED = {"volume": 3, "stylized": 6, "physicallens": 8}
"""Spreadlets that are traced and reconstructed in each database, spread evenly over its cells; of others as many as
`USUALLY_SAMPLED`. Some take long to trace."""
USUALLY_SAMPLED = 24

LARGE_COC = 4.0
"""CoC radius, px: smaller PSFs are little more than their edge, and have limits of their own."""

LEAST_SIMILARITY = 0.955
"""Of any spreadlet of a large CoC."""

LEAST_SMALL_SIMILARITY = 0.97
"""Of any other: most are drawn in full, all but their faintest pixels."""

MEAN_SIMILARITY = 0.97
"""Over the sampled spreadlets of large CoC."""

MEAN_SPARSITY = {
    "combined": (0.17, None),
    "simplelens": (0.38, None),
    FRESH: (0.25, None),
    "physicallens": (0.28, 0.57),
    "stylized": (0.42, 0.95),
    "volume": (0.008, None),
}
"""Largest, over the sampled spreadlets of large CoC and over the others, at most a sixth above what was measured. Half
of the simple lens's radii are below 30 px, the fresh database's end at 12 px; small PSFs need more of their pixels."""

MAX_ENERGY_ERROR = 1e-4

SIMILARITY_TOLERANCE = 2e-3
"""Between the recorded similarity and the one measured anew: noise of the tracing, should its samples differ."""

LEAST_HALO = 1e-3
"""Share of the light around a spike below which rounding shows in its figures."""

RELATIVE_TOLERANCE = 0.02
"""The same for the support and the L1 error."""


class Measured(NamedTuple):
    """One spreadlet, measured anew, and what the file says of it."""

    place: str
    large: bool
    similarity: float
    l1: float
    sparsity: float
    n_support: int
    energy_error: float
    recorded: dict[str, float]
    share: float


def retrace(database, cell, number):
    """Trace a cell's PSF with the seed of its build."""
    seed = np.random.SeedSequence((database.provenance["seed"], cell, number)).generate_state(1)[0]
    return trace_psf(
        database.grid.model,
        database.grid.box(cell),
        angle=float(database.angles(cell)[number]),
        angle_half_width=database.grid.angle_half_width(cell),
        side=database.grid.side(cell, number),
        rays=database.provenance["parameters"]["rays"],
        seed=int(seed),
    )


def on_one_window(psf, spreadlet):
    """Pad a PSF by the margin of its similarity, and reconstruct the spreadlet on the same window."""
    half = np.array(psf.shape[:2]) // 2
    margin = np.maximum(PSF_MARGIN_PX, np.ceil(PSF_MARGIN_FRACTION * np.array(psf.shape[:2]))).astype(int)
    half = np.maximum(half + margin, spreadlet.extent)
    dense = spreadlet.to_dense(margin=int((half - spreadlet.extent).max()))
    rows, cols = half - np.array(psf.shape[:2]) // 2
    top, left = np.array(dense.shape[:2]) // 2 - half
    window = dense[top : top + 2 * half[0] + 1, left : left + 2 * half[1] + 1]
    return np.pad(psf, ((rows, rows), (cols, cols), (0, 0))), window


def without_spike(psf, spreadlet):
    """Return a PSF and its reconstruction on one window, both without what the central pixel has of its own."""
    true, drawn = on_one_window(psf, spreadlet)
    rest, spike = split_spike(true)
    drawn[tuple(np.array(drawn.shape[:2]) // 2)] -= spike
    return rest, drawn


def is_large(database, cell):
    """Tell cells whose PSFs are more than their edge: those of a medium all are."""
    return bool(database.grid.model.axes[0].unit == "m" or database.coordinate(cell)[0] >= LARGE_COC)


def measure(database, cell, number, statistics):
    psf, spreadlet = retrace(database, cell, number), database.cell(cell, number)
    true, drawn = without_spike(psf, spreadlet)
    n_support = int((true > PSF_SUPPORT_THRESHOLD * true.max()).any(axis=2).sum())
    moments = spreadlet.moments()
    energy = moments[0] if spreadlet.direct else 0.25 * (moments[4] + moments[5])
    index = int(database.cell_start[cell]) + number
    return Measured(
        f"cell {cell}, pose {number}",
        is_large(database, cell),
        psf_similarity(true, drawn),
        psf_l1(true, drawn),
        spreadlet.n_points / n_support,
        n_support,
        float(np.abs(energy - psf.sum(axis=(0, 1))).max()),
        {name: float(column[index]) for name, column in statistics.items()},
        share=float(split_spike(psf)[0].sum() / psf.sum()),
    )


@pytest.fixture(scope="module", params=[*SHIPPED, FRESH], ids=lambda name: getattr(name, "stem", "fresh"))
def measured(request):
    fresh = request.param == FRESH
    path = request.getfixturevalue("small_combined_path") if fresh else request.param
    rng = np.random.default_rng(11)
    with open_database(path) as database:
        statistics = database.statistics()
        n_sampled = N_SAMPLED.get(path.stem, USUALLY_SAMPLED)
        cells = np.linspace(0, database.n_cells - 1, n_sampled).round().astype(int).tolist()
        numbers = [int(rng.integers(len(database.angles(cell)))) for cell in cells]
        found = [measure(database, *place, statistics) for place in zip(cells, numbers, strict=True)]
    return found, MEAN_SPARSITY[FRESH if fresh else path.stem]


def test_there_are_databases_that_ship():
    assert {path.stem for path in SHIPPED} >= {"combined", "simplelens"}


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_databases_that_ship_are_of_the_algorithm_that_ships(path):
    with open_database(path) as database:
        assert database.provenance["algorithm_version"] == ALGORITHM_VERSION
        recorded = database.provenance["between_cells"]["highlight"]
        assert recorded["mean"] >= 0.98 and recorded["percentile_1"] >= 0.8


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_databases_that_ship_can_be_extended(path, tmp_path, monkeypatch):
    """By nothing: all of it is kept, so that no cell is made anew. What is drawn between cells is judged elsewhere."""
    monkeypatch.setattr(database_file, "GZIP_LEVEL", 1)  # is quicker
    copy = tmp_path / path.name
    copy.write_bytes(path.read_bytes())
    made = []
    with open_database(path) as database:
        told = {"progress": lambda *each: made.append(each)}
        build_database(database.grid.model.name, copy, extend=True, jobs=1, judge=False, **told)
        with open_database(copy) as extended:
            assert not any(total for _, total, *_ in made) and np.array_equal(
                extended.point_start, database.point_start
            )


def test_the_databases_that_ship_are_small():
    assert sum(path.stat().st_size for path in SHIPPED) < 30e6


def test_no_sampled_spreadlet_is_bad(measured):
    for one in measured[0]:
        assert one.similarity >= (LEAST_SIMILARITY if one.large else LEAST_SMALL_SIMILARITY), one.place


def test_sampled_spreadlets_of_large_coc_are_similar_and_sparse_on_average(measured):
    large = [one for one in measured[0] if one.large]
    assert len(large) >= len(measured[0]) // 4
    assert np.mean([one.similarity for one in large]) >= MEAN_SIMILARITY
    assert np.mean([one.sparsity for one in large]) <= measured[1][0]


def test_sampled_spreadlets_of_small_coc_are_sparse_on_average_too(measured):
    small = [one.sparsity for one in measured[0] if not one.large]
    assert len(small) >= (0 if measured[1][1] is None else len(measured[0]) // 8)
    assert not small or np.mean(small) <= measured[1][1]


def test_sampled_spreadlets_keep_the_energy(measured):
    for one in measured[0]:
        assert one.energy_error <= MAX_ENERGY_ERROR, one.place


def test_recorded_figures_are_those_of_the_points(measured):
    for one in measured[0]:
        if one.share < LEAST_HALO:
            continue
        assert one.recorded["ssim"] == pytest.approx(one.similarity, abs=SIMILARITY_TOLERANCE), one.place
        for name in ("l1", "sparsity", "n_support"):
            expected = pytest.approx(getattr(one, name), rel=RELATIVE_TOLERANCE, abs=1e-4)
            assert one.recorded[name] == expected, f"{one.place}: {name}"
