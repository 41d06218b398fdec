"""The rendered frames that several studies share, and pictures of results beside their references."""

import argparse
from functools import cached_property
from pathlib import Path

import numpy as np
from skimage.transform import downscale_local_mean

import spreadlets as sp
from spreadlets.scene.display import display_encode

SCENES = ("coins", "whirl", "fence")
RESULTS = Path(__file__).parent / "results"
DIFFERENCE_GAIN = 4
DIFFERENCE_LEVELS = 32
"""Steps of the difference in a picture: enough to see it, few enough to keep the file small."""


class Scene:
    """A rendered frame in all its forms, each read when it is first asked for."""

    def __init__(self, folder: Path, name: str) -> None:
        self.folder, self.name = folder, name
        self.camera = sp.read_camera(folder / f"{name}.json")

    @cached_property
    def pinhole(self) -> sp.Frame:
        """The frame in one layer."""
        return sp.read_frame(self.folder / f"{self.name}_pinhole.exr")

    @cached_property
    def layered(self) -> sp.Frame:
        """The frame in layers, nearest first, hidden surfaces present."""
        paths = sorted(self.folder.glob(f"{self.name}_layer?.exr"))
        return sp.Frame.from_layers([sp.read_frame(path) for path in paths])

    @cached_property
    def samples(self) -> sp.SampleBuffer:
        """Labelled stochastic samples."""
        return sp.read_samples(self.folder / f"{self.name}_samples.exr")

    @cached_property
    def reference(self) -> np.ndarray:
        """What the renderer makes of lens and shutter."""
        return sp.read_image(self.folder / f"{self.name}_ref_dofmb.exr")


def parser(description: str | None) -> argparse.ArgumentParser:
    """Return a parser with the option of all studies on these frames."""
    made = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    made.add_argument("--frames", type=Path, default=Path("frames"))
    return made


def scenes(folder: Path) -> list[Scene]:
    """Return the scenes of a folder, or say that there are none and return an empty list."""
    if not (folder / "coins_pinhole.exr").exists():
        print(f"skipped: no frames in {folder}")
        return []
    return [Scene(folder, name) for name in SCENES]


def save_pictures(path: Path, images: list[np.ndarray], reference: np.ndarray, shrink: int = 2) -> None:
    """Save images, their reference, and the difference of the first image from it, amplified, side by side.

    The difference is of displayed values: grey is none, brighter is where the image is too bright.
    """
    rows, cols = (side - side % shrink for side in reference.shape[:2])
    shown = [display_encode(image[:rows, :cols, :3]) for image in (*images, reference)]
    small = [downscale_local_mean(image, (shrink, shrink, 1)) for image in shown]
    difference = np.clip(0.5 + DIFFERENCE_GAIN * (small[0] - small[-1]), 0, 1)
    small.append(np.rint(DIFFERENCE_LEVELS * difference) / DIFFERENCE_LEVELS)
    from PIL import Image

    Image.fromarray(np.rint(255 * np.concatenate(small, axis=1)).astype(np.uint8)).save(path, optimize=True)


class Report:
    """Lines that are printed as they come and kept for a file."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def add(self, line: str = "") -> None:
        """Print a line and keep it."""
        self.lines.append(line)
        print(line, flush=True)

    def row(self, *cells: object, width: int = 12, first: int = 30) -> None:
        """Add a row of a table; the first column is wider."""
        texts = [f"{cell:.4f}" if isinstance(cell, float) else str(cell) for cell in cells]
        self.add(f"{texts[0]:<{first}}" + "".join(f"{text:>{width}}" for text in texts[1:]))

    def save(self, name: str) -> None:
        """Write what was added to a file of the results."""
        (RESULTS / name).write_text("\n".join(self.lines) + "\n")
