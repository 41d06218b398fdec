import json
import sys

import numpy as np
import pytest
from click.testing import CliRunner
from skimage.io import imread

from spreadlets.api import DensePsfs
from spreadlets.cli import main as cli
from spreadlets.cli.status import EXIT_BAD_INPUT
from spreadlets.errors import InvalidParameterError
from spreadlets.psf.database import CellRecord, absent_record, open_database, write_database
from spreadlets.reports import database_plot as plot
from spreadlets.reports.database_plot import plot_database

ROWS_OF_IMAGES = 3
STATISTICS_PANELS = 3


@pytest.fixture(scope="module")
def drawn():
    """The figures that are written, in order."""
    from matplotlib.figure import Figure

    figures, write = [], Figure.savefig

    def savefig(figure, *arguments, **options):
        figures.append(figure)
        write(figure, *arguments, **options)

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(Figure, "savefig", savefig)
        yield figures


@pytest.fixture(scope="module")
def told(small_combined_path, tmp_path_factory, drawn):
    """The plot of a database, its file, and what the command that draws it says."""
    path = tmp_path_factory.mktemp("plot") / "quality.png"
    done = CliRunner().invoke(cli.cli, ["info", str(small_combined_path), "--plot", str(path), "--json"])
    return drawn[-1], path, done


@pytest.fixture(scope="module")
def picture(told):
    return told[:2]


def images(figure, row):
    """The arrays shown of all cells: 0 the PSFs, 1 what the spreadlets stand for, 2 the differences."""
    return [axes.images[0].get_array() for axes in figure.get_axes() if axes.images][row::ROWS_OF_IMAGES]


def test_the_picture_has_all_its_panels_and_they_show_every_spreadlet(small_combined, picture):
    figure, path = picture
    assert len(figure.get_axes()) == STATISTICS_PANELS + ROWS_OF_IMAGES * plot.N_WORST
    pixels = imread(path)[..., :3]
    assert pixels.shape[:2] == tuple(int(inches * plot.DPI) for inches in plot.FIGURE_INCHES[::-1])
    upper, lower = np.array_split(pixels, 2)
    # Text alone covers about a hundredth.
    assert (upper != 255).any(axis=2).mean() > 0.05 and (lower != 255).any(axis=2).mean() > 0.05
    assert [each.name for each in path.parent.iterdir()] == ["quality.png"]
    assert counts(figure) == [small_combined.n_spreadlets] * STATISTICS_PANELS


def counts(figure):
    """How many spreadlets each of the statistics' panels shows."""
    sparsity, similarity, scatter = figure.get_axes()[:STATISTICS_PANELS]
    bars = [sum(bar.get_height() for bar in axes.patches) for axes in (sparsity, similarity)]
    return [*bars, sum(len(line.get_xdata()) for line in scatter.lines)]


def test_what_a_database_leaves_out_is_not_shown(small_combined, tmp_path, drawn):
    grid, statistics = small_combined.grid, small_combined.statistics()
    cells = [[absent_record(angle, 1) for angle in grid.angles(cell).tolist()] for cell in range(grid.n_cells)]
    for cell in (5, 10):
        figures = {name: column[small_combined.cell_start[cell] + 1] for name, column in statistics.items()}
        cells[cell][1] = CellRecord(cells[cell][1].angle, small_combined.cell(cell, 1), figures)
    write_database(tmp_path / "few.h5", grid, cells, {})
    with open_database(tmp_path / "few.h5") as few:
        plot_database(few, tmp_path / "quality.png", DensePsfs(few))
    assert counts(drawn[-1]) == [2] * STATISTICS_PANELS
    assert len(images(drawn[-1], 0)) == 2


def test_the_worst_cells_come_first_and_show_what_is_stored(small_combined, picture):
    figure, _ = picture
    titles = [axes.get_title() for axes in figure.get_axes() if axes.images and axes.get_title()]
    shown = [float(title.split(",")[0]) for title in titles]
    similarity = small_combined.statistics()["ssim"]
    worst = np.minimum.reduceat(similarity, small_combined.cell_start[:-1])
    np.testing.assert_allclose(shown, np.sort(worst)[: plot.N_WORST], atol=1e-4)
    for psf, spreadlet, difference in zip(*(images(figure, row) for row in range(ROWS_OF_IMAGES)), strict=True):
        assert psf.max() == pytest.approx(1.0)
        assert spreadlet.sum() == pytest.approx(psf.sum(), rel=1e-2)
        np.testing.assert_allclose(spreadlet - psf, difference, atol=1e-12)
        assert np.abs(difference).sum() < 0.5 * psf.sum()


@pytest.mark.parametrize("name", ["missing/quality.png", "folder"])
def test_an_unwritable_place_is_one_clear_error(small_combined, tmp_path, name):
    (tmp_path / "folder").mkdir()
    with pytest.raises(InvalidParameterError, match="the plot .*cannot be written"):
        plot_database(small_combined, tmp_path / name, DensePsfs(small_combined))
    assert [path.name for path in tmp_path.rglob("*")] == ["folder"]


def test_a_failure_leaves_the_old_picture(small_combined, tmp_path):
    (tmp_path / "quality.png").write_bytes(b"old")

    def failing(cell, pose, scale):
        raise InvalidParameterError("no PSF")

    with pytest.raises(InvalidParameterError, match="no PSF"):
        plot.plot_database(small_combined, tmp_path / "quality.png", failing)
    assert [path.name for path in tmp_path.iterdir()] == ["quality.png"]
    assert (tmp_path / "quality.png").read_bytes() == b"old"


def test_info_draws_on_request(told, small_combined_path, tmp_path, monkeypatch, capsys):
    _, path, done = told
    assert done.exit_code == 0 and json.loads(done.stdout)["n_cells"] == 14
    assert imread(path).std() > 0
    monkeypatch.setattr("warnings.showwarning", None)
    arguments = ["info", str(small_combined_path), "--plot", str(tmp_path / "missing" / "quality.png")]
    monkeypatch.setattr(sys, "argv", ["spreadlets", *arguments])
    with pytest.raises(SystemExit) as stop:
        cli.main()
    assert stop.value.code == EXIT_BAD_INPUT
    assert "missing/quality.png: cannot be written: there is no folder" in capsys.readouterr().err
