"""Depth layers, compositing, and reconstruction from samples, on cases whose answer is known."""

import json

import numpy as np
import pytest
from click.testing import CliRunner
from scipy import ndimage
from threads import for_thread_counts

from spreadlets.api import reconstruct, synthesize
from spreadlets.arrays import NOTHING
from spreadlets.cli.main import cli, main
from spreadlets.errors import InvalidParameterError
from spreadlets.files.exr_samples import write_samples
from spreadlets.files.images import write_image
from spreadlets.runtime.composite import _visibility_kernels
from spreadlets.runtime.composite.composite import COUNT, LAST, REST, add_layer
from spreadlets.runtime.composite.layers import (
    Cover,
    Moments,
    Pass,
    cover_part,
    layer_moments,
    passing_samples,
    share_beyond,
)
from spreadlets.runtime.label.labels import Labels, Places, View
from spreadlets.runtime.label.lists import Pixels
from spreadlets.runtime.plan import layering
from spreadlets.runtime.plan.layering import Layering, Membership
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.frame import Frame
from spreadlets.scene.samples import SampleBuffer

SIZE = 64
CAMERA = ThinLens(
    focal_length_mm=50.0, sensor_width_mm=36.0, f_number=0.02, focus_distance_m=4.0, shutter=(-0.25, 0.25)
)
CAMERA_FILE = {
    "focal_length_mm": 50.0,
    "sensor_width_mm": 36.0,
    "f_number": 0.02,
    "focus_distance_m": 4.0,
    "shutter_open_close_frames": [-0.25, 0.25],
}


def depth_of(coc, size=SIZE):
    """Depth, metres, of a signed CoC radius, px."""
    return 1.0 / (1.0 / CAMERA.focus_distance_m - np.asarray(coc) / CAMERA.coc_scale(size))


def labels_of(depth, coc=None, path=(0.0, 0.0)):
    """Labels of an image of depths, straight paths."""
    depth = np.asarray(depth, np.float32)
    coc = np.zeros_like(depth) if coc is None else np.asarray(coc, np.float32)
    paths = np.broadcast_to(np.array(path, np.float32), (*depth.shape, 2)).copy()
    return Labels(coc, paths, np.hypot(*np.moveaxis(paths, 2, 0)), None, View(depth, 1.0, 1.0))


def members_of(layer, farther=0.0, variant=0):
    layer = np.asarray(layer, np.int32)
    fill = [np.broadcast_to(np.asarray(value, kind), layer.shape).copy() for value, kind in ((variant, np.int32),)]
    return Membership(fill[0], layer, np.broadcast_to(np.float32(farther), layer.shape).copy())


# --- which pixel belongs where


def shares(depth, n_layers, softness):
    """Share (n_layers, pixels) of each pixel in each layer."""
    depth = np.asarray(depth, np.float32)[None]
    variant = np.zeros(depth.shape, np.int32)
    labels = labels_of(depth)
    members = Layering.equal([(labels, variant)], n_layers, softness).members(labels, variant)
    found = np.zeros((n_layers + 1, depth.size))
    np.add.at(found, (members.layer[0], np.arange(depth.size)), 1 - members.farther[0])
    np.add.at(found, (members.layer[0] + 1, np.arange(depth.size)), members.farther[0])
    assert (found[n_layers] == 0).all(), "nothing lies behind the last layer"
    return found[:n_layers]


NEARNESS = np.linspace(1 / 2.0, 1 / 20.0, 1001)


@pytest.mark.interpreted
@pytest.mark.parametrize("n_layers", [2, 3, 8])
@pytest.mark.parametrize("softness", [0.0, 0.3, 1.0])
def test_the_shares_of_a_pixel_follow_its_parallax(n_layers, softness):
    found = shares(1 / NEARNESS, n_layers, softness)
    place = np.linspace(0, n_layers, len(NEARNESS))  # equal steps of inverse depth are equal steps of a layer
    # A layer's share is a box of its width, whose sides, except at the ends, are ramps as wide as the transition.
    begins = np.arange(n_layers)[:, None]
    rise = _ramp(place - begins, softness)
    rise[0] = 1.0
    fall = np.vstack([rise[1:], np.zeros(len(place))])
    on_border = np.isclose(place[None], np.round(place[None]), atol=1e-4) & (softness == 0)
    assert np.allclose(np.where(on_border, 0, found), np.where(on_border, 0, rise - fall), atol=2e-3)
    assert np.allclose(found.sum(axis=0), 1.0, atol=1e-6)


def _ramp(distance, width):
    return np.clip(distance / width + 0.5, 0, 1) if width else (distance >= 0).astype(float)


def test_hard_layers_split_no_pixel_and_soft_ones_split_most():
    hard, soft = (shares(1 / NEARNESS, 6, softness) for softness in (0.0, 1.0))
    assert set(np.unique(hard)) == {0.0, 1.0}
    assert 0.8 < ((soft > 0) & (soft < 1)).any(axis=0).mean() < 0.85  # all but half a layer at both ends


def test_infinite_depth_lies_in_the_last_layer():
    found = shares([2.0, 4.0, np.inf], 4, 1.0)
    assert found[0, 0] == found[3, 2] == 1.0 and found[1, 1] == found[2, 1] == 0.5


