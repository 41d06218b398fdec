import os
import pickle
import shutil
import zlib

import h5py
import numpy as np
import pytest

import spreadlets as sp
from spreadlets.errors import InvalidDatabaseError, InvalidParameterError
from spreadlets.psf import database, database_file
from spreadlets.psf.database import CellRecord, open_database, shared_database, write_database
from spreadlets.psf.model import PsfGrid, get_model
from spreadlets.psf.spreadlet import Spreadlet

STATISTICS = dict.fromkeys(database.STATISTICS, 0.5)


def make_cells(grid, seed=0):
    rng = np.random.default_rng(seed)
    return [
        [
            CellRecord(
                float(angle),
                Spreadlet(
                    rng.integers(-9, 10, (5 + cell % 3, 2)).astype(np.int16),
                    rng.normal(size=(5 + cell % 3, 1)).astype(np.float32),
                    cell % 4 == 0,
                ),
                STATISTICS,
            )
            for angle in grid.angles(cell)
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
            assert np.array_equal(opened.angles(cell), [record.angle for record in records])
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
        with pytest.raises(InvalidParameterError, match="pose 99 of cell 0"):
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
    file["provenance"][...] = ord("{")


def unmark(file):
    del file.attrs["format"]


def link_outside(file):
    del file["value"]
    file["value"] = h5py.ExternalLink("other.h5", "/value")


def link_softly(file):
    file.move("value", "hidden")
    file["value"] = h5py.SoftLink("/hidden")


def store_outside(file):
    shape, dtype = file["direct"].shape, file["direct"].dtype
    del file["direct"]
    file.create_dataset("direct", shape, dtype, external=[("/etc/hostname", 0, h5py.h5f.UNLIMITED)])


def make_virtual(file):
    layout = h5py.VirtualLayout(file["direct"].shape, np.uint8)
    layout[...] = h5py.VirtualSource("other.h5", "direct", file["direct"].shape)
    del file["direct"]
    file.create_virtual_dataset("direct", layout)


def rewrite(file, name, data, **options):
    del file[name]
    file.create_dataset(name, data=data, **({"fletcher32": True, "chunks": True} | options))


def leave_out_checksums(file):
    rewrite(file, "direction", file["direction"][...], fletcher32=False)


def store_text(file):
    rewrite(file, "direct", np.array(["a"], object), dtype=h5py.string_dtype(), fletcher32=False)


def add_a_group(file):
    file.create_group("more")


def need_a_plugin(file):
    table = file["direct"][...]
    plist = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    plist.set_chunk(table.shape)
    plist.set_filter(32000, h5py.h5z.FLAG_OPTIONAL, ())
    plist.set_fletcher32()
    del file["direct"]
    h5py.h5d.create(file.id, b"direct", h5py.h5t.NATIVE_UINT8, h5py.h5s.create_simple(table.shape), plist)


def claim_much(file):
    del file["value"]
    file.create_dataset("value", (10**8, 1), np.float32, chunks=(8192, 1), compression="gzip", fletcher32=True)


def make_chunks_large(file):
    rewrite(file, "direct", np.zeros(1 << 20, np.uint8), chunks=(1 << 20,))


def write_a_long_text(file):
    rewrite(file, "provenance", np.zeros(1 << 23, np.uint8), chunks=(8192,))


def attach_much(file):
    for number in range(40):
        file.attrs[f"more{number}"] = 1


def attach_a_reference(file):
    file.attrs["more"] = file["value"].ref


def grow_shape(file):
    file.attrs["shape"] = [10**6, 10**6]


def widen_range(file):
    file.attrs["maximum"] = [1e300, 12.0]


def narrow_step(file):
    file.attrs["direction_step_px"] = 1e-9


def spoil_direct(file):
    file["direct"][2] = 7


def turn_directions(file):
    file["direction"][...] = 0.1


def lengthen_one(file):
    starts = file["point_start"][...]
    starts[1:] += 1 << 21
    file["point_start"][...] = starts


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (change_version, "database version 99, this program reads version"),
        (drop_values, "dataset 'value' is missing"),
        (swap_starts, "'point_start' is not a list of rising starts"),
        (shrink_shape, "cell_start"),
        (widen_step, "angles stored for the cells"),
        (rename_model, "telescope"),
        (spoil_provenance, "malformed"),
        (unmark, "not a spreadlet database"),
        (link_outside, "'value' is a link to another place or file"),
        (link_softly, "link to another place|which no database has"),
        (store_outside, "'direct' keeps its values in another file"),
        (make_virtual, "'direct' keeps its values in another file"),
        (leave_out_checksums, "'direction' has no checksums"),
        (store_text, "a database holds numbers only"),
        (add_a_group, "holds 'more', which no database has"),
        (need_a_plugin, "needs the filters .*32000"),
        (claim_much, "claims 400000000 bytes, but stores only 0"),
        (make_chunks_large, "has chunks of more than"),
        (write_a_long_text, "is not a text of up to|claims"),
        (attach_much, "more than 32 attributes"),
        (attach_a_reference, "'more' refers to something else|is not a number or text"),
        (grow_shape, "is too large"),
        (widen_range, "the axes end at"),
        (narrow_step, "poses of a cell"),
        (spoil_direct, "'direct' holds 7"),
        (turn_directions, "angles stored for the cells"),
        (lengthen_one, "whose steps are"),
    ],
)
def test_a_damaged_file_is_refused_with_the_reason(path, damage, message):
    with h5py.File(path, "a") as file:
        damage(file)
    with pytest.raises(InvalidDatabaseError, match=message):
        open_database(path)


