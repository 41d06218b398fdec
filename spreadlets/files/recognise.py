"""What the channels of a file mean: colour, depth and motion, by name, by preset, or as the caller says.

Labels are looked for beside the colour first: with the same prefix, in the same part, view layer or view.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace
from typing import TypedDict, Unpack

import numpy as np

from spreadlets.arrays import BoolArray, FloatArray, PathLike
from spreadlets.errors import InvalidFileError, InvalidParameterError, option
from spreadlets.files.conventions import (
    ALPHA_LIKE,
    DEPTH_CONVENTIONS,
    DEPTH_LIKE,
    MOTION_CONVENTIONS,
    MOTION_LIKE,
    OWN,
    POSITION,
    POSITION_COMPONENTS,
    POSITION_LAYERS,
    PRESETS,
    UNCLEAR,
    Scale,
    background_places,
    check_choice,
)
from spreadlets.files.deep import DEFAULT_LAYERS
from spreadlets.files.exr_parts import Image
from spreadlets.scene.camera import ThinLens

COLOUR_NAMES = ("Combined.", "rgba.", "beauty.", "")
"""What stands before R, G, B in the main image, behind any layer prefix, if there are no plain R, G, B; first wins."""

COLOUR_SETS = (("R", "G", "B"), ("red", "green", "blue"))
GREY = "Y"
ALPHA_SETS = (("A",), ("alpha",), ("AR", "AG", "AB"))
"""Names of alpha; of three, one for each colour, the mean counts."""

AROUND = ("depth_prev", "depth_next")
"""Channels of the depths one frame before and one frame after, as `write_frame` names them."""

THIRD_COMPONENTS = {"x": "z", "X": "Z", "r": "b", "R": "B", "u": "w", "U": "W"}
"""What a vector's third component ends with, by the end of its first."""

VIEW_LAYER = ".combined."
"""How the prefix of a view layer's colour ends in Blender's files."""

COMPOSITE = "composite."
"""Blender's result of the compositor, which stands beside the view layers that it is made of."""

ELSEWHERE = 99
"""Rank of channels that do not stand beside the colour."""

INVERSE_LIMIT = 1.0
INVERSE_RATIO = 4.0
"""Depth that stays below the limit, and varies by this ratio or more, could as well be 1 over the depth."""

MotionRow = tuple[tuple[str, ...], str, str]
"""Names of the channels, their convention, and what is doubtful about it."""


class ReadKeywords(TypedDict, total=False):
    """The fields of `ReadOptions`, for functions that take them as keywords."""

    preset: str | None
    view: str | None
    colour_layer: str | Sequence[str] | None
    alpha_channel: str | None
    depth_channel: str | None
    motion_channels: Sequence[str] | None
    depth_convention: str | None
    motion_convention: str | None
    unpremultiplied: bool
    background_depth: float | str | None
    depth_file: PathLike | None
    motion_file: PathLike | None
    alpha_file: PathLike | None
    camera: ThinLens | None
    depth_scale: float
    baseline_m: float | None
    max_displacement: float | None
    max_layers: int
    repair: bool


