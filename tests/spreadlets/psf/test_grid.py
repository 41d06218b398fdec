import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spreadlets.errors import InvalidParameterError
from spreadlets.psf._grid_kernels import triangular_root
from spreadlets.psf.grid import MAX_SIDE_DIFFERENCE, NestedGrid, nested_shape

SHAPES = st.one_of(
    st.tuples(st.integers(1, 300)),
    st.tuples(st.integers(1, 40), st.integers(1, 40)),
    st.tuples(st.integers(1, 12), st.integers(1, 12), st.integers(1, 12)),
)


def test_nine_by_nine_has_28_cells():
    assert NestedGrid((9, 9)).n_cells == 28
    assert NestedGrid((9, 9)).level_offset.tolist() == [0, 17, 24, 27]


@given(SHAPES)
@settings(deadline=None, max_examples=60)
def test_boxes_cover_every_unit_cell_once(shape):
    covered = np.zeros(shape, dtype=int)
    for box in NestedGrid(shape).boxes().astype(int):
        covered[tuple(slice(low, high) for low, high in box)] += 1
    assert (covered == 1).all()


@given(SHAPES)
@settings(deadline=None, max_examples=60)
def test_box_edges_are_those_of_their_level(shape):
    boxes = NestedGrid(shape).boxes()
    edge = boxes[..., 1] - boxes[..., 0]
    level = np.array([triangular_root(low) for low in boxes[..., 0].min(axis=1)])
    clipped = boxes[..., 1] == np.array(shape)
    assert ((edge == level[:, None] + 1) | (clipped & (edge <= level[:, None] + 1))).all()


@given(SHAPES, st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=60)
def test_forward_map_finds_the_box_of_every_point(shape, seed):
    grid = NestedGrid(shape)
    boxes = grid.boxes()
    # Lower corners, points just below the upper ones, and anything between.
    inner = np.random.default_rng(seed).random(boxes.shape[:2])
    low, high = boxes[..., 0], boxes[..., 1]
    for point in (low, np.nextafter(high, low), low + inner * (high - low) * (1 - 1e-9)):
        np.testing.assert_array_equal(grid.index(point), np.arange(grid.n_cells))


@given(SHAPES)
@settings(deadline=None, max_examples=60)
def test_upper_border_belongs_to_the_last_cell(shape):
    grid = NestedGrid(shape)
    boxes = grid.boxes()
    at_border = (boxes[..., 1] == np.array(shape)).all(axis=1)
    corner = np.array(shape, dtype=float)
    assert grid.index(corner) == grid.n_cells - 1 == np.flatnonzero(at_border)[-1]
    # On one upper face, off it along the other axes: the cell just inside the face.
    for axis in range(len(shape)):
        point = boxes[..., 0].copy()
        point[:, axis] = shape[axis]
        inside = point.copy()
        inside[:, axis] = np.nextafter(corner[axis], 0.0)
        np.testing.assert_array_equal(grid.index(point), grid.index(inside))


def test_coordinates_outside_are_clamped():
    grid = NestedGrid((9, 5))
    outside = [[-1.0, 2.0], [np.inf, 2.0], [20.0, 20.0], [-np.inf, -3.0]]
    inside = np.clip(outside, 0.0, [9.0, 5.0])
    np.testing.assert_array_equal(grid.index(outside), grid.index(inside))


def test_index_keeps_the_leading_shape():
    grid = NestedGrid((9, 9))
    coordinates = np.random.default_rng(0).random((4, 3, 2), dtype=np.float32) * 9
    index = grid.index(coordinates)
    assert index.shape == (4, 3) and index.dtype == np.int64
    assert index[2, 1] == grid.index(coordinates[2, 1])
    assert grid.index(np.zeros((0, 2))).shape == (0,)


@given(st.integers(0, 2**25))
@settings(deadline=None)
def test_triangular_root_is_exact_at_its_steps(level):
    start = level * (level + 1) // 2
    assert triangular_root(float(start)) == level
    if level:
        assert triangular_root(np.nextafter(float(start), 0.0)) == level - 1


def test_inverse_list_is_a_copy():
    grid = NestedGrid((4, 4))
    grid.boxes()[:] = 0.0
    assert grid.boxes().max() == 4.0


@pytest.mark.parametrize("n_axes", [1, 2, 3])
@pytest.mark.parametrize("n_cells", [1, 2, 3, 10, 28, 100, 400])
def test_nested_shape_is_the_best_near_cube(n_cells, n_axes):
    shape = nested_shape(n_cells, n_axes)
    assert max(shape) - min(shape) <= MAX_SIDE_DIFFERENCE
    count = NestedGrid(shape).n_cells
    assert count <= n_cells
    # No near-cube lies strictly between the two counts.
    for bump in np.ndindex((MAX_SIDE_DIFFERENCE + 1,) * n_axes):
        other = tuple(min(shape) + b for b in bump)
        assert not count < NestedGrid(other).n_cells <= n_cells


@pytest.mark.parametrize("n_cells, most", [(1000, (None, 80)), (60, (None, 5)), (400, (30, None)), (400, (None, 500))])
def test_a_side_that_is_limited_leaves_its_cells_to_the_others(n_cells, most):
    shape = nested_shape(n_cells, 2, most)
    count = NestedGrid(shape).n_cells
    free, limited = (most.index(None), 1 - most.index(None))
    assert shape[limited] <= most[limited] and 0.98 * n_cells <= count <= n_cells
    if shape[limited] == most[limited]:
        longer = tuple(side + (axis == free) for axis, side in enumerate(shape))
        assert shape[free] > shape[limited] and NestedGrid(longer).n_cells > n_cells
    else:
        assert shape == nested_shape(n_cells, 2)


def test_a_shape_of_limited_sides_only_is_refused():
    with pytest.raises(InvalidParameterError, match=r"no limit, not \(9, 9\)"):
        nested_shape(28, 2, (9, 9))


def test_nested_shape_of_one_axis_is_triangular():
    assert nested_shape(100, 1) == (100 * 101 // 2,)


@pytest.mark.parametrize("n_axes, n_cells", [(2, 400), (2, 28), (3, 95)])
def test_known_counts_are_met_exactly(n_axes, n_cells):
    assert NestedGrid(nested_shape(n_cells, n_axes)).n_cells == n_cells


@pytest.mark.parametrize("shape", [(), (0,), (3, -1), (2.5,)])
def test_impossible_shapes_are_refused(shape):
    with pytest.raises(InvalidParameterError, match="at least 1"):
        NestedGrid(shape)


def test_wrong_number_of_coordinates_is_refused():
    with pytest.raises(InvalidParameterError, match=r"\(\.\.\., 2\).*\(3,\)"):
        NestedGrid((4, 4)).index([1.0, 2.0, 3.0])
    with pytest.raises(InvalidParameterError, match=r"not \(\)"):
        NestedGrid((4,)).index(1.0)
    with pytest.raises(InvalidParameterError, match="at least 1"):
        nested_shape(0, 2)


def test_storage_grows_slower_than_a_regular_grid():
    counts = [NestedGrid((side, side)).n_cells for side in (16, 64)]
    assert math.log(counts[1] / counts[0], 4) < 1.6


def test_a_grid_too_large_for_its_tables_is_refused():
    with pytest.raises(InvalidParameterError, match="is too large: at most"):
        NestedGrid((10**6, 10**6))
