import numba
import numpy as np
import pytest
from naive import psfs
from threads import for_thread_counts

from spreadlets.errors import InvalidParameterError
from spreadlets.metrics import psf_similarity
from spreadlets.precompute.models.registry import REGISTRY, psf_footprint, trace_psf
from spreadlets.precompute.trace._tracing_kernels import deposit_segments
from spreadlets.precompute.trace.line_sample import lens_chords, tent
from spreadlets.psf.model import PsfGrid, PsfModel, get_model

SIMPLE, COMBINED = get_model("simplelens"), get_model("combined")

L1_BUDGET = 0.005
"""Relative L1 that a traced PSF may differ from the analytic one; oblique ones are below 1e-4."""

compiled = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="millions of deposits need the compiled kernels")


def on_canvas(psf, shape):
    """Embed a centred PSF (h, w, 1) in a canvas (H, W)."""
    rows, cols = (shape[0] - psf.shape[0]) // 2, (shape[1] - psf.shape[1]) // 2
    return np.pad(psf[..., 0], ((rows, rows), (cols, cols)))


def relative_l1(psf, expected):
    shape = np.maximum(psf.shape[:2], expected.shape)
    rows, cols = (shape - expected.shape) // 2
    return np.abs(on_canvas(psf, shape) - np.pad(expected, ((rows, rows), (cols, cols)))).sum()


def sharp(*values):
    return [[value, value] for value in values]


@compiled
@pytest.mark.parametrize("radius", [0.3, 1.0, 4.0, 7.7, 16.0, 30.3, 64.0])
def test_disc_is_the_analytic_one(radius):
    assert relative_l1(trace_psf(SIMPLE, sharp(radius)), psfs.disc_coverage(radius)) < 1e-4


@compiled
@pytest.mark.parametrize(
    "radius, length, angle",
    [(4, 20, 0.5), (4, 0.5, 0.1), (30, 60, 0.0), (30.3, 60, 0.3), (8, 100, 0.0), (8, 100, np.pi / 4), (64, 3, 0.2)],
)
def test_capsule_is_the_analytic_one(radius, length, angle):
    psf = trace_psf(COMBINED, sharp(radius, length), angle=angle)
    assert relative_l1(psf, psfs.capsule_psf(radius, length, angle)) < L1_BUDGET


@compiled
def test_traced_psf_agrees_with_random_points():
    expected = psfs.trace_points(5.0, 9.0, 0.7, 21, 200_000, np.random.default_rng(1))
    # 200 000 points over some 170 px leave a relative error of about 0.8 / sqrt(1200).
    assert relative_l1(trace_psf(COMBINED, sharp(5, 9), angle=0.7), expected) < 0.035


@compiled
@pytest.mark.parametrize("box", [[[3.0, 5.0]], [[20.0, 22.0]], [[0.0, 2.0]]])
def test_prefilter_is_the_tent_average_of_discs(box):
    size = 2 * int(np.ceil(box[0][1] + 1)) + 1
    radii, weights = psfs.tent_nodes(*box[0])
    expected = sum(w * psfs.disc_coverage(r, size=size) for r, w in zip(radii, weights, strict=True))
    assert relative_l1(trace_psf(SIMPLE, box), expected) < L1_BUDGET


@compiled
def test_prefilter_is_the_tent_average_over_motion_and_direction():
    lengths, length_weights = psfs.tent_nodes(20.0, 30.0, 5)
    angles, angle_weights = psfs.tent_nodes(0.2, 0.6, 5)
    expected = sum(
        v * w * psfs.capsule_psf(6.0, length, angle, 45)
        for length, v in zip(lengths, length_weights, strict=True)
        for angle, w in zip(angles, angle_weights, strict=True)
    )
    psf = trace_psf(COMBINED, [[6, 6], [20, 30]], angle=0.4, angle_half_width=0.2)
    assert relative_l1(psf, expected) < L1_BUDGET
    assert relative_l1(trace_psf(COMBINED, [[6, 6], [20, 30]], angle=0.4), expected) > 2 * L1_BUDGET


@compiled
@pytest.mark.parametrize("model, box", [(SIMPLE, [[10, 12]]), (COMBINED, [[10, 12], [20, 25]])])
def test_result_does_not_depend_on_the_thread_count(model, box):
    first, *others = for_thread_counts(lambda: trace_psf(model, box, angle=0.3, angle_half_width=0.05))
    for other in others:
        np.testing.assert_array_equal(other, first)


@compiled
def test_seed_changes_the_noise_and_nothing_else():
    box = [[10, 12], [20, 25]]
    first, again, other = (trace_psf(COMBINED, box, angle=0.3, rays=300_000, seed=seed) for seed in (0, 0, 1))
    np.testing.assert_array_equal(first, again)
    assert 0 < relative_l1(first, other[..., 0]) < 2 * L1_BUDGET
    assert first.sum() == pytest.approx(1.0, abs=1e-12) == other.sum()