@dataclass(frozen=True)
class ReadOptions:
    """What the caller says about a file; every field may be left open.

    Attributes
    ----------
    preset : str or None
        A key of `conventions.PRESETS`: look for that renderer's channels only.
    view : str or None
        The view of a stereo file; by default the hero view, the first that the file names.
    colour_layer : str, sequence of str, or None
        The colour channels' prefix, such as ``"ViewLayer.Combined"`` or ``"ViewLayer"``; several are depth layers,
        nearest first.
    alpha_channel, depth_channel : str or None
        Full names.
    motion_channels : sequence of str or None
        The motion channels in the convention's order; empty for none, though the file may have some.
    depth_convention, motion_convention : str or None
        Keys of `conventions.DEPTH_CONVENTIONS` and `conventions.MOTION_CONVENTIONS`.
    unpremultiplied : bool
        Whether the colours are not multiplied by alpha yet.
    background_depth : float, str, or None
        Stored depth that means background: a number, ``"nan"``, or ``"<X"`` or ``">X"`` for all values beyond a number.
    depth_file, motion_file, alpha_file : path or None
        Files that hold these passes, if the frame's own does not.
    camera : ThinLens or None
        For ray distance, disparity and velocity in space.
    depth_scale : float
        Metres per unit of the depth channel: 0.01 for centimetres; below 0 where the axis points to the camera.
    baseline_m : float or None
        Distance of the two cameras of a stereo pair, metres, for disparity.
    max_displacement : float or None
        Motion in px that a normalised channel's end of range stands for.
    max_layers : int
        Most depth layers that are made of a deep image, see `deep.DeepImage.layers`.
    repair : bool
        Mend pixels with invalid values instead of raising, see `Frame`.

    Raises
    ------
    InvalidParameterError
        If a name is unknown or a value out of its range.

    Examples
    --------
    >>> options = sp.ReadOptions(depth_channel="depth.R", depth_scale=0.01)
    >>> options.depth_convention is None
    True
    """

    preset: str | None = None
    view: str | None = None
    colour_layer: str | Sequence[str] | None = None
    alpha_channel: str | None = None
    depth_channel: str | None = None
    motion_channels: Sequence[str] | None = None
    depth_convention: str | None = None
    motion_convention: str | None = None
    unpremultiplied: bool = False
    background_depth: float | str | None = None
    depth_file: PathLike | None = None
    motion_file: PathLike | None = None
    alpha_file: PathLike | None = None
    camera: ThinLens | None = None
    depth_scale: float = 1.0
    baseline_m: float | None = None
    max_displacement: float | None = None
    max_layers: int = DEFAULT_LAYERS
    repair: bool = False

    def __post_init__(self) -> None:
        check_choice("preset", self.preset, PRESETS)
        check_choice("depth_convention", self.depth_convention, DEPTH_CONVENTIONS)
        check_choice("motion_convention", self.motion_convention, MOTION_CONVENTIONS)
        if self.background_depth is not None:
            background_places(self.background_depth, np.zeros(0, np.float32))
        if self.motion_channels is not None:
            object.__setattr__(self, "motion_channels", tuple(self.motion_channels))
        if self.motion_channels == () and (self.motion_convention is not None or self.motion_file is not None):
            other = "motion_convention" if self.motion_file is None else "motion_file"
            raise InvalidParameterError(f"{option('motion_channels')} is {_none()}: {option(other)} is then of nothing")
        _ = self.scale

    @property
    def scale(self) -> Scale:
        """Camera and units, as the conventions take them."""
        return Scale(self.camera, self.depth_scale, self.baseline_m, self.max_displacement)

    @property
    def colour_layers(self) -> tuple[str | None, ...]:
        """The colour layers to read, nearest first; None stands for the main image."""
        layer = self.colour_layer
        return (layer,) if layer is None or isinstance(layer, str) else tuple(layer)

    @classmethod
    def of(cls, options: ReadOptions | None = None, **keywords: Unpack[ReadKeywords]) -> ReadOptions:
        """Return options with some fields changed."""
        known = {field.name for field in fields(cls)}
        for name in keywords:
            if name not in known:
                raise TypeError(f"reading knows no option {name!r}; it knows {', '.join(sorted(known))}")
        return replace(options or cls(), **keywords)


