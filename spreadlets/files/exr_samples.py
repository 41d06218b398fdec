"""Sample buffers as files: OpenEXR with one part per sample, and TLFR buffers."""

from __future__ import annotations

import functools
import os
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import OpenEXR

from spreadlets.arrays import BoolArray, FloatArray, PathLike
from spreadlets.errors import InvalidFileError, InvalidFrameError
from spreadlets.files.atomic import atomic_path
from spreadlets.files.attributes import carry_attributes
from spreadlets.files.exr_file import ExrFile, Source, library_messages
from spreadlets.files.exr_parts import (
    Image,
    check_same_window,
    covered,
    gather,
    merged,
    part_header,
    raster_header,
)
from spreadlets.files.kinds import open_file
from spreadlets.files.tlfr import HEADER_SUFFIX, is_tlfr, read_tlfr
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.raster import Window
from spreadlets.scene.samples import SampleBuffer

CHANNELS: Mapping[str, tuple[str, ...]] = {
    "depth": ("Z",),
    "motion": ("motion.x", "motion.y"),
    "lens_uv": ("lens.u", "lens.v"),
    "time": ("time",),
    "offset": ("offset.x", "offset.y"),
    "coc_radius": ("coc",),
    "motion_prev": ("motion_prev.x", "motion_prev.y"),
    "motion_next": ("motion_next.x", "motion_next.y"),
}
"""A part's channels by the label that they hold; colours are R, G, B and, unless all are opaque, A."""

NEEDED = ("R", "G", "B", "Z", "motion.x", "motion.y", "lens.u", "lens.v", "time")
VALID = "valid"
"""Channel that is 0 where a pixel has no such sample; it is there only if some pixel lacks one."""


def read_samples(path: Source, *, camera: ThinLens | None = None, repair: bool = False) -> SampleBuffer:
    """Read a buffer of labelled samples.

    Parameters
    ----------
    path : path
        An OpenEXR file with one part per sample and the channels R, G, B, Z (planar metres), motion.x, motion.y (px
        per frame, y down, forward), lens.u, lens.v, time (frames from the frame's time) and, optionally, A, offset.x,
        offset.y, coc, motion_prev.x/.y, motion_next.x/.y, valid. Or a TLFR buffer, told by its header, see
        `tlfr.read_tlfr`.
    camera : ThinLens, optional
        Only TLFR buffers need it: their times are shares of its shutter.
    repair : bool
        Drop invalid samples instead of raising, see `SampleBuffer`.

    Returns
    -------
    SampleBuffer
        In the file's data window, with its raster; of several windows in one that holds them all, where samples
        outside their own are missing.

    Raises
    ------
    InvalidFileError
        If the file cannot be read, or a part lacks a channel.
    InvalidFrameError
        If the values are invalid.

    Examples
    --------
    >>> import numpy as np
    >>> shape = (4, 6, 2)
    >>> pairs = np.zeros((*shape, 2))
    >>> samples = sp.SampleBuffer(
    ...     np.ones((*shape, 3)), depth=np.ones(shape), motion=pairs, lens_uv=pairs, time=np.zeros(shape)
    ... )
    >>> sp.write_samples("samples.exr", samples)
    >>> sp.read_samples("samples.exr").n_samples
    2
    """
    if isinstance(path, ExrFile):
        return _samples_of(path, repair)
    with open_file(os.fspath(path).removesuffix(HEADER_SUFFIX)) as file:
        if not is_tlfr(file):
            return _samples_of(ExrFile(file), repair)
        try:
            return read_tlfr(file, shutter=None if camera is None else camera.shutter, repair=repair)
        except InvalidFrameError as error:
            raise InvalidFrameError(f"{path}: {error}") from None


def samples_files(path: PathLike) -> list[str]:
    """Return the files that `read_samples` may read for a path."""
    name = os.fspath(path).removesuffix(HEADER_SUFFIX)
    return [os.fspath(path), name, name + HEADER_SUFFIX]