def test_one_depth_is_one_layer():
    labels, variant = labels_of(np.full((3, 4), 5.0)), np.zeros((3, 4), np.int32)
    assert Layering.equal([(labels, variant)], 6, 1.0) == Layering()


def test_pixels_that_are_not_drawn_do_not_widen_the_range():
    labels, variant = labels_of([[2.0, 4.0, 1000.0]]), np.array([[0, 0, -1]], np.int32)
    made = Layering.equal([(labels, variant)], 4, 1.0)
    assert made.cuts == pytest.approx((-7 / 16, -6 / 16, -5 / 16)) and made.widths == pytest.approx([1 / 16] * 3)


def test_a_stray_depth_does_not_widen_the_range_but_a_small_object_does():
    depth = 1 / np.linspace(0.25, 0.1, 10_000).reshape(100, 100)
    variant = np.zeros(depth.shape, np.int32)
    usual = Layering.equal([(labels_of(depth), variant)], 4, 1.0)
    depth[50, 50:60] = 1e-6
    stray = Layering.equal([(labels_of(depth), variant)], 4, 1.0)
    assert stray.cuts == pytest.approx(usual.cuts, abs=1e-3) and stray.widths == pytest.approx(usual.widths, rel=0.01)
    assert stray.members(labels_of(depth), variant).layer[50, 55] == 0
    depth[50, 50:80] = 1e-6
    assert Layering.equal([(labels_of(depth), variant)], 4, 1.0).cuts[0] == pytest.approx(-0.75e6)
    depth[50, 50:80] = 4.0
    depth[50, 50] = 1 / 0.3
    near = Layering.equal([(labels_of(depth), variant)], 4, 1.0)
    assert near.cuts[0] == pytest.approx(-0.3 + 0.05), "close enough to count"


# --- the blur that shares and counts get


@pytest.mark.parametrize(("radius", "length"), [(7.0, 0.0), (8.0, 0.0), (20.0, 0.0), (0.0, 40.0), (9.0, 30.0)])
def test_two_boxes_spread_as_far_as_the_psf(radius, length):
    halves = Moments(0.0, radius**2, length**2, (0.0, 0.0)).box_half_widths()
    spread = sum(((2 * half + 1) ** 2 - 1) / 12 for half in halves)  # variance of two boxes of pixels
    assert spread == pytest.approx(radius**2 / 4 + length**2 / 24, rel=0.1)


def test_moments_are_weighted_means_and_empty_layers_have_none():
    labels = labels_of(np.ones((1, 3)), coc=[[2.0, -4.0, 100.0]], path=(3.0, 4.0))
    members = Membership(np.array([[0, 0, -1]], np.int32), np.array([[0, 1, 0]], np.int32), np.float32([[0.25, 0, 0]]))
    first, second, third = layer_moments([(Pixels(np.ones((1, 3, 4), np.float32), labels), labels.path, members)], 3)
    assert third is None
    assert (first.coc, first.coc_squared, first.length_squared, first.motion) == (2.0, 4.0, 25.0, (3.0, 4.0))
    assert second.coc == pytest.approx((0.25 * 2 - 4) / 1.25)
    assert second.coc_squared == pytest.approx((0.25 * 4 + 16) / 1.25)


def test_steps_of_time_count_with_their_whole_path_and_their_share():
    labels = labels_of(np.ones((1, 2)), path=(1.0, 0.0))._replace(sweep=np.full((1, 2, 2), (6.0, 8.0), np.float32))
    members = Membership(*np.zeros((2, 1, 2), np.int32), np.zeros((1, 2), np.float32))
    whole = labels_of(np.ones((1, 2)), path=(0.0, 0.0))
    sets = [(labels, 0.25), (whole, 0.75)]
    (found,) = layer_moments(
        [
            (Pixels(np.ones((1, 2, 4), np.float32), each, np.full((1, 2), share, np.float32)), each.whole_path, members)
            for each, share in sets
        ],
        1,
    )
    assert (found.length_squared, found.motion) == (25.0, (1.5, 2.0))


# --- how much of a layer was seen

SHARP = Moments(0.0, 0.0, 0.0, (0.0, 0.0))


def beyond(members, number, moments=SHARP, alpha=1.0, weight=NOTHING):
    radiance = np.full((*members.layer.shape, 4), alpha, np.float32)
    known = np.ones(members.layer.shape, np.uint64)
    return share_beyond(Cover(cover_part(members, pixels_of(radiance, weight)), [], [], known), number, moments)


def pixels_of(radiance, weight, places=None):
    nothing = np.zeros(radiance.shape[:2], np.float32)
    labels = Labels(
        nothing, np.zeros((*nothing.shape, 2), np.float32), nothing, None, View(nothing, 1, 1, places=places)
    )
    return Pixels(radiance, labels, weight)


