"""Builds: the same database by any way, from whatever was finished, and one clear error where it cannot go on."""

import os
import signal
import subprocess
import sys

import h5py
import numba
import numpy as np
import pytest
from building import CASE, Stop, assert_same, contents, stop_after

from spreadlets.errors import BuildStoppedError, InvalidDatabaseError, InvalidParameterError
from spreadlets.precompute.build import parts as parts_module
from spreadlets.precompute.build import work
from spreadlets.precompute.build.build import build_database
from spreadlets.precompute.build.parts import Parts, open_parts
from spreadlets.precompute.build.work import CellTask, build_unit, plan_units
from spreadlets.precompute.models.grids import ALGORITHM_VERSION, model_grid
from spreadlets.psf.database import open_database

pytestmark = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="builds databases")


def build(path, **changes):
    build_database("combined", path, **({"jobs": 1} | CASE | changes))
    return path


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    return build(tmp_path_factory.mktemp("reference") / "a.h5")


def test_two_processes_build_the_same_database(reference, tmp_path):
    assert_same(build(tmp_path / "a.h5", jobs=2), reference)


def test_a_build_goes_on_from_the_cells_that_were_finished(reference, tmp_path, monkeypatch):
    with pytest.raises(Stop):
        build(tmp_path / "a.h5", progress=stop_after(5))
    assert len(list((tmp_path / "a.h5.parts").glob("*.part"))) == 5
    built = []
    monkeypatch.setattr(
        "spreadlets.precompute.build.build.build_unit", lambda unit: built.append(unit.cell) or build_unit(unit)
    )
    assert_same(build(tmp_path / "a.h5"), reference)
    assert len(set(built)) == 7
    assert [path.name for path in tmp_path.iterdir()] == ["a.h5"]


def test_cells_of_another_seed_or_algorithm_are_built_anew(tmp_path, monkeypatch):
    with pytest.raises(Stop):
        build(tmp_path / "a.h5", progress=stop_after(5))
    for change in ({"seed": 3}, {"density": 2.0}, {"sparsifier": "lks"}, {"max_coc": 5.0}, {"rays": 9_000}):
        with pytest.raises(Stop):
            build(tmp_path / "a.h5", progress=stop_after(0), **change)
    monkeypatch.setattr(parts_module, "ALGORITHM_VERSION", ALGORITHM_VERSION + 1)
    with pytest.raises(Stop):
        build(tmp_path / "a.h5", progress=stop_after(0))


def test_a_damaged_part_is_built_anew(reference, tmp_path):
    with pytest.raises(Stop):
        build(tmp_path / "a.h5", progress=stop_after(6))
    first, second, *_ = sorted((tmp_path / "a.h5.parts").glob("*.part"))
    first.write_bytes(first.read_bytes()[:100])
    content = bytearray(second.read_bytes())
    content[200] ^= 1
    second.write_bytes(content)
    told = []
    build(tmp_path / "a.h5", progress=lambda *args: told.append(args))
    assert told[0][:2] == (4, 12)
    assert_same(tmp_path / "a.h5", reference)


def test_a_full_disk_is_one_error_and_loses_nothing(reference, tmp_path, monkeypatch):
    replace = os.replace
    room = [4]

    def replace_while_there_is_room(source, target):
        room[0] -= 1
        if room[0] < 0:
            raise OSError(28, "No space left on device")
        replace(source, target)

    monkeypatch.setattr(os, "replace", replace_while_there_is_room)
    with pytest.raises(BuildStoppedError, match="cannot be stored in .*No space left on device.*same command goes on"):
        build(tmp_path / "a.h5")
    assert len(list((tmp_path / "a.h5.parts").iterdir())) == 4 + len(["lock", "holder", "build.log"])
    room[0] = 12 - 4  # for the cells, and not for the database
    with pytest.raises(BuildStoppedError, match="cannot write the database .*No space left.*same command"):
        build(tmp_path / "a.h5")
    assert not (tmp_path / "a.h5").exists() and len(list((tmp_path / "a.h5.parts").glob("*.part"))) == 12
    room[0] = 1
    assert_same(build(tmp_path / "a.h5"), reference)


