"""What all jobs have in common: the files that are read and written, and their change from frame to frame."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

from spreadlets.arrays import Image
from spreadlets.files.images import check_bit_depth
from spreadlets.files.outputs import check_outputs
from spreadlets.files.sequence import numbered

PathChange = Callable[[str], str]
Progress = Callable[..., None]
"""Called with the numbers of what is done and of all, and the seconds that are left, if they are known."""


@dataclass(frozen=True)
class Job(ABC):
    """An image to make from files, and how; it can be sent to another process.

    Attributes
    ----------
    inputs : sequence of str
        The files that are worked on. Their counters decide which frames a sequence has.
    output : str
        The image to write.
    camera : str or None
        File of the camera; without one, the input's own.
    lens : mapping
        Single values of the camera, which override.
    reference : str or None
        File to compare the image with.
    database : str or None
        A file or a shipped name; without one, what suits.
    bit_depth : int or None
        Of the image's file.
    rendering : mapping
        Options by the names of the public functions.
    """

    inputs: Sequence[str]
    output: str
    camera: str | None
    lens: Mapping[str, Any]
    reference: str | None
    database: str | None
    bit_depth: int | None
    rendering: Mapping[str, Any]

    @abstractmethod
    def make(self, progress: Progress | None = None) -> dict[str, Any]:
        """Make the image, write it, and return its report; what has to be built first tells of its progress."""

    @property
    def others(self) -> list[str]:
        """Files that must be there besides the inputs, the database left out."""
        return [path for path in (self.camera, self.reference) if path]

    @property
    def reads(self) -> list[str]:
        """Files that may be read."""
        return [*self.inputs, *self.others, *filter(None, [self.database])]

    @property
    def writes(self) -> list[str]:
        """Files that are written."""
        return [self.output]

    def with_paths(self, change: PathChange) -> Self:
        """Return the job with each path changed, except that of the database."""
        return replace(
            self,
            inputs=tuple(map(change, self.inputs)),
            output=change(self.output),
            camera=self.camera and change(self.camera),
            reference=self.reference and change(self.reference),
        )

    def numbered(self, number: int) -> Self:
        """Return the job of one frame of a sequence."""
        return self.with_paths(lambda path: numbered(path, number))

    def absolute(self) -> Self:
        """Return the job for processes that work in another folder."""
        job = self.with_paths(os.path.abspath)
        if self.database is None or not os.path.exists(self.database):
            return job
        return replace(job, database=os.path.abspath(self.database))

    def check(self) -> None:
        """Raise an error, before anything is computed, if the image cannot be written or would replace what is read."""
        check_bit_depth(self.output, self.bit_depth)
        check_outputs(self.writes, self.reads)


def compared(image: Image, truth: Image) -> dict[str, float]:
    """Return the errors of an image; what that needs is loaded only here."""
    from spreadlets import metrics

    return metrics.compare(image, truth)
