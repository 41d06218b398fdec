import base64
import zlib

import matplotlib.image
import numba
import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from spreadlets.errors import InvalidFileError, InvalidParameterError
from spreadlets.precompute.build.build import build_database
from spreadlets.precompute.models.grids import model_settings
from spreadlets.precompute.models.registry import trace_psf
from spreadlets.precompute.models.stylized import MAX_SIDE, decode, read_settings
from spreadlets.precompute.sparsify.sparsify import sparsify
from spreadlets.psf.database import open_database
from spreadlets.psf.model import get_model

compiled = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="millions of deposits need the compiled kernels")


def letter(n=48):
    """An L with a coloured foot, as sRGB: no symmetry."""
    image = np.zeros((n, n, 3))
    image[4:-4, 8:18] = 1.0
    image[-14:-4, 8:-6] = (1.0, 0.6, 0.2)
    return image


@pytest.fixture
def letter_path(tmp_path):
    matplotlib.image.imsave(tmp_path / "letter.png", letter())
    return str(tmp_path / "letter.png")


def linear(display):
    return np.where(display <= 0.04045, display / 12.92, ((display + 0.055) / 1.055) ** 2.4)


def drawn(light, radius, offset=0.0, n=12):
    """Resample an image to a radius by brute force: many look-ups in every pixel; (H, W, 3), unit mean sum."""
    half = int(np.ceil(radius * (1.1 + offset))) + 1
    fine = (np.arange((2 * half + 1) * n) + 0.5) / n - half - 0.5
    y, x = np.meshgrid(fine, fine, indexing="ij")
    scale = 0.5 * max(light.shape[:2]) / radius
    middle = [0.5 * (size - 1) for size in light.shape[:2]]
    planes = []
    for channel, move in enumerate((offset, 0.0, -offset)):
        place = [y * scale + middle[0], (x - radius * move) * scale + middle[1]]
        values = map_coordinates(light[..., channel], place, order=1, mode="grid-constant")
        planes.append(values.reshape(2 * half + 1, n, 2 * half + 1, n).mean(axis=(1, 3)))
    psf = np.stack(planes, axis=-1)
    return psf * (3 / psf.sum())


