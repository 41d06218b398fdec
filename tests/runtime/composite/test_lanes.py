"""Lanes: what moves far in focus keeps what differs across its paths, and loses what is noise."""

import numpy as np
import pytest
from naive.lanes import sums_along

from spreadlets.runtime.composite import _lane_kernels
from spreadlets.runtime.composite.composite import COUNT, LAST, add_layer
from spreadlets.runtime.composite.lanes import REACH, SHARP_REACH, find_lanes
from spreadlets.runtime.plan.layering import Membership

SIZE, LENGTH = 48, 24
GREY = np.float32(0.5)


def lanes_of(texture, coc=0.0, path=(LENGTH, 0.0)):
    """Return the lanes of a layer whose samples have the colours of a texture (H, W)."""
    still = np.zeros(texture.shape, np.float32)
    members = Membership(still.astype(np.int32), still.astype(np.int32), still)
    radiance = np.repeat(texture[..., None], 4, axis=2).astype(np.float32)
    radiance[..., 3] = 1.0
    paths = np.tile(np.float32(path), (*texture.shape, 1))
    return find_lanes([members], [radiance], [still + np.float32(coc)], [paths], 0)


def swept(texture):
    """Return the sums of the splats of such samples, each along its path, which is level."""
    weight = np.ones(LENGTH) / LENGTH
    colour = np.stack([np.convolve(np.pad(row, LENGTH, "wrap"), weight, "same")[LENGTH:-LENGTH] for row in texture])
    return np.stack([colour, colour, colour, np.ones_like(colour)], axis=-1).astype(np.float32)


def filled(texture, lanes):
    """Return one colour of the image of such a layer, the last."""
    image = np.zeros((SIZE, SIZE, 4), np.float32)
    add_layer(image, swept(texture), (0, 0), LAST, least=(5.0, 4.0), lanes=lanes)
    return image[..., 0]


def test_rings_stay_as_sharp_as_they_were_seen():
    stripes = np.repeat(np.arange(SIZE)[:, None] // 4 % 2, SIZE, axis=1).astype(np.float32)
    inside = slice(8, -8), slice(8, -8)
    kept = np.abs(filled(stripes, lanes_of(stripes)) - stripes)[inside].max()
    lost = np.abs(filled(stripes, None) - stripes)[inside].max()
    assert kept < 0.01, kept
    assert lost > 0.1, lost


def test_noise_across_paths_is_averaged():
    noise = np.random.default_rng(0).integers(0, 2, (SIZE, SIZE)).astype(np.float32)
    before, found = swept(noise)[..., 0], filled(noise, lanes_of(noise))
    assert found.std() < 0.7 * before.std(), (found.std(), before.std())


@pytest.mark.parametrize(("coc", "path"), [(1.5 * SHARP_REACH, (LENGTH, 0.0)), (0.0, (4.0, 0.0))])
def test_what_is_blurred_or_hardly_moves_has_no_lanes(coc, path):
    assert lanes_of(np.ones((SIZE, SIZE)), coc, path) is None


def test_what_passed_a_layer_leaves_it_transparent():
    lanes = lanes_of(np.full((SIZE, SIZE), GREY))
    image, sums = np.zeros((SIZE, SIZE, 4), np.float32), np.ones((SIZE, SIZE, 4), np.float32)
    add_layer(image, sums, (0, 0), COUNT, seen=np.full((SIZE, SIZE), 3.0, np.float32), least=(5.0, 4.0), lanes=lanes)
    assert np.allclose(image, 0.25, atol=1e-5)


@pytest.mark.interpreted
def test_sums_along_paths_are_those_of_each_place():
    rng = np.random.default_rng(0)
    y, x = np.indices((12, 14)) - 6.3
    path = (np.stack([-y, x], axis=-1) * 1.5).astype(np.float32)
    padded, planes = rng.uniform(0.2, 1.0, (12, 14, 4)), rng.uniform(0.0, 1.0, (12, 14, 6))
    padded, planes, seen = (each.astype(np.float32) for each in (padded, planes, rng.uniform(0.0, 1.0, (12, 14))))
    along, lane = np.empty((12, 14, 5), np.float32), np.empty((12, 14, 6), np.float32)
    given = padded, 0, 0, seen, COUNT, planes, path, REACH
    _lane_kernels.sum_along(0, 12, *given, along, lane)
    for row, col in ((0, 0), (3, 5), (6, 6), (8, 12), (11, 4)):
        expected = sums_along(padded, padded[..., 3] + seen, planes, path, REACH, row, col)
        assert along[row, col] == pytest.approx(expected[0], rel=1e-4), (row, col)
        assert lane[row, col] == pytest.approx(expected[1], rel=1e-4), (row, col)
