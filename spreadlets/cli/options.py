"""Options that commands share, in groups by what they are for; choices come from the tables that carry them out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from typing import Any

import click
import cloup

Command = Callable[..., Any]


class TableChoice(click.Choice[str]):
    """A choice among the names of a table, whose module is loaded when it is first asked for them.

    Parameters
    ----------
    module : str
        The module of the table.
    table : str
        Its name there: a mapping, or a sequence of names.
    """

    def __init__(self, module: str, table: str) -> None:
        self.module, self.table = module, table
        super().__init__(())

    @property
    def choices(self) -> tuple[str, ...]:
        """The allowed names."""
        names: Mapping[str, object] | Sequence[str] = getattr(import_module(self.module), self.table)
        return tuple(names)

    @choices.setter
    def choices(self, names: tuple[str, ...]) -> None:
        """Take no notice: the table is asked each time."""


json_option = cloup.option("--json", "as_json", is_flag=True, help="Print one JSON object on standard output.")

input_options = cloup.option_group(
    "Reading the frame (what is not given is recognised)",
    cloup.option(
        "--preset", type=TableChoice("spreadlets.files.conventions", "PRESETS"), help="The renderer that wrote it."
    ),
    cloup.option("--colour-layer", help="Name of the colour layer, if there are several."),
    cloup.option("--depth-channel", help="Name of the depth channel, if it is not recognised."),
    cloup.option(
        "--depth-convention",
        type=TableChoice("spreadlets.files.conventions", "DEPTH_CONVENTIONS"),
        help="planar, ray (distance along the ray), inverse (1/depth) or disparity.",
    ),
    cloup.option("--depth-scale", type=float, default=1.0, show_default=True, help="Metres per unit of depth."),
    cloup.option("--baseline", "baseline_m", type=float, help="Distance of the two cameras, metres, for disparity."),
    cloup.option("--motion-channels", help="Names of the motion channels, separated by commas; none ignores them."),
    cloup.option(
        "--motion-convention",
        metavar="NAME",
        help="DIRECTION-UNIT[-up] with forward or backward, and px, ndc, uv, norm, norm8 or norm16; blender, nuke, "
        "nuke-forward, nuke-backward, curved-px, camera-velocity, camera-velocity-sum or ndc.",
    ),
    cloup.option("--max-displacement", type=float, help="Motion in px at the end of a normalised range."),
    cloup.option("--unpremultiplied", is_flag=True, help="The colours are not multiplied by alpha."),
)
"""How to read a frame."""


def input_settings(options: dict[str, Any]) -> dict[str, Any]:
    """Return the options of reading a frame as `read_frame` takes them."""
    names = options["motion_channels"]
    channels = () if names == "none" else tuple(names.split(",")) if names else None
    return options | {"motion_channels": channels}


def splatting_options(*, layers: str, fireflies: str) -> Callable[[Command], Command]:
    """Return the options of quality and speed; the words are what differs between commands."""
    return cloup.option_group(
        "Quality and speed",
        cloup.option(
            "--integrator",
            type=TableChoice("spreadlets.runtime.options", "INTEGRATORS"),
            help="Poisson solver (default: multigrid).",
        ),
        cloup.option("--cycles", type=click.IntRange(min=0), help="Cycles of the integrator multigrid."),
        cloup.option(
            "--tolerance", type=float, help="Display error to trade for speed; 0 draws every pixel by itself."
        ),
        cloup.option("--layers", type=click.IntRange(min=1), help=f"Depth layers (default: {layers})."),
        cloup.option(
            "--softness",
            type=float,
            help="Transition between depth layers: 0 (hard, a frame's default) to 1 (soft, that of samples).",
        ),
        cloup.option("--firefly-clamp", type=float, metavar="FACTOR", help=fireflies),
    )


camera_options = cloup.option_group(
    "Camera",
    cloup.option("--camera", required=True, type=click.Path(dir_okay=False), help="Camera file (JSON)."),
)
"""Which lens and shutter."""


def effect_options(verb: str) -> Callable[[Command], Command]:
    """Return the options that switch an effect off, by the names that the public functions have for them."""

    def off(name: str, what: str) -> Callable[[Command], Command]:
        switch = cloup.option(
            f"--no-{name}", name, is_flag=True, flag_value=False, default=True, help=f"{verb} {what} out."
        )
        return switch

    return cloup.option_group("Effects", off("defocus", "depth of field"), off("motion", "motion blur"))


def output_options(what: str, *further: Any) -> Callable[[Command], Command]:
    """Return the options of where the image goes, and what it is compared with."""
    return cloup.option_group(
        "Output",
        cloup.option("-o", "--output", required=True, type=click.Path(dir_okay=False), help=what),
        cloup.option("--reference", type=click.Path(dir_okay=False), help="Compare the result with this image."),
        *further,
    )
