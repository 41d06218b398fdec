"""A frame and a database, ready to be looked at through one camera after another."""

from __future__ import annotations

import io
import warnings
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from operator import itemgetter
from threading import Lock
from types import TracebackType
from typing import TYPE_CHECKING, Any, Literal, Self, Unpack, overload

import numpy as np

from spreadlets.arrays import FloatArray, Image
from spreadlets.bokeh import BokehCache, Progress
from spreadlets.errors import AmbiguousInputWarning, InvalidParameterError, LeftOutError, option
from spreadlets.full_psfs import blurred_share, full_psfs
from spreadlets.models import Model
from spreadlets.psf.database import Database, open_database, shared_database
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.display import display_encode
from spreadlets.scene.doubts import depth_range, frame_doubts
from spreadlets.scene.frame import Frame
from spreadlets.scene.parts import (
    checked_mask,
    cut,
    depth_at,
    means,
    pixel_under,
    put_before,
    region_window,
    seen_depth,
    smaller,
    smaller_raster,
    without,
)
from spreadlets.scene.raster import Raster, Window
from spreadlets.scene.squares import Grid, squared

if TYPE_CHECKING:
    from spreadlets.runtime.clock import Clock
    from spreadlets.runtime.options import Options, RenderOptions
    from spreadlets.runtime.report import Report

MOST_PROXIES = 4
"""Sizes of a frame that are kept."""