@dataclass(frozen=True)
class Colour:
    """The channels of the picture.

    Attributes
    ----------
    image : Image
        Where they are.
    channels : tuple of three str
        R, G and B; three times the same for grey.
    alpha : tuple of str
        Empty, or one name, or three whose mean counts.
    alpha_image : Image
        Where alpha is.
    prefixes : tuple of str
        What stands before the names of what belongs to it, the nearest first, in lower case.
    doubts : tuple of str
        What the user should be warned of.
    """

    image: Image
    channels: tuple[str, ...]
    alpha: tuple[str, ...]
    alpha_image: Image
    prefixes: tuple[str, ...]
    doubts: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Every channel, as the file names them."""
        return tuple(dict.fromkeys((*self.channels, *self.alpha)))


@dataclass(frozen=True)
class Found:
    """Channels with their convention.

    Attributes
    ----------
    image : Image
        Where they are.
    channels : tuple of str
        Full names in the file.
    convention : str
        How to read them.
    doubt : str
        What the user should be warned of; empty if nothing.
    prefix : str
        What stands before their names, in lower case.
    """

    image: Image
    channels: tuple[str, ...]
    convention: str
    doubt: str = ""
    prefix: str = ""


@dataclass(frozen=True)
class Passes:
    """Images of passes that stand in files of their own."""

    depth: Image | None = None
    motion: Image | None = None
    alpha: Image | None = None


@dataclass(frozen=True)
class Recognised:
    """The channels of one layer, and what is doubtful about them."""

    colour: Colour
    depth: Found
    motion: Found | None
    doubts: tuple[str, ...]
    around: Found | None = None
    """The depths one frame before and one frame after."""

    def names_in(self, image: Image) -> tuple[str, ...]:
        """Return every channel that is taken from an image."""
        names = list(self.colour.channels) if self.colour.image is image else []
        names += self.colour.alpha if self.colour.alpha_image is image else ()
        for found in (self.depth, self.motion, self.around):
            names += found.channels if found is not None and found.image is image else ()
        return tuple(names)


def recognise(image: Image, options: ReadOptions, passes: Passes | None = None) -> Recognised:
    """Return the channels of a layer.

    Parameters
    ----------
    image : Image
        The channels of a file, or of one part.
    options : ReadOptions
        With one colour layer at most.
    passes : Passes, optional
        Files of single passes, where they are apart.

    Raises
    ------
    InvalidFileError
        If a channel is missing or ambiguous.
    InvalidParameterError
        If a convention takes another number of channels than are named.
    """
    passes = passes or Passes()
    layer = options.colour_layer
    view = options.view
    if view is None and isinstance(layer, str) and layer in image.views:
        view, options = layer, replace(options, colour_layer=None)
    image = image.of_view(view)
    colour = find_colour(image, options, passes.alpha)
    depth = find_depth(passes.depth or image, colour, options, alone=passes.depth is not None)
    motion = find_motion(passes.motion or image, colour, options, depth, alone=passes.motion is not None)
    around, lone = find_depths_around(passes.depth or image, colour, depth)
    doubts = [
        *colour.doubts,
        depth.doubt,
        lone,
        motion.doubt if motion else "",
        *_unused(image, colour, depth, motion, options),
    ]
    return Recognised(colour, depth, motion, tuple(dict.fromkeys(filter(None, doubts))), around)


# --- Colour --------------------------------------------------------------------------------------------------------


def find_colour(image: Image, options: ReadOptions, alpha_image: Image | None = None) -> Colour:
    """Return the channels of the picture.

    Raises
    ------
    InvalidFileError
        If they are missing or ambiguous.
    """
    layer = options.colour_layers[0]
    if layer is None:
        prefix, channels, doubt = _main_colour(image, options.preset)
    else:
        prefix, channels, doubt = (*_named_colour(image, layer), "")
    prefixes = tuple(dict.fromkeys((prefix, _parent(prefix), "")))
    alpha = _alpha(alpha_image or image, prefixes, options, alone=alpha_image is not None)
    return Colour(image, channels, alpha, alpha_image or image, prefixes, (doubt,) if doubt else ())


def _main_colour(image: Image, preset: str | None) -> tuple[str, tuple[str, ...], str]:
    """Return the main picture's prefix, its channels, and what is doubtful about the choice."""
    # Plain channels of no layer come first,
    for names in COLOUR_SETS:
        for prefix, group in _groups(image, names):
            if prefix == "":
                return prefix, group, ""
    # then layers by the names that renderers give,
    for heading in (PRESETS[preset].colour, *COLOUR_NAMES) if preset else COLOUR_NAMES:
        groups = [found for names in COLOUR_SETS for found in _groups(image, [heading + name for name in names])]
        if groups:
            prefix, group, doubt = _chosen_colour(image, groups)
            return prefix + heading.lower(), group, doubt
    # then a single channel of luminance.
    grey = [group for _, group in _groups(image, (GREY,)) if image.place(group[0]) == GREY]
    if not grey:
        found = ", ".join(sorted(image.names)) or "none"
        raise InvalidFileError(
            f"{image.path}: lacks colour channels; no layer has R, G and B (or red, green, blue, or Y). A file of a "
            f"single pass goes to {option('depth_file')}, {option('motion_file')} or {option('alpha_file')}. Channels "
            f"found: {found}"
        )
    return "", grey[0] * 3, ""


