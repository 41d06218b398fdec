"""The PSF of a real lens at a single coordinate, from a mesh of rays.

The rays cross the entrance pupil in a square grid, at a few wavelengths between which their places on the sensor are
interpolated. The light of each triangle of the mesh lies evenly on the triangle that it becomes there; where it is cut
by a rim, fine samples tell. So a few thousand rays draw a smooth PSF with a crisp rim.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache

import numpy as np

from spreadlets.arrays import DoubleArray
from spreadlets.parallel import for_bands
from spreadlets.precompute.models import physicallens
from spreadlets.precompute.models._mesh_kernels import fill_meshes
from spreadlets.precompute.models.colour import LONGEST_NM, SHORTEST_NM, rgb_response
from spreadlets.psf.model import PsfModel

MESH_SIDE = 33
"""Rays along each side of the mesh: aberrations are smooth, so that straight lines between them err by 1/1000."""
TRACED_WAVELENGTHS = 5
"""Wavelengths at which rays are traced, in equal steps of their inverse squares: dispersion goes with them (Cauchy)."""
WAVELENGTHS = 12
"""Wavelengths whose light is drawn: neighbours in a colour fringe lie within a pixel of each other."""
SAMPLES_PER_PX = 4
"""Samples along each side of a pixel, for each wavelength; a rim has as many steps as all of them together."""
LIT_STEP_PX, LIT_STEP_MM = 4.0, 1.0
"""The lit part of the pupil is looked for once for all PSFs of such a range of CoC, px, and of image height."""


def lens_psf(model: PsfModel) -> Callable[[tuple[float, ...], float, int], DoubleArray]:
    """Return what makes the PSF of a lens.

    Parameters
    ----------
    model : PsfModel
        ``physicallens``.

    Returns
    -------
    callable
        ``(coordinate, direction, side) -> psf``: for the coordinate (CoC radius that a thin lens would have, px; image
        height, mm) an array (h, w, 3), centred, of unit sum in the mean over the channels. Beyond the corner of the
        frame the PSF is that of the corner.
    """
    focused = physicallens.focused_lens(model.settings)
    corner_mm = model.axes[1].maximum

    @lru_cache(maxsize=1024)
    def lit(coc_step: int, height_step: int, side: int) -> tuple[DoubleArray, DoubleArray, float]:
        box = np.array([[coc_step, coc_step + 1.0], [height_step, height_step + 1.0]])
        box *= np.array([[LIT_STEP_PX], [LIT_STEP_MM]])
        box[1] = np.minimum(box[1], corner_mm)
        return physicallens.lit_pupil(focused, box, side)

    def psf(coordinate: tuple[float, ...], direction: float, side: int) -> DoubleArray:
        coc, height = coordinate[0], min(coordinate[1], corner_mm)
        low, high, extent = lit(int(coc // LIT_STEP_PX), int(height // LIT_STEP_MM), side)
        wavelength = SHORTEST_NM + (LONGEST_NM - SHORTEST_NM) * (np.arange(WAVELENGTHS) + 0.5) / WAVELENGTHS
        mesh = _mesh(focused, (low, high), (coc, height, side), wavelength)
        half = math.ceil(extent + 0.5)
        turned = physicallens.turned(mesh[..., 0], mesh[..., 1], direction)
        mesh[..., :2] = SAMPLES_PER_PX * (turned + half + 0.5)
        return _coloured(mesh, 2 * half + 1, wavelength)

    return psf


def _mesh(
    focused: physicallens.FocusedLens,
    lit: tuple[DoubleArray, DoubleArray],
    point: tuple[float, float, int],
    wavelength: DoubleArray,
) -> DoubleArray:
    """Return x, y (px) and clearance, shape (n, MESH_SIDE, MESH_SIDE, 3), of the rays of a point at n wavelengths."""
    (low, high), (coc, height, side) = lit, point
    along, across = (np.linspace(low[k], high[k], MESH_SIDE) for k in (0, 1))
    place = physicallens.turned(*np.meshgrid(along, across), physicallens.LINE_ANGLE).reshape(1, -1, 2)
    nodes = np.linspace(SHORTEST_NM**-2.0, LONGEST_NM**-2.0, TRACED_WAVELENGTHS)
    same = np.ones(TRACED_WAVELENGTHS)
    inverse = float(physicallens.inverse_distance(focused, np.array(coc), side))
    bundle = physicallens.trace_bundle(
        focused, np.repeat(place, TRACED_WAVELENGTHS, axis=0), nodes**-0.5, inverse * same, height * same
    )
    traced = np.stack([bundle.x, bundle.y, bundle.clearance], axis=-1)
    # Interpolate between the wavelengths that were traced.
    step = (wavelength**-2.0 - nodes[0]) / (nodes[1] - nodes[0])
    first = np.minimum(step.astype(np.int64), TRACED_WAVELENGTHS - 2)
    share = (step - first)[:, None, None]
    mesh = (1.0 - share) * traced[first] + share * traced[first + 1]
    return np.asarray(mesh.reshape(-1, MESH_SIDE, MESH_SIDE, 3))


def _coloured(mesh: DoubleArray, size: int, wavelength: DoubleArray) -> DoubleArray:
    """Draw meshes, one for each wavelength, as an image (size, size, 3) of unit sum in the mean over the channels."""
    planes = np.zeros((len(mesh), size * SAMPLES_PER_PX, size * SAMPLES_PER_PX))
    for_bands(fill_meshes, len(mesh), np.ascontiguousarray(mesh), planes)
    pixels = planes.reshape(len(mesh), size, SAMPLES_PER_PX, size, SAMPLES_PER_PX).sum(axis=(2, 4))
    psf = physicallens.without_negative_light(np.tensordot(pixels, rgb_response(wavelength), axes=(0, 0)))
    return np.asarray(psf * (psf.shape[2] / psf.sum()))
