"""How many samples passed a layer: blurred along the layer's own paths."""

import numpy as np
import pytest

from spreadlets.runtime.composite.layers import Moments, Pass, passing_samples
from spreadlets.runtime.plan.layering import Membership

SIZE, LENGTH = 96, 24.0


def passed(paths, inside):
    """Return what passed a layer that each sample ``inside`` (H, W) is of, and which moves along paths (H, W, 2)."""
    layer = np.where(inside, 0, 1).astype(np.int32)
    members = Membership(np.zeros_like(layer), layer, np.zeros(layer.shape, np.float32))
    still = np.zeros((*layer.shape, 2), np.float32)
    square = float((paths[inside] ** 2).sum(axis=-1).mean())
    moments = Moments(0.0, 0.0, square, (0.0, 0.0), LENGTH / 2)
    zeros, ones = np.zeros(layer.shape, np.float32), np.ones(layer.shape, np.float32)
    return passing_samples([Pass(members, still, still, zeros, ones, ones)], [paths], 0, moments, 1.0)


@pytest.mark.interpreted
def test_across_a_path_what_passed_stays_sharp():
    inside = np.zeros((SIZE, SIZE), bool)
    inside[:, 32:64] = True
    paths = np.zeros((SIZE, SIZE, 2), np.float32)
    paths[..., 1] = LENGTH
    found = passed(paths, inside)
    assert found[48, 38:58] == pytest.approx(0.0, abs=0.02), "nothing passes what moves along its edge"
    assert found[48, :26] == pytest.approx(1.0, abs=0.02)


def test_along_a_path_it_is_blurred_as_the_layer_is():
    inside = np.zeros((SIZE, SIZE), bool)
    inside[:, 48:] = True
    paths = np.zeros((SIZE, SIZE, 2), np.float32)
    paths[..., 0] = LENGTH
    found = passed(paths, inside)[48]
    expected = np.clip(0.5 - (np.arange(SIZE) + 0.5 - 48) / LENGTH, 0, 1)
    assert np.abs(found - expected)[48:].max() < 0.15, np.abs(found - expected)[48:].max()


def test_what_turns_is_blurred_along_its_circles():
    y, x = np.indices((SIZE, SIZE)) - (SIZE - 1) / 2
    inside = np.hypot(x, y) < 30.0
    paths = np.stack([-y, x], axis=-1).astype(np.float32) * np.float32(0.8)
    found = passed(paths, inside)
    rim = (np.hypot(x, y) > 22.0) & (np.hypot(x, y) < 25.0)
    assert found[rim].mean() < 0.03, found[rim].mean()


def test_of_a_turning_blade_as_much_is_passed_as_it_leaves():
    # A wedge turns about the middle. Samples at random times meet it or pass it; both are moved to mid-shutter alike.
    count, turn = 8, np.float32(0.8)
    y, x = np.indices((SIZE, SIZE)) - (SIZE - 1) / 2
    radius, angle = np.hypot(x, y), np.arctan2(y, x)
    times = np.random.default_rng(0).uniform(-0.5, 0.5, (count, SIZE, SIZE)).astype(np.float32)
    met = np.abs(angle - turn * times) < 0.7
    path = np.stack([-y, x], axis=-1).astype(np.float32) * turn
    moments = Moments(0.0, 0.0, float((path**2).sum(axis=-1).mean()), (0.0, 0.0), SIZE / 2)
    still = np.zeros((SIZE, SIZE, 2), np.float32)

    def passed_by(behind):
        layers = behind.astype(np.int32)
        members = [Membership(np.zeros_like(each), each, still[..., 0].copy()) for each in layers]
        ones = np.ones_like(radius, np.float32)
        passes = [Pass(each, still, still, time, ones, ones) for each, time in zip(members, times, strict=True)]
        return passing_samples(passes, [path] * count, 0, moments, 1.0)

    past, own = passed_by(~met), passed_by(met)
    expected = np.mean([np.abs(angle - turn * time) >= 0.7 for time in np.linspace(-0.5, 0.5, 257)], axis=0)
    near = (radius > 12.0) & (radius < 36.0) & (np.abs(angle) < 2.0)
    error = (past / (past + own) - expected)[near]
    assert np.sqrt(np.mean(error**2)) < 0.045  # measured 0.026
