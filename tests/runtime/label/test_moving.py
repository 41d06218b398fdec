"""What changes while the shutter is open, against the mean of many moments."""

import numpy as np
import pytest
from scipy import ndimage

import spreadlets as sp
from spreadlets.runtime.label.pixels import frame_pixels
from spreadlets.scene.shutter import shutter_shares

SIZE, N_TIMES = 72, 48
SHUTTER = (-0.25, 0.25)
TIMES = (np.arange(N_TIMES) + 0.5) / N_TIMES * 0.5 - 0.25
RNG = np.random.default_rng(5)
PICTURE = np.clip(4.0 * ndimage.gaussian_filter(RNG.random((SIZE, SIZE, 3)), (1.5, 1.5, 0)) - 1.5, 0.02, 1.0)
PICTURE[20, 30] = PICTURE[50, 44] = 30.0


def lens(*keys, **settings):
    return sp.ThinLens(85, 36, 0.35, 3.0, shutter=SHUTTER, keys=tuple(keys), **settings)


def plane(depth=5.0, **labels):
    return sp.Frame(PICTURE, np.full((SIZE, SIZE), depth, np.float32), **labels)


def disc(radius):
    half = int(np.ceil(radius)) + 1
    fine = (np.arange((2 * half + 1) * 16) + 0.5) / 16 - half - 0.5
    inside = (np.hypot(*np.meshgrid(fine, fine)) <= radius).reshape(2 * half + 1, 16, 2 * half + 1, 16).mean((1, 3))
    return inside / inside.sum()


def blurred(camera, depth):
    radius = abs(float(camera.coc_radius(depth, SIZE)))
    return ndimage.convolve(PICTURE, disc(max(radius, 0.05))[..., None], mode="nearest")


def inner_ssim(image, truth):
    inner = slice(8, -8)
    return sp.metrics.compare(image[inner, inner, :3], truth[inner, inner].astype(np.float32))["ssim"]


def test_a_pull_of_focus_is_the_mean_of_its_moments():
    camera = lens(sp.LensKey(-0.25, focus_distance_m=2.0), sp.LensKey(0.25, focus_distance_m=6.0))
    truth = np.mean([blurred(camera.at(t), 5.0) for t in TIMES], axis=0)
    assert inner_ssim(sp.synthesize(plane(), camera), truth) > 0.995
    assert inner_ssim(sp.synthesize(plane(), camera.at(0.0)), truth) < 0.99


def test_what_comes_nearer_is_the_mean_of_its_moments():
    frame = plane(3.0, depth_prev=np.full((SIZE, SIZE), 9.0), depth_next=np.full((SIZE, SIZE), 1.8))
    inverse = [1 / 3 + 2 / 9 * t for t in TIMES]
    truth = np.mean([blurred(lens(), 1 / each) for each in inverse], axis=0)
    assert inner_ssim(sp.synthesize(frame, lens()), truth) > 0.995
    assert inner_ssim(sp.synthesize(plane(3.0), lens()), truth) < 0.99


def test_an_iris_that_closes_changes_the_blur_alone():
    camera = lens(sp.LensKey(-0.25, f_number=0.3), sp.LensKey(0.25, f_number=2.0))
    truth = np.mean([blurred(camera.at(t), 9.0) for t in TIMES], axis=0)
    assert inner_ssim(sp.synthesize(plane(9.0), camera), truth) > 0.995


@pytest.mark.parametrize("curve", [(0.0, 1.0), "trapezoid:0.5,0.25"])
@pytest.mark.parametrize(("database", "depth"), [("combined", 5.0), ("simplelens", 5.0), ("combined", 3.0)])
def test_a_shutter_that_opens_slowly_is_the_weighted_mean_of_its_moments(database, depth, curve):
    motion = np.broadcast_to(np.float32([24.0, 12.0]), (SIZE, SIZE, 2))
    still = blurred(lens(), depth)
    weight = shutter_shares(curve, N_TIMES)
    moved = [ndimage.shift(still, (12 * t, 24 * t, 0), order=1, mode="nearest") for t in TIMES]
    truth = np.tensordot(weight, np.array(moved), 1)
    camera = lens(shutter_curve=curve)
    assert inner_ssim(sp.synthesize(plane(depth, motion=motion), camera, database), truth) > 0.985
    assert inner_ssim(sp.synthesize(plane(depth, motion=motion), lens(), database), truth) < 0.98


