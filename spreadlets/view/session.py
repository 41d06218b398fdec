"""The work behind the page: one thread for each open page renders the newest request, and nothing else.

While something is dragged, a proxy is made that keeps up; when it rests, the whole picture. A request that is overtaken
by a newer one is dropped between two steps of its rendering.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from spreadlets.arrays import FloatArray
from spreadlets.errors import InvalidFrameError, SpreadletsError, options_spelled
from spreadlets.psf.database import Database
from spreadlets.renderer import Renderer, shows_motion
from spreadlets.runtime.clock import Clock
from spreadlets.runtime.report import Report
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.frame import Frame
from spreadlets.scene.raster import placed
from spreadlets.view import picture
from spreadlets.view.drafts import (
    ALL_BUT_ONE_LAYER,
    DRAFT,
    FAST_S,
    FIRST_SIDE,
    LEFT_OUT,
    TOO_SLOW_S,
    DraftRenderer,
    ladder,
)
from spreadlets.view.settings import BOUNDS, Settings, spelled

RESTING_S = 0.05
"""How long a drag must rest before the whole picture is begun: if it goes on, that is dropped."""
LOOK_S = 0.01
"""How often it is looked whether something that is waited for is wanted still."""
MOST_APERTURES = 4
"""Renderers of apertures that are kept open."""

Send = Callable[[dict[str, Any], bytes], None]


class Request(NamedTuple):
    """What a page asks for: a number of its own, the settings, and whether they are being dragged."""

    number: int
    settings: Settings
    dragging: bool = False
    judging: bool = False


class Superseded(BaseException):
    """A newer request has come, or the page is closed: nobody waits for this picture."""


class Watch(Clock):
    """A clock that stops a rendering between its steps.

    Parameters
    ----------
    superseded : callable
        Tells whether to stop.
    """

    def __init__(self, superseded: Callable[[], bool]) -> None:
        super().__init__()
        self._superseded = superseded

    @contextmanager
    def step(self, name: str) -> Iterator[None]:
        """Raise `Superseded` if this is not wanted any more, or else time the block."""
        if self._superseded():
            raise Superseded
        with super().step(name):
            yield


@dataclass(frozen=True)
class Scene:
    """What is looked at.

    Attributes
    ----------
    frame : Frame
    camera : ThinLens
        That the page begins with.
    database : Database, str or None
    reference : ndarray of shape (H, W, 3 or 4), float32, or None
        Of the display window.
    frames : tuple of str
        The frame's files.
    camera_file : str or None

    Raises
    ------
    InvalidFrameError
        If the reference has another size.
    """

    frame: Frame
    camera: ThinLens
    database: Database | str | None = None
    reference: FloatArray | None = None
    frames: tuple[str, ...] = ()
    camera_file: str | None = None

    def __post_init__(self) -> None:
        display = self.frame.raster.display
        if self.reference is not None and self.reference.shape[:2] != display.shape:
            height, width = self.reference.shape[:2]
            raise InvalidFrameError(
                f"the reference has {width} x {height} px, the frame displays {display.width} x {display.height}"
            )


class Ahead(threading.Thread):
    """Renders what a page begins with, before there is one: while the page is loaded, nothing else is to be done.

    Parameters
    ----------
    studio : Studio
    settings : Settings
    """

    def __init__(self, studio: Studio, settings: Settings) -> None:
        super().__init__(name="spreadlets-view-ahead", daemon=True)
        self._studio, self._settings = studio, settings
        self._unwanted = False
        self._found: tuple[FloatArray, Report] | None = None

    def run(self) -> None:
        """Render, until it is dropped."""
        # What fails here fails again where it is asked for, and is told there.
        with suppress(Superseded, SpreadletsError):
            self._found = self._studio.whole(self._settings, lambda: self._unwanted)

    def drop(self) -> None:
        """Stop: something else is asked for."""
        self._unwanted = True

    def take(self, settings: Settings, superseded: Callable[[], bool]) -> tuple[FloatArray, Report] | None:
        """Return the picture, as soon as it is there; None, and stop, if other settings are asked for.

        Raises
        ------
        Superseded
            If that is so before.
        """
        if settings.rendering != self._settings.rendering:
            self.drop()
            return None
        while self.is_alive():
            self.join(LOOK_S)
            if superseded():
                raise Superseded
        return self._found


class Studio:
    """The renderers of a scene, for all pages that look at it.

    Attributes
    ----------
    latest : ndarray of shape (H, W, 4), float32, or None
        The last whole picture.
    kernels : dict of str to str
        Images of PSFs that pages have sent: their names, and the files that hold them.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self._renderers: dict[tuple[Any, bool], Renderer] = {}
        self.latest: FloatArray | None = None
        self.kernels: dict[str, str] = {}
        self._lock = threading.Lock()
        self._begins_with = Settings.of_camera(scene.camera)
        self.plain = self.renderer(self._begins_with, draft=False)
        self._ahead = Ahead(self, self._begins_with)

    @property
    def moving(self) -> bool:
        """Whether anything moves."""
        return shows_motion(self.scene.frame, self.scene.camera)

    def renderer(self, settings: Settings, *, draft: bool, progress: Callable[..., None] | None = None) -> Renderer:
        """Return the renderer of an aperture; or that of its drafts."""
        model = settings.model(moving=self.moving)
        key = model, draft
        with self._lock:
            if key not in self._renderers:
                kind = DraftRenderer if draft else Renderer
                self._renderers[key] = kind(self.scene.frame, model or self.scene.database, progress=progress)
                others = [each for each in self._renderers if each[0] is not None and each != key]
                # A page may still use one; it is closed when nobody does.
                for old in others[: max(len(others) - 2 * MOST_APERTURES, 0)]:
                    del self._renderers[old]
            return self._renderers[key]

    def begin(self) -> None:
        """Begin with the picture that pages begin with."""
        self._ahead.start()

    def whole(
        self, settings: Settings, superseded: Callable[[], bool], progress: Callable[..., None] | None = None
    ) -> tuple[FloatArray, Report]:
        """Return the whole picture and its report.

        Raises
        ------
        Superseded
            If that is so before it is done.
        """
        renderer = self.renderer(settings, draft=False, progress=progress)
        camera = settings.camera(self.scene.camera)
        return renderer.render(camera, **settings.options(), report=True, clock=Watch(superseded))

    def begun(self, settings: Settings, superseded: Callable[[], bool]) -> tuple[FloatArray, Report] | None:
        """Return the picture that was begun with, if these are its settings, as soon as it is there; else None.

        Raises
        ------
        Superseded
            If that is so before.
        """
        return self._ahead.take(settings, superseded)

    def stop(self) -> None:
        """Stop what was begun with."""
        self._ahead.drop()

    def focus_at(self, x: float, y: float) -> float:
        """Return the distance, m, at which what lies under a point is in focus, as a setting: the sky's is finite."""
        return min(self.plain.depth_at(x, y), BOUNDS["focus"][1])

    def pinhole(self) -> FloatArray:
        """Return the frame without any blur, (H, W, 4) float32."""
        image = np.zeros((*self.scene.frame.shape, 4), np.float32)
        for layer in self.scene.frame.layers:
            image += (np.float32(1.0) - image[..., 3:]) * layer.radiance
        return image

    def placed_reference(self) -> FloatArray | None:
        """Return the reference as it lies in the frame's data window."""
        raster = self.scene.frame.raster
        if self.scene.reference is None:
            return None
        return placed(self.scene.reference, raster.display, raster.data)

    def close(self) -> None:
        """Close all databases."""
        self.stop()
        if self._ahead.is_alive():
            self._ahead.join()
        with self._lock:
            for renderer in self._renderers.values():
                renderer.close()
            self._renderers.clear()


