"""What an image file or sample buffer holds, and how it would be read: for people who wonder why a result is wrong."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from spreadlets.arrays import FloatArray, PathLike
from spreadlets.errors import InvalidFileError, InvalidParameterError
from spreadlets.files.conventions import motion_labels, planar_depth
from spreadlets.files.exr_chunks import read_deep_part
from spreadlets.files.exr_frames import deep_header, layer_images
from spreadlets.files.exr_parts import Image, check_same_window, gather, is_deep, read_headers
from spreadlets.files.exr_samples import read_samples
from spreadlets.files.recognise import Found, ReadOptions, depth_warning, find_colour, find_depth, find_motion
from spreadlets.files.tlfr import HEADER_SUFFIX
from spreadlets.scene.samples import SampleBuffer

EXR_MAGIC = b"\x76\x2f\x31\x01"


def is_frame_file(path: PathLike) -> bool:
    """Tell by content whether a path is an OpenEXR file or a TLFR sample buffer."""
    try:
        with open(path, "rb") as file:
            return file.read(4) == EXR_MAGIC or os.path.isfile(os.fspath(path) + HEADER_SUFFIX)
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
    if os.path.isfile(os.fspath(path) + HEADER_SUFFIX):
        return _samples_info(path, [])
    headers = read_headers(path)
    parts = [_part_info(header) for header in headers]
    if all({"lens.u", "lens.v", "time"} <= set(part["channels"]) for part in parts):
        return _samples_info(path, parts)
    deep = any(part["type"] == "deep" for part in parts)
    warnings: list[str] = []
    problems: list[str] = []
    index, images = 0, []
    if deep:
        index, image = deep_header(path, headers)
        images.append(image)
    else:
        images += layer_images(path)
    size = images[0].display
    kind = "deep" if deep else "layers" if len(images) > 1 else "frame"
    report: dict[str, Any] = {"kind": kind, "width": size.width, "height": size.height, "parts": parts}
    if deep:
        counts = read_deep_part(path, index).counts
        report["samples_per_pixel"] = [int(counts.min()), int(counts.max())]
    report["layers"] = [_layer_info(image, options, warnings, problems, deep=deep) for image in images]
    return report | {"warnings": warnings, "problems": problems}


def _part_info(header: Mapping[str, Any]) -> dict[str, Any]:
    (left, top), (right, bottom) = header["dataWindow"]
    return {
        "name": str(header.get("name", "")),
        "type": "deep" if is_deep(header) else "flat",
        "compression": header["compression"].name,
        "data_window": [int(left), int(top), int(right), int(bottom)],
        "display_window": [int(edge) for corner in header["displayWindow"] for edge in corner],
        "pixel_aspect": float(header.get("pixelAspectRatio", 1.0)),
        "channels": sorted(channel.name for channel in header["channels"]),
    }


def _samples_info(path: PathLike, parts: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the ranges of a sample buffer's labels."""
    samples = read_samples(path, repair=True)
    found = {name: _range(values, samples.valid) for name, values in samples.labels.items()}
    height, width = samples.shape
    warnings = _dropped_warning(samples)
    report = {"kind": "samples", "width": width, "height": height, "parts": parts}
    report |= {"samples_per_pixel": [int(f(samples.valid.sum(axis=2))) for f in (np.min, np.max)]}
    return report | {"labels": found, "warnings": warnings, "problems": []}


def _dropped_warning(samples: SampleBuffer) -> list[str]:
    return [f"{samples.dropped_samples} samples are invalid"] if samples.dropped_samples else []


def _layer_info(
    image: Image, options: ReadOptions, warnings: list[str], problems: list[str], *, deep: bool
) -> dict[str, Any]:
    """Return what one layer's channels were taken for; warnings and problems are added to the lists."""
    colour: tuple[str, ...] = ()
    depth: Found | None = None
    motion: Found | None = None
    try:
        colour = find_colour(image, options)
        depth = find_depth(image, colour, options)
    except InvalidFileError as error:
        problems.append(str(error))
    try:
        motion = find_motion(image, options)
    except (InvalidFileError, InvalidParameterError) as error:
        problems.append(str(error))
    warnings += [f"{image.path}: {found.doubt}" for found in (depth, motion) if found is not None and found.doubt]
    report: dict[str, Any] = {
        "colour": {"channels": list(colour), "alpha": len(colour) == 4} if colour else None,
        "depth": {"channel": depth.channels[0], "convention": depth.convention} if depth else None,
        "motion": {"channels": list(motion.channels), "convention": motion.convention} if motion else None,
    }
    try:
        if not deep and colour and depth:
            _add_ranges(report, image, (colour, depth, motion), options, warnings)
    except (InvalidFileError, InvalidParameterError) as error:
        problems.append(str(error))
    return report


def _add_ranges(
    report: dict[str, Any],
    image: Image,
    found: tuple[Sequence[str], Found, Found | None],
    options: ReadOptions,
    warnings: list[str],
) -> None:
    """Add the ranges of visible values, in our units, to a layer's report."""
    colour, depth, motion = found
    check_same_window(image, [*colour, *depth.channels, *(motion.channels if motion else ())])
    colours = gather(image, colour)
    visible = colours[..., 3] > 0 if len(colour) == 4 else np.ones(colours.shape[:2], np.bool_)
    report["colour"] |= _range(colours[..., :3], visible)
    stored = gather(image, depth.channels)[..., 0]
    told = options.depth_convention is not None or options.preset is not None
    alpha = colours[..., 3] if len(colour) == 4 else None
    if warning := depth_warning(os.fspath(image.path), depth, stored, alpha, told):
        warnings.append(warning)
    planar = planar_depth(depth.convention, stored, options.scale)
    report["depth"] |= {f"{name}_m": value for name, value in _range(planar, visible).items()}
    if motion is not None:
        labels = motion_labels(motion.convention, gather(image, motion.channels), planar, options.scale)
        lengths = [np.hypot(path[..., 0], path[..., 1]) for path in labels.values()]
        report["motion"] |= {"longest_px": max(_range(length, visible)["max"] or 0.0 for length in lengths)}
        report["motion"] |= {"curved": "motion_prev" in labels}


def _range(values: FloatArray, places: Any) -> dict[str, Any]:
    """Return the least and largest finite value at some places, and how many are not finite."""
    chosen = values[places]
    finite = chosen[np.isfinite(chosen)]
    ends = (float(finite.min()), float(finite.max())) if finite.size else (None, None)
    return {"min": ends[0], "max": ends[1], "not_finite": int(chosen.size - finite.size)}
