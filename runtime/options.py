"""How to render: one set of options from the public functions to the plan."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from spreadlets.arrays import Image
from spreadlets.errors import InvalidParameterError
from spreadlets.runtime.finish.denoise import DENOISERS
from spreadlets.runtime.integrate.convolution_pyramid import DEFAULT_CYCLES, DEFAULT_METHOD, METHODS, integrate
from spreadlets.runtime.plan import layering
from spreadlets.runtime.plan.plan import DEFAULT_TOLERANCE, Settings
from spreadlets.runtime.plan.variant import DensePsf
from spreadlets.runtime.splat.splat import sum_rows

SAMPLE_CLAMP = 32.0
"""How many times as bright as all others around it a sample may be, by default."""

Solver = Callable[[Image], Image]


@dataclass(frozen=True)
class Options:
    """How to render.

    Attributes
    ----------
    defocus, motion : bool
        Whether to apply each effect.
    integrator : str
        Poisson solver, see `spreadlets.runtime.integrate.convolution_pyramid.integrate`.
    cycles : int
        Cycles of the integrator ``multigrid``; the others take no notice.
    tolerance : float
        Error of the displayed image, as a share of its range, that may be traded for speed; 0 draws every pixel.
    n_layers : int or None
        Depth layers; by default those that the frame has, or a usual number if it has none.
    softness : float
        Width of the transition between depth layers, in layers: 0 (hard) to 1 (soft).
    firefly_clamp : float or None
        How many times as bright as any other within a pixel of where it comes from a sample may be; infinite for any.
        By default any in synthesis, and `SAMPLE_CLAMP` in reconstruction.
    denoise : str or None
        Denoiser for the sharp parts of a reconstruction, see `spreadlets.runtime.finish.denoise.denoise_sharp`.
    calibrate : bool
        Whether a reconstruction is brought to its samples' local means, where those are of the whole lens and shutter,
        see `spreadlets.runtime.finish.calibration.calibrate`.
    dense_psf : callable or None
        If given, PSFs are drawn in full from it, every pixel by itself: methods ``dense`` and ``dense-rows``.
    filtering : bool
        Gather with the PSF of the receiving pixel instead of splatting, see `runtime.splat.gather`; needs `dense_psf`.
    """

    defocus: bool = True
    motion: bool = True
    integrator: str = DEFAULT_METHOD
    cycles: int = DEFAULT_CYCLES
    tolerance: float = DEFAULT_TOLERANCE
    n_layers: int | None = None
    softness: float = layering.DEFAULT_SOFTNESS
    firefly_clamp: float | None = None
    denoise: str | None = None
    calibrate: bool = True
    dense_psf: DensePsf | None = None
    filtering: bool = False

    def __post_init__(self) -> None:
        if self.integrator not in METHODS:
            raise InvalidParameterError(f"integrator {self.integrator!r} is unknown: allowed are {', '.join(METHODS)}")
        if not 0.0 <= self.tolerance < 1.0:
            raise InvalidParameterError(
                f"tolerance is {self.tolerance}: allowed are 0 (off) to below 1 (the displayed range)"
            )
        if self.n_layers is not None and not 1 <= self.n_layers <= layering.MAX_LAYERS:
            raise InvalidParameterError(f"layers is {self.n_layers}: allowed are 1 to {layering.MAX_LAYERS}")
        if not 0.0 <= self.softness <= 1.0:
            raise InvalidParameterError(f"softness is {self.softness}: allowed are 0 (hard layers) to 1 (soft)")
        if self.firefly_clamp is not None and not self.firefly_clamp >= 1.0:
            raise InvalidParameterError(f"firefly_clamp is {self.firefly_clamp}: allowed are 1 and more, inf for off")
        if self.denoise is not None and self.denoise not in DENOISERS:
            raise InvalidParameterError(f"denoise is {self.denoise!r}: allowed are {', '.join(DENOISERS)}, or none")

    def solver(self) -> Solver:
        """Return what makes images from what is splatted."""
        if self.dense_psf is not None and self.dense_psf.by_rows:
            return sum_rows
        return partial(integrate, method=self.integrator, cycles=self.cycles)

    def settings(self, n_layers: int, *, border: bool = True, stochastic: bool = False) -> Settings:
        """Return the settings of the plan."""
        return Settings(self.tolerance, self.dense_psf, border, n_layers, self.softness, stochastic)
