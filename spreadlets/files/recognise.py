"""What the channels of a file mean: colour, depth and motion, by name, by preset, or as the caller says."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from spreadlets.arrays import FloatArray
from spreadlets.errors import InvalidParameterError
from spreadlets.files.conventions import (
    DEPTH_CONVENTIONS,
    MOTION_CONVENTIONS,
    OWN,
    PRESETS,
    UNCLEAR,
    Scale,
    check_choice,
)
from spreadlets.files.exr_parts import Image

COLOUR_NAMES = ("Combined.", "rgba.", "beauty.", "")
"""What stands before R, G, B in the main image, behind any layer prefix, if there are no plain R, G, B; first wins."""

INVERSE_LIMIT = 1.0
INVERSE_RATIO = 4.0
"""Depth that stays below the limit, and varies by this ratio or more, could as well be 1 over the depth."""

MotionRow = tuple[tuple[str, ...], str, str]
"""Names of the channels, their convention, and what is doubtful about it."""


@dataclass(frozen=True)
class ReadOptions:
    """What the caller says about a file; every field may be left open.

    Attributes
    ----------
    preset : str or None
        A key of `PRESETS`: look for that renderer's channels only.
    colour_layer, depth_channel : str or None
        The colour channels' prefix, and the depth channel's name.
    motion_channels : tuple of str or None
        The motion channels in the convention's order; empty for none, though the file may have some.
    depth_convention, motion_convention : str or None
        Keys of `DEPTH_CONVENTIONS` and `MOTION_CONVENTIONS`.
    unpremultiplied : bool
        Whether the colours are not multiplied by alpha yet.
    scale : Scale
        Camera and units.
    """

    preset: str | None = None
    colour_layer: str | None = None
    depth_channel: str | None = None
    motion_channels: tuple[str, ...] | None = None
    depth_convention: str | None = None
    motion_convention: str | None = None
    unpremultiplied: bool = False
    scale: Scale = field(default_factory=Scale)

    def __post_init__(self) -> None:
        check_choice("preset", self.preset, PRESETS)
        check_choice("depth_convention", self.depth_convention, DEPTH_CONVENTIONS)
        check_choice("motion_convention", self.motion_convention, MOTION_CONVENTIONS)


@dataclass(frozen=True)
class Found:
    """Channels with their convention.

    Attributes
    ----------
    channels : tuple of str
        Full names in the file.
    convention : str
        How to read them.
    doubt : str
        What the user should be warned of; empty if nothing.
    """

    channels: tuple[str, ...]
    convention: str
    doubt: str = ""


def find_colour(image: Image, options: ReadOptions) -> tuple[str, ...]:
    """Return the names of R, G, B and, if there is one, A.

    Raises
    ------
    InvalidFileError
        If they are missing or ambiguous.
    """
    prefixes = (PRESETS[options.preset].colour, *COLOUR_NAMES) if options.preset else COLOUR_NAMES
    if options.colour_layer is not None:
        groups = [tuple(f"{options.colour_layer}.{name}" for name in "RGB")]
        if not set(groups[0]) <= image.planes.keys():
            raise image.problem(f"lacks {', '.join(groups[0])}", "colour_layer")
    elif {"R", "G", "B"} <= image.planes.keys():
        groups = [("R", "G", "B")]
    else:
        known = (_groups(image, [prefix + name for name in "RGB"]) for prefix in prefixes)
        groups = next((groups for groups in known if groups), [])
    if len(groups) != 1:
        raise image.problem("the colour channels are ambiguous" if groups else "lacks colour channels", "colour_layer")
    alpha = groups[0][0][:-1] + "A"
    return (*groups[0], alpha) if alpha in image.planes else groups[0]


def find_depth(image: Image, colour: Sequence[str], options: ReadOptions) -> Found:
    """Return the depth channel and its convention.

    Raises
    ------
    InvalidFileError
        If it is missing or ambiguous.
    """
    found: dict[str, str] = {}
    for rows in _depth_tables(options.preset):
        found = {name: convention for row, convention in rows for name in _depth_names(image, row, colour)}
        if options.depth_channel is not None:
            found = {name: convention for name, convention in found.items() if name == options.depth_channel}
        if found:
            break
    if options.depth_channel is not None:
        if options.depth_channel not in image.planes:
            raise image.problem(f"lacks the depth channel {options.depth_channel}", "depth_channel")
        found = found or {options.depth_channel: "planar"}
    if len(found) != 1:
        what = f"has several depth channels ({', '.join(found)})" if found else "lacks a depth channel"
        raise image.problem(what, "depth_channel")
    ((name, convention),) = found.items()
    if options.depth_convention is not None:
        return Found((name,), options.depth_convention)
    return Found((name,), convention, PRESETS[options.preset].depth_doubt if options.preset else "")


def find_motion(image: Image, options: ReadOptions) -> Found | None:
    """Return the motion channels and their convention, or None if the file has no motion.

    Raises
    ------
    InvalidFileError
        If channels that were asked for are missing, or it is not clear which are meant.
    InvalidParameterError
        If the convention takes another number of channels than are named.
    """
    presets = [PRESETS[options.preset]] if options.preset else [OWN, *PRESETS.values(), UNCLEAR]
    rows: list[MotionRow] = [(*row, preset.motion_doubt) for preset in presets for row in preset.motion]
    if options.motion_channels == ():
        return None
    if options.motion_channels is not None:
        return _given_motion(image, options.motion_channels, rows, options.motion_convention)
    if options.motion_convention is not None:
        return _motion_of_convention(image, rows, options.motion_convention)
    found = _matches(image, rows)
    if len(found) > 1:
        names = " or ".join(", ".join(item.channels) for item in found)
        raise image.problem(f"has several sets of motion channels ({names})", "motion_channels or motion_convention")
    return found[0] if found else None


def depth_warning(name: str, found: Found, stored: FloatArray, alpha: FloatArray | None, told: bool) -> str:
    """Return a warning if a depth channel's values look like another convention than the one assumed, else "".

    Parameters
    ----------
    name : str
        The file's name, for the message.
    found : Found
        The depth channel.
    stored : ndarray of shape (H, W)
        Its values.
    alpha : ndarray of shape (H, W) or None
        Where it is 0 the values do not count.
    told : bool
        Whether the caller named the convention or the renderer.
    """
    if told or found.convention != "planar":
        return ""
    values = stored[np.isfinite(stored) & (True if alpha is None else alpha > 0)]
    if values.size == 0 or values.min() < 0:
        return ""
    channel = found.channels[0]
    remedy = "say depth_convention inverse if it is 1 over the depth, planar if it is not"
    zeros = int(np.count_nonzero(values == 0))
    if 0 < zeros < values.size:
        return f"{name}: {channel} is 0 at {zeros} pixels, as where 1 over the depth of the background is; {remedy}"
    if 0 < values.max() <= INVERSE_LIMIT and values.max() >= INVERSE_RATIO * values.min():
        span = f"{values.min():.3g} to {values.max():.3g}"
        return f"{name}: {channel} holds {span}, taken for planar metres; {remedy}"
    return ""


def _groups(image: Image, names: Sequence[str]) -> list[tuple[str, ...]]:
    """Return every set of channels that carries these names behind one prefix, without regard to case."""
    actual = {name.lower(): name for name in sorted(image.planes, reverse=True)}
    lowered = [name.lower() for name in names]
    heads = [name for name in actual if name == lowered[0] or name.endswith("." + lowered[0])]
    prefixes = [head.removesuffix(lowered[0]) for head in heads]
    groups = [[prefix + name for name in lowered] for prefix in prefixes]
    found = [tuple(actual[name] for name in group) for group in groups if all(name in actual for name in group)]
    return sorted(found)


def _depth_tables(preset: str | None) -> list[list[tuple[str, str]]]:
    """Return depth rows in groups, the preferred group first: a renderer's own, or planar ones before the others."""
    if preset is not None:
        return [[row] for row in PRESETS[preset].depth]
    rows = [row for known in [OWN, *PRESETS.values()] for row in known.depth]
    planar = {name.lower(): (name, "planar") for name, convention in reversed(rows) if convention == "planar"}
    return [list(planar.values()), [row for row in rows if row[0].lower() not in planar]]


