"""Frames as OpenEXR, and the colours of an image.

What the channels mean is told by the tables of `spreadlets.files.conventions`.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import OpenEXR

from spreadlets.arrays import FloatArray, PathLike
from spreadlets.errors import AmbiguousInputWarning, InvalidFileError, InvalidFrameError, InvalidParameterError
from spreadlets.files.atomic import atomic_path
from spreadlets.files.attributes import carried_attributes
from spreadlets.files.conventions import (
    MOTION_CONVENTIONS,
    OWN,
    PRESETS,
    Preset,
    Scale,
    check_choice,
    motion_labels,
    planar_depth,
    planar_samples,
    stored_depth,
    stored_motion,
)
from spreadlets.files.deep import DEFAULT_LAYERS, deep_image
from spreadlets.files.exr_chunks import read_deep_part
from spreadlets.files.exr_parts import (
    Image,
    Plane,
    check_headers,
    check_same_window,
    covered,
    gather,
    is_deep,
    library_messages,
    merged,
    part_header,
    part_of,
    read_headers,
    read_parts,
    window,
)
from spreadlets.files.recognise import Found, ReadOptions, depth_warning, find_colour, find_depth, find_motion
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.frame import Frame, Layer


def read_frame(
    paths: PathLike | Sequence[PathLike],
    *,
    preset: str | None = None,
    colour_layer: str | None = None,
    depth_channel: str | None = None,
    motion_channels: Sequence[str] | None = None,
    depth_convention: str | None = None,
    motion_convention: str | None = None,
    unpremultiplied: bool = False,
    camera: ThinLens | None = None,
    depth_scale: float = 1.0,
    baseline_m: float | None = None,
    max_displacement: float | None = None,
    max_layers: int = DEFAULT_LAYERS,
    repair: bool = False,
) -> Frame:
    """Read a frame of labelled pixels from OpenEXR files.

    Parameters
    ----------
    paths : path or sequence of paths
        One file is a whole frame, or depth layers if each of its parts holds R, G, B, A and Z, or a deep image, whose
        samples become layers. Several files are depth layers, nearest first, premultiplied by alpha.
    preset : str, optional
        The renderer that wrote the file, a key of `conventions.PRESETS`; by default all their channel names are
        looked for.
    colour_layer : str, optional
        Prefix of the colour channels, e.g. ``"ViewLayer.Combined"``; by default the main image is looked for.
    depth_channel : str, optional
        Name of the depth channel; by default a known name is looked for.
    motion_channels : sequence of str, optional
        Names of the motion channels in the order of the convention, or an empty sequence to take the frame as still;
        by default known names are looked for.
    depth_convention, motion_convention : str, optional
        Keys of `conventions.DEPTH_CONVENTIONS` and `conventions.MOTION_CONVENTIONS`; by default they follow from the
        renderer or from the channels' names.
    unpremultiplied : bool
        Whether the colours are not multiplied by alpha yet.
    camera : ThinLens, optional
        Needed for ray distance, disparity and velocities in space.
    depth_scale : float
        Metres per unit of the depth channel: 0.01 for a scene in centimetres.
    baseline_m : float, optional
        Distance of the two cameras in metres; needed for disparity.
    max_displacement : float, optional
        Motion in px that the end of the range stands for; needed for normalised motion.
    max_layers : int
        Most depth layers that are made of a deep image, see `deep.DeepImage.layers`.
    repair : bool
        Drop pixels with invalid values instead of raising, see `Frame`.

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
        If a convention had to be assumed.

    Examples
    --------
    >>> import numpy as np
    >>> frame = sp.Frame(np.ones((4, 6, 3)), depth=np.full((4, 6), 2.0), motion=np.ones((4, 6, 2)))
    >>> sp.write_frame("frame.exr", frame)
    >>> sp.read_frame("frame.exr").motion[0, 0].tolist()
    [1.0, 1.0]
    >>> sp.read_frame(["frame.exr", "frame.exr"])  # two files are two depth layers
    Frame(4 x 6 px, 2 layers)
    """
    options = ReadOptions(
        preset=preset,
        colour_layer=colour_layer,
        depth_channel=depth_channel,
        motion_channels=None if motion_channels is None else tuple(motion_channels),
        depth_convention=depth_convention,
        motion_convention=motion_convention,
        unpremultiplied=unpremultiplied,
        scale=Scale(camera, depth_scale, baseline_m, max_displacement),
    )
    files = [paths] if isinstance(paths, str | os.PathLike) else list(paths)
    layers = [layer for path in files for layer in _read_file(path, options, repair, max_layers)]
    return _with_room(layers[0] if len(layers) == 1 else Frame.from_layers(layers))


def read_image(path: PathLike, *, colour_layer: str | None = None) -> FloatArray:
    """Read the colours of an OpenEXR file.

    Parameters
    ----------
    path : path
        The file.
    colour_layer : str, optional
        Prefix of the colour channels, e.g. ``"ViewLayer.Combined"``; by default the main image is looked for.

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
    image = merged(path, read_parts(path))
    colour = find_colour(image, ReadOptions(colour_layer=colour_layer))
    check_same_window(image, colour)
    return _radiance(image, colour)


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
        has motion, with motion_prev and motion_next for a curved path; several layers as parts layer0, layer1, ...
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
    parts = [
        OpenEXR.Part({**part_header(), "name": f"layer{index}"}, _stored_channels(layer, row, scale, unpremultiplied))
        for index, layer in enumerate(frame.layers)
    ]
    with atomic_path(path, ".exr") as temporary, library_messages():
        OpenEXR.File(parts).write(str(temporary))


