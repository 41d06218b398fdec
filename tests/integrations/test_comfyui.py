"""The node of ComfyUI, without ComfyUI: tensors are arrays that can be asked for the processor's copy."""

import importlib.util
import sys
from pathlib import Path
from types import SimpleNamespace

import numba
import numpy as np
import pytest

FOLDER = Path(__file__).resolve().parents[2] / "integrations" / "comfyui"
pytestmark = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="makes pictures in a process of its own")


class Tensor(np.ndarray):
    def cpu(self):
        return self


@pytest.fixture
def node(monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", SimpleNamespace(from_numpy=lambda array: array.view(Tensor)))
    monkeypatch.delenv("SPREADLETS_SERVER", raising=False)
    spec = importlib.util.spec_from_file_location("comfyui_spreadlets", FOLDER / "__init__.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.NODE_CLASS_MAPPINGS["SpreadletsBlur"]()


@pytest.fixture
def picture():
    """A checkerboard, near in its left half and far in its right."""
    rows, columns = np.indices((48, 64))
    image = np.float32(0.2) + np.float32(0.6) * np.repeat(((rows // 4 + columns // 4) % 2)[None, ..., None], 3, axis=-1)
    depth = np.repeat(np.where(columns < 32, 1.0, 0.0)[None, ..., None], 3, axis=-1).astype(np.float32)
    return image.view(Tensor), depth.view(Tensor)


def test_what_is_at_the_focus_stays_sharp_and_the_rest_is_blurred(node, picture):
    image, depth = picture
    (blurred,) = node.blur(image, depth, 0.1, 0.5, 6.0, program=sys.executable)
    assert blurred.shape == image.shape and blurred.dtype == np.float32
    assert np.abs(blurred - image)[0, 8:-8, 4:20].mean() < 0.05 < 0.15 < np.abs(blurred - image)[0, 8:-8, 44:-4].mean()


def test_errors_are_one_line(node, picture):
    image, depth = picture
    with pytest.raises(RuntimeError, match="^error: "):
        node.blur(image, depth, 0.1, 0.5, 6.0, options="--no-such-option", program=sys.executable)
    with pytest.raises(ValueError, match="the depth map is 32 x 48 px, the image 64 x 48"):
        node.blur(image, depth[:, :, :32], 0.1, 0.5, 6.0)
    with pytest.raises(ValueError, match="2 depth maps for 1 images"):
        node.blur(image, np.concatenate([depth, depth]).view(Tensor), 0.1, 0.5, 6.0)


def test_each_input_is_a_parameter(node):
    import inspect

    inputs = node.INPUT_TYPES()
    assert [*inputs["required"], *inputs["optional"]] == [*inspect.signature(node.blur).parameters]