def test_a_pull_of_focus_is_weighed_by_the_shutter_too():
    keys = sp.LensKey(-0.25, focus_distance_m=2.0), sp.LensKey(0.25, focus_distance_m=6.0)
    camera = lens(*keys, shutter_curve=(0.0, 0.0, 1.0))
    truth = np.tensordot(
        shutter_shares(camera.shutter_curve, N_TIMES), np.array([blurred(camera.at(t), 5.0) for t in TIMES]), 1
    )
    assert inner_ssim(sp.synthesize(plane(), camera), truth) > 0.995
    assert inner_ssim(sp.synthesize(plane(), lens(*keys)), truth) < 0.99


def test_a_shutter_that_is_fully_open_all_the_time_changes_nothing():
    frame = plane(5.0, motion=np.full((SIZE, SIZE, 2), 9.0))
    assert np.array_equal(sp.synthesize(frame, lens(shutter_curve=(2.0, 2.0))), sp.synthesize(frame, lens()))
    still = sp.synthesize(plane(), lens(shutter_curve=(0.0, 1.0)))
    assert np.array_equal(still, sp.synthesize(plane(), lens()))


def test_two_shutter_curves_are_one_too_many(tmp_path):
    model = sp.models.Combined(max_coc=4, max_motion=4, shutter_curve=(0, 1))
    sp.build_database(model, tmp_path / "a.h5", samples=2, rays=10_000, jobs=1, sparsifier="quick")
    with pytest.raises(sp.errors.InvalidParameterError, match=r"'a\.h5' has a shutter curve, and so has the camera"):
        sp.synthesize(plane(), lens(shutter_curve=(1, 0)), tmp_path / "a.h5")


def test_a_rolling_shutter_shears_what_moves():
    frame = plane(3.0, motion=np.broadcast_to(np.float32([8.0, 0.0]), (SIZE, SIZE, 2)))
    labels = frame_pixels(frame.layers[0], lens(readout_frames=0.5), defocus=True, motion=True)[0].labels
    assert labels.shift[0, 5] == pytest.approx([-2.0, 0.0]) and labels.shift[-1, 5] == pytest.approx([2.0, 0.0])


def test_a_frame_that_does_not_change_is_drawn_at_one_moment():
    keys = sp.LensKey(-0.25, focus_distance_m=3.0), sp.LensKey(0.25, focus_distance_m=3.0)
    motion = np.full((SIZE, SIZE, 2), 6.0)
    pixels = frame_pixels(plane(5.0, motion=motion).layers[0], lens(*keys), defocus=True, motion=True)
    assert len(pixels) == 1 and pixels[0].curved is None


def test_depths_of_other_frames_come_together_and_are_distances():
    ones = np.ones((SIZE, SIZE))
    with pytest.raises(sp.errors.InvalidFrameError, match="depth_next is missing"):
        plane(depth_prev=ones)
    with pytest.raises(sp.errors.InvalidFrameError, match="depth_prev is not a distance"):
        plane(depth_prev=-ones, depth_next=ones)


@pytest.mark.parametrize("bends", [False, True])
def test_what_is_not_swept_is_listed_once_with_places_along_its_way(bends):
    """Each pixel is drawn amid equal steps of the shutter's time, with the share of the light that it has open then."""
    motion = np.zeros((SIZE, SIZE, 2), np.float32)
    motion[:, 40:], motion[:, :8] = [24.0, 12.0], [3.0, 0.0]
    curve = {"motion_prev": motion, "motion_next": motion[..., ::-1] * np.float32([1, -1])} if bends else {}
    frame, camera = plane(3.2, motion=motion, **curve), lens(shutter_curve=(0.0, 1.0), readout_frames=0.5)
    base, moving = frame_pixels(frame.layers[0], camera, defocus=True, motion=True, swept=False)
    assert (base.weight == 0).sum() == 40 * SIZE and (moving.weight == 1).sum() == 40 * SIZE
    labels = moving.labels
    n_places = labels.trail.n_places
    # Two lengths of ways, each in steps of at most a pixel or a tenth of its radius.
    assert len(np.unique(n_places[moving.weight > 0])) == 2
    step = max(1.0, 0.1 * abs(float(camera.coc_radius(3.2, SIZE))))
    assert 0.5 * np.hypot(24.0, 12.0) / step <= n_places.max() < np.hypot(24.0, 12.0) / step
    # A list begins where its rows are read out, and its places add up to the pixel.
    rows = labels.view.places.at[..., 0]
    later = 0.5 * (rows / (SIZE - 1) - 0.5)
    at = labels.view.places.at
    assert labels.shift == pytest.approx(motion[at[..., 0], at[..., 1]] * later[..., None], abs=1e-5)
    for n in np.unique(n_places):
        shares = labels.trail.share[n * (n - 1) // 2 :][:n]
        assert shares == pytest.approx(shutter_shares(camera.shutter_curve, n))
