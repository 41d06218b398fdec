import numpy as np
import pytest

from spreadlets.errors import InvalidParameterError
from spreadlets.psf.laplacian import (
    MAX_GREEN_RADIUS,
    laplacian,
    lattice_biharmonic,
    lattice_green,
    solve_dirichlet,
    solve_free_space,
)

FLOAT64_ROUNDING = 1e-12
FLOAT32_SOLVE = 1e-5
"""Relative error of a float32 solve of some hundred pixels: its smallest eigenvalue amplifies rounding."""


def stencil(table):
    """The 5-point stencil at the inner points of a table."""
    return table[2:, 1:-1] + table[:-2, 1:-1] + table[1:-1, 2:] + table[1:-1, :-2] - 4 * table[1:-1, 1:-1]


def whole(quarter):
    """A table on all four quadrants from its quarter."""
    half = np.concatenate([quarter[:0:-1], quarter])
    return np.concatenate([half[:, :0:-1], half], axis=1)


def random_image(shape, border=3, dtype=np.float64):
    image = np.zeros(shape, dtype)
    inner = tuple(slice(border, -border) for _ in range(2))
    image[inner] = np.random.default_rng(1).normal(size=image[inner].shape)
    return image


def disc(side, radius):
    y, x = np.mgrid[:side, :side] - side // 2
    return (np.hypot(x - 0.3, y) < radius).astype(np.float64)


class TestLaplacian:
    def test_of_one_pixel_is_the_stencil(self):
        assert laplacian(np.ones((1, 1))).tolist() == [[0, 1, 0], [1, -4, 1], [0, 1, 0]]

    @pytest.mark.parametrize("shape", [(1, 7), (5, 4), (6, 5, 3)])
    def test_sum_and_first_moments_vanish_and_the_second_is_four_times_the_sum(self, shape):
        image = np.random.default_rng(0).uniform(size=shape)
        field = laplacian(image)
        y, x = (
            axis.reshape(axis.shape + (1,) * (image.ndim - 2)) for axis in np.mgrid[tuple(map(slice, field.shape[:2]))]
        )
        for weights in (np.ones_like(x), x, y):
            np.testing.assert_allclose((weights * field).sum(axis=(0, 1)), 0, atol=FLOAT64_ROUNDING * 100)
        np.testing.assert_allclose(((x * x + y * y) * field).sum(axis=(0, 1)), 4 * image.sum(axis=(0, 1)))

    def test_keeps_the_dtype(self):
        assert laplacian(np.ones((2, 2), np.float32)).dtype == np.float32

    @pytest.mark.parametrize("image", [np.ones((2, 2), int), np.ones(3), np.ones((0, 3))])
    def test_refuses_what_is_no_image(self, image):
        with pytest.raises(InvalidParameterError, match="floating-point"):
            laplacian(image)


class TestSolve:
    @pytest.mark.parametrize("shape", [(40, 31), (37, 64, 3), (9, 90, 1), (66, 70, 4)])
    @pytest.mark.parametrize("solve", [solve_dirichlet, solve_free_space])
    def test_inverts_the_stencil(self, shape, solve):
        image = random_image(shape)
        assert np.abs(solve(laplacian(image)[1:-1, 1:-1]) - image).max() < FLOAT64_ROUNDING * 10

    def test_float32_stays_float32(self):
        image = random_image((60, 45, 4), dtype=np.float32)
        source = laplacian(image)[1:-1, 1:-1]
        kept = source.copy()
        solution = solve_dirichlet(source, workers=2)
        assert solution.dtype == np.float32
        assert np.abs(solution - image).max() < FLOAT32_SOLVE
        assert np.array_equal(source, kept)

    def test_overwrite_uses_the_source_as_workspace(self):
        source = laplacian(random_image((140, 150)))[1:-1, 1:-1].copy()
        kept = source.copy()
        solution = solve_dirichlet(source, overwrite=True)
        np.testing.assert_allclose(solution, solve_dirichlet(kept), atol=FLOAT64_ROUNDING)
        assert not np.array_equal(source, kept)

    def test_one_pixel_in_a_box(self):
        assert solve_dirichlet(np.ones((1, 1)))[0, 0] == pytest.approx(-0.25)

    def test_free_space_answer_of_one_pixel_is_the_lattice_green_function(self):
        source = np.zeros((9, 6))
        source[0, 0] = 1
        assert np.abs(solve_free_space(source) - lattice_green(8)[:9, :6]).max() < FLOAT64_ROUNDING

    def test_a_box_cuts_off_the_field_of_a_source_that_is_not_an_image_s_laplacian(self):
        source = np.zeros((33, 33))
        source[16, 15:18] = 1, -2, 1
        inside, free = solve_dirichlet(source), solve_free_space(source)
        assert 1e-4 < np.abs(inside - free).max() < 1e-2


