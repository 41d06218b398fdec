"""The PSF models by name: how each reads its options and traces its PSFs; and the PSF of a cell, traced.

What a model's parameters are, the runtime has to know, too: that is `spreadlets.psf.model.MODELS`.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import DoubleArray
from spreadlets.errors import InvalidParameterError
from spreadlets.precompute.models import aperture, combined, physicallens, simplelens, stylized, volume
from spreadlets.precompute.models.exact_cache import CachedPsfs
from spreadlets.precompute.models.lens_mesh import lens_psf
from spreadlets.precompute.trace.light_tracing import crop, draw_segments, footprint
from spreadlets.precompute.trace.line_sample import Painter, Tracer
from spreadlets.psf.capsule import exact_capsules
from spreadlets.psf.exact import ExactPsf
from spreadlets.psf.model import PsfModel

EXACT_RAYS = 1 << 18
"""Deposits for the PSF of a single coordinate: without a pre-filter there is less to sample."""


class ModelEntry(NamedTuple):
    """What a PSF model needs for a build.

    Attributes
    ----------
    read_settings : callable
        Turns the options of the model, see `spreadlets.models`, into its settings.
    tracer : callable
        What makes the PSFs of a model on a side of the focus (1 behind, -1 in front).
    exact : callable
        What makes the PSFs of single coordinates for a model; None if its cells are so fine that they are exact.
    blurred_share : callable, optional
        How much of a layer's opacity is blurred to one beyond, for a model and two distances; by default all.
    """

    read_settings: Callable[..., dict[str, Any]]
    tracer: Callable[[PsfModel, int], Tracer | Painter]
    exact: Callable[[PsfModel], ExactPsf | None]
    blurred_share: Callable[[PsfModel, float, float], float] | None = None


def _thin_lens(own: Tracer) -> Callable[[PsfModel, int], Tracer]:
    """Return the tracer of each side: of a round, even aperture the model's own, the same for both."""
    return lambda model, side: aperture.tracer(model, side) if model.settings else own


def _exact_thin_lens(model: PsfModel) -> ExactPsf:
    """Return the PSFs of a thin lens: in closed form; or, of an aperture of its own, drawn, or traced in motion."""
    if not model.settings:
        return exact_capsules
    return CachedPsfs(partial(aperture.drawn_psf if aperture.is_drawn(model) else _traced_exactly, model))


def _traced_exactly(model: PsfModel, coordinate: tuple[float, ...], angle: float, side: int) -> DoubleArray:
    """Trace the PSF of a single coordinate."""
    box = np.repeat(np.array(coordinate)[:, None], 2, axis=1)
    return trace_psf(model, box, angle=angle, side=side, rays=EXACT_RAYS)


REGISTRY = {
    "simplelens": ModelEntry(simplelens.read_settings, _thin_lens(simplelens.ROUND), _exact_thin_lens),
    "combined": ModelEntry(combined.read_settings, _thin_lens(combined.ROUND), _exact_thin_lens),
    "physicallens": ModelEntry(
        physicallens.read_settings, physicallens.tracer, lambda model: CachedPsfs(lens_psf(model))
    ),
    "stylized": ModelEntry(
        stylized.read_settings, stylized.tracer, lambda model: CachedPsfs(stylized.image_psf(model))
    ),
    "volume": ModelEntry(volume.read_settings, volume.tracer, lambda model: None, volume.blurred_share),
}

_EXACT: dict[tuple[str, str], ExactPsf | None] = {}


def exact_psf(model: PsfModel) -> ExactPsf | None:
    """Return what makes the PSFs of single coordinates, the same for all databases of a model with equal settings.

    Parameters
    ----------
    model : PsfModel

    Returns
    -------
    ExactPsf or None
        None if the model's cells are so fine that their PSFs are exact, as those of ``volume`` are.
    """
    key = model.name, json.dumps([[axis.maximum for axis in model.axes], dict(model.settings)], sort_keys=True)
    if key not in _EXACT:
        _EXACT[key] = REGISTRY[model.name].exact(model)
    return _EXACT[key]


