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

bit_depth_option = cloup.option(
    "--bit-depth", type=click.INT, metavar="BITS", help="8 (default) or 16 of .png and .tif, 32 or 16 of .exr."
)

input_options = cloup.option_group(
    "Reading the frame (what is not given is recognised)",
    cloup.option(
        "--preset", type=TableChoice("spreadlets.files.conventions", "PRESETS"), help="The renderer that wrote it."
    ),
    cloup.option("--view", help="View of a stereo file (default: the hero view)."),
    cloup.option("--colour-layer", metavar="NAME,...", help="Colour layer; several are depth layers, nearest first."),
    cloup.option("--alpha-channel", help="Name of the alpha channel."),
    cloup.option("--depth-channel", help="Name of the depth channel."),
    cloup.option(
        "--depth-convention",
        type=TableChoice("spreadlets.files.conventions", "DEPTH_CONVENTIONS"),
        help="planar, ray (distance along the ray), inverse (1/depth) or disparity.",
    ),
    cloup.option(
        "--depth-scale",
        type=float,
        default=1.0,
        show_default=True,
        help="Metres per unit of depth; below 0 turns the sign.",
    ),
    cloup.option("--background-depth", metavar="VALUE", help="Depth of background: a number, nan, <X or >X."),
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
    *(
        cloup.option(f"--{name}", f"{name}_file", metavar="FILE[:CHANNELS]", help=f"File of the {what}, if apart.")
        for name, what in (("depth", "depth"), ("motion", "motion"), ("alpha", "alpha"))
    ),
    cloup.option("--deep-layers", "max_layers", type=click.IntRange(min=1), help="Most layers of a deep image (8)."),
    cloup.option("--repair", is_flag=True, help="Mend pixels with invalid values instead of refusing the frame."),
)
"""How to read a frame."""

SPELLED = {
    "baseline_m": "--baseline",
    "max_layers": "--deep-layers",
    "depth_file": "--depth",
    "motion_file": "--motion",
    "alpha_file": "--alpha",
    "focal_length_mm": "--focal-length",
    "sensor_width_mm": "--sensor-width",
    "focus_distance_m": "--focus",
    "defocus": "--no-defocus",
    "motion": "--no-motion",
    "calibrate": "--no-calibrate",
}
"""Options that are not called after the parameter that they set."""

READ_NAMES = tuple(
    "preset view colour_layer alpha_channel depth_channel depth_convention depth_scale background_depth baseline_m "
    "motion_channels motion_convention max_displacement unpremultiplied depth_file motion_file alpha_file max_layers "
    "repair".split()
)
CAMERA_CURVE = "camera_shutter_curve"
"""Parameter of commands that have an option for a camera's shutter curve; a model to build has one of its own."""
CAMERA_NAMES = ("focal_length_mm", "sensor_width_mm", "sensor_fit", "f_number", "focus_distance_m", "shutter")


def spelled(name: str) -> str:
    """Return an option as it is typed, of the parameter that it sets."""
    return SPELLED.get(name, "--" + name.replace("_", "-"))


def take_reading(options: dict[str, Any]) -> dict[str, Any]:
    """Take the options of reading a frame out of a command's, as `ReadOptions` takes them; what is not given is not."""
    taken = {name: options.pop(name) for name in READ_NAMES if name in options}
    taken = {name: value for name, value in taken.items() if value is not None}
    if names := taken.get("motion_channels"):
        taken["motion_channels"] = () if names == "none" else _listed(names)
    if "," in (layer := taken.get("colour_layer", "")):
        taken["colour_layer"] = _listed(layer)
    for name, channels in (("depth", "depth_channel"), ("alpha", "alpha_channel"), ("motion", "motion_channels")):
        path, colon, chosen = taken.get(f"{name}_file", "").rpartition(":")
        if colon and len(path) > 1:  # a single letter is a drive
            taken[f"{name}_file"] = path
            taken[channels] = _listed(chosen) if name == "motion" else chosen
    return taken


def _listed(names: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in names.split(","))


def take_camera(options: dict[str, Any]) -> dict[str, Any]:
    """Take the single values of a camera out of a command's options; what is not given is not."""
    taken = {name: options.pop(name) for name in CAMERA_NAMES if name in options}
    taken["shutter_curve"] = options.pop(CAMERA_CURVE, None)
    if taken.get("focus_distance_m") is not None and options.get("focus_at") is not None:
        raise click.UsageError("--focus and --focus-at exclude each other: give the distance, or the pixel")
    return {name: value for name, value in taken.items() if value is not None}


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


CAMERA = (
    cloup.option(
        "--camera", metavar="FILE", help="JSON, OpenEXR with camera attributes, or USD[:/PRIM] (default: the frame's)."
    ),
    cloup.option("--focal-length", "focal_length_mm", type=float, metavar="MM", help="Focal length."),
    cloup.option("--sensor-width", "sensor_width_mm", type=float, metavar="MM", help="Sensor's width (default: 36)."),
    cloup.option(
        "--sensor-fit",
        type=click.Choice(["horizontal", "vertical", "auto"]),
        help="Side of the frame that the sensor spans; auto is the longer.",
    ),
    cloup.option("--f-number", type=float, metavar="N", help="Focal length over aperture."),
    cloup.option("--focus", "focus_distance_m", type=float, metavar="M", help="Distance in focus, metres."),
    cloup.option("--shutter", metavar="ANGLE|OPEN,CLOSE", help="180deg, or times in frames (default: 180deg)."),
)

camera_options = cloup.option_group("Camera", *CAMERA)
"""Which lens and shutter; single values override those of the file."""

drawn_camera_options = cloup.option_group(
    "Camera",
    *CAMERA,
    cloup.option(
        "--shutter-curve",
        CAMERA_CURVE,
        metavar="CURVE",
        help="How far the shutter is open over its time: 0,1,1,0.5 or trapezoid:RISE,FALL (default: fully).",
    ),
)
"""The same for commands that draw: how far the shutter is open over its time."""


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
        bit_depth_option,
        cloup.option("--reference", type=click.Path(dir_okay=False), help="Compare the result with this image."),
        *further,
    )


SEQUENCE_NAMES = ("frames", "overwrite", "jobs", "scheduler")

sequence_options = cloup.option_group(
    "Sequences",
    cloup.option("--frames", "only_frames", help="Frames to make, such as 1-24, 1-24x2 or 1,5,9-12 (default: all)."),
    cloup.option("--overwrite", is_flag=True, help="Make frames again whose results exist."),
    cloup.option("--jobs", type=click.IntRange(min=1), help="Processes that make frames (default: 1)."),
    cloup.option("--scheduler", metavar="ADDRESS", help="A Dask scheduler, whose workers make frames (HOST:PORT)."),
)
"""Which frames of a sequence, and who makes them."""


def take_sequence(options: dict[str, Any]) -> dict[str, Any]:
    """Take the options of a sequence out of a command's; what is not given is not."""
    options["frames"] = options.pop("only_frames")
    taken = {name: options.pop(name) for name in SEQUENCE_NAMES}
    return {name: value for name, value in taken.items() if value}
