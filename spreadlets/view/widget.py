"""The picture in a notebook, with its lens beside it: a widget that renders as the page in the browser does."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from spreadlets.errors import SpreadletsError
from spreadlets.packages import optional_package
from spreadlets.psf.database import Database
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.frame import Frame
from spreadlets.view.session import Request, Scene, Studio, Worker
from spreadlets.view.settings import Settings

SCRIPT = Path(__file__).parent / "page" / "widget.js"
SHOWN = ("f_number", "focal_length", "focus", "shutter", "exposure", "blades")
"""Settings that the widget has a slider for."""


def widget(frame: Frame | Sequence[Frame], camera: ThinLens, database: Database | str | None = None) -> Any:
    """Look at a frame through a camera in a notebook: sliders change the lens, a click focuses.

    Parameters
    ----------
    frame : Frame or sequence of Frame
        A pinhole frame, or depth layers, nearest first.
    camera : ThinLens
        That it begins with.
    database : Database or str, optional
        As for `Renderer`.

    Returns
    -------
    anywidget.AnyWidget
        Its attribute ``camera`` is the camera as the sliders stand, ``image`` the last whole picture, (H, W, 4)
        float32, None before the first; ``close()`` ends its work.

    Raises
    ------
    MissingPackageError
        If the package ``anywidget`` is missing, which the extra ``notebook`` brings.

    Examples
    --------
    >>> look = sp.widget(frame, camera)  # doctest: +SKIP
    >>> look  # doctest: +SKIP
    >>> image = sp.synthesize(frame, look.camera)  # doctest: +SKIP
    """
    studio = Studio(Scene(frame if isinstance(frame, Frame) else Frame.from_layers(list(frame)), camera, database))
    return _widget_class()(studio)


def _widget_class() -> Any:
    """Return the class of the widget, whose base is in an optional package."""
    anywidget, traitlets = (optional_package(name, "notebook", "the widget") for name in ("anywidget", "traitlets"))

    class Look(anywidget.AnyWidget):  # type: ignore[misc, name-defined]
        """Shows what a `Worker` renders, and hands it what is chosen."""

        # What the browser knows.
        _esm = SCRIPT
        shape = traitlets.List().tag(sync=True)
        settings = traitlets.Dict().tag(sync=True)
        ranges = traitlets.Dict().tag(sync=True)

        # What is rendered, by a thread of its own.
        def __init__(self, studio: Studio) -> None:
            self._studio, self._chosen = studio, Settings.of_camera(studio.scene.camera)
            super().__init__(
                shape=list(studio.scene.frame.shape), settings=_sliders(self._chosen), ranges=_ranges(studio)
            )
            self._worker = Worker(studio, lambda message, data: self.send(message, [data] if data else None))
            self._worker.start()
            self.on_msg(self._receive)

        # What a notebook's reader asks for.
        @property
        def camera(self) -> ThinLens:
            """The camera as the sliders stand."""
            return self._chosen.camera(self._studio.scene.camera)

        @property
        def image(self) -> Any:
            """The last whole picture."""
            return self._studio.latest

        def close(self) -> None:
            """End the rendering."""
            self._worker.close()
            self._studio.close()
            super().close()

        # What the browser asks for.
        def _receive(self, _: Any, message: Mapping[str, Any], buffers: Any) -> None:
            try:
                self._chosen = _changed(self._studio, self._chosen, message)
            except SpreadletsError as error:
                self.send({"type": "error", "text": str(error)})
                return
            self.settings = _sliders(self._chosen)
            self._worker.ask(Request(0, self._chosen, message.get("dragging") is True))

    return Look


def _changed(studio: Studio, chosen: Settings, message: Mapping[str, Any]) -> Settings:
    """Return the settings that a message leads to: some are given, or a point is clicked that is to be sharp."""
    changed = chosen.changed(message.get("settings", {}))
    if "click" in message:
        x, y = message["click"]
        left, top, *_ = studio.scene.frame.raster.data
        changed = changed.changed({"focus": studio.focus_at(left + x, top + y)})
    return changed


def _sliders(settings: Settings) -> dict[str, float]:
    return {name: getattr(settings, name) for name in SHOWN}


def _ranges(studio: Studio) -> dict[str, tuple[float, float]]:
    """Return the ends of each slider; that of the focus reaches as far as the frame, and all hold the camera's."""
    depth = studio.plain.depth[np.isfinite(studio.plain.depth)]
    near, far = (0.5 * float(depth.min()), 2.0 * float(depth.max())) if depth.size else (0.1, 100.0)
    own = {"f_number": (0.5, 32.0), "focal_length": (10.0, 300.0), "focus": (near, far), "shutter": (0.0, 360.0)}
    camera = _sliders(Settings.of_camera(studio.scene.camera))
    own = {name: (min(least, camera[name]), max(most, camera[name])) for name, (least, most) in own.items()}
    return own | {"exposure": (-6.0, 6.0), "blades": (0.0, 9.0)}
