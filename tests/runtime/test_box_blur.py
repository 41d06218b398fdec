"""The blur by a box, against SciPy's."""

import numpy as np
import pytest
from scipy import ndimage

from spreadlets.runtime.box_blur import box_blurred


@pytest.mark.interpreted
@pytest.mark.parametrize("half", [0, 1, 4, 9])
@pytest.mark.parametrize("times", [1, 2])
@pytest.mark.parametrize("shape", [(13, 21), (9, 130), (7, 5)])
def test_it_is_a_uniform_filter_with_nothing_beyond_the_border(half, times, shape):
    image = np.random.default_rng(0).random(shape).astype(np.float32)
    expected = image.astype(np.float64)
    for _ in range(times):
        expected = ndimage.uniform_filter(expected, 2 * half + 1, mode="constant")
    np.testing.assert_allclose(box_blurred(image, half, times), expected, atol=1e-6)
