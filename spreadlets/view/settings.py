"""What the page may ask for: every number checked, and turned into a camera, options and an aperture."""

from __future__ import annotations

import math
import shlex
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, Self

from spreadlets.bokeh import bokeh_model
from spreadlets.errors import InvalidParameterError, option
from spreadlets.models import Model
from spreadlets.scene.camera import ThinLens

DEGREES_PER_FRAME = 360.0
OVERLAYS = ("none", "coc", "depth")
EVERYWHERE, IN_CORNERS = "everywhere", "corners"
CHOICES: Mapping[str, tuple[str, ...]] = {"overlay": OVERLAYS, "cats_eye_at": (EVERYWHERE, IN_CORNERS)}
"""What may be chosen of each setting that is no number."""

BOUNDS: Mapping[str, tuple[float, float]] = {
    "f_number": (1e-3, 1e3),
    "focal_length": (1.0, 5000.0),
    "focus": (1e-3, 1e9),
    "shutter": (0.0, 720.0),
    "exposure": (-20.0, 20.0),
    "blades": (0, 64),
    "rotation": (-360.0, 360.0),
    "cats_eye": (0.0, 1.9),
    "squeeze": (0.25, 1.0),
    "layers": (0, 64),
    "near_strength": (0.0, 100.0),
    "far_strength": (0.0, 100.0),
    "max_coc": (0.0, 1e4),
    "gain": (0.0, 1e4),
    "threshold": (0.0, 1e6),
    "near": (0.0, 1e9),
    "far": (0.0, 1e9),
}
"""Least and largest value of each number; the largest focus stands for infinity."""


LABELS: Mapping[str, str] = {
    "f_number": "f-number",
    "in_focus": "Sharp from and to",
    "max_coc": "Largest CoC",
    "cats_eye": "Cat's eye",
    "gain": "Highlight gain",
    "near": "Sharp from",
    "far": "Sharp to",
}
"""Names of the settings on the page, where they are not those of here with blanks."""


def spelled(name: str) -> str:
    """Return the name of a setting as it stands on the page."""
    return LABELS.get(name, name.replace("_", " ").capitalize())


