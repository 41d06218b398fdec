"""Frames as OpenEXR, and the colours of an image.

What the channels mean is told by the tables of `spreadlets.files.conventions`.
"""

from __future__ import annotations

import functools
import os
import re
import warnings
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Unpack

import numpy as np
import numpy.typing as npt
import OpenEXR

from spreadlets.arrays import FloatArray, PathLike
from spreadlets.errors import AmbiguousInputWarning, InvalidFileError, InvalidFrameError, InvalidParameterError, option
from spreadlets.files.atomic import atomic_path
from spreadlets.files.attributes import carry_attributes
from spreadlets.files.conventions import (
    MOTION_CONVENTIONS,
    OWN,
    POSITION,
    PRESETS,
    Preset,
    Scale,
    background_places,
    channels_depth,
    check_choice,
    motion_labels,
    planar_depth,
    planar_samples,
    stored_depth,
    stored_motion,
)
from spreadlets.files.deep import DeepImage, deep_image
from spreadlets.files.exr_chunks import DeepPart
from spreadlets.files.exr_file import ExrFile, Source, is_deep, library_messages, opened
from spreadlets.files.exr_parts import (
    Image,
    Part,
    Plane,
    check_same_window,
    covered,
    gather,
    merged,
    part_header,
    raster_header,
    window,
)
from spreadlets.files.luminance import with_rgb
from spreadlets.files.recognise import (
    AROUND,
    Colour,
    Found,
    Passes,
    ReadKeywords,
    ReadOptions,
    Recognised,
    depth_warning,
    find_colour,
    recognise,
)
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.doubts import layer_doubts
from spreadlets.scene.frame import BACKGROUND_DEPTH, Frame, Layer
from spreadlets.scene.raster import Raster, Window

COUNTER = re.compile(r"\d+")
"""A number in a file's name."""


def read_frame(
    paths: Source | Sequence[Source], *, options: ReadOptions | None = None, **keywords: Unpack[ReadKeywords]
) -> Frame:
    """Read a frame of labelled pixels from OpenEXR files.

    Parameters
    ----------
    paths : path or sequence of paths
        One file is a whole frame, or depth layers if each of its parts holds R, G, B, A and Z, or a deep image, whose
        samples become layers. Several flat files are depth layers, nearest first, premultiplied by alpha; several deep
        files are one scene, merged sample by sample.
    options : ReadOptions, optional
        What is known about the files.
    **keywords
        Fields of `ReadOptions`, in addition: ``depth_channel="depth.R"``.

    Returns
    -------
    Frame
        In the file's data window. A frame that is not opaque reaches as far as the display window, too: its blur goes
        on where it has no pixels. Without motion channels the frame is still.

    Raises
    ------
    InvalidFileError
        If a file cannot be read, or a channel is missing, ambiguous, or does not cover the image.
    InvalidFrameError
        If the values are invalid, or the layers' shapes differ.
    InvalidParameterError
        If a name is unknown, a convention takes another number of channels than are named, or needs something that is
        not given.

    Warns
    -----
    AmbiguousInputWarning
        If a convention had to be assumed, channels that look like motion or alpha are not used, or the order of the
        layers is doubtful.

    Examples
    --------
    >>> import numpy as np
    >>> frame = sp.Frame(np.ones((4, 6, 3)), depth=np.full((4, 6), 2.0), motion=np.ones((4, 6, 2)))
    >>> sp.write_frame("frame.exr", frame)
    >>> sp.read_frame("frame.exr").motion[0, 0].tolist()
    [1.0, 1.0]
    >>> import warnings
    >>> with warnings.catch_warnings(action="ignore"):  # the front layer hides the other
    ...     sp.read_frame(["frame.exr", "frame.exr"])  # two files are two depth layers
    Frame(4 x 6 px, 2 layers)
    """
    # Read the headers, and passes of their own.
    chosen = ReadOptions.of(options, **keywords)
    with opened(paths) as files:
        return frame_of(files, read_passes(chosen), chosen)


