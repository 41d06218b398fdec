"""The public functions that join the two halves: what ``import spreadlets`` offers beside the vocabulary."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Literal, Unpack, overload

from spreadlets.arrays import Image
from spreadlets.errors import AmbiguousInputWarning, InvalidParameterError, option
from spreadlets.full_psfs import DensePsfs as DensePsfs
from spreadlets.full_psfs import full_psfs
from spreadlets.models import Model, option_names
from spreadlets.psf.database import Database, open_database, shared_database
from spreadlets.renderer import Renderer, default_database
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.doubts import sample_doubts
from spreadlets.scene.frame import Frame
from spreadlets.scene.samples import SampleBuffer
from spreadlets.scene.squares import squared_samples, unsquared

if TYPE_CHECKING:
    from spreadlets.runtime.clock import Clock
    from spreadlets.runtime.options import RenderOptions
    from spreadlets.runtime.report import Report


@overload
def synthesize(
    frame: Frame | Sequence[Frame],
    camera: ThinLens,
    database: Database | Model | str | None = ...,
    *,
    hidden_from: Frame | Sequence[Frame] = ...,
    report: Literal[False] = ...,
    clock: Clock | None = ...,
    **options: Unpack[RenderOptions],
) -> Image: ...


@overload
def synthesize(
    frame: Frame | Sequence[Frame],
    camera: ThinLens,
    database: Database | Model | str | None = ...,
    *,
    hidden_from: Frame | Sequence[Frame] = ...,
    report: Literal[True],
    clock: Clock | None = ...,
    **options: Unpack[RenderOptions],
) -> tuple[Image, Report]: ...


def synthesize(
    frame: Frame | Sequence[Frame],
    camera: ThinLens,
    database: Database | Model | str | None = None,
    *,
    hidden_from: Frame | Sequence[Frame] = (),
    report: bool = False,
    clock: Clock | None = None,
    **options: Unpack[RenderOptions],
) -> Image | tuple[Image, Report]:
    """Put the depth of field and the motion blur of a camera on a rendered frame.

    Parameters
    ----------
    frame : Frame or sequence of Frame
        A pinhole frame, or depth layers, nearest first.
    camera : ThinLens
        Lens and shutter.
    database : Database, Model or str, optional
        An open database, a path, or a shipped name; by default ``"combined"`` if anything moves, else
        ``"simplelens"``. For a model, such as ``spreadlets.models.Combined(blades=6)``, what the frame needs is built,
        and kept in this user's cache.
    hidden_from : Frame or sequence of Frame
        The frames of the sequence right before or after, or both, with the motion of their pixels. What is hidden in a
        frame of one layer, behind something near, is taken from where it was seen in them, and else guessed. Which
        frame comes before follows from where its colours fit better.
    method : {"spreadlets", "dense", "dense-rows", "gather"}
        Sparse Laplacian splatting; the same PSFs drawn in full (the quality ceiling), pixel by pixel or as differences
        along rows that are summed up at the end; or filtering with the PSF of the receiving pixel.
    vignetting : bool
        Whether to darken the image towards its corners as the lens of a database of ``physicallens`` does.
    report : bool
        Also return the figures of the run.
    integrator : str, optional
        Poisson solver: ``multigrid`` (default), ``pyramid``, ``exact``, ``pyramid-f5`` or ``pyramid-f7``.
    cycles : int, optional
        Cycles of the integrator ``multigrid``: each takes the error down further.
    tolerance : float, optional
        Error of the displayed image, as a share of its range, that may be traded for speed by drawing blocks of like
        pixels as one; 0 draws every pixel by itself. The default is one step of an 8-bit display, of samples
        three. The other methods always treat every pixel by itself.
    layers : int, optional
        Depth layers, at most. By default a frame that comes in layers keeps them, and any other is divided into as many
        as it needs, at most 12; 1 draws all pixels into one image and normalises it by accumulated weight.
    softness : float, optional
        Width of the transition between depth layers, in layers: 0 (hard, the default of a frame) to 1 (soft, that of
        samples).
    firefly_clamp : float, optional
        How many times as bright as any other within a pixel of where it comes from a pixel, or a sample, may be, 1 or
        more. In synthesis by default any, since a single pixel may be a true highlight; in reconstruction 32, and
        infinity for any.
    defocus, motion : bool
        Whether to apply each effect.
    focus_at : tuple of float, optional
        Focus on what lies at this pixel (x, y).
    in_focus : tuple of float, optional
        ``(near, far)``: keep these depths sharp, metres.
    near_strength, far_strength : float
        Factors of the blur in front of and behind what is in focus.
    max_coc : float, optional
        Largest radius of the circle of confusion, px.
    highlights : tuple of float, optional
        ``(gain, threshold)``: multiply the light of blurred pixels above the threshold.
    mask : array_like of shape (H, W), optional
        Keep sharp, and out of the blur, where it is 1; of a frame of one layer.
    region : tuple of int, optional
        ``(x, y, width, height)`` of the part of the picture to return, px.
    proxy : float
        Return a smaller picture of this share of the size.
    clock : Clock, optional
        Adds the times of the steps to those that the caller has already taken.

    Returns
    -------
    image : ndarray of shape (H, W, 4), float32
        Linear, premultiplied.
    report : Report
        Only with ``report=True``: ``time_s``, ``compile_s``, ``peak_rss_mb`` and ``plan``, as attributes or by name.

    Raises
    ------
    InvalidParameterError
        If the method or the integrator is unknown, a parameter is out of its range, the database knows no vignetting,
        or nothing can be taken from ``hidden_from``.
    InvalidDatabaseError
        If the database cannot be used.

    Warns
    -----
    AmbiguousInputWarning
        If values do not fit each other, such as a focus far outside the frame's depths.

    Examples
    --------
    A lamp, 4 m away, seen by a camera that is focused at 2 m, becomes a disc; its light is kept:

    >>> import numpy as np
    >>> radiance = np.zeros((48, 48, 3))
    >>> radiance[24, 24] = 100.0
    >>> frame = sp.Frame(radiance, depth=np.full((48, 48), 4.0))
    >>> camera = sp.ThinLens(focal_length_mm=80, sensor_width_mm=36, f_number=2, focus_distance_m=2)
    >>> image = sp.synthesize(frame, camera, "simplelens")
    >>> image.shape, round(float(image[..., 0].sum()))
    ((48, 48, 4), 100)
    >>> image, report = sp.synthesize(frame, camera, "simplelens", report=True)
    >>> report.plan.cells_total, "motion" in report.plan.left_out
    (400, True)
    """
    with Renderer(frame, database, hidden_from=hidden_from) as renderer:
        image, figures = renderer.render(camera, report=True, clock=clock, **options)
    return (image, figures) if report else image


@overload
def reconstruct(
    samples: SampleBuffer,
    camera: ThinLens,
    database: Database | str | None = ...,
    *,
    report: Literal[False] = ...,
    settings: Mapping[str, object] | None = ...,
    clock: Clock | None = ...,
    progress: Callable[[int, int], None] | None = ...,
    **options: Unpack[RenderOptions],
) -> Image: ...


@overload
def reconstruct(
    samples: SampleBuffer,
    camera: ThinLens,
    database: Database | str | None = ...,
    *,
    report: Literal[True],
    settings: Mapping[str, object] | None = ...,
    clock: Clock | None = ...,
    progress: Callable[[int, int], None] | None = ...,
    **options: Unpack[RenderOptions],
) -> tuple[Image, Report]: ...


def reconstruct(
    samples: SampleBuffer,
    camera: ThinLens,
    database: Database | str | None = None,
    *,
    report: bool = False,
    settings: Mapping[str, object] | None = None,
    clock: Clock | None = None,
    progress: Callable[[int, int], None] | None = None,
    **options: Unpack[RenderOptions],
) -> Image | tuple[Image, Report]:
    """Make a clean image of a buffer of stochastic samples that hold lens and shutter already.

    Parameters
    ----------
    samples : SampleBuffer
        Labelled samples, any number in each pixel.
    camera, database, report, clock, options
        As for `synthesize`. Without an effect (``defocus=False``) the image is what a camera without it would see.
    method : str
        ``spreadlets``: sparse Laplacian splatting. ``dense``, ``dense-rows``: the same PSFs drawn in full. ``sheared``,
        ``axis-aligned``: layered reconstruction (SLR 2015). ``lrdm``, ``lrdm-sheared``, ``lrdm-ewa``: of motion, too
        (LRDM 2014, and with two faster screen filters of 2015). ``tlfr``: of both, with exact visibility, slow (TLFR
        2011). ``mean``: the mean of each pixel's samples, the plain
        Monte Carlo image. ``bm3d``, ``oidn``: that image, denoised, with the optional packages of that name.
    settings : mapping, optional
        Of a method that others have published, by name, see the fields of `runtime.sheared.slr.Slr`,
        `runtime.sheared.lrdm.Lrdm` and `runtime.sheared.tlfr.Tlfr`; in the first two, ``layers`` is the number of
        partitions over both sides of focus.
    progress : callable, optional
        Told, by the methods that have settings, how many parts of the image are done, and of how many.
    denoise : {"oidn", "bm3d"}, optional
        Denoise what is sharp and still, which splatting cannot clean, with the optional package of that name; by
        default off. For methods that splat.
    calibrate : bool
        Bring the image's local means to those of the samples, if these are spread over lens and shutter and all effects
        are shown. For methods that splat.

    Returns
    -------
    image : ndarray of shape (H, W, 4), float32
        Linear, premultiplied.
    report : Report
        Only with ``report=True``, as for `synthesize`.

    Raises
    ------
    InvalidParameterError
        If the method, the integrator or a setting is unknown or not one of the method's, a parameter is out of its
        range, or an optional package is missing.
    InvalidDatabaseError
        If the database cannot be used.

    Examples
    --------
    The mean of each pixel's samples, the plain Monte Carlo image:

    >>> import numpy as np
    >>> rng = np.random.default_rng(0)
    >>> shape = (16, 16, 4)
    >>> samples = sp.SampleBuffer(
    ...     radiance=rng.random((*shape, 3)),
    ...     depth=np.full(shape, 4.0),
    ...     motion=np.zeros((*shape, 2)),
    ...     lens_uv=rng.uniform(-0.7, 0.7, (*shape, 2)),
    ...     time=np.zeros(shape),
    ... )
    >>> camera = sp.ThinLens(focal_length_mm=80, sensor_width_mm=36, f_number=2, focus_distance_m=2)
    >>> mean = sp.reconstruct(samples, camera, method="mean")
    >>> clean = sp.reconstruct(samples, camera)
    >>> bool(clean[..., 0].std() < mean[..., 0].std())
    True
    """
    from spreadlets.runtime import render
    from spreadlets.runtime.options import (
        METHODS,
        PUBLISHED_METHODS,
        RECONSTRUCTION_METHODS,
        Options,
        check_for_samples,
        check_method,
    )

    # Check the method, and that samples and camera fit.
    method = options.get("method", "spreadlets")
    check_method(method, RECONSTRUCTION_METHODS)
    check_for_samples(options)
    _warn(sample_doubts(samples, camera))
    camera = camera.fitted(samples.raster.display.shape, samples.raster.pixel_aspect)
    squares = squared_samples(samples)
    if settings and method not in PUBLISHED_METHODS:
        raise InvalidParameterError(f"method {method!r} has no settings; those with are {', '.join(PUBLISHED_METHODS)}")
    # Methods without splatting need no database.
    if method not in METHODS:
        image, figures = _without_splatting(squares, camera, method, settings or {}, clock, progress, options)
    else:
        # Splat.
        chosen = Options.of(**options)
        with _opened(database, chosen.motion and bool(samples.motion.any())) as opened:
            image, figures = render.reconstruct(squares, camera, opened, chosen, clock, *full_psfs(opened, chosen))
    image = unsquared(image, samples.raster)
    return (image, figures) if report else image


def _without_splatting(
    samples: SampleBuffer,
    camera: ThinLens,
    method: str,
    settings: Mapping[str, object],
    clock: Clock | None,
    progress: Callable[[int, int], None] | None,
    options: RenderOptions,
) -> tuple[Image, Report]:
    """Reconstruct with a method that needs no database."""
    from spreadlets.runtime.options import DENOISERS, PUBLISHED_METHODS, SPLATTING_OPTIONS, Options

    # Find the options that were changed, and refuse those of splatting.
    default = Options()
    changed: dict[str, Any] = {
        k: v for k, v in options.items() if v is not None and k != "method" and v != getattr(default, k)
    }
    for name in SPLATTING_OPTIONS:
        if name in changed:
            raise InvalidParameterError(f"{option(name)} is no option of method {method!r}")
    # Reconstruct as others have published it.
    if method in PUBLISHED_METHODS:
        from spreadlets.runtime.sheared import reconstruct as layered

        if "layers" in changed:
            settings = {"layers": changed.pop("layers"), **settings}
        made = layered.make_method(method, settings)
        return layered.reconstruct(samples, camera, made, **changed, clock=clock, progress=progress)
    # Or average the samples of each pixel, and denoise if that was asked for.
    for name in changed:
        raise InvalidParameterError(f"{option(name)} is no option of method {method!r}, which takes the image as it is")
    from spreadlets.runtime.clock import Clock
    from spreadlets.runtime.finish.average import average

    clock = clock or Clock()
    image, figures = average(samples, clock)
    if method in DENOISERS:
        from spreadlets.runtime.finish.denoise import denoise

        image, figures = denoise(image, method, clock)
    return image, figures


def tune_layered_methods() -> dict[str, Any]:
    """Find how the work of the methods ``lrdm``, ``lrdm-sheared`` and ``lrdm-ewa`` is best divided on this machine.

    Returns
    -------
    dict
        ``file`` where the ``work_sizes`` are kept, and ``time_ms`` by step and size.
    """
    from spreadlets.runtime.sheared.tune import tune

    sizes, times = tune()
    return {"file": str(sizes.save()), "work_sizes": vars(sizes), "time_ms": times}


def _warn(doubts: Sequence[str]) -> None:
    """Warn the caller of a public function of each doubt."""
    for doubt in doubts:
        warnings.warn(doubt, AmbiguousInputWarning, stacklevel=3)


@contextmanager
def _opened(database: Database | str | None, moving: bool) -> Iterator[Database]:
    """Open a database for the block, unless it is open."""
    if isinstance(database, Database):
        yield database
        return
    name = database or default_database(moving)
    if (shared := shared_database(name)) is not None:
        yield shared
        return
    with open_database(name) as opened:
        yield opened


def build_database(
    model: str | Model,
    path: str | os.PathLike[str],
    *,
    frames: Sequence[Frame] | None = None,
    camera: ThinLens | None = None,
    **options: Any,
) -> None:
    """Build a database, the whole of it or only what certain frames need.

    Parameters
    ----------
    model : str or Model
        Name of a PSF model, or one with options, such as ``spreadlets.models.Combined(max_coc=64, blades=6)``.
    path, options
        See `precompute.build.build.build_database`.
    frames : sequence of Frame, optional
        Build only the cells and poses that these frames use; needs the camera.
    camera : ThinLens, optional
        Lens and shutter for `frames`, and for models that depend on the camera.

    Examples
    --------
    >>> sp.build_database("simplelens", "small.h5", samples=4, max_coc=4.0, jobs=1)
    >>> with sp.open_database("small.h5") as database:
    ...     database.n_cells
    4
    """
    from spreadlets.precompute.build.build import build_database as build
    from spreadlets.precompute.build.build import build_grid

    # Take the name and the options apart.
    name = model if isinstance(model, str) else model.name
    if not isinstance(model, str):
        options = model.options() | options
    # Fit the camera to the frames.
    if frames is not None and camera is None:
        raise InvalidParameterError("a database for certain frames needs the camera, too")
    if frames and camera is not None:
        camera = camera.fitted(frames[0].raster.display.shape, frames[0].raster.pixel_aspect)
    # Give camera and width to models that depend on them.
    extend = bool(options.get("extend"))
    if camera is not None and "camera" in option_names(name) and not extend:
        options["camera"] = camera
    elif camera is not None and frames is None:
        raise InvalidParameterError(f"the model {name!r} takes a camera only together with the frames to build for")
    if frames and "width" in option_names(name) and options.get("width") is None and not extend:
        options["width"] = frames[0].shape[1]
    # Find the spreadlets that the frames need.
    if frames is not None and camera is not None:
        from spreadlets.runtime.plan.plan import needed_spreadlets

        of_build = ("density", "sparsifier", "rays", "jobs", "scheduler", "seed", "extend", "progress", "log")
        settings = {name: value for name, value in options.items() if name not in of_build}
        grid = build_grid(name, path, extend, **settings)
        options["only"] = set().union(*(needed_spreadlets(frame, camera, grid) for frame in frames))
    build(name, path, **options)


def verify_database(database: Database, **options: Any) -> dict[str, Any]:
    """Check an open database against its recorded figures; see `precompute.build.verification.verify_database`."""
    from spreadlets.precompute.build.verification import verify_database as verify

    return verify(database, **options)
