"""Colour spaces by name: there and back, in files, and by a configuration of one's own."""

import numpy as np
import pytest
from PIL import Image

from spreadlets.errors import InvalidParameterError
from spreadlets.files.colour_spaces import from_linear, to_linear
from spreadlets.files.pictures import read_picture
from spreadlets.scene.display import display_decode

library = pytest.importorskip("PyOpenColorIO")

COLOURS = np.random.default_rng(1).random((5, 7, 3)).astype(np.float32)
AP1_OF_REC_709 = np.array([[0.613, 0.339, 0.047], [0.070, 0.916, 0.013], [0.021, 0.110, 0.870]])
"""ACES, to three digits."""


def test_acescg_has_its_primaries_and_comes_back():
    there = from_linear(COLOURS, "ACEScg")
    assert np.allclose(there, COLOURS @ AP1_OF_REC_709.T, atol=2e-3)
    assert np.allclose(to_linear(there, "ACEScg"), COLOURS, atol=1e-5)


def test_the_values_of_a_file_are_taken_as_the_space_says(tmp_path):
    codes = np.rint(255 * COLOURS).astype(np.uint8)
    Image.fromarray(codes).save(tmp_path / "a.png")
    np.save(tmp_path / "a.npy", codes)
    for name in ("a.png", "a.npy"):
        assert np.allclose(read_picture(tmp_path / name).radiance, display_decode(codes / np.float32(255)), atol=1e-6)
        raw = read_picture(tmp_path / name, "Linear Rec.709 (sRGB)").radiance
        assert np.allclose(raw, codes / np.float32(255), atol=1e-6)
        assert np.allclose(read_picture(tmp_path / name, "ACEScg").radiance, to_linear(raw, "ACEScg"), atol=1e-6)


def test_unknown_spaces_are_refused_with_likely_ones_and_so_are_configurations(monkeypatch, tmp_path):
    with pytest.raises(InvalidParameterError, match="no colour space 'ACEScc g'.*ACEScg"):
        to_linear(COLOURS, "ACEScc g")
    monkeypatch.setenv("OCIO", str(tmp_path / "none.ocio"))
    with pytest.raises(InvalidParameterError, match="none.ocio"):
        to_linear(COLOURS, "ACEScg")


def test_a_configuration_of_ones_own_is_used(monkeypatch, tmp_path):
    config = library.Config.CreateFromFile("ocio://default")
    config.addColorSpace(
        library.ColorSpace(name="as it is", aliases=["own"], referenceSpace=library.REFERENCE_SPACE_SCENE)
    )
    (tmp_path / "own.ocio").write_text(config.serialize())
    monkeypatch.setenv("OCIO", str(tmp_path / "own.ocio"))
    assert np.allclose(to_linear(from_linear(COLOURS, "as it is"), "as it is"), COLOURS, atol=1e-5)