def _chosen_colour(image: Image, groups: list[tuple[str, tuple[str, ...]]]) -> tuple[str, tuple[str, ...], str]:
    """Return the main one of several pictures, or raise InvalidFileError."""
    if len(groups) == 1:
        return (*groups[0], "")
    # A composite is what was meant to be seen.
    composite = [found for found in groups if found[0] == COMPOSITE]
    if len(composite) == 1:
        return (*composite[0], "")
    # Of several view layers, take the first.
    groups = sorted(groups, key=lambda found: list(image.planes).index(found[1][0]))
    if all(_parent(image.place(group[0]).lower()).endswith(VIEW_LAYER) for _, group in groups):
        held = ", ".join(group[0].rpartition(".")[0] for _, group in groups)
        doubt = (
            f"the file holds the view layers {held}; the first is taken: say {option('colour_layer')} for "
            "another, or for several as depth layers, nearest first"
        )
        return (*groups[0], doubt)
    # Of several parts, take the plain picture of the first.
    first = [found for found in groups if image.planes[found[1][0]].part == 0]
    if image.n_parts > 1 and len(first) == 1 and "." not in image.planes[first[0][1][0]].bare:
        names = ", ".join(first[0][1])
        return (
            *first[0],
            f"the picture is taken from the first part ({names}); say {option('colour_layer')} for others",
        )
    # Anything else is for the user to decide.
    layers = ", ".join(prefix.rstrip(".") or group[0].rpartition(".")[0] for prefix, group in groups)
    raise image.problem(
        f"the colour channels are ambiguous ({layers}; several, with commas and nearest first, are depth layers)",
        "colour_layer",
    )


def _named_colour(image: Image, layer: str) -> tuple[str, tuple[str, ...]]:
    """Return the prefix and the channels of a colour layer that the caller names, with or without its last word."""
    for heading in ("", *COLOUR_NAMES[:-1]):
        for names in COLOUR_SETS:
            for prefix, group in _groups(image, [f"{layer}.{heading}{name}" for name in names]):
                if prefix == "":
                    return f"{layer}.{heading}".lower(), group
    if layer in image.planes:
        return "", (layer,) * 3
    raise image.problem(f"lacks {', '.join(f'{layer}.{name}' for name in 'RGB')}", "colour_layer")


def _alpha(image: Image, prefixes: Sequence[str], options: ReadOptions, *, alone: bool) -> tuple[str, ...]:
    """Return the names of alpha, or none: the colour's own, or one beside it that belongs to no other colour."""
    if options.alpha_channel is not None:
        return (_named(image, options.alpha_channel, "alpha_channel"),)
    coloured = _coloured_prefixes(image)
    for index, prefix in enumerate(prefixes):
        for names in ALPHA_SETS:
            for found, group in _groups(image, names):
                if found == prefix and (index == 0 or alone or prefix not in coloured):
                    return group
    if alone:
        return (_only_channel(image, "alpha_channel"),)
    return ()


def _coloured_prefixes(image: Image) -> set[str]:
    return {prefix for names in COLOUR_SETS for prefix, _ in _groups(image, names)}


# --- Depth ---------------------------------------------------------------------------------------------------------


def find_depth(image: Image, colour: Colour, options: ReadOptions, *, alone: bool = False) -> Found:
    """Return the depth channel and its convention.

    Parameters
    ----------
    image : Image
        Where to look.
    colour : Colour
        The picture that the depth is of.
    options : ReadOptions
        What the caller says.
    alone : bool
        Whether the image is a file of its own for depth, where any single channel will do.

    Raises
    ------
    InvalidFileError
        If it is missing or ambiguous.
    """
    # Take what the user says, or look for it.
    given = options.depth_channel is not None
    found = _given_depth(image, colour, options) if given else _found_depth(image, colour, options, alone)
    return found if options.depth_convention is not None else _as_values_say(found)


def find_depths_around(image: Image, colour: Colour, depth: Found) -> tuple[Found | None, str]:
    """Return the depths of the frames before and after, stored as the depth is, if both are there; and a doubt, or "".

    Parameters
    ----------
    image, colour
        As for `find_depth`.
    depth : Found
        The frame's own.
    """
    places = [_rank_of(image, colour, name) for name in AROUND]
    if all(place is not None for place in places):
        names = tuple(name for place in places if place is not None for name in place[1:])
        return Found(image, names, "planar" if depth.convention == POSITION else depth.convention), ""
    lone = [place[1] for place in places if place is not None]
    return None, f"{lone[0]} is not used: {' and '.join(AROUND)} come together" if lone else ""


def _rank_of(image: Image, colour: Colour, name: str) -> tuple[int, str] | None:
    """Return the channel of a name that stands nearest the colour, with its rank."""
    groups = _groups(image, (name,))
    return min(((_rank(image, colour, prefix, found), found) for prefix, (found,) in groups), default=None)


