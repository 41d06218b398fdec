"""What the benchmark runs on: frames, their layers and samples, and what the renderer itself makes of them."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
import numpy.typing as npt

from spreadlets.api import DensePsfs, build_database
from spreadlets.arrays import Image
from spreadlets.errors import InvalidParameterError
from spreadlets.files.cameras import read_camera
from spreadlets.files.exr_frames import read_frame, read_image
from spreadlets.files.exr_samples import read_samples
from spreadlets.psf.database import Database, open_database
from spreadlets.reports.demo import DATA, DATABASE
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.frame import Frame
from spreadlets.scene.samples import SampleBuffer

Traced = dict[tuple[int, int, float], npt.NDArray[np.float64]]

RENDER_TIMES_KEY = "render_time_s"
"""Optional key of a camera file: seconds of the plain Monte Carlo renders by their samples per pixel."""


@dataclass(frozen=True)
class TracedPsfs:
    """Full PSFs that are traced once: dense splatting is timed as if it came with them, as spreadlets do."""

    psfs: DensePsfs
    traced: Traced
    by_rows: bool

    def __call__(self, cell: int, pose: int, scale: float) -> npt.NDArray[np.float64]:
        """Return the PSF of a cell and pose, its parameters times a scale, as an array (h, w, C)."""
        key = cell, pose, scale
        if key not in self.traced:
            self.traced[key] = self.psfs(*key)
        return self.traced[key]


@dataclass
class Subject:
    """A frame to run on; files are read when they are first asked for.

    Attributes
    ----------
    name : str
    camera_file, reference_file : path
    frame_files : sequence of path
        The frame as it is blurred by default: one file, or layers, nearest first. None for samples alone.
    layer_files : sequence of path
        The same view in layers, if there are any beside the frame.
    samples_file : path or None
    render_files : mapping of int to path
        Plain Monte Carlo renders by their samples per pixel.
    """

    name: str
    camera_file: Path
    reference_file: Path
    frame_files: Sequence[Path] = ()
    layer_files: Sequence[Path] = ()
    samples_file: Path | None = None
    render_files: dict[int, Path] = field(default_factory=dict)
    databases: dict[float, Database] = field(default_factory=dict, repr=False)
    traced: Traced = field(default_factory=dict, repr=False)

    @cached_property
    def camera(self) -> ThinLens:
        """Lens and shutter."""
        return read_camera(self.camera_file)

    @cached_property
    def reference(self) -> Image:
        """What the renderer makes of lens and shutter."""
        return read_image(self.reference_file)

    @cached_property
    def frame(self) -> Frame:
        """The frame without blur."""
        return read_frame([str(path) for path in self.frame_files], camera=self.camera)

    @cached_property
    def layered(self) -> Frame:
        """The frame in layers, hidden surfaces present."""
        return read_frame([str(path) for path in self.layer_files], camera=self.camera)

    @cached_property
    def samples(self) -> SampleBuffer:
        """Labelled stochastic samples."""
        if self.samples_file is None:
            raise InvalidParameterError(f"{self.name} has no samples")
        return read_samples(str(self.samples_file), camera=self.camera)

    @cached_property
    def render_times(self) -> dict[int, float]:
        """Recorded seconds of the Monte Carlo renders by their samples per pixel, as far as they are recorded."""
        recorded = json.loads(self.camera_file.read_text()).get(RENDER_TIMES_KEY, {})
        return {int(spp): float(seconds) for spp, seconds in recorded.items()}

    def database(self, density: float, folder: Path) -> Database:
        """Return the shipped database, or one of another density built for this frame and kept in a folder."""
        if density not in self.databases:
            path: str | Path = DATABASE
            if density != 1.0:
                path = folder / f"{self.name}_density_{density:g}.h5"
                if not path.exists():
                    folder.mkdir(parents=True, exist_ok=True)
                    build_database(DATABASE, path, density=density, frames=[self.frame], camera=self.camera)
            self.databases[density] = open_database(path)
        return self.databases[density]

    def dense_psfs(self, folder: Path, *, by_rows: bool = False) -> TracedPsfs:
        """Return the full PSFs of the shipped database; they share what has been traced."""
        return TracedPsfs(DensePsfs(self.database(1.0, folder)), self.traced, by_rows)

    def close(self) -> None:
        """Close the databases and forget the PSFs."""
        for database in self.databases.values():
            database.close()
        self.databases.clear()
        self.traced.clear()


def shipped_subject() -> Subject:
    """Return the frame that ships with the package."""
    return Subject("coins", DATA / "coins.json", DATA / "coins_ref_dofmb.exr", [DATA / "coins_pinhole.exr"])


def subjects_in(folder: Path) -> list[Subject]:
    """Return the frames of a folder: each NAME.json with NAME_ref_dofmb.exr and what else there is of NAME.

    Raises
    ------
    InvalidParameterError
        If there is none.
    """
    found = []
    for camera in sorted(folder.glob("*.json")):
        name = camera.stem
        reference, pinhole, samples = (folder / f"{name}_{part}.exr" for part in ("ref_dofmb", "pinhole", "samples"))
        if not reference.exists() or not (pinhole.exists() or samples.exists()):
            continue
        renders = numbered_files(folder, f"{name}_noisy")
        layers = list(numbered_files(folder, f"{name}_layer").values())
        given = samples if samples.exists() else None
        frame = [pinhole] if pinhole.exists() else []
        found.append(Subject(name, camera, reference, frame, layers, given, renders))
    if not found:
        raise InvalidParameterError(
            f"{folder}: holds no frame; needed are NAME.json and NAME_ref_dofmb.exr with NAME_pinhole.exr or "
            "NAME_samples.exr"
        )
    return found


def numbered_files(folder: Path, stem: str) -> dict[int, Path]:
    """Return the files of a folder that are called by a stem and a number, by that number, ascending."""
    called = re.compile(rf"{re.escape(stem)}(\d+)\.exr")
    found = {int(match.group(1)): path for path in folder.iterdir() if (match := called.fullmatch(path.name))}
    return dict(sorted(found.items()))


def given_subject(frame: Sequence[str], samples: str | None, camera: str | None, reference: str | None) -> Subject:
    """Return a frame that the user named, with its reference."""
    if camera is None or reference is None:
        raise InvalidParameterError("a frame or samples of your own need --camera and --reference, too")
    for path in (*frame, *([samples] if samples else []), camera, reference):
        if not Path(path).exists():
            raise InvalidParameterError(f"{path} does not exist")
    first = frame[0] if frame else samples
    name = re.sub(r"\W+", "_", Path(str(first)).stem)
    files = [Path(path) for path in frame]
    return Subject(name, Path(camera), Path(reference), files, (), Path(samples) if samples else None)
