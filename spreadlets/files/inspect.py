"""What an image file or sample buffer holds, and how it would be read: for people who wonder why a result is wrong."""

from __future__ import annotations

import warnings as _warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import fields, replace
from functools import partial
from typing import Any

import numpy as np

from spreadlets.arrays import FloatArray, PathLike
from spreadlets.errors import SpreadletsError
from spreadlets.files.exr_chunks import read_deep_part
from spreadlets.files.exr_frames import deep_header, flat_layers, read_frame, read_passes, recognise_deep
from spreadlets.files.exr_parts import EXR_MAGIC, Image, is_deep, read_headers
from spreadlets.files.exr_samples import read_samples
from spreadlets.files.recognise import ReadOptions, Recognised, recognise
from spreadlets.files.tlfr import is_tlfr
from spreadlets.scene.doubts import frame_doubts
from spreadlets.scene.frame import Frame
from spreadlets.scene.samples import SampleBuffer


def is_frame_file(path: PathLike) -> bool:
    """Tell by content whether a path is an OpenEXR file or a TLFR sample buffer."""
    try:
        with open(path, "rb") as file:
            return file.read(len(EXR_MAGIC)) == EXR_MAGIC or is_tlfr(path)
    except OSError:
        return False


def frame_info(path: PathLike, options: ReadOptions | None = None) -> dict[str, Any]:
    """Return what a file holds and what was recognised.

    Parameters
    ----------
    path : path
        An OpenEXR file, flat or deep, of a frame or of samples, or a TLFR buffer.
    options : ReadOptions, optional
        What the caller would tell `read_frame`.

    Returns
    -------
    dict
        ``kind`` (frame, layers, deep or samples), ``width``, ``height``, ``parts``; for frames a list ``layers`` of
        what was recognised as ``colour``, ``depth`` and ``motion``, with conventions and ranges of values (metres and
        px per frame); ``warnings`` that reading gives and ``problems`` that it stops at.

    Raises
    ------
    InvalidFileError
        If the file cannot be read at all.
    """
    options = options or ReadOptions()
    if is_tlfr(path):
        return _samples_info(path, [])
    headers = read_headers(path)
    parts = [_part_info(header) for header in headers]
    if all({"lens.u", "lens.v", "time"} <= set(part["channels"]) for part in parts):
        return _samples_info(path, parts)
    warnings, problems, frame = _tried(path, options)
    layers: list[tuple[Recognised | None, Image]] = []
    report: dict[str, Any] = {}
    if any(part["type"] == "deep" for part in parts):
        index, image = deep_header(path, headers, options)
        layers.append((_recognised(partial(recognise_deep, image, options)), image))
        counts = read_deep_part(path, index).counts
        report["samples_per_pixel"] = [int(counts.min()), int(counts.max())]
        kind = "deep"
    else:
        passes = read_passes(options)
        for image, settings in flat_layers(path, options):
            layers.append((_recognised(partial(recognise, image, settings, passes)), image))
        kind = "layers" if len(layers) > 1 else "frame"
    height, width = layers[0][1].shape
    report = {"kind": kind, "width": width, "height": height, "parts": parts} | report
    if layers[0][1].views:
        report["views"] = list(layers[0][1].views)
    report["layers"] = [
        _layer_info(found) | (_ranges(found, frame, index, kind) if found else {})
        for index, (found, _) in enumerate(layers)
    ]
    if options.camera is not None:
        fitted = options.camera.fitted((height, width))
        report["camera"] = {field.name: getattr(fitted, field.name) for field in fields(fitted)}
        if frame is not None:
            warnings += frame_doubts(frame, options.camera)
    return report | {"warnings": warnings, "problems": problems}


