import numpy as np
import pytest
from naive.psfs import capsule_psf, disc_coverage
from scipy.ndimage import gaussian_filter

import spreadlets.precompute.sparsify.direct as direct_module
import spreadlets.precompute.sparsify.fitted as fitted_module
from spreadlets.errors import InvalidParameterError
from spreadlets.metrics import psf_l1, psf_similarity
from spreadlets.precompute.sparsify.direct import DIRECT_BITS, round_direct
from spreadlets.precompute.sparsify.sparsify import sparsify

# Shape (radius, length, angle): budgets of sparsity, SSIM loss and L1 at density 1.
BUDGETS = {
    (12.0, 0.0, 0.0): (0.26, 0.035, 0.06),
    (30.0, 0.0, 0.0): (0.10, 0.025, 0.03),
    (12.0, 30.0, 0.0): (0.13, 0.03, 0.06),
    (12.0, 30.0, 0.5): (0.13, 0.03, 0.06),
    (12.0, 30.0, np.pi / 4): (0.13, 0.03, 0.06),
}


@pytest.mark.parametrize("shape", BUDGETS, ids=str)
def test_discs_and_capsules_keep_their_budgets(shape):
    psf = capsule_psf(*shape)
    sparsity, loss, l1 = BUDGETS[shape]
    spreadlet, statistics = sparsify(psf)
    assert not spreadlet.direct
    assert statistics["sparsity"] < sparsity
    assert 1 - statistics["ssim"] < loss
    assert statistics["l1"] < l1
    assert statistics["energy_error"] < 1e-6
    assert statistics["max_value_ratio"] < 10


