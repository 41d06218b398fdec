import numpy as np
import pytest

from spreadlets import SampleBuffer, reconstruct
from spreadlets.errors import InvalidParameterError
from spreadlets.runtime.finish import denoise
from spreadlets.runtime.finish.denoise import DENOISING, denoise_sharp
from spreadlets.scene.camera import ThinLens

CAMERA = ThinLens(focal_length_mm=50, sensor_width_mm=36, f_number=0.08, focus_distance_m=2.0)


@pytest.fixture
def blackened(monkeypatch):
    """A denoiser that leaves nothing, to see where it acts."""
    monkeypatch.setitem(denoise.DENOISING, "oidn", np.zeros_like)


def test_only_what_is_sharp_is_denoised(blackened):
    image = np.ones((20, 40, 4), np.float32)
    sharp = np.where(np.arange(40) < 20, 1.0, 0.0) * np.ones((20, 1))
    found = denoise_sharp(image, sharp.astype(np.float32), "oidn")
    assert not found[:, :18, :3].any() and (found[:, 20:] == 1).all() and (found[..., 3] == 1).all()
    assert (np.diff(found[..., 0], axis=1) >= 0).all()


def test_samples_in_focus_are_denoised_and_others_not(blackened, small_combined):
    depth = np.where(np.arange(40) < 20, 2.0, 3.0)[None, :, None] * np.ones((24, 1, 2))
    zero = np.zeros((24, 40, 2, 2))
    samples = SampleBuffer(np.full((24, 40, 2, 3), 0.5), depth, zero, zero, np.zeros((24, 40, 2)))
    plain = reconstruct(samples, CAMERA, small_combined)
    found = reconstruct(samples, CAMERA, small_combined, denoise="oidn")
    assert not found[:, :17, :3].any()
    np.testing.assert_array_equal(found[:, 22:], plain[:, 22:])


@pytest.mark.parametrize("method, name", [("spreadlets", "median"), ("mean", "oidn")])
def test_what_cannot_be_denoised_is_refused(small_combined, method, name):
    zero = np.zeros((8, 8, 1, 2))
    samples = SampleBuffer(np.ones((8, 8, 1, 3)), np.full((8, 8, 1), 2.0), zero, zero, np.zeros((8, 8, 1)))
    with pytest.raises(InvalidParameterError, match="denoise is"):
        reconstruct(samples, CAMERA, small_combined, method=method, denoise=name)


@pytest.mark.parametrize("hue", [(1.0, 1.0, 1.0), (1.0, 0.0, 0.0), (1.0, 0.5, 0.0)])
def test_bm3d_takes_images_of_one_hue_and_of_one_colour(hue):
    pytest.importorskip("bm3d")
    noise = np.random.default_rng(4).random((24, 32, 1)).astype(np.float32)
    noisy = np.float32(0.5) * noise * np.float32(hue)
    found = DENOISING["bm3d"](noisy)
    assert np.isfinite(found).all() and found.min() >= 0 and found.std() < noisy.std()
    even = np.full((24, 32, 3), hue, np.float32)
    np.testing.assert_allclose(DENOISING["bm3d"](even), even, atol=1e-6)


def test_bm3d_refuses_images_smaller_than_its_blocks():
    pytest.importorskip("bm3d")
    with pytest.raises(InvalidParameterError, match="'bm3d' is for 8 x 8 px and more: the image has 40 x 7"):
        DENOISING["bm3d"](np.ones((7, 40, 3), np.float32))