def write_samples(path: PathLike, samples: SampleBuffer) -> None:
    """Write a buffer of samples as OpenEXR so that `read_samples` gives it back; the file appears whole or not at all.

    Parameters
    ----------
    path : path
        Where to write; an existing file is replaced.
    samples : SampleBuffer
        Stored as 32-bit floats, one part per sample, with the windows, pixel aspect and attributes of its raster.

    Raises
    ------
    InvalidFileError
        If the file cannot be written.

    Examples
    --------
    >>> import numpy as np
    >>> shape = (4, 6, 2)
    >>> pairs = np.zeros((*shape, 2))
    >>> samples = sp.SampleBuffer(
    ...     np.ones((*shape, 3)), depth=np.ones(shape), motion=pairs, lens_uv=pairs, time=np.zeros(shape)
    ... )
    >>> sp.write_samples("samples.exr", samples)
    """
    opaque = bool(((samples.radiance[..., 3] == 1) | ~samples.valid).all())
    colours = "RGB" if opaque else "RGBA"
    parts = []
    for index in range(samples.n_samples):
        channels = {name: samples.radiance[:, :, index, axis] for axis, name in enumerate(colours)}
        for label, values in samples.labels.items():
            planes = np.atleast_3d(values[:, :, index])
            channels |= {name: planes[..., axis] for axis, name in enumerate(CHANNELS[label])}
        if not samples.valid.all():
            channels[VALID] = samples.valid[:, :, index].astype(np.float32)
        stored = {name: np.ascontiguousarray(plane) for name, plane in channels.items()}
        header = part_header() | raster_header(samples.raster, samples.raster.data)
        parts.append(OpenEXR.Part({**header, "name": f"sample{index}"}, stored))
    with atomic_path(path, ".exr") as temporary, library_messages():
        OpenEXR.File(parts).write(str(temporary))
        carry_attributes(temporary, [samples.raster.attributes] * samples.n_samples)


def _samples_of(file: ExrFile, repair: bool) -> SampleBuffer:
    """Return the samples of an OpenEXR file, one per part."""
    # Read the parts, and check that each has what a sample needs.
    images = {part.name: merged(file.path, [part]) for part in file.parts}
    for name, image in images.items():
        missing = [channel for channel in NEEDED if channel not in image.planes]
        if missing:
            raise InvalidFileError(
                f"{file.path}: part {name!r} lacks {', '.join(missing)}; every sample needs {', '.join(NEEDED)}. "
                f"Channels found: {', '.join(sorted(image.planes))}"
            )
    # Find the channels that all have.
    first = next(iter(images.values()))
    colours = ("R", "G", "B", "A") if all("A" in image.planes for image in images.values()) else ("R", "G", "B")
    there = [label for label, names in CHANNELS.items() if set(names) <= first.planes.keys()]
    for image in images.values():
        check_same_window(image, [*colours, *(name for label in there for name in CHANNELS[label])])
    # Stack the samples in the smallest window that holds all.
    windows = [image.raster("R").data for image in images.values()]
    raster = replace(first.raster("R"), data=functools.reduce(Window.union, windows))
    labels = {label: _stacked(images, CHANNELS[label], raster.data) for label in there}
    scalars = [label for label in there if len(CHANNELS[label]) == 1]
    labels |= {label: labels[label][..., 0] for label in scalars}
    valid = np.stack([_there(image, raster.data) for image in images.values()], axis=2)
    try:
        return SampleBuffer(_stacked(images, colours, raster.data), valid=valid, raster=raster, repair=repair, **labels)
    except InvalidFrameError as error:
        raise InvalidFrameError(f"{file.path}: {error}") from None


def _stacked(images: Mapping[str, Image], names: tuple[str, ...], target: Window) -> FloatArray:
    """Return channels of all parts in a window, (H, W, S, n)."""
    return np.stack([gather(image, names, target) for image in images.values()], axis=2)


def _there(image: Image, target: Window) -> BoolArray:
    """Return where a part has samples: inside its data window, and where it does not say otherwise."""
    if VALID in image.planes:
        check_same_window(image, ["R", VALID])
        return gather(image, (VALID,), target)[..., 0] > 0
    return covered(image, "R", target)