@pytest.mark.interpreted
def test_of_what_a_layer_leaves_the_part_that_nearer_ones_do_not_hide_lies_beyond():
    members = Membership(
        np.array([[0, 0, 0, -1]], np.int32), np.array([[0, 1, 1, 0]], np.int32), np.float32([[0.25, 0.5, 0, 0]])
    )
    assert np.allclose(beyond(members, 0), [[1, 1, 1, 1]]), "nothing lies before the first layer"
    share = beyond(members, 1)
    assert np.allclose(share[0, [0, 1, 3]], [0, 1, 1])
    assert 0.5 < share[0, 2] < 1.0, "a pixel that is wholly in the layer leaves nothing, and takes the share around it"
    assert np.allclose(beyond(members, 2), [[0, 0, 0, 1]])
    assert np.allclose(beyond(members, 2, alpha=0.5), [[0.5, 2 / 3, 0.5, 1]])
    half = np.full((1, 4), 0.5, np.float32)
    assert np.allclose(beyond(members, 2, weight=half), beyond(members, 2, alpha=0.5))


@pytest.mark.interpreted
def test_where_a_layer_is_known_what_nearer_ones_hide_of_it_counts():
    colours = np.ones((1, 4, 4), np.float32)
    seen = members_of(np.array([[0, 0, 0, 2]], np.int32)), pixels_of(colours, NOTHING)
    at = Places(np.array([[(0, col) for col in range(4)]], np.int32), (1, 4))
    hidden = members_of([[1, 1, 1, 1]]), pixels_of(colours, np.float32([[1.0, 0.25, 0.0, 0.0]]), at)
    known = np.array([[0b11, 0b11, 0b1, 0b1]], np.uint64)
    found = share_beyond(Cover(cover_part(*seen), [], [cover_part(*hidden)], known), 1, SHARP)
    assert np.allclose(found[0, 1:], [1, 0, 1]), "in part the layer's, unknown, not hidden"


def test_the_share_beyond_is_blurred_as_the_layer_is():
    layer = np.full((41, 41), 2, np.int32)
    layer[20, 20] = 0
    share = beyond(members_of(layer), 1, Moments(6.0, 36.0, 0.0, (0.0, 0.0)))
    rows, cols = np.indices(share.shape) - 20
    hidden = 1 - share
    assert hidden.sum() == pytest.approx(1.0, rel=1e-4)
    assert ((hidden > 0) == (rows**2 + cols**2 <= 36)).all()


def test_where_a_layer_leaves_nothing_within_its_mean_blur_pixels_that_blur_farther_are_reckoned_with():
    """A leaf 24 px wide whose layer blurs by 8 px in the mean, and by 20 at most: all that it leaves lies beyond it."""
    layer = np.ones((41, 41), np.int32)
    layer[:, 8:32] = 0
    assert np.allclose(beyond(members_of(layer), 0, Moments(8.0, 64.0, 0.0, (0.0, 0.0), 20.0)), 1.0)
    within = beyond(members_of(layer + 1), 1, Moments(8.0, 64.0, 0.0, (0.0, 0.0), 20.0))
    assert np.allclose(within, 1.0)


@pytest.mark.interpreted
def test_pixels_whose_own_blur_does_not_reach_beyond_their_layer_let_nothing_through():
    """A layer blurs by 8 px in the mean; its upper rows by 2, its lower ones by 40. One of its pixels is mixed."""
    layer = np.ones((32, 40), np.int32)
    layer[:, :20] = 0
    blur = np.where(np.arange(32)[:, None] < 16, 2.0, 40.0) * np.ones((1, 40))
    part = cover_part(members_of(layer), pixels_of(np.ones((32, 40, 4), np.float32), NOTHING))
    known, moments = np.ones(layer.shape, np.uint64), Moments(8.0, 64.0, 0.0, (0.0, 0.0), 40.0)
    part.cover[5, 5] = 0.99
    seen = share_beyond(Cover(part, [], [], known, blur.astype(np.float32)), 0, moments)
    hidden = seen[:16, :17] == 0.0
    assert not hidden[5, 5] and hidden.sum() == hidden.size - 1, "three px and more from the edge"
    assert np.allclose(seen[:16, 17:], 1.0) and np.allclose(seen[16:], 1.0)


@pytest.mark.interpreted
def test_a_layer_in_focus_lets_nothing_through_either():
    layer = np.ones((12, 16), np.int32)
    layer[:, :8] = 0
    part = cover_part(members_of(layer), pixels_of(np.ones((12, 16, 4), np.float32), NOTHING))
    seen = share_beyond(
        Cover(part, [], [], np.ones(layer.shape, np.uint64), np.zeros(layer.shape, np.float32)), 0, SHARP
    )
    assert (seen[:, :7] == 0.0).all() and (seen[:, 7:] == 1.0).all()


@pytest.mark.interpreted
def test_samples_behind_a_layer_are_holes_where_they_passed_it():
    layer = np.zeros((9, 9), np.int32)
    layer[4, 4], layer[6, 2] = 1, layering.BEHIND_ALL
    offset, lens, time = np.zeros((9, 9, 2), np.float32), np.zeros((9, 9, 2), np.float32), np.zeros((9, 9), np.float32)
    offset[4, 4], lens[4, 4], time[4, 4] = (0.25, 0.0), (0.5, -0.5), 0.5
    moments = Moments(2.0, 0.0, 0.0, (0.0, 4.0))  # x: 4 + 0.25 - 2 * 0.5, y: 4 + 2 * 0.5 - 4 * 0.5
    alpha, ones = np.ones((2, 9, 9), np.float32)
    passes = [Pass(members_of(layer), offset, lens, time, alpha, ones)]
    found = passing_samples(passes, [lens], 0, moments, 1.0)
    expected = np.zeros((9, 9))
    expected[3, 3], expected[3, 4], expected[6, 2] = 0.75, 0.25, 1.0
    assert np.allclose(found, expected, atol=1e-6)
    behind_both = passing_samples(passes, [lens], 1, moments, 1.0)
    assert behind_both.sum() == pytest.approx(1.0), "only what met nothing passes the second layer, too"
    alpha[4, 4] = 0.25
    assert passing_samples(passes, [lens], 1, moments, 1.0).sum() == pytest.approx(1.75), "it lets the rest pass"
    ones[4, 4] = 0.5
    assert passing_samples(passes, [lens], 0, moments, 1.0).sum() == pytest.approx(1.5), "it stands for half a sample"