class TestLatticeGreen:
    def test_known_values(self):
        table = lattice_green(2)
        expected = [[0, 0.25, 1 - 2 / np.pi], [0.25, 1 / np.pi, 2 / np.pi - 0.25]]
        np.testing.assert_allclose(table[:2], expected, atol=FLOAT64_ROUNDING * 0.01)

    @pytest.mark.parametrize("radius", [1, 5, 60, 300])
    def test_stencil_gives_a_point(self, radius):
        field = stencil(whole(lattice_green(radius)))
        field[radius - 1, radius - 1] -= 1
        assert np.abs(field).max() < FLOAT64_ROUNDING

    def test_far_out_it_is_the_logarithm(self):
        radius = 400
        table = lattice_green(radius)
        expected = (np.log(radius) + np.euler_gamma + 1.5 * np.log(2)) / (2 * np.pi)
        # The next term of the expansion falls with the squared distance.
        assert table[radius, 0] == pytest.approx(expected, abs=0.02 / radius**2)

    def test_is_symmetric_and_does_not_depend_on_the_radius(self):
        table = lattice_green(90)
        assert np.abs(table - table.T).max() < FLOAT64_ROUNDING
        assert np.abs(table[:31, :31] - lattice_green(30)).max() < FLOAT64_ROUNDING

    @pytest.mark.parametrize("radius", [-1, MAX_GREEN_RADIUS + 1])
    def test_refuses_a_radius_out_of_range(self, radius):
        with pytest.raises(InvalidParameterError, match=str(radius)):
            lattice_green(radius)

    def test_radius_zero(self):
        assert lattice_green(0).tolist() == [[0]]
        assert lattice_biharmonic(0).tolist() == [[0]]


class TestLatticeBiharmonic:
    @pytest.mark.parametrize("radius", [1, 5, 60, 300])
    def test_stencil_gives_the_green_function(self, radius):
        table, green = whole(lattice_biharmonic(radius)), whole(lattice_green(radius))
        error = np.abs(stencil(table) - green[1:-1, 1:-1]).max()
        assert error < FLOAT64_ROUNDING * max(1, np.abs(table).max())

    def test_is_symmetric_and_does_not_depend_on_the_radius(self):
        table = lattice_biharmonic(90)
        assert np.array_equal(table, table.T)
        assert np.abs(table[:31, :31] - lattice_biharmonic(30)).max() < 1e-10 * table.max()

    def test_gives_the_energy_of_an_image_from_its_laplacian_alone(self):
        # All moments of its Laplacian up to the second vanish, because the image's own sum does.
        image = disc(41, 12)
        image = np.roll(image, 1, axis=0) + np.roll(image, -1, axis=0) - 2 * image
        source = laplacian(image)[1:-1, 1:-1]
        points = np.argwhere(source)
        values = source[tuple(points.T)]
        gram = lattice_biharmonic(60)[tuple(np.abs(points[:, None] - points).transpose(2, 0, 1))]
        assert values @ gram @ values == pytest.approx(np.sum(image**2), rel=1e-8)
