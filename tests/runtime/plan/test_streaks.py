"""Streaks and thin capsules against lines and discs, and where they are used."""

import numpy as np
import pytest

import spreadlets as sp
from spreadlets.compiled import kernel
from spreadlets.psf._capsule_kernels import thin_code
from spreadlets.psf.capsule import exact_capsules
from spreadlets.psf.model import get_model
from spreadlets.runtime.plan._streak_kernels import streak_code
from spreadlets.runtime.plan.streaks import draw_streaks

CAMERA = sp.ThinLens(50.0, 36.0, 1e6, 4.0, shutter=(-0.5, 0.5))
CLOSE = sp.ThinLens(50.0, 36.0, 0.05, 4.0, shutter=(-0.5, 0.5))
SIZE = 48


@kernel
def coded(x, y, across, down):
    """Helpers have no entrance from Python."""
    return streak_code(x, y, across, down)


def drawn(path, shift=(0.0, 0.0), curve=None):
    """The image (41, 41) of one streak about its pixel, and the sum of its points."""
    model = get_model("combined", settings={} if curve is None else {"shutter_curve": curve})
    ((offset_rc, value, _),) = draw_streaks(np.array([coded(*path, *shift)]), model)
    image = np.zeros((41, 41))
    image[tuple(offset_rc.T + 20)] = value[:, 0]
    return image


@kernel
def thin_coded(radius, x, y, excess):
    return thin_code(radius, x, y, excess)


@pytest.mark.interpreted
@pytest.mark.parametrize("radius", [0.5, 0.75, 1.5, 2.5])
def test_a_small_disc_has_its_own_radius(radius):
    code = 2 * thin_coded(radius, 0.0, 0.0, 1.0) + 1
    ((offset_rc, value, _),) = draw_streaks(np.array([code]), get_model("combined"))
    assert value.sum() == pytest.approx(1.0, abs=1e-6)
    # The variance of a disc along an axis is r^2 / 4, that of a pixel 1 / 12.
    variance = float((value[:, 0] * offset_rc[:, 0] ** 2).sum())
    assert variance == pytest.approx(radius**2 / 4 - 1 / 12 if radius > 1 else variance, abs=0.25)
    peak = 1.0 if radius <= 0.5 else 1.0 / (np.pi * radius**2) if radius > 0.71 else None
    assert peak is None or value.max() == pytest.approx(peak, rel=0.02)


@pytest.mark.interpreted
@pytest.mark.parametrize(
    ("path", "excess"), [((7.0, -3.0), 1.0), ((-7.0, 3.0), 1.0), ((150.0, 20.0), 1.0), ((9.0, 0.0), 3.0)]
)
def test_a_thin_capsule_has_its_own_length_and_direction(path, excess):
    code = 2 * thin_coded(2.0 * excess, *path, excess) + 1
    ((offset_rc, value, _),) = draw_streaks(np.array([code]), get_model("combined"))
    row, col = offset_rc.T.astype(float)
    light = value[:, 0].astype(float)
    assert light.sum() == pytest.approx(1.0, abs=1e-5)
    # A path of l has the variance l^2 / 12 along an axis, a disc r^2 / 4; ends are off by a quarter of a step or less.
    step = 1.0 if excess == 1.0 and max(path) < 128 else 2.0 if excess == 1.0 else 4.0
    for offset, length in ((col, path[0]), (row, path[1])):
        spread = float(np.sqrt(12.0 * max((light * offset**2).sum() - excess**2, 0.0)))
        assert spread == pytest.approx(abs(length), abs=1.0 + step / 2)
    assert np.sign((light * row * col).sum()) == np.sign(path[0] * path[1])


def test_streaks_are_drawn_once(monkeypatch):
    codes, model = np.array([coded(9.5, 3.5, 0.0, 0.0), coded(11.5, -3.5, 0.25, 0.0)]), get_model("combined")
    first = draw_streaks(codes, model)
    monkeypatch.setattr("spreadlets.runtime.plan.streaks.for_bands", None)
    again = draw_streaks(codes[::-1], model)
    for one, other in zip(first, again[::-1], strict=True):
        np.testing.assert_array_equal(one[0], other[0])
        np.testing.assert_array_equal(one[1], other[1])