def test_a_folder_that_cannot_be_written_is_one_error(tmp_path, monkeypatch):
    def refuse(*args, **kwargs):
        raise PermissionError(13, "Permission denied")

    with pytest.raises(InvalidParameterError, match="there is no such folder"):
        build(tmp_path / "missing" / "a.h5")
    monkeypatch.setattr("pathlib.Path.mkdir", refuse)
    with pytest.raises(InvalidParameterError, match="cannot write beside the database: Permission denied"):
        build(tmp_path / "a.h5")


def test_a_build_replaces_no_file_but_a_database(tmp_path):
    frame = tmp_path / "frame.exr"
    frame.write_bytes(b"v/1\x01" + bytes(100))
    with pytest.raises(InvalidParameterError, match=r"frame\.exr is there already, and no database"):
        build(frame)
    assert frame.stat().st_size == 104 and [path.name for path in tmp_path.iterdir()] == ["frame.exr"]


def test_a_second_build_of_the_same_file_says_who_is_at_work(reference, tmp_path):
    refused = []

    def try_too(done, total, left_s):
        if done == 3:
            with pytest.raises(
                BuildStoppedError, match=f"another build is writing .*process {os.getpid()} on "
            ) as error:
                build(tmp_path / "a.h5")
            refused.append(error)

    build(tmp_path / "a.h5", progress=try_too)
    assert refused
    assert_same(tmp_path / "a.h5", reference)


def test_a_killed_build_leaves_a_lock_that_holds_nobody_up(reference, tmp_path):
    code = (
        "import sys, time\nfrom spreadlets.precompute.build.build import build_database\n"
        f"build_database('combined', sys.argv[1], jobs=1, progress=lambda *a: print(a[0], flush=True), **{CASE!r})"
    )
    process = subprocess.Popen([sys.executable, "-c", code, str(tmp_path / "a.h5")], stdout=subprocess.PIPE, text=True)
    while process.stdout.readline().strip() != "3":
        pass
    process.send_signal(signal.SIGKILL)
    process.communicate()
    assert (tmp_path / "a.h5.parts" / "lock").exists()
    assert_same(build(tmp_path / "a.h5"), reference)
    assert [path.name for path in tmp_path.iterdir()] == ["a.h5"]


class Deadly:
    """What kills the process that is asked to compute it, before it has loaded all that a build needs."""

    def __reduce__(self):
        return signal.raise_signal, (signal.SIGKILL,)

    def __call__(self, unit):
        raise AssertionError("a worker was to compute this")


def test_a_unit_that_kills_every_worker_is_one_error_and_loses_nothing(reference, tmp_path, monkeypatch):
    with pytest.raises(Stop):
        build(tmp_path / "a.h5", progress=stop_after(11))  # each of the units that are left costs three processes
    with monkeypatch.context() as patched:
        patched.setattr("spreadlets.precompute.build.build.build_unit", Deadly())
        with pytest.raises(BuildStoppedError, match="cell .*: 3 processes died on it.*same command goes on"):
            build(tmp_path / "a.h5", jobs=2)
    assert len(list((tmp_path / "a.h5.parts").glob("*.part"))) == 11
    assert_same(build(tmp_path / "a.h5"), reference)


def test_the_log_tells_of_every_cell_and_what_is_left(tmp_path):
    told = []
    build(tmp_path / "a.h5", log=tmp_path / "log.txt", progress=lambda *args: told.append(args))
    lines = (tmp_path / "log.txt").read_text().splitlines()
    assert len(lines) == 14 and "12 cells, 0 of them finished before" in lines[0] and "is complete" in lines[-1]
    assert all("s; " in line and line.endswith("s left") for line in lines[1:-1])
    assert [done for done, _, _ in told] == list(range(13))
    assert told[0][2] is None and told[-1][2] == 0.0 and told[1][2] > 0.0


