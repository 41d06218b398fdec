"""Coloured, turned and one-sided PSFs from database to image."""

from dataclasses import replace
from functools import partial

import numba
import numpy as np
import pytest
from scipy import ndimage

from spreadlets.api import synthesize
from spreadlets.errors import InvalidParameterError
from spreadlets.metrics import ssim
from spreadlets.precompute.build.build import build_database
from spreadlets.precompute.models import registry
from spreadlets.precompute.models.grids import model_settings
from spreadlets.psf.database import open_database
from spreadlets.psf.model import PsfGrid, get_model
from spreadlets.runtime import render
from spreadlets.runtime.plan.plan import needed_spreadlets
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.frame import Frame

SIZE = 64
CAMERA = ThinLens(
    focal_length_mm=50.0, sensor_width_mm=36.0, f_number=0.02, focus_distance_m=4.0, shutter=(-0.25, 0.25)
)
"""Wide open, so that a small frame is blurred by many pixels; glass is built for a camera that glass can serve."""

FEW_RAYS = 30_000
"""For PSFs in full: a million takes 10 s."""

GLASS = ThinLens(focal_length_mm=50.0, sensor_width_mm=36.0, f_number=5.0, focus_distance_m=4.0)

QUICKLY = {"jobs": 1, "sparsifier": "quick", "judge": False}
"""How databases are built here, whose figures nobody looks at."""

pytestmark = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="builds databases")


def depth_of(coc):
    return 1.0 / (1.0 / CAMERA.focus_distance_m - coc / CAMERA.coc_scale(SIZE))


def spot_frame(row, col, coc, depth=None, path=(0.0, 0.0)):
    """A bright pixel on black, with the same labels everywhere."""
    radiance = np.zeros((SIZE, SIZE, 3), np.float32)
    radiance[row, col] = 8.0
    motion = np.broadcast_to(np.float32(path) / CAMERA.shutter_duration, (SIZE, SIZE, 2))
    return Frame(radiance, np.full((SIZE, SIZE), depth or depth_of(coc), np.float32), motion)


def noise_frame(coc):
    """Random blocks of colour, with a CoC for each column."""
    rng = np.random.default_rng(5)
    radiance = rng.random((8, 8, 3)).repeat(8, 0).repeat(8, 1).astype(np.float32)
    return Frame(radiance, np.broadcast_to(depth_of(coc), (SIZE, SIZE)).astype(np.float32))


def centroid(image):
    rows, cols = np.indices(image.shape)
    return np.array([(image * rows).sum(), (image * cols).sum()]) / image.sum()


@pytest.fixture(scope="module")
def triangles(tmp_path_factory):
    path = tmp_path_factory.mktemp("databases") / "triangles.h5"
    build_database("simplelens", path, samples=12, max_coc=12.0, blades=3, rotation=0.0, **QUICKLY)
    with open_database(path) as database:
        yield database


@pytest.fixture(scope="module")
def lens(tmp_path_factory):
    """A singlet and only what a frame needs of it: one CoC radius on both sides of the focus."""
    path = tmp_path_factory.mktemp("databases") / "lens.h5"
    options = {"lens": "singlet", "camera": GLASS, "width": SIZE}
    grid = PsfGrid.of(get_model("physicallens", 8.0, settings=model_settings("physicallens", options)), 12)
    frames = [spot_frame(32, 32, 5.0), spot_frame(32, 32, -5.0)]
    needed = set().union(*(needed_spreadlets(frame, CAMERA, grid) for frame in frames))
    build_database("physicallens", path, samples=12, max_coc=8.0, only=needed, rays=100_000, **options, **QUICKLY)
    with open_database(path) as database:
        yield database


@pytest.fixture(scope="module")
def fog(tmp_path_factory):
    path = tmp_path_factory.mktemp("databases") / "fog.h5"
    options = {"width": SIZE, "psf_radius": 16.0, "camera": CAMERA}
    build_database("volume", path, samples=6, rays=60_000, **options, **QUICKLY)
    with open_database(path) as database:
        yield database


def test_a_triangle_turns_through_focus(triangles):
    """At rotation 0 a corner points right behind focus; the mass lies to its left, and to its right in front."""
    behind, front = (synthesize(spot_frame(32, 32, coc), CAMERA, triangles)[..., 0] for coc in (10.0, -10.0))
    # The pixel's own normalisation by alpha leaves the shape.
    assert np.argwhere(behind[32] > 0.5 * behind.max()).max() > 32 + 7
    assert np.argwhere(front[32] > 0.5 * front.max()).min() < 32 - 7
    np.testing.assert_allclose(front[1:, 1:], behind[1:, 1:][::-1, ::-1], atol=1e-3 * behind.max())