def test_opposite_paths_share_a_capsule_and_codes_of_short_paths_are_small():
    assert thin_coded(2.0, 7.0, -3.0, 1.0) == thin_coded(2.0, -7.0, 3.0, 1.0) != thin_coded(2.0, 7.0, 3.0, 1.0)
    longest = [max(thin_coded(3.5, x, y, 1.0) for x in (-n, n) for y in (0.0, n)) for n in (4.0, 8.0, 128.0, 300.0)]
    assert np.all(np.diff(longest) > 0) and longest[1] < 46 * 18**2
    assert thin_coded(1.0, 1e9, 1e9, 1.0) == thin_coded(1.0, 1e5, 1e5, 1.0), "a path without end"


def test_thin_capsules_need_no_cells(small_combined):
    """What lies below the radius from which a grid begins is drawn without it, and without a warning of its range."""
    radiance = np.zeros((SIZE, SIZE, 3), np.float32)
    radiance[SIZE // 2, SIZE // 2] = 0.9
    depth = 1 / (1 / 4.0 - 2.0 / CLOSE.coc_scale(SIZE))
    motion = np.full((SIZE, SIZE, 2), (9.0, 6.0), np.float32)
    frame = sp.Frame(radiance, np.full((SIZE, SIZE), depth, np.float32), motion)
    image, report = sp.synthesize(frame, CLOSE, small_combined, report=True)
    exact = next(exact_capsules(np.array([[2.0, np.hypot(9, 6)]]), np.array([np.arctan2(6, 9)]), np.array([1])))
    drawn = np.zeros((SIZE, SIZE))
    drawn[tuple(exact.offset_rc.T + SIZE // 2)] = 0.9 * exact.value[:, 0]
    assert np.abs(image[..., 0] - drawn).max() < 0.06 * drawn.max()
    assert report.plan.cells_used == 0


def test_near_the_focus_the_blur_grows_evenly(small_combined):
    radiance = np.broadcast_to(np.random.default_rng(0).random((SIZE, SIZE, 1)), (SIZE, SIZE, 3))
    seen = []
    for coc in np.linspace(0.4, 2.4, 41):
        depth = 1 / (1 / 4.0 - coc / CLOSE.coc_scale(SIZE))
        image = sp.synthesize(sp.Frame(radiance, np.full((SIZE, SIZE), depth)), CLOSE, small_combined)
        seen.append(image[8:-8, 8:-8, 0])
    steps = np.abs(np.diff(seen, axis=0)).mean(axis=(1, 2))
    assert steps.max() < 0.06  # measured .037; drawn by cells .13


def centre(image):
    return [float((image * np.indices(image.shape)[axis]).sum()) - 20.0 for axis in (1, 0)]


@pytest.mark.interpreted
@pytest.mark.parametrize("path", [(0.5, 0.0), (12.0, 5.0), (-3.5, 20.0)])
def test_a_streak_is_as_long_as_its_path_and_keeps_all_light(path):
    image = drawn(path)
    assert image.sum() == pytest.approx(1.0, abs=1e-6)
    assert centre(image) == pytest.approx([0.0, 0.0], abs=1e-5)
    # A line of length l has the variance l^2 / 12; a tent adds a third at most, along each axis.
    for axis, length in ((1, path[0]), (0, path[1])):
        variance = float((image * (np.indices(image.shape)[axis] - 20.0) ** 2).sum())
        assert length**2 / 12 - 0.01 <= variance <= length**2 / 12 + 0.34


@pytest.mark.interpreted
def test_the_part_of_a_pixel_that_a_streak_is_shifted_by_is_in_it():
    assert centre(drawn((6.0, 2.0), (3.25, -1.5))) == pytest.approx([0.25, 0.5], abs=1e-5)


@pytest.mark.interpreted
def test_a_shutter_that_opens_slowly_shows_more_of_the_end():
    assert centre(drawn((12.0, 0.0), curve=[0.0, 1.0]))[0] == pytest.approx(2.0, abs=0.05)


def test_codes_of_short_paths_are_small_and_differ():
    steps = np.arange(-8, 9) / 2
    codes = {coded(x, y, across, 0.25) for x in steps for y in steps for across in (-0.25, 0.0)}
    assert len(codes) == 2 * 17**2 and max(codes) < 2 * 25 * 18**2


def test_what_moves_in_focus_is_not_blurred_across_its_path(small_combined):
    radiance = np.zeros((SIZE, SIZE, 3), np.float32)
    radiance[::2] = 1.0
    motion = np.full((SIZE, SIZE, 2), (12.0, 0.0), np.float32)
    image = sp.synthesize(sp.Frame(radiance, np.full((SIZE, SIZE), 4.0), motion), CAMERA, small_combined)
    assert np.abs(image[8:-8, 8:-8, 0] - radiance[8:-8, 8:-8, 0]).max() < 1e-3
