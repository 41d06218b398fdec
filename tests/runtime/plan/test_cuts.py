"""Where the cuts between depth layers lie, on depths whose surfaces are known."""

import itertools

import numpy as np
import pytest

from spreadlets.runtime.label.labels import Labels, View
from spreadlets.runtime.plan import cuts
from spreadlets.runtime.plan.cuts import Steps, best_cuts
from spreadlets.runtime.plan.layering import Layering

SCALE, FOCUS = 60.0, 4.0
"""The CoC radius is SCALE (1 / FOCUS - 1 / depth), px."""


def fitted(coc, most=12, motion=0.0, softness=0.0):
    """Cuts, as CoC radii, of an image of CoC radii."""
    coc = np.asarray(coc, np.float32)
    depth = 1.0 / (1.0 / FOCUS - coc / SCALE)
    path = np.stack([np.broadcast_to(np.float32(motion), coc.shape), np.zeros_like(coc)], axis=-1)
    labels = Labels(coc, path, path[..., 0], None, View(depth.astype(np.float32), 1.0, 1.0))
    made = Layering.fitted([(labels, np.zeros(coc.shape, np.int32))], most, softness)
    return SCALE * (1.0 / FOCUS + np.array(made.cuts)), made


def blocks(values, size=8):
    return np.kron(np.array(values, float), np.ones((size, size)))


def slant(low, high, shape=(48, 48)):
    return np.linspace(low, high, shape[0])[:, None] * np.ones(shape)


def test_a_cut_lies_midway_between_two_surfaces():
    found, _ = fitted(blocks([[-10, 6], [6, -10]]))
    assert len(found) == 1 and found[0] == pytest.approx(-2.0, abs=0.3)


def test_a_surface_in_focus_shares_no_layer_with_what_is_blurred():
    found, _ = fitted(blocks([[0, 14, -12], [14, -12, 0], [-12, 0, 14]]), most=4)
    assert ((found > 1) & (found < 13)).any() and ((found > -11) & (found < -1)).any()


def test_a_slanted_surface_alone_is_not_cut():
    assert not len(fitted(slant(-12, 12))[0])


def test_an_object_before_a_slanted_surface_is_cut_off_it():
    coc = slant(2, 14)
    coc[8:40, 20:26] = -9.0
    found, _ = fitted(coc)
    assert len(found) == 1 and -9 < found[0] < 2


def test_surfaces_that_do_not_meet_need_no_cut():
    coc = np.concatenate([slant(-10, 0, (48, 40)), slant(0, 10, (48, 40))])
    assert not len(fitted(coc)[0])


def test_more_layers_part_more_surfaces_up_to_the_number_allowed():
    coc = blocks(np.random.default_rng(0).permutation(np.linspace(-20, 20, 36)).reshape(6, 6), size=2)
    counts = [fitted(coc, most)[1].n_layers for most in (1, 2, 4, 12)]
    assert counts[:3] == [1, 2, 4] and 6 <= counts[3] <= 12


def test_surfaces_that_meet_along_columns_are_cut_as_those_along_rows():
    bands = blocks([[-10] * 4, [6] * 4, [-10] * 4, [6] * 4])
    (found, _), (turned, _) = fitted(bands), fitted(bands.T.copy())
    assert len(found) == 1
    np.testing.assert_allclose(found, turned, rtol=1e-6)


def test_a_slope_is_not_cut_whichever_way_it_leans():
    for coc in (slant(-12, 12), slant(-12, 12).T.copy()):
        assert not len(fitted(coc)[0])


def test_without_defocus_the_motion_tells_where_to_cut():
    depth_like = blocks([[-10, 6], [6, -10]])
    depth = (1.0 / (1.0 / FOCUS - depth_like / SCALE)).astype(np.float32)
    path = np.zeros((*depth.shape, 2), np.float32)
    path[depth_like < 0] = (20.0, 0.0)
    for paths, count in ((path, 2), (0 * path, 1)):
        labels = Labels(np.zeros_like(depth), paths, np.hypot(*np.moveaxis(paths, 2, 0)), None, View(depth, 1.0, 1.0))
        assert Layering.fitted([(labels, np.zeros(depth.shape, np.int32))], 12, 0.0).n_layers == count


def test_paths_that_cancel_in_the_mean_part_surfaces_where_they_meet():
    depth = np.where(blocks([[0, 1], [1, 0]]) > 0, 2.0, 8.0).astype(np.float32)
    across = np.where(np.arange(16) % 8 < 4, 20.0, -20.0) * (depth == 2.0)
    path = np.stack([across, np.zeros_like(across)], axis=-1).astype(np.float32)
    labels = Labels(np.zeros_like(depth), path, np.abs(path[..., 0]), None, View(depth, 1.0, 1.0))
    assert Layering.fitted([(labels, np.zeros(depth.shape, np.int32))], 12, 0.0).n_layers == 2


def test_the_partition_is_the_best_of_all(monkeypatch):
    monkeypatch.setattr(cuts, "LEAST_GAIN", 0.0)
    rng = np.random.default_rng(1)
    n = 9
    meetings = np.triu(rng.random((n, n)), 1) / 40
    coc, seams = np.sort(rng.uniform(-9, 9, n)), rng.random(n + 1) / 20
    steps = Steps(np.ones(n, bool), meetings, seams, coc, np.zeros((n, n)))
    apart = np.abs(coc[:, None] - coc)
    harm = meetings * apart**2 / (1 + apart + np.minimum(*np.abs(np.broadcast_arrays(coc[:, None], coc))))

    def cost(borders):
        ends = [0, *borders, n]
        return sum(harm[a:b, a:b].sum() for a, b in itertools.pairwise(ends)) + seams[list(borders)].sum()

    for count in (2, 3, 4):
        best = min(cost(each) for k in range(count) for each in itertools.combinations(range(1, n), k))
        assert cost(best_cuts(steps, count).astype(int)) == pytest.approx(best)


def test_softness_is_a_share_of_the_thinner_layer():
    _, made = fitted(blocks([[-10, 6, 16], [16, -10, 6], [6, 16, -10]]), softness=0.5)
    borders = np.array([1 / FOCUS + 10 / SCALE, *(-np.array(made.cuts)), 1 / FOCUS - 16 / SCALE])
    steps = -np.diff(borders)
    assert made.widths == pytest.approx(0.5 * np.minimum(steps[1:], steps[:-1]), rel=1e-3)
