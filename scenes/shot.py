"""What a frame is apart from the scene itself: the camera, the shutter, and how it is sampled."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

SENSOR_MM = 36.0
LENSES = Path(__file__).resolve().parent.parent / "precompute" / "models" / "lenses"


@dataclass(frozen=True)
class Glass:
    """A lens of glass: the name of its prescription, and what it is scaled and stopped down to."""

    name: str
    focal_length_mm: float
    f_number: float

    @property
    def path(self) -> Path:
        """Of the prescription."""
        return LENSES / f"{self.name}.txt"


@dataclass(frozen=True)
class Shot:
    """A camera and how it renders.

    Parameters
    ----------
    focal_length_mm, f_number, focus_distance_m : float
        The thin lens.
    shutter : float, optional
        How long it is open, frames; its middle is at the frame's time. 0: the frame is at rest.
    place : tuple of float, optional
        Of the middle of the lens, metres.
    pitch : float, optional
        By which the camera looks up, radians.
    aspect : float, optional
        Height over width.
    pixel_filter : str, optional
        ``BOX``, 1 px wide, or ``BLACKMAN_HARRIS``, 1.5 px wide, Cycles' default, which anti-aliases.
    n_layers : int, optional
        Depth layers that the scene's objects are in.
    light_samples : int, optional
        How often each labelled sample is lit: what glossy surfaces show of an area light is noisy, and neither lens nor
        shutter makes that noise.
    glass : Glass, optional
        The lens of which this is the thin one with the same pupil and image scale.
    """

    focal_length_mm: float
    f_number: float
    focus_distance_m: float
    shutter: float = 0.5
    place: tuple[float, float, float] = (0.0, 0.0, 0.0)
    pitch: float = 0.0
    aspect: float = 1.0
    pixel_filter: str = "BOX"
    n_layers: int = 1
    light_samples: int = 4
    glass: Glass | None = None

    @property
    def aperture_m(self) -> float:
        """The diameter of the entrance pupil, metres."""
        return self.focal_length_mm / self.f_number / 1000

    def shape(self, width: int) -> tuple[int, int]:
        """Return height and width of an image, px."""
        return round(width * self.aspect), width

    def focal_length_px(self, width: int) -> float:
        """Return the focal length in pixels of an image."""
        return self.focal_length_mm / SENSOR_MM * width

    def description(self, width: int) -> dict[str, object]:
        """Return the camera as the product reads it, and what else a reader wants to know."""
        focal, aperture = self.focal_length_px(width), self.aperture_m
        height = self.shape(width)[0]
        half = self.shutter / 2
        return {
            "renderer": "Blender Cycles",
            "width": width,
            "height": height,
            "pixel_filter": "box 1 px" if self.pixel_filter == "BOX" else "Blackman-Harris 1.5 px",
            "focal_length_mm": self.focal_length_mm,
            "sensor_width_mm": SENSOR_MM,
            "focal_length_px": focal,
            "f_number": self.f_number,
            "aperture_diameter_m": aperture,
            "focus_distance_m": self.focus_distance_m,
            "shutter_open_close_frames": [-half, half],
            "coc_scale_px_m": 0.5 * aperture * focal,
            "depth": "channel Z, planar metres, at the pixel's centre",
            "vector": "Vector.X,Y,Z,W, px per frame, y up; XY = P(previous) - P(current), ZW = P(current) - P(next)",
            "colour": "scene-linear Rec.709",
            "denoised": "references by Open Image Denoise (colour only, HDR), where it brings them nearer to the truth",
        }

    def glass_description(self, width: int) -> dict[str, object]:
        """Return the camera with its lens of glass as the product reads it; `glass` must be there."""
        assert self.glass is not None
        return self.description(width) | {
            "focal_length_mm": self.glass.focal_length_mm,
            "focal_length_px": self.glass.focal_length_mm / SENSOR_MM * width,
            "f_number": self.glass.f_number,
            "aperture_diameter_m": self.glass.focal_length_mm / self.glass.f_number / 1000,
            "pinhole_focal_length_mm": self.focal_length_mm,
            "lens": f"{self.glass.name}, scaled to the focal length, stopped to the f-number, focused at 550 nm",
            "camera_place": "the middle of the entrance pupil",
        }
