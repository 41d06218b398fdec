"""Poisson integrators: from a Laplacian image to the image, in time linear in its pixels.

- `pyramid`: one pass down and one pass up a pyramid. It is a convolution pyramid whose levels relax the interpolated
  coarser answer against their own source with a few Jacobi steps, where a published one adds a filtered copy of the
  source. Filters and weights are optimised for the 5-point stencil (`benchmarks/optimise_pyramid.py`).
- `multigrid`: the pyramid, then `cycles` times the pyramid again on what is left of the Laplacian.
- `pyramid-f5`, `pyramid-f7`: Farbman et al. 2011, "Convolution Pyramids", as published.
- `exact`: sine transforms on the padded box. Not quite linear, but the yardstick.

Boundary: `exact`, `pyramid` and `multigrid` hold the image at zero on a ring of pixels around the array. At the upper
and left sides it lies just outside; at the lower and right sides it may lie a few per cent of the size further out,
where the array is padded to a size that the levels divide evenly. Every level continues its arrays across the ring by
odd reflection, so all levels and the stencil of the residual mean the same problem, and the cycles converge to the
exact answer. That is the free-space answer as far as the sources' field has died off at the ring: that of an exact
Laplacian is zero outside its shape, that of a fitted spreadlet falls with the third power of the distance. The
published pyramids are free-space by construction.

Precision: float32 throughout. The residual is a sum of differences, so the cycles end near 1e-6 relative L2, no worse
than `exact`.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from spreadlets.arrays import Image
from spreadlets.errors import InvalidParameterError
from spreadlets.parallel import for_blocks, limit_threads, thread_count
from spreadlets.psf.laplacian import solve_dirichlet
from spreadlets.runtime.buffers import buffer
from spreadlets.runtime.integrate import _pyramid_kernels as kernels
from spreadlets.runtime.options import DEFAULT_CYCLES, DEFAULT_INTEGRATOR, INTEGRATORS

Rows = NDArray[np.float32]
"""An image as the kernels see it, of shape (H, W * C)."""


COARSEST_SIDE = 32
"""Levels end before the shorter side gets below this, and the coarsest is solved exactly in under 1 % of the time. A
smaller one would waste more pixels on dividing the size evenly. Smaller images have no levels: they are solved exactly.
"""

SERIAL_SIZE = 100_000
"""Levels of fewer floats than this run on one thread: they take less than a busy machine needs to wake another."""

LONGEST_ODD_SIDE = 128
"""Sides above this are padded to a fast transform length before an exact solve."""

NET_SOURCE_TOLERANCE = 0.01
"""Largest sum of the Laplacian, relative to the largest value of the image, that passes without a warning. The field of
a net source q is about q times the logarithm of the distance over 2 pi, so this is an error of about 1 %."""


class UnbalancedSourceWarning(UserWarning):
    """The Laplacian has a net source, for which no answer is zero at infinity; zero on the ring is what was solved."""


@dataclass(frozen=True)
class FilterSet:
    """Separable filters of a published pyramid: centre tap, then the taps on either side.

    Attributes
    ----------
    down, up, source : tuple of 4 floats
        Filters before decimation, after expansion, and of each level's own source (`h1`, `h2` and `g` in the paper).
    pad : int
        Zero pixels that are added around every level.
    """

    down: tuple[float, float, float, float]
    up: tuple[float, float, float, float]
    source: tuple[float, float, float, float]
    pad: int


_F5_TAPS = (0.7, 0.5, 0.15, 0.0)
_F7_TAPS = (0.65934, 0.53034, 0.26177, 0.06110)
# The paper scales the two-dimensional filter.
_F7_SCALE = math.sqrt(0.51106)

PUBLISHED_FILTERS = {
    "pyramid-f5": FilterSet(down=_F5_TAPS, up=_F5_TAPS, source=(0.547, 0.175, 0.0, 0.0), pad=5),
    "pyramid-f7": FilterSet(
        down=_F7_TAPS,
        up=(_F7_SCALE * 0.65934, _F7_SCALE * 0.53034, _F7_SCALE * 0.26177, _F7_SCALE * 0.06110),
        source=(0.57410, 0.24453, 0.05407, 0.0),
        pad=7,
    ),
}


@dataclass(frozen=True)
class LevelFilters:
    """Filters of one level of the optimised pyramid.

    Attributes
    ----------
    down, up : tuple of 2 floats
        Third and fourth tap of the seven-tap filters before decimation and after expansion. The other two follow from
        keeping the sum of the source, and constant images.
    weights : tuple of floats
        Jacobi weights in the order of use. The large ones come first, so that the small ones damp the rounding errors
        that those amplify.
    """

    down: tuple[float, float]
    up: tuple[float, float]
    weights: tuple[float, ...]


# Found by benchmarks/optimise_pyramid.py.
FINEST_FILTERS = LevelFilters(
    down=(0.17756, 0.02515),
    up=(-0.27606, -0.08837),
    weights=(0.61352, 0.3228, 0.22377, 0.15721, 0.13097),
)
COARSER_FILTERS = LevelFilters(
    down=(0.19801, 0.03582),
    up=(-0.04277, -0.21613),
    weights=(1.21389, 0.71416, 0.71413, 0.22379, 0.22377, 0.13523),
)


def complete_taps(outer: tuple[float, float]) -> Rows:
    """Complete a seven-tap filter whose even taps, and whose odd taps, sum to 1: centre tap, then side taps."""
    return np.array([1 - 2 * outer[0], 0.5 - outer[1], *outer], np.float32)


@dataclass(frozen=True)
class IntegrationReport:
    """How an integration went.

    Attributes
    ----------
    cycles : int
        Multigrid cycles that were run after the first guess.
    residual : float or None
        Largest magnitude of `L - Lap u` relative to the largest of `L`, if a tolerance was given.
    net_source : float
        Largest magnitude, over the channels, of the sum of `L`, relative to the largest magnitude of `u`.
    """

    cycles: int
    residual: float | None
    net_source: float


def integrate(
    laplacian_image: NDArray[Any],
    method: str = DEFAULT_INTEGRATOR,
    *,
    cycles: int = DEFAULT_CYCLES,
    tolerance: float | None = None,
    threads: int | None = None,
    out: Image | None = None,
) -> Image:
    """Integrate a Laplacian image once; to do it for many frames, keep an `Integrator`.

    Parameters
    ----------
    laplacian_image : ndarray of shape (H, W, C)
        Sum of spreadlets, floating point, computed in float32. The sources should lie inside, off the sides.
    method : {"exact", "pyramid", "multigrid", "pyramid-f5", "pyramid-f7"}
        See the module.
    cycles : int
        Most cycles of `multigrid`; 0 is `pyramid`. Other methods take no notice.
    tolerance : float, optional
        Stop the cycles once the residual is below this, see `IntegrationReport`. Other methods take no notice.
    threads : int, optional
        Largest number of threads, by default `spreadlets.parallel.thread_count`. The image does not depend on it.
    out : ndarray of shape (H, W, C), float32, optional
        C-contiguous array that receives the image.

    Returns
    -------
    ndarray of shape (H, W, C), float32
        The image: `out`, if given.

    Raises
    ------
    InvalidParameterError
        If the image or a parameter is not as described, or if the answer exceeds the range of float32.

    Warns
    -----
    UnbalancedSourceWarning
        If a channel's sum is not zero.
    """
    return Integrator(method, cycles=cycles, tolerance=tolerance, threads=threads)(laplacian_image, out)


@dataclass
class Integrator:
    """A Poisson integrator that keeps its buffers.

    After the first image of a size it allocates only results, and what scipy needs for `exact`. Parameters are those of
    `integrate`. Not for use by several threads at once.

    Attributes
    ----------
    report : IntegrationReport or None
        How the last call went.

    Raises
    ------
    InvalidParameterError
        From the call, as `integrate`.
    """

    method: str = DEFAULT_INTEGRATOR
    cycles: int = field(default=DEFAULT_CYCLES, kw_only=True)
    tolerance: float | None = field(default=None, kw_only=True)
    threads: int | None = field(default=None, kw_only=True)
    report: IntegrationReport | None = field(default=None, init=False)
    _solver: _Solver | None = field(default=None, init=False, repr=False)

    def __call__(self, laplacian_image: NDArray[Any], out: Image | None = None) -> Image:
        """Integrate an image; arguments, result and errors are those of `integrate`."""
        source = _checked_source(laplacian_image)
        out = np.empty_like(source) if out is None else _checked_out(out, source)
        self._check_parameters()
        with limit_threads(self.threads):
            key = (self.method, source.shape, thread_count())
            if self._solver is None or self._solver.key != key:
                self._solver = _make_solver(key)
            self.report = self._solver.solve(source, out, self.cycles, self.tolerance)
        _warn_of_net_source(self.report.net_source)
        return out

    def _check_parameters(self) -> None:
        if self.method not in INTEGRATORS:
            raise InvalidParameterError(f"method is {self.method!r}; the integrators are {', '.join(INTEGRATORS)}")
        if self.cycles < 0:
            raise InvalidParameterError(f"cycles is {self.cycles}; give 0 or more")
        if self.tolerance is not None and not self.tolerance >= 0:
            raise InvalidParameterError(f"tolerance is {self.tolerance}; give a residual of 0 or more, or None")


def _checked_source(laplacian_image: NDArray[Any]) -> Image:
    source = np.asarray(laplacian_image)
    if source.ndim != 3 or source.size == 0 or not np.issubdtype(source.dtype, np.floating):
        raise InvalidParameterError(
            f"the Laplacian image has shape {source.shape} and dtype {source.dtype}; "
            "give a non-empty floating-point array of shape (H, W, C)"
        )
    with np.errstate(over="ignore"):
        # A value that overflows here is reported as non-finite like any other.
        return np.ascontiguousarray(source, np.float32)


def _checked_out(out: Image, source: Image) -> Image:
    if out.shape != source.shape or out.dtype != np.float32 or not out.flags.c_contiguous:
        raise InvalidParameterError(
            f"out has shape {out.shape} and dtype {out.dtype}; "
            f"give a C-contiguous float32 array of the Laplacian's shape {source.shape}"
        )
    if np.may_share_memory(out, source):
        raise InvalidParameterError("out shares memory with the Laplacian image; give an array of its own")
    return out


def _warn_of_net_source(net_source: float) -> None:
    if net_source > NET_SOURCE_TOLERANCE:
        warnings.warn(
            f"a channel of the Laplacian sums to {net_source:.2g} times the image's largest value, so no answer is "
            "zero at infinity; it was held at zero around the array. Give whole, neutral sources, off the sides",
            UnbalancedSourceWarning,
            stacklevel=3,
        )


def _magnitude(bits: NDArray[np.int32]) -> float:
    """Largest of the magnitudes that the kernels return as bits."""
    return float(bits.max().view(np.float32))


def _ratio(value: float, scale: float) -> float:
    return value / scale if scale > 0 else (math.inf if value > 0 else 0.0)


def _largest_sum(sums: NDArray[np.float32]) -> float:
    """Largest magnitude, over the channels, of what rows sum to."""
    return float(np.abs(sums.sum(axis=0, dtype=np.float64)).max())


def _rows(image: Image) -> Rows:
    return image.reshape(image.shape[0], -1)


def _require_finite(magnitude: float, source: Image) -> None:
    """Refuse an infinite or undefined magnitude, and say where it comes from."""
    if math.isfinite(magnitude):
        return
    bad = np.argwhere(~np.isfinite(source))
    if len(bad):
        raise InvalidParameterError(
            f"the Laplacian image has {len(bad)} values that are not finite in float32, the first at "
            f"(row, col, channel) {tuple(int(i) for i in bad[0])}; mend or drop them"
        )
    raise InvalidParameterError(
        f"the answer exceeds the range of float32: the Laplacian reaches {float(np.abs(source).max()):.3g}; "
        "scale the image down"
    )


SolverKey = tuple[str, tuple[int, ...], int]
"""What a solver's buffers are made for: method, shape of the image, number of threads."""


