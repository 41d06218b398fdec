"""The public functions that join the two halves: what ``import spreadlets`` offers beside the vocabulary."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Literal, overload

import numpy as np
import numpy.typing as npt

from spreadlets.camera import ThinLens
from spreadlets.database import Database, open_database
from spreadlets.errors import InvalidParameterError
from spreadlets.frame import Frame

if TYPE_CHECKING:
    from runtime.render import Clock

Image = npt.NDArray[np.float32]

METHODS = ("spreadlets", "dense", "gather")


@overload
def synthesize(
    frame: Frame | Sequence[Frame],
    camera: ThinLens,
    database: Database | str | None = ...,
    *,
    report: Literal[False] = ...,
    method: str = ...,
    integrator: str | None = ...,
    cycles: int | None = ...,
    tolerance: float | None = ...,
    defocus: bool = ...,
    motion: bool = ...,
    clock: Clock | None = ...,
) -> Image: ...


@overload
def synthesize(
    frame: Frame | Sequence[Frame],
    camera: ThinLens,
    database: Database | str | None = ...,
    *,
    report: Literal[True],
    method: str = ...,
    integrator: str | None = ...,
    cycles: int | None = ...,
    tolerance: float | None = ...,
    defocus: bool = ...,
    motion: bool = ...,
    clock: Clock | None = ...,
) -> tuple[Image, dict[str, Any]]: ...


def synthesize(
    frame: Frame | Sequence[Frame],
    camera: ThinLens,
    database: Database | str | None = None,
    *,
    method: str = "spreadlets",
    integrator: str | None = None,
    cycles: int | None = None,
    tolerance: float | None = None,
    defocus: bool = True,
    motion: bool = True,
    report: bool = False,
    clock: Clock | None = None,
) -> Image | tuple[Image, dict[str, Any]]:
    """Put the depth of field and the motion blur of a camera on a rendered frame.

    Parameters
    ----------
    frame : Frame or sequence of Frame
        A pinhole frame, or depth layers, nearest first.
    camera : ThinLens
        Lens and shutter.
    database : Database or str, optional
        An open database, a path, or a shipped name; by default ``"combined"`` if anything moves, else
        ``"simplelens"``.
    method : {"spreadlets", "dense", "gather"}
        Sparse Laplacian splatting; the same PSFs drawn in full (the quality ceiling); or filtering with the PSF of the
        receiving pixel.
    integrator : str, optional
        Poisson solver: ``multigrid`` (default), ``pyramid``, ``exact``, ``pyramid-f5`` or ``pyramid-f7``.
    cycles : int, optional
        Cycles of the integrator ``multigrid``: each takes the error down further.
    tolerance : float, optional
        Error of the displayed image, as a share of its range, that may be traded for speed by drawing blocks of like
        pixels as one; 0 draws every pixel by itself. The default is one step of an 8-bit display. The other
        methods always treat every pixel by itself.
    defocus, motion : bool
        Whether to apply each effect.
    report : bool
        Also return the figures of the run.
    clock : Clock, optional
        Adds the times of the steps to those that the caller has already taken.

    Returns
    -------
    image : ndarray of shape (H, W, 4), float32
        Linear, premultiplied.
    report : dict
        Only with ``report=True``: ``time_s``, ``compile_s``, ``peak_rss_mb``, ``plan``.

    Raises
    ------
    InvalidParameterError
        If the method or the integrator is unknown.
    InvalidDatabaseError
        If the database cannot be used.
    """
    from runtime import convolution_pyramid, render

    if method not in METHODS:
        raise InvalidParameterError(f"method {method!r} is unknown: allowed are {', '.join(METHODS)}")
    layered = frame if isinstance(frame, Frame) else Frame.from_layers(list(frame))
    opened = (
        database if isinstance(database, Database) else open_database(database or _default_database(layered, motion))
    )
    try:
        image, figures = render.synthesize(
            layered,
            camera,
            opened,
            defocus=defocus,
            motion=motion,
            integrator=integrator or convolution_pyramid.DEFAULT_METHOD,
            cycles=convolution_pyramid.DEFAULT_CYCLES if cycles is None else cycles,
            tolerance=render.DEFAULT_TOLERANCE if tolerance is None else tolerance,
            dense_psf=None if method == "spreadlets" else _dense_psf(opened),
            filtering=method == "gather",
            clock=clock,
        )
    finally:
        if opened is not database:
            opened.close()
    return (image, figures) if report else image


def build_database(
    model: str,
    path: str | os.PathLike[str],
    *,
    frames: Sequence[Frame] | None = None,
    camera: ThinLens | None = None,
    **options: Any,
) -> None:
    """Build a database, the whole of it or only what certain frames need.

    Parameters
    ----------
    model, path, options
        See `precompute.build.build_database`.
    frames : sequence of Frame, optional
        Build only the cells and directions that these frames use; needs the camera.
    camera : ThinLens, optional
        Lens and shutter for `frames`, and for models that depend on the camera.
    """
    from precompute.build import build_database as build
    from precompute.build import model_grid, takes_option

    if frames is not None and camera is None:
        raise InvalidParameterError("a database for certain frames needs the camera, too")
    if camera is not None and takes_option(model, "camera"):
        options["camera"] = camera
    elif camera is not None and frames is None:
        raise InvalidParameterError(f"the model {model!r} takes a camera only together with the frames to build for")
    if frames and takes_option(model, "width") and options.get("width") is None:
        options["width"] = frames[0].shape[1]
    if frames is not None and camera is not None:
        from runtime.plan import needed_spreadlets

        of_build = ("density", "rays", "jobs", "seed", "progress")
        grid = model_grid(model, **{name: value for name, value in options.items() if name not in of_build})
        options["only"] = set().union(*(needed_spreadlets(frame, camera, grid) for frame in frames))
    build(model, path, **options)


def plot_database(database: Database, path: str | os.PathLike[str]) -> None:
    """Draw the quality of an open database as a PNG file; see `spreadlets.plot.plot_database`."""
    from spreadlets.plot import plot_database as plot

    plot(database, path, _dense_psf(database))


def _default_database(frame: Frame, motion: bool) -> str:
    moving = motion and any(layer.motion.any() for layer in frame.layers)
    return "combined" if moving else "simplelens"


def _dense_psf(database: Database) -> Callable[[int, int, float], npt.NDArray[np.float64]]:
    """Return a function that traces the full PSF of a database's cell, as its build did."""
    from precompute.light_tracing import trace_psf

    def dense_psf(cell: int, direction: int, scale: float) -> npt.NDArray[np.float64]:
        grid = database.grid
        stretch = np.array([[scale if axis.scales else 1.0] for axis in grid.model.axes])
        return trace_psf(
            grid.model,
            grid.box(cell) * stretch,
            direction=float(database.directions(cell)[direction]),
            direction_half_width=grid.direction_half_width(cell),
            side=grid.side(cell, direction),
        )

    return dense_psf
