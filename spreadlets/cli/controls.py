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

BOKEH_NAMES = (
    "kernel blades blade_curvature rotation cats_eye cats_eye_angle cats_eye_radial squeeze"
    " spherical_aberration obstruction".split()
)

bokeh_options = cloup.option_group(
    "Bokeh (in place of a database; what the frame needs is built once, and kept)",
    cloup.option("--blades", type=click.IntRange(min=0), help="Edges of the aperture (0: round)."),
    cloup.option("--blade-curvature", type=float, help="... from 0 (straight edges) to 1 (round)."),
    cloup.option("--rotation", type=float, help="... of the blades, degrees."),
    cloup.option("--cats-eye", type=float, help="Distance of a second, clipping circle, radii."),
    cloup.option("--cats-eye-angle", type=float, help="... its direction, degrees."),
    cloup.option("--cats-eye-radial", is_flag=True, default=None, help="... growing from the middle to the corners."),
    cloup.option("--squeeze", type=float, help="Width over height of an anamorphic PSF."),
    cloup.option("--spherical-aberration", type=float, help="Above 0: dark rim behind focus, bright in front."),
    cloup.option("--obstruction", type=float, help="Radius of a central obstruction, radii."),
    cloup.option("--kernel", type=click.Path(dir_okay=False), metavar="PNG", help="An image as the PSF; no motion."),
)
"""The shape of the aperture."""


def take_bokeh(options: dict[str, Any], database: str | None) -> dict[str, Any]:
    """Take the shape of the aperture out of a command's options; what is not given is not."""
    taken = {name: options.pop(name) for name in BOKEH_NAMES if name in options}
    taken = {name: value for name, value in taken.items() if value is not None}
    if not taken:
        return {}
    first = "--" + next(iter(taken)).replace("_", "-")
    if database:
        raise click.UsageError(f"{first} and --db exclude each other: a database has its own aperture")
    if "kernel" in taken and len(taken) > 1:
        raise click.UsageError("--kernel is the whole PSF: leave the other options of the aperture out")
    return taken