# --- Reading -------------------------------------------------------------------------------------------------------


def _with_room(frame: Frame) -> Frame:
    """Return a frame with empty pixels up to the display window, if it is an element whose blur may reach there."""
    whole = frame.raster.data.union(frame.raster.display)
    if whole == frame.raster.data or frame.layers[-1].radiance[..., 3].min() == 1:
        return frame
    return frame.reaching(whole)


def _read_file(path: PathLike, options: ReadOptions, repair: bool, max_layers: int) -> list[Frame]:
    """Return a file's depth layers: its parts, or those of a deep image, or one from all parts together."""
    headers = read_headers(path)
    if any(is_deep(header) for header in headers):
        return [_read_deep(path, headers, options, repair, max_layers)]
    return [_read_layer(image, options, repair) for image in layer_images(path)]


def layer_images(path: PathLike) -> list[Image]:
    """Return the images of a flat file: its parts if each holds R, G, B, A and Z, else one of all channels together."""
    parts = read_parts(path)
    one_view = len({part.view for part in parts}) == 1  # the parts of a stereo image are no layers
    if one_view and all({"R", "G", "B", "A", "Z"} <= part.planes.keys() for part in parts):
        return [Image(path, part.planes, part.display, parts) for part in parts]
    return [merged(path, parts)]


def deep_header(path: PathLike, headers: Sequence[Mapping[str, Any]]) -> tuple[int, Image]:
    """Return which part of a file is deep, and its channels without pixels, after checking what the headers promise."""
    deep = [index for index, header in enumerate(headers) if is_deep(header)]
    if len(deep) > 1:
        raise InvalidFileError(f"{path}: holds {len(deep)} deep parts; one can be read")
    check_headers(path, headers, deep=True)
    header = headers[deep[0]]
    data, nothing = window(header["dataWindow"]), np.zeros((0, 0), np.float32)
    planes = {channel.name: Plane(nothing, data, (1, 1)) for channel in header["channels"]}
    part = part_of(header, planes, carried_attributes(path)[deep[0]])
    return deep[0], Image(path, planes, part.display, [part])


def _read_deep(
    path: PathLike, headers: Sequence[Mapping[str, Any]], options: ReadOptions, repair: bool, max_layers: int
) -> Frame:
    """Return the depth layers of a deep file."""
    index, image = deep_header(path, headers)
    colour = find_colour(image, options)
    if len(colour) < 4:
        raise image.problem("lacks alpha, which deep samples need", "colour_layer")
    depth, motion = find_depth(image, colour, options), find_motion(image, options)
    names = {"colour": colour, "depth": depth.channels} | ({"motion": motion.channels} if motion else {})
    _warn(image, depth.doubt, motion.doubt if motion else "")
    part, raster = read_deep_part(path, index), image.raster(colour[0])
    if part.counts.shape != raster.data.shape:
        raise InvalidFileError(f"{path}: its header is malformed: the library takes the data window for another")
    raster = raster.reaching(raster.data.union(raster.display))
    scale, shape = replace(options.scale, raster=raster), raster.data.shape
    try:
        samples, dropped = deep_image(
            part,
            image.planes[colour[0]].window,
            raster.data,
            names,
            to_planar=lambda values, pixel: planar_samples(depth.convention, values, pixel, shape, scale),
            to_motion=lambda channels: _mean_motion(motion, channels, shape, scale),
            unpremultiplied=options.unpremultiplied,
            repair=repair,
        )
        if dropped:
            warnings.warn(f"{path}: {dropped} invalid deep samples were dropped", stacklevel=4)
        return samples.layers(max_layers).lying_at(raster)
    except (InvalidFrameError, InvalidParameterError) as error:
        raise type(error)(f"{path}: {error}") from None