@pytest.mark.parametrize(("name", "value"), [("max_coc", -1.0), ("max_coc", float("inf")), ("max_motion", 0.0)])
def test_a_range_that_is_none_is_named_as_it_was_given(tmp_path, name, value):
    with pytest.raises(InvalidParameterError, match=f"{name} is {value:g}: it must be finite and above 0"):
        build_database("combined", tmp_path / "a.h5", **{name: value})
    assert not any(tmp_path.iterdir())


def tasks_of(grid):
    return [CellTask(grid, cell, tuple(range(n)), 1.0, None, 0, cell, "fit") for cell, n in enumerate(grid.pose_counts)]


def test_units_cover_every_direction_once_and_the_longest_come_first():
    grid = model_grid("combined", samples=60, max_coc=20.0, max_motion=40.0)
    tasks = tasks_of(grid)
    few, many = plan_units(tasks, 1), plan_units(tasks, 64)
    for units in (few, many):
        places = sorted((unit.cell, number) for unit in units for number, _, _ in unit.poses)
        assert places == [(cell, number) for cell, n in enumerate(grid.pose_counts) for number in range(n)]
        costs = [unit.cost for unit in units]
        assert costs == sorted(costs, reverse=True)
    total = sum(unit.cost for unit in many)
    assert all(len(unit.poses) == 1 or unit.cost <= total / (64 * work.UNITS_PER_WORKER) for unit in many)
    assert len(few) < len(many)


def test_larger_psfs_are_expected_to_take_longer():
    grid = model_grid("combined", samples=100)
    cost = {unit.cell: unit.cost / len(unit.poses) for unit in plan_units(tasks_of(grid), 1)}
    small, large = int(grid.find([1.0, 1.0])), int(grid.find([60.0, 120.0]))
    assert cost[large] > 20.0 * cost[small]


def test_a_unit_computes_with_one_thread_and_one_at_a_time():
    unit = plan_units(tasks_of(model_grid("combined", samples=12, max_coc=4.0, max_motion=4.0)), 1)[-1]
    result = build_unit(unit._replace(rays=5_000))
    assert result.seconds > 0.0 and set(result.records) == {number for number, _, _ in unit.poses}
    assert result.algorithm_version == ALGORITHM_VERSION


def test_parts_of_other_builds_go_when_the_database_is_complete(reference, tmp_path):
    with pytest.raises(Stop):
        build(tmp_path / "a.h5", seed=9, progress=stop_after(2))
    (tmp_path / "a.h5.parts" / "notes.txt").write_text("mine")
    build(tmp_path / "a.h5")
    assert [path.name for path in (tmp_path / "a.h5.parts").iterdir()] == ["notes.txt"]


def test_a_build_that_fails_before_its_first_cell_leaves_no_folder(tmp_path):
    with pytest.raises(Stop):
        build(tmp_path / "a.h5", progress=stop_after(0))
    assert list(tmp_path.iterdir()) == []


# --- Extending -----------------------------------------------------------------------------------------------------


def spreadlets_by_place(path):
    with open_database(path) as database:
        boxes = database.grid.nested.boxes()
        return {
            (boxes[cell].tobytes(), number): database.cell(cell, number)
            for cell in range(database.n_cells)
            for number in range(len(database.angles(cell)))
        }


def test_a_wider_database_keeps_the_cells_that_are_there(reference, tmp_path, monkeypatch):
    path = tmp_path / "a.h5"
    path.write_bytes(reference.read_bytes())
    built = []
    monkeypatch.setattr(
        "spreadlets.precompute.build.build.build_unit", lambda unit: built.append(unit) or build_unit(unit)
    )
    build_database("combined", path, extend=True, max_coc=5.5, max_motion=6.0, jobs=1)
    before, after = spreadlets_by_place(reference), spreadlets_by_place(path)
    kept = before.keys() & after.keys()
    assert len(kept) >= 0.5 * len(before) and len(after) > len(before)
    for place in kept:
        assert np.array_equal(before[place].offset_rc, after[place].offset_rc)
        assert np.array_equal(before[place].value, after[place].value)
    assert sum(len(unit.poses) for unit in built) == len(after) - len(kept)
    with open_database(path) as wide, open_database(reference) as narrow:
        assert wide.grid.maximum[0] >= 5.5 and wide.grid.maximum[1] >= 6.0
        for coordinate in ([0.5, 0.5], [2.0, 1.0]):
            old, new = narrow.find(coordinate), wide.find(coordinate)
            assert np.allclose(narrow.grid.box(int(old)), wide.grid.box(int(new)))
        assert wide.provenance["seed"] == 2 and wide.provenance["parameters"]["rays"] == 10_000