class Renderer:
    """A frame and a database: what does not depend on the camera is kept, from the second picture on.

    Parameters
    ----------
    frame : Frame or sequence of Frame
        A pinhole frame, or depth layers, nearest first.
    database : Database, Model or str, optional
        An open database, a path, or a shipped name; by default ``"combined"`` if anything moves, else
        ``"simplelens"``. What is not open is opened when it is first needed, and closed with the renderer. For a
        model, such as ``spreadlets.models.Combined(blades=6)``, what the frame needs is built, and kept in this user's
        cache.
    hidden_from : Frame or sequence of Frame
        The frames of the sequence right before or after, or both, with the motion of their pixels. What is hidden in a
        frame of one layer, behind something near, is taken from where it was seen in them, and else guessed. Which
        frame comes before follows from where its colours fit better.
    progress : callable, optional
        Told the numbers of spreadlets that are built and of all, and of the seconds left, while a model is built.

    Notes
    -----
    It may be used from several threads at once. Its images are those of `synthesize`.

    Examples
    --------
    >>> import numpy as np
    >>> frame = sp.Frame(np.ones((32, 48, 3)), depth=np.full((32, 48), 4.0))
    >>> camera = sp.ThinLens(focal_length_mm=80, sensor_width_mm=36, f_number=2, focus_distance_m=2)
    >>> with sp.Renderer(frame, "simplelens") as renderer:
    ...     image = renderer.render(camera)
    ...     renderer.coc(camera)[0, 0].round(2), renderer.depth_at(24, 16)
    (np.float32(0.53), 4.0)
    >>> image.shape
    (32, 48, 4)
    """

    def __init__(
        self,
        frame: Frame | Sequence[Frame],
        database: Database | Model | str | None = None,
        *,
        hidden_from: Frame | Sequence[Frame] = (),
        progress: Progress | None = None,
    ) -> None:
        from spreadlets.runtime.label.surfaces import KeptSurfaces, split_surfaces

        self.frame = frame if isinstance(frame, Frame) else Frame.from_layers(list(frame))
        self._neighbours = [hidden_from] if isinstance(hidden_from, Frame) else list(hidden_from)
        check_neighbours(self._neighbours, self.frame)
        self._database = database
        self._bokeh = BokehCache(database, progress) if isinstance(database, Model) else None
        self._opened: list[Database] = []
        self._named: dict[str, Database] = {}
        self._current: Database | None = None
        self._proxies: dict[float, Frame] = {1.0: self.frame}
        self._depths: dict[float, FloatArray] = {}
        self._split = KeptSurfaces(split_surfaces)
        self._lock = Lock()
        self._shown: Image | None = None

    @overload
    def render(
        self,
        camera: ThinLens,
        *,
        report: Literal[False] = ...,
        clock: Clock | None = ...,
        **options: Unpack[RenderOptions],
    ) -> Image: ...

    @overload
    def render(
        self, camera: ThinLens, *, report: Literal[True], clock: Clock | None = ..., **options: Unpack[RenderOptions]
    ) -> tuple[Image, Report]: ...

    def render(
        self,
        camera: ThinLens,
        *,
        report: bool = False,
        clock: Clock | None = None,
        **options: Unpack[RenderOptions],
    ) -> Image | tuple[Image, Report]:
        """Return the frame as a camera sees it.

        Parameters
        ----------
        camera, report, clock, options
            As for `synthesize`.

        Returns
        -------
        image : ndarray of shape (H, W, 4), float32
            Linear, premultiplied; of a region or a proxy in its size.
        report : Report
            Only with ``report=True``.
        """
        (image,), figures = self._rendered([], camera, clock, options)
        return (image, figures) if report else image

    def render_all(
        self, further: Sequence[Frame], camera: ThinLens, clock: Clock | None = None, **options: Unpack[RenderOptions]
    ) -> tuple[list[Image], Report]:
        """Return the frame and others that differ from it in their colours only, all drawn by its plan.

        Parameters
        ----------
        further : sequence of Frame
            Such as `Frame.coloured` makes: elements of its picture.
        camera, clock, options
            As for `render`.

        Returns
        -------
        images : list of ndarray of shape (H, W, 4), float32
            That of the frame first.
        report : Report
            With the figures of the frame.

        Raises
        ------
        InvalidParameterError
            As `render` does; or if there are further frames, and the renderer takes what is hidden from others.
        """
        if further and self._neighbours:
            raise InvalidParameterError(
                f"{option('hidden_from')} is of one frame: draw further ones by renderers of their own"
            )
        return self._rendered(further, camera, clock, options)

    def _rendered(
        self, further: Sequence[Frame], camera: ThinLens, clock: Clock | None, options: RenderOptions
    ) -> tuple[list[Image], Report]:
        from spreadlets.runtime.options import Options

        chosen = Options.of(**options)
        if self._neighbours and (chosen.layers == 1 or chosen.method == "gather"):
            raise InvalidParameterError(
                f"{option('hidden_from')} is for a frame that is divided by depth: not with layers=1, nor with the "
                "method 'gather'"
            )
        camera = self._focused(camera, chosen)
        _warn(frame_doubts(self.frame, camera, self._depth_range))
        images, figures = self._synthesized(further, camera, chosen, clock)
        images = [self._cut(image, chosen) for image in images]
        self._shown = images[0]
        return images, figures

    def raster(self, **options: Unpack[RenderOptions]) -> Raster:
        """Return where the pixels of an image lie that `render` makes with these options."""
        from spreadlets.runtime.options import Options

        chosen = Options.of(**options)
        raster = smaller_raster(self.frame.raster, chosen.proxy)
        if chosen.region is None:
            return raster
        return replace(raster, data=region_window(chosen.region, self.frame.raster, chosen.proxy), stored=None)

    def camera(self, camera: ThinLens, **options: Unpack[RenderOptions]) -> ThinLens:
        """Return the camera that `render` uses with these options: fitted to the frame, and focused at ``focus_at``."""
        from spreadlets.runtime.options import Options

        return self._focused(camera, Options.of(**options))

    def coc(self, camera: ThinLens, **options: Unpack[RenderOptions]) -> FloatArray:
        """Return the signed radius of the circle of confusion of what is seen in each pixel.

        Parameters
        ----------
        camera : ThinLens
        options
            Those that change it, see `synthesize`: ``near_strength``, ``far_strength``, ``in_focus``, ``max_coc``,
            ``focus_at``; and ``region`` and ``proxy``.

        Returns
        -------
        ndarray of shape (H, W), float32
            Pixels of the whole frame, negative in front of the focus; of a lens that changes, in mid-exposure.
        """
        from spreadlets.runtime.options import Options

        chosen = Options.of(**options)
        camera = self._focused(camera, chosen)
        camera = camera.at(camera.shutter_centre)
        depth = self._cut(self._seen_depth(chosen.proxy), chosen)
        width = self.frame.raster.display.width
        radius = np.asarray(camera.coc_radius(depth, width), np.float32)
        if chosen.change_coc:
            radius = chosen.coc(radius, depth, camera.coc_scale(width))
        return radius

    @property
    def depth(self) -> FloatArray:
        """Depth of what is seen in each pixel, (H, W) float32, metres; ``inf`` where there is nothing."""
        return self._seen_depth(1.0)

    def proxy_depth(self, share: float) -> FloatArray:
        """Return the depth of what is seen in each pixel of a proxy of this share of the size, (h, w) float32."""
        return self._seen_depth(share)

    def depth_at(self, x: float, y: float) -> float:
        """Return the depth of the surface under a point, metres.

        Parameters
        ----------
        x, y : float
            Column and row, px; 0, 0 is the first pixel, unless the file's windows say otherwise.

        Returns
        -------
        float
            The median of the pixels around that belong to the same surface.

        Raises
        ------
        InvalidParameterError
            If the point lies outside the frame.
        """
        return depth_at(self.depth, self.frame.raster, x, y)

    def motion_at(self, camera: ThinLens, x: float, y: float) -> tuple[float, float]:
        """Return the motion of what is nearest under a point as it is drawn, (dx, dy), px per frame.

        That of the frame's motion vectors; or, if it has none, as the camera's move makes it.

        Parameters
        ----------
        camera : ThinLens
        x, y : float
            As for `depth_at`.

        Raises
        ------
        InvalidParameterError
            As `depth_at` does.
        """
        from spreadlets.runtime.label.carried import carried

        layer, raster = self.frame.layers[0], self.frame.raster
        row, col = pixel_under(raster, x, y)
        motion = layer.motion[row, col]
        if camera.moves_picture and not self._moves_itself:
            # A lens sees squares: divide the pixel into them, and follow the first.
            left, top = raster.data[:2]
            alone = replace(raster, data=Window(left + col, top + row, 1, 1), stored=None)
            take = itemgetter(np.s_[row : row + 1, col : col + 1])
            pixel = replace(layer.mapped(take, take, take(layer.radiance)), raster=alone)
            camera = camera.fitted(raster.display.shape, raster.pixel_aspect)
            (moved,) = carried(squared(Frame.of([pixel])).layers, camera)
            motion = moved.motion[0, 0] / np.array(Grid.of(raster.pixel_aspect).per_pixel, np.float32)
        return float(motion[0]), float(motion[1])

    @cached_property
    def _moves_itself(self) -> bool:
        from spreadlets.runtime.label.carried import moves_itself

        return moves_itself(self.frame.layers)

    def close(self) -> None:
        """Close the databases that this renderer has opened."""
        with self._lock:
            if self._bokeh is not None:
                self._bokeh.store()
            for database in self._opened:
                database.close()
            self._opened.clear()
            self._named.clear()
            self._current = None

    def __enter__(self) -> Self:
        """Return the renderer."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close it."""
        self.close()

    def _repr_png_(self) -> bytes:
        """Return the picture that was made last as a notebook shows it: PNG, or before any the frame itself."""
        from PIL import Image as Picture

        shown = self.frame.layers[0].radiance if self._shown is None else self._shown
        file = io.BytesIO()
        encoded = np.rint(255.0 * np.nan_to_num(display_encode(shown[..., :3]))).astype(np.uint8)
        Picture.fromarray(encoded).save(file, "PNG", compress_level=1)
        return file.getvalue()

    def _synthesized(
        self, further: Sequence[Frame], camera: ThinLens, options: Options, clock: Clock | None
    ) -> tuple[list[Image], Report]:
        """Return the whole images of proxies, with what is held out put before them."""
        from spreadlets.runtime import render

        whole = [self._proxy(options.proxy), *(smaller(each, options.proxy) for each in further)]
        frames, mask, chosen = whole, None, options
        if options.mask is not None:
            mask = means(checked_mask(options.mask, self.frame), whole[0].shape)
            frames = [without(each, mask) for each in whole]
        if options.max_coc is not None:
            options = replace(options, max_coc=options.max_coc * options.proxy)
        # Open the database for what moves.
        with self._lock:
            database = self._open(options.motion and shows_motion(frames[0], camera))
        # Render; PSFs that the database lacks are built, and then once more.
        try:
            neighbours = [smaller(each, options.proxy) for each in self._neighbours]
            images, figures = render.synthesize_all(
                frames, camera, database, options, clock, neighbours=neighbours, **self._drawing(database, options)
            )
        except LeftOutError as error:
            if self._bokeh is None:
                raise
            self._build(self._bokeh, database, error.places)
            return self._synthesized(further, camera, chosen, clock)
        if mask is not None:
            images = [put_before(image, each, mask) for image, each in zip(images, whole, strict=True)]
        return images, figures

    def _drawing(self, database: Database, options: Options) -> dict[str, Any]:
        """Return what draws PSFs in full, divides mixed pixels and tells of a medium, as `synthesize_all` takes it."""
        dense_psf, exact_psf = full_psfs(database, options)
        own = {"dense_psf": dense_psf, "exact_psf": exact_psf, "split": self._split}
        return {**own, "blurred_share": blurred_share(database)}

    @cached_property
    def _depth_range(self) -> tuple[float, float]:
        return depth_range(self.frame)

    def _proxy(self, share: float) -> Frame:
        with self._lock:
            if share not in self._proxies:
                while len(self._proxies) > MOST_PROXIES:
                    oldest = [each for each in self._proxies if each != 1.0][0]
                    self._depths.pop(oldest, None)
                    del self._proxies[oldest]
                self._proxies[share] = smaller(self.frame, share)
            return self._proxies[share]

    def _seen_depth(self, share: float) -> FloatArray:
        frame = self._proxy(share)
        with self._lock:
            if share not in self._depths:
                self._depths[share] = seen_depth(frame)
            return self._depths[share]

    def _cut(self, values: FloatArray, options: Options) -> FloatArray:
        """Return the region of an array (H, W, ...) of a proxy's pixels."""
        if options.region is None:
            return values
        raster = self.frame.raster
        wanted = region_window(options.region, raster, options.proxy)
        return cut(values, smaller_raster(raster, options.proxy).data, wanted)

    def _focused(self, camera: ThinLens, options: Options) -> ThinLens:
        if not isinstance(camera, ThinLens):
            kind = type(camera).__name__
            raise InvalidParameterError(f"camera is a {kind}; it must be a ThinLens, such as read_camera returns")
        camera = camera.fitted(self.frame.raster.display.shape, self.frame.raster.pixel_aspect)
        if options.focus_at is None:
            return camera
        return camera.held(focus_distance_m=self.depth_at(*options.focus_at))

    def _open(self, moving: bool) -> Database:
        """Return the database, opened if it is not."""
        if isinstance(self._database, Database):
            return self._database
        if self._bokeh is not None:
            if self._current is None:
                self._current = self._bokeh.open()
                self._bokeh.recall()
                self._opened.append(self._current)
            return self._current
        assert not isinstance(self._database, Model)
        name = self._database or default_database(moving)
        if name not in self._named:
            found = shared_database(name)
            if found is None:
                found = open_database(name)
                self._opened.append(found)
            self._named[name] = found
        return self._named[name]

    def _build(self, bokeh: BokehCache, database: Database, places: Sequence[tuple[int, int]]) -> None:
        """Add spreadlets to those of the cache, unless another thread has added some; that is then looked at anew."""
        with self._lock:
            if self._current is database:
                bokeh.add(places)
                # Other threads may still read the one before.
                self._current = None