def _mean_motion(found: Found | None, channels: FloatArray, shape: tuple[int, int], scale: Scale) -> FloatArray:
    """Return the motion of samples, (N, n) to (N, 2) in px per frame; of a curved path the mean."""
    assert found is not None  # only called where there are channels
    labels = motion_labels(found.convention, channels[None], channels[None], scale, shape)
    values = labels["motion"] if "motion" in labels else 0.5 * (labels["motion_prev"] + labels["motion_next"])
    return np.asarray(values[0], np.float32)


def _read_layer(image: Image, options: ReadOptions, repair: bool) -> Frame:
    """Return one layer of labelled pixels; its errors start with the file's path."""
    colour = find_colour(image, options)
    depth = find_depth(image, colour, options)
    motion = find_motion(image, options)
    for names in (colour, depth.channels, *([motion.channels] if motion else [])):
        check_same_window(image, names)
    raster = image.raster(colour[0])
    scale = replace(options.scale, raster=raster)
    radiance = gather(image, colour, raster.data)
    if options.unpremultiplied and radiance.shape[2] == 4:
        radiance[..., :3] *= radiance[..., 3:]
    stored = gather(image, depth.channels, raster.data, 1.0)[..., 0]
    alpha = radiance[..., 3] if radiance.shape[2] == 4 else None
    told = options.depth_convention is not None or options.preset is not None
    _warn(image, depth.doubt, motion.doubt if motion else "")
    if looks_wrong := depth_warning(os.fspath(image.path), depth, stored, alpha, told):
        warnings.warn(looks_wrong, AmbiguousInputWarning, stacklevel=3)
    try:
        planar = planar_depth(depth.convention, stored, scale)
        planar[~covered(image, depth.channels[0], raster.data)] = np.inf
        labels = {}
        if motion is not None:
            labels = motion_labels(motion.convention, gather(image, motion.channels, raster.data), planar, scale)
        return Frame(radiance, planar, **labels, raster=raster, repair=repair)
    except (InvalidFrameError, InvalidParameterError) as error:
        raise type(error)(f"{image.path}: {error}") from None


def _warn(image: Image, *doubts: str) -> None:
    """Warn of each doubt that there is."""
    for doubt in filter(None, doubts):
        remedy = "say depth_convention or motion_convention to choose another or to silence this"
        warnings.warn(f"{image.path}: {doubt}; {remedy}", AmbiguousInputWarning, stacklevel=4)


def _radiance(image: Image, names: Sequence[str]) -> FloatArray:
    """Return the colours; opaque ones get an alpha where their data window does not fill the display window."""
    colours = gather(image, names)
    window = image.planes[names[0]].window
    if len(names) == 4 or window == image.display:
        return colours
    coverage = covered(image, names[0], image.display).astype(np.float32)
    return np.concatenate([colours, coverage[..., None]], axis=2)


# --- Writing -------------------------------------------------------------------------------------------------------


def _stored_channels(layer: Layer, row: Preset, scale: Scale, unpremultiplied: bool) -> dict[str, FloatArray]:
    """Return a layer's channels by the names of a preset, as contiguous planes."""
    colours = layer.radiance
    if unpremultiplied:
        alpha = colours[..., 3:]
        rgb = np.divide(colours[..., :3], alpha, out=np.zeros_like(colours[..., :3]), where=alpha > 0)
        colours = np.concatenate([rgb, alpha], axis=2)
    channels = {row.colour + name: colours[..., index] for index, name in enumerate("RGBA")}
    depth_name, depth_convention = row.depth[0]
    channels[depth_name] = stored_depth(depth_convention, layer.depth, scale)
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
