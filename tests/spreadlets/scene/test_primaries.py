import numpy as np
import pytest

from spreadlets.scene.primaries import REC_709, luminance_weights, to_rec_709

AP1 = (0.713, 0.293, 0.165, 0.830, 0.128, 0.044, 0.32168, 0.33767)
XYZ = (1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1 / 3, 1 / 3)


def test_luminance_weights_are_those_of_the_standard():
    np.testing.assert_allclose(luminance_weights(REC_709), [0.2126, 0.7152, 0.0722], atol=2e-4)


@pytest.mark.parametrize("xy", [AP1, XYZ])
def test_white_stays_white(xy):
    white = np.ones((1, 1, 3), np.float32)
    np.testing.assert_allclose(to_rec_709(white, xy), white, atol=1e-6)


def test_colours_of_another_space_become_the_displays():
    # The published matrix from ACEScg to linear sRGB (Bradford, D60 to D65).
    expected = [[1.70505, -0.62179, -0.08326], [-0.13026, 1.14080, -0.01055], [-0.02400, -0.12897, 1.15297]]
    found = to_rec_709(np.eye(3, dtype=np.float32)[None], AP1)[0].T
    np.testing.assert_allclose(found, expected, atol=3e-4)


def test_the_displays_own_colours_and_impossible_primaries_change_nothing():
    image = np.random.default_rng(0).random((2, 3, 3), np.float32)
    for xy in (np.float32(REC_709), (0.3, 0.3) * 4, (0.0,) * 8):
        assert to_rec_709(image, xy) is image