def check_neighbours(neighbours: Sequence[Frame], frame: Frame) -> None:
    """Raise InvalidParameterError if nothing can be taken from the neighbouring frames of another."""
    name = option("hidden_from")
    if neighbours and len(frame.layers) > 1:
        raise InvalidParameterError(f"{name} is for a frame of one layer; what is hidden is known of one in layers")
    for number, each in enumerate(neighbours):
        if len(each.layers) > 1:
            raise InvalidParameterError(
                f"{name} has a frame of {len(each.layers)} layers (number {number}); give frames of one"
            )
        if each.raster != frame.raster:
            raise InvalidParameterError(
                f"{name} has a frame (number {number}) of {each.shape[0]} x {each.shape[1]} px, but the frame has "
                f"{frame.shape[0]} x {frame.shape[1]}, or their data windows differ; give frames of one sequence"
            )


def shows_motion(frame: Frame, camera: ThinLens) -> bool:
    """Tell whether anything moves in the picture: by the frame's vectors, or as the camera does."""
    return camera.moves_picture or any(layer.has_motion for layer in frame.layers)


def default_database(moving: bool) -> str:
    """Return the name of the database for a frame that moves, or not."""
    return "combined" if moving else "simplelens"


def _warn(doubts: Sequence[str]) -> None:
    """Warn the caller of a renderer's method of each doubt."""
    for doubt in doubts:
        warnings.warn(doubt, AmbiguousInputWarning, stacklevel=4)
