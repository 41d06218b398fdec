"""Mixed pixels, drawn with many samples each, against the shares and colours that they were drawn with."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage, special

from spreadlets.runtime.label import _gap_kernels, surfaces
from spreadlets.runtime.label.scale import LEAST_GAP, places, separating_scale
from spreadlets.runtime.label.surfaces import (
    SharedSurfaces,
    depth_is_filtered,
    depth_is_noise,
    split_lights,
    split_surfaces,
    without_nothing,
)
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.frame import Frame

CAMERA = ThinLens(focal_length_mm=50, sensor_width_mm=36, f_number=0.1, focus_distance_m=6.0)
NEAR, FAR = 2.0, 6.0
FINE = 9
"""Samples of a pixel along each axis; odd, so that one is its centre."""
RED, BLUE = np.array([0.9, 0.3, 0.05]), np.array([0.1, 0.3, 0.6])


def drawn(inside, size=24, filtered=False, alpha=False):
    """Return a frame with a red near shape before a blue plane, or before nothing, and the shape's coverage."""
    y, x = (np.mgrid[: size * FINE, : size * FINE] + 0.5) / FINE - 0.5
    mask = inside(x, y)

    def mean(values):
        return values.reshape(size, FINE, size, FINE, -1).mean(axis=(1, 3)).squeeze()

    share = mean(mask.astype(float))
    radiance = share[..., None] * np.append(RED, 1.0) + (1 - share[..., None]) * np.append(BLUE, 1.0) * (not alpha)
    depth = np.where(mask, NEAR, FAR)
    depth = mean(depth) if filtered else depth[FINE // 2 :: FINE, FINE // 2 :: FINE]
    motion = np.where(depth < 0.5 * (NEAR + FAR), 3.0, -1.0)[..., None] * np.ones(2)
    return Frame(radiance, depth, motion).layers[0], share


def edge(x, y):
    return x + 0.4 * y < 16.3


def stick(x, y):
    return np.abs(x - 0.3 * y - 8.2) < 0.8


def dot(x, y):
    return np.hypot(x - 11.8, y - 12.1) < 1.9


def in_frame(found, shape):
    """Return surfaces as layers and shares of all pixels; where a list has none, the share is 0."""
    passes = []
    for layer, share, at in found:
        if at is not None:
            drawn, whole = share > 0, np.zeros(shape, np.float32)
            place = tuple(at[drawn].T)
            whole[place] = share[drawn]

            def spread(values, place=place, drawn=drawn):
                planes = np.ones((*shape, *values.shape[2:]), np.float32)
                planes[place] = values[drawn]
                return planes

            layer, share = layer.mapped(spread, spread, spread(layer.radiance)), whole
        passes.append((layer, share))
    return passes


def near_share(passes):
    return sum(share * (layer.depth < 3.0) for layer, share in passes)


def placed(layer):
    """Return where a layer's surfaces lie in depth, px."""
    return places(layer, separating_scale(layer, CAMERA))


def inner(values, margin=3):
    return values[margin:-margin, margin:-margin]


@pytest.mark.parametrize("filtered", [False, True])
@pytest.mark.parametrize(("shape", "most"), [(edge, 0.06), (stick, 0.2), (dot, 0.25)])
def test_each_surface_gets_its_share(shape, most, filtered):
    layer, truth = drawn(shape, filtered=filtered)
    error = np.abs(inner(near_share(in_frame(split_surfaces(layer, CAMERA), layer.shape)) - truth))
    assert error.max() < most
    assert error[(inner(truth) > 0.02) & (inner(truth) < 0.98)].mean() < most / 2


@pytest.mark.parametrize("filtered", [False, True])
@pytest.mark.parametrize("shape", [edge, stick, dot])
def test_each_surface_gets_its_colour_and_all_add_up_to_the_pixel(shape, filtered):
    layer, truth = drawn(shape, filtered=filtered)
    passes = in_frame(split_surfaces(layer, CAMERA), layer.shape)
    total = sum(each.radiance * share[..., None] for each, share in passes)
    assert np.abs(total - layer.radiance).max() < 1e-6
    assert np.abs(sum(share for _, share in passes) - 1).max() < 1e-6
    red, count = 0.0, 0.0
    for each, share in passes:
        weight = inner(share * (each.depth < 3.0))
        red, count = red + (weight[..., None] * inner(each.radiance)[..., :3]).sum(axis=(0, 1)), count + weight.sum()
    assert np.abs(red / count - RED).max() < 0.1


def test_colours_tell_shares_before_what_varies_in_brightness_only():
    """Point samples do not tell which part of a column of pixels an upright edge covers."""
    size, rng = 24, np.random.default_rng(0)
    grey = rng.uniform(0.1, 0.9, (size, size, 1)) * np.ones(3)
    column = np.arange(size)
    share = (column < 12) + 0.2 * (column == 12)
    radiance = share[:, None] * RED + (1.0 - share[:, None]) * grey
    layer = Frame(radiance, np.where(column < 12, NEAR, FAR) * np.ones((size, 1))).layers[0]
    found = inner(near_share(in_frame(split_surfaces(layer, CAMERA), layer.shape)))[:, 12 - 3]
    assert np.abs(found - 0.2).mean() < 0.09


def test_labels_are_those_of_a_surface_beside_the_pixel():
    layer, _ = drawn(edge, filtered=True)
    for each, share in in_frame(split_surfaces(layer, CAMERA), layer.shape):
        used = inner(share) > 0
        depth, motion = inner(each.depth)[used], inner(each.motion)[used]
        is_near = depth < 0.5 * (NEAR + FAR)
        assert np.abs(depth - np.where(is_near, NEAR, FAR)).max() <= 0.05 * (FAR - NEAR)
        assert (motion[is_near] == 3.0).all() and (motion[~is_near] == -1.0).all()


def test_all_along_a_stick_labels_are_those_of_its_purest_pixels():
    """Through a Gaussian filter its depth is its own nowhere, and nearly so in few pixels only."""
    y, x = np.mgrid[:48, :48]
    across, deviation = (x - 0.15 * y - 6.0) / np.hypot(1.0, 0.15), 0.45
    share = 0.5 * sum(special.erf((0.8 + side * across) / (np.sqrt(2.0) * deviation)) for side in (-1, 1))
    radiance = share[..., None] * RED + (1.0 - share[..., None]) * BLUE
    layer = Frame(radiance, FAR + share * (NEAR - FAR)).layers[0]
    found = [
        inner(each.depth)[inner(used) > 0.0] for each, used in in_frame(split_surfaces(layer, CAMERA), share.shape)
    ]
    near = np.concatenate(found)
    near = near[near < 0.5 * (NEAR + FAR)]
    assert near.max() - near.min() < 0.003 * (FAR - NEAR)


def test_an_element_over_nothing_is_one_surface():
    layer, share = drawn(edge, filtered=True, alpha=True)
    ((found, weight, _),) = split_surfaces(layer, CAMERA)
    assert weight is None and np.array_equal(found.radiance, layer.radiance)
    assert (found.depth[share > 0.02] == NEAR).all(), "edges have the element's depth, not that of the nothing behind"


@pytest.mark.parametrize(
    "depth",
    [
        np.full((9, 12), NEAR),
        np.linspace(NEAR, FAR, 12) * np.ones((9, 12)),
        np.linspace(NEAR, FAR, 108).reshape(9, 12),
    ],
    ids=["flat", "slant", "steep"],
)
def test_one_surface_is_left_as_it_is(depth):
    layer = Frame(np.random.default_rng(0).random((9, 12, 3)), depth).layers[0]
    narrow = ThinLens(focal_length_mm=50, sensor_width_mm=36, f_number=2.8, focus_distance_m=6.0)
    ((found, share, _),) = split_surfaces(layer, narrow)
    assert share is None and found is layer


@pytest.mark.parametrize("shape", [edge, stick, dot])
def test_filtered_depth_is_told_from_point_samples(shape):
    for filtered in (False, True):
        layer, _ = drawn(shape, filtered=filtered)
        place = (CAMERA.coc_scale(24) * (1 / 6.0 - 1 / layer.depth)).astype(np.float32)
        assert depth_is_filtered(place) == filtered or shape is not edge


def test_what_bends_before_it_ends_is_no_blend():
    """A ball before a wall: towards its rim each pixel is a little nearer to the wall, and then the wall begins."""
    y, x = np.mgrid[:48, :48] - 23.3
    ball = NEAR + 0.5 * (1.0 - np.sqrt(np.maximum(1.0 - (x**2 + y**2) / 20.0**2, 0.0)))
    layer = Frame(np.ones((48, 48, 3)), np.where(np.hypot(x, y) < 20.0, ball, FAR)).layers[0]
    assert not depth_is_filtered(placed(layer))


def thread(x, y):
    return np.abs(x - 0.5 * y - 6.2) < 0.4


def test_a_thread_without_a_pixel_of_its_own_tells_whether_depth_is_filtered():
    for filtered in (False, True):
        layer, _ = drawn(thread, filtered=filtered)
        assert depth_is_filtered(placed(layer)) == filtered


def smoothed(layer, variance):
    """Return a layer whose colours were filtered further."""
    beside = np.full(1, 0.5 * variance)
    taps = np.concatenate([beside, 1.0 - 2.0 * beside, beside])
    colours = ndimage.convolve1d(ndimage.convolve1d(layer.radiance, taps, axis=0), taps, axis=1)
    return replace(layer, radiance=colours.astype(np.float32))


def test_the_width_of_the_filter_is_told_by_the_colours_of_edges(monkeypatch):
    told = []
    measured = surfaces.filter_widening
    monkeypatch.setattr(surfaces, "filter_widening", lambda *given: told.append(measured(*given)) or told[-1])
    layer, _ = drawn(dot_of_many_edges, size=64)
    for variance in (0.0, 0.15, 0.3):
        list(split_surfaces(smoothed(layer, variance), CAMERA))
    # Half of the variance of a box is less by 1 / 24 than that of a tent 2 px wide.
    assert told[0] == pytest.approx(surfaces.DOUBT - 1 / 24, abs=0.03)
    assert np.diff(told) == pytest.approx(0.075, abs=0.03)


def dot_of_many_edges(x, y):
    return np.hypot(x - 31.3, y - 31.9) < 21.0


def test_noise_is_told_from_hair_and_is_not_divided():
    rng, size = np.random.default_rng(0), 256
    hair = np.full((size, size), 30.0, np.float32)
    for _ in range(600):
        # Each has a depth of its own.
        (y, x), angle = rng.uniform(0, size, 2), rng.uniform(0, np.pi)
        along = np.arange(-40, 41)
        rows, cols = (np.rint(y + along * np.sin(angle)).astype(int), np.rint(x + along * np.cos(angle)).astype(int))
        inside = (rows >= 0) & (rows < size) & (cols >= 0) & (cols < size)
        hair[rows[inside], cols[inside]] = rng.uniform(2.0, 20.0)
    assert not depth_is_noise(hair) and not depth_is_noise(np.full((size, size), np.inf, np.float32))
    assert depth_is_noise(rng.uniform(8.0, 16.0, (size, size)).astype(np.float32))
    depth = rng.uniform(0.3, 1.0, (size, size)).astype(np.float32)
    layer = Frame(rng.random((size, size, 3)).astype(np.float32), depth).layers[0]
    assert depth_is_noise(placed(layer))
    assert [each.share for each in split_surfaces(layer, CAMERA)] == [None]


def test_a_bright_lamp_keeps_its_light_to_itself():
    layer, truth = drawn(dot)
    lamp = Frame(truth[..., None] * 450.0 + (1 - truth[..., None]) * BLUE * 0.05, layer.depth).layers[0]
    passes = in_frame(split_surfaces(lamp, CAMERA), lamp.shape)
    far = sum((share * (each.depth > 3.0))[..., None] * each.radiance[..., :3] for each, share in passes)
    assert far.max() < 0.2, "the plane behind has .03 and less of its own"


def test_pixels_beside_those_of_an_edge_are_divided_only_where_something_outshines_them():
    layer, truth = drawn(edge)
    columns = np.arange(24) - np.argmax(layer.depth > 3.0, axis=1)[:, None]
    bright = replace(layer, radiance=layer.radiance * np.where(truth > 0.5, 9.0, 0.1)[..., None].astype(np.float32))
    distances = []
    for each in (layer, bright):
        (_, _, at), *_ = list(split_surfaces(each, CAMERA))[1:]
        distances.append(np.abs(columns[tuple(at.reshape(-1, 2).T)] + 0.5).max())
    assert distances[0] < distances[1]


@pytest.mark.parametrize("shape", [edge, stick, dot])
def test_an_element_with_filtered_depth_has_its_own_depth_up_to_its_rim(shape):
    layer, share = drawn(shape, filtered=True, alpha=True)
    found = without_nothing(layer)
    assert np.abs(inner(found.depth)[inner(share) >= 0.01] - NEAR).max() < 1e-3
    assert np.array_equal(found.depth[share == 0], layer.depth[share == 0])


@pytest.mark.parametrize("shape", [edge, stick, dot])
def test_an_element_has_its_own_depth_also_where_the_samples_of_depth_missed_it(shape):
    layer, share = drawn(shape, alpha=True)
    assert (layer.depth[share > 0] != NEAR).any()
    found = without_nothing(layer)
    assert (found.depth[share > 0] == NEAR).all()
    assert np.array_equal(found.depth[share == 0], layer.depth[share == 0])


def test_an_element_all_of_whose_samples_of_depth_hit_it_keeps_them():
    layer, share = drawn(edge, alpha=True)
    hit = replace(layer, depth=np.where(share > 0, NEAR, layer.depth).astype(np.float32))
    assert without_nothing(hit) is hit


def test_surfaces_are_kept_for_the_next_camera_unless_there_are_too_many(monkeypatch):
    layer = Frame(np.ones((8, 8, 3)), np.where(np.arange(8) < 4, 2.0, 4.0) * np.ones((8, 1))).layers[0]
    kept = surfaces.KeptSurfaces(split_surfaces)
    # A single picture keeps none.
    assert len(list(kept(layer, CAMERA))) == 2
    assert not kept._kept
    assert kept(layer, CAMERA) is kept(layer, replace(CAMERA, focus_distance_m=3.0))
    assert kept(layer, CAMERA) is not kept(layer, replace(CAMERA, f_number=2 * CAMERA.f_number))
    monkeypatch.setattr(surfaces, "MOST_KEPT_PIXELS", 64)
    assert kept(layer, CAMERA) is not kept(layer, CAMERA)


def test_drafts_divide_the_pixels_of_lights_alone():
    layer, share = drawn(edge)
    (dim,) = split_lights(layer, CAMERA)
    assert dim.share is None
    np.testing.assert_allclose(dim.layer.radiance, layer.radiance, atol=1e-6)
    # The upper half of the near shape is a lamp.
    lamp, light = np.where((np.arange(24) < 10)[:, None], share, 0.0), 20.0 * np.append(RED, 0.0)
    lit = replace(layer, radiance=(layer.radiance + lamp[..., None] * light).astype(np.float32))
    found, every = (in_frame(split(lit, CAMERA), lit.shape) for split in (split_lights, split_surfaces))
    total = sum(own.radiance * part[..., None] for own, part in found)
    np.testing.assert_allclose(total, lit.radiance, atol=1e-5)
    mixed, all_mixed = (np.any([(part > 0) & (part < 1) for _, part in each], axis=0) for each in (found, every))
    assert np.array_equal(mixed[:9], all_mixed[:9]) and mixed[:9].any()
    assert all_mixed[18:].any() and not mixed[18:].any()


@pytest.mark.parametrize("shape", [edge, stick, dot])
def test_other_colours_are_divided_among_the_same_surfaces_in_the_same_shares(shape):
    layer, truth = drawn(shape)
    near, far = np.float32([0.0, 2.0, 0.5]), np.float32([0.7, 0.1, 0.0])
    colours = truth[..., None] * near + (1 - truth[..., None]) * far
    other = replace(layer, radiance=np.dstack([colours, layer.radiance[..., 3]]).astype(np.float32))
    split = SharedSurfaces(split_surfaces)
    own_surfaces, divided = split(layer, CAMERA), split(other, CAMERA)
    for (surface, share, _), (own, own_share, _) in zip(own_surfaces, divided, strict=True):
        assert own_share is share and own.depth is surface.depth and own.motion is surface.motion
    divided = in_frame(divided, layer.shape)
    total = sum(own.radiance * share[..., None] for own, share in divided)
    np.testing.assert_allclose(total, other.radiance, atol=1e-5)
    for own, share in divided:
        seen = inner((own.depth < 3.0) & (share > 0.3) & (share < 1.0))
        assert np.abs(inner(own.radiance)[seen][:, :3] - near).max(initial=0.0) < 0.35


@pytest.mark.interpreted
def test_strands_have_no_gaps():
    """A strand of .5 px at 6 degrees: ten rows of each twenty have no point sample in it."""
    slope, width = np.tan(np.radians(6.0)), 0.5
    layer, coverage = drawn(lambda x, y: np.abs(x - 24.2 - slope * (y - 24.0)) < 0.5 * width, size=48)
    sampled = (layer.depth == NEAR).any(axis=1)
    assert 0.3 < sampled.mean() < 0.7
    place = placed(layer)
    closed, places = surfaces.without_gaps(layer, place)
    assert ((closed.depth == NEAR).any(axis=1)[4:-4]).all() and np.array_equal(
        closed.depth == NEAR, places == place.min()
    )
    # Whether little of it or much of a paler one, its light is that of the strand.
    passes = in_frame(split_surfaces(layer, CAMERA), layer.shape)
    light = sum(share * (each.depth < 3.0) * (each.radiance[..., 0] - BLUE[0]) for each, share in passes)
    wanted = coverage.sum(axis=1) * (RED[0] - BLUE[0])
    assert np.abs((light.sum(axis=1) - wanted)[6:-6]).mean() < 0.1 * wanted.mean()


@pytest.mark.parametrize("across", [False, True])
def test_a_strand_that_hardly_leaves_its_column_or_row_has_no_gaps(across):
    """A strand of .5 px at 1.5 degrees: nineteen rows of each thirty-eight have no point sample in it."""
    slope, size = np.tan(np.radians(1.5)), 120
    inside = lambda x, y: np.abs(x - 24.2 - slope * (y - 60.0)) < 0.25  # noqa: E731
    layer, coverage = drawn((lambda x, y: inside(y, x)) if across else inside, size=size)
    axis = 0 if across else 1
    assert 0.3 < (layer.depth == NEAR).any(axis=axis).mean() < 0.7
    closed, _ = surfaces.without_gaps(layer, placed(layer))
    assert ((closed.depth == NEAR).sum(axis=axis) == 1)[8:100].all()
    passes = in_frame(split_surfaces(layer, CAMERA), layer.shape)
    light = sum(share * (each.depth < 3.0) * (each.radiance[..., 0] - BLUE[0]) for each, share in passes)
    wanted = coverage.sum(axis=axis) * (RED[0] - BLUE[0])
    assert np.abs((light.sum(axis=axis) - wanted)[8:100]).mean() < 0.15 * wanted.mean()


def test_short_things_in_a_line_are_no_strand():
    """Two upright sticks a pixel apart in their columns, farther from each other than they are long."""
    layer, _ = drawn(lambda x, y: (np.abs(x - 20.0 - (y > 24.0)) < 0.5) & (np.abs(np.abs(y - 24.0) - 13.0) < 2.0), 48)
    place = placed(layer)
    assert np.array_equal(surfaces.without_gaps(layer, place)[1], place)


@pytest.mark.interpreted
def test_a_gap_is_not_closed_over_the_only_pixel_of_what_is_seen_in_it():
    place = np.zeros((16, 16), np.float32)
    place[:, 7] = -4.0
    place[8, 7] = 3.0
    for beside, closed in ((0.0, 3.0), (3.0, -4.0)):
        place[6, 5] = beside
        ends, found = np.empty((16, 16, 2), np.int8), place.copy()
        thin = surfaces._thin(place)
        _gap_kernels.find_gaps(0, 16, place, thin, LEAST_GAP, ends)
        assert ends[7, 7].tolist() == [2, 0]
        _gap_kernels.close_gaps(0, 16, place, ends, LEAST_GAP, found, np.zeros((16, 16, 2), np.int32))
        assert found[8, 7] == closed


@pytest.mark.interpreted
def test_tips_that_point_at_each_other_are_no_strand():
    """Nothing is put between the points of two leaves."""
    shape = lambda x, y: (np.abs(y - 12.0) < 0.3 * np.abs(x - 12.0)) & (np.abs(np.abs(x - 12.0) - 7.0) < 5.0)  # noqa: E731
    layer, _ = drawn(shape)
    assert surfaces.without_gaps(layer, placed(layer))[0] is layer


@pytest.mark.interpreted
def test_where_there_is_nothing_there_is_no_strand():
    """Empty pixels are as far away as each other, so none of them lies before another, and none is looked at."""
    layer, coverage = drawn(lambda x, y: x + 0.3 * y < 12.0, alpha=True)
    place = placed(layer)
    place[coverage == 0.0] = np.inf
    thin = np.ones(place.shape, np.int8)
    _gap_kernels.find_thin(0, len(place), place, surfaces.LEAST_GAP, 1, thin)
    assert not thin[np.isinf(place)].any()


def of_strand(width, degrees, size=64):
    """Return light and coverage, row by row, of a red strand before blue and dark blocks, and how wide it is there."""
    slope = np.tan(np.radians(degrees))
    inside = lambda x, y: np.abs(x - 0.5 * size - slope * (y - 0.5 * size)) < 0.5 * width  # noqa: E731
    layer, coverage = drawn(inside, size=size)
    rows, cols = np.indices(coverage.shape)
    blocks = np.where((rows // 5 + cols // 3) % 2, 2.0, 0.2)
    behind = blocks[..., None] * BLUE
    colours = coverage[..., None] * RED + (1.0 - coverage[..., None]) * behind
    layer = replace(layer, radiance=np.dstack([colours, np.ones_like(coverage)]).astype(np.float32))
    passes = in_frame(split_surfaces(layer, CAMERA), layer.shape)
    total = sum(share * each.radiance[..., :3].astype(float) for each, share in ((p, s[..., None]) for p, s in passes))
    np.testing.assert_allclose(total, layer.radiance[..., :3], atol=1e-4)
    near = [(share * (each.depth < 3.0), each.radiance[..., 0]) for each, share in passes]
    covered = sum(share for share, _ in near).sum(axis=1)
    light = sum(share * red for share, red in near).sum(axis=1)
    return tuple(each[12:-12] for each in (light, covered, coverage.sum(axis=1)))


@pytest.mark.parametrize("degrees", [4.0, 17.0, 35.0])
def test_a_strand_is_as_wide_and_as_bright_all_along(degrees):
    """What is behind it changes from block to block, and it does not."""
    light, covered, wanted = of_strand(0.6, degrees)
    assert covered.std() < 0.1 * wanted.mean() and light.std() < 0.15 * RED[0] * wanted.mean()
    assert abs(light.mean() - RED[0] * wanted.mean()) < 0.1 * RED[0] * wanted.mean()


@pytest.mark.parametrize("width", [1.3, 1.5])
def test_a_strand_that_is_now_one_pixel_wide_now_two_is_as_even_as_drawn(width):
    """A strip along a straight line, with the edges of the filter: no pixel of it stands out."""
    errors = []
    for place in (24.2, 24.57, 24.9):
        inside = lambda x, y, place=place: np.abs(x - place - 0.07 * (y - 24.0)) < 0.5 * width  # noqa: E731
        layer, coverage = drawn(inside, size=48)
        behind = np.kron(np.random.default_rng(1).uniform(0.2, 1.8, (12, 12)), np.ones((4, 4)))[..., None] * BLUE
        colours = coverage[..., None] * RED + (1.0 - coverage[..., None]) * behind
        layer = replace(layer, radiance=np.dstack([colours, np.ones_like(coverage)]).astype(np.float32))
        error = inner(near_share(in_frame(split_surfaces(layer, CAMERA), layer.shape)) - coverage, 8)
        errors.append(np.mean(error[inner(coverage, 8) > 0.02] ** 2))
    assert np.sqrt(np.mean(errors)) < 0.045


def test_strands_side_by_side_are_each_as_wide_as_drawn():
    """Two of .7 px, 3 px apart: the pixels between them are of the nearer one, and are evened once."""
    rows = 40
    inside = lambda x, y: np.abs(np.abs(x - 20.2 - 0.2 * (y - 20.0)) - 1.53) < 0.35  # noqa: E731
    layer, coverage = drawn(inside, size=rows)
    passes = in_frame(split_surfaces(layer, CAMERA), layer.shape)
    covered = sum(share * (each.depth < 3.0) for each, share in passes)
    assert np.abs(covered - coverage)[8:-8].max() < 0.3
    assert covered.sum(axis=1)[8:-8].std() < 0.03 * coverage.sum(axis=1).mean()


def test_colours_tell_the_share_of_hair_that_samples_meet_here_and_there():
    """Forty strands a third of a pixel wide cover a quarter of all, and no line of them can be followed."""
    errors = []
    for seed in (3, 4, 5):
        chance = np.random.default_rng(seed)
        strands = [(*chance.uniform(0.0, 48.0, 2), 0.5 * np.pi + chance.normal(0.0, 0.35)) for _ in range(40)]

        def hair(x, y, strands=strands):
            apart = (np.abs((x - left) * np.sin(turn) - (y - top) * np.cos(turn)) for left, top, turn in strands)
            return np.logical_or.reduce([each < 0.17 for each in apart])

        layer, truth = drawn(hair, size=48)
        error = inner(near_share(in_frame(split_surfaces(layer, CAMERA), layer.shape)) - truth)
        errors.append(np.sqrt(np.mean(error[inner(truth) > 0.02] ** 2)))
    assert np.mean(errors) < 0.2


def test_the_sample_in_a_gap_of_a_strand_is_one_of_its_surfaces():
    """Single bright pixels of the sky beside a strand, its gaps among them: the sky's light is not the strand's."""
    slope, width, size = np.tan(np.radians(12.0)), 0.5, 48
    layer, coverage = drawn(lambda x, y: np.abs(x - 24.2 - slope * (y - 24.0)) < 0.5 * width, size=size)
    depth, radiance = layer.depth.copy(), layer.radiance.copy()
    radiance[..., :3] -= 0.9 * (1.0 - coverage)[..., None] * BLUE
    # The sky fills single pixels in the strand's gaps, whose point samples are of it, and one 3 px away from each.
    place = placed(layer)
    gaps = np.argwhere(surfaces.without_gaps(layer, place)[1] != place)[::3]
    dots = np.zeros(depth.shape, bool)
    for away in (0, 3):
        dots[gaps[:, 0], gaps[:, 1] + away] = True
    depth[dots] = 1e4
    radiance[dots, :3] = (1.0 - coverage[dots])[:, None] * 1.5 + coverage[dots][:, None] * RED
    passes = in_frame(split_surfaces(replace(layer, depth=depth, radiance=radiance), CAMERA), layer.shape)
    assert len(gaps) > 4
    light = sum(share * (each.depth > 100.0) * each.radiance[..., 2] for each, share in passes)
    assert (light[dots] > 0.6).all(), light[dots]


def test_what_explains_a_pixel_is_found_among_many_surfaces():
    """A pixel of a leaf shows the sky too, of which few pixels around are, while most are of three other leaves."""
    depth = np.full((64, 64), FAR, np.float32)
    depth[:, :31], depth[32:, 31:], depth[31, 27:32] = 4.0, 3.0, NEAR
    depth[29, 30:33] = 1e4
    colours = {FAR: 0.1, 4.0: 0.12, 3.0: 0.08, NEAR: 0.1, 1e4: 3.0}
    radiance = np.ones((64, 64, 4), np.float32)
    for place, value in colours.items():
        radiance[depth == np.float32(place), :3] = value
    radiance[31, 31, :3] = 0.6 * 0.1 + 0.4 * 3.0
    layer = Frame(radiance, depth, np.zeros((64, 64, 2), np.float32)).layers[0]
    found = [
        (float(each.depth[31, 31]), share[31, 31], each.radiance[31, 31, 0])
        for each, share in in_frame(split_surfaces(layer, CAMERA), layer.shape)
    ]
    light = {depth: float(share * value) for depth, share, value in found if share > 0.0}
    assert light.get(1e4, 0.0) > 0.5, light


@pytest.mark.interpreted
def test_what_a_pixel_does_not_have_is_not_looked_at():
    """Surfaces without a share have neither place nor colour: what lies in memory there changes nothing."""
    place = np.full((16, 9), 6.0, np.float32)
    place[:, 4] = 2.0
    radiance = np.full((16, 9, 4), 0.5, np.float32)
    rows, cols = (each.ravel() for each in np.indices(place.shape, np.int32))
    given = []
    for unknown in (0.0, np.nan):
        shares = np.tile(np.float32([0.7, 0.3, 0.0]), (place.size, 1))
        beside = np.where(cols == 4, 3, 4).astype(np.int32)
        sources = np.stack([np.tile(rows, (3, 1)), [cols, beside, cols]], axis=-1)
        colours, told = np.full((place.size, 3, 4), unknown, np.float32), np.zeros(place.size, np.float32)
        colours[:, :2] = np.random.default_rng(0).random((place.size, 2, 4))
        first = shares[:, 0].reshape(place.shape).copy(), radiance.copy()
        found = np.stack([rows, cols], axis=1), shares, sources.transpose(1, 0, 2).copy(), colours, told
        surfaces.even_strands(place, radiance, first, found)
        given.append(first)
    for one, other in zip(*given, strict=True):
        np.testing.assert_array_equal(one, other)
    assert np.ptp(given[0][0][:, 4]) < 0.2 and not np.array_equal(given[0][1], radiance)