def _depth_names(image: Image, row: str, colour: Sequence[str]) -> list[str]:
    """Return the channels of a depth row; a bare name counts by itself or beside the colour (normals have a Z, too)."""
    groups = [group[0] for group in _groups(image, (row,))]
    if "." in row:
        return groups
    beside = colour[0][:-1].lower()
    return [name for name in groups if name.lower() in (row.lower(), beside + row.lower())]


def _matches(image: Image, rows: Iterable[MotionRow]) -> list[Found]:
    """Return the sets of channels that are there; one that extends another is the one that was meant."""
    found: dict[tuple[tuple[str, ...], str], Found] = {}
    for names, convention, doubt in rows:
        for group in _groups(image, names):
            found.setdefault((group, convention), Found(group, convention, doubt))
    sets = [set(item.channels) for item in found.values()]
    return [item for item in found.values() if not any(set(item.channels) < other for other in sets)]


def _motion_of_convention(image: Image, rows: Sequence[MotionRow], convention: str) -> Found:
    """Return the channels to read by a given convention: those of its own names, else any others of that number."""
    own = _matches(image, [row for row in rows if row[1] == convention])
    n_channels = MOTION_CONVENTIONS[convention].n_channels
    found = own or _matches(image, [row for row in rows if len(row[0]) == n_channels])
    groups = list(dict.fromkeys(item.channels for item in found))
    if len(groups) > 1:
        names = " or ".join(", ".join(group) for group in groups)
        raise image.problem(f"has several sets of motion channels ({names})", "motion_channels")
    if not groups:
        raise image.problem(f"lacks the motion channels of the convention {convention}", "motion_channels")
    return Found(groups[0], convention)


def _given_motion(image: Image, channels: tuple[str, ...], rows: Sequence[MotionRow], convention: str | None) -> Found:
    """Return explicitly named channels with the given convention, or with the one that their names have."""
    missing = [name for name in channels if name not in image.planes]
    if missing:
        raise image.problem(f"lacks the motion channel {', '.join(missing)}", "motion_channels")
    if convention is not None:
        expected = MOTION_CONVENTIONS[convention].n_channels
        if len(channels) != expected:
            raise InvalidParameterError(
                f"motion_channels names {len(channels)} channels; the motion_convention {convention} takes {expected}"
            )
        return Found(channels, convention)
    for names, known, doubt in rows:
        if channels in _groups(image, names):
            return Found(channels, known, doubt)
    raise image.problem(f"the meaning of {', '.join(channels)} is not known", "motion_convention")
