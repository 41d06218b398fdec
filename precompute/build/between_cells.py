"""How like the exact PSF is what is drawn, between the cells: the figures of a database at random coordinates.

At a cell's middle a spreadlet is nearly the PSF. A pixel's coordinate lies anywhere in its cell, and there it is not:
for a dim pixel the spreadlet of its cell is drawn, for a highlight a PSF of nearly its own coordinate.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from spreadlets.arrays import DoubleArray
from spreadlets.metrics import psf_similarity
from spreadlets.parallel import for_each
from spreadlets.precompute.models.registry import exact_psf, trace_psf
from spreadlets.psf.capsule import thin_capsules
from spreadlets.psf.exact import rounded
from spreadlets.psf.model import COC_FLOOR_PX, PsfGrid
from spreadlets.psf.spreadlet import Spreadlet

N_COORDINATES = 1000
N_TRACED = 64
"""Random coordinates; fewer where the exact PSF must be traced, which takes a second."""
LARGE_COC_PX = 4.0
"""CoC radius from which a PSF has a rim to see."""
RIM_LEVEL = 0.1
"""Share of the peak above which a pixel is inside the rim."""
SEED = 0

FindSpreadlet = Callable[[int, int], Spreadlet | None]
"""``(cell, pose) -> spreadlet``; None if it was left out."""


class Places(NamedTuple):
    """Random coordinates (n, n_axes), directions (n,) and sides (n,)."""

    coordinate: DoubleArray
    angle: DoubleArray
    side: np.ndarray[Any, np.dtype[np.int64]]


def between_cells(grid: PsfGrid, find: FindSpreadlet, rays: int | None = None) -> dict[str, Any]:
    """Compare what is drawn at random coordinates to the exact PSF there.

    Parameters
    ----------
    grid : PsfGrid
    find : callable
        Gives the spreadlet of a cell and pose.
    rays : int, optional
        Budget of an exact PSF that must be traced; the default is the tracer's own.

    Returns
    -------
    dict
        ``coordinates``, how many there were, evenly spread over the axes after their remapping; and for ``highlight``
        and ``dim``, each where it was drawn: ``mean`` similarity, ``percentile_1``, ``mean_large`` (CoC of 4 px and
        more), and of the large ones ``radius_error`` (relative) and ``centre_error_px`` of the rim, means of the
        sizes; fog has no rim.
    """
    exact = exact_psf(grid.model)
    places = random_places(grid, N_COORDINATES if exact else N_TRACED)
    truth = _exact_psfs(grid, places, rays)
    dim = [_of_cell(grid, find, *place) for place in zip(*places, strict=True)]
    # What is drawn in closed form has no cell.
    thin = np.flatnonzero(places.coordinate[:, 0] <= grid.model.closed_radius)
    for place, psf in zip(thin, thin_capsules(places.coordinate[thin], places.angle[thin]), strict=True):
        dim[place] = psf
    highlight = list(exact(*rounded(*places, grid.model))) if exact else dim
    large = places.coordinate[:, 0] >= (LARGE_COC_PX if exact else 0.0)
    return {
        "coordinates": len(truth),
        "highlight": _figures(truth, highlight, large, spike=not exact),
        "dim": _figures(truth, dim, large, spike=not exact),
    }


def random_places(grid: PsfGrid, count: int) -> Places:
    """Return random coordinates, evenly spread over the remapped axes, with random directions and sides.

    A CoC is at least `spreadlets.psf.model.COC_FLOOR_PX`, also where cells begin above it.
    """
    rng = np.random.default_rng(SEED)
    first = (np.minimum([axis.floor for axis in grid.model.axes], COC_FLOOR_PX) / grid.maximum) ** (1.0 / grid.power)
    fraction = first + (1.0 - first) * rng.random((count, grid.model.n_axes))
    angle = rng.uniform(-np.pi, np.pi, count) if grid.model.has_direction else np.zeros(count)
    side = np.where(rng.random(count) < 0.5, -1, 1).astype(np.int64)
    if grid.model.symmetry.sign == "ignored":
        side[:] = 1
    return Places(grid.maximum * fraction**grid.power, angle, side)


def _exact_psfs(grid: PsfGrid, places: Places, rays: int | None) -> list[DoubleArray]:
    exact = exact_psf(grid.model)
    if exact is not None:
        return [psf.to_dense() for psf in exact(*places)]

    def traced(place: tuple[DoubleArray, float, int]) -> DoubleArray:
        coordinate, angle, side = place
        box = np.repeat(coordinate[:, None], 2, axis=1)
        return trace_psf(grid.model, box, angle=angle, side=side, rays=rays, seed=SEED)

    return for_each(traced, zip(*places, strict=True))


def _of_cell(grid: PsfGrid, find: FindSpreadlet, coordinate: DoubleArray, angle: float, side: int) -> Spreadlet | None:
    """Return the spreadlet that a pixel is drawn with, turned as it is drawn."""
    cell = int(grid.find(coordinate))
    pose, transpose, flip_row, flip_col = grid.nearest_pose(cell, angle, side < 0)
    spreadlet = find(cell, int(pose))
    if spreadlet is None:
        return None
    return spreadlet.transformed(transpose=bool(transpose), flip_row=bool(flip_row), flip_col=bool(flip_col))


def _figures(
    truth: Sequence[DoubleArray],
    drawn: Sequence[Spreadlet | None],
    large: np.ndarray[Any, np.dtype[np.bool_]],
    *,
    spike: bool,
) -> dict[str, float]:
    """Return the figures of what is drawn; without a spike, next to which nothing else would count, if there is one."""

    def compared(pair: tuple[DoubleArray, Spreadlet | None]) -> tuple[float, float, float]:
        if pair[1] is None:
            return np.nan, np.nan, np.nan
        exact, made = on_one_window(pair[0], pair[1].to_dense())
        if spike:
            exact, made = _without_spike(exact), _without_spike(made)
        (radius, *centre), (other, *other_centre) = rim(exact), rim(made)
        apart = np.hypot(centre[0] - other_centre[0], centre[1] - other_centre[1])
        return psf_similarity(exact, made), abs(other / radius - 1.0), float(apart)

    # Compare the pairs; what has no spreadlet is NaN.
    similarity, radius, centre = np.array(for_each(compared, zip(truth, drawn, strict=True))).T
    known = ~np.isnan(similarity)
    if not known.any():
        return {}
    # Similarity of all PSFs.
    found = {"mean": float(similarity[known].mean()), "percentile_1": float(np.percentile(similarity[known], 1))}
    # Radius and centre of the rim, where PSFs are large enough to have one.
    some = known & large
    if some.any() and not spike:
        found |= {
            "mean_large": float(similarity[some].mean()),
            "radius_error": float(radius[some].mean()),
            "centre_error_px": float(centre[some].mean()),
        }
    return found


def _without_spike(psf: DoubleArray) -> DoubleArray:
    """Return a PSF with its central pixel no brighter than those beside it."""
    rest, (row, col) = psf.copy(), np.array(psf.shape[:2]) // 2
    rest[row, col] = 0.25 * (psf[row - 1, col] + psf[row + 1, col] + psf[row, col - 1] + psf[row, col + 1])
    return rest


def rim(psf: DoubleArray) -> tuple[float, float, float]:
    """Return the radius of the disc that is as large as a PSF within its rim, and its centre (row, col), px.

    Parameters
    ----------
    psf : ndarray of shape (h, w, C), float64
        Centred. Its level is the median within the rim, and a pixel counts as far as it reaches the level.
    """
    light = np.maximum(psf.mean(axis=2), 0.0)
    level = np.median(light[light > RIM_LEVEL * light.max()])
    filled = np.minimum(light / level, 1.0)
    area = float(filled.sum())
    rows, cols = np.indices(light.shape) - (np.array(light.shape) // 2)[:, None, None]
    return float(np.sqrt(area / np.pi)), float((filled * rows).sum() / area), float((filled * cols).sum() / area)


def on_one_window(*psfs: DoubleArray) -> list[DoubleArray]:
    """Pad centred PSFs to one size."""
    shape = np.max([psf.shape[:2] for psf in psfs], axis=0)
    margins = [(shape - psf.shape[:2]) // 2 for psf in psfs]
    return [np.pad(psf, [(a, a), (b, b), (0, 0)]) for psf, (a, b) in zip(psfs, margins, strict=True)]
