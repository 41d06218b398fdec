"""How to render: one set of options from the command line to the plan, with their names, ranges and defaults."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, TypedDict

import numpy as np

from spreadlets.arrays import FloatArray
from spreadlets.errors import InvalidParameterError, option
from spreadlets.runtime.controls import Controls, check_value

METHODS = ("spreadlets", "dense", "dense-rows", "gather")
"""Sparse Laplacian splatting; the same PSFs drawn in full, pixel by pixel or as differences along rows; filtering with
the PSF of the receiving pixel."""
INTEGRATORS = ("multigrid", "pyramid", "pyramid-f5", "pyramid-f7", "exact")
"""Poisson solvers, see `runtime.integrate.convolution_pyramid`."""
DEFAULT_INTEGRATOR = "multigrid"
DEFAULT_CYCLES = 1
"""One cycle leaves about 1e-4 of the image, which no display shows. The pyramid alone costs up to .0005 SSIM on frames
with strong highlights; a second cycle changes nothing that can be seen."""
DENOISERS = ("bm3d", "oidn")
"""Optional packages, see `runtime.finish.denoise`."""

LAYERED_METHODS = ("sheared", "axis-aligned", "lrdm", "lrdm-sheared", "lrdm-ewa")
"""Layered reconstructions by others, see `runtime.sheared`."""
PUBLISHED_METHODS = (*LAYERED_METHODS, "tlfr")
"""Reconstructions by others, with settings of their own: those, and one without layers."""
RECONSTRUCTION_METHODS = ("spreadlets", "dense", "dense-rows", *PUBLISHED_METHODS, "mean", *DENOISERS)
SPLATTING_OPTIONS = ("integrator", "cycles", "tolerance", "softness", "firefly_clamp", "denoise", "calibrate")
"""Options that mean nothing to methods that do not splat."""

FRAME_OPTIONS = "near_strength far_strength in_focus max_coc highlights focus_at mask region proxy vignetting".split()
"""Options that mean nothing to samples, which hold their lens already."""

SWITCHES = ("defocus", "motion", "calibrate", "vignetting")
"""Options that are on or off."""

LEAST_PROXY = 1 / 64
"""Smallest proxy, as a share of the frame's size."""

DEFAULT_TOLERANCE = 0.004
"""One step of an 8-bit display."""
SAMPLE_TOLERANCE = 3.0 * DEFAULT_TOLERANCE
"""That of samples, whose noise is more than that."""
MOST_LAYERS, MOST_SAMPLE_LAYERS = 12, 7
"""Layers, at most, of a frame that comes without any, and of a buffer of samples: as many as their depths need, see
`runtime.plan.cuts`."""
MAX_LAYERS = 64
SAMPLE_SOFTNESS, FRAME_SOFTNESS = 0.8, 0.0
"""Width of the transition from one layer to the next, in layers: samples are many, and their layers few."""
SAMPLE_CLAMP = 32.0
"""How many times as bright as all others around it a sample may be, by default."""


