"""The job of reconstruction: a buffer of samples in a file, made into a clean image."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from spreadlets.errors import InvalidParameterError, option
from spreadlets.jobs.job import Job, Progress, compared


@dataclass(frozen=True)
class Reconstruction(Job):
    """A buffer of samples to clean, see `Job`; it has one input.

    Attributes
    ----------
    settings : mapping
        Of a layered reconstruction, as for `spreadlets.reconstruct`.
    spp : int or None
        Use so many samples of each pixel.
    repair : bool
        Drop invalid samples.
    """

    settings: Mapping[str, object] = field(default_factory=dict)
    spp: int | None = None
    repair: bool = False

    @property
    def reads(self) -> list[str]:
        """Files that may be read: a buffer of TLFR is two."""
        from spreadlets.files.exr_samples import samples_files

        return [*super().reads, *samples_files(self.inputs[0])]

    def make(self, progress: Progress | None = None) -> dict[str, Any]:
        """Make the image, write it, and return its report; what this needs is loaded here, as in `Synthesis.make`."""
        from spreadlets.api import reconstruct
        from spreadlets.files.cameras import camera_of
        from spreadlets.files.exr_frames import read_image
        from spreadlets.files.exr_samples import read_samples
        from spreadlets.files.images import write_image
        from spreadlets.jobs.databases import kept_database
        from spreadlets.renderer import default_database
        from spreadlets.runtime.clock import Clock
        from spreadlets.scene.raster import placed

        # Read camera, samples and reference.
        path, clock = self.inputs[0], Clock()
        with clock.step("read"):
            lens = camera_of(self.camera, self.lens, path)
            buffer = read_samples(path, camera=lens, repair=self.repair)
            truth = read_image(self.reference) if self.reference else None
        if self.spp and self.spp > buffer.n_samples:
            raise InvalidParameterError(
                f"{option('spp')} is {self.spp}, but {path} holds {buffer.n_samples} samples of each pixel at most"
            )
        # Clean the samples by the database that suits them.
        given = buffer.take(self.spp) if self.spp else buffer
        moving = bool(self.rendering.get("motion", True)) and bool(given.motion.any())
        database = kept_database(self.database or default_database(moving))
        options: dict[str, Any] = {**self.rendering, "settings": self.settings, "clock": clock, "progress": progress}
        image, report = reconstruct(given, lens, database, **options, report=True)
        if buffer.dropped_samples:
            warnings.warn(f"{buffer.dropped_samples} invalid samples were dropped", stacklevel=1)
        # Compare and write the image.
        raster = buffer.raster
        figures = {}
        if truth is not None:
            figures = compared(placed(image, raster.data, raster.display), truth)
        with clock.step("write"):
            write_image(self.output, image, bit_depth=self.bit_depth, raster=raster)
        return report.to_dict() | {"time_s": clock.times()} | figures
