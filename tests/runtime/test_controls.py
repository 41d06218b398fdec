"""Artistic controls, each by what it changes."""

from dataclasses import replace

import numpy as np
import pytest

from spreadlets.errors import InvalidParameterError
from spreadlets.runtime.controls import Controls
from spreadlets.runtime.options import Options

DEPTH = np.array([[1.0, 2.0, 3.0, 4.0, np.inf]], np.float32)
SCALE = 12.0


def own_coc(focus):
    return (SCALE * (1 / focus - 1 / DEPTH)).astype(np.float32)


def changed(focus=2.0, **controls):
    return Controls(**controls).coc(own_coc(focus), DEPTH, SCALE)[0]


def test_strengths_apply_to_their_own_side_of_the_focus():
    np.testing.assert_allclose(changed(near_strength=0.5, far_strength=3.0), [-3.0, 0.0, 6.0, 9.0, 18.0], rtol=1e-6)


def test_a_range_in_focus_is_sharp_and_the_blur_begins_at_its_ends():
    np.testing.assert_allclose(changed(in_focus=(2.0, 3.0)), [-6.0, 0.0, 0.0, 1.0, 4.0], atol=1e-5)


def test_the_largest_coc_holds_on_both_sides():
    np.testing.assert_allclose(changed(focus=4.0, max_coc=2.5), [-2.5, -2.5, -1.0, 0.0, 2.5], atol=1e-6)


def test_without_controls_the_lens_stays_as_it_is():
    assert not Controls().change_coc
    np.testing.assert_array_equal(changed(), own_coc(2.0)[0])


def test_highlights_gain_only_above_the_threshold_and_where_blurred():
    radiance = np.array([[[0.5, 0.25, 0.0, 1.0], [2.0, 1.0, 0.0, 1.0], [2.0, 1.0, 0.0, 1.0]]], np.float32)
    coc = np.array([[9.0, -9.0, 0.0]], np.float32)
    light = Controls(highlights=(5.0, 1.0)).light(radiance, coc)
    np.testing.assert_allclose(light[0, :, 0], [0.5, 6.0, 2.0])
    np.testing.assert_allclose(light[0, 1], [6.0, 3.0, 0.0, 1.0])  # the hue and the coverage stay


@pytest.mark.parametrize(
    "bad",
    [
        {"near_strength": -1.0},
        {"far_strength": np.nan},
        {"in_focus": (3.0, 2.0)},
        {"in_focus": (0.0, 2.0)},
        {"in_focus": 2.0},
        {"max_coc": -1.0},
        {"highlights": (-1.0, 1.0)},
        {"highlights": (1.0, 2.0, 3.0)},
        {"proxy": 0.0},
        {"proxy": 1.5},
        {"region": (0, 0, 0, 5)},
        {"focus_at": (np.inf, 0.0)},
        {"cycles": 2.5},
        {"cycles": -1},
        {"defocus": "no"},
        {"motion": 0.5},
    ],
)
def test_bad_values_are_refused_by_name(bad):
    with pytest.raises(InvalidParameterError, match=next(iter(bad))):
        Options.of(**bad)


def test_options_take_the_controls_and_can_be_changed():
    assert replace(Options(near_strength=0.5), max_coc=3.0).near_strength == 0.5


def test_an_option_that_does_not_exist_is_named_with_those_that_do():
    with pytest.raises(TypeError, match=r"no option 'blade': there are .*\bmax_coc\b"):
        Options.of(blade=6)
