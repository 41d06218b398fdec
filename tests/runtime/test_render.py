"""The whole runtime on frames small enough to know the answer."""

from dataclasses import replace

import numpy as np
import pytest
from naive.psfs import capsule_psf, disc_coverage

from spreadlets.api import synthesize as synthesize_any
from spreadlets.errors import InvalidParameterError
from spreadlets.metrics import psf_l1
from spreadlets.runtime.options import Options
from spreadlets.runtime.plan.variant import scaled
from spreadlets.scene.camera import LensKey, ThinLens
from spreadlets.scene.display import display_encode
from spreadlets.scene.frame import Frame

SIZE = 65


def synthesize(*arguments, **options):
    """Render and return the image and the report."""
    return synthesize_any(*arguments, **options, report=True)


CAMERA = ThinLens(
    focal_length_mm=50.0, sensor_width_mm=36.0, f_number=0.02, focus_distance_m=4.0, shutter=(-0.25, 0.25)
)


def depth_of(coc, size=SIZE):
    """Depth, metres, of a signed CoC radius, px: the lens equation the other way round."""
    scale = 0.5 * (0.05 / CAMERA.f_number) * (50.0 / 36.0 * size)
    return 1.0 / (1.0 / CAMERA.focus_distance_m - coc / scale)


def spot_frame(row, col, coc, path=(0.0, 0.0), size=SIZE, camera=CAMERA):
    """A single bright pixel on black; every pixel has the same CoC and the same motion (dx, dy) over the shutter."""
    radiance = np.zeros((size, size, 3), np.float32)
    radiance[row, col] = (4.0, 2.0, 1.0)
    depth = np.full((size, size), depth_of(coc, size), np.float32)
    motion = np.broadcast_to(np.array(path, np.float32) / camera.shutter_duration, (size, size, 2))
    return Frame(radiance, depth, motion)


def shifted_window(psf, row, col, size=SIZE):
    """Cut the frame out of a PSF whose centre lies at (row, col)."""
    half = psf.shape[0] // 2
    canvas = np.zeros((size + 2 * half, size + 2 * half))
    canvas[row : row + psf.shape[0], col : col + psf.shape[1]] = psf
    return canvas[half : half + size, half : half + size]


def centroid(image):
    rows, cols = np.indices(image.shape)
    return np.array([(image * rows).sum(), (image * cols).sum()]) / image.sum()


LABELS = [(-5, 0, 0), (9, 0, 0), (6, 9, 200), (4, 12, 33), (-5, 15, 118), (2, 14, 45), (0, 10, 290), (0, 0, 0)]


@pytest.mark.parametrize(("coc", "length", "angle"), LABELS)
def test_a_bright_pixel_becomes_its_point_spread_function(small_combined, coc, length, angle):
    radians = np.deg2rad(angle)
    path = length * np.cos(radians), length * np.sin(radians)
    image, _ = synthesize(spot_frame(32, 32, coc, path), CAMERA, small_combined)
    radius = abs(coc) or 0.1  # a PSF within its pixel is the pixel
    exact = capsule_psf(radius, length, radians, SIZE) if length else disc_coverage(radius, size=SIZE)
    red = image[..., 0] / 4.0
    assert np.allclose(image[..., 1], image[..., 0] / 2, atol=1e-5), "colours keep their ratios"
    assert red.sum() == pytest.approx(1.0, rel=1e-3)
    assert np.abs(centroid(red) - 32).max() < 0.05
    spread, expected = second_moments(red), second_moments(exact)
    assert np.abs(spread - expected).max() < 0.05 * (radius**2 / 4 + length**2 / 12) + 0.1


@pytest.mark.parametrize("place", [(1, 1), (1, 40), (63, 62), (20, 63), (0, 64)])
@pytest.mark.parametrize(("coc", "length", "angle"), LABELS)
def test_at_the_border_it_is_the_same_function_cut_off(small_combined, place, coc, length, angle):
    radians = np.deg2rad(angle)
    path = length * np.cos(radians), length * np.sin(radians)
    whole, _ = synthesize(spot_frame(32, 32, coc, path), CAMERA, small_combined)
    image, _ = synthesize(spot_frame(*place, coc, path), CAMERA, small_combined)
    expected = shifted_window(whole[..., 0], *place)
    assert np.abs(image[..., 0] - expected).max() < 2e-3 * expected.max()
    assert image[..., 0].sum() == pytest.approx(expected.sum(), rel=1e-3)


