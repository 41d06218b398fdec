"""The registry of the benchmark: every method, with every knob, on every kind of input."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from spreadlets import api
from spreadlets.arrays import Image
from spreadlets.files.exr_frames import read_image
from spreadlets.reports.bench.blender_nodes import run_nodes
from spreadlets.reports.bench.subjects import Subject
from spreadlets.runtime.options import RECONSTRUCTION_METHODS, Options
from spreadlets.runtime.render import reconstruct, synthesize
from spreadlets.scene.samples import SampleBuffer

DEFAULT = "default"
ONE_FRAME = "one layer"
LAYERED = "layers"

SYNTHESIS_KNOBS: tuple[tuple[str, dict[str, Any]], ...] = (
    *((f"layers {count}", {"layers": count}) for count in (1, 2, 3, 4, 8, 12, 16)),
    *((f"tolerance {value:g}", {"tolerance": value}) for value in (0.0, 0.001, 0.016, 0.064)),
    *((f"integrator {name}", {"integrator": name}) for name in ("pyramid", "exact", "pyramid-f7", "pyramid-f5")),
    ("cycles 2", {"cycles": 2}),
    ("softness 0", {"softness": 0.0}),
)
"""What `synthesize` is given beside its defaults; the method is ``spreadlets``."""

QUICK_KNOBS = ("layers 1", "layers 2", "tolerance 0.016", "integrator pyramid")
DENSITIES = (0.5, 2.0)
SAMPLE_COUNTS = (1, 2, 4, 8, 16)

RECONSTRUCTION_KNOBS: tuple[tuple[str, dict[str, Any]], ...] = (
    *((f"layers {count}", {"layers": count}) for count in (1, 3, 12)),
    ("tolerance 0.016", {"tolerance": 0.016}),
    ("integrator pyramid", {"integrator": "pyramid"}),
    ("not calibrated", {"calibrate": False}),
)
"""The same for `reconstruct`."""

OPTIONAL_PACKAGES = {"bm3d": "bm3d", "oidn": "pyoidn"}
"""The packages behind methods that need one."""
RECONSTRUCTION_PEERS = ("mean", "sheared", "axis-aligned", "lrdm", "lrdm-sheared", "lrdm-ewa", "tlfr", "bm3d", "oidn")
SLOW_METHODS = ("dense", "dense-rows", "gather", "blender nodes", "tlfr")


@dataclass(frozen=True)
class Contender:
    """One method with one setting on one kind of input.

    Attributes
    ----------
    task : str
        ``synthesis`` or ``reconstruction``.
    source : str
        What it is given: ``one layer``, ``layers``, a number of samples per pixel, or a render.
    method, knob : str
    make : callable
        Makes the image; its time is taken. None where the time is recorded, or where something is missing.
    missing : str
        Why it cannot be run.
    """

    task: str
    source: str
    method: str
    knob: str
    make: Callable[[], Image] | None
    missing: str = ""

    @property
    def key(self) -> str:
        """A name of its own within a frame."""
        return "/".join((self.task, self.source, self.method, self.knob))


def contenders(subject: Subject, folder: Path, *, quick: bool) -> Iterator[Contender]:
    """Yield whatever can be, or could be, run on a frame."""
    if subject.frame_files:
        yield from _synthesis(subject, folder, quick)
    if subject.samples_file:
        yield from _reconstruction(subject, folder, quick)
    for spp in subject.render_files:
        missing = "" if spp in subject.render_times else "its render time is not recorded"
        yield Contender("reconstruction", "render", "monte carlo", f"{spp} spp", None, missing)


def _synthesis(subject: Subject, folder: Path, quick: bool) -> Iterator[Contender]:
    # Ways to make an image: with spreadlets, or with all PSFs in full.
    def ours(frame: str, density: float = 1.0, **options: Any) -> Callable[[], Image]:
        def make() -> Image:
            database = subject.database(density, folder)
            image: Image = api.synthesize(getattr(subject, frame), subject.camera, database, **options)
            return image

        return make

    def dense(frame: str, method: str, layers: int | None = None) -> Callable[[], Image]:
        def make() -> Image:
            psfs = subject.dense_psfs(folder, by_rows=method == "dense-rows")
            options = Options.of(layers=layers, method=method)
            return synthesize(getattr(subject, frame), subject.camera, psfs.psfs.database, options, dense_psf=psfs)[0]

        return make

    def of(source: str, method: str, knob: str, make: Callable[[], Image] | None, missing: str = "") -> Contender:
        return Contender("synthesis", source, method, knob, make, missing)

    # Spreadlets at all their knobs.
    yield of(ONE_FRAME, "spreadlets", DEFAULT, ours("frame"))
    for knob, options in SYNTHESIS_KNOBS:
        if not quick or knob in QUICK_KNOBS:
            yield of(ONE_FRAME, "spreadlets", knob, ours("frame", **options))
    if not quick:
        for density in DENSITIES:
            yield of(ONE_FRAME, "spreadlets", f"density {density:g}", ours("frame", density))
    # PSFs in full: scattered, and gathered.
    for method in ("dense", "dense-rows"):
        if not quick or method == "dense":
            yield of(ONE_FRAME, method, DEFAULT, dense("frame", method))
            yield of(ONE_FRAME, method, "layers 1", dense("frame", method, layers=1))
    yield of(ONE_FRAME, "gather", DEFAULT, dense("frame", "gather"))
    # The same of layers, where the subject has them.
    if subject.layer_files:
        yield of(LAYERED, "spreadlets", DEFAULT, ours("layered"))
        yield of(LAYERED, "spreadlets", "tolerance 0.016", ours("layered", tolerance=0.016))
        yield of(LAYERED, "dense", DEFAULT, dense("layered", "dense"))
        yield of(LAYERED, "gather", DEFAULT, dense("layered", "gather"))
    # What a compositor has today.
    if not quick:
        missing = "" if find_spec("bpy") else "package bpy is not installed"
        yield of(ONE_FRAME, "blender nodes", DEFAULT, None if missing else lambda: run_nodes(subject), missing)


def _reconstruction(subject: Subject, folder: Path, quick: bool) -> Iterator[Contender]:
    # Take the first samples of each pixel.
    counts = [1] if quick else [count for count in SAMPLE_COUNTS if count <= subject.samples.n_samples]
    for count in counts:
        samples = subject.samples.take(count)

        # Ways to make an image: PSFs in full, spreadlets, or a method that needs no database.
        def of(method: str, knob: str, samples: SampleBuffer = samples, **options: Any) -> Contender:
            def make() -> Image:
                if method == "dense":
                    psfs = subject.dense_psfs(folder)
                    return reconstruct(
                        samples, subject.camera, psfs.psfs.database, Options(method="dense"), dense_psf=psfs
                    )[0]
                database = None if method in RECONSTRUCTION_PEERS else subject.database(1.0, folder)
                image: Image = api.reconstruct(samples, subject.camera, database, method=method, **options)
                return image

            missing = missing_for(method)
            source = f"{samples.n_samples} spp"
            return Contender("reconstruction", source, method, knob, None if missing else make, missing)

        # Spreadlets, at all their knobs for a single sample, and the others.
        yield of("spreadlets", DEFAULT)
        for knob, options in RECONSTRUCTION_KNOBS if count == 1 and not quick else ():
            yield of("spreadlets", knob, **options)
        for method in ("dense", *RECONSTRUCTION_PEERS):
            if not (quick and method in SLOW_METHODS):
                yield of(method, DEFAULT)


def missing_for(method: str) -> str:
    """Say why a method of reconstruction cannot be run; empty if it can."""
    if method not in RECONSTRUCTION_METHODS:
        return "this version has no such method"
    package = OPTIONAL_PACKAGES.get(method)
    if package and find_spec(package) is None:
        return f"package {package} is not installed (pip install 'spreadlets[bench]')"
    return ""


def recorded(subject: Subject, contender: Contender) -> tuple[Image, float | None]:
    """Return a Monte Carlo render and its recorded time, None if there is none."""
    spp = int(contender.knob.split()[0])
    return read_image(subject.render_files[spp]), subject.render_times.get(spp)
