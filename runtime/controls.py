"""What an artist changes in a lens: a range kept in focus, the strength of the blur on either side, highlights.

The depths, and with them what hides what, stay as they are; what changes is the circle of confusion of each pixel.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from spreadlets.arrays import FloatArray, Image
from spreadlets.errors import InvalidParameterError, option

FULL_GAIN_COC = 1.0
"""CoC radius, px, from which a highlight has its whole gain: what is in focus keeps its light."""


@dataclass(frozen=True)
class Controls:
    """What is changed in the blur of a lens.

    Attributes
    ----------
    near_strength, far_strength : float
        Factor of the CoC in front of and behind what is in focus, 0 and more.
    in_focus : tuple of float or None
        ``(near, far)``: what lies between these depths, in metres, is sharp, and the blur begins at either end. By
        default only what lies at the camera's focus is.
    max_coc : float or None
        Largest CoC radius, px; by default any.
    highlights : tuple of float or None
        ``(gain, threshold)``: the light of a blurred pixel above the threshold, in its brightest channel, is multiplied
        by the gain. It gives back what was clipped.

    Raises
    ------
    InvalidParameterError
        If a value is not allowed.
    """

    near_strength: float = 1.0
    far_strength: float = 1.0
    in_focus: tuple[float, float] | None = None
    max_coc: float | None = None
    highlights: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        for name in ("near_strength", "far_strength"):
            check_value(name, getattr(self, name), "factors of 0 and more", 0.0 <= getattr(self, name) < math.inf)
        if self.in_focus is not None:
            near, far = _pair("in_focus", self.in_focus, "the nearest and the farthest depth that are sharp, metres")
            check_value("in_focus", self.in_focus, "depths 0 < NEAR <= FAR, metres", 0.0 < near <= far)
        if self.max_coc is not None:
            check_value("max_coc", self.max_coc, "radii of 0 px and more", 0.0 <= self.max_coc < math.inf)
        if self.highlights is not None:
            gain, threshold = _pair("highlights", self.highlights, "a gain and a threshold")
            good = 0.0 <= gain < math.inf and 0.0 <= threshold < math.inf
            check_value("highlights", self.highlights, "a gain and a threshold of 0 and more", good)

    @property
    def change_coc(self) -> bool:
        """Whether any CoC may be another than the camera's."""
        changed = self.near_strength, self.far_strength, self.in_focus, self.max_coc
        return changed != (1.0, 1.0, None, None)

    @property
    def strength(self) -> float:
        """The largest factor of any CoC, at least 1."""
        return max(1.0, self.near_strength, self.far_strength)

    def coc(self, radius: FloatArray, depth: FloatArray, scale: float) -> FloatArray:
        """Return the signed CoC radii that a camera's become.

        Parameters
        ----------
        radius : ndarray of shape (H, W), float32
            The camera's own, px.
        depth : ndarray of shape (H, W), float32
            Metres.
        scale : float
            CoC for each 1/m of inverse depth, px metres.
        """
        if self.in_focus is not None:
            near, far = self.in_focus
            inverse = np.float32(1.0) / depth
            radius = np.float32(scale) * (np.clip(inverse, np.float32(1.0 / far), np.float32(1.0 / near)) - inverse)
        strength = np.where(radius < 0.0, np.float32(self.near_strength), np.float32(self.far_strength))
        radius = radius * strength
        return radius if self.max_coc is None else np.clip(radius, -self.max_coc, self.max_coc, dtype=np.float32)

    def light(self, radiance: Image, coc: FloatArray) -> Image:
        """Return the colours (H, W, 4) with the gain of highlights, as far as they are blurred."""
        if self.highlights is None:
            return radiance
        gain, threshold = self.highlights
        brightest = radiance[..., :3].max(axis=2)
        above = np.maximum(brightest - np.float32(threshold), np.float32(0.0))
        blurred = np.minimum(np.abs(coc) / np.float32(FULL_GAIN_COC), np.float32(1.0))
        factor = np.float32(1.0) + np.float32(gain - 1.0) * blurred * above / np.maximum(brightest, np.float32(1e-12))
        changed = radiance.copy()
        changed[..., :3] *= factor[..., None]
        return changed


def _pair(name: str, value: Any, what: str) -> tuple[float, float]:
    if not isinstance(value, tuple) or len(value) != 2:
        raise InvalidParameterError(f"{option(name)} is {value!r}: needed are {what}")
    return value


def check_value(name: str, value: object, allowed: str, is_good: bool) -> None:
    """Raise InvalidParameterError, naming the option as the caller spells it, if its value is not allowed."""
    if not is_good:
        raise InvalidParameterError(f"{option(name)} is {value!r}: allowed are {allowed}")
