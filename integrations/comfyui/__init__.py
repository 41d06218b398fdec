"""A node of ComfyUI: an image and its depth map become an image with the depth of field of another lens.

The work is that of ``spreadlets photo``, in a process of its own: the command, or a Python that has the package; or,
with SPREADLETS_SERVER and SPREADLETS_TOKEN in the environment, a warm one (``spreadlets serve``).
"""

import os
import subprocess
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image


class SpreadletsBlur:
    """Blurs by depth: what is at the focus stays sharp."""

    CATEGORY = "image/postprocessing"
    RETURN_TYPES = ("IMAGE",)
    FUNCTION = "blur"

    @classmethod
    def INPUT_TYPES(cls):  # noqa: N802 (the name is ComfyUI's)
        """Return the inputs, with their ranges."""
        place = {"default": 0.5, "min": 0.0, "max": 1.0, "step": 0.001}
        return {
            "required": {
                "image": ("IMAGE",),
                "depth": ("IMAGE", {"tooltip": "bright is near, as depth models predict it"}),
                "focus_x": ("FLOAT", {**place, "tooltip": "share of the width"}),
                "focus_y": ("FLOAT", {**place, "tooltip": "share of the height"}),
                "blur": ("FLOAT", {"default": 25.0, "min": 0.0, "max": 200.0, "tooltip": "radius at the far end, px"}),
            },
            "optional": {
                "blades": ("INT", {"default": 0, "min": 0, "max": 16, "tooltip": "edges of the aperture; 0 is round"}),
                "options": ("STRING", {"default": "", "tooltip": "more options of spreadlets photo"}),
                "program": (
                    "STRING",
                    {"default": "spreadlets", "tooltip": "the command, or a Python with the package"},
                ),
            },
        }

    def blur(self, image, depth, focus_x, focus_y, blur, blades=0, options="", program="spreadlets"):
        """Return the images of a batch, each blurred by its depth; one depth map serves all."""
        import torch

        images, depths = (np.asarray(batch.cpu(), np.float32) for batch in (image, depth))
        if len(depths) not in (1, len(images)):
            raise ValueError(f"there are {len(depths)} depth maps for {len(images)} images: give one, or one for each")
        height, width = images.shape[1:3]
        if depths.shape[1:3] != (height, width):
            raise ValueError(f"the depth map is {depths.shape[2]} x {depths.shape[1]} px, the image {width} x {height}")
        focus = f"{focus_x * (width - 1):.0f},{focus_y * (height - 1):.0f}"
        given = [
            "--focus",
            focus,
            "--blur",
            str(blur),
            *(["--blades", str(blades)] if blades else []),
            *options.split(),
        ]
        results = [
            _blurred(each, depths[index if len(depths) > 1 else 0], given, program) for index, each in enumerate(images)
        ]
        return (torch.from_numpy(np.stack(results)),)


def _blurred(image, depth, options, program):
    """Blur one image, (H, W, 3) of sRGB in 0 to 1."""
    with tempfile.TemporaryDirectory(prefix="spreadlets-") as name:
        folder = Path(name)
        np.save(folder / "image.npy", _linear(image[..., :3]))
        np.save(folder / "depth.npy", depth[..., :3].mean(axis=-1))
        files = [str(folder / "image.npy"), str(folder / "depth.npy"), "-o", str(folder / "out.png")]
        done = subprocess.run(
            [*_command(program), "photo", *files, *options], capture_output=True, text=True, check=False
        )
        if done.returncode:
            raise RuntimeError((done.stderr.strip() or "spreadlets failed").splitlines()[-1])
        with Image.open(folder / "out.png") as result:
            return np.asarray(result.convert("RGB"), np.float32) / 255.0


def _linear(encoded):
    """Return linear light for sRGB."""
    low = encoded <= 0.04045
    return np.where(low, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4).astype(np.float32)


def _command(program):
    begin = [program, "-m", "spreadlets.cli.main"] if Path(program).name.lower().startswith("python") else [program]
    return [*begin, "send"] if "SPREADLETS_SERVER" in os.environ else begin


NODE_CLASS_MAPPINGS = {"SpreadletsBlur": SpreadletsBlur}
NODE_DISPLAY_NAME_MAPPINGS = {"SpreadletsBlur": "Depth of Field (Spreadlets)"}
