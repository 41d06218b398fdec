from dataclasses import replace

import numpy as np
import pytest

import spreadlets as sp
from spreadlets.runtime.controls import Controls
from spreadlets.runtime.label._label_kernels import path_places
from spreadlets.runtime.label.pixels import frame_pixels
from spreadlets.runtime.label.sampled import sample_pixels


def place(before, after, time):
    found = np.empty((1, 1, 2), np.float32)
    path_places(
        0,
        1,
        *(np.array(each, np.float32).reshape(1, 1, 2) for each in (before, after)),
        np.full((1, 1), time, np.float32),
        found,
    )
    return found[0, 0]


def on_circle(turn, time, radius=40.0):
    return radius * np.array([np.cos(turn * time) - 1.0, np.sin(turn * time)])


@pytest.mark.interpreted
@pytest.mark.parametrize("degrees", [0.01, 1.0, 20.0, 60.0, 90.0, -130.0])
@pytest.mark.parametrize("time", [-1.0, -0.4, 0.25, 1.0])
def test_what_turns_at_constant_speed_moves_along_an_arc(degrees, time):
    turn = np.radians(degrees)
    found = place(-on_circle(turn, -1.0), on_circle(turn, 1.0), time)
    np.testing.assert_allclose(found, on_circle(turn, time), atol=2e-4)


@pytest.mark.parametrize(
    "before, after",
    [
        ((3.0, 1.0), (3.0, 1.0)),
        ((2.0, 1.0), (3.0, 1.5)),
        ((0.0, 0.0), (5.0, 1.0)),
        ((4.0, 0.0), (-4.0, 0.1)),
        ((4, 4), (0, 0)),
    ],
)
def test_paths_lead_through_the_places_before_and_after(before, after):
    np.testing.assert_allclose(place(before, after, -1.0), -np.array(before), atol=1e-5)
    np.testing.assert_allclose(place(before, after, 1.0), after, atol=1e-5)
    np.testing.assert_allclose(place(before, after, 0.0), [0, 0], atol=1e-6)


def test_a_stop_is_a_parabola():
    np.testing.assert_allclose(place((4.0, 0.0), (0.0, 0.0), -0.5), [-0.5 * 2 - 0.5 * 0.25 * 4, 0.0], atol=1e-6)


def turning_frame():
    """A disc that turns before a floor: curved paths, and edges that show both."""
    rows, cols = np.indices((40, 1100)) - np.array([20, 550])[:, None, None]
    disc = np.hypot(rows, cols) < 15
    depth = np.where(disc, np.float32(2.0), np.float32(9.0))
    turn = np.stack([-rows, cols], axis=-1) * disc[..., None]
    before = (turn + 0.8 * turn[..., ::-1] * [1, -1]).astype(np.float32)
    after = (turn - 0.8 * turn[..., ::-1] * [1, -1]).astype(np.float32)
    colour = np.where(disc[..., None], [0.9, 0.5, 0.1], [0.1, 0.2, 0.6])
    return sp.Frame(colour, depth, motion_prev=before, motion_next=after)


CAMERA = sp.ThinLens(focal_length_mm=50, sensor_width_mm=36, f_number=1, focus_distance_m=3.0, shutter=(-0.5, 0.5))


def test_what_a_frame_and_its_list_draw_of_a_pixel_adds_up_to_its_colour():
    layer = turning_frame().layers[0]
    base, extra = frame_pixels(layer, CAMERA, defocus=True, motion=True)
    assert not base.is_list and extra.is_list and base.curved.any()
    total = base.radiance * base.weight[..., None]
    at = extra.labels.view.places.at
    np.add.at(total, (at[..., 0], at[..., 1]), extra.radiance * extra.weight[..., None])
    assert np.abs(total - layer.radiance).max() < 1e-5
    share = base.weight.copy()
    np.add.at(share, (at[..., 0], at[..., 1]), extra.weight)
    assert np.abs(share - 1.0).max() < 1e-6


def test_pixels_of_a_list_have_the_place_of_the_frame_s():
    base, extra = frame_pixels(turning_frame().layers[0], CAMERA, defocus=True, motion=True)
    at = extra.labels.view.places.at
    for place in ("position", "block_position"):
        whole = getattr(base.labels.view, place)()
        assert np.array_equal(getattr(extra.labels.view, place)(), whole[at[..., 0], at[..., 1]])


def test_a_still_frame_in_one_depth_has_no_list():
    frame = sp.Frame(np.full((16, 16, 3), 0.5), np.full((16, 16), 4.0))
    (only,) = frame_pixels(frame.layers[0], CAMERA, defocus=True, motion=True)
    assert not only.is_list and not len(only.weight)


def test_samples_on_a_curved_path_meet_where_the_path_is_at_mid_shutter():
    """Seen at any time, through any place of the lens, one point of a turning disc is drawn at one place."""
    rng = np.random.default_rng(2)
    n = 64
    time = rng.uniform(-0.5, 0.5, (1, n, 1)).astype(np.float32)
    before, after = (np.broadcast_to(np.float32(each), (1, n, 1, 2)) for each in ((12.0, 5.0), (12.0, -5.0)))
    now = np.zeros((1, n, 2), np.float32)
    path_places(0, 1, before[:, :, 0].copy(), after[:, :, 0].copy(), time[..., 0], now)
    samples = sp.SampleBuffer(
        np.ones((1, n, 1, 3)), np.full((1, n, 1), 3.0), motion=np.broadcast_to(np.float32([12, 0]), (1, n, 1, 2)),
        lens_uv=np.zeros((1, n, 1, 2)), time=time, offset=now[:, :, None], motion_prev=before, motion_next=after,
    )  # fmt: skip
    labels = sample_pixels(samples, CAMERA, defocus=True, motion=True)[0].labels
    assert np.ptp(labels.shift, axis=1).max() < 1e-4
    straight = sp.SampleBuffer(
        np.ones((1, n, 1, 3)), np.full((1, n, 1), 3.0), motion=np.broadcast_to(np.float32([12, 0]), (1, n, 1, 2)),
        lens_uv=np.zeros((1, n, 1, 2)), time=time, offset=now[:, :, None],
    )  # fmt: skip
    assert np.ptp(sample_pixels(straight, CAMERA, defocus=True, motion=True)[0].labels.shift, axis=1).max() > 0.2


def test_surfaces_are_told_apart_by_the_blur_that_strengths_make_of_a_lens():
    y, x = np.mgrid[:32, :32]
    near = x + 0.3 * y < 18.4
    share = np.clip(18.4 - (x + 0.3 * y) + 0.5, 0.0, 1.0)[..., None]
    frame = sp.Frame(share * [0.9, 0.3, 0.1] + (1 - share) * [0.1, 0.3, 0.6], np.where(near, 2.0, 6.0))
    wide = sp.ThinLens(focal_length_mm=50, sensor_width_mm=36, f_number=0.1, focus_distance_m=6.0)
    narrow, strong = replace(wide, f_number=6.4), Controls(near_strength=64.0)
    found, expected = (
        frame_pixels(frame.layers[0], lens, defocus=True, motion=False, controls=controls)
        for lens, controls in ((narrow, strong), (wide, Controls()))
    )
    assert len(found) == len(expected) == 2
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one.weight, other.weight, atol=1e-6)
        np.testing.assert_allclose(one.labels.coc, other.labels.coc, atol=1e-4)
