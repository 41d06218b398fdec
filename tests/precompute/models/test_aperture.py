from functools import lru_cache

import numba
import numpy as np
import pytest

from spreadlets.errors import InvalidParameterError
from spreadlets.precompute.models.aperture import Aperture, drawn_psf, is_drawn, shutter_times
from spreadlets.precompute.models.grids import model_settings
from spreadlets.precompute.models.registry import trace_psf
from spreadlets.precompute.trace.line_sample import lit_parts
from spreadlets.psf.model import PsfGrid, get_model

L1_BUDGET = 0.01
"""Relative L1 that a traced PSF may differ from the supersampled drawing."""

RADIUS = 14.0

SHAPES = {
    "triangle": {"blades": 3, "rotation": 20.0},
    "hexagon": {"blades": 6, "rotation": 12.0},
    "curved": {"blades": 5, "blade_curvature": 0.5},
    "cats eye": {"cats_eye": 0.7, "cats_eye_angle": 30.0},
    "anamorphic": {"squeeze": 0.5},
    "obstructed": {"obstruction": 0.5},
    "dark rim": {"spherical_aberration": 0.4},
    "bright rim": {"spherical_aberration": -0.4},
    "all": {"blades": 7, "cats_eye": 0.4, "squeeze": 0.7, "spherical_aberration": 0.2, "obstruction": 0.3},
}

compiled = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="millions of deposits need the compiled kernels")


def inside(shape, u, v):
    """Tell which points of the lens let light through: plain geometry, edge by edge."""
    bright = u**2 + v**2 <= 1
    blades = shape.get("blades", 0)
    if blades:
        distance = np.full(u.shape, -np.inf)
        for k in range(blades):
            normal = np.radians(shape.get("rotation", 0.0)) + (2 * k + 1) * np.pi / blades
            distance = np.maximum(distance, (u * np.cos(normal) + v * np.sin(normal)) / np.cos(np.pi / blades))
        # The polygon's edge in this direction lies at hypot / distance.
        edge = np.hypot(u, v) / np.where(distance == 0, 1, distance)
        curvature = shape.get("blade_curvature", 0.0)
        bright &= np.hypot(u, v) <= (1 - curvature) * edge + curvature
    if "cats_eye" in shape:
        angle = np.radians(shape.get("cats_eye_angle", 0.0))
        bright &= np.hypot(u - shape["cats_eye"] * np.cos(angle), v - shape["cats_eye"] * np.sin(angle)) <= 1
    return bright & (np.hypot(u, v) >= shape.get("obstruction", 0.0))


@lru_cache(maxsize=9)
def lit_points(shape, n):
    """Return the points of a lens that let light through, of n x n; options and values of the shape as pairs."""
    ticks = (np.arange(n) + 0.5) / n * 2 - 1
    u, v = np.meshgrid(ticks, ticks)
    lit = inside(dict(shape), u, v)
    return u[lit], v[lit]


def drawn(shape, radius, path=(0.0, 0.0), weights=(1.0,), side=1, n=672):
    """Draw the lens point by point, moved along a path with the weights of the shutter's times.

    By default a whole number of points lies across each pixel of a lens of radius 3 or 14.
    """
    u, v = lit_points(tuple(shape.items()), n)
    stretch = side * (1 + side * shape.get("spherical_aberration", 0.0) * (u**2 + v**2 - 1))
    x, y = radius * shape.get("squeeze", 1.0) * stretch * u, radius * stretch * v
    half = int(np.ceil(radius + np.hypot(*path) / 2 + 1))
    still, width = path == (0.0, 0.0), 2 * half + 1
    psf = np.zeros(width * width)
    for k, weight in enumerate(weights):
        t = 0.0 if still else (k + 0.5) / len(weights) - 0.5
        row, col = ((each + (half + 0.5)).astype(np.int32) for each in (y + t * path[1], x + t * path[0]))
        psf += weight * np.bincount(width * row + col, minlength=width * width)
    return psf.reshape(width, width) / psf.sum()


