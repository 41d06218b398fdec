"""Options for who chooses the look: where the focus is, how strong the blur, which part of the picture, how large."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import click
import cloup


class Numbers(click.ParamType[Any]):
    """Numbers with commas between them, as a tuple.

    Parameters
    ----------
    form : str
        What they are, such as ``X,Y``: their names, as many as there must be.
    kind : type
        Of each.
    """

    def __init__(self, form: str, kind: Callable[[str], float] = float) -> None:
        self.name, self.kind = form, kind

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the numbers, or fail with what is needed."""
        if isinstance(value, tuple):
            return value
        words = str(value).split(",")
        try:
            numbers = tuple(self.kind(word) for word in words)
        except ValueError:
            self.fail(f"{value!r} is not {self.name}", param, ctx)
        if len(numbers) != len(self.name.split(",")):
            self.fail(f"{value!r} has {len(numbers)} numbers; needed is {self.name}", param, ctx)
        return numbers


control_options = cloup.option_group(
    "Look",
    cloup.option("--focus-at", type=Numbers("X,Y"), metavar="X,Y", help="Focus on what lies at this pixel."),
    cloup.option("--in-focus", type=Numbers("NEAR,FAR"), metavar="NEAR,FAR", help="Keep these depths sharp, metres."),
    cloup.option("--near-strength", type=float, metavar="FACTOR", help="Blur in front of the focus, times that."),
    cloup.option("--far-strength", type=float, metavar="FACTOR", help="Blur behind the focus, times that."),
    cloup.option("--max-coc", type=float, metavar="PX", help="Largest radius of the blur."),
    cloup.option(
        "--highlights",
        type=Numbers("GAIN,THRESHOLD"),
        metavar="GAIN,THRESHOLD",
        help="Multiply blurred light above the threshold.",
    ),
    cloup.option(
        "--mask",
        type=click.Path(dir_okay=False),
        metavar="FILE",
        help="Keep sharp, and out of the blur, what is white.",
    ),
    cloup.option("--region", type=Numbers("X,Y,W,H", int), metavar="X,Y,W,H", help="Make this part of the picture."),
    cloup.option("--proxy", type=float, metavar="SHARE", help="Make a smaller picture, such as 0.5."),
)
"""What an artist changes."""