def quiet(frame, database, **options):
    with pytest.warns(UserWarning, match="another camera: f_number is 0.02, built for 5"):
        return synthesize(frame, CAMERA, database, **options)


@pytest.mark.parametrize("coc", [5.0, -5.0])
def test_a_lens_blurs_the_corners_outwards_alike(lens, coc):
    """Mirrored places have mirrored PSFs, so the four corners' images are each other's mirror images."""
    image = quiet(spot_frame(8, 12, coc), lens)[..., :3]
    for rows, cols in ((-1, 1), (1, -1), (-1, -1)):
        row, col = (8 if rows > 0 else SIZE - 9), (12 if cols > 0 else SIZE - 13)
        other = quiet(spot_frame(row, col, coc), lens)[..., :3]
        np.testing.assert_allclose(other[::rows, ::cols], image, atol=0.02 * image.max())
    transposed = quiet(spot_frame(12, 8, coc), lens)[..., :3]
    np.testing.assert_allclose(transposed.swapaxes(0, 1), image, atol=0.02 * image.max())


def test_corners_darken_as_the_lens_darkens_them(lens):
    """The stop of a singlet stands before its glass: only the fourth power of the field's cosine darkens."""
    frame = noise_frame(np.full(SIZE, 5.0))
    bright, dark = (quiet(frame, lens, vignetting=wanted) for wanted in (False, True))
    place = (np.indices((SIZE, SIZE)) - 0.5 * (SIZE - 1)) * CAMERA.sensor_width_mm / SIZE
    cosine_4 = (1.0 + (place**2).sum(axis=0) / CAMERA.focal_length_mm**2) ** -2
    np.testing.assert_allclose(dark[..., :3], bright[..., :3] * cosine_4[..., None], rtol=0.03)
    np.testing.assert_array_equal(dark[..., 3], bright[..., 3])


@pytest.mark.parametrize("coc", [5.0, -5.0])
def test_a_wall_of_one_colour_stays_that_behind_glass(lens, coc):
    """From cell to cell the glass shifts each colour by another way: lines of up to a tenth of the light were seen."""
    radiance = np.broadcast_to(np.float32([0.9, 0.6, 0.3]), (SIZE, SIZE, 3))
    wall = Frame(radiance, np.full((SIZE, SIZE), depth_of(coc), np.float32))
    np.testing.assert_allclose(quiet(wall, lens), np.broadcast_to([0.9, 0.6, 0.3, 1.0], (SIZE, SIZE, 4)), atol=1e-3)


def test_a_lamp_behind_glass_has_a_psf_of_its_own_place_which_is_not_evened(lens, monkeypatch):
    frame = spot_frame(20, 28, 5.0)
    image = quiet(frame, lens)
    monkeypatch.setattr(render, "even_colours", lambda *given: None)
    np.testing.assert_allclose(image, quiet(frame, lens), atol=1e-5 * image.max())


def test_vignetting_needs_a_lens_of_glass(triangles):
    with pytest.raises(InvalidParameterError, match="'simplelens' knows no vignetting; build one of 'physicallens'"):
        synthesize(spot_frame(32, 32, 5.0), CAMERA, triangles, vignetting=True)


def test_a_lens_fringes_a_spot_with_colour_by_side(lens):
    reach = []
    for coc in (5.0, -5.0):
        image = quiet(spot_frame(32, 32, coc), lens)[..., :3]
        rows, cols = np.indices(image.shape[:2])
        reach.append([np.average(np.hypot(rows - 32, cols - 32), weights=plane) for plane in image.T.swapaxes(1, 2)])
    assert reach[0][2] > reach[0][0] and reach[1][0] > reach[1][2]


