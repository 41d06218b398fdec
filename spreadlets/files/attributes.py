"""Header attributes that go from a frame's file to the result's: byte for byte, whatever their type.

The OpenEXR binding cannot write every type that it reads; so a file is written first, and its attributes put in.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Mapping, Sequence

from spreadlets.arrays import PathLike
from spreadlets.files.exr_chunks import add_attributes
from spreadlets.scene.raster import Attribute

FILE_ATTRIBUTES = frozenset(
    {
        "channels",
        "chunkCount",
        "compression",
        "dataWindow",
        "deepImageState",
        "displayWindow",
        "dwaCompressionLevel",
        "lineOrder",
        "maxSamplesPerPixel",
        "name",
        "pixelAspectRatio",
        "preview",
        "tiles",
        "type",
        "version",
    }
)
"""Header attributes that describe the file's own pixels; other values there would break it, or be wrong."""

WRITTEN_BY_LIBRARY = frozenset({"screenWindowCenter", "screenWindowWidth"})
"""Attributes that every file has, so that the library writes its own values."""

CHROMATICITIES = "<8f"
"""x and y of red, green, blue and white."""


def carried_attributes(stored: Mapping[str, Attribute]) -> dict[str, Attribute]:
    """Return those of a part's attributes that do not describe its own pixels."""
    return {name: attribute for name, attribute in stored.items() if name not in FILE_ATTRIBUTES}


def carry_attributes(path: PathLike, parts: Sequence[Mapping[str, Attribute]]) -> None:
    """Put attributes into the headers of a file of scanlines, one mapping for each part; what is there already stays.

    Parameters
    ----------
    path : path
        A file that is written and not yet in its place.
    parts : sequence of mapping
        As from `carried_attributes`.
    """
    if any(parts):
        add_attributes(os.fspath(path), parts, replacing=WRITTEN_BY_LIBRARY)


def chromaticities(attributes: Mapping[str, Attribute]) -> tuple[float, ...] | None:
    """Return x and y of red, green, blue and white, if a header gives them."""
    found = attributes.get("chromaticities")
    if found is None or len(found.value) != struct.calcsize(CHROMATICITIES):
        return None
    return struct.unpack(CHROMATICITIES, found.value)
