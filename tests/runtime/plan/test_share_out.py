"""Wide bright areas: blocks of their pixels share out the cells about their coordinate."""

import numpy as np
import pytest
from scipy import ndimage

from spreadlets.api import synthesize
from spreadlets.precompute.models.registry import exact_psf
from spreadlets.runtime.label.labels import Places
from spreadlets.runtime.label.pixels import frame_pixels
from spreadlets.runtime.plan import plan
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.frame import Frame

SIZE = 96
CAMERA = ThinLens(
    focal_length_mm=50.0, sensor_width_mm=36.0, f_number=0.02, focus_distance_m=4.0, shutter=(-0.25, 0.25)
)
COC, LENGTH = 9.4, 10.0
"""Off the middle of their cell on both axes."""


def even_frame(light=4.0, coc=COC, length=LENGTH, size=SIZE):
    depth = 1.0 / (1.0 / CAMERA.focus_distance_m - coc / CAMERA.coc_scale(size))
    motion = np.broadcast_to(np.float32((length, 0.0)) / CAMERA.shutter_duration, (size, size, 2))
    return Frame(np.full((size, size, 3), light, np.float32), np.full((size, size), depth), motion)


def keys_of(frame, database, apart=plan.NOWHERE, pixels=None):
    """Keys of a frame's pixels, of their nearest cells and after sharing out."""
    if pixels is None:
        (pixels,) = frame_pixels(frame.layers[0], CAMERA, defocus=True, motion=True)
    given = pixels, plan._Given.of(pixels.labels, database.grid, database.cell_start)
    near = plan._variant_keys(*given)[0]
    return near, plan._shared_keys(*given, near.copy(), apart, 1.0)


def middles_of(keys, database):
    """Where the middles of their cells lie in the grid, (n, n_axes)."""
    used, index = np.unique(keys, return_inverse=True)
    cells = np.array([each.cell for each in plan._decoded(used, database.cell_start)])[index.ravel()]
    return database.grid.nested.bounds[cells].mean(axis=2)


def place_of(database, coc, length):
    """A coordinate in units of the grid."""
    grid = database.grid
    fraction = (np.array([coc, length]) / grid.maximum) ** (1 / grid.power)
    return (fraction - grid.first) / (1 - grid.first) * grid.shape


@pytest.mark.parametrize(("coc", "length"), [(COC, LENGTH), (8.3, 0.0), (11.9, 3.0), (9.0, 15.5)])
def test_the_cells_of_a_bright_area_lie_about_its_coordinate_in_the_mean(small_combined, coc, length):
    near, shared = keys_of(even_frame(coc=coc, length=length), small_combined)
    place = place_of(small_combined, coc, length)
    found, cell = middles_of(shared, small_combined), middles_of(near[:1, :1], small_combined)[0]
    away = np.abs(found.mean(axis=0) - place)
    # Beyond the middle of the outermost cells there are none to share with.
    inner = (place > 1.0) & (place < np.array(small_combined.grid.shape) - 1.5)
    assert (away[inner] < 0.1).all()
    assert (away <= np.abs(cell - place) + 1e-9).all()


def test_blocks_of_the_level_of_detail_have_one_cell_wherever_the_frame_begins(small_combined):
    wide = even_frame()
    (pixels,) = frame_pixels(wide.layers[0], CAMERA, defocus=True, motion=True)
    _, shared = keys_of(wide, small_combined)
    row, col = pixels.labels.view.corner
    rows, cols = (np.arange(SIZE) + row) // 4, (np.arange(SIZE) + col) // 4
    blocks = [shared[np.ix_(rows == y, cols == x)] for y in np.unique(rows) for x in np.unique(cols)]
    assert all(len(np.unique(block)) == 1 for block in blocks) and len(np.unique(shared)) > 1
    # Those of a list are the same as those of the frame.
    at = np.stack(np.mgrid[10:14, 3:40], axis=-1).astype(np.int32)
    view = pixels.labels.view._replace(places=Places(at, (SIZE, SIZE)))
    some = [each[10:14, 3:40].copy() for each in (pixels.labels.coc, pixels.labels.path, pixels.labels.length)]
    labels = pixels.labels._replace(coc=some[0], path=some[1], length=some[2], view=view)
    listed = pixels._replace(radiance=np.ascontiguousarray(pixels.radiance[10:14, 3:40]), labels=labels)
    assert np.array_equal(keys_of(wide, small_combined, pixels=listed)[1], shared[10:14, 3:40])


@pytest.mark.parametrize("changed", [{"light": 1.0}, {"coc": 3.0, "length": 9.0}])
def test_what_is_dim_or_narrow_has_its_nearest_cell(small_combined, changed):
    near, shared = keys_of(even_frame(**changed), small_combined)
    assert np.array_equal(near, shared)


def test_highlights_and_what_a_filter_receives_have_their_nearest_cell(small_combined):
    kept = np.arange(SIZE * SIZE).reshape(SIZE, SIZE) % 3 == 0
    near, shared = keys_of(even_frame(), small_combined, apart=np.flatnonzero(kept))
    assert np.array_equal(near[kept], shared[kept]) and not np.array_equal(near, shared)
    image = synthesize(even_frame(), CAMERA, small_combined, method="gather")[24:-24, 24:-24, :3]
    assert np.ptp(image) < 0.02


def test_a_frame_needs_the_cells_that_it_shares_out(small_combined):
    frame, grid = even_frame(), small_combined.grid
    frame.layers[0].radiance[24:, :, :3] = 0.05
    near, shared = keys_of(frame, small_combined)
    found = plan._decoded(np.union1d(near, shared), small_combined.cell_start)
    assert plan.needed_spreadlets(frame, CAMERA, grid) >= {(each.cell, each.pose) for each in found}


def rim_error(coc, database):
    """How far, in display values, a wide bright disc before a dark ground is from what exact PSFs draw."""
    size = 2 * SIZE
    frame = even_frame(0.1, coc, 0.0, size)
    y, x = np.indices((size, size)) - SIZE
    frame.layers[0].radiance[np.hypot(x, y) < 40] = (6.0, 6.0, 6.0, 1.0)
    (psf,) = exact_psf(database.grid.model)(np.array([[coc, 0.0]]), np.zeros(1), np.ones(1, np.int64))
    light = frame.layers[0].radiance[..., 0].astype(np.float64)
    truth = ndimage.convolve(light, psf.to_dense()[..., 0], mode="constant")
    image = synthesize(frame, CAMERA, database, tolerance=0.0)[..., 0]
    return float(np.abs(np.clip(image, 0, 1) - np.clip(truth, 0, 1))[32:-32, 32:-32].mean())


def test_the_rim_of_a_wide_bright_area_lies_where_it_should(small_combined, monkeypatch):
    radii = 8.6, 9.0, 9.4, 9.9, 10.4
    shared = [rim_error(coc, small_combined) for coc in radii]
    monkeypatch.setattr(plan, "_shared_keys", lambda pixels, given, key, apart, limit: key)
    nearest = [rim_error(coc, small_combined) for coc in radii]
    assert max(shared) < 0.6 * max(nearest)
