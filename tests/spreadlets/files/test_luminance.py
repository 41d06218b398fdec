import numpy as np

from spreadlets.files.exr_parts import Image, Plane, Window
from spreadlets.files.luminance import with_rgb


def test_luminance_and_chroma_become_colours():
    """Chroma that changes linearly is found again at every pixel but the last, odd ones."""
    rng = np.random.default_rng(1)
    window = Window(0, 0, 12, 8)
    y = (0.5 + rng.random((8, 12))).astype(np.float32)
    ramp = np.broadcast_to(np.linspace(0.1, 0.4, 12, dtype=np.float32), (8, 12))
    red, blue = (ramp + 1) * y, (0.2 - ramp + 1) * y
    green = (y - 0.212639 * red - 0.072192 * blue) / 0.715169
    planes = {
        "Y": Plane(y, window, (1, 1)),
        "RY": Plane(ramp[::2, ::2], window, (2, 2)),
        "BY": Plane((0.2 - ramp)[::2, ::2], window, (2, 2)),
        "Z": Plane(y, window, (1, 1)),
    }
    image = with_rgb(Image("f.exr", planes, window, names=tuple(planes)))
    assert image.names == ("Z", "R", "G", "B")
    found = np.stack([image.planes[name].pixels for name in "RGB"], 2)
    np.testing.assert_allclose(found[:, :-1], np.stack([red, green, blue], 2)[:, :-1], rtol=1e-5)


def test_other_images_are_left_alone():
    window = Window(0, 0, 2, 2)
    image = Image("f.exr", {"Y": Plane(np.ones((2, 2)), window, (1, 1))}, window, names=("Y",))
    assert with_rgb(image) is image
