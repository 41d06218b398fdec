"""PSF variants: a stored spreadlet turned by the lattice's symmetries and scaled, as a row-sorted list of points."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple, Protocol
from weakref import WeakKeyDictionary

import numpy as np
import numpy.typing as npt

from spreadlets.kept import Kept
from spreadlets.psf.database import Database
from spreadlets.psf.exact import direct_points
from spreadlets.psf.spreadlet import Spreadlet

Points = tuple[npt.NDArray[np.int32], npt.NDArray[np.float32], bool]


class DensePsf(Protocol):
    """Gives the full PSF of (cell, pose, scale) as an array of odd size, centred, and says how to draw it."""

    @property
    def by_rows(self) -> bool:
        """Whether to draw the PSF's differences along rows, summed up afterwards, rather than its pixels."""

    def __call__(self, cell: int, pose: int, scale: float) -> npt.NDArray[np.float64]:
        """Return the PSF."""


MIN_ROW_STEP = 2e-3
"""A row of a PSF counts as constant while it stays within this share of the peak: a traced disc is not quite even."""

MOST_KEPT_POINTS = 1 << 22
"""Points of variants that are kept for each database, 50 to 80 MB."""

SPIKE_SHARE = 0.01
"""A spike that holds less than this share of a channel's light is left where it is."""


class Variant(NamedTuple):
    """One PSF as a frame needs it: which stored spreadlet, how turned, and how much larger."""

    cell: int
    pose: int
    transpose: bool
    flip_row: bool
    flip_col: bool
    scale: float


SHARP = Variant(-1, 0, False, False, False, 1.0)
"""The PSF that stays within its pixel: of no cell, a single direct point. It sorts first among a plan's variants."""


def variant_points(
    variants: list[Variant], database: Database, dense_psf: DensePsf | None
) -> Iterator[tuple[Points, npt.NDArray[np.float32]]]:
    """Yield each variant's points without its spike, and the spike.

    Points are offsets int32 (n, 2) sorted by row, values float32 (n, C), and whether they are direct.
    """
    stored = [each for each in variants if each != SHARP]
    if len(stored) < len(variants):
        yield split_spike((np.zeros((1, 2), np.int32), np.ones((1, database.n_channels), np.float32), True))
    if dense_psf is not None:
        yield from (split_spike(_dense_variant(each, dense_psf)) for each in stored)
        return
    kept = _KEPT.setdefault(database, _kept_points())
    yield from kept.of(stored, lambda missing: _stored_points(missing, database))


def _stored_points(variants: list[Variant], database: Database) -> Iterator[tuple[Points, npt.NDArray[np.float32]]]:
    """Yield the points of stored variants, and their spikes."""
    spreadlets = database.spreadlets([(each.cell, each.pose) for each in variants])
    for each, spreadlet in zip(variants, spreadlets, strict=True):
        wide = spreadlet if each.scale == 1.0 else scaled(spreadlet, each.scale)
        yield split_spike(_turned(wide, each))


def _kept_points() -> Kept[Variant, tuple[Points, npt.NDArray[np.float32]]]:
    return Kept(MOST_KEPT_POINTS, lambda known: len(known[0][1]))


_KEPT: WeakKeyDictionary[Database, Kept[Variant, tuple[Points, npt.NDArray[np.float32]]]] = WeakKeyDictionary()


def own_points(psf: Spreadlet) -> tuple[Points, npt.NDArray[np.float32]]:
    """Return the points of a PSF that is drawn as it is: direct, its rows ascending, and without a spike."""
    return split_spike((psf.offset_rc.astype(np.int32), psf.value, True))


def _turned(spreadlet: Spreadlet, variant: Variant) -> Points:
    """Return the points of a spreadlet, turned as the variant asks."""
    offset = spreadlet.offset_rc[:, ::-1] if variant.transpose else spreadlet.offset_rc
    turned = np.where([variant.flip_row, variant.flip_col], -offset.astype(np.int32), offset)
    order = np.argsort(turned[:, 0], kind="stable")
    return turned[order], spreadlet.value[order], spreadlet.direct


def _dense_variant(variant: Variant, dense_psf: DensePsf) -> Points:
    """Return the points of a variant's full PSF."""
    psf = dense_psf(variant.cell, variant.pose, variant.scale)
    if not dense_psf.by_rows:
        return _turned(direct_points(psf), variant)
    # Differences along rows must be taken after turning.
    turned = psf.swapaxes(0, 1) if variant.transpose else psf
    turned = turned[:: -1 if variant.flip_row else 1, :: -1 if variant.flip_col else 1]
    steps = _row_differences(turned)
    return steps.offset_rc.astype(np.int32), steps.value, False