@pytest.mark.parametrize("moments", [Moments(1e9, 1e18, 0.0, (0.0, 0.0)), Moments(0.0, 0.0, 1e16, (1e8, 0.0))])
def test_samples_behind_what_blurs_over_many_frames_count_evenly(moments):
    layer = np.ones((9, 12), np.int32)
    layer[:, :6] = 0
    lens, time = np.zeros((9, 12, 2), np.float32), np.zeros((9, 12), np.float32)
    path = np.full(lens.shape, moments.motion, np.float32)
    ones = np.ones(layer.shape, np.float32)
    found = passing_samples([Pass(members_of(layer), lens, lens, time, ones, ones)], [path], 0, moments, 1.0)
    assert np.abs(found - 0.5).max() < 0.02


@pytest.mark.interpreted
def test_scattering_keeps_the_number_of_samples():
    rng = np.random.default_rng(0)
    shape = (12, 15)
    members = members_of(rng.integers(0, 3, shape), farther=0.0)
    members.farther[...] = np.where(members.layer < 2, rng.random(shape), 0)
    place = np.stack([rng.uniform(0, 14, shape), rng.uniform(0, 11, shape)], axis=-1)
    lens, time = rng.uniform(-1, 1, (*shape, 2)).astype(np.float32), rng.uniform(-1, 1, shape).astype(np.float32)
    coc, motion = 3.0, np.array([2.0, -1.0])
    offset = place - np.stack(np.indices(shape)[::-1], axis=-1) + coc * lens + motion * time[..., None]
    passing = np.zeros(shape, np.float32)
    ones = np.ones(shape, np.float32)
    sample = offset.astype(np.float32), lens, time, ones, ones
    straight = np.zeros((0, 0, 4), np.float32)
    _visibility_kernels.scatter_passing(tuple(members), 0, sample, (coc, *motion), straight, 0, 0, passing)
    behind = np.where(members.layer == 0, members.farther, 1.0)
    assert passing.sum() == pytest.approx(behind.sum(), rel=1e-5)
    shares_x = passing.sum(axis=0) @ np.arange(15)
    assert shares_x == pytest.approx((behind * place[..., 0]).sum(), rel=1e-5)


# --- normalisation and filling


def behind_hole(colour, seen, blur=None):
    """Put sums of a layer of a colour (H, W, 3), of which a share was seen, behind nothing."""
    sums = np.concatenate([colour * seen[..., None], seen[..., None]], axis=2).astype(np.float32)
    image = np.zeros((*seen.shape, 4), np.float32)
    add_layer(image, sums, (0, 0), REST, seen=np.zeros_like(sums[..., 3]), blur=blur)
    return image


def hole(shape, rows, cols):
    seen = np.ones(shape)
    seen[rows, cols] = 0.0
    return seen


@pytest.mark.interpreted
@pytest.mark.parametrize("shape", [(32, 32), (33, 47)])
def test_a_hole_in_a_constant_layer_is_filled_with_the_constant(shape):
    image = behind_hole(np.full((*shape, 3), (0.2, 0.5, 3.0)), hole(shape, slice(8, 20), slice(10, 25)))
    assert np.allclose(image, (0.2, 0.5, 3.0, 1.0), rtol=1e-5)


def test_a_hole_in_a_ramp_is_filled_with_about_the_ramp():
    ramp = np.repeat(np.linspace(0, 1, 64)[None], 64, axis=0)
    seen = hole((64, 64), slice(24, 40), slice(24, 40))
    image = behind_hole(np.repeat(ramp[..., None], 3, axis=2), seen)
    error = np.abs(image[..., 0] - ramp)
    assert error[seen == 1].max() < 1e-6
    assert error.max() < 0.12  # half the ramp's rise over the hole
    assert np.diff(image[24:40, 20:44, 0].mean(axis=0)).min() > 0, "it rises through the hole"


def test_a_share_that_was_seen_stands_for_the_whole():
    seen = np.random.default_rng(0).uniform(0.35, 1.0, (16, 16))
    assert np.allclose(behind_hole(np.full((16, 16, 3), 0.7), seen), (0.7, 0.7, 0.7, 1.0), atol=1e-6)


def test_where_little_was_seen_the_surroundings_count_more():
    """A few hundredths of a pixel, often of a wrong colour beside an edge, may not stand for the whole."""
    colour, seen = np.full((32, 32, 3), 0.5), np.ones((32, 32))
    colour[16, 16], seen[16, 16] = 4.0, 0.03
    assert 0.5 < behind_hole(colour, seen)[16, 16, 0] < 1.0


