"""Highlights: which pixels they are, and what is drawn for them."""

from dataclasses import replace

import numpy as np
import pytest
from naive.psfs import capsule_psf, disc_coverage

from spreadlets.api import reconstruct, synthesize
from spreadlets.metrics import psf_similarity
from spreadlets.psf import exact
from spreadlets.runtime.label.labels import View
from spreadlets.runtime.plan import _highlight_kernels, highlights
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.frame import Frame
from spreadlets.scene.samples import SampleBuffer

SIZE = 97
MIDDLE = SIZE // 2
CAMERA = ThinLens(
    focal_length_mm=50.0, sensor_width_mm=36.0, f_number=0.02, focus_distance_m=4.0, shutter=(-0.25, 0.25)
)


def depth_of(coc, size=SIZE):
    return 1.0 / (1.0 / CAMERA.focus_distance_m - coc / CAMERA.coc_scale(size))


def lamp_frame(coc, light=1000.0, ground=0.2, path=(0.0, 0.0), place=(MIDDLE, MIDDLE)):
    """A lamp of one pixel before an even ground of the same labels."""
    radiance = np.full((SIZE, SIZE, 3), ground, np.float32)
    radiance[place] = light
    motion = np.broadcast_to(np.float32(path) / CAMERA.shutter_duration, (SIZE, SIZE, 2))
    return Frame(radiance, np.full((SIZE, SIZE), depth_of(coc), np.float32), motion)


def lamp_of(image, ground=0.2, light=1000.0):
    return (image[..., 0].astype(np.float64) - ground) / (light - ground)


@pytest.mark.parametrize("method", ["spreadlets", "dense", "dense-rows"])
@pytest.mark.parametrize(("coc", "length", "angle"), [(10.6, 0.0, 0.0), (-7.3, 9.4, 0.6), (2.2, 14.1, -1.9)])
def test_a_lamp_has_the_psf_of_its_own_coordinate(small_combined, method, coc, length, angle):
    path = length * np.cos(angle), length * np.sin(angle)
    image = synthesize(lamp_frame(coc, path=path), CAMERA, small_combined, method=method)
    exact = capsule_psf(abs(coc), length, angle, SIZE) if length else disc_coverage(abs(coc), size=SIZE)
    lamp = lamp_of(image)
    assert psf_similarity(exact, lamp) > 0.985
    assert lamp.sum() == pytest.approx(1.0, abs=3e-3)  # rows: as even as float32 sums along them


@pytest.mark.parametrize("coc", [5.1, 8.9, 11.8])
def test_a_rim_lies_where_it_should_and_is_crisp(small_combined, coc):
    lamp = lamp_of(synthesize(lamp_frame(coc), CAMERA, small_combined))
    level = lamp[MIDDLE, MIDDLE]
    assert np.sqrt(np.minimum(lamp / level, 1.0).clip(0).sum() / np.pi) == pytest.approx(coc, rel=0.01)
    # Along the row through the middle no more than one pixel lies between a tenth and nine tenths of the level.
    row = lamp[MIDDLE, MIDDLE:] / level
    assert ((row > 0.1) & (row < 0.9)).sum() <= 1


@pytest.mark.parametrize("turns", range(4))
@pytest.mark.parametrize("seen", [3, 6, 9])
def test_a_lamp_that_the_border_cuts_shines_in_as_if_it_were_whole(small_combined, seen, turns):
    y, x = np.indices((SIZE, SIZE)) - MIDDLE
    radiance = np.where(np.hypot(x, y) < 5.5, 30.0, 0.2)[..., None] * np.ones(3, np.float32)
    depth = np.full((SIZE, SIZE), depth_of(8.0), np.float32)
    whole = synthesize(Frame(radiance, depth), CAMERA, small_combined)
    # Its lowest rows of pixels are all that is seen.
    first = MIDDLE + 6 - seen
    part = np.ascontiguousarray(np.rot90(radiance[first:], turns))
    focus = CAMERA.coc_scale(SIZE) / CAMERA.coc_scale(part.shape[1])
    camera = replace(CAMERA, f_number=CAMERA.f_number / focus)
    found = synthesize(Frame(part, np.rot90(depth[first:], turns).copy()), camera, small_combined)
    found = np.rot90(found, -turns)[..., 0].astype(np.float64) - 0.2
    expected = whole[first:, :, 0].astype(np.float64) - 0.2
    assert found.sum() == pytest.approx(expected.sum(), rel=0.15)  # measured 0.11; not drawn beyond it, 0.59


