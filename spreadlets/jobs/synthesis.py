"""The job of synthesis: a frame in files, or its layers, with depth of field and motion blur put on it."""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, Self

from spreadlets.errors import InvalidParameterError, SpreadletsError, option
from spreadlets.files.images import OPENEXR, image_extension
from spreadlets.files.sequence import is_pattern, numbered
from spreadlets.jobs.job import Job, PathChange, Progress, compared

if TYPE_CHECKING:
    from spreadlets.arrays import Image
    from spreadlets.files.exr_file import Source
    from spreadlets.files.recognise import ReadOptions
    from spreadlets.models import Model
    from spreadlets.psf.database import Database
    from spreadlets.scene.camera import ThinLens
    from spreadlets.scene.frame import Frame
    from spreadlets.scene.raster import Raster

PASSES = ("depth_file", "motion_file", "alpha_file")
"""Options of reading that name a file."""


class _Given(NamedTuple):
    """What the files hold: frame, further colour layers as frames by name, camera, reference, and all other channels.

    And of each frame before or after the frame itself, and its further colour layers.
    """

    frame: Frame
    elements: dict[str, Frame]
    camera: ThinLens
    truth: Image | None
    channels: dict[str, Any]
    neighbours: list[tuple[Frame, dict[str, Frame]]]


