from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spreadlets.errors import InvalidParameterError
from spreadlets.psf.model import (
    CLOSED_RADIUS_PX,
    DIRECTION_STEP_PX,
    OCTANT,
    Axis,
    PoseSymmetry,
    PsfGrid,
    PsfModel,
    get_model,
)

COMBINED = PsfGrid.of(get_model("combined"))


def test_models_are_those_of_the_paper():
    simple, combined = get_model("simplelens"), get_model("combined", max_coc=20.0, max_motion=50.0)
    assert [(a.name, a.unit, a.maximum, a.power) for a in simple.axes] == [("coc", "px", 64.0, 2.0)]
    assert (simple.has_direction, simple.n_channels, simple.default_cells) == (False, 1, 100)
    assert [(a.maximum, a.power) for a in combined.axes] == [(20.0, 2.0), (50.0, 1.0)]
    assert (combined.has_direction, combined.default_cells) == (True, 400)


TABLE_1 = {
    "simplelens": ((2.0,), 100, 1),
    "combined": ((2.0, 1.0), 400, 1),
    "physicallens": ((2.5, 1.2), 4000, 3),
    "volume": ((1.0,), 200, 3),
    "stylized": ((1.5,), 200, 3),
}
"""LKS table 1: powers of the axes, number of samples, and colour channels."""


@pytest.mark.parametrize("name", TABLE_1)
def test_powers_cells_and_colours_are_those_of_table_1(name):
    model = get_model(name)
    assert (tuple(axis.power for axis in model.axes), model.default_cells, model.n_channels) == TABLE_1[name]


@pytest.mark.parametrize("name", ["simplelens", "combined", "physicallens", "stylized"])
def test_defocus_of_less_than_a_pixel_makes_no_difference(name):
    grid = PsfGrid.of(get_model(name))
    rest = [0.0] * (grid.model.n_axes - 1)
    assert grid.find([0.02, *rest]) == grid.find([0.98, *rest])
    assert grid.find([0.02, *rest]) != grid.find([4.5, *rest])


@pytest.mark.parametrize(("settings", "begins"), [({}, CLOSED_RADIUS_PX), ({"blades": 6}, 0.0)])
def test_cells_of_a_round_lens_begin_where_the_closed_form_ends(settings, begins):
    model = get_model("combined", settings=settings)
    assert PsfGrid.of(model).boxes[:, 0, 0].min() == pytest.approx(begins)
    assert model.closed_radius == (begins or -1.0)
    # What was built before had cells of all radii, and keeps their ranges.
    before = replace(model, axes=(replace(model.axes[0], floor=1.0), model.axes[1]))
    assert PsfGrid.of(before).boxes[:, 0, 0].min() == 0.0


def test_coloured_and_real_lenses_have_no_closed_form():
    assert [get_model(name).closed_radius for name in ("stylized", "volume", "physicallens")] == [-1.0] * 3


def test_unknown_model_lists_the_known_ones():
    with pytest.raises(InvalidParameterError, match="'fisheye'.*combined, physicallens, simplelens, stylized, volume"):
        get_model("fisheye")


@pytest.mark.parametrize("keywords", [{"max_coc": 0.0}, {"max_motion": float("inf")}])
def test_impossible_range_is_refused(keywords):
    with pytest.raises(InvalidParameterError, match="above 0"):
        get_model("combined", **keywords)


@pytest.mark.parametrize("name", ["simplelens", "combined"])
def test_default_grid_has_the_default_number_of_cells(name):
    model = get_model(name)
    assert PsfGrid.of(model).n_cells == model.default_cells
    assert PsfGrid.of(model, 28).n_cells <= 28


@pytest.mark.parametrize(("power", "floor", "finest"), [(1.0, 0.0, 1.6), (1.2, 0.0, 0.7), (2.0, 1.0, 0.3)])
def test_the_most_units_have_a_first_one_of_the_finest_width(power, floor, finest):
    axis = Axis("s", "px", 50.0, power, floor, finest=finest)
    model = PsfModel("any", (axis,), 1, False, 10)
    wide, narrow = (PsfGrid(model, (axis.most_units + more,)).box(0)[0, 1] - floor for more in (-1, 0))
    assert narrow <= finest * (1 + 1e-9) < wide
    assert Axis("s", "px", 50.0, power, floor).most_units is None