def _bands_for(n_floats: int, threads: int) -> slice:
    """Return the bands of scratch for a level of some size: one for each thread that it deserves."""
    return slice(threads if n_floats >= SERIAL_SIZE else 1)


class _Solver(Protocol):
    """Buffers and procedure of one method for one shape and number of threads."""

    key: SolverKey

    def solve(self, source: Image, out: Image, cycles: int, tolerance: float | None) -> IntegrationReport:
        """Write the image to `out`."""


class _Meter:
    """Measures whole images for the methods that do not do so in passing."""

    def __init__(self, shape: tuple[int, ...], threads: int) -> None:
        height, width, n_channels = shape
        self.sums = np.empty((height, n_channels), np.float32)
        self.largest = np.empty(height, np.int32)
        self.scratch = np.empty((threads, 1, width * n_channels), np.float32)

    def net_source(self, source: Image) -> float:
        """Largest magnitude, over the channels, of the sum of a source; refuse values that are not finite."""
        _require_finite(self._measure(source), source)
        return _largest_sum(self.sums)

    def report(self, net: float, source: Image, out: Image) -> IntegrationReport:
        """Report on a direct solve; refuse an answer that is not finite."""
        largest = self._measure(out)
        _require_finite(largest, source)
        return IntegrationReport(cycles=0, residual=None, net_source=_ratio(net, largest))

    def _measure(self, image: Image) -> float:
        arguments = _rows(image), image.shape[2], self.sums, self.largest, self.scratch
        for_blocks(kernels.measure, len(self.scratch), *arguments)
        return _magnitude(self.largest)