def _tried(path: PathLike, options: ReadOptions) -> tuple[list[str], list[str], Frame | None]:
    """Return the warnings and the problem that reading gives, and the frame; of a bad one, that mended."""
    with _warnings.catch_warnings(record=True) as caught:
        _warnings.simplefilter("always")
        problems: list[str] = []
        frame: Frame | None = None
        try:
            frame = read_frame(path, options=options)
        except SpreadletsError as error:
            problems.append(str(error))
    said = list(dict.fromkeys(str(warning.message) for warning in caught))
    if problems and not options.repair:
        with _warnings.catch_warnings(action="ignore"), suppress(SpreadletsError):
            frame = read_frame(path, options=replace(options, repair=True))
    if frame is not None and not problems and frame.repaired_pixels + frame.dropped_pixels:
        said.append(f"{frame.repaired_pixels} invalid pixels are mended, {frame.dropped_pixels} are dropped")
    return said, problems, frame


def _recognised(find: Callable[[], Recognised]) -> Recognised | None:
    """Return what was recognised, or None: the problem is told by reading."""
    try:
        return find()
    except SpreadletsError:
        return None


def _part_info(header: Mapping[str, Any]) -> dict[str, Any]:
    (left, top), (right, bottom) = header["dataWindow"]
    return {
        "name": str(header.get("name", "")),
        "type": "deep" if is_deep(header) else "flat",
        "compression": header["compression"].name,
        "data_window": [int(left), int(top), int(right), int(bottom)],
        "channels": sorted(channel.name for channel in header["channels"]),
    }


def _samples_info(path: PathLike, parts: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the ranges of a sample buffer's labels."""
    samples = read_samples(path, repair=True)
    found = {name: _range(values[samples.valid]) for name, values in samples.labels.items()}
    height, width = samples.shape
    warnings = _dropped_warning(samples)
    report = {"kind": "samples", "width": width, "height": height, "parts": parts}
    report |= {"samples_per_pixel": [int(f(samples.valid.sum(axis=2))) for f in (np.min, np.max)]}
    return report | {"labels": found, "warnings": warnings, "problems": []}


def _dropped_warning(samples: SampleBuffer) -> list[str]:
    return [f"{samples.dropped_samples} samples are invalid"] if samples.dropped_samples else []


def _layer_info(found: Recognised | None) -> dict[str, Any]:
    """Return what one layer's channels were taken for."""
    if found is None:
        return {"colour": None, "depth": None, "motion": None}
    colour, depth, motion = found.colour, found.depth, found.motion
    return {
        "colour": {"channels": list(colour.names), "alpha": bool(colour.alpha)},
        "depth": {"channel": depth.channels[0], "convention": depth.convention},
        "motion": {"channels": list(motion.channels), "convention": motion.convention} if motion else None,
    }


def _ranges(found: Recognised, frame: Frame | None, index: int, kind: str) -> dict[str, Any]:
    """Return what one layer's channels were taken for, with the ranges of its visible values in our units."""
    report = _layer_info(found)
    if frame is None or (kind != "deep" and index >= len(frame.layers)):
        return report
    chosen = frame.layers if kind == "deep" else [frame.layers[index]]
    visible = [layer.radiance[..., 3] > 0 for layer in chosen]

    def joined(arrays: Sequence[FloatArray]) -> FloatArray:
        return np.concatenate([array[seen] for array, seen in zip(arrays, visible, strict=True)])

    depth = joined([layer.depth for layer in chosen])
    report["colour"] |= _range(joined([layer.radiance[..., :3] for layer in chosen]))
    report["depth"] |= {f"{name}_m": value for name, value in _range(depth).items() if name != "not_finite"}
    report["depth"] |= {"background": int(np.count_nonzero(np.isinf(depth)))}
    if found.motion is not None:
        paths = [
            [path for path in (layer.motion, layer.motion_prev, layer.motion_next) if path is not None]
            for layer in chosen
        ]
        lengths = [np.max([np.hypot(path[..., 0], path[..., 1]) for path in each], axis=0) for each in paths]
        report["motion"] |= {"longest_px": _range(joined(lengths))["max"] or 0.0}
        report["motion"] |= {"curved": any(layer.motion_prev is not None for layer in chosen)}
    return report


def _range(chosen: FloatArray) -> dict[str, Any]:
    """Return the least and largest finite value, and how many are not finite."""
    finite = chosen[np.isfinite(chosen)]
    ends = (float(finite.min()), float(finite.max())) if finite.size else (None, None)
    return {"min": ends[0], "max": ends[1], "not_finite": int(chosen.size - finite.size)}