def second_moments(image):
    """Variances along the rows, along the columns, and their covariance, px^2."""
    rows, cols = np.indices(image.shape) - centroid(image)[:, None, None]
    return np.array([(image * rows**2).sum(), (image * cols**2).sum(), (image * rows * cols).sum()]) / image.sum()


@pytest.mark.parametrize("shutter", [(0.0, 0.5), (-0.5, 0.0), (0.1, 0.23)])
def test_an_uncentred_shutter_moves_the_centroid_by_a_fraction_of_a_pixel(small_combined, shutter):
    camera = ThinLens(50.0, 36.0, 0.02, 4.0, shutter)
    frame = spot_frame(30, 30, 3.0, (7.0, -4.0), camera=camera)
    image, _ = synthesize(frame, camera, small_combined)
    per_frame = np.array([-4.0, 7.0]) / camera.shutter_duration
    expected = 30 + per_frame * camera.shutter_centre
    assert np.abs(centroid(image[..., 0]) - expected).max() < 0.1
    assert image[..., 0].sum() == pytest.approx(4.0, rel=5e-3)


def test_a_turning_path_is_drawn_along_its_arc():
    """A quarter turn in a frame, half of which the shutter sees: the chords stay by the circle."""
    radius, camera = 24.0, replace(CAMERA, shutter=(-0.5, 0.5))

    def place(time):
        return radius * np.array([np.sin(np.pi / 2 * time), 1.0 - np.cos(np.pi / 2 * time)])

    still = spot_frame(20, 32, 0.0)
    before, after = (np.broadcast_to(path, (SIZE, SIZE, 2)) for path in (-place(-1.0), place(1.0)))
    frame = Frame(still.radiance, still.depth, (before + after) / 2, motion_prev=before, motion_next=after)
    light = synthesize(frame, camera)[0][..., 0]
    rows, cols = np.indices(light.shape)
    distance = np.abs(np.hypot(rows - 20 - radius, cols - 32) - radius)
    assert (light * distance).sum() / light.sum() < 0.7  # measured 0.53: a line is two pixels wide


def test_a_constant_frame_stays_constant_up_to_its_border(small_combined):
    rng = np.random.default_rng(0)
    radiance = np.full((48, 57, 3), 0.7, np.float32)
    depth = depth_of(rng.uniform(-10, 10, (48, 57)), 57).astype(np.float32)
    motion = rng.uniform(-20, 20, (48, 57, 2)).astype(np.float32)
    image, _ = synthesize(Frame(radiance, depth, motion), CAMERA, small_combined)
    assert np.allclose(image[..., :3], 0.7, rtol=2e-3)
    assert (image[..., 3] == 1).all()


def test_in_focus_and_still_nothing_changes(small_combined):
    rng = np.random.default_rng(1)
    radiance = rng.random((20, 31, 3)).astype(np.float32)
    image, report = synthesize(Frame(radiance, np.full((20, 31), 4.0)), CAMERA, small_combined)
    assert np.allclose(image[..., :3], radiance, atol=1e-5)
    assert {"motion", "defocus", "empty pixels"} & set(report["plan"]["left_out"]) == {"motion", "defocus"}


def test_layers_are_composited_nearest_first(small_combined):
    red, blue = np.zeros((2, 24, 24, 4), np.float32)
    red[:, :12] = (1, 0, 0, 1)
    blue[...] = (0, 0, 1, 1)
    in_focus = np.full((24, 24), 4.0)
    image, report = synthesize(Frame.from_layers([(red, in_focus), (blue, in_focus)]), CAMERA, small_combined)
    assert np.allclose(image[:, :12], (1, 0, 0, 1), atol=1e-5)
    assert np.allclose(image[:, 12:], (0, 0, 1, 1), atol=1e-5)
    assert report["plan"]["layers"] == 2