@pytest.mark.parametrize("name", ["value", "offset_rc", "statistics", "direction", "cell_start", "provenance"])
def test_a_flipped_bit_is_found_by_the_checksums(path, name):
    with h5py.File(path) as file:
        chunk = file[name].id.get_chunk_info(0)
    content = bytearray(path.read_bytes())
    content[chunk.byte_offset + chunk.size // 2] ^= 1
    path.write_bytes(content)
    with pytest.raises(InvalidDatabaseError), open_database(path) as opened:
        opened.statistics()
        opened.cell(0)


def test_a_flipped_bit_in_the_bookkeeping_is_found(path):
    content = path.read_bytes()
    at = content.index(np.float64(12.0).tobytes())  # the end of the second axis
    path.write_bytes(content[:at] + b"\x01" + content[at + 1 :])
    with pytest.raises(InvalidDatabaseError):
        open_database(path)


def test_a_chunk_that_unpacks_to_more_than_it_should_is_not_unpacked(path):
    with h5py.File(path, "a") as file:
        shape = file["value"].shape
        del file["value"]
        dataset = file.create_dataset("value", shape, np.float32, chunks=shape, compression="gzip", fletcher32=True)
        dataset.id.write_direct_chunk((0, 0), zlib.compress(bytes(1 << 26), 1)[: 1 << 18] + bytes(4))
    with open_database(path) as opened, pytest.raises(InvalidDatabaseError, match="a chunk of 'value' is larger"):
        opened.cell(0)


def test_hdf5_without_checksums_of_its_own_is_refused(path, tmp_path):
    with h5py.File(path) as new, h5py.File(tmp_path / "old.h5", "w") as old:
        for name, value in new.attrs.items():
            old.attrs[name] = value
        for name in new:
            new.copy(name, old)
    with pytest.raises(InvalidDatabaseError, match="HDF5 of an old format"):
        open_database(tmp_path / "old.h5")


def test_hdf5_behind_other_bytes_is_refused(path):
    path.write_bytes(bytes(512) + path.read_bytes())
    with pytest.raises(InvalidDatabaseError, match="not a readable HDF5 file"):
        open_database(path)


def test_large_databases_are_written_piece_by_piece(grid, tmp_path, monkeypatch):
    monkeypatch.setattr(database_file, "WRITE_POINTS", 20)
    taken = []
    cells = (taken.append(number) or cell for number, cell in enumerate(make_cells(grid)))
    write_database(tmp_path / "b.h5", grid, cells, {"seed": 7})
    assert taken == list(range(28))
    with open_database(tmp_path / "b.h5") as opened:
        for number, records in enumerate(make_cells(grid)):
            for pose, record in enumerate(records):
                assert np.array_equal(opened.cell(number, pose).offset_rc, record.spreadlet.offset_rc)


def test_a_value_beyond_any_laplacian_is_refused(path):
    with h5py.File(path, "a") as file:
        file["value"][0] = 1e6
    with open_database(path) as opened, pytest.raises(InvalidDatabaseError, match="a value above 1000"):
        opened.cell(0)


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


def test_what_ships_stays_open_until_its_file_changes(monkeypatch, tmp_path, small_combined_path):
    shutil.copy(small_combined_path, tmp_path / "shipped.h5")
    monkeypatch.setattr(database, "shipped_folder", lambda: tmp_path)
    first = shared_database("shipped")
    assert shared_database(tmp_path / "shipped.h5") is first is not None
    # A renderer that is closed leaves it open.
    frame = sp.Frame(np.ones((8, 8, 3), np.float32), np.full((8, 8), 4.0))
    with sp.Renderer(frame, "shipped") as renderer:
        renderer.render(sp.ThinLens(focal_length_mm=50, sensor_width_mm=36, f_number=2, focus_distance_m=2))
    assert first.cell(0).n_points > 0
    # Another file of the name is opened anew, while the one before can still be read.
    shutil.copy(small_combined_path, tmp_path / "other.h5")
    os.replace(tmp_path / "other.h5", tmp_path / "shipped.h5")
    assert shared_database("shipped") is not first
    assert first.cell(0).n_points > 0


def test_a_file_of_ones_own_is_not_kept_open(small_combined_path):
    assert shared_database(small_combined_path) is None


def test_a_pickled_database_is_opened_anew_from_wherever_one_is(tmp_path, grid, monkeypatch):
    write_database(tmp_path / "own.h5", grid, make_cells(grid), {})
    monkeypatch.chdir(tmp_path)
    with open_database("own.h5") as opened:
        pickled, cell = pickle.dumps(opened), opened.cell(3)
    monkeypatch.chdir("/")
    with pickle.loads(pickled) as again:
        assert again.cell(3).value.tobytes() == cell.value.tobytes()
    (tmp_path / "own.h5").unlink()
    with pytest.raises(InvalidDatabaseError, match=r"own\.h5"):
        pickle.loads(pickled)
