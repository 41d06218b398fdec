"""Samples on curved paths, and through a lens that changes while the shutter is open."""

from dataclasses import replace

import numpy as np
import pytest

import spreadlets as sp
from spreadlets.runtime.label.moving import Effects
from spreadlets.runtime.label.sampled import sample_paths, sample_pixels, sample_steps

CAMERA = sp.ThinLens(50.0, 36.0, 2.0, 4.0, shutter=(-0.25, 0.25))
PULL = replace(CAMERA, keys=(sp.LensKey(-0.25, focus_distance_m=2.0), sp.LensKey(0.25, focus_distance_m=8.0)))
BOTH = Effects(defocus=True, motion=True, swept=True)
TURN = np.deg2rad(90.0)


def turning(shape=(6, 8, 2)):
    """Samples of what turns about a point 60 px to the left of each, without lens."""
    rng = np.random.default_rng(0)
    time = rng.uniform(*CAMERA.shutter, shape)
    rotated = [60.0 * np.array([np.cos(a) - 1.0, np.sin(a)]) for a in (-TURN, TURN)]
    before, after = (np.broadcast_to(each, (*shape, 2)) for each in (-rotated[0], rotated[1]))
    still = np.zeros((*shape, 2))
    given = np.ones((*shape, 3)), np.full(shape, 4.0), 0.5 * (before + after), still, time
    return sp.SampleBuffer(*given, motion_prev=before, motion_next=after)


def test_a_curved_path_is_drawn_in_steps_that_lie_on_it():
    samples = turning()
    sets = sample_steps(samples, sample_pixels(samples, CAMERA, defocus=True, motion=True), CAMERA, BOTH)
    assert len(sets) == 4 and all(each.curved.all() for each in sets[:2])
    for number, steps in enumerate(sets[2:]):
        at, drawn = steps.labels.view.places.at, steps.weight > 0
        seen = samples.time[at[..., 0], at[..., 1], number]
        # Each sample was seen on its arc: the middle of the turn lies so far to the side.
        centre = -60.0 * np.stack([np.cos(TURN * seen), np.sin(TURN * seen)], axis=-1)
        away = np.hypot(*np.moveaxis(steps.labels.shift - centre, -1, 0))
        assert away[drawn] == pytest.approx(60.0, abs=0.5)
        assert steps.weight.sum() == pytest.approx(48, rel=1e-5)


def test_samples_move_as_they_do_where_they_were_seen():
    samples = turning()
    paths = sample_paths(samples, sample_pixels(samples, CAMERA, defocus=True, motion=True), CAMERA)
    for number, path in enumerate(paths):
        # The chord of the arc that lies around the time of each.
        angle = TURN * samples.time[:, :, number]
        along = np.stack([-np.sin(angle), np.cos(angle)], axis=-1)
        assert path == pytest.approx(2.0 * 60.0 * np.sin(TURN / 4) * along, abs=0.01)


def test_samples_are_recentred_by_the_lens_at_their_own_time():
    shape = (4, 4, 1)
    rng = np.random.default_rng(0)
    time, lens_uv = rng.uniform(-0.25, 0.25, shape), rng.uniform(-0.7, 0.7, (*shape, 2))
    coc = np.array([float(PULL.at(t).coc_radius(3.0, 4)) for t in time.ravel()]).reshape(shape)
    still = np.zeros((*shape, 2))
    samples = sp.SampleBuffer(np.ones((*shape, 3)), np.full(shape, 3.0), still, lens_uv, time, coc[..., None] * lens_uv)
    (pixels,) = sample_pixels(samples, PULL, defocus=True, motion=True)
    assert pixels.labels.shift == pytest.approx(0.0, abs=0.02 * np.abs(coc).max())


def test_a_pull_of_focus_is_drawn_in_steps_unless_the_buffer_says_how_blurred_it_is():
    shape = (4, 64, 1)
    still = np.zeros((*shape, 2))
    given = np.ones((*shape, 3)), np.full(shape, 3.0), still, still, np.zeros(shape)
    wide = replace(PULL, f_number=0.1)
    for coc_radius, n_sets in ((None, 2), (np.ones(shape), 1)):
        samples = sp.SampleBuffer(*given, coc_radius=coc_radius)
        pixel_sets = sample_pixels(samples, wide, defocus=True, motion=True)
        assert len(sample_steps(samples, pixel_sets, wide, BOTH)) == n_sets


def test_a_rolling_shutter_moves_the_middle_of_the_exposure():
    shape = (5, 3, 1)
    moving = np.full((*shape, 2), (10.0, 0.0))
    samples = sp.SampleBuffer(np.ones((*shape, 3)), np.full(shape, 4.0), moving, 0 * moving, np.zeros(shape))
    (pixels,) = sample_pixels(samples, replace(CAMERA, readout_frames=1.0), defocus=True, motion=True)
    assert pixels.labels.shift[:, 0, 0] == pytest.approx([-5.0, -2.5, 0.0, 2.5, 5.0], abs=1e-5)
