import numpy as np
import pytest
from naive import sparsify as naive
from naive.psfs import capsule_psf
from scipy import ndimage
from skimage.metrics import structural_similarity

from spreadlets.precompute.sparsify import _sparsify_kernels as _kernels
from spreadlets.precompute.sparsify.similarity import detail_filter, similarity_equations, with_detail
from spreadlets.precompute.sparsify.symmetry import GROUPS, IDENTITY, find_group, orbits, symmetrise
from spreadlets.psf.laplacian import laplacian


def boxed_capsule(radius=7.0, length=10.0, angle=0.0):
    psf = np.pad(capsule_psf(radius, length, angle), 10)
    return (psf / psf.max())[..., None]


def edge_offsets(psf, every=1):
    field = laplacian(psf)[1:-1, 1:-1, 0]
    return np.argwhere(np.abs(field) > 1e-2 * np.abs(field).max())[::every] - np.array(psf.shape[:2]) // 2


@pytest.mark.interpreted
def test_rows_kernel_agrees_with_its_naive_twin():
    rng = np.random.default_rng(0)
    sample, members = rng.integers(-4, 5, (6, 2)), rng.integers(-4, 5, (5, 2, 2))
    weight, share = rng.random((6, 3)), rng.random(5)
    mean, detail = rng.random((12, 12)), rng.random((12, 12))
    rows = np.empty((18, 5))
    _kernels.fill_rows(sample, weight, members, share, mean, detail, rows)
    for s in range(6):
        for j in range(5):
            d = sample[s] - members[j]
            here, right, below = (np.abs(d + step) for step in ([0, 0], [0, 1], [1, 0]))
            level = detail[here[:, 0], here[:, 1]]
            expected = [
                weight[s, 0] * mean[here[:, 0], here[:, 1]].sum(),
                weight[s, 1] * (detail[right[:, 0], right[:, 1]] - level).sum(),
                weight[s, 2] * (detail[below[:, 0], below[:, 1]] - level).sum(),
            ]
            np.testing.assert_allclose(rows[3 * s : 3 * s + 3, j], np.array(expected) * share[j], rtol=1e-10)


@pytest.mark.parametrize("angle", [0.0, 0.4])
def test_the_form_estimates_structural_dissimilarity(angle):
    psf = boxed_capsule(angle=angle)
    members, size = orbits(edge_offsets(psf, 4), (IDENTITY,))
    equations = similarity_equations(psf, members, size, (IDENTITY,))
    value = equations.solve(equations.free_inverse())
    dense = (naive.green_columns(members[:, 0], psf.shape[:2]) @ value)[..., 0]
    estimate, exact = equations.objective(value), naive.dissimilarity_form(psf[..., 0], dense - psf[..., 0])
    measured = 1 - structural_similarity(
        psf[..., 0], dense, gaussian_weights=True, sigma=1.5, use_sample_covariance=False, data_range=1.0
    )
    assert exact == pytest.approx(measured, rel=0.15)
    assert estimate == pytest.approx(measured, rel=0.35)


def test_its_minimum_is_more_similar_than_plain_least_squares():
    psf = boxed_capsule()
    offset = edge_offsets(psf, 4)
    members, size = orbits(offset, (IDENTITY,))
    equations = similarity_equations(psf, members, size, (IDENTITY,))
    columns = naive.green_columns(offset, psf.shape[:2])
    target = np.array([0, 0, 0, 0, 2, 2]) * psf.sum()
    plain = naive.constrained_least_squares(
        columns.reshape(-1, len(offset)), psf.ravel(), naive.moment_rows(offset), target
    )
    fitted = equations.solve(equations.free_inverse())[:, 0]
    losses = [naive.dissimilarity_form(psf[..., 0], columns @ v - psf[..., 0]) for v in (fitted, plain)]
    assert losses[0] < 0.8 * losses[1]
    np.testing.assert_allclose(naive.moment_rows(offset) @ fitted, target, atol=1e-8 * psf.sum() * 100)


@pytest.mark.parametrize("group", [group for group in GROUPS if not any(g.transpose for g in group)], ids=len)
def test_orbits_give_the_values_of_the_unreduced_problem(group):
    psf = symmetrise(boxed_capsule(), group)
    assert set(group) <= set(find_group(psf))
    members, size = orbits(edge_offsets(psf, 3), group)
    reduced = similarity_equations(psf, members, size, group)
    value = reduced.solve(reduced.free_inverse())
    offset = np.unique(members.reshape(-1, 2), axis=0)
    full = similarity_equations(psf, *orbits(offset, (IDENTITY,)), (IDENTITY,))
    alone = full.solve(full.free_inverse())
    assert reduced.objective(value) == pytest.approx(full.objective(alone), rel=0.05)


def test_large_problems_are_thinned_without_losing_the_scale(monkeypatch):
    psf = boxed_capsule(12.0, 20.0)
    members, size = orbits(edge_offsets(psf, 3), (IDENTITY,))
    full = similarity_equations(psf, members, size, (IDENTITY,))
    monkeypatch.setattr("spreadlets.precompute.sparsify.similarity.MAX_SAMPLES", 1000)
    thinned = similarity_equations(psf, members, size, (IDENTITY,))
    value = full.solve(full.free_inverse())
    assert thinned.objective(value) == pytest.approx(full.objective(value), rel=0.1)
    assert not np.array_equal(thinned.gram, full.gram)


@pytest.mark.parametrize("shape", [(7, 30), (64, 45)])
def test_the_detail_of_an_image_is_its_convolution_with_the_filter(shape):
    image = np.random.default_rng(3).random(shape)
    expected = ndimage.convolve(image, detail_filter(), mode="constant")
    np.testing.assert_allclose(with_detail(image), expected, rtol=0, atol=1e-12 * expected.max())