@pytest.mark.interpreted
def test_a_hole_is_not_filled_with_the_light_of_a_lamp_beside_it():
    colour, seen = np.full((32, 32, 3), 0.5), hole((32, 32), slice(None), slice(16, None))
    colour[14:18, 13:16] = 30.0
    filled = behind_hole(colour, seen, blur=2.0)
    assert filled[:, 16:, 0].max() < 0.7, filled[:, 16:, 0].max()
    assert np.allclose(filled[:, :16, :3], colour[:, :16]), "what was seen stays"
    assert behind_hole(colour, seen)[:, 16:, 0].max() > 5.0, "where lamps may be as likely as anything else"


def test_a_hole_in_a_bright_layer_is_as_bright():
    colour, seen = np.full((32, 32, 3), 30.0), hole((32, 32), slice(None), slice(16, None))
    assert np.allclose(behind_hole(colour, seen, blur=2.0)[..., 0], 30.0, rtol=1e-5)


@pytest.mark.parametrize(("alpha", "least"), [(1.0, 1.0), (0.8, 0.8)])
def test_past_a_layer_no_more_is_seen_than_it_leaves(alpha, least):
    """However its shares meet those of nearer ones, of which less of it may be seen than in the mean."""
    image = np.full((8, 8, 4), 0.4, np.float32)
    sums = np.full((8, 8, 4), alpha, np.float32)
    ones = np.ones((8, 8), np.float32)
    add_layer(image, sums, (0, 0), REST, seen=ones, beyond=np.float32(-0.9) * ones)
    assert np.allclose(image[..., 3], least, atol=1e-6)


def test_a_sliver_at_the_rim_of_a_blur_does_not_tell_what_is_left_there():
    nearer, beyond = np.full((1, 4), 1e-4, np.float32), np.zeros((1, 4), np.float32)
    around = np.full((1, 4), 0.2, np.float32), np.full((1, 4), 0.6, np.float32)
    _visibility_kernels.divide_shares(0, 1, nearer, beyond, around, np.float32(1e-6))
    assert np.allclose(beyond, 0.75, atol=0.01)


def test_samples_that_passed_make_a_layer_transparent():
    sums = np.full((8, 8, 4), 3.0, np.float32) * np.float32([0.5, 0.5, 0.5, 1.0])
    image = np.zeros((8, 8, 4), np.float32)
    add_layer(image, sums, (0, 0), COUNT, seen=np.full((8, 8), 9.0, np.float32), least=(4.0, 4.0))
    assert np.allclose(image, np.float32([0.125, 0.125, 0.125, 0.25]))


def test_the_last_layer_is_opaque_and_lies_behind_the_others():
    image = np.full((4, 4, 4), 0.25, np.float32)
    add_layer(image, np.full((2, 2, 4), 2.0, np.float32), (1, 1), LAST)
    assert np.allclose(image, 0.25 + 0.75 * 1.0)


# --- synthesis in layers


def square_frame(near=-9.0, far=5.0, square=(0.1, 0.3, 0.8), around=(0.7, 0.7, 0.7)):
    """A square in front of a background, each of one colour and one CoC radius, px."""
    inside = np.zeros((SIZE, SIZE), bool)
    inside[20:44, 20:44] = True
    radiance = np.where(inside[..., None], square, around).astype(np.float32)
    return Frame(radiance, np.where(inside, depth_of(near), depth_of(far)).astype(np.float32)), inside


@pytest.mark.parametrize("softness", [0.0, 1.0])
@pytest.mark.parametrize("n_layers", [2, 4, 8])
@pytest.mark.parametrize(("near", "far"), [(-9.0, 0.0), (-9.0, 5.0), (0.0, 9.0), (-4.0, 9.0)])
def test_a_square_before_a_constant_background_has_no_halo(small_combined, near, far, n_layers, softness):
    frame, _ = square_frame(near, far)
    image = synthesize(frame, CAMERA, small_combined, layers=n_layers, softness=softness, tolerance=0.0)
    truth = synthesize(layered_square(near, far), CAMERA, small_combined, tolerance=0.0)
    assert np.abs(image[..., :3] - truth[..., :3]).max() < 0.02
    assert (image[..., 3] == 1).all()
    span = [np.sort(np.array([(0.1, 0.3, 0.8), (0.7, 0.7, 0.7)])[:, c]) for c in range(3)]
    assert all(
        (image[..., c] > low - 0.01).all() and (image[..., c] < high + 0.01).all() for c, (low, high) in enumerate(span)
    )


def layered_square(near, far):
    """The same, the background behind the square being there."""
    frame, inside = square_frame(near, far)
    nearer = np.dstack([frame.radiance[..., :3] * inside[..., None], inside])
    behind = np.full((SIZE, SIZE, 3), 0.7)
    return Frame.from_layers([(nearer, frame.depth), (behind, np.full((SIZE, SIZE), depth_of(far)))])


def test_layering_beats_the_plain_sum_where_something_is_hidden(small_combined):
    frame, _ = square_frame(0.0, 9.0)
    truth = synthesize(layered_square(0.0, 9.0), CAMERA, small_combined)
    error = [
        np.abs(synthesize(frame, CAMERA, small_combined, layers=count)[..., :3] - truth[..., :3]).mean()
        for count in (1, 2)
    ]
    assert error[0] > 10 * error[1]


