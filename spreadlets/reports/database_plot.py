"""A picture of a database: how sparse and how good its spreadlets are, and what the worst of them get wrong."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt

from spreadlets.arrays import DoubleArray, PathLike
from spreadlets.errors import InvalidFileError, InvalidParameterError
from spreadlets.files.atomic import atomic_path
from spreadlets.packages import optional_package
from spreadlets.psf.database import Database

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure


DensePsf = Callable[[int, int, float], DoubleArray]
"""Traces a PSF again: (cell, pose, scale) to (H, W, C), as `runtime.render.synthesize` takes it."""

N_WORST = 10
N_COLUMNS = 5
"""Cells that are shown as images, in all and side by side."""

MARGIN_PX = 8
"""Pixels shown around a PSF: where the similarity is measured, errors outside the support count."""

N_BINS = 40
FIGURE_INCHES = (15.0, 13.0)
DPI = 90


class _Spot(NamedTuple):
    """One spreadlet to be shown as images."""

    cell: int
    pose: int
    similarity: float


def plot_database(database: Database, path: PathLike, dense_psf: DensePsf) -> None:
    """Draw histograms of sparsity and similarity, one against the other, and the ten worst cells, as a PNG file.

    Parameters
    ----------
    database : Database
        An open database.
    path : path
        Where to write; an existing file is replaced. The file appears whole or not at all.
    dense_psf : callable
        ``(cell, pose, scale) -> ndarray of shape (H, W, C)``, H and W odd: the PSF, which the file does not hold.

    Raises
    ------
    InvalidParameterError
        If the file cannot be written.
    MissingPackageError
        If matplotlib is not installed (extra ``plot``).

    Notes
    -----
    LKS Fig. 10 b and c, over all spreadlets that are stored, as in `Database.summary`. A cell is as bad as its worst
    pose.
    """
    figures = optional_package("matplotlib.figure", "plot", "a plot")
    try:
        with atomic_path(path, ".png") as temporary:
            figure: Figure = figures.Figure(figsize=FIGURE_INCHES, dpi=DPI, layout="constrained")
            above, below = figure.subfigures(2, 1, squeeze=False, height_ratios=(2, 5)).ravel()
            _draw_statistics(database, above)
            _draw_worst(database, below, dense_psf)
            figure.savefig(temporary)
    except InvalidFileError as error:
        raise InvalidParameterError(f"the plot {error}") from error


def _draw_statistics(database: Database, figure: SubFigure) -> None:
    """Draw both histograms and the scatter, sparse and direct spreadlets apart."""
    figures, stored = database.statistics(), _stored(database)
    kinds = {"sparse": stored & ~database.direct, "direct": stored & database.direct}
    left, middle, right = figure.subplots(1, 3)
    for axes, name, label in ((left, "sparsity", "sparsity"), (middle, "ssim", "similarity")):
        groups = [figures[name][kind] for kind in kinds.values()]
        axes.hist(groups, bins=N_BINS, stacked=True, label=list(kinds))
        axes.set(xlabel=label, ylabel="spreadlets", title=f"mean {label} {figures[name][stored].mean():.4f}")
    for name, kind in kinds.items():
        right.plot(figures["sparsity"][kind], figures["ssim"][kind], ".", markersize=3, label=name)
    right.set(xlabel="sparsity", ylabel="similarity", title=f"{np.count_nonzero(stored)} spreadlets")
    for axes in (left, middle, right):
        axes.legend()
    figure.suptitle(f"{database.path.name}: {database.grid.model.name}, {database.n_cells} cells")


def _draw_worst(database: Database, figure: SubFigure, dense_psf: DensePsf) -> None:
    """Draw the PSF, what its spreadlet stands for, and their difference of each of the worst cells."""
    spots = _worst_cells(database)
    n_columns = min(N_COLUMNS, len(spots))
    blocks = figure.subfigures(-(-len(spots) // n_columns), n_columns, squeeze=False).ravel()
    for spot, block in zip(spots, blocks, strict=False):
        psf, reconstruction = _pair(database, spot, dense_psf(spot.cell, spot.pose, 1.0))
        difference = reconstruction - psf
        limit = float(np.abs(difference).max()) or 1.0
        first, second, third = block.subplots(3, 1)
        _show(first, psf, "gray", (0.0, 1.0), "PSF")
        _show(second, reconstruction, "gray", (0.0, 1.0), "spreadlet")
        _show(third, difference, "RdBu", (-limit, limit), f"±{limit:.2g}")
        first.set_title(_title(database, spot), fontsize="small")
    figure.suptitle(
        f"The {len(spots)} worst cells: PSF, what the spreadlet stands for, and the difference, relative to the peak"
    )


def _worst_cells(database: Database) -> list[_Spot]:
    """Find the cells of the lowest similarity, each with its worst pose, worst first."""
    similarity = np.where(_stored(database), database.statistics()["ssim"], np.inf)
    spots = []
    for cell, (begin, end) in enumerate(itertools.pairwise(database.cell_start)):
        some = similarity[begin:end]
        spots.append(_Spot(cell, int(np.argmin(some)), float(some.min())))
    return sorted((spot for spot in spots if spot.similarity < np.inf), key=lambda spot: spot.similarity)[:N_WORST]


def _stored(database: Database) -> npt.NDArray[np.bool_]:
    """Tell which spreadlets are stored: a database for certain frames leaves most of them out."""
    return np.asarray(np.diff(database.point_start) > 0)


def _pair(database: Database, spot: _Spot, psf: DoubleArray) -> tuple[DoubleArray, DoubleArray]:
    """Return a PSF and its reconstruction on one window (H, W), averaged over the channels, relative to the peak."""
    spreadlet = database.cell(spot.cell, spot.pose)
    half = np.maximum(np.asarray(psf.shape[:2]) // 2, spreadlet.extent) + MARGIN_PX
    dense = spreadlet.to_dense(int((half - spreadlet.extent).max()))
    true, approximate = (_centred(image, half).mean(axis=2) for image in (psf, dense))
    peak = float(true.max())
    return true / peak, approximate / peak


def _centred(image: DoubleArray, half: npt.NDArray[np.int64]) -> DoubleArray:
    """Crop or pad an image (H, W, C) of odd sizes about its centre to these half-sizes."""
    missing = half - np.asarray(image.shape[:2]) // 2
    padded = np.pad(image, [*((max(int(n), 0),) * 2 for n in missing), (0, 0)])
    row, col = np.asarray(padded.shape[:2]) // 2 - half
    return padded[row : row + 2 * half[0] + 1, col : col + 2 * half[1] + 1]


def _show(axes: Axes, image: DoubleArray, colours: str, limits: tuple[float, float], label: str) -> None:
    axes.imshow(image, cmap=colours, vmin=limits[0], vmax=limits[1], interpolation="nearest")
    axes.set(xticks=[], yticks=[])
    axes.set_ylabel(label, fontsize="small", rotation="horizontal", horizontalalignment="right")


def _title(database: Database, spot: _Spot) -> str:
    model = database.grid.model
    direct = ", direct" if database.direct[database.cell_start[spot.cell] + spot.pose] else ""
    place = zip(model.axes, database.coordinate(spot.cell), strict=True)
    facts = [f"{axis.name} {x:.3g} {axis.unit}" for axis, x in place]
    if model.has_direction:
        facts.append(f"{math.degrees(database.angles(spot.cell)[spot.pose]):.0f}°")
    return f"{spot.similarity:.4f}, cell {spot.cell}{direct}\n{', '.join(facts)}"