@compiled
def test_more_rays_lower_the_error():
    expected = psfs.disc_coverage(30.3)
    errors = [relative_l1(trace_psf(SIMPLE, sharp(30.3), rays=rays), expected) for rays in (3_000, 30_000, 300_000)]
    assert errors[0] > 4 * errors[1] > 16 * errors[2]


@compiled
@pytest.mark.parametrize("cell", [30, 70, 99])
def test_disc_has_the_symmetry_of_the_lattice(cell):
    psf = trace_psf(SIMPLE, PsfGrid.of(SIMPLE).box(cell))[..., 0]
    for mirrored in (psf[::-1], psf[:, ::-1], psf.T):
        np.testing.assert_allclose(mirrored, psf, rtol=1e-12, atol=0)


@compiled
@pytest.mark.parametrize("cell", [0, 40, 200, 399])
def test_cells_have_unit_energy_half_turn_symmetry_and_a_tight_frame(cell):
    grid = PsfGrid.of(COMBINED)
    psf = trace_psf(COMBINED, grid.box(cell), angle=0.2, angle_half_width=grid.angle_half_width(cell))
    assert psf.sum() == pytest.approx(1.0, abs=1e-12)
    assert psf.shape[0] % 2 == psf.shape[1] % 2 == 1 and psf.shape[2] == 1
    np.testing.assert_array_equal(psf[::-1, ::-1], psf)
    frame = [psf[0], psf[-1], psf[:, 0], psf[:, -1]]
    assert not any(side.any() for side in frame)
    assert psf[1].any() and psf[:, 1].any()


@compiled
def test_motion_to_the_right_and_down_fills_that_diagonal():
    psf = trace_psf(COMBINED, sharp(1, 20), angle=np.pi / 4)[..., 0]
    middle = psf.shape[0] // 2
    assert psf[middle + 5, middle + 5] > 0 and psf[middle - 5, middle - 5] > 0
    assert psf[middle + 5, middle - 5] == 0 == psf[middle - 5, middle + 5]


@compiled
@pytest.mark.parametrize("angle", np.random.default_rng(4).uniform(-np.pi, np.pi, 6))
def test_folded_direction_reproduces_the_psf(angle):
    grid = PsfGrid.of(COMBINED)
    cell = int(grid.find([6.0, 40.0]))
    step = grid.angle_half_width(cell) * grid.coordinate(cell)[1] / 2
    index, transpose, flip_row, flip_col = grid.nearest_pose(cell, angle)
    psf = trace_psf(COMBINED, sharp(*grid.coordinate(cell)), angle=grid.angles(cell)[index])
    psf = psf.swapaxes(0, 1) if transpose else psf
    psf = psf[::-1] if flip_row else psf
    psf = psf[:, ::-1] if flip_col else psf
    wanted = trace_psf(COMBINED, sharp(*grid.coordinate(cell)), angle=angle)
    # The nearest node is off by a quarter step along the path on average, over an edge of 1 / 6 of the area per px.
    assert relative_l1(psf, on_canvas(wanted, (61, 61))) < 0.06 * step


def random_segments(n, n_channels, rng):
    ends = rng.uniform(-5, 5, (n, 4))
    # Points, axis-parallel segments, whole and half coordinates: every special case of the traversal.
    ends[::5, 2:] = ends[::5, :2]
    ends[1::5, 2] = ends[1::5, 0]
    ends[2::5, 3] = ends[2::5, 1]
    ends[3::10] = np.round(2 * ends[3::10]) / 2
    return ends, rng.random((n, n_channels)), rng.random((n, n_channels))


@pytest.mark.parametrize("n_channels", [1, 3])
def test_deposit_agrees_with_the_naive_twin(n_channels):
    ends, start, stop = random_segments(400, n_channels, np.random.default_rng(2))
    images = np.zeros((8, 13, 15, n_channels))
    deposit_segments(0, len(images), ends, start, stop, images)
    np.testing.assert_allclose(images.sum(axis=(0, 1, 2)), (start + stop).sum(axis=0) / 2)
    # Segments along a pixel border belong to either side, by rounding: compared above in energy only.
    plain = np.ones(400, dtype=bool)
    plain[3::10] = False
    images[:] = 0.0
    deposit_segments(0, len(images), ends[plain], start[plain], stop[plain], images)
    expected = psfs.deposit_segments(ends[plain], start[plain], stop[plain], np.zeros((13, 15, n_channels)))
    np.testing.assert_allclose(images.sum(axis=0), expected, atol=1e-12)


