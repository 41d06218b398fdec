import numpy as np
import pytest
from naive.splat import splat_naive
from threads import for_thread_counts

from spreadlets.runtime.label.labels import NO_SHIFT
from spreadlets.runtime.splat._splat_kernels import RUN_ROW
from spreadlets.runtime.splat.passes import DIRECT, GROUPS, Canvas, PointTable, SplatPass, canvas_of, find_runs, union
from spreadlets.runtime.splat.splat import add_to_canvas, splat_direct, splat_laplacian

N_LAYERS = 2
SPARSE_GROUPS = (0, GROUPS)
DIRECT_GROUPS = (DIRECT, GROUPS + DIRECT)
CORNER = (2, 4)
"""Minus the row and column where the passes here begin."""


def random_table(rng, n_channels, n_variants=5, reach=6):
    offsets, values, counts = [], [], []
    for _ in range(n_variants):
        n_points = int(rng.integers(1, 12))
        offset = rng.integers(-reach, reach + 1, (n_points, 2)).astype(np.int32)
        offsets.append(offset[np.lexsort((offset[:, 1], offset[:, 0]))])
        values.append(rng.normal(size=(n_points, n_channels)).astype(np.float32))
        counts.append(n_points)
    start = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    group = np.where(np.arange(n_variants) % 2 == 1, DIRECT, 0)
    return PointTable(np.concatenate(offsets), np.concatenate(values), start, group)


