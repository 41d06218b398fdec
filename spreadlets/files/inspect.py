"""What an image file or sample buffer holds, and how it would be read: for people who wonder why a result is wrong."""

from __future__ import annotations

import warnings as _warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from spreadlets.arrays import BoolArray, FloatArray, PathLike
from spreadlets.errors import SpreadletsError
from spreadlets.files.conventions import background_places, channels_depth
from spreadlets.files.exr_file import ExrFile, Source, is_deep
from spreadlets.files.exr_frames import deep_header, flat_layers, frame_of, read_passes
from spreadlets.files.exr_parts import Image, gather
from spreadlets.files.exr_samples import read_samples
from spreadlets.files.kinds import OPENEXR, file_kind, open_file
from spreadlets.files.recognise import (
    Colour,
    Found,
    Passes,
    ReadOptions,
    find_colour,
    find_depth,
    find_motion,
    recognise,
)
from spreadlets.files.tlfr import is_tlfr
from spreadlets.scene.doubts import frame_doubts
from spreadlets.scene.frame import BACKGROUND_DEPTH, Frame, Layer
from spreadlets.scene.samples import SampleBuffer


def is_frame_file(path: PathLike) -> bool:
    """Tell by content whether a path is an OpenEXR file or a TLFR sample buffer."""
    return file_kind(path) == OPENEXR or is_tlfr(path)


def frame_info(path: Source, options: ReadOptions | None = None) -> dict[str, Any]:
    """Return what a file holds and what was recognised.

    Parameters
    ----------
    path : path or ExrFile
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
    # Buffers of samples have their own report.
    options = options or ReadOptions()
    if isinstance(path, ExrFile):
        return _exr_info(path, options)
    with open_file(path) as file:
        return _samples_info(path, []) if is_tlfr(file) else _exr_info(ExrFile(file), options)


def _exr_info(file: ExrFile, options: ReadOptions) -> dict[str, Any]:
    """Return what an OpenEXR file holds and what was recognised."""
    # Buffers of samples have their own report.
    parts = [_part_info(header) for header in file.headers]
    if all({"lens.u", "lens.v", "time"} <= set(part["channels"]) for part in parts):
        return _samples_info(file, parts)
    # Try to read the frame.
    passes = read_passes(options)
    said, problems, frame = _tried(file, passes, options)
    report: dict[str, Any] = {}
    # Find what each layer is recognised as.
    if file.is_deep:
        index, image = deep_header(file, options)
        layers = [_pieces(image, options, Passes())]
        counts = file.deep_part(index).counts
        report["samples_per_pixel"] = [int(counts.min()), int(counts.max())]
    else:
        layers = [_pieces(image, settings, passes) for image, settings in flat_layers(file, options)]
    # Describe the frame and its layers.
    kind = "deep" if file.is_deep else "layers" if len(layers) > 1 else "frame"
    height, width = layers[0].image.shape
    report = {"kind": kind, "width": width, "height": height, "parts": parts} | report
    if layers[0].image.views:
        report["views"] = list(layers[0].image.views)
    shown = [] if frame is None else [frame.layers] if file.is_deep else [[layer] for layer in frame.layers]
    report["layers"] = [
        _layer_info(piece) | (_ranges(piece, shown[index], options) if index < len(shown) else {})
        for index, piece in enumerate(layers)
    ]
    # Collect problems and doubts.
    problems = list(dict.fromkeys([*(text for piece in layers for text in piece.problems), *problems]))
    warnings = list(dict.fromkeys([*said, *(text for piece in layers for text in piece.doubts)]))
    # Fit the camera.
    if options.camera is not None:
        parts_read = layers[0].image.parts
        aspect = parts_read[0].pixel_aspect if parts_read else 1.0
        fitted = options.camera.fitted((height, width), aspect)
        report["camera"] = {field.name: getattr(fitted, field.name) for field in fields(fitted)}
        if frame is not None:
            warnings += frame_doubts(frame, options.camera)
    return report | {"warnings": warnings, "problems": problems}


def _tried(file: ExrFile, passes: Passes, options: ReadOptions) -> tuple[list[str], list[str], Frame | None]:
    """Return the warnings and the problem that reading gives, and the frame; of a bad one, that mended."""
    with _warnings.catch_warnings(record=True) as caught:
        _warnings.simplefilter("always")
        problems: list[str] = []
        frame: Frame | None = None
        try:
            frame = frame_of([file], passes, options)
        except SpreadletsError as error:
            problems.append(str(error))
    said = list(dict.fromkeys(str(warning.message) for warning in caught))
    if problems and not options.repair:
        with _warnings.catch_warnings(action="ignore"), suppress(SpreadletsError):
            frame = frame_of([file], passes, replace(options, repair=True))
    if frame is not None and not problems and frame.repaired_pixels + frame.dropped_pixels:
        said.append(f"{frame.repaired_pixels} invalid pixels are mended, {frame.dropped_pixels} are dropped")
    return said, problems, frame


@dataclass(frozen=True)
class _Pieces:
    """What was recognised of a layer, as far as it was."""

    image: Image
    colour: Colour | None
    depth: Found | None
    motion: Found | None
    doubts: tuple[str, ...]
    problems: tuple[str, ...]


def _pieces(image: Image, options: ReadOptions, passes: Passes) -> _Pieces:
    """Return what can be recognised, though something else may be missing."""
    problems: list[str] = []

    def attempt(find: Callable[[], Any]) -> Any:
        try:
            return find()
        except SpreadletsError as error:
            problems.append(str(error))
            return None

    # If the whole is recognised, that is all.
    whole = attempt(lambda: recognise(image, options, passes))
    if whole is not None:
        doubts = tuple(f"{image.path}: {doubt}" for doubt in whole.doubts)
        return _Pieces(whole.colour.image, whole.colour, whole.depth, whole.motion, doubts, ())
    problems.clear()
    # Else look for each piece by itself.
    view = attempt(lambda: image.of_view(options.view)) or image
    colour = attempt(lambda: find_colour(view, options, passes.alpha))
    depth = motion = None
    if colour is not None:
        depth = attempt(lambda: find_depth(passes.depth or view, colour, options, alone=passes.depth is not None))
        motion = attempt(
            lambda: find_motion(passes.motion or view, colour, options, depth, alone=passes.motion is not None)
        )
    doubts = tuple(f"{image.path}: {found.doubt}" for found in (depth, motion) if found is not None and found.doubt)
    return _Pieces(view, colour, depth, motion, doubts, tuple(problems))


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


def _samples_info(path: Source, parts: list[dict[str, Any]]) -> dict[str, Any]:
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


def _layer_info(found: _Pieces) -> dict[str, Any]:
    """Return what one layer's channels were taken for."""
    colour, depth, motion = found.colour, found.depth, found.motion
    return {
        "colour": {"channels": list(colour.names), "alpha": bool(colour.alpha)} if colour else None,
        "depth": {"channel": depth.channels[0], "convention": depth.convention} if depth else None,
        "motion": {"channels": list(motion.channels), "convention": motion.convention} if motion else None,
    }