@pytest.mark.parametrize("x, pixel", [(-0.5, 0), (0.49, 0), (0.5, 1), (-0.51, -1)])
def test_pixel_owns_its_lower_border(x, pixel):
    images = np.zeros((1, 5, 5, 1))
    deposit_segments(0, len(images), np.array([[x, 0.0, x, 0.0]]), np.ones((1, 1)), np.ones((1, 1)), images)
    assert images[0, 2, 2 + pixel, 0] == 1.0


def test_tent_is_zero_at_the_borders_and_centred():
    value = tent((np.arange(100_000) + 0.5) / 100_000, 2.0, 6.0)
    density, _ = np.histogram(value, bins=4, range=(2.0, 6.0))
    np.testing.assert_allclose(density / 100_000, [1 / 8, 3 / 8, 3 / 8, 1 / 8], atol=1e-4)
    assert value.mean() == pytest.approx(4.0)


@pytest.mark.parametrize("radius, half_path", [(3.0, 0.0), (0.0, 3.0), (0.0, 0.0), (2.0, 5.0), (5.0, 2.0)])
def test_chords_carry_the_area_of_the_lens(radius, half_path):
    u = (np.arange(1000) + 0.5) / 1000
    chords = lens_chords(u, np.full(1000, radius), np.full(1000, half_path), np.zeros(1000))
    # The mean over u of the squared cosine that a chord's energy is.
    assert (chords.start + chords.stop).sum() / 2 / 1000 == pytest.approx(0.5)


@pytest.mark.parametrize(
    "model, box, keywords, message",
    [
        (PsfModel("fisheye", SIMPLE.axes, 1, False, 9), [[1, 2]], {}, "'fisheye'.*combined, physicallens, simplelens"),
        (COMBINED, [[1, 2]], {}, r"\(2, 2\).*\(1, 2\)"),
        (SIMPLE, [[2, 1]], {}, "low <= high"),
        (SIMPLE, [[-1, 1]], {}, "0 <= low"),
        (SIMPLE, [[1, np.inf]], {}, "< inf"),
        (SIMPLE, [[1, 2]], {"rays": 0}, "rays must be at least 1"),
    ],
)
def test_impossible_input_is_refused(model, box, keywords, message):
    with pytest.raises(InvalidParameterError, match=message):
        trace_psf(model, box, **keywords)


@compiled
@pytest.mark.parametrize("coordinate", [(0.5, 25.0), (0.5, 100.0), (1.5, 60.0), (2.5, 60.0), (6.0, 90.0), (15.0, 90.0)])
def test_psf_midway_between_two_directions_stays_similar(coordinate):
    grid = PsfGrid.of(COMBINED)
    cell = int(grid.find(coordinate))
    box, spacing = grid.box(cell), grid.angle_half_width(cell)
    for number in (0, 1, 2):
        stored = trace_psf(COMBINED, box, angle=number * spacing, angle_half_width=spacing)
        wanted = trace_psf(COMBINED, box, angle=(number + 0.5) * spacing)
        half = np.maximum(stored.shape[:2], wanted.shape[:2]) // 2
        pair = [on_canvas(psf, tuple(2 * half + 1)) for psf in (wanted, stored)]
        # A third of a pixel between neighbours is what brings the sharpest lines here; steps of 0.5 px leave 0.94.
        assert psf_similarity(*pair) > 0.965


def test_a_psf_too_wide_to_be_traced_is_refused():
    model = get_model("simplelens", max_coc=1e5)
    with pytest.raises(InvalidParameterError, match="reaches .* at most 2048 px"):
        trace_psf(model, [[9e4, 1e5]])


def test_the_footprint_is_about_as_large_as_the_psf():
    model = get_model("combined")
    for box in ([[10.0, 11.0], [0.0, 2.0]], [[30.0, 32.0], [60.0, 64.0]], [[0.0, 1.0], [80.0, 82.0]]):
        pixels = psf_footprint(model, box, angle=0.0, angle_half_width=0.0, side=1)
        psf = trace_psf(model, box, rays=20_000)
        assert 0.5 * psf.size < pixels < 2.0 * psf.size


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("simplelens", {}),
        ("simplelens", {"obstruction": 0.3}),
        ("combined", {}),
        ("combined", {"blades": 6, "shutter_curve": [0.0, 1.0, 0.2], "spherical_aberration": 0.4}),
        ("physicallens", {}),
    ],
)
@pytest.mark.parametrize("side", [1, -1])
def test_no_segment_leaves_the_square_that_its_tracer_names(name, options, side):
    model = get_model(name, settings=REGISTRY[name].read_settings(**options))
    tracer = REGISTRY[name].tracer(model, side)
    box = np.array(sharp(*(0.4 * axis.maximum for axis in model.axes)))
    points = np.random.default_rng(5).random((4000, tracer.n_dimensions))
    farthest = np.abs(tracer.trace(points, box, 0.0, 0.0).ends).max()
    assert 0.75 * tracer.reach(box) < farthest <= tracer.reach(box) * (1.0 + 1e-12)
