"""What lies behind a post before a pattern: found in its surroundings, or in another frame."""

import numpy as np
import pytest

from spreadlets.runtime.label.moving import Effects
from spreadlets.runtime.plan import _behind_kernels, _bridge_kernels
from spreadlets.runtime.plan import behind as behind_module
from spreadlets.runtime.plan.divide import divide_frames
from spreadlets.scene.camera import ThinLens
from spreadlets.scene.frame import Frame
from spreadlets.scene.raster import Raster, Window

CAMERA = ThinLens(focal_length_mm=50, sensor_width_mm=36, f_number=0.05, focus_distance_m=4.0)
SIZE, POST = 64, slice(28, 36)


def depth_of(coc):
    return 1.0 / (1.0 / 4.0 - coc / CAMERA.coc_scale(SIZE))


def checkerboard(cell=8):
    rows, cols = np.indices((SIZE, SIZE))
    return np.where(((rows // cell + cols // cell) % 2)[..., None], (0.9, 0.8, 0.7), (0.1, 0.2, 0.3))


def post_before(behind, near=-6.0, far=0.0):
    radiance, depth = behind.copy(), np.full((SIZE, SIZE), depth_of(far))
    radiance[:, POST], depth[:, POST] = (0.5, 0.1, 0.1), depth_of(near)
    return Frame(radiance, depth).layers[0]


def hidden(layer, **options):
    """Return colours and shares of what is hidden in a frame."""
    divided = divide_frames([layer], CAMERA, Effects(defocus=True, motion=True, swept=True), **options)
    assert divided.n_hidden == 1
    return in_frame(divided.pixel_sets[0][-1])


def in_frame(pixels):
    """Return colours and weights of a list of pixels where they lie; black where there are none."""
    colours, weights = np.zeros((SIZE, SIZE, 4)), np.zeros((SIZE, SIZE))
    drawn = pixels.weight > 0
    rows, cols = pixels.labels.view.places.at[drawn].T
    colours[rows, cols], weights[rows, cols] = pixels.radiance[drawn], pixels.weight[drawn]
    return colours, weights


def test_a_pattern_goes_on_behind_a_post():
    behind = checkerboard()
    colours, share = hidden(post_before(behind))
    found = share[8:-8, POST]
    assert found.mean() > 0.95, "all of it is within reach of the post's blur"
    error = np.abs(colours[..., :3] - behind)[8:-8, POST].max(axis=2)[found > 0.5]
    assert np.median(error) < 0.02 and error.mean() < 0.15


def test_lines_go_on_across_a_narrow_gap():
    """Behind a bar before a star of rays, each as wide and as steep as no other: nowhere else looks alike."""
    rows, cols = np.indices((SIZE, SIZE)) - np.array([30.0, -30.0])[:, None, None]
    rays = np.sin(0.5 * np.degrees(np.arctan2(rows, cols))) > 0.0
    behind = np.where(rays[..., None], (0.9, 0.8, 0.7), (0.1, 0.2, 0.3))
    colours, share = hidden(post_before(behind))
    error = np.abs(colours[..., :3] - behind)[8:-8, POST].max(axis=2)
    found = share[8:-8, POST] > 0.5
    assert found.mean() > 0.25 and error[found].mean() < 0.05, (found.mean(), error[found].mean())


def test_lamps_are_not_copied():
    behind = checkerboard()
    behind[[12, 36, 52], [22, 24, 40]] = 60.0
    assert hidden(post_before(behind))[0].max() < 2.0, "no pixel is much brighter than what is around"


@pytest.mark.interpreted
def test_nor_are_lamps_so_large_that_the_mean_around_them_is_bright_too():
    behind = checkerboard()
    for row, col in ((12, 16), (36, 40), (52, 18)):
        behind[row : row + 4, col : col + 4] = 300.0
    assert hidden(post_before(behind))[0].max() < 8.0


def test_as_bright_as_everything_around_is_no_lamp():
    bright = 20.0 * checkerboard()
    colours, share = hidden(post_before(bright))
    assert np.median(np.abs(colours[..., :3] - bright)[8:-8, POST].max(axis=2)[share[8:-8, POST] > 0.5]) < 0.4


@pytest.mark.interpreted
def test_what_is_copied_is_no_brighter_than_all_that_was_seen_around():
    hides, features = np.zeros((8, 24), np.float32), np.ones((8, 24, 5), np.float32)
    features[:, 8:16, :3] = 4.0
    places, unlike = np.tile(np.int64((0, 8)), (1, 3, 1)), np.array([[0.01, -1.0, -1.0]])
    near, far, looked_up = np.float32(hides == 0), np.zeros_like(hides), (8, 24)
    found = np.zeros(looked_up, np.int32), np.zeros(looked_up, np.float32), np.zeros((*looked_up, 4), np.float32)
    known, given = np.zeros(looked_up, np.uint64), ((0, 0), places, unlike, np.full((1, 3), 0.5), far[:1, :3])
    _behind_kernels.find_behind(
        0, 8, near, (hides, features, far, np.ones(hides.shape, np.uint8)), given, 0, (0, 0), 1, found, known
    )
    assert np.allclose(found[2][:, :8], (0.5, 0.5, 0.5, 1.0))


def test_squares_wider_than_what_blocks_are_compared_by_go_on():
    size, cell, post = 192, 24, slice(92, 112)
    rows, cols = np.indices((size, size))
    behind = np.where((((rows + 4) // cell + (cols + 16) // cell) % 2)[..., None], (0.9, 0.8, 0.7), (0.1, 0.2, 0.3))
    near, far = (1.0 / (1.0 / 4.0 - coc / CAMERA.coc_scale(size)) for coc in (-12.0, 0.0))
    radiance, depth = behind.copy(), np.full((size, size), far)
    radiance[:, post], depth[:, post] = 0.5, near
    divided = divide_frames(Frame(radiance, depth).layers, CAMERA, Effects(defocus=True, motion=True, swept=True))
    last = divided.pixel_sets[0][-1]
    place = tuple(last.labels.view.places.at[last.weight > 0].T)
    error = np.abs(last.radiance[last.weight > 0][:, :3] - behind[place]).max(axis=1)
    assert np.mean(error > 0.1) < 0.12, "all but a few lie on the right side of the squares' edges"


def test_what_moves_is_looked_up_for_it_is_sharp_across_its_motion():
    """Bars along the motion stay sharp, however far they move; behind a post they go on."""
    behind = np.where((np.indices((SIZE, SIZE))[0] // 4 % 2)[..., None], (0.9, 0.8, 0.7), (0.1, 0.2, 0.3))
    post = post_before(behind)
    moving = np.where((post.depth < depth_of(-3.0))[..., None], 0.0, (48.0, 0.0))
    colours, share = hidden(Frame(post.radiance, post.depth, moving).layers[0])
    assert share[8:-8, POST].mean() > 0.85
    assert np.abs(colours[..., :3] - behind)[8:-8, POST].max(axis=2)[share[8:-8, POST] > 0.5].mean() < 0.05


def test_an_even_surface_stays_even():
    colours, share = hidden(post_before(np.full((SIZE, SIZE, 3), 0.4)))
    assert np.allclose(colours[share > 0], (0.4, 0.4, 0.4, 1.0), atol=0.005)


def test_far_behind_an_edge_an_even_surface_is_as_bright_as_beside_it():
    """Where blocks have seen nothing around them, nothing limits how bright what they copy is."""
    size = 192
    near, far = (1.0 / (1.0 / 4.0 - coc / CAMERA.coc_scale(size)) for coc in (-28.0, 0.0))
    rows, cols = np.indices((size, size)) - size // 2
    from_edge = 58.0 - np.hypot(rows, cols)
    radiance = np.where(from_edge[..., None] > 0.0, 0.1, 0.4) * np.ones(3)
    layers = Frame(radiance, np.where(from_edge > 0.0, near, far)).layers
    divided = divide_frames(layers, CAMERA, Effects(defocus=True, motion=True, swept=True))
    last = divided.pixel_sets[0][-1]
    drawn = last.weight > 0.0
    assert from_edge[tuple(last.labels.view.places.at[drawn].T)].max() > 24.0
    assert np.abs(last.radiance[drawn][:, :3] - 0.4).max() < 0.05


def test_behind_a_wide_blur_it_is_looked_up_in_cells_of_several_pixels(monkeypatch):
    rows, columns = np.indices((SIZE, 2 * SIZE))
    behind = np.where((rows // 8 % 2)[..., None], (0.9, 0.8, 0.7), (0.1, 0.2, 0.3))
    post = np.abs(columns - SIZE + 0.5) < 15
    coc = np.where(post, -24.0, 9.0)
    frame = Frame(np.where(post[..., None], 0.5, behind), 1.0 / (1.0 / 4.0 - coc / CAMERA.coc_scale(2 * SIZE)))
    levels, find = [], _behind_kernels.find_behind
    monkeypatch.setattr(_behind_kernels, "find_behind", lambda *given: levels.append(given[5]) or find(*given))
    last = divide_frames(frame.layers, CAMERA, Effects(defocus=True, motion=True, swept=True)).pixel_sets[0][-1]
    assert set(levels) == {1}
    place = tuple(last.labels.view.places.at[last.weight > 0].T)
    found = np.zeros(post.shape)
    found[place] = last.weight[last.weight > 0]
    assert found[12:-12, SIZE - 10 : SIZE + 10].mean() > 0.85
    error = np.abs(last.radiance[last.weight > 0][:, :3] - behind[place]).max(axis=1)
    assert np.median(error) < 0.02, "the stripes go on: cells lie within them"


def test_shares_are_those_that_the_nearer_layer_hides():
    layer = post_before(checkerboard())
    divided = divide_frames([layer], CAMERA, Effects(defocus=True, motion=True, swept=True))
    first, further, last = divided.pixel_sets[0]
    near = first.weight * (first.labels.coc < -3)
    at = further.labels.view.places.at
    np.add.at(near, (at[..., 0], at[..., 1]), further.weight * (further.labels.coc < -3))
    share = in_frame(last)[1]
    assert share.any() and np.allclose(share[share > 0], near[share > 0], atol=1e-5)


def test_what_no_blur_reveals_is_not_looked_for():
    behind = checkerboard()
    radiance, depth = behind.copy(), np.full((SIZE, SIZE), depth_of(0.0))
    radiance[:, 22:42], depth[:, 22:42] = 0.5, depth_of(-4.0)
    _, share = hidden(Frame(radiance, depth).layers[0])
    assert not share[:, 30:34].any() and share[8:-8, 22:25].any()


def test_noise_is_not_copied():
    noise = np.random.default_rng(0).random((SIZE, SIZE, 3))
    divided = divide_frames([post_before(noise)], CAMERA, Effects(defocus=True, motion=True, swept=True))
    assert divided.n_hidden == 0, "no place looks like another"


def noise_before_a_wall(covers):
    """Return a frame of noise of which some pixels lie farther off, with a post before all."""
    noise = 0.2 + np.random.default_rng(0).random((SIZE, SIZE, 3))
    depth = np.where(covers, depth_of(0.0), depth_of(8.0))
    noise[:, POST], depth[:, POST] = (0.5, 0.1, 0.1), depth_of(-6.0)
    return Frame(noise, depth).layers[0]


def test_a_large_thing_goes_on_as_far_as_it_is_seen_beside_a_post():
    """Nowhere else looks alike, and no lines go on: but beside the post all is covered above, and nothing below."""
    rows = np.indices((SIZE, SIZE))[0]
    layer = noise_before_a_wall(rows < SIZE // 2)
    colours, share = hidden(layer)
    beside = slice(POST.start, POST.start + 2), slice(POST.stop - 2, POST.stop)
    above, below = slice(8, SIZE // 2 - 4), slice(SIZE // 2 + 4, SIZE - 8)
    assert all(share[above, each].min() > 0.9 and share[below, each].max() < 0.1 for each in beside)
    # What is nearest counts most: three pixels right beside the post.
    seen = layer.radiance[:, POST.start - 1, :3]
    nearest = np.mean([seen[above.start + step : above.stop + step] for step in (-1, 0, 1)], axis=0)
    found = colours[above, POST.start, :3]
    assert np.corrcoef(found.ravel(), nearest.ravel())[0, 1] > 0.8


def test_what_is_finer_than_a_gap_does_not_go_on_in_it(monkeypatch):
    """One piece says nothing of the next: to guess would make blots. Some are strands, which go on as such."""
    covers = (np.random.default_rng(1).random((SIZE // 2, SIZE // 2)) < 0.5).repeat(2, axis=0).repeat(2, axis=1)
    colours, share = hidden(noise_before_a_wall(covers))
    monkeypatch.setattr(behind_module, "GOING_ON", 0.0)
    without = hidden(noise_before_a_wall(covers))
    assert np.array_equal(colours, without[0]) and np.array_equal(share, without[1])


@pytest.mark.interpreted
def test_changes_are_counted_between_neighbours_that_are_known():
    comparable = np.random.default_rng(2).integers(0, 3, (19, 13)).astype(np.uint8)
    corner = (3, -2)
    counts, expected = np.empty((4, 3, 3), np.float32), np.zeros((4, 3, 3))
    _bridge_kernels.count_changes(0, 3, comparable, corner, counts)
    for row, col in np.argwhere(comparable):
        block = (row + 3) // 8, (col + 6) // 8
        beside = [(row - 1, col), (row + 1, col), (row, col - 1), (row, col + 1)]
        known = [comparable[at] for at in beside if min(at) >= 0 and at[0] < 19 and at[1] < 13 and comparable[at]]
        own = comparable[row, col]
        expected[(slice(None), *block)] += 1, own == 2, len(known), sum(each != own for each in known)
    assert np.array_equal(counts, expected)


def test_other_frames_come_before_guesses():
    noise = np.random.default_rng(0).random((SIZE, SIZE, 3))
    seen_there = np.roll(noise, 20, axis=1)
    other = Frame(seen_there, np.full((SIZE, SIZE), depth_of(0.0)), np.broadcast_to((-20.0, 0.0), (SIZE, SIZE, 2)))
    layer = Frame(*((each := post_before(noise)).radiance, each.depth, np.zeros((SIZE, SIZE, 2)))).layers[0]
    colours, share = hidden(layer, neighbours=[other.layers[0]])
    assert share[:, POST].min() > 0.9
    assert np.allclose(colours[:, POST, :3], noise[:, POST], atol=1e-5)


def test_any_number_of_threads_gives_the_same(monkeypatch):
    from spreadlets.parallel import limit_threads

    layer, found = post_before(checkerboard()), []
    for count in (1, 2):
        with limit_threads(count):
            found.append(hidden(layer))
    assert all(np.array_equal(*each) for each in zip(*found, strict=True))


def test_a_frame_with_overscan_finds_what_the_wide_frame_does():
    wide = post_before(checkerboard())
    display = Window(16, 16, 32, 32)
    found = []
    for cut in (0, 3):
        inner = np.s_[cut : SIZE - cut, cut : SIZE - cut]
        raster = Raster(Window(cut, cut, SIZE - 2 * cut, SIZE - 2 * cut), display)
        layer = Frame(wide.radiance[inner], wide.depth[inner], raster=raster).layers[0]
        pixels = divide_frames([layer], CAMERA, Effects(defocus=True, motion=True, swept=True)).pixel_sets[0][-1]
        drawn = pixels.weight > 0
        rows, cols = pixels.labels.view.places.at[drawn].T + cut
        colours = np.zeros((SIZE, SIZE, 4))
        colours[rows, cols] = pixels.radiance[drawn]
        found.append(colours[24:40, 24:40])
    # What lies beyond the narrower frame is compared, too, from afar.
    assert found[0].any() and np.abs(found[0] - found[1]).max() < 0.006


@pytest.mark.parametrize("angle", [0.0, pytest.param(40.0, marks=pytest.mark.interpreted)])
def test_a_strand_goes_on_behind_a_post(angle):
    """A stalk in focus crosses a post out of focus, before a wall out of focus: as wide, as bright, along its line."""
    radiance, depth = np.full((SIZE, SIZE, 3), 0.4), np.full((SIZE, SIZE), depth_of(8.0))
    rows, cols = np.indices((SIZE, SIZE)) - SIZE / 2 + 0.25
    across = np.abs(rows * np.cos(np.radians(angle)) - cols * np.sin(np.radians(angle)))
    stalk = across < 1.0
    radiance[stalk], depth[stalk] = (0.1, 0.8, 0.1), depth_of(0.0)
    radiance[:, POST], depth[:, POST] = (0.5, 0.1, 0.1), depth_of(-6.0)
    colours, share = hidden(Frame(radiance, depth).layers[0])
    inside = np.zeros((SIZE, SIZE), bool)
    inside[:, POST] = True
    green = share * (colours[..., 1] > 2 * colours[..., 0])
    assert (green[stalk & inside] > 0.5).mean() > 0.75
    assert green[inside & (across > 2.5)].sum() == 0.0
