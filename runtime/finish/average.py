"""The plain Monte Carlo image: the mean of each pixel's samples."""

from __future__ import annotations

import numpy as np

from spreadlets.arrays import Image
from spreadlets.runtime.clock import Clock
from spreadlets.runtime.report import Report
from spreadlets.scene.samples import SampleBuffer


def average(samples: SampleBuffer, clock: Clock | None = None) -> tuple[Image, Report]:
    """Return the mean of each pixel's samples, and a report of the time; where there is none, the pixel is empty."""
    clock = clock or Clock()
    with clock.step("composite"):
        count = np.maximum(samples.valid.sum(axis=2), 1)
        image = (samples.radiance.sum(axis=2) / count[..., None]).astype(np.float32)
    return image, Report.of(clock, {})