def _found_depth(image: Image, colour: Colour, options: ReadOptions, alone: bool) -> Found:
    """Return the depth channel that stands nearest the colour, with the convention that it has by its name."""
    # Rank the candidates.
    ranked = _depth_candidates(image, colour, options)
    # Without any, take the only channel of a pass, or tell what is missing.
    if not ranked:
        if (positions := _found_positions(image, colour)) is not None:
            return positions
        if alone:
            return Found(image, (_only_channel(image, "depth_channel"),), options.depth_convention or "planar")
        like = _like(image, DEPTH_LIKE, colour.names)
        hint = f" ({', '.join(like)} may be it)" if like else ""
        raise image.problem(f"lacks a depth channel{hint}", "depth_channel", "depth_file")
    # Take the best; several must be equal.
    best = min(ranked)
    found = list({item.channels: item for rank, item in _items(ranked, best)}.values())
    if best[0] == ELSEWHERE and colour.prefixes[0].startswith(COMPOSITE):
        found = sorted(found, key=lambda item: image.planes[item.channels[0]].part)[:1]
    if len(found) > 1 and not _all_equal(image, [item.channels[0] for item in found]):
        names = ", ".join(item.channels[0] for item in found)
        raise image.problem(f"has several depth channels ({names})", "depth_channel")
    # Say what is doubtful about it.
    chosen = found[0]
    if options.depth_convention is not None:
        chosen = replace(chosen, convention=options.depth_convention, doubt="")
    if best[0] == ELSEWHERE and not alone:
        chosen = replace(chosen, doubt=_elsewhere("depth", chosen, colour, "depth_channel"))
    return chosen


def _as_values_say(found: Found) -> Found:
    """Return a depth that would be 1 over the depth as planar where most of it would be nearer than a metre.

    In compositing both have the same name: 1 over the depth is what the program's own renderer writes, planar depth
    what others do.
    """
    stored = found.image.planes[found.channels[0]].pixels
    values = stored[np.isfinite(stored) & (stored > 0)]
    if found.convention != "inverse" or not values.size or np.median(values) <= INVERSE_LIMIT:
        return found
    doubt = (
        f"{found.channels[0]} holds {values.min():.3g} to {values.max():.3g}, too near for 1 over the depth (nearest "
        f"{1 / values.max():.3g} m), and is taken for planar metres; say {option('depth_convention')} inverse if it is "
        "1 over the depth, planar if it is not"
    )
    return replace(found, convention="planar", doubt=doubt)


def _given_depth(image: Image, colour: Colour, options: ReadOptions) -> Found:
    """Return the channel that the caller names, with the convention that he names or that its name has."""
    assert options.depth_channel is not None
    name = _named(image, options.depth_channel, "depth_channel")
    known = [item for _, item in _depth_candidates(image, colour, options).values() if item.channels == (name,)]
    found = known[0] if known else Found(image, (name,), "planar")
    if options.depth_convention is not None:
        return replace(found, convention=options.depth_convention, doubt="")
    return found


def _found_positions(image: Image, colour: Colour) -> Found | None:
    """Return the position pass that stands nearest the colour, whose depth counts where there is none else."""
    found = {
        (_rank(image, colour, prefix, group[0]), number): Found(image, group, POSITION, "", prefix)
        for number, (layer, names) in enumerate(itertools.product(POSITION_LAYERS, POSITION_COMPONENTS))
        for prefix, group in _groups(image, [f"{layer}.{name}" for name in names])
    }
    return found[min(found)] if found else None


def _depth_candidates(
    image: Image, colour: Colour, options: ReadOptions
) -> dict[tuple[int, int, int], tuple[int, Found]]:
    """Return channels that may be depth by (rank of its place, table, number)."""
    found: dict[tuple[int, int, int], tuple[int, Found]] = {}
    for table, rows in enumerate(_depth_tables(options.preset)):
        for row, convention, doubt in rows:
            for prefix, (name,) in _groups(image, (row,)):
                rank = _rank(image, colour, prefix, name)
                if "." not in row and not _may_be_bare_depth(image, name, rank):
                    continue
                doubt = _assumed(doubt, "depth_convention")
                found[rank, table, len(found)] = rank, Found(image, (name,), convention, doubt, prefix)
    return found


def _items(
    ranked: dict[tuple[int, int, int], tuple[int, Found]], best: tuple[int, int, int]
) -> list[tuple[int, Found]]:
    """Return the candidates of the best place and table."""
    return [item for key, item in ranked.items() if key[:2] == best[:2]]


