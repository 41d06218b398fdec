"""Layers in a medium: compared with paths that are followed one by one."""

import numpy as np
import pytest

import spreadlets as sp
from spreadlets.runtime.composite.haze import Haze

SIDE, RADIUS_PX = 160, 26
DENSITY, ANISOTROPY, ALBEDO = 0.9, 0.8, (1.0, 1.0, 0.9)
FOCAL_PX, PSF_RADIUS_PX = 50.0 / 36.0 * 512, 128.0
CAMERA = sp.ThinLens(
    focal_length_mm=50.0, sensor_width_mm=36.0 * SIDE / 512, f_number=2.0, focus_distance_m=2.0, shutter=(0.0, 0.0)
)


def share_that_passes(near, far, n_paths=150_000):
    """What a pixel sees of a white wall past a disc in front of it, in fog, of what it would see without the disc."""
    rng = np.random.default_rng(0)
    place, direction = np.zeros((n_paths, 3)), np.tile([0.0, 0.0, 1.0], (n_paths, 1))
    weight, blocked, on_its_way = np.ones((n_paths, 3)), np.zeros(n_paths, bool), np.arange(n_paths)
    seen, whole = np.zeros(3), np.zeros(3)
    for _ in range(60):
        here, along = place[on_its_way], direction[on_its_way]
        there = here + rng.exponential(1.0 / DENSITY, len(on_its_way))[:, None] * along

        def distance_at(plane, here=here, along=along):
            """Distance from the axis, px, of where paths meet a plane."""
            meeting = here + ((plane - here[:, 2]) / along[:, 2])[:, None] * along
            return np.hypot(*meeting[:, :2].T) * FOCAL_PX / plane

        at_disc = (here[:, 2] - near) * (there[:, 2] - near) < 0
        blocked[on_its_way[at_disc]] |= distance_at(near)[at_disc] < RADIUS_PX
        ends = there[:, 2] >= far
        arrived = ends & (distance_at(far) < PSF_RADIUS_PX)
        whole += weight[on_its_way[arrived]].sum(axis=0)
        seen += weight[on_its_way[arrived & ~blocked[on_its_way]]].sum(axis=0)
        # Scatter those that go on, by the law of Henyey and Greenstein.
        on_its_way, along = on_its_way[~ends], along[~ends]
        place[on_its_way] = there[~ends]
        weight[on_its_way] *= ALBEDO
        part = (1 - ANISOTROPY**2) / (1 - ANISOTROPY + 2 * ANISOTROPY * rng.random(len(on_its_way)))
        cosine = (1 + ANISOTROPY**2 - part**2) / (2 * ANISOTROPY)
        aside = np.cross(along, rng.normal(size=along.shape))
        aside /= np.linalg.norm(aside, axis=1, keepdims=True)
        direction[on_its_way] = cosine[:, None] * along + np.sqrt(1 - cosine**2)[:, None] * aside
    return seen.mean() / whole.mean()


def centre_past_a_black_disc(near, far):
    y, x = np.mgrid[:SIDE, :SIDE] - 0.5 * (SIDE - 1)
    disc = np.dstack([np.zeros((SIDE, SIDE, 3)), np.hypot(x, y) < RADIUS_PX])
    wall = np.ones((SIDE, SIDE, 4))
    frame = sp.Frame.from_layers([(disc, np.full((SIDE, SIDE), near)), (wall, np.full((SIDE, SIDE), far))])
    with pytest.warns(match="no axis 'coc'"):
        image = sp.synthesize(frame, CAMERA, "volume")
    return image[SIDE // 2 - 1 : SIDE // 2 + 1, SIDE // 2 - 1 : SIDE // 2 + 1].mean(axis=(0, 1))


@pytest.mark.parametrize(("near", "far"), [(0.9, 3.6), (0.9, 1.125)])
def test_as_much_of_a_wall_passes_a_disc_in_fog_as_paths_do(near, far):
    centre = centre_past_a_black_disc(near, far)
    assert centre[:3].mean() == pytest.approx(share_that_passes(near, far), rel=0.06)
    assert centre[3] == 1.0


def test_layers_whose_opacity_is_all_blurred_hide_by_the_product():
    rng = np.random.default_rng(1)
    covers = rng.random((3, 8, 8)).astype(np.float32)
    depth = [np.full((8, 8), metres) for metres in (1.0, 2.0, 4.0)]
    frame = sp.Frame.from_layers([(np.dstack([each] * 4), z) for each, z in zip(covers, depth, strict=True)])
    haze, image = Haze(frame.layers, lambda near, far: 1.0), np.zeros((8, 8, 4), np.float32)
    for number, cover in enumerate(covers):
        haze.hide(image, number)
        assert image[..., 3] == pytest.approx(1.0 - np.prod(1.0 - covers[:number], axis=0), abs=1e-5)
        image[..., 3] += (1.0 - image[..., 3]) * cover
        haze.add(image)
    haze.hide(image)
    assert image[..., 3] == pytest.approx(1.0 - np.prod(1.0 - covers, axis=0), abs=1e-5)