def _ranges(found: _Pieces, chosen: Sequence[Layer], options: ReadOptions) -> dict[str, Any]:
    """Return what one layer's channels were taken for, with the ranges of its visible values in our units."""
    report = _layer_info(found)
    visible = [layer.radiance[..., 3] > 0 for layer in chosen]

    def joined(arrays: Sequence[FloatArray]) -> FloatArray:
        return np.concatenate([array[seen] for array, seen in zip(arrays, visible, strict=True)])

    # Colour, and depth in metres.
    depth = joined([layer.depth for layer in chosen])
    report["colour"] |= _range(joined([layer.radiance[..., :3] for layer in chosen]))
    report["depth"] |= {f"{name}_m": value for name, value in _range(depth).items() if name != "not_finite"}
    report["depth"] |= {"background": int(np.count_nonzero(np.isinf(depth)))}
    if found.depth is not None and found.depth.image.planes[found.depth.channels[0]].pixels.size:
        report["depth"] |= _bad_depths(found.depth, visible[0], options)
    if any(layer.depth_prev is not None for layer in chosen):
        report["depth"] |= {"moves": True}
    # Motion, in px per frame.
    if found.motion is not None:
        lengths = [np.max([np.hypot(each[..., 0], each[..., 1]) for each in layer.motions], axis=0) for layer in chosen]
        report["motion"] |= {"longest_px": _range(joined(lengths))["max"] or 0.0}
        report["motion"] |= {"curved": any(layer.motion_prev is not None for layer in chosen)}
    return report


def _bad_depths(found: Found, visible: BoolArray, options: ReadOptions) -> dict[str, int]:
    """Return how many visible pixels of a flat layer have no valid depth, and are counted as background if mended."""
    channels = gather(found.image, found.channels)
    stored, planar = channels[..., 0], channels_depth(found.convention, channels, options.scale)
    if options.background_depth is not None:
        planar = np.where(background_places(options.background_depth, stored), BACKGROUND_DEPTH, planar)
    bad = {"not_a_number": np.isnan(planar), "not_positive": planar <= 0}
    counts = {name: int(np.count_nonzero(places & visible)) for name, places in bad.items()}
    background = int(np.count_nonzero(visible & np.isposinf(planar)))
    return {"background": background} | {name: count for name, count in counts.items() if count}


def _range(chosen: FloatArray) -> dict[str, Any]:
    """Return the least and largest finite value, and how many are not finite."""
    finite = chosen[np.isfinite(chosen)]
    ends = (float(finite.min()), float(finite.max())) if finite.size else (None, None)
    return {"min": ends[0], "max": ends[1], "not_finite": int(chosen.size - finite.size)}
