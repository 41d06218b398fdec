"""The benchmark on a tiny frame: who is on the front, what is resumed, what is written, what is left out."""

import csv
import json
import time
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from spreadlets.cli.main import cli
from spreadlets.errors import InvalidParameterError
from spreadlets.files.exr_frames import write_frame
from spreadlets.files.images import write_image
from spreadlets.reports.bench import bench, contenders
from spreadlets.reports.bench.bench import Notebook, run_bench, summary, verdicts
from spreadlets.reports.bench.contenders import Contender, missing_for
from spreadlets.reports.bench.rows import METRICS, Row, front, panels
from spreadlets.reports.bench.subjects import given_subject, shipped_subject, subjects_in
from spreadlets.scene.frame import Frame

CAMERA = {
    "focal_length_mm": 50.0,
    "sensor_width_mm": 36.0,
    "f_number": 0.1,
    "focus_distance_m": 4.0,
    "shutter_open_close_frames": [-0.25, 0.25],
}
CONDITIONS = {"processor": "abacus", "threads": 1}


def row(method, seconds, ssim, knob="default", **others):
    given = {"frame": "f", "task": "synthesis", "source": "one layer", "flip": 1 - ssim, "psnr": 30.0, "relmse": 0.1}
    runs = [] if seconds is None else [0.9 * seconds, seconds, 1.2 * seconds]
    return Row(**(given | {"method": method, "knob": knob, "ssim": ssim, "runs_s": runs} | others))


# --- the front


def test_the_front_holds_what_nothing_beats():
    fast, good, slow, bad = row("a", 1, 0.9), row("b", 3, 0.95), row("c", 4, 0.94), row("d", 1.5, 0.8)
    assert front([slow, bad, good, fast], "ssim") == [fast, good]
    assert front([slow, bad, good, fast], "flip") == [fast, good]


@pytest.mark.parametrize("metric", ["ssim", "flip"])
def test_the_front_is_that_of_all_pairs(metric):
    rng = np.random.default_rng(0)
    rows = [row(str(i), *pair) for i, pair in enumerate(rng.random((60, 2)))]
    sign = 1 if metric == "ssim" else -1
    errors = [sign * getattr(each, metric) for each in rows]
    expected = [
        a
        for a, x in zip(rows, errors, strict=True)
        if not any(b.seconds < a.seconds and y > x for b, y in zip(rows, errors, strict=True))
    ]
    assert front(rows, metric) == sorted(expected, key=lambda each: each.seconds)


def test_rows_without_time_or_error_are_not_on_the_front():
    assert front([row("a", None, 0.9), row("b", 1, float("nan"))], "ssim") == []


def test_the_verdict_names_what_is_faster_and_better():
    ours, other = row("spreadlets", 2, 0.9, flip=0.01), row("oidn", 1, 0.95, flip=0.02)
    lines = verdicts([ours, other])
    assert lines[0] == "ssim: spreadlets is NOT on the front; faster and no worse than its best: oidn"
    assert lines[1] == "flip: spreadlets is on the front (default)"


def test_what_cannot_be_compared_is_kept_apart_and_renders_have_no_panel():
    rows = [row("a", 1, 0.9), row("a", 1, 0.9, source="layers"), row("a", 1, 0.9, source="render")]
    assert [key[2] for key in panels(rows)] == ["one layer", "layers"]
    text = "\n".join(summary([*rows, row("bm3d", None, float("nan"), note="not installed")], CONDITIONS))
    assert "Plain Monte Carlo renders\n  f, a " in text and "synthesis, bm3d: not installed" in text


def test_the_spread_is_that_of_the_runs():
    each = row("a", 2, 0.9)
    assert (each.seconds, *each.spread) == pytest.approx((2, 1.8, 2.4))


# --- what is measured


@pytest.fixture
def folder(tmp_path):
    """A folder with one tiny frame, its reference, and a noisy render."""
    rng = np.random.default_rng(1)
    colours = rng.random((24, 24, 3)).astype(np.float32)
    write_frame(tmp_path / "tiny_pinhole.exr", Frame(colours, np.full((24, 24), 4.0), np.zeros((24, 24, 2))))
    for name in ("ref_dofmb", "noisy4", "noisy16"):
        write_image(tmp_path / f"tiny_{name}.exr", np.dstack([colours, np.ones((24, 24), np.float32)]))
    (tmp_path / "tiny.json").write_text(json.dumps(CAMERA | {"render_time_s": {"4": 2.5}}))
    (tmp_path / "other.json").write_text("{}")
    return tmp_path


