import math

import numba
import numpy as np
import pytest
from threads import for_thread_counts

from spreadlets.errors import InvalidParameterError
from spreadlets.precompute.models._volume_kernels import free_path, scattering_cosine, seed_state, uniform
from spreadlets.precompute.models.grids import model_settings
from spreadlets.precompute.models.registry import trace_psf
from spreadlets.precompute.models.volume import (
    N_BLOCKS,
    RINGS_PER_PX,
    Medium,
    blurred_share,
    draw_rings,
    trace_paths,
)
from spreadlets.precompute.sparsify.preparation import split_spike
from spreadlets.precompute.sparsify.sparsify import sparsify
from spreadlets.psf.model import get_model
from spreadlets.scene.camera import ThinLens

N = 40_000
ERRORS = 3.0
"""Standard errors by which a mean may differ from its expectation; seeds are fixed."""

compiled = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="thousands of paths need the compiled kernels")


def assert_mean(samples, expected):
    samples = np.asarray(samples)
    error = samples.std(ddof=1) / math.sqrt(len(samples))
    assert abs(samples.mean() - expected) < ERRORS * error


def states(seed, n=N):
    return [seed_state(seed, path) for path in range(n)]


@compiled
def test_numbers_are_uniform():
    numbers = np.array([[uniform(state) for _ in range(3)] for state in states(1)])
    assert ((numbers > 0) & (numbers <= 1)).all()
    for column in numbers.T:
        assert_mean(column, 0.5)
        assert_mean(column**2, 1 / 3)
    assert_mean(numbers[:, 0] * numbers[:, 1], 0.25)
    assert_mean(numbers[1:, 0] * numbers[:-1, 0], 0.25)


@compiled
@pytest.mark.parametrize("density", [0.9, 3.0])
def test_mean_free_path_is_the_inverse_of_the_density(density):
    paths = [free_path(density, state) for state in states(2)]
    assert_mean(paths, 1 / density)
    assert_mean(np.square(paths), 2 / density**2)


@compiled
@pytest.mark.parametrize("g", [0.8, 0.0, -0.5])
def test_mean_cosine_is_the_anisotropy(g):
    cosines = [scattering_cosine(g, uniform(state)) for state in states(3)]
    assert_mean(cosines, g)
    # The second Legendre moment of Henyey and Greenstein is g squared.
    assert_mean(1.5 * np.square(cosines) - 0.5, g * g)


def tally_of(medium, distance, seeds=24, n_paths=4000, radius=40.0):
    """Trace with several seeds; return the tallies."""
    return [trace_paths(medium, (distance, distance), 500.0, radius, n_paths, seed) for seed in range(seeds)]


@compiled
def test_all_energy_is_accounted_for():
    for tally in tally_of(Medium(), 2.0, seeds=2):
        total = tally.rings.sum(axis=0) + tally.direct + tally.absorbed + tally.lost
        np.testing.assert_allclose(total, 1.0, rtol=1e-12)
        assert tally.direct == pytest.approx(math.exp(-0.9 * 2.0), rel=1e-9)
        assert tally.absorbed[0] == 0 < tally.absorbed[2]


@compiled
def test_energy_of_forward_scattering_is_the_closed_form():
    """Light that is scattered straight on is only absorbed: exp(-density distance (1 - albedo)) of it arrives."""
    albedo = (0.9, 0.5, 0.0)
    tallies = tally_of(Medium(0.9, 1.0 - 1e-12, albedo), 2.0)
    for channel, a in enumerate(albedo[:2]):
        arrived = [tally.direct + tally.rings[:, channel].sum() for tally in tallies]
        assert_mean(arrived, math.exp(-0.9 * 2.0 * (1 - a)))
    for tally in tallies:
        assert tally.rings[:, 2].sum() == 0
        # It all arrives on the axis.
        assert tally.rings[1:].max() < 1e-12


@compiled
def test_single_scattering_has_the_closed_form_within_a_radius():
    """In a thin medium a path collides once: integrate over the place and the angle of that collision."""
    medium, distance, radius, focal = Medium(1e-4, 0.8, (1.0, 1.0, 1.0)), 2.0, 40.0, 500.0
    reach = radius / focal * distance
    place = (np.arange(4000) + 0.5) / 4000 * distance
    cosine = (distance - place) / np.hypot(distance - place, reach)
    g = medium.anisotropy
    # Share of the phase function within an angle, by its distribution function.
    within = (1 - g * g) / (2 * g) * (1 / (1 - g) - 1 / np.sqrt(1 + g * g - 2 * g * cosine))
    expected = within.mean()
    shares = []
    for tally in tally_of(medium, distance):
        scattered = 1.0 - tally.direct
        shares.append(tally.rings[:-1, 0].sum() / scattered)
    assert_mean(shares, expected)