def count_of(frame, database):
    """How many pixels are drawn with PSFs of their own."""
    from spreadlets.precompute.models.registry import exact_psf
    from spreadlets.runtime.label.pixels import frame_pixels
    from spreadlets.runtime.plan.plan import _Given, _variant_keys

    passes = frame_pixels(frame.layers[0], CAMERA, defocus=True, motion=True)
    keys = [_variant_keys(each, _Given.of(each.labels, database.grid, database.cell_start))[0] for each in passes]
    model = database.grid.model
    return sum(map(len, highlights.find_highlights(passes, keys, model, exact_psf(model)).places))


@pytest.mark.parametrize("place", [(MIDDLE, MIDDLE), (0, MIDDLE), (SIZE - 1, SIZE - 1), (3, 1)])
def test_a_lamp_is_a_highlight_wherever_it_is(small_combined, place):
    assert count_of(lamp_frame(10.0, place=place), small_combined) == 1


def test_what_does_not_stand_out_is_none(small_combined):
    dim = lamp_frame(10.0, light=2.0)
    sharp = lamp_frame(0.2)
    edge = lamp_frame(10.0)
    edge.radiance[:, MIDDLE:] = 50.0
    assert [count_of(each, small_combined) for each in (dim, sharp, edge)] == [0, 0, 0]


def test_light_that_shows_makes_a_highlight(small_combined):
    """Its change of the display is its light over the PSF's area, times the display's slope."""
    area, slope = np.pi * 10.0**2, 1.055 / 2.4 * 0.2 ** (1.0 / 2.4 - 1.0)
    least = 0.2 + highlights.LEAST_CHANGE * area / slope
    lights = 0.97 * least, 1.03 * least
    assert [count_of(lamp_frame(10.0, light=light), small_combined) for light in lights] == [0, 1]


def test_the_pixels_of_a_lamp_share_one_psf(small_combined):
    from spreadlets.precompute.models.registry import exact_psf
    from spreadlets.runtime.label.pixels import frame_pixels
    from spreadlets.runtime.plan.plan import _Given, _variant_keys

    frame = lamp_frame(10.0, path=(4.0, 3.0))
    frame.radiance[MIDDLE - 1 : MIDDLE + 2, MIDDLE - 1 : MIDDLE + 2] = 900.0
    frame.depth[MIDDLE] = depth_of(10.02)
    passes = frame_pixels(frame.layers[0], CAMERA, defocus=True, motion=True)
    keys = [
        _variant_keys(each, _Given.of(each.labels, small_combined.grid, small_combined.cell_start))[0]
        for each in passes
    ]
    model = small_combined.grid.model
    found = highlights.find_highlights(passes, keys, model, exact_psf(model))
    assert len(found.psfs) == 1 and len(found.places[0]) == 9


@pytest.mark.parametrize("layers", [1, 3])
def test_a_lamp_before_another_depth_keeps_its_light(small_combined, layers):
    frame = lamp_frame(9.0)
    frame.depth[:, : MIDDLE - 30] = depth_of(-3.0)
    image = synthesize(frame, CAMERA, small_combined, layers=layers)
    ground = frame.radiance.copy()
    ground[MIDDLE, MIDDLE, :3] = 0.2
    without = synthesize(Frame(ground, frame.depth, frame.motion), CAMERA, small_combined, layers=layers)
    added = (image - without)[..., 0].sum(dtype=np.float64)
    assert added == pytest.approx(1000.0 - 0.2, rel=2e-3)
    assert np.allclose(image[..., 3], without[..., 3], atol=1e-6), "what a highlight covers is what its cell covers"


def test_a_moved_lamp_is_placed_to_a_fraction_of_a_pixel(small_combined):
    camera = ThinLens(50.0, 36.0, 0.02, 4.0, (0.0, 0.5))
    frame = lamp_frame(6.0, path=(3.0, 1.5))
    lamp = lamp_of(synthesize(frame, camera, small_combined))
    rows, cols = np.indices(lamp.shape)
    centre = (lamp * rows).sum() / lamp.sum(), (lamp * cols).sum() / lamp.sum()
    assert centre == pytest.approx((MIDDLE + 0.75, MIDDLE + 1.5), abs=0.05)


def test_light_that_moves_out_of_the_frame_is_left_out(small_combined):
    camera = ThinLens(50.0, 36.0, 0.02, 4.0, (10.0, 10.01))
    image, report = synthesize(lamp_frame(3.0, path=(200.0, 0.0)), camera, small_combined, report=True)
    assert report["plan"]["padding_px"] < 100 and image.max() < 1.01