def _may_be_bare_depth(image: Image, name: str, rank: int) -> bool:
    """Tell whether a channel named by one word is depth: beside the colour or in its part, and no part of a vector."""
    head, _, last = image.planes[name].bare.rpartition(".")
    places = {plane.bare.lower() for plane in image.planes.values() if plane.part == image.planes[name].part}
    prefix = f"{head}.".lower() if head else ""
    vector = last.lower() == "z" and {f"{prefix}x", f"{prefix}y"} <= places
    return not vector and rank < ELSEWHERE


def _depth_tables(preset: str | None) -> list[list[tuple[str, str, str]]]:
    """Return depth rows in groups, the preferred group first: a renderer's own, or planar ones before the others."""
    unclear = [(*row, UNCLEAR.depth_doubt) for row in UNCLEAR.depth]
    if preset is not None:
        known = PRESETS[preset]
        return [*([(name, convention, known.depth_doubt)] for name, convention in known.depth), unclear]
    rows = [(*row, "") for known in [OWN, *PRESETS.values()] for row in known.depth]
    doubtful = {name: known.depth_doubt for known in PRESETS.values() for name, _ in known.depth if "." in name}
    rows = [(name, convention, doubtful.get(name, "")) for name, convention, _ in rows]
    planar = {row[0].lower(): row for row in reversed(rows) if row[1] == "planar"}
    others = [row for row in rows if row[0].lower() not in planar]
    return [list(planar.values()), others, [row for row in unclear if row[0].lower() not in planar]]


def _all_equal(image: Image, names: Sequence[str]) -> bool:
    """Tell whether channels hold the same values."""
    first, *others = (image.planes[name].pixels for name in names)
    return first.size > 0 and all(np.array_equal(first, each, equal_nan=True) for each in others)


def depth_warning(name: str, found: Found, stored: FloatArray, seen: BoolArray, told: bool) -> str:
    """Return a warning if a depth channel's values look like another convention than the one assumed, else "".

    Parameters
    ----------
    name : str
        The file's name, for the message.
    found : Found
        The depth channel.
    stored : ndarray of shape (H, W)
        Its values.
    seen : ndarray of shape (H, W), bool
        Elsewhere the values do not count: nothing is there.
    told : bool
        Whether the caller named the convention, or a renderer that writes planar depth.
    """
    if told:
        return ""
    # Look at what was seen.
    values = stored[np.isfinite(stored) & seen]
    if found.convention != "planar" or values.size == 0 or values.min() < 0:
        return ""
    channel = found.channels[0]
    spelled = option("depth_convention")
    remedy = f"say {spelled} inverse if it is 1 over the depth, planar if it is not"
    span = f"{values.min():.3g} to {values.max():.3g}"
    # Zeros, and a wide range of small numbers, are what an inverse depth looks like.
    zeros = int(np.count_nonzero(values == 0))
    if 0 < zeros < values.size:
        return f"{name}: {channel} is 0 at {zeros} pixels, as where 1 over the depth of the background is; {remedy}"
    if 0 < values.max() <= INVERSE_LIMIT and values.max() >= INVERSE_RATIO * values.min():
        return f"{name}: {channel} holds {span}, taken for planar metres; {remedy}"
    return ""


# --- Motion --------------------------------------------------------------------------------------------------------


def find_motion(
    image: Image, colour: Colour, options: ReadOptions, depth: Found | None = None, *, alone: bool = False
) -> Found | None:
    """Return the motion channels and their convention, or None if the file has no motion.

    Parameters
    ----------
    image, colour, options, alone
        As for `find_depth`.
    depth : Found, optional
        The depth; motion from the same place belongs to it.

    Raises
    ------
    InvalidFileError
        If channels that were asked for are missing, or it is not clear which are meant.
    InvalidParameterError
        If the convention takes another number of channels than are named.
    """
    if options.motion_channels is not None and len(options.motion_channels) == 0:
        return None
    presets = [PRESETS[options.preset]] if options.preset else [OWN, *PRESETS.values(), UNCLEAR]
    rows: list[MotionRow] = [(*row, preset.motion_doubt) for preset in presets for row in preset.motion]
    if options.motion_channels is not None:
        return _given_motion(image, tuple(options.motion_channels), rows, options.motion_convention)
    if depth is not None and depth.image is image:
        colour = replace(colour, prefixes=(*colour.prefixes, depth.prefix))
    if options.motion_convention is not None:
        return _motion_of_convention(image, colour, rows, options.motion_convention, alone=alone)
    found = _matches(image, colour, rows)
    if not found and alone:
        return _only_motion(image)
    if len(found) > 1:
        names = " or ".join(", ".join(item.channels) for item in found)
        raise image.problem(f"has several sets of motion channels ({names})", "motion_channels", "motion_convention")
    return found[0] if found else None


