"""Apertures of one's own: built as frames need them, kept by content."""

import os
import time
from dataclasses import replace

import numpy as np
import pytest

import spreadlets as sp
from spreadlets import bokeh, metrics
from spreadlets.errors import InvalidParameterError

pytestmark = pytest.mark.usefixtures("one_processor")

CAMERA = sp.ThinLens(focal_length_mm=80, sensor_width_mm=36, f_number=0.2, focus_distance_m=2.0)
SHAPE = (48, 64)
MODEL = sp.models.SimpleLens(blades=5, rotation=10.0, samples=12, max_coc=12.0)


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv(bokeh.FOLDER, str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture(scope="module")
def frame():
    radiance = np.full((*SHAPE, 3), 0.2, np.float32)
    radiance[20, 30] = 60.0
    return sp.Frame(radiance, np.full(SHAPE, 4.0))


def stored_spreadlets(path):
    with sp.open_database(path) as database:
        return database.summary()["n_spreadlets"]


def refuse(*given, **options):
    raise AssertionError("nothing is to be built")


def test_the_image_is_that_of_a_whole_database_and_the_second_run_builds_nothing(cache, frame, tmp_path, monkeypatch):
    first = sp.synthesize(frame, CAMERA, MODEL)
    # As it is built in a hurry, and as usual.
    for sparsifier, similar in (("quick", 1.0 - 1e-6), ("fit", 0.999)):
        sp.build_database(MODEL, tmp_path / "whole.h5", jobs=1, sparsifier=sparsifier)
        whole = sp.synthesize(frame, CAMERA, str(tmp_path / "whole.h5"))
        assert metrics.compare(first, whole)["ssim"] >= similar
    (database,) = cache.glob("*.h5")
    with sp.open_database(database) as opened:
        assert opened.summary()["parameters"]["sparsifier"] == "quick"
    monkeypatch.setattr("spreadlets.precompute.build.build.build_database", refuse)
    np.testing.assert_array_equal(sp.synthesize(frame, CAMERA, MODEL), first)


def test_another_camera_adds_what_it_needs(cache, frame):
    told = []
    with sp.Renderer(frame, MODEL, progress=lambda *numbers: told.append(numbers)) as renderer:
        renderer.render(CAMERA)
        (database,) = cache.glob("*.h5")
        before = stored_spreadlets(database)
        renderer.render(replace(CAMERA, f_number=0.3))
    assert list(cache.glob("*.h5")) == [database] and stored_spreadlets(database) > before
    assert told


def test_equal_apertures_share_a_file_and_others_do_not(cache):
    paths = [
        bokeh.BokehCache(model).path
        for model in (MODEL, replace(MODEL), replace(MODEL, blades=6), sp.models.Combined(blades=5))
    ]
    assert paths[0] == paths[1] and len(set(paths)) == 3


def test_psfs_of_highlights_are_stored_and_a_damaged_file_is_no_harm(cache, frame, monkeypatch):
    from spreadlets.precompute.models import registry

    first = sp.synthesize(frame, CAMERA, MODEL)
    (stored,) = cache.glob("*.npz")
    monkeypatch.setattr(registry, "_EXACT", {})
    monkeypatch.setattr(registry, "_traced_exactly", refuse)
    np.testing.assert_array_equal(sp.synthesize(frame, CAMERA, MODEL), first)
    monkeypatch.undo()
    monkeypatch.setenv(bokeh.FOLDER, str(cache))
    monkeypatch.setattr(registry, "_EXACT", {})
    stored.write_bytes(stored.read_bytes()[:100])
    np.testing.assert_array_equal(sp.synthesize(frame, CAMERA, MODEL), first)


def test_what_was_not_used_for_the_longest_goes_first(cache, frame, monkeypatch):
    models = [replace(MODEL, blades=blades, samples=6) for blades in (5, 6, 7)]
    files = [bokeh.BokehCache(model).path for model in models]
    for age, model, file in zip((200, 100), models, files, strict=False):
        sp.synthesize(frame, CAMERA, model)
        os.utime(file, (time.time() - age,) * 2)
    sp.synthesize(frame, CAMERA, models[0])  # the older one is used again
    monkeypatch.setattr(bokeh, "MOST_BYTES", sum(each.stat().st_size for each in cache.iterdir()) + 1000)
    sp.synthesize(frame, CAMERA, models[2])
    assert [file.exists() for file in files] == [True, False, True]
    assert not list(cache.glob(f"{files[1].stem}.*"))


def test_an_image_may_be_the_psf(cache, frame, tmp_path):
    from PIL import Image

    half = np.zeros((32, 32), np.uint8)
    half[:, 16:] = 255
    Image.fromarray(half).save(tmp_path / "half.png")
    model = replace(bokeh.bokeh_model(moving=True, kernel=str(tmp_path / "half.png")), samples=8, max_coc=12.0)
    image = sp.synthesize(frame, CAMERA, model)
    light = image[..., 0] - 0.2
    assert light[:, 31:].sum() > 20 * np.abs(light[:, :30].sum())


def test_impossible_apertures_are_refused(cache, frame):
    with pytest.raises(InvalidParameterError, match="blades is 2"):
        sp.synthesize(frame, CAMERA, sp.models.SimpleLens(blades=2))


def centroid(image, at, reach=12):
    """Return where the light around a place (row, col) lies from it, (x, y), px."""
    rows, cols = (slice(each - reach, each + reach + 1) for each in at)
    light = image[rows, cols, 0] - 0.2
    ticks = np.arange(-reach, reach + 1)
    return np.array([light.sum(axis=0) @ ticks, light.sum(axis=1) @ ticks]) / light.sum()


@pytest.mark.parametrize(("depth", "side"), [(4.0, 1.0), (1.4, -1.0)])
def test_a_radial_cats_eye_grows_towards_the_corners_in_motion_too(cache, depth, side):
    shape, lamps = (96, 128), ((48, 64), (48, 20), (48, 107), (16, 20))
    radiance = np.full((*shape, 3), 0.2, np.float32)
    for at in lamps:
        radiance[at] = 60.0
    camera = replace(CAMERA, f_number=0.4, shutter=(-0.5, 0.5))
    assert 5.0 < abs(camera.coc_radius(np.array([depth]), 128)[0]) < 9.0
    still = np.zeros((*shape, 2), np.float32)
    model = bokeh.bokeh_model(moving=True, cats_eye=1.2, cats_eye_radial=True)
    assert isinstance(model, sp.models.SimpleLens) and not isinstance(model, sp.models.Combined)
    for motion in (still, still + np.array([3.0, 0.0], np.float32)):
        image = sp.synthesize(sp.Frame(radiance, np.full(shape, depth), motion), camera, model)
        middle, left, right, corner = (centroid(image, at) for at in lamps)
        # Behind the focus the middle's side stays, in front of it the other.
        assert np.abs(middle).max() < 0.3
        assert left[0] * side > 0.8 and abs(left[1]) < 0.3 and right[0] * side < -0.8
        assert corner[0] * side > 0.8 and corner[1] * side > 0.6