def test_what_lies_across_the_picture_is_cut_off_as_what_stands_in_it(small_combined):
    """A rail out of focus, before a texture in focus: it does not hide the texture, nor does that sharpen the rail."""
    coc = np.full((SIZE, SIZE), 0.0)
    coc[28:36] = -11.0
    radiance = np.random.default_rng(0).uniform(0.2, 0.8, (SIZE, SIZE, 1)) * np.ones(3)
    radiance[28:36] = (0.9, 0.1, 0.1)
    lying, _ = synthesize(Frame(radiance, depth_of(coc)), CAMERA, small_combined)
    turned = Frame(np.swapaxes(radiance, 0, 1), depth_of(coc.T))
    standing, report = synthesize(turned, CAMERA, small_combined)
    assert report.plan.layers == 2
    inner = slice(14, -14)
    assert np.abs(np.swapaxes(lying, 0, 1) - standing)[inner, inner].max() < 2e-3


def test_a_lone_opaque_pixel_keeps_its_transparency(small_combined):
    radiance = np.zeros((41, 41, 4), np.float32)
    radiance[20, 20] = 1.0
    image, report = synthesize(Frame(radiance, np.full((41, 41), depth_of(6.0, 41))), CAMERA, small_combined)
    assert image[..., 0].sum() == pytest.approx(1.0, rel=5e-3)
    assert image[..., 3].max() < 0.05
    assert report["plan"]["pixels_skipped"] == 41 * 41 - 1


def test_effects_can_be_switched_off(small_combined):
    frame = spot_frame(32, 32, 6.0, (12.0, 0.0))
    spread = {}
    for name, options in {"both": {}, "dof": {"motion": False}, "mb": {"defocus": False}}.items():
        image, _ = synthesize(frame, CAMERA, small_combined, **options)
        rows, cols = np.nonzero(image[..., 0] > 1e-3)
        spread[name] = np.ptp(rows), np.ptp(cols)
    assert spread["dof"][0] == pytest.approx(spread["dof"][1], abs=1)
    assert spread["mb"][0] <= 2 < spread["mb"][1]
    assert spread["both"][1] > spread["dof"][1]


def test_sparse_and_dense_agree(small_combined):
    frame = spot_frame(32, 32, 9.0, (10.0, 6.0))
    sparse = synthesize_any(frame, CAMERA, small_combined)
    dense, report = synthesize_any(frame, CAMERA, small_combined, method="dense", report=True)
    assert report["plan"]["pixels_sparse"] == 0
    assert psf_l1(dense[..., 0], sparse[..., 0]) < 0.1
    assert sparse.mean() == pytest.approx(dense.mean(), rel=1e-3)


def test_differences_along_rows_sum_up_to_the_psf_whichever_way_it_is_turned(small_combined):
    frame = spot_frame(32, 32, 9.0, (-4.0, 10.0))
    dense = synthesize_any(frame, CAMERA, small_combined, method="dense")
    rows, report = synthesize_any(frame, CAMERA, small_combined, method="dense-rows", report=True)
    assert psf_l1(dense[..., 0], rows[..., 0]) < 0.02
    assert report["plan"]["points_splatted"] > 0 and rows.mean() == pytest.approx(dense.mean(), rel=1e-5)


def frame_with(coc=9.0, path=(10.0, 6.0)):
    """A textured frame of one label."""
    frame = spot_frame(32, 32, coc, path)
    return Frame(np.random.default_rng(1).random((SIZE, SIZE, 3)), frame.depth, frame.motion)


def test_an_empty_pixel_is_not_drawn_and_changes_nothing(small_combined):
    frame = frame_with()
    radiance = np.dstack([frame.radiance[..., :3], np.ones((SIZE, SIZE))]).astype(np.float32)
    radiance[20:40, 10:30] = 0
    faint = radiance.copy()
    faint[20:40, 10:30, :3] = 1e-30
    lean, report = synthesize(Frame(radiance, frame.depth, frame.motion), CAMERA, small_combined, tolerance=0.0)
    full, drawn = synthesize(Frame(faint, frame.depth, frame.motion), CAMERA, small_combined, tolerance=0.0)
    assert report["plan"]["pixels_skipped"] == 400 and drawn["plan"]["pixels_skipped"] == 0
    assert np.allclose(lean, full, atol=1e-6)