@pytest.mark.parametrize(("softness", "most"), [(1.0, 0.03), (0.0, 0.05)])
def test_a_slanted_plane_shows_no_seams(small_combined, softness, most):
    slant = np.repeat(depth_of(np.linspace(-8, 8, SIZE))[:, None], SIZE, axis=1)
    texture = np.random.default_rng(0).random((SIZE, SIZE, 3))
    frame = Frame(ndimage.gaussian_filter(texture, (2, 2, 0), mode="wrap") * 2, slant)
    plain = synthesize(frame, CAMERA, small_combined, layers=1)
    divided = synthesize(frame, CAMERA, small_combined, layers=6, softness=softness)
    assert np.abs(divided - plain).max() < most


def test_softness_and_number_of_layers_change_the_image(small_combined):
    blocks = np.kron(np.random.default_rng(0).uniform(-8, 8, (8, 8)), np.ones((8, 8)))
    frame = Frame(np.random.default_rng(0).random((SIZE, SIZE, 3)), depth_of(blocks))
    images = [
        synthesize(frame, CAMERA, small_combined, layers=count, softness=softness)
        for count, softness in ((4, 1.0), (4, 0.0), (3, 1.0))
    ]
    assert np.array_equal(images[1], synthesize(frame, CAMERA, small_combined, layers=4)), "hard layers are the default"
    assert all(np.abs(each - images[0]).max() > 1e-3 for each in images[1:])


@pytest.mark.parametrize(("name", "value", "allowed"), [("layers", 0, "1 to 64"), ("layers", 65, "1 to 64")])
def test_a_number_of_layers_out_of_range_is_refused(small_combined, name, value, allowed):
    with pytest.raises(InvalidParameterError, match=f"{name} is {value}: allowed are {allowed}"):
        synthesize(square_frame()[0], CAMERA, small_combined, **{name: value})


@pytest.mark.parametrize("value", [-0.1, 1.5, float("nan")])
def test_a_softness_out_of_range_is_refused(small_combined, value):
    with pytest.raises(InvalidParameterError, match=r"softness is .*: allowed are 0 \(hard layers\) to 1"):
        reconstruct(bar_samples(1), CAMERA, small_combined, softness=value)


# --- reconstruction

BAR_COC, BACK_COC, BAR_MOTION = -8.0, 0.0, np.array([14.0, 0.0])
BAR = (24.0, 40.0)
"""Columns between which the bar lies at the frame's time, seen from the lens's centre."""


def seen_by_rays(rows, cols, lens, time):
    """Colour and label of the rays through places of the image: a moving bar out of focus, and stripes in focus."""
    x = cols - BAR_COC * lens[..., 0] - BAR_MOTION[0] * time
    hit = (x >= BAR[0]) & (x < BAR[1])
    stripes = 0.3 + 0.3 * np.sin((rows + cols) / 6)
    colour = np.where(hit[..., None], (0.9, 0.4, 0.1), stripes[..., None] * np.array([0.4, 0.7, 1.0]))
    depth = np.where(hit, depth_of(BAR_COC), depth_of(BACK_COC))
    return colour, depth, np.where(hit[..., None], BAR_MOTION, 0.0), hit


def random_rays(n_samples, seed=0, size=SIZE):
    """Places in the pixels, on the lens and in time."""
    rng = np.random.default_rng(seed)
    shape = (size, size, n_samples)
    radius, angle = np.sqrt(rng.random(shape)), rng.uniform(0, 2 * np.pi, shape)
    lens = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)
    return lens, rng.uniform(-0.25, 0.25, shape), rng.uniform(-0.5, 0.5, (*shape, 2))


def bar_samples(n_samples, seed=0):
    lens, time, offset = random_rays(n_samples, seed)
    rows, cols = (index[..., None] for index in np.indices((SIZE, SIZE)))
    colour, depth, motion, _ = seen_by_rays(rows + offset[..., 1], cols + offset[..., 0], lens, time)
    return SampleBuffer(colour, depth, motion, lens, time, offset)


@pytest.fixture(scope="module")
def bar_truth():
    """The mean of 512 samples in each pixel."""
    return np.mean([bar_samples(64, seed=100 + k).radiance.mean(axis=2) for k in range(8)], axis=0)


def rms(image, truth):
    inside = np.s_[8:-8, 8:-8, :3]
    return float(np.sqrt(np.mean((image[inside] - truth[inside]) ** 2)))


def test_samples_become_cleaner_than_their_mean_and_more_of_them_better(bar_truth):
    found = [rms(reconstruct(bar_samples(count), CAMERA, "combined"), bar_truth) for count in (1, 2, 4)]
    mean = rms(reconstruct(bar_samples(1), CAMERA, method="mean"), bar_truth)
    assert found[0] < 0.1 * mean  # measured 0.072
    assert found[0] > found[1] > found[2]


def test_from_samples_layers_beat_the_plain_sum(small_combined, bar_truth):
    samples = bar_samples(2)
    plain, divided = (rms(reconstruct(samples, CAMERA, small_combined, layers=count), bar_truth) for count in (1, 2))
    assert divided < 0.8 * plain