@pytest.mark.parametrize(
    "name, coc", [("triangles", np.linspace(-11, 11, SIZE)), ("lens", np.repeat([5, -5], SIZE // 2))]
)
def test_spreadlets_agree_with_the_same_psfs_in_full(request, monkeypatch, name, coc):
    monkeypatch.setattr(registry, "trace_psf", partial(registry.trace_psf, rays=FEW_RAYS))
    database, frame = request.getfixturevalue(name), noise_frame(coc)
    run = quiet if name == "lens" else lambda frame, database, **options: synthesize(frame, CAMERA, database, **options)
    sparse, dense = run(frame, database), run(frame, database, method="dense")
    assert ssim(sparse[..., :3], dense[..., :3]) > 0.99


@pytest.mark.filterwarnings("ignore:the focus is at")
def test_fog_agrees_with_the_same_psfs_in_full_and_hides_what_is_far(fog, monkeypatch):
    monkeypatch.setattr(registry, "trace_psf", partial(registry.trace_psf, rays=FEW_RAYS))
    frame = Frame(noise_frame(np.zeros(SIZE)).radiance[..., :3], np.full((SIZE, SIZE), 3.0, np.float32))
    near = Frame(frame.radiance[..., :3], np.full((SIZE, SIZE), 0.05, np.float32))
    with pytest.warns(UserWarning, match="no axis 'coc'"):
        sparse, dense, clear = (
            synthesize(frame, CAMERA, fog),
            synthesize(frame, CAMERA, fog, method="dense"),
            synthesize(near, CAMERA, fog),
        )
    assert ssim(sparse[..., :3], dense[..., :3]) > 0.99
    assert sparse[..., 1].std() < 0.8 * clear[..., 1].std()
    assert sparse[..., 2].mean() < clear[..., 2].mean()


def test_fog_does_not_depend_on_the_lens(fog):
    """Nor do the layers that a frame of one layer is divided into, and what is guessed behind them."""
    depth = np.full((SIZE, SIZE), 3.0, np.float32)
    depth[20:44, 20:44] = 0.5
    frame = Frame(noise_frame(np.zeros(SIZE)).radiance[..., :3], depth)
    with pytest.warns(UserWarning, match="no axis 'coc': the camera's defocus is ignored"):
        wide, narrow = (synthesize(frame, replace(CAMERA, f_number=each), fog) for each in (0.02, 16.0))
    np.testing.assert_array_equal(wide, narrow)
    np.testing.assert_array_equal(wide, synthesize(frame, CAMERA, fog, defocus=False))


def test_fog_keeps_the_texture_that_light_brings_through_it(fog):
    """Blocks of pixels are drawn as one, but not what was never scattered."""
    rng = np.random.default_rng(1)
    radiance = (0.2 + 0.002 * rng.random((SIZE, SIZE, 3))).astype(np.float32)
    frame = Frame(radiance, np.full((SIZE, SIZE), 3.0, np.float32))
    with pytest.warns(UserWarning, match="no axis 'coc'"):
        exact, whole = synthesize(frame, CAMERA, fog, tolerance=0.0, report=True)
        merged, report = synthesize(frame, CAMERA, fog, report=True)
    assert report["plan"]["pixels_merged"] > 0.9 * radiance[..., 0].size
    assert report["plan"]["points_splatted"] < 0.5 * whole["plan"]["points_splatted"]
    assert report["plan"]["pixels_sparse"] == whole["plan"]["pixels_sparse"] and not report["plan"]["pixels_dense"]
    assert (merged[..., 1] - exact[..., 1]).std() < 0.1 * exact[..., 1].std()


def test_a_lens_with_colour_moves_along_straight_and_curved_paths(lens):
    """A spot is drawn at places along its way: the mean of stills of the frame, each moved to where it is then."""
    still = spot_frame(32, 32, 5.2)
    motion = np.broadcast_to(np.float32([24.0, 8.0]), (SIZE, SIZE, 2))
    one = quiet(still, lens)[..., :3]
    moved = quiet(Frame(still.radiance, still.depth, motion), lens)[..., :3]
    times = (np.arange(64) + 0.5) / 64 * CAMERA.shutter_duration + CAMERA.shutter[0]
    truth = np.mean([ndimage.shift(one, (8 * t, 24 * t, 0), order=1) for t in times], axis=0)
    assert np.abs(moved - truth).max() < 0.04 * truth.max()
    paths = {"motion_prev": motion[..., ::-1], "motion_next": motion}
    curved = quiet(Frame(still.radiance, still.depth, motion, **paths), lens)[..., :3]
    assert np.abs(curved - moved).max() > 0.1 * moved.max(), "the path bends"
    assert curved.sum() == pytest.approx(moved.sum(), rel=2e-3)


def test_beyond_the_last_distance_the_last_cell_is_used(fog):
    frame = spot_frame(32, 32, 0.0, depth=9.0)
    with pytest.warns(UserWarning, match="100.00 % of the pixels lie beyond the database's largest distance, 4 m"):
        far = synthesize(frame, CAMERA, fog, defocus=False)
    with pytest.warns(UserWarning) as caught:
        last = synthesize(spot_frame(32, 32, 0.0, depth=3.99), CAMERA, fog)
    assert caught
    np.testing.assert_array_equal(far, last)