@pytest.mark.parametrize(("effect", "labels"), [("motion", {"path": (0.0, 0.0)}), ("defocus", {"coc": 0.0})])
def test_an_effect_that_no_pixel_shows_can_as_well_be_switched_off(small_combined, effect, labels):
    frame = frame_with(**labels)
    lean, report = synthesize(frame, CAMERA, small_combined)
    off, _ = synthesize(frame, CAMERA, small_combined, **{effect: False})
    assert effect in report["plan"]["left_out"] and np.array_equal(lean, off)


def test_without_sparse_pixels_the_solver_is_not_needed(small_combined):
    frame = frame_with(coc=1.0, path=(0.0, 0.0))
    lean, report = synthesize(frame, CAMERA, small_combined)
    depth = frame.depth.copy()
    depth[0, 0] = depth_of(9.0)
    full, needed = synthesize(Frame(frame.radiance, depth), CAMERA, small_combined)
    assert "sparse image" in report["plan"]["left_out"] and report["time_s"]["integrate"] == 0.0
    assert "sparse image" not in needed["plan"]["left_out"] and needed["time_s"]["integrate"] > 0.0
    assert np.allclose(full[30:, 30:], lean[30:, 30:], atol=1e-4)


def test_without_direct_pixels_there_is_no_direct_image(small_combined):
    lean, report = synthesize(frame_with(), CAMERA, small_combined)
    frame = frame_with()
    depth, motion = frame.depth.copy(), frame.motion.copy()
    depth[0, 0], motion[0, 0] = CAMERA.focus_distance_m, 0.0
    full, needed = synthesize(Frame(frame.radiance, depth, motion), CAMERA, small_combined)
    assert "direct image" in report["plan"]["left_out"] and "direct image" not in needed["plan"]["left_out"]
    assert np.allclose(full[40:, 40:], lean[40:, 40:], atol=1e-4)


def test_a_centred_shutter_needs_no_sub_pixel_placement(small_combined):
    frame = frame_with()
    centred, report = synthesize(frame, CAMERA, small_combined, tolerance=0.0)
    nearly, needed = synthesize(frame, replace(CAMERA, shutter=(-0.2500001, 0.25)), small_combined, tolerance=0.0)
    assert "sub-pixel placement" in report["plan"]["left_out"]
    assert "sub-pixel placement" not in needed["plan"]["left_out"]
    # As far from the border as light comes in from outside: what moves goes on straight there.
    assert np.allclose(centred[16:-16, 16:-16], nearly[16:-16, 16:-16], atol=1e-4)


def test_no_pixel_beyond_the_range_needs_no_scaled_psf(small_combined):
    at_the_end, report = synthesize(frame_with(coc=11.999), CAMERA, small_combined)
    with pytest.warns(UserWarning, match="beyond the database's range"):
        beyond, needed = synthesize(frame_with(coc=12.001), CAMERA, small_combined)
    assert "scaled PSFs" in report["plan"]["left_out"] and "scaled PSFs" not in needed["plan"]["left_out"]
    assert np.abs(at_the_end - beyond).max() < 0.05


def test_more_cycles_come_closer_to_the_exact_solution(small_combined):
    frame = spot_frame(32, 32, 9.0, (10.0, 6.0))
    exact, _ = synthesize(frame, CAMERA, small_combined, integrator="exact")
    error = []
    for cycles in (0, 1, 2):
        image, _ = synthesize(frame, CAMERA, small_combined, integrator="multigrid", cycles=cycles)
        error.append(np.abs(image - exact).max() / exact[..., :3].max())
    assert error[0] > 3 * error[1] > 3 * error[2] and error[1] < 1e-3