def test_dense_and_sparse_reconstruct_alike(small_combined):
    samples = bar_samples(1)
    sparse, dense = (reconstruct(samples, CAMERA, small_combined, method=name) for name in ("spreadlets", "dense"))
    assert rms(sparse, dense) < 0.01


@pytest.mark.parametrize(
    ("coc", "motion"), [(6.0, (0.0, 0.0)), (-6.0, (0.0, 0.0)), (0.0, (20.0, -8.0)), (6.0, (20.0, -8.0))]
)
def test_samples_of_a_texture_return_to_where_they_would_lie_without_lens_and_motion(small_combined, coc, motion):
    def texture(x, y):
        return np.repeat(0.5 + 0.4 * (np.sin(x / 1.5) * np.cos(y / 2.0))[..., None], 3, axis=-1)

    lens, time, offset = random_rays(4)
    rows, cols = np.indices((SIZE, SIZE))
    x, y = (
        index[..., None] + offset[..., axis] - coc * lens[..., axis] - motion[axis] * time
        for axis, index in enumerate((cols, rows))
    )
    moving = np.broadcast_to(motion, (*time.shape, 2))
    samples = SampleBuffer(texture(x, y), np.full(time.shape, depth_of(coc)), moving, lens, time, offset)
    image = reconstruct(samples, CAMERA, small_combined, defocus=False, motion=False)
    assert rms(image, texture(cols, rows)) < 0.045  # measured 0.027


@pytest.mark.parametrize("coc", [0.0, 1.5, 3.0, 4.0])
def test_a_narrow_psf_of_a_sample_is_placed_to_a_fraction_of_a_pixel(small_combined, coc):
    shape = SIZE, SIZE, 5  # as many as stand for a pixel
    colour, (dx, dy) = np.zeros((*shape, 3)), (0.3, -0.2)
    colour[30, 33] = 1.0
    still, centre, offset = np.zeros((*shape, 2)), np.zeros((*shape, 2)), np.broadcast_to((dx, dy), (*shape, 2))
    samples = SampleBuffer(colour, np.full(shape, depth_of(coc)), still, centre, np.zeros(shape), offset)
    image = reconstruct(samples, CAMERA, small_combined, layers=1, firefly_clamp=np.inf, calibrate=False)
    light, (rows, cols) = image[..., 0], np.indices((SIZE, SIZE))
    assert (light * rows).sum() / light.sum() == pytest.approx(30 + dy, abs=0.05)
    assert (light * cols).sum() / light.sum() == pytest.approx(33 + dx, abs=0.05)


def plane_samples(n_samples=2, coc=6.0, motion=(10.0, -4.0), alpha=1.0):
    """Samples of a plane of one colour, wherever they are on the lens and in time."""
    lens, time, offset = random_rays(n_samples)
    colour = np.array([0.2, 0.5, 0.9, 1.0]) * alpha
    return SampleBuffer(
        np.broadcast_to(colour, (*time.shape, 4)),
        np.full(time.shape, depth_of(coc)),
        np.broadcast_to(motion, (*time.shape, 2)),
        lens,
        time,
        offset,
    )


@pytest.mark.parametrize(("coc", "motion"), [(0.0, (0.0, 0.0)), (6.0, (0.0, 0.0)), (-7.0, (10.0, -4.0))])
@pytest.mark.parametrize("n_samples", [1, 3])
def test_samples_of_one_colour_become_that_colour(small_combined, coc, motion, n_samples):
    image = reconstruct(plane_samples(n_samples, coc, motion), CAMERA, small_combined)
    assert np.allclose(image, (0.2, 0.5, 0.9, 1.0), atol=2e-3)


def test_missing_samples_take_no_part(small_combined):
    whole, there = bar_samples(2), np.ones((SIZE, SIZE, 2), bool)
    there[..., 1] = False
    labels = {name: values.copy() for name, values in whole.labels.items()}
    radiance = whole.radiance.copy()
    radiance[..., 1, :3] = 1e3
    masked = SampleBuffer(radiance, **labels, valid=there)
    expected = reconstruct(whole.take(1), CAMERA, small_combined)
    assert np.allclose(reconstruct(masked, CAMERA, small_combined), expected, atol=1e-5)
    assert np.allclose(reconstruct(masked, CAMERA, method="mean"), whole.radiance[:, :, 0], atol=1e-6)


@pytest.mark.parametrize("effect", ["defocus", "motion"])
def test_an_effect_can_be_taken_out_of_samples(bar_truth, effect):
    image = reconstruct(bar_samples(4), CAMERA, "combined", **{effect: False})
    truth = np.mean([bar_without(effect, seed) for seed in range(8)], axis=0)
    assert rms(image, truth) < 0.028
    # Measured .33 and .70: what is left out of the image is what the two truths differ by.
    assert rms(image, truth) < 0.9 * rms(image, bar_truth)


def bar_without(effect, seed):
    """The mean of 64 samples in each pixel through a pinhole, or at the frame's time."""
    lens, time, offset = random_rays(64, 300 + seed)
    lens, time = (0 * lens, time) if effect == "defocus" else (lens, 0 * time)
    rows, cols = (index[..., None] for index in np.indices((SIZE, SIZE)))
    colour, *_ = seen_by_rays(rows + offset[..., 1], cols + offset[..., 0], lens, time)
    return colour.mean(axis=2)


