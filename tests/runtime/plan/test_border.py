"""What continues a frame beyond its border."""

import numpy as np
import pytest

from spreadlets.arrays import NOTHING
from spreadlets.runtime.plan._border_kernels import Border
from spreadlets.runtime.plan.border import NO_BORDER, border_limit, edge_slopes, extended_pass
from spreadlets.runtime.splat.passes import STRIDES, SplatPass


def extended(radiance, label, reach, border=None, coc=None):
    frame = SplatPass((0, 0), radiance, label)
    return extended_pass(
        frame,
        NOTHING,
        np.array(reach),
        border or Border(border_limit(radiance), edge_slopes(radiance[..., 0] if coc is None else coc)),
    )


def test_the_border_is_continued_as_far_as_psfs_reach_back_in_whole_blocks():
    radiance = np.full((16, 24, 4), 0.5, np.float32)
    label = np.zeros((16, 24), np.int32)
    label[:, -1] = 1
    found = extended(radiance, label, [5, 2])
    assert found.origin == (-8, -8) and not any(side % STRIDES[-1] for side in found.origin)
    rows, cols = np.nonzero(found.label == 0)
    assert (rows.min() - 8, cols.min() - 8) == (-5, -5) and rows.max() - 8 == 15 + 5
    rows, cols = np.nonzero(found.label == 1)
    assert (rows.min() - 8, rows.max() - 8, cols.max() - 8) == (-2, 15 + 2, 23 + 2)
    assert (found.radiance[found.label >= 0] == 0.5).all()
    np.testing.assert_array_equal(found.label[8:24, 8:32], label)


def test_beyond_the_border_it_is_as_bright_as_on_it():
    radiance = np.ones((64, 64, 4), np.float32)
    radiance[..., :3] = np.random.default_rng(0).choice([0.1, 1.8], (64, 64, 1), p=[0.7, 0.3])
    even = np.ones((64, 64), np.float32)
    found = extended(radiance, np.zeros((64, 64), np.int32), [4], coc=even)
    above = found.radiance[-found.origin[0] - 4 : -found.origin[0], -found.origin[1] : 64 - found.origin[1]]
    np.testing.assert_array_equal(above, np.broadcast_to(radiance[:1], above.shape))


@pytest.mark.parametrize("turns", range(4))
@pytest.mark.parametrize("slope", [-1.5, -0.5, 0.0, 1.0])
def test_beyond_the_border_outlines_go_on_in_their_direction(slope, turns):
    rows, cols = np.mgrid[-40:96.0, -40:136.0]
    # A bright bar, anti-aliased, crosses the upper border at its middle.
    cover = np.clip(10.5 - np.abs(cols - 48 + slope * (rows + 0.5)), 0.0, 1.0)
    whole = (0.2 + 0.7 * cover)[..., None] * np.ones(4)
    radiance = np.ascontiguousarray(np.rot90(whole[40:, 40:136], turns), np.float32)
    found = extended(radiance, np.zeros(radiance.shape[:2], np.int32), [16])
    shown = np.rot90(found.radiance[..., 0], -turns)
    top, left = np.argwhere(np.rot90(found.label, -turns) == 0).min(axis=0)
    above = shown[top : top + 16, left + 16 : left + 16 + 96]
    # Each of its sides is off by less than two pixels.
    assert np.abs(above - whole[24:40, 40:136, 0]).sum(axis=1).max() < 2 * 2 * 0.7


def test_a_lamp_on_the_border_is_dimmed_beyond_it_in_its_own_hue():
    radiance = np.full((64, 64, 4), 0.1, np.float32)
    radiance[..., 3] = 1.0
    radiance[0, 30, :3] = 400.0, 200.0, 100.0
    found = extended(radiance, np.zeros((64, 64), np.int32), [4])
    above = found.radiance[-found.origin[0] - 1, 30 - found.origin[1]]
    assert above[0] < 1.5 and above[:3] / above[0] == pytest.approx([1.0, 0.5, 0.25]) and above[3] == 1
    np.testing.assert_array_equal(found.radiance[-found.origin[0], 30 - found.origin[1]], radiance[0, 30])


def test_without_a_limit_the_frame_ends_at_its_border():
    radiance, label = np.ones((8, 8, 4), np.float32), np.zeros((8, 8), np.int32)
    assert extended(radiance, label, [4], NO_BORDER).label is label


def test_light_that_covers_nothing_goes_on_too():
    radiance = np.zeros((16, 16, 4), np.float32)
    radiance[..., :3] = 5.0
    found = extended(radiance, np.zeros((16, 16), np.int32), [4])
    assert (found.radiance[found.label >= 0] == (5.0, 5.0, 5.0, 0.0)).all() and (found.label >= 0).sum() == 24 * 24