def test_gathering_equals_splatting_where_labels_are_alike(small_combined):
    labels = spot_frame(32, 32, 9.0, (10.0, 6.0))
    radiance = np.zeros((SIZE, SIZE, 3), np.float32)
    radiance[20:45, 20:45] = np.random.default_rng(0).uniform(0.3, 1.0, (25, 25, 3))
    frame = Frame(radiance, labels.depth, labels.motion)
    dense = synthesize_any(frame, CAMERA, small_combined, method="dense")
    gathered = synthesize_any(frame, CAMERA, small_combined, method="gather")
    assert np.allclose(gathered, dense, atol=1e-5)


def test_gathering_takes_the_label_of_the_receiver(small_combined):
    frame = spot_frame(32, 32, 9.0)
    depth = frame.depth.copy()
    depth[:, :32] = CAMERA.focus_distance_m
    gathered = synthesize_any(Frame(frame.radiance, depth), CAMERA, small_combined, method="gather")
    assert gathered[:, :32, 0].max() == 0 and gathered[32, 33, 0] > 0


@pytest.mark.parametrize("changing", ["lens", "depth"])
def test_gathering_takes_the_moment_at_mid_shutter_of_what_changes(small_combined, changing):
    """A filter has one PSF for each pixel: of a changing frame it gives what it gives of the frame at that moment."""
    ones, depth = np.ones((24, 24, 3), np.float32), np.full((24, 24), depth_of(3.0, 24))
    ones[8:16, 8:16] = 4.0
    keys = LensKey(-0.25, focus_distance_m=3.9), LensKey(0.25, focus_distance_m=4.3)
    camera = replace(CAMERA, keys=keys if changing == "lens" else ())
    others = {"depth_prev": 2.0 * depth, "depth_next": 0.5 * depth} if changing == "depth" else {}
    gathered = synthesize_any(Frame(ones, depth, **others), camera, small_combined, method="gather")
    still = synthesize_any(Frame(ones, depth), camera.at(camera.shutter_centre), small_combined, method="gather")
    assert np.array_equal(gathered, still) and np.allclose(gathered[..., 3], 1.0, atol=1e-6)


def test_gathering_takes_a_shutter_of_any_curve_as_evenly_open(small_combined):
    ones = np.ones((24, 24, 3), np.float32)
    ones[8:16, 8:16] = 4.0
    frame = Frame(ones, np.full((24, 24), depth_of(3.0, 24)), np.full((24, 24, 2), 4.0))
    curved, even = (
        synthesize_any(frame, replace(CAMERA, shutter_curve=curve), small_combined, method="gather")
        for curve in ((0.0, 1.0, 0.0), None)
    )
    assert np.array_equal(curved, even) and curved.std() > 0


def test_gathering_around_holes_and_blended_depths_takes_no_light_from_nowhere(small_combined):
    depth = np.full((48, 48), depth_of(9.0, 48))
    depth[:, 24:] = depth_of(3.0, 48)
    depth[:, 24] = 2 / (1 / depth[0, 0] + 1 / depth[0, 47])
    radiance = np.full((48, 48, 4), 0.25)
    radiance[:, 24:] = 0.5
    radiance[:, 24] = 0.375
    radiance[:20] = 0.0
    for _ in range(20):  # leaves bad numbers in memory that is used again
        np.full((48, 48, 4), np.nan, np.float32)
    gathered = synthesize_any(Frame(radiance, depth), CAMERA, small_combined, method="gather")
    assert np.isfinite(gathered).all() and gathered.max() <= 0.5 * (1 + 1e-3)
    assert gathered[36:, :12] == pytest.approx(0.25, rel=1e-3)


def uneven_frame():
    """A gently varying frame with a highlight: blocks of its pixels are alike, but not the same."""
    rng = np.random.default_rng(3)
    rows, cols = np.indices((96, 96))
    radiance = np.repeat((0.3 + 0.2 * np.sin(rows / 9) * np.cos(cols / 7))[..., None], 3, axis=2)
    radiance += 0.02 * rng.random(radiance.shape)
    radiance[40, 50] = 30.0
    return Frame(radiance, np.full((96, 96), depth_of(10.0, 96)))