def test_samples_that_meet_nothing_make_the_foreground_transparent(small_combined):
    lens, time, offset = random_rays(4)
    rows, cols = (index[..., None] for index in np.indices((SIZE, SIZE)))
    colour, depth, motion, hit = seen_by_rays(rows + offset[..., 1], cols + offset[..., 0], lens, time)
    radiance = np.concatenate([colour * hit[..., None], hit[..., None]], axis=-1)
    image = reconstruct(SampleBuffer(radiance, depth, motion, lens, time, offset), CAMERA, small_combined)
    alpha = np.mean([bar_alpha(seed) for seed in range(8)], axis=0)
    inside = np.s_[8:-8, 2:-2]
    assert np.abs(image[..., 3] - alpha)[inside].mean() < 0.02 and np.abs(image[..., 3] - alpha)[inside].max() < 0.15
    assert np.allclose(image[..., 0], 0.9 * image[..., 3], atol=2e-3), "colour stays premultiplied"


def bar_alpha(seed):
    lens, time, offset = random_rays(64, 200 + seed)
    rows, cols = (index[..., None] for index in np.indices((SIZE, SIZE)))
    return seen_by_rays(rows + offset[..., 1], cols + offset[..., 0], lens, time)[3].mean(axis=2)


def test_results_do_not_depend_on_the_number_of_threads(small_combined):
    samples, frame = bar_samples(1), square_frame()[0]
    first, *others = for_thread_counts(
        lambda: (reconstruct(samples, CAMERA, small_combined), synthesize(frame, CAMERA, small_combined))
    )
    assert all(np.array_equal(one, two) for other in others for one, two in zip(first, other, strict=True))


def test_an_unknown_method_of_reconstruction_is_named(small_combined):
    with pytest.raises(
        InvalidParameterError, match="method 'gather' is unknown: allowed are spreadlets, dense, dense-rows"
    ):
        reconstruct(bar_samples(1), CAMERA, small_combined, method="gather")


# --- the command


@pytest.fixture(scope="module")
def files(tmp_path_factory, bar_truth):
    folder = tmp_path_factory.mktemp("samples")
    write_samples(folder / "samples.exr", bar_samples(2))
    write_image(folder / "reference.exr", bar_truth.astype(np.float32))
    (folder / "camera.json").write_text(json.dumps(CAMERA_FILE))
    return folder


def run(files, database, *options):
    paths = [str(files / "samples.exr"), "-o", str(files / "out.exr"), "--camera", str(files / "camera.json")]
    return CliRunner().invoke(cli, ["reconstruct", *paths, "--db", str(database), "--json", *options])


def test_the_command_prints_one_json_object(files, small_combined_path):
    result = run(files, small_combined_path, "--reference", str(files / "reference.exr"))
    assert result.exit_code == 0, result.output
    report = json.loads(result.stdout)
    assert {"read", "plan", "splat", "integrate", "composite", "write", "total"} <= set(report["time_s"])
    assert {"layers", "cells_used", "points_splatted", "left_out"} <= set(report["plan"])
    assert {"compile_s", "peak_rss_mb", "ssim", "psnr", "flip", "relmse", "mae"} <= set(report)
    assert report["ssim"] > 0.98 and (files / "out.exr").exists()


def test_calibration_can_be_left_out(files, small_combined_path):
    made = {}
    for options in ((), ("--no-calibrate",)):
        result = run(files, small_combined_path, "--reference", str(files / "reference.exr"), *options)
        assert result.exit_code == 0, result.output
        report = json.loads(result.stdout)
        made[options] = report["psnr"], "calibration" in report["plan"]["left_out"]
    assert made[()][0] != made["--no-calibrate",][0]
    assert made[()][1] is False and made["--no-calibrate",][1] is True


def test_fewer_samples_can_be_asked_for(files, small_combined_path):
    reference = "--reference", str(files / "reference.exr")
    found = [
        json.loads(run(files, small_combined_path, "--method", "mean", "--spp", spp, *reference).stdout)["ssim"]
        for spp in ("1", "2")
    ]
    assert found[0] < found[1]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--spp", "3"), "--spp is 3, but"),
        (("--layers", "65"), "layers is 65: allowed are 1 to 64"),
        (("--softness", "2"), "softness is 2.0: allowed are 0"),
        (("--method", "magic"), "'magic' is not one of 'spreadlets', 'dense'"),
        (("--reference", "nowhere.exr"), "nowhere.exr"),
    ],
)
def test_bad_input_is_one_line_and_status_2(
    files, small_combined_path, monkeypatch, capsys, tmp_path, options, message
):
    output = tmp_path / "out.exr"
    paths = [str(files / "samples.exr"), "-o", str(output), "--camera", str(files / "camera.json")]
    arguments = ["spreadlets", "reconstruct", *paths, "--db", str(small_combined_path), *options]
    monkeypatch.setattr("sys.argv", arguments)
    with pytest.raises(SystemExit) as stopped:
        main()
    error = capsys.readouterr().err.strip()
    assert stopped.value.code == 2 and message in error and "\n" not in error and not output.exists()