@dataclass(frozen=True)
class Settings:
    """What is chosen on the page.

    Attributes
    ----------
    f_number, focal_length, focus : float
        Of the lens; mm and metres.
    shutter : float
        Degrees.
    exposure : float
        Stops by which the picture is shown brighter.
    blades, rotation, cats_eye, squeeze : float
        Of the aperture; see `spreadlets.models.SimpleLens`.
    kernel : str
        Path of an image of the PSF on this machine; none if empty.
    layers : float
        Depth layers; 0 as many as the frame needs.
    near_strength, far_strength, max_coc, gain, threshold, near, far : float
        See `spreadlets.runtime.controls.Controls`; 0 is off for the largest CoC and for ``far``.
    cats_eye_at : str
        Whether the cat's eye is the same everywhere, or grows to what it is in the corners.
    overlay : str
        One of `OVERLAYS`.
    """

    f_number: float
    focal_length: float
    focus: float
    shutter: float
    exposure: float = 0.0
    blades: float = 0
    rotation: float = 0.0
    cats_eye: float = 0.0
    squeeze: float = 1.0
    kernel: str = ""
    layers: float = 0
    near_strength: float = 1.0
    far_strength: float = 1.0
    max_coc: float = 0.0
    gain: float = 1.0
    threshold: float = 1.0
    near: float = 0.0
    far: float = 0.0
    cats_eye_at: str = EVERYWHERE
    overlay: str = "none"

    @classmethod
    def of_camera(cls, camera: ThinLens) -> Self:
        """Return what the page begins with."""
        focus = min(camera.focus_distance_m, BOUNDS["focus"][1])
        degrees = camera.shutter_duration * DEGREES_PER_FRAME
        return cls(camera.f_number, camera.focal_length_mm, focus, degrees)

    def changed(self, given: Mapping[str, Any]) -> Self:
        """Return settings of which some are given by a message.

        Raises
        ------
        InvalidParameterError
            If there is no such setting, or a value is not allowed.
        """
        numbers: dict[str, Any] = {}
        for name, value in given.items():
            if name in CHOICES:
                if value not in CHOICES[name]:
                    raise InvalidParameterError(f"{option(name)} is {value!r}: allowed are {', '.join(CHOICES[name])}")
                numbers[name] = value
            elif name in BOUNDS:
                numbers[name] = checked(name, value, *BOUNDS[name])
            else:
                raise InvalidParameterError(f"there is no setting {name!r}")
        return replace(self, **numbers)

    def with_kernel(self, path: str) -> Self:
        """Return the settings with an image of the PSF."""
        return replace(self, kernel=path)

    def camera(self, base: ThinLens) -> ThinLens:
        """Return the camera, its lens held, with the sensor, the move and the middle of the shutter of another."""
        half, centre = 0.5 * self.shutter / DEGREES_PER_FRAME, base.shutter_centre
        focus = self.focus if self.focus < BOUNDS["focus"][1] else math.inf
        held = base.held(f_number=self.f_number, focal_length_mm=self.focal_length, focus_distance_m=focus)
        return replace(held, shutter=(centre - half, centre + half))

    def options(self) -> dict[str, Any]:
        """Return the options of rendering that are not the default."""
        found: dict[str, Any] = {"layers": int(self.layers) or None, "max_coc": self.max_coc or None}
        if self.far > 0.0:
            found["in_focus"] = self.near, self.far
        if self.gain != 1.0:
            found["highlights"] = self.gain, self.threshold
        for name in ("near_strength", "far_strength"):
            found[name] = getattr(self, name) if getattr(self, name) != 1.0 else None
        return {name: value for name, value in found.items() if value is not None}

    def shape(self) -> dict[str, Any]:
        """Return the options of the aperture that are not the default."""
        if self.kernel:
            return {"kernel": self.kernel}
        given = {"blades": int(self.blades), "rotation": self.rotation, "cats_eye": self.cats_eye}
        found: dict[str, Any] = {name: value for name, value in given.items() if value}
        if not self.blades:
            found.pop("rotation", None)
        if self.cats_eye and self.cats_eye_at == IN_CORNERS:
            found["cats_eye_radial"] = True
        return found | ({"squeeze": self.squeeze} if self.squeeze != 1.0 else {})

    def model(self, *, moving: bool) -> Model | None:
        """Return the model of the aperture; None if it is round."""
        shape = self.shape()
        return bokeh_model(moving=moving, **shape) if shape else None

    @property
    def rendering(self) -> tuple[Any, ...]:
        """What the picture depends on before it is shown."""
        return tuple(getattr(self, each.name) for each in fields(self) if each.name not in ("exposure", "overlay"))

    def command_line(self, frames: list[str], camera: str | None, base: ThinLens) -> str:
        """Return the command that makes the picture."""
        words = ["spreadlets", "synth", *frames, "-o", "out.exr"]
        words += ["--camera", camera] if camera else ["--sensor-width", f"{base.sensor_width_mm:g}"]
        own = self.camera(base)
        words += ["--f-number", f"{self.f_number:.6g}", "--focal-length", f"{self.focal_length:.6g}"]
        words += ["--focus", f"{own.focus_distance_m:.6g}", "--shutter", f"{own.shutter[0]:.6g},{own.shutter[1]:.6g}"]
        for name, value in (self.options() | self.shape()).items():
            words.append("--" + name.replace("_", "-"))
            if value is not True:
                text = ",".join(f"{each:.6g}" for each in value) if isinstance(value, tuple) else value
                words.append(f"{text:.6g}" if isinstance(text, float) else str(text))
        return shlex.join(words)


def checked(name: str, value: Any, least: float, most: float) -> float:
    """Return a number of a message.

    Raises
    ------
    InvalidParameterError
        If it is none, or out of its range.
    """
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InvalidParameterError(f"{option(name)} is {value!r}: needed is a number")
    if not least <= value <= most:
        raise InvalidParameterError(f"{option(name)} is {value:g}: allowed are {least:g} to {most:g}")
    return float(value)