@pytest.mark.parametrize("tolerance", [None, 0.03])
def test_a_tolerance_keeps_its_bound_and_draws_less(small_combined, tolerance):
    exact, whole = synthesize(uneven_frame(), CAMERA, small_combined, tolerance=0.0)
    merged, report = synthesize(uneven_frame(), CAMERA, small_combined, tolerance=tolerance)
    change = np.abs(display_encode(merged[..., :3]) - display_encode(exact[..., :3])).max()
    allowed = 1.03 / 255 if tolerance is None else tolerance  # by default a step of an 8-bit display
    assert 0 < change <= report["plan"]["error_bound"] <= allowed
    assert report["plan"]["points_splatted"] < 0.6 * whole["plan"]["points_splatted"]
    assert whole["plan"]["pixels_merged"] == 0 and whole["plan"]["error_bound"] == 0


def test_a_uniform_region_is_merged_without_error(small_combined):
    frame = Frame(np.full((64, 64, 3), 0.5), np.full((64, 64), depth_of(10.0, 64)))
    exact, _ = synthesize(frame, CAMERA, small_combined, tolerance=0.0)
    merged, report = synthesize(frame, CAMERA, small_combined, tolerance=1e-9)
    assert report["plan"]["pixels_merged"] > 64 * 60
    assert np.allclose(merged, exact, atol=2e-5)


@pytest.mark.parametrize("coc", [8.0, 9.0, 10.0, 11.0])
def test_blocks_of_several_layers_lie_where_their_pixels_do(small_combined, coc):
    cols = np.arange(96)
    depth = np.select([cols < 20, cols < 76], [depth_of(coc, 96), depth_of(6.3, 96)], depth_of(4.0, 96))
    radiance = np.full((64, 96, 3), 0.7)
    radiance[:, 48:] = 0.1
    frame = Frame(radiance, np.tile(depth, (64, 1)))
    exact, _ = synthesize(frame, CAMERA, small_combined, tolerance=0.0, layers=4)
    merged, report = synthesize(frame, CAMERA, small_combined, tolerance=1e-9, layers=4)
    assert report["plan"]["pixels_merged"] > 2000
    assert np.allclose(merged, exact, atol=1e-4)


def test_beyond_the_range_the_nearest_cell_is_scaled_with_a_warning(small_combined):
    frame = spot_frame(32, 32, 20.0)
    with pytest.warns(UserWarning, match=r"100.00 % of the pixels.*coc 0 to 12 px.*1.67 times"):
        image, _ = synthesize(frame, CAMERA, small_combined)
    rows, cols = np.nonzero(image[..., 0] > 0.5 * image[32, 32, 0])
    # The pixel stands out, so that it has a PSF of its own size.
    assert np.ptp(rows) / 2 == pytest.approx(20.0, abs=0.5) and np.ptp(cols) / 2 == pytest.approx(20.0, abs=0.5)
    assert image[..., 0].sum() == pytest.approx(4.0, rel=5e-3)


def test_only_the_last_cells_are_scaled(small_combined):
    """What lies beyond the range is drawn from the cell that it is nearest to, whatever its size."""
    coc = np.linspace(1.05, 2.0, SIZE) * 12.0
    frame = Frame(np.ones((SIZE, SIZE, 3), np.float32), np.broadcast_to(depth_of(coc), (SIZE, SIZE)))
    with pytest.warns(UserWarning, match="scaled from the nearest cell"):
        _, report = synthesize(frame, CAMERA, small_combined)
    assert report["plan"]["cells_used"] == 1


def test_scaling_keeps_the_moments(small_combined):
    spreadlet = next(
        spreadlet
        for cell in reversed(range(small_combined.n_cells))
        if not (spreadlet := small_combined.cell(cell)).direct
    )
    wider = scaled(spreadlet, 1.7)
    assert np.allclose(wider.moments(), spreadlet.moments(), atol=2e-3)
    assert wider.extent[0] == pytest.approx(1.7 * spreadlet.extent[0], abs=1)


def test_an_unknown_method_is_named(small_combined):
    with pytest.raises(
        InvalidParameterError, match="method 'magic' is unknown: allowed are spreadlets, dense, dense-rows, gather"
    ):
        synthesize_any(spot_frame(3, 3, 1.0), CAMERA, small_combined, method="magic")