def frame_of(files: Sequence[ExrFile], passes: Passes, options: ReadOptions) -> Frame:
    """Return the frame of files and passes that are open already, as `read_frame` does."""
    if files and all(file.is_deep for file in files):
        return _with_room(_merged_deep(files, options))
    layers: list[Frame] = []
    for file in files:
        if file.is_deep:
            layers.append(_merged_deep([file], options))
        else:
            layers += [_read_layer(image, settings, passes) for image, settings in flat_layers(file, options)]
    if len(layers) > 1 and passes != Passes():
        raise InvalidParameterError(
            f"{option('depth_file')}, {option('motion_file')} and {option('alpha_file')} are for frames of one layer"
        )
    frame = layers[0] if len(layers) == 1 else Frame.from_layers(layers)
    for doubt in (*_sequence_doubts([file.path for file in files]), *layer_doubts(frame)):
        warnings.warn(doubt, AmbiguousInputWarning, stacklevel=3)
    return _with_room(frame)


def read_image(path: Source, *, options: ReadOptions | None = None, **keywords: Unpack[ReadKeywords]) -> FloatArray:
    """Read the colours of an OpenEXR file.

    Parameters
    ----------
    path : path
        The file.
    options, **keywords
        As for `read_frame`; of use here are ``view``, ``colour_layer``, ``alpha_channel`` and ``unpremultiplied``.

    Returns
    -------
    ndarray of shape (H, W, 3) or (H, W, 4), float32
        Linear values in the display window; with alpha if the file has it, or does not fill the window.

    Raises
    ------
    InvalidFileError
        If the file cannot be read, or its colour channels are missing, ambiguous, or do not cover the image.

    Examples
    --------
    >>> import numpy as np
    >>> sp.write_image("image.exr", np.ones((4, 6, 3)))
    >>> sp.read_image("image.exr").shape
    (4, 6, 3)
    """
    chosen = ReadOptions.of(options, **keywords)
    with opened(path) as (file,):
        image = with_rgb(file.image)
    view, layer = chosen.view, chosen.colour_layer
    if view is None and isinstance(layer, str) and layer in image.views:
        view, chosen = layer, replace(chosen, colour_layer=None)
    return _radiance(find_colour(image.of_view(view), chosen), chosen.unpremultiplied)


def read_reference(path: PathLike, options: ReadOptions) -> FloatArray:
    """Return the colours of an image that another is compared with, read as that one where it has the same names.

    Parameters
    ----------
    path : path
        The file.
    options : ReadOptions
        How the other image, or the frame that it is made from, is read.

    Returns
    -------
    ndarray of shape (H, W, 3) or (H, W, 4), float32

    Raises
    ------
    InvalidFileError
        As for `read_image`.
    """
    plain = ReadOptions(unpremultiplied=options.unpremultiplied)
    attempts = [replace(plain, view=options.view, colour_layer=layer) for layer in options.colour_layers if layer]
    attempts += [replace(plain, view=options.view)] if options.view else []
    with opened(path) as (file,):
        for attempt in attempts:
            with suppress(InvalidFileError):
                return read_image(file, options=attempt)
        return read_image(file, options=plain)


