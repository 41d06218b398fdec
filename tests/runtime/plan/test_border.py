"""What continues a frame beyond its border."""

import numpy as np

from spreadlets.runtime.plan.border import border_colours, extended_pass
from spreadlets.runtime.splat.passes import STRIDES, SplatPass


def test_the_border_is_continued_as_far_as_psfs_reach_back_in_whole_blocks():
    radiance = np.full((16, 24, 4), 0.5, np.float32)
    label = np.zeros((16, 24), np.int32)
    label[:, -1] = 1
    frame = SplatPass((0, 0), radiance, label)
    extended = extended_pass(frame, np.zeros((0, 0), np.float32), np.array([5, 2]), border_colours(radiance))
    assert extended.origin == (-8, -8) and not any(side % STRIDES[-1] for side in extended.origin)
    rows, cols = np.nonzero(extended.label == 0)
    assert (rows.min() - 8, cols.min() - 8) == (-5, -5) and rows.max() - 8 == 15 + 5
    rows, cols = np.nonzero(extended.label == 1)
    assert (rows.min() - 8, rows.max() - 8, cols.max() - 8) == (-2, 15 + 2, 23 + 2)
    assert (extended.radiance[extended.label >= 0] == 0.5).all()
    np.testing.assert_array_equal(extended.label[8:24, 8:32], label)