def test_a_filter_has_no_layers():
    with pytest.raises(InvalidParameterError, match="layers is 2: the method 'gather' filters a frame without"):
        Options(layers=2, method="gather")


def test_a_model_without_motion_draws_it_as_one_with_motion_does(tmp_path, small_combined):
    from spreadlets.precompute.build.build import build_database
    from spreadlets.psf.database import open_database

    build_database("simplelens", tmp_path / "s.h5", samples=8, max_coc=6.0, jobs=1)
    frame = spot_frame(32, 32, 4.0, (12.0, 4.0))
    with open_database(tmp_path / "s.h5") as database:
        stepped, _ = synthesize(frame, CAMERA, database)
    swept, _ = synthesize(frame, CAMERA, small_combined)
    assert np.abs(stepped - swept).max() < 0.06 * swept.max()


@pytest.mark.parametrize("value", [1e4, 1e8])
def test_a_strong_highlight_leaves_nothing_around_its_psf(small_combined, value):
    radiance = np.ones((129, 129, 3), np.float32)
    radiance[64, 64] = value
    image, _ = synthesize(Frame(radiance, np.full((129, 129), depth_of(9.0, 129))), CAMERA, small_combined, layers=1)
    rows, cols = np.indices(image.shape[:2]) - 64
    assert np.abs(image[np.hypot(rows, cols) > 20] - 1).max() < 1e-4
    assert (image[..., 0].sum(dtype=np.float64) - 129**2) / value == pytest.approx(1.0, rel=2e-3)


# --- what is hidden


def disc_before_plane(time, near=-6.0, layers=False):
    """A near disc, moving by 20 px a frame, before noise in focus: as one layer, or with what it hides."""
    noise = np.random.default_rng(0).random((SIZE, SIZE, 3)).astype(np.float32)
    rows, cols = np.indices((SIZE, SIZE))
    inside = np.hypot(rows - 32, cols - 32 - 20 * time) < 8
    motion = np.where(inside[..., None], (20.0, 0.0), (0.0, 0.0))
    if layers:
        disc = inside[..., None] * np.array([0.6, 0.1, 0.1, 1.0])
        everywhere = np.ones((SIZE, SIZE))
        return Frame.from_layers([(disc, depth_of(near) * everywhere, motion), (noise, depth_of(0.0) * everywhere)])
    radiance = np.where(inside[..., None], (0.6, 0.1, 0.1), noise)
    return Frame(radiance, np.where(inside, depth_of(near), depth_of(0.0)), motion)


def test_what_other_frames_saw_is_shown_through_the_blur(small_combined):
    still = replace(CAMERA, shutter=(0.0, 0.0))
    truth = synthesize(disc_before_plane(0, layers=True), still, small_combined)[0]
    others = [disc_before_plane(-1), disc_before_plane(1)]
    guessed, one, both = (
        np.abs(synthesize(disc_before_plane(0), still, small_combined, hidden_from=each)[0] - truth).mean()
        for each in ((), others[0], others)
    )
    assert max(one, both) < 0.3 * guessed


@pytest.mark.parametrize(
    ("frame", "other", "options", "words"),
    [
        (disc_before_plane(0, layers=True), disc_before_plane(1), {}, "for a frame of one layer"),
        (disc_before_plane(0), disc_before_plane(1), {"layers": 1}, "not with layers=1"),
        (disc_before_plane(0), disc_before_plane(1), {"method": "gather"}, "nor with the method 'gather'"),
        (disc_before_plane(0), disc_before_plane(1, layers=True), {}, "a frame of 2 layers"),
        (disc_before_plane(0), spot_frame(3, 3, 0.0, size=33), {}, "33 x 33 px, but the frame has 65 x 65"),
    ],
)
def test_frames_that_cannot_tell_what_is_hidden_are_refused(small_combined, frame, other, options, words):
    with pytest.raises(InvalidParameterError, match=words):
        synthesize(frame, CAMERA, small_combined, hidden_from=other, **options)