def write_frame(
    path: PathLike,
    frame: Frame,
    *,
    preset: str | None = None,
    unpremultiplied: bool = False,
    camera: ThinLens | None = None,
    depth_scale: float = 1.0,
    baseline_m: float | None = None,
    max_displacement: float | None = None,
) -> None:
    """Write a frame as OpenEXR so that `read_frame` gives it back; the file appears whole or not at all.

    Parameters
    ----------
    path : path
        Where to write; an existing file is replaced.
    frame : Frame
        Stored as 32-bit floats R, G, B, A, Z, and motion.x, motion.y (px per frame, y down, forward) where the frame
        has motion, with motion_prev and motion_next for a curved path, and depth_prev and depth_next where it moves in
        depth; several layers as parts layer0, layer1, ... With the windows, pixel aspect and attributes of its raster.
    preset : str, optional
        Store one layer as this renderer does, a key of `conventions.PRESETS`, with the first depth and motion
        convention of its row.
    unpremultiplied : bool
        Divide the colours by alpha; empty pixels become black.
    camera, depth_scale, baseline_m, max_displacement
        As for `read_frame`, where the preset's conventions need them.

    Raises
    ------
    InvalidFrameError
        If the frame has several layers and the preset holds one.
    InvalidParameterError
        If the preset is unknown or needs something that is not given.
    InvalidFileError
        If the file cannot be written.

    Examples
    --------
    >>> import numpy as np
    >>> frame = sp.Frame(np.ones((4, 6, 3)), depth=np.full((4, 6), 2.0), motion=np.ones((4, 6, 2)))
    >>> sp.write_frame("frame.exr", frame, preset="blender")
    >>> sp.read_frame("frame.exr", preset="blender").depth[0, 0].item()
    2.0
    """
    check_choice("preset", preset, PRESETS)
    if preset is not None and len(frame.layers) > 1:
        raise InvalidFrameError(f"the preset {preset} holds one layer, the frame has {len(frame.layers)}")
    row = OWN if preset is None else PRESETS[preset]
    scale = Scale(camera, depth_scale, baseline_m, max_displacement)
    header = part_header() | raster_header(frame.raster, frame.raster.data)
    parts = [
        OpenEXR.Part(header | {"name": f"layer{index}"}, _stored_channels(layer, row, scale, unpremultiplied))
        for index, layer in enumerate(frame.layers)
    ]
    with atomic_path(path, ".exr") as temporary, library_messages():
        OpenEXR.File(parts).write(str(temporary))
        carry_attributes(temporary, [frame.raster.attributes] * len(parts))


# --- Reading -------------------------------------------------------------------------------------------------------


def _with_room(frame: Frame) -> Frame:
    """Return a frame with empty pixels up to the display window, if it is an element whose blur may reach there."""
    whole = frame.raster.data.union(frame.raster.display)
    if whole == frame.raster.data or frame.layers[-1].radiance[..., 3].min() == 1:
        return frame
    return frame.reaching(whole)


def flat_layers(file: ExrFile, options: ReadOptions) -> list[tuple[Image, ReadOptions]]:
    """Return the depth layers of a flat file, each as an image and how to read it.

    They are its parts if each holds R, G, B, A and Z, else the colour layers that the caller names, all channels
    together.
    """
    one_view = len({part.view for part in file.parts}) == 1  # the parts of a stereo image are no layers
    if one_view and all({"R", "G", "B", "A", "Z"} <= part.planes.keys() for part in file.parts):
        return [(merged(file.path, [part]), options) for part in file.parts]
    image = with_rgb(file.image)
    return [(image, replace(options, colour_layer=layer)) for layer in options.colour_layers]


def read_passes(options: ReadOptions) -> Passes:
    """Return the images of the passes that the caller keeps in files of their own."""
    paths = (options.depth_file, options.motion_file, options.alpha_file)
    with opened([path for path in paths if path is not None]) as files:
        images = iter([file.image.of_view(options.view) for file in files])
    depth, motion, alpha = (None if path is None else next(images) for path in paths)
    return Passes(depth, motion, alpha)