class Worker(threading.Thread):
    """Renders the newest request of a page.

    Parameters
    ----------
    studio : Studio
    send : callable
        Takes a message and the bytes that go with it; may block.
    """

    def __init__(self, studio: Studio, send: Send) -> None:
        super().__init__(name="spreadlets-view", daemon=True)
        self._studio, self._send = studio, send
        self._pending: Request | None = None
        self._closed = False
        self._changed = threading.Condition()
        self._ladder = ladder(max(studio.scene.frame.shape))
        self._rung = next(
            (
                rung
                for rung, (share, _) in enumerate(self._ladder)
                if share * max(studio.scene.frame.shape) <= FIRST_SIDE
            ),
            len(self._ladder) - 1,
        )
        self.full: tuple[tuple[Any, ...], FloatArray, dict[str, Any]] | None = None

    def ask(self, request: Request) -> None:
        """Take a request, in place of one that waits."""
        with self._changed:
            self._pending = request
            self._changed.notify()

    def close(self) -> None:
        """Let the thread end."""
        with self._changed:
            self._closed = True
            self._changed.notify()

    def run(self) -> None:
        """Work until the page is closed."""
        while (request := self._next()) is not None:
            try:
                with options_spelled(spelled):
                    self._answer(request)
            except Superseded:
                continue
            except SpreadletsError as error:
                self._tell({"type": "error", "number": request.number, "text": str(error)})
            except Exception as error:
                self._tell({"type": "error", "number": request.number, "text": f"{type(error).__name__}: {error}"})

    def _tell(self, message: dict[str, Any], data: bytes = b"") -> None:
        if self._closed:
            raise Superseded
        self._send(message, data)

    def _next(self) -> Request | None:
        with self._changed:
            self._changed.wait_for(lambda: self._closed or self._pending is not None)
            request, self._pending = self._pending, None
            return None if self._closed else request

    def _overtaken(self) -> bool:
        return self._closed or self._pending is not None

    def _rests(self, seconds: float) -> bool:
        """Wait, and tell whether no request came."""
        with self._changed:
            return not self._changed.wait_for(self._overtaken, seconds)

    def _answer(self, request: Request) -> None:
        """Send the proxy of a drag, and the whole picture as soon as it rests."""
        if request.dragging and not self._is_known(request):
            self._draft(request)
            if not self._rests(RESTING_S):
                return
        image, report = self._whole(request)
        self._show(request, image, 1.0, {**report, "full": True})
        truth = self._studio.placed_reference()
        if request.judging and truth is not None and self._rests(RESTING_S):
            from spreadlets import metrics  # a tenth of the time to the first picture

            figures = metrics.compare(image, truth)
            self._tell({"type": "metrics", "number": request.number, **figures})

    def _is_known(self, request: Request) -> bool:
        return self.full is not None and self.full[0] == request.settings.rendering

    def _draft(self, request: Request) -> None:
        self._studio.stop()
        share, n_layers = self._ladder[self._rung]
        begin = time.perf_counter()
        renderer = self._studio.renderer(request.settings, draft=True, progress=self._progress)
        options = {"layers": n_layers, **DRAFT, **request.settings.options(), "proxy": share}
        camera = request.settings.camera(self._studio.scene.camera)
        image, report = renderer.render(camera, **options, report=True)
        took = time.perf_counter() - begin
        left_out = [*LEFT_OUT, *([ALL_BUT_ONE_LAYER] if options["layers"] == 1 else [])]
        self._show(request, image, share, {"time_s": report.time_s, "plan": {"left_out": left_out}, "full": False})
        if took > TOO_SLOW_S:
            self._rung = min(self._rung + 1, len(self._ladder) - 1)
        elif took < FAST_S:
            self._rung = max(self._rung - 1, 0)

    def _whole(self, request: Request) -> tuple[FloatArray, dict[str, Any]]:
        """Return the whole picture and what is told of it; the one before, if only its display changes."""
        if self.full is not None and self._is_known(request):
            return self.full[1], self.full[2]
        settings, given = request.settings, (request.settings, self._overtaken)
        image, report = self._studio.begun(*given) or self._studio.whole(*given, self._progress)
        told = {"time_s": report.time_s, "plan": dict(report.plan)}
        self.full, self._studio.latest = (settings.rendering, image, told), image
        return image, told

    def _progress(self, done: int, total: int, *left_s: float | None) -> None:
        self._tell({"type": "progress", "done": done, "total": total})

    def _show(self, request: Request, image: FloatArray, share: float, report: dict[str, Any]) -> None:
        """Send a picture with its overlay."""
        settings, scene = request.settings, self._studio.scene
        canvas = picture.shown(image, settings.exposure)
        if settings.overlay == "coc":
            coc = self._studio.plain.coc(settings.camera(scene.camera), **settings.options(), proxy=share)
            canvas = picture.with_coc(canvas, coc)
        elif settings.overlay == "depth":
            canvas = picture.with_depth(canvas, self._studio.plain.proxy_depth(share))
        height, width = canvas.shape[:2]
        command = settings.command_line(list(scene.frames), scene.camera_file, scene.camera)
        message = {"type": "picture", "number": request.number, "width": width, "height": height, "share": share}
        self._tell({**message, "command": command, **report}, canvas.tobytes())