def relative_l1(psf, expected):
    rows, cols = ((e - p) // 2 for e, p in zip(expected.shape, psf.shape, strict=False))
    if rows < 0 or cols < 0:
        expected = np.pad(expected, ((max(-rows, 0),) * 2, (max(-cols, 0),) * 2))
    padded = np.pad(psf[..., 0], ((max(rows, 0),) * 2, (max(cols, 0),) * 2))
    return np.abs(padded - expected).sum()


def make(name, **options):
    return get_model(name, settings=model_settings(name, options))


@compiled
@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("name", SHAPES)
def test_aperture_is_that_of_the_supersampled_drawing(name, side):
    psf = trace_psf(make("simplelens", **SHAPES[name]), [[RADIUS, RADIUS]], side=side)
    assert relative_l1(psf, drawn(SHAPES[name], RADIUS, side=side)) < L1_BUDGET


@pytest.mark.parametrize("radius", [3.0, RADIUS])
@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("name", [name for name in SHAPES if "rim" not in name and name != "all"])
def test_the_psf_of_a_single_coordinate_is_that_of_the_supersampled_drawing(name, side, radius):
    model = make("simplelens", **SHAPES[name])
    assert is_drawn(model)
    assert relative_l1(drawn_psf(model, (radius,), 0.0, side), drawn(SHAPES[name], radius, side=side)) < L1_BUDGET


def test_what_is_in_focus_is_drawn_in_one_pixel():
    psf = drawn_psf(make("simplelens", blades=5), (0.0,), 0.0, 1)
    assert psf.sum() == pytest.approx(1.0) and psf.max() == pytest.approx(1.0)


def test_a_radial_cats_eye_of_a_single_coordinate_is_that_of_the_supersampled_drawing():
    psf = drawn_psf(make("simplelens", cats_eye=0.9, cats_eye_radial=True), (RADIUS, 0.6), 0.5, 1)
    shape = {"cats_eye": 0.9 * 0.6, "cats_eye_angle": np.degrees(0.5) + 180.0}
    assert relative_l1(psf, drawn(shape, RADIUS)) < L1_BUDGET


@compiled
@pytest.mark.parametrize("extra", [{}, {"blades": 5, "rotation": 20.0}, {"spherical_aberration": 0.3}])
@pytest.mark.parametrize("side", [1, -1])
def test_a_radial_cats_eye_closes_towards_the_corners_on_the_side_of_the_middle(extra, side):
    model = make("simplelens", cats_eye=0.9, cats_eye_radial=True, **extra)
    psf = trace_psf(model, [[RADIUS, RADIUS], [0.6, 0.6]], angle=0.5, side=side)
    shape = {"cats_eye": 0.9 * 0.6, "cats_eye_angle": np.degrees(0.5) + 180.0, **extra}
    assert relative_l1(psf, drawn(shape, RADIUS, side=side)) < L1_BUDGET


def spread(psf):
    """Return mean and deviation of a PSF's light along x, then along y, px."""
    found = []
    for axis in (0, 1):
        light = psf.sum(axis=(axis, 2)) / psf.sum()
        place = np.arange(len(light)) - len(light) // 2
        found += [light @ place, np.sqrt(light @ place**2 - (light @ place) ** 2)]
    return found


@compiled
def test_a_radial_cats_eye_lies_as_that_of_real_glass():
    glass = get_model("physicallens", max_coc=16.0, settings=model_settings("physicallens", {"width": 256}))
    eye = make("simplelens", cats_eye=0.9, cats_eye_radial=True)
    for model, place in ((glass, [17, 18]), (eye, [0.8, 0.8])):
        middle, along, _, across = spread(trace_psf(model, [[10, 11], place], rays=1_000_000))
        assert middle < -0.5 and along < 0.85 * across


def test_a_radial_cats_eye_has_no_direction_of_its_own_and_no_motion():
    with pytest.raises(InvalidParameterError, match="without a cats_eye_angle"):
        model_settings("simplelens", {"cats_eye": 0.5, "cats_eye_angle": 30.0, "cats_eye_radial": True})
    with pytest.raises(InvalidParameterError, match="cats_eye above 0"):
        model_settings("simplelens", {"cats_eye_radial": True})
    with pytest.raises(InvalidParameterError, match="build 'simplelens'"):
        model_settings("combined", {"cats_eye": 0.5, "cats_eye_radial": True})


@compiled
@pytest.mark.parametrize("name", SHAPES)
def test_aperture_in_motion_is_that_of_the_supersampled_drawing(name):
    psf = trace_psf(make("combined", **SHAPES[name]), [[9.0, 9.0], [20.0, 20.0]], angle=0.5)
    path = (20.0 * np.cos(0.5), 20.0 * np.sin(0.5))
    assert relative_l1(psf, drawn(SHAPES[name], 9.0, path, np.ones(160), n=400)) < L1_BUDGET


@compiled
@pytest.mark.parametrize(
    "curve, weight",
    [("trapezoid:0.5,0.2", lambda t: np.minimum(np.minimum(t / 0.5, (1 - t) / 0.2), 1)), ("0,3", np.array)],
)
def test_shutter_curve_is_that_of_the_supersampled_drawing(curve, weight):
    psf = trace_psf(make("combined", shutter_curve=curve), [[6.0, 6.0], [30.0, 30.0]], angle=2.2)
    weights = weight((np.arange(240) + 0.5) / 240)
    path = (30.0 * np.cos(2.2), 30.0 * np.sin(2.2))
    assert relative_l1(psf, drawn({}, 6.0, path, weights, n=400)) < L1_BUDGET


def pose_psf(grid, cell, coordinates, angle, in_front):
    """Trace a PSF as the run time would draw it: a stored pose, turned by a symmetry of the lattice."""
    number, transpose, flip_row, flip_col = grid.nearest_pose(cell, angle, in_front)
    side = grid.side(cell, int(number))
    psf = trace_psf(grid.model, coordinates, angle=grid.angles(cell)[number], side=side, rays=100_000)
    psf = psf.swapaxes(0, 1) if transpose else psf
    return psf[:: -1 if flip_row else 1, :: -1 if flip_col else 1]


@compiled
@pytest.mark.parametrize("shape", ["triangle", "hexagon", "dark rim", "all"])
@pytest.mark.parametrize("curve", [None, "0,3"])
@pytest.mark.parametrize("angle", [0.3, 1.9, -2.6])
@pytest.mark.parametrize("in_front", [False, True])
def test_stored_poses_give_every_direction_on_both_sides(shape, curve, angle, in_front):
    grid = PsfGrid.of(make("combined", shutter_curve=curve, **SHAPES[shape]))
    cell = int(grid.find([6.0, 24.0]))
    psf = pose_psf(grid, cell, [[6.0, 6.0], [24.0, 24.0]], angle, in_front)
    weights = np.ones(120) if curve is None else (np.arange(120) + 0.5) / 120
    path = (24.0 * np.cos(angle), 24.0 * np.sin(angle))
    expected = drawn(SHAPES[shape], 6.0, path, weights, side=-1 if in_front else 1, n=120)
    # Half a step of directions moves the tip by 0.75 px, over an edge of about a quarter of the area per px.
    assert relative_l1(psf, expected) < 0.12


@compiled
@pytest.mark.parametrize("extra", [{}, {"blades": 5, "rotation": 20.0}])
@pytest.mark.parametrize("angle", [0.3, 1.9, -2.6])
@pytest.mark.parametrize("in_front", [False, True])
def test_stored_poses_of_a_radial_cats_eye_give_every_direction_on_both_sides(extra, angle, in_front):
    grid = PsfGrid.of(make("simplelens", cats_eye=0.9, cats_eye_radial=True, **extra))
    psf = pose_psf(grid, int(grid.find([RADIUS, 0.8])), [[RADIUS, RADIUS], [0.8, 0.8]], angle, in_front)
    shape = {"cats_eye": 0.9 * 0.8, "cats_eye_angle": np.degrees(angle) + 180.0, **extra}
    assert relative_l1(psf, drawn(shape, RADIUS, side=-1 if in_front else 1, n=600)) < 0.12


@compiled
def test_a_triangle_points_the_other_way_in_front_of_focus():
    grid = PsfGrid.of(make("simplelens", **SHAPES["triangle"]))
    cell = int(grid.find([RADIUS]))
    behind, front = (pose_psf(grid, cell, [[RADIUS, RADIUS]], 0.0, side) for side in (False, True))
    np.testing.assert_array_equal(front, behind[::-1, ::-1])
    assert np.abs(front - behind).sum() > 0.5


def test_round_and_even_is_the_plain_model():
    assert model_settings("combined", {"blades": 0, "squeeze": 1.0}) == {}
    assert make("combined") == get_model("combined")


@pytest.mark.parametrize(
    "options, arrow, lattice, sign",
    [
        ({"obstruction": 0.3}, False, True, "ignored"),
        ({"blades": 6}, False, False, "ignored"),
        ({"blades": 5}, False, False, "turned"),
        ({"blades": 5, "blade_curvature": 1.0}, False, True, "ignored"),
        ({"spherical_aberration": 0.1}, False, True, "stored"),
        ({"shutter_curve": [1.0, 0.0]}, True, True, "ignored"),
        ({"shutter_curve": "trapezoid:0.2,0.2"}, False, True, "ignored"),
    ],
)
def test_symmetry_is_what_the_shape_leaves(options, arrow, lattice, sign):
    symmetry = make("combined", **options).symmetry
    assert (symmetry.arrow, symmetry.lattice, symmetry.sign) == (arrow, lattice, sign)


def test_times_follow_the_curve():
    u = (np.arange(100_000) + 0.5) / 100_000
    found, _ = np.histogram(shutter_times(u, [0.0, 1.0]), bins=4, range=(-0.5, 0.5))
    np.testing.assert_allclose(found / 100_000, [1 / 16, 3 / 16, 5 / 16, 7 / 16], atol=1e-4)


@pytest.mark.parametrize(
    "options, message",
    [
        ({"blades": 2}, "blades is 2.*0 or 3 to"),
        ({"blade_curvature": 1.5}, "0 to 1"),
        ({"cats_eye": 2.0}, "no light is left"),
        ({"cats_eye": 1.2, "obstruction": 0.99, "blades": 3, "rotation": 60.0}, "no light"),
        ({"cats_eye": 1.99}, "too little: 0.039 % of the open lens"),
        ({"squeeze": 0.0}, "0.25 to 1"),
        ({"rotation": 20.0}, "rotation is 20.0: without blades it is of nothing"),
        ({"blade_curvature": 0.5, "squeeze": 0.5}, "without blades"),
        ({"cats_eye_angle": 20.0, "blades": 5}, "without cats_eye"),
        ({"spherical_aberration": 0.6}, "0.45"),
        ({"obstruction": 1.0}, "below 1"),
        ({"shutter_curve": "0,0"}, "not all 0"),
        ({"shutter_curve": "a,b"}, "numbers separated by commas"),
        ({"shutter_curve": "box:1,2"}, "trapezoid:RISE,FALL"),
        ({"shutter_curve": "trapezoid:0.8,0.5"}, "at most 1"),
    ],
)
def test_impossible_shapes_are_refused(options, message):
    with pytest.raises(InvalidParameterError, match=message):
        model_settings("combined", options)


def test_options_of_other_models_are_refused():
    with pytest.raises(InvalidParameterError, match="'simplelens' has no shutter_curve.*blades"):
        model_settings("simplelens", {"shutter_curve": "1,1"})
    assert Aperture().is_round


@compiled
@pytest.mark.parametrize("name", ["hexagon", "anamorphic", "obstructed"])
@pytest.mark.parametrize("side", [1, -1])
def test_lines_moved_along_themselves_make_what_nodes_placed_one_by_one_make(name, side):
    """The least aberration takes the nodes' way, which places many more of them for as little noise."""
    box, pose = [[5.0, 7.0], [18.0, 22.0]], {"angle": 0.5, "angle_half_width": 0.03, "side": side}
    chords = trace_psf(make("combined", **SHAPES[name]), box, **pose)
    nodes = trace_psf(make("combined", **SHAPES[name], spherical_aberration=1e-9), box, **pose, rays=1 << 22)
    again = trace_psf(make("combined", **SHAPES[name]), box, **pose, seed=1)
    assert relative_l1(chords, nodes[..., 0]) < 0.004
    assert relative_l1(chords, again[..., 0]) < 0.004


def test_parts_of_lines_end_where_the_clearance_crosses_zero():
    lit = np.array([[1.0, 1.0, -1.0, -3.0, 1.0], [-1.0, -1.0, -1.0, 0.0, -1.0], [-1.0, 1.0, 1.0, 1.0, 3.0]])
    line, begin, end = lit_parts(lit)
    assert line.tolist() == [0, 0, 2]
    assert np.allclose(begin, [-1.0, 0.875, -0.75]) and np.allclose(end, [-0.25, 1.0, 1.0])
