"""The files of a frame: images in half floats, labels, samples, and the camera with the times of rendering."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import OpenEXR
from scipy import ndimage

LARGEST_HALF = 65504.0
BLURRED = ("noisy", "ref_dofmb", "ref_lens")
"""How the names of images begin that are what lens and shutter make of the frame."""
FAR_M = 1e9
"""Cycles gives a depth of 1e10 where nothing is."""
HEADER = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}


def half(values: np.ndarray) -> np.ndarray:
    """Return values as half floats, those that are too large as the largest."""
    return np.ascontiguousarray(np.clip(values, -LARGEST_HALF, LARGEST_HALF).astype(np.float16))


def channels(
    colour: np.ndarray,
    depth: np.ndarray | None = None,
    vectors: np.ndarray | None = None,
) -> dict[str, np.ndarray]:
    """Return the channels of an image: R, G, B, and A if the colour has four; Z; Vector.X, Y, Z and W."""
    made = {name: half(colour[..., k]) for k, name in enumerate("RGBA"[: colour.shape[-1]])}
    if depth is not None:
        made["Z"] = np.ascontiguousarray(depth, np.float32)
    if vectors is not None:
        made |= {f"Vector.{name}": half(vectors[..., k]) for k, name in enumerate("XYZW")}
    return made


def motion_at_frame(vectors: np.ndarray, time: float) -> np.ndarray:
    """Return the motion that samples are labelled with: px per frame at the frame's time, y down.

    Parameters
    ----------
    vectors : ndarray of shape (H, W, 4)
        As Cycles gives them at the time of the rendering, from the current place to the previous one, and from the next
        to the current; y up.
    time : float
        Of the rendering, frames from the frame's time. What turns moves another way then.
    """
    before, after = vectors[..., :2] * (-1, 1), vectors[..., 2:] * (-1, 1)
    return 0.5 * (before + after) - time * (after - before)


def write_image(path: Path, of: Mapping[str, np.ndarray]) -> None:
    """Write an image of one part."""
    OpenEXR.File(dict(HEADER), dict(of)).write(str(path))


def write_samples(path: Path, samples: Mapping[str, np.ndarray]) -> None:
    """Write labelled samples, a part for each sample of a pixel.

    Parameters
    ----------
    path : path
    samples : mapping of str to ndarray
        Arrays (H, W, S) by channel; ``Z`` is written in full floats, the rest in half.
    """
    count = samples["Z"].shape[2]
    parts = []
    for s in range(count):
        each = {
            name: np.ascontiguousarray(values[..., s], np.float32) if name == "Z" else half(values[..., s])
            for name, values in samples.items()
        }
        parts.append(OpenEXR.Part({**HEADER, "name": f"sample{s}"}, each))
    OpenEXR.File(parts).write(str(path))


def filled(values: np.ndarray, there: np.ndarray) -> np.ndarray:
    """Return an array with the nearest value where there is none; as it is if there is none at all."""
    if not there.any():
        return values
    nearest = ndimage.distance_transform_edt(~there, return_distances=False, return_indices=True)
    return values[tuple(nearest)]


def write_camera(
    path: Path, description: Mapping[str, object], of: str, samples: int, found: Mapping[str, float]
) -> None:
    """Write a camera, and what is known of one image beside what is known of others.

    Parameters
    ----------
    path : path
        If there is such a camera of the same width, what it tells of other images stays.
    description : mapping
        See `Shot.description`.
    of : str
        Ending of the image's file.
    samples : int
        In each pixel.
    found : mapping
        Figures, such as ``render_time_s``. Those of plain renderings with lens and shutter are repeated by their number
        of samples alone, as ``spreadlets bench`` reads them.
    """
    before = json.loads(path.read_text()) if path.exists() else {}
    images = before.get("render", {}) if before.get("width") == description["width"] else {}
    images[of] = {**images.get(of, {}), str(samples): dict(found)}
    times = {
        count: each["render_time_s"]
        for name, counts in images.items()
        if name.startswith(BLURRED)
        for count, each in counts.items()
    }
    path.write_text(json.dumps({**description, "render_time_s": times, "render": images}, indent=1) + "\n")