@dataclass(frozen=True)
class Synthesis(Job):
    """A frame to blur, see `Job`.

    Attributes
    ----------
    reading : mapping
        How to read the frame, by the names of `ReadOptions`.
    aperture : mapping
        Its shape, in place of a database, as for `spreadlets.bokeh.bokeh_model`.
    also : sequence of str
        Further colour layers to blur.
    pass_through : bool
        Copy all other channels.
    output_coc : str or None
        File for the radii of the circle of confusion.
    hidden_from : sequence of (str, mapping)
        Frames right before or after, from which what is hidden is taken, each with how to read it. Of a sequence they
        are sequences, of which those before and after each frame are taken, if they are there.
    cameras_around : sequence of (float, str)
        Files that hold the cameras of the frames before and after, with their times: a camera that goes from one to the
        other carries the picture along. Of a sequence they are found by their numbers.
    time_code : float or None
        Of an animated camera in a USD file, the frame's number.
    of_sequence : bool
        Whether the frames in `hidden_from` were found by their numbers: one that cannot be used is then left out.
    """

    reading: Mapping[str, Any] = field(default_factory=dict)
    aperture: Mapping[str, Any] = field(default_factory=dict)
    also: Sequence[str] = ()
    pass_through: bool = False
    output_coc: str | None = None
    hidden_from: Sequence[tuple[str, Mapping[str, Any]]] = ()
    cameras_around: Sequence[tuple[float, str]] = ()
    time_code: float | None = None
    of_sequence: bool = False

    @property
    def others(self) -> list[str]:
        """Files that must be there besides the inputs, the database left out."""
        named = (*(self.reading.get(name) for name in PASSES), self.rendering.get("mask"), self.aperture.get("kernel"))
        return [*super().others, *filter(None, named)]

    @property
    def reads(self) -> list[str]:
        """Files that may be read."""
        around = [path for path, _ in self.hidden_from] + [path for _, path in self.cameras_around]
        return [*super().reads, *around]

    @property
    def writes(self) -> list[str]:
        """Files that are written."""
        return [*super().writes, *filter(None, [self.output_coc])]

    def with_paths(self, change: PathChange) -> Self:
        """Return the job with each path changed, except that of the database."""
        return replace(
            super().with_paths(change),
            reading=_changed(self.reading, PASSES, change),
            rendering=_changed(self.rendering, ("mask",), change),
            aperture=_changed(self.aperture, ("kernel",), change),
            output_coc=self.output_coc and change(self.output_coc),
            hidden_from=[(change(path), _changed(reading, PASSES, change)) for path, reading in self.hidden_from],
            cameras_around=[(time, change(path)) for time, path in self.cameras_around],
        )

    def numbered(self, number: int) -> Self:
        """Return the job of one frame of a sequence; the frames around it are taken for what is hidden in it."""
        around = [
            (numbered(path, at), _changed(reading, PASSES, partial(numbered, number=at)))
            for path, reading in self.hidden_from
            for at in (number - 1, number + 1)
        ]
        there = [(path, reading) for path, reading in around if os.path.exists(path)]
        # The camera may go on from frame to frame.
        pattern = self.camera or self.inputs[0]
        cameras = [(float(step), numbered(pattern, number + step)) for step in (-1, 1)] if is_pattern(pattern) else []
        cameras = [(time, path) for time, path in cameras if os.path.exists(path)]
        job = super().numbered(number)
        return replace(job, hidden_from=there, cameras_around=cameras, time_code=float(number), of_sequence=True)

    def check(self) -> None:
        """Raise an error, before anything is computed, if files or options do not fit each other."""
        coc, through = option("output_coc"), option("pass_through")
        if self.output_coc and image_extension(self.output_coc) != OPENEXR:
            raise InvalidParameterError(f"{coc} {self.output_coc}: radii have a sign; name the file {OPENEXR}")
        if self.pass_through and (self.rendering.get("proxy") or self.rendering.get("region")):
            raise InvalidParameterError(
                f"{through} copies channels of the whole frame: leave {option('proxy')} and {option('region')} out"
            )
        if image_extension(self.output) != OPENEXR and (self.also or self.pass_through):
            raise InvalidParameterError(f"{option('also')} and {through} are for OpenEXR; name the output {OPENEXR}")
        super().check()

    def make(self, progress: Progress | None = None) -> dict[str, Any]:
        """Make the image, write it, and return its report; an aperture's spreadlets may have to be built first.

        What this needs is loaded here, so that who only hands jobs out starts in no time.
        """
        from spreadlets.files.further_channels import named_channels
        from spreadlets.files.images import write_image, write_plane
        from spreadlets.files.pictures import read_plane
        from spreadlets.renderer import Renderer
        from spreadlets.runtime.clock import Clock

        clock = Clock()
        with clock.step("read"):
            given = self._read()
        frame, camera, further = given.frame, given.camera, given.channels
        rendering = dict(self.rendering)
        if rendering.get("mask"):
            rendering["mask"] = read_plane(rendering["mask"])
        database = self._database(frame, camera)
        around = [neighbour for neighbour, _ in given.neighbours]
        # What is hidden in further colours is taken from theirs, which takes a plan of its own.
        frames = [] if around else list(given.elements.values())
        with Renderer(frame, database, hidden_from=around, progress=progress) as renderer:
            (image, *blurred), report = renderer.render_all(frames, camera, clock, **rendering)
            raster, coc = renderer.raster(**rendering), renderer.coc(camera, **rendering) if self.output_coc else None
        if frame.repaired_pixels or frame.dropped_pixels:
            text = f"{frame.repaired_pixels} invalid pixels were mended, {frame.dropped_pixels} dropped"
            warnings.warn(text, stacklevel=1)
        figures = compared(*_alike(image, given.truth, raster, rendering)) if given.truth is not None else {}
        for name, element in given.elements.items() if around else ():
            with Renderer(element, database, hidden_from=[each[name] for _, each in given.neighbours]) as apart:
                blurred.append(apart.render(camera, clock=clock, **rendering))
        for name, colours in zip(given.elements, blurred, strict=True):
            further |= named_channels(name, colours)
        with clock.step("write"):
            write_image(self.output, image, bit_depth=self.bit_depth, raster=raster, channels=further)
            if self.output_coc is not None and coc is not None:
                write_plane(self.output_coc, "coc", coc, raster=raster)
        return report.to_dict() | {"time_s": clock.times()} | figures

    def _read(self) -> _Given:
        """Read all that the files hold for this image."""
        from spreadlets.files.cameras import camera_of, moved_along
        from spreadlets.files.exr_file import opened
        from spreadlets.files.exr_frames import read_reference
        from spreadlets.files.further_channels import other_channels
        from spreadlets.files.recognise import ReadOptions

        with opened(self.inputs) as files:
            scale = self.reading.get("depth_scale", 1.0)
            camera = camera_of(self.camera, self.lens, files[0], scale, self.time_code)
            camera = moved_along(camera, self.cameras_around, scale)
            options = ReadOptions(**self.reading, camera=camera)
            frame, elements = self._coloured(files, options)
            channels: dict[str, Any] = {}
            if self.pass_through:
                channels = other_channels(files, frame.raster, options.colour_layer, options.view)
        truth = read_reference(self.reference, options) if self.reference else None
        around = [self._neighbour(path, ReadOptions(**each, camera=camera), frame) for path, each in self.hidden_from]
        return _Given(frame, elements, camera, truth, channels, [each for each in around if each is not None])

    def _neighbour(self, path: str, options: ReadOptions, frame: Frame) -> tuple[Frame, dict[str, Frame]] | None:
        """Read a frame to take what is hidden from; of a sequence, None if it is not fit for that."""
        from spreadlets.renderer import check_neighbours

        try:
            found = self._coloured([path], options)
            if len(frame.layers) == 1:
                check_neighbours([found[0]], frame)
        except SpreadletsError as error:
            # It is this frame's own error when its turn comes.
            if not self.of_sequence:
                raise
            warnings.warn(f"what is hidden is not taken from {path}: {error}", stacklevel=2)
            return None
        return found

    def _coloured(self, paths: Sequence[Source], options: ReadOptions) -> tuple[Frame, dict[str, Frame]]:
        """Read a frame, and its further colour layers."""
        from spreadlets.files.exr_file import opened
        from spreadlets.files.exr_frames import read_frame
        from spreadlets.files.further_channels import with_colours

        with opened(paths) as files:
            frame = read_frame(files, options=options)
            return frame, dict(with_colours(files, frame, self.also, options.view))

    def _database(self, frame: Frame, camera: ThinLens) -> Database | Model:
        """Return where the PSFs come from: the aperture's model, or an open database."""
        from spreadlets.bokeh import bokeh_model
        from spreadlets.jobs.databases import kept_database
        from spreadlets.renderer import default_database, shows_motion

        moving = bool(self.rendering.get("motion", True)) and shows_motion(frame, camera)
        if self.aperture:
            return bokeh_model(moving=moving, **self.aperture)
        return kept_database(self.database or default_database(moving))


def _changed(options: Mapping[str, Any], names: Sequence[str], change: PathChange) -> dict[str, Any]:
    """Return options of which those that name a file are changed."""
    return {name: change(value) if name in names and value else value for name, value in options.items()}


def _alike(image: Image, truth: Image, raster: Raster, rendering: Mapping[str, Any]) -> tuple[Image, Image]:
    """Return an image and its reference as the same pixels: those displayed, or of the region, at the proxy's size."""
    from spreadlets.scene.parts import means
    from spreadlets.scene.raster import placed

    window = raster.data if rendering.get("region") else raster.display
    truth = means(truth, raster.display.shape) if rendering.get("proxy") else truth
    return placed(image, raster.data, window), placed(truth, raster.display, window)
