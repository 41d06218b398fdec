"""Colour spaces by the names that OpenColorIO knows, for photographs that are in none that a profile tells.

The names are those of the configuration that the environment variable ``OCIO`` names, or else of the one that comes
with OpenColorIO.
"""

from __future__ import annotations

import os
from difflib import get_close_matches
from typing import Any

import numpy as np

from spreadlets.arrays import FloatArray
from spreadlets.errors import InvalidParameterError
from spreadlets.packages import optional_package

BUILT_IN = "ocio://default"
LINEAR = "Linear Rec.709 (sRGB)"
"""What all else here works in, by the name that OpenColorIO itself has for it, whatever the configuration."""


def to_linear(values: FloatArray, space: str) -> FloatArray:
    """Return colours (H, W, 3) of a space as linear light in the primaries of sRGB, float32.

    Raises
    ------
    InvalidParameterError
        If the configuration has no such space.
    MissingPackageError
        If OpenColorIO is missing.
    """
    library, config = _configuration(space)
    return _applied(library.Config.GetProcessorToBuiltinColorSpace(config, space, LINEAR), values)


def from_linear(values: FloatArray, space: str) -> FloatArray:
    """Return linear light (H, W, 3) in the primaries of sRGB as the colours of a space, float32; errors as above."""
    library, config = _configuration(space)
    return _applied(library.Config.GetProcessorFromBuiltinColorSpace(LINEAR, config, space), values)


def check_space(space: str) -> None:
    """Raise an error if there is no such space; errors as those of `to_linear`."""
    _configuration(space)


def _configuration(space: str) -> tuple[Any, Any]:
    """Return the library and its configuration, which has this space."""
    library = optional_package("PyOpenColorIO", "photo", f"the colour space {space!r}")
    source = os.environ.get("OCIO") or BUILT_IN
    try:
        config = library.Config.CreateFromFile(source)
    except (library.Exception, library.ExceptionMissingFile) as error:
        raise InvalidParameterError(f"OCIO is {source!r}: no configuration can be read there: {error}") from error
    if config.getColorSpace(space) is None:
        names = list(config.getColorSpaceNames())
        likely = get_close_matches(space, names, cutoff=0.3) or names[:8]
        raise InvalidParameterError(f"there is no colour space {space!r} in {source}; it has {', '.join(likely)}, ...")
    return library, config


def _applied(processor: Any, values: FloatArray) -> FloatArray:
    colours = np.array(values, np.float32, order="C")
    processor.getDefaultCPUProcessor().applyRGB(colours)
    return colours