def test_extending_to_what_is_there_changes_nothing(reference, tmp_path):
    path = tmp_path / "a.h5"
    path.write_bytes(reference.read_bytes())
    build_database("combined", path, extend=True, max_coc=3.0, jobs=1)
    tables = contents(path)[0]
    del tables["seed_cell"]
    for name, table in contents(reference)[0].items():
        assert np.array_equal(table, tables[name]), name


def test_an_extended_database_is_as_good_as_it_says(reference, tmp_path):
    from spreadlets.precompute.build.verification import verify_database

    path = tmp_path / "a.h5"
    path.write_bytes(reference.read_bytes())
    build_database("combined", path, extend=True, max_coc=5.0, jobs=1)
    with open_database(path) as database:
        assert verify_database(database, jobs=1)["cells"] == database.n_cells


def test_a_denser_database_keeps_what_is_stored_as_pixels(tmp_path, monkeypatch):
    options = {"samples": 10, "max_coc": 9.0, "rays": 10_000, "jobs": 1}
    path = tmp_path / "a.h5"
    build_database("simplelens", path, **options)
    with open_database(path) as database:
        direct, counts = database.direct.copy(), np.diff(database.point_start)
    built = []
    monkeypatch.setattr(
        "spreadlets.precompute.build.build.build_unit", lambda unit: built.append(unit.cell) or build_unit(unit)
    )
    build_database("simplelens", path, extend=True, density=2.0, jobs=1)
    assert 0 < len(built) < 10 and sorted(built) == np.flatnonzero(~direct).tolist()
    with open_database(path) as database:
        assert (np.diff(database.point_start)[~direct] > counts[~direct]).any()
        assert np.array_equal(np.diff(database.point_start)[direct], counts[direct])
        assert database.provenance["parameters"]["density"] == 2.0


def test_a_database_says_by_which_sparsifier_it_was_made_and_an_extension_keeps_it(tmp_path, monkeypatch):
    sparsify, used = work.sparsify, []
    monkeypatch.setattr(work, "sparsify", lambda *a, **k: used.append(k["sparsifier"]) or sparsify(*a, **k))
    path = tmp_path / "a.h5"
    options = {"samples": 6, "max_coc": 6.0, "rays": 10_000, "jobs": 1}
    build_database("simplelens", path, sparsifier="lks", **options)
    built = len(used)
    build_database("simplelens", path, extend=True, max_coc=8.0, jobs=1)
    assert len(used) > built and set(used) == {"lks"}
    with pytest.raises(InvalidParameterError, match="built with the sparsifier 'lks': an extension keeps it.*'fit'"):
        build_database("simplelens", path, extend=True, sparsifier="fit", jobs=1)
    with open_database(path) as database:
        assert database.summary()["parameters"]["sparsifier"] == "lks"
    build_database("simplelens", path, **options)
    assert used[-1] == "fit"
    with open_database(path) as database:
        assert database.summary()["parameters"]["sparsifier"] == "fit"


def test_an_unknown_sparsifier_is_refused_before_anything_is_written(tmp_path):
    with pytest.raises(InvalidParameterError, match="sparsifier is 'magic': allowed are 'fit', 'quick', 'lks'"):
        build(tmp_path / "a.h5", sparsifier="magic")
    assert not list(tmp_path.iterdir())


def test_a_database_for_a_frame_is_extended_for_another(tmp_path):
    path = tmp_path / "a.h5"
    build(path, only=[(0, 0), (3, 0)])
    build_database("combined", path, extend=True, only=[(5, 0)], jobs=1)
    with open_database(path) as database:
        stored = np.flatnonzero(np.diff(database.point_start))
        assert stored.tolist() == sorted(database.cell_start[[0, 3, 5]].tolist())


