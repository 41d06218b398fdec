"""What a canvas shows of linear colours."""

import numpy as np
import pytest

from spreadlets.scene.display import display_encode
from spreadlets.view import picture


@pytest.mark.parametrize("exposure", [0.0, -3.5, 2.0])
def test_a_canvas_shows_the_display_s_codes(exposure):
    values = np.concatenate([np.linspace(0.0, 1.2, 5000), np.geomspace(1e-8, 1e3, 5000)]).astype(np.float32)
    image = np.stack([values, values[::-1], 0.5 * values, np.zeros_like(values)], axis=-1)[None]
    canvas = picture.shown(image, exposure)
    exact = 255.0 * display_encode(image[..., :3] * np.float32(2.0**exposure))
    error = canvas[..., :3] - exact
    assert np.abs(error).max() < 0.6
    assert abs((canvas[..., :3] - np.rint(exact)).mean()) < 0.005
    assert (canvas[..., 3] == 255).all()


def test_what_no_display_has_is_black_or_white():
    values = np.array([np.inf, -np.inf, np.nan, -1.0, -0.0], np.float32)
    canvas = picture.shown(np.repeat(values[None, :, None], 3, axis=2), 0.0)
    assert canvas[0, :, 0].tolist() == [255, 0, 0, 0, 0]
