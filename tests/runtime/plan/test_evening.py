"""Samples weighed by the area that they stand for."""

import numpy as np
import pytest

from spreadlets.runtime.label.labels import Labels, View
from spreadlets.runtime.label.lists import Pixels
from spreadlets.runtime.plan.evening import Seen, evened
from spreadlets.runtime.plan.layering import Layering

SIZE = 96
LAYERS = Layering((-0.75, -0.5, -0.25), (0.2, 0.2, 0.2))
"""Between depths of 4/3, 2 and 4 m."""


def scattered(rng, n_samples=1, depth=2.0):
    """Sets of samples that lie anywhere within 6 px of their pixels."""
    nothing = np.zeros((SIZE, SIZE), np.float32)
    view = View(np.broadcast_to(np.float32(depth), nothing.shape).copy(), 1.0, 1.0)
    shifts = rng.uniform(-6, 6, (n_samples, SIZE, SIZE, 2)).astype(np.float32)
    still = np.zeros((SIZE, SIZE, 2), np.float32)
    return [Pixels(np.ones((SIZE, SIZE, 4), np.float32), Labels(nothing, still, nothing, s, view)) for s in shifts]


def taken(sets):
    """How samples were taken that lie where they are drawn: wherever on the way what they met is."""
    none, there = np.zeros((SIZE, SIZE, 2), np.float32), np.ones((SIZE, SIZE), bool)
    return [Seen(there, each.labels, each.labels.shift, none, none[..., 0]) for each in sets]


def weighed(sets, layering):
    return evened(sets, taken(sets), layering)[0]


def noise(sets, side=4):
    """Relative deviation of the weights that fall into squares of some px."""
    count = np.zeros((SIZE // side, SIZE // side))
    for each in sets:
        place = np.indices((SIZE, SIZE)).transpose(1, 2, 0) + 0.5 + each.labels.shift[..., ::-1]
        at = np.floor(place / side).astype(int)
        inside = ((at >= 0) & (at < len(count))).all(axis=2)
        weight = each.weight if len(each.weight) else np.ones((SIZE, SIZE), np.float32)
        np.add.at(count, tuple(at[inside].T), weight[inside])
    inner = count[3:-3, 3:-3]
    return inner.std() / inner.mean()


@pytest.mark.parametrize(("n_samples", "left"), [pytest.param(1, 0.69, marks=pytest.mark.interpreted), (4, 0.565)])
def test_random_samples_are_evened(n_samples, left):
    sets = scattered(np.random.default_rng(0), n_samples)
    assert noise(weighed(sets, Layering()), 2) < left * noise(
        sets, 2
    )  # measured 0.65 and 0.54, evened once 0.71 and 0.58


def test_samples_that_lie_evenly_keep_their_weight():
    (pixels,) = scattered(np.random.default_rng(0))
    still = pixels._replace(labels=pixels.labels._replace(shift=np.zeros((SIZE, SIZE, 2), np.float32)))
    (found,) = weighed([still], Layering())
    assert found.weight[20:-20, 20:-20] == pytest.approx(1.0, abs=1e-5)


def test_a_surface_keeps_its_share_of_what_was_seen():
    depth = np.where(np.arange(SIZE) % 12 < 3, 2.0, 8.0)
    sets = scattered(np.random.default_rng(0), 4, depth)
    near = np.broadcast_to(depth == 2.0, (SIZE, SIZE))
    assert sum(each.weight[near].sum() for each in weighed(sets, LAYERS)) == pytest.approx(4 * near.sum(), rel=0.03)


def test_what_met_nothing_keeps_its_weight_and_counts_for_none():
    (pixels,) = scattered(np.random.default_rng(0))
    pixels.radiance[:, ::2] = 0.0
    (found,) = weighed([pixels], Layering())
    assert (found.weight[:, ::2] == 1.0).all() and found.weight[:, 1::2].std() > 0.1


def test_a_lamp_before_a_wall_that_is_seen_past_it_keeps_its_light():
    rng = np.random.default_rng(0)
    pixels = scattered(rng, 4)
    row, col = np.indices((SIZE, SIZE))
    lamp, sets = np.hypot(row - 48, col - 48) < 3, []
    for each in pixels:
        # Samples of the lamp lie on it, and those of the wall everywhere.
        shift = np.where(lamp[..., None], rng.uniform(-0.5, 0.5, (SIZE, SIZE, 2)), each.labels.shift)
        depth = np.where(lamp, 20.0, 32.0).astype(np.float32)
        depth[:4] = 1.0  # all else is in the farthest of the layers
        view = each.labels.view._replace(depth=depth)
        sets.append(each._replace(labels=each.labels._replace(shift=shift.astype(np.float32), view=view)))
    weights = np.stack([each.weight for each in weighed(sets, LAYERS)])
    assert weights[:, lamp].mean() == pytest.approx(1.0, abs=0.03)