def test_a_folder_is_searched_for_whole_sets(folder):
    (subject,) = subjects_in(folder)
    assert subject.name == "tiny" and list(subject.render_files) == [4, 16] and subject.render_times == {4: 2.5}
    assert subject.samples_file is None and not subject.layer_files
    assert shipped_subject().frame.shape == (512, 512)


def counted(monkeypatch):
    """Replace the registry by a few contenders and count their runs."""
    runs = {"good": 0, "noisy": 0, "broken": 0}

    def made(subject, name, noise):
        def make():
            runs[name] += 1
            time.sleep(0.001)
            if name == "broken":
                raise InvalidParameterError("out of order")
            image = subject.reference.copy()
            image[..., :3] += noise * np.random.default_rng(2).random(image[..., :3].shape, np.float32)
            return image

        return make

    def listed(subject, databases, *, quick):
        for name, noise in (("good", 0.0), ("noisy", 0.3), ("broken", 0.0)):
            yield Contender("synthesis", "one layer", name, "default", made(subject, name, noise))
        yield Contender("synthesis", "one layer", "absent", "default", None, "package absent is not installed")
        for spp in subject.render_files:
            yield Contender("reconstruction", "render", "monte carlo", f"{spp} spp", None, "")

    monkeypatch.setattr(bench, "contenders", listed)
    return runs


@pytest.fixture
def no_plots(monkeypatch):
    """For runs whose plots nobody looks at: they take longer than all else."""
    monkeypatch.setattr(bench, "save_plots", lambda folder, rows: [])


def test_all_contenders_run_in_turns_and_everything_is_written(folder, monkeypatch, tmp_path):
    runs = counted(monkeypatch)
    out = tmp_path / "out"
    steps = []
    report = run_bench(subjects_in(folder), out, progress=lambda done, total: steps.append((done, total)))
    assert runs == {"good": 1 + bench.ROUNDS, "noisy": 1 + bench.ROUNDS, "broken": 1}
    assert steps[-1][0] == steps[-1][1]
    with (out / "bench.csv").open() as file:
        rows = {(each["method"], each["knob"]): each for each in csv.DictReader(file)}
    assert float(rows["good", "default"]["ssim"]) == 1.0 and float(rows["noisy", "default"]["ssim"]) < 1.0
    assert int(rows["good", "default"]["runs"]) == bench.ROUNDS
    assert rows["broken", "default"]["note"] == "InvalidParameterError: out of order"
    assert rows["absent", "default"]["note"] == "package absent is not installed"
    assert float(rows["monte carlo", "4 spp"]["seconds"]) == 2.5
    assert rows["monte carlo", "16 spp"]["seconds"] == "nan"
    assert "on_front_of" in rows["good", "default"] and "ssim" in rows["good", "default"]["on_front_of"]
    page = (out / "bench.html").read_text()
    assert page.count("data:image/jpeg") == 2 * 2 + 1 and "@BODY@" not in page and 'src="http' not in page
    for metric in METRICS:
        assert (out / f"synthesis_{metric}.png").stat().st_size > 1000
    assert any("fastest first" in line for line in report["summary"])


def test_an_interrupted_run_goes_on_and_a_fresh_one_does_not(folder, monkeypatch, no_plots, tmp_path):
    out = tmp_path / "out"
    counted(monkeypatch)
    run_bench(subjects_in(folder), out)
    runs = counted(monkeypatch)
    built = out / bench.DATABASES / "of_an_older_frame.h5"
    built.parent.mkdir(exist_ok=True)
    built.touch()
    run_bench(subjects_in(folder), out)
    assert runs == {"good": 0, "noisy": 0, "broken": 0} and built.exists()
    run_bench(subjects_in(folder), out, fresh=True)
    assert runs["good"] == 1 + bench.ROUNDS and not built.exists()


def test_figures_of_another_source_are_dropped(tmp_path):
    notebook = Notebook(tmp_path, {"source": "a"}, fresh=False)
    notebook.rows["f/x"] = row("a", 1, 0.9)
    notebook.save()
    assert Notebook(tmp_path, {"source": "a"}, fresh=False).rows["f/x"].runs_s == row("a", 1, 0.9).runs_s
    assert not Notebook(tmp_path, {"source": "b"}, fresh=False).rows


