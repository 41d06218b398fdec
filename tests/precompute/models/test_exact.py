"""PSFs of single coordinates of every model, against the same traced."""

import numpy as np
import pytest

from spreadlets.metrics import psf_similarity
from spreadlets.precompute.models.exact_cache import CachedPsfs
from spreadlets.precompute.models.registry import exact_psf, trace_psf
from spreadlets.psf.database import open_database
from spreadlets.psf.exact import direct_points
from spreadlets.psf.model import get_model


def pair(exact, traced):
    """Both on a window that holds both."""
    shape = np.maximum(exact.shape[:2], traced.shape[:2])
    return [
        np.pad(psf, [*(((want - have) // 2,) * 2 for have, want in zip(psf.shape, shape, strict=False)), (0, 0)])
        for psf in (traced, exact)
    ]


def similarity(model, coordinate, angle, side, rays=None):
    made = exact_psf(model)(np.array([coordinate]), np.array([angle]), np.array([side]))
    traced = trace_psf(model, np.repeat(np.array(coordinate)[:, None], 2, 1), angle=angle, side=side, rays=rays)
    return psf_similarity(*pair(next(made).to_dense(), traced))


@pytest.mark.parametrize(
    ("name", "coordinate", "side", "least"),
    [
        ("stylized", (3.0,), 1, 0.9999),
        ("stylized", (17.0,), 1, 0.9999),
        ("physicallens", (6.0, 4.0), 1, 0.99),
        ("physicallens", (9.0, 24.0), -1, 0.99),
        ("physicallens", (14.0, 17.0), 1, 0.99),
    ],
)
def test_a_psf_of_a_single_coordinate_is_the_traced_one(name, coordinate, side, least):
    with open_database(name) as database:
        assert similarity(database.grid.model, coordinate, 2.2, side) > least


def test_an_aperture_with_a_shape_of_its_own_is_traced():
    settings = {
        "aperture": dict(
            blades=5,
            blade_curvature=0.0,
            rotation=10.0,
            cats_eye=0.0,
            cats_eye_angle=0.0,
            squeeze=1.0,
            spherical_aberration=0.0,
            obstruction=0.0,
        ),
        "shutter_curve": None,
        "symmetry": {"arrow": False, "lattice": False, "sign": "turned"},
    }
    model = get_model("combined", settings=settings)
    assert similarity(model, (9.0, 6.0), 0.7, -1) > 0.995


def test_equal_models_share_what_makes_their_psfs():
    first, second = (get_model("combined", max_coc=12.0) for _ in range(2))
    assert exact_psf(first) is exact_psf(second)
    assert exact_psf(get_model("volume", settings={})) is None, "its cells are exact"


def test_psfs_are_made_once_and_the_oldest_go(monkeypatch):
    made = []

    def make(coordinate, angle, side):
        made.append(coordinate)
        return np.full((1, int(coordinate[0]), 1), 1.0 / coordinate[0])

    monkeypatch.setattr("spreadlets.precompute.models.exact_cache.MOST_KEPT_POINTS", 8)
    psfs = CachedPsfs(make)

    def ask(*sizes):
        nothing = np.zeros(len(sizes))
        return [psf.n_points for psf in psfs(np.array(sizes)[:, None], nothing, nothing.astype(int))]

    assert ask(3.0, 5.0, 3.0) == [3, 5, 3] and sorted(made) == [(3.0,), (5.0,)]
    assert ask(3.0) == [3] and len(made) == 2
    assert ask(1.0) == [1] and ask(5.0) == [5], "5 was asked for before 3 was again"
    assert made[2:] == [(1.0,), (5.0,)]


def test_points_of_a_pure_colour_have_no_light_in_the_other_channels():
    psf = np.zeros((5, 5, 3))
    psf[1:4, 1:4, 0] = 1.0 / 3.0
    assert direct_points(psf).to_dense().sum(axis=(0, 1)).tolist() == pytest.approx([3.0, 0.0, 0.0])