def test_a_lamp_among_samples_is_as_large_as_its_psf(small_combined):
    shape = (SIZE, SIZE, 2)
    rng = np.random.default_rng(0)
    turn, size = rng.uniform(0, 2 * np.pi, shape), np.sqrt(rng.random(shape))
    lens_uv = np.stack([size * np.cos(turn), size * np.sin(turn)], axis=-1).astype(np.float32)
    radiance = np.full((*shape, 4), 0.2, np.float32)
    radiance[..., 3] = 1.0
    # Where the lamp is seen through each place of the lens.
    for u in np.linspace(-1, 1, 41):
        for v in np.linspace(-1, 1, 41):
            if u * u + v * v <= 1.0:
                row, col = round(MIDDLE + 10.6 * v), round(MIDDLE + 10.6 * u)
                place = np.array([col - MIDDLE, row - MIDDLE]) / 10.6
                lens_uv[row, col, 0] = place / max(1.0, np.hypot(*place))
                radiance[row, col, 0, :3] = 30.0
    zeros = np.zeros((*shape, 2), np.float32)
    samples = SampleBuffer(
        radiance, np.full(shape, depth_of(10.6), np.float32), zeros, lens_uv, np.zeros(shape, np.float32), zeros
    )
    image = reconstruct(samples, CAMERA, small_combined, layers=1, calibrate=False, firefly_clamp=np.inf)
    lamp = np.maximum(image[..., 0].astype(np.float64) - 0.2, 0.0)
    level = np.median(lamp[lamp > 0.5 * lamp.max()])
    assert np.sqrt(np.minimum(lamp / level, 1.0).sum() / np.pi) == pytest.approx(10.6, rel=0.06)


@pytest.mark.parametrize("behind", [0.2, 4.0])
def test_the_edge_of_a_lamp_has_the_psf_of_the_lamp(small_combined, behind):
    """Pixels along its edge have the lamp's light and the depth of what is behind: two steps down, an eighth each."""
    frame = lamp_frame(behind)
    rows, cols = np.indices((SIZE, SIZE)) - MIDDLE
    far = np.maximum(np.abs(rows), np.abs(cols))
    for distance, light in enumerate((1000.0, 125.0, 16.0)):
        frame.radiance[far == distance, :3] = light
    frame.depth[far == 0] = depth_of(9.3)
    image = synthesize(frame, CAMERA, small_combined, layers=1)
    total = frame.radiance[..., 0].sum(dtype=np.float64) - 0.2 * SIZE**2
    spread = np.hypot(rows, cols)
    added = (image[..., 0] - 0.2) / total
    # All of it lies in the lamp's disc, widened by the two steps; what is behind is as it was.
    assert added[spread < 13.0].sum() == pytest.approx(1.0, abs=0.03)
    assert added[MIDDLE, MIDDLE + 5] == pytest.approx(1.0 / (np.pi * 9.3**2), rel=0.02)
    assert np.abs(image[spread > 14.0][:, 0] - 0.2).max() < 5e-3


def test_the_edge_of_a_lamp_in_focus_stays_with_it(small_combined):
    frame = lamp_frame(9.0, light=400.0)
    frame.depth[MIDDLE, MIDDLE] = depth_of(0.0)
    frame.radiance[MIDDLE, MIDDLE + 1, :3] = 100.0
    image = synthesize(frame, CAMERA, small_combined, layers=2)
    assert image[MIDDLE, MIDDLE + 1, 0] > 90.0
    assert image[MIDDLE, MIDDLE - 5, 0] < 0.3, "no disc about it"


def test_a_highlight_has_the_coordinate_that_the_figures_of_a_build_are_of(small_combined):
    """What the plan packs and unpacks is what `spreadlets.psf.exact.rounded` says."""
    rng = np.random.default_rng(3)
    n, model = 200, small_combined.grid.model
    radius, length, angle = rng.uniform(0.2, 30.0, n), rng.uniform(0.0, 40.0, n), rng.uniform(-3.1, 3.1, n)
    side = np.where(rng.random(n) < 0.5, -1, 1)
    path = (length * np.stack([np.cos(angle), np.sin(angle)])).T.astype(np.float32, "C")[None]
    path.setflags(write=False)  # as those of frames
    radii, lengths = (side * radius).astype(np.float32)[None], length.astype(np.float32)[None]
    labels = _highlight_kernels.CodedLabels(radii, lengths, path)
    light = np.full((1, n), np.inf, np.float32)
    steps = _highlight_kernels.CodeSteps(exact.RADIUS_STEPS, exact.longest_step(model, 1), exact.THIN_RADIUS_PX, False)
    given = np.ones((1, n), np.int64), light, labels, steps, (0.0, np.inf)
    at, code = np.empty((2, n), np.int64)
    _highlight_kernels.list_highlights(0, 1, *given, np.zeros(1, np.int64), at, code)
    assert np.array_equal(at, np.arange(n))
    drawn = highlights._coordinates(code, model, View(np.zeros((1, 1), np.float32), 1.0, 1.0))
    said = exact.rounded(np.stack([radius, length], axis=1), angle, np.ones(n, np.int64), model)
    for one, other in zip(drawn, said, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-6)