def _matches(image: Image, colour: Colour, rows: Iterable[MotionRow]) -> list[Found]:
    """Return the sets of channels that stand nearest the colour; one that extends another is the one that was meant."""
    found: dict[tuple[tuple[str, ...], str], tuple[int, Found]] = {}
    for names, convention, doubt in rows:
        for prefix, group in _groups(image, names):
            rank = _rank(image, colour, prefix, group[0])
            item = Found(image, group, convention, _assumed(doubt, "motion_convention"), prefix)
            if rank == ELSEWHERE:
                item = replace(item, doubt=_elsewhere("motion", item, colour, "motion_channels"))
            found.setdefault((group, convention), (rank, item))
    sets = [set(item.channels) for _, item in found.values()]
    whole = [pair for pair in found.values() if not any(set(pair[1].channels) < other for other in sets)]
    return [item for rank, item in whole if rank == min(rank for rank, _ in whole)]


def _motion_of_convention(
    image: Image, colour: Colour, rows: Sequence[MotionRow], convention: str, *, alone: bool
) -> Found:
    """Return the channels to read by a given convention: those of its own names, else any others of that number."""
    own = _matches(image, colour, [row for row in rows if row[1] == convention])
    n_channels = MOTION_CONVENTIONS[convention].n_channels
    found = own or _matches(image, colour, [row for row in rows if len(row[0]) == n_channels])
    groups = list(dict.fromkeys(item.channels for item in found))
    if len(groups) > 1:
        names = " or ".join(", ".join(group) for group in groups)
        raise image.problem(f"has several sets of motion channels ({names})", "motion_channels")
    if not groups and alone:
        return replace(_only_motion(image), convention=convention, doubt="")
    if not groups:
        raise image.problem(f"lacks the motion channels of the convention {convention}", "motion_channels")
    return Found(image, groups[0], convention)


def _given_motion(image: Image, channels: tuple[str, ...], rows: Sequence[MotionRow], convention: str | None) -> Found:
    """Return explicitly named channels with the given convention, or with the one that their names have."""
    names = tuple(_named(image, name, "motion_channels") for name in channels)
    if convention is not None:
        expected = MOTION_CONVENTIONS[convention].n_channels
        if len(names) != expected:
            raise InvalidParameterError(
                f"{option('motion_channels')} names {len(names)} channels; the {option('motion_convention')} "
                f"{convention} takes {expected}"
            )
        return Found(image, names, convention)
    for row, known, doubt in rows:
        if names in [group for _, group in _groups(image, row)]:
            return Found(image, names, known, _assumed(doubt, "motion_convention"))
    raise image.problem(f"the meaning of {', '.join(names)} is not known", "motion_convention")


def _only_motion(image: Image) -> Found:
    """Return the first two channels of a file that holds motion only."""
    for row in (("R", "G"), ("X", "Y"), ("u", "v")):
        groups = _groups(image, row)
        if len(groups) == 1:
            doubt = _assumed(UNCLEAR.motion_doubt, "motion_convention")
            return Found(image, groups[0][1], "forward-px-up", doubt)
    raise image.problem("the motion channels are not clear", "motion_channels")


# --- Names ---------------------------------------------------------------------------------------------------------


def _groups(image: Image, names: Sequence[str]) -> list[tuple[str, tuple[str, ...]]]:
    """Return every set of channels that carries these names behind one prefix, without regard to case.

    Each with its prefix in lower case. Names are compared without the view.
    """
    actual = {image.place(name).lower(): name for name in sorted(image.names, reverse=True)}
    lowered = [name.lower() for name in names]
    heads = [name for name in actual if name == lowered[0] or name.endswith("." + lowered[0])]
    prefixes = sorted(head.removesuffix(lowered[0]) for head in heads)
    sets = [(prefix, [prefix + name for name in lowered]) for prefix in prefixes]
    return [(prefix, tuple(actual[name] for name in group)) for prefix, group in sets if set(group) <= actual.keys()]


def _parent(prefix: str) -> str:
    """Return a prefix without its last word."""
    head = prefix.rstrip(".").rpartition(".")[0]
    return f"{head}." if head else ""