def blurred_share(model: PsfModel) -> Callable[[float, float], float] | None:
    """Return what tells how much of a layer's opacity is blurred to one beyond; None if all of it always is.

    Parameters
    ----------
    model : PsfModel

    Returns
    -------
    callable or None
        Of the distances of the nearer layer and the farther one, metres.
    """
    share = REGISTRY[model.name].blurred_share
    return None if share is None else partial(share, model)


def trace_psf(
    model: PsfModel,
    box: npt.ArrayLike,
    *,
    angle: float = 0.0,
    angle_half_width: float = 0.0,
    side: int = 1,
    rays: int | None = None,
    seed: int = 0,
) -> DoubleArray:
    """Trace the PSF of one cell, pre-filtered over the cell.

    Parameters
    ----------
    model : PsfModel
    box : array_like of shape (n_axes, 2)
        Range of each parameter, physical units; a range of no width is not filtered.
    angle : float
        Direction of the motion (dx, dy) = (cos, sin), y down, radians; for models with direction.
    angle_half_width : float
        Half-width of the tent over the direction, radians; 0 for no filter.
    side : int
        1 behind the focus, -1 in front of it; for models that tell them apart.
    rays : int, optional
        Work, in point-equivalent deposits: a segment counts as 1 + its length in px. By default the tracer's own for
        each pixel of the smallest box along the motion that holds the PSF, and at least
        `trace.light_tracing.MIN_RAYS`. Models that are not traced by segments count paths.
    seed : int
        Of the shift of the low-discrepancy points.

    Returns
    -------
    ndarray of shape (H, W, C), float64
        H and W odd, centred on the mid-shutter position, cropped to the support and 1 px around it. The sum over the
        pixels, averaged over the channels, is 1.

    Raises
    ------
    InvalidParameterError
        If the model has no tracer, the box is none of the model's, or ``rays`` is below 1.

    Notes
    -----
    LKS sections 5.3 and 5.4.
    """
    ranges = _checked_box(model, box)
    if rays is not None and rays < 1:
        raise InvalidParameterError(f"rays must be at least 1, not {rays}")
    tracer = REGISTRY[model.name].tracer(model, side)
    if isinstance(tracer, Painter):
        psf = tracer.paint(ranges, rays, seed)
    else:
        pose = angle, angle_half_width
        psf = draw_segments(tracer, ranges, pose, rays, seed)
    return crop(psf * (model.n_channels / psf.sum()))


def psf_footprint(model: PsfModel, box: npt.ArrayLike, *, angle: float, angle_half_width: float, side: int) -> float:
    """Return about how many pixels the PSF of a cell covers, without tracing it.

    Parameters
    ----------
    model, box, angle, angle_half_width, side
        As for `trace_psf`.

    Returns
    -------
    float
        See `trace.light_tracing.footprint`; for a model that is not traced by segments the same for all cells.
    """
    ranges = _checked_box(model, box)
    tracer = REGISTRY[model.name].tracer(model, side)
    return 1.0 if isinstance(tracer, Painter) else footprint(tracer, ranges, angle, angle_half_width)


def _checked_box(model: PsfModel, box: npt.ArrayLike) -> DoubleArray:
    """Return the box as float64 (n_axes, 2), or say why it cannot be traced."""
    if model.name not in REGISTRY:
        raise InvalidParameterError(f"no tracer for PSF model {model.name!r}; available: {', '.join(sorted(REGISTRY))}")
    ranges = np.asarray(box, dtype=np.float64)
    if ranges.shape != (model.n_axes, 2):
        raise InvalidParameterError(
            f"the box of {model.name!r} needs shape ({model.n_axes}, 2), low and high per axis, not {ranges.shape}"
        )
    if not (np.isfinite(ranges).all() and (ranges[:, 0] >= 0.0).all() and (ranges[:, 0] <= ranges[:, 1]).all()):
        raise InvalidParameterError(f"each range of the box needs 0 <= low <= high < inf, not {ranges.tolist()}")
    return ranges
