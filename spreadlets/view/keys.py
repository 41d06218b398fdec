"""Focus keys over a sequence: a camera for each of its frames."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from spreadlets.errors import InvalidParameterError
from spreadlets.scene.camera import ThinLens
from spreadlets.view.settings import BOUNDS, checked

MOST_FRAMES = 100_000


def camera_files(camera: ThinLens, keys: Any) -> dict[str, str]:
    """Return the cameras from the first key to the last.

    Parameters
    ----------
    camera : ThinLens
        What all frames have in common.
    keys : list of [frame, focus]
        Numbers of frames, and distances in metres.

    Returns
    -------
    dict of str to str
        Names of files, such as ``camera.0012.json``, and what they hold. Between keys the focus moves evenly in its
        inverse, as the blur of what lies there does.

    Raises
    ------
    InvalidParameterError
        If the keys are no such list.
    """
    places = dict(_key(each) for each in _listed(keys))
    first, last = min(places), max(places)
    if last - first >= MOST_FRAMES:
        raise InvalidParameterError(f"the keys are for frames {first} to {last}: at most {MOST_FRAMES} are written")
    numbers = np.arange(first, last + 1)
    known = sorted(places)
    inverse = np.interp(numbers, known, [1.0 / places[number] for number in known])
    return {
        f"camera.{number:04d}.json": _text(replace(camera, focus_distance_m=float(1.0 / each)))
        for number, each in zip(numbers.tolist(), inverse, strict=True)
    }


def _listed(keys: Any) -> Sequence[Any]:
    if not isinstance(keys, list) or not keys:
        raise InvalidParameterError("there are no focus keys")
    return keys


def _key(key: Any) -> tuple[int, float]:
    if not isinstance(key, list) or len(key) != 2:
        raise InvalidParameterError(f"a key is {key!r}: needed are a frame's number and a focus")
    number = checked("the frame of a key", key[0], 0, 10 * MOST_FRAMES)
    return int(number), checked("the focus of a key", key[1], *BOUNDS["focus"])


def _text(camera: ThinLens) -> str:
    """Return a camera as the JSON that `read_camera` reads."""
    given = asdict(camera)
    values = {
        "focal_length_mm": given["focal_length_mm"],
        "sensor_width_mm": given["sensor_width_mm"],
        "f_number": given["f_number"],
        "focus_distance_m": given["focus_distance_m"],
        "shutter_open_close_frames": list(given["shutter"]),
        "lens_model": given["lens_model"],
        "sensor_fit": given["sensor_fit"],
        "readout_frames": given["readout_frames"],
    }
    if given["sensor_height_mm"] is not None:
        values["sensor_height_mm"] = given["sensor_height_mm"]
    if camera.keys:
        values["keys"] = [{name: value for name, value in key.items() if value is not None} for key in given["keys"]]
    for name in ("camera_to_world", "shutter_curve"):
        if given[name] is not None:
            values[name] = given[name]
    return json.dumps(values, indent=1) + "\n"