def test_statistics_are_those_of_the_reconstruction():
    psf = np.pad(capsule_psf(8.0, 5.0, 0.2), 20)
    spreadlet, statistics = sparsify(psf)
    dense = spreadlet.to_dense(margin=40)
    half = np.array(dense.shape[:2]) // 2
    window = dense[tuple(slice(h - s // 2, h + s // 2 + 1) for h, s in zip(half, psf.shape, strict=True))]
    assert statistics["ssim"] == pytest.approx(psf_similarity(psf, window[..., 0]), abs=1e-9)
    assert statistics["l1"] == pytest.approx(psf_l1(psf, window[..., 0]), rel=0.02)
    assert statistics["n_points"] == spreadlet.n_points
    assert statistics["n_support"] == (psf > 1e-4 * psf.max()).sum()
    assert dense.sum() == pytest.approx(1, abs=1e-4)


def test_far_field_dies_off():
    spreadlet, _ = sparsify(disc_coverage(10.0))
    dense = spreadlet.to_dense(margin=60)[..., 0]
    y, x = np.mgrid[: dense.shape[0], : dense.shape[1]] - np.array(dense.shape)[:, None, None] // 2
    peak = disc_coverage(10.0).max()
    assert np.abs(dense[np.hypot(y, x) > 25]).max() < 1e-3 * peak
    assert np.abs(dense[np.hypot(y, x) > 50]).max() < 1e-4 * peak


def test_faint_tails_keep_their_energy():
    y, x = np.mgrid[:181, :181] - 90
    psf = np.exp(-np.hypot(y, x) / 6)
    assert psf[psf < 1e-4].sum() > 1e-4 * psf.sum()
    spreadlet, _ = sparsify(psf)
    energy = spreadlet.moments()[4:].sum() / 4
    assert not spreadlet.direct
    assert energy == pytest.approx(psf.sum(), rel=1e-5)


def test_density_trades_points_for_similarity():
    psf = capsule_psf(10.0, 12.0, 0.3)
    figures = [sparsify(psf, density=density)[1] for density in (0.5, 1, 2)]
    counts, similarities = ([f[key] for f in figures] for key in ("n_points", "ssim"))
    assert counts[0] < 0.85 * counts[1] and counts[1] < 0.85 * counts[2]
    assert similarities[0] < similarities[1] < similarities[2]


@pytest.mark.parametrize("psf", [disc_coverage(8.0), capsule_psf(4.0, 16.0, 0.7)])
def test_few_points_are_no_excuse_for_any_loss(psf):
    """At half the density a point is worth so much that the price alone would drop twice as many."""
    spreadlet, statistics = sparsify(psf, density=0.5)
    assert not spreadlet.direct and 1 - statistics["ssim"] < 0.05  # measured 0.037 and less


def test_equal_seeds_give_equal_spreadlets_and_others_do_not(monkeypatch):
    monkeypatch.setattr("spreadlets.precompute.sparsify.fitted.MAX_ORBITS", 60)
    psf = gaussian_filter(capsule_psf(9.0, 6.0, 0.3), 1.0)
    first, second, other = (sparsify(psf, seed=seed)[0] for seed in (4, 4, 5))
    np.testing.assert_array_equal(first.offset_rc, second.offset_rc)
    np.testing.assert_array_equal(first.value, second.value)
    assert not np.array_equal(first.offset_rc, other.offset_rc)


@pytest.mark.parametrize("psf", [np.ones((1, 1)), capsule_psf(0.4, 40.0, 0.0), capsule_psf(0.6, 30.0, 0.7)])
def test_thin_psfs_are_drawn_directly_and_exactly(psf):
    spreadlet, statistics = sparsify(psf / psf.sum())
    assert spreadlet.direct
    assert statistics["ssim"] > 0.97
    assert statistics["energy_error"] < 1e-6
    assert statistics["sparsity"] <= 1


def test_a_faint_veil_is_not_left_out(monkeypatch):
    """A narrow core in a veil of a third of the light: the similarity alone would drop most of the veil."""
    rows, cols = np.indices((41, 41)) - 20
    square = rows**2 + cols**2
    psf = np.exp(-square / (2 * 0.6**2)) + 0.03 * np.exp(-square / (2 * 2.4**2))
    results = []
    for most in (direct_module.MAX_LEFT_OUT, 1.0):
        monkeypatch.setattr(direct_module, "MAX_LEFT_OUT", most)
        spreadlet, statistics = sparsify(psf)
        assert spreadlet.direct
        kept = np.zeros(psf.shape, np.bool_)
        kept[tuple((spreadlet.offset_rc + 20).T)] = True
        results.append((psf[~kept].sum() / psf.sum(), statistics["l1"]))
    assert results[0][0] <= 0.1 < results[1][0]
    assert results[0][1] < 0.7 * results[1][1]


def test_a_spreadlet_that_was_misjudged_gets_more_points(monkeypatch):
    psf = disc_coverage(14.0)
    plain = sparsify(psf)[1]
    monkeypatch.setattr(fitted_module, "MISJUDGED_LOSS", 0.0)
    again = sparsify(psf)[1]
    assert again["n_points"] > plain["n_points"] and again["ssim"] > plain["ssim"]


def test_of_a_narrow_psf_little_light_goes_astray_in_any_direction(monkeypatch):
    """A slanted path fills a tenth of its box: the similarity alone would let a seventh of the light go astray."""
    paths = [capsule_psf(4.0, 110.0, angle) for angle in (0.3, np.pi / 4)]
    found = [sparsify(psf)[1] for psf in paths]
    monkeypatch.setattr(fitted_module, "WORST_L1", 1.0)
    alone = [sparsify(psf)[1] for psf in paths]
    for given, without in zip(found, alone, strict=True):
        assert given["l1"] < 0.11 < 0.13 < without["l1"]


def test_the_light_that_goes_astray_counts_only_in_what_is_narrow_and_not_waited_for(monkeypatch):
    given = (capsule_psf(5.0, 20.0, 0.3), "fit"), (disc_coverage(9.0), "fit"), (capsule_psf(5.0, 20.0, 0.3), "quick")
    before = [sparsify(psf, sparsifier=name)[1]["n_points"] for psf, name in given]
    monkeypatch.setattr(fitted_module, "WORST_L1", 0.03)
    narrow, wide, quick = (sparsify(psf, sparsifier=name)[1]["n_points"] for psf, name in given)
    assert narrow > before[0] and (wide, quick) == (before[1], before[2])


def test_direct_pixels_are_rounded_to_few_bits_without_loss_of_energy():
    rng = np.random.default_rng(5)
    value = np.concatenate([np.full((300, 2), 0.003), rng.random((100, 2)) * [0.01, 5.0]])
    offset = rng.permutation(np.argwhere(np.ones((20, 20))) - 10)
    rounded = round_direct(offset, value)
    step = 2.0 ** np.ceil(np.log2(value.max(axis=0))) / 2**DIRECT_BITS
    others = np.delete(np.arange(400), np.argmin((offset**2).sum(axis=1)))
    np.testing.assert_array_equal(rounded[others] / step, np.rint(rounded[others] / step))
    assert (np.abs(rounded - value) <= 1.5 * step).all()
    np.testing.assert_allclose(rounded.sum(axis=0, dtype=np.float64), value.sum(axis=0), rtol=1e-7)
    # A plateau keeps its mean: rounding each pixel to the nearest step would shift all of them alike.
    np.testing.assert_allclose(rounded[:300].sum(axis=0), value[:300].sum(axis=0), atol=1.5 * step.max())


def test_points_inherit_the_psf_s_symmetry():
    spreadlet, _ = sparsify(disc_coverage(14.0))
    points = {(int(r), int(c)): float(v) for (r, c), (v,) in zip(spreadlet.offset_rc, spreadlet.value, strict=True)}
    largest = max(map(abs, points.values()))
    for (r, c), value in points.items():
        assert points[c, -r] == pytest.approx(value, abs=1e-4 * largest)


def test_colour_channels_share_positions():
    planes = [gaussian_filter(disc_coverage(radius, size=49), 1.5) for radius in (14.0, 15.0, 16.0)]
    psf = np.stack(planes, axis=-1)
    spreadlet, statistics = sparsify(psf)
    assert spreadlet.value.shape == (spreadlet.n_points, 3)
    assert statistics["ssim"] > 0.95
    np.testing.assert_allclose(spreadlet.moments()[4:], 2 * psf.sum(axis=(0, 1)) * np.ones((2, 1)), rtol=1e-4)


def test_scale_does_not_matter():
    psf = disc_coverage(7.0)
    small, large = sparsify(psf)[0], sparsify(1024 * psf)[0]
    np.testing.assert_array_equal(small.offset_rc, large.offset_rc)
    np.testing.assert_allclose(1024 * small.value, large.value, rtol=1e-5, atol=1e-5 * np.abs(large.value).max())


def test_noise_hardly_adds_points():
    psf = gaussian_filter(disc_coverage(20.0, size=61), 1.5)
    rng = np.random.default_rng(0)
    noisy = np.maximum(psf * (1 + 2e-3 * rng.normal(size=psf.shape)), 0)
    clean, disturbed = sparsify(psf)[1], sparsify(noisy)[1]
    assert disturbed["n_points"] < 1.25 * clean["n_points"]


@pytest.mark.parametrize(
    ("psf", "message"),
    [
        (np.ones((4, 5)), "H and W odd"),
        (np.ones(5), "H and W odd"),
        (np.full((5, 5), np.nan), "finite"),
        (-np.ones((5, 5)), "non-negative"),
        (np.zeros((5, 5)), "not zero everywhere"),
    ],
)
def test_malformed_psfs_are_refused(psf, message):
    with pytest.raises(InvalidParameterError, match=message):
        sparsify(psf)


def test_density_must_be_positive():
    with pytest.raises(InvalidParameterError, match="density must be above 0, not 0"):
        sparsify(np.ones((5, 5)), density=0)


def test_an_unknown_sparsifier_is_refused():
    with pytest.raises(InvalidParameterError, match="sparsifier is 'darts': allowed are 'fit', 'quick', 'lks'"):
        sparsify(np.ones((5, 5)), sparsifier="darts")


def test_the_quick_way_starts_from_fewer_candidates_and_loses_little(monkeypatch):
    started, equations = [], fitted_module.similarity_equations
    monkeypatch.setattr(
        fitted_module,
        "similarity_equations",
        lambda psf, at, *given: started.append(len(at)) or equations(psf, at, *given),
    )
    psf = capsule_psf(16.0, 30.0, 0.3)
    whole, quick = (sparsify(psf, sparsifier=name)[1] for name in ("fit", "quick"))
    assert started[-1] <= fitted_module.QUICK_ORBITS < started[0]
    assert 0.0 < whole["ssim"] - quick["ssim"] < 0.015
    monkeypatch.delattr(fitted_module, "anneal_fitted")
    assert sparsify(psf, sparsifier="quick")[1] == quick


def test_annealing_gives_more_similarity_for_the_same_points(monkeypatch):
    shapes = [capsule_psf(9.0, 22.0, angle) for angle in (0.2, 0.4, 0.6)]
    annealed = [sparsify(psf)[1] for psf in shapes]
    monkeypatch.setattr(fitted_module, "anneal_fitted", lambda equations, near, index, rng: index)
    plain = [sparsify(psf)[1] for psf in shapes]
    assert [some["n_points"] for some in annealed] == [some["n_points"] for some in plain]
    loss, before = (np.mean([1 - some["ssim"] for some in figures]) for figures in (annealed, plain))
    assert loss < 0.99 * before


def test_relaxed_darts_are_better_candidates_than_darts(monkeypatch):
    monkeypatch.setattr(fitted_module, "MAX_ORBITS", 120)
    monkeypatch.setattr(fitted_module, "MISJUDGED_LOSS", 1.0)
    psf = gaussian_filter(np.pad(capsule_psf(14.0, 20.0, 0.3), 6), 1.0)
    relaxed = np.mean([fitted_module._loss(sparsify(psf, seed=seed)) for seed in range(4)])
    monkeypatch.setattr(fitted_module, "RELAXATIONS", 0)
    thrown = np.mean([fitted_module._loss(sparsify(psf, seed=seed)) for seed in range(4)])
    assert relaxed < 0.97 * thrown
