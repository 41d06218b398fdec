import numpy as np
import pytest
from naive.psfs import capsule_psf, disc_coverage

from spreadlets.precompute.sparsify import symmetry


@pytest.mark.parametrize(
    ("psf", "order"),
    [
        (disc_coverage(5.0), 8),
        (capsule_psf(4.0, 6.0, 0.0), 4),
        (capsule_psf(4.0, 6.0, np.pi / 4), 4),
        (capsule_psf(4.0, 6.0, 0.3), 2),
        (np.eye(5) * np.arange(5), 1),
    ],
)
def test_the_largest_group_is_found(psf, order):
    assert len(symmetry.find_group(np.ascontiguousarray(psf)[..., None])) in {order} | ({2} if order == 1 else set())


def test_noise_below_the_tolerance_is_ignored():
    psf = disc_coverage(5.0)[..., None]
    noisy = psf + 1e-3 * psf.max() * np.random.default_rng(0).random(psf.shape)
    assert len(symmetry.find_group(noisy)) == 8
    assert len(symmetry.find_group(noisy, tolerance=1e-6)) == 1


@pytest.mark.parametrize("group", symmetry.GROUPS, ids=lambda group: f"order {len(group)}")
def test_offsets_and_images_move_alike(group):
    rng = np.random.default_rng(0)
    image = rng.random((7, 7, 1))
    offset = np.argwhere(np.ones((7, 7))) - 3
    for element in group:
        moved = symmetry.transform_offsets(offset, element)
        original = image[offset[:, 0] + 3, offset[:, 1] + 3]
        transformed = symmetry.transform_image(image, element)[moved[:, 0] + 3, moved[:, 1] + 3]
        np.testing.assert_array_equal(original, transformed)


@pytest.mark.parametrize("group", symmetry.GROUPS, ids=lambda group: f"order {len(group)}")
def test_groups_are_closed_and_symmetrising_is_idempotent(group):
    image = np.random.default_rng(0).random((7, 7, 2))
    once = symmetry.symmetrise(image, group)
    assert len(group) == len(symmetry.find_group(once, tolerance=1e-12))
    np.testing.assert_allclose(symmetry.symmetrise(once, group), once, rtol=1e-12)


def test_orbits_hold_each_point_once_and_expand_to_all_images():
    group = symmetry.GROUPS[0]
    members, size = symmetry.orbits(np.array([[0, 0], [0, 3], [2, 2], [1, 2], [2, 1]]), group)
    assert sorted(size) == [1, 4, 4, 8]
    offset, value = symmetry.expand(members, size, size[:, None].astype(float))
    assert len(offset) == size.sum() == len(np.unique(offset, axis=0))
    assert (value[(offset == [0, 0]).all(axis=1)] == 1).all()
    assert (value[(np.abs(offset) == [1, 2]).all(axis=1)] == 8).all()


def test_representatives_count_what_they_stand_for():
    offset = np.array([[0, 0], [1, 2], [-1, -2], [3, 3]])
    index, count = symmetry.representatives(offset, (symmetry.IDENTITY, symmetry.HALF_TURN))
    assert len(index) == 3 and sorted(count) == [1, 1, 2]
