"""Channels beside the main image: further colour layers, which are blurred as it is, and all that is only copied."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import FloatArray
from spreadlets.errors import InvalidFileError
from spreadlets.files.exr_file import Source, opened
from spreadlets.files.exr_parts import Image, check_same_window, gather
from spreadlets.files.recognise import ReadOptions, find_colour
from spreadlets.scene.frame import Frame
from spreadlets.scene.raster import Raster, placed

MAIN = ("R", "G", "B", "A")


def with_colours(
    paths: Sequence[Source], frame: Frame, names: Sequence[str], view: str | None = None
) -> Iterator[tuple[str, Frame]]:
    """Yield a frame with the colours of each named layer of its file, and its own alpha and labels.

    Parameters
    ----------
    paths : sequence of path or ExrFile
        The file of the frame.
    frame : Frame
        As it was read from there.
    names : sequence of str
        Prefixes of the colour channels.
    view : str, optional
        As the frame was read.

    Raises
    ------
    InvalidFileError
        If there is no such layer, or the frame is none of one flat file.
    """
    if not names:
        return
    image = _only_image(paths, view)
    for name in names:
        colour = find_colour(image, ReadOptions(colour_layer=name)).channels
        check_same_window(image, colour)
        values = gather(image, colour, frame.raster.data)
        yield name, frame.coloured(np.concatenate([values, frame.radiance[..., 3:]], axis=2))


def named_channels(name: str, blurred: FloatArray) -> dict[str, FloatArray]:
    """Return the colours of a blurred layer (H, W, 4) by their names in the file."""
    return {f"{name}.{letter}": blurred[..., index] for index, letter in enumerate(MAIN[:3])}


def other_channels(
    paths: Sequence[Source], raster: Raster, colour_layer: str | Sequence[str] | None = None, view: str | None = None
) -> dict[str, npt.NDArray[Any]]:
    """Return all channels of a frame's file but its colours, as they are stored.

    Parameters
    ----------
    paths : sequence of path or ExrFile
        The file of the frame.
    raster : Raster
        Where the frame's pixels lie; channels are 0 where they have none.
    colour_layer, view : optional
        As the frame was read.

    Raises
    ------
    InvalidFileError
        If the frame is none of one flat file, or a channel is subsampled.
    """
    image = _only_image(paths, view)
    left_out = {*find_colour(image, ReadOptions(colour_layer=colour_layer)).names, *MAIN}
    others: Mapping[str, Any] = {name: plane for name, plane in image.planes.items() if name not in left_out}
    for name in others:
        check_same_window(image, [name])
    return {name: placed(plane.pixels, plane.window, raster.data) for name, plane in others.items()}


def _only_image(paths: Sequence[Source], view: str | None) -> Image:
    """Return all channels of the file, if there is one and it is flat."""
    with opened(paths) as files:
        if len(files) > 1 or files[0].is_deep:
            raise InvalidFileError(f"{files[0].path}: further channels are taken from one flat file, not from layers")
        return files[0].image.of_view(view)