def deep_header(file: ExrFile, options: ReadOptions | None = None) -> tuple[int, Image]:
    """Return which part of a file is deep, and its channels without pixels, after checking what the headers promise.

    Of several deep parts it is the one of the view that is asked for, or the hero view's.
    """
    view = options.view if options else None
    deep = [index for index, header in enumerate(file.headers) if is_deep(header)]
    views = [str(file.headers[index].get("view", "")) for index in deep]
    if view is not None and view not in views:
        raise InvalidFileError(f"{file.path}: lacks the {option('view')} {view!r}; its views are {', '.join(views)}")
    if len(deep) > 1 and len(set(views)) < len(deep):
        raise InvalidFileError(f"{file.path}: holds {len(deep)} deep parts of the same view; one can be read")
    index = deep[views.index(view) if view is not None else 0]
    file.check_size(deep=True)
    header = file.headers[index]
    data, nothing = window(header["dataWindow"]), np.zeros((0, 0), np.float32)
    planes = {channel.name: Plane(nothing, data, (1, 1)) for channel in header["channels"]}
    part = replace(Part.of({**header, "multiView": ()}, planes, file.attributes[index]), name="")
    return index, merged(file.path, [part])


def _merged_deep(files: Sequence[ExrFile], options: ReadOptions) -> Frame:
    """Return the depth layers of deep files, which show one scene, in a window that holds all of theirs."""
    parts = [deep_header(file, options) for file in files]
    found = [recognise_deep(image, options) for _, image in parts]
    rasters = [each.colour.image.raster(each.colour.channels[0]) for each in found]
    for file, raster in zip(files, rasters, strict=True):
        if (raster.display, raster.pixel_aspect) != (rasters[0].display, rasters[0].pixel_aspect):
            first = files[0].path
            raise InvalidFileError(f"{file.path}: is displayed otherwise than {first}; deep files of one scene agree")
    stored = functools.reduce(Window.union, (raster.data for raster in rasters))
    shared = replace(rasters[0], data=stored).reaching(stored.union(rasters[0].display))
    images = [
        _read_deep(file.deep_part(index), each, shared, options)
        for file, (index, _), each in zip(files, parts, found, strict=True)
    ]
    try:
        return DeepImage.merged(images).layers(options.max_layers).lying_at(shared)
    except (InvalidFrameError, InvalidParameterError) as error:
        raise type(error)(f"{', '.join(str(file.path) for file in files)}: {error}") from None


def _read_deep(part: DeepPart, found: Recognised, raster: Raster, options: ReadOptions) -> DeepImage:
    """Return the samples of a deep part of a file, in the data window of a raster."""
    # Name the channels that were recognised.
    image = found.colour.image
    path = image.path
    names = {"colour": found.colour.channels, "alpha": found.colour.alpha, "depth": found.depth.channels}
    names |= {"motion": found.motion.channels} if found.motion else {}
    _warn(image, found)
    data = image.planes[found.colour.channels[0]].window
    if part.counts.shape != data.shape:
        raise InvalidFileError(f"{path}: its header is malformed: the library takes the data window for another")
    # Convert them to planar depth and px per frame.
    scale, shape = replace(options.scale, raster=raster), raster.data.shape
    try:
        samples, dropped = deep_image(
            part,
            data,
            raster.data,
            names,
            to_planar=lambda values, pixel: _planar_samples(found.depth, values, pixel, shape, options, scale),
            to_motion=lambda channels: _mean_motion(found.motion, channels, shape, scale),
            unpremultiplied=options.unpremultiplied,
            repair=options.repair,
        )
    except (InvalidFrameError, InvalidParameterError) as error:
        raise type(error)(f"{path}: {error}") from None
    # Tell what was lost.
    if dropped:
        text = f"{path}: {dropped} invalid deep samples were mended, or dropped where the colour is invalid"
        warnings.warn(text, stacklevel=5)
    return samples


def recognise_deep(image: Image, options: ReadOptions) -> Recognised:
    """Return the channels of a deep image, or raise InvalidFileError if it lacks colour or alpha."""
    found = recognise(image, replace(options, view=None))
    if found.depth.convention == POSITION:
        raise image.problem("lacks a depth channel", "depth_channel")
    if not found.colour.alpha:
        raise image.problem("lacks alpha, which deep samples need", "alpha_channel")
    return found


