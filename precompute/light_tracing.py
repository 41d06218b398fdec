"""Dense, pre-filtered PSFs by light tracing (LKS sections 5.3 and 5.4).

Where LKS traces 700 million single rays, this tracer traces *line samples*: a model turns each low-discrepancy point
into one or more segments on the image, over which it has integrated analytically, and each segment is deposited
exactly, pixel by pixel. A thin lens with constant motion has two such integrals, both along one line: over the shutter,
as a lens point's image moves straight and evenly, and over a chord of the lens, as its image is a straight line, too.
Choosing the chords parallel to the motion merges the two into one segment, whose density rises, stays and falls. What
is left to sample is the place of the chord and the extent of the pre-filter, so that some hundred segments across a
pixel leave less noise than millions of points. (Line samples: Jones and Perry 2000, "Antialiasing with line samples".)

A model without such an analytic integral emits segments of no length: plain rays.

The pre-filter replaces the parameters of the PSF by a tent over the cell: the box of parameters, and to both sides of
the direction. Its dimensions are part of the same low-discrepancy set, so it costs no further loop (LKS section 5.4).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from precompute import combined, simplelens
from precompute._tracing_kernels import CHUNK, deposit_segments, kronecker
from precompute.line_sample import Segments
from spreadlets.errors import InvalidParameterError
from spreadlets.psf_model import PsfModel

FloatArray = npt.NDArray[np.float64]

RAYS_PER_PIXEL = 1024
"""Default point-equivalent deposits per pixel of the smallest box along the motion that holds the PSF."""

MIN_RAYS = 1 << 17
"""Smallest default: in a PSF of few pixels, nearly all of them lie on the edge."""

PILOT_POINTS = 1024
"""Points whose segments are measured to learn how many points the deposits pay for."""

N_BLOCKS = 8
"""Images that are filled independently and then summed in order: the same sum for any number of threads."""


@dataclass(frozen=True)
class Tracer:
    """How the rays of one PSF model are made.

    Parameters
    ----------
    n_dimensions : int
        Length of the points that ``trace`` takes. The first coordinate is the best distributed.
    trace : callable
        ``(points, box, direction, direction_half_width) -> Segments``.
    reach : callable
        ``(box) -> px``: no segment leaves the square of this half-side.
    symmetrise : callable
        ``(psf) -> psf``: average over the symmetries that the PSF has, for less noise and none in its symmetry.
    """

    n_dimensions: int
    trace: Callable[[FloatArray, FloatArray, float, float], Segments]
    reach: Callable[[FloatArray], float]
    symmetrise: Callable[[FloatArray], FloatArray]


def _point_symmetric(psf: FloatArray) -> FloatArray:
    """Average a PSF (H, W, C) with its half turn."""
    return 0.5 * (psf + psf[::-1, ::-1])


def _lattice_symmetric(psf: FloatArray) -> FloatArray:
    """Average a square PSF (H, H, C) over the lattice's eight symmetries."""
    mirrored = psf + psf[::-1]
    mirrored = mirrored + mirrored[:, ::-1]
    return 0.125 * (mirrored + mirrored.swapaxes(0, 1))


TRACERS = {
    "simplelens": Tracer(simplelens.N_DIMENSIONS, simplelens.trace, simplelens.reach, _lattice_symmetric),
    "combined": Tracer(combined.N_DIMENSIONS, combined.trace, combined.reach, _point_symmetric),
}


