"""The demonstration: blur the frame that ships with the package, and compare it with the renderer's own result."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from spreadlets import metrics
from spreadlets.api import synthesize
from spreadlets.errors import InvalidParameterError
from spreadlets.files import exr_frames as exr
from spreadlets.runtime.clock import Clock
from spreadlets.scene.camera import read_camera

DATA = Path(__file__).resolve().parents[1] / "data"
FRAME = "coins"
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
    """
    output = Path(folder)
    try:
        output.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InvalidParameterError(f"cannot write to {str(output)!r}: {error}") from error
    clock = Clock()
    with clock.step("read"):
        frame = exr.read_frame(DATA / f"{FRAME}_pinhole.exr")
    reference = exr.read_image(DATA / f"{FRAME}_ref_dofmb.exr")
    image, report = synthesize(frame, read_camera(DATA / f"{FRAME}.json"), DATABASE, report=True, clock=clock)
    with clock.step("write"):
        exr.write_image(output / "result.exr", image)
    pictures = {"result": image, "pinhole": frame.layers[0].radiance, "reference": reference}
    for name, picture in pictures.items():
        exr.write_png(output / f"{name}.png", picture)
    figures = metrics.compare(image, reference)
    return report.to_dict() | {"time_s": clock.times()} | figures | {"written_to": str(output)}
