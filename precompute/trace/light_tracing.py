"""Dense, pre-filtered PSFs by light tracing (LKS sections 5.3 and 5.4).

Where LKS traces 700 million single rays, this tracer traces *line samples*: a model turns each low-discrepancy point
into one or more segments on the image, over which it has integrated analytically, and each segment is deposited
exactly, pixel by pixel. A thin lens with constant motion has two such integrals, both along one line: over the shutter,
as a lens point's image moves straight and evenly, and over a chord of the lens, as its image is a straight line, too.
Choosing the chords parallel to the motion merges the two into one segment, whose density rises, stays and falls. What
is left to sample is the place of the chord and the extent of the pre-filter, so that some hundred segments across a
pixel leave less noise than millions of points. (Line samples: Jones and Perry 2000, "Antialiasing with line samples".)

A model without such an analytic integral emits chains of short segments between neighbouring rays.

The pre-filter replaces the parameters of the PSF by a tent over the cell: the box of parameters, and to both sides of
the direction. Its dimensions are part of the same low-discrepancy set, so it costs no further loop (LKS section 5.4).
"""

import math

import numpy as np

from spreadlets.arrays import DoubleArray
from spreadlets.errors import InvalidParameterError
from spreadlets.parallel import for_blocks
from spreadlets.precompute.trace._tracing_kernels import deposit_segments, kronecker
from spreadlets.precompute.trace.line_sample import Segments, Tracer

MIN_RAYS = 1 << 17
"""Smallest default: in a PSF of few pixels, nearly all of them lie on the edge."""

CHUNK = 1 << 16
"""Segments made at a time: bounds the memory that a trace needs (a few MB), large enough to hide NumPy's call cost."""

MAX_REACH_PX = 2048
"""Farthest that light may go from a PSF's centre, px: its images then take some gigabytes."""

FOOTPRINT_POINTS = 64
"""Points whose segments tell roughly how large a PSF is."""

PILOT_POINTS = 1024
"""Points whose segments are measured to learn how many points the deposits pay for."""

BLUR_REACH = 4.0
"""Standard deviations at which the pre-filter's blur ends."""

N_BLOCKS = 8
"""Images that are filled independently and then summed in order: the same sum for any number of threads."""


def footprint(tracer: Tracer, box: DoubleArray, angle: float, angle_half_width: float) -> float:
    """Return about how many pixels a PSF covers, without tracing it.

    Parameters
    ----------
    tracer : Tracer
    box : ndarray of shape (n_axes, 2), float64
        Range of each parameter, physical units.
    angle, angle_half_width : float
        Radians.

    Returns
    -------
    float
        Pixels of the smallest box along the direction that holds some of the PSF's segments.
    """
    own = tracer.generators
    generators = _generators(tracer.n_dimensions - 1) if own is None else np.array(own)
    shift = np.full(tracer.n_dimensions, 0.5)
    points = kronecker(0, FOOTPRINT_POINTS, FOOTPRINT_POINTS, shift, generators)
    segments = tracer.trace(points, box, angle, angle_half_width)
    return _box_area(segments, angle) if len(segments.ends) else 1.0


def draw_segments(
    tracer: Tracer, box: DoubleArray, pose: tuple[float, float], rays: int | None, seed: int
) -> DoubleArray:
    """Draw as many segments as the rays pay for.

    Parameters
    ----------
    tracer : Tracer
    box : ndarray of shape (n_axes, 2), float64
        Range of each parameter, physical units.
    pose : tuple of two floats
        Direction and half-width of its tent, radians.
    rays : int or None
        Point-equivalent deposits; by default the tracer's own number for each pixel that the PSF covers.
    seed : int

    Returns
    -------
    ndarray of shape (H, W, C), float64
        The sum, centred.

    Raises
    ------
    InvalidParameterError
        If the PSF reaches farther than `MAX_REACH_PX`.
    """
    from scipy import ndimage  # only tracing needs it, and it takes time to import

    # Size the image by the PSF's reach and the pre-filter's.
    reach = tracer.reach(box)
    if not reach <= MAX_REACH_PX:
        raise InvalidParameterError(
            f"a PSF of this cell reaches {reach:g} px; at most {MAX_REACH_PX} px are traced: narrow the model's ranges"
        )
    blur = tracer.blur(box)
    half = math.ceil(reach + 0.5) + math.ceil(BLUR_REACH * blur)
    own = tracer.generators
    generators = _generators(tracer.n_dimensions - 1) if own is None else np.array(own)

    def make_segments(first: int, total: int, most: int) -> Segments:
        points = kronecker(first, total, most, shift, generators)
        return tracer.trace(points, box, *pose)

    # Estimate the PSF's area, and the cost of a point, from a pilot set.
    chunk = max(CHUNK // tracer.segments_per_point, 1)
    shift = np.random.default_rng(seed).random(tracer.n_dimensions)
    pilot = make_segments(0, PILOT_POINTS, PILOT_POINTS)
    n_rays = rays or max(MIN_RAYS, math.ceil(tracer.rays_per_pixel * _box_area(pilot, pose[0])))
    n_points = math.ceil(n_rays * PILOT_POINTS / _cost(pilot))
    # Deposit the segments chunk by chunk, a share of them into each image of a stack.
    images = np.zeros((N_BLOCKS, 2 * half + 1, 2 * half + 1, pilot.start.shape[1]))
    for first in range(0, n_points, chunk):
        for_blocks(deposit_segments, len(images), *make_segments(first, n_points, chunk), images)
    # Pre-filter the sum.
    psf = ndimage.gaussian_filter(images.sum(axis=0), blur, axes=(0, 1), mode="constant", truncate=BLUR_REACH)
    return tracer.symmetrise(np.asarray(psf))


def _generators(n: int) -> DoubleArray:
    """Return the n generators of the R_n sequence: inverse powers of the generalised golden ratio.

    Its ratio g solves ``g ** (n + 1) = g + 1`` (Roberts 2018, "The unreasonable effectiveness of quasirandom
    sequences"); the iteration contracts by more than 3 a step, so 64 steps reach the last bit.
    """
    ratio = 1.5
    for _ in range(64):
        ratio = (1.0 + ratio) ** (1.0 / (n + 1))
    return np.asarray(ratio ** -np.arange(1.0, n + 1.0), dtype=np.float64)


def _box_area(segments: Segments, angle: float) -> float:
    """Return the pixels of the smallest box along a direction that holds segments, with a margin of a pixel."""
    along = np.array([math.cos(angle), math.sin(angle)])
    ends = segments.ends.reshape(-1, 2)
    length, width = (np.ptp(ends @ axis) + 3.0 for axis in (along, np.array([-along[1], along[0]])))
    return float(length * width)


def _cost(segments: Segments) -> float:
    """Return the point-equivalent deposits of segments: 1 + length in px for each."""
    x0, y0, x1, y1 = segments.ends.T
    return float(np.sum(1.0 + np.hypot(x1 - x0, y1 - y0)))


def crop(psf: DoubleArray) -> DoubleArray:
    """Crop a PSF symmetrically to its support and a border of 1 px."""
    padded = np.pad(psf, ((1, 1), (1, 1), (0, 0)))
    row, col, _ = np.nonzero(padded)
    height, width = padded.shape[0] // 2, padded.shape[1] // 2
    half_row, half_col = np.abs(row - height).max() + 1, np.abs(col - width).max() + 1
    return padded[height - half_row : height + half_row + 1, width - half_col : width + half_col + 1]