def _planar_samples(
    found: Found,
    values: FloatArray,
    pixel: npt.NDArray[np.int64],
    shape: tuple[int, int],
    options: ReadOptions,
    scale: Scale,
) -> FloatArray:
    """Return planar depth in metres of samples in the pixels of an image."""
    planar = planar_samples(found.convention, values, pixel, shape, scale)
    if options.background_depth is None:
        return planar
    return np.where(background_places(options.background_depth, values), BACKGROUND_DEPTH, planar)


def _mean_motion(found: Found | None, channels: FloatArray, shape: tuple[int, int], scale: Scale) -> FloatArray:
    """Return the motion of samples, (N, n) to (N, 2) in px per frame; of a curved path the mean."""
    assert found is not None  # only called where there are channels
    labels = motion_labels(found.convention, channels[None], channels[None], scale, shape)
    values = labels["motion"] if "motion" in labels else 0.5 * (labels["motion_prev"] + labels["motion_next"])
    return np.asarray(values[0], np.float32)


def _read_layer(image: Image, options: ReadOptions, passes: Passes) -> Frame:
    """Return one layer of labelled pixels; its errors start with the file's path."""
    # Recognise the channels.
    found = recognise(image, options, passes)
    raster = found.colour.image.raster(found.colour.channels[0])
    scale = replace(options.scale, raster=raster)
    radiance = _radiance(found.colour, options.unpremultiplied, raster.data)
    _warn(image, found)
    try:
        # Find where nothing was seen.
        depths = _label("depth", found.depth, found.colour.image, raster.data, 1.0)
        stored = depths[..., 0]
        nothing = ~covered(found.depth.image, found.depth.channels[0], raster.data)
        if options.background_depth is not None:
            nothing |= background_places(options.background_depth, stored)
        seen = ~nothing if radiance.shape[2] == 3 else ~nothing & (radiance[..., 3] > 0)
        # Warn if the depth looks like another convention.
        planar_told = options.preset is not None and found.depth.convention == "planar"
        told = options.depth_convention is not None or planar_told
        if looks_wrong := depth_warning(os.fspath(found.depth.image.path), found.depth, stored, seen, told):
            warnings.warn(looks_wrong, AmbiguousInputWarning, stacklevel=3)
        # Convert depth and motion to ours.
        planar = np.where(nothing, BACKGROUND_DEPTH, channels_depth(found.depth.convention, depths, scale))
        labels = {}
        if found.motion is not None:
            channels = _label("motion", found.motion, found.colour.image, raster.data)
            labels = motion_labels(found.motion.convention, channels, planar, scale)
        if found.around is not None:
            channels = _label("depth", found.around, found.colour.image, raster.data, 1.0)
            convention = found.around.convention
            labels |= {name: planar_depth(convention, channels[..., k], scale) for k, name in enumerate(AROUND)}
        return Frame(radiance, planar, **labels, raster=raster, repair=options.repair)
    except InvalidFrameError as error:
        raise InvalidFrameError(f"{image.path}: {error}{_background_advice(error)}") from None
    except InvalidParameterError as error:
        raise InvalidParameterError(f"{image.path}: {error}") from None


def _background_advice(error: InvalidFrameError) -> str:
    """Return what to do besides about depth that is invalid; "" of other errors."""
    if not str(error).startswith(("depth is NaN", "depth is zero or negative")):
        return ""
    return f"; if it stands for the background, say so with {option('background_depth')}: a number, nan, <X or >X"


def _label(what: str, found: Found, picture: Image, target: Window, fill: float = 0.0) -> FloatArray:
    """Return a label's channels in a window, (H, W, n); one in a file of its own has the picture's size."""
    check_same_window(found.image, found.channels)
    _check_size(what, found.image, picture)
    return gather(found.image, found.channels, target, fill)


def _check_size(what: str, image: Image, picture: Image) -> None:
    """Raise InvalidFileError unless a pass in a file of its own is displayed in a window of the picture's size."""
    if image.display.shape != picture.display.shape:
        there, wanted = (f"{each.display.width} x {each.display.height} px" for each in (image, picture))
        raise InvalidFileError(f"the {what} in {image.path} has {there}, the colours have {wanted}")