def _make_solver(key: SolverKey) -> _Solver:
    method, shape, _ = key
    if method in PUBLISHED_FILTERS:
        return _PublishedSolver(key)
    if method == "exact" or min(shape[:2]) < 2 * COARSEST_SIDE - 1:
        return _ExactSolver(key)
    return _LevelSolver(key)


def _fast_side(side: int) -> int:
    """Smallest side, at least as long, whose sine transform is fast."""
    if side <= LONGEST_ODD_SIDE:
        return side
    from scipy.fft import next_fast_len

    return int(next_fast_len(side + 1, real=True)) - 1


class _ExactSolver:
    """Sine transforms on the array, padded to a fast size."""

    def __init__(self, key: SolverKey) -> None:
        self.key = key
        self.meter = _Meter(key[1], key[2])

    def solve(self, source: Image, out: Image, cycles: int, tolerance: float | None) -> IntegrationReport:
        (height, width, n_channels), threads = self.key[1:]
        net = self.meter.net_source(source)
        padded = np.zeros((_fast_side(height), _fast_side(width), n_channels), np.float32)
        padded[:height, :width] = source
        with np.errstate(over="ignore", invalid="ignore"):
            # Overflow is found, and reported in words, below.
            out[:] = solve_dirichlet(padded, workers=threads, overwrite=True)[:height, :width]
        return self.meter.report(net, source, out)


