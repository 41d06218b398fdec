"""The published chain: every stage of LKS section 5.5, with its numbers, in its order."""

import numpy as np
from naive.psfs import capsule_psf, disc_coverage
from scipy.ndimage import gaussian_filter

from spreadlets.precompute.sparsify import lks as module
from spreadlets.precompute.sparsify.annealing import anneal
from spreadlets.precompute.sparsify.dart_throwing import throw_darts
from spreadlets.precompute.sparsify.lks import place_points, with_moments
from spreadlets.precompute.sparsify.lloyd import collapse, relax
from spreadlets.precompute.sparsify.sparsify import sparsify
from spreadlets.psf.laplacian import laplacian

DISC = disc_coverage(14.0)


def test_the_stages_follow_one_another_and_each_is_as_published(monkeypatch):
    seen = []

    def watch(name, stage):
        def watched(*arguments, **options):
            seen.append((name, len(arguments), options))
            return stage(*arguments, **options)

        monkeypatch.setattr(module, name, watched)

    for name, stage in (("throw_darts", throw_darts), ("relax", relax), ("anneal", anneal), ("collapse", collapse)):
        watch(name, stage)
    sparsify(DISC, sparsifier="lks")
    # Nothing but their own arguments: the numbers of attempts, iterations and steps are their defaults.
    assert seen == [("throw_darts", 3, {}), ("relax", 2, {}), ("anneal", 4, {}), ("collapse", 2, {})]


def test_points_hold_the_sums_over_their_voronoi_cells():
    psf = np.pad(DISC, 3)[..., None]
    points, value = place_points(psf, 1.0, np.random.default_rng(0))
    np.testing.assert_allclose(value, collapse(laplacian(psf)[1:-1, 1:-1], points), rtol=0, atol=1e-15)
    np.testing.assert_allclose(value.sum(axis=0), 0.0, atol=1e-12)


def test_points_lie_where_the_laplacian_does():
    psf = np.pad(DISC, 8)[..., None]
    points, _ = place_points(psf, 1.0, np.random.default_rng(0))
    distance = np.hypot(*(points - np.array(psf.shape[:2]) // 2).T)
    assert np.mean(np.abs(distance - 14.0) < 2.5) > 0.9


def test_density_is_a_factor_of_the_number_of_points():
    soft = gaussian_filter(np.pad(DISC, 8), 2.0)
    counts = [sparsify(soft, density=density, sparsifier="lks")[0].n_points for density in (0.5, 1.0, 2.0)]
    assert counts[0] < 0.65 * counts[1] and counts[1] < 0.65 * counts[2]


def test_a_psf_of_few_pixels_is_kept_as_pixels():
    thin, statistics = sparsify(capsule_psf(0.6, 30.0, 0.3), sparsifier="lks")
    assert thin.direct and statistics["sparsity"] == 1.0 and statistics["ssim"] > 0.999
    assert not sparsify(DISC, sparsifier="lks")[0].direct


def test_the_fit_is_sparser_at_a_higher_similarity():
    published, fitted = (sparsify(DISC, sparsifier=name)[1] for name in ("lks", "fit"))
    assert fitted["ssim"] > published["ssim"] > 0.8


def test_the_moments_are_repaired_and_hardly_anything_else():
    psf = gaussian_filter(np.pad(DISC, 12), 2.0)[..., None]
    points, value = place_points(psf, 0.5, np.random.default_rng(0))
    offset = points - np.array(psf.shape[:2]) // 2
    repaired = with_moments(psf, offset, value)
    rows, cols = offset.T
    for power in (rows**0, rows, cols, rows * cols):
        np.testing.assert_allclose(power @ repaired, 0.0, atol=1e-9)
    np.testing.assert_allclose([rows**2 @ repaired, cols**2 @ repaired], 2.0, rtol=1e-9)
    assert max(abs(rows @ value), abs(cols @ value), abs(rows**2 @ value - 2.0)) > 1e-3
    assert np.abs(repaired - value).max() < 0.05 * np.abs(value).max()
    assert sparsify(DISC, sparsifier="lks")[1]["energy_error"] < 1e-5


def test_equal_seeds_give_equal_spreadlets_and_others_do_not():
    first, second, other = (sparsify(DISC, seed=seed, sparsifier="lks")[0] for seed in (4, 4, 5))
    np.testing.assert_array_equal(first.offset_rc, second.offset_rc)
    np.testing.assert_array_equal(first.value, second.value)
    assert not np.array_equal(first.offset_rc, other.offset_rc)


def test_colours_share_their_points():
    planes = np.stack([disc_coverage(radius, size=41) for radius in (13.0, 14.0, 15.0)], axis=-1)
    spreadlet, statistics = sparsify(planes, sparsifier="lks")
    assert spreadlet.value.shape == (spreadlet.n_points, 3)
    assert statistics["ssim"] > 0.94