@dataclass(frozen=True)
class Options(Controls):
    """How to render.

    Attributes
    ----------
    defocus, motion : bool
        Whether to apply each effect.
    integrator : str
        Poisson solver, see `spreadlets.runtime.integrate.convolution_pyramid.integrate`.
    cycles : int
        Cycles of the integrator ``multigrid``; the others take no notice.
    tolerance : float or None
        Error of the displayed image, as a share of its range, that may be traded for speed; 0 draws every pixel. By
        default one step of an 8-bit display for a frame, and three for samples.
    layers : int or None
        Depth layers, at most; by default those that a frame has, or as many as it, or a buffer of samples, needs.
    softness : float or None
        Width of the transition between depth layers, in layers: 0 (hard) to 1 (soft); by default hard for a frame and
        soft for samples.
    firefly_clamp : float or None
        How many times as bright as any other within a pixel of where it comes from a sample may be; infinite for any.
        By default any in synthesis, and `SAMPLE_CLAMP` in reconstruction.
    denoise : str or None
        Denoiser for the sharp parts of a reconstruction, see `spreadlets.runtime.finish.denoise.denoise_sharp`.
    calibrate : bool
        Whether a reconstruction is brought to its samples' local means, where those are of the whole lens and shutter,
        see `spreadlets.runtime.finish.calibration.calibrate`.
    method : str
        One of `METHODS`.
    vignetting : bool
        Whether to darken the image towards its corners as the lens of a database of ``physicallens`` does.
    near_strength, far_strength, in_focus, max_coc, highlights
        What is changed in the lens's blur, see `spreadlets.runtime.controls.Controls`.
    focus_at : tuple of float or None
        Place (x, y), px, whose depth the camera is focused at.
    mask : ndarray of shape (H, W), float32, or None
        What is kept sharp and held out of the blur, from 0 to 1.
    region : tuple of int or None
        ``(x, y, width, height)`` of the part of the picture that is made, px of the whole frame.
    proxy : float
        Size of the picture, as a share of the frame's.

    Raises
    ------
    InvalidParameterError
        If a value is not allowed.
    """

    defocus: bool = True
    motion: bool = True
    integrator: str = DEFAULT_INTEGRATOR
    cycles: int = DEFAULT_CYCLES
    tolerance: float | None = None
    layers: int | None = None
    softness: float | None = None
    firefly_clamp: float | None = None
    denoise: str | None = None
    calibrate: bool = True
    method: str = "spreadlets"
    vignetting: bool = False
    focus_at: tuple[float, float] | None = None
    mask: FloatArray | None = field(default=None, compare=False)
    region: tuple[int, int, int, int] | None = None
    proxy: float = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        check_method(self.method, METHODS)
        for name in SWITCHES:
            check_value(name, getattr(self, name), "True and False", isinstance(getattr(self, name), bool | np.bool_))
        # Method and solver.
        if self.integrator not in INTEGRATORS:
            known = ", ".join(INTEGRATORS)
            raise InvalidParameterError(f"{option('integrator')} {self.integrator!r} is unknown: allowed are {known}")
        whole_cycles = isinstance(self.cycles, int | np.integer) and self.cycles >= 0
        check_value("cycles", self.cycles, "whole numbers from 0", whole_cycles)
        if self.tolerance is not None:
            allowed = "0 (off) to below 1 (the displayed range)"
            check_value("tolerance", self.tolerance, allowed, 0.0 <= self.tolerance < 1.0)
        # Layers of depth.
        if self.layers is not None:
            check_value("layers", self.layers, f"1 to {MAX_LAYERS}", self.layers in range(1, MAX_LAYERS + 1))
            if self.method == "gather" and self.layers > 1:
                raise InvalidParameterError(
                    f"{option('layers')} is {self.layers}: the method 'gather' filters a frame without dividing it"
                )
        if self.softness is not None:
            check_value("softness", self.softness, "0 (hard layers) to 1 (soft)", 0.0 <= self.softness <= 1.0)
        # What is done to the image.
        if self.firefly_clamp is not None:
            check_value("firefly_clamp", self.firefly_clamp, "1 and more, inf for off", self.firefly_clamp >= 1.0)
        if self.denoise is not None:
            check_value("denoise", self.denoise, f"{', '.join(DENOISERS)}, or none", self.denoise in DENOISERS)
        # Size, region and focus.
        check_value("proxy", self.proxy, "1/64 to 1, the whole size", LEAST_PROXY <= self.proxy <= 1.0)
        whole = self.region is None or all(isinstance(each, int | np.integer) for each in self.region)
        if self.region is not None and not (whole and len(self.region) == 4 and min(self.region[2:]) >= 1):
            raise InvalidParameterError(
                f"{option('region')} is {self.region}: needed are x, y, width and height in whole px, the last two at "
                "least 1"
            )
        if self.focus_at is not None and not (len(self.focus_at) == 2 and all(map(math.isfinite, self.focus_at))):
            raise InvalidParameterError(f"{option('focus_at')} is {self.focus_at}: needed are x and y in px")

    @classmethod
    def of(cls, **given: Any) -> Options:
        """Return options of which some are given; None stands for the default, and pairs may come as lists."""
        known = [each.name for each in fields(cls)]
        for name in given:
            if name not in known:
                raise TypeError(f"there is no option {name!r}: there are {', '.join(known)}")
        chosen: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
        pairs = {name: tuple(value) for name, value in chosen.items() if isinstance(value, list)}
        return cls(**chosen | pairs)

    @property
    def draws_in_full(self) -> bool:
        """Whether PSFs are drawn in full instead of from spreadlets."""
        return self.method != "spreadlets"


class RenderOptions(TypedDict, total=False):
    """The options as keywords of the public functions; None stands for the default."""

    defocus: bool
    motion: bool
    integrator: str | None
    cycles: int | None
    tolerance: float | None
    layers: int | None
    softness: float | None
    firefly_clamp: float | None
    denoise: str | None
    calibrate: bool
    method: str
    vignetting: bool
    near_strength: float | None
    far_strength: float | None
    in_focus: tuple[float, float] | None
    max_coc: float | None
    highlights: tuple[float, float] | None
    focus_at: tuple[float, float] | None
    mask: FloatArray | None
    region: tuple[int, int, int, int] | None
    proxy: float | None


RENDER_OPTIONS = tuple(field.name for field in fields(Options))
"""Their names."""


def check_method(method: str, allowed: Sequence[str]) -> None:
    """Raise InvalidParameterError if a method is not one of those that are allowed."""
    if method not in allowed:
        raise InvalidParameterError(f"{option('method')} {method!r} is unknown: allowed are {', '.join(allowed)}")


def check_for_samples(options: Mapping[str, Any]) -> None:
    """Raise InvalidParameterError if an option is given that means nothing to samples."""
    for name in FRAME_OPTIONS:
        if options.get(name) not in (None, getattr(Options, name)):
            raise InvalidParameterError(f"{option(name)} is for frames: samples hold their lens already")
