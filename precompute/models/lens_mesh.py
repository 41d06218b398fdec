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

TRACED_SIDE = 33
"""Rays along each side of the mesh that are traced; between them places lie on cubic polynomials."""
MESH_SIDE = 2 * TRACED_SIDE - 1
"""Rays along each side of the mesh: light near a caustic, where triangles fold, is as fine as they are."""
TRACED_WAVELENGTHS = 5
"""Wavelengths at which rays are traced, in equal steps of their inverse squares: dispersion goes with them (Cauchy)."""
WAVELENGTHS = 12
"""Wavelengths whose light is drawn: neighbours in a colour fringe lie within a pixel of each other."""
SAMPLES_PER_PX = 4, 16
"""Least and most samples along each side of a pixel, for each wavelength; a rim has as many steps as all together."""
SAMPLES_PER_SQUARE = 4.0
"""Samples along each side of a square of the mesh, where there may be as many: fewer would not fill its triangles."""
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

    def psf(coordinate: tuple[float, ...], angle: float, side: int) -> DoubleArray:
        coc, height = coordinate[0], min(coordinate[1], corner_mm)
        low, high, extent = lit(int(coc // LIT_STEP_PX), int(height // LIT_STEP_MM), side)
        wavelength = SHORTEST_NM + (LONGEST_NM - SHORTEST_NM) * (np.arange(WAVELENGTHS) + 0.5) / WAVELENGTHS
        mesh = _mesh(focused, (low, high), (coc, height, side), wavelength)
        # A lens is its own mirror image about the meridional plane.
        mesh = np.concatenate([mesh, mesh * np.array([1.0, -1.0, 1.0])])
        half = math.ceil(extent + 0.5)
        turned = physicallens.turned(mesh[..., 0], mesh[..., 1], angle)
        samples = int(np.clip(math.ceil(SAMPLES_PER_SQUARE * MESH_SIDE / (2.0 * extent)), *SAMPLES_PER_PX))
        mesh[..., :2] = samples * (turned + half + 0.5)
        return _coloured(mesh, (2 * half + 1, samples), np.tile(wavelength, 2))

    return psf


def _mesh(
    focused: physicallens.FocusedLens,
    lit: tuple[DoubleArray, DoubleArray],
    point: tuple[float, float, int],
    wavelength: DoubleArray,
) -> DoubleArray:
    """Return x, y (px) and clearance, shape (n, MESH_SIDE, MESH_SIDE, 3), of the rays of a point at n wavelengths."""
    (low, high), (coc, height, side) = lit, point
    along, across = (np.linspace(low[k], high[k], TRACED_SIDE) for k in (0, 1))
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
    return _refined(_refined(mesh.reshape(-1, TRACED_SIDE, TRACED_SIDE, 3)).swapaxes(1, 2)).swapaxes(1, 2)


def _refined(mesh: DoubleArray) -> DoubleArray:
    """Put a value between each two along the second axis, on the cubic polynomial through the four about it."""
    fine = np.empty((mesh.shape[0], 2 * mesh.shape[1] - 1, *mesh.shape[2:]))
    fine[:, ::2] = mesh
    fine[:, 3:-2:2] = (9.0 * (mesh[:, 1:-2] + mesh[:, 2:-1]) - mesh[:, :-3] - mesh[:, 3:]) / 16.0
    # At the ends, the parabola through three.
    fine[:, 1] = (3.0 * mesh[:, 0] + 6.0 * mesh[:, 1] - mesh[:, 2]) / 8.0
    fine[:, -2] = (3.0 * mesh[:, -1] + 6.0 * mesh[:, -2] - mesh[:, -3]) / 8.0
    return fine


def _coloured(mesh: DoubleArray, size: tuple[int, int], wavelength: DoubleArray) -> DoubleArray:
    """Draw meshes, one for each wavelength, as an image (n, n, 3) of unit sum in the mean over the channels.

    Parameters
    ----------
    mesh : ndarray of shape (n_wavelengths, MESH_SIDE, MESH_SIDE, 3), float64
        Places in samples, and clearance.
    size : tuple of two ints
        Pixels along each side of the image, and samples along each side of a pixel.
    wavelength : ndarray of shape (n_wavelengths,), float64
    """
    n_pixels, n_samples = size
    planes = np.zeros((len(mesh), n_pixels * n_samples, n_pixels * n_samples))
    for_bands(fill_meshes, len(mesh), np.ascontiguousarray(mesh), planes)
    pixels = planes.reshape(len(mesh), n_pixels, n_samples, n_pixels, n_samples).sum(axis=(2, 4))
    psf = physicallens.without_negative_light(np.tensordot(pixels, rgb_response(wavelength), axes=(0, 0)))
    return np.asarray(psf * (psf.shape[2] / psf.sum()))
