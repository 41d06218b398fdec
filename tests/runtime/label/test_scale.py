"""The scale at which depths are compared: surfaces that move apart are told apart, and none falls apart."""

from dataclasses import replace

import numpy as np
import pytest

from spreadlets.runtime.label.scale import LEAST_GAP, places, separating_scale
from spreadlets.runtime.label.surfaces import split_surfaces
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.frame import Frame

SIDE, FINE = 64, 8
STOPPED_DOWN = ThinLens(
    focal_length_mm=50, sensor_width_mm=36, f_number=22, focus_distance_m=6.0, shutter=(-0.25, 0.25)
)
NEAR, FAR = 5.0, 6.0


def moving_disc(near: float = NEAR, motion: float = 8.0):
    """Return a layer with a disc that moves before a plane, with filtered colours and sampled depth, and its share."""
    y, x = (np.mgrid[: SIDE * FINE, : SIDE * FINE] + 0.5) / FINE
    inside = np.hypot(x - 30.3, y - 33.1) < 14.0
    share = inside.reshape(SIDE, FINE, SIDE, FINE).mean(axis=(1, 3))
    hit = inside[FINE // 2 :: FINE, FINE // 2 :: FINE]
    colour = share[..., None] * np.array([0.9, 0.3, 0.1]) + (1 - share[..., None]) * np.array([0.1, 0.3, 0.6])
    path = np.where(hit, motion, 0.0)[..., None] * np.array([1.0, 0.2])
    return Frame(colour, np.where(hit, near, FAR), path).layers[0], share


def share_of_disc(layer, camera):
    """Return how much of each pixel is given to what moves."""
    total = np.zeros(layer.shape)
    for surface in split_surfaces(layer, camera):
        moves = surface.layer.motion[..., 0] > 1.0
        if surface.at is None:
            total += moves * (1.0 if surface.share is None else surface.share)
        else:
            np.add.at(total, tuple(np.moveaxis(surface.at, 2, 0)), moves * surface.share)
    return total


def test_edges_of_what_moves_are_divided_though_the_lens_blurs_all_alike():
    layer, share = moving_disc()
    assert STOPPED_DOWN.coc_scale(SIDE) * (1 / NEAR - 1 / FAR) < 0.1 * LEAST_GAP
    assert np.abs(share_of_disc(layer, STOPPED_DOWN) - share).max() < 0.15
    # While the shutter is closed nothing moves apart, and pixels are left whole.
    closed = share_of_disc(layer, replace(STOPPED_DOWN, shutter=(0.0, 0.0)))
    assert set(np.unique(closed)) == {0.0, 1.0}


@pytest.mark.parametrize("motion", [0.0, 1.0])
def test_what_does_not_move_apart_is_compared_at_the_scale_of_the_lens(motion):
    layer, _ = moving_disc(motion=motion)
    scale = STOPPED_DOWN.coc_scale(SIDE)
    assert scale <= separating_scale(layer, STOPPED_DOWN) <= np.sqrt(2.0) * scale


def test_a_lens_that_tells_them_apart_is_not_outdone():
    layer, _ = moving_disc()
    wide = replace(STOPPED_DOWN, f_number=0.05)
    scale = wide.coc_scale(SIDE)
    assert scale * (1 / NEAR - 1 / FAR) > LEAST_GAP
    assert scale <= separating_scale(layer, wide) <= np.sqrt(2.0) * scale


@pytest.mark.parametrize("times", [1, 2])
def test_a_slope_does_not_fall_apart_beside_what_hardly_differs_in_depth(times):
    """Nor does one of pixels that are repeated, which changes at every second one only."""
    layer, _ = moving_disc(near=FAR - 0.001)
    # A floor as steep as that from one pixel to the next.
    floor = 1.0 / (1.0 / layer.depth + 0.0006 * np.arange(SIDE)[:, None])
    depth, motion = (each.repeat(times, 0).repeat(times, 1) for each in (floor, times * layer.motion))
    slope = Frame(np.ones((*depth.shape, 3)), depth, motion).layers[0]
    place = places(slope, separating_scale(slope, STOPPED_DOWN))
    assert np.abs(np.diff(place[:, 0])).max() < 0.3


def test_scales_are_finite_whatever_the_depths():
    layer, _ = moving_disc()
    for depth in (1e-3, 1e10, np.inf):
        one = replace(layer, depth=np.where(layer.motion[..., 0] > 0, np.float32(depth), layer.depth))
        assert np.isfinite(separating_scale(one, STOPPED_DOWN))