def relative_l1(psf, expected):
    shape = np.maximum(psf.shape, expected.shape)
    on = [np.pad(p, [((n - m) // 2,) * 2 for n, m in zip(shape, p.shape, strict=True)]) for p in (psf, expected)]
    return np.abs(on[0] - on[1]).sum() / 3


def stylized(path, **options):
    return get_model("stylized", settings=model_settings("stylized", {"image": path, **options}))


@compiled
@pytest.mark.parametrize("radius, offset", [(3.3, 0.1), (12.0, 0.0), (30.0, 0.1)])
def test_psf_is_the_image_at_the_size_of_the_circle_of_confusion(letter_path, radius, offset):
    psf = trace_psf(stylized(letter_path, colour_offset=offset), [[radius, radius]])
    assert relative_l1(psf, drawn(linear(letter()), radius, offset)) < 0.01


@compiled
def test_prefilter_averages_the_sizes(letter_path):
    model = stylized(letter_path)
    nodes = np.linspace(10.0, 14.0, 41)
    weights = 1 - np.abs(nodes - 12.0) / 2.0
    size = drawn(linear(letter()), 14.0).shape[0]
    expected = np.zeros((size, size, 3))
    for radius, weight in zip(nodes, weights, strict=True):
        psf = drawn(linear(letter()), radius, n=8)
        margin = (size - psf.shape[0]) // 2
        expected += weight * np.pad(psf, ((margin,) * 2, (margin,) * 2, (0, 0)))
    assert relative_l1(trace_psf(model, [[10.0, 14.0]]), expected / weights.sum()) < 0.01


@compiled
def test_coloured_spreadlet_is_similar_in_every_channel(letter_path):
    psf = trace_psf(stylized(letter_path, colour_offset=0.1), [[29.0, 30.0]])
    spreadlet, statistics = sparsify(psf)
    assert spreadlet.n_channels == 3 and not spreadlet.direct
    assert statistics["ssim"] > 0.965 and statistics["sparsity"] < 0.3
    moments = spreadlet.moments()
    np.testing.assert_allclose(0.25 * (moments[4] + moments[5]), psf.sum(axis=(0, 1)), rtol=1e-5)


def test_image_goes_with_the_database(letter_path, tmp_path):
    build_database("stylized", tmp_path / "l.h5", samples=3, max_coc=3.0, image=letter_path, rays=20_000, jobs=1)
    with open_database(tmp_path / "l.h5") as database:
        assert database.n_channels == 3
        stored = decode(database.grid.model.settings["image"])
        assert database.grid.model == get_model(
            "stylized", 3.0, settings=model_settings("stylized", {"image": letter_path})
        )
    np.testing.assert_allclose(stored, linear(letter()), atol=1e-2)


def test_alpha_multiplies_and_large_images_are_reduced(tmp_path):
    image = np.zeros((2 * MAX_SIDE, 40, 4))
    image[..., :3], image[:, 20:, 3] = 1.0, 1.0
    matplotlib.image.imsave(tmp_path / "a.png", image)
    light = decode(model_settings("stylized", {"image": str(tmp_path / "a.png")})["image"])
    assert light.shape == (MAX_SIDE, 20, 3)
    assert light[:, :8].max() < 0.01 and light[:, 12:].min() > 0.99


def test_unusable_images_are_refused(tmp_path):
    matplotlib.image.imsave(tmp_path / "black.png", np.zeros((8, 8, 3)))
    (tmp_path / "text.png").write_text("no image")
    cases = {
        "black.png": (InvalidParameterError, "black.png: the image holds no light"),
        "text.png": (InvalidFileError, "text.png: not a readable PNG"),
        "missing.png": (InvalidFileError, "missing.png: cannot be read: No such file or directory$"),
    }
    for name, (kind, message) in cases.items():
        with pytest.raises(kind, match=message):
            model_settings("stylized", {"image": str(tmp_path / name)})
    with pytest.raises(InvalidParameterError, match="needs an image"):
        model_settings("stylized", {})


def test_offset_out_of_range_is_refused(letter_path):
    with pytest.raises(InvalidParameterError, match="colour_offset is 0.7: allowed are -0.5 to 0.5"):
        model_settings("stylized", {"image": letter_path, "colour_offset": 0.7})


def test_an_image_too_large_is_refused_before_it_is_unpacked(tmp_path):
    path = tmp_path / "large.png"
    path.write_bytes(b"\x89PNG\r\n\x1a\n\0\0\0\x0dIHDR" + (100_000).to_bytes(4, "big") * 2 + bytes(9))
    with pytest.raises(InvalidFileError, match="has 100000 x 100000 px; at most"):
        read_settings(image=str(path))


def test_an_image_of_a_database_is_not_unpacked_beyond_its_shape(letter_path):
    stored = read_settings(image=str(letter_path))["image"]
    with pytest.raises(InvalidParameterError, match="its sides end at"):
        decode(stored | {"shape": [100_000, 100_000, 3]})
    bomb = base64.b64encode(zlib.compress(bytes(1 << 24), 9)).decode()
    assert decode({"shape": [2, 2, 3], "u16": bomb}).shape == (2, 2, 3)


def test_an_image_that_has_lost_bytes_is_refused(letter_path):
    with open(letter_path, "rb") as file:
        content = file.read()
    for damaged in (content[:-200] + content[-199:], content[:-12], content[:60] + content[61:]):
        with open(letter_path, "wb") as file:
            file.write(damaged)
        with pytest.raises(InvalidFileError, match="not a readable PNG file"):
            read_settings(image=letter_path)