@pytest.mark.parametrize(
    ("model", "options", "message"),
    [
        ("simplelens", {}, "is a database of 'combined', not of 'simplelens'"),
        ("combined", {"samples": 50}, "samples cannot be extended"),
        ("combined", {"blades": 5}, "blades cannot be extended"),
        ("combined", {"density": 0.5}, "cannot thin it out"),
        ("combined", {"max_coc": float("nan")}, "max_coc is nan: it must be finite and above 0"),
        ("combined", {"max_motion": float("inf")}, "max_motion is inf"),
        ("combined", {"seed": 7}, "built with rays 10000 and seed 2"),
    ],
)
def test_what_cannot_be_extended_is_refused(reference, tmp_path, model, options, message):
    path = tmp_path / "a.h5"
    path.write_bytes(reference.read_bytes())
    with pytest.raises(InvalidParameterError, match=message):
        build_database(model, path, extend=True, jobs=1, **options)
    assert path.read_bytes() == reference.read_bytes() and [each.name for each in tmp_path.iterdir()] == ["a.h5"]


def test_extending_needs_a_database(tmp_path):
    with pytest.raises(InvalidParameterError, match="no such file; build it first"):
        build_database("combined", tmp_path / "a.h5", extend=True)


# --- Verifying -----------------------------------------------------------------------------------------------------


def test_a_database_is_verified(reference):
    from spreadlets.precompute.build.verification import verify_database

    with open_database(reference) as database:
        found = verify_database(database, jobs=1)
        assert found["spreadlets"] == database.n_spreadlets and found["cells"] == 12
    assert found["differences"]["ssim"] < 1e-6


@pytest.mark.parametrize("name", ["ssim", "l1", "n_support", "total_variation"])
def test_a_figure_that_is_not_that_of_the_points_is_found(reference, tmp_path, name):
    from spreadlets.precompute.build.verification import verify_database
    from spreadlets.psf.database import STATISTICS

    path = tmp_path / "a.h5"
    path.write_bytes(reference.read_bytes())
    with h5py.File(path, "a") as file:
        table = file["statistics"][...]
        table[:, STATISTICS.index(name)] *= 1.05
        table[:, STATISTICS.index("sparsity")] /= 1.05 if name == "n_support" else 1.0
        file["statistics"][...] = table
    with (
        open_database(path) as database,
        pytest.raises(InvalidDatabaseError, match=f"its ({name}|sparsity) is .* recorded"),
    ):
        verify_database(database, jobs=1)


def test_points_that_are_not_those_of_the_figures_are_found(reference, tmp_path):
    from spreadlets.precompute.build.verification import verify_database

    path = tmp_path / "a.h5"
    path.write_bytes(reference.read_bytes())
    with h5py.File(path, "a") as file:
        file["value"][...] = 1.01 * file["value"][...]
    with open_database(path) as database, pytest.raises(InvalidDatabaseError, match="its energy is 1.01.*more"):
        verify_database(database, jobs=1)


def test_the_lock_is_taken_again_if_the_folder_goes_meanwhile(tmp_path):
    grid = model_grid("combined", samples=12)
    with open_parts(tmp_path / "a.h5", grid) as mine:
        mine.remove()
        with open_parts(tmp_path / "a.h5", grid) as other:
            assert other.folder.is_dir() and isinstance(other, Parts)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("model", "options", "message"),
    [
        ("simplelens", {"max_motion": 5.0}, "the model 'simplelens' has no max_motion"),
        ("volume", {"max_coc": 5.0}, "the model 'volume' has no max_coc"),
        ("combined", {"max_coc": -5.0}, "max_coc is -5: it must be finite and above 0"),
        ("combined", {"max_motion": 0.0}, "max_motion is 0: it must be"),
    ],
)
def test_ranges_that_a_model_has_not_or_cannot_have_are_refused_by_name(tmp_path, model, options, message):
    with pytest.raises(InvalidParameterError, match=message):
        build_database(model, tmp_path / "a.h5", jobs=1, **options)
    assert not list(tmp_path.iterdir())