def _warn(image: Image, found: Recognised) -> None:
    """Warn of each doubt that there is."""
    for doubt in found.doubts:
        warnings.warn(f"{image.path}: {doubt}", AmbiguousInputWarning, stacklevel=4)


def _radiance(colour: Colour, unpremultiplied: bool, target: Window | None = None) -> FloatArray:
    """Return the colours in a window, by default the display's; opaque ones get an alpha where they do not fill it."""
    image, alpha_image = colour.image, colour.alpha_image
    target = image.display if target is None else target
    check_same_window(image, colour.channels)
    colours = gather(image, colour.channels, target)
    if colour.alpha:
        check_same_window(alpha_image, colour.alpha)
        _check_size("alpha", alpha_image, image)
        alpha = gather(alpha_image, colour.alpha, target).mean(axis=2, keepdims=True)
    elif image.planes[colour.channels[0]].window != target:
        alpha = covered(image, colour.channels[0], target).astype(np.float32)[..., None]
    else:
        return colours
    return np.concatenate([colours * alpha if unpremultiplied else colours, alpha], axis=2)


def _sequence_doubts(files: Sequence[PathLike]) -> list[str]:
    """Return a warning if files that are taken for depth layers look like frames of a sequence."""
    names = [os.path.basename(os.fspath(path)) for path in files]
    if len(names) < 2 or len({COUNTER.sub("", name) for name in names}) > 1:
        return []
    counters = zip(*(COUNTER.findall(name) for name in names), strict=True)
    changing = [index for index, values in enumerate(counters) if len(set(values)) == len(names)]
    if not changing or "layer" in names[0].lower():
        return []
    places = list(COUNTER.finditer(names[0]))
    first, last = places[changing[0]].span()
    pattern = names[0][:first] + "#" * (last - first) + names[0][last:]
    return [
        f"{names[0]} to {names[-1]} differ in a number only, as frames of a sequence do, but several files are depth "
        f"layers of one frame, nearest first; name a sequence like {pattern}"
    ]


# --- Writing -------------------------------------------------------------------------------------------------------


def _stored_channels(layer: Layer, row: Preset, scale: Scale, unpremultiplied: bool) -> dict[str, FloatArray]:
    """Return a layer's channels by the names of a preset, as contiguous planes."""
    # Colours.
    colours = layer.radiance
    if unpremultiplied:
        alpha = colours[..., 3:]
        rgb = np.divide(colours[..., :3], alpha, out=np.zeros_like(colours[..., :3]), where=alpha > 0)
        colours = np.concatenate([rgb, alpha], axis=2)
    channels = {row.colour + name: colours[..., index] for index, name in enumerate("RGBA")}
    # Depth, also of the frames before and after.
    depth_name, depth_convention = row.depth[0]
    channels[depth_name] = stored_depth(depth_convention, layer.depth, scale)
    for name, other in zip(AROUND, (layer.depth_prev, layer.depth_next), strict=True):
        if other is not None:
            channels[name] = stored_depth(depth_convention, other, scale)
    # Motion.
    if layer.has_motion:
        curved = layer.motion_prev is not None
        names, convention = next(
            (item for item in row.motion if MOTION_CONVENTIONS[item[1]].curved == curved), row.motion[0]
        )
        stored = stored_motion(convention, _paths(layer), layer.depth, scale)
        channels |= {name: stored[..., index] for index, name in enumerate(names)}
    return {row.prefix + name: np.ascontiguousarray(plane) for name, plane in channels.items()}


def _paths(layer: Layer) -> dict[str, FloatArray]:
    """Return the motion labels of a layer; a straight path has the same motion before and after the frame."""
    before = layer.motion if layer.motion_prev is None else layer.motion_prev
    after = layer.motion if layer.motion_next is None else layer.motion_next
    return {"motion": layer.motion, "motion_prev": before, "motion_next": after}