def scaled(spreadlet: Spreadlet, scale: float) -> Spreadlet:
    """Return a spreadlet whose PSF is wider by a factor above 1, of equal energy.

    The Laplacian of ``f(x / s) / s^2`` has its points at ``s x`` with values ``v / s^2``. Rounding the points to pixels
    upsets the moments that keep the far field clean; the smallest change of the values restores them.
    """
    if spreadlet.direct:
        return direct_points(_magnified(spreadlet.to_dense(), scale))
    offset = spreadlet.offset_rc.astype(np.float64) * scale
    rounded = np.rint(offset)
    value = spreadlet.value.astype(np.float64) / scale**2
    target = _moments(offset) @ value
    moments = _moments(rounded)
    value += np.linalg.lstsq(moments, target - moments @ value, rcond=None)[0]
    return Spreadlet(rounded.astype(np.int16), value.astype(np.float32), False)


def split_spike(points: Points) -> tuple[Points, npt.NDArray[np.float32]]:
    """Take what the central pixel of a PSF has above its neighbours off its points.

    Light that passes a medium unscattered stays in its pixel, and its texture is seen as it is. The rest is smooth.

    Parameters
    ----------
    points : Points
        As from `variant_points`.

    Returns
    -------
    points : Points
        What is left: values at the same places.
    spike : ndarray of shape (C,), float32
        What was taken off; zero if there is no spike, or the points are direct.
    """
    offset_rc, value, direct = points
    nothing = np.zeros(value.shape[1], np.float32)
    if direct:
        return points, nothing
    distance = (offset_rc * offset_rc).sum(axis=1)
    centre, around = np.flatnonzero(distance == 0), np.flatnonzero(distance == 1)
    if len(centre) != 1 or len(around) != 4:
        return points, nothing
    spike = np.minimum(value[around].min(axis=0), -0.25 * value[centre[0]])
    energy = 0.25 * distance @ value
    if not (spike > SPIKE_SHARE * energy).all():
        return points, nothing
    rest = value.copy()
    rest[around] -= spike
    rest[centre] += 4 * spike
    return (offset_rc, rest, direct), spike


def _moments(offset: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return the moment matrix of shape (6, n): 1, row, col and the second moments."""
    row, col = offset.T
    return np.stack([np.ones_like(row), row, col, row * col, row * row, col * col])


def _magnified(psf: npt.NDArray[np.float64], scale: float) -> npt.NDArray[np.float64]:
    """Resample a centred PSF to a size larger by ``scale``, of equal energy."""
    from scipy import ndimage

    half = [int(np.ceil((size // 2 + 1) * scale)) for size in psf.shape[:2]]
    grid = np.meshgrid(*(np.arange(-extent, extent + 1) / scale for extent in half), indexing="ij")
    centre = [size // 2 for size in psf.shape[:2]]
    position = [axis + offset for axis, offset in zip(grid, centre, strict=True)]
    channels = [ndimage.map_coordinates(psf[..., c], position, order=1) for c in range(psf.shape[2])]
    magnified: npt.NDArray[np.float64] = np.stack(channels, axis=-1)
    magnified *= psf.sum() / magnified.sum()
    return magnified


def _row_differences(psf: npt.NDArray[np.float64]) -> Spreadlet:
    """Turn a centred dense PSF of shape (h, w, C) into the steps along its rows; their running sums are the PSF."""
    held = np.zeros((psf.shape[0], psf.shape[2]))
    steps = np.zeros((psf.shape[0], psf.shape[1] + 1, psf.shape[2]))
    for col in range(psf.shape[1]):
        moved = (np.abs(psf[:, col] - held) > MIN_ROW_STEP * psf.max()).any(axis=1)
        steps[moved, col] = psf[moved, col] - held[moved]
        held[moved] = psf[moved, col]
    steps[:, -1] = -held
    steps *= psf.sum() / np.cumsum(steps, axis=1).sum()
    rows, cols = np.nonzero(steps.any(axis=2))
    centre = np.array([psf.shape[0] // 2, psf.shape[1] // 2])
    offset_rc = (np.stack([rows, cols], axis=1) - centre).astype(np.int16)
    return Spreadlet(offset_rc, steps[rows, cols].astype(np.float32), False)