@compiled
def test_result_does_not_depend_on_the_thread_count():
    first, *others = for_thread_counts(
        lambda: trace_paths(Medium(), (1.0, 2.0), 500.0, 20.0, 10 * N_BLOCKS + 3, 7).rings
    )
    for other in others:
        np.testing.assert_array_equal(other, first)


def test_rings_are_drawn_with_their_energy_and_their_place():
    rings = np.zeros((20 * RINGS_PER_PX, 1))
    rings[: 10 * RINGS_PER_PX, 0] = np.diff((np.arange(10 * RINGS_PER_PX + 1) / RINGS_PER_PX) ** 2)
    psf = draw_rings(rings, 0.25)[..., 0]
    assert psf.shape == (41, 41)
    assert psf.sum() == pytest.approx(rings.sum() + 0.25)
    assert psf[20, 20] == pytest.approx(np.pi**-1 + 0.25, rel=0.02)
    assert psf[20, 28] == pytest.approx(np.pi**-1, rel=0.02) and psf[20, 32] < 0.02
    np.testing.assert_allclose(psf, psf[::-1, ::-1], atol=1e-12)


def volume(**options):
    return get_model("volume", settings=model_settings("volume", {"width": 512, "psf_radius": 32.0} | options))


@compiled
def test_far_light_turns_yellow_and_loses_its_core():
    near, far = (trace_psf(volume(), [[d, d]], rays=200_000) for d in (0.2, 3.0))
    assert far.sum(axis=(0, 1))[2] < near.sum(axis=(0, 1))[2] < near.sum(axis=(0, 1))[0]
    middle = near.shape[0] // 2
    assert far[middle, middle, 0] < 0.7 * near[middle, middle, 0]


@compiled
def test_unscattered_light_is_kept_beside_a_similar_halo():
    psf = trace_psf(volume(), [[1.0, 1.0]], rays=400_000)
    spreadlet, statistics = sparsify(psf)
    dense = spreadlet.to_dense(margin=8)
    middle, centre = np.array(dense.shape[:2]) // 2, np.array(psf.shape[:2]) // 2
    np.testing.assert_allclose(dense[tuple(middle)], psf[tuple(centre)], rtol=0.05)
    rest, spike = split_spike(psf)
    assert (spike > 10 * rest.max(axis=(0, 1))).all()
    assert statistics["ssim"] > 0.95 and not spreadlet.direct
    # The halo alone, in total and half-way out: without the split, the similarity would not see it.
    halo = dense[middle[0] - 12 : middle[0] + 13, middle[1] - 12 : middle[1] + 13].sum() - dense[tuple(middle)].sum()
    true = psf[centre[0] - 12 : centre[0] + 13, centre[1] - 12 : centre[1] + 13].sum() - psf[tuple(centre)].sum()
    assert halo == pytest.approx(true, rel=0.1)


def test_camera_sets_the_scale():
    camera = ThinLens(focal_length_mm=85, sensor_width_mm=36, f_number=2, focus_distance_m=2)
    settings = model_settings("volume", {"camera": camera, "width": 720})
    assert settings["view"]["focal_length_px"] == pytest.approx(1700.0)


@pytest.mark.parametrize(
    "options, message",
    [
        ({"medium_density": 0.0}, "medium_density is 0.0: it must be finite and > 0"),
        ({"max_distance": math.inf}, "max_distance is inf"),
        ({"anisotropy": 1.0}, "between -1 and 1"),
        ({"albedo": (1.0, 1.0)}, "three numbers"),
        ({"albedo": (0.0, 0.0, 0.0)}, "not all 0"),
        ({"image": "x.png"}, "'volume' has no image; its own are: medium_density"),
    ],
)
def test_impossible_media_are_refused(options, message):
    with pytest.raises(InvalidParameterError, match=message):
        model_settings("volume", options)


def test_a_layer_hides_what_lies_right_behind_it_as_its_own_light():
    model = volume(psf_radius=128.0)
    assert blurred_share(model, 1.0, 1.001) == blurred_share(model, 0.0, 2.0) == 1.0
    assert blurred_share(model, 3.0, math.inf) == blurred_share(model, 3.0, 4.0), "the database ends at 4 m"


@pytest.mark.parametrize(("near", "far", "share"), [(0.9, 1.125, 0.879), (0.9, 3.6, 0.702), (1.8, 3.6, 0.809)])
def test_what_is_not_scattered_before_a_layer_is_hidden_right_there(near, far, share):
    """Shares of a Monte Carlo of its own that follows paths through both planes."""
    assert blurred_share(volume(psf_radius=128.0), near, far) == pytest.approx(share, abs=0.015)