def test_many_cells_of_combined_divide_the_coc_more_finely_than_still_motion():
    few, many = (PsfGrid.of(get_model("combined"), count) for count in (400, 1000))
    assert few.box(0)[1, 1] == pytest.approx(1.7, abs=0.05) and many.box(0)[1, 1] == pytest.approx(1.6)
    assert many.n_cells == 1000 and many.shape[0] > 3 * many.shape[1]


@pytest.mark.parametrize("name", ["simplelens", "combined"])
def test_find_inverts_coordinate(name):
    grid = PsfGrid.of(get_model(name))
    middle = np.array([grid.coordinate(cell) for cell in range(grid.n_cells)])
    np.testing.assert_array_equal(grid.find(middle), np.arange(grid.n_cells))


@given(st.floats(0.0, 64.0), st.floats(0.0, 128.0))
@settings(deadline=None)
def test_find_returns_the_box_around(coc, motion):
    box = COMBINED.box(int(COMBINED.find([coc, motion])))
    # What is thinner belongs to the first cells, but is drawn without them.
    point = np.array([max(coc, CLOSED_RADIUS_PX), motion])
    slack = 1e-9 * COMBINED.maximum
    assert (box[:, 0] <= point + slack).all() and (point - slack <= box[:, 1]).all()


def test_find_clamps_to_the_range():
    np.testing.assert_array_equal(COMBINED.find([[1e9, 1e9], [-3.0, 4.0]]), COMBINED.find([[64.0, 128.0], [0.0, 4.0]]))


def test_power_above_one_makes_cells_near_zero_finer():
    def edges(power):
        grid = PsfGrid(PsfModel("any", (Axis("s", "px", 1.0, power),), 1, False, 10), (55,))
        return grid.boxes[0, 0, 1], grid.box(9)[0, 1]

    assert edges(2.0) == (pytest.approx(1 / 55**2), 1.0)
    assert edges(1.0) == (pytest.approx(1 / 55), 1.0)


def test_wrong_shapes_are_refused():
    with pytest.raises(InvalidParameterError, match="2 axes"):
        PsfGrid(COMBINED.model, (9,))
    with pytest.raises(InvalidParameterError, match="direction_step_px"):
        PsfGrid(COMBINED.model, (9, 9), direction_step_px=0.0)
    with pytest.raises(InvalidParameterError, match=r"\(\.\.\., 2\)"):
        COMBINED.find([1.0])


@pytest.mark.parametrize("step_px", [DIRECTION_STEP_PX, 0.25])
def test_directions_keep_the_tip_within_half_a_step(step_px):
    grid = PsfGrid(COMBINED.model, COMBINED.shape, direction_step_px=step_px)
    for cell in range(grid.n_cells):
        nodes, longest = grid.angles(cell), grid.box(cell)[1, 1]
        assert len(nodes) == grid.direction_counts[cell]
        if longest <= 1.0:
            assert nodes.tolist() == [0.0] and grid.angle_half_width(cell) == 0.0
            continue
        assert nodes[0] == 0.0 and nodes[-1] == OCTANT
        np.testing.assert_allclose(np.diff(nodes), grid.angle_half_width(cell))
        step = step_px * min(1 + grid.box(cell)[0, 0] / 2.4, 16)
        assert grid.angle_half_width(cell) / 2 * longest / 2 <= step / 2 * (1 + 1e-12)
        assert grid.angle_half_width(cell) * longest / 2 >= step * (1 - 1 / (len(nodes) - 1)) * 0.99


def test_short_motion_needs_one_direction():
    grid = PsfGrid(get_model("combined", max_motion=40.0), (60, 60))
    assert grid.box(0)[1, 1] < 1.0
    assert grid.angles(0).tolist() == [0.0]
    assert grid.angle_half_width(0) == 0.0


def apply_symmetry(dx, dy, transpose, flip_row, flip_col):
    if transpose:
        dx, dy = dy, dx
    return (-dx if flip_col else dx), (-dy if flip_row else dy)


@given(st.floats(-20.0, 20.0), st.integers(0, COMBINED.n_cells - 1))
@settings(deadline=None, max_examples=300)
def test_folded_direction_maps_back_to_the_angle(angle, cell):
    index, *symmetry = COMBINED.nearest_pose(cell, angle)
    nodes = COMBINED.angles(cell)
    dx, dy = apply_symmetry(np.cos(nodes[index]), np.sin(nodes[index]), *symmetry)
    # Half a turn is no difference, hence the absolute value.
    off = np.arccos(min(1.0, abs(dx * np.cos(angle) + dy * np.sin(angle))))
    spacing = COMBINED.angle_half_width(cell) or 2 * OCTANT
    assert off <= spacing / 2 + 1e-7