def random_pass(rng, n_variants=5, shape=(70, 23), shift=3, stride=1):
    radiance = rng.random((*shape, 4)).astype(np.float32)
    label = np.repeat(rng.integers(-1, N_LAYERS * n_variants, (shape[0], 8)), 3, axis=1)[:, : shape[1]]
    moved = NO_SHIFT
    if shift:
        moved = rng.integers(-shift, shift + 1, (shape[0], 1, 2)).repeat(shape[1], axis=1).astype(np.int32)
        moved[:, shape[1] // 2 :] = 0
    return SplatPass((-2, -4), radiance, label.astype(np.int32), moved, stride)


def random_levels(rng):
    """Single pixels and blocks of 2 and 4 px of one frame."""
    shapes = {1: (70, 23), 2: (35, 11), 4: (17, 5)}
    return [random_pass(rng, shape=shape, shift=0, stride=stride) for stride, shape in shapes.items()]


def drawn(table, sources, group):
    """The canvas and the image of a group."""
    runs = [find_runs(source, table, N_LAYERS) for source in sources]
    canvas = canvas_of(runs, group, table, 3, CORNER)
    if group in SPARSE_GROUPS:
        return canvas, splat_laplacian(canvas, [runs], group, table)
    image = np.zeros((canvas.rows, canvas.cols, 4), np.float32)
    splat_direct(image, canvas, runs[0], group, table)
    return canvas, image


@pytest.mark.interpreted
@pytest.mark.parametrize("n_channels", [1, 3])
@pytest.mark.parametrize("group", [*SPARSE_GROUPS, *DIRECT_GROUPS])
def test_runs_draw_what_single_pixels_would(n_channels, group):
    rng = np.random.default_rng(n_channels)
    table, source = random_table(rng, n_channels), random_pass(rng)
    canvas, image = drawn(table, [source], group)
    expected = splat_naive(canvas, [source], group, table)
    assert expected.any() and np.allclose(image, expected, atol=2e-5)


@pytest.mark.interpreted
@pytest.mark.parametrize("n_channels", [1, 3])
@pytest.mark.parametrize("group", SPARSE_GROUPS)
def test_blocks_are_drawn_as_all_their_pixels_would(n_channels, group):
    rng = np.random.default_rng(2)
    table, sources = random_table(rng, n_channels), random_levels(rng)
    canvas, image = drawn(table, sources, group)
    assert np.allclose(image, splat_naive(canvas, sources, group, table), atol=5e-5)


@pytest.mark.interpreted
@pytest.mark.parametrize("n_channels", [1, 3])
def test_passes_add_up(n_channels):
    rng = np.random.default_rng(9)
    table = random_table(rng, n_channels)
    sources = [random_levels(rng), [random_pass(rng)], random_levels(rng)[:2]]
    runs = [[find_runs(each, table, N_LAYERS) for each in levels] for levels in sources]
    canvas = canvas_of([each for levels in runs for each in levels], 0, table, 0, CORNER)
    image = splat_laplacian(canvas, runs, 0, table)
    expected = splat_naive(canvas, [each for levels in sources for each in levels], 0, table)
    assert np.allclose(image, expected, atol=5e-5)


@pytest.mark.parametrize("n_channels", [1, 3])
def test_the_result_does_not_depend_on_the_number_of_threads(n_channels):
    rng = np.random.default_rng(5)
    table, sources = random_table(rng, n_channels), random_levels(rng)
    for group in (0, DIRECT):
        first, *others = for_thread_counts(lambda group=group: drawn(table, sources, group)[1])
        assert all(np.array_equal(first, other) for other in others)


@pytest.mark.interpreted
@pytest.mark.parametrize("n_channels", [1, 3])
def test_direct_points_that_are_neighbours_are_drawn_like_single_ones(n_channels):
    rng = np.random.default_rng(8)
    _, source = random_table(rng, n_channels), random_pass(rng, n_variants=2)
    grid = np.argwhere(rng.random((7, 9)) < 0.8).astype(np.int32) - [3, 4]
    offset = np.concatenate([grid, grid[::2]]).astype(np.int32, "C")
    value = rng.random((len(offset), n_channels)).astype(np.float32)
    table = PointTable(offset, value, np.array([0, len(grid), len(offset)]), np.full(2, DIRECT))
    canvas, image = drawn(table, [source], DIRECT)
    assert np.allclose(image, splat_naive(canvas, [source], DIRECT, table), atol=2e-5)


@pytest.mark.interpreted
@pytest.mark.parametrize("n_channels", [1, 3])
def test_long_runs_draw_direct_points_like_short_ones(n_channels):
    rng = np.random.default_rng(6)
    table = random_table(rng, n_channels)
    source = SplatPass((-2, -4), rng.random((9, 40, 4)).astype(np.float32), np.ones((9, 40), np.int32))
    canvas, image = drawn(table, [source], DIRECT)
    assert np.allclose(image, splat_naive(canvas, [source], DIRECT, table), atol=2e-5)


def test_passes_of_one_table_are_drawn_into_canvases_of_any_width():
    rng = np.random.default_rng(11)
    table = random_table(rng, 1)
    widths = []
    for cols in (9, 23, 9):
        source = random_pass(rng, shape=(20, cols), shift=0)
        canvas, image = drawn(table, [source], 0)
        widths.append(canvas.cols)
        assert np.allclose(image, splat_naive(canvas, [source], 0, table), atol=2e-5)
    assert widths[0] == widths[2] < widths[1]


@pytest.mark.interpreted
def test_a_pass_without_shift_is_one_with_zero_shift():
    rng = np.random.default_rng(7)
    table, source = random_table(rng, 1), random_pass(rng, shift=0)
    still = source._replace(shift=np.zeros((*source.label.shape, 2), np.int32))
    images = [drawn(table, [each], 0)[1] for each in (source, still)]
    assert images[0].any() and np.array_equal(*images)


def test_the_canvas_holds_every_splat_and_no_more():
    table = PointTable(np.array([[-2, 5]], np.int32), np.ones((1, 1), np.float32), np.array([0, 1]), np.zeros(1, int))
    label = np.full((9, 12), -1, np.int32)
    label[4, 6] = 0
    runs = find_runs(SplatPass((0, 0), np.ones((9, 12, 4), np.float32), label), table, 1)
    canvas = canvas_of([runs], 0, table, 1, (0, 0))
    # It reaches 5 px in any direction, and there is 1 px around it; blocks widen that.
    assert canvas == Canvas(-4, 0, 16, 16)
    assert canvas_of([runs], DIRECT, table, 1, (0, 0)) is None


def test_the_union_holds_all_canvases_and_no_more():
    assert union([Canvas(-4, 0, 8, 12), Canvas(0, -8, 12, 8)]) == Canvas(-4, -8, 16, 20)


@pytest.mark.parametrize("place", range(4))
@pytest.mark.parametrize("size", range(1, 5))
@pytest.mark.parametrize("at", range(4))
def test_canvases_begin_and_end_at_blocks_of_every_stride(place, size, at):
    table = PointTable(np.zeros((1, 2), np.int32), np.ones((1, 1), np.float32), np.array([0, 1]), np.zeros(1, int))
    label = np.full((12, 12), -1, np.int32)
    label[place : place + size, place : place + size] = 0
    runs = find_runs(SplatPass((-at, -at), np.ones((12, 12, 4), np.float32), label), table, 1)
    canvas = canvas_of([runs], 0, table, 1, (at, at))
    assert (canvas.top + at) % 4 == (canvas.left + at) % 4 == canvas.rows % 4 == canvas.cols % 4 == 0


@pytest.mark.parametrize("shift", [0, 3])
def test_runs_of_a_group_are_sorted_by_row(shift):
    rng = np.random.default_rng(12)
    runs = find_runs(random_pass(rng, shift=shift), random_table(rng, 1), N_LAYERS)
    assert all((np.diff(runs.of(group)[:, RUN_ROW]) >= 0).all() for group in (*SPARSE_GROUPS, *DIRECT_GROUPS))
    assert len(runs.runs) > 50


def shared_out(image, step):
    """Share each pixel between the coarse pixels around it, linearly."""
    for axis in (0, 1):
        fine = np.moveaxis(image, axis, 0)
        place = (np.arange(len(fine)) + 0.5) / step - 0.5
        weight = np.maximum(1 - np.abs(place - np.arange(len(fine) // step)[:, None]), 0)
        image = np.moveaxis(np.tensordot(weight, fine, 1), 0, axis)
    return image


@pytest.mark.parametrize("step", [2, pytest.param(4, marks=pytest.mark.interpreted)])
def test_coarse_pixels_share_what_fine_ones_would_hold(step):
    rng = np.random.default_rng(13)
    table, sources = random_table(rng, 1), random_levels(rng)
    runs = [find_runs(source, table, N_LAYERS) for source in sources]
    canvas = canvas_of(runs, 0, table, 2 * step, CORNER)
    fine, coarse = (splat_laplacian(canvas, [runs], 0, table, each) for each in (1, step))
    assert coarse.shape == (canvas.rows // step, canvas.cols // step, 4)
    assert np.allclose(coarse, shared_out(fine.astype(float), step), atol=5e-5)
    assert coarse.sum(axis=(0, 1)) == pytest.approx(fine.sum(axis=(0, 1)), abs=1e-3)


def interpolated(coarse, step):
    """Interpolate cubically, by the kernel of Keys."""
    for axis in (0, 1):
        given = np.moveaxis(coarse, axis, 0)
        place = (np.arange(step * len(given)) + 0.5) / step - 0.5
        far = np.abs(place[:, None] - np.arange(len(given)))
        inner, outer = 1.5 * far**3 - 2.5 * far**2 + 1, -0.5 * far**3 + 2.5 * far**2 - 4 * far + 2
        weight = np.where(far <= 1, inner, np.where(far < 2, outer, 0))
        coarse = np.moveaxis(np.tensordot(weight, given, 1), 0, axis)
    return coarse


@pytest.mark.interpreted
@pytest.mark.parametrize("step", [1, 2, 4])
def test_images_of_coarse_pixels_are_added_cubically_where_they_lie(step):
    rng = np.random.default_rng(14)
    own = Canvas(-4, 8, 12, 16)
    coarse = rng.random((own.rows // step, own.cols // step, 4)).astype(np.float32)
    image = rng.random((24, 40, 4)).astype(np.float32)
    expected = image.astype(float)
    expected[4:16, 12:28] += interpolated(coarse.astype(float), step)
    add_to_canvas(image, Canvas(-8, -4, 24, 40), coarse, own, step)
    assert np.allclose(image, expected, atol=1e-5)