class _PublishedSolver:
    """A convolution pyramid as published, on as many levels as the longer side has binary digits."""

    def __init__(self, key: SolverKey) -> None:
        self.key = key
        method, (height, width, n_channels), threads = key
        self.meter = _Meter(key[1], threads)
        filters = PUBLISHED_FILTERS[method]
        self.pad = filters.pad
        self.down, self.up, self.own = (
            np.array([taps, taps], np.float32) for taps in (filters.down, filters.up, filters.source)
        )
        # The published filters invert minus the Laplacian: the finest level's answer changes sign.
        negate = np.array([[-1], [1]], np.float32)
        self.last_up, self.last_own = self.up * negate, self.own * negate
        shapes = [(height, width * n_channels)]
        for _ in range(1, math.ceil(math.log2(max(height, width)))):
            height, width = ((side + 2 * self.pad + 1) // 2 for side in (height, width))
            shapes.append((height, width * n_channels))
        self.sources, self.answers = ([np.empty(shape, np.float32) for shape in shapes[1:]] for _ in range(2))
        widest = max(width for _, width in shapes) + (2 * self.pad + 8) * n_channels
        self.scratch = np.empty((threads, 5, widest), np.float32)

    def solve(self, source: Image, out: Image, cycles: int, tolerance: float | None) -> IntegrationReport:
        n_channels, pad = source.shape[2], self.pad
        net = self.meter.net_source(source)
        self.scratch[:] = 0
        sources, answers = [_rows(source), *self.sources], [_rows(out), *self.answers]
        for fine, coarse in zip(sources, sources[1:], strict=False):
            scratch = self.scratch[_bands_for(fine.size, self.key[2])]
            for_blocks(kernels.filter_down, len(scratch), fine, coarse, self.down, pad, n_channels, scratch)
        own = self.own if len(sources) > 1 else self.last_own
        kernels.filter_level(0, 1, sources[-1], answers[-1], own, n_channels, self.scratch[:1])
        for level in reversed(range(len(sources) - 1)):
            scratch = self.scratch[_bands_for(answers[level].size, self.key[2])]
            up, own = (self.up, self.own) if level else (self.last_up, self.last_own)
            images = answers[level + 1], sources[level], answers[level]
            for_blocks(kernels.filter_up, len(scratch), *images, up, own, pad, n_channels, scratch)
        return self.meter.report(net, source, out)


def _level_shapes(height: int, width: int) -> list[tuple[int, int]]:
    """Sizes of the levels, finest first: each has an odd size and its coarser pixels lie on its odd ones."""
    halvings = int(math.log2((min(height, width) + 1) / COARSEST_SIDE))
    step = 2**halvings
    coarsest = [_fast_side(math.ceil((side + 1) / step) - 1) for side in (height, width)]
    return [((coarsest[0] + 1) * 2**k - 1, (coarsest[1] + 1) * 2**k - 1) for k in reversed(range(halvings + 1))]


class _LevelSolver:
    """The optimised pyramid, and the multigrid cycle that it makes."""

    def __init__(self, key: SolverKey) -> None:
        self.key = key
        method, (height, width, n_channels), threads = key
        self.repeats = method == "multigrid"
        # Allocate source and answer of each coarser level.
        self.shapes = _level_shapes(height, width)
        flat = [(rows, cols * n_channels) for rows, cols in self.shapes]
        self.sources, self.answers = ([buffer(shape) for shape in flat[1:]] for _ in range(2))
        self.images: list[Rows] = []
        self.nothing = np.empty((0, 0), np.float32)
        # Allocate what rows and bands report: sums and largest magnitudes.
        self.sums = np.empty((flat[0][0], n_channels), np.float32)
        self.largest = np.empty(flat[0][0], np.int32)
        self.band_largest = np.empty(threads, np.int32)
        # Tabulate the filters of the finest and the coarser levels.
        self.down, self.up = (
            [complete_taps(getattr(filters, name)) for filters in (FINEST_FILTERS, COARSER_FILTERS)]
            for name in ("down", "up")
        )
        self.weights = [np.array(filters.weights, np.float32) for filters in (FINEST_FILTERS, COARSER_FILTERS)]
        # Allocate the scratch rows of each thread, with the overlap of neighbouring blocks.
        most_steps = max(len(weights) for weights in self.weights)
        overlap = 2 * (most_steps + kernels.INTERPOLATION_REACH) + 8
        block = (kernels.BLOCK_PIXELS + overlap) * n_channels
        self.relax_scratch = buffer((threads, 8 + 3 * most_steps, block))
        self.coarsen_scratch = buffer((threads, 12, flat[0][1] + 4 * n_channels))

    def solve(self, source: Image, out: Image, cycles: int, tolerance: float | None) -> IntegrationReport:
        rows, out_rows = _rows(source), _rows(out)
        cycles, tolerance = (cycles, tolerance) if self.repeats else (0, None)
        # Filter the source down to the first coarse level.
        scale = self._coarsen(0, rows, self.nothing, True)
        _require_finite(scale, source)
        net = _largest_sum(self.sums)
        image, residual, done = self.nothing, None, 0
        while True:
            # Solve the coarser levels, and relax their answer at the finest.
            self._solve_coarser_levels()
            direct = done == cycles and tolerance is None
            target = out_rows if direct else self._image(done % 2)
            largest = self._relax(0, image, rows, target)
            _require_finite(largest, source)
            image = target
            if direct:
                break
            # Filter the remaining residual down, and stop where it is small enough.
            left = self._coarsen(0, rows, image, tolerance is not None)
            if tolerance is not None:
                residual = _ratio(left, scale)
                if residual <= tolerance or done == cycles:
                    out_rows[:] = image[: out_rows.shape[0], : out_rows.shape[1]]
                    break
            done += 1
        return IntegrationReport(cycles=done, residual=residual, net_source=_ratio(net, largest))

    def _image(self, index: int) -> Rows:
        """One of two images on the whole padded domain; only the cycles need them."""
        if len(self.images) <= index:
            height, width = self.shapes[0]
            self.images.append(buffer((height, width * self.key[1][2])))
        return self.images[index]

    def _bands(self, level: int) -> slice:
        """Choose the number of threads for a level: which bands of the scratch arrays it uses."""
        rows, cols = self.shapes[level]
        return _bands_for(rows * cols * self.key[1][2], self.key[2])

    def _coarsen(self, level: int, source: Rows, image: Rows, measured: bool = False) -> float:
        """Filter a level's remaining source down to the next; return its largest magnitude if that is measured."""
        coarse, taps, scratch = self.sources[level], self.down[min(level, 1)], self.coarsen_scratch[self._bands(level)]
        sums = self.sums[: None if measured else 0]
        images, n_channels = (source, image, coarse), self.key[1][2]
        for_blocks(kernels.coarsen, len(scratch), *images, taps, n_channels, sums, self.largest, scratch)
        return _magnitude(self.largest)

    def _relax(self, level: int, image: Rows, source: Rows, out: Rows) -> float:
        """Add the next level's answer to an image and relax it; return the largest magnitude of the outcome."""
        kind, bands = min(level, 1), self._bands(level)
        taps, weights = self.up[kind], self.weights[kind]
        largest, scratch = self.band_largest[bands], self.relax_scratch[bands]
        images, n_channels = (self.answers[level], image, source, out), self.key[1][2]
        for_blocks(kernels.relax, len(scratch), *images, taps, weights, n_channels, largest, scratch)
        return _magnitude(largest)

    def _solve_coarser_levels(self) -> None:
        """From the first coarse level's source to its answer."""
        n_coarse = len(self.sources)
        for level in range(1, n_coarse):
            self._coarsen(level, self.sources[level - 1], self.nothing)
        coarsest = self.sources[-1].reshape(*self.shapes[-1], -1)
        with np.errstate(over="ignore", invalid="ignore"):
            # Overflow is found, and reported in words, at the end.
            self.answers[-1][:] = _rows(solve_dirichlet(coarsest))
        for level in reversed(range(1, n_coarse)):
            self._relax(level, self.nothing, self.sources[level - 1], self.answers[level - 1])