def test_directions_have_one_representation_each():
    cell = int(COMBINED.find([8.0, 100.0]))
    n_nodes = len(COMBINED.angles(cell))
    angles = np.linspace(-np.pi, np.pi, 20001)
    found = set(zip(*(part.tolist() for part in COMBINED.nearest_pose(cell, angles)), strict=True))
    assert len(found) == 4 * (n_nodes - 1)
    assert {flags for index, *flags in map(tuple, found) for flags in [tuple(flags)] if index == 0} == {
        (False, False, False),
        (True, False, False),
    }


def test_nearest_pose_broadcasts():
    index, transpose, flip_row, flip_col = COMBINED.nearest_pose(np.array([[3], [40]]), np.array([0.1, 1.2, 2.0]))
    for part, dtype in ((index, np.int64), (transpose, np.bool_), (flip_row, np.bool_), (flip_col, np.bool_)):
        assert part.shape == (2, 3) and part.dtype == dtype
    assert transpose[0].tolist() == [False, True, True]


def test_model_without_direction_needs_no_symmetry():
    grid = PsfGrid.of(get_model("simplelens"))
    assert grid.angles(5).tolist() == [0.0]
    assert [part.tolist() for part in grid.nearest_pose(5, [1.0, 2.0])] == [[0, 0]] + 3 * [[False, False]]


SYMMETRIES = [
    PoseSymmetry(arrow=arrow, lattice=lattice, sign=sign)
    for arrow in (False, True)
    for lattice in (False, True)
    for sign in ("ignored", "turned", "stored")
]


def posed_grid(symmetry):
    model = get_model("combined")
    return PsfGrid.of(PsfModel(model.name, model.axes, 1, True, 400, symmetry))


@pytest.mark.parametrize("symmetry", SYMMETRIES, ids=str)
def test_every_direction_and_side_comes_from_the_nearest_pose(symmetry):
    """Follow a direction through the look-up and back: the stored one, turned, is the one asked for."""
    grid = posed_grid(symmetry)
    cell = int(grid.find([4.0, 60.0]))
    angles = np.random.default_rng(3).uniform(-7.0, 7.0, 200)
    for in_front in (False, True):
        number, transpose, flip_row, flip_col = grid.nearest_pose(cell, angles, in_front)
        stored = grid.angles(cell)[number]
        x, y = np.cos(stored), np.sin(stored)
        x, y = np.where(transpose, y, x), np.where(transpose, x, y)
        x, y = np.where(flip_col, -x, x), np.where(flip_row, -y, y)
        along = x * np.cos(angles) + y * np.sin(angles)
        aligned = along if symmetry.arrow else np.abs(along)
        assert aligned.min() > np.cos(1.01 * grid.angle_half_width(cell) / 2)
        sides = {grid.side(cell, int(each)) for each in number}
        assert sides == ({-1} if in_front and symmetry.sign == "stored" else {1})
        if not symmetry.lattice:
            turned = in_front and symmetry.sign == "turned"
            assert not transpose.any() and (flip_row == turned).all() and (flip_col == turned).all()


@pytest.mark.parametrize("symmetry", SYMMETRIES, ids=str)
def test_poses_are_counted_as_they_are_listed(symmetry):
    grid = posed_grid(symmetry)
    for cell in (0, 30, 200, 399):
        assert len(grid.angles(cell)) == grid.pose_counts[cell]
    spans = symmetry.n_spans if symmetry.n_spans == 1 else symmetry.n_spans * (grid.direction_counts - 1)
    expected = np.maximum(grid.direction_counts if symmetry.n_spans == 1 else spans, 1) * symmetry.n_sides
    np.testing.assert_array_equal(grid.pose_counts, expected)


def test_directions_of_a_lens_are_more_towards_the_corner():
    grid = PsfGrid.of(get_model("physicallens", settings={"aberration_px": 4.0}), 400)
    near, far = (int(grid.find([20.0, height])) for height in (1.0, 24.0))
    assert grid.direction_counts[near] < grid.direction_counts[far]


def test_unknown_symmetry_is_refused():
    with pytest.raises(InvalidParameterError, match="sign 'odd'"):
        PoseSymmetry(sign="odd")
