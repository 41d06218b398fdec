"""The rendered frames that several studies share, and pictures of results beside their references."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cached_property
from pathlib import Path

import numpy as np
from skimage.transform import downscale_local_mean

import spreadlets as sp
from spreadlets.scene.display import display_encode

SCENES = ("coins", "whirl", "fence", "gear")
"""What `scenes/render.py` makes for a thin lens, but for `rain`; any of them may be there."""
RESULTS = Path(__file__).parent / "results"
DATA, TESTS = Path(sp.__file__).parent / "data", Path(__file__).parent.parent / "tests" / "data"
SMALL = RESULTS / "small"
"""Where results of small frames are written: those of the frames at full size are kept."""
SHIPPED = {"coins": (TESTS,), "fence": (DATA, TESTS)}
"""Where the small frames that ship are: 256 x 256 px, see `benchmarks/shipped_frames.py`."""
DIFFERENCE_GAIN = 4
DIFFERENCE_LEVELS = 32
"""Steps of the difference in a picture: enough to see it, few enough to keep the file small."""


class Scene:
    """A rendered frame in all its forms, each read when it is first asked for."""

    lens, truth = ".json", "_ref_dofmb.exr"
    """Endings of the files of the camera and of the reference."""

    def __init__(self, name: str, *folders: Path) -> None:
        self.name, self.folders = name, folders
        self.camera = sp.read_camera(self.path(self.lens))

    def path(self, ending: str) -> Path:
        """Return the path of a file, such as that which ends with ``_pinhole.exr``."""
        paths = [folder / f"{self.name}{ending}" for folder in self.folders]
        return next((path for path in paths if path.exists()), paths[0])

    @cached_property
    def pinhole(self) -> sp.Frame:
        """The frame in one layer."""
        return sp.read_frame(self.path("_pinhole.exr"))

    @cached_property
    def layered(self) -> sp.Frame:
        """The frame in layers, nearest first, hidden surfaces present."""
        paths = [self.path(f"_layer{k}.exr") for k in range(10)]
        return sp.Frame.from_layers([sp.read_frame(path) for path in paths if path.exists()])

    @cached_property
    def samples(self) -> sp.SampleBuffer:
        """Labelled stochastic samples."""
        return sp.read_samples(self.path("_samples.exr"))

    def counts(self, wanted: Sequence[int]) -> list[int]:
        """Return the numbers of samples in a pixel that there are, of those that are wanted."""
        return [count for count in wanted if count <= self.samples.n_samples]

    @cached_property
    def reference(self) -> np.ndarray:
        """What the renderer makes of lens and shutter."""
        return sp.read_image(self.path(self.truth))


class ThinRain(Scene):
    """`rain` as its thin lens sees it, which its samples are of."""

    lens, truth = "_thin.json", "_ref_thin.exr"


def parser(description: str | None) -> argparse.ArgumentParser:
    """Return a parser with the option of all studies on these frames."""
    made = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    made.add_argument(
        "--frames",
        type=Path,
        default=Path("frames"),
        help="folder of frames, see scenes/README.md (default: frames); without, the small ones that ship are taken",
    )
    return made


def scenes(folder: Path, *needed: str) -> list[Scene]:
    """Return the scenes of a folder, or else of the small frames that ship, that have what is needed; say which.

    From then on, `result_path` is among results of frames of that size.

    Parameters
    ----------
    folder : path
    *needed : str
        Endings of files, such as ``_samples.exr``.
    """
    there = [name for name in SCENES if (folder / f"{name}.json").exists()]
    whole = bool(there)
    places = dict.fromkeys(there, (folder,)) if whole else SHIPPED
    found = [Scene(name, *folders) for name, folders in places.items()]
    found = [scene for scene in found if all(scene.path(ending).exists() for ending in needed)]
    names = ", ".join(scene.name for scene in found) or "none"
    _taken["small"] = not whole
    print(f"frames of {folder}: {names}" if whole else f"no frames in {folder}; small frames that ship: {names}")
    return found


_taken = {"small": False}


def result_path(name: str) -> Path:
    """Return where a result is written."""
    folder = SMALL if _taken["small"] else RESULTS
    folder.mkdir(exist_ok=True)
    return folder / name


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
        result_path(name).write_text("\n".join(self.lines) + "\n")


def save_tables(
    tables: Mapping[str, tuple[Callable[[Report, Scene], None], Sequence[str]]], found: Iterable[Scene], study: str
) -> None:
    """Make tables, each by a function of report and scene under a head, and write them as STUDY_NAME.txt."""
    for name, (make, head) in tables.items():
        report = Report()
        report.row(*head)
        for scene in found:
            make(report, scene)
        report.save(f"{study}_{name}.txt")