def trace_psf(
    model: PsfModel,
    box: npt.ArrayLike,
    *,
    direction: float = 0.0,
    direction_half_width: float = 0.0,
    rays: int | None = None,
    seed: int = 0,
) -> FloatArray:
    """Trace the PSF of one cell, pre-filtered over the cell.

    Parameters
    ----------
    model : PsfModel
    box : array_like of shape (n_axes, 2)
        Range of each parameter, physical units; a range of no width is not filtered.
    direction : float
        Direction of the motion (dx, dy) = (cos, sin), y down, radians; for models with direction.
    direction_half_width : float
        Half-width of the tent over the direction, radians; 0 for no filter.
    rays : int, optional
        Work, in point-equivalent deposits: a segment counts as 1 + its length in px. By default `RAYS_PER_PIXEL` for
        each pixel of the smallest box along the motion that holds the PSF, and at least `MIN_RAYS`.
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
    tracer = TRACERS[model.name]
    half = math.ceil(tracer.reach(ranges) + 0.5)
    if rays is not None and rays < 1:
        raise InvalidParameterError(f"rays must be at least 1, not {rays}")

    def make_segments(first: int, total: int) -> Segments:
        points = kronecker(first, total, shift, _generators(tracer.n_dimensions - 1))
        return tracer.trace(points, ranges, direction, direction_half_width)

    shift = np.random.default_rng(seed).random(tracer.n_dimensions)
    pilot = make_segments(0, PILOT_POINTS)
    n_points = math.ceil((rays or _default_rays(pilot, direction)) * PILOT_POINTS / _cost(pilot))
    images = np.zeros((N_BLOCKS, 2 * half + 1, 2 * half + 1, model.n_channels))
    for first in range(0, n_points, CHUNK):
        deposit_segments(*make_segments(first, n_points), images)
    psf = tracer.symmetrise(images.sum(axis=0))
    return _crop(psf * (model.n_channels / psf.sum()))


def _checked_box(model: PsfModel, box: npt.ArrayLike) -> FloatArray:
    """Return the box as float64 (n_axes, 2), or say why it cannot be traced."""
    if model.name not in TRACERS:
        raise InvalidParameterError(f"no tracer for PSF model {model.name!r}; available: {', '.join(sorted(TRACERS))}")
    ranges = np.asarray(box, dtype=np.float64)
    if ranges.shape != (model.n_axes, 2):
        raise InvalidParameterError(
            f"the box of {model.name!r} needs shape ({model.n_axes}, 2), low and high per axis, not {ranges.shape}"
        )
    if not (np.isfinite(ranges).all() and (ranges[:, 0] >= 0.0).all() and (ranges[:, 0] <= ranges[:, 1]).all()):
        raise InvalidParameterError(f"each range of the box needs 0 <= low <= high < inf, not {ranges.tolist()}")
    return ranges


def _generators(n: int) -> FloatArray:
    """Return the n generators of the R_n sequence: inverse powers of the generalised golden ratio.

    Its ratio g solves ``g ** (n + 1) = g + 1`` (Roberts 2018, "The unreasonable effectiveness of quasirandom
    sequences"); the iteration contracts by more than 3 a step, so 64 steps reach the last bit.
    """
    ratio = 1.5
    for _ in range(64):
        ratio = (1.0 + ratio) ** (1.0 / (n + 1))
    return np.asarray(ratio ** -np.arange(1.0, n + 1.0), dtype=np.float64)


def _default_rays(segments: Segments, direction: float) -> int:
    """Return the default work for a PSF of which these segments are a sample."""
    along = np.array([math.cos(direction), math.sin(direction)])
    ends = segments.ends.reshape(-1, 2)
    length, width = (np.ptp(ends @ axis) + 3.0 for axis in (along, np.array([-along[1], along[0]])))
    return max(MIN_RAYS, math.ceil(RAYS_PER_PIXEL * float(length * width)))


def _cost(segments: Segments) -> float:
    """Return the point-equivalent deposits of segments: 1 + length in px for each."""
    x0, y0, x1, y1 = segments.ends.T
    return float(np.sum(1.0 + np.hypot(x1 - x0, y1 - y0)))


def _crop(psf: FloatArray) -> FloatArray:
    """Crop a PSF symmetrically to its support and a border of 1 px."""
    padded = np.pad(psf, ((1, 1), (1, 1), (0, 0)))
    row, col, _ = np.nonzero(padded)
    height, width = padded.shape[0] // 2, padded.shape[1] // 2
    half_row, half_col = np.abs(row - height).max() + 1, np.abs(col - width).max() + 1
    return padded[height - half_row : height + half_row + 1, width - half_col : width + half_col + 1]
