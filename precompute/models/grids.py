"""The cells that a model with its options has, and the version of the algorithms that fill them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from spreadlets.errors import InvalidParameterError, option
from spreadlets.models import TYPES, option_names
from spreadlets.precompute.models.registry import REGISTRY
from spreadlets.psf.model import PsfGrid, get_model

ALGORITHM_VERSION = 7
"""Raise it when a change of tracing or sparsification makes finished cells of an interrupted build outdated."""


def model_grid(
    model: str,
    *,
    samples: int | None = None,
    max_coc: float | None = None,
    max_motion: float | None = None,
    **options: Any,
) -> PsfGrid:
    """Return the grid that a build with these arguments has; None stands for the model's own value.

    Raises
    ------
    InvalidParameterError
        If the model has no such range or option, or refuses its value.
    """
    given = {"max_coc": max_coc, "max_motion": max_motion}
    ranges = {key: value for key, value in given.items() if value is not None}
    if model in REGISTRY:
        check_ranges(ranges)
        for name in ranges.keys() - {each.name for each in fields(TYPES[model])}:
            raise InvalidParameterError(f"the model {model!r} has no {option(name)}")
    return PsfGrid.of(get_model(model, **ranges, settings=model_settings(model, options)), samples)


def check_ranges(ranges: Mapping[str, float]) -> None:
    """Raise InvalidParameterError unless the ends of a model's axes, by the names of their options, are possible."""
    for name, value in ranges.items():
        if not 0.0 < value < math.inf:
            raise InvalidParameterError(f"{option(name)} is {value:g}: it must be finite and above 0")


def model_settings(model: str, options: Mapping[str, Any]) -> dict[str, Any]:
    """Turn the options of a model into its settings; None stands for the model's own value.

    Raises
    ------
    InvalidParameterError
        If the model has no such option, or refuses its value.
    """
    if model not in REGISTRY:
        # The table of models gives the error.
        return {}
    given = {name: value for name, value in options.items() if value is not None}
    known = option_names(model)
    for name in given:
        if name not in known:
            own = ", ".join(map(option, known))
            raise InvalidParameterError(f"the model {model!r} has no {option(name)}; its own are: {own}")
    return REGISTRY[model].read_settings(**given)
