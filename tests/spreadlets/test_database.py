import h5py
import numpy as np
import pytest

from spreadlets import database
from spreadlets.database import CellRecord, open_database, write_database
from spreadlets.errors import InvalidDatabaseError, InvalidParameterError
from spreadlets.psf_model import PsfGrid, get_model
from spreadlets.spreadlet import Spreadlet

STATISTICS = dict.fromkeys(database.STATISTICS, 0.5)


def make_cells(grid, seed=0):
    rng = np.random.default_rng(seed)
    return [
        [
            CellRecord(
                float(direction),
                Spreadlet(
                    rng.integers(-9, 10, (5 + cell % 3, 2)).astype(np.int16),
                    rng.normal(size=(5 + cell % 3, 1)).astype(np.float32),
                    cell % 4 == 0,
                ),
                STATISTICS,
            )
            for direction in grid.directions(cell)
        ]
        for cell in range(grid.n_cells)
    ]


@pytest.fixture
def grid():
    return PsfGrid.of(get_model("combined", max_coc=10.0, max_motion=12.0), 28)


@pytest.fixture
def path(grid, tmp_path):
    write_database(tmp_path / "a.h5", grid, make_cells(grid), {"seed": 7, "parameters": {"samples": 28}})
    return tmp_path / "a.h5"


def test_round_trip_keeps_every_point(grid, path):
    cells = make_cells(grid)
    with open_database(path) as opened:
        assert opened.n_cells == 28
        assert opened.n_spreadlets == grid.direction_counts.sum()
        for cell, records in enumerate(cells):
            assert np.array_equal(opened.directions(cell), [record.direction for record in records])
            for number, record in enumerate(records):
                stored = opened.cell(cell, number)
                assert np.array_equal(stored.offset_rc, record.spreadlet.offset_rc)
                assert np.array_equal(stored.value, record.spreadlet.value)
                assert stored.direct == record.spreadlet.direct


def test_the_grid_and_the_provenance_come_back(grid, path):
    with open_database(path) as opened:
        assert opened.grid == grid
        assert opened.summary()["seed"] == 7
        coordinate = opened.coordinate(5)
        assert opened.find(coordinate) == 5
        assert np.allclose(coordinate, grid.coordinate(5))


def test_writing_leaves_no_temporary_file(path):
    assert [file.name for file in path.parent.iterdir()] == ["a.h5"]


def test_an_unwritable_place_is_one_clear_error(grid, tmp_path):
    with pytest.raises(InvalidParameterError, match="cannot write the database"):
        write_database(tmp_path / "missing" / "a.h5", grid, make_cells(grid), {})


def test_a_cell_out_of_range_is_named(path):
    with open_database(path) as opened:
        with pytest.raises(InvalidParameterError, match="cell 28: the database has cells 0 to 27"):
            opened.cell(28)
        with pytest.raises(InvalidParameterError, match="direction 99 of cell 0"):
            opened.cell(0, 99)


def test_an_unknown_name_lists_the_shipped_ones():
    with pytest.raises(InvalidDatabaseError, match="no database 'nothing'.*combined"):
        open_database("nothing")


def test_a_truncated_file_is_refused(path):
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    with pytest.raises(InvalidDatabaseError, match="not a readable HDF5 file"):
        open_database(path)


def change_version(file):
    file.attrs["version"] = 99


def drop_values(file):
    del file["value"]


def swap_starts(file):
    starts = file["point_start"][...]
    starts[3] = starts[-1] + 5
    file["point_start"][...] = starts


def shrink_shape(file):
    file.attrs["shape"] = [2, 2]


def widen_step(file):
    file.attrs["direction_step_px"] = 9.0


def rename_model(file):
    file.attrs["model"] = "telescope"


def spoil_provenance(file):
    file.attrs["provenance"] = "{"


def unmark(file):
    del file.attrs["format"]


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (change_version, "database version 99, this program reads version"),
        (drop_values, "dataset 'value' is missing"),
        (swap_starts, "'point_start' is not a list of rising starts"),
        (shrink_shape, "cell_start"),
        (widen_step, "directions stored for the cells"),
        (rename_model, "telescope"),
        (spoil_provenance, "malformed"),
        (unmark, "not a spreadlet database"),
    ],
)
def test_a_damaged_file_is_refused_with_the_reason(path, damage, message):
    with h5py.File(path, "a") as file:
        damage(file)
    with pytest.raises(InvalidDatabaseError, match=message):
        open_database(path)


def test_a_value_that_is_not_finite_never_leaves_the_file(path):
    with h5py.File(path, "a") as file:
        values = file["value"][...]
        values[0] = np.nan
        file["value"][...] = values
    with open_database(path) as opened, pytest.raises(InvalidDatabaseError, match="point 0 has a value"):
        opened.cell(0)


def test_an_offset_beyond_the_limit_is_refused(path):
    with h5py.File(path, "a") as file:
        offsets = file["offset_rc"][...]
        offsets[0] = -32768
        file["offset_rc"][...] = offsets
    with open_database(path) as opened, pytest.raises(InvalidDatabaseError, match="offset above"):
        opened.cell(0)
