"""The demonstrations: blur a frame that ships, or clean samples, and compare with the renderer's own image."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from spreadlets import metrics
from spreadlets.api import reconstruct, synthesize
from spreadlets.arrays import Image
from spreadlets.errors import InvalidParameterError
from spreadlets.files import exr_frames as exr
from spreadlets.files import images
from spreadlets.files.cameras import read_camera
from spreadlets.files.exr_samples import read_samples
from spreadlets.runtime.clock import Clock
from spreadlets.runtime.report import Report

DATA = Path(__file__).resolve().parents[1] / "data"
FRAME = "coins"
SAMPLES = "fence"
DATABASE = "combined"


def run_demo(folder: str | os.PathLike[str]) -> dict[str, Any]:
    """Synthesise depth of field and motion blur on the shipped frame.

    Parameters
    ----------
    folder : path-like
        Where ``result.exr``, ``result.png``, ``pinhole.png`` and ``reference.png`` are written; made if need be.

    Returns
    -------
    dict
        The report of the run with the metrics against the reference, and the folder.

    Raises
    ------
    InvalidParameterError
        If the folder cannot be made.
    """
    output, clock = _made(folder), Clock()
    with clock.step("read"):
        frame = exr.read_frame(DATA / f"{FRAME}_pinhole.exr")
    image, report = synthesize(frame, read_camera(DATA / f"{FRAME}.json"), DATABASE, report=True, clock=clock)
    return _written(output, FRAME, {"result": image, "pinhole": frame.layers[0].radiance}, report, clock)


def run_reconstruction_demo(folder: str | os.PathLike[str]) -> dict[str, Any]:
    """Clean the shipped samples, which were rendered through lens and shutter.

    Parameters
    ----------
    folder : path-like
        Where ``result.exr``, ``result.png``, ``samples.png`` (the mean of each pixel's samples) and ``reference.png``
        are written; made if need be.

    Returns
    -------
    dict
        The report of the run with the metrics against the reference, and the folder.

    Raises
    ------
    InvalidParameterError
        If the folder cannot be made.
    """
    output, clock = _made(folder), Clock()
    camera = read_camera(DATA / f"{SAMPLES}.json")
    with clock.step("read"):
        samples = read_samples(DATA / f"{SAMPLES}_samples.exr", camera=camera)
    image, report = reconstruct(samples, camera, DATABASE, report=True, clock=clock)
    mean = reconstruct(samples, camera, method="mean")
    return _written(output, SAMPLES, {"result": image, "samples": mean}, report, clock)


def _made(folder: str | os.PathLike[str]) -> Path:
    """Return a folder that exists."""
    output = Path(folder)
    try:
        output.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InvalidParameterError(f"cannot write to {str(output)!r}: {error}") from error
    return output


def _written(output: Path, name: str, pictures: dict[str, Image], report: Report, clock: Clock) -> dict[str, Any]:
    """Write the result and the pictures beside the reference, and add to the report how far from it the result is."""
    reference = exr.read_image(DATA / f"{name}_ref_dofmb.exr")
    with clock.step("write"):
        images.write_image(output / "result.exr", pictures["result"])
    for each, picture in (pictures | {"reference": reference}).items():
        images.write_png(output / f"{each}.png", picture)
    figures = metrics.compare(pictures["result"], reference)
    return report.to_dict() | {"time_s": clock.times()} | figures | {"written_to": str(output)}