def _rank(image: Image, colour: Colour, prefix: str, name: str) -> int:
    """Return how far from the colour a channel stands: 0 with the same prefix, `ELSEWHERE` if not beside it."""
    plane = image.planes[name]
    bare = plane.bare.lower()
    if image is colour.image and plane.part == image.planes[colour.channels[0]].part:
        own = image.planes[colour.channels[0]].bare.lower().rpartition(".")[0]
        if bare.rpartition(".")[0] == own:
            return 0
    if prefix in colour.prefixes:
        return colour.prefixes.index(prefix)
    if image.n_parts > 1 and "." not in bare and not _has_colour(image, plane.part):
        return len(colour.prefixes)
    return ELSEWHERE


def _has_colour(image: Image, part: int) -> bool:
    """Tell whether a part holds a picture: then its labels belong to that."""
    there = {plane.bare.lower() for plane in image.planes.values() if plane.part == part}
    return any({name.lower() for name in names} <= there for names in COLOUR_SETS)


def _named(image: Image, name: str, spelled: str) -> str:
    """Return the channel that the caller names, or raise InvalidFileError."""
    name = name.strip()
    if name in image.planes:
        return name
    alike = [found for found in image.names if name.lower() in (found.lower(), image.place(found).lower())]
    if len(alike) == 1:
        return alike[0]
    what = option(spelled).lstrip("-").replace("-", " ").replace("_", " ").removesuffix("s")
    raise image.problem(f"lacks the {what} {name}", spelled)


def _only_channel(image: Image, spelled: str) -> str:
    """Return the only channel of a file, or one of several that are all alike."""
    names = sorted(image.names)
    if len(names) == 1 or (names and _all_equal(image, names)):
        return names[-1]
    raise image.problem("holds several channels", spelled)


def _assumed(doubt: str, spelled: str) -> str:
    """Return what is said of a convention that had to be assumed."""
    return f"{doubt}; say {option(spelled)} to choose another or to silence this" if doubt else ""


def _elsewhere(what: str, found: Found, colour: Colour, spelled: str) -> str:
    names, picture = ", ".join(found.channels), ", ".join(colour.channels)
    return f"the {what} {names} does not stand beside the colour {picture}; say {option(spelled)} if it belongs to it"


def _like(image: Image, pattern: re.Pattern[str], used: Iterable[str]) -> list[str]:
    """Return the channels whose names match a pattern, without those that are used."""
    taken = set(used)
    return [name for name in sorted(image.names) if name not in taken and pattern.search(image.place(name).lower())]


def _unused(image: Image, colour: Colour, depth: Found, motion: Found | None, options: ReadOptions) -> list[str]:
    """Return warnings of channels that look like alpha or motion, or a part of it, and are not used."""
    used = {*colour.names, *depth.channels, *(motion.channels if motion else ())}
    found: list[str] = []
    # Motion, or a part of it.
    if motion is None and options.motion_channels is None:
        like = _like(image, MOTION_LIKE, used)
        if like:
            found.append(
                f"no motion was recognised, but {', '.join(like)} may be motion; say {option('motion_channels')} and "
                f"{option('motion_convention')} (or {option('motion_channels')} {_none()} to go without)"
            )
    told = options.motion_channels is not None or options.motion_convention is not None
    if motion is not None and not told and (third := _third_component(motion)) is not None:
        found.append(
            f"{third} beside the motion {', '.join(motion.channels)} is not used; if the three are a velocity in "
            f"space, say {option('motion_convention')} camera-velocity, if not, {motion.convention} silences this"
        )
    # Alpha.
    if not colour.alpha:
        coloured = _coloured_prefixes(image)
        like = [name for name in _like(image, ALPHA_LIKE, used) if _parent_of(image, name) not in coloured]
        if like:
            found.append(f"no alpha was recognised, but {', '.join(like)} may be alpha; say {option('alpha_channel')}")
    return found


def _third_component(motion: Found) -> str | None:
    """Return the third component of motion of which two are used, unless it is the same everywhere, as a filler is."""
    first, *others = motion.channels
    third = first[:-1] + THIRD_COMPONENTS.get(first[-1:], "")
    if len(others) != 1 or third == first[:-1] or third not in motion.image.planes:
        return None
    values = motion.image.planes[third].pixels
    values = values[np.isfinite(values)]
    return third if values.size and values.min() < values.max() else None


def _none() -> str:
    return "()" if option("motion_channels") == "motion_channels" else "none"


def _parent_of(image: Image, name: str) -> str:
    return _parent(image.place(name).lower() + ".")