def test_what_takes_long_is_timed_less_often(folder, monkeypatch, no_plots, tmp_path):
    runs = counted(monkeypatch)
    monkeypatch.setattr(bench, "MOST_SECONDS", 0.0)
    run_bench(subjects_in(folder), tmp_path / "out")
    assert runs["good"] == 1 + bench.FEWEST_RUNS


# --- the registry


def test_the_registry_names_every_method_once(folder):
    (subject,) = subjects_in(folder)
    keys = [each.key for each in contenders.contenders(subject, folder, quick=False)]
    assert len(set(keys)) == len(keys)
    assert {key.split("/")[2] for key in keys} >= {"spreadlets", "dense", "gather", "blender nodes", "monte carlo"}
    quick = [each.key for each in contenders.contenders(subject, folder, quick=True)]
    assert set(quick) < set(keys)


def test_every_contender_of_a_frame_makes_an_image(folder):
    (subject,) = subjects_in(folder)
    for each in contenders.contenders(subject, folder, quick=True):
        if each.make is not None:
            assert np.allclose(each.make()[..., :3], subject.reference[..., :3], atol=1e-3), each.key
    subject.close()


@pytest.mark.parametrize("method", contenders.RECONSTRUCTION_PEERS)
def test_a_method_runs_or_says_what_is_missing(method, monkeypatch):
    assert missing_for(method) == "" or "no such method" in missing_for(method) or "pip install" in missing_for(method)
    monkeypatch.setattr(contenders, "RECONSTRUCTION_METHODS", (method,))
    monkeypatch.setattr(contenders, "find_spec", lambda package: None)
    package = contenders.OPTIONAL_PACKAGES.get(method)
    assert missing_for(method) == (
        f"package {package} is not installed (pip install 'spreadlets[bench]')" if package else ""
    )


# --- the command


def test_a_frame_of_ones_own_needs_camera_and_reference(folder):
    frame = str(folder / "tiny_pinhole.exr")
    with pytest.raises(InvalidParameterError, match="need --camera and --reference"):
        given_subject([frame], None, None, None)
    with pytest.raises(InvalidParameterError, match="nowhere.json does not exist"):
        given_subject([frame], None, "nowhere.json", frame)
    result = CliRunner().invoke(cli, ["bench", "--camera", "camera.json"])
    assert result.exit_code == 2 and "come with --frame or --samples" in result.output


@pytest.mark.parametrize("own", [True, False])
def test_the_command_prints_a_summary(folder, monkeypatch, no_plots, tmp_path, own):
    counted(monkeypatch)
    given = ["--frames", str(folder)]
    if own:
        given = ["--frame", "tiny_pinhole.exr", "--camera", "tiny.json", "--reference", "tiny_ref_dofmb.exr"]
        given = [str(folder / each) if "." in each else each for each in given]
    out = tmp_path / "out"
    as_json = ["--json"] if own else []
    result = CliRunner().invoke(cli, ["bench", "--quick", "--out", str(out), *given, *as_json])
    assert result.exit_code == 0, result.output
    assert Path(out / "bench.html").exists()
    if not own:
        assert "the front by SSIM" in result.output
    with (out / "bench.csv").open() as file:
        row = json.loads(result.output)["rows"][0] if own else next(csv.DictReader(file))
    assert int(row["runs"]) == bench.QUICK_ROUNDS and row["frame"].startswith("tiny")


def test_without_any_frame_there_is_one_error(tmp_path):
    with pytest.raises(InvalidParameterError, match="no frame to run on"):
        run_bench([], tmp_path)


def test_a_folder_without_frames_is_refused_and_not_replaced_by_the_frame_that_ships(tmp_path):
    for folder in (tmp_path, tmp_path / "none"):
        result = CliRunner().invoke(cli, ["bench", "--frames", str(folder), "--out", str(tmp_path / "out")])
        assert isinstance(result.exception, InvalidParameterError | SystemExit)
        assert "holds no frame" in f"{result.output}{result.exception}"
    assert not list(tmp_path.iterdir())


def test_layers_of_a_folder_are_in_the_order_of_their_numbers(tmp_path):
    for name in ("a.json", "a_ref_dofmb.exr", "a_pinhole.exr", *(f"a_layer{number}.exr" for number in range(12))):
        (tmp_path / name).touch()
    (subject,) = subjects_in(tmp_path)
    assert [path.name for path in subject.layer_files] == [f"a_layer{number}.exr" for number in range(12)]
